"""Profile of ideal ridges, and the visible share of each of its segments.

One period of the profile is a polyline. In the sheared coordinate s = x − t·z, with t = ω_x/ω_z, a point is
reached by light from direction ω exactly if no point further toward the light has a smaller s (t > 0), so a
running extremum of s gives the visible part of every segment without approximation. For ridges with
perpendicular walls this reduces to the one-sided G1 = 1/((1 + t·tan θr)·cos² θr) where t > tan θr.
"""

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.profiles.ideal import RidgeDesign


def ridge_polyline(design: RidgeDesign) -> tuple[FloatArray, FloatArray]:
    """One period of the ridge profile, crest to crest.

    Returns:
        x, z in µm, both (K + 1,): the last point is the first one shifted by the pitch. Facets fall toward +x.
    """
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
