"""Parts rendered by Mitsuba 3 (tools/render_mitsuba_parts.py), judged as `inspect --frames` judges them.

The renderer shares nothing with the prediction. Scatter between pixels is that of its paths, 10 to 30 % in dim poses,
so that cells of the contrast map count as deviating from a ln ratio of 0.8 on; the means are good to 0.3 %.
"""

from collections import Counter
from dataclasses import replace

import pytest

from anisoscope.diagnosis.cell_levels import SMEAR_PX
from anisoscope.diagnosis.part_diagnosis import evidence_of
from anisoscope.diagnosis.ranking import diagnose
from anisoscope.diagnosis.signature_cache import cached_signatures
from anisoscope.imaging.deviation_map import CellScatter
from anisoscope.imaging.ridge_waves import measured_pitch
from anisoscope.kinds.kind import Explanation
from anisoscope.kinds.parts import usable
from anisoscope.record.surface_details import surface_of
from detection_study.mitsuba import ARCHIVE, CAUSES, GOOD, TILTED, UPRIGHT, Inspector, Parts

WHOLE = tuple(name for name in CAUSES if name.split("-")[0] not in {"burrs", "scratches"})
"""Parts with a defect of their whole surface; marks are for the area to find."""
GROSS = ("angle-1", "angle+1", "rough+20", "rough+60", "height-loss", "burrs-10")


@pytest.fixture(scope="module")
def parts(tmp_path_factory, request):
    return Parts.unpacked(request.config.rootpath / ARCHIVE, tmp_path_factory.mktemp("mitsuba"))


def verdicts(inspector, names):
    return {name: inspector.record(name).verdict for name in names}


def passed(found):
    return sum(verdict == "PASS" for verdict in found.values())


def test_three_golden_parts_tell_rendered_good_parts_from_bad_ones(parts, tmp_path, undiagnosed):
    inspector = Inspector(parts, tmp_path, UPRIGHT, methods=undiagnosed).learn()
    expected = {"good-01": "PASS", "good-02": "PASS", "angle-1": "FAIL", "height-loss": "FAIL"}
    assert verdicts(inspector, expected) == expected


@pytest.mark.soak
@pytest.mark.parametrize(
    ("tilts", "good", "missed"), [(UPRIGHT, 12, 6), (TILTED, 12, 1)], ids=["upright", "tilted"]
)
def test_verdicts_with_three_golden_parts(parts, tmp_path, undiagnosed, tilts, good, missed):
    """At least so many good parts of twelve pass, and at most so many defective ones of twelve."""
    inspector = Inspector(parts, tmp_path, tilts, methods=undiagnosed).learn()
    assert passed(verdicts(inspector, GOOD)) >= good
    found = verdicts(inspector, CAUSES)
    assert passed(found) <= missed, found
    assert {found[name] for name in GROSS} == {"FAIL"}


@pytest.mark.soak
@pytest.mark.parametrize(("tilts", "missed"), [(UPRIGHT, 6), (TILTED, 4)], ids=["upright", "tilted"])
def test_verdicts_against_the_design(parts, tmp_path, undiagnosed, tilts, missed):
    """Without golden parts every good part passes, and gross defects fail; wear of 5 µm may be an unmeasured edge."""
    inspector = Inspector(parts, tmp_path, tilts, methods=undiagnosed)
    assert passed(verdicts(inspector, GOOD)) == len(GOOD)
    found = verdicts(inspector, CAUSES)
    assert passed(found) <= missed, found
    assert {found[name] for name in GROSS} == {"FAIL"}


@pytest.mark.soak
@pytest.mark.parametrize("golden", [False, True], ids=["design", "golden"])
@pytest.mark.parametrize(("tilts", "good"), [(UPRIGHT, (0, 2)), (TILTED, (4, 11))], ids=["upright", "tilted"])
def test_no_defective_part_excludes_every_defect(parts, tmp_path, undiagnosed, tilts, good, golden):
    """Against the design and three golden parts; at least so many of twelve good parts exclude every defect."""
    inspector = Inspector(parts, tmp_path, tilts, methods=undiagnosed)
    if golden:
        inspector.learn()

    def excludes(name):
        record = inspector.record(name)
        found = surface_of(record).exclusions
        return record.verdict == "PASS" and bool(found) and all(one.excluded for one in found)

    assert [name for name in WHOLE if excludes(name)] == []
    assert sum(map(excludes, GOOD)) >= good[golden]


@pytest.mark.soak
@pytest.mark.parametrize("tilts", [UPRIGHT, TILTED], ids=["upright", "tilted"])
def test_good_parts_against_their_own_maps(parts, tmp_path, undiagnosed, tilts):
    found = verdicts(Inspector(parts, tmp_path, tilts, own_map=True, methods=undiagnosed), GOOD)
    assert set(found.values()) == {"PASS"}, found


@pytest.mark.soak
@pytest.mark.parametrize("golden", [False, True], ids=["design", "golden"])
@pytest.mark.parametrize(
    ("tilts", "first", "held"), [(UPRIGHT, 5, 11), (TILTED, 11, 11)], ids=["upright", "tilted"]
)
def test_causes_and_severities(parts, tmp_path, undiagnosed, tilts, golden, first, held):
    """Of twelve defective parts: right cause first, among the ties, and severity within its interval.

    Upright, three poses give two numbers: most causes tie. Parts that pass are diagnosed here too.
    """
    seen = []

    def diagnosed(case, _advance):
        reference = usable(case.reference) if case.decided.golden else None
        told = evidence_of(case.recipe, case.expected, case.measured, case.decided, reference)
        known = cached_signatures(case.recipe, case.expected.convention.light_angle_deg)
        area = case.decided.area
        smear = SMEAR_PX * case.measured.grid.pixel_mm * 1000.0 / case.recipe.surface.pitch_um
        known = known.by_scatter(CellScatter.of(area), smear, area.cells)
        seen.append(diagnose(known, replace(told, pitch=measured_pitch(case.measured, case.recipe))))
        return Explanation()

    inspector = Inspector(parts, tmp_path, tilts, methods=replace(undiagnosed, diagnose=diagnosed))
    if golden:
        inspector.learn()
    named, tied, within = 0, 0, 0
    for name, (cause, _) in CAUSES.items():
        inspector.record(name)
        found = seen[-1]
        right = next(one for one in found.causes if one.cause == cause)
        low, high = right.interval
        truth = parts.severity(name)
        named += found.causes[0] is right
        tied += right.tie
        within += (low is None or low <= truth) and (high is None or truth <= high)
    assert named >= first
    assert tied == len(CAUSES)
    assert within >= held


@pytest.mark.soak
@pytest.mark.parametrize(
    ("tilts", "good", "found"), [(UPRIGHT, 18, 5), (TILTED, 34, 9)], ids=["upright", "tilted"]
)
def test_lots_of_four_good_parts_and_a_bad_one(parts, tmp_path, undiagnosed, tilts, good, found):
    """No good part fails and no bad one passes; at least so many of 36 good ones pass, and of nine bad ones fail."""
    inspector = Inspector(parts, tmp_path, tilts, lots=True, methods=undiagnosed)
    verdicts = Counter()
    for number, bad in enumerate(WHOLE):
        others = [GOOD[(number + 5 * step) % len(GOOD)] for step in range(4)]
        for name, record in inspector.lot([*others, bad]).items():
            verdicts[name == bad, record.verdict] += 1
    assert verdicts[False, "FAIL"] == 0
    assert verdicts[True, "PASS"] == 0
    assert verdicts[False, "PASS"] >= good, verdicts
    assert verdicts[True, "FAIL"] >= found, verdicts
