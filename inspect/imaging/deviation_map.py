"""Deviation map: the cells of the contrast map that deviate from their flank, and the decision on their area."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import MeasurementError
from anisoscope.base.significance import holm
from anisoscope.imaging.area_limit import KnownShares
from anisoscope.imaging.pose_radiance import CELLS_PER_PITCH, Measured
from anisoscope.parameters.geometry import Pose
from anisoscope.recipe.surface import AreaPart
from anisoscope.record.schema import AreaRecord
from anisoscope.record.verdict import Verdict
from anisoscope.sim.light.contrasts import consecutive_pairs

MAX_CELL_NOISE = 0.25


@dataclass(frozen=True, eq=False)
class CellMap:
    """The contrast map of a part.

    Attributes:
        ratios: (pairs, cell rows, cell cols) ln ratios.
        off: the same shape, the deviation of every cell from its flank.
        thresholds: (pairs,) ln ratios beyond which a cell deviates.
    """

    ratios: FloatArray
    off: FloatArray
    thresholds: FloatArray

    def deviating(self) -> npt.NDArray[np.bool_]:
        """(cell rows, cell cols) True where a cell deviates in some pair."""
        return np.asarray(np.any(np.abs(self.off) > self.thresholds[:, None, None], axis=0))

    def u_share(self, noise: FloatArray) -> float:
        """Standard uncertainty of the share of deviating cells, from noise and from their number.

        Noise puts a cell near its threshold on either side, every cell by itself: with the probability p that a cell
        deviates the share varies by √(Σ p (1 − p))/N; half a cell is the resolution. That noise makes more cells
        deviate than it hides is left in the share, as it is on golden parts.

        Args:
            noise: (pairs,) standard uncertainty of the ln ratio of a cell.
        """
        from scipy.special import ndtr  # noqa: PLC0415 - start-up time

        beyond = np.abs(self.off) - self.thresholds[:, None, None]
        scores = beyond / np.maximum(noise, 1e-12)[:, None, None]
        chance = 1.0 - np.prod(ndtr(-scores), axis=0)
        variance = np.sum(chance * (1.0 - chance)) / chance.size**2
        return float(np.sqrt(variance + (0.5 / chance.size) ** 2))


NEIGHBOURS = 6  # ridges to each side with which a line of cells is compared
MIN_NEIGHBOURS = 3
SCATTERS = 5.0  # robust standard deviations by which a cell may be off its flank
LEAST_DEVIATION = 0.05  # what registration and the edges of cells leave


def cell_thresholds(
    ratios: FloatArray, cell_deviation: float | Literal["auto"], noise: float = 0.0
) -> FloatArray:
    """(pairs,) ln ratios beyond which a cell deviates.

    "auto" is five times what the cells of a pair scatter by about their flanks (from the median of the absolute
    deviations), at least four times their noise and `LEAST_DEVIATION`. A mark stands out in the pair whose good cells
    are most alike; where texture scatters them more than any fixed number, as in poses off the mirror direction, they
    do not deviate.

    Args:
        ratios: (pairs, cell rows, cell cols) ln ratios.
        cell_deviation: of the recipe.
        noise: standard uncertainty of the ln ratio of a cell from noise.
    """
    if cell_deviation != "auto":
        return np.full(len(ratios), cell_deviation)
    off = np.abs(ratios - np.median(ratios, axis=1, keepdims=True)).reshape(len(ratios), -1)
    scatter = 1.4826 * np.median(off, axis=1)  # of normal values: their standard deviation
    least = max(LEAST_DEVIATION, noise / MAX_CELL_NOISE)
    return np.asarray(np.maximum(SCATTERS * scatter, least))


def cell_deviations(ratios: FloatArray, thresholds: FloatArray | float) -> FloatArray:
    """Deviation of every cell from the value expected at its place.

    Each line of cells (a column) runs along one flank of one ridge, so its median is the value of that flank, and
    marks stand out against it. A whole line that differs by more than its threshold from the same flank of the
    neighbouring ridges belongs to a missing or deformed ridge: all of it deviates. Smaller differences between lines
    come from where the raster cuts the flanks, and are ignored.

    Args:
        ratios: (pairs, cell rows, cell cols) ln ratios, `CELLS_PER_PITCH` columns a pitch.
        thresholds: (pairs,), or one of all.

    Returns:
        The same shape.
    """
    lines = np.median(ratios, axis=1)
    off_lines = lines - _same_flank(lines)
    whole = np.where(np.abs(off_lines) > np.reshape(thresholds, (-1, 1)), off_lines, 0.0)
    return np.asarray(ratios - lines[:, None, :] + whole[:, None, :])


def _same_flank(lines: FloatArray) -> FloatArray:
    """(pairs, cols) median of the same flank on the neighbouring ridges; the line itself where these are too few."""
    pairs, cols = lines.shape
    steps = CELLS_PER_PITCH * np.array([j for j in range(-NEIGHBOURS, NEIGHBOURS + 1) if j])
    at = np.arange(cols)[:, None] + steps
    inside = (at >= 0) & (at < cols)
    neighbours = np.where(inside, lines[:, np.clip(at, 0, cols - 1)], np.nan)
    countable = inside.sum(axis=1) >= MIN_NEIGHBOURS
    found = lines.copy()
    if countable.any():
        found[:, countable] = _median_of_known(neighbours[:, countable])
    assert found.shape == (pairs, cols)
    return found


def _median_of_known(values: FloatArray) -> FloatArray:
    """Median along the last axis without NaN; three times faster than nanmedian where that axis is short."""
    rising = np.sort(values, axis=-1)  # NaN last
    count = np.count_nonzero(~np.isnan(values), axis=-1)[..., None]
    low, high = (
        np.take_along_axis(rising, np.maximum(place, 0), axis=-1) for place in ((count - 1) // 2, count // 2)
    )
    return np.asarray(0.5 * (low + high)[..., 0])


def cell_log_ratios(measured: Measured, poses: tuple[Pose, ...]) -> FloatArray:
    """(pairs, cell rows, cell cols) ln ratio of every cell for consecutive stage angles."""
    safe = np.maximum(measured.cells, 1e-6)
    return np.stack([np.log(safe[i] / safe[j]) for i, j in consecutive_pairs(poses)])


def cell_map(measured: Measured, poses: tuple[Pose, ...], rule: AreaPart) -> CellMap:
    """The contrast map of a part, with a recipe's threshold."""
    ratios = cell_log_ratios(measured, poses)
    thresholds = cell_thresholds(ratios, rule.cell_deviation, float(_noise(measured, poses).max()))
    return CellMap(ratios, cell_deviations(ratios, thresholds), thresholds)


def _noise(measured: Measured, poses: tuple[Pose, ...]) -> FloatArray:
    """(pairs,) standard uncertainty of the ln ratio of a cell from noise."""
    noise = measured.cell_noise
    return np.array([np.hypot(noise[i], noise[j]) for i, j in consecutive_pairs(poses)])


def judge_area(
    measured: Measured,
    poses: tuple[Pose, ...],
    rule: AreaPart | None,
    coverage: float,
    known: KnownShares | None = None,
    *,
    alpha: float = 0.01,
    p_means: float = 1.0,
    cells: CellMap | None = None,
) -> tuple[AreaRecord | None, npt.NDArray[np.bool_] | None]:
    """Decide on the deviating area of a part from its contrast map.

    Args:
        measured: the part.
        poses: P poses.
        rule: threshold and limit.
        coverage: guard band by the standard uncertainty of the share.
        known: shares of golden parts; their limit has no guard band, because their scatter includes that of the
            measurement.
        alpha: level of the means and of the area of golden parts together (Holm 1979).
        p_means: p value of the means.
        cells: the contrast map, if already computed.

    Returns:
        The result and (cell rows, cell cols) where cells deviate; None and None without a rule.

    Raises:
        MeasurementError: the noise of the cells exceeds what the threshold allows.
    """
    if rule is None:
        return None, None
    found = cell_map(measured, poses, rule) if cells is None else cells
    over, each_noise, least = _over(found, measured), _noise(measured, poses), float(found.thresholds.min())
    noise = float(each_noise.max())
    if noise > (1.0 + 1e-9) * MAX_CELL_NOISE * least:
        raise MeasurementError(
            f"the ln ratio of a cell is uncertain by {noise:.3f}, too much to tell deviations of "
            f"{least:g} (limit {MAX_CELL_NOISE * least:.3f}): "
            "take more frames_per_pose, a longer exposure_s, or brackets (acquisition.brackets)"
        )
    share, u = float(np.mean(over)), found.u_share(each_noise)
    each = tuple(map(float, found.thresholds)) if rule.cell_deviation == "auto" else None
    if known is not None:
        return _limit_by_golden(share, u, known, alpha, p_means).model_copy(
            update={"cell_deviations": each}
        ), over
    limit, guard = rule.max_share, coverage * u
    verdict = Verdict.INCONCLUSIVE
    if share <= limit - guard:
        verdict = Verdict.PASS
    elif share >= limit + guard:
        verdict = Verdict.FAIL
    return AreaRecord(
        share=share, u=u, max_share=limit, cells=over.size, verdict=verdict, cell_deviations=each
    ), over


def _over(found: CellMap, measured: Measured) -> npt.NDArray[np.bool_]:
    """Cells that deviate, those that a defect saturates among them."""
    over = found.deviating()
    return over if measured.mirroring is None else over | measured.mirroring


def _limit_by_golden(share: float, u: float, known: KnownShares, alpha: float, p_means: float) -> AreaRecord:
    chance = known.chance(share)
    fails = holm(np.array([p_means, chance]))[1] < alpha
    limit = known.limit(alpha if p_means < 0.5 * alpha else 0.5 * alpha)
    verdict = Verdict.FAIL if fails else Verdict.PASS
    return AreaRecord(
        share=share, u=u, max_share=limit, cells=known.cells, verdict=verdict, learnt=True, p_value=chance
    )
