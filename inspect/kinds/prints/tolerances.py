"""Tolerances of a print's recipe learnt from good prints, and the recipe rewritten with them.

One good print is a single sample; its limits come from the uncertainty of the inspection. Golden prints show how good
prints vary. A limit then has two parts: the value that one more good print reaches, and the guard band of the rule, so
that a stated share of good prints is below limit − guard band in all quantities at once (Bonferroni: the remaining
probability is divided equally among the quantities). Deviations are from the mean of the golden prints, on either side.
The value that one more good print reaches is the prediction limit of a normal sample, t·√(s² (1 + 1/n) + u²), for
quantities with a sign; lengths and CIEDE2000 are taken as
L^(2/3), which is nearly normal for the length of a normal vector (Wilson and Hilferty 1931). u is the standard
uncertainty of the measurement: an error common to golden prints of one rig and one flat is not in their scatter, and
changes with the next calibration.

Teaching photographs nothing. Exposure, region and poses stay, so that the golden prints remain those of the recipe.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from decimal import ROUND_UP, Decimal
from pathlib import Path
from typing import Any

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.atomic_write import write_text
from anisoscope.base.errors import UsageError
from anisoscope.base.regular_file import bounded_text
from anisoscope.base.toml_edits import with_values
from anisoscope.decision.reference_parts import golden_path, limit_is_given
from anisoscope.kinds.prints.decision import PrintDecision, decide_print
from anisoscope.kinds.prints.expectation import PrintExpectation
from anisoscope.kinds.prints.lighting import check_print_rig, expectation_of_print
from anisoscope.kinds.prints.measurement import MeasuredPrint, cell_grid
from anisoscope.kinds.prints.pose_colours import colours_of
from anisoscope.kinds.prints.quantities import Quantity
from anisoscope.kinds.prints.recipe import PrintRecipe
from anisoscope.kinds.prints.record import LENGTHS, print_of
from anisoscope.kinds.prints.reference_prints import GoldenPrints, read_golden_prints
from anisoscope.kinds.prints.sources import of_poses, total
from anisoscope.recipe.teaching import Change, Taught, previous_version_path
from anisoscope.record.schema import Record
from anisoscope.rig.rigfile import read_replay_rig

TARGET_RATIO = 4.0  # T/U, U = 2 u
SIGMAS = 3.0
PASSING = 0.95
"""Share of good prints that should pass all limits that golden prints teach."""
KEYS = {
    "alpha x": "alpha_share",
    "alpha y": "alpha_share",
    "ratio": "ln_ratio",
    "skew": "ln_ratio",
    "gain": "gain_share",
    "chromaticity": "chromaticity",
    "tilt": "tilt_deg",
    "delta_e": "delta_e",
    "curl": "curl_deg",
}
"""The limit under which each quantity stands in the recipe."""
WHY = f"{TARGET_RATIO:g} times the expanded uncertainty, or what this print deviates and {SIGMAS:g} u if that is more"
_DRIFT = 0.25
"""Drift of the lamp in an inspection by its limit, as `recipe check` takes it."""


@dataclass(frozen=True)
class TaughtLimit:
    """A limit, and where it comes from."""

    value: float
    why: str


@dataclass(frozen=True)
class _Spread:
    """A quantity of golden prints: deviations, largest guard band, and u of the measurement alone."""

    deviations: FloatArray
    guard: float
    u: float


def taught_tolerances(record: Record, recipe: PrintRecipe) -> dict[str, TaughtLimit]:
    """Limits by their keys, for all that was judged; rounded up to two digits.

    Args:
        record: the inspection of a good print.
        recipe: its recipe, whose other limits stay.
    """
    details = print_of(record)
    assert details is not None
    found: dict[str, float] = {}
    for one in details.quantities:
        needed = max(TARGET_RATIO * 2.0 * one.u, abs(one.deviation) + SIGMAS * one.u)
        key = KEYS[one.name]
        found[key] = max(found.get(key, 0.0), needed)
    return {key: _limit(recipe, key, value, WHY) for key, value in found.items() if value > 0.0}


def golden_tolerances(
    golden: GoldenPrints, recipe: PrintRecipe, expected: PrintExpectation, share: float = PASSING
) -> dict[str, TaughtLimit]:
    """Limits that one more good print passes in all quantities at once with a probability of `share`.

    Args:
        golden: good prints, none of which is lacking.
        recipe: their recipe; limits of which they say nothing stay.
        expected: what it predicts.
        share: of good prints, 0 to 1.
    """
    spreads = _quantities(golden, recipe, expected)
    alpha = (1.0 - share) / len(spreads)
    found: dict[str, tuple[float, str]] = {}
    for name, one in spreads.items():
        reached = _reached(name, one, alpha)
        words = (
            f"{len(one.deviations)} golden prints: at least {share:.0%} of good prints pass all limits; the next one "
            f"reaches {reached:.2g} from their mean, guard band {one.guard:.2g}"
        )
        if reached + one.guard > found.get(KEYS[name], (0.0, ""))[0]:
            found[KEYS[name]] = (reached + one.guard, words)
    return {key: _limit(recipe, key, value, why) for key, (value, why) in found.items()}


def wider(recipe: PrintRecipe, found: Mapping[str, TaughtLimit]) -> tuple[str, ...]:
    """Keys whose new limit is wider than the one that the recipe has, stated or not."""
    return tuple(key for key, one in found.items() if one.value > getattr(recipe.tolerances, key))


def _limit(recipe: PrintRecipe, key: str, value: float, why: str) -> TaughtLimit:
    limit, before = _rounded_up(value), getattr(recipe.tolerances, key)
    if limit > before:
        stated = key in recipe.tolerances.model_fields_set
        why += f"; WIDER than the {'stated' if stated else 'usual'} {before:g}"
    return TaughtLimit(limit, why)


def _reached(name: str, one: _Spread, alpha: float) -> float:
    """Limit that one more good print exceeds with a probability of alpha."""
    from scipy.special import stdtrit  # noqa: PLC0415 - heavy

    count = len(one.deviations)
    more = 1.0 + 1.0 / count
    if name not in LENGTHS:
        factor = float(stdtrit(count - 1, 1.0 - 0.5 * alpha))
        spread = np.sqrt(float(one.deviations.var(ddof=1)) * more + one.u**2)
        return float(factor * spread)
    roots = np.cbrt(one.deviations**2)
    factor = float(stdtrit(count - 1, 1.0 - alpha))
    reach = (float(roots.mean()) + factor * float(roots.std(ddof=1)) * np.sqrt(more)) ** 1.5
    # a shift of the measurement adds to a length along one direction
    return float(np.hypot(reach, factor * one.u))


def _quantities(golden: GoldenPrints, recipe: PrintRecipe, expected: PrintExpectation) -> dict[str, _Spread]:
    """Values of every quantity in golden prints, by the present recipe and prediction."""
    plain = recipe.model_copy(update={"area": None})
    measured = [_measured(logs, plain) for logs in golden.logs()]
    decisions = [decide_print(expected, one, plain, golden) for one in measured]
    found: dict[str, _Spread] = {}
    for k, first in enumerate(decisions[0].quantities):
        rows = [decision.quantities[k] for decision in decisions]
        if first.name == "delta_e":
            u = [_u_of_colours(expected, *pair) for pair in zip(measured, decisions, strict=True)]
        else:
            u = [_of_measurement(row) for row in rows]
        deviations = np.array([row.deviation for row in rows])
        found[first.name] = _Spread(deviations, max(row.guard for row in rows), max(u))
    curls = [(part.curl_deg, part.u_curl_deg) for part in golden.parts if part.curl_deg is not None]
    if recipe.area is not None and len(curls) == len(golden.parts):
        known = np.array(curls, dtype=np.float64)
        u_curl = float(known[:, 1].max())
        found["curl"] = _Spread(known[:, 0], recipe.decision.coverage * u_curl, u_curl)
    return found


def _measured(logs: FloatArray, recipe: PrintRecipe) -> MeasuredPrint:
    """Measurement of a golden print from its stored channels; its noise is small and left out."""
    channels = np.exp(logs).reshape(-1, 3)
    lamp = _DRIFT * recipe.limits.drift / np.sqrt(3.0)
    drift = of_poses("drift of the lamp", "measurement", np.full(channels.shape, lamp))
    cells, noise = channels[:, :, None, None], np.zeros_like(channels)
    return MeasuredPrint(channels, cells, noise, (drift,), cell_grid(recipe), None)


def _of_measurement(one: Quantity) -> float:
    """Standard uncertainty of a quantity from the measurement alone."""
    return float(np.linalg.norm([u for _, kind, u in one.contributions if kind == "measurement"]))


def _u_of_colours(expected: PrintExpectation, measured: MeasuredPrint, decision: PrintDecision) -> float:
    """The same of CIEDE2000, of the pose in which it is largest."""
    own = tuple(source for source in decision.sources if source.kind == "measurement")
    covariance = total(own, measured.channels.size)
    return max(one.u_delta_e for one in colours_of(expected, measured, decision.fit, covariance))


def _rounded_up(value: float) -> float:
    exact = Decimal(value)
    return float(exact.quantize(Decimal(1).scaleb(exact.adjusted() - 1), rounding=ROUND_UP))


def teach_by_golden(recipe_path: Path, rig_path: Path, share: float = PASSING) -> Taught:
    """Write a new version of a print's recipe with tolerances learnt from its golden prints; the old one is saved.

    Args:
        recipe_path: recipe file.
        rig_path: rig file, for lamp, camera and angle of the light; no device is opened.
        share: of good prints that should pass all limits, 0 to 1.

    Raises:
        UsageError: the recipe is no print's, the share makes no sense, or there are too few golden prints.
        RecipeError, InkFileError, RigFileError, CalibrationError: a file that is missing or wrong.
        RecordError: a file cannot be written.
    """
    if not 0.5 <= share < 1.0:
        raise UsageError(f"--share must lie between 0.5 and 1, not {share:g}")
    recipe = PrintRecipe.read(recipe_path)
    rig = read_replay_rig(rig_path, recipe.acquisition.light_channel)
    check_print_rig(rig, rig_path)
    golden = read_golden_prints(golden_path(recipe_path), recipe, rig)
    if golden is None or golden.lacking is not None:
        why = "there are none yet" if golden is None else golden.lacking
        raise UsageError(
            f"{recipe_path}: golden prints cannot teach it: {why}: add some with `anisoscope golden add`"
        )
    limits = golden_tolerances(golden, recipe, expectation_of_print(recipe, rig), share)
    values: dict[tuple[str, ...], Any] = {("version",): recipe.version + 1}
    values |= {("tolerances", key): one.value for key, one in limits.items()}
    previous, text = (
        previous_version_path(recipe_path, recipe.version),
        bounded_text(recipe_path),
    )
    new = with_values(text, values)
    write_text(previous, text)
    write_text(recipe_path, new)
    taught = PrintRecipe.read(recipe_path)
    changes = tuple(
        Change(f"tolerances.{key}", getattr(recipe.tolerances, key), getattr(taught.tolerances, key), one.why)
        for key, one in limits.items()
    )
    return Taught(taught.version, previous, None, changes, _notes(recipe, golden))


def _notes(recipe: PrintRecipe, golden: GoldenPrints) -> tuple[str, ...]:
    """Notes on the limit of the area, which is learnt at every inspection."""
    notes = []
    rule = recipe.area
    if rule is not None and limit_is_given(rule):
        notes.append(
            f"area.max_share stays {rule.max_share:g}, as the recipe says: leave it out, and it is learnt from golden "
            "prints"
        )
    elif rule is not None:
        limit = golden.area_limit(recipe)
        learnt = "golden prints tell no limit of the area yet" if limit is None else f"it is {limit:.2%} now"
        notes.append(f"the limit of the area is learnt at every inspection: {learnt}")
    if rule is not None and any(part.curl_deg is None for part in golden.parts):
        notes.append(
            "tolerances.curl_deg stays: golden prints that were added by earlier versions do not tell the curl"
        )
    return tuple(notes)
