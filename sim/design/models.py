"""Reflectance models of a dot in design files: glossy lobe, anti-mirror, mirror, or a mixture.

Every model gives the density that it reflects on average, and random dots.
"""

from typing import Annotated, Literal

import numpy as np
import numpy.typing as npt
from pydantic import Field, model_validator

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import ModelError
from anisoscope.base.toml_file import Part, Positive
from anisoscope.sim.design.antimirror import AntiMirror, Labels
from anisoscope.sim.light.wave.claims import blurred_sinc2, lobe, mixture
from anisoscope.sim.light.wave.sampling import Widths


class LobeModel(Part):
    """Rectangles whose widths are drawn, with random levels: sampling process 1.

    Attributes:
        widths_x_um: widths along x.
        p_a_x: how often each is drawn.
        widths_y_um: widths along y.
        p_a_y: how often each is drawn.
    """

    kind: Literal["lobe"] = "lobe"
    widths_x_um: tuple[Positive, ...] = Field(min_length=1)
    p_a_x: tuple[float, ...]
    widths_y_um: tuple[Positive, ...] = Field(min_length=1)
    p_a_y: tuple[float, ...]

    def axes(self, min_width_um: float) -> tuple[Widths, Widths]:
        """Distributions along x and y.

        Raises:
            ModelError: widths below the smallest feature, or probabilities that are none.
        """
        return (
            Widths(self.widths_x_um, self.p_a_x, min_width_um),
            Widths(self.widths_y_um, self.p_a_y, min_width_um),
        )

    @property
    def finest_um(self) -> float:
        """Width of the narrowest step."""
        return min(self.widths_x_um + self.widths_y_um)


class AntiMirrorModel(Part):
    """Blocks that hold every level equally often: sampling process 2; see `antimirror.AntiMirror`."""

    kind: Literal["antimirror"] = "antimirror"
    arrangement: tuple[int, int]
    widths_um: tuple[Positive, Positive]
    levels: int
    crossed: bool = False
    folded: bool = False

    def parts(self, min_width_um: float) -> AntiMirror:
        """The anti-mirror.

        Raises:
            ModelError: see `antimirror.AntiMirror`.
        """
        return AntiMirror(self.arrangement, self.widths_um, self.levels, self.crossed, min_width_um)

    @property
    def finest_um(self) -> float:
        """Width of the narrowest step."""
        return min(self.widths_um)


class MirrorModel(Part):
    """The bare wafer: a lobe of no width."""

    kind: Literal["mirror"] = "mirror"

    @property
    def finest_um(self) -> float:
        """No step at all."""
        return float("inf")


Single = Annotated[LobeModel | AntiMirrorModel | MirrorModel, Field(discriminator="kind")]


class MixtureModel(Part):
    """Dots of several models next to each other, by shares of the area."""

    kind: Literal["mixture"] = "mixture"
    shares: tuple[float, ...]
    models: tuple[Single, ...]

    @model_validator(mode="after")
    def _shares_add_up(self) -> "MixtureModel":
        if len(self.shares) != len(self.models) or min(self.shares, default=0.0) <= 0.0:
            raise ValueError("every model of a mixture needs a positive share")
        if abs(sum(self.shares) - 1.0) > 1e-6:
            raise ValueError(f"the shares of a mixture must add up to 1, not {sum(self.shares):g}")
        return self

    @property
    def finest_um(self) -> float:
        """Width of the narrowest step."""
        return min(model.finest_um for model in self.models)


Model = Annotated[LobeModel | AntiMirrorModel | MirrorModel | MixtureModel, Field(discriminator="kind")]
AnyModel = LobeModel | AntiMirrorModel | MirrorModel | MixtureModel


def model_density(
    model: AnyModel,
    frequency_x: FloatArray,
    frequency_y: FloatArray,
    coherence_um: float,
    dot_um: float,
    tau: float,
) -> FloatArray:
    """(Y, X) density in µm² that dots of a model reflect on average.

    Args:
        model: the model.
        frequency_x: (X,) frequencies ω = 2h/λ in cycles per µm.
        frequency_y: (Y,) the same along y.
        coherence_um: Δc.
        dot_um: Δd, which gives the spike its width.
        tau: |τ| of all levels, for the spike.
    """
    if isinstance(model, MixtureModel):
        found = [
            model_density(one, frequency_x, frequency_y, coherence_um, dot_um, tau) for one in model.models
        ]
        return mixture(model.shares, [part.ravel() for part in found]).reshape(found[0].shape)
    line = [blurred_sinc2(f, dot_um, coherence_um) for f in (frequency_y, frequency_x)]
    spike = np.outer(*line)
    if isinstance(model, MirrorModel):
        return spike
    if isinstance(model, LobeModel):
        y, x = (
            lobe(f, np.array(widths), np.array(drawn), coherence_um)
            for f, widths, drawn in (
                (frequency_y, model.widths_y_um, model.p_a_y),
                (frequency_x, model.widths_x_um, model.p_a_x),
            )
        )
        wide = np.outer(y, x)
    else:
        wide = model.parts(0.0).density(frequency_x, frequency_y, coherence_um)
    return np.asarray((1.0 - tau**2) * wide + tau**2 * spike)


def random_dot(
    model: LobeModel | AntiMirrorModel | MirrorModel,
    levels: int,
    points: int,
    grid_um: float,
    min_width_um: float,
    rng: np.random.Generator,
) -> Labels:
    """(points, points) number of the level of every grid point of a random dot.

    Raises:
        ModelError: steps below the smallest feature, or that are not whole grid points.
    """
    if isinstance(model, MirrorModel):
        return np.zeros((points, points), dtype=np.uint16)
    if isinstance(model, AntiMirrorModel):
        return model.parts(min_width_um).labels((points, points), grid_um, model.folded, rng)
    x, y = (_cells(widths, points, grid_um, rng) for widths in model.axes(min_width_um))
    chosen = rng.integers(0, levels, (int(y[-1]) + 1, int(x[-1]) + 1))
    return chosen[np.ix_(y, x)].astype(np.uint16)


def _cells(widths: Widths, points: int, grid_um: float, rng: np.random.Generator) -> npt.NDArray[np.int64]:
    """(points,) number of the step of every grid point; the dot begins and ends with whole steps."""
    sizes = np.rint(np.asarray(widths.widths_um) / grid_um).astype(np.int64)
    off = np.abs(sizes * grid_um - widths.widths_um)
    if (off > 1e-6 * sizes * grid_um).any():
        raise ModelError(
            f"steps of {widths.widths_um[int(off.argmax())]:g} µm are not whole grid steps of {grid_um:g} µm: take a "
            "finer --grid"
        )
    shares = np.asarray(widths.probabilities) / sum(widths.probabilities)
    edges = np.cumsum(rng.choice(sizes, points // int(sizes.min()) + 1, p=shares))
    inside = edges[edges <= points - round(widths.min_width_um / grid_um)]
    return np.searchsorted(inside, np.arange(points), side="right").astype(np.int64)
