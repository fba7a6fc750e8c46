"""Rough plastic seen by waves: how roughness below the pixels blurs, and what a facet sends of it.

Roughness is given in the frame of a facet (`material`), the blur is one of slopes of the whole surface. Between the
slope of the facets that shine into a direction and the slope that would mirror, the two are related by a matrix that is
exact at this pair; so is the height of the lobe. On large flat facets the wave model then gives what the geometric one
gives, lobe, Fresnel and Smith's shadowing by the roughness included.
"""

from dataclasses import dataclass

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import ModelError
from anisoscope.sim.light.material import Material, fresnel, smith
from anisoscope.sim.light.wave.halfvectors import HalfVector
from anisoscope.sim.light.wave.surface import WaveSurface

MOST_FACETS = 40_000
_FAINT = 30.0


@dataclass(frozen=True, eq=False)
class Lobe:
    """What unresolved roughness does in one direction.

    Attributes:
        slope_variance: (2, 2) covariance of its slopes along x and y.
        factor: what the blurred spectrum of a perfect mirror is multiplied with.
    """

    slope_variance: FloatArray
    factor: float


def facet_slopes(surface: WaveSurface, limit_um: float, *, along_y: bool = True) -> FloatArray:
    """(F, 2) slopes along x and y of a sample of the facets; jumps of more than ``limit_um`` are none."""
    rows, cols = surface.shape
    step = max(1, int(np.sqrt(rows * cols / MOST_FACETS))) if rows > 1 else max(1, cols // MOST_FACETS)
    z = surface.height_um
    low = z[: max(rows - 1, 1) : step, :-1:step].astype(np.float64)
    rise_x = z[: max(rows - 1, 1) : step, 1::step][:, : low.shape[1]] - low
    rise_y = np.zeros_like(rise_x)
    if along_y and rows > 1:
        rise_y = z[1::step, :-1:step][: low.shape[0]] - low
    smooth = (np.abs(rise_x) <= limit_um) & (np.abs(rise_y) <= limit_um)
    if not smooth.any():
        return np.zeros((1, 2))
    found = np.stack([rise_x[smooth] / surface.pixel_x_um, rise_y[smooth] / surface.pixel_y_um], axis=-1)
    return np.asarray(found, dtype=np.float64)


def lobe_of(
    half: HalfVector, to_light: FloatArray, to_camera: FloatArray, slopes: FloatArray, material: Material
) -> Lobe:
    """The lobe about the facets (F, 2) that shine most into a direction.

    Raises:
        ModelError: the roughness is not Gaussian, so that waves do not know its spectrum.
    """
    if not material.is_beckmann:
        raise ModelError(
            "the wave model knows Gaussian roughness only: take the tail and the second lobe of the material away, "
            "or predict by rays (geometric)"
        )
    target = np.array(half.slopes)
    apart = (target - slopes) / (material.alpha_across, material.alpha_along)
    spread = np.sum((apart / (1.0 + slopes @ target)[:, None]) ** 2, axis=1)
    weight = np.exp(-np.minimum(spread - spread.min(), _FAINT))
    facet = weight @ slopes / weight.sum()
    long = np.sqrt(1.0 + facet @ facet)
    normal = np.array([-facet[0], -facet[1], 1.0]) / long
    along = np.array([0.0, 1.0, facet[1]]) / np.sqrt(1.0 + facet[1] ** 2)
    across = np.cross(along, normal)
    reach = (1.0 + facet @ target) / long
    to_facet = (
        np.stack([across[:2], along[:2]]) / reach
    )  # slopes of the surface to those in the frame of the facet
    inverse = to_facet.T @ np.diag([material.alpha_across**-2.0, material.alpha_along**-2.0]) @ to_facet
    mirrored = float(fresnel(np.sqrt(np.asarray(half.square)), material.index))  # l·ĥ = |h|
    shadow = float(smith(to_light, to_camera, along, across, normal, material))
    height = (1.0 + facet @ facet) / reach**2
    return Lobe(0.5 * np.linalg.inv(inverse), mirrored * shadow * float(height))
