"""The verdict on a plate: contrasts of its classes with guard bands, single fields, and its code."""

from dataclasses import dataclass

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.notation import p_value_text
from anisoscope.base.significance import chi2_tail, log_basis, mahalanobis
from anisoscope.decision.exclusion import MORE_TILTS, open_defects, open_text, with_exclusions
from anisoscope.kinds.plates.code_grades import Cells, Grade, graded
from anisoscope.kinds.plates.code_symbol import Symbol, find_symbol, read_fields
from anisoscope.kinds.plates.excluded_fields import OF_ALL, excluded_fields
from anisoscope.kinds.plates.expectation import ExpectedPlate
from anisoscope.kinds.plates.field_judgement import (
    TESTS,
    banded,
    compared_fields,
    field_offsets,
    fields_text,
    judge_fields,
    predicted_fields,
)
from anisoscope.kinds.plates.field_outliers import MIDDLE_ERROR, class_middles
from anisoscope.kinds.plates.field_places import FieldPlaces
from anisoscope.kinds.plates.measurement import MeasuredPlate
from anisoscope.kinds.plates.recipe import PlateRecipe, Symbology
from anisoscope.kinds.plates.record import (
    ClassRecord,
    CodeRecord,
    GoldenPlatesRecord,
    GradeRecord,
    PlacementRecord,
    PlateContrastRecord,
    PlateDetails,
)
from anisoscope.kinds.plates.reference_plates import GoldenPlates
from anisoscope.parameters.geometry import Pose
from anisoscope.prediction.expectation import Component
from anisoscope.record.schema import BudgetRecord
from anisoscope.record.verdict import Verdict
from anisoscope.sim.light.contrasts import consecutive_pairs
from anisoscope.sim.light.geometry import directions

NONE_NAMED = "no defect is excluded: [defects] names none"
MEASURE_LOBE = (
    "measure the lobe (anisoscope calibrate material), or add golden plates (anisoscope golden add)"
)
MOST_RECORDED = 4096
"""Fields of which the offsets are recorded."""


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
        class_deviation: (C·P,) ln L of the classes, measured − predicted.
        covariance: (C·P, C·P) of it.
        components: its sources.
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
    class_deviation: FloatArray
    covariance: FloatArray
    components: tuple[Component, ...]


def decide_plate(
    expected: ExpectedPlate,
    measured: MeasuredPlate,
    recipe: PlateRecipe,
    golden: GoldenPlates | None = None,
) -> PlateDecision:
    """Decide on a plate.

    Args:
        expected: the prediction.
        measured: the fields.
        recipe: limits and rule.
        golden: good plates that replace the prediction where deviations are tested, or None.
    """
    classes, letters = expected.plan.classes(), expected.plan.letters
    ln = np.log(measured.radiance)
    middle, scatter, counts = class_middles(ln, classes, len(letters))
    components = (*expected.components, *_measured_components(expected, recipe, scatter, counts))
    covariance = np.sum([one.covariance() for one in components], axis=0)
    covariance = covariance + _of_poses(expected, measured.drift, recipe)
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
    p_value, compared = float(chi2_tail(d2, dof)), None
    if golden is not None:
        d2, dof, p_value = golden.t_squared(middle, covariance)
        compared = GoldenPlatesRecord(parts=len(golden.parts), t2=d2, p_value=p_value)
    offsets = field_offsets(expected, ln, middle)
    tested, scatters = compared_fields(expected, recipe, offsets, golden)
    fields, powers = judge_fields(expected, measured, recipe, offsets, tested, scatters)
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
        powers=powers,
        placement=tuple(_placement(one, expected.plan.module_mm) for one in measured.places),
        field_offsets=_recorded(offsets),
        golden=compared,
    )
    verdict, reasons = _verdict(details, recipe, p_value)
    if verdict is Verdict.PASS:
        absolute = covariance + recipe.uncertainty.scale_share**2
        free = tolerance is None and golden is None
        found = excluded_fields(expected, recipe, tested, scatters, (off, absolute) if free else None)
        shared = open_defects(tuple(one for one in found if one.defect.words.startswith(OF_ALL)))
        details = details.model_copy(update={"exclusions": tuple(one.record() for one in found)})
        if shared and recipe.decision.unexcluded == "note":
            reasons = (open_text(shared, MEASURE_LOBE), *reasons)
        remedy = MEASURE_LOBE if shared else MORE_TILTS
        verdict, reasons = with_exclusions(
            verdict, reasons, found, recipe.decision.unexcluded, remedy, NONE_NAMED
        )
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
        off,
        covariance,
        components,
    )


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


def _recorded(offsets: FloatArray) -> tuple[tuple[tuple[float | None, ...], ...], ...]:
    """Offsets with four decimals; none of plates of very many fields."""
    if offsets[0].size > MOST_RECORDED:
        return ()
    return tuple(
        tuple(tuple(round(float(one), 4) if np.isfinite(one) else None for one in row) for row in pose)
        for pose in offsets
    )


def _placement(places: FieldPlaces | None, module_mm: float) -> PlacementRecord | None:
    """Places of the fields as the record has them."""
    if places is None:
        return None
    x, y = places.shift
    return PlacementRecord(
        shift_mm=(x * module_mm, y * module_mm),
        turn_deg=places.turn_deg,
        axial=places.axial,
        grid=places.grid,
    )


def planned_contrasts(
    expected: ExpectedPlate, recipe: PlateRecipe
) -> tuple[list[str], FloatArray, FloatArray]:
    """Names of the contrasts that will be judged, (K,) what is predicted, and (K, K) covariance without scatter."""
    names, gradient = contrast_pairs(expected.plan.letters, expected.poses)
    covariance = gradient @ planned_covariance(expected, recipe) @ gradient.T
    return names, gradient @ np.log(expected.radiance).ravel(), covariance


def planned_covariance(expected: ExpectedPlate, recipe: PlateRecipe) -> FloatArray:
    """(C·P, C·P) covariance of ln L of the classes without scatter of fields, on the absolute scale."""
    none = np.zeros_like(expected.radiance)
    measured = _measured_components(expected, recipe, none, np.ones(len(none)))
    covariance = np.sum([one.covariance() for one in (*expected.components, *measured)], axis=0)
    return np.asarray(covariance + _of_poses(expected, None, recipe) + recipe.uncertainty.scale_share**2)


def _measured_components(
    expected: ExpectedPlate, recipe: PlateRecipe, scatter: FloatArray, counts: FloatArray
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
    return tuple(Component(name, "measurement", relative, shared) for name, relative, shared in found)


def _of_poses(expected: ExpectedPlate, measured_drift: float | None, recipe: PlateRecipe) -> FloatArray:
    """(C·P, C·P) covariance of errors of a pose that all classes share: lamp, flat field, stage angle."""
    rig, poses = recipe.uncertainty, len(expected.poses)
    drift = recipe.limits.drift if measured_drift is None else abs(measured_drift)
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
    square = np.einsum("kn,nm,km->k", gradient, one.covariance(), gradient)
    return np.asarray(np.sqrt(np.maximum(square, 0.0)))  # rounding of what two classes share


def predicted_code(
    expected: ExpectedPlate, symbology: Symbology
) -> tuple[tuple[str | None, ...], tuple[tuple[Grade, ...], ...]]:
    """Reading of the predicted fields in every pose, and their grades; no grades without a symbol."""
    fields, cosines = predicted_fields(expected), _light_cosines(expected)
    readings = tuple(read_fields(one, symbology) for one in fields)
    symbol = _symbol(expected, symbology)
    if symbol is None:
        return readings, ((),) * len(readings)
    cells = [
        Cells(one, cosine, reading is not None, 0.0, 0.0)
        for one, cosine, reading in zip(fields, cosines, readings, strict=True)
    ]
    return readings, tuple(graded(one, symbol) for one in cells)


def _light_cosines(expected: ExpectedPlate) -> list[float]:
    return [float(one) for one in directions(expected.poses, expected.convention)[0][:, 2]]


def _symbol(expected: ExpectedPlate, symbology: Symbology) -> Symbol | None:
    """The symbol, where the plan is one of two classes without flat fields."""
    classes = expected.plan.classes()
    return find_symbol(classes, symbology) if set(np.unique(classes)) == {0, 1} else None


def _code(expected: ExpectedPlate, measured: MeasuredPlate, recipe: PlateRecipe) -> CodeRecord | None:
    """Readings and grades of the code, where the plan is one of two classes."""
    part = recipe.code
    if part is None:
        return None
    due = tuple(pose.tilt_deg == 0.0 and pose.stage_deg in part.read_at_deg for pose in expected.poses)
    readings, predicted = predicted_code(expected, part.symbology)
    symbol, grades = _symbol(expected, part.symbology), list[GradeRecord]()
    for number, (pose, cosine) in enumerate(zip(expected.poses, _light_cosines(expected), strict=True)):
        if symbol is None or not due[number]:
            continue
        places = measured.places[number] if measured.places else None
        seen = Cells(
            measured.radiance[number],
            cosine,
            measured.texts[number] is not None,
            None if places is None else places.axial,
            None if places is None else places.grid,
        )
        other = {one.parameter: one for one in predicted[number]}
        grades += [
            GradeRecord(
                stage_deg=pose.stage_deg,
                tilt_deg=pose.tilt_deg,
                parameter=one.parameter,
                measured=one.value,
                measured_grade=one.grade,
                predicted=other[one.parameter].value,
                predicted_grade=other[one.parameter].grade,
            )
            for one in graded(seen, symbol)
        ]
    return CodeRecord(
        text=part.text,
        symbology=part.symbology,
        readings=measured.texts,
        required=due,
        grades=tuple(grades),
        predicted_readings=readings,
    )


def _verdict(details: PlateDetails, recipe: PlateRecipe, p_value: float) -> tuple[Verdict, tuple[str, ...]]:
    """Verdict and reasons."""
    fails, unsure, warnings = _of_fields(details, recipe)
    contrasts = sorted(details.contrasts, key=lambda one: -abs(one.measured - one.predicted))
    fails += [contrast_text(one) for one in contrasts if one.verdict == "FAIL"]
    unsure += [contrast_text(one) for one in contrasts if one.verdict == "INCONCLUSIVE"]
    code = details.code
    if code is not None and code.unread:
        seen = ", ".join(
            "nothing" if code.readings[n] is None else repr(code.readings[n]) for n in code.unread
        )
        fails.append(f"the code does not read {code.text!r} in every required pose: {seen}")
    together = _together(details, recipe, p_value)
    if together is not None:
        must = recipe.decision.tolerance is None or recipe.decision.deviation == "fail"
        (fails if must else warnings).append(together if must else f"warning: {together}")
    if fails:
        return Verdict.FAIL, (*fails, *unsure, *warnings)
    if unsure:
        return Verdict.INCONCLUSIVE, (*unsure, *warnings)
    return Verdict.PASS, tuple(warnings)


def _of_fields(details: PlateDetails, recipe: PlateRecipe) -> tuple[list[str], list[str], list[str]]:
    """Reasons by single fields: to fail, not to decide, and to warn."""
    dead, near, others = (
        [one for one in details.fields if one.verdict == verdict]
        for verdict in (Verdict.FAIL, Verdict.INCONCLUSIVE, Verdict.PASS)
    )
    fails, unsure = [], []
    if len(dead) > recipe.fields.most:
        fails.append(fields_text(dead))
    elif len(dead) + len(near) > recipe.fields.most:
        unsure.append(f"within the guard band: {fields_text([*dead, *near])}")
    beyond = f"warning: within the tolerance, but beyond the scatter: {fields_text(others)}" if others else ""
    return fails, unsure, [beyond] if beyond else []


def _together(details: PlateDetails, recipe: PlateRecipe, p_value: float) -> str | None:
    """Significant deviation of all classes together, or None."""
    if p_value >= recipe.decision.alpha / TESTS:
        return None
    text = p_value_text(p_value)
    if details.golden is None:
        return f"the classes deviate together (p {text} for a plate as predicted)"
    return f"the classes deviate together (p {text} for a plate like the golden ones)"


def contrast_text(one: PlateContrastRecord) -> str:
    """A contrast with its tolerance."""
    name = one.title
    return (
        f"{name}: measured {one.measured:+.3f}, predicted {one.predicted:+.3f} (u {one.u:.3f}, tolerance "
        f"±{one.tolerance:g})"
    )
