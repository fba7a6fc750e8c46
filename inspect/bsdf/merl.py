"""MERL binary files: isotropic BRDFs on half and difference angles, in linear RGB.

Three int32 (90, 90, 180), then doubles, one colour after the other: θ of the half vector in squared steps, θ and φ of
the difference. Values are scaled by 1500 over (1, 1.15, 1.66). A value is that of the middle of its cell, as readers
look the cell up. Source: Matusik et al., "A data-driven reflectance model", ACM TOG 22(3), 2003, and the reader that
comes with its data.
"""

from pathlib import Path
from typing import Literal

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.atomic_write import write_bytes
from anisoscope.base.errors import UsageError
from anisoscope.base.regular_file import MOST_PICTURE_BYTES, bounded_bytes
from anisoscope.bsdf.file_format import BsdfFile
from anisoscope.bsdf.reflectance import Reflectance, above_horizon, must_be_isotropic

SHAPE = 90, 90, 180
SCALE = np.array([1.0, 1.15, 1.66]) / 1500.0
RGB_NM = (450.0, 550.0, 650.0)
"""Under which the blue, green and red of a file are known in here; they are no lines."""


def write_merl(reflectance: Reflectance, path: Path) -> None:
    """Write an isotropic BRDF of one channel, or of the three of RGB_NM.

    Raises:
        UsageError: an anisotropic surface, or other wavelengths.
        RecordError: the file cannot be written.
    """
    must_be_isotropic(reflectance, "MERL")
    if reflectance.channels not in (1, 3):
        raise UsageError(
            f"{reflectance.name}: MERL holds red, green and blue, not {reflectance.channels} wavelengths"
        )
    half, diff, turn = (axis.ravel() for axis in np.meshgrid(*_middles(), indexing="ij"))
    light, camera = _directions(half, diff, turn)
    value = reflectance.evaluate(light, camera)
    colours = np.repeat(value, 3, axis=1) if value.shape[1] == 1 else value[:, ::-1]
    data = np.maximum(colours, 0.0) / SCALE
    write_bytes(path, np.array(SHAPE, "<i4").tobytes() + np.ascontiguousarray(data.T, "<f8").tobytes())


def is_merl(head: bytes) -> bool:
    """Whether a file begins as a MERL binary does."""
    return head.startswith(np.array(SHAPE, "<i4").tobytes())


def read_merl(path: Path, *, nearest: bool = False) -> Reflectance:
    """Read a MERL binary; a grey one has one value for all light. Negative values mark what was not measured: 0.

    Args:
        path: the file.
        nearest: take the value of the cell, as the reader that comes with the data does, in place of a mean of cells.

    Raises:
        UsageError: it cannot be read, or has another size.
    """
    try:
        data = bounded_bytes(path, MOST_PICTURE_BYTES)
    except OSError as problem:
        raise UsageError(f"cannot read {path}: {problem.strerror or problem}") from problem
    if not is_merl(data):
        raise UsageError(f"{path}: no MERL binary: it does not begin with the sizes 90, 90, 180")
    count = int(np.prod(SHAPE))
    if len(data) != 12 + 24 * count:
        raise UsageError(f"{path}: {len(data)} bytes, a MERL binary has {12 + 24 * count}: copy it again")
    raw = np.frombuffer(data, "<f8", 3 * count, 12).reshape(3, *SHAPE)
    if not np.isfinite(raw).all():
        raise UsageError(f"{path}: holds values that are no numbers")
    table = np.maximum(np.moveaxis(raw, 0, -1) * SCALE, 0.0)[..., ::-1]
    grey = bool(
        np.allclose(table[..., 0], table[..., 2], rtol=1e-6) and np.allclose(table[..., 0], table[..., 1])
    )
    table = np.ascontiguousarray(table[..., :1] if grey else table)
    # φ of the difference has a period of 180°: exchanging light and camera turns it by that
    table = np.concatenate([table[:, :, -1:], table, table[:, :, :1]], axis=2)

    order: Literal[0, 1] = 0 if nearest else 1

    def value(to_light: FloatArray, to_camera: FloatArray) -> FloatArray:
        from scipy.ndimage import map_coordinates  # noqa: PLC0415 - slow to import

        half, diff, turn = _half_and_difference(to_light, to_camera)
        place = [
            90.0 * np.sqrt(half / (0.5 * np.pi)) - 0.5,
            diff / np.radians(1.0) - 0.5,
            np.mod(turn, np.pi) / np.radians(1.0) + 0.5,
        ]
        return np.stack(
            [
                map_coordinates(table[..., c], place, order=order, mode="nearest")
                for c in range(table.shape[-1])
            ],
            axis=-1,
        )

    return Reflectance(
        path.stem,
        lambda light, camera: above_horizon(light, camera, value),
        () if grey else RGB_NM,
        isotropic=True,
        notes=() if grey else ("450, 550 and 650 nm stand for blue, green and red",),
    )


def _middles() -> tuple[FloatArray, FloatArray, FloatArray]:
    """θ half, θ difference and φ difference of the middles of the cells, in radians."""
    n_half, n_diff, n_turn = SHAPE
    half = 0.5 * np.pi * ((np.arange(n_half) + 0.5) / n_half) ** 2
    diff = np.radians(np.arange(n_diff) + 0.5)
    return half, diff, np.radians(np.arange(n_turn) + 0.5)


def _directions(half: FloatArray, diff: FloatArray, turn: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(N, 3) unit vectors to light and camera of N half and difference angles, the half vector over +x."""
    x, y, z = np.sin(diff) * np.cos(turn), np.sin(diff) * np.sin(turn), np.cos(diff)
    cos, sin = np.cos(half), np.sin(half)
    light = np.stack([cos * x + sin * z, y, cos * z - sin * x], axis=-1)
    normal = np.stack([sin, np.zeros_like(sin), cos], axis=-1)
    return light, 2.0 * np.sum(light * normal, axis=-1, keepdims=True) * normal - light


def _half_and_difference(
    to_light: FloatArray, to_camera: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """θ half, θ difference and φ difference of (N, 3) unit vectors."""
    half = to_light + to_camera
    half = half / np.linalg.norm(half, axis=1, keepdims=True)
    tilt = np.arctan2(np.hypot(half[:, 0], half[:, 1]), half[:, 2])
    azimuth = np.arctan2(half[:, 1], half[:, 0])
    x = np.cos(azimuth) * to_light[:, 0] + np.sin(azimuth) * to_light[:, 1]
    y = np.cos(azimuth) * to_light[:, 1] - np.sin(azimuth) * to_light[:, 0]
    across = np.cos(tilt) * x - np.sin(tilt) * to_light[:, 2]
    up = np.sin(tilt) * x + np.cos(tilt) * to_light[:, 2]
    return tilt, np.arctan2(np.hypot(across, y), up), np.arctan2(y, across)


MERL = BsdfFile("merl", "MERL binary", is_merl, read_merl, 2)
