"""Plates rendered by Mitsuba 3 (tools/render_mitsuba_plates.py), judged as `inspect --frames` judges them.

The renderer shares nothing with the prediction, and light goes from field to field.
"""

import tarfile

import pytest

from anisoscope.inspection.replay import inspect_frames

FIELDS = {
    "good-1": {},
    "good-2": {},
    "dead": {(3, 4): {"missing"}, (6, 8): {"missing"}, (9, 2): {"missing", "filled"}},
    "one-worn": {(4, 5): {"worn"}},
    "turned-field": {(7, 3): {"wrong direction"}},
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory, request):
    found = tmp_path_factory.mktemp("mitsuba-plates")
    archive = request.config.rootpath / "tests" / "data" / "mitsuba" / "plates.tar.xz"
    with tarfile.open(archive) as packed:
        packed.extractall(found, filter="data")
    return found


@pytest.mark.parametrize("name", FIELDS)
def test_rendered_plates_get_their_verdicts(folder, name, undiagnosed):
    record = inspect_frames(
        folder / name,
        folder / "recipe.toml",
        name,
        folder / "out",
        rig_path=folder / "rig.toml",
        methods=undiagnosed,
    ).record
    details = record.details
    found = {(one.row, one.col): one for one in details.fields}
    assert set(found) == set(FIELDS[name])
    assert all(found[place].looks_like in words for place, words in FIELDS[name].items())
    assert details.code.unread == ()
    deviations = [abs(one.measured - one.predicted) / one.u for one in details.contrasts]
    assert max(deviations) < 2.5
    if name.startswith("good"):
        assert record.verdict == "PASS"
        grades = {one.parameter: one.measured_grade for one in details.code.grades}
        assert grades["overall grade"] == 4
    elif name == "one-worn":  # 13 % of brightness, within the tolerance of a field
        assert found[4, 5].significant
        assert record.verdict != "FAIL"
    else:
        assert record.verdict == "FAIL"
