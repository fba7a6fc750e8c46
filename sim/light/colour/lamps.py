"""A synthetic white LED for virtual rigs and examples; spectra of real lamps are measured."""

from functools import cache

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.sim.light.colour.illuminant import Illuminant

LED_WHITE = "led-white"
STEP_NM = 5.0


def skewed(nm: FloatArray, peak_nm: float, left_nm: float, right_nm: float) -> FloatArray:
    """A bell of height 1 whose two sides have standard deviations of their own."""
    width = np.where(nm < peak_nm, left_nm, right_nm)
    return np.asarray(np.exp(-0.5 * ((nm - peak_nm) / width) ** 2))


@cache
def synthetic_white_led() -> Illuminant:
    """A phosphor-converted white LED: a blue line of 21 nm FWHM at 452 nm, and the broad bell of a phosphor.

    Made up, after the shape that such lamps have (CIE 015:2018, LED-B series); about 4600 K.
    """
    nm = np.arange(380.0, 780.0 + STEP_NM, STEP_NM)
    power = 0.9 * skewed(nm, 452.0, 8.0, 10.0) + 0.62 * skewed(nm, 560.0, 38.0, 62.0)
    return Illuminant(f"{LED_WHITE} (synthetic)", tuple(nm.tolist()), tuple(power.tolist()))
