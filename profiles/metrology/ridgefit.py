"""Planes through the facets of all ridges: ridge angle, and what differs from ridge to ridge.

Roughness of the facets: Beckmann's α along and across the ridges, without the noise of the instrument.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import HeightMapError
from anisoscope.profiles.heightmap import sampled
from anisoscope.profiles.metrology import ridgekernels as kernels
from anisoscope.profiles.metrology.quantity import Quantity, jackknife, weighted_mean
from anisoscope.profiles.metrology.ridgefold import Course, Facet, Folded, Grid
from anisoscope.profiles.metrology.ridgekernels import Frame, Mask
from anisoscope.profiles.metrology.ridgemeasurement import Segment
from anisoscope.profiles.metrology.ridgesums import noise_sums, structure_sums

SAMPLES = 60_000
CLIP = 3.5
CLIPPED_VARIANCE = 0.9937  # of a normal distribution, within ±3.5 standard deviations of it
PASSES = 3
LEAST_WEIGHT = 0.15
LEAST_POINTS = 50
MIN_RIDGES = 3
ENDS = 0.1
EIGHTHS = 8
LEAST_TILE = 0.3


@dataclass(frozen=True)
class Planes:
    """Planes of the facets, s across and v along in µm from the middle of the facet and of the map.

    Attributes:
        planes: (ridges, 3) height in µm, slope across, slope along; NaN for ridges that the map holds too little of.
        mean: (3,) the mean facet: height, slope across (below 0), 0.
        sigma_um: (ridges,) standard deviation of the heights about the plane.
        weight: (ridges,) information on the slope across; 0 for ridges not fitted.
        points: (ridges,) number of points used.
        sums: (ridges, tiles, 10) what the planes were fitted to.
        tilt_across: slope across of the plane through equal places of all ridges.
        tilt_along: slope along of that plane.
    """

    planes: FloatArray
    mean: FloatArray
    sigma_um: FloatArray
    weight: FloatArray
    points: FloatArray
    sums: FloatArray
    tilt_across: float
    tilt_along: float

    @property
    def fitted(self) -> Mask:
        """(ridges,) which ridges have a plane."""
        return self.weight > 0.0


def _normal(sums: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(..., 3, 3) and (..., 3) normal equations of planes."""
    n, s, v, ss, sv, vv, z, zs, zv = np.moveaxis(sums[..., :9], -1, 0)
    matrix = np.stack([np.stack([n, s, v], -1), np.stack([s, ss, sv], -1), np.stack([v, sv, vv], -1)], -2)
    return matrix, np.stack([z, zs, zv], -1)


def _information(matrix: FloatArray) -> FloatArray:
    """(...) information on the slope across, after height and slope along have been fitted too."""
    a = np.stack([matrix[..., 0, 0], matrix[..., 0, 2], matrix[..., 2, 0], matrix[..., 2, 2]], -1)
    determinant = a[..., 0] * a[..., 3] - a[..., 1] * a[..., 2]
    x, y = matrix[..., 0, 1], matrix[..., 1, 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        lost = (a[..., 3] * x * x - 2.0 * a[..., 1] * x * y + a[..., 0] * y * y) / determinant
        found = matrix[..., 1, 1] - lost
    return np.where(determinant > 1e-6 * a[..., 0] * a[..., 3], found, 0.0)


def _solve(sums: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(..., 3) planes and (...) information; information 0 and NaN planes where nothing can be fitted."""
    matrix, right = _normal(sums)
    information = _information(matrix)
    enough = (information > 1e-9 * matrix[..., 1, 1]) & (matrix[..., 0, 0] >= LEAST_POINTS)
    planes = np.full(right.shape, np.nan)
    planes[enough] = np.linalg.solve(matrix[enough], right[enough][..., None])[..., 0]
    return planes, np.where(enough, information, 0.0)


def _start(
    grid: Grid, frame: Frame, facet: Facet, line: tuple[float, float]
) -> tuple[FloatArray, FloatArray]:
    """Planes as steep as the median facet, each at the median height of its ridge; and (ridges,) spread about it."""
    known = sampled(np.isfinite(grid.z) & ~grid.out, SAMPLES)
    i, j = np.divmod(known, grid.z.shape[1])
    q = i * frame.qi + j * frame.qj - frame.q0
    whole = np.floor(q)
    place = q - whole
    on = (place >= facet.begin) & (place <= facet.end)
    above = grid.z.ravel()[known[on]] - line[0] - line[1] * (place[on] - facet.middle) * frame.pitch
    ridge = whole[on].astype(np.intp) - frame.first
    planes, spread = np.zeros((frame.ridges, 3)), np.full(frame.ridges, np.inf)
    planes[:, 1] = line[1]
    for k in range(frame.ridges):
        here = above[ridge == k]
        if here.size:
            middle = float(np.median(here))
            planes[k, 0] = line[0] + middle
            spread[k] = 1.4826 * float(np.median(np.abs(here - middle)))
    return planes, spread


def facet_line(folded: Folded, facet: Facet, pitch_um: float) -> tuple[float, float]:
    """Height at the middle of the median facet, and its slope across."""
    place = (np.arange(folded.height_um.size) + folded.shift) / folded.height_um.size
    on = (place >= facet.begin) & (place <= facet.end)
    slope, height = np.polyfit((place[on] - facet.middle) * pitch_um, folded.height_um[on], 1)
    return float(height), float(slope)


def fit_planes(
    grid: Grid, course: Course, facet: Facet, folded: Folded, earlier: Planes | None = None
) -> Planes:
    """Least-squares planes through the facets, points beyond 3.5 standard deviations left out.

    Args:
        grid: levelled heights.
        course: how the ridges run.
        facet: where their facets lie.
        folded: the median ridge.
        earlier: planes to begin with, if there are some: then one pass does.

    Raises:
        HeightMapError: fewer than three ridges can be fitted.
    """
    frame = course.frame(grid)
    span = (facet.begin, facet.end)
    if earlier is None:
        planes, sigma = _start(grid, frame, facet, facet_line(folded, facet, course.pitch_um))
    else:
        planes, sigma = earlier.planes, np.where(earlier.fitted, earlier.sigma_um, np.inf)
    floor = 1e-6 + 1e-3 * float(np.median(folded.spread_um))
    sums = np.zeros((frame.ridges, frame.tiles, 10))
    information, total = np.zeros(frame.ridges), sums[:, 0]
    for number in range(PASSES) if earlier is None else (PASSES,):
        clip = np.where(np.isfinite(sigma), np.maximum(sigma, floor), 0.0) * (CLIP if number else CLIP + 1.0)
        sums = kernels.facet_sums(grid.z, grid.out, frame, span, np.nan_to_num(planes), clip)
        total = sums.sum(axis=1)
        planes, information = _solve(total)
        sigma = _scatter(total, planes)
    good = information > LEAST_WEIGHT * information.max()
    if int(good.sum()) < MIN_RIDGES:
        raise HeightMapError(
            f"only {int(good.sum())} ridges of this height map have enough measured points on their facets; "
            f"at least {MIN_RIDGES} are needed"
        )
    planes[~good] = np.nan
    weight = np.where(good, information, 0.0)
    parts = _across_parts(planes, weight, course.pitch_um)[good]
    tilt = float(_angle_and_tilt(parts.sum(axis=0))[1])
    along = float(weight[good] @ planes[good, 2] / weight.sum())
    mean = np.array(
        [weighted_mean(planes[good, 0], weight[good]).value, *_mean_slope(planes[good], weight[good])]
    )
    return Planes(planes, mean, sigma, weight, total[:, 0], sums, tilt, along)


def _mean_slope(planes: FloatArray, weight: FloatArray) -> tuple[float, float]:
    return float(weight @ planes[:, 1] / weight.sum()), float(weight @ planes[:, 2] / weight.sum())


def _scatter(sums: FloatArray, planes: FloatArray) -> FloatArray:
    """(ridges,) standard deviation about the planes."""
    matrix, right = _normal(sums)
    left = sums[:, 9] - 2.0 * np.einsum("ka,ka->k", planes, right)
    left += np.einsum("ka,kab,kb->k", planes, matrix, planes)
    with np.errstate(divide="ignore", invalid="ignore"):
        found: FloatArray = np.sqrt(np.maximum(left, 0.0) / sums[:, 0] / CLIPPED_VARIANCE)
    return found


def _across_parts(planes: FloatArray, weight: FloatArray, pitch_um: float) -> FloatArray:
    """(ridges, 6) sums from which the mean slope and the tilt across follow."""
    r = np.arange(weight.size) * pitch_um
    height, slope = planes[:, 0], planes[:, 1]
    return np.stack(
        [weight, weight * r, weight * r * r, weight * height, weight * r * height, weight * slope], axis=1
    )


def _angle_and_tilt(total: FloatArray) -> FloatArray:
    """(2,) slope of the facets against the plane through equal places of all ridges, and the slope of that plane."""
    w, r, rr, c, rc, a = total
    tilt = (w * rc - r * c) / (w * rr - r * r)
    return np.array([a / w - tilt, tilt])


def slope_of_ends(folded: Folded, facet: Facet, pitch_um: float) -> float:
    """Excess slope of the median facet without a tenth of its width at either end: 0 for a straight one."""
    cut = ENDS * (facet.end - facet.begin)
    inner = facet_line(folded, Facet(facet.begin + cut, facet.end - cut), pitch_um)[1]
    return inner - facet_line(folded, facet, pitch_um)[1]


def slope_of_steps(planes: Planes, facet: Facet, pitch_um: float, rounded_um: float) -> float:
    """Standard uncertainty of the mean slope by heights rounded to steps of ``rounded_um``, the same for all ridges.

    A staircase of steps q on a facet of width w and slope a has lost triangles of q by q/a; of a half one at either
    end, least squares make a slope of 3q²/(4aw²) at most. Roughness σ beneath takes exp(−2π²σ²/q²) of it (Widrow and
    Kollár, Quantization Noise, 2008).
    """
    if rounded_um == 0.0:
        return 0.0
    width, sigma = (facet.end - facet.begin) * pitch_um, float(np.median(planes.sigma_um[planes.fitted]))
    most = 0.75 * rounded_um**2 / (max(abs(float(planes.mean[1])), rounded_um / width) * width**2)
    rough = max(sigma**2 - rounded_um**2 / 12.0, 0.0)
    return most * float(np.exp(-2.0 * np.pi**2 * rough / rounded_um**2))


def facet_bow(folded: Folded, facet: Facet, pitch_um: float) -> float:
    """Bow of the median facet: rms distance of its eighths from its line, as a share of its rise."""
    place = (np.arange(folded.height_um.size) + folded.shift) / folded.height_um.size
    on = (place >= facet.begin) & (place <= facet.end)
    height, slope = facet_line(folded, facet, pitch_um)
    left = folded.height_um[on] - height - slope * (place[on] - facet.middle) * pitch_um
    parts = np.array([float(np.mean(part)) for part in np.array_split(left, EIGHTHS) if part.size])
    return float(np.sqrt(np.mean(parts**2))) / (abs(slope) * (facet.end - facet.begin) * pitch_um)


def slow_slopes(planes: Planes) -> tuple[float, float]:
    """Variances (along, across) of the slopes of whole tiles: what waves longer than a facet add to the roughness."""
    tiles, information = _solve(planes.sums)
    use = (information > LEAST_TILE * information.max()) & planes.fitted[:, None]
    if int(use.sum()) < MIN_RIDGES:
        return 0.0, 0.0
    weight = information[use] / float(information[use].sum())
    slopes = tiles[use][:, 1:]
    across, along = (weight @ (slopes - weight @ slopes) ** 2).tolist()
    return along, across


def ridge_angle(
    planes: Planes, course: Course, removed: float, u_pitch: float, ends: float, rounded: float
) -> Quantity:
    """Mean ridge angle in degrees: between facets and the plane through equal places of the ridges.

    Slopes are turned into angles before they are subtracted, with the slope ``removed`` across by levelling put back.
    Uncertainty: leaving out one ridge after the other, tilt and facets together; equal places are only as equal as
    the pitch is known, and with a relative error of the pitch the slope of the plane through them changes by as much of
    that of the facets; and what the ends of the facets, and rounded heights, change of their slope.

    Args:
        planes: of the facets.
        course: how they run.
        removed: slope across that levelling took off.
        u_pitch: standard uncertainty of the pitch in µm.
        ends: change of slope by the ends, from ``slope_of_ends``.
        rounded: change of slope by rounded heights, from ``slope_of_steps``.
    """
    good = planes.fitted
    parts = _across_parts(planes.planes, planes.weight, course.pitch_um)[good]

    def angle(total: FloatArray) -> FloatArray:
        slope, tilt = _angle_and_tilt(total)
        return np.array([_between(slope + tilt, tilt, removed)])

    value, u = jackknife(parts, angle, planes.weight[good], fitted=2)
    slope = float(np.tan(np.radians(value[0])))
    shared = np.linalg.norm([slope * u_pitch / course.pitch_um, ends, rounded])
    others = np.degrees(shared / (1.0 + slope * slope))
    return Quantity(float(value[0]), float(np.hypot(u[0], others)))


def _between(slope: float, tilt: float, removed: float) -> float:
    """Angle in degrees by which a facet falls against the tilt."""
    return float(np.degrees(np.arctan(tilt + removed) - np.arctan(slope + removed)))


@dataclass(frozen=True)
class Single:
    """One ridge by itself: angle in degrees and the step at its wall in µm, each with its uncertainty."""

    angle_deg: Quantity
    step_um: Quantity


def single_ridges(planes: Planes, course: Course, facet: Facet, removed: float) -> list[Single | None]:
    """Angles and steps of every ridge; uncertainties from the scatter between its tiles.

    The step is the height of the ridge's plane over that of the ridge before it, at the wall between the two.
    """
    tiles, information = _solve(planes.sums)
    information = np.where(information > 0.02 * information.max(), information, 0.0)
    middle = planes.sums[..., 2] / np.maximum(planes.sums[..., 0], 1.0)
    height = tiles[..., 0] + tiles[..., 2] * middle
    above = height - tiles[..., 1] * facet.middle * course.pitch_um
    below = height + tiles[..., 1] * (1.0 - facet.middle) * course.pitch_um
    found: list[Single | None] = []
    for k in range(planes.weight.size):
        use = information[k] > 0
        if planes.weight[k] == 0 or int(use.sum()) < 2:
            found.append(None)
            continue
        error = weighted_mean(tiles[k, use, 1], information[k, use]).u
        angle = _between(float(planes.planes[k, 1]), planes.tilt_across, removed)
        cosine = float(np.cos(np.radians(angle)))
        value = Quantity(angle, float(np.degrees(error * cosine**2)) if error is not None else None)
        found.append(Single(value, _step(above[k], below[k - 1], information[k], information[k - 1], k)))
    return found


def segments_along(planes: Planes, course: Course, grid: Grid, removed: float) -> tuple[Segment, ...]:
    """Ridge angles of lengths along the ridges; uncertainties from the scatter between the ridges there."""
    tiles, information = _solve(planes.sums)
    frame = course.frame(grid)
    found = []
    for k in range(frame.tiles):
        use = (information[:, k] > LEAST_TILE * information.max()) & planes.fitted
        if int(use.sum()) < MIN_RIDGES:
            continue
        slope = weighted_mean(tiles[use, k, 1], information[use, k])
        assert slope.value is not None
        assert slope.u is not None
        angle = _between(slope.value, planes.tilt_across, removed)
        error = float(np.degrees(slope.u) * np.cos(np.radians(angle)) ** 2)
        found.append(Segment((k + 0.5 - 0.5 * frame.tiles) * frame.tile, Quantity(angle, error)))
    return tuple(found)


def _step(above: FloatArray, below: FloatArray, weight: FloatArray, before: FloatArray, k: int) -> Quantity:
    use = (weight > 0) & (before > 0)
    if k == 0 or int(use.sum()) < 2:
        return Quantity(None)
    return weighted_mean(above[use] - below[use], np.minimum(weight, before)[use])


SLOPE_CLIP = 4.0
SLOPE_CLIPPED_VARIANCE = 0.99893  # of a normal distribution, within ±4 standard deviations of it
THIRD = 400.0  # Σ of the squared coefficients of a third difference along both axes
LEAST_WINDOWS = 400
SAMPLED_ROWS = 60
MANY_POINTS = 500_000
COUNTS = 0.02
MOST_DISTINCT = 0.5
LEAST_EQUAL = 0.05
CROSSED = 1.5
LINE_POINTS = 400
LINE_LEAST = 20
OF_LINES = 0.1
OF_LAY = 0.1
LEAST_SHARP = 0.2
OF_SHARPENING = 0.5
LAGS = np.array([(0, 1), (1, 0), (1, 1), (1, -1), (0, 2), (2, 0), (1, 2), (2, 1), (1, -2), (2, -1)])


@dataclass(frozen=True)
class Slopes:
    """Roughness and noise.

    Attributes:
        alpha_along: √2 times the standard deviation of the slope along the ridges.
        alpha_across: the same across them.
        noise_um: standard deviation of the white noise of the heights.
        line_drift_um: rms step from one line of the scan to the next, already taken off; 0 where none counts.
        height_step_um: step of rounded heights where it counts beside the roughness, else 0.
        short_share: share of what looks like noise that is roughness shorter than three pixels, if it counts.
        lay_um: rms step between lines along the ridges, which is not taken off; 0 where it does not count.
    """

    alpha_along: Quantity
    alpha_across: Quantity
    noise_um: Quantity
    line_drift_um: float = 0.0
    height_step_um: float = 0.0
    short_share: float = 0.0
    lay_um: float = 0.0


def _robust(values: FloatArray) -> float:
    known = np.abs(values[np.isfinite(values)])
    return 1.4826 * float(np.median(known)) if known.size else 0.0


def _first_limits(above: FloatArray, owner: npt.NDArray[np.int16]) -> tuple[FloatArray, float]:
    """Clipping limits of the differences at every lag and of the third difference, from a sample of rows."""
    rows = np.unique(np.linspace(0, above.shape[0] - 4, SAMPLED_ROWS).astype(np.intp))
    part = [np.where(owner[rows + k] >= 0, above[rows + k], np.nan) for k in range(4)]
    found = []
    for down, right in LAGS.tolist():
        ahead, start = part[down], part[0]
        if right >= 0:
            found.append(_robust(ahead[:, right:] - start[:, : start.shape[1] - right]))
        else:
            found.append(_robust(ahead[:, :right] - start[:, -right:]))
    third = part[3] - 3.0 * part[2] + 3.0 * part[1] - part[0]
    return SLOPE_CLIP * np.array(found), SLOPE_CLIP * _robust(np.diff(third, n=3, axis=1))


def _interpolation(pixel: tuple[float, float], directions: list[tuple[float, float]]) -> FloatArray:
    """(directions, lags) weights that turn differences at the lags into the variance of the slope over one pixel.

    Mean squared differences D(τ) of a smooth surface are, near 0, a quadratic and a quartic form of the lag. Both are
    fitted with weights τ⁻³, and read at the lag of one pixel in each direction (x, y); along x or y that is nearly
    the value measured there.
    """
    y, x = (LAGS * np.array(pixel)).T
    far = np.hypot(*(LAGS.T)) ** -3.0

    def forms(x: FloatArray, y: FloatArray) -> FloatArray:
        return np.stack([x * x, x * y, y * y, x**4, x**3 * y, x * x * y * y, x * y**3, y**4], axis=-1)

    solve = np.linalg.pinv(forms(x, y) * far[:, None]) * far
    length = np.array([1.0 / np.hypot(ex / pixel[1], ey / pixel[0]) for ex, ey in directions])
    ex, ey = np.array(directions).T
    weights: FloatArray = (forms(ex * length, ey * length) @ solve) / length[:, None] ** 2
    return weights


def measure_slopes(
    above: FloatArray,
    owner: npt.NDArray[np.int16],
    pixel: tuple[float, float],
    course: Course,
    ridges: int,
    slow: tuple[float, float] = (0.0, 0.0),
    rounded_um: float = 0.0,
    sigma_um: float = 0.0,
    blur_um: float = 0.0,
) -> Slopes:
    """Roughness of the facets from height differences over one or two pixels.

    The variance of a slope along u is D(u)/u² at a lag u of one pixel, D the mean squared height difference; for
    ridges that do not run along the grid D is interpolated. Differences beyond four standard deviations are left out.
    White noise of standard deviation σ adds 2σ² to every D. σ comes from the third difference along both axes
    of 4 × 4 points, whose variance is 400 σ²; a surface that is smooth over two or three pixels hardly adds to
    it. Uncertainties: leaving out one ridge after the other, the slopes of waves longer than a facet, and what all
    ridges share: steps between lines of the scan, rounded heights, roughness so short that it looks like noise.

    Args:
        above: (rows, cols) heights over the planes of the facets in µm, NaN where missing or spoiled.
        owner: (rows, cols) ridge of every point, −1 off the facets.
        pixel: (y, x) in µm.
        course: how the ridges run.
        ridges: their number.
        slow: variances (along, across) of the slopes of whole pieces of facets, from ``slow_slopes``.
        rounded_um: step of rounded heights, from ``height_step``; 0 where they are not rounded.
        sigma_um: of the known point spread function, for which α is corrected.
        blur_um: of one that is only suspected, which widens u.
    """
    limit, third = _first_limits(above, owner)
    every = 2 if above.size > MANY_POINTS else 1
    total = structure_sums(above, owner, LAGS, limit, ridges, 8 * every).sum(axis=0)
    if total[:, 0].min() < LEAST_WINDOWS / 8:
        return Slopes(Quantity(None), Quantity(None), Quantity(None))
    better = SLOPE_CLIP * np.sqrt(total[:, 1] / total[:, 0] / SLOPE_CLIPPED_VARIANCE)
    structure = structure_sums(above, owner, LAGS, better, ridges, every)
    noise = noise_sums(above, owner, third, ridges)
    spare = noise.sum(axis=0)
    heard = bool(spare[0] >= LEAST_WINDOWS)
    if heard:
        better_third = SLOPE_CLIP * float(np.sqrt(spare[1] / spare[0] / SLOPE_CLIPPED_VARIANCE))
        noise = noise_sums(above, owner, better_third, ridges)
    points = structure[..., 0].sum(axis=1)
    used = (points > 0.02 * points.max()) & ((noise[:, 0] > 0) | (not heard))
    ex, ey = course.downhill()
    weights = _interpolation(pixel, [(-ey, ex), (ex, ey)])
    lines, u_lines, lay = _line_steps(above, owner, pixel, course, better)
    seen = structure[used].sum(axis=0)
    squares = seen[:, 1] / np.maximum(seen[:, 0], 1.0) / SLOPE_CLIPPED_VARIANCE - lines
    short = _short_variance(above, owner, squares, noise[used].sum(axis=0), ridges) if heard else 0.0
    hidden = _rounding_variance(squares, rounded_um)

    def variances(sums: FloatArray) -> FloatArray:
        own = max(sums[-1] / sums[-2] / SLOPE_CLIPPED_VARIANCE / THIRD - short, 0.0) if heard else 0.0
        pairs = sums[:-2].reshape(-1, 2)
        differences = pairs[:, 1] / pairs[:, 0] / SLOPE_CLIPPED_VARIANCE - lines
        return np.append(weights @ (differences - 2.0 * own), own)

    parts = np.concatenate([structure.reshape(ridges, -1), noise], axis=1)
    (along, across, own), u = jackknife(parts[used], variances, points[used])
    factor, u_factor = np.ones(2), np.zeros(2)
    if max(sigma_um, blur_um) > 0.0:
        lengths = _lengths(above, owner, pixel, lines, own, ridges)
        factor, u_factor = _sharpening(lengths, [(-ey, ex), (ex, ey)], pixel, max(sigma_um, blur_um))
        if blur_um > 0.0:
            factor, u_factor = np.ones(2), (factor - 1.0) / np.sqrt(2.0)
    each = weights.sum(axis=1)
    shared = np.stack([2.0 * hidden * each, 2.0 * short * each])
    shared = np.vstack([shared, np.abs(weights) @ u_lines, slow])
    u_along, u_across = np.sqrt(u[:2] ** 2 + np.square(shared).sum(axis=0)).tolist()
    u_own = float(np.sqrt(u[2] ** 2 + hidden**2 + (0.5 * short) ** 2))
    noisy = (
        Quantity(float(np.sqrt(own)), min(u_own / (2.0 * np.sqrt(own)), np.sqrt(u_own))) if own > 0 else None
    )
    counts = COUNTS * max(float(squares[:2].min()) - 2.0 * own, 0.0)
    coarse = 2.0 * hidden > counts
    return Slopes(
        _sharper(_alpha(along, u_along, heard), factor[0], u_factor[0]),
        _sharper(_alpha(across, u_across, heard), factor[1], u_factor[1]),
        (noisy or Quantity(0.0, float(np.sqrt(u_own)))) if heard else Quantity(None),
        float(np.sqrt(lines[:2].max())) if lines[:2].max() > counts and not coarse else 0.0,
        rounded_um if coarse else 0.0,
        float(short / (short + own)) if 2.0 * short > counts and not coarse else 0.0,
        float(np.sqrt(lay)) if lay > OF_LAY / COUNTS * counts and not coarse else 0.0,
    )


def height_step(height_um: FloatArray) -> float:
    """Step in µm to which heights are rounded; 0 where nearly every height of a sample occurs once only."""
    sample = height_um.ravel()[sampled(np.isfinite(height_um), SAMPLES)]
    distinct = np.unique(sample)
    if not 1 < distinct.size < MOST_DISTINCT * sample.size:
        return 0.0
    gaps = np.diff(distinct)
    step = float(np.median(gaps[gaps > 1e-3 * gaps.max()]))
    left = np.abs(gaps / step - np.rint(gaps / step))
    return step if float(np.mean(left < 0.05)) > 0.9 else 0.0


def shows_stairs(height_um: FloatArray) -> bool:
    """Whether neighbours along x and along y are often equal, as on facets of few heights.

    Roughness hides finer steps, and ideal facets, which have few heights too, fall from pixel to pixel.
    """
    rows = np.unique(np.linspace(0, height_um.shape[0] - 2, SAMPLED_ROWS).astype(np.intp))
    here, below = height_um[rows], height_um[rows + 1]
    known = int(np.isfinite(here).sum())
    return bool(min(np.sum(here == below), np.sum(here[:, 1:] == here[:, :-1])) > LEAST_EQUAL * known)


def _rounding_variance(squares: FloatArray, step: float) -> float:
    """Most that the errors of rounding leave a white noise by, in µm².

    Errors of two heights rounded to steps q have a covariance of at most q²/12 times exp(−2π²·D/q²), with D the mean
    squared difference of the heights. Source: Widrow and Kollár, Quantization Noise, 2008.
    """
    if step == 0.0:
        return 0.0
    difference = max(float(squares[:2].min()) - step**2 / 6.0, 0.0)
    return float(step**2 / 12.0 * np.exp(-2.0 * np.pi**2 * difference / step**2))


def _line_steps(
    above: FloatArray,
    owner: npt.NDArray[np.int16],
    pixel: tuple[float, float],
    course: Course,
    limits: FloatArray,
) -> tuple[FloatArray, FloatArray, float]:
    """(lags,) mean squared height differences that whole lines of the scan share, and their uncertainty.

    Steps between lines are told from roughness by the covariance of the mean steps of the first and the last third
    of each line. Lines that do not cross a ridge and a half are the third number: along a ridge a step may be a part of
    its profile, so that it is in u.
    """
    found, error, lay = np.zeros(len(LAGS)), np.zeros(len(LAGS)), 0.0
    ex, ey = course.downhill()
    for axis, across in ((0, abs(ex)), (1, abs(ey))):
        heights, ridge = (above, owner) if axis == 0 else (above.T, owner.T)
        count = heights.shape[1]
        crossing = across * count * pixel[1 - axis] >= CROSSED * course.pitch_um
        thin = max(1, count // LINE_POINTS)
        for lag in (1, 2):
            at = LAGS.tolist().index([lag, 0] if axis == 0 else [0, lag])
            parts = []
            for part in (slice(0, count // 3, thin), slice(count - count // 3, count, thin)):
                z, k = heights[:, part], ridge[:, part]
                step = z[lag:] - z[:-lag]
                use = (k[lag:] == k[:-lag]) & (k[lag:] >= 0) & (np.abs(step) <= limits[at])
                known = use.sum(axis=1)
                total = np.where(use, step, 0.0).sum(axis=1)
                parts.append(np.where(known >= LINE_LEAST, total / np.maximum(known, 1), np.nan))
            product = parts[0] * parts[1]
            product = product[np.isfinite(product)]
            if product.size < LINE_LEAST:
                continue
            shared = float(np.mean(product))
            u = float(np.std(product)) * float(np.sqrt(2.0 * lag / product.size))
            down = np.abs(LAGS[:, axis]) == lag
            if shared <= 3.0 * u:
                error[down] += u
            elif crossing:
                found[down] += shared
                error[down] += np.hypot(u, OF_LINES * shared)
            else:
                error[down] += shared / np.sqrt(2.0)
                lay = max(lay, shared) if lag == 1 else lay
    return found, error, lay


def _third(length: FloatArray, stride: int) -> FloatArray:
    """Share of the variance of Gaussian roughness that third differences along one axis take for noise."""
    r1, r2, r3 = (np.exp(-np.square(k * stride / length)) for k in (1, 2, 3))
    share: FloatArray = (20.0 - 30.0 * r1 + 12.0 * r2 - 2.0 * r3) / 20.0
    return share


def _short_variance(
    above: FloatArray, owner: npt.NDArray[np.int16], squares: FloatArray, noise: FloatArray, ridges: int
) -> float:
    """Variance in µm² of roughness that is so short that it was taken for noise.

    Noise that is white is the same in third differences over every second point; roughness of a few pixels is more
    there. Of Gaussian roughness of all lengths and white noise, those count that agree with both and with the
    differences of neighbours; the largest length that does.
    """
    own = float(noise[1] / noise[0]) / SLOPE_CLIPPED_VARIANCE / THIRD
    apart, theirs = np.ascontiguousarray(above[::2, ::2]), np.ascontiguousarray(owner[::2, ::2])
    part = noise_sums(apart, theirs, SLOPE_CLIP * np.sqrt(THIRD * (own + float(squares.max()))), ridges).sum(
        axis=0
    )
    if part[0] < LEAST_WINDOWS:
        return 0.0
    limit = SLOPE_CLIP * float(np.sqrt(part[1] / part[0]))
    part = noise_sums(apart, theirs, limit, ridges).sum(axis=0)
    double = float(part[1] / max(part[0], 1.0)) / SLOPE_CLIPPED_VARIANCE / THIRD
    lengths = np.geomspace(12.0, 0.8, 120)
    x, y = np.maximum(squares[:2] - 2.0 * own, 1e-3 * squares[:2]).tolist()
    if min(x, y) <= 0.0:
        return own
    wide = lengths * float(np.clip((y / x) ** 0.25, 0.5, 2.0))
    high = lengths**2 / wide
    near, far = _third(wide, 1) * _third(high, 1), _third(wide, 2) * _third(high, 2)
    rough = x / (2.0 * (1.0 - np.exp(-1.0 / wide**2) - near)).clip(1e-12)
    rough = np.minimum(rough, own / near)
    reached = rough * (far - near) >= double - own
    at = int(np.argmax(reached)) if reached.any() else lengths.size - 1
    return float((rough * near)[at])


def _lengths(
    above: FloatArray,
    owner: npt.NDArray[np.int16],
    pixel: tuple[float, float],
    lines: FloatArray,
    noise: float,
    ridges: int,
) -> FloatArray:
    """Correlation lengths (x, y) in µm of roughness with Gaussian correlation, from differences over 1 to 8 pixels."""
    steps = np.array([1, 2, 4, 8])
    lags = np.concatenate([np.stack([0 * steps, steps], 1), np.stack([steps, 0 * steps], 1)])
    sums = structure_sums(above, owner, lags, np.full(len(lags), np.inf), ridges, 2).sum(axis=0)
    squares = sums[:, 1] / np.maximum(sums[:, 0], 1.0) - 2.0 * noise
    squares[4:] -= lines[1]
    tried = np.geomspace(0.8, 60.0, 300)
    shapes = np.log(-np.expm1(-np.square(steps / tried[:, None])))
    found = []
    for part in (squares[:4], squares[4:]):
        seen = np.log(np.maximum(part, 1e-3 * part.max()) if part.max() > 0.0 else np.ones(4))
        left = np.var(seen - shapes, axis=1)
        found.append(float(tried[np.argmin(left)]))
    return np.array([found[0] * pixel[1], found[1] * pixel[0]])


def _sharpening(
    lengths: FloatArray, directions: list[tuple[float, float]], pixel: tuple[float, float], sigma: float
) -> tuple[FloatArray, FloatArray]:
    """Factors (along, across) that take a Gaussian point spread function off α, and their uncertainties.

    Roughness with correlation exp(−x²/Tx² − y²/Ty²) has lengths √(T² + 4σ²) after it, and its variance falls as the
    product of the lengths grows. Other spectra need another factor: half of the correction is u. Infinite where the
    roughness seen is hardly longer than the point spread function.
    """
    true = np.square(lengths) - 4.0 * sigma**2
    if np.any(true < LEAST_SHARP * np.square(lengths)):
        return np.full(2, np.inf), np.full(2, np.inf)
    variance = np.prod(lengths) / np.sqrt(np.prod(true))
    found = []
    for ex, ey in directions:
        lag = 1.0 / np.hypot(ex / pixel[1], ey / pixel[0])
        seen, sharp = (
            -np.expm1(-(lag**2) * (ex**2 / one[0] + ey**2 / one[1])) for one in (np.square(lengths), true)
        )
        found.append(float(np.sqrt(variance * sharp / seen)))
    factor = np.array(found)
    return factor, OF_SHARPENING * (factor - 1.0)


def _sharper(alpha: Quantity, factor: float, u_factor: float) -> Quantity:
    """α times a factor; a lower bound where nothing but that is known."""
    if alpha.value is None or alpha.u is None:
        return alpha if np.isfinite(factor) and factor == 1.0 else Quantity(None)
    if not (np.isfinite(factor) and np.isfinite(u_factor)):
        return Quantity(None, at_least=alpha.value - 2.0 * alpha.u)
    return Quantity(factor * alpha.value, float(np.hypot(factor * alpha.u, u_factor * alpha.value)))


def _alpha(variance: float, u: float, heard: bool) -> Quantity:
    """√(2·variance); a bound where the variance is not clear of 0, or still holds noise."""
    if not heard or variance <= 2.0 * u:
        return Quantity(None, at_most=float(np.sqrt(2.0 * (max(variance, 0.0) + 2.0 * u))))
    alpha = float(np.sqrt(2.0 * variance))
    return Quantity(alpha, float(u / alpha))
