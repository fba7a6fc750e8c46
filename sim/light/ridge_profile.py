"""Profile of ideal ridges, and the visible share of each of its segments.

One period of the profile is a polyline. In the sheared coordinate s = x − t·z, with t = ω_x/ω_z, a point is
reached by light from direction ω exactly if no point further toward the light has a smaller s (t > 0), so a
running extremum of s gives the visible part of every segment without approximation. For ridges with
perpendicular walls this reduces to the one-sided G1 = 1/((1 + t·tan θr)·cos² θr) where t > tan θr.

A rounded crest is an arc. Its chords would be little facets of their own, and one of them may stand in the mirror
direction; so chords only say which part of the arc is visible, while its light is integrated over its normals.
"""

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from anisoscope.base.arrays import FloatArray
from anisoscope.parameters.ridges import RidgeDesign

MOST_SHORTENED = 0.9  # share of a groove that a rounded crest may take
ROUNDED = 0.8
"""Of the length that a rounded crest takes from the wall, the share by which it shortens the groove.

The arc still throws light into it. On path-traced ridges of 10 and 15° with radii of 5 and 10 µm it is 0.75 to 0.89 at
90 and 180° for smooth, dark plastic, whose reflections are strong, and 0.54 to 0.63 for rough, bright plastic.
"""
CHORDS = 24  # of an arc, where nothing else is said
_NODES = 6  # Gauss-Legendre, on every chord's part of an arc


@dataclass(frozen=True, eq=False)
class Outline:
    """One period of a profile, facet, wall and crest, from which light comes.

    Attributes:
        x_um: (K + 1,) corners, not falling; the last is the first one shifted by the pitch.
        z_um: (K + 1,) their heights.
        segment: (N,) segment whose visible share counts for each of N normals.
        normal: (N, 2) normals (x, z).
        length_um: (N,) length of the profile with this normal.
    """

    x_um: FloatArray
    z_um: FloatArray
    segment: NDArray[np.intp]
    normal: FloatArray
    length_um: FloatArray


def outline_of(x_um: FloatArray, z_um: FloatArray) -> Outline:
    """The outline of a polyline (K + 1,), one period long, whose segments are facets."""
    run, rise = np.diff(x_um), np.diff(z_um)
    length = np.hypot(run, rise)
    solid = length > 0.0
    normal = np.stack([-rise[solid], run[solid]], axis=-1) / length[solid, None]
    return Outline(x_um, z_um, np.flatnonzero(solid), normal, length[solid])


def ridge_outline(design: RidgeDesign, widest_rad: float = 0.1) -> Outline:
    """The outline of ridges; a rounded crest is cut into chords that turn by at most ``widest_rad``."""
    if design.edge_radius_um == 0.0 or design.full_height_um == 0.0:
        return outline_of(*ridge_polyline(design))
    x, z, turns = _rounded(design, widest_rad)
    flat = outline_of(x, z)
    straight = np.isnan(turns[:, 0])[flat.segment]
    node, weight = np.polynomial.legendre.leggauss(_NODES)
    arcs = np.flatnonzero(~np.isnan(turns[:, 0]))
    first, last = turns[arcs, 0], turns[arcs, 1]
    angle = (first + 0.5 * (last - first) * (1.0 + node[:, None])).ravel()
    length = (0.5 * design.edge_radius_um * (first - last) * weight[:, None]).ravel()
    return Outline(
        x,
        z,
        np.concatenate([flat.segment[straight], np.tile(arcs, _NODES)]),
        np.concatenate([flat.normal[straight], np.stack([np.cos(angle), np.sin(angle)], axis=-1)]),
        np.concatenate([flat.length_um[straight], length]),
    )


def _rounded(design: RidgeDesign, widest_rad: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """x, z of a profile with a rounded crest, and (K, 2) normals' directions at the ends of the chords of its arcs.

    From the end of the arc down the facet, up the wall, and over the crest; directions are NaN for straight segments.
    """
    arc, pitch, level, share = design.crest_arc(), design.pitch_um, design.height_um, design.height_loss
    rise = (level - arc.z_um) / arc.radius_um
    cut = (
        float(np.arcsin(max(rise, -1.0))) if rise < 1.0 else 0.5 * np.pi
    )  # normal where a plateau ends the arc
    on_wall, on_facet = (
        np.pi - cut < arc.first_rad,
        cut > arc.last_rad,
    )  # else the plateau cuts the wall or the facet
    start = arc.at(arc.last_rad) if on_facet else (share * design.facet_width_um, level)
    points, turns = [start], list[tuple[float, float]]()

    def go(x: float, z: float) -> None:
        if np.hypot(x - points[-1][0], z - points[-1][1]) > 1e-12 * pitch:
            points.append((x, z))
            turns.append((np.nan, np.nan))

    def bend(first: float, last: float) -> None:
        ends = np.linspace(first, last, int(np.ceil((first - last) / widest_rad)) + 1)
        for begin, end in pairwise(ends.tolist()):
            x, z = arc.at(end)
            points.append((x + pitch, z))
            turns.append((begin, end))

    go(design.facet_width_um, 0.0)
    wall_end = arc.at(arc.first_rad) if on_wall else (-share * design.wall_width_um, level)
    go(wall_end[0] + pitch, wall_end[1])
    if on_wall:
        bend(arc.first_rad, np.pi - cut)
    if on_facet:
        x, z = arc.at(cut)
        go(x + pitch, z)
        bend(cut, arc.last_rad)
    else:
        go(start[0] + pitch, start[1])
    corners = np.array(points)
    return np.maximum.accumulate(corners[:, 0]), corners[:, 1], np.array(turns)


def sharp_groove(design: RidgeDesign) -> RidgeDesign:
    """The groove between sharp crests in which light of a rounded one goes to and fro.

    Facet and wall are shortened by `ROUNDED` of what the rounding takes from the wall, or by the lost height where that
    is more.
    """
    if design.edge_radius_um == 0.0 or design.full_height_um == 0.0:
        return replace(design, edge_radius_um=0.0)
    shortened = min(MOST_SHORTENED, ROUNDED * design.edge_reach_um / design.wall_length_um)
    return replace(design, edge_radius_um=0.0, height_loss=max(design.height_loss, shortened))


def ridge_polyline(design: RidgeDesign) -> tuple[FloatArray, FloatArray]:
    """One period of the ridge profile, crest to crest; a rounded crest as CHORDS chords at most.

    Returns:
        x, z in µm, both (K + 1,): the last point is the first one shifted by the pitch. Facets fall toward +x.
    """
    if design.edge_radius_um > 0.0 and design.full_height_um > 0.0:
        x, z, _ = _rounded(design, np.pi / CHORDS)
        return x, z
    pitch, foot = design.pitch_um, design.facet_width_um
    height = design.full_height_um
    if height == 0.0:
        return np.array([0.0, pitch]), np.zeros(2)
    crest = (1.0 - design.height_loss) * height
    cut_facet = design.height_loss * foot
    cut_wall = design.height_loss * (pitch - foot)
    x = np.array([cut_facet, foot, pitch - cut_wall, pitch + cut_facet])
    z = np.array([crest, 0.0, crest, crest])
    keep = np.append(True, (np.diff(x) > 0) | (np.diff(z) != 0))  # no plateau where nothing was cut
    return x[keep], z[keep]


def chord_polyline(design: RidgeDesign, chords: int) -> tuple[FloatArray, FloatArray]:
    """One period of a whole ridge whose rounded crest is not an arc but so many equal chords of it.

    Returns:
        x, z in µm, as of `ridge_polyline`.
    """
    arc, pitch = design.crest_arc(), design.pitch_um
    crest = np.array([arc.at(turn) for turn in np.linspace(arc.first_rad, arc.last_rad, chords + 1)])
    x = np.concatenate([[crest[-1, 0], design.facet_width_um], crest[:, 0] + pitch])
    return np.maximum.accumulate(x), np.concatenate([[crest[-1, 1], 0.0], crest[:, 1]])


def visible_shares(x_um: FloatArray, z_um: FloatArray, tangent: FloatArray | float) -> FloatArray:
    """Visible share of every segment of a periodic polyline, seen along one or several directions.

    Args:
        x_um: (K + 1,) positions, not falling; the last point is one period after the first.
        z_um: (K + 1,) heights.
        tangent: t = ω_x/ω_z of one direction, or (P,) of several.

    Returns:
        (K,) or (P, K) shares 0 to 1. For t ≥ 0 the visible part is the low-x end of a segment, for t < 0 the high-x
        end.
    """
    tangents = np.atleast_1d(np.asarray(tangent, dtype=np.float64))
    from_left = tangents < 0.0
    shares = np.empty((tangents.size, x_um.size - 1))
    shares[~from_left] = _shares_from_right(x_um, z_um, tangents[~from_left])
    shares[from_left] = _shares_from_right(-x_um[::-1], z_um[::-1], -tangents[from_left])[:, ::-1]
    return shares if np.ndim(tangent) else shares[0]


def _shares_from_right(x_um: FloatArray, z_um: FloatArray, tangents: FloatArray) -> FloatArray:
    """(P, K) shares from directions with tangents (P,) ≥ 0."""
    period = x_um[-1] - x_um[0]
    reach = 2 + int(np.ceil(np.max(tangents, initial=0.0) * np.ptp(z_um) / period))
    sheared = x_um - tangents[:, None] * z_um
    start, end = sheared[:, :-1], sheared[:, 1:]
    ahead = np.concatenate([end + period * n for n in range(reach + 1)], axis=1)
    limit = np.minimum.accumulate(ahead[:, ::-1], axis=1)[:, ::-1][:, : start.shape[1]]
    length = end - start
    facing = length > 1e-12 * period
    return np.where(facing, np.clip((limit - start) / np.where(facing, length, 1.0), 0.0, 1.0), 0.0)
