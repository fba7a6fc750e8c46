"""Radial distortion of a lens: from seen places to straight ones and back, and its fit to markers.

Source: D. C. Brown, "Decentering distortion of lenses", Photogrammetric Engineering 32 (1966).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from anisoscope.base.arrays import FloatArray

_SIGMAS = 4.0
_LEAST_PX = 0.1
_STRAIGHT_SIDES = 0.1
"""Share by which k may be off, because the bent sides of a marker are fitted as straight lines."""
_INVERSE_ROUNDS = 8


@dataclass(frozen=True)
class Lens:
    """Radial distortion about the middle of the picture: straight = middle + (seen − middle)·(1 + k1 ρ² + k2 ρ⁴).

    ρ is the distance of the seen place from the middle, 1 at a corner of the picture.

    Attributes:
        shape: (rows, cols) of the picture.
        k1: share by which a corner lies inside its straight place, positive for a barrel.
        k2: its term of fourth order.
    """

    shape: tuple[int, int]
    k1: float
    k2: float = 0.0

    @property
    def share(self) -> float:
        """Share by which a corner of the picture lies inside its straight place."""
        return self.k1 + self.k2

    @property
    def _middle(self) -> FloatArray:
        return 0.5 * (np.array(self.shape[::-1]) - 1.0)

    def _stretch(self, away: FloatArray) -> FloatArray:
        share = np.sum(away**2, axis=-1, keepdims=True) / np.sum(self._middle**2)
        return np.asarray(1.0 + share * (self.k1 + self.k2 * share))

    def straight(self, seen: FloatArray) -> FloatArray:
        """(..., 2) column and row in the picture of a lens without distortion."""
        away = seen - self._middle
        return np.asarray(self._middle + away * self._stretch(away))

    def seen(self, straight: FloatArray) -> FloatArray:
        """(..., 2) column and row in the picture of this lens."""
        target = straight - self._middle
        away = target
        for _ in range(_INVERSE_ROUNDS):
            away = target / self._stretch(away)
        return np.asarray(self._middle + away)


class Corners(NamedTuple):
    """Corners of markers in a picture, four by four: (N, 2) millimetres, (N, 2) pixels; cosine of its tilt."""

    points_mm: FloatArray
    pixels: FloatArray
    squeeze: float


@dataclass(frozen=True, eq=False)
class FittedLens:
    """Distortion that markers show.

    Attributes:
        lens: the lens, or None where the distortion is not significant.
        u: (1 or 2,) standard uncertainty of k1 and k2, from the scatter of the corners and the curvature of sides.
        residual_px: rms distance of the corners from the fit.
        plain_px: likewise, without distortion.
    """

    lens: Lens | None
    u: FloatArray
    residual_px: float
    plain_px: float


def fit_lens(pictures: Sequence[Corners], shape: tuple[int, int]) -> FittedLens:
    """Least-squares distortion common to all pictures, each with its own similarity.

    The print may have made all markers larger or smaller by one share: it is fitted too. A term counts where it exceeds
    four times its uncertainty and moves a corner of a marker by 0.1 px.

    Args:
        pictures: at least one, with three markers or more.
        shape: (rows, cols).
    """
    found = _solved(pictures, shape, 1)
    both = _solved(pictures, shape, 2)
    (k, u, rest), terms = (both, 2) if abs(both[0][1]) > _SIGMAS * both[1][1] else (found, 1)
    lens = Lens(shape, *(float(value) for value in k))
    moved = max(float(np.abs(lens.straight(one.pixels) - one.pixels).max()) for one in pictures)
    significant = terms == 2 or abs(k[0]) > _SIGMAS * u[0]
    u = np.hypot(u, _STRAIGHT_SIDES * np.abs(k))
    plain = _solved(pictures, shape, 0)[2]
    return FittedLens(lens if significant and moved > _LEAST_PX else None, u, rest, plain)


def _solved(
    pictures: Sequence[Corners], shape: tuple[int, int], terms: int
) -> tuple[FloatArray, FloatArray, float]:
    """(terms,) coefficients, their uncertainties, and the rms residual."""
    middle = 0.5 * (np.array(shape[::-1]) - 1.0)
    count = 4 * len(pictures)
    target = np.concatenate([((one.pixels - middle) / [1.0, one.squeeze]).T.ravel() for one in pictures])

    def design_at(before: FloatArray) -> FloatArray:
        return np.concatenate([_block(one, middle, 4 * i, before, terms) for i, one in enumerate(pictures)])

    # the size of markers acts by the similarity, which the first round finds
    first = np.linalg.lstsq(design_at(np.zeros(count + 1 + terms)), target, rcond=None)[0]
    design = design_at(first)
    found = np.linalg.lstsq(design, target, rcond=None)[0]
    rest = target - design @ found
    inverse = np.linalg.pinv(design.T @ design)
    # what a misprinted corner does, it does alike in all pictures
    points = np.concatenate([np.tile(one.points_mm, (2, 1)) for one in pictures])
    _, corner = np.unique(points.round(6), axis=0, return_inverse=True)
    pulls = np.zeros((corner.max() + 1, design.shape[1]))
    np.add.at(pulls, corner.ravel(), design * rest[:, None])
    alike = np.diag(inverse @ pulls.T @ pulls @ inverse)
    apart = np.diag(inverse) * (rest @ rest) / max(rest.size - len(found), 1)
    u = np.sqrt(np.maximum(alike, apart)[count + 1 :])
    return found[count + 1 :], u, float(np.sqrt(2.0 * np.mean(rest**2)))


def _block(one: Corners, middle: FloatArray, first: int, before: FloatArray, terms: int) -> FloatArray:
    """Derivatives of a picture's columns and rows by its similarity, the size of markers, and the distortion."""
    away = one.pixels - middle
    share = np.sum(away**2, axis=1, keepdims=True) / np.sum(middle**2)
    x, y = one.points_mm.T
    side = one.points_mm - np.repeat(one.points_mm.reshape(-1, 4, 2).mean(axis=1), 4, axis=0)
    a, b = before[first], before[first + 1]
    zero, unit = np.zeros_like(x), np.ones_like(x)
    found = np.zeros((2 * len(x), len(before)))
    found[:, first : first + 4] = np.stack(
        [np.r_[x, -y], np.r_[y, x], np.r_[unit, zero], np.r_[zero, unit]], axis=1
    )
    found[:, -1 - terms] = np.r_[a * side[:, 0] + b * side[:, 1], b * side[:, 0] - a * side[:, 1]]
    for term in range(terms):
        found[:, term - terms] = -(away / [1.0, one.squeeze] * share ** (term + 1)).T.ravel()
    return found
