"""Test of a print against the golden prints: T² of all that is fitted, and of the colour of every pose.

The scatter of few prints cannot weigh the 63 channels of 21 poses. What is weighed are combinations of them: the nine
parameters of the fit (roughness in every direction, lean, levels, form of the lobe), taken linearly about the print
that the recipe predicts, so that they are normal if the channels are; and pose by pose the three channels, without what
the lean makes, because the lean may be that of the seat and is one of the nine. The scatter of good prints has the form
of sheets of ink, and the size that golden prints show (`base.significance.like_sample`). Lobe, colours and, where its
limit is learnt, the area share one level, and so do the poses' colours (Holm 1979).
"""

from dataclasses import dataclass

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.significance import holm, like_sample
from anisoscope.decision.lot_reference import LotScatter
from anisoscope.imaging.area_limit import KnownShares
from anisoscope.kinds.prints.expectation import PrintExpectation, rig_sources, scatter_of_prints
from anisoscope.kinds.prints.lobe_fit import PARAMETERS
from anisoscope.kinds.prints.model import State
from anisoscope.kinds.prints.recipe import PrintRecipe
from anisoscope.kinds.prints.record import GoldenColourRecord, GoldenFitRecord, GoldenPrintsRecord
from anisoscope.kinds.prints.reference_prints import GoldenPrints
from anisoscope.kinds.prints.sources import Source, total

FIT_TITLES = {
    "alpha": ("ln of the roughness", ""),
    "ratio": ("ln of roughness at 90° over 0°", ""),
    "skew": ("ln of roughness at 135° over 45°", ""),
    "tilt_x_deg": ("lean toward +x", "°"),
    "tilt_y_deg": ("lean toward +y", "°"),
    "red": ("ln of the level of red", ""),
    "green": ("ln of the level of green", ""),
    "blue": ("ln of the level of blue", ""),
    "lobe": ("form of the lobe", ""),
}
"""Fitted parameters, with their units."""
LEAN = [PARAMETERS.index(name) for name in ("tilt_x_deg", "tilt_y_deg")]


@dataclass(frozen=True)
class GoldenArea:
    """Comparison of the deviating area with that of the golden prints.

    Attributes:
        limit: largest share of one more good print, but for its part of the level.
        p_value: probability of as much for a print like the golden ones, Holm-adjusted over all tests.
        prints: number of golden prints behind the limit.
    """

    limit: float
    p_value: float
    prints: int


@dataclass(frozen=True, eq=False)
class GoldenComparison:
    """Comparison of a print with the golden prints.

    Attributes:
        count: n, how many they are.
        words: a print like them, in words.
        fitted: (n, 9) parameters of the golden prints from those of the predicted print, as of `lobe_fit.PARAMETERS`.
        measured: (9,) those of this print.
        t2: T² of the nine.
        p_fitted: probability of more for a print like the golden ones, Holm-adjusted.
        colours: one a pose.
        logs: (3P,) mean of the golden prints' ln of the channels.
        covariance: (3P, 3P) covariance of a good print's ln of the channels about it, from the scatter of the nine.
        area: the deviating area by that of the golden prints, or None where they lack it.
        lot: lot of the print, where these are its other prints, of unknown quality.
    """

    count: int
    words: str
    fitted: FloatArray
    measured: FloatArray
    t2: float
    p_fitted: float
    colours: tuple[GoldenColourRecord, ...]
    logs: FloatArray
    covariance: FloatArray
    area: GoldenArea | None = None
    lot: str | None = None

    @property
    def p_value(self) -> float:
        """Probability that a print like the golden ones deviates as much in any test but that of the area."""
        return min(self.p_fitted, *(one.p_value for one in self.colours))

    def record(self) -> GoldenPrintsRecord:
        """The comparison as the record holds it."""
        fitted = tuple(
            GoldenFitRecord(
                name=name,
                title=FIT_TITLES[name][0],
                unit=FIT_TITLES[name][1],
                measured=float(own),
                mean=float(known.mean()),
                s=float(known.std(ddof=1)),
                golden=tuple(known.tolist()),
            )
            for name, own, known in zip(PARAMETERS, self.measured, self.fitted.T, strict=True)
        )
        return GoldenPrintsRecord(
            parts=self.count,
            lot=self.lot,
            t2=self.t2,
            p_value=self.p_fitted,
            fitted=fitted,
            colours=self.colours,
        )


@dataclass(frozen=True, eq=False)
class LinearFit:
    """The fit about the predicted print: (3P, 9) slopes, and (9, 3P) what ln of the channels makes of the nine."""

    slopes: FloatArray
    gain: FloatArray


def linear_fit(expected: PrintExpectation, sources: tuple[Source, ...]) -> LinearFit:
    """The linear fit of prints.

    Args:
        expected: the prediction, about which it is linear.
        sources: uncertainty of what the fit does not vary; it weighs the channels.
    """
    slopes = np.stack([expected.scene.slope(name, State()) for name in PARAMETERS], axis=-1)
    weighed = np.linalg.solve(total(sources, len(slopes)), slopes)
    return LinearFit(slopes, np.linalg.solve(slopes.T @ weighed, weighed.T))


def compare_with_golden(
    golden: GoldenPrints,
    expected: PrintExpectation,
    logs: FloatArray,
    fit: LinearFit,
    stated: FloatArray,
    area: tuple[KnownShares, float] | None = None,
    alpha: float = 0.01,
) -> GoldenComparison:
    """Test a print against the golden prints.

    Args:
        golden: the set, none of whose prints is lacking.
        expected: the prediction.
        logs: (3P,) ln of the print's channels.
        fit: what is weighed, of all prints alike.
        stated: (3P, 3P) covariance of ln of the channels of good prints by all that is uncertain of one: its form.
        area: area shares of the golden prints, and the share that deviates here; None where they lack them.
        alpha: level of all tests together.

    Raises:
        MeasurementError: the golden prints are too few.
    """
    base = np.log(expected.channels).ravel()
    slopes, gain = fit.slopes, fit.gain
    known, mine = golden.logs() - base, logs - base
    fitted, own = known @ gain.T, gain @ mine
    t2, p_fitted = like_sample(own, fitted, gain @ stated @ gain.T)
    flat = np.eye(base.size) - slopes[:, LEAN] @ gain[LEAN]
    others = (known @ flat.T).reshape(len(known), -1, 3)
    here = (flat @ mine).reshape(-1, 3)
    level = (flat @ stated @ flat.T).reshape(len(here), 3, len(here), 3)
    tests = [like_sample(here[k], others[:, k], level[k, :, k]) for k in range(len(here))]
    of_poses = holm(np.array([p for _, p in tests]))
    p_values = [p_fitted, float(of_poses.min())]
    shares = None if area is None else _area(*area, p_values, alpha)
    p_values += [] if area is None else [area[0].chance(area[1])]
    p_fitted, p_colours = (float(p) for p in holm(np.array(p_values))[:2])
    apart, spread = _differences(expected, here, others)
    colours = tuple(
        GoldenColourRecord(
            stage_deg=pose.stage_deg,
            tilt_deg=pose.tilt_deg,
            delta_e=float(apart[k]),
            spread=float(spread[k]),
            t2=tests[k][0],
            p_value=float(max(of_poses[k], p_colours)),
        )
        for k, pose in enumerate(expected.poses)
    )
    count = len(known)
    scatter = slopes @ np.cov(fitted, rowvar=False) @ slopes.T * (1.0 + 1.0 / count)
    mean = golden.logs().mean(axis=0)
    return GoldenComparison(
        count,
        golden.words,
        fitted,
        own,
        t2,
        p_fitted,
        colours,
        mean,
        np.asarray(scatter),
        shares,
        golden.lot,
    )


def lot_scatter(logs: FloatArray, recipe: PrintRecipe, expected: PrintExpectation) -> LotScatter:
    """What is compared of prints of unknown quality: the nine parameters, which scatter in the form of sheets of ink.

    Args:
        logs: (n, 3P) ln of the channels of the prints.
        recipe: the recipe.
        expected: its prediction.
    """
    gain = linear_fit(expected, (*expected.common, *rig_sources(recipe, expected))).gain
    off = logs - np.log(expected.channels).ravel()
    return LotScatter(off @ gain.T, gain @ scatter_of_prints(recipe, expected) @ gain.T, sized=False)


def _area(known: KnownShares, share: float, others: list[float], alpha: float) -> GoldenArea:
    """Test of the area, Holm-adjusted with the p values of the other tests; its limit is that of its Holm step."""
    rejected = 0
    for step, p_value in enumerate(sorted(others)):
        if p_value * (len(others) + 1 - step) >= alpha:
            break
        rejected += 1
    limit = known.limit(alpha / (len(others) + 1 - rejected))
    adjusted = float(holm(np.array([*others, known.chance(share)]))[-1])
    return GoldenArea(limit, adjusted, len(known.shares))


def _differences(
    expected: PrintExpectation, here: FloatArray, others: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """(P,) CIEDE2000 of a print from the golden prints' mean, and the rms of theirs; ln of channels over predicted."""
    mean = others.mean(axis=0)
    mean_channels = expected.channels * np.exp(mean)
    apart = expected.eye.difference(expected.channels * np.exp(here), mean_channels)
    each = expected.eye.difference(
        expected.channels * np.exp(others), np.broadcast_to(mean_channels, others.shape)
    )
    return apart, np.sqrt(np.mean(each**2, axis=0) * len(others) / (len(others) - 1.0))
