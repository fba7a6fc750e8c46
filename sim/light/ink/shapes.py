"""Shapes to look at inks on, seen along −z in parallel light rays: normals, tangents and places on the print.

x runs to the right, y up, z to the viewer; the first row is at the top.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import ModelError

Float32 = npt.NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Surface:
    """Surface of a shape in view of a camera, pixel by pixel.

    Attributes:
        normal: (rows, cols, 3) unit normals; zero where there is nothing to see.
        tangent: (rows, cols, 3) unit tangents toward which an ink's x axis points.
        uv: (rows, cols, 2) places on the print, (0, 0) at its lower left and (1, 1) at its upper right corner; NaN
            where there is nothing.
    """

    normal: Float32
    tangent: Float32
    uv: Float32


def _pixels(rows: int, cols: int, fill: float) -> tuple[FloatArray, FloatArray]:
    """Return x and y of the pixels' middles; the shorter side of the picture spans ±1/fill."""
    if rows < 1 or cols < 1 or not 0.0 < fill <= 1.0:
        raise ModelError(
            f"a picture needs rows, cols of 1 or more and a fill in 0 to 1, not {rows} × {cols}, {fill:g}"
        )
    step = 2.0 / (fill * min(rows, cols))
    x = (np.arange(cols) + 0.5 - 0.5 * cols) * step
    y = (0.5 * rows - 0.5 - np.arange(rows)) * step
    return np.broadcast_to(x, (rows, cols)), np.broadcast_to(y[:, None], (rows, cols))


def _surface(
    normal: tuple[FloatArray, ...],
    tangent: tuple[FloatArray, ...],
    uv: tuple[FloatArray, ...],
    seen: npt.NDArray[np.bool_],
) -> Surface:
    shown = seen[..., None]
    return Surface(
        np.where(shown, np.stack(normal, axis=-1), 0.0).astype(np.float32),
        np.where(shown, np.stack(tangent, axis=-1), 0.0).astype(np.float32),
        np.where(shown, np.stack(uv, axis=-1), np.nan).astype(np.float32),
    )


def sphere(rows: int, cols: int, fill: float = 0.96) -> Surface:
    """A sphere; tangents run along its circles of latitude, the print covers the half that is seen.

    Args:
        rows: of the picture.
        cols: of the picture.
        fill: share of the shorter side that the sphere takes.

    Raises:
        ModelError: a picture without pixels, or a fill that is no share.
    """
    x, y = _pixels(rows, cols, fill)
    seen = x**2 + y**2 < 1.0
    z = np.sqrt(np.maximum(1.0 - x**2 - y**2, 0.0))
    ring = np.maximum(np.hypot(x, z), 1e-12)
    u = 0.5 + np.arctan2(x, z) / np.pi
    v = 0.5 + np.arcsin(np.clip(y, -1.0, 1.0)) / np.pi
    return _surface((x, y, z), (z / ring, np.zeros_like(x), -x / ring), (u, v), seen)


def cylinder(rows: int, cols: int, fill: float = 0.96) -> Surface:
    """An upright cylinder over the whole height of the picture; tangents run around it.

    Arguments and errors as for :func:`sphere`; ``fill`` is the share of the width.
    """
    x, y = _pixels(rows, cols, fill)
    x = x * min(rows, cols) / cols
    seen = np.abs(x) < 1.0
    z = np.sqrt(np.maximum(1.0 - x**2, 0.0))
    nothing = np.zeros_like(x)
    u = 0.5 + np.arcsin(np.clip(x, -1.0, 1.0)) / np.pi
    return _surface((x, nothing, z), (z, nothing, -x), (u, _upward(y)), seen)


def plane(rows: int, cols: int, tilt_deg: float = 0.0, toward_deg: float = 0.0) -> Surface:
    """A plane whose normal leans by ``tilt_deg`` toward an azimuth, counter-clockwise from +x; it fills the picture.

    Raises:
        ModelError: a picture without pixels, or a tilt of 90° or more.
    """
    if not abs(tilt_deg) < 90.0:
        raise ModelError(f"a plane is seen up to a tilt of 90°, not at {tilt_deg:g}°")
    x, y = _pixels(rows, cols, 1.0)
    tilt, toward = np.radians(tilt_deg), np.radians(toward_deg)
    normal = np.array([np.sin(tilt) * np.cos(toward), np.sin(tilt) * np.sin(toward), np.cos(tilt)])
    tangent = np.array([normal[2], 0.0, -normal[0]]) / np.hypot(normal[0], normal[2])
    ones = np.ones_like(x)
    u = (x - x.min()) / max(np.ptp(x), 1e-12)
    return _surface(
        tuple(part * ones for part in normal),
        tuple(part * ones for part in tangent),
        (u, _upward(y)),
        np.ones(x.shape, dtype=bool),
    )


def _upward(y: FloatArray) -> FloatArray:
    return np.asarray((y - y.min()) / max(float(np.ptp(y)), 1e-12))
