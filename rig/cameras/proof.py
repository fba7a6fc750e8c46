"""The proof that auto exposure is off: brightness has to follow the exposure, and to come back with it.

A camera may say that auto exposure is off and adjust nevertheless, by gain if not by exposure.
"""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from anisoscope.base.errors import CameraError, UsageError
from anisoscope.rig.camera import Camera
from anisoscope.rig.frame import SATURATION

BENT = (0.3, 1.3)
"""Exponents between which brightness may follow the exposure where counts are not linear: 1/2.2 is usual."""
_LEAST_SIGNAL = 0.02
_MOST_CLIPPED = 0.01
_LEAST_FACTOR = 1.5


@dataclass(frozen=True)
class ExposureProof:
    """Measured exposures of a camera.

    Attributes:
        exposures_s: exposures that the camera reported, the first one again at the end.
        signals: mean counts above dark at each of them.
        exponents: d ln(signal)/d ln(exposure) between neighbours; 1 for a linear camera.
        drift: largest relative change of brightness while the exposure stood.
    """

    exposures_s: tuple[float, ...]
    signals: tuple[float, ...]
    exponents: tuple[float, ...]
    drift: float


def prove_exposure(
    camera: Camera,
    exposures_s: Sequence[float],
    *,
    gain: float = 1.0,
    dark_counts: float | None = None,
    tolerance: float = 0.05,
    frames: int = 3,
) -> ExposureProof:
    """Photograph a still, lit scene with several exposures, and with the first one again.

    Args:
        camera: the camera; it is left with the first exposure.
        exposures_s: two or more exposures in seconds, in any order.
        gain: gain as a factor.
        dark_counts: mean counts with the light off; the black level if not given.
        tolerance: largest relative deviation of brightness from proportion, of a return and of a drift. A camera
            that is not linear need not keep proportion: the exponent has to lie within `BENT`.
        frames: frames at each exposure.

    Raises:
        UsageError: fewer than two exposures, or they hardly differ.
        CameraError: brightness does not follow; or the scene is too dark or too bright to tell.
    """
    if len(exposures_s) < 2 or max(exposures_s) < _LEAST_FACTOR * min(exposures_s):
        raise UsageError(
            f"a proof of the exposure needs two exposures that differ by {_LEAST_FACTOR} or more"
        )
    dark = camera.info.black_level if dark_counts is None else dark_counts
    times, signals, drift = [], [], 0.0
    for exposure_s in (*exposures_s, exposures_s[0]):
        time_s, signal, change = _measure(camera, exposure_s, gain, dark, frames)
        if change > tolerance:
            raise CameraError(
                f"brightness changes by {100 * change:.0f} % while the exposure stands at {time_s:g} s: auto "
                "exposure or auto gain is at work, or the light is not steady"
            )
        times.append(time_s)
        signals.append(signal)
        drift = max(drift, change)
    if abs(signals[-1] / signals[0] - 1.0) > tolerance:
        raise CameraError(
            f"brightness does not come back with the exposure of {times[0]:g} s: {signals[0]:.1f} counts before, "
            f"{signals[-1]:.1f} after; auto exposure is at work, or the light is not steady"
        )
    order = np.argsort(times[:-1])
    pairs = [(a, b) for a, b in itertools.pairwise(order) if times[b] > times[a]]
    exponents = [_follow(camera, times, signals, pair, tolerance) for pair in pairs]
    if not exponents:
        raise CameraError(f"the camera takes all of these exposures as {times[0]:g} s; choose others")
    return ExposureProof(tuple(times), tuple(signals), tuple(exponents), drift)


def _measure(
    camera: Camera, exposure_s: float, gain: float, dark: float, frames: int
) -> tuple[float, float, float]:
    settings = camera.configure(exposure_s, gain)
    full_scale = (1 << camera.info.bit_depth) - 1
    pictures = [camera.grab() for _ in range(max(frames, 2))]
    clipped = max(float(np.mean(counts >= SATURATION * full_scale)) for counts in pictures)
    means = [float(counts.mean()) - dark for counts in pictures]
    if clipped > _MOST_CLIPPED:
        raise CameraError(
            f"{100 * clipped:.0f} % of the pixels are clipped at {settings.exposure_s:g} s: too bright for a "
            "proof of the exposure; take shorter ones"
        )
    if min(means) < _LEAST_SIGNAL * full_scale:
        raise CameraError(
            f"only {min(means):.1f} counts above dark at {settings.exposure_s:g} s: too dark for a proof of the "
            "exposure; switch the light on, or take longer ones"
        )
    mean = float(np.mean(means))
    return settings.exposure_s, mean, (max(means) - min(means)) / mean


def _follow(
    camera: Camera, times: Sequence[float], signals: Sequence[float], pair: tuple[int, int], tolerance: float
) -> float:
    a, b = pair
    longer, brighter = times[b] / times[a], signals[b] / signals[a]
    exponent = math.log(brighter) / math.log(longer)
    in_proportion = abs(brighter / longer - 1.0) <= tolerance
    bent = not camera.info.linear and BENT[0] <= exponent <= BENT[1]
    if not (in_proportion or bent):
        raise CameraError(
            f"the exposure grew x{longer:.3g} from {times[a]:g} s to {times[b]:g} s, the brightness "
            f"x{brighter:.3g}: auto exposure or auto gain is at work, or the exposure is not what the camera says"
        )
    return exponent
