"""Regions of one ridge direction on a height map of several.

Every point votes for the direction in which the surface falls there. Facets outnumber walls, so that the mean vote over
less than a pitch is the azimuth toward which the facets lean, in a few pixels of the border of a field. Modes of these
azimuths are the classes of direction; connected points of one class are a region. Facets that fall alike to both
sides, as those of V-grooves, have no lean: there the votes are doubled in angle, as in a structure tensor.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.profiles.metrology.quantity import Quantity
from anisoscope.profiles.period import find_period

Labels = npt.NDArray[np.int32]
Votes = npt.NDArray[np.complexfloating]

APART_DEG = 8.0
"""Classes of direction differ by more than this."""
WINDOW_SHARE, LEAST_WINDOW = 1.0 / 80.0, 3.0
"""Standard deviation of the mean of votes: of the shorter side of the map, at least so many pixels."""
FLAT_SLOPE = 0.005
"""Slope below which a point has no direction: 0.3°."""
ONE_SIDED = 0.3
"""Length of the mean vote from which on facets lean to one side, over a window so many times as wide."""
WIDE = 4.0
AGREED = 0.25
"""Length of the mean vote below which a point belongs to no direction."""
LEAST_SHARE = 0.01
"""Share of the map that a class of direction takes at least."""
LEAST_SIDE = 4.0
"""Side of a region, in standard deviations of the window; smaller ones belong to their surroundings."""
OF_SIDE = 0.5
"""Common border of two parts of one region, over the side of a square as large as the smaller one."""
HISTOGRAM = 180
COARSE_POINTS = 400
"""Points along the shorter side of the grid on which regions are found."""
MARGIN = 1.5
"""Width of the band about a border in which points are assigned one by one, in standard deviations of the window."""
LOCAL, NEAR, LEAN_WEIGHT = 0.8, 3.0, 0.3
"""Smoothing of heights and of votes at borders in points, and the weight of the lean against that of the direction."""
BORDER = 6.0
"""Points by which borders are uncertain."""
LEAST_U_DEG = 1e-6
BLOCKS = 4
"""Parts of a region along each axis, between which its ridge angle scatters."""
MEANS = 6
"""Passes in which the azimuths of the classes are refined."""
RETURNED = 0.7
"""Largest fall of a region along its azimuth, of the median fall of its points: the walls of ridges make up for their
facets, the side of a hill falls on the whole as it does everywhere."""
ALIKE = 0.8
"""Least share of points whose fall is within half of its median, where ridges have no lean or many directions; normal
textures have 0.4 to 0.7."""
FEW_DIRECTIONS = 6


@dataclass(frozen=True)
class Region:
    """Connected points whose ridges have one direction.

    Attributes:
        number: from 1, rows by rows from the first point of the map.
        direction_class: index of its class in `DirectionRegions.azimuths_deg`.
        azimuth_deg: toward which its facets lean on the map, counter-clockwise from +x, within (−180, 180].
        points: number of points.
        share: of the points of the map.
        centre_um: mean place (x, y) of its points, from the first point of the map.
        box: rows and columns that hold it.
    """

    number: int
    direction_class: int
    azimuth_deg: float
    points: int
    share: float
    centre_um: tuple[float, float]
    box: tuple[slice, slice]

    @property
    def direction_deg(self) -> float:
        """Direction of the ridges, counter-clockwise from +y, within (−90, 90]."""
        return 90.0 - (90.0 - self.azimuth_deg) % 180.0


@dataclass(frozen=True)
class RegionRidges:
    """Ridges of a region.

    Attributes:
        ridge_angle_deg: of the facets, against the plane of the map; with the scatter over the region.
        pitch_um: where the region holds four ridges, else None.
    """

    ridge_angle_deg: Quantity
    pitch_um: float | None


@dataclass(frozen=True, eq=False)
class DirectionRegions:
    """Regions of a map.

    Attributes:
        surface: the map.
        labels: (rows, cols) number of the region of every point; 0 where it belongs to none.
        azimuths_deg: (C,) azimuth of the facets of every class, largest area first.
        one_sided: whether the facets of the classes lean to one side.
        regions: the regions.
        margin: points by which borders are uncertain.
    """

    surface: HeightMap
    labels: Labels
    azimuths_deg: tuple[float, ...]
    one_sided: bool
    regions: tuple[Region, ...]
    margin: float = 0.0

    @cached_property
    def areas(self) -> FloatArray:
        """(C,) share of the map that every class takes."""
        found = np.zeros(len(self.azimuths_deg))
        for one in self.regions:
            found[one.direction_class] += one.share
        return found

    def part(self, region: Region) -> HeightMap:
        """The map of a region alone, missing beyond it and in a margin along its border."""
        inside = self.labels[region.box] == region.number
        around = np.pad(inside, 1, mode="constant")
        rows, cols = self.surface.shape
        # the rim of the map is no border
        around[0] |= region.box[0].start == 0
        around[-1] |= region.box[0].stop == rows
        around[:, 0] |= region.box[1].start == 0
        around[:, -1] |= region.box[1].stop == cols
        deep = cv2.distanceTransform(around.astype(np.uint8), cv2.DIST_L2, 5)[1:-1, 1:-1]
        height = np.where(inside & (deep > self.margin), self.surface.height_um[region.box], np.nan)
        return HeightMap(height, self.surface.pixel_x_um, self.surface.pixel_y_um, dict(self.surface.origin))

    def of_class(self, number: int) -> tuple[Region, ...]:
        """The regions of a class, largest first."""
        chosen = [one for one in self.regions if one.direction_class == number]
        return tuple(sorted(chosen, key=lambda one: -one.points))

    def ridges(self, region: Region) -> RegionRidges:
        """Ridges of a region; the angle is that of the median slope of its facets."""
        part = self.part(region)
        known = np.isfinite(part.height_um)
        if not known.any():
            return RegionRidges(Quantity(None), None)
        turn = np.radians(region.azimuth_deg)
        fall_y, fall_x = (-one for one in np.gradient(part.height_um, part.pixel_y_um, part.pixel_x_um))
        slope = np.cos(turn) * fall_x + np.sin(turn) * fall_y
        blocks = [
            float(np.nanmedian(one))
            for band in np.array_split(slope, BLOCKS)
            for one in np.array_split(band, BLOCKS, axis=1)
            if np.isfinite(one).any()
        ]
        middle = float(np.nanmedian(slope))
        spread = float(np.std(blocks, ddof=1)) / np.sqrt(len(blocks)) if len(blocks) > 1 else float("inf")
        angle = float(np.degrees(np.arctan(middle)))
        u = float(np.degrees(spread) / (1.0 + middle**2)) if np.isfinite(spread) else None
        u = 0.0 if u is not None and u < LEAST_U_DEG else u
        period = find_period(part)
        return RegionRidges(Quantity(angle, u), period.pitch_um if period.is_periodic else None)


def direction_regions(surface: HeightMap) -> DirectionRegions:
    """Regions of one ridge direction.

    Args:
        surface: (rows, cols) heights in µm, NaN where missing. Fields narrower than about a twentieth of the map, or
            of less than half a pitch, are not resolved. Borders are exact to about a hundredth of the map.

    Returns:
        The regions; none where no part of the map has a direction, or where its slopes are those of a texture or of
        hills.
    """
    surface = surface.measured()
    found = _found(surface)
    return found if _ridged(found) else _none(surface)


def field_leans(surface: HeightMap, rows: int, cols: int) -> npt.NDArray[np.complexfloating]:
    """(rows, cols) mean unit vectors x + iy of the falls in square fields that fill a map, first row at the top.

    The angle is the azimuth toward which the facets of a field lean; of a flat field the vector is short.
    """
    fall_x, fall_y = _falls(surface, LOCAL)
    steep = np.hypot(fall_x, fall_y)
    votes = np.where(steep > FLAT_SLOPE, (fall_x + 1j * fall_y) / np.maximum(steep, FLAT_SLOPE), 0.0)
    bands = [
        [part.mean() for part in np.array_split(band, cols, axis=1)]
        for band in np.array_split(votes[::-1], rows)
    ]
    return np.array(bands)


def local_directions(
    surface: HeightMap, width_um: float
) -> tuple[npt.NDArray[np.complex64], npt.NDArray[np.float32]]:
    """Directions in which the surface falls or rises, doubled in angle, and root mean square slopes about every point.

    By the structure tensor of the slopes. The angle of a direction is twice the azimuth, alike for facets and walls;
    its length is 1 where all slopes lie along one line, near 0 on a texture, 0 on level land. Both are (rows, cols).

    Args:
        surface: heights; missing ones count as level.
        width_um: standard deviation of the normal window.
    """
    fall_x, fall_y = _falls(surface, LOCAL)
    fall = fall_x + 1j * fall_y
    sigma = width_um / surface.pixel_x_um
    square = _smoothed(np.abs(fall) ** 2, sigma)
    lines = _smoothed(fall * fall, sigma) / np.maximum(square, FLAT_SLOPE**2)
    return np.asarray(lines, dtype=np.complex64), np.asarray(np.sqrt(square), dtype=np.float32)


def _none(surface: HeightMap) -> DirectionRegions:
    return DirectionRegions(surface, np.zeros(surface.shape, dtype=np.int32), (), False, ())


def _ridged(found: DirectionRegions) -> bool:
    """Whether the regions hold ridges, and not the hills or the texture of a surface without any."""
    surface, median, whole, alike, points = found.surface, 0.0, 0.0, 0.0, 0
    fall_x, fall_y = _falls(surface, LOCAL)
    for one in found.regions:
        turn, inside = np.radians(one.azimuth_deg), found.labels[one.box] == one.number
        fall = np.cos(turn) * fall_x[one.box][inside] + np.sin(turn) * fall_y[one.box][inside]
        fall = fall if found.one_sided else np.abs(fall)
        middle = float(np.median(fall))
        alike += float(np.count_nonzero(np.abs(fall - middle) < 0.5 * middle))
        points += one.points
        median += one.points * middle
        whole += one.points * min(
            float(np.mean(fall)), _fall_on_the_whole(surface, one, inside, turn), key=abs
        )
    if found.one_sided and abs(whole) >= RETURNED * median:
        return False
    few = found.one_sided and len(found.azimuths_deg) <= FEW_DIRECTIONS
    return few or alike >= ALIKE * points


def _fall_on_the_whole(
    surface: HeightMap, region: Region, inside: npt.NDArray[np.bool_], turn: float
) -> float:
    """Slope of a plane through the points of a region along an azimuth in radians, positive where it falls."""
    rows, cols = np.nonzero(inside & np.isfinite(surface.height_um[region.box]))
    x, y = (n - n.mean() for n in (cols * surface.pixel_x_um, rows * surface.pixel_y_um))
    height = surface.height_um[region.box][rows, cols]
    moments = np.array([[x @ x, x @ y], [x @ y, y @ y]])
    slopes = np.linalg.lstsq(moments, np.array([x @ height, y @ height]), rcond=None)[0]
    return float(-np.cos(turn) * slopes[0] - np.sin(turn) * slopes[1])


def _found(surface: HeightMap) -> DirectionRegions:
    """Regions of one direction of fall, whatever falls there."""
    thin = max(1, min(surface.shape) // COARSE_POINTS)
    known, votes = _votes(surface, thin)
    window = max(WINDOW_SHARE * min(known.shape), LEAST_WINDOW / thin)
    weight = 1.0 / np.maximum(_smoothed(known, window), 1e-3)
    once, twice = (_smoothed(vote, window) * weight for vote in (votes, _doubled(votes)))
    some = known > 0.0
    wide = _smoothed(votes, WIDE * window) / np.maximum(_smoothed(known, WIDE * window), 1e-3)
    one_sided = bool(some.any()) and float(np.median(np.abs(wide[some]))) > ONE_SIDED
    turned = once if one_sided else twice
    certain = some & (np.abs(turned) > AGREED)
    centres = _classes(turned, certain)
    if not centres.size:
        return _none(surface)
    likeness = np.stack([(turned * np.exp(-1j * np.radians(one))).real for one in centres])
    classes = np.where(certain, likeness.argmax(axis=0) + 1, 0)
    coarse, class_of = _grown(classes.astype(np.int32), window)
    rows, cols = surface.shape
    fine = np.repeat(np.repeat(coarse, thin, axis=0), thin, axis=1)
    fine = np.pad(fine, ((0, rows - len(fine)), (0, cols - fine.shape[1])), mode="edge")
    azimuths = centres if one_sided else 0.5 * centres
    band = MARGIN * max(thin, window * thin)
    deep = _deep(fine) > band
    if len(class_of) > 2:
        azimuths = _refined(surface, fine, deep, class_of, azimuths)
        rim = int(np.ceil(band))
        fine = _at_borders(surface, fine, deep, class_of, azimuths, rim, one_sided=one_sided)
    fine[~np.isfinite(surface.height_um)] = 0
    return replace(_regions(surface, fine, class_of, azimuths, one_sided=one_sided), margin=BORDER)


def _deep(labels: Labels) -> npt.NDArray[np.float32]:
    """(rows, cols) distance of every point from another region, in points."""
    border = np.zeros(labels.shape, dtype=bool)
    across, along = labels[:, 1:] != labels[:, :-1], labels[1:] != labels[:-1]
    border[:, 1:] |= across
    border[:, :-1] |= across
    border[1:] |= along
    border[:-1] |= along
    if not border.any():
        return np.full(labels.shape, np.inf, dtype=np.float32)
    return np.asarray(cv2.distanceTransform((~border).astype(np.uint8), cv2.DIST_L2, 5))


def _falls(surface: HeightMap, sigma: float) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
    """(rows, cols) slopes toward +x and +y, counted positive where the surface falls."""
    smooth = surface.height_um.astype(np.float32)
    unknown = ~np.isfinite(smooth)
    if unknown.any():
        smooth[unknown] = np.float32(np.nanmean(surface.height_um))
    even = cv2.GaussianBlur(smooth, (0, 0), sigma)
    fall_x = -cv2.Sobel(even, cv2.CV_32F, 1, 0, ksize=1, scale=0.5 / surface.pixel_x_um)
    fall_y = -cv2.Sobel(even, cv2.CV_32F, 0, 1, ksize=1, scale=0.5 / surface.pixel_y_um)
    if unknown.any():
        near = cv2.dilate(unknown.astype(np.uint8), np.ones((3, 3), np.uint8)).astype(bool)
        fall_x[near] = fall_y[near] = 0.0
    return np.asarray(fall_x, dtype=np.float32), np.asarray(fall_y, dtype=np.float32)


def _refined(
    surface: HeightMap,
    labels: Labels,
    deep: npt.NDArray[np.bool_],
    class_of: npt.NDArray[np.intp],
    azimuths: FloatArray,
) -> FloatArray:
    """(C,) azimuths of the median slopes of the classes, away from borders."""
    fall_x, fall_y = _falls(surface, LOCAL)
    classes = np.where(deep & (labels > 0), class_of[labels] + 1, 0)
    found = azimuths.copy()
    for number in range(len(azimuths)):
        mine = classes == number + 1
        turn = np.radians(azimuths[number])
        if mine.any():
            x, y = fall_x[mine], fall_y[mine]
            along = np.cos(turn) * x + np.sin(turn) * y
            facets = along > 0.0
            if facets.any():
                found[number] = np.degrees(np.arctan2(np.median(y[facets]), np.median(x[facets])))
    return found


def _at_borders(
    surface: HeightMap,
    labels: Labels,
    deep: npt.NDArray[np.bool_],
    class_of: npt.NDArray[np.intp],
    azimuths: FloatArray,
    rim: int,
    *,
    one_sided: bool,
) -> Labels:
    """The labels with borders where the slopes of the points themselves change, not where means of them do.

    Within ``rim`` points of the rim of the map, too, where the slopes have another line: a field that is cut off there
    may be too narrow to be seen.
    """
    from scipy import ndimage  # noqa: PLC0415 - slow to import

    fall_x, fall_y = _falls(surface, LOCAL)
    vote = fall_x + 1j * fall_y
    vote /= np.maximum(np.abs(vote), FLAT_SLOPE)
    once, twice = _smoothed(vote, NEAR), _smoothed(vote * vote, NEAR)
    present = sorted({int(class_of[number]) for number in np.unique(labels) if number > 0})
    turns = [np.exp(-1j * np.radians(azimuths[number])) for number in present]
    fits = np.stack(
        [
            (twice * turn * turn).real + (LEAN_WEIGHT * (once * turn).real if one_sided else 0.0)
            for turn in turns
        ]
    )
    local = np.array(present)[fits.argmax(axis=0)]
    own = np.take_along_axis(fits, np.searchsorted(present, class_of[labels])[None], axis=0)[0]
    outer = np.ones_like(deep)
    outer[rim : len(deep) - rim, rim : deep.shape[1] - rim] = False
    near = ~deep | (outer & (fits.max(axis=0) - own > 2.0 * LEAN_WEIGHT))
    found, core = labels.copy(), np.where(near, 0, labels)
    for number in present:
        mine = near & (local == number) & (class_of[labels] != number)
        if not mine.any():
            continue
        seeds = np.where((class_of[core] == number) & (core > 0), core, 0)
        if not seeds.any():
            continue
        nearest = ndimage.distance_transform_edt(seeds == 0, return_distances=False, return_indices=True)
        found[mine] = seeds[tuple(part[mine] for part in nearest)]
    return found


def _votes(surface: HeightMap, thin: int) -> tuple[FloatArray, Votes]:
    """By squares of points: the share of those with a direction, and the mean unit vector (x + iy) of their falls."""
    fall_x, fall_y = _falls(surface, max(0.5 * thin, LOCAL))
    steep = np.hypot(fall_x, fall_y)
    usable = steep > FLAT_SLOPE
    weight = np.where(usable, 1.0 / np.maximum(steep, FLAT_SLOPE), 0.0).astype(np.float32)
    share, x, y = (
        _thinned(one, thin) for one in (usable.astype(np.float32), fall_x * weight, fall_y * weight)
    )
    return share.astype(float), x + 1j * y


def _thinned(values: npt.NDArray[np.float32], thin: int) -> npt.NDArray[np.float32]:
    """Means over squares of points."""
    rows, cols = (n // thin for n in values.shape)
    part = values[: rows * thin, : cols * thin].reshape(rows, thin, cols, thin)
    return np.asarray(part.mean(axis=(1, 3)))


def _doubled(votes: Votes) -> Votes:
    """Votes doubled in angle, of unchanged length."""
    return votes * votes / np.maximum(np.abs(votes), 1e-6)


def _smoothed(values: Any, sigma: float) -> Any:  # noqa: ANN401 - real or complex
    """Mean under a normal window."""
    if np.iscomplexobj(values):
        return _smoothed(values.real, sigma) + 1j * _smoothed(values.imag, sigma)
    return cv2.GaussianBlur(values.astype(np.float32), (0, 0), max(sigma, 0.3))


def _classes(turned: npt.NDArray[np.complexfloating], certain: npt.NDArray[np.bool_]) -> FloatArray:
    """(C,) modes of the angles of the mean votes in degrees, the largest share first."""
    from scipy import ndimage  # noqa: PLC0415 - slow to import

    if certain.sum() < LEAST_SHARE * certain.size:
        return np.zeros(0)
    angle = np.degrees(np.angle(turned[certain]))
    step = 360.0 / HISTOGRAM
    counts = np.histogram(angle, HISTOGRAM, (-180.0, 180.0))[0].astype(float)
    counts = ndimage.uniform_filter1d(counts, 3, mode="wrap")
    left = counts.copy()
    reach = int(np.ceil(APART_DEG / step))
    around = np.arange(-reach, reach + 1)
    found: list[float] = []
    while True:
        peak = int(left.argmax())
        share = counts[(peak + around) % HISTOGRAM].sum() / certain.size
        if left[peak] <= 0.0 or share < LEAST_SHARE:
            break
        # what only stands on the flank of a stronger mode is the border between two fields
        if counts[(peak + np.arange(-3, 4)) % HISTOGRAM].max() <= counts[peak]:
            found.append(-180.0 + step * (peak + 0.5))
        left[(peak + around) % HISTOGRAM] = 0.0
    centres = np.array(found)
    for _ in range(MEANS if found else 0):
        away = np.abs((angle[:, None] - centres + 180.0) % 360.0 - 180.0)
        nearest = away.argmin(axis=1)
        close = away.min(axis=1) < 0.5 * APART_DEG
        kept = [n for n in range(centres.size) if (close & (nearest == n)).any()]
        centres = np.array([_mean_angle(angle[close & (nearest == n)]) for n in kept])
    return centres


def _mean_angle(angle_deg: FloatArray) -> float:
    return float(np.degrees(np.angle(np.mean(np.exp(1j * np.radians(angle_deg))))))


def _grown(classes: Labels, window: float) -> tuple[Labels, npt.NDArray[np.intp]]:
    """(rows, cols) number of a region from 1 everywhere, and (R + 1,) the class of each, from 0.

    Regions and bridges narrower than the window are left out first: at the corners of a checkerboard fields of one
    direction touch. What is left grows until it fills the map.
    """
    from scipy import ndimage  # noqa: PLC0415 - slow to import

    if classes.any():  # walls, where votes disagree, are of the class about them
        nearest = ndimage.distance_transform_edt(classes == 0, return_distances=False, return_indices=True)
        classes = classes[tuple(nearest)]
    side = max(3, round(LEAST_SIDE * window))
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side))
    seeds, class_of = np.zeros_like(classes), [0]
    for number in range(1, int(classes.max()) + 1):
        wide = cv2.morphologyEx((classes == number).astype(np.uint8), cv2.MORPH_OPEN, kernel)
        parts, count = ndimage.label(wide)
        seeds[parts > 0] = parts[parts > 0] + len(class_of) - 1
        class_of += [number - 1] * count
    if len(class_of) > 1:
        nearest = ndimage.distance_transform_edt(seeds == 0, return_distances=False, return_indices=True)
        seeds = seeds[tuple(nearest)]
    return _joined(seeds, np.array(class_of), side), np.array(class_of)


def _joined(labels: Labels, class_of: npt.NDArray[np.intp], side: int) -> Labels:
    """The labels, one number for regions of a class that are parted along a side, and not only touch at a corner.

    Cut crests and walls between them are level or rise over as much as facets fall, and part a field into its ridges.
    A corner is about ``side`` points wide, and its border twice as long by steps along the grid.
    """
    from scipy import sparse  # noqa: PLC0415 - slow to import

    pairs = np.concatenate(
        [
            np.stack([a.ravel(), b.ravel()])
            for a, b in ((labels[:, 1:], labels[:, :-1]), (labels[1:], labels[:-1]))
        ],
        axis=1,
    )
    pairs = np.sort(pairs[:, (pairs[0] != pairs[1]) & (class_of[pairs[0]] == class_of[pairs[1]])], axis=0)
    (one, other), length = np.unique(pairs, axis=1, return_counts=True)
    points = np.bincount(labels.ravel(), minlength=class_of.size)
    long = length > np.maximum(2 * side, OF_SIDE * np.sqrt(np.minimum(points[one], points[other])))
    graph = sparse.coo_array((length[long], (one[long], other[long])), shape=(class_of.size,) * 2)
    part = sparse.csgraph.connected_components(graph, directed=False)[1]
    first = np.unique(part, return_index=True)[1]
    return np.asarray(first[part][labels], dtype=np.int32)


def _regions(
    surface: HeightMap,
    labels: Labels,
    class_of: npt.NDArray[np.intp],
    centres: FloatArray,
    *,
    one_sided: bool,
) -> DirectionRegions:
    """Regions from the first row on, classes in the order of their areas."""
    from scipy import ndimage  # noqa: PLC0415 - slow to import

    points = np.bincount(labels.ravel(), minlength=len(class_of))
    areas = np.bincount(class_of[1:], points[1:], minlength=len(centres))
    order = [int(n) for n in np.argsort(-areas, kind="stable") if areas[n] > 0]
    boxes = ndimage.find_objects(labels, len(class_of) - 1)
    present = [number for number in range(1, len(class_of)) if points[number] > 0]
    present.sort(key=lambda number: (boxes[number - 1][0].start, boxes[number - 1][1].start))
    renumbered = np.zeros(len(class_of), dtype=np.int32)
    renumbered[present] = np.arange(1, len(present) + 1)
    azimuths, found = tuple(_azimuth(float(centres[number])) for number in order), []
    for number in present:
        box, rank = (boxes[number - 1][0], boxes[number - 1][1]), order.index(int(class_of[number]))
        rows, cols = np.nonzero(labels[box] == number)
        centre = (
            float((box[1].start + cols.mean()) * surface.pixel_x_um),
            float((box[0].start + rows.mean()) * surface.pixel_y_um),
        )
        share = float(points[number] / labels.size)
        found.append(
            Region(int(renumbered[number]), rank, azimuths[rank], int(points[number]), share, centre, box)
        )
    return DirectionRegions(surface, renumbered[labels], azimuths, one_sided, tuple(found))


def _azimuth(angle_deg: float) -> float:
    """Within (−180, 180]."""
    return 180.0 - (180.0 - angle_deg) % 360.0
