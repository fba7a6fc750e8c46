"""Sheets without a lobe: is the ink missing, or is this no print at all?

Where no lobe fits, one hypothesis can still be tested: that the channels of all poses are those of the recipe's print
with a share of its ink missing, up to the bare substrate. The share is the only free number; everything that is
uncertain of rig, ink and substrate is weighed as it acts there, and how far substrates are not grey and dull.
Pictures that this explains no better than chance (level `decision.alpha`) show no such sheet: the inspection stays
INVALID.
"""

from dataclasses import dataclass

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.significance import chi2_tail
from anisoscope.decision.decision import guarded
from anisoscope.diagnosis.ranking import Diagnosis
from anisoscope.kinds.prints.expectation import PrintExpectation, sources_at
from anisoscope.kinds.prints.measurement import MeasuredPrint
from anisoscope.kinds.prints.model import State
from anisoscope.kinds.prints.quantities import Quantity
from anisoscope.kinds.prints.recipe import PrintRecipe
from anisoscope.kinds.prints.sources import of_channels, of_each, of_poses, total
from anisoscope.parameters.geometry import Convention
from anisoscope.record.schema import CauseRecord
from anisoscope.record.verdict import Verdict
from anisoscope.sim.light.geometry import directions

MISSING_INK, MISSING_TITLE = "missing-ink", "missing ink, share"
"""The cause, by name and in words."""
DULL, TINGED, UNEVEN = 0.03, 0.05, 0.01
"""Relative standard uncertainties of a substrate: how far each pose, each channel and each of both is off a grey
Lambertian one."""
ALIKE = 0.1
"""Relative scatter over poses and channels below which a sheet looks grey and dull."""
_SHARES = (0.0, 0.2, 0.4, 0.6, 0.7, 0.8, 0.85, 0.9, 0.95, 0.98, 1.0)
_ROUNDS, _BETWEEN = 3, 7
_QUANTILE = 3.841458820694124
"""95 % of χ² with one degree of freedom."""


@dataclass(frozen=True)
class Bare:
    """A sheet whose ink is missing.

    Attributes:
        missing: share of the ink that is missing, 1 for the bare substrate.
        u: its standard uncertainty.
        low, high: its 95 % interval.
        chi2: what the best share leaves.
        p_value: probability of more, for such a sheet.
        reflectance: mean reflectance of the sheet as a diffuser.
        quantity: the level of the ink against its limit.
    """

    missing: float
    u: float
    low: float
    high: float
    chi2: float
    p_value: float
    reflectance: float
    quantity: Quantity

    @property
    def reason(self) -> str:
        """Reason in a sentence."""
        if self.high < 1.0:
            return (
                f"{self.missing:.1%} of the ink is missing ({self.low:.1%} to {self.high:.1%}), so that hardly any "
                "lobe is left"
            )
        return (
            "nothing is printed here, the ink is missing: all poses show the bare substrate (reflectance "
            f"{self.reflectance:.3f}), or something as grey and dull that lies in its place"
        )

    def diagnosis(self) -> Diagnosis:
        """The diagnosis, with missing ink as its only cause."""
        found = CauseRecord(
            cause=MISSING_INK,
            title=MISSING_TITLE,
            unit="",
            severity=self.missing,
            u=self.u,
            interval=(self.low, self.high),
            weight=1.0,
            chi2=self.chi2,
            at_bound=self.missing == 1.0,
            tie=True,
        )
        return Diagnosis((found,), self.p_value)


def without_ink(expected: PrintExpectation, measured: MeasuredPrint, recipe: PrintRecipe) -> Bare | None:
    """The share of the ink that is missing, or None where that does not explain what the pictures show.

    Args:
        expected: the prediction.
        measured: the channels, through all gates.
        recipe: limit of the level, guard band, and the level of significance.
    """
    logs = np.log(measured.channels).ravel()
    shares, chi2, cost = _searched(expected, measured, recipe, logs)
    best = int(np.argmin(cost))
    share, (low, high) = float(shares[best]), _interval(shares, cost, best)
    p_value = _chance(expected, measured, recipe, share, float(chi2[best]))
    if p_value < recipe.decision.alpha:
        return None
    u = (high - low) / (2.0 if low > 0.0 and high < 1.0 else 1.0) / np.sqrt(_QUANTILE)
    quantity = _level(recipe, share, float(u))
    if quantity.verdict is not Verdict.FAIL:
        return None
    reflectance = float(np.mean(_reflectances(expected, measured)))
    return Bare(share, float(u), low, high, float(chi2[best]), p_value, reflectance, quantity)


def _searched(
    expected: PrintExpectation, measured: MeasuredPrint, recipe: PrintRecipe, logs: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Shares of missing ink, rising and closest where they explain most; χ² and −2 ln of the likelihood of each."""
    known: dict[float, tuple[float, float]] = {}
    more = np.array(_SHARES)
    for _ in range(_ROUNDS):
        known |= {float(s): _weighed(expected, measured, recipe, logs, float(s)) for s in more}
        shares = sorted(known)
        k = min(range(len(shares)), key=lambda one: known[shares[one]][1])
        more = np.linspace(shares[max(k - 1, 0)], shares[min(k + 1, len(shares) - 1)], _BETWEEN + 2)
    chi2, cost = np.array([known[share] for share in sorted(known)]).T
    return np.array(sorted(known)), chi2, cost


def _interval(shares: FloatArray, cost: FloatArray, best: int) -> tuple[float, float]:
    """95 % interval of the share, by the likelihood ratio; linear between the shares that were looked at."""
    limit = cost[best] + _QUANTILE
    ends = []
    for way in (-1, 1):
        k = best
        while 0 <= k + way < len(shares) and cost[k + way] <= limit:
            k += way
        if not 0 <= k + way < len(shares) or not np.isfinite(cost[k + way]):
            ends.append(float(shares[k]))
            continue
        part = (limit - cost[k]) / (cost[k + way] - cost[k])
        ends.append(float(shares[k] + part * (shares[k + way] - shares[k])))
    return ends[0], ends[1]


def sheet_description(expected: PrintExpectation, measured: MeasuredPrint, recipe: PrintRecipe) -> str:
    """Description of a sheet without a lobe that missing ink does not explain: its reflectance, or ""."""
    found = _reflectances(expected, measured)
    if float(np.std(found)) > ALIKE * float(np.mean(found)):
        return ""
    return (
        f" (The pictures show something grey and dull of reflectance {float(np.mean(found)):.2f}; the recipe's "
        f"substrate has {recipe.print.substrate:g}.)"
    )


def _reflectances(expected: PrintExpectation, measured: MeasuredPrint) -> FloatArray:
    """(P, 3) reflectance of a diffuser that would show the channels."""
    to_light, _ = directions(expected.poses, Convention(expected.scene.light_angle_deg))
    return np.asarray(np.pi * measured.channels / to_light[:, 2:])


def _weighed(
    expected: PrintExpectation, measured: MeasuredPrint, recipe: PrintRecipe, logs: FloatArray, missing: float
) -> tuple[float, float]:
    """χ² and −2 ln of the likelihood of a share of missing ink; infinite where a predicted radiance is zero."""
    state = State(missing=missing)
    if expected.scene.channels(state).min() <= 0.0:
        return np.inf, np.inf
    covariance, _ = _of_sheet(expected, measured, recipe, state)
    off = logs - expected.scene.log_channels(state)
    chi2 = float(off @ np.linalg.solve(covariance, off))
    return chi2, chi2 + float(np.linalg.slogdet(covariance)[1])


def _chance(
    expected: PrintExpectation, measured: MeasuredPrint, recipe: PrintRecipe, missing: float, chi2: float
) -> float:
    """Probability of as much for such a sheet: of χ², or of how bright the sheet is, which χ² alone would hide."""
    state, logs = State(missing=missing), np.log(measured.channels).ravel()
    covariance, bare = _of_sheet(expected, measured, recipe, state)
    weighed = np.linalg.solve(covariance, bare)
    z = float(weighed @ (logs - expected.scene.log_channels(state)) / np.sqrt(weighed @ bare))
    of_level = float(chi2_tail(z * z, 1))
    return min(1.0, 2.0 * min(float(chi2_tail(chi2, logs.size - 1)), of_level))


def _of_sheet(
    expected: PrintExpectation, measured: MeasuredPrint, recipe: PrintRecipe, state: State
) -> tuple[FloatArray, FloatArray]:
    """(N, N) covariance of ln of the channels of such a sheet, and (N,) the substrate's share of each channel."""
    scene = expected.scene
    to_light, _ = directions(expected.poses, Convention(scene.light_angle_deg))
    uncovered = 1.0 - scene.coverage * (1.0 - state.missing)
    bare = to_light[:, 2:] * uncovered * scene.substrate / np.pi / scene.channels(state)
    own = (
        of_poses("bare substrate", "prediction", DULL * bare),
        of_channels("bare substrate", "prediction", TINGED * bare),
        of_each("bare substrate", "prediction", UNEVEN * bare.ravel()),
    )
    sources = (*sources_at(recipe, expected, state), *measured.sources, *own)
    return total(sources, bare.size), np.asarray(bare.ravel())


def _level(recipe: PrintRecipe, missing: float, u: float) -> Quantity:
    limit = recipe.tolerances.gain_share
    verdict, guard, conformance = guarded(-missing, u, limit, recipe.decision.coverage)
    return Quantity(
        name="gain",
        title="level of the ink",
        unit="",
        value=1.0 - missing,
        nominal=1.0,
        deviation=-missing,
        u=u,
        limit=limit,
        guard=guard,
        conformance_probability=conformance,
        verdict=verdict,
    )
