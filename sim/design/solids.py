"""Bodies of plates: the part and its mould insert as closed triangle meshes, written as STL.

A field is the lower envelope of its ridges and of four planes that rise from the inner edge of its land with the draft
of the walls (`anisoscope.profiles.plates`). All are planes between the lines of the ridges, so that a field is a set of
convex polygons, the same for all fields of a class. The lands are level, and their outer edges straight: fields of any
two classes meet without a gap. A rounded crest is as many chords as `anisoscope.parameters.ridge_outline` asks for.

The insert is what the part leaves in its mould: mirrored along x, and solid where the part is air.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Literal

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import HeightMapError, UsageError
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.profiles.files.images import STL_HEADER_BYTES, TRIANGLE
from anisoscope.profiles.plates import FLAT, LAND_SHARE, Plan
from anisoscope.sim.light.ridge_profile import ridge_polyline

Side = Literal["part", "insert"]
MOST_TRIANGLES = 50_000_000
"""Of an STL: 2.5 GB."""
BLOCK_TRIANGLES = 500_000
WELD_UM = 1e-6


@dataclass(frozen=True, eq=False)
class Body:
    """A plate on a base.

    Attributes:
        plan: its fields.
        design: their ridges.
        base_um: thickness of the base below the lowest level.
    """

    plan: Plan
    design: RidgeDesign
    base_um: float

    @property
    def side_um(self) -> float:
        """Side of a field."""
        return 1000.0 * self.plan.module_mm

    @cached_property
    def tiles(self) -> dict[str, FloatArray]:
        """(T, 3, 3) triangles of a field of each class in µm, about its middle, counter-clockwise seen from above.

        Raises:
            UsageError: walls without draft.
        """
        used = {letter for row in self.plan.rows for letter in row}
        found = {}
        for letter in used:
            if letter == FLAT:
                level = 0.5 * self.design.height_um
                profile = np.array([0.0, self.design.pitch_um]), np.array([level, level])
                found[letter] = field_triangles(profile, self.design.draft_rad, self.side_um, 0.0)
                continue
            design = self.plan.design_of(letter, self.design)
            azimuth = self.plan.azimuths_deg[letter]
            found[letter] = field_triangles(ridge_polyline(design), design.draft_rad, self.side_um, azimuth)
        return found

    def fields(self, letter: str) -> FloatArray:
        """(F, 2) columns and rows of the fields of a class, rows from the bottom."""
        grid = np.array([list(row) for row in reversed(self.plan.rows)])
        row, col = np.nonzero(grid == letter)
        return np.stack([col, row], axis=1).astype(np.float64)

    @cached_property
    def triangle_count(self) -> int:
        """Triangles of the closed body."""
        rows, cols = self.plan.shape
        top = sum(len(tile) * len(self.fields(letter)) for letter, tile in self.tiles.items())
        return top + 2 * (rows + cols) + 4 + 2


def field_triangles(
    profile_um: tuple[FloatArray, FloatArray], draft_rad: float, side_um: float, azimuth_deg: float
) -> FloatArray:
    """(T, 3, 3) triangles of a field about its middle in µm: ridges, drafted border and land.

    Args:
        profile_um: x and z (K + 1,) of one period of the ridges, as of `ridge_polyline`.
        draft_rad: of the border, from the vertical.
        side_um: side of the field.
        azimuth_deg: toward which the facets fall.

    Raises:
        UsageError: no draft.
    """
    if draft_rad <= 0.0:
        raise UsageError("the border of a field needs a draft: give walls with --draft 1 or more")
    half, inner = 0.5 * side_um, (0.5 - LAND_SHARE) * side_um
    steep = 1.0 / np.tan(draft_rad)
    turn = np.radians(azimuth_deg)
    cos, sin = round(float(np.cos(turn)), 15), round(float(np.sin(turn)), 15)
    # planes (a, b, c): a·x + b·y + c
    border = [steep * np.array(one) for one in ((-1, 0, inner), (1, 0, inner), (0, -1, inner), (0, 1, inner))]
    square = np.array([[-inner, -inner], [inner, -inner], [inner, inner], [-inner, inner]])
    x, z = profile_um
    period, reach = float(x[-1] - x[0]), inner * (abs(cos) + abs(sin))
    polygons = []
    for turn_number in range(
        int(np.floor((half - reach - x[-1]) / period)), int(np.ceil((half + reach - x[0]) / period)) + 1
    ):
        for first in range(len(x) - 1):
            low, high = x[first] + turn_number * period, x[first + 1] + turn_number * period
            if high - low <= WELD_UM:
                continue
            slope = (z[first + 1] - z[first]) / (high - low)
            ridge = np.array([slope * cos, slope * sin, z[first] + slope * (half - low)])
            slab = _clipped(square, np.array([cos, sin, half - low]))
            slab = _clipped(slab, np.array([-cos, -sin, high - half]))
            planes = [ridge, *border]
            for number, plane in enumerate(planes):
                part = slab
                for other in (*planes[:number], *planes[number + 1 :]):
                    part = _clipped(part, other - plane)
                if len(part) >= 3:
                    polygons.append(np.column_stack([part, part @ plane[:2] + plane[2]]))
    return _welded(polygons, half, inner)


def _clipped(polygon: FloatArray, plane: FloatArray) -> FloatArray:
    """The part of a convex polygon (N, 2) on which a·x + b·y + c ≥ 0."""
    if len(polygon) < 3:
        return polygon[:0]
    value = polygon @ plane[:2] + plane[2]
    value = np.where(np.abs(value) < 1e-9, 0.0, value)
    points = []
    for one, (here, there) in enumerate(zip(value, np.roll(value, -1), strict=True)):
        if here >= 0.0:
            points.append(polygon[one])
        if here * there < 0.0:
            share = here / (here - there)
            points.append(polygon[one] + share * (polygon[(one + 1) % len(polygon)] - polygon[one]))
    return np.array(points).reshape(-1, 2)


def _welded(polygons: list[FloatArray], half: float, inner: float) -> FloatArray:
    """Triangles of polygons (N, 3) whose common corners are one point each, and of the land around them."""
    corners = np.concatenate(polygons)
    rounded = np.round(corners / WELD_UM).astype(np.int64)
    _, number = np.unique(rounded[:, :2], axis=0, return_inverse=True)
    number = number.ravel()
    points = np.empty((number.max() + 1, 3))
    points[number] = corners
    triangles, start = [], 0
    for one in polygons:
        ring = number[start : start + len(one)]
        start += len(one)
        ring = ring[ring != np.roll(ring, 1)]
        triangles += [(ring[0], ring[k], ring[k + 1]) for k in range(1, len(ring) - 1)]
    top = points[np.array(triangles)]
    return np.concatenate([top, _land(points, half, inner)])


def _land(points: FloatArray, half: float, inner: float) -> FloatArray:
    """(T, 3, 3) triangles of the level land between the points on the inner square and the outer corners."""
    found = []
    for axis, sign in ((1, -1.0), (0, 1.0), (1, 1.0), (0, -1.0)):
        along = 1 - axis
        on = points[np.abs(points[:, axis] - sign * inner) < WELD_UM]
        # counter-clockwise about the middle: +x at the bottom, +y on the right, −x at the top, −y on the left
        forward = -sign if axis == 1 else sign
        on = on[np.argsort(forward * on[:, along])]
        ends = np.zeros((2, 3))
        ends[:, axis], ends[:, along] = sign * half, (-forward * half, forward * half)
        found += [(ends[0], on[k + 1], on[k]) for k in range(len(on) - 1)]
        found.append((ends[0], ends[1], on[-1]))
    return np.array(found)


def _closed(body: Body, depth_um: float) -> FloatArray:
    """(T, 3, 3) sides and bottom of a body in µm, whose upper edge is at 0."""
    rows, cols = body.plan.shape
    width, length = cols * body.side_um, rows * body.side_um
    corner = np.array([[0.0, 0.0], [width, 0.0], [width, length], [0.0, length]])
    found = []
    for number, count in enumerate((cols, rows, cols, rows)):
        first, last = corner[number], corner[(number + 1) % 4]
        steps = np.arange(count + 1.0)[:, None] * body.side_um  # the same numbers as those of the fields
        along = (
            first + np.sign(last - first) * steps
            if number < 2
            else last + np.sign(first - last) * steps[::-1]
        )
        top = np.column_stack([along, np.zeros(count + 1)])
        low, end = np.append(first, -depth_um), np.append(last, -depth_um)
        found += [(low, top[k + 1], top[k]) for k in range(count)]
        found.append((low, end, top[-1]))
    floor = np.column_stack([corner, np.full(4, -depth_um)])
    found += [(floor[0], floor[2], floor[1]), (floor[0], floor[3], floor[2])]
    return np.array(found)


def _surface(body: Body, side: Side) -> Iterator[FloatArray]:
    """Blocks (T, 3, 3) of triangles of the surface in µm."""
    width = body.plan.shape[1] * body.side_um
    for letter, tile in body.tiles.items():
        places = body.fields(letter)
        step = max(1, BLOCK_TRIANGLES // len(tile))
        for start in range(0, len(places), step):
            middle = (places[start : start + step] + 0.5) * body.side_um
            block = np.empty((len(middle), *tile.shape))
            block[...] = tile
            block[..., :2] += middle[:, None, None, :]
            block = block.reshape(-1, 3, 3)
            if side == "insert":
                block[..., 0] = width - block[..., 0]
                block[..., 2] *= -1.0
                block = block[:, ::-1]
            yield block


def write_body(body: Body, path: Path, side: Side) -> None:
    """Write a plate or its mould insert as a binary STL in mm, block by block.

    Raises:
        UsageError: too many triangles, or walls without draft.
        HeightMapError: the file cannot be written.
    """
    if body.triangle_count > MOST_TRIANGLES:
        raise UsageError(
            f"a body of {body.triangle_count / 1e6:.0f} million triangles is too large (at most "
            f"{MOST_TRIANGLES // 10**6}): take fewer fields, or leave --stl out"
        )
    highest = max(float(one[..., 2].max()) for one in body.tiles.values())
    depth = body.base_um + (highest if side == "insert" else 0.0)
    partial = path.with_name(f".{path.name}.partial")
    try:
        with partial.open("wb") as stream:
            stream.write(f"{side} of a plate of ridges, unit mm".encode().ljust(STL_HEADER_BYTES))
            stream.write(np.uint32(body.triangle_count).astype("<u4").tobytes())
            for block in _surface(body, side):
                stream.write(_records(block).tobytes())
            stream.write(_records(_closed(body, depth)).tobytes())
        partial.replace(path)
    except OSError as error:
        raise HeightMapError(f"{path}: cannot be written ({error.strerror})") from None
    finally:
        partial.unlink(missing_ok=True)


def _records(triangles_um: FloatArray) -> npt.NDArray[np.void]:
    corners = 1e-3 * triangles_um
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    records = np.zeros(len(corners), TRIANGLE)
    records["normal"] = normal / np.linalg.norm(normal, axis=1, keepdims=True)
    records["corners"] = corners
    return records
