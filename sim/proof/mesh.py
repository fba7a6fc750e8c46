"""Meshes from Wavefront OBJ files: triangles with normals, tangents and places on the print."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import UsageError
from anisoscope.base.regular_file import MOST_PICTURE_BYTES, bounded_bytes

IntArray = npt.NDArray[np.int64]

MOST_TRIANGLES = 500_000


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles about the origin, within a unit sphere.

    Attributes:
        position: (V, 3).
        normal: (V, 3) unit.
        tangent: (V, 3) unit, along rising u.
        uv: (V, 2) places on the print.
        triangles: (T, 3) numbers of vertices, counter-clockwise seen from outside.
        notes: what was made up, because the file does not have it.
    """

    position: FloatArray
    normal: FloatArray
    tangent: FloatArray
    uv: FloatArray
    triangles: IntArray
    notes: tuple[str, ...]


@dataclass
class _Text:
    """Parsed lines of a file: numbers as written, corners as (position, uv, normal), −1 for none."""

    path: Path
    position: list[tuple[float, ...]] = field(default_factory=list)
    uv: list[tuple[float, ...]] = field(default_factory=list)
    normal: list[tuple[float, ...]] = field(default_factory=list)
    corners: list[tuple[int, int, int]] = field(default_factory=list)

    def fail(self, line: int, problem: str) -> UsageError:
        return UsageError(f"{self.path}, line {line}: {problem}")

    def numbers(self, line: int, words: Sequence[str], count: int) -> tuple[float, ...]:
        try:
            found = tuple(float(word) for word in words[:count])
        except ValueError:
            raise self.fail(line, f"{' '.join(words)!r} are not numbers") from None
        if len(found) < count or not all(math.isfinite(value) for value in found):
            raise self.fail(line, f"{count} finite numbers are needed, found {' '.join(words)!r}")
        return found

    def corner(self, line: int, word: str) -> tuple[int, int, int]:
        parts = [*word.split("/"), "", ""][:3]
        found = []
        for part, known, what in zip(
            parts, (self.position, self.uv, self.normal), ("vertex", "texture point", "normal"), strict=True
        ):
            if not part and what != "vertex":
                found.append(-1)
                continue
            try:
                number = int(part)
            except ValueError:
                raise self.fail(
                    line, f"{word!r} is no corner of a face; write v, v/vt, v//vn or v/vt/vn"
                ) from None
            index = number - 1 if number > 0 else len(known) + number
            if number == 0 or not 0 <= index < len(known):
                raise self.fail(line, f"{what} {number} does not exist; {len(known)} are given so far")
            found.append(index)
        return found[0], found[1], found[2]

    def face(self, line: int, words: Sequence[str]) -> None:
        if len(words) < 3:
            raise self.fail(line, "a face needs three corners or more")
        corners = [self.corner(line, word) for word in words]
        for second, third in pairwise(corners[1:]):
            self.corners += [corners[0], second, third]
        if len(self.corners) > 3 * MOST_TRIANGLES:
            raise self.fail(line, f"more than {MOST_TRIANGLES:,} triangles: reduce the mesh")


def read_obj(path: Path) -> Mesh:
    """Read the faces of an OBJ file, moved and scaled into the unit sphere; polygons are cut into fans of triangles.

    Missing normals are averaged from the faces, missing texture points are projected along z. Materials, groups and
    curves are passed over.

    Raises:
        UsageError: no such file, a line that cannot be used, or no faces.
    """
    try:
        lines = bounded_bytes(path, MOST_PICTURE_BYTES).decode("utf-8", "replace").splitlines()
    except OSError as problem:
        raise UsageError(f"{path}: cannot be read: {problem.strerror}") from None
    text = _Text(path)
    rest = ""
    for number, raw in enumerate(lines, 1):
        line = rest + raw.split("#", 1)[0].strip()
        if line.endswith("\\"):
            rest = line[:-1] + " "
            continue
        rest = ""
        kind, *words = line.split() or [""]
        if kind == "v":
            text.position.append(text.numbers(number, words, 3))
        elif kind == "vt":
            text.uv.append(text.numbers(number, words, 2))
        elif kind == "vn":
            text.normal.append(text.numbers(number, words, 3))
        elif kind == "f":
            text.face(number, words)
    if not text.corners:
        raise UsageError(f"{path}: no faces (lines 'f …') are found: is it an OBJ mesh?")
    return _mesh(text)


def _mesh(text: _Text) -> Mesh:
    corners, inverse = np.unique(np.array(text.corners), axis=0, return_inverse=True)
    triangles = inverse.reshape(-1, 3)
    position = np.array(text.position)[corners[:, 0]]
    low, high = position.min(axis=0), position.max(axis=0)
    position = position - 0.5 * (low + high)
    radius = float(np.linalg.norm(position, axis=1).max())
    if radius <= 0.0:
        raise UsageError(f"{text.path}: all corners of the mesh lie in one point")
    position = position / radius
    notes = []
    normal = _averaged(position, triangles, corners[:, 0])
    if np.all(corners[:, 2] >= 0):
        given = np.array(text.normal)[corners[:, 2]]
        length = np.linalg.norm(given, axis=1, keepdims=True)
        normal = np.where(length > 1e-9, given / np.maximum(length, 1e-9), normal)
    else:
        notes.append("the mesh has no normals: they are averaged from its faces")
    if np.all(corners[:, 1] >= 0):
        uv = np.array(text.uv)[corners[:, 1]]
    else:
        span = np.maximum(np.ptp(position[:, :2], axis=0).max(), 1e-9)
        uv = position[:, :2] / span + 0.5
        notes.append("the mesh has no texture points: the print is projected along z")
    return Mesh(position, normal, _tangents(position, normal, uv, triangles), uv, triangles, tuple(notes))


def _averaged(position: FloatArray, triangles: IntArray, points: IntArray) -> FloatArray:
    """(V, 3) mean of the normals of the faces about a point, weighed by their areas."""
    a, b, c = (position[triangles[:, n]] for n in range(3))
    area = np.cross(b - a, c - a)
    total = np.zeros((int(points.max()) + 1, 3))
    for n in range(3):
        np.add.at(total, points[triangles[:, n]], area)
    found = total[points]
    length = np.linalg.norm(found, axis=1, keepdims=True)
    return np.asarray(np.where(length > 1e-12, found / np.maximum(length, 1e-12), [0.0, 0.0, 1.0]))


def _tangents(position: FloatArray, normal: FloatArray, uv: FloatArray, triangles: IntArray) -> FloatArray:
    """(V, 3) unit vectors along rising u, at right angles to the normals (Lengyel 2001)."""
    a, b, c = (triangles[:, n] for n in range(3))
    first, second = position[b] - position[a], position[c] - position[a]
    (s1, t1), (s2, t2) = (uv[b] - uv[a]).T, (uv[c] - uv[a]).T
    area = s1 * t2 - s2 * t1
    along = (first * t2[:, None] - second * t1[:, None]) * np.sign(area)[:, None]
    total = np.zeros_like(position)
    for corner in (a, b, c):
        np.add.at(total, corner, along)
    total -= np.sum(total * normal, axis=1, keepdims=True) * normal
    spare = np.cross([0.0, 1.0, 0.0], normal)
    spare = np.where(np.linalg.norm(spare, axis=1, keepdims=True) > 1e-6, spare, [1.0, 0.0, 0.0])
    length = np.linalg.norm(total, axis=1, keepdims=True)
    found = np.where(length > 1e-9, total, spare)
    return np.asarray(found / np.linalg.norm(found, axis=1, keepdims=True))
