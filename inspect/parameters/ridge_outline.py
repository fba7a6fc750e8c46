"""Outline of parallel ridges: the one that light, height maps, bodies and tool paths share.

One period is a facet, a foot, a wall with its draft, and a crest that is sharp, an arc tangent to both, or a plateau;
the foot is sharp or an arc. Turned by half a circle, sharp ridges are the same: the arc of a foot is that of a crest.
Arcs are exact; where straight lines must do, chords of them turn by at most `WIDEST_RAD` and leave at most `SAG_UM`
out.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray

SAG_UM = 0.01
WIDEST_RAD = math.radians(4.0)


@dataclass(frozen=True)
class CrestArc:
    """Arcs of N rounded crests or feet, before any height is lost.

    Attributes:
        x_um: (N,) of the centre, from the uncut crest.
        z_um: (N,) of the centre, from the foot of the ridge.
        radius_um: (N,) radius; 0 is sharp. Negative at a foot, whose normals point to the centre.
        first_rad: (N,) direction of the normal where the arc begins, at the wall, from +x toward +z.
        last_rad: (N,) the same where it ends, at the facet; smaller.
        possible: (N,) whether the radius leaves a facet; elsewhere the crest is sharp.
    """

    x_um: FloatArray
    z_um: FloatArray
    radius_um: FloatArray
    first_rad: FloatArray
    last_rad: FloatArray
    possible: npt.NDArray[np.bool_]

    def at(self, normal_rad: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Points x, z in µm, (N, …), whose normals have directions (N, …)."""
        x, z, radius = (
            one.reshape(-1, *(1,) * (np.ndim(normal_rad) - 1))
            for one in (self.x_um, self.z_um, self.radius_um)
        )
        return x + radius * np.cos(normal_rad), z + radius * np.sin(normal_rad)


@dataclass(frozen=True)
class Outlines:
    """One period of N ridges, from the end of the crest at the facet to the next one. Points may coincide.

    Attributes:
        x_um: (N, K + 1) corners, not falling; the last is the first one shifted by the pitch.
        z_um: (N, K + 1) their heights above the foot.
        turn_rad: (N, K, 2) directions of the normals of an arc at the ends of its chord; NaN for straight segments.
        possible: (N,) whether the radius leaves a facet.
    """

    x_um: FloatArray
    z_um: FloatArray
    turn_rad: FloatArray
    possible: npt.NDArray[np.bool_]


def facet_width_um(pitch_um: FloatArray, angle_rad: FloatArray, draft_rad: FloatArray) -> FloatArray:
    """Width along x of the facets of uncut ridges: p/(1 + tan θ·tan δ) with the draft δ of the walls."""
    return np.asarray(pitch_um / (1.0 + np.tan(angle_rad) * np.tan(draft_rad)))


def widest_arcs_um(pitch_um: FloatArray, angle_rad: FloatArray, draft_rad: FloatArray) -> FloatArray:
    """Sum of the radii of crest and foot at which their arcs meet on the shorter side of uncut ridges."""
    full = facet_width_um(pitch_um, angle_rad, draft_rad) * np.tan(angle_rad)
    shorter = full / np.maximum(np.sin(angle_rad), np.cos(draft_rad))
    return np.asarray((1.0 + 1e-9) * shorter * np.tan(0.5 * (0.5 * np.pi - angle_rad + draft_rad)))


def crest_arcs(
    pitch_um: FloatArray, angle_rad: FloatArray, draft_rad: FloatArray, radius_um: FloatArray
) -> CrestArc:
    """Arcs in place of N crests; all arguments (N,).

    A ball of the radius rolls inside the material. Where the wall is shorter than the arc would need, the arc ends at
    the foot of the wall.
    """
    sine, cosine = np.sin(angle_rad), np.cos(angle_rad)  # the facet falls along (cosine, -sine)
    facet = facet_width_um(pitch_um, angle_rad, draft_rad)
    full = facet * np.tan(angle_rad)
    foot_x, foot_z = facet - pitch_um, -full
    reach = radius_um / np.tan(0.5 * (0.5 * np.pi - angle_rad + draft_rad))
    at_foot = reach > np.hypot(foot_x, foot_z)  # the ball no longer touches the wall, only its foot
    along, deep = foot_x * cosine - foot_z * sine, -foot_x * sine - foot_z * cosine
    touching = along + np.sqrt(np.maximum(radius_um**2 - (radius_um - deep) ** 2, 0.0))
    reach = np.where(at_foot, touching, reach)
    possible = (radius_um >= 0.0) & (radius_um <= pitch_um) & (reach < facet / cosine)
    radius, reach = np.where(possible, radius_um, 0.0), np.where(possible, reach, 0.0)
    x, z = reach * cosine - radius * sine, -reach * sine - radius * cosine
    to_foot = np.arctan2(foot_z - z, foot_x - x) % (2.0 * np.pi)
    first = np.where(at_foot & possible, to_foot, np.pi - draft_rad)
    return CrestArc(x, z + full, radius, first, 0.5 * np.pi - angle_rad, possible)


def foot_arcs(
    pitch_um: FloatArray, angle_rad: FloatArray, draft_rad: FloatArray, radius_um: FloatArray
) -> CrestArc:
    """Arcs in place of N feet; all arguments (N,).

    A ball of the radius rolls above the surface. ``first_rad`` is at the wall, ``last_rad`` at the facet.
    """
    arc = crest_arcs(pitch_um, angle_rad, draft_rad, radius_um)
    facet = facet_width_um(pitch_um, angle_rad, draft_rad)
    return replace(
        arc, x_um=facet - arc.x_um, z_um=facet * np.tan(angle_rad) - arc.z_um, radius_um=-arc.radius_um
    )


def chords_for(radius_um: float, turn_rad: float, widest_rad: float = WIDEST_RAD) -> int:
    """Chords of an arc, each within `SAG_UM` and ``widest_rad``."""
    sag = 2.0 * math.acos(max(1.0 - SAG_UM / radius_um, 0.0)) if radius_um > 0.0 else math.pi
    return max(1, math.ceil(turn_rad / min(widest_rad, sag) - 1e-9))


def ridge_outlines(
    pitch_um: FloatArray,
    angle_rad: FloatArray,
    draft_rad: FloatArray,
    radius_um: FloatArray,
    height_loss: FloatArray,
    chords: int,
    foot_um: FloatArray | None = None,
    foot_chords: int = 1,
) -> Outlines:
    """Outlines of N ridges, whose crests and feet are so many chords; all else is (N,).

    An arc that a plateau cuts is in two parts, with half of the chords each. No foot is given where all are sharp.
    """
    facet = facet_width_um(pitch_um, angle_rad, draft_rad)
    full = facet * np.tan(angle_rad)
    arc, level = crest_arcs(pitch_um, angle_rad, draft_rad, radius_um), (1.0 - height_loss) * full
    with np.errstate(divide="ignore", invalid="ignore"):
        rise = np.where(
            arc.radius_um > 0.0, (level - arc.z_um) / arc.radius_um, np.where(height_loss > 0.0, -1.0, 1.0)
        )
    cut = np.arcsin(np.clip(rise, -1.0, 1.0))  # normal where the plateau ends the arc
    on_wall, on_facet = np.pi - cut < arc.first_rad, cut > arc.last_rad
    left = (chords + 1) // 2
    share = np.linspace(0.0, 1.0, chords + 1)
    whole = arc.first_rad[:, None] + (arc.last_rad - arc.first_rad)[:, None] * share
    before = np.where(on_wall, np.pi - cut, arc.first_rad)
    after = np.where(on_facet, cut, arc.last_rad)
    up = arc.first_rad[:, None] + (before - arc.first_rad)[:, None] * np.linspace(0.0, 1.0, left + 1)
    down = after[:, None] + (arc.last_rad - after)[:, None] * np.linspace(0.0, 1.0, chords - left + 1)
    uncut = (rise >= 1.0)[:, None]
    up, down = np.where(uncut, whole[:, : left + 1], up), np.where(uncut, whole[:, left:], down)
    (up_x, up_z), (down_x, down_z) = arc.at(up), arc.at(down)
    wall, fall = (-height_loss * (pitch_um - facet))[:, None], (height_loss * facet)[:, None]
    flat, possible = level[:, None], arc.possible
    low_x, low_z, bend = facet[:, None], np.zeros_like(flat), np.empty((len(facet), 0, 2))
    if foot_um is not None:
        foot = foot_arcs(pitch_um, angle_rad, draft_rad, foot_um)
        # a plateau may cut the foot as well
        with np.errstate(divide="ignore", invalid="ignore"):
            deep = np.where(foot.radius_um < 0.0, (level - foot.z_um) / foot.radius_um, -1.0)
        under = np.arcsin(np.clip(deep, -1.0, 1.0))
        begin, end = np.maximum(foot.last_rad, under), np.minimum(foot.first_rad, np.pi - under)
        turns = begin[:, None] + (end - begin)[:, None] * np.linspace(0.0, 1.0, foot_chords + 1)
        low_x, low_z = foot.at(turns)
        bend = np.stack([turns[:, :-1], turns[:, 1:]], axis=-1)
        bend = np.where((foot.radius_um < 0.0)[:, None, None], bend, np.nan)
        fall = np.where(begin[:, None] > foot.last_rad[:, None], low_x[:, :1], fall)
        wall = np.where(end[:, None] < foot.first_rad[:, None], low_x[:, -1:] - pitch_um[:, None], wall)
        together = (radius_um <= 0.0) | (foot_um <= 0.0)
        together |= radius_um + foot_um <= widest_arcs_um(pitch_um, angle_rad, draft_rad)
        possible = possible & foot.possible & together
    up_x, up_z = np.where(on_wall[:, None], up_x, wall), np.where(on_wall[:, None], up_z, flat)
    down_x, down_z = np.where(on_facet[:, None], down_x, fall), np.where(on_facet[:, None], down_z, flat)
    x = np.hstack([down_x[:, -1:], low_x, up_x + pitch_um[:, None], down_x + pitch_um[:, None]])
    z = np.hstack([down_z[:, -1:], low_z, up_z, down_z])
    turn = np.full((len(x), x.shape[1] - 1, 2), np.nan)
    turn[:, 1 : 1 + bend.shape[1]] = bend
    start = 1 + low_x.shape[1]
    for begins, angles, on in ((start, up, on_wall), (start + left + 1, down, on_facet)):
        pairs = np.stack([angles[:, :-1], angles[:, 1:]], axis=-1)
        turn[:, begins : begins + pairs.shape[1]] = np.where(
            (on & (arc.radius_um > 0.0))[:, None, None], pairs, np.nan
        )
    return Outlines(np.maximum.accumulate(x, axis=1), z, turn, possible)
