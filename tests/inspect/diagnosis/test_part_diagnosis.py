"""What a record tells of the causes where golden parts decide: parts of a world that the prediction does not know."""

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from anisoscope.decision.decision import decide
from anisoscope.decision.reference_parts import GoldenPart, GoldenSet
from anisoscope.diagnosis.cause_model import PLASTIC_CAUSES
from anisoscope.diagnosis.part_diagnosis import evidence_of, explain
from anisoscope.diagnosis.signatures import signatures
from anisoscope.imaging.pose_radiance import Measured
from anisoscope.imaging.registration.placement import Grid
from anisoscope.prediction.expectation import Component, expectation
from detection_study.product import (
    BY_NAME,
    GOOD,
    LIGHT_DEG,
    WHOLE,
    Size,
    draw,
    draw_rig,
    recipe_of,
)
from detection_study.surrogate import SurrogateTask, direct_of, state_of

GOLDEN, PARTS = 25, 5
CAUSES = ("incomplete-filling", "wear", "ridge-angle", "seating-y", "colour")
CLASSES = ("height-loss", "wear")


@pytest.fixture(scope="module")
def recipe():
    found = recipe_of("tilted", Size())
    known = {"u_tail": 0.0, "u_alpha_share": 0.05, "u_albedo": 0.03 * WHOLE.albedo}
    return found.model_copy(
        update={
            "area": None,
            "material": found.material.model_copy(update=known),
            "surface": found.surface.model_copy(update={"reflections": "direct"}),
        }
    )


@pytest.fixture(scope="module")
def expected(recipe):
    return expectation(recipe, LIGHT_DEG)


@pytest.fixture
def few(of_the_recipe):
    """The causes of the plastic, of which these few are looked for."""
    return replace(PLASTIC_CAUSES, signatures=lambda *_: of_the_recipe)


@pytest.fixture(scope="module")
def of_the_recipe(recipe):
    return signatures(recipe, LIGHT_DEG, names=CAUSES)


def shown(kind, count, seed, poses):
    """(count, P) ln L of direct light of parts with GGX lobes, each on a rig of its own, by a camera without noise."""
    rng = np.random.default_rng(seed)
    found = []
    for _ in range(count):
        rig, (specimen, extent) = draw_rig(rng), draw(BY_NAME.get(kind), rng)
        state = state_of(specimen, rig, extent, kind or "")[0]
        radiance = direct_of(SurrogateTask("other", kind or GOOD, extent), state)[:poses].mean(axis=1)
        found.append(np.log((radiance + rig.stray) * specimen.gain[:poses]))
    return np.array(found)


def golden_set(recipe, expected, count):
    """So many golden parts."""
    poses = tuple((pose.stage_deg, pose.tilt_deg) for pose in expected.poses)
    parts = tuple(
        GoldenPart(
            serial=f"G{number}",
            inspected_at="2026-01-01T00:00:00+00:00",
            log_radiance=tuple(row),
            area_share=None,
            verdict="PASS",
        )
        for number, row in enumerate(shown(None, count, 1, len(poses)))
    )
    return GoldenSet(product=recipe.product, recipe_key=GoldenSet.key_of(recipe), poses=poses, parts=parts)


@pytest.fixture(scope="module")
def golden(recipe, expected):
    return golden_set(recipe, expected, GOLDEN)


def measured(log_radiance, recipe, expected):
    """What the rig's own uncertainties say of such a part."""
    rig = recipe.uncertainty
    alone = np.full(len(log_radiance), np.hypot(rig.flat_share, rig.linearity_share))
    components = (
        Component("flat field", "measurement", alone, shared=False),
        Component("stray light", "measurement", rig.stray_radiance / expected.radiance, shared=True),
        Component("stage angle", "measurement", rig.stage_deg * expected.per_degree, shared=False),
    )
    radiance = np.exp(log_radiance)
    cells = np.repeat(radiance[:, None, None], 16, axis=1)
    grid = Grid((0.0, 0.0), 0.025, (4, 4))
    return Measured(radiance, components, (), cells, np.full(len(radiance), 0.001), grid, 0.0)


@pytest.mark.statistics  # how many of five parts of each class; inspections with golden parts are in every run
@pytest.mark.parametrize("kind", CLASSES)
def test_golden_parts_of_another_world_name_what_the_prediction_cannot(recipe, expected, golden, few, kind):
    said = Counter()
    for row in shown(kind, PARTS, 2, len(expected.poses)):
        seen = measured(row, recipe, expected)
        alone, note = explain(recipe, expected, seen, decide(expected, seen, recipe), causes=few)
        assert note is None
        assert alone.says.startswith("none of the causes explains the part")
        told, note = explain(
            recipe, expected, seen, decide(expected, seen, recipe, golden), golden=golden, causes=few
        )
        assert note is None
        if (
            told.unexplained_p is None
        ):  # a part like the golden ones, at this level: nothing is to be explained
            continue
        said["diagnosed"] += 1
        said["explained"] += told.unexplained_p > recipe.decision.alpha
        ties = {cause.cause for cause in told.causes if cause.tie}
        said["tied"] += BY_NAME[kind].cause in ties
        said["first"] += told.causes[0].cause == BY_NAME[kind].cause
    assert said["diagnosed"] >= PARTS - 1  # of a weak defect one part may pass
    assert said["explained"] >= said["diagnosed"] - 1
    assert said["tied"] >= said["diagnosed"] - 1
    # of two readings that tie the wrong one may be first: a worn crest changes these poses as a cut one does
    assert said["first"] + (kind == "height-loss") > said["diagnosed"] / 2


def test_the_reference_is_the_mean_of_the_golden_parts(recipe, expected):
    golden = golden_set(recipe, expected, 10)
    row = shown("wear", 1, 3, len(expected.poses))[0]
    seen = measured(row, recipe, expected)
    decision = decide(expected, seen, recipe, golden)
    shift = np.mean([part.log_radiance for part in golden.parts], axis=0)
    found = evidence_of(recipe, expected, seen, decision, golden)
    np.testing.assert_allclose(found.deviation, row - shift)
    alone = evidence_of(recipe, expected, seen, decision)
    np.testing.assert_allclose(alone.deviation, row - np.log(expected.radiance))
    assert alone.learnt is None
    assert found.learnt.misfit.min() > 0.1  # the model is far off good parts, and so are its changes
