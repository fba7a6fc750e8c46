"""Spatial against directional resolution: how far one dot of a design is from the expected reflectance.

A dot of side Δd under a source with the coherence length Δc averages n = (Δd/Δc)² windows that interfere within
themselves only. Every window is a speckle of its own, so that the relative error of a random dot is about 1/√n.
Source: Levin et al. 2013, section 3.1 and Fig. 6.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import ModelError
from anisoscope.base.json_fields import LEFT_OUT, in_json
from anisoscope.sim.design.designfile import DesignFile
from anisoscope.sim.design.models import MirrorModel, MixtureModel, model_density, random_dot
from anisoscope.sim.light.wave.correlation import angular_map
from anisoscope.sim.light.wave.surface import WaveSurface
from anisoscope.sim.light.wave.windows import Extent, Window

REACH = 0.2
SAMPLES = 8
"""Places of the comparison in the width of the source."""

MOST_PLACES = 801
MOST_DOT_POINTS = 4096
PICTURE = 161


@dataclass(frozen=True, eq=False)
class Tradeoff:
    """Random dots of one size under one source.

    Attributes:
        dot_um: Δd.
        coherence_um: Δc.
        error: ‖R_o − R_E‖/‖R_E‖ over |h_x|, |h_y| ≤ 0.2, the root of the mean square over the dots.
        scatter: standard deviation of the error from dot to dot; NaN of a single one.
        observed: (161, 161) density in µm² of the first dot over h from −0.2 to 0.2, rows along rising h_y.
    """

    dot_um: float
    coherence_um: float
    error: float
    scatter: float
    observed: FloatArray = field(metadata=LEFT_OUT)

    @property
    @in_json()
    def windows(self) -> float:
        """Windows that a dot averages, n = (Δd/Δc)²."""
        return (self.dot_um / self.coherence_um) ** 2

    @property
    @in_json()
    def source_deg(self) -> float:
        """Full angle of the source at 500 nm that has this coherence length, in degrees."""
        return float(np.degrees(0.5 / self.coherence_um))


def expected(design: DesignFile, coherence_um: float, h: FloatArray, dot_um: float) -> FloatArray:
    """(H, H) density in µm² that dots of a design reflect on average at its wavelength, rows along rising h_y."""
    f = 2.0e3 * h / design.wavelength_nm
    return model_density(design.model, f, f, coherence_um, dot_um, design.depths.tau_at(design.wavelength_nm))


def tradeoff(
    design: DesignFile,
    pairs: Sequence[tuple[float, float]],
    dots: int,
    rng: np.random.Generator,
) -> tuple[Tradeoff, ...]:
    """Errors of random dots against the expectation, for pairs of (Δd, Δc) in µm.

    Args:
        design: of one model with steps.
        pairs: sizes of the dot and coherence lengths; a dot is not smaller than the coherence length.
        dots: random dots of each pair.
        rng: of the dots.

    Raises:
        ModelError: a design without steps, a mixture, or a dot that is smaller than Δc or too large to compute.
    """
    if isinstance(design.model, MirrorModel | MixtureModel):
        raise ModelError(
            f"{design.name} is a {design.model.kind}: the trade-off takes a lobe or an anti-mirror"
        )
    if dots < 1:
        raise ModelError(f"the trade-off needs one random dot or more, not {dots}")
    return tuple(_of_pair(design, dot, coherence, dots, rng) for dot, coherence in pairs)


def _of_pair(
    design: DesignFile, dot_um: float, coherence_um: float, dots: int, rng: np.random.Generator
) -> Tradeoff:
    if isinstance(design.model, MirrorModel | MixtureModel):  # narrows the type
        raise ModelError("no steps")
    if not 0.0 < coherence_um <= dot_um:
        raise ModelError(
            f"a dot of {dot_um:g} µm under a coherence length of {coherence_um:g} µm: the dot must hold one window, "
            "and both must be positive"
        )
    points = round(dot_um / design.grid_um)
    if points > MOST_DOT_POINTS:
        raise ModelError(
            f"a dot of {dot_um:g} µm on a grid of {design.grid_um:g} µm has {points} points a side, which takes "
            f"{20 * (2 * points) ** 2 / 2**30:.1f} GB; at most {MOST_DOT_POINTS}: take a smaller dot"
        )
    wavelength_um = 1e-3 * design.wavelength_nm
    window = Window(Extent("rect", wavelength_um / coherence_um))
    step = 0.5 * wavelength_um / (SAMPLES * coherence_um)
    h = np.linspace(-REACH, REACH, 2 * min(round(REACH / step), MOST_PLACES // 2) + 1)
    grid_y, grid_x = np.meshgrid(h, h, indexing="ij")
    wanted = expected(design, coherence_um, h, dot_um)
    levels, errors, picture = np.asarray(design.depths.levels_um), [], np.zeros((0, 0))
    for number in range(dots):
        labels = random_dot(design.model, levels.size, points, design.grid_um, design.min_width_um, rng)
        surface = WaveSurface.of(levels[labels], design.grid_um, cells=True)
        found = angular_map(surface, wavelength_um, window)
        observed = found.at(grid_x, grid_y)
        errors.append(float(np.linalg.norm(observed - wanted) / np.linalg.norm(wanted)))
        if number == 0:
            line = np.linspace(-REACH, REACH, PICTURE)
            y, x = np.meshgrid(line, line, indexing="ij")
            picture = found.at(x, y)
    scatter = float(np.std(errors, ddof=1)) if dots > 1 else float("nan")
    return Tradeoff(dot_um, coherence_um, float(np.sqrt(np.mean(np.square(errors)))), scatter, picture)
