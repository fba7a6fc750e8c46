"""Direct light from many ridged parts at once, whose crests may be rounded: the corrected model on polylines.

A ball of the edge radius rolls inside the material along the profile, and material beyond its reach is missing: melt
does not fill the sharp bottom of a groove of the tool, where the crest of the part forms. Feet, copied from edges of
the tool, are sharp or arcs as well. Height loss cuts that profile at its height. Visibility of every segment is
exact, as in `sim.light.corrected`; with a radius of 0 this is the corrected model. All parts of a sample are evaluated
together in arrays (parts, poses, segments).
"""

from dataclasses import dataclass, field, fields, replace

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.parameters.material import Material
from anisoscope.parameters.ridge_outline import Outlines, ridge_outlines
from anisoscope.parameters.ridges import RidgeDesign, Wall
from anisoscope.sim.light.material import (
    TABLE_SIZE,
    diffuse_scale,
    fresnel,
    slope_density,
    smith_lambda,
    transmittance_table,
)

ARC_SEGMENTS = 24
TABLES_PER_E_FOLD = 8  # interface tables; between two of them the radiance is interpolated
_BLOCK = (
    200_000  # parts × poses × segments that are evaluated together: arrays that fit the processor's cache
)


@dataclass(frozen=True, eq=False)
class RidgedParts:
    """N ridged parts; numbers that all share may be given once.

    Attributes:
        pitch_um: (N,) distance of the crests.
        ridge_angle_deg: (N,) slope of the facets.
        height_loss: (N,) share of the height that is missing at the crests.
        edge_radius_um: (N,) radius of the crests; 0 is sharp.
        foot_radius_um: (N,) radius of the feet.
        alpha_along: (N,) roughness along the ridges.
        alpha_across: (N,) roughness across.
        wall: of all ridges.
        plastic: albedo, index and shape of the lobe of all parts.
    """

    pitch_um: FloatArray
    ridge_angle_deg: FloatArray
    height_loss: FloatArray
    edge_radius_um: FloatArray
    foot_radius_um: FloatArray
    alpha_along: FloatArray
    alpha_across: FloatArray
    wall: Wall = "perpendicular"
    plastic: Material = field(default_factory=Material)

    @classmethod
    def of(cls, design: RidgeDesign, edge_radius_um: float, material: Material) -> "RidgedParts":
        """One part."""
        numbers = (
            design.pitch_um, design.ridge_angle_deg, design.height_loss, edge_radius_um, design.foot_radius_um
        )  # fmt: skip
        pitch, angle, loss, radius, foot = (np.array([float(one)]) for one in numbers)
        along, across = np.array([material.alpha_along]), np.array([material.alpha_across])
        return cls(pitch, angle, loss, radius, foot, along, across, wall=design.wall, plastic=material)

    def block(self, rows: slice) -> "RidgedParts":
        """Some of the parts."""
        return replace(self, **{one.name: getattr(self, one.name)[rows] for one in fields(self)[:7]})


def _outlines(parts: RidgedParts) -> Outlines:
    angle = np.radians(parts.ridge_angle_deg)
    draft = RidgeDesign(1.0, 0.0, parts.wall).draft_rad if parts.wall != "perpendicular" else angle
    return ridge_outlines(
        parts.pitch_um,
        angle,
        np.broadcast_to(draft, angle.shape),
        parts.edge_radius_um,
        parts.height_loss,
        ARC_SEGMENTS if np.any(parts.edge_radius_um > 0.0) else 1,
        parts.foot_radius_um if np.any(parts.foot_radius_um > 0.0) else None,
        ARC_SEGMENTS,
    )


def ridge_radiances(to_light: FloatArray, to_camera: FloatArray, parts: RidgedParts) -> FloatArray:
    """Direct radiance [1/sr] per unit irradiance perpendicular to the beam, (N, P).

    The transmittance of the rough interface is tabulated for few mean roughnesses: radiances of the two next to
    the one asked for are interpolated in its logarithm. That makes thousands of materials cheap, and the radiance
    a continuous function of the roughness; the error is below 10⁻⁴ of the radiance.

    Args:
        to_light: (P, 3) or (N, P, 3) unit vectors in the sample frame, above the horizon.
        to_camera: likewise.
        parts: the ridges and their plastic.

    Returns:
        NaN for a part whose edge radius leaves no facet.
    """
    outlines = _outlines(parts)
    x, z, possible = outlines.x_um, outlines.z_um, outlines.possible
    count, poses = len(x), to_light.shape[-2]
    interface = _Interface(parts)
    found = np.empty((count, poses))
    step = max(1, _BLOCK // (poses * x.shape[1]))
    for start in range(0, count, step):
        rows = slice(start, start + step)
        light, camera = (np.broadcast_to(one, (count, poses, 3))[rows] for one in (to_light, to_camera))
        found[rows] = _radiances(light, camera, x[rows], z[rows], parts.block(rows), interface.block(rows))
    return np.where(possible[:, None], found, np.nan)


def _radiances(
    to_light: FloatArray,
    to_camera: FloatArray,
    x: FloatArray,
    z: FloatArray,
    parts: RidgedParts,
    interface: "_Interface",
) -> FloatArray:
    """(N, P) radiances of one block; directions (N, P, 3), profiles (N, K + 1)."""
    size = np.hypot(np.diff(x), np.diff(z))
    whole = np.where(size > 0.0, size, 1.0)
    flat, up = (np.diff(x) / whole)[:, None], (np.diff(z) / whole)[:, None]

    def across(vector: FloatArray) -> FloatArray:
        return np.asarray(flat * vector[..., :1] + up * vector[..., 2:])

    def normal(vector: FloatArray) -> FloatArray:
        return np.asarray(flat * vector[..., 2:] - up * vector[..., :1])

    half = to_light + to_camera
    half /= np.linalg.norm(half, axis=-1, keepdims=True)
    mirror = fresnel(np.sum(to_light * half, axis=-1), parts.plastic.index)[..., None]
    along_u, across_v = parts.alpha_along[:, None, None], parts.alpha_across[:, None, None]
    cos_i, cos_o, cos_h = normal(to_light), normal(to_camera), normal(half)
    front = (cos_i > 0.0) & (cos_o > 0.0)
    slope = (half[..., 1:2] / along_u) ** 2 + (across(half) / across_v) ** 2
    safe = np.where(cos_h > 1e-6, cos_h, 1.0)
    lobe = slope_density(slope / safe**2, parts.plastic) / (np.pi * along_u * across_v * safe**4)
    lobe = np.where(cos_h > 1e-6, lobe, 0.0) * mirror

    def shadowing(vector: FloatArray, cosine: FloatArray) -> FloatArray:
        spread = np.hypot(along_u * vector[..., 1:2], across_v * across(vector))
        return smith_lambda(spread / np.maximum(cosine, 1e-9), parts.plastic.tail, parts.plastic.second_lobe)

    # f·cos_i·cos_o, so that the lobe's denominator is a number
    lobe = 0.25 * lobe / (1.0 + shadowing(to_light, cos_i) + shadowing(to_camera, cos_o))
    cos_i, cos_o = np.maximum(cos_i, 0.0), np.maximum(cos_o, 0.0)
    value = np.where(front, lobe + interface.base(cos_i, cos_o) * cos_i * cos_o, 0.0)
    slant_i, slant_o = (one[..., 0] / one[..., 2] for one in (to_light, to_camera))
    lit, seen = _visible_shares(x, z, slant_i), _visible_shares(x, z, slant_o)
    same = ((slant_i >= 0.0) == (slant_o >= 0.0))[..., None]
    share = np.where(same, np.minimum(lit, seen), np.maximum(0.0, lit + seen - 1.0))
    total = np.sum(value * share * size[:, None], axis=-1)
    return np.asarray(total / ((x[:, -1] - x[:, 0])[:, None] * to_camera[..., 2]))


def _visible_shares(x: FloatArray, z: FloatArray, tangent: FloatArray) -> FloatArray:
    """(N, P, K) visible shares of the segments of periodic polylines (N, K + 1) along directions with (N, P) tangents.

    As `ridge_profile.visible_shares`; of all periods ahead only the next one can hide more than those after it.
    """
    period = (x[:, -1] - x[:, 0])[:, None, None]
    sheared = x[:, None] - tangent[..., None] * z[:, None]
    left = (tangent < 0.0)[..., None]
    sheared = np.where(left, -sheared[..., ::-1], sheared)
    start, end = sheared[..., :-1], sheared[..., 1:]
    limit = np.minimum.accumulate(end[..., ::-1], axis=-1)[..., ::-1]
    limit = np.minimum(limit, limit[..., :1] + period)
    length = end - start
    facing = length > 1e-12 * period
    share = np.where(facing, np.clip((limit - start) / np.where(facing, length, 1.0), 0.0, 1.0), 0.0)
    return np.where(left, share[..., ::-1], share)


@dataclass(frozen=True)
class _Tabulated(Material):
    """A plastic whose rough interface is that of another mean roughness."""

    interface_alpha: float = 0.1

    @property
    def alpha_mean(self) -> float:
        return self.interface_alpha


class _Interface:
    """Light that enters and leaves through the rough interfaces of N parts, between the tabulated roughnesses."""

    def __init__(self, parts: RidgedParts) -> None:
        place = 0.5 * np.log(parts.alpha_along * parts.alpha_across) * TABLES_PER_E_FOLD
        low = np.floor(place)
        numbers = np.unique(np.concatenate([low, low + 1.0]))
        plastics = [self._tabulated(parts.plastic, float(number)) for number in numbers]
        self._tables = np.array([transmittance_table(one) for one in plastics])
        self._scales = np.array([diffuse_scale(one) for one in plastics])
        self._first, self._weight = np.searchsorted(numbers, low), place - low

    @staticmethod
    def _tabulated(plastic: Material, number: float) -> Material:
        given = {one.name: getattr(plastic, one.name) for one in fields(Material)}
        return _Tabulated(**given, interface_alpha=float(np.exp(number / TABLES_PER_E_FOLD)))

    def block(self, rows: slice) -> "_Interface":
        """That of some of the parts."""
        found = object.__new__(_Interface)
        found._tables, found._scales = self._tables, self._scales
        found._first, found._weight = self._first[rows], self._weight[rows]
        return found

    def base(self, cos_i: FloatArray, cos_o: FloatArray) -> FloatArray:
        """(N, …) radiance of the base per irradiance of the facet [1/sr] for cosines (N, …) within 0 and 1."""
        shape = (len(cos_i),) + (1,) * (cos_i.ndim - 1)
        places = []
        for cosine in (cos_i, cos_o):
            place = np.minimum(cosine, 1.0) * (TABLE_SIZE - 1)
            cell = np.minimum(place.astype(np.intp), TABLE_SIZE - 2)
            places.append((cell, place - cell))
        total = np.zeros_like(cos_i)
        flat = self._tables.ravel()
        for step, weight in ((0, 1.0 - self._weight), (1, self._weight)):
            table = self._first + step
            both = (weight * self._scales[table]).reshape(shape)
            for cell, part in places:
                at = cell + (table * TABLE_SIZE).reshape(shape)
                lower = flat[at]
                both = both * (lower + (flat[at + 1] - lower) * part)
            total += both
        return total


def ridge_radiance(
    to_light: FloatArray,
    to_camera: FloatArray,
    design: RidgeDesign,
    edge_radius_um: float,
    material: Material,
) -> FloatArray:
    """Direct radiance [1/sr] of one part, (P,): `ridge_radiances` of it alone.

    Raises:
        HeightMapError: a negative radius, or one that leaves no facet.
    """
    design = replace(design, edge_radius_um=edge_radius_um)
    return np.asarray(
        ridge_radiances(to_light, to_camera, RidgedParts.of(design, edge_radius_um, material))[0]
    )
