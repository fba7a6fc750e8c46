"""Faults of the rig compete with defects: a part that lies turned is no FAIL; a defect stays one."""

from dataclasses import replace

import numpy as np
import pytest

from anisoscope.decision.decision import decide
from anisoscope.decision.reference_parts import GoldenPart, GoldenSet
from anisoscope.diagnosis.cause_model import PLASTIC_CAUSES
from anisoscope.diagnosis.part_diagnosis import explain, rig_reason
from anisoscope.diagnosis.rig_causes import other_seats
from anisoscope.diagnosis.signatures import signatures
from anisoscope.imaging.pose_radiance import Measured
from anisoscope.imaging.registration.placement import Grid
from anisoscope.kinds.kind import Explanation
from anisoscope.kinds.ridges.kind import RIDGES
from anisoscope.prediction.cache import cached_expectation
from anisoscope.prediction.expectation import Component, expectation
from anisoscope.record.schema import CauseRecord, DiagnosisRecord
from anisoscope.record.verdict import Verdict

LIGHT_DEG = 10.0
CAUSES = ("incomplete-filling", "wear", "ridge-angle", "seating-y", "colour", "roughness-along")


@pytest.fixture(scope="module")
def recipe():
    table = {
        "schema": 1,
        "product": "plate",
        "surface": {
            "pitch_um": 100.0,
            "design": {"ridge_angle_deg": 10.0, "edge_radius_um": 0.0},
            "reflections": "direct",
        },
        "material": {
            "alpha_along": 0.06,
            "alpha_across": 0.1,
            "albedo": 0.2,
            "u_tail": 0.0,
            "u_alpha_share": 0.03,
        },
        "acquisition": {"exposure_s": 0.01},
        "region": {"size_mm": [1.0, 1.0]},
        "decision": {"alpha": 0.001},
        "uncertainty": {"seating_tilt_deg": 0.05},
    }
    return RIDGES.recipe.model_validate(table)


@pytest.fixture(scope="module")
def expected(recipe):
    return expectation(recipe, LIGHT_DEG)


@pytest.fixture(scope="module")
def few(recipe):
    """The causes of the plastic, of which these few are looked for."""
    found = signatures(recipe, LIGHT_DEG, names=CAUSES)
    return replace(PLASTIC_CAUSES, signatures=lambda *_: found)


def predict(recipe):
    return cached_expectation(recipe, LIGHT_DEG)


def seen(radiance):
    """A part of these radiances."""
    noise = Component("flat field", "measurement", np.full(len(radiance), 0.002), shared=False)
    cells = np.repeat(np.repeat(radiance[:, None, None], 40, axis=1), 40, axis=2)
    grid = Grid((0.0, 0.0), 0.025, (40, 40))
    return Measured(radiance, (noise,), (), cells, np.full(len(radiance), 0.001), grid, 0.0)


def told(recipe, expected, few, factors, *, golden=None, watched=False):
    """The diagnosis of a part whose radiances are those predicted, by factors."""
    part = seen(expected.radiance * factors)
    decided = decide(expected, part, recipe, golden)
    assert decided.verdict is Verdict.FAIL
    found, note = explain(
        recipe, expected, part, decided, golden=golden, causes=few, predict=predict, light_watched=watched
    )
    assert note is None
    return found


def turned(expected, *order):
    return expected.radiance[list(order)] / expected.radiance


def test_a_seat_turned_by_180_is_the_plan_with_its_ends_swapped(recipe, expected):
    seats = other_seats(recipe, expected, predict)
    np.testing.assert_allclose(seats["turned-180"].radiance, expected.radiance[[2, 1, 0]], rtol=0.01)
    np.testing.assert_allclose(seats["turned-90"].radiance[:2], expected.radiance[1:], rtol=1e-6)
    assert "mirrored" not in seats  # symmetrical ridges look alike then


@pytest.mark.parametrize("watched", [False, True])
def test_a_part_turned_in_its_seat_is_invalid_whatever_is_known_of_the_light(recipe, expected, few, watched):
    found = told(recipe, expected, few, turned(expected, 2, 1, 0), watched=watched)
    assert (found.rig_fault, found.verdict) == ("turned-180", Verdict.INVALID)
    assert found.says.startswith("the part lies turned by 180° in its seat")
    assert rig_reason(found).startswith(
        "the part lies turned by 180° in its seat: this explains the poses, and no"
    )


def test_against_golden_parts_a_turned_part_is_one_as_well(recipe, expected, few):
    rng = np.random.default_rng(3)
    poses = tuple((pose.stage_deg, pose.tilt_deg) for pose in expected.poses)
    off = np.array([0.03, -0.02, 0.01])
    parts = tuple(
        GoldenPart(
            serial=f"G{number}",
            inspected_at="2026-01-01T00:00:00+00:00",
            log_radiance=tuple(np.log(expected.radiance) + off + 0.01 * rng.standard_normal(3)),
            area_share=None,
            verdict="PASS",
        )
        for number in range(12)
    )
    golden = GoldenSet(product=recipe.product, recipe_key=GoldenSet.key_of(recipe), poses=poses, parts=parts)
    factors = turned(expected, 2, 1, 0) * np.exp(off)
    found = told(recipe, expected, few, factors, golden=golden)
    assert found.rig_fault == "turned-180"


@pytest.mark.parametrize(
    ("cause", "extent"), [("incomplete-filling", 0.3), ("ridge-angle", -2.0), ("ridge-angle", 2.0)]
)
def test_a_defect_that_is_no_fault_of_the_rig_stays_a_fail(recipe, expected, few, cause, extent):
    (change,) = (one.at(extent)[0] for one in few.signatures().found if one.cause.name == cause)
    found = told(recipe, expected, few, np.exp(change))
    assert (found.rig_fault, found.verdict) == (None, None)
    assert cause in {one.cause for one in found.causes if one.tie}


FAULTS = {
    "one pose": ("pose-scaled", np.array([1.0, 0.6, 1.0])),
    "light": ("light-added", None),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_of_the_light_leaves_a_doubt_unless_the_light_was_watched(recipe, expected, few, fault):
    name, factors = FAULTS[fault]
    if factors is None:
        factors = 1.0 + 0.8 * expected.radiance.min() / expected.radiance
    found = told(recipe, expected, few, factors)
    assert found.rig_fault == name
    assert found.verdict in {Verdict.INCONCLUSIVE, Verdict.INVALID}
    assert told(recipe, expected, few, factors, watched=True).rig_fault is None


def test_two_poses_scaled_are_no_fault_that_is_looked_for(recipe, expected, few):
    found = told(recipe, expected, few, np.array([1.0, 0.5, 1.8]))
    assert found.rig_fault is None


@pytest.mark.parametrize("verdict", [Verdict.INVALID, Verdict.INCONCLUSIVE])
def test_record_and_conclusion_name_the_fault_and_what_to_do(virtual_rig, undiagnosed, verdict):
    cause = CauseRecord(
        cause="turned-180",
        title="turned",
        unit="",
        severity=0.0,
        u=None,
        weight=0.9,
        chi2=1.0,
        at_bound=False,
        tie=True,
    )
    found = DiagnosisRecord(says="turned", causes=(cause,), rig_fault="turned-180", verdict=verdict)
    methods = replace(undiagnosed, diagnose=lambda *_: Explanation(found, reason="it lies turned"))
    bench = {"sample": {"ridge_angle_deg": 7.0}}
    record = (
        virtual_rig(bench=bench, recipe={"decision": {"remeasure": 1, "deviation": "fail"}})
        .inspect(methods=methods)
        .record
    )
    assert (record.verdict, record.rounds) == (verdict.value, 1)  # more pictures would not tell them apart
    assert record.reasons[0] == "it lies turned"
    assert record.conclusion.follows_from == "turned-180"
    assert "it lies turned" in record.conclusion.finding
    assert "check how the part lies in its seat" in record.conclusion.action


def test_inspections_of_before_are_recomputed_without_faults_of_the_rig(recipe):
    recorded = recipe.model_dump(mode="json")
    assert RIDGES.as_recorded(recipe, recorded).decision.rig_faults
    del recorded["decision"]["rig_faults"]
    assert not RIDGES.as_recorded(recipe, recorded).decision.rig_faults
