"""Profile of ideal ridges, and the visible share of each of its segments.

One period of the profile is a polyline. In the sheared coordinate s = x − t·z, with t = ω_x/ω_z, a point is
reached by light from direction ω exactly if no point further toward the light has a smaller s (t > 0), so a
running extremum of s gives the visible part of every segment without approximation. For ridges with
perpendicular walls this reduces to the one-sided G1 = 1/((1 + t·tan θr)·cos² θr) where t > tan θr.

A rounded crest or foot is an arc. Its chords would be little facets of their own, and one of them may stand in the
mirror direction; so chords only say which part of the arc is visible, while its light is integrated over its normals.
"""

from dataclasses import dataclass, replace

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
_NODES = 3  # Gauss-Legendre, on every chord's part of an arc
_RULE = np.polynomial.legendre.leggauss(_NODES)


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


def ridge_outline(design: RidgeDesign, widest_rad: float | None = None) -> Outline:
    """The outline of ridges; rounded crests and feet are cut into chords that turn by at most ``widest_rad``."""
    line = design.outline(widest_rad)
    flat = outline_of(line.x_um[0], line.z_um[0])
    turn = line.turn_rad[0]
    straight = np.isnan(turn[:, 0])[flat.segment]
    node, weight = _RULE
    arcs = np.flatnonzero(~np.isnan(turn[:, 0]))
    first, last = turn[arcs, 0], turn[arcs, 1]
    angle = (first + 0.5 * (last - first) * (1.0 + node[:, None])).ravel()
    half = 0.5 * np.abs(first - last)
    chord = np.hypot(np.diff(line.x_um[0]), np.diff(line.z_um[0]))[arcs]
    around = chord * np.divide(half, np.sin(half), out=np.ones_like(half), where=half > 0.0)
    length = (0.5 * around * weight[:, None]).ravel()
    return Outline(
        flat.x_um,
        flat.z_um,
        np.concatenate([flat.segment[straight], np.tile(arcs, _NODES)]),
        np.concatenate([flat.normal[straight], np.stack([np.cos(angle), np.sin(angle)], axis=-1)]),
        np.concatenate([flat.length_um[straight], length]),
    )


def sharp_groove(design: RidgeDesign) -> RidgeDesign:
    """The groove between sharp crests in which light of a rounded one goes to and fro; its foot is that of the design.

    Facet and wall are shortened by `ROUNDED` of what the rounding takes from the wall, or by the lost height where that
    is more.
    """
    if design.edge_radius_um == 0.0 or design.full_height_um == 0.0:
        return replace(design, edge_radius_um=0.0)
    shortened = min(MOST_SHORTENED, ROUNDED * design.edge_reach_um / design.wall_length_um)
    return replace(design, edge_radius_um=0.0, height_loss=max(design.height_loss, shortened))


def ridge_polyline(design: RidgeDesign, chords: int | None = None) -> tuple[FloatArray, FloatArray]:
    """One period of the ridge profile, crest to crest, arcs in chords.

    Args:
        design: the ridges.
        chords: so many equal ones of the crest; as many as `anisoscope.parameters.ridge_outline` asks for by default.

    Returns:
        x, z in µm, both (K + 1,): the last point is the first one shifted by the pitch. Facets fall toward +x.
    """
    if design.full_height_um == 0.0:
        return np.array([0.0, design.pitch_um]), np.zeros(2)
    line = design.outline(chords=chords)
    x, z = line.x_um[0], line.z_um[0]
    tiny = 1e-12 * design.pitch_um
    keep = np.append(
        True, (np.diff(x) > tiny) | (np.abs(np.diff(z)) > tiny)
    )  # no plateau where nothing was cut
    return x[keep], z[keep]


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
    sheared = x_um - tangents[:, None] * z_um
    start, end = sheared[:, :-1], sheared[:, 1:]
    limit = np.minimum.accumulate(end[:, ::-1], axis=1)[:, ::-1]
    limit = np.minimum(limit, limit[:, :1] + period)  # of all periods ahead the next one hides most
    length = end - start
    facing = length > 1e-12 * period
    return np.where(facing, np.clip((limit - start) / np.where(facing, length, 1.0), 0.0, 1.0), 0.0)
