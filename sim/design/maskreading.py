"""Etch masks read back: a window of any GDSII file becomes a height map."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from anisoscope.base.errors import ConfigError, HeightMapError
from anisoscope.base.regular_file import regular_file
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.sim.design.depths import MOST_PASSES, level_heights
from anisoscope.sim.design.layout import MAX_POINTS
from anisoscope.sim.design.mask import FIRST_LAYER, SCHEMA_VERSION, TEXT_LAYER

if TYPE_CHECKING:
    import gdstk


def read_gds(
    path: Path,
    *,
    corner_um: tuple[float, float] = (0.0, 0.0),
    size_um: tuple[float, float] | None = None,
    grid_um: float | None = None,
    passes_nm: tuple[float, ...] | None = None,
) -> HeightMap:
    """The heights of a window of a GDSII file; every layer from 1 on is an etch pass.

    A grid point is etched where its middle is inside a polygon.

    Args:
        path: the file.
        corner_um: (y, x) of the lower left corner of the window, from the lower left corner of the drawing.
        size_um: (along y, along x); all the rest by default.
        grid_um: pixel size; of files of ours as they say.
        passes_nm: depth of the pass of layer 1, 2, …; of files of ours as they say.

    Raises:
        ConfigError: no GDSII, no polygons, one that crosses itself, or depths or a grid that are given nowhere.
        HeightMapError: a window outside the drawing, or too large.
    """
    top, header = _opened(path)
    depths = passes_nm or tuple(header.get("passes_nm", ()))
    grid = grid_um or header.get("grid_um")
    if not depths or grid is None:
        raise ConfigError(
            f"{path}: the file does not say depths and grid: give --depths in nm and --grid in µm"
        )
    if len(depths) > 2 * MOST_PASSES or not min(depths) > 0.0:
        raise ConfigError(
            f"{path}: masks take 1 to {2 * MOST_PASSES} passes of positive depth in nm, not {list(depths)}"
        )
    parts = header.get("grid_um", grid) / grid
    if parts < 1.0 - 1e-9 or abs(parts - round(parts)) > 1e-6 * parts:
        raise ConfigError(
            f"{path}: undersampled: its edges lie on a grid of {header['grid_um']:g} µm, {grid:g} µm would move them: "
            f"take --grid {header['grid_um']:g} or a whole part of it"
        )
    if "size_um" in header:
        (x0, y0), (high, wide) = (0.0, 0.0), header["size_um"]
    else:
        box = top.bounding_box()
        if box is None:
            raise ConfigError(f"{path}: no polygon in {top.name}: nothing is etched")
        (x0, y0), high, wide = box[0], box[1][1] - box[0][1], box[1][0] - box[0][0]
    y, x = corner_um
    size_y, size_x = (high - y, wide - x) if size_um is None else size_um
    rows, cols = round(size_y / grid), round(size_x / grid)
    if min(y, x) < 0.0 or min(rows, cols) < 2 or y + size_y > high + grid or x + size_x > wide + grid:
        raise HeightMapError(
            f"{path.name}: a window of {size_x:g} × {size_y:g} µm at x = {x:g}, y = {y:g} µm is not within the drawing "
            f"of {wide:g} × {high:g} µm: choose a window inside"
        )
    if rows * cols > MAX_POINTS:
        raise HeightMapError(
            f"{path.name}: {rows} × {cols} points are too many; choose a window or a coarser grid"
        )
    labels = _drawn(top, (x0 + x, y0 + y), (rows, cols), grid, len(depths), path)
    heights = np.asarray(level_heights(tuple(1e-3 * depth for depth in depths)))[labels]
    origin = {"ideal": "masks", "masks": path.name, "passes_nm": list(depths), "corner_um": [y, x]}
    return HeightMap(heights, grid, grid, {"made": origin})


def _opened(path: Path) -> "tuple[gdstk.Cell, dict[str, Any]]":
    import gdstk  # noqa: PLC0415 - loaded when first needed

    if not path.is_file():
        raise ConfigError(f"{path}: there is no such file")
    with regular_file(path) as stream:
        if stream.read(4)[2:] != b"\x00\x02":
            raise ConfigError(f"{path}: not a GDSII file")
    try:
        library = gdstk.read_gds(path, unit=1e-6)
    except (OSError, RuntimeError, ValueError) as error:
        raise ConfigError(f"{path}: not a GDSII file that can be read ({error})") from None
    tops = [cell for cell in library.top_level() if isinstance(cell, gdstk.Cell)]
    if len(tops) != 1:
        names = ", ".join(cell.name for cell in tops) or "none"
        raise ConfigError(f"{path}: one top cell is needed, found: {names}; keep one")
    for label in tops[0].labels:
        if label.layer == TEXT_LAYER and label.text.startswith('{"anisoscope_masks"'):
            header = _header(label.text, path)
            if header["anisoscope_masks"] != SCHEMA_VERSION:
                raise ConfigError(
                    f"{path}: masks of schema {header['anisoscope_masks']}; known is {SCHEMA_VERSION}"
                )
            return tops[0], header
    return tops[0], {}


def _header(text: str, path: Path) -> dict[str, Any]:
    """Header of a mask file of ours; of another schema its number only."""
    try:
        header: dict[str, Any] = json.loads(text)
        if header["anisoscope_masks"] != SCHEMA_VERSION:
            return header
        numbers = [*header["passes_nm"], header["grid_um"], *header["size_um"]]
        if len(header["size_um"]) == 2 and all(0.0 < float(one) < np.inf for one in numbers):
            return header
    except (ValueError, KeyError, TypeError):
        pass
    raise ConfigError(
        f"{path}: the text that says depths and grid is damaged: remove it, or write the masks again"
    )


def _drawn(
    top: "gdstk.Cell",
    corner: tuple[float, float],
    shape: tuple[int, int],
    grid: float,
    passes: int,
    path: Path,
) -> npt.NDArray[np.int64]:
    labels = np.zeros(shape, dtype=np.int64)
    far = corner[0] + shape[1] * grid, corner[1] + shape[0] * grid
    for polygon in _inside(top, corner, far):
        bit = polygon.layer - FIRST_LAYER
        if polygon.layer == TEXT_LAYER:
            continue
        if bit >= passes:
            raise ConfigError(
                f"{path}: polygons on layer {polygon.layer}, but {passes} depths: give a depth for every layer"
            )
        points = (np.asarray(polygon.points) - corner) / grid
        if _crosses(points):
            x, y = points.mean(axis=0) * grid + corner
            raise ConfigError(
                f"{path}: a polygon of layer {polygon.layer} near x = {x:g}, y = {y:g} µm crosses itself, and does not "
                "say what is etched: draw it as polygons that do not"
            )
        _fill(labels, points, 1 << bit)
    return labels


def _inside(
    cell: "gdstk.Cell", low: tuple[float, float], high: tuple[float, float]
) -> "Iterator[gdstk.Polygon]":
    """Polygons of a cell that reach into a window; whole references outside are left where they are."""
    yield from cell.get_polygons(depth=0)
    for reference in cell.references:
        if not _reaches(reference.bounding_box(), low, high):
            continue
        for single in _unrolled(reference, low, high):
            yield from single.get_polygons()


def _reaches(box: Any, low: tuple[float, float], high: tuple[float, float]) -> bool:  # noqa: ANN401 - or None
    """Whether a box ((x0, y0), (x1, y1)) has anything in a window; nothing drawn has no box."""
    if box is None:
        return False
    (x0, y0), (x1, y1) = box
    return bool(x0 < high[0] and y0 < high[1] and x1 > low[0] and y1 > low[1])


def _unrolled(reference: Any, low: tuple[float, float], high: tuple[float, float]) -> Iterator[Any]:  # noqa: ANN401
    """The members of an array that reach into a window, as references of their own."""
    import gdstk  # noqa: PLC0415 - loaded when first needed

    if reference.repetition.size == 0:
        yield reference
        return
    for dx, dy in reference.repetition.get_offsets():
        place = reference.origin[0] + dx, reference.origin[1] + dy
        single = gdstk.Reference(
            reference.cell, place, reference.rotation, reference.magnification, reference.x_reflection
        )
        if _reaches(single.bounding_box(), low, high):
            yield single


def _crosses(points: npt.NDArray[np.float64]) -> bool:
    """Whether an outline crosses itself: the area that it goes around is not the one that it covers."""
    import gdstk  # noqa: PLC0415 - loaded when first needed

    steps = np.diff(points, axis=0, append=points[:1])
    if len(points) <= 4 and (np.abs(steps).min(axis=1) == 0.0).all():
        return False
    outline = gdstk.Polygon([(float(x), float(y)) for x, y in points])
    covered = sum(one.area() for one in gdstk.boolean(outline, [], "or", precision=1e-6))
    return bool(abs(covered - outline.area()) > 0.01 + 1e-6 * covered)


def _fill(labels: npt.NDArray[np.int64], points: npt.NDArray[np.float64], bit: int) -> None:
    """Set a bit where the middles of grid points are inside a polygon; points are (x, y) in grid steps."""
    low, high = points.min(axis=0), points.max(axis=0)
    corners = len(points) == 4 and all(
        np.isin(points[:, axis], (low[axis], high[axis])).all() for axis in (0, 1)
    )
    first = np.maximum(np.ceil(low - 0.5 - 1e-6), 0).astype(int)
    last = np.minimum(np.ceil(high - 0.5 - 1e-6), labels.shape[::-1]).astype(int)
    if (last <= first).any():
        return
    window = labels[first[1] : last[1], first[0] : last[0]]
    if corners:
        if (high - low).min() < 1.0 - 1e-6:
            raise ConfigError(
                f"undersampled: a feature of {(high - low).min():.2g} pixels may be lost: take a finer --grid"
            )
        window |= bit
        return
    from skimage.draw import polygon2mask  # noqa: PLC0415 - slow to import

    shifted = points[:, ::-1] - first[::-1] - 0.5
    window[polygon2mask(window.shape, shifted)] |= bit  # type: ignore[no-untyped-call]
