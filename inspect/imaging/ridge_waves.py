"""Waves of the ridges in the aligned pictures: pitch and direction in every pose, and whether they are the recipe's.

A gate that could not see what it watches returns a note for the record.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import MeasurementError
from anisoscope.imaging.pose_radiance import Measured
from anisoscope.imaging.registration.placement import Grid
from anisoscope.recipe.surface import SurfaceRecipe

Image = npt.NDArray[np.float32]

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
        None where the ridges do not stand out, or are not resolved, or no pictures were stored.
    """
    if not measured.aligned:
        return None
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
