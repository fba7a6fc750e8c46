"""The outline of the mean ridge about its wall as an instrument of limited lateral resolution shows it.

Facet, foot, wall, crest, facet are straight lines and arcs that touch them, or level ends. An arc is a polygon of
tangents. So the outline is a line and a sum of kinks: at each, the slope changes by Δ at x₀. A Gaussian point spread
function of standard deviation σ turns a kink into Δ·σ·(t·Φ(t) + φ(t)), t = (x − x₀)/σ, with Φ and φ the normal
distribution and its density.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares
from scipy.special import ndtr

from anisoscope.base.arrays import FloatArray

TANGENTS = 10
SIGMA_OF_LIMIT = float(np.sqrt(0.5 * np.log(2.0)) / np.pi)
"""σ of a Gaussian point spread function over the lateral period limit: exp(−2π²σ²/D²) is 50 % (ISO 25178-600)."""
LEAST_SIGMA = 0.05
MOST_RUN = 0.7
CLEARLY_LEVEL = 0.8
CLEAR_SQUARE = 9.0
STEP = 1e-4


@dataclass(frozen=True)
class Outline:
    """What an outline is fitted to, about the wall; x in µm, facets falling toward +x.

    Attributes:
        x: (n,) places from the wall.
        height: (n,) heights in µm.
        u: (n,) standard deviations to weigh them by.
        fall: slope of the facets, above 0.
        at_wall: height of the facet behind the wall, prolonged to x = 0.
        pitch: in µm.
        wall: middle and width of the wall to begin with, in µm.
        sigma: of the point spread function in µm.
        level: whether the crest and the foot end level instead of round.
    """

    x: FloatArray
    height: FloatArray
    u: FloatArray
    fall: float
    at_wall: float
    pitch: float
    wall: tuple[float, float]
    sigma: float
    level: tuple[bool, bool] = (False, False)

    def at(self, x: FloatArray, found: FloatArray) -> FloatArray:
        """(n,) heights of the outline at x.

        Args:
            x: (n,) places in µm.
            found: (6,) middle of the wall, its horizontal width, size of the crest and of the foot (radius, or what
                is missing of the height), offset of the heights, σ.
        """
        middle, width, crest, foot, offset, sigma = found
        rise = self.fall * (self.pitch - width) / width
        places, changes = [], []
        for end, (size, level) in enumerate(zip((crest, foot), self.level, strict=True)):
            way = 1.0 if end else -1.0  # the crest is the foot turned by 180°
            if level:
                place, change = np.array([-size / self.fall, size / rise]), np.array([self.fall, rise])
            else:
                place, change = _arc(self.fall, rise, size)
            places.append(middle + way * (place - 0.5 * width))
            changes.append(way * change)
        t = (x[:, None] - np.concatenate(places)) / sigma
        kinks = t * ndtr(t) + np.exp(-0.5 * t * t) / np.sqrt(2.0 * np.pi)
        before = self.at_wall - self.fall * (x + self.pitch) + offset
        found_heights: FloatArray = before + sigma * (kinks @ np.concatenate(changes))
        return found_heights

    def fitted(self, step: float, *, free: tuple[bool, bool, bool] = (True, True, False)) -> "Fit":
        """Least squares of the outline.

        Args:
            step: pixel across in µm.
            free: whether crest, foot and σ are fitted; else ends are sharp and σ is the one given.
        """
        sigma = max(self.sigma, LEAST_SIGMA * step)
        width = min(max(self.wall[1], 0.5 * step), 0.5 * self.pitch)
        start = np.array([self.wall[0], width, step, step, 0.0, max(sigma, step) if free[2] else sigma])
        use = np.array([True, True, free[0], free[1], True, free[2]])
        start[~use & (np.arange(6) < 5)] = 0.0
        upper = np.array(
            [self.pitch, MOST_RUN * self.pitch, self.pitch, self.pitch, np.inf, 0.1 * self.pitch]
        )
        lower = np.array([-self.pitch, 0.02 * step, 0.0, 0.0, -np.inf, LEAST_SIGMA * step])
        scale = np.array([step, step, step, step, self.fall * step, step])

        def whole(values: FloatArray) -> FloatArray:
            full = start.copy()
            full[use] = values
            return full

        def left(values: FloatArray) -> FloatArray:
            found: FloatArray = (self.at(self.x, whole(values)) - self.height) / self.u
            return found

        inside = np.clip(start, lower + 1e-6 * step, upper - 1e-6 * step)
        best = least_squares(
            left, inside[use], bounds=(lower[use], upper[use]), x_scale=scale[use], max_nfev=40
        )
        # outlines change with the square of a radius below the blur, so that there is no derivative at a sharp end
        moves = np.where(np.isin(np.arange(6), (2, 3)), max(sigma, 0.1 * step), STEP * scale)
        at = np.where(use, np.clip(whole(best.x), lower + STEP * step, upper), start)
        slopes = np.zeros((self.x.size, 6))
        for k in np.flatnonzero(use):
            more = at.copy()
            more[k] += moves[k]
            slopes[:, k] = (self.at(self.x, more) - self.at(self.x, at)) / (more[k] - at[k]) / self.u
        gain = np.zeros((6, self.x.size))
        gain[use] = np.linalg.pinv(slopes[:, use])
        return Fit(self, whole(best.x), gain, float(2.0 * best.cost), int(use.sum()))


@dataclass(frozen=True)
class Fit:
    """A fitted outline: (6,) numbers as of ``Outline.at``, (6, n) their change with the heights, Σ squares."""

    outline: Outline
    found: FloatArray
    gain: FloatArray
    square: float
    free: int

    def moved(self, x: FloatArray, height: FloatArray) -> FloatArray:
        """(6,) numbers for other heights near these, to first order."""
        left = (height - self.outline.at(x, self.found)) / self.outline.u
        own = (self.outline.height - self.outline.at(self.outline.x, self.found)) / self.outline.u
        return self.found + self.gain @ np.where(np.isfinite(left), left - own, 0.0)

    def misfit(self) -> FloatArray:
        """(8,) standard uncertainties of ``shape`` by what the outline leaves of the heights, neighbours as one."""
        scale = max(self.square / max(self.outline.x.size - self.free, 1), 1.0)
        here, changes = self.shape(self.found), np.zeros((8, 6))
        for k in range(4):
            more = self.found.copy()
            more[k] += STEP * self.outline.pitch
            changes[:, k] = (self.shape(more) - here) / (more[k] - self.found[k])
        found: FloatArray = np.sqrt(2.0 * scale * np.square(changes @ self.gain).sum(axis=1))
        return found

    @property
    def straight(self) -> float:
        """Share of the wall that its round ends leave straight; below 0 where they overlap."""
        width = float(self.found[1])
        rise = self.outline.fall * (self.outline.pitch - width) / width
        reach = np.tan(0.5 * (np.arctan(self.outline.fall) + np.arctan(rise))) * np.cos(np.arctan(rise))
        ends = [
            0.0 if level else size for size, level in zip(self.found[2:4], self.outline.level, strict=True)
        ]
        return 1.0 - float(sum(ends) * reach) / width

    def shape(self, found: FloatArray) -> FloatArray:
        """(8,) wall angle in degrees, full height; share missing, radius, 1 if level, of crest and of foot."""
        outline, width = self.outline, max(float(found[1]), 1e-6)
        rise = outline.fall * max(outline.pitch - width, 1e-6) / width
        full = outline.fall * (outline.pitch - width)
        row = [float(np.degrees(np.arctan(rise))), full]
        for size, level in zip(found[2:4], outline.level, strict=True):
            missing = size if level else size * _over_arc(outline.fall, rise)
            row += [missing / full, 0.0 if level else size, float(level)]
        return np.array(row)


def _arc(fall: float, rise: float, radius: float) -> tuple[FloatArray, FloatArray]:
    """Places of the kinks from the vertex of a foot, and the changes of slope there."""
    theta, psi = float(np.arctan(fall)), float(np.arctan(rise))
    turn = theta + psi
    half = 0.5 * turn / TANGENTS
    ends = -theta + 2.0 * half * np.arange(TANGENTS + 1)
    centre = radius * (np.sin(theta) - np.tan(0.5 * turn) * np.cos(theta))
    return centre + radius / np.cos(half) * np.sin(ends[:-1] + half), np.diff(np.tan(ends))


def _over_arc(fall: float, rise: float) -> float:
    """Height of the lowest point of a rounded foot of radius 1 over its vertex."""
    theta, psi = float(np.arctan(fall)), float(np.arctan(rise))
    return float(np.cos(0.5 * (psi - theta)) / np.cos(0.5 * (psi + theta)) - 1.0)


def best_fit(outline: Outline, step: float) -> Fit:
    """The outline with round ends, or with level ones where these leave clearly less."""
    kinds = [(False, False), (True, False), (False, True)]
    fits = [replace(outline, level=kind).fitted(step) for kind in kinds]
    best = min(fits[1:], key=lambda one: one.square)
    clear = max((1.0 - CLEARLY_LEVEL) * fits[0].square, CLEAR_SQUARE)
    return best if fits[0].square - best.square > clear else fits[0]
