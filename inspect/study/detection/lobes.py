"""Reflectance of facets in the two worlds, fast for many materials; GGX lobe whose Beckmann fit is the recipe's."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.profiles.ideal import RidgeDesign, ridges
from anisoscope.sim.light import corrected
from anisoscope.sim.light.geometry import Convention, directions
from anisoscope.sim.light.material import Material, diffuse_scale, fresnel, transmittance_table
from anisoscope.sim.light.relief import Relief
from anisoscope.sim.light.shine import Shine, vector
from anisoscope.study.detection.product import (
    LIGHT_DEG,
    LOBE,
    PITCH_UM,
    RIDGE_ANGLE_DEG,
    WHOLE,
    Size,
    World,
    expected_of,
)

_NODES = (0.8, 1.0, 1.3)
POINTS_A_PITCH = 200


@lru_cache(maxsize=16)
def _interface(alpha: float, index: float) -> tuple[FloatArray, float]:
    """Transmittance table and internal reflectance of one interface."""
    material = Material(alpha, alpha, 0.5, index)
    returned = (1.0 - 0.5 / (np.pi * index**2 * diffuse_scale(material))) / 0.5
    return transmittance_table(material), float(returned)


def quick_shine(to_light: FloatArray, to_camera: FloatArray, material: Material) -> Shine:
    """As `shine.shine_in`, the interface interpolated between three roughnesses: it hardly depends on them.

    The interface is that of index 1.5; its change with the index, of a few thousandths, is in the lobe alone.
    """
    nodes = [node * LOBE.alpha_mean for node in _NODES]
    alpha = float(np.clip(material.alpha_mean, nodes[0], nodes[-1]))
    upper = 1 if alpha < nodes[1] else 2
    share = (alpha - nodes[upper - 1]) / (nodes[upper] - nodes[upper - 1])
    low, high = (_interface(nodes[n], LOBE.index) for n in (upper - 1, upper))
    table = (1.0 - share) * low[0] + share * high[0]
    returned = (1.0 - share) * low[1] + share * high[1]
    half = (to_light + to_camera) / np.linalg.norm(to_light + to_camera)
    mirrored = float(fresnel(np.asarray(to_light @ half), material.index))
    return Shine(
        vector(to_light),
        vector(to_camera),
        vector(half),
        mirrored / (4.0 * np.pi * material.alpha_along * material.alpha_across),
        material.alpha_along,
        material.alpha_across,
        material.albedo / (1.0 - material.albedo * returned) / (np.pi * material.index**2),
        table,
    )


@dataclass(frozen=True)
class Lobes:
    """Materials of one world: of the surfaces with their own roughness, and of smooth ridges that look like them."""

    textured: Material
    smooth: Material
    misfit: float = 0.0


def lobes_of(world: World) -> Lobes:
    """Nominal materials of a world.

    Facets of the other world have GGX lobes. Their widths and the albedo are such that the Beckmann lobe that fits
    their nine ln radiances best is the recipe's: the result of a user who fits the recipe's material to the real one.
    """
    return Lobes(LOBE, WHOLE) if world == "same" else _matched()


@lru_cache(maxsize=1)
def _matched() -> Lobes:
    from scipy.optimize import least_squares  # noqa: PLC0415 - 0.3 s

    from anisoscope.sim.light.ggx import lobe_maps  # noqa: PLC0415 - numba when first needed

    poses = expected_of("tilted", Size()).poses
    sides = directions(poses, Convention(LIGHT_DEG))
    design = RidgeDesign(PITCH_UM, RIDGE_ANGLE_DEG)
    target = np.log(corrected.radiance(*sides, design, WHOLE))
    surface = ridges(design, (2, 3 * POINTS_A_PITCH + 1), (PITCH_UM, PITCH_UM / POINTS_A_PITCH))
    relief = Relief(surface, PITCH_UM)

    def material(change: FloatArray) -> Material:
        a, b, c = (float(factor) for factor in np.exp(change))
        return Material(
            WHOLE.alpha_along * a, WHOLE.alpha_across * b, min(WHOLE.albedo * c, 0.99), WHOLE.index
        )

    def off(change: FloatArray) -> FloatArray:
        shines = [quick_shine(light, camera, material(change)) for light, camera in zip(*sides, strict=True)]
        found = [float(radiance.mean(dtype=np.float64)) for radiance in lobe_maps(relief, shines, "ggx")]
        return np.asarray(np.log(found) - target)

    fit = least_squares(off, np.array([-0.2, -0.2, -0.1]), bounds=(-1.0, 1.0), diff_step=[1e-3])
    a, b, c = (float(factor) for factor in np.exp(fit.x))
    smooth = material(fit.x)
    textured = Material(LOBE.alpha_along * a, LOBE.alpha_across * b, min(LOBE.albedo * c, 0.99), LOBE.index)
    return Lobes(textured, smooth, float(np.sqrt(np.mean(fit.fun**2))))
