"""Single fields of a plate: by how much they are off, whether that is tolerated or chance, and what it looks like."""

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.kinds.plates.expectation import ExpectedPlate
from anisoscope.kinds.plates.field_outliers import (
    FieldScatter,
    class_middles,
    class_scatter,
    field_p_values,
    golden_scatter,
)
from anisoscope.kinds.plates.measurement import MeasuredPlate
from anisoscope.kinds.plates.recipe import PlateRecipe
from anisoscope.kinds.plates.record import FieldRecord, PowerRecord
from anisoscope.kinds.plates.reference_plates import GoldenPlates
from anisoscope.record.verdict import Verdict

TESTS = 2
"""Tests that share the level of the recipe: classes, and fields."""
NEAR = 0.5
"""Distance from the change of a defect, in shares of the deviation, up to which a field looks like it."""
EXTENTS = {"worn": (0.4, 1.6), "filled": (0.4, 1.1), "merged": (0.4, 1.1)}
"""Ranges of the extents of defects, relative to the predicted ones; others are of one extent."""
TIE = 4.0
"""Difference of twice the log likelihoods of two defects below which they tie."""
DOUBT = 0.1
"""Relative uncertainty of the predicted change of ln L by a defect."""
LISTED = 3
UNLIKE = "unlike any known defect"


def banded(size: float, tolerance: float, guard: float) -> Verdict:
    """Verdict on a deviation with a guard band (ISO 14253-1)."""
    if size <= tolerance - guard:
        return Verdict.PASS
    return Verdict.FAIL if size >= tolerance + guard else Verdict.INCONCLUSIVE


def predicted_fields(expected: ExpectedPlate) -> FloatArray:
    """(P, rows, cols) predicted radiance of every field: by the height map, or that of its class."""
    if expected.fields is not None:
        return expected.fields
    classes = expected.plan.classes()
    return np.where(
        classes >= 0, expected.radiance.T[:, np.maximum(classes, 0)], expected.flat[:, None, None]
    )


def field_offsets(expected: ExpectedPlate, ln: FloatArray, middle: FloatArray) -> FloatArray:
    """(P, rows, cols) ln L of the fields less the middle of their class, or less what the height map predicts of it.

    NaN for flat fields. With a height map the middle of the class is that of the differences.
    """
    classes = expected.plan.classes()
    if expected.fields is not None:
        ln = ln - np.log(expected.fields)
        middle, _, _ = class_middles(ln, classes, len(middle))
    return np.where(classes >= 0, ln - middle.T[:, np.maximum(classes, 0)], np.nan)


def compared_fields(
    expected: ExpectedPlate, recipe: PlateRecipe, offsets: FloatArray, golden: GoldenPlates | None
) -> tuple[FloatArray, tuple[FieldScatter | None, ...]]:
    """(P, rows, cols) offsets less the pattern of golden plates, and the scatter of the fields of every class.

    Args:
        expected: the prediction.
        recipe: tolerance of a field.
        offsets: (P, rows, cols) of `field_offsets`.
        golden: good plates whose pattern and scatter are taken, or None.
    """
    classes = expected.plan.classes()
    pattern = None if golden is None else golden.pattern(classes.shape)
    tested = offsets if pattern is None else offsets - pattern
    return tested, tuple(
        class_scatter(_of_class(tested, classes, number), recipe.fields.tolerance)
        if pattern is None
        else _golden(golden, classes, number)
        for number in range(len(expected.plan.letters))
    )


def judge_fields(
    expected: ExpectedPlate,
    measured: MeasuredPlate,
    recipe: PlateRecipe,
    offsets: FloatArray,
    tested: FloatArray,
    scatters: tuple[FieldScatter | None, ...],
) -> tuple[tuple[FieldRecord, ...], tuple[PowerRecord, ...]]:
    """Fields that do not surely pass or deviate significantly, the largest deviation first, and powers of the test.

    Args:
        expected: the prediction.
        measured: the fields.
        recipe: tolerance of a field, and level.
        offsets: (P, rows, cols) of `field_offsets`.
        tested: the same less the pattern of golden plates, as of `compared_fields`.
        scatters: of every class.
    """
    rule, letters, classes = recipe.decision, expected.plan.letters, expected.plan.classes()
    level = rule.alpha / TESTS
    p_values = field_p_values(tested, classes, scatters)
    found = []
    for row, col in zip(*np.nonzero(classes >= 0), strict=True):
        number, off = int(classes[row, col]), offsets[:, row, col]
        if not np.isfinite(off).any():
            continue
        worst, p_value = int(np.nanargmax(np.abs(off))), float(p_values[row, col])
        u = float(np.hypot(measured.noise[worst], measured.u_place[worst, row, col]))
        tolerance = recipe.fields.tolerance
        verdict = banded(abs(float(off[worst])), tolerance, min(rule.coverage * u, 0.5 * tolerance))
        significant = p_value < level
        if significant and rule.deviation == "fail":
            verdict = Verdict.FAIL
        if verdict == "PASS" and not significant:
            continue
        changes = {name: one[number] for name, one in expected.defects.items()}
        likely = looks_like(off, changes, scatters[number])
        found.append(
            FieldRecord(
                row=int(row),
                col=int(col),
                direction_class=letters[number],
                deviations=tuple(float(one) for one in off),
                u=u,
                verdict=verdict,
                looks_like=next(iter(likely), None),
                or_like=likely[1:],
                p_value=p_value,
                significant=significant,
            )
        )
    found.sort(key=lambda one: -max(abs(value) for value in one.deviations))
    return tuple(found), _powers(expected, scatters, level / max(int((classes >= 0).sum()), 1))


def _of_class(offsets: FloatArray, classes: np.ndarray, number: int) -> FloatArray:
    """(N, P) offsets of the known fields of a class."""
    found = offsets[:, classes == number].T
    return np.asarray(found[np.isfinite(found).all(axis=1)])


def _golden(golden: GoldenPlates | None, classes: np.ndarray, number: int) -> FieldScatter:
    """Scatter of the fields of a class about the pattern of golden plates."""
    assert golden is not None
    return golden_scatter(golden.offsets(classes.shape)[:, :, classes == number].transpose(0, 2, 1))


def _powers(
    expected: ExpectedPlate, scatters: tuple[FieldScatter | None, ...], level: float
) -> tuple[PowerRecord, ...]:
    """Probability that a single field with each defect is found, in the class in which that is hardest."""
    known = [(number, one) for number, one in enumerate(scatters) if one is not None]
    return tuple(
        PowerRecord(defect=name, power=min(one.power(changes[number], level) for number, one in known))
        for name, changes in expected.defects.items()
        if known
    )


def looks_like(
    off: FloatArray, defects: dict[str, FloatArray], scatter: FieldScatter | None = None
) -> tuple[str, ...]:
    """Names of the defect whose change of ln L is nearest to (P,) offsets, and of those that tie with it.

    Empty where none is near. Defects tie where their likelihoods differ by less than a factor of seven.

    Args:
        off: (P,) offset of a field.
        defects: by name the (P,) predicted change; its extent may differ.
        scatter: of the class, which weighs the poses.
    """
    known = np.isfinite(off)
    own = 1e-4 * np.eye(off.size) if scatter is None else scatter.covariance
    scores, apart = dict[str, float](), dict[str, float]()
    for name, change in defects.items():
        doubted = (own + np.diag((DOUBT * change) ** 2))[np.ix_(known, known)]
        inverse = np.linalg.inv(doubted)
        extents = np.linspace(*EXTENTS.get(name, (1.0, 1.0)), 25)
        left = off[known] - extents[:, None] * change[known]
        left = np.vstack([left, off[known]])
        size = np.einsum("np,pq,nq->n", left, inverse, left)
        scores[name] = float(size[:-1].min() + np.linalg.slogdet(doubted)[1])
        apart[name] = float(np.sqrt(size[:-1].min() / max(size[-1], 1e-12)))
    near = sorted((name for name in scores if apart[name] <= NEAR), key=lambda name: scores[name])
    return tuple(name for name in near if scores[name] - scores[near[0]] < TIE)


def fields_text(fields: list[FieldRecord]) -> str:
    """Number of deviating fields, and the first of them with their appearance."""
    named = "; ".join(_field_text(one) for one in fields[:LISTED])
    more = len(fields) - LISTED
    if len(fields) == 1:
        return f"1 field deviates from its class: {named}"
    if more > 0:
        return f"{len(fields)} fields deviate from their class: {named}; and {more} more"
    return f"{len(fields)} fields deviate from their class: {named}"


def places_text(fields: list[FieldRecord]) -> str:
    """Places of fields, row by row; of many only the most deviating ones."""
    listed = sorted(fields[:LISTED], key=lambda one: (one.row, one.col))
    named = "; ".join(f"row {one.row + 1}, column {one.col + 1}" for one in listed)
    more = len(fields) - LISTED
    return f"{named}; and {more} more" if more > 0 else named


def _field_text(one: FieldRecord) -> str:
    looks = one.likeness or UNLIKE
    return f"row {one.row + 1}, column {one.col + 1} ({looks})"
