"""Lean and roughness of the facets of a part as a whole, and the poses that measure them best.

The radiance of a plane facet with the lobe of the recipe is the model; what reaches the camera by more than one
reflection is added as its mean, with an uncertainty that leaves the verdict to the poses near the mirror direction.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from anisoscope.base.arrays import FloatArray
from anisoscope.parameters.geometry import Convention, Pose
from anisoscope.parameters.material import Material
from anisoscope.prediction.expectation import Component, Expectation
from anisoscope.prediction.part_scatter import with_design
from anisoscope.prediction.propagation import RIDGE_ANGLE
from anisoscope.prediction.recipe_models import rig_of
from anisoscope.recipe.surface import SurfaceRecipe
from anisoscope.sim.light.geometry import directions
from anisoscope.sim.light.material import HeldInterface, brdf, rays
from anisoscope.sim.light.optics import bundle

MODEL_ERROR = 0.02
"""Relative standard uncertainty of the radiance of a facet in one pose, from the model."""
AGAIN_SHARE = 0.05
"""Relative standard uncertainty of the light of the base, for light that reaches a facet by way of others."""
U_ALPHA_SHARE = 0.15  # of the part's roughness before its photographs are seen
U_LEAN_DEG = 3.0  # of the part's lean before, and of a cell's about that of the part
U_ALONG_DEG = 0.3  # of the lean along the ridges before
MOST_LOG_ALPHA = 1.0  # by which the roughness of a part may differ from that of the recipe
STARTS, SAME_STATE = 4, 0.05
_NOT_ADDED = (RIDGE_ANGLE, "roughness along the ridges", "roughness across the ridges")


class FacetScene:
    """Radiance of facets of any lean in the poses of a recipe with a design."""

    def __init__(
        self,
        recipe: SurfaceRecipe,
        poses: tuple[Pose, ...],
        convention: Convention,
        components: Sequence[Component] = (),
    ) -> None:
        self.recipe, self.components = recipe, components
        self.design = recipe.surface.ridge_design()
        self.material = recipe.material.material()
        self.to_light, self.to_camera = directions(poses, convention)
        optics = rig_of(recipe, poses, convention).optics
        self.beams = bundle(self.to_light, self.to_camera, optics)

    @property
    def wall(self) -> float:
        """Width of the wall as a share of the pitch."""
        return self.design.wall_width_um / self.design.pitch_um

    def rougher(self, share: float, albedo: float | None = None, interface: float = 1.0) -> Material:
        """The material with both roughnesses times ``share``, and its interface of ``interface`` times them."""
        known = self.material
        changed = {
            "alpha_along": known.alpha_along * share,
            "alpha_across": known.alpha_across * share,
            "albedo": known.albedo if albedo is None else albedo,
        }
        return HeldInterface(**vars(known) | changed, interface_alpha=known.alpha_mean * interface)

    def log_radiance(self, across_deg: FloatArray, along_deg: FloatArray, material: Material) -> FloatArray:
        """(P, N) ln L of facets that lean so far, (N,) each."""
        gx, gy = -np.tan(np.radians(across_deg)), np.tan(np.radians(along_deg))
        none, steep = np.zeros_like(gx), 1.0 + gy**2
        size = np.sqrt(steep + gx**2)
        frame = (
            np.stack([none, none + 1.0, gy]) / np.sqrt(steep),
            np.stack([steep, -gx * gy, gx]) / (np.sqrt(steep) * size),
            np.stack([-gx, -gy, none + 1.0]) / size,
        )
        found = np.empty((len(self.to_light), len(gx)))
        for pose, ways in enumerate(zip(self.beams.to_light, self.beams.to_camera, strict=True)):
            both = [[way @ axis for axis in frame] for way in ways]
            reached = np.all([way[2] > 0.0 for way in both], axis=0)
            light, camera = (rays(u, v, np.where(reached, w, 1.0), material) for u, v, w in both)
            values = brdf(light, camera, material) * light.normal * camera.normal * reached
            found[pose] = np.log(np.maximum((self.beams.weight / ways[1][:, 2]) @ values * size, 1e-12))
        return found

    def doubt(self) -> FloatArray:
        """(P,) standard uncertainty of ln L of a facet of the part from its base."""
        lean, none = np.array([self.design.ridge_angle_deg]), np.zeros(1)
        u = float(np.hypot(self.recipe.material.u_albedo, AGAIN_SHARE * self.material.albedo))
        brighter = self.rougher(1.0, min(1.0, self.material.albedo + u))
        found = self.log_radiance(lean, none, brighter) - self.log_radiance(lean, none, self.material)
        return np.asarray(found[:, 0])


@dataclass(frozen=True, eq=False)
class PartLean:
    """Lean and roughness of the part as a whole; ``left`` (P,) of ln L is what they do not explain."""

    lean: tuple[float, float]
    alpha: float
    u_lean_deg: float
    u_alpha: float
    sees_along: bool
    left: FloatArray


def part_lean(scene: FacetScene, medians: FloatArray) -> PartLean:
    """One lean and one roughness for the medians (P,) of ln L of the cells."""
    from scipy.optimize import least_squares  # noqa: PLC0415 - start-up time

    doubt = np.hypot(MODEL_ERROR, scene.doubt())
    nominal = scene.design.ridge_angle_deg

    def off(state: FloatArray, interface: float) -> FloatArray:
        across, along, rougher = state
        material = scene.rougher(
            float(np.exp(np.clip(rougher, -MOST_LOG_ALPHA, MOST_LOG_ALPHA))), interface=interface
        )
        seen = scene.log_radiance(np.array([across]), np.array([along]), material)[:, 0]
        # a part of another roughness altogether is no more than unlikely
        before = (across - nominal) / U_LEAN_DEG, along / U_ALONG_DEG, np.arcsinh(rougher / U_ALPHA_SHARE)
        return np.concatenate([(seen - medians) / doubt, before])

    def fitted(start: FloatArray, interface: float) -> Any:  # noqa: ANN401 - a class of scipy without a public name
        return least_squares(off, start, ftol=1e-14, xtol=1e-12, gtol=1e-14, args=(interface,))

    ways = [fitted(start, 1.0) for start in _starts(scene, medians, doubt)]
    best = min(ways, key=lambda one: float(one.cost))
    spread = _spread(best, ways)
    # the interface, on which the light hardly depends and which costs most, is that of the roughness found
    best = fitted(best.x, float(np.exp(best.x[2])))
    jacobian = np.asarray(best.jac)
    inner = np.linalg.inv(jacobian.T @ jacobian)
    poses = len(medians)
    # how ln L of the poses moves the three: what all cells share is carried over
    carried = inner @ jacobian[:poses].T / doubt
    variance = inner[0, 0] + spread[0]
    for one in scene.components:
        if one.source.endswith(_NOT_ADDED):
            continue
        moved = carried[0] * one.relative
        variance += float(np.sum(moved)) ** 2 if one.shared else float(np.sum(moved**2))
    variance += (scene.recipe.uncertainty.scale_share * float(np.sum(carried[0]))) ** 2
    own = np.linalg.inv(jacobian[:poses].T @ jacobian[:poses] + np.diag([1e-12, 1e-12, U_ALPHA_SHARE**-2]))
    return PartLean(
        (float(best.x[0]), float(best.x[1])),
        float(np.exp(best.x[2])),
        float(np.sqrt(variance)),
        float(np.exp(best.x[2]) * np.sqrt(inner[2, 2] + spread[2])),
        bool(np.sqrt(own[1, 1]) < U_ALONG_DEG),
        -best.fun[:poses] * doubt,
    )


def _starts(scene: FacetScene, medians: FloatArray, doubt: FloatArray) -> list[FloatArray]:
    """States (across, along, ln roughness) from which the fit to the medians begins: the best ones of a grid."""
    across = scene.design.ridge_angle_deg + np.arange(-6.0, 6.1, 0.5)
    along, rougher = np.linspace(-2.0, 2.0, 5) * U_ALONG_DEG, np.arange(-0.8, 0.81, 0.1)
    leans = [one.ravel() for one in np.meshgrid(across, along, indexing="ij")]
    seen = np.stack(
        [scene.log_radiance(leans[0], leans[1], scene.rougher(float(np.exp(one)))) for one in rougher]
    )
    square = np.sum(((seen - medians[:, None]) / doubt[:, None]) ** 2, axis=1)
    square += ((leans[0] - scene.design.ridge_angle_deg) / U_LEAN_DEG) ** 2 + (leans[1] / U_ALONG_DEG) ** 2
    square += np.arcsinh(rougher / U_ALPHA_SHARE)[:, None] ** 2
    field = square.reshape(len(rougher), len(across), len(along)).min(axis=2)
    around = sliding_window_view(np.pad(field, 1, constant_values=np.inf), (3, 3)).min(axis=(2, 3))
    lowest = sorted(np.argwhere(field <= around), key=lambda at: float(field[tuple(at)]))
    best = square.reshape(*field.shape, len(along)).argmin(axis=2)
    return [np.array([across[j], along[best[i, j]], rougher[i]]) for i, j in lowest[:STARTS]]


def _spread(best: Any, ways: Sequence[Any]) -> FloatArray:  # noqa: ANN401 - a class of scipy without a public name
    """(3,) variance about the best state by others that explain the medians: each counts by its probability."""
    weights, off = np.zeros(len(ways)), np.zeros((len(ways), len(best.x)))
    for k, one in enumerate(ways):
        off[k] = one.x - best.x
        known = np.abs(off[:k] - off[k]).max(axis=1) < SAME_STATE
        if not known.any():
            weights[k] = np.exp(best.cost - one.cost) / np.sqrt(np.linalg.det(one.jac.T @ one.jac))
    return np.asarray(weights @ off**2 / weights.sum())


def planned_worth(recipe: SurfaceRecipe, expected: Expectation) -> str:
    """Uncertainties of the angle map of a good part by these poses, in one line.

    Args:
        recipe: of the part.
        expected: the prediction.

    Raises:
        HeightMapError: the recipe's height map has no ridges.
    """
    ideal = with_design(recipe.deciding())
    scene = FacetScene(ideal, expected.poses, expected.convention, expected.components)
    lean = scene.design.ridge_angle_deg
    part = part_lean(scene, scene.log_radiance(np.array([lean]), np.zeros(1), scene.material)[:, 0])
    along = "the lean along the ridges too"
    if not part.sees_along:
        along = f"not the lean along the ridges, which a pose at 90° with a tilt of −{lean:.2g}° would tell"
    return (
        f"angle map: tells the mean lean of the facets across the ridges to ± {2.0 * part.u_lean_deg:.2g}° (k = 2), "
        f"their roughness to ± {200.0 * part.u_alpha:.2g} %, {along}"
    )


def poses_for_angles(
    recipe: SurfaceRecipe, poses: tuple[Pose, ...], convention: Convention, count: int
) -> list[int]:
    """Poses by which the lean of a facet is known best across and along the ridges, though its roughness is not.

    One pose after the other, each for the smallest sum of both variances. A pose is worth most where ln L is steep and
    blind to roughness, which is about where facet and half vector are atan α apart.

    Args:
        recipe: of ridges.
        poses: allowed ones.
        convention: of the angles.
        count: how many.

    Returns:
        Their numbers, the most valuable first.

    Raises:
        HeightMapError: the recipe's height map has no ridges.
    """
    scene = FacetScene(recipe, poses, convention)
    lean, h, none = scene.design.ridge_angle_deg, 0.1, np.zeros(2)
    around = np.array([lean + h, lean - h])
    across, along, rough = (
        np.diff(seen[:, ::-1], axis=1)[:, 0] / step
        for seen, step in (
            (scene.log_radiance(around, none, scene.material), 2.0 * h),
            (scene.log_radiance(np.full(2, lean), around - lean, scene.material), 2.0 * h),
            (
                np.hstack(
                    [
                        scene.log_radiance(np.array([lean]), none[:1], scene.rougher(1.0 + sign * h))
                        for sign in (1.0, -1.0)
                    ]
                ),
                float(np.log((1.0 + h) / (1.0 - h))),
            ),
        )
    )
    slopes = np.stack([across, along, rough], axis=1) / np.hypot(MODEL_ERROR, scene.doubt())[:, None]
    information = np.diag([U_LEAN_DEG**-2.0, U_LEAN_DEG**-2.0, U_ALPHA_SHARE**-2.0])
    chosen: list[int] = []
    for _ in range(count):
        each = np.linalg.inv(information + slopes[:, :, None] * slopes[:, None, :])
        worth = each[:, 0, 0] + each[:, 1, 1]
        worth[chosen] = np.inf
        chosen.append(int(np.argmin(worth)))
        information = information + np.outer(slopes[chosen[-1]], slopes[chosen[-1]])
    return chosen
