"""Quadrature of light that reflects on one side of a ridge groove and then on the other, in arrays.

Every side has its own frame (along the ridges, up the side away from the foot, normal). Between the sides light
travels at an angle χ to the first side, measured in the xz plane from the direction toward the foot, and at an
elevation φ out of that plane. The lobes stand at fixed sin φ, whatever χ, so panels can be laid around them.

No compiled kernel: importing numba takes longer than predicting a design.
"""

import math
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.sim.light.material import (
    SHADOWING_ENDS,
    SHADOWING_SIZE,
    Material,
    diffuse_scale,
    shadowing_table,
    slope_density,
    transmittance,
)
from anisoscope.sim.light.shadowing import UNSHADOWED, beckmann_lambda

POINTS = 8192  # of the inner integral at a time: arrays of them stay in the cache
ROWS = 16  # of a table of BRDFs at a time
LEAST_COSINE = 0.02  # of the elevation of a lobe, over which its panels widen
_SLANTS_PER_E_FOLD = (SHADOWING_SIZE - 1) / math.log(SHADOWING_ENDS[1] / SHADOWING_ENDS[0])


class Rays(NamedTuple):
    """Directions in the frame of a side, and what a BRDF needs of each alone: transmittance and Smith's Λ."""

    along: FloatArray
    up: FloatArray
    normal: FloatArray
    through: FloatArray
    shadow: FloatArray

    def at(self, place: Any) -> "Rays":  # noqa: ANN401 - whatever an array takes
        """Those at some places."""
        return Rays(*(one[place] for one in self))


def rays(along: FloatArray, up: FloatArray, normal: FloatArray, material: Material) -> Rays:
    """Directions (along, up, normal) above a side."""
    return Rays(along, up, normal, transmittance(normal, material), _shadowing(along, up, normal, material))


def _rays_to(directions: FloatArray, material: Material) -> Rays:
    """(N, 3) directions above a side."""
    along, up, normal = np.ascontiguousarray(directions.T)
    return rays(along, up, normal, material)


def _shadowing(along: FloatArray, up: FloatArray, normal: FloatArray, material: Material) -> FloatArray:
    """Smith's Λ: for any lobe but Beckmann's from its table, where ln Λ is nearly straight over ln(α·tan θ)."""
    spread = (material.alpha_along * along) ** 2 + (material.alpha_across * up) ** 2
    if material.is_beckmann:
        found = np.zeros_like(spread)
        slanting = spread > (normal / UNSHADOWED) ** 2
        found[slanting] = beckmann_lambda(normal[slanting] / np.sqrt(spread[slanting]))
        return found
    table = shadowing_table(material.tail, material.second_lobe)
    place = np.log(np.maximum(np.sqrt(spread) / normal, 1e-9) / SHADOWING_ENDS[0]) * _SLANTS_PER_E_FOLD
    index = np.clip(place.astype(np.intp), 0, table.size - 2)
    return np.asarray(np.exp(table[index] + (place - index) * (table[index + 1] - table[index])))


def brdf(first: Rays, second: Rays, material: Material) -> FloatArray:
    """BRDF [1/sr] of rough plastic between directions above a side, as `material.facet_brdf`; they broadcast."""
    alpha_u, alpha_v, index = material.alpha_along, material.alpha_across, material.index
    h_normal = first.normal + second.normal
    per_square = 1.0 / (h_normal * h_normal)
    h_along, h_up = (first.along + second.along) ** 2, (first.up + second.up) ** 2
    slope = (h_along * alpha_u**-2 + h_up * alpha_v**-2) * per_square
    h_along += h_up
    h_along *= per_square
    h_along += 1.0  # |h|²/h_n²
    square = 0.25 * h_along / per_square  # cos² of half the angle between unit vectors
    cosine = np.minimum(np.sqrt(square), 1.0)
    inside = np.sqrt(square + (index * index - 1.0))  # Fresnel's, times the index
    perpendicular = (inside - cosine) / (inside + cosine)
    parallel = (cosine * (inside + cosine) - 1.0) / (cosine * (inside - cosine) + 1.0)
    parallel *= parallel
    parallel += 1.0
    perpendicular *= perpendicular
    value = slope_density(slope, material)
    value *= perpendicular
    value *= parallel
    h_along *= h_along
    value *= h_along
    value /= (1.0 + first.shadow + second.shadow) * (first.normal * second.normal)
    value *= 1.0 / (8.0 * math.pi * alpha_u * alpha_v)
    value += diffuse_scale(material) * first.through * second.through
    return np.asarray(value)


def brdf_table(first: FloatArray, second: FloatArray, material: Material) -> FloatArray:
    """(N, M) BRDF [1/sr] between directions (N, 3) and (M, 3) in the frame of the side; 0 at or below its plane."""

    def above(directions: FloatArray) -> tuple[Rays, FloatArray]:
        along, up, normal = np.ascontiguousarray(directions.T)
        front = normal > 0.0
        return rays(along, up, np.where(front, normal, 1.0), material), front.astype(np.float64)

    (one, lit), (other, seen) = above(first), above(second)
    result = np.empty((len(first), len(second)))
    for start in range(0, len(first), ROWS):
        rows = slice(start, start + ROWS)
        result[rows] = brdf(one.at((rows, None)), other, material)
    if not (lit.all() and seen.all()):
        result *= lit[:, None] * seen
    return result


def two_reflections(
    light: FloatArray,
    camera: FloatArray,
    lit: FloatArray,
    seen: FloatArray,
    opening: float,
    material: Material,
    steps: FloatArray,
    rule: FloatArray,
) -> FloatArray:
    """Light that reflects on a first side and then, once, on the second side of the groove.

    ∫∫ f_1 f_2 cos_i cos_o cos²φ sin χ M(χ) dφ dχ, where M is the length on the first side from which a ray at χ
    leaves a lit point and meets a seen point: sides are straight, so M is the overlap of two intervals.

    Args:
        light: (N, 3) directions to the light in the frame of the first side.
        camera: (N, 3) directions to the camera in the frame of the second side.
        lit: (N, 2) lit intervals of the first side, distances from the foot.
        seen: (N, 2) seen intervals of the second side.
        opening: angle between the sides, radians.
        material: of both sides.
        steps: ends of the panels on one side of a lobe's centre, in multiples of its width.
        rule: (2, Q) nodes and weights of a Gauss-Legendre rule, used in every panel.

    Returns:
        (N,) integrals, in the unit of length per sr; divided by pitch·ω_o,z they are radiances.
    """
    total = np.zeros(len(light))
    reached = (light[:, 2] > 0.0) & (camera[:, 2] > 0.0) & (lit[:, 1] > lit[:, 0]) & (seen[:, 1] > seen[:, 0])
    use = np.flatnonzero(reached)
    if use.size:
        around = np.concatenate([[0.0], steps, -steps])
        pair, chi, weight = _angles(
            light[use], camera[use], lit[use], seen[use], opening, material, around, rule
        )
        ends = _Ends.of(light[use], camera[use], material)
        inner = np.concatenate(
            [
                ends.elevation_integral(pair[part], chi[part], opening, material, around, rule)
                for part in _parts(len(chi), around.size * rule.shape[1])
            ]
        )
        found = np.bincount(pair, weight * inner, use.size)
        total[use] = found * light[use, 2] * camera[use, 2]
    return total


def _parts(count: int, points: int) -> list[slice]:
    """Slices of so many angles, each with about so many points of the inner integral."""
    size = max(1, POINTS // points)
    return [slice(start, start + size) for start in range(0, max(count, 1), size)]


def _panels(breaks: FloatArray, low: float, high: float) -> tuple[FloatArray, FloatArray]:
    """Starts and half lengths, (N, K − 1), of the panels between breakpoints (N, K)."""
    ordered = np.sort(np.clip(breaks, low, high), axis=1)
    return ordered[:, :-1], 0.5 * np.diff(ordered, axis=1)


def _angles(
    light: FloatArray,
    camera: FloatArray,
    lit: FloatArray,
    seen: FloatArray,
    opening: float,
    material: Material,
    around: FloatArray,
    rule: FloatArray,
) -> tuple[npt.NDArray[np.intp], FloatArray, FloatArray]:
    """Nodes of the outer integral: the pair of directions that each belongs to, χ, and its weight with sin χ·M(χ).

    Panels are laid around the mirror directions of both sides, and between the kinks of M.
    """
    end, width = math.pi - opening, 2.0 * material.alpha_across * around
    own, other = lit[:, [0, 1, 0, 1]], seen[:, [0, 0, 1, 1]]
    ratio = other / np.where(own > 0.0, own, 1.0)
    kinks = np.arctan2(ratio * math.sin(opening), 1.0 - ratio * math.cos(opening))
    breaks = [
        np.broadcast_to([0.0, end], (len(light), 2)),
        np.arctan2(light[:, 2], light[:, 1])[:, None] + width,
        end - np.arctan2(camera[:, 2], camera[:, 1])[:, None] + width,
        np.where(own > 0.0, kinks, end),
    ]
    start, half = _panels(np.concatenate(breaks, axis=1), 0.0, end)
    pair, panel = np.nonzero(half >= 1e-10)
    start, half = start[pair, panel, None], half[pair, panel, None]
    chi = start + half * (1.0 + rule[0])
    ratio = np.sin(chi) / np.sin(end - chi)
    (lit_from, lit_to), (seen_from, seen_to) = lit[pair].T[..., None], seen[pair].T[..., None]
    common = np.minimum(lit_to, seen_to / ratio) - np.maximum(lit_from, seen_from / ratio)
    meets = common > 0.0
    weight = half * rule[1] * np.sin(chi) * common
    return np.broadcast_to(pair[:, None], chi.shape)[meets], chi[meets], weight[meets]


class _Ends(NamedTuple):
    """Both ends of N ways of light, and where the lobes about them stand.

    Attributes:
        light: to the light, in the frame of the first side.
        camera: to the camera, in the frame of the second side.
        centre: (2, N) elevations of the lobes.
        cosine: (2, N) their cosines.
    """

    light: Rays
    camera: Rays
    centre: FloatArray
    cosine: FloatArray

    @classmethod
    def of(cls, light: FloatArray, camera: FloatArray, material: Material) -> "_Ends":
        centre = np.arcsin(np.stack([-light[:, 0], camera[:, 0]]))
        first, last = (_rays_to(one, material) for one in (light, camera))
        return cls(first, last, centre, np.maximum(LEAST_COSINE, np.cos(centre)))

    def elevation_integral(
        self,
        pair: npt.NDArray[np.intp],
        chi: FloatArray,
        opening: float,
        material: Material,
        around: FloatArray,
        rule: FloatArray,
    ) -> FloatArray:
        """(M,) ∫ f_1·f_2·cos²φ dφ for M angles χ at the first side, each of one pair of directions."""
        angles = np.stack([chi, math.pi - opening - chi])
        sine, cosine = np.sin(angles), np.cos(angles)
        breaks = [np.broadcast_to([-0.5 * math.pi, 0.5 * math.pi], (len(chi), 2))]
        for side, end in enumerate((self.light, self.camera)):
            flat = self.cosine[side, pair]
            spread = material.alpha_along * (end.normal[pair] + flat * sine[side]) / flat
            breaks.append(self.centre[side, pair, None] + spread[:, None] * around)
        start, half = _panels(np.concatenate(breaks, axis=1), -0.5 * math.pi, 0.5 * math.pi)
        way, panel = np.nonzero(half >= 1e-10)
        half = half[way, panel]
        phi = start[way, panel] + half * (
            1.0 + rule[0, :, None]
        )  # panels run fastest, so that loops are long
        flat, rise = np.cos(phi), np.sin(phi)
        out, back = (
            rays(along, -flat * cosine[side, way], flat * sine[side, way], material)
            for side, along in enumerate((rise, -rise))
        )
        at = pair[way]
        value = brdf(self.light.at(at), out, material)
        value *= brdf(back, self.camera.at(at), material)
        value *= flat * flat
        return np.asarray(np.bincount(way, (rule[1] @ value) * half, len(chi)), dtype=np.float64)
