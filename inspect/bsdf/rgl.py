"""RGL/EPFL ``.bsdf`` files: the adaptive parameterisation of Dupuy and Jakob 2018, as Mitsuba's ``measured`` reads it.

The file factors f·cos θo = S·D(m)/(4σ(ω_i)), m the half vector. D is one function of m at any resolution, and may be
sharp; σ is its projected area; S is smooth, and stored on a square that a density of m ("vndf") stretches to where the
light is. Directions are u = (√(2θ/π), (φ + π)/2π); for isotropic surfaces the azimuth of m is that from the light's.
Between the incident directions of the file the cumulative distributions are interpolated.

What is written here: D is the reflectance back to the light, 4 cos²θ·f(m, m), which has the peaks of f; the density is
the root of D·(ω_i·m) over the half vectors that reflect above the horizon, and a floor.

The container, a tensor file, is named arrays, little-endian, one after another: ``tensor_file`` and a zero, version
(1, 0), number of fields; per field the length of its name, the name, dimensions, type, offset of the data and shape;
then the data.

Sources: Dupuy and Jakob, "An adaptive parameterization for efficient material acquisition and rendering", ACM TOG
37(6), 2018, doi 10.1145/3272127.3275059, and the loader of rgl-epfl/brdf-loader and Mitsuba 3 for the layout.
"""

import struct
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.atomic_write import write_bytes
from anisoscope.base.errors import UsageError
from anisoscope.base.progress import Advance, silent
from anisoscope.base.regular_file import MOST_PICTURE_BYTES, bounded_bytes
from anisoscope.bsdf.file_format import BsdfFile
from anisoscope.bsdf.reflectance import Reflectance, above_horizon, refuse_huge

MAGIC = b"tensor_file\0"
_TYPES: dict[int, npt.DTypeLike] = {
    1: "<u1", 2: "<i1", 3: "<u2", 4: "<i2", 5: "<u4", 6: "<i4", 7: "<u8", 8: "<i8", 9: "<f2", 10: "<f4", 11: "<f8",
}  # fmt: skip
_CODES = {np.dtype(name): code for code, name in _TYPES.items()}
_ALIGNMENT = 8
_MOST_FIELDS = 1000
HIGHEST_DEG = 88.0
GREY_NM = (360.0, 830.0)
"""Wavelengths under which one value for all light is stored twice."""
_FIELDS = {
    "phi_i": 1,
    "theta_i": 1,
    "wavelengths": 1,
    "ndf": 2,
    "sigma": 2,
    "vndf": 4,
    "spectra": 5,
    "jacobian": 1,
}
_FLOOR = 0.3  # of the density, against its mean: the flanks of the lobe need nodes too
_HIDDEN = 0.05  # of that floor where light would go below the horizon

_AREAS = 65, 65  # of σ
_DENSITY = 65, 65
_NEAR_HORIZON = 0.01
_QUARTERS = 4  # a file of a surface with two planes of symmetry holds a quarter of the turn


@dataclass(frozen=True)
class Resolution:
    """Numbers of nodes of a file.

    Attributes:
        theta: incident inclinations, evenly from 0 to HIGHEST_DEG.
        phi: incident azimuths, evenly over the turn, both ends counted; isotropic surfaces have one.
        square: nodes on a side of the square of outgoing directions.
        normals: nodes over azimuth and inclination of the reflectance back to the light.

    Raises:
        UsageError: too few to interpolate between.
    """

    theta: int = 24
    phi: int = 37
    square: int = 48
    normals: tuple[int, int] = (256, 512)

    def __post_init__(self) -> None:
        if self.theta < 2 or self.phi < 5 or self.square < 4:
            raise UsageError(
                "a .bsdf file needs at least 2 inclinations and 5 azimuths of the light and 4 nodes on a side, not "
                f"{self.theta}, {self.phi} and {self.square}"
            )


COARSE = Resolution(12, 19, 24, (48, 256))
"""For surfaces whose values take long to compute."""


def write_rgl(
    reflectance: Reflectance, path: Path, resolution: Resolution | None = None, on_progress: Advance = silent
) -> None:
    """Sample a reflectance and write it.

    Raises:
        UsageError: a file that would be huge, or a surface that reflects nothing.
        RecordError: the file cannot be written.
    """
    usual = COARSE if reflectance.costly else Resolution(45) if reflectance.isotropic else Resolution()
    size = resolution or usual
    nm = reflectance.wavelengths_nm or GREY_NM
    if len(nm) == 1:
        nm = (nm[0], nm[0] + 1.0)  # readers interpolate between two
    phi_i = np.zeros(1) if reflectance.isotropic else np.linspace(-np.pi, np.pi, size.phi)
    theta_i = np.radians(np.linspace(0.0, HIGHEST_DEG, size.theta))
    slices = len(phi_i) * len(theta_i)
    pixels = _DENSITY[0] * _DENSITY[1] + size.square**2 * (1 + len(nm))
    refuse_huge(4 * slices * pixels, f"{path}: {slices} directions of the light × {len(nm)} wavelengths")
    normals = _Plane(_back_reflection(reflectance, size.normals))
    areas = _Plane(_projected_areas(normals, isotropic=reflectance.isotropic))
    density = np.empty((slices, *_DENSITY), dtype=np.float32)
    spectra = np.empty((slices, len(nm), size.square, size.square), dtype=np.float32)
    luminance = np.empty((slices, size.square, size.square), dtype=np.float32)
    side = np.linspace(0.0, 1.0, size.square)
    sample = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    for number, (phi, theta) in enumerate((phi, theta) for phi in phi_i for theta in theta_i):
        if number % len(theta_i) == 0:
            on_progress("directions", number, slices)
        light, turn = _vectors(theta, phi), float(phi) if reflectance.isotropic else 0.0
        density[number] = _density_of_normals(normals, light, turn)
        u, share = _Warp(density[number]).at(sample)
        value, through = _mirrored(reflectance, light, _vectors(*_angles(u, turn)))
        lobe = np.maximum(normals(u), 1e-30)
        scaled = value * (4.0 * areas(_unit(theta, phi)) / lobe)[:, None]
        spectra[number] = np.broadcast_to(
            scaled.T.reshape(-1, size.square, size.square), spectra[number].shape
        )
        luminance[number] = (value.mean(axis=1) * through * _solid_angle(u) / share).reshape(
            luminance[number].shape
        )
    luminance += 0.03 * luminance.mean(axis=(1, 2), keepdims=True) + 1e-12
    on_progress("directions", slices, slices)
    grid = len(phi_i), len(theta_i)
    found: dict[str, npt.NDArray[Any]] = {
        "phi_i": phi_i,
        "theta_i": theta_i,
        "wavelengths": np.array(nm),
        "ndf": normals.value,
        "sigma": areas.value,
        "vndf": density.reshape(*grid, *_DENSITY),
        "luminance": luminance.reshape(*grid, *luminance.shape[1:]),
        "spectra": spectra.reshape(*grid, *spectra.shape[1:]),
    }
    text = f"{reflectance.name} (anisoscope)".encode()
    write_tensors(
        {
            "description": np.frombuffer(text, np.uint8),
            "jacobian": np.array([1], np.uint8),
            **{name: array.astype(np.float32) for name, array in found.items()},
        },
        path,
    )


def read_rgl(path: Path) -> Reflectance:
    """Read a ``.bsdf`` file of RGL, ours or another's.

    Raises:
        UsageError: it cannot be read, is none, or lacks a field.
    """
    fields = read_tensors(path)
    for name, dimensions in _FIELDS.items():
        if name not in fields:
            kind = " (files in RGB have no wavelengths: take the spectral one)" if name == "spectra" else ""
            raise UsageError(f"{path}: the field {name!r} of a .bsdf file is missing{kind}")
        if fields[name].ndim != dimensions or fields[name].size == 0:
            raise UsageError(
                f"{path}: the field {name!r} has the shape {fields[name].shape}, not {dimensions} axes"
            )
    phi_i, theta_i, nm = (fields[name].astype(np.float64) for name in ("phi_i", "theta_i", "wavelengths"))
    grid = len(phi_i), len(theta_i)
    if fields["vndf"].shape[:2] != grid or fields["spectra"].shape[:3] != (*grid, len(nm)):
        raise UsageError(f"{path}: directions and wavelengths do not match the shape of vndf or spectra")
    for name, array in fields.items():
        if array.dtype.kind == "f" and not np.isfinite(array).all():
            raise UsageError(f"{path}: {name} holds values that are no numbers")
    measured = _Measured(
        phi_i,
        theta_i,
        _Warp(fields["vndf"].astype(np.float64)),
        fields["spectra"],
        _Plane(fields["ndf"].astype(np.float64)),
        _Plane(fields["sigma"].astype(np.float64)),
        jacobian=bool(fields["jacobian"].ravel()[0]),
    )
    grey = len(nm) == 2 and np.array_equal(fields["spectra"][:, :, 0], fields["spectra"][:, :, 1])
    text = bytes(fields["description"].astype(np.uint8).ravel()).decode("utf-8", "replace") if (
        "description" in fields
    ) else path.stem  # fmt: skip

    def evaluate(to_light: FloatArray, to_camera: FloatArray) -> FloatArray:
        found = above_horizon(to_light, to_camera, measured.brdf)
        return found[:, :1] if grey else found

    wavelengths = () if grey and nm[1] - nm[0] > 1.0 else (float(nm[0]),) if grey else tuple(map(float, nm))
    return Reflectance(text.removesuffix(" (anisoscope)"), evaluate, wavelengths, isotropic=len(phi_i) <= 2)


@dataclass(frozen=True, eq=False)
class _Plane:
    """Values over the unit square, bilinear between (rows, cols) nodes; columns go with the first coordinate."""

    value: FloatArray

    def __call__(self, u: FloatArray) -> FloatArray:
        """(N,) values at (N, 2)."""
        (row, col), (y, x) = _cells(u, self.value.shape)
        v = self.value
        top = (1.0 - x) * v[row, col] + x * v[row, col + 1]
        return np.asarray((1.0 - y) * top + y * ((1.0 - x) * v[row + 1, col] + x * v[row + 1, col + 1]))


@dataclass(eq=False)
class _Warp:
    """A density over the unit square, bilinear between nodes (…, rows, cols), and its cumulative distributions.

    The marginal runs over the rows, the conditional along a row.
    """

    value: FloatArray
    along: FloatArray = field(init=False)
    down: FloatArray = field(init=False)

    def __post_init__(self) -> None:
        v = np.asarray(self.value, dtype=np.float64)
        along = np.zeros_like(v)
        np.cumsum(0.5 * (v[..., :-1] + v[..., 1:]), axis=-1, out=along[..., 1:])
        rows = along[..., -1]
        down = np.zeros_like(rows)
        np.cumsum(0.5 * (rows[..., :-1] + rows[..., 1:]), axis=-1, out=down[..., 1:])
        total = down[..., -1]
        if not np.all(total > 0.0):
            raise UsageError("a density of directions is 0 everywhere")
        self.along, self.down = along / total[..., None, None], down / total[..., None]
        self.value = v / total[..., None, None]

    def at(self, sample: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(N, 2) places of (N, 2) even samples, and the density there; for one (rows, cols) density."""
        rows, cols = self.value.shape
        row = np.clip(np.searchsorted(self.down, sample[:, 1], side="right") - 1, 0, rows - 2)
        whole = self.along[:, -1]
        y = _root(whole[row], whole[row + 1], sample[:, 1] - self.down[row])
        line = (1.0 - y)[:, None] * self.along[row] + y[:, None] * self.along[row + 1]
        aim = sample[:, 0] * line[:, -1]
        col = np.clip(np.sum(line <= aim[:, None], axis=1) - 1, 0, cols - 2)
        v, at = self.value, np.arange(len(sample))
        left = (1.0 - y) * v[row, col] + y * v[row + 1, col]
        right = (1.0 - y) * v[row, col + 1] + y * v[row + 1, col + 1]
        x = _root(left, right, aim - line[at, col])
        u = np.stack([(col + x) / (cols - 1), (row + y) / (rows - 1)], axis=-1)
        return u, np.maximum((1.0 - x) * left + x * right, 1e-30) * (rows - 1) * (cols - 1)

    def inverse(self, u: FloatArray, corners: "_Corners") -> FloatArray:
        """(N, 2) even samples of (N, 2) places, the distributions interpolated between the corners of N slices."""
        (row, col), (y, x) = _cells(u, self.value.shape[-2:])
        cols = self.value.shape[-1]
        value, along, down = (
            array.reshape(-1, *array.shape[2:]) for array in (self.value, self.along, self.down)
        )

        def mean(array: FloatArray, *place: Any) -> FloatArray:  # noqa: ANN401 - indices
            return np.asarray(sum(weight * array[(slice_, *place)] for slice_, weight in corners))

        left = (1.0 - y) * mean(value, row, col) + y * mean(value, row + 1, col)
        right = (1.0 - y) * mean(value, row, col + 1) + y * mean(value, row + 1, col + 1)
        before = (1.0 - y) * mean(along, row, col) + y * mean(along, row + 1, col)
        first, second = mean(along, row, cols - 1), mean(along, row + 1, cols - 1)
        share = before + x * (left + 0.5 * x * (right - left))
        over = mean(down, row) + y * (first + 0.5 * y * (second - first))
        return np.stack([share / np.maximum((1.0 - y) * first + y * second, 1e-30), over], axis=-1)


_Corners = list[tuple[npt.NDArray[np.intp], FloatArray]]


@dataclass(frozen=True, eq=False)
class _Measured:
    """The fields of a file, ready to be looked up."""

    phi_i: FloatArray
    theta_i: FloatArray
    warp: _Warp
    spectra: npt.NDArray[np.float32]
    normals: _Plane
    areas: _Plane
    jacobian: bool

    def brdf(self, to_light: FloatArray, to_camera: FloatArray) -> FloatArray:
        """(N, W) values in 1/sr at (N, 3) directions above the horizon."""
        light, camera = self._folded(to_light, to_camera)
        half = light + camera
        half /= np.linalg.norm(half, axis=1, keepdims=True)
        theta, phi = _spherical(light)
        theta_m, phi_m = _spherical(half)
        u = _unit(theta_m, phi_m - phi if len(self.phi_i) <= 2 else phi_m)
        u[:, 1] -= np.floor(u[:, 1])
        corners = self._corners(theta, phi)
        sample = self.warp.inverse(u, corners)
        (row, col), (y, x) = _cells(np.clip(sample, 0.0, 1.0), self.spectra.shape[-2:])
        table = self.spectra.reshape(-1, *self.spectra.shape[2:])
        found = np.zeros((len(light), table.shape[1]))
        for slice_, weight in corners:
            for down, right, share in (
                (0, 0, (1 - y) * (1 - x)),
                (0, 1, (1 - y) * x),
                (1, 0, y * (1 - x)),
                (1, 1, y * x),
            ):
                found += (weight * share)[:, None] * table[slice_, :, row + down, col + right]
        if self.jacobian:
            found *= (self.normals(u) / (4.0 * np.maximum(self.areas(_unit(theta, phi)), 1e-30)))[:, None]
        return np.asarray(found / camera[:, 2:])

    def _folded(self, to_light: FloatArray, to_camera: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Directions brought into the azimuths of the file, which may use a symmetry."""
        light, camera = np.array(to_light), np.array(to_camera)
        if len(self.phi_i) <= 2:
            return light, camera
        parts = round(2.0 * np.pi / max(float(self.phi_i[-1] - self.phi_i[0]), 1e-9))
        if parts >= 2:
            turned = np.where(light[:, :2] >= 0.0, -1.0, 1.0)
            if parts != _QUARTERS:
                turned[:, 0] = turned[:, 1]
            light[:, :2] *= turned
            camera[:, :2] *= turned
        return light, camera

    def _corners(self, theta: FloatArray, phi: FloatArray) -> _Corners:
        """Slices around N incident directions, and their weights."""
        (p, ps), (t, ts) = _between(self.phi_i, phi), _between(self.theta_i, theta)
        count = len(self.theta_i)
        one, other = min(1, len(self.phi_i) - 1), min(1, count - 1)
        return [
            (p * count + t, (1 - ps) * (1 - ts)),
            (p * count + t + other, (1 - ps) * ts),
            ((p + one) * count + t, ps * (1 - ts)),
            ((p + one) * count + t + other, ps * ts),
        ]


def _back_reflection(reflectance: Reflectance, nodes: tuple[int, int]) -> FloatArray:
    """D on its nodes: 4 cos²θ·f(m, m), never quite 0; of an isotropic surface two equal rows."""
    rows = 2 if reflectance.isotropic else nodes[0]
    v, u = np.meshgrid(np.linspace(0.0, 1.0, rows), np.linspace(0.0, 1.0, nodes[1]), indexing="ij")
    theta, phi = _angles(np.stack([u.ravel(), v.ravel()], axis=-1), 0.0)
    normal = _vectors(np.minimum(theta, np.radians(HIGHEST_DEG)), np.zeros_like(phi) if rows == 2 else phi)
    found = 4.0 * normal[:, 2] ** 2 * np.mean(np.maximum(reflectance.evaluate(normal, normal), 0.0), axis=1)
    if not found.max() > 0.0:
        raise UsageError(
            f"{reflectance.name}: nothing is reflected back toward the light: there is nothing to write"
        )
    weight = u.ravel() * np.sin(theta)
    mean = float(np.sum(found * weight) / np.sum(weight))
    return np.asarray((found + 0.01 * mean).reshape(rows, nodes[1]))


def _projected_areas(normals: _Plane, *, isotropic: bool) -> FloatArray:
    """σ(ω_i) = ∫ D(m) max(0, ω_i·m) dm on its nodes."""
    v, u = np.meshgrid((np.arange(96) + 0.5) / 96, (np.arange(192) + 0.5) / 192, indexing="ij")
    places = np.stack([u.ravel(), v.ravel()], axis=-1)
    normal = _vectors(*_angles(places, 0.0))
    weight = normals(places) * _solid_angle(places) / len(places)
    rows = 2 if isotropic else _AREAS[0]
    v, u = np.meshgrid(np.linspace(0.0, 1.0, rows), np.linspace(0.0, 1.0, _AREAS[1]), indexing="ij")
    lights = _vectors(*_angles(np.stack([u.ravel(), v.ravel()], axis=-1), 0.0))
    found = np.array([np.sum(weight * np.maximum(normal @ light, 0.0)) for light in lights])
    return np.asarray(np.maximum(found, 1e-12).reshape(rows, _AREAS[1]))


def _density_of_normals(normals: _Plane, light: FloatArray, turn: float) -> FloatArray:
    """√(D·(ω_i·m)) per u, where m mirrors the light above the horizon, with a floor everywhere."""
    v, u = np.meshgrid(np.linspace(0.0, 1.0, _DENSITY[0]), np.linspace(0.0, 1.0, _DENSITY[1]), indexing="ij")
    places = np.stack([u.ravel(), v.ravel()], axis=-1)
    normal = _vectors(*_angles(places, turn))
    facing = np.maximum(normal @ light, 0.0)
    up = 2.0 * facing * normal[:, 2] - light[2] > 0.0
    found = np.sqrt(np.where(up, normals(places) * facing * _solid_angle(places), 0.0))
    return np.asarray((found + _FLOOR * np.where(up, 1.0, _HIDDEN) * found.mean()).reshape(_DENSITY))


def _mirrored(
    reflectance: Reflectance, light: FloatArray, normal: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """(N, W) f·cos θo for light mirrored by (N, 3) normals, and dω_o/dω_m; below the horizon that at the horizon."""
    facing = normal @ light
    camera = 2.0 * facing[:, None] * normal - light
    low = camera[:, 2] < _NEAR_HORIZON
    # Toward the horizon; where that is straight below, the normal says which way.
    toward = camera[low, :2]
    flat = np.hypot(toward[:, 0], toward[:, 1])
    toward = np.where((flat > _NEAR_HORIZON)[:, None], toward, normal[low, :2])
    length = np.maximum(np.hypot(toward[:, 0], toward[:, 1]), 1e-12)
    camera[low, :2] = toward / length[:, None] * np.sqrt(1.0 - _NEAR_HORIZON**2)
    camera[low, 2] = _NEAR_HORIZON
    value = reflectance.evaluate(np.broadcast_to(light, camera.shape).copy(), camera)
    return value * camera[:, 2:], 4.0 * np.maximum(facing, 0.0)


def _unit(theta: FloatArray | float, phi: FloatArray | float) -> FloatArray:
    """(N, 2) places on the unit square of directions."""
    u = np.sqrt(np.maximum(np.atleast_1d(theta), 0.0) * (2.0 / np.pi))
    return np.stack(np.broadcast_arrays(u, (np.atleast_1d(phi) + np.pi) / (2.0 * np.pi)), axis=-1)


def _angles(u: FloatArray, turn: float) -> tuple[FloatArray, FloatArray]:
    """θ and φ of (N, 2) places; ``turn`` is the azimuth from which φ counts."""
    return 0.5 * np.pi * u[:, 0] ** 2, (2.0 * u[:, 1] - 1.0) * np.pi + turn


def _solid_angle(u: FloatArray) -> FloatArray:
    """(N,) solid angle over area of the unit square."""
    return np.asarray(2.0 * np.pi**2 * u[:, 0] * np.sin(0.5 * np.pi * u[:, 0] ** 2))


def _vectors(theta: FloatArray | float, phi: FloatArray | float) -> FloatArray:
    """(…, 3) unit vectors."""
    return np.stack(
        np.broadcast_arrays(np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)), axis=-1
    )


def _spherical(vectors: FloatArray) -> tuple[FloatArray, FloatArray]:
    """θ and φ of (N, 3) unit vectors, θ exact near the pole too."""
    x, y, z = vectors.T
    return np.arctan2(np.hypot(x, y), z), np.arctan2(y, x)


def _cells(
    u: FloatArray, shape: tuple[int, ...]
) -> tuple[tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]], tuple[FloatArray, FloatArray]]:
    """(row, col) of the cells that hold (N, 2) places, and the places in them."""
    found = []
    for count, at in zip(shape, (u[:, 1], u[:, 0]), strict=True):
        place = np.clip(at, 0.0, 1.0) * (count - 1)
        cell = np.clip(place.astype(np.intp), 0, max(count - 2, 0))
        found.append((cell, place - cell))
    return (found[0][0], found[1][0]), (found[0][1], found[1][1])


def _between(nodes: FloatArray, at: FloatArray) -> tuple[npt.NDArray[np.intp], FloatArray]:
    """Index of the node before, and the share of the next one, held at both ends."""
    if len(nodes) == 1:
        return np.zeros(len(at), dtype=np.intp), np.zeros(len(at))
    index = np.clip(np.searchsorted(nodes, at, side="right") - 1, 0, len(nodes) - 2)
    return index, np.clip((at - nodes[index]) / (nodes[index + 1] - nodes[index]), 0.0, 1.0)


def _root(first: FloatArray, second: FloatArray, area: FloatArray) -> FloatArray:
    """Where a density that runs linearly from ``first`` to ``second`` over a cell has gathered ``area``, in 0 to 1."""
    discriminant = np.sqrt(np.maximum(first**2 + 2.0 * (second - first) * area, 0.0))
    return np.asarray(np.clip(2.0 * area / np.maximum(first + discriminant, 1e-30), 0.0, 1.0))


def write_tensors(fields: Mapping[str, npt.NDArray[Any]], path: Path) -> None:
    """Write arrays under their names.

    Raises:
        RecordError: the file cannot be written.
    """
    arrays = {
        name: np.ascontiguousarray(array, array.dtype.newbyteorder("<")) for name, array in fields.items()
    }
    size = len(MAGIC) + 6 + sum(2 + len(n.encode()) + 2 + 1 + 8 + 8 * a.ndim for n, a in arrays.items())
    head, body = [MAGIC, bytes((1, 0)), struct.pack("<I", len(arrays))], []
    for name, array in arrays.items():
        gap = -size % _ALIGNMENT
        head.append(struct.pack("<H", len(name.encode())) + name.encode())
        head.append(struct.pack("<HBQ", array.ndim, _CODES[array.dtype], size + gap))
        head.append(struct.pack(f"<{array.ndim}Q", *array.shape))
        body += [bytes(gap), array.tobytes()]
        size += gap + array.nbytes
    write_bytes(path, b"".join(head + body))


def read_tensors(path: Path) -> dict[str, npt.NDArray[Any]]:
    """Read all arrays of a tensor file.

    Raises:
        UsageError: it cannot be read, is none, or is damaged.
    """
    try:
        data = bounded_bytes(path, MOST_PICTURE_BYTES)
    except OSError as problem:
        raise UsageError(f"cannot read {path}: {problem.strerror or problem}") from problem
    if not data.startswith(MAGIC):
        raise UsageError(f"{path}: no tensor file: it does not begin with 'tensor_file'")
    try:
        return _fields(data)
    except (struct.error, ValueError, KeyError, UnicodeDecodeError) as problem:
        raise UsageError(f"{path}: damaged or cut off: copy it again ({problem})") from problem


def _fields(data: bytes) -> dict[str, npt.NDArray[Any]]:
    at = len(MAGIC)
    if data[at] != 1:
        raise ValueError(f"version {data[at]}, known is 1")
    (count,) = struct.unpack_from("<I", data, at + 2)
    if count > _MOST_FIELDS:
        raise ValueError(f"{count} fields")
    at += 6
    found = {}
    for _ in range(count):
        (length,) = struct.unpack_from("<H", data, at)
        name = data[at + 2 : at + 2 + length].decode()
        at += 2 + length
        dimensions, code, offset = struct.unpack_from("<HBQ", data, at)
        at += 11
        shape = struct.unpack_from(f"<{dimensions}Q", data, at)
        at += 8 * dimensions
        if code not in _TYPES:
            raise ValueError(f"field {name} has the unknown type {code}")
        number = 1
        for extent in shape:
            number *= extent
        if offset + number * np.dtype(_TYPES[code]).itemsize > len(data):
            raise ValueError(f"field {name} ends beyond the file")
        found[name] = np.frombuffer(data, _TYPES[code], number, offset).reshape(shape)
    return found


RGL = BsdfFile("rgl", "RGL .bsdf", lambda head: head.startswith(MAGIC), read_rgl, 1)
