"""Watch the lamp of an opened rig, and say whether it is warm."""

import time
from collections.abc import Callable
from typing import Protocol

import numpy as np

from anisoscope.calibration.warmup import ALLOWED_PER_MINUTE, WarmUp, fit_warmup
from anisoscope.errors import CalibrationError
from anisoscope.rig.camera import Camera
from anisoscope.rig.frame import SATURATION
from anisoscope.rig.light import Light

MAX_SATURATED = 0.01
MIN_LEVEL = 0.01


class Lit(Protocol):
    """What a rig needs for its lamp to be watched."""

    @property
    def camera(self) -> Camera:
        """The camera."""
        ...

    @property
    def light(self) -> Light:
        """The light."""
        ...


def watch_lamp(
    rig: Lit,
    *,
    exposure_s: float,
    gain: float = 1.0,
    frames: int = 60,
    interval_s: float = 1.0,
    region: tuple[slice, slice] | None = None,
    allowed_per_minute: float = ALLOWED_PER_MINUTE,
    clock: Callable[[], float] = time.monotonic,
    sleep: Callable[[float], None] = time.sleep,
) -> WarmUp:
    """Switch the lamp on, take a frame every so often, and judge the series. The stage stays where it is.

    Args:
        rig: an opened rig.
        exposure_s: exposure in seconds; frames must not be saturated.
        gain: gain as a factor.
        frames: number of frames.
        interval_s: time between two frames, in seconds.
        region: rows and columns over which brightness is averaged; by default the middle quarter of the picture.
        allowed_per_minute: drift that counts as warm, as a share per minute.
        clock: gives the time in seconds.
        sleep: waits for a time in seconds.

    Raises:
        UsageError: too few frames.
        CalibrationError: the lamp is dark, or the frames are saturated.
        RigError: a device fails.
    """
    info = rig.camera.info
    rows, cols = region or _middle(info.rows, info.cols)
    rig.camera.configure(exposure_s, gain)
    rig.light.on()
    full_scale = 2**info.bit_depth - 1
    start = clock()
    times, levels = [], []
    for number in range(frames):
        sleep(max(0.0, start + number * interval_s - clock()))
        times.append(clock() - start)
        counts = rig.camera.grab()[rows, cols]
        if np.mean(counts >= SATURATION * full_scale) > MAX_SATURATED:
            raise CalibrationError(
                f"the frames are saturated at {exposure_s:g} s; watch the lamp with a shorter exposure"
            )
        levels.append(float(counts.mean()) - info.black_level)
    if np.mean(levels) < MIN_LEVEL * full_scale:
        raise CalibrationError(
            f"the frames are dark at {exposure_s:g} s; uncover the lens, or watch with a longer exposure"
        )
    return fit_warmup(times, levels, allowed_per_minute=allowed_per_minute)


def _middle(rows: int, cols: int) -> tuple[slice, slice]:
    return slice(rows // 4, rows - rows // 4), slice(cols // 4, cols - cols // 4)
