"""Kinds of marks: what a group of deviating cells is, with a weight for every kind.

A group is described by its form, by the mean and the extremes of its deviation of ln L with the light along, across
and against the ridges, by where on the pitch it is, and by whether groups on both neighbouring ridges continue it. A
kind is a Student distribution of these numbers (K. L. Lange et al., J. Am. Stat. Assoc. 84 (1989) 881), so that numbers
that a recipe's poses do not show are left out. The distributions are fitted to marks of drawn sizes on drawn designs in
the prediction's own light (``tests/evidence/marks.py``), which also judges them in light of another renderer.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib import resources
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.imaging.pose_radiance import CELLS_PER_PITCH
from anisoscope.parameters.geometry import Pose

TEXTURE, UNKNOWN = "texture", "unknown mark"
"""A group as chance makes it on good parts, and a mark of no kind that was simulated."""
CELLS = 2
"""Cells from which on a group has a kind."""
DEGREES = 10.0
"""Degrees of freedom of the distributions."""
RIGHT_ANGLES = (0.0, 90.0, 180.0)
Labels = npt.NDArray[np.integer[Any]]
SIDES = (*((angle, 0) for angle in RIGHT_ANGLES), (90.0, -1), (90.0, 1))
"""Stage angle and sign of the tilt of the poses whose deviations are averaged.

Across the ridges tilted poses are dark: light between the facets rules there, which the prediction's light lacks.
"""
MOST_LOG = 1.5
ALIKE, ROUNDS = 2.0, 12
"""Marks of every kind that a part is taken to have besides its own, and rounds of the estimate."""
CONTINUED = 7 + len(SIDES)
"""Place of the continuation by neighbours among the numbers of a group."""
CROWDED = 0.5
"""Groups that chance leaves on a neighbouring ridge from which on they continue nothing."""
_WINDOW = 2.5  # in squares of the pitch, where a neighbour continues a group
_BEYOND, _LEAST = 1e-3, 1e-2


@dataclass(frozen=True, eq=False)
class MarkSigns:
    """Cells of a map as their kinds of marks are recognised by.

    Attributes:
        off: (5, cell rows, cell cols) mean deviation of ln L over the poses of every side of `SIDES`; NaN without one.
        beyond: (cell rows, cell cols) share of the points of a cell that deviate.
        calm: (cell rows, cell cols) share of the points that deviate and are on the calm part of the pitch.
        tilted: whether there are poses of both signs of tilt.
    """

    off: FloatArray
    beyond: FloatArray
    calm: FloatArray
    tilted: bool

    @staticmethod
    def of(cells: FloatArray, beyond: FloatArray, calm: FloatArray, poses: tuple[Pose, ...]) -> "MarkSigns":
        """Signs of (P, cell rows, cell cols) deviations of ln L in P poses."""
        angles, signs = [_right_angle(pose.stage_deg) for pose in poses], [np.sign(p.tilt_deg) for p in poses]
        means = []
        for side in SIDES:
            chosen = [k for k, one in enumerate(zip(angles, signs, strict=True)) if one == side]
            means.append(cells[chosen].mean(axis=0) if chosen else np.full(cells.shape[1:], np.nan))
        return MarkSigns(np.stack(means), beyond, calm, {-1.0, 1.0} <= set(signs))


def _right_angle(stage_deg: float) -> float | None:
    """Of 0°, 90° and 180° the one within 45°; ridges look alike from both of their ends."""
    turned = abs((stage_deg + 180.0) % 360.0 - 180.0)
    nearest = min(RIGHT_ANGLES, key=lambda one: abs(turned - one))
    return nearest if abs(turned - nearest) < 45.0 else None


def group_numbers(
    labels: Labels, count: int, score: FloatArray, limit: float, signs: MarkSigns
) -> FloatArray:
    """(count − 1, D) numbers that describe the groups 1 … count − 1 of (cell rows, cell cols) labels, one or more."""
    places = [np.nonzero(labels == number) for number in range(1, count)]
    centres = np.array([(rows.mean(), cols.mean()) for rows, cols in places]).reshape(-1, 2)
    found = []
    for number, (rows, cols) in enumerate(places):
        spread = (np.cov(np.stack([rows, cols]).astype(float)) if len(rows) > 1 else 0.0) + np.eye(2) / 12.0
        values, vectors = np.linalg.eigh(spread)
        wide, long = np.sqrt(12.0 * values) / CELLS_PER_PITCH
        turn = np.arctan2(abs(vectors[1, 1]), abs(vectors[0, 1]))
        off = signs.off[:, rows, cols]
        weight = score[rows, cols] - 0.8 * limit
        mean = np.clip(off @ weight / weight.sum(), -MOST_LOG, MOST_LOG)
        beyond, calm = signs.beyond[rows, cols], signs.calm[rows, cols]
        upright = off[: len(RIGHT_ANGLES)]
        found.append(
            [
                np.log(long),
                np.log(wide),
                np.log(long / wide) * np.cos(2.0 * turn),
                np.log(len(rows) / CELLS_PER_PITCH**2 / (long * wide)),
                *mean,
                np.log(score[rows, cols].max() / limit),
                calm.sum() / max(float(beyond.sum()), _BEYOND),
                np.log(max(float(beyond.mean()), _LEAST)),
                _continued(rows, cols, np.delete(centres, number, axis=0)),
                *np.clip(upright.max(axis=1), -1.0, MOST_LOG),
                *np.clip(upright.min(axis=1), -MOST_LOG, 1.0),
            ]
        )
    numbers = np.array(found, dtype=np.float64)
    if (count - 1) * _WINDOW * CELLS_PER_PITCH**2 > CROWDED * score.size:
        numbers[:, CONTINUED] = np.nan
    return numbers


def _continued(rows: npt.NDArray[np.intp], cols: npt.NDArray[np.intp], others: FloatArray) -> float:
    """1 where groups about a pitch away on both sides continue a group in a straight line, 0.5 for one on one side."""

    def beside(edge: int, sign: int) -> FloatArray:
        away = sign * (others[:, 1] - edge) / CELLS_PER_PITCH
        level = np.abs(others[:, 0] - rows[cols == edge].mean()) / CELLS_PER_PITCH
        return np.asarray(others[(away >= 0.625) & (away <= 1.625) & (level <= 1.25), 0])

    left, right = beside(int(cols.min()), -1), beside(int(cols.max()), 1)
    if left.size and right.size and np.abs(np.add.outer(left, right) / 2.0 - rows.mean()).min() <= 1.5:
        return 1.0
    return 0.5 if left.size or right.size else 0.0


@dataclass(frozen=True, eq=False)
class MarkClasses:
    """Distributions of the numbers of every kind of mark.

    Attributes:
        names: of C kinds.
        means: (C, D); NaN where no training part had the poses.
        covariances: (C, D, D).
        temper: exponent of the likelihoods with which the stated weights hold for marks that were not trained on.
        unknown: weight of `UNKNOWN` a priori; every other kind has the same.
    """

    names: tuple[str, ...]
    means: FloatArray
    covariances: FloatArray
    temper: float
    unknown: float = 0.05

    def weights(self, numbers: FloatArray) -> FloatArray:
        """(G, C + 1) weights of the kinds and of `UNKNOWN` for (G, D) numbers of a part's groups; rows add up to 1.

        Marks of a part are often of one kind. How common each kind is on the part is estimated with the weights
        (expectation and maximisation), with `ALIKE` marks of every kind as the prior.
        """
        logs = [self._log_density(numbers, k) for k in range(len(self.names))]
        known = np.isfinite(numbers).all(axis=0) & np.isfinite(self.means[0])
        logs.append(np.full(len(numbers), self._usual(known)))
        likelihood = self.temper * np.stack(logs, axis=1)
        likelihood = np.exp(likelihood - likelihood.max(axis=1, keepdims=True))
        prior = np.append(np.full(len(self.names), (1.0 - self.unknown) / len(self.names)), self.unknown)
        rows = self._shared(likelihood, prior)
        for _ in range(ROUNDS):
            rows = self._shared(likelihood, ALIKE * len(prior) * prior + rows.sum(axis=0))
        return rows

    @staticmethod
    def _shared(likelihood: FloatArray, prior: FloatArray) -> FloatArray:
        rows = likelihood * prior
        return np.asarray(rows / rows.sum(axis=1, keepdims=True))

    def _scale(self, number: int, known: npt.NDArray[np.bool_]) -> FloatArray:
        return np.asarray(self.covariances[number][np.ix_(known, known)] * (DEGREES - 2.0) / DEGREES)

    def _log_density(self, numbers: FloatArray, number: int) -> FloatArray:
        known = np.isfinite(numbers).all(axis=0) & np.isfinite(self.means[number])
        scale, away = self._scale(number, known), numbers[:, known] - self.means[number, known]
        squares = np.sum(away * np.linalg.solve(scale, away.T).T, axis=1)
        size = int(known.sum())
        return np.asarray(
            _constant(size)
            - 0.5 * np.linalg.slogdet(scale)[1]
            - 0.5 * (DEGREES + size) * np.log1p(squares / DEGREES)
        )

    def _usual(self, known: npt.NDArray[np.bool_]) -> float:
        """Log density of an unknown mark: that of the widest kind at three standard deviations in every number."""
        size = int(known.sum())
        if not size:
            return 0.0
        widest = max(float(np.linalg.slogdet(self._scale(k, known))[1]) for k in range(len(self.names)))
        return float(_constant(size) - 0.5 * widest - 0.5 * (DEGREES + size) * np.log1p(3.0 * size / DEGREES))


def _constant(size: int) -> float:
    from scipy.special import gammaln  # noqa: PLC0415 - start-up time

    return float(
        gammaln(0.5 * (DEGREES + size)) - gammaln(0.5 * DEGREES) - 0.5 * size * np.log(DEGREES * np.pi)
    )


@cache
def known_classes() -> Mapping[bool, MarkClasses]:
    """Classes for poses of both signs of tilt (True), and for upright ones."""
    text = resources.files(__package__).joinpath("data/mark-classes.json").read_text(encoding="utf-8")
    return {name == "tilted": classes_of(one) for name, one in json.loads(text).items()}


def classes_of(table: Mapping[str, Any]) -> MarkClasses:
    """Classes from their table: names, temper, means, and lower triangles of the covariances."""
    means = np.array(table["means"], dtype=np.float64)
    size = means.shape[1]
    covariances = np.zeros((len(means), size, size))
    rows, cols = np.tril_indices(size)
    for number, triangle in enumerate(table["triangles"]):
        covariances[number, rows, cols] = covariances[number, cols, rows] = triangle
    return MarkClasses(tuple(table["names"]), means, covariances, table["temper"])


def kinds_of_groups(
    over: npt.NDArray[np.bool_], score: FloatArray, limit: float, signs: MarkSigns
) -> tuple[Labels, list[dict[str, float]]]:
    """Groups of touching cells and the weights of their kinds, largest first; none below `CELLS` cells.

    Args:
        over: (cell rows, cell cols) True where a cell deviates.
        score: (cell rows, cell cols) by how much.
        limit: score from which on a cell deviates.
        signs: deviation in the poses.

    Returns:
        (cell rows, cell cols) number of the group of every cell, from 1, and the weights of each.
    """
    count, found = cv2.connectedComponents(over.astype(np.uint8), connectivity=8)
    labels: Labels = np.asarray(found, dtype=np.int32)
    if count == 1:
        return labels, []
    classes = known_classes()[signs.tilted]
    sizes = np.bincount(labels.ravel())[1:]
    rows = classes.weights(group_numbers(labels, count, score, limit, signs))
    names = (*classes.names, UNKNOWN)
    return labels, [
        dict(sorted(zip(names, map(float, row), strict=True), key=lambda one: -one[1]))
        if size >= CELLS
        else {}
        for size, row in zip(sizes, rows, strict=True)
    ]
