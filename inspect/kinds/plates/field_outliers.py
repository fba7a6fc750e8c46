"""Does a single field differ from the fields of its class? T² with their scatter, and Holm over all fields.

Ln L of a field in P poses, less the middle of its class, is compared with the covariance of the class, estimated so
that fields with defects do not enter it: without those beyond the tolerance, from the 95 % that lie closest together
(minimum covariance determinant, Rousseeuw and Van Driessen 1999), then from all but those that hardly any good field
reaches. Each field is tested against the others without itself. A twentieth of the fields of a class may deviate and
still be found; groups of more fields that are alike, as from one part of a tool, count as scatter. With golden plates
their mean pattern is taken off, and the scatter is theirs. Holm's procedure keeps the probability of any false alarm on
a plate.
"""

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.significance import f_tail, holm

MIDDLE, MIDDLE_ERROR = 0.6, 1.1
"""Share of the fields of a class, by their brightness, whose mean stands for it, so that fields with defects are left
out; and its standard error over that of the mean of all."""
MAD = 1.4826
HELD = 0.95
BEYOND = 0.02
"""Number of good fields of a class expected beyond the distance at which fields are left out of its scatter."""
STEPS = 20
FLOOR = 0.002
"""Standard deviation of ln L of a field that is always allowed for: flat field and resampling."""
LEAST_A_POSE = 4
"""Fields of a class for every pose, below which they are not compared with each other."""


@dataclass(frozen=True, eq=False)
class FieldScatter:
    """Scatter of the fields of a class.

    Attributes:
        middle: (P,) mean of what is compared.
        covariance: (P, P).
        freedom: degrees of freedom of the covariance.
        members: (N,) which fields it was estimated from; None where it is that of other plates.
    """

    middle: FloatArray
    covariance: FloatArray
    freedom: float
    members: npt.NDArray[np.bool_] | None = None

    def t_squared(self, off: FloatArray) -> FloatArray:
        """(N,) squared distances of (N, P) fields."""
        away = off - self.middle
        return np.asarray(np.einsum("np,np->n", away, np.linalg.solve(self.covariance, away.T).T))

    def p_values(self, off: FloatArray) -> FloatArray:
        """(N,) probabilities of larger distances from the others, for the fields of the class."""
        size, free = self.middle.size, max(self.freedom, self.middle.size + 2.0)
        squared = self.t_squared(off)
        if self.members is None:
            return f_tail(squared * (free - size + 1.0) / (free * size), size, free - size + 1.0)
        count = free + 1.0
        new = squared * count / (count + 1.0) * (free - size + 1.0) / (free * size)
        # of a member of the sample: its distance from the others follows from that from all
        share = np.minimum(squared * count / free**2, 1.0 - 1e-9)
        own = (free - size) / size * share / (1.0 - share)
        return np.where(self.members, f_tail(own, size, free - size), f_tail(new, size, free - size + 1.0))

    def limit(self, level: float) -> float:
        """Squared distance beyond which a field deviates at a level."""
        from scipy.special import fdtri  # noqa: PLC0415 - start-up time

        size, free = self.middle.size, max(self.freedom, self.middle.size + 1.0)
        other = free - size + 1.0
        return float(fdtri(size, other, 1.0 - level)) * free * size / other

    def power(self, change: FloatArray, level: float) -> float:
        """Probability that a field is found whose ln L is changed by (P,) in every pose."""
        from scipy.special import chndtr  # noqa: PLC0415 - start-up time

        away = float(change @ np.linalg.solve(self.covariance, change))
        return float(1.0 - chndtr(self.limit(level), self.middle.size, away))


def class_scatter(off: FloatArray, tolerance: float = np.inf) -> FieldScatter | None:
    """Scatter of (N, P) fields of a class without those that lie apart; None where they are too few.

    Args:
        off: ln L less the middle of the class.
        tolerance: |ln| beyond which a field has a defect.
    """
    size = off.shape[1]
    usual = np.abs(off).max(axis=1, initial=0.0) < tolerance
    inner = off[usual]
    count = len(inner)
    if count < LEAST_A_POSE * size:
        return None
    middle = np.median(inner, axis=0)
    away = np.abs(inner - middle)
    distance = ((away / np.maximum(np.median(away, axis=0), 1e-6)) ** 2).sum(axis=1)
    held = min(int(np.ceil(HELD * count)), count - 1)
    chosen = np.argsort(distance, kind="stable")[:held]
    found = _of(inner[chosen], held / count)
    for _ in range(STEPS):
        again = np.argsort(found.t_squared(inner), kind="stable")[:held]
        if set(again) == set(chosen):
            break
        chosen = again
        found = _of(inner[chosen], held / count)
    share = 1.0 - BEYOND / count
    near = usual.copy()
    near[usual] = found.t_squared(inner) <= _quantile(share, size)
    return replace(_of(off[near], share), members=near)


def _of(off: FloatArray, share: float) -> FieldScatter:
    """Mean and covariance of the innermost share of normal fields, made good for what is left out."""
    size = off.shape[1]
    from scipy.special import gammainc  # noqa: PLC0415 - start-up time

    inner = float(gammainc(0.5 * size + 1.0, 0.5 * _quantile(share, size)))
    covariance = np.atleast_2d(np.cov(off, rowvar=False)) * share / inner + FLOOR**2 * np.eye(size)
    return FieldScatter(off.mean(axis=0), covariance, float(len(off) - 1))


def _quantile(share: float, size: int) -> float:
    from scipy.special import chdtri  # noqa: PLC0415 - start-up time

    return float(chdtri(size, 1.0 - share)) if share < 1.0 else float("inf")


def golden_scatter(off: FloatArray) -> FieldScatter:
    """Scatter of one more plate about the mean pattern of (G, N, P) fields of a class of golden plates."""
    plates, fields, size = off.shape
    left = (off - off.mean(axis=0)).reshape(-1, size)
    freedom = float(fields * (plates - 1))
    covariance = left.T @ left / freedom * (1.0 + 1.0 / plates) + FLOOR**2 * np.eye(size)
    return FieldScatter(np.zeros(size), covariance, freedom)


def field_p_values(
    off: FloatArray, classes: npt.NDArray[np.int64], scatters: tuple[FieldScatter | None, ...]
) -> FloatArray:
    """(rows, cols) p values of all fields, Holm-adjusted over the plate; 1 where a field is not tested.

    Args:
        off: (P, rows, cols) ln L less the middle of the class, and less the golden pattern where there is one.
        classes: (rows, cols).
        scatters: of every class.
    """
    found = np.ones(classes.shape)
    tested = np.zeros(classes.shape, dtype=bool)
    for number, scatter in enumerate(scatters):
        mine = (classes == number) & np.isfinite(off).all(axis=0)
        if scatter is not None and mine.any():
            found[mine] = scatter.p_values(off[:, mine].T)
            tested |= mine
    found[tested] = holm(found[tested])
    return found


def class_middles(
    ln: FloatArray, classes: npt.NDArray[np.int64], count: int
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(C, P) middles of ln L, (C, P) scatter between fields, (C,) numbers of fields."""
    middle = np.array([_middle(ln[:, classes == one]) for one in range(count)])
    away = [np.abs(ln[:, classes == one] - middle[one][:, None]) for one in range(count)]
    scatter = MAD * np.array([np.nanmedian(one, axis=1) for one in away])
    return middle, scatter, np.array([float((classes == one).sum()) for one in range(count)])


def _middle(values: FloatArray) -> FloatArray:
    """(P,) means of the middle fields of (P, F)."""
    ordered = np.sort(values, axis=1)  # NaN last
    count = np.isfinite(ordered).sum(axis=1)
    found = []
    for row, n in zip(ordered, count, strict=True):
        cut = int(0.5 * (1.0 - MIDDLE) * n)
        found.append(float(row[cut : n - cut].mean()))
    return np.array(found)
