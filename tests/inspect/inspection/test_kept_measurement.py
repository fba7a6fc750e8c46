"""From what an inspection kept the verdict is decided as from its frames."""

import re

import numpy as np
import pytest

from anisoscope.base.errors import RecordError
from anisoscope.inspection.kept_measurement import CHANGE, KEPT_NAME, read_kept
from anisoscope.inspection.manifest import reopen
from anisoscope.inspection.recompute import differences
from anisoscope.record.schema import read_record


@pytest.fixture
def kept_part(inspected_part):
    folder = inspected_part[1].folder
    record = read_record(folder)
    return folder, record, reopen(folder)[1]


def test_it_decides_as_the_frames_did(kept_part):
    folder, record, job = kept_part
    kept = read_kept(folder, record)
    assert kept[CHANGE] == 0.0
    expected = job.kind.predict(job.recipe, job.rig, cached=True)
    measured, decided = job.kind.decide_again(kept, job.recipe, expected, None)
    assert decided.verdict.value == record.verdict
    np.testing.assert_allclose(measured.radiance, [pose.measured for pose in record.poses], rtol=1e-12)
    assert measured.drift == record.drift
    again = job.kind.results(None, job.recipe, expected, measured, decided, None)
    now = again.details.model_dump(mode="json")
    then = record.details.model_dump(mode="json")
    for name in ("contrasts", "area", "regions", "between_tilts"):
        assert list(differences(then[name], now[name])) == []
    assert again.d2 == pytest.approx(record.d2, rel=1e-9)


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({"decision": {"tolerance": 0.1}}, None),
        ({"limits": {"drift": 0.1}}, None),
        ({"material": {"albedo": 0.3}}, None),
        ({"region": {"size_mm": (0.8, 0.8)}}, r"region is .*0.8.*, the inspection was by .*1.0"),
        (
            {"limits": {"registration_px": 0.1}},
            r"limits\.registration_px is 0\.1, the inspection was by 0\.5",
        ),
        ({"surface": {"pitch_um": 50.0}}, r"surface\.pitch_um"),
    ],
)
def test_what_was_changed_says_whether_frames_are_needed(kept_part, change, why):
    _, record, job = kept_part
    table = {
        key: getattr(job.recipe, key).model_copy(update=values) if values else None
        for key, values in change.items()
    }
    found = job.kind.needs_frames(record.recipe, job.recipe.model_copy(update=table))
    assert (found is None) == (why is None)
    if why is not None:
        assert re.search(why, found)


def test_a_changed_file_is_refused(kept_part):
    folder, record, _ = kept_part
    path = folder / KEPT_NAME
    path.write_bytes(path.read_bytes()[:-1] + b"!")
    with pytest.raises(RecordError, match=r"measured\.npz: was changed since the inspection"):
        read_kept(folder, record)
    assert read_kept(folder, record.model_copy(update={"files": ()})) is None
