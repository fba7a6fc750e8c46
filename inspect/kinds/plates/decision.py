"""The verdict on a plate: contrasts of its classes with guard bands, single fields, and its code."""

from dataclasses import dataclass

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.notation import p_value_text
from anisoscope.base.significance import chi2_tail, log_basis, mahalanobis
from anisoscope.kinds.plates.expectation import ExpectedPlate
from anisoscope.kinds.plates.measurement import MeasuredPlate
from anisoscope.kinds.plates.recipe import PlateRecipe
from anisoscope.kinds.plates.record import (
    ClassRecord,
    CodeRecord,
    FieldRecord,
    GradeRecord,
    PlateContrastRecord,
    PlateDetails,
    graded,
)
from anisoscope.prediction.expectation import Component
from anisoscope.record.schema import BudgetRecord
from anisoscope.record.verdict import Verdict
from anisoscope.sim.light.contrasts import consecutive_pairs
from anisoscope.sim.light.geometry import Pose

MIDDLE, MIDDLE_ERROR = 0.6, 1.1
"""Share of the fields of a class, by their brightness, whose mean stands for it, so that fields with defects are left
out; and its standard error over that of the mean of all."""
MAD = 1.4826
NEAR = 0.5
"""Rms distance from the change of a defect, in shares of the deviation, up to which a field looks like it."""
LISTED = 3


@dataclass(frozen=True, eq=False)
class PlateDecision:
    """Verdict with its reasons.

    Attributes:
        verdict: of the plate.
        reasons: one line each, most important first.
        details: contrasts, fields, code.
        radiance: (P,) mean over all fields with ridges in 1/sr.
        predicted: (P,) likewise.
        budget: sources of uncertainty of the contrasts.
        d2, dof, p_value: distance of all ln ratios from the prediction, and its probability.
        deviation: (P, rows, cols) ln ratio of every field to its prediction, relative to the mean of all.
        deviating: (rows, cols) fields that fail.
    """

    verdict: Verdict
    reasons: tuple[str, ...]
    details: PlateDetails
    radiance: FloatArray
    predicted: FloatArray
    budget: tuple[BudgetRecord, ...]
    d2: float
    dof: int
    p_value: float
    deviation: FloatArray
    deviating: np.ndarray


def decide_plate(expected: ExpectedPlate, measured: MeasuredPlate, recipe: PlateRecipe) -> PlateDecision:
    """Decide on a plate."""
    classes, letters = expected.plan.classes(), expected.plan.letters
    ln = np.log(measured.radiance)
    middle, scatter, counts = _class_middles(ln, classes, len(letters))
    components = (*expected.components, *_measured_components(expected, measured, recipe, scatter, counts))
    covariance = np.sum([one.covariance() for one in components], axis=0)
    covariance = covariance + _of_poses(expected, measured, recipe)
    off = (middle - np.log(expected.radiance)).ravel()
    names, gradient = contrast_pairs(letters, expected.poses)
    u = np.sqrt(np.einsum("kn,nm,km->k", gradient, covariance, gradient))
    values, due = gradient @ middle.ravel(), gradient @ np.log(expected.radiance).ravel()
    tolerance, coverage = recipe.decision.tolerance, recipe.decision.coverage
    contrasts = tuple(
        PlateContrastRecord(
            name=name,
            measured=float(value),
            predicted=float(want),
            u=float(one),
            tolerance=tolerance,
            guard=None if tolerance is None else float(coverage * one),
            verdict=Verdict.PASS
            if tolerance is None
            else banded(abs(float(value - want)), tolerance, coverage * float(one)),
        )
        for name, value, want, one in zip(names, values, due, u, strict=True)
    )
    basis = log_basis(off.size)
    d2, dof = mahalanobis(basis @ off, basis @ covariance @ basis.T)
    p_value = float(chi2_tail(d2, dof))
    fields = _fields(expected, measured, recipe, ln, middle, classes)
    code = _code(expected, measured, recipe)
    details = PlateDetails(
        classes=tuple(
            ClassRecord(
                direction_class=letter,
                facet_azimuth_deg=expected.plan.azimuths_deg[letter],
                fields=int(counts[number]),
                measured=tuple(np.exp(middle[number]).tolist()),
                predicted=tuple(expected.radiance[number].tolist()),
                scatter=tuple(scatter[number].tolist()),
            )
            for number, letter in enumerate(letters)
        ),
        contrasts=contrasts,
        fields=fields,
        field_count=int((classes >= 0).sum()),
        alike=measured.alike,
        code=code,
    )
    verdict, reasons = _verdict(details, recipe, p_value)
    budget = tuple(
        BudgetRecord(source=one.source, kind=one.kind, contributions=tuple(_share(one, gradient).tolist()))
        for one in sorted(components, key=lambda one: -float(_share(one, gradient).max()))
        if np.any(one.relative)
    )
    weights = counts / counts.sum()
    deviating = np.zeros(classes.shape, dtype=bool)
    for one in fields:
        if one.verdict == "FAIL":
            deviating[one.row, one.col] = True
    deviation = ln - np.log(predicted_fields(expected))
    return PlateDecision(
        verdict,
        reasons,
        details,
        np.asarray(weights @ np.exp(middle)),
        np.asarray(weights @ expected.radiance),
        budget,
        d2,
        dof,
        p_value,
        deviation - np.nanmedian(deviation),
        deviating,
    )


def banded(size: float, tolerance: float, guard: float) -> Verdict:
    """Verdict on a deviation with a guard band (ISO 14253-1)."""
    if size <= tolerance - guard:
        return Verdict.PASS
    return Verdict.FAIL if size >= tolerance + guard else Verdict.INCONCLUSIVE


def contrast_pairs(letters: tuple[str, ...], poses: tuple[Pose, ...]) -> tuple[list[str], FloatArray]:
    """Names of the contrasts, and (K, C·P) derivatives by ln L.

    Contrasts are those of neighbouring classes at one pose, and of one class between poses.
    """
    count, names, rows = len(poses), [], []

    def row(first: int, second: int) -> FloatArray:
        found = np.zeros(len(letters) * count)
        found[first], found[second] = 1.0, -1.0
        return found

    for number, pose in enumerate(poses):
        for a in range(len(letters) - 1):
            names.append(f"ln {letters[a]}/{letters[a + 1]} at {_pose(pose)}")
            rows.append(row(a * count + number, (a + 1) * count + number))
    for a, letter in enumerate(letters):
        for i, j in consecutive_pairs(poses):
            names.append(f"ln {letter} {poses[i].stage_deg:g}-{_pose(poses[j])}")
            rows.append(row(a * count + i, a * count + j))
    return names, np.array(rows)


def _pose(pose: Pose) -> str:
    return f"{pose.stage_deg:g}" + (f" @{pose.tilt_deg:g}" if pose.tilt_deg else "")


def predicted_fields(expected: ExpectedPlate) -> FloatArray:
    """(P, rows, cols) predicted radiance of every field; flat ones by direct light."""
    classes = expected.plan.classes()
    return np.where(
        classes >= 0, expected.radiance.T[:, np.maximum(classes, 0)], expected.flat[:, None, None]
    )


def _class_middles(
    ln: FloatArray, classes: np.ndarray, count: int
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


def _measured_components(
    expected: ExpectedPlate,
    measured: MeasuredPlate,
    recipe: PlateRecipe,
    scatter: FloatArray,
    counts: FloatArray,
) -> tuple[Component, ...]:
    """Uncertainties of the classes that are independent between classes and poses, or shared by all."""
    rig, size = recipe.uncertainty, expected.radiance.size
    own = MIDDLE_ERROR * scatter / np.sqrt(counts)[:, None]
    stray = rig.stray_radiance / expected.radiance
    found = (
        ("scatter between fields", own.ravel(), False),
        ("linearity of the camera", np.full(size, rig.linearity_share), False),
        ("stray light", stray.ravel(), True),
    )
    del measured
    return tuple(Component(name, "measurement", relative, shared) for name, relative, shared in found)


def _of_poses(expected: ExpectedPlate, measured: MeasuredPlate, recipe: PlateRecipe) -> FloatArray:
    """(C·P, C·P) covariance of errors of a pose that all classes share: lamp, flat field, stage angle."""
    rig, poses = recipe.uncertainty, len(expected.poses)
    drift = recipe.limits.drift if measured.drift is None else abs(measured.drift)
    level = np.full(expected.radiance.shape, np.hypot(rig.flat_share, drift / np.sqrt(3.0)))
    found = np.zeros((expected.radiance.size,) * 2)
    for per_pose in (level, rig.stage_deg * expected.per_degree):
        for number in range(poses):
            one = np.zeros_like(expected.radiance)
            one[:, number] = per_pose[:, number]
            found += np.outer(one.ravel(), one.ravel())
    return found


def _share(one: Component, gradient: FloatArray) -> FloatArray:
    """(K,) contribution of a source to every contrast."""
    return np.asarray(np.sqrt(np.einsum("kn,nm,km->k", gradient, one.covariance(), gradient)))


def _fields(
    expected: ExpectedPlate,
    measured: MeasuredPlate,
    recipe: PlateRecipe,
    ln: FloatArray,
    middle: FloatArray,
    classes: np.ndarray,
) -> tuple[FieldRecord, ...]:
    """Fields that do not surely pass, the largest deviation first."""
    tolerance, coverage, letters = recipe.fields.tolerance, recipe.decision.coverage, expected.plan.letters
    found = []
    for row, col in zip(*np.nonzero(classes >= 0), strict=True):
        number = int(classes[row, col])
        off = ln[:, row, col] - middle[number]
        if not np.isfinite(off).any():
            continue
        worst = int(np.nanargmax(np.abs(off)))
        u = float(np.hypot(measured.noise[worst], measured.u_place[worst, row, col]))
        verdict = banded(abs(float(off[worst])), tolerance, min(coverage * u, 0.5 * tolerance))
        if verdict == "PASS":
            continue
        looks = looks_like(off, {name: one[number] for name, one in expected.defects.items()})
        found.append(
            FieldRecord(
                row=int(row),
                col=int(col),
                direction_class=letters[number],
                deviations=tuple(float(one) for one in off),
                u=u,
                verdict=verdict,
                looks_like=looks,
            )
        )
    return tuple(sorted(found, key=lambda one: -max(abs(value) for value in one.deviations)))


def looks_like(off: FloatArray, defects: dict[str, FloatArray]) -> str | None:
    """The defect whose change of ln L (P,) is nearest to a deviation; None where none is near."""
    apart = {name: float(np.sqrt(np.nanmean((off - one) ** 2))) for name, one in defects.items()}
    if not apart:
        return None
    best = min(apart, key=lambda name: apart[name])
    return best if apart[best] <= NEAR * float(np.sqrt(np.nanmean(off**2))) else None


def _code(expected: ExpectedPlate, measured: MeasuredPlate, recipe: PlateRecipe) -> CodeRecord | None:
    """Readings and grades of the code, where the plan is one of two classes."""
    part = recipe.code
    if part is None:
        return None
    due = tuple(pose.tilt_deg == 0.0 and pose.stage_deg in part.read_at_deg for pose in expected.poses)
    classes, grades = expected.plan.classes(), list[GradeRecord]()
    if len(expected.plan.letters) == 2 and (classes >= 0).all():
        predicted = predicted_fields(expected)
        for number, pose in enumerate(expected.poses):
            if not due[number]:
                continue
            darker = int(np.argmin(expected.radiance[:, number]))
            pairs = zip(
                graded(measured.radiance[number], classes == darker, part.symbology),
                graded(predicted[number], classes == darker, part.symbology),
                strict=False,
            )
            grades += [
                GradeRecord(
                    stage_deg=pose.stage_deg,
                    tilt_deg=pose.tilt_deg,
                    parameter=seen.parameter,
                    measured=seen.value,
                    measured_grade=seen.grade,
                    predicted=want.value,
                    predicted_grade=want.grade,
                )
                for seen, want in pairs
            ]
    return CodeRecord(
        text=part.text,
        symbology=part.symbology,
        readings=measured.texts,
        required=due,
        grades=tuple(grades),
    )


def _verdict(details: PlateDetails, recipe: PlateRecipe, p_value: float) -> tuple[Verdict, tuple[str, ...]]:
    """Verdict and reasons."""
    fails, unsure, warnings = list[str](), list[str](), list[str]()
    for one in sorted(details.contrasts, key=lambda one: -abs(one.measured - one.predicted)):
        line = (
            f"{one.name}: measured {one.measured:+.3f}, predicted {one.predicted:+.3f} (u {one.u:.3f}, tolerance "
            f"±{one.tolerance:g})"
            if one.tolerance is not None
            else ""
        )
        if one.verdict == "FAIL":
            fails.append(line)
        elif one.verdict == "INCONCLUSIVE":
            unsure.append(line)
    dead = [one for one in details.fields if one.verdict == "FAIL"]
    if len(dead) > recipe.fields.most:
        fails.insert(0, fields_text(dead))
    elif len(details.fields) > recipe.fields.most:
        unsure.append(f"{fields_text(list(details.fields))}: within the guard band")
    code = details.code
    if code is not None and code.unread:
        seen = ", ".join(
            "nothing" if code.readings[n] is None else repr(code.readings[n]) for n in code.unread
        )
        fails.append(f"the code does not read {code.text!r} in every required pose: {seen}")
    if p_value < recipe.decision.alpha:
        text = f"the classes deviate from the prediction together (p {p_value_text(p_value)})"
        must = recipe.decision.tolerance is None or recipe.decision.deviation == "fail"
        (fails if must else warnings).append(text)
    if fails:
        return Verdict.FAIL, (*fails, *unsure, *warnings)
    if unsure:
        return Verdict.INCONCLUSIVE, (*unsure, *warnings)
    return Verdict.PASS, tuple(warnings)


def fields_text(fields: list[FieldRecord]) -> str:
    """How many fields deviate, and the first of them with what they look like."""
    named = "; ".join(
        f"row {one.row + 1}, column {one.col + 1} ({one.looks_like or 'unlike any known defect'})"
        for one in fields[:LISTED]
    )
    more = f" and {len(fields) - LISTED} more" if len(fields) > LISTED else ""
    return (
        f"{len(fields)} field{'s deviate' if len(fields) > 1 else ' deviates'} from the class: {named}{more}"
    )
