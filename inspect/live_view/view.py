"""Numbers of a live picture for adjusting a rig: focus, saturation, histogram, direction of the ridges.

Pure functions of a frame's counts, (rows, cols). What cannot be told from a frame is NaN or None, never a guess.
"""

import math
from collections import deque
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import cv2
import numpy as np
import numpy.typing as npt

from anisoscope.base.json_fields import json_field
from anisoscope.parameters.taking import FocusMeasure
from anisoscope.rig.bayer import grey_of
from anisoscope.rig.camera import CameraInfo
from anisoscope.rig.frame import SATURATION

if TYPE_CHECKING:
    from anisoscope.live_view.lamps import Lamp

Counts = npt.NDArray[np.uint16]
Plane = npt.NDArray[np.float32]

DARK_SHARE = 0.005
MIN_MIDDLE_PX, MAX_MIDDLE_PX = 32, 512
MIN_RIDGES = 3.0
MAX_FREQUENCY = 0.4
RINGS = 10
MIN_PROMINENCE = 30.0
MIN_MODULATION = 0.002
RIVAL_SHARE, RIVAL_SINE, RIVAL_STEPS = 0.5, 0.2, 2.5
TINY = 1e-30
FRAMES_FOR_SPEED = 20


@dataclass(frozen=True)
class View:
    """Numbers of one frame.

    Attributes:
        mean: mean count above black, as a share of full scale above black.
        saturated_share: share of pixels at or above 98 % of full scale.
        focus: focus measure, 1/px²; NaN where the picture is too dark to tell.
        ridge_deg: direction of the ridges, see `ridge_direction`; None where there is none.
        prominence: power of the ridges over that of other structure as fine, see `ridge_direction`.
        histogram: share of pixels in equal bins from black to full scale; sums to 1.
    """

    mean: float
    saturated_share: float
    focus: float
    ridge_deg: float | None
    prominence: float
    histogram: tuple[float, ...]


@dataclass(frozen=True)
class Reading:
    """A view in its sequence: focus over the best focus so far (NaN if too dark), frame rate, lamps of the rig."""

    frame: int
    view: View = field(metadata=json_field(merged=True))
    relative_focus: float
    frames_per_s: float
    lamps: "tuple[Lamp, ...]" = field(default=(), metadata=json_field(only_given=True))


class Meter:
    """Running maximum of the focus, and the frame rate."""

    def __init__(self) -> None:
        self._best = 0.0
        self._frames = 0
        self._times: deque[float] = deque(maxlen=FRAMES_FOR_SPEED)

    def read(self, view: View, time_s: float, lamps: "tuple[Lamp, ...]" = ()) -> Reading:
        """Take the next view, seen at a monotonic time in seconds; frames per second are NaN at the first."""
        self._frames += 1
        self._times.append(time_s)
        self._best = max(self._best, view.focus)  # NaN is larger than nothing
        passed = self._times[-1] - self._times[0]
        speed = (len(self._times) - 1) / passed if passed > 0.0 else math.nan
        relative = view.focus / self._best if self._best > 0.0 else math.nan
        return Reading(self._frames, view, relative, speed, lamps)


def look_at(counts: Counts, info: CameraInfo, *, focus: FocusMeasure = "tenengrad", bins: int = 32) -> View:
    """Evaluate a frame of a camera; of a colour camera, focus and ridges without the pattern of its mosaic.

    Args:
        counts: (rows, cols) raw counts.
        info: what took them; gives full scale and black level.
        focus: by which measure.
        bins: of the histogram.
    """
    signal = signal_of(counts, info)
    grey = signal if info.filters == "mono" else signal_of(grey_of(counts, info.filters), info)
    direction, prominence = ridge_direction(grey)
    return View(
        mean=float(signal.mean()),
        saturated_share=saturated_share(counts, info.bit_depth),
        focus=focus_of(grey, focus),
        ridge_deg=direction,
        prominence=prominence,
        histogram=histogram_of(signal, bins),
    )


def signal_of(counts: Counts, info: CameraInfo) -> Plane:
    """Counts above black as a share of full scale above black, (rows, cols)."""
    span = ((1 << info.bit_depth) - 1) - info.black_level
    return np.asarray((counts.astype(np.float32) - np.float32(info.black_level)) / np.float32(span))


def saturated_share(counts: Counts, bit_depth: int) -> float:
    """Share of pixels at or above 98 % of full scale."""
    return float(np.mean(counts >= SATURATION * ((1 << bit_depth) - 1)))


def focus_of(signal: Plane, measure: FocusMeasure = "tenengrad") -> float:
    """Sharpness of a picture; larger is sharper, independent of exposure.

    Tenengrad: mean squared Sobel gradient. Laplacian: variance of the Laplacian. Both of the picture with its noise
    smoothed a little, and over its squared mean. Comparable between pictures of the same object only.
    Source: Pertuz, Puig, Garcia, "Analysis of focus measure operators", Pattern Recognition 46 (2013).

    Returns:
        1/px² (Tenengrad) or 1/px⁴; NaN where the mean is below 0.5 % of full scale: noise would be taken for detail.
    """
    mean = float(signal.mean())
    if mean < DARK_SHARE:
        return math.nan
    calm = np.asarray(cv2.GaussianBlur(signal, (0, 0), 1.0), dtype=np.float32)
    if measure == "laplacian":
        return float(cv2.Laplacian(calm, cv2.CV_32F).var()) / mean**2
    across, down = _gradient(calm)
    return float(np.mean(across**2 + down**2)) / mean**2


def ridge_direction(signal: Plane) -> tuple[float | None, float]:
    """Direction of the ridges from the spectrum of the picture's middle.

    Ridges repeat, so their power stands in a sharp peak (and its harmonics, on the same line), while roughness,
    shading and noise spread theirs. A peak is what stands far above the median of its ring of frequencies, and
    modulates the picture noticeably; ridges run across the strongest one.

    Returns:
        Degrees counter-clockwise from the upright of the picture, above −90 and up to 90; None where there is no peak
        (dark, no ridges, ridges not resolved) or one about as strong in another direction. And the power of the
        strongest peak over the background of its ring, 0 without one.
    """
    middle = _middle(signal)
    if min(middle.shape) < MIN_MIDDLE_PX or float(middle.mean()) < DARK_SHARE:
        return None, 0.0
    power, ratio, up, across = _spectrum(middle)
    peaks = np.where(ratio >= MIN_PROMINENCE, power, 0.0)
    row, col = (int(place) for place in np.unravel_index(int(np.argmax(peaks)), peaks.shape))
    if math.sqrt(float(peaks[row, col])) < MIN_MODULATION * float(middle.mean()):
        return None, 0.0
    main_up, main_across = float(up[row, col]), float(across[row, col])
    away = np.abs(up * main_across - across * main_up) / math.hypot(main_up, main_across)
    elsewhere = (away > RIVAL_SINE * np.hypot(up, across)) & (away > RIVAL_STEPS)
    if float(np.max(peaks[elsewhere], initial=0.0)) > RIVAL_SHARE * peaks[row, col]:
        return None, float(ratio[row, col])
    weight = np.where(elsewhere, 0.0, peaks)
    # the axis on which the peak and its harmonics lie; ridges run across it, a quarter turn from the x axis
    double = math.atan2(
        2.0 * float(np.sum(weight * up * across)), float(np.sum(weight * (across**2 - up**2)))
    )
    return wrapped_deg(math.degrees(0.5 * double)), float(ratio[row, col])


def _spectrum(middle: Plane) -> tuple[Plane, Plane, Plane, Plane]:
    """Spectrum of a square picture without its shading.

    Returns:
        Power as squared amplitude of a wave; power over the background of its ring, 0 where no ridges are looked for;
        and the frequencies up and across, in periods per picture.
    """
    size = middle.shape[0]
    window = np.hanning(size).astype(np.float32)
    spectrum = np.fft.fftshift(np.fft.fft2(_without_shading(middle) * np.outer(window, window)))
    power = np.asarray((2.0 * np.abs(spectrum) / window.sum() ** 2) ** 2, dtype=np.float32)
    up = -np.fft.fftshift(np.fft.fftfreq(size, 1.0 / size)).astype(np.float32)[:, None]  # rows grow downwards
    across = -up.T
    radius = np.hypot(up, across)
    edges = np.geomspace(MIN_RIDGES, MAX_FREQUENCY * size, RINGS + 1)
    ring = np.searchsorted(edges, radius, side="right")
    ratio = np.zeros_like(power)
    for number in range(1, RINGS + 1):
        inside = ring == number
        background = float(np.median(power[inside])) / math.log(2.0)  # the mean of noise with this median
        ratio[inside] = power[inside] / max(background, TINY)
    return power, ratio, np.broadcast_to(up, power.shape), np.broadcast_to(across, power.shape)


def _without_shading(middle: Plane) -> Plane:
    """A square picture less its best parabola (by Legendre polynomials, which hardly share anything)."""
    at = np.linspace(-1.0, 1.0, middle.shape[0], dtype=np.float32)
    shapes = np.ones_like(at), at, 1.5 * at**2 - 0.5
    left = middle.copy()
    for down, across in ((0, 0), (0, 1), (1, 0), (1, 1), (0, 2), (2, 0)):
        rows, cols = shapes[down], shapes[across]
        share = float(rows @ left @ cols) / float((rows @ rows) * (cols @ cols))
        left -= share * np.outer(rows, cols)
    return left


def wrapped_deg(angle_deg: float) -> float:
    """The same direction of a line, above −90° and up to 90°."""
    return 90.0 - (90.0 - angle_deg) % 180.0


def histogram_of(signal: Plane, bins: int) -> tuple[float, ...]:
    """Share of pixels in equal bins from black to full scale; the outer bins include what is beyond."""
    numbers = np.clip((signal * bins).astype(np.int32), 0, bins - 1)
    found = np.bincount(numbers.ravel(), minlength=bins) / signal.size
    return tuple(float(share) for share in found)


def _middle(signal: Plane) -> Plane:
    """Central square, half as wide as the picture is high or wide, inside the markers of a fixture."""
    size = min(*signal.shape, 2 * MAX_MIDDLE_PX) // 4 * 2
    top, left = (signal.shape[0] - size) // 2, (signal.shape[1] - size) // 2
    return np.ascontiguousarray(signal[top : top + size, left : left + size])


def _gradient(plane: Plane) -> tuple[Plane, Plane]:
    across = cv2.Sobel(plane, cv2.CV_32F, 1, 0, ksize=3, scale=0.125)
    down = cv2.Sobel(plane, cv2.CV_32F, 0, 1, ksize=3, scale=0.125)
    return np.asarray(across, dtype=np.float32), np.asarray(down, dtype=np.float32)
