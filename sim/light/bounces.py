"""Interreflection of the corrected ridge model: light that reflects two and more times within a groove.

All crests of a ridge profile stand equally high, so light that leaves a side upward past a crest never returns, and
plateaus send nothing back: only the facet and the wall of one groove exchange light, and the chords of its foot where
that is rounded. All are planes that see each other, and ridges are long. So two reflections are a double integral over
the direction between two sides, with the length from which a ray leaves a lit point and meets a seen point in closed
form, for the full rough-plastic BRDF at both reflections (glossy and diffuse in all four combinations). It is evaluated
by Gauss-Legendre panels laid around the lobes. From three reflections on, the field within the groove, whose foot is
then taken as sharp, is followed on a grid.

Three and more reflections are a Neumann series on this grid of places and directions. The field that arrives at a
side is binned by distance from the foot (cells), by the angle χ in the xz plane and by the elevation φ. Travel from
side to side maps cells onto cells exactly (overlap of intervals, so light is conserved); reflection is one matrix
product over all directions, the same at every place.
"""

from dataclasses import dataclass, replace
from functools import cache, lru_cache
from itertools import combinations
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import ModelError
from anisoscope.base.parallel import one_blas_thread
from anisoscope.parameters.material import SHORTEST_TAIL, Material
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.sim.light.material import Rays, brdf, brdf_table, rays, rays_to
from anisoscope.sim.light.ridge_profile import sharp_groove, visible_shares

FieldArray = npt.NDArray[np.float32]

ANGLES = 24
ELEVATIONS = 64
HALF = ELEVATIONS // 2
CELLS = 12
DIRECTIONS = ANGLES * ELEVATIONS
NARROWEST = 0.05  # roughness below which the grid would miss a lobe; such lobes are widened to this
DEEPEST = 30  # reflections followed at most; the rest is closed as a geometric series
FOOT_CHORDS = 4, 24  # fewest and most of a rounded foot
CHORD_ALPHAS = 2.0  # turn of a chord, in standard deviations of the slopes
NEGLIGIBLE = 1e-3  # share of the series at which the rest may be closed


@dataclass(frozen=True, eq=False)
class DirectionGrid:
    """Directions between the sides of a groove, D = DIRECTIONS, the elevation running fastest.

    Attributes:
        sides: for each side (D, 3) unit vectors from it toward the other side, in its own frame.
        weight: (D,) solid angles in sr.
        ratio: (ANGLES,) distance from the foot on the second side over that on the first.
        scatter: for each side, field that arrives → field that leaves, [in, out], on the lower half of the elevations:
            of the part of the field that is even in the elevation, and of the odd part; both (D/2, D/2).
    """

    sides: tuple[FloatArray, FloatArray]
    weight: FloatArray
    ratio: FloatArray
    scatter: tuple[tuple[FieldArray, ...], ...]


def widened(material: Material) -> Material:
    """The material whose lobes the grid resolves: each roughness at least NARROWEST."""
    along, across = max(material.alpha_along, NARROWEST), max(material.alpha_across, NARROWEST)
    return replace(material, alpha_along=along, alpha_across=across)


@lru_cache(maxsize=3)  # about 10 MB each
def direction_grid(opening: float, material: Material) -> DirectionGrid:
    """The grid for a groove of an opening angle [rad]; both sides are of the same material."""
    node, node_weight = np.polynomial.legendre.leggauss(ANGLES)
    chi = 0.5 * (np.pi - opening) * (1.0 + node)
    chi_weight = 0.5 * (np.pi - opening) * node_weight
    x, x_weight = np.polynomial.legendre.leggauss(ELEVATIONS)
    phi = 0.5 * np.pi * (0.5 * x + 0.5 * x**3)  # denser where lobes stand
    phi_weight = 0.5 * np.pi * (0.5 + 1.5 * x**2) * x_weight * np.cos(phi)
    sides = tuple(_fan(angle, phi, sign) for angle, sign in ((chi, 1.0), (np.pi - opening - chi, -1.0)))
    weight = np.outer(chi_weight, phi_weight).ravel()
    below = sides[0].reshape(ANGLES, ELEVATIONS, 3)[:, :HALF].reshape(-1, 3)
    arriving = below[:, 2] * weight.reshape(ANGLES, ELEVATIONS)[:, :HALF].ravel()
    sent = np.multiply(
        brdf_table(below, sides[0], material), arriving[:, None], dtype=np.float32, casting="same_kind"
    )
    sent = sent.reshape(ANGLES, HALF, ANGLES, ELEVATIONS)
    # to directions in the same half of the elevations, and in the other
    same, other = sent[..., :HALF], sent[..., : HALF - 1 : -1]
    # the second side's fan is the first one's, mirrored and with its angles in reverse
    scatter = tuple(
        tuple(
            np.ascontiguousarray(one[turn, :, turn]).reshape(ANGLES * HALF, -1)
            for one in (same + other, same - other)
        )
        for turn in (slice(None), slice(None, None, -1))
    )
    ratio = np.sin(chi) / np.sin(np.pi - opening - chi)
    return DirectionGrid((sides[0], sides[1]), weight, ratio, scatter)


def _fan(angle: FloatArray, phi: FloatArray, sign: float) -> FloatArray:
    along = np.broadcast_to(sign * np.sin(phi), (angle.size, phi.size))
    up, normal = -np.outer(np.cos(angle), np.cos(phi)), np.outer(np.sin(angle), np.cos(phi))
    return np.ascontiguousarray(np.stack([along, up, normal], axis=-1).reshape(-1, 3))


def overlap(low: FloatArray, high: FloatArray, other_low: FloatArray, other_high: FloatArray) -> FloatArray:
    """Length common to intervals; the arguments broadcast."""
    return np.asarray(np.maximum(0.0, np.minimum(high, other_high) - np.maximum(low, other_low)))


class Groove:
    """Transport between the two straight sides of a groove.

    Args:
        lengths: of the first and the second side, any unit.
        opening: angle between them, radians.
        material: of both sides.
    """

    def __init__(self, lengths: tuple[float, float], opening: float, material: Material) -> None:
        self.material = widened(material)
        self.grid = direction_grid(opening, self.material)
        share = (np.arange(CELLS + 1) / CELLS) ** 1.5  # finer at the foot, where light is caught
        self.edges = lengths[0] * share, lengths[1] * share
        self.growth = self.grid.ratio, 1.0 / self.grid.ratio
        self.travel = self._travel(0), self._travel(1)

    def _travel(self, start: int) -> FieldArray:
        """(ANGLES, cells there, cells here): field that leaves side ``start`` → field that arrives opposite."""
        here, there = self.edges[start], self.edges[1 - start]
        shot = self.growth[start][:, None, None] * here
        common = overlap(there[:-1, None], there[1:, None], shot[..., :-1], shot[..., 1:])
        return np.asarray(common / np.diff(there)[:, None], dtype=np.float32)

    def arriving(self, side: int, light: FloatArray, lit: FloatArray) -> FieldArray:
        """(P, CELLS, D) radiance that arrives at ``side`` after one reflection on the other side.

        Args:
            side: 0 or 1.
            light: (P, 3) directions to the light in the frame of the *other* side.
            lit: (P, 2) lit intervals of the other side.
        """
        sent = brdf_table(light, self.grid.sides[1 - side], self.material) * light[:, 2:]
        edges, growth = self.edges[side], self.growth[1 - side]
        shot = growth[:, None, None, None] * lit  # (angles, 1, P, 2)
        common = overlap(edges[:-1, None], edges[1:, None], shot[..., 0], shot[..., 1])
        cover = common / np.diff(edges)[:, None]  # (angles, cells, P)
        field = sent.reshape(len(light), 1, ANGLES, ELEVATIONS) * cover.transpose(2, 1, 0)[..., None]
        return np.asarray(field.reshape(len(light), CELLS, -1), dtype=np.float32)

    def reflected(self, side: int, field: FieldArray) -> FieldArray:
        """(P, CELLS, D) field that arrives at ``side`` → field that leaves it."""
        rows = field.reshape(-1, ANGLES, ELEVATIONS)
        below, above = rows[..., :HALF], rows[..., : HALF - 1 : -1]
        even, odd = (
            (part.reshape(len(rows), -1) @ scatter).reshape(below.shape)
            for part, scatter in zip((below + above, below - above), self.grid.scatter[side], strict=True)
        )
        left = np.empty_like(rows)
        left[..., :HALF], left[..., : HALF - 1 : -1] = 0.5 * (even + odd), 0.5 * (even - odd)
        return left.reshape(field.shape)

    def carried(self, side: int, field: FieldArray) -> FieldArray:
        """(P, CELLS, D) field that leaves ``side`` → field that arrives at the other side."""
        poses = len(field)
        columns = field.reshape(poses, CELLS, ANGLES, ELEVATIONS).transpose(2, 1, 0, 3)
        there = self.travel[side] @ columns.reshape(ANGLES, CELLS, poses * ELEVATIONS)
        back = there.reshape(ANGLES, CELLS, poses, ELEVATIONS).transpose(2, 1, 0, 3)
        return np.asarray(back.reshape(field.shape))

    def shown(self, side: int, field: FieldArray, camera: FloatArray, seen: FloatArray) -> FloatArray:
        """Light in view of the camera on ``side`` from the other side, in length/sr.

        Args:
            side: 0 or 1.
            field: (P, CELLS, D) field that leaves the *other* side.
            camera: (P, 3) directions to the camera in the frame of ``side``.
            seen: (P, 2) seen intervals of ``side``.

        Returns:
            (P,) values.
        """
        directions = self.grid.sides[side]
        weight = brdf_table(camera, directions, self.material) * (directions[:, 2] * self.grid.weight)
        shot = self.growth[1 - side][:, None, None] * self.edges[1 - side]  # (angles, 1, edges)
        length = overlap(shot[..., :-1], shot[..., 1:], seen[:, :1], seen[:, 1:])  # (angles, P, cells)
        shape = (len(field), CELLS, ANGLES, ELEVATIONS)
        together = np.einsum("pcay,apc->pay", field.reshape(shape), length)
        return np.asarray(camera[:, 2] * np.sum(together.reshape(len(field), -1) * weight, axis=1))


def higher_reflections(
    groove: Groove,
    light: tuple[FloatArray, FloatArray],
    camera: tuple[FloatArray, FloatArray],
    lit: tuple[FloatArray, FloatArray],
    seen: tuple[FloatArray, FloatArray],
    bounces: int | None,
) -> FloatArray:
    """Light after three to ``bounces`` reflections, or all with None, in length/sr.

    Args:
        groove: the two sides.
        light: for each side (P, 3) directions to the light in its frame; normal component ≥ 0.
        camera: for each side (P, 3) directions to the camera.
        lit: for each side (P, 2) lit intervals, distances from the foot.
        seen: for each side (P, 2) seen intervals.
        bounces: largest number of reflections.

    Returns:
        (P,) values.
    """
    fields = [groove.arriving(side, light[1 - side], lit[1 - side]) for side in (0, 1)]
    total = np.zeros(len(light[0]))
    latest, previous = total, total
    for count in range(3, (DEEPEST if bounces is None else bounces) + 1):
        leaving = [groove.reflected(side, fields[side]) for side in (0, 1)]
        previous = latest
        latest = sum(
            (groove.shown(s, leaving[1 - s], camera[s], seen[s]) for s in (0, 1)), np.zeros_like(total)
        )
        total = total + latest
        if count > 3 and np.all(latest <= NEGLIGIBLE * total):
            break
        fields = [groove.carried(1 - side, leaving[1 - side]) for side in (0, 1)]
    if bounces is None:
        decay = np.clip(latest / np.where(previous > 0, previous, 1.0), 0.0, 0.95)
        total = total + latest * decay / (1.0 - decay)
    return total


_POINTS = 8192  # of the inner integral of two reflections at a time: arrays of them stay in the cache
_LEAST_COSINE = 0.02  # of the elevation of a lobe, over which its panels widen


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
    size = max(1, _POINTS // points)
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
    end, width = np.pi - opening, 2.0 * material.alpha_across * around
    own, other = lit[:, [0, 1, 0, 1]], seen[:, [0, 0, 1, 1]]
    ratio = other / np.where(own > 0.0, own, 1.0)
    kinks = np.arctan2(ratio * np.sin(opening), 1.0 - ratio * np.cos(opening))
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
    """Both ends of N ways of light, and the directions of the lobes about them.

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
        first, last = (rays_to(one, material) for one in (light, camera))
        return cls(first, last, centre, np.maximum(_LEAST_COSINE, np.cos(centre)))

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
        angles = np.stack([chi, np.pi - opening - chi])
        sine, cosine = np.sin(angles), np.cos(angles)
        breaks = [np.broadcast_to([-0.5 * np.pi, 0.5 * np.pi], (len(chi), 2))]
        for side, end in enumerate((self.light, self.camera)):
            flat = self.cosine[side, pair]
            spread = material.alpha_along * (end.normal[pair] + flat * sine[side]) / flat
            breaks.append(self.centre[side, pair, None] + spread[:, None] * around)
        start, half = _panels(np.concatenate(breaks, axis=1), -0.5 * np.pi, 0.5 * np.pi)
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


NODES = 6  # of the Gauss-Legendre rule in each panel
_STEPS, _LONG_STEPS = (1.7, 3.4), (0.8, 1.7, 3.4, 7.0, 15.0)
_COINCIDENT = 1e-9  # share of the pitch
BATCH = 64  # poses followed together, for the sake of memory


class _Sides(NamedTuple):
    """Two sides of one groove, the left one (0) and the right one (1), as P directions see them.

    Attributes:
        local: for each side (P, 3) directions in its frame: along the ridges, up the side, normal.
        visible: for each side (P, 2) visible interval in µm, distances from the line in which their planes meet.
    """

    local: tuple[FloatArray, FloatArray]
    visible: tuple[FloatArray, FloatArray]


class _Valley:
    """Sides of one groove from left to right: its facet, the chords of a rounded foot, and its wall."""

    def __init__(self, design: RidgeDesign, chords: int) -> None:
        line = design.outline(foot_chords=chords)
        step = np.stack([np.diff(line.x_um[0]), np.diff(line.z_um[0])], axis=-1)
        there = np.hypot(*step.T) > _COINCIDENT * design.pitch_um  # a wide foot leaves no wall
        self.x, self.z = (one[0, np.append(there, True)] for one in (line.x_um, line.z_um))
        self.count = int(there[: 2 + (chords if design.foot_radius_um > 0.0 else 0)].sum())
        step = step[there][: self.count]
        self.length = np.hypot(*step.T)
        self.along = step / self.length[:, None]

    def opening(self, pair: tuple[int, int]) -> float:
        """Angle between two sides, the left one first, radians."""
        return float(np.arccos(np.clip(-self.along[pair[0]] @ self.along[pair[1]], -1.0, 1.0)))

    def shares(self, directions: FloatArray) -> FloatArray:
        """(P, K) visible shares of the sides along unit vectors (P, 3) in the sample frame."""
        return visible_shares(self.x, self.z, directions[:, 0] / directions[:, 2])[:, : self.count]

    def seen(self, directions: FloatArray, shares: FloatArray, pair: tuple[int, int]) -> _Sides:
        """Two sides, the left one first, as directions (P, 3) see them."""
        left, right = pair
        # distances along both planes to the line in which they meet
        gap = np.array([self.x[right] - self.x[left + 1], self.z[right] - self.z[left + 1]])
        low = np.linalg.solve(self.along[[left, right]].T, gap) if right > left + 1 else np.zeros(2)
        from_left = directions[:, 0] >= 0.0
        local, visible = [], []
        for side, turn, start in ((left, -1.0, low[0]), (right, 1.0, low[1])):
            x_up, z_up = turn * self.along[side]
            normal = directions[:, 2] * self.along[side, 0] - directions[:, 0] * self.along[side, 1]
            across = directions[:, 0] * x_up + directions[:, 2] * z_up
            local.append(np.stack([directions[:, 1], across, np.maximum(normal, 0.0)], axis=-1))
            part = self.length[side] * np.where(normal > 0, shares[:, side], 0.0)
            begin = start + np.where(from_left == (side == left), self.length[side] - part, 0.0)
            visible.append(np.stack([begin, begin + part], axis=-1))
        return _Sides((local[0], local[1]), (visible[0], visible[1]))


def panel_steps(material: Material) -> FloatArray:
    """Ends of the panels on one side of a lobe's centre, in multiples of its width."""
    steps = np.array(_STEPS if material.tail < SHORTEST_TAIL else _LONG_STEPS)
    if material.second_lobe is not None:
        steps = np.union1d(steps, np.array(_STEPS) * material.second_lobe[1])
    return steps


@cache
def _rule(nodes: int) -> FloatArray:
    """(2, nodes) nodes and weights of a Gauss-Legendre rule."""
    return np.stack(np.polynomial.legendre.leggauss(nodes))


def _twice(light: _Sides, camera: _Sides, opening: float, material: Material, nodes: int) -> FloatArray:
    """(P,) light after exactly two reflections, in µm/sr; ``opening`` between the sides in radians."""
    first = np.concatenate(light.local), np.concatenate(camera.local[::-1])
    parts = np.concatenate(light.visible), np.concatenate(camera.visible[::-1])
    each = two_reflections(*first, *parts, opening, material, panel_steps(material), _rule(nodes))
    return np.asarray(each.reshape(2, -1).sum(axis=0))


def _more_often(
    light: _Sides,
    camera: _Sides,
    lengths: tuple[float, float],
    opening: float,
    material: Material,
    bounces: int | None,
) -> FloatArray:
    """(P,) light after three to ``bounces`` reflections, in µm/sr; lengths of the sides in µm."""
    groove = Groove(lengths, opening, material)
    total = np.zeros(len(light.local[0]))
    views = [light.local, camera.local, light.visible, camera.visible]
    with one_blas_thread():
        for start in range(0, len(total), BATCH):
            part = slice(start, start + BATCH)
            facing = [(view[0][part], view[1][part]) for view in views]
            total[part] = higher_reflections(groove, facing[0], facing[1], facing[2], facing[3], bounces)
    return total


def interreflection(
    to_light: FloatArray,
    to_camera: FloatArray,
    design: RidgeDesign,
    material: Material,
    bounces: int | None = None,
    nodes: int = NODES,
) -> FloatArray:
    """Radiance [1/sr] of light that reflects two to ``bounces`` times, per unit irradiance of the beam.

    Args:
        to_light: (P, 3) unit vectors in the sample frame, above the horizon.
        to_camera: (P, 3) unit vectors in the sample frame, above the horizon.
        design: the ridges; of rounded crests the sharp groove counts (`ridge_profile.sharp_groove`);
            light that reflects three and more times finds a sharp foot.
        material: the plastic.
        bounces: largest number of reflections; None follows all.
        nodes: Gauss-Legendre nodes per panel for two reflections.

    Returns:
        (P,) radiances.

    Raises:
        ModelError: fewer than one reflection.
    """
    if bounces is not None and bounces < 1:
        raise ModelError(f"light reflects at least once, not {bounces} times")
    design = sharp_groove(design)
    if bounces == 1 or design.height_um == 0.0 or len(to_light) == 0:
        return np.zeros(len(to_light))
    sharp = _Valley(replace(design, foot_radius_um=0.0), 1)
    rounded = design.foot_radius_um > 0.0
    valley = _Valley(design, _foot_chords(material, nodes)) if rounded else sharp
    shares = [valley.shares(one) for one in (to_light, to_camera)]
    total = np.zeros(len(to_light))
    for pair in combinations(range(valley.count), 2):
        light, camera = (
            valley.seen(one, share, pair) for one, share in zip((to_light, to_camera), shares, strict=True)
        )
        total += _twice(light, camera, valley.opening(pair), material, nodes)
    if bounces is None or bounces > 2:
        light, camera = (sharp.seen(one, sharp.shares(one), (0, 1)) for one in (to_light, to_camera))
        lengths = float(sharp.length[0]), float(sharp.length[1])
        total += _more_often(light, camera, lengths, sharp.opening((0, 1)), material, bounces)
    return np.asarray(total / (design.pitch_um * to_camera[:, 2]))


def _foot_chords(material: Material, nodes: int) -> int:
    """Chords of a foot: none of a quarter of a circle turns by more than `CHORD_ALPHAS` times α, with all nodes."""
    turn = CHORD_ALPHAS * material.narrowest_alpha * NODES / nodes
    return int(np.clip(np.ceil(0.5 * np.pi / turn), *FOOT_CHORDS))
