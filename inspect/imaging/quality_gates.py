"""Quality gates on the pictures: tilt, sharpness, stationary dirt, and the identity of the part.

Light, saturation, registration and drift are checked where they are measured (`pose_radiance`, `rig_monitor`); these
gates compare pictures. Every error message says what to do. A gate that could not see what it watches
returns a note for the record.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import CalibrationError, MeasurementError, RegistrationError
from anisoscope.imaging.pose_radiance import CELLS_PER_PITCH, Measured
from anisoscope.imaging.registration.placement import Grid, View, angle_between
from anisoscope.recipe.base import RecipeBase
from anisoscope.recipe.surface import MOST_DEVIATION, SurfaceRecipe

Image = npt.NDArray[np.float32]

TILT_DEG = 1.0
MIN_SQUEEZE_SHARE = 0.002
BLUR_GROWTH, BLUR_ADDED_PX = 1.5, 0.7
BLUR_PITCHES = 0.25
PITCH_SHARE = 0.03
DIRECTION_DEG = 5.0
FAINT_PEAK = 0.05
CLEAR_WAVE = 40.0
"""Power of a clear wave over that of the texture at its frequency; chance reaches 25 in a picture of 512 × 512."""
MISSING_RATIO, FOREIGN_RATIO = 10.0, 0.5
"""Power over that of the expected wave from which a harmonic lacks its fundamental, and a longer wave is the pitch."""
PITCH_BINS = 0.05
SCALE_SHARE = 0.001
"""Relative standard uncertainty of the size of a pixel on the sample."""
POINTS_A_PITCH, POINTS_RESOLVED = 6.0, 3.0
RINGS, MOST_WAVES = 25, 16
QUIET_SHARE, NEAR_BINS = 0.2, 6.0
"""Share of a ray of the spectrum that no wave of a period of a fifth of the picture or less reaches; its least half."""
MOST_MEDIANS = 3.0
MAX_WINDOW = 512
STILL_CELLS, LEAST_CELLS = 8.0, 64
UNLIKE, LIKE = 1.6, 1.4  # factors in brightness: what is beyond the part, and what is the part
THINNEST = 2.0  # cells
SOLID_PART, MOST_LIKE = (
    0.6,
    0.1,
)  # over this part of its depth so few cells of what an edge cuts off look like the part


def check_views(views: list[View], recipe: SurfaceRecipe | None = None) -> None:
    """Gates that use the markers; without a recipe the pictures need not resolve a pitch.

    Raises:
        RegistrationError: the tilt of the arm differs from the commanded one.
        MeasurementError: a picture is out of focus.
    """
    for view in views:
        check_tilt(view)
        check_sharpness(view, views[0], recipe)


def check_tilt(view: View) -> None:
    """Compare the foreshortening of the plate with the tilt of the arm."""
    place = view.placement
    cos = float(np.cos(np.radians(view.tilt_deg)))
    near, far = (np.cos(np.radians(abs(view.tilt_deg) + turn)) for turn in (-TILT_DEG, TILT_DEG))
    share = max(abs(float(near) - cos), abs(float(far) - cos)) / cos
    if abs(place.squeeze - 1.0) <= max(share, MIN_SQUEEZE_SHARE) + 4.0 * place.u_squeeze:
        return
    observed = float(np.degrees(np.arccos(min(place.squeeze * cos, 1.0))))
    words = f"the markers say {observed:.1f}°"
    if place.squeeze * cos > 1.0:
        words = f"in the markers columns are foreshortened instead of rows, by {1.0 - 1.0 / (place.squeeze * cos):.2%}"
    raise RegistrationError(
        f"at {view.stage_deg:g}° the arm stands at {view.tilt_deg:.1f}° tilt, {words} (limit ±{TILT_DEG:g}°): check "
        "tilt axis and geometry.tilt_deg in the rig file, and that the fixture lies flat"
    )


def check_sharpness(view: View, first: View, recipe: SurfaceRecipe | None = None) -> None:
    """Compare the sharpness of the markers' edges with the first pose, and with the cells of the contrast map."""
    blur, usual = view.placement.blur_px, first.placement.blur_px
    if blur is None or usual is None:
        return
    blur_um = blur * view.placement.pixel_um
    limit_um = np.inf if recipe is None else BLUR_PITCHES * recipe.surface.pitch_um
    if recipe is not None and recipe.area is not None and blur_um > limit_um:
        raise MeasurementError(
            f"at {view.stage_deg:g}° the picture is out of focus: the markers' edges are smeared by {blur_um:.1f} µm "
            f"(limit {limit_um:g} µm, a quarter of a pitch): focus again, and clean the lens"
        )
    added = float(np.sqrt(abs(blur**2 - usual**2)))
    if max(blur, usual) > BLUR_GROWTH * min(blur, usual) and added > BLUR_ADDED_PX:
        worse, better = (view, first) if blur > usual else (first, view)
        raise MeasurementError(
            f"at {worse.stage_deg:g}° the picture is less sharp than at {better.stage_deg:g}° (edges of the markers "
            f"{max(blur, usual):.2f} px instead of {min(blur, usual):.2f} px): focus again, and check that the fixture "
            "lies flat and the stage does not wobble"
        )


def unwatched(views: Sequence[View]) -> tuple[str, ...]:
    """Notes on what the gates that use the markers could not see, whatever the kind of part."""
    places = [view.placement for view in views]
    blind = {
        "tilt": any(view.tilt_deg and not view.placement.markers for view in views),
        "sharpness": any(place.blur_px is None for place in places),
    }
    names = [name for name, is_blind in blind.items() if is_blind]
    return (f"not watched: {', '.join(names)} (no markers in the pictures)",) if names else ()


def check_part(views: list[View], measured: Measured, recipe: SurfaceRecipe) -> tuple[str, ...]:
    """Gates of the aligned pictures of ridges.

    Returns:
        Notes on what could not be seen.

    Raises:
        MeasurementError: the region reaches beyond the part; the ridges are not those of the recipe, or run elsewhere.
        CalibrationError: a deviation is stationary in the picture while the part turns.
    """
    notes = check_edges(measured.cells, measured.grid, recipe)
    notes += check_ridges(measured.aligned, [view.stage_deg for view in views], measured.grid, recipe)
    rule = MOST_DEVIATION if recipe.area is None else recipe.area.cell_deviation
    if rule == "auto":
        rule = MOST_DEVIATION
    return notes + check_dirt(views, measured, 0.5 * rule)


@dataclass(frozen=True)
class Overhang:
    """A corner of the region beyond the part: (x, y) of the corner in sample millimetres, and how far in µm."""

    at_mm: tuple[float, float]
    beyond_um: float


def overhangs(cells: FloatArray, grid: Grid) -> tuple[Overhang, ...]:
    """Corners of the region that lie beyond the part.

    What is not the part is brighter or darker than it in every pose, up to a straight edge that cuts the corner off or
    runs along a side. Means of a whole pitch across the ridges show it; cells that look like the part, each compared
    with the median of the cells at its place in the pitch, contradict it.

    Args:
        cells: (P, rows, cols) mean radiance of cells, four in a pitch.
        grid: raster of the aligned pictures.

    Returns:
        The corners; none where there are too few cells to say.
    """
    if min(cells.shape[1:]) < CELLS_PER_PITCH:
        return ()
    cell_um = 1000.0 * grid.pixel_mm * grid.shape[1] / cells.shape[2]
    found = []
    for down in (1, -1):
        for across in (1, -1):
            beyond = _cut_off(cells[:, ::down, ::across])
            if beyond > 0.0:
                row, col = (0 if down > 0 else grid.shape[0] - 1), (0 if across > 0 else grid.shape[1] - 1)
                x, y, _ = grid.to_mm() @ [col, row, 1.0]
                found.append(Overhang((float(x), float(y)), beyond * cell_um))
    return tuple(found)


def _cut_off(cells: FloatArray) -> float:
    """Distance in cells from the corner at (P, 0, 0) to the edge of the part; 0 where the part covers the corner."""
    ends = np.pad(np.cumsum(cells, axis=2), ((0, 0), (0, 0), (1, 0)))
    pitches = ends[:, :, CELLS_PER_PITCH:] - ends[:, :, :-CELLS_PER_PITCH]
    unlike = np.all(np.abs(_off_median(pitches)) > np.log(UNLIKE), axis=0)
    # a pitch counts up to where half of it is the part
    across = np.cumprod(unlike, axis=1).sum(axis=1)
    across = np.where(across > 0, across + CELLS_PER_PITCH // 2 - 1, 0)
    down = np.cumprod(unlike, axis=0).sum(axis=0)
    like = np.empty(cells.shape[1:], dtype=bool)
    for phase in range(CELLS_PER_PITCH):
        own = np.s_[:, :, phase::CELLS_PER_PITCH]
        like[own[1:]] = np.all(np.abs(_off_median(cells[own])) < np.log(LIKE), axis=0)
    row, col = np.indices(like.shape) + 0.5
    legs = float(across[:2].min()), float(down[0])
    beyond = 0.0
    if min(legs) >= THINNEST and max(legs) >= CELLS_PER_PITCH:
        beyond = legs[0] * legs[1] / float(np.hypot(*legs))
        if _is_part(like, row / legs[1] + col / legs[0]):
            beyond = 0.0
    # a strip along a whole side, whatever the next side shows
    for depth, along in ((float(np.median(across)), col), (float(np.median(down)), row)):
        if depth >= THINNEST and not _is_part(like, along / depth):
            beyond = max(beyond, depth)
    return beyond


def _is_part(like: npt.NDArray[np.bool_], depth: FloatArray) -> bool:
    """Whether more than a few cells near the border look like the part; the depth is 1 at the supposed edge."""
    inner = depth < SOLID_PART
    return not inner.any() or bool(like[inner].mean() > MOST_LIKE)


def _off_median(values: FloatArray) -> FloatArray:
    """Ln ratio of every value of a pose to the median of the pose."""
    logs = np.log(np.maximum(values, 1e-6))
    return np.asarray(logs - np.median(logs, axis=(1, 2), keepdims=True))


def check_edges(cells: FloatArray, grid: Grid, recipe: RecipeBase) -> tuple[str, ...]:
    """Check that no corner of the region is beyond the part; cells as for `overhangs`, notes as of `check_part`."""
    found = beyond_part(cells, grid, recipe)
    if found is not None:
        raise MeasurementError(found)
    if min(cells.shape[1:]) < CELLS_PER_PITCH:
        return ("not watched: whether the region lies on the part (it is narrower than a pitch)",)
    return ()


def beyond_part(cells: FloatArray, grid: Grid, recipe: RecipeBase) -> str | None:
    """Corners of the region that are beyond the part by more than the recipe allows; None if none is.

    Args:
        cells: as for `overhangs`.
        grid: of the region.
        recipe: with the limit.
    """
    limit_um = recipe.limits.beyond_part_um
    beyond = [one for one in overhangs(cells, grid) if one.beyond_um > limit_um]
    if not beyond:
        return None
    count = f"at {len(beyond)} corners" if len(beyond) > 1 else "at a corner"
    places = ", ".join(
        f"{one.beyond_um:.0f} µm at x {one.at_mm[0]:+.2f} mm, y {one.at_mm[1]:+.2f} mm" for one in beyond
    )
    return (
        f"the region reaches beyond the part {count}: {places} (limit {limit_um:g} µm, "
        "limits.beyond_part_um): make region.size_mm smaller, correct region.center_mm, or seat the part properly; is "
        "the part whole there?"
    )


@dataclass(frozen=True)
class Ridges:
    """The strongest periodic structure of the aligned pictures.

    Attributes:
        pitch_um: period.
        direction_deg: across the ridges, relative to the recipe, −90 to 90.
        share: share of the pictures' variation in this wave.
        expected_share: share in the wave that the recipe expects.
        is_expected: the expected wave is the strongest one, within the resolution of the pictures.
    """

    pitch_um: float
    direction_deg: float
    share: float
    expected_share: float
    is_expected: bool


def find_ridges(aligned: tuple[Image, ...], pixel_um: float, pitch_um: float) -> Ridges | None:
    """Strongest wave in pictures whose columns should follow the ridges; None where the pitch is hardly resolved.

    Args:
        aligned: P pictures (rows, cols).
        pixel_um: distance of their points.
        pitch_um: what the recipe expects.
    """
    factor = max(1, int(pitch_um / pixel_um / POINTS_A_PITCH))
    step_um = factor * pixel_um
    if pitch_um < POINTS_RESOLVED * step_um:
        return None
    power, frequencies = _power(aligned, factor)
    down, across = (axis / step_um for axis in frequencies)
    radius = np.hypot(down[:, None], across)
    searched = (radius > 0.3 / pitch_um) & (across >= 0.0)[None, :]
    inside = np.where(searched, power, 0.0)
    row, col = (int(i) for i in np.unravel_index(inside.argmax(), inside.shape))
    f_down, f_across = (_refined(power, (row, col), axis, frequencies[axis]) / step_um for axis in (0, 1))
    total = float(inside.sum())
    if total <= 0.0:
        return None
    bin_size = 1.0 / (step_um * np.array(power.shape))

    def around(at_down: float, at_across: float, bins: float) -> npt.NDArray[np.bool_]:
        rows = np.abs(down - at_down) <= bins * bin_size[0]
        return np.asarray(rows[:, None] & (np.abs(across - at_across) <= bins * bin_size[1])[None, :])

    near, peak = around(0.0, 1.0 / pitch_um, 1.6), around(f_down, f_across, 1.6)
    surrounding = near & ~around(f_down, f_across, 2.1)  # the window spreads a wave over four bins
    direction = float(np.degrees(np.arctan2(f_down, f_across)))
    return Ridges(
        float(1.0 / max(np.hypot(f_down, f_across), 1e-12)),
        (direction + 90.0) % 180.0 - 90.0,
        float(inside[peak].sum()) / total,
        float(inside[surrounding].sum()) / total,
        bool(near[row, col]),
    )


def _power(aligned: tuple[Image, ...], factor: int) -> tuple[FloatArray, tuple[FloatArray, FloatArray]]:
    """Mean of the pictures' normalised power spectra, and the frequencies of rows and columns."""
    spectra = []
    for picture in aligned:
        rows, cols = (size - size % factor for size in picture.shape)
        known = picture[:rows, :cols]
        if not np.isfinite(known.sum(dtype=np.float64)):
            known = np.nan_to_num(known, nan=float(np.nanmean(picture)))
        small = cv2.resize(known, (cols // factor, rows // factor), interpolation=cv2.INTER_AREA)
        small = small[:MAX_WINDOW, :MAX_WINDOW].astype(np.float64)
        window = np.hanning(small.shape[0])[:, None] * np.hanning(small.shape[1])
        found = np.abs(np.fft.fft2((small / small.mean() - 1.0) * window)) ** 2
        found[0, 0] = 0.0
        spectra.append(found / max(float(found.sum()), 1e-30))
    shape = spectra[0].shape
    rows, cols = (np.asarray(np.fft.fftfreq(size), dtype=np.float64) for size in shape)
    return np.asarray(np.mean(spectra, axis=0), dtype=np.float64), (rows, cols)


def _refined(power: FloatArray, at: tuple[int, int], axis: int, frequencies: FloatArray) -> float:
    """Frequency of a peak along an axis: vertex of a parabola through the logarithms of three neighbours."""
    size = power.shape[axis]
    line = power[:, at[1]] if axis == 0 else power[at[0]]
    before, top, after = (np.log(line[(at[axis] + step) % size] + 1e-30) for step in (-1, 0, 1))
    bend = before - 2.0 * top + after
    shift = 0.5 * (before - after) / bend if bend < 0.0 else 0.0
    return float(frequencies[at[axis]] + np.clip(shift, -0.5, 0.5) / size)


def measured_pitch(measured: Measured, recipe: SurfaceRecipe) -> tuple[float, float] | None:
    """Relative deviation of the pitch in the aligned pictures from the recipe's, and its standard uncertainty, in %.

    The wave of the ridges is found to `PITCH_BINS` of the resolution that the number of pitches gives.

    Returns:
        None where the ridges do not stand out, or are not resolved.
    """
    pitch_um, grid = recipe.surface.pitch_um, measured.grid
    found = find_ridges(measured.aligned, grid.pixel_mm * 1000.0, pitch_um)
    if found is None or not found.is_expected or found.share < FAINT_PEAK:
        return None
    pitches = grid.size_mm[0] * 1000.0 / pitch_um
    return 100.0 * (found.pitch_um / pitch_um - 1.0), 100.0 * float(
        np.hypot(PITCH_BINS / pitches, SCALE_SHARE)
    )


@dataclass(frozen=True)
class Wave:
    """A wave that stands out of the texture of one picture.

    Attributes:
        pitch_um: period.
        direction_deg: across its crests, relative to the recipe, −90 to 90.
        height: power over that of the texture at its frequency.
        over_fundamental: power over that at the period that the recipe expects.
        order: k where its period is the k-th part of the expected pitch, whatever its direction; 0 for others.
    """

    pitch_um: float
    direction_deg: float
    height: float
    over_fundamental: float
    order: int

    @property
    def expected(self) -> bool:
        """Whether the recipe's ridges, or a harmonic of them, make it."""
        return self.order > 0 and abs(self.direction_deg) <= DIRECTION_DEG


def find_waves(picture: Image, pixel_um: float, pitch_um: float) -> tuple[Wave, ...] | None:
    """Clear waves of a picture whose columns should follow the ridges, the highest first.

    Args:
        picture: (rows, cols).
        pixel_um: distance of its points.
        pitch_um: what the recipe expects.

    Returns:
        None where the pitch is hardly resolved.
    """
    factor = max(1, int(pitch_um / pixel_um / POINTS_A_PITCH))
    step_um = factor * pixel_um
    if pitch_um < POINTS_RESOLVED * step_um:
        return None
    bright = MOST_MEDIANS * np.float32(np.nanmedian(picture))  # land without ridges may outshine them by far
    power, frequencies = _power((np.minimum(picture, bright),), factor)
    down, across = (axis / step_um for axis in frequencies)
    radius = np.hypot(down[:, None], across)
    bins = 1.0 / (step_um * np.array(power.shape))
    searched = (radius > max(0.25 / pitch_um, 3.0 * bins.max())) & (across >= 0.0)[None, :]
    edges = np.linspace(0.0, float(radius.max()), RINGS)[1:-1]
    ring = np.digitize(radius, edges)
    floor = np.array(
        [
            np.median(power[inside]) if (inside := searched & (ring == k)).any() else np.inf
            for k in range(RINGS)
        ]
    )
    searched &= power == cv2.dilate(power, np.ones((3, 3)))
    height = np.where(
        searched, power * np.log(2.0) / np.maximum(floor[ring], 1e-30), 0.0
    )  # mean of chance: 1
    near = (np.abs(down) <= 1.6 * bins[0])[:, None] & (np.abs(across - 1.0 / pitch_um) <= 1.6 * bins[1])[
        None, :
    ]
    fundamental = float(power[near].max(initial=1e-30))
    found: list[Wave] = []
    for _ in range(MOST_WAVES):
        if height.max() < CLEAR_WAVE:
            break
        row, col = (int(i) for i in np.unravel_index(height.argmax(), height.shape))
        f_down, f_across = (_refined(power, (row, col), axis, frequencies[axis]) / step_um for axis in (0, 1))
        period = float(1.0 / np.hypot(f_down, f_across))
        direction = (float(np.degrees(np.arctan2(f_down, f_across))) + 90.0) % 180.0 - 90.0
        order = round(pitch_um / period)
        if order and abs(order * period / pitch_um - 1.0) > PITCH_SHARE:
            order = 0
        top = min(float(height[row, col]), float(power[row, col]) / _along(power, bins, f_down, f_across))
        if top >= CLEAR_WAVE:
            found.append(Wave(period, direction, top, float(power[row, col]) / fundamental, order))
        own = np.abs(down - down[row])[:, None] <= 3.1 * bins[0]
        height[own & (np.abs(across - across[col]) <= 3.1 * bins[1])[None, :]] = 0.0
    return tuple(sorted(found, key=lambda wave: -wave.height))


def _along(power: FloatArray, bins: FloatArray, f_down: float, f_across: float) -> float:
    """Mean power of what does not repeat, around a wave on its ray: ridges missing here and there spread over it."""
    at = np.array([f_down / bins[0], f_across / bins[1]])
    length = float(np.hypot(*at))
    reach = max(0.5 * length, NEAR_BINS)
    steps = np.arange(max(length - reach, 3.0), min(length + reach, 0.5 * min(power.shape) - 1.0))
    if not steps.size:  # a picture of few pitches
        return 1e-30
    row, col = np.rint(steps[:, None] * at / length).astype(int).T
    return float(np.quantile(power[row, col], QUIET_SHARE) / -np.log1p(-QUIET_SHARE)) + 1e-30


def check_ridges(
    aligned: tuple[Image, ...], stages_deg: Sequence[float], grid: Grid, recipe: SurfaceRecipe
) -> tuple[str, ...]:
    """Compare the ridges of every pose with the recipe, and their direction with that of the other poses.

    Args:
        aligned: P pictures (rows, cols).
        stages_deg: their P stage angles.
        grid: raster of the pictures.
        recipe: pitch and limits.

    Returns:
        Notes on what could not be seen.

    Raises:
        MeasurementError: another pitch, another direction, or a part that turned on its fixture.
    """
    pitch_um = recipe.surface.pitch_um
    waves = [find_waves(picture, grid.pixel_mm * 1000.0, pitch_um) for picture in aligned]
    if any(one is None for one in waves):
        return (
            f"not watched: pitch and direction of the ridges (a pitch has fewer than {POINTS_RESOLVED:g} points)",
        )
    seen = {deg: one for deg, one in zip(stages_deg, waves, strict=True) if one}
    if not seen:
        return ("not watched: pitch and direction of the ridges (no clear wave in any pose)",)
    # waves of another direction beside those of the ridges are chatter
    lies = {
        deg: next((wave for wave in one if wave.expected), one[0]).direction_deg
        for deg, one in seen.items()
        if one[0].order or any(wave.expected for wave in one)
    }
    check_following(lies, recipe.limits.part_turn_deg, period_deg=180.0)
    if not any(wave.expected for one in seen.values() for wave in one):
        turned = max((one[0] for one in seen.values()), key=lambda wave: wave.height)
        if abs(turned.direction_deg) > DIRECTION_DEG:
            raise MeasurementError(
                f"the ridges run {abs(turned.direction_deg):.0f}° from where the recipe says: lay the part into the "
                "fixture the right way round, or correct poses.facet_azimuth_deg in the recipe"
            )
    found_um = _other_pitch(
        [tuple(w for w in one if abs(w.direction_deg) <= DIRECTION_DEG) for one in seen.values()]
    )
    if found_um is not None:
        raise MeasurementError(
            f"the ridges are {found_um:.1f} µm apart, the recipe says {pitch_um:g} µm "
            f"(limit ±{PITCH_SHARE:.0%}): is this part of another product, or the recipe the wrong one?"
        )
    blind = ", ".join(f"{deg:g}°" for deg in stages_deg if deg not in lies)
    return (
        (f"not watched: whether the part follows its fixture at {blind} (no clear ridges)",) if blind else ()
    )


def _other_pitch(seen: Sequence[tuple[Wave, ...]]) -> float | None:
    """Period of the ridges where it is not the recipe's, else None, from the waves of every pose across the ridges."""
    for waves in seen:
        own = max((one.height for one in waves if one.order), default=0.0)
        others = [one for one in waves if not one.order and one.height > FOREIGN_RATIO * own]
        if others:
            return max(one.pitch_um for one in others if one.height >= FOREIGN_RATIO * others[0].height)
    # with light along the ridges both flanks may look alike: one pose with the fundamental is enough
    lacking = [waves[0] for waves in seen if waves and waves[0].over_fundamental > MISSING_RATIO]
    shown = [waves for waves in seen if waves and waves[0].over_fundamental <= MISSING_RATIO]
    if not lacking or any(wave.order == 1 for waves in shown for wave in waves):
        return None
    return max(lacking, key=lambda wave: wave.height).pitch_um


def check_following(lies_deg: Mapping[float, float], limit_deg: float, period_deg: float) -> None:
    """Check that a part follows its fixture.

    Args:
        lies_deg: how the part lies on its fixture, by stage angle.
        limit_deg: between two poses.
        period_deg: angle after which the part looks alike.

    Raises:
        MeasurementError: it turned between two poses.
    """
    for (before, first), (after, second) in pairwise(lies_deg.items()):
        turned = (second - first + 0.5 * period_deg) % period_deg - 0.5 * period_deg
        if abs(turned) > limit_deg:
            raise MeasurementError(
                f"between {before:g}° and {after:g}° the part turned by {turned:+.1f}° on its fixture (limit "
                f"±{limit_deg:g}°, limits.part_turn_deg): seat the part so that it cannot slip"
            )


def check_dirt(views: list[View], measured: Measured, threshold: float) -> tuple[str, ...]:
    """Detect stationary dirt: deviations at fixed pixels while the part turns.

    Cells are compared with their flank in every pose. Dirt on lens, sensor or white tile makes the same cells of the
    *picture* deviate in every pose, whereas a mark on the part moves. The number expected by chance follows from the
    number of deviating cells in each pose. Notes as of `check_part`.
    """
    turned = [
        i for i, v in enumerate(views) if i == 0 or abs(angle_between(views[0].stage_deg, v.stage_deg)) > 1.0
    ]
    if len(turned) < 2 or measured.cells.shape[1] * measured.cells.shape[2] < LEAST_CELLS:
        few = "one stage angle" if len(turned) < 2 else f"fewer than {LEAST_CELLS} cells"
        return (f"not watched: dirt on lens and white tile ({few})",)
    maps = [_off_flank(measured.cells[i]) for i in turned]
    first, shape = maps[0], maps[0].shape
    fixed, chance = np.abs(first) > threshold, float(np.mean(np.abs(first) > threshold))
    known, moved = np.ones(shape, dtype=bool), np.zeros(shape, dtype=bool)
    for i, other in zip(turned[1:], maps[1:], strict=True):
        at = _same_pixels(views[0], views[i], measured.grid, shape)
        observed = _looked_up(other, at)
        moved |= np.hypot(*np.moveaxis(at - _cell_indices(shape)[..., :2], -1, 0)) > STILL_CELLS
        known &= np.isfinite(observed)
        fixed &= np.sign(first) * observed > threshold
        chance *= 0.5 * float(np.mean(np.abs(other) > threshold))
    fixed &= known & moved
    expected = chance * float((known & moved).sum())
    if fixed.sum() > expected + 6.0 * np.sqrt(expected) + 3.0:
        column, row = _place_of(fixed, views[0], measured.grid)
        raise CalibrationError(
            f"something stays at column {column:.0f}, row {row:.0f} of the picture while the part turns "
            f"({int(fixed.sum())} cells): clean lens and camera, then the white tile, and take a new flat with "
            "`anisoscope calibrate flat`"
        )
    return ()


def _looked_up(cells: FloatArray, at: Image) -> Image:
    """The nearest cell of every place; NaN outside."""
    return np.asarray(
        cv2.remap(
            cells.astype(np.float32),
            at[..., 0],
            at[..., 1],
            cv2.INTER_NEAREST,
            borderMode=cv2.BORDER_CONSTANT,
            borderValue=(float("nan"),),
        )
    )


def _off_flank(cells: FloatArray) -> FloatArray:
    """Ln ratio of every cell to the median along its flank."""
    logs = np.log(np.maximum(cells, 1e-6))
    return np.asarray(logs - np.median(logs, axis=0))


def _cells_to_pixels(view: View, grid: Grid, cols: int) -> FloatArray:
    """(3, 3) map from (column, row, 1) of cells, ``cols`` in a row, to (column, row, 1) of the picture."""
    side = grid.shape[1] / cols
    centres = np.array([[side, 0.0, (side - 1.0) / 2.0], [0.0, side, (side - 1.0) / 2.0], [0.0, 0.0, 1.0]])
    return np.asarray(view.placement.homography @ grid.to_mm() @ centres)


def _same_pixels(first: View, other: View, grid: Grid, shape: tuple[int, ...]) -> Image:
    """(rows, cols, 2) column and row of the other view's cell on the same pixels as each cell of the first."""
    to_first, to_other = (_cells_to_pixels(view, grid, shape[1]) for view in (first, other))
    at = _cell_indices(shape) @ (np.linalg.inv(to_other) @ to_first).T
    return np.asarray(at[..., :2] / at[..., 2:], dtype=np.float32)


def _cell_indices(shape: tuple[int, ...]) -> FloatArray:
    """(rows, cols, 3) column, row, 1 of every cell."""
    row, column = np.indices(shape).astype(np.float64)
    return np.stack([column, row, np.ones(shape)], axis=-1)


def _place_of(cells: npt.NDArray[np.bool_], view: View, grid: Grid) -> tuple[float, float]:
    """Column and row in the picture of the median cell of a set."""
    row, column = (float(np.median(index)) for index in np.nonzero(cells))
    observed = _cells_to_pixels(view, grid, cells.shape[1]) @ [column, row, 1.0]
    return float(observed[0] / observed[2]), float(observed[1] / observed[2])
