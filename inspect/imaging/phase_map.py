"""Phase map: where every point of the aligned pictures lies across its ridge, and pitch and turn of the ridges.

The wave of the ridges is demodulated: a picture times exp(−2πi·x/p), averaged over some pitches, has the phase of the
ridges about it (Takeda, Ina and Kobayashi, J. Opt. Soc. Am. 72, 1982). Turn, pitch and the bend that a lens leaves are
a surface of second degree fitted to these phases, so that a missing ridge or a scratch does not bend it. Crest and wall
stand where the mean profile of a pitch differs from the plain facet.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from weakref import WeakKeyDictionary

import cv2
import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import MeasurementError
from anisoscope.imaging.pose_radiance import Image, Measured

POINTS_RESOLVED = 8.0
"""Points a pitch below which facet and wall blur into each other."""
SPAN_PITCHES = 1.0  # of the average: its standard deviation across and along
BINS = 64  # of a pitch
PASSES, ROUNDS = 3, 4
"""The average bends phases at the rim of a picture unless its carrier has them already: it is made again."""
CLEAR = 0.02  # amplitude of the wave over the mean radiance
LEAST_PITCHES = 3
USUAL_SHARE, UNUSUAL_SPREADS, UNUSUAL_LOG = 0.4, 6.0, 0.3
"""Share of the pitches whose ln L is closest together; beyond so many of their spreads, or 0.3, a pitch is unusual."""
_SAMPLE = 2000
MOST_SCATTER = 0.06
"""Scatter of the phases in pitches from which on no course describes them; good parts have 0.02 at the most."""
MOST_MEDIANS = 5.0  # a mirroring scratch outshines all ridges about it


@dataclass(frozen=True, eq=False)
class PhaseMap:
    """Where the points of a raster lie across their ridges.

    Attributes:
        place: (rows, cols) in pitches; a whole number is a crest, from which a facet falls towards greater places.
        pitch_um: mean pitch.
        turn_deg: how far the ridges run counter-clockwise from the columns.
        scatter: robust standard deviation of the phases about the fitted surface, in pitches.
    """

    place: FloatArray
    pitch_um: float
    turn_deg: float
    scatter: float


_MADE: WeakKeyDictionary[Measured, dict[tuple[float, float | None], PhaseMap]] = WeakKeyDictionary()


def phases_of(
    measured: Measured, pitch_um: float, wall: float | None, least_points: float = POINTS_RESOLVED
) -> PhaseMap:
    """The ridges in the pictures of a part, found once; arguments and errors as for `phase_map`."""
    pixel_um = 1000.0 * measured.grid.pixel_mm
    _check_points(pixel_um, pitch_um, least_points)
    made = _MADE.setdefault(measured, {})
    if (pitch_um, None) not in made:
        made[pitch_um, None] = phase_map(measured.aligned, pixel_um, pitch_um, None, least_points)
    found = made[pitch_um, None]
    if wall is not None and (pitch_um, wall) not in made:
        made[pitch_um, wall] = replace(
            found, place=found.place - crest_of(measured.aligned, found.place, wall)
        )
    return made[pitch_um, wall]


def _check_points(pixel_um: float, pitch_um: float, least_points: float) -> None:
    pitch = pitch_um / pixel_um
    if pitch < least_points:
        raise MeasurementError(
            f"a pitch of {pitch_um:g} µm has {pitch:.1f} points of {pixel_um:g} µm, facets are seen from "
            f"{least_points:g} on: take a lens of greater magnification"
        )


def phase_map(
    aligned: Sequence[Image],
    pixel_um: float,
    pitch_um: float,
    wall: float | None,
    least_points: float = POINTS_RESOLVED,
) -> PhaseMap:
    """Find the ridges in aligned pictures.

    Args:
        aligned: P pictures (rows, cols) whose columns follow the ridges within some degrees.
        pixel_um: distance of their points.
        pitch_um: pitch of the recipe; that of the pictures may differ by some percent.
        wall: width of the wall as a share of the pitch; None: places count from anywhere.
        least_points: points that a pitch needs.

    Raises:
        MeasurementError: the pitch has fewer points, the pictures hold fewer than three
            ridges, or show no ridges.
    """
    pitch = pitch_um / pixel_um
    rows, cols = aligned[0].shape
    _check_points(pixel_um, pitch_um, least_points)
    if min(rows, cols) < LEAST_PITCHES * pitch:
        raise MeasurementError(
            f"the region holds {min(rows, cols) / pitch:.1f} pitches, the phase of the ridges needs {LEAST_PITCHES}: "
            "make region.size_mm larger"
        )
    step = max(1, int(pitch / POINTS_RESOLVED))
    block = max(1, int(0.5 * pitch / step))
    small = [_reduced(one, step, block) for one in aligned]
    means = [float(one.mean()) for one in small]
    calm = [_usual_ridges(one, pitch / step) for one in small]
    surface, scatter = np.zeros((3, 3)), 0.0
    for _ in range(PASSES):
        at_row, at_col = (_unit_places(size, 1) for size in small[0].shape)
        bend = np.asarray(np.polynomial.polynomial.polygrid2d(at_row, at_col, surface), dtype=np.float64)
        together = _together([_demodulated(one, pitch / step, bend, block) for one in calm], means)
        if together is None:
            raise MeasurementError(
                "no pose shows the ridges clearly enough to find their phase: is the part in the fixture, and in focus?"
            )
        more, scatter = _surface(together)
        surface += more
    if scatter > MOST_SCATTER:
        raise MeasurementError(
            f"the phase of the ridges scatters by {scatter:.2f} pitches about its course: many ridges are missing or "
            "spoiled, or they are not those of the recipe"
        )
    at_row, at_col = (_unit_places(size, step * block) for size in (rows, cols))
    turned = np.asarray(np.polynomial.polynomial.polygrid2d(at_row, at_col, surface), dtype=np.float64)
    place = (np.arange(cols) - 0.5 * (cols - 1)) / pitch + turned / (2.0 * np.pi)
    if wall is not None:
        place -= crest_of(aligned, place, wall)
    known = (rows // (step * block) * step * block, cols // (step * block) * step * block)
    slope_rows, slope_cols = _mean_slopes(surface, known)
    across = 1.0 / pitch + slope_cols
    frequency = float(np.hypot(across, slope_rows))
    # rows count downwards
    turn = float(np.degrees(np.arctan2(slope_rows, across)))
    return PhaseMap(place, pixel_um / frequency, turn, scatter)


def _reduced(picture: Image, step: int, block: int) -> Image:
    rows, cols = (size // (step * block) * step * block for size in picture.shape)
    known = picture[:rows, :cols]
    if not np.isfinite(known.sum(dtype=np.float64)):
        known = np.nan_to_num(known, nan=float(np.nanmean(picture)))
    small = cv2.resize(known, (cols // step, rows // step), interpolation=cv2.INTER_AREA)
    return np.asarray(np.minimum(small, MOST_MEDIANS * np.median(small)), dtype=np.float32)


def _usual_ridges(picture: Image, pitch: float) -> Image:
    """The picture less its mean over some pitches; 0 where a pitch is far brighter or darker than most are.

    A missing ridge mirrors at other poses than the others, brighter than their waves by far, at a phase of its own.
    """
    side = max(1, round(pitch))
    levels = np.log(np.maximum(cv2.blur(picture, (side, side), borderType=cv2.BORDER_REFLECT), 1e-12))
    ordered = np.sort(levels, axis=None)[:: max(1, levels.size // _SAMPLE)]
    count = int(USUAL_SHARE * ordered.size)
    first = int(np.argmin(ordered[count:] - ordered[: ordered.size - count]))
    low, high = float(ordered[first]), float(ordered[first + count])
    near = np.abs(levels - 0.5 * (low + high)) < max(0.5 * UNUSUAL_SPREADS * (high - low), UNUSUAL_LOG)
    usual = near.astype(np.float32)
    total, weight = (
        cv2.GaussianBlur(one, (0, 0), pitch, borderType=cv2.BORDER_REFLECT)
        for one in (picture * usual, usual)
    )
    return np.asarray(usual * (picture - total / np.maximum(weight, 1e-6)), dtype=np.float32)


def _demodulated(calm: Image, pitch: float, bend: FloatArray, block: int) -> npt.NDArray[np.complex128]:
    """Complex amplitude of the wave about every block of points; its phase is that beyond carrier and ``bend``."""
    rows, cols = calm.shape
    carrier = 2.0 * np.pi * (np.arange(cols) - 0.5 * (cols - 1)) / pitch
    phase = (carrier + bend).astype(np.float32)
    sigma, size = SPAN_PITCHES * pitch, (cols // block, rows // block)
    real, imaginary = (
        cv2.resize(
            cv2.GaussianBlur(part, (0, 0), sigma, borderType=cv2.BORDER_REFLECT),
            size,
            interpolation=cv2.INTER_AREA,
        ).astype(np.float64)
        for part in (calm * np.cos(phase), -calm * np.sin(phase))
    )
    return np.asarray(real + 1j * imaginary)


def _together(
    waves: Sequence[npt.NDArray[np.complex128]], means: Sequence[float]
) -> npt.NDArray[np.complex128] | None:
    """The waves of all poses in the phase of the clearest, weighted by their amplitudes over their means."""
    scaled = [wave / max(mean, 1e-300) for wave, mean in zip(waves, means, strict=True)]
    sizes = [float(np.median(np.abs(wave))) for wave in scaled]
    clearest = int(np.argmax(sizes))
    if sizes[clearest] < CLEAR:
        return None
    total = np.zeros_like(scaled[0])
    for wave in scaled:
        shift = np.sum(wave * np.conj(scaled[clearest]))
        total += wave * np.conj(shift) / max(abs(shift), 1e-300) * np.abs(wave)
    return total


def _unit_places(size: int, step: int) -> FloatArray:
    """Places of points along an axis, −1 to 1 over that of the reduced picture."""
    half = 0.5 * (size // step * step)
    return np.asarray((np.arange(size) + 0.5 - half) / half, dtype=np.float64)


def _surface(wave: npt.NDArray[np.complex128]) -> tuple[FloatArray, float]:
    """(3, 3) coefficients of the phase over row and column, each −1 to 1, and its scatter in pitches."""
    rows, cols = wave.shape
    at_row, at_col = np.meshgrid(*(_unit_places(size, 1) for size in (rows, cols)), indexing="ij")
    found = np.zeros((3, 3))
    weight = np.abs(wave)
    # the steepest part first, as the phase between neighbours, which never wraps
    down = np.angle(np.sum(wave[1:] * np.conj(wave[:-1])))
    right = np.angle(np.sum(wave[:, 1:] * np.conj(wave[:, :-1])))
    found[1, 0], found[0, 1] = 0.5 * rows * down, 0.5 * cols * right
    terms = [(0, 0), (0, 1), (1, 0), (1, 1), (0, 2), (2, 0)]
    columns = np.stack([(at_row**i * at_col**j).ravel() for i, j in terms], axis=1)
    scatter = 0.0
    for _ in range(ROUNDS):
        left = wave * np.exp(-1j * np.polynomial.polynomial.polyval2d(at_row, at_col, found))
        left *= np.exp(-1j * np.angle(left.sum()))
        start = np.angle(
            np.sum(wave * np.exp(-1j * np.polynomial.polynomial.polyval2d(at_row, at_col, found)))
        )
        off = np.angle(left).ravel()
        scatter = 1.4826 * float(np.median(np.abs(off)))
        near = np.abs(off) < max(3.0 * scatter, 1e-3)
        counted = np.sqrt(weight.ravel()) * near
        more = np.linalg.lstsq(columns * counted[:, None], off * counted, rcond=None)[0]
        for (i, j), value in zip(terms, more, strict=True):
            found[i, j] += value
        found[0, 0] += start
    return found, scatter / (2.0 * np.pi)


def _mean_slopes(surface: FloatArray, shape: tuple[int, int]) -> tuple[float, float]:
    """Slopes of the phase down and to the right in the middle of a raster, in pitches a point."""
    return (
        float(surface[1, 0] / (np.pi * shape[0])),
        float(surface[0, 1] / (np.pi * shape[1])),
    )


def profile_over(place: FloatArray, values: FloatArray) -> FloatArray:
    """(`BINS`,) mean of values by their place within a pitch; a bin without any lies between its neighbours."""
    known = np.isfinite(values)
    number = (np.mod(place[known], 1.0) * BINS).astype(np.intp) % BINS
    count = np.bincount(number, minlength=BINS)
    total = np.bincount(number, values[known], minlength=BINS)
    filled = np.flatnonzero(count)
    return np.interp(np.arange(BINS), filled, total[filled] / count[filled], period=BINS)


def crest_of(aligned: Sequence[Image], place: FloatArray, wall: float) -> float:
    """Place at which the crests stand.

    Facets are plain: what differs from them, darker or brighter, is the wall with crest and foot.

    Args:
        aligned: P pictures (rows, cols) in 1/sr.
        place: (rows, cols) places of their points in pitches from anywhere.
        wall: width of the wall as a share of the pitch.
    """
    off = np.zeros(BINS)
    for picture in aligned:
        calm = np.minimum(picture, MOST_MEDIANS * np.nanmedian(picture)).astype(np.float64)
        logs = np.log(np.maximum(profile_over(place, calm), 1e-12))
        off += (logs - np.median(logs)) ** 2
    middles = (np.arange(BINS) + 0.5) / BINS
    centre = float(np.angle(np.sum(off * np.exp(2j * np.pi * middles)))) / (2.0 * np.pi)
    return centre + 0.5 * wall
