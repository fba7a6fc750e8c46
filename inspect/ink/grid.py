"""Readings as a grid of places and wavelengths, and what of it a fit can use."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import UsageError
from anisoscope.ink.goniometer import Readings
from anisoscope.sim.light.ink.angles import shift

BoolArray = npt.NDArray[np.bool_]

FLOOR_SHARE = 1e-5
"""Usual noise floor, as a share of the largest reading."""

CLEAR = 3.0
"""Readings up to this many noise floors are dropped: the logarithm of what is mostly noise misleads."""

LEAST = 3


@dataclass(frozen=True)
class Dropped:
    """A reading that the fit does not use.

    Attributes:
        line: of the file.
        theta_i_deg: of the light.
        theta_o_deg: of the detector.
        wavelength_nm: of the reading.
        value: BRDF in 1/sr.
        reason: why.
    """

    line: int
    theta_i_deg: float
    theta_o_deg: float
    wavelength_nm: float
    value: float
    reason: str


@dataclass(frozen=True, eq=False)
class Grid:
    """Readings by place (G) and wavelength (W).

    Attributes:
        theta_i_deg: (G,).
        theta_o_deg: (G,) with its sign.
        nm: (W,) rising.
        value: (G, W) BRDF, NaN where there is no reading that can be used.
        floor: noise floor of the readings, 1/sr.
        dropped: readings that are left out.
    """

    theta_i_deg: FloatArray
    theta_o_deg: FloatArray
    nm: FloatArray
    value: FloatArray
    floor: float
    dropped: tuple[Dropped, ...]

    @property
    def half_deg(self) -> FloatArray:
        """(G,) angle of the half vector from the normal."""
        return np.abs(self.theta_i_deg - self.theta_o_deg) / 2.0

    @property
    def x(self) -> FloatArray:
        """(G,) 1 − cos((θi + |θo|)/2)."""
        return shift(np.cos(np.radians(self.theta_i_deg)), np.cos(np.radians(self.theta_o_deg)))

    @property
    def mirror(self) -> BoolArray:
        """(G,) the places in the mirror direction."""
        return np.asarray(np.abs(self.theta_i_deg - self.theta_o_deg) < 0.01)


def grid_of(readings: Readings, floor: float | None = None, below_deg: float | None = None) -> Grid:
    """Sort readings by place and wavelength; a place that is read twice stands twice.

    Args:
        readings: BRDF values.
        floor: noise floor in 1/sr; readings up to three times as large are dropped. None: a share of the
            largest reading.
        below_deg: angles of the light from which readings are dropped.

    Raises:
        UsageError: a floor that is not positive, or nothing is left.
    """
    largest = float(np.max(readings.value))
    if largest <= 0.0:
        raise UsageError("no reading lies above 0: there is nothing to fit")
    lowest = FLOOR_SHARE * largest if floor is None else floor
    if not 0.0 < lowest < largest:
        raise UsageError(
            f"the noise floor must lie above 0 and below the largest reading ({largest:g}/sr), not at {lowest:g}"
        )
    steep = readings.theta_i_deg >= (np.inf if below_deg is None else below_deg)
    why = np.where(
        steep, "angle left out", np.where(readings.value <= CLEAR * lowest, "near the noise floor", "")
    )
    nm, column = np.unique(readings.wavelength_nm, return_inverse=True)
    angle_i, number_i = np.unique(readings.theta_i_deg, return_inverse=True)
    angle_o, number_o = np.unique(readings.theta_o_deg, return_inverse=True)
    place = number_i * len(angle_o) + number_o
    times = _times(place * len(nm) + column)
    at, row = np.unique(place + len(angle_i) * len(angle_o) * times, return_inverse=True)
    at = at % (len(angle_i) * len(angle_o))
    value = np.full((len(at), len(nm)), np.nan)
    value[row, column] = np.where(why == "", readings.value, np.nan)
    few = np.sum(np.isfinite(value), axis=0) < LEAST
    why = np.where((why == "") & few[column], "too few at this wavelength", why)
    if few.all():
        raise UsageError(
            f"no wavelength has {LEAST} readings clear of the noise floor of {lowest:g}/sr: there is nothing to fit"
        )
    kept = np.isfinite(value[:, ~few]).any(axis=1)
    light, detector = angle_i[at // len(angle_o)], angle_o[at % len(angle_o)]
    return Grid(light[kept], detector[kept], nm[~few], value[kept][:, ~few], lowest, _dropped(readings, why))


def _times(key: npt.NDArray[np.intp]) -> npt.NDArray[np.intp]:
    """(N,) how many readings with the same key come before each one."""
    order = np.argsort(key, kind="stable")
    count = np.arange(len(order))
    new = np.concatenate([[True], np.diff(key[order]) != 0])
    found = np.empty_like(count)
    found[order] = count - np.maximum.accumulate(np.where(new, count, 0))
    return found


def _dropped(readings: Readings, why: npt.NDArray[np.str_]) -> tuple[Dropped, ...]:
    return tuple(
        Dropped(
            readings.lines[n],
            float(readings.theta_i_deg[n]),
            float(readings.theta_o_deg[n]),
            float(readings.wavelength_nm[n]),
            float(readings.value[n]),
            str(why[n]),
        )
        for n in np.flatnonzero(why != "")
    )
