"""Reflectance of facets in every world, fast for many materials; lobes whose Beckmann fit is the recipe's."""

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.parameters.geometry import Convention
from anisoscope.parameters.material import Material
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.profiles.ideal import ridges
from anisoscope.sim.light import corrected
from anisoscope.sim.light.geometry import directions
from anisoscope.sim.light.material import diffuse_scale, fresnel, transmittance_table
from anisoscope.sim.light.shine import Shine, lobe_shape, vector
from anisoscope.sim.pathtracer.plastic import LobeName, Plastic
from anisoscope.sim.pathtracer.tracer import PathTracer
from detection_study.product import (
    LIGHT_DEG,
    LOBE,
    PITCH_UM,
    POSES,
    RIDGE_ANGLE_DEG,
    WHOLE,
    WORLDS,
    World,
)

_NODES = (0.8, 1.0, 1.3)
POINTS_A_PITCH = 200
FIT_ROWS = 41  # of the ridges to which a lobe is fitted


@lru_cache(maxsize=16)
def _interface(alpha: float, index: float) -> tuple[FloatArray, float]:
    """Transmittance table and internal reflectance of one interface."""
    material = Material(alpha, alpha, 0.5, index)
    returned = (1.0 - 0.5 / (np.pi * index**2 * diffuse_scale(material))) / 0.5
    return transmittance_table(material), float(returned)


def quick_shine(to_light: FloatArray, to_camera: FloatArray, material: Material) -> Shine:
    """As `shine.shine_in`, with the interface interpolated between three roughnesses, on which it hardly depends.

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
        (1.0, 0.0),
        vector(to_light),
        vector(to_camera),
        vector(half),
        mirrored / (4.0 * np.pi * material.alpha_along * material.alpha_across),
        material.alpha_along,
        material.alpha_across,
        material.albedo / (1.0 - material.albedo * returned) / (np.pi * material.index**2),
        table,
        lobe_shape(material),
    )


@dataclass(frozen=True)
class Lobes:
    """Materials of one world: of the surfaces with their own roughness, and of smooth ridges that look like them."""

    textured: Material
    smooth: Material
    misfit: float = 0.0


def lobes_of(world: World) -> Lobes:
    """Nominal materials of a world.

    Widths and albedo of a foreign lobe are chosen so that the best Beckmann fit to the nine ln radiances is the
    recipe's material, as if a user had fitted the recipe's material to the real one.
    """
    lobe = WORLDS[world].lobe
    return Lobes(LOBE, WHOLE) if lobe == "beckmann" else _matched(lobe)


def plastic_of(world: World, material: Material) -> Plastic:
    """The material as the path tracer has it; the lobe is that of the world, whatever the material says of it."""
    return Plastic(
        material.alpha_along, material.alpha_across, material.albedo, material.index, WORLDS[world].lobe
    )


@lru_cache(maxsize=4)
def _matched(lobe: LobeName) -> Lobes:
    from scipy.optimize import least_squares

    sides = directions(POSES["tilted"], Convention(LIGHT_DEG))
    design = RidgeDesign(PITCH_UM, RIDGE_ANGLE_DEG)
    target = np.log(corrected.radiance(*sides, design, WHOLE))
    surface = ridges(design, (FIT_ROWS, POINTS_A_PITCH + 1), (PITCH_UM, PITCH_UM / POINTS_A_PITCH))

    def off(change: FloatArray) -> FloatArray:
        own = _changed(WHOLE, change)
        plastic = Plastic(own.alpha_along, own.alpha_across, own.albedo, own.index, lobe)
        tracer = PathTracer(surface, plastic, pitch_um=PITCH_UM, reflections=1)
        found = [float(tracer.direct(*pair).mean(dtype=np.float64)) for pair in zip(*sides, strict=True)]
        return np.asarray(np.log(found) - target)

    fit = least_squares(off, np.array([-0.2, -0.2, -0.1]), bounds=(-1.0, 1.0), diff_step=[1e-3])
    misfit = float(np.sqrt(np.mean(fit.fun**2)))
    return Lobes(_changed(LOBE, fit.x), _changed(WHOLE, fit.x), misfit)


def _changed(material: Material, change: FloatArray) -> Material:
    """A material with factors exp(change) on its two roughnesses and its albedo."""
    a, b, c = (float(factor) for factor in np.exp(change))
    return replace(
        material,
        alpha_along=material.alpha_along * a,
        alpha_across=material.alpha_across * b,
        albedo=min(material.albedo * c, 0.99),
    )
