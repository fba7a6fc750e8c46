"""Radiance predicted from a height map, facet by facet.

Every four neighbouring points form a facet with the normal of its symmetric gradients, the lobe of its
*unresolved* roughness, and a Lambertian base. Which part of it is both lit and seen follows from the horizon
along the azimuths of light and camera (``kernels``). The map is never rotated: the directions are.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from anisoscope.errors import HeightMapError, ModelError
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.sim.light.material import Material, diffuse_scale, transmittance_table

FloatArray = npt.NDArray[np.float64]
ShareArray = npt.NDArray[np.float32]

MAX_MISSING_SHARE = 0.25


@dataclass(frozen=True)
class Relief:
    """A height map prepared for prediction.

    Attributes:
        surface: the map, levelled.
        pitch_um: distance along x after which the surface repeats, or None. With it, shadows cast from
            beyond the edge are taken from inside the map, and means run over whole pitches.
        max_missing_share: share of missing facets above which prediction is refused.

    Raises:
        HeightMapError: too much of the map is missing, or it is smaller than one period.
    """

    surface: HeightMap
    pitch_um: float | None = None
    max_missing_share: float = MAX_MISSING_SHARE

    def __post_init__(self) -> None:
        missing = self.missing_share
        if missing > self.max_missing_share:
            raise HeightMapError(
                f"{missing:.1%} of the facets of this height map are missing (limit {self.max_missing_share:.0%}): "
                "measure it again, or fill the gaps in the instrument's software"
            )
        if self.pitch_um is not None and self._columns_per_pitch > self.surface.shape[1] - 1 + 1e-6:
            width = (self.surface.shape[1] - 1) * self.surface.pixel_x_um
            raise HeightMapError(
                f"the height map is {width:g} µm wide, less than one pitch of {self.pitch_um:g} µm: "
                "a prediction needs at least one whole ridge"
            )

    @property
    def _columns_per_pitch(self) -> float:
        assert self.pitch_um is not None
        return self.pitch_um / self.surface.pixel_x_um

    @property
    def missing_share(self) -> float:
        """Share of facets without a height at one of their corners."""
        known = np.isfinite(self.surface.height_um)
        whole = known[:-1, :-1] & known[1:, :-1] & known[:-1, 1:] & known[1:, 1:]
        return float(1.0 - whole.mean())

    def column_weights(self) -> FloatArray:
        """(cols − 1,) weights of the facet columns in a mean: whole pitches, the last column in part."""
        columns = self.surface.shape[1] - 1
        weights = np.ones(columns)
        if self.pitch_um is not None:
            span = np.floor(columns / self._columns_per_pitch + 1e-6) * self._columns_per_pitch
            weights = np.clip(span - np.arange(columns), 0.0, 1.0)
        return weights

    def wrap_columns(self) -> int:
        """Columns after which the surface repeats, rounded; 0 if unknown."""
        if self.pitch_um is None:
            return 0
        columns = self.surface.shape[1] - 1
        return round(float(np.floor(columns / self._columns_per_pitch + 1e-6)) * self._columns_per_pitch)


def visible_shares(relief: Relief, direction: FloatArray) -> ShareArray:
    """Share of every facet that is reached from one direction, by the horizon along its azimuth.

    Args:
        relief: the surface.
        direction: (3,) unit vector above the horizon.

    Returns:
        (rows − 1, cols − 1) shares. Exact on slices along a map axis; on other azimuths the slices pass
        between the points and are interpolated.
    """
    from anisoscope.sim.light.kernels import slice_shares  # noqa: PLC0415 - numba is loaded when first needed

    surface = relief.surface
    tan_x, tan_y = direction[0] / direction[2], direction[1] / direction[2]
    per_x, per_y = abs(tan_x) / surface.pixel_x_um, abs(tan_y) / surface.pixel_y_um
    rows, cols = surface.shape
    if max(per_x, per_y) * float(np.nanmax(surface.height_um) - np.nanmin(surface.height_um)) < 1e-12:
        return np.ones((rows - 1, cols - 1), dtype=np.float32)
    along_x = per_x >= per_y
    z = surface.height_um if along_x else surface.height_um.T
    major_tan, minor_tan = (tan_x, tan_y) if along_x else (tan_y, tan_x)
    major_px, minor_px = (surface.pixel_x_um, surface.pixel_y_um)[:: 1 if along_x else -1]
    flip_major, flip_minor = major_tan < 0, minor_tan < 0
    z = np.ascontiguousarray(z[:: -1 if flip_minor else 1, :: -1 if flip_major else 1])
    shift = abs(minor_tan) / minor_px / (abs(major_tan) / major_px)
    step = float(np.hypot(major_px, shift * minor_px))
    tangent = float(np.hypot(tan_x, tan_y))
    minor, major = z.shape
    reach = int(np.ceil(tangent * np.ptp(z[np.isfinite(z)]) / step)) + 1
    wrap = relief.wrap_columns()
    first = -int(np.ceil(0.5 * shift * major)) - 1
    count = minor - 1 - 2 * first
    period_major, period_minor = (wrap, 0) if along_x else (0, wrap)
    sliced = slice_shares(z, step, tangent, shift, reach, period_major, period_minor, first, count)
    shares = (
        _slices_to_facets(sliced, shift, first, minor - 1)
        if shift > 0
        else sliced[-first : -first + minor - 1]
    )
    shares = shares[:: -1 if flip_minor else 1, :: -1 if flip_major else 1]
    return np.ascontiguousarray(shares if along_x else shares.T)


def _slices_to_facets(sliced: ShareArray, shift: float, first: int, rows: int) -> ShareArray:
    """Facet row r lies between two slices at every column: interpolate between them."""
    columns = sliced.shape[1]
    column = np.arange(columns) + 0.5
    position = np.arange(rows)[:, None] - shift * (column - 0.5 * columns)[None, :] - first
    low = np.floor(position).astype(np.intp)
    part = (position - low).astype(np.float32)
    column_index = np.arange(columns)[None, :]
    below, above = sliced[low, column_index], sliced[low + 1, column_index]
    return np.asarray(below + part * (above - below), dtype=np.float32)


def radiance_maps(
    relief: Relief, to_light: FloatArray, to_camera: FloatArray, material: Material
) -> Iterator[ShareArray]:
    """For each pose, what every facet adds to the radiance per macroscopic area [1/sr].

    Args:
        relief: the surface.
        to_light: (P, 3) unit vectors in the frame of the sample.
        to_camera: (P, 3) unit vectors in the frame of the sample.
        material: the plastic, with the roughness that the map does *not* resolve.

    Yields:
        P maps (rows − 1, cols − 1), NaN where the height is missing; their mean is the radiance.
    """
    from anisoscope.sim.light.kernels import facet_radiance  # noqa: PLC0415

    surface = relief.surface
    table, diffuse = transmittance_table(material), diffuse_scale(material)
    cache: dict[bytes, ShareArray] = {}
    for light, camera in zip(to_light, to_camera, strict=True):
        if min(light[2], camera[2]) < 1e-3:
            raise ModelError("light or camera stands at or below the horizon of the sample")
        shares = []
        for direction in (light, camera):
            key = np.round(direction, 12).tobytes()
            if key not in cache:
                cache[key] = visible_shares(relief, direction)
            shares.append(cache[key])
        yield facet_radiance(
            surface.height_um,
            surface.pixel_x_um,
            surface.pixel_y_um,
            light,
            camera,
            shares[0],
            shares[1],
            material.alpha_along,
            material.alpha_across,
            material.index,
            diffuse,
            table,
        )


def radiance(relief: Relief, to_light: FloatArray, to_camera: FloatArray, material: Material) -> FloatArray:
    """Mean radiance [1/sr] of the surface per unit irradiance perpendicular to the beam, direct light.

    Missing facets are left out; with a known pitch the mean runs over whole pitches.

    Args and errors as :func:`radiance_maps`. Returns (P,) values.
    """
    weights = relief.column_weights()
    means = []
    for shown in radiance_maps(relief, to_light, to_camera, material):
        known = np.isfinite(shown)
        total = np.nansum(shown, axis=0, dtype=np.float64) @ weights
        means.append(total / (known.sum(axis=0) @ weights))
    return np.array(means)
