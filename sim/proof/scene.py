"""Printed shapes, turned before the eye, as the surfaces that a picture needs.

The eye looks along −z in parallel rays; x runs right, y up. A print is turned by ``yaw_deg`` about y, then by
``pitch_deg`` about x. Its inner side, or back, is bare paper, with ``uv`` NaN. Sphere and cylinder bear the
print twice, once on each half.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import ModelError
from anisoscope.sim.light.ink.shapes import Surface
from anisoscope.sim.proof.mesh import Mesh

Float32 = npt.NDArray[np.float32]
Shape = Literal["sphere", "cylinder", "plane", "mesh"]

FILL = 0.96


@dataclass(frozen=True, eq=False)
class Scene:
    """A shape and how it is turned.

    Attributes:
        shape: what is printed on; "mesh" needs ``mesh``.
        yaw_deg: turn about the upright axis, to the right for positive angles.
        pitch_deg: turn about the horizontal axis after that; positive ones show more of the top.
        aspect: width of the print over its height; a plane and half a cylinder keep it.
        fill: share of the shorter side of the picture that a unit sphere takes.
        mesh: for the shape "mesh".
    """

    shape: Shape = "sphere"
    yaw_deg: float = 0.0
    pitch_deg: float = 0.0
    aspect: float = 1.0
    fill: float = FILL
    mesh: Mesh | None = None

    @property
    def turn(self) -> FloatArray:
        """(3, 3) from the frame of the print to that of the eye."""
        yaw, pitch = np.radians(self.yaw_deg), np.radians(self.pitch_deg)
        about_y = np.array([[np.cos(yaw), 0, np.sin(yaw)], [0, 1, 0], [-np.sin(yaw), 0, np.cos(yaw)]])
        about_x = np.array([[1, 0, 0], [0, np.cos(pitch), -np.sin(pitch)], [0, np.sin(pitch), np.cos(pitch)]])
        return np.asarray(about_x @ about_y)


def plane_size(aspect: float) -> tuple[float, float]:
    """Half the width and half the height of a plane in the unit sphere."""
    return aspect / float(np.hypot(aspect, 1.0)), 1.0 / float(np.hypot(aspect, 1.0))


def cylinder_size(aspect: float) -> tuple[float, float]:
    """Radius and half the height of a cylinder in the unit sphere; half of it is as wide as the print."""
    radius = 2.0 * aspect / np.pi
    return radius / float(np.hypot(radius, 1.0)), 1.0 / float(np.hypot(radius, 1.0))


def surface(scene: Scene, rows: int, cols: int) -> Surface:
    """Surface in view of the eye, pixel by pixel.

    Raises:
        ModelError: a picture without pixels, a shape that is not known, a mesh that is missing, or angles that are not
            finite.
    """
    if rows < 1 or cols < 1 or not 0.0 < scene.fill <= 1.0 or not 0.0 < scene.aspect < np.inf:
        raise ModelError(
            f"a picture needs pixels, a fill in 0 to 1 and an aspect above 0, not {rows} × {cols}"
        )
    if not np.isfinite(scene.yaw_deg) or not np.isfinite(scene.pitch_deg):
        raise ModelError("a print is turned by finite angles")
    if scene.shape == "mesh":
        if scene.mesh is None:
            raise ModelError("the shape 'mesh' needs a mesh")
        return _of_mesh(scene, scene.mesh, rows, cols)
    if scene.shape not in _SHAPES:
        raise ModelError(f"no shape is named {scene.shape!r}; known: {', '.join(_SHAPES)}, mesh")
    step = 2.0 / (scene.fill * min(rows, cols))
    x = np.broadcast_to((np.arange(cols) + 0.5 - 0.5 * cols) * step, (rows, cols))
    y = np.broadcast_to(((0.5 * rows - 0.5 - np.arange(rows)) * step)[:, None], (rows, cols))
    with np.errstate(divide="ignore", invalid="ignore"):
        visible, normal, tangent, uv, outer = _SHAPES[scene.shape](scene, x, y)
    return _finished(scene, visible, normal, tangent, np.where(outer[..., None], uv, np.nan))


_Found = tuple[npt.NDArray[np.bool_], FloatArray, FloatArray, FloatArray, npt.NDArray[np.bool_]]


def _finished(
    scene: Scene, visible: npt.NDArray[np.bool_], normal: FloatArray, tangent: FloatArray, uv: FloatArray
) -> Surface:
    turn = scene.turn
    mask = visible[..., None]
    return Surface(
        np.where(mask, normal @ turn.T, 0.0).astype(np.float32),
        np.where(mask, tangent @ turn.T, 0.0).astype(np.float32),
        np.where(mask, uv, np.nan).astype(np.float32),
    )


def _sphere(scene: Scene, x: FloatArray, y: FloatArray) -> _Found:
    visible = x**2 + y**2 < 1.0
    eye = np.stack([x, y, np.sqrt(np.maximum(1.0 - x**2 - y**2, 0.0))], axis=-1)
    normal = eye @ scene.turn
    px, py, pz = np.moveaxis(normal, -1, 0)
    ring = np.maximum(np.hypot(px, pz), 1e-12)
    tangent = np.stack([pz / ring, np.zeros_like(px), -px / ring], axis=-1)
    uv = np.stack([_around(px, pz), 0.5 + np.arcsin(np.clip(py, -1.0, 1.0)) / np.pi], axis=-1)
    return visible, normal, tangent, uv, visible


def _around(x: FloatArray, z: FloatArray) -> FloatArray:
    """Place around the axis: 0 to 1 over the front half, and again over the back."""
    found = 0.5 + np.arctan2(x, z) / np.pi
    return np.asarray(found - np.floor(found))


def _rays(scene: Scene, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(…, 3) points on the rays of the pixels, and the direction to the eye (3,), in the frame of the print."""
    return np.stack([x, y, np.zeros_like(x)], axis=-1) @ scene.turn, scene.turn[2]


def _cylinder(scene: Scene, x: FloatArray, y: FloatArray) -> _Found:
    radius, half = cylinder_size(scene.aspect)
    start, eye = _rays(scene, x, y)
    a = eye[0] ** 2 + eye[2] ** 2
    b = start[..., 0] * eye[0] + start[..., 2] * eye[2]
    root = b**2 - a * (start[..., 0] ** 2 + start[..., 2] ** 2 - radius**2)
    near = (-b + np.sqrt(np.maximum(root, 0.0))) / a
    far = (-b - np.sqrt(np.maximum(root, 0.0))) / a
    outer = np.abs(start[..., 1] + near * eye[1]) <= half
    point = start + np.where(outer, near, far)[..., None] * eye
    visible = (root > 0.0) & (a > 1e-12) & (np.abs(point[..., 1]) <= half)
    px, pz = point[..., 0] / radius, point[..., 2] / radius
    nothing = np.zeros_like(px)
    normal = np.stack([px, nothing, pz], axis=-1) * np.where(outer, 1.0, -1.0)[..., None]
    uv = np.stack([_around(px, pz), 0.5 + 0.5 * point[..., 1] / half], axis=-1)
    return visible, normal, np.stack([pz, nothing, -px], axis=-1), uv, outer


def _plane(scene: Scene, x: FloatArray, y: FloatArray) -> _Found:
    wide, high = plane_size(scene.aspect)
    start, eye = _rays(scene, x, y)
    point = start - (start[..., 2] / eye[2])[..., None] * eye
    visible = (np.abs(point[..., 0]) <= wide) & (np.abs(point[..., 1]) <= high) & (abs(eye[2]) > 1e-6)
    uv = np.stack([0.5 + 0.5 * point[..., 0] / wide, 0.5 + 0.5 * point[..., 1] / high], axis=-1)
    side = 1.0 if eye[2] > 0.0 else -1.0
    normal = np.broadcast_to([0.0, 0.0, side], point.shape)
    return (
        visible,
        normal,
        np.broadcast_to([1.0, 0.0, 0.0], point.shape),
        uv,
        np.full(visible.shape, side > 0.0),
    )


_SHAPES = {"sphere": _sphere, "cylinder": _cylinder, "plane": _plane}


def _of_mesh(scene: Scene, mesh: Mesh, rows: int, cols: int) -> Surface:
    from anisoscope.sim.proof.kernels import draw  # noqa: PLC0415 - loads the compiler

    eye = mesh.position @ scene.turn.T
    scale = 0.5 * scene.fill * min(rows, cols)
    point = np.stack([0.5 * cols + scale * eye[:, 0], 0.5 * rows - scale * eye[:, 1], eye[:, 2]], axis=-1)
    vertex = np.concatenate([mesh.normal, mesh.tangent, mesh.uv], axis=1)
    found = np.zeros((rows, cols, 9))
    depth = np.full((rows, cols), -np.inf)
    draw(np.ascontiguousarray(point), vertex, mesh.triangles, depth, found)
    side = found[..., 8:]
    normal = found[..., :3] / np.maximum(np.linalg.norm(found[..., :3], axis=-1, keepdims=True), 1e-12) * side
    tangent = found[..., 3:6] - np.sum(found[..., 3:6] * normal, axis=-1, keepdims=True) * normal
    tangent /= np.maximum(np.linalg.norm(tangent, axis=-1, keepdims=True), 1e-12)
    uv = np.where(side > 0.0, found[..., 6:8] - np.floor(found[..., 6:8]), np.nan)
    return _finished(scene, depth > -np.inf, normal, tangent, uv)


def printed(where: Surface, print_: npt.NDArray[np.generic]) -> Float32:
    """(rows, cols, 3) coverages at the pixels of a surface: those of the nearest dot, 0 on bare paper.

    Args:
        where: the surface.
        print_: (dot rows, dot columns, 3) coverages, first row at the top of the print.
    """
    rows, cols = print_.shape[:2]
    u, v = np.moveaxis(where.uv, -1, 0)
    known = np.isfinite(u) & np.isfinite(v)
    c = np.clip(np.where(known, u, 0.0) * cols, 0, cols - 1).astype(np.intp)
    r = np.clip((1.0 - np.where(known, v, 0.0)) * rows, 0, rows - 1).astype(np.intp)
    return np.asarray(np.where(known[..., None], print_[r, c], 0.0), dtype=np.float32)
