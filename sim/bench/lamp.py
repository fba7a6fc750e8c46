"""The lamp of the bench: how bright it is, and how it warms up, drifts and flickers from frame to frame."""

import math
from collections.abc import Callable

import numpy as np

from anisoscope.sim.bench.benchfile import OpticsPart


class Lamp:
    """A lamp that one light switches and a camera sees.

    Args:
        part: drift, noise and warm-up.
        rng: noise.

    Attributes:
        attend: called before the level is read; a light that may switch itself off does it here.
    """

    def __init__(self, part: OpticsPart, rng: np.random.Generator) -> None:
        self.attend: Callable[[], None] = lambda: None
        self._part = part
        self._rng = rng
        self._level = 0.0
        self._frames_lit = 0
        self._warmth = 0.0

    @property
    def level(self) -> float:
        """Share of full brightness to which it is set, 0 … 1; 0 is off."""
        self.attend()
        return self._level

    @level.setter
    def level(self, share: float) -> None:
        self._level = min(max(share, 0.0), 1.0)

    def brightness(self) -> float:
        """Brightness during the next frame; 1 is that of a warm lamp at full level, at the begin of its drift."""
        level, part = self.level, self._part
        keeps_cold = math.exp(-1.0 / part.lamp_warmup_frames)
        if level == 0.0:
            self._warmth *= keeps_cold
            return 0.0
        lamp = 1.0 + part.lamp_noise * self._rng.standard_normal()
        lamp *= 1.0 + part.lamp_drift_per_frame * self._frames_lit
        lamp *= 1.0 + part.lamp_warmup_share * (1.0 - self._warmth)
        self._frames_lit += 1
        self._warmth = 1.0 - (1.0 - self._warmth) * keeps_cold
        return lamp * level
