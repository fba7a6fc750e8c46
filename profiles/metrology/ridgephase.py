"""Pitch and direction from where every ridge stands, tile by tile, against the median ridge."""

from dataclasses import dataclass, replace

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.profiles.metrology import ridgekernels as kernels
from anisoscope.profiles.metrology.quantity import Quantity, jackknife
from anisoscope.profiles.metrology.ridgefold import Course, Folded, Grid

LEAST_INFORMATION = 0.05
WALL_ROWS = 64
CLIP = 4.0


@dataclass(frozen=True)
class Positions:
    """Where the ridges stand.

    Attributes:
        course: the course after correction.
        pitch_um: its pitch.
        direction_deg: its direction.
        shift_um: (ridges,) distance of every wall from its place in the course, NaN where unknown.
        shift_u_um: (ridges,) standard uncertainties, from the scatter along the ridge.
    """

    course: Course
    pitch_um: Quantity
    direction_deg: Quantity
    shift_um: FloatArray
    shift_u_um: FloatArray


def _shifts(sums: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """(ridges, tiles) shift of every tile in µm with its height left free, its information, and its place q and v.

    On the facet alone, height and shift cannot be told apart, nor pitch and tilt; what counts is the wall.
    """
    w, s, ss, e, es, q, v = (sums[..., n] for n in range(7))
    with np.errstate(divide="ignore", invalid="ignore"):
        information = np.nan_to_num(ss - s * s / w)
        information = np.asarray(np.where(information < 1e-6 * ss, 0.0, information), dtype=np.float64)
        shift = np.nan_to_num((e * s / w - es) / information, posinf=0.0, neginf=0.0)
        return shift, information, np.nan_to_num(q / ss), np.nan_to_num(v / ss)


def _normal(weight: FloatArray, design: FloatArray) -> FloatArray:
    """(ridges, 3, 4) normal equations of a plane through shifts, one for each ridge, from (ridges, tiles, 4) rows."""
    found: FloatArray = np.einsum("km,kma,kmb->kab", weight, design[..., :3], design)
    return found


def _solve(normal: FloatArray) -> FloatArray:
    """(3,) shift, and its change by q and by v, from the (3, 4) normal equations."""
    return np.asarray(np.linalg.lstsq(normal[:, :3], normal[:, 3], rcond=None)[0], dtype=np.float64)


def refine(grid: Grid, course: Course, folded: Folded, wall_um: float) -> Positions:
    """Correct pitch, direction and offset of a course by the positions of its ridges.

    Each tile (a ridge times a twelfth of the field along it) is shifted against the median ridge by weighted least
    squares; a plane through the shifts gives the corrections. Uncertainties: by leaving out one ridge after the
    other, and what the pixel grid hides: walls narrower than the largest gap between the places at which they
    are sampled may stand anywhere within that gap.

    Args:
        grid: levelled heights.
        course: where the ridges are, to a fraction of a pixel.
        folded: the median ridge there.
        wall_um: width of the wall, 0 if unknown.
    """
    frame = course.frame(grid, folded.shift)
    step = course.step_um(grid.pixel)
    slope = (
        np.gradient(np.pad(folded.height_um, 1, mode="wrap"))[1:-1] * folded.height_um.size / course.pitch_um
    )
    # equal weights on both sides of the wall: what differs from bin to bin there is where the grid happens to sample it
    steepest = np.max(np.abs([np.roll(slope, k) for k in (-1, 0, 1)]), axis=0)
    least = (
        0.1 * step * float(np.median(np.abs(slope)))
    )  # else a smooth surface a little out of place is no match
    spread = np.hypot(max(float(np.median(folded.spread_um)), least), steepest * step / np.sqrt(12.0))
    sums = kernels.phase_sums(grid.z, grid.out, frame, folded.height_um, spread)
    shift, information, q, v = _shifts(sums)
    good = information > LEAST_INFORMATION * information.max()
    middle_q, middle_v = float(np.mean(q[good])), 0.5 * frame.tile * frame.tiles
    design = np.stack([np.ones_like(q), (q - middle_q) * course.pitch_um, v - middle_v, shift], axis=-1)
    first = _normal(information * good, design)
    away = np.abs(shift - design[..., :3] @ _solve(first.sum(axis=0)))
    good &= away <= max(CLIP * 1.4826 * float(np.median(away[good])), 0.1 * step)
    weight = information * good
    parts = _normal(weight, design)
    left = shift - design[..., :3] @ _solve(parts.sum(axis=0))
    used = parts[:, 0, 0] > LEAST_INFORMATION * parts[:, 0, 0].max()
    (start, by_r, by_v), u = jackknife(parts[used], _solve, parts[used, 0, 0], fitted=2)
    dead = max(0.0, _gap(grid, course) - wall_um) / np.sqrt(6.0)
    turn = np.hypot(u[2], dead / (frame.tile * frame.tiles))
    stretch = np.hypot(u[1] * course.pitch_um, dead / max(int(used.sum()) - 1, 1))
    corrected = _corrected(
        course, start - by_r * middle_q * course.pitch_um - by_v * (middle_v + frame.v0), by_r, by_v
    )
    with np.errstate(invalid="ignore", divide="ignore"):
        size = np.where(used, weight.sum(axis=1), np.nan)
        mean = (weight * left).sum(axis=1) / size
        scatter = (weight * (left - mean[:, None]) ** 2).sum(axis=1) / size
        count = np.count_nonzero(weight, axis=1)
        error = np.sqrt(scatter / np.maximum(count - 1, 1))
    return Positions(
        corrected,
        Quantity(corrected.pitch_um, float(stretch)),
        Quantity(corrected.direction_deg, float(np.degrees(turn))),
        mean,
        np.where(count > 2, error, np.nan),
    )


def _corrected(course: Course, start: float, by_r: float, by_v: float) -> Course:
    """The course whose walls stand ``start`` + ``by_r``·(q·pitch) + ``by_v``·v µm further."""
    ex, ey = course.downhill()
    fx = ((1.0 - by_r) * ex + by_v * ey) / course.pitch_um
    fy = ((1.0 - by_r) * ey - by_v * ex) / course.pitch_um
    # q counts from the offset: q = f·x − offset, and shifts were fitted over q, not over f·x
    offset = course.offset * (1.0 - by_r) + start / course.pitch_um
    size = float(np.hypot(fx, fy))
    angle = float(np.degrees(np.arctan2(course.lean * fy, course.lean * fx)))
    lean, offset = course.lean, float(offset)
    if not -90.0 < angle <= 90.0:
        angle, lean = angle - np.copysign(180.0, angle), -lean
    return replace(course, pitch_um=1.0 / size, direction_deg=angle, offset=offset, lean=lean)


def _gap(grid: Grid, course: Course) -> float:
    """Largest gap in µm between the places, a pixel about the walls, at which the map samples them."""
    frame, step = course.frame(grid), course.step_um(grid.pixel)
    rows, cols = grid.z.shape
    i = np.arange(0, rows, max(1, rows // WALL_ROWS)) if abs(frame.qj) >= abs(frame.qi) else np.arange(rows)
    j = np.arange(cols) if abs(frame.qj) >= abs(frame.qi) else np.arange(0, cols, max(1, cols // WALL_ROWS))
    q = np.add.outer(i * frame.qi, j * frame.qj) - frame.q0
    from_wall = (q - np.rint(q)).ravel() * course.pitch_um
    near = np.sort(from_wall[np.abs(from_wall) <= step])
    return float(np.diff(near).max()) if near.size > 1 else 2.0 * step
