"""Files of JSON that are too large or nested too deeply are one line."""

import json

import pytest

from anisoscope.base import json_file
from anisoscope.base.errors import CalibrationError, RecordError
from anisoscope.base.regular_file import MOST_BYTES
from anisoscope.calibration.record import read_calibration
from anisoscope.inspection.batch.journal import read_batch
from anisoscope.inspection.manifest import read_job_file
from anisoscope.record.schema import read_record, recorded_files
from anisoscope.rig.acquisition.journal import read_journal


def nested(levels):
    return "[" * levels + "]" * levels


@pytest.mark.parametrize(("levels", "fits"), [(64, True), (65, False), (900, False), (500_000, False)])
def test_depth(levels, fits):
    if fits:
        assert json_file.parsed_json(nested(levels)) == json.loads(nested(levels))
    else:
        with pytest.raises(ValueError, match="more than 64 deep"):
            json_file.parsed_json(nested(levels))


READERS = {
    "record.json": read_record,
    "record.json of files": recorded_files,
    "job.json": read_job_file,
    "batch.json": read_batch,
    "frames.jsonl": read_journal,
    "flat.calibration.json": lambda folder: read_calibration(folder / "flat.calibration.json", "flat"),
}


@pytest.mark.parametrize("name", READERS)
@pytest.mark.parametrize("what", ["deep", "large"])
def test_a_file_that_is_not_ours_is_one_line(tmp_path, name, what):
    path = tmp_path / name.split()[0]
    if what == "deep":
        path.write_text('{"recipe": ' + nested(100_000) + "}\n")
    else:
        with path.open("wb") as stream:
            stream.truncate(MOST_BYTES + 1)
    with pytest.raises((RecordError, CalibrationError)) as caught:
        READERS[name](tmp_path)
    assert "\n" not in str(caught.value)
    assert str(path.parent) in str(caught.value)
    assert path.name in str(caught.value)
    if what == "large":
        assert "more than 64 MiB" in str(caught.value)
