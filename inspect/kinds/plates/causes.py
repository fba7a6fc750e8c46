"""Causes of deviating plates: defects of single fields, counted by their kind, and causes that change the whole plate.

The whole plate is explained as ridges are (`anisoscope.diagnosis.ranking`): ln L of all classes in all poses, and the
turn of the fields against the fixture, are data, and every cause has a signature for them, from the light of the
ideal ridges of every class. A field with a defect is called by the defect whose change is nearest.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.cause_words import SEAT_AGAIN, CauseWords
from anisoscope.base.errors import HeightMapError
from anisoscope.diagnosis.cause_words import plastic_words
from anisoscope.diagnosis.causes import Cause, all_causes
from anisoscope.diagnosis.evidence import Evidence, Inputs
from anisoscope.diagnosis.part_diagnosis import diagnosis_record
from anisoscope.diagnosis.ranking import NOTHING, diagnose
from anisoscope.diagnosis.signatures import Signature, Signatures
from anisoscope.kinds.plates.decision import PlateDecision
from anisoscope.kinds.plates.expectation import ExpectedPlate, quick_light
from anisoscope.kinds.plates.field_judgement import TESTS
from anisoscope.kinds.plates.measurement import MeasuredPlate
from anisoscope.kinds.plates.recipe import PlateRecipe
from anisoscope.kinds.plates.record import FieldRecord
from anisoscope.parameters.material import Material
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.prediction.expectation import part_uncertainty
from anisoscope.prediction.propagation import RIDGE_ANGLE, SEATING
from anisoscope.prediction.second_order import Response
from anisoscope.record.schema import CauseRecord, ComponentRecord, DiagnosisRecord

U_TURN_DEG = 0.1
"""Standard uncertainty of the turn of the fields against the fixture."""
UNKNOWN_TURN_DEG = 10.0
TURNED = "turned"
SHARES = (-0.5, -0.3, -0.2, -0.1, -0.05, 0.0, 0.05, 0.1, 0.2, 0.3, 0.5, 0.8)
DEGREES = (-3.0, -2.0, -1.0, -0.5, -0.2, 0.0, 0.2, 0.5, 1.0, 2.0, 3.0)
OF_PITCH = (0.0, 0.02, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.4, 0.5, 0.65, 0.8, 1.0)
OF_HEIGHT = (0.0, 0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7)
DOUBT_OF_MODEL = 0.05
"""Least relative uncertainty of a change by ideal ridges."""

UNCLEAR = "fields-unclear"
_TOOL = "Reject the plate, and have the insert checked"
FIELD_WORDS: Mapping[str, CauseWords] = {
    "fields-missing": CauseWords(
        "Fields without ridges: {size}",
        f"{_TOOL} for fields that are clogged or were not machined",
        percent=False,
    ),
    "fields-merged": CauseWords(
        "Fields that run into each other: {size}", f"{_TOOL} for damaged borders", percent=False
    ),
    "fields-wrong-direction": CauseWords(
        "Fields with ridges of another direction: {size}",
        f"{_TOOL} against the plan; check that the recipe has the plan of this plate",
        percent=False,
    ),
    "fields-worn": CauseWords(
        "Fields with worn crests: {size}", f"{_TOOL} for wear at the fields in the list", percent=False
    ),
    "fields-filled": CauseWords(
        "Fields that are not filled: {size}",
        "Reject the plate; raise melt or mould temperature or packing pressure, and clean the vents",
        percent=False,
    ),
    UNCLEAR: CauseWords(
        "Fields with a defect that these poses do not tell from another: {size}",
        f"{_TOOL} at the fields in the list; a pose at 180° in the recipe tells more defects apart",
        percent=False,
    ),
    "fields-unlike": CauseWords(
        "Fields that are unlike any known defect: {size}",
        "Clean the plate and inspect it again; if it fails again, set it aside for a reviewer",
        percent=False,
    ),
}


def plate_words() -> Mapping[str, CauseWords]:
    """Causes of plates in plain words."""
    turned = CauseWords("The plate lies turned by about {size} in its seat", SEAT_AGAIN)
    return {**plastic_words(), **FIELD_WORDS, TURNED: turned}


def explain_plate(
    recipe: PlateRecipe, expected: ExpectedPlate, measured: MeasuredPlate, decided: PlateDecision
) -> DiagnosisRecord:
    """Diagnosis of a plate: defects of its fields, and the cause of a deviation of all classes.

    Args:
        recipe: its recipe.
        expected: the prediction.
        measured: the fields and their places.
        decided: the verdict.
    """
    fields = field_causes(decided.details.fields)
    of_classes = [one.verdict for one in decided.details.contrasts]
    failed = any(one.verdict == "FAIL" for one in decided.details.fields)
    off = "FAIL" in of_classes or ("INCONCLUSIVE" in of_classes and not failed)
    whole = None
    if off or decided.p_value < recipe.decision.alpha / TESTS:
        whole = _of_plate(recipe, expected, measured, decided)
    if whole is None or not whole.causes or whole.causes[0].cause == NOTHING:
        if not fields:
            return whole or DiagnosisRecord(says="nothing: the plate is as it should be")
        return DiagnosisRecord(says=_listed(fields), causes=_ranked(fields))
    if not fields:
        return whole
    best, *others = whole.causes
    other = best.components[0] if best.components else _component(best)
    return DiagnosisRecord(
        says=f"{_listed(fields)}; {whole.says}",
        causes=(_together(fields[0], other, best.weight), *others),
        unexplained_p=whole.unexplained_p,
        tells=whole.tells,
    )


def field_causes(fields: tuple[FieldRecord, ...]) -> tuple[ComponentRecord, ...]:
    """Kinds of defects of the fields that fail, or else of those that deviate, the most frequent first."""
    failed = [one for one in fields if one.verdict == "FAIL"] or [one for one in fields if one.significant]
    names = [
        UNCLEAR if one.or_like else f"fields-{(one.looks_like or 'unlike').replace(' ', '-')}"
        for one in failed
    ]
    counted = sorted(dict.fromkeys(names), key=lambda name: -names.count(name))
    return tuple(
        ComponentRecord(
            cause=name,
            title=FIELD_TITLES[name],
            unit="",
            severity=float(names.count(name)),
            u=0.0,
            interval=(float(names.count(name)),) * 2,
        )
        for name in counted
    )


FIELD_TITLES = {
    "fields-missing": "fields without ridges",
    "fields-merged": "fields that run into each other",
    "fields-wrong-direction": "fields with ridges of another direction",
    "fields-worn": "fields with worn crests",
    "fields-filled": "fields that are not filled",
    UNCLEAR: "fields with a defect that these poses do not tell from another",
    "fields-unlike": "fields that are unlike any known defect",
}


def _listed(fields: tuple[ComponentRecord, ...]) -> str:
    return ", ".join(f"{one.title}: {one.severity:.0f}" for one in fields)


def _ranked(fields: tuple[ComponentRecord, ...]) -> tuple[CauseRecord, ...]:
    """Causes for the record; each explains its own fields, so that none excludes another."""
    total = sum(one.severity for one in fields)
    found = tuple(
        CauseRecord(
            **one.model_dump(),
            weight=one.severity / total,
            chi2=0.0,
            at_bound=False,
            tie=number == 0,
        )
        for number, one in enumerate(fields)
    )
    return found if len(found) == 1 else (_together(fields[0], fields[1], 1.0), *found[2:])


def _together(one: ComponentRecord, other: ComponentRecord, weight: float) -> CauseRecord:
    """Two causes that both act."""
    return CauseRecord(
        cause=f"{one.cause}+{other.cause}",
        title=f"{one.title} and {other.title}",
        unit="",
        severity=0.0,
        u=None,
        weight=weight,
        chi2=0.0,
        at_bound=False,
        tie=True,
        components=(one, other),
    )


def _component(one: CauseRecord) -> ComponentRecord:
    return ComponentRecord(
        cause=one.cause, title=one.title, unit=one.unit, severity=one.severity, u=one.u, interval=one.interval
    )


def _of_plate(
    recipe: PlateRecipe, expected: ExpectedPlate, measured: MeasuredPlate, decided: PlateDecision
) -> DiagnosisRecord:
    """Ranked causes of what the classes show."""
    turns = [one.turn_deg for one in measured.places if one is not None]
    deviation = np.append(decided.class_deviation, float(np.median(turns)) if turns else 0.0)
    covariance = _with_turn(decided.covariance + recipe.uncertainty.scale_share**2)
    covariance[-1, -1] = U_TURN_DEG**2 if turns else UNKNOWN_TURN_DEG**2
    evidence = Evidence(deviation, covariance, inputs=_inputs(recipe, decided, covariance))
    found = diagnose(plate_signatures(recipe, expected), evidence, together=False)
    return diagnosis_record(found, recipe.decision.alpha, "plate")


def _with_turn(covariance: FloatArray) -> FloatArray:
    return np.pad(covariance, (0, 1))


def _inputs(recipe: PlateRecipe, decided: PlateDecision, covariance: FloatArray) -> Inputs:
    """The uncertain inputs that are causes themselves, with the bounds that the recipe sets them; linear."""
    stated, albedo = part_uncertainty(recipe.of_class(0.0)), recipe.material.albedo
    u = {
        "roughness along the ridges": stated.alpha_share,
        "roughness across the ridges": stated.alpha_share,
        "albedo of the plastic": stated.albedo / albedo if albedo > 0.0 else 0.0,
        RIDGE_ANGLE: stated.ridge_angle_deg,
        "light angle": stated.light_angle_deg,
        **dict.fromkeys(SEATING, stated.seating_tilt_deg),
    }
    known = [one for one in decided.components if one.shared and u.get(one.source)]
    slope = np.array([np.append(one.relative, 0.0) for one in known]).reshape(len(known), -1).T
    rest = covariance - slope @ slope.T
    sources, size = tuple(one.source for one in known), len(known)
    response = Response(sources, slope, np.zeros((len(covariance), size, size)))
    units = np.array([u[source] for source in sources])
    return Inputs(response, {source: u[source] for source in sources}, rest, units)


def plate_signatures(recipe: PlateRecipe, expected: ExpectedPlate) -> Signatures:
    """Change of ln L of all classes in all poses, and of the turn, along every cause."""
    design, material = recipe.surface.ridge_design(), recipe.material.material()
    quick = quick_light(recipe, expected.poses, expected.convention)
    azimuths = [expected.plan.azimuths_deg[letter] for letter in expected.plan.letters]
    light, pitch = expected.convention.light_angle_deg, design.pitch_um
    known = {one.name: one for one in all_causes(design.ridge_angle_deg, pitch)}

    designs = [expected.plan.design_of(letter, design) for letter in expected.plan.letters]

    def seen(
        ridges: list[RidgeDesign] = designs,
        plastic: Material = material,
        turn: float = 0.0,
        lamp: float = light,
    ) -> FloatArray:
        classes = zip(ridges, azimuths, strict=True)
        return np.append(
            np.concatenate([quick(each, one + turn, plastic, lamp) for each, one in classes]), turn
        )

    def scaled(name: str) -> Callable[[float], FloatArray]:
        value = getattr(material, name)
        return lambda e: seen(plastic=replace(material, **{name: value * (1.0 + e)}))

    good, found, left_out = seen(), [], []
    ways: list[tuple[Cause, tuple[float, ...], Callable[[float], FloatArray]]] = [
        (
            known["ridge-angle"],
            DEGREES,
            lambda e: seen([replace(one, ridge_angle_deg=one.ridge_angle_deg + e) for one in designs]),
        ),
        (
            known["wear"],
            tuple(one * pitch for one in OF_PITCH),
            lambda e: seen([replace(one, edge_radius_um=max(e, one.edge_radius_um)) for one in designs]),
        ),
        (
            known["incomplete-filling"],
            OF_HEIGHT,
            lambda e: seen([replace(one, height_loss=e, edge_radius_um=0.0) for one in designs]),
        ),
        (known["roughness-along"], SHARES, scaled("alpha_along")),
        (known["roughness-across"], SHARES, scaled("alpha_across")),
        (known["colour"], SHARES, scaled("albedo")),
        (known["light-angle"], DEGREES, lambda e: seen(lamp=light + e)),
        (_turned(), DEGREES, lambda e: seen(turn=e)),
        *_seating(recipe, expected, known, good),
    ]
    for cause, extents, way in ways:
        changes, possible = [], []
        for extent in extents:
            try:
                changes.append(way(extent) - good)
            except HeightMapError:  # no facet is left
                continue
            possible.append(extent)
        if len(possible) < 2:
            left_out.append((cause.name, "no facet is left"))
            continue
        cause = replace(cause, doubt=max(cause.doubt, DOUBT_OF_MODEL), extents=tuple(possible))  # noqa: PLW2901
        found.append(Signature(cause, np.array(possible), np.array(changes), np.zeros(len(possible))))
    radiance = np.append(np.exp(good[:-1]), 1.0)
    return Signatures(expected.poses, radiance, 0.0, tuple(found), tuple(left_out))


def _turned() -> Cause:
    """The plate turned in its seat."""
    seating = next(one for one in all_causes() if one.name == "seating-x")
    return replace(seating, name=TURNED, title="the plate lies turned by", sources=())


def _seating(
    recipe: PlateRecipe, expected: ExpectedPlate, known: Mapping[str, Cause], good: FloatArray
) -> list[tuple[Cause, tuple[float, ...], Callable[[float], FloatArray]]]:
    """The plate tilted about its axes, to first order."""
    u = part_uncertainty(recipe.of_class(0.0)).seating_tilt_deg
    found: list[tuple[Cause, tuple[float, ...], Callable[[float], FloatArray]]] = []
    for name, source in zip(("seating-x", "seating-y"), SEATING, strict=True):
        per_u = next((one.relative for one in expected.components if one.source == source), None)
        if per_u is None or u == 0.0:
            continue

        found.append((known[name], DEGREES, partial(_tilted, good, per_u / u)))
    return found


def _tilted(good: FloatArray, slope: FloatArray, extent: float) -> FloatArray:
    return np.asarray(good + np.append(extent * slope, 0.0))
