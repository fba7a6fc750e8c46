"""The height map: a sampled surface with its scale."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Self

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import HeightMapError
from anisoscope.base.notebook import axes_or_new, html_picture, html_table

if TYPE_CHECKING:
    from matplotlib.axes import Axes

PICTURE_POINTS = 600  # along the longer side, in a notebook


Layer = npt.NDArray[np.float32]

BLOCK_POINTS = 2**18  # two megabytes, which stay in the cache


def row_blocks(shape: tuple[int, ...]) -> Iterator[slice]:
    """Slices of rows that together are the map, each small enough for the cache.

    Work on whole maps makes a new array, and its memory, at every step; on blocks it does not.
    """
    rows = max(1, BLOCK_POINTS // max(1, shape[1]))
    for start in range(0, shape[0], rows):
        yield slice(start, min(start + rows, shape[0]))


def sampled(chosen: npt.NDArray[np.bool_], most: int) -> npt.NDArray[np.intp]:
    """Flat places of every n-th of the chosen points of (rows, cols), n the whole number that leaves ``most`` or more.

    All of them where they are fewer.
    """
    step = max(1, int(np.count_nonzero(chosen)) // most)
    found, before = [], 0
    for block in row_blocks(chosen.shape):
        here = np.flatnonzero(chosen[block])
        found.append(here[-before % step :: step] + block.start * chosen.shape[1])
        before += here.size
    return np.concatenate(found)


def known_mean(height_um: FloatArray) -> float:
    """Mean of the measured heights of (rows, cols); NaN where nothing was measured."""
    total, count = 0.0, 0
    for block in row_blocks(height_um.shape):
        part = height_um[block]
        known = np.isfinite(part)
        total += float(np.sum(part, where=known))
        count += int(np.count_nonzero(known))
    return total / count if count else float("nan")


def sealed(height_um: FloatArray) -> FloatArray:
    """The array, read-only, so that a map takes it over instead of copying it."""
    height_um.flags.writeable = False
    return height_um


def _owned(height_um: FloatArray) -> FloatArray:
    """A private read-only copy; a read-only array is used unchanged."""
    given = np.asarray(height_um)
    if given.dtype == np.float64 and given.flags.c_contiguous and not given.flags.writeable:
        return given
    return np.array(given, dtype=np.float64, order="C")


INTENSITY, COLOUR, INTERPOLATED = "intensity", "colour", "interpolated"
MOST_INTERPOLATED = 0.5


def _layers(given: Mapping[str, Layer], shape: tuple[int, ...]) -> dict[str, Layer]:
    """Private read-only copies of layers; read-only float32 arrays are used unchanged."""
    found: dict[str, Layer] = {}
    for name, values in given.items():
        layer = np.asarray(values)
        due = {INTENSITY: shape, COLOUR: (*shape, 3), INTERPOLATED: shape}.get(name)
        if due is None:
            raise HeightMapError(
                f"a height map has no layer {name!r}; it has {INTENSITY}, {COLOUR} and {INTERPOLATED}"
            )
        if layer.shape != due:
            raise HeightMapError(f"the {name} layer has shape {layer.shape} where {due} is due")
        if layer.dtype != np.float32 or layer.flags.writeable:
            layer = np.array(layer, dtype=np.float32, order="C")
        layer.flags.writeable = False
        found[name] = layer
    return found


@dataclass(frozen=True, eq=False)
class HeightMap:
    """A surface sampled on a regular grid.

    Rows run along y and columns along x: row index increases with **+y**, column index with +x, so that
    ``height_um[i, j]`` stands at ``(x, y) = (j * pixel_x_um, i * pixel_y_um)``, z up.

    Attributes:
        height_um: (rows, cols) heights in µm; NaN where nothing was measured. Read-only: the array given is
            copied, unless it is read-only.
        pixel_x_um: distance of neighbouring columns in µm.
        pixel_y_um: distance of neighbouring rows in µm.
        origin: where the map comes from (file, instrument, date, what was corrected, ...), as plain
            JSON-compatible data that travels with the map.
        layers: what the instrument stored besides the heights, in its own numbers, float32, NaN where missing:
            ``"intensity"`` (rows, cols), ``"colour"`` (rows, cols, 3) red, green, blue. ``"interpolated"`` (rows, cols)
            is 1 where scattered points were interpolated further than half a step from any of them, else 0.

    Raises:
        HeightMapError: the array is not two-dimensional with at least 2 × 2 points, a pixel size is
            not a positive finite number, or a layer has another name or shape.
    """

    height_um: FloatArray
    pixel_x_um: float
    pixel_y_um: float
    origin: dict[str, Any] = field(default_factory=dict)
    layers: Mapping[str, Layer] = field(default_factory=dict)

    def __post_init__(self) -> None:
        height = _owned(self.height_um)
        if height.ndim != 2 or min(height.shape) < 2:
            raise HeightMapError(
                f"a height map needs at least 2 × 2 points, this array has shape {height.shape}"
            )
        for axis, pixel in (("x", self.pixel_x_um), ("y", self.pixel_y_um)):
            if not (np.isfinite(pixel) and pixel > 0):
                raise HeightMapError(
                    f"the pixel size along {axis} must be a positive number of µm, not {pixel}"
                )
        height.flags.writeable = False
        object.__setattr__(self, "height_um", height)
        object.__setattr__(self, "layers", _layers(self.layers, height.shape))

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, cols)."""
        rows, cols = self.height_um.shape
        return rows, cols

    @property
    def missing_share(self) -> float:
        """Share of points that were not measured, 0 to 1."""
        return (
            self.height_um.size - int(np.count_nonzero(np.isfinite(self.height_um)))
        ) / self.height_um.size

    @property
    def extent_um(self) -> tuple[float, float]:
        """(along y, along x): size of the sampled field in µm, one pixel per point."""
        rows, cols = self.shape
        return rows * self.pixel_y_um, cols * self.pixel_x_um

    def measured(self) -> Self:
        """The map without interpolated points, which become missing: what is measured on a map leaves them out.

        Raises:
            HeightMapError: more than half of the heights are interpolated.
        """
        if (layer := self.layers.get(INTERPOLATED)) is None:
            return self
        guessed = ~(layer < 0.5) & np.isfinite(self.height_um)
        if not guessed.any():
            return self
        share = np.count_nonzero(guessed) / np.count_nonzero(np.isfinite(self.height_um))
        if share > MOST_INTERPOLATED:
            raise HeightMapError(
                f"{self.origin.get('file', 'the map')}: grid: {share:.0%} of the heights are interpolated, further "
                "than half a step from any measured point; take a larger step with --grid"
            )
        return self.with_height(sealed(np.where(guessed, np.nan, self.height_um)))

    def with_height(self, height_um: FloatArray, **origin: Any) -> Self:  # noqa: ANN401 - free-form provenance
        """The same grid with other heights; ``origin`` entries are added to the provenance.

        Layers stay, unless the heights have another shape.
        """
        layers = self.layers if np.shape(height_um) == self.shape else {}
        return replace(self, height_um=height_um, layers=layers, origin={**self.origin, **origin})

    def __repr__(self) -> str:
        """One line: size, pixel, range of the heights, missing share."""
        return f"HeightMap({', '.join(f'{name} {text}' for name, text in self._facts())})"

    def _repr_html_(self) -> str:
        from matplotlib.figure import Figure  # noqa: PLC0415 - slow to import

        figure = Figure(figsize=(5.0, 3.6), layout="constrained")
        step = max(1, max(self.shape) // PICTURE_POINTS)
        self._draw(figure.add_subplot(), step)
        name = str(self.origin.get("file", "height map"))
        return html_table(name, ("", ""), self._facts()) + html_picture(figure, name)

    def _facts(self) -> list[tuple[str, str]]:
        rows, cols = self.shape
        known = self.height_um[np.isfinite(self.height_um)]
        heights = f"{known.min():.4g} to {known.max():.4g} µm" if known.size else "none measured"
        return [
            ("points", f"{rows} × {cols}"),
            ("pixel", f"{self.pixel_y_um:g} × {self.pixel_x_um:g} µm"),
            ("heights", heights),
            ("missing", f"{self.missing_share:.2%}"),
            *([("layers", ", ".join(self.layers))] if self.layers else []),
        ]

    def plot(self, axes: "Axes | None" = None) -> "Axes":
        """Draw the heights in false colours, x to the right and y up in µm; missing points are white.

        Args:
            axes: of matplotlib, to draw into; a new figure where they are not given.
        """
        return self._draw(axes_or_new(axes), 1)

    def _draw(self, axes: "Axes", step: int) -> "Axes":
        along_y, along_x = self.extent_um
        shown = np.ma.masked_invalid(self.height_um[::step, ::step])
        picture = axes.imshow(shown, origin="lower", extent=(0.0, along_x, 0.0, along_y), cmap="viridis")
        axes.set(xlabel="x [µm]", ylabel="y [µm]")
        axes.figure.colorbar(picture, ax=axes, label="height [µm]")
        return axes
