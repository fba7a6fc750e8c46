"""Roughness that a height map does not resolve: what is left for the lobe of its facets.

The roughness of a plastic holds for all scales; a height map shows the part above its lateral bandwidth as slopes of
its facets. Slopes add in variance, and α² is twice the variance of the slopes, so that the lobe of a facet keeps
α² − α²(resolved). Otherwise the resolved part would count twice.
"""

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.parameters.material import Material
from anisoscope.sim.light.relief import Relief
from anisoscope.sim.light.shine import turn_of

SMOOTHEST = 0.001  # the smallest roughness that a material can have
_CLIP = 3.0
_CLIPPED_SPREAD = 0.98658  # standard deviation of a normal distribution cut at ±3σ, in σ
_ROUNDS = 20


@dataclass(frozen=True)
class Resolved:
    """Roughness that a map shows.

    Attributes:
        along: Beckmann α of the facets' slopes along the ridges, √2 · standard deviation.
        across: the same across them, within the most frequent facet.
        bandwidth_um: shortest wavelengths that the map can show along x and y: two pixels.
    """

    along: float
    across: float
    bandwidth_um: tuple[float, float]

    def lobe(self, plastic: Material) -> Material:
        """Lobe that a plastic, rough at all scales, leaves for the facets of the map, at least ``SMOOTHEST``."""
        left = plastic.alpha_along**2 - self.along**2, plastic.alpha_across**2 - self.across**2
        along, across = (float(np.sqrt(max(square, SMOOTHEST**2))) for square in left)
        return replace(plastic, alpha_along=along, alpha_across=across)

    def exhausts(self, plastic: Material) -> bool:
        """Is the map as rough as the plastic or rougher, so that nothing is left?"""
        lobe = self.lobe(plastic)
        return min(lobe.alpha_along, lobe.alpha_across) <= SMOOTHEST


def resolve(relief: Relief, height_noise_um: float = 0.0) -> Resolved:
    """The roughness that a map shows at its lateral bandwidth.

    It is the spread of the slopes (symmetric gradients) around the most frequent one; facets more than three standard
    deviations away (walls, burrs) do not count.

    Args:
        relief: the surface.
        height_noise_um: standard deviation of the instrument's noise, independent from point to point; its share in
            the slopes is taken off.
    """
    z, px, py = relief.surface.height_um, relief.surface.pixel_x_um, relief.surface.pixel_y_um
    step_x, step_y = np.diff(z, axis=1), np.diff(z, axis=0)
    slopes_x = 0.5 * (step_x[1:] + step_x[:-1]) / px
    slopes_y = 0.5 * (step_y[:, 1:] + step_y[:, :-1]) / py
    noise_x, noise_y = height_noise_um / px, height_noise_um / py
    if relief.direction_deg != 0.0:
        cos, sin = turn_of(relief.direction_deg)
        slopes_x, slopes_y = cos * slopes_x + sin * slopes_y, cos * slopes_y - sin * slopes_x
        noise_x, noise_y = np.hypot(cos * noise_x, sin * noise_y), np.hypot(cos * noise_y, sin * noise_x)
    inside = _main_mode(slopes_x)
    across = _alpha(slopes_x[inside], float(noise_x))
    along = _alpha(slopes_y[inside], float(noise_y))
    return Resolved(along, across, (2.0 * px, 2.0 * py))


def _main_mode(slopes: FloatArray) -> npt.NDArray[np.bool_]:
    """Facets with slopes around the most frequent one."""
    known = slopes[np.isfinite(slopes)]
    centre = float(np.median(known))
    spread = 1.4826 * float(np.median(np.abs(known - centre)))
    for _ in range(_ROUNDS):
        near = known[np.abs(known - centre) <= _CLIP * spread]
        centre, before, spread = float(near.mean()), spread, float(near.std()) / _CLIPPED_SPREAD
        if abs(spread - before) <= 1e-4 * before:
            break
    return np.asarray(np.abs(slopes - centre) <= max(_CLIP * spread, 1e-9))


def _alpha(slopes: FloatArray, noise_slope: float) -> float:
    """√2 · standard deviation, without the noise: symmetric gradients of noise σ spread by σ per pixel."""
    known = slopes[np.isfinite(slopes)]
    centre = float(np.median(known))
    spread = 1.4826 * float(np.median(np.abs(known - centre)))
    near = known[np.abs(known - centre) <= _CLIP * spread] if spread > 0.0 else known
    variance = float(np.var(near)) / (_CLIPPED_SPREAD**2 if spread > 0.0 else 1.0)
    return float(np.sqrt(2.0 * max(variance - noise_slope**2, 0.0)))
