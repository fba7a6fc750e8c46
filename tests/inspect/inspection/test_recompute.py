"""Finished inspections: their numbers again, and their files as they were."""

import hashlib
import json
import math
import shutil

import pytest

from anisoscope.base.errors import RecordError
from anisoscope.inspection.integrity import verify
from anisoscope.inspection.recompute import differences, recompute
from anisoscope.inspection.report_seal import write_report_sealed
from anisoscope.inspection.run import write_report_again
from anisoscope.record.schema import RECORD_NAME, UNSEALED, read_record, sha256_of, write_record


@pytest.fixture
def finished(inspected_part):
    """The folder of a finished inspection."""
    return inspected_part[1].folder


def test_a_folder_explains_itself_anywhere(finished, tmp_path):
    moved = tmp_path / "elsewhere"
    shutil.move(finished, moved)
    shutil.rmtree(tmp_path / "part")
    before = {path: path.stat().st_mtime_ns for path in moved.rglob("*")}
    found = recompute(moved)
    assert (found.verdict, found.differences) == ("PASS", ())
    assert verify(moved).intact
    assert before == {path: path.stat().st_mtime_ns for path in moved.rglob("*")}


def test_a_record_of_other_numbers_differs_and_they_are_named(finished):
    record = read_record(finished)
    contrasts = record.details.contrasts
    pair = contrasts[1].model_copy(update={"measured": contrasts[1].measured * (1.0 + 1e-7)})
    forged = record.model_copy(
        update={
            "details": record.details.model_copy(update={"contrasts": (contrasts[0], pair, *contrasts[2:])}),
            "verdict": "FAIL",
        }
    )
    write_record(forged, finished)  # with a new seal, as a forger would
    assert verify(finished).changed == ("report.sha256",)  # the report belongs to another record
    write_report_sealed(finished, (finished / "report.html").read_text(encoding="utf-8"))
    found = recompute(finished)
    assert [line.partition(":")[0] for line in found.differences] == [
        "details.contrasts[1].measured",
        "verdict",
    ]
    assert verify(finished).intact  # nobody but a recomputation notices


def test_recompute_refuses_frames_that_were_changed(finished):
    path = finished / "frames" / "004_sample_0090.00.tif"
    path.write_bytes(path.read_bytes()[:-1] + b"!")
    with pytest.raises(RecordError, match=r"004_sample_0090\.00\.tif: was changed"):
        recompute(finished)


def test_every_single_file_is_guarded(finished):
    files = sorted(path for path in finished.rglob("*") if path.is_file())
    assert verify(finished).files == len(files)
    for path in files:
        data = path.read_bytes()
        path.chmod(0o644)  # some are shared and read-only
        path.write_bytes(data[:-2] + bytes([data[-2] ^ 1]) + data[-1:])
        found = verify(finished)
        name = path.relative_to(finished).as_posix()
        assert name in found.changed, name
        path.write_bytes(data)
    assert verify(finished).intact


def test_missing_and_additional_files_are_named(finished):
    (finished / "frames" / "000_dark.tif").rename(finished / "frames" / "dark.tif")
    found = verify(finished)
    assert found.missing == ("frames/000_dark.tif",)
    assert found.additional == ("frames/dark.tif",)
    assert found.changed == ()
    assert not found.intact


def test_the_least_change_of_the_record_breaks_its_seal(finished):
    path = finished / "record.json"
    content = json.loads(path.read_text())
    content["verdict"] = "FAIL"
    path.write_text(json.dumps(content, indent=2))
    with pytest.raises(RecordError, match="it was changed after it had been written"):
        read_record(finished)
    assert verify(finished).changed == ("record.json",)


def test_folders_that_are_none(tmp_path):
    with pytest.raises(RecordError, match="there is no such folder"):
        verify(tmp_path / "none")
    with pytest.raises(RecordError, match="is no inspection folder"):
        verify(tmp_path)
    with pytest.raises(RecordError, match="was this inspection finished"):
        recompute(tmp_path)


@pytest.mark.parametrize(
    ("old", "new", "names"),
    [
        ({"a": 1.0}, {"a": 1.0 + 1e-10}, []),
        ({"a": 1e6}, {"a": 1e6 + 1e-4}, []),
        ({"a": 0.0}, {"a": 2e-9}, ["a"]),
        ({"d2": 100.0, "e2": 100.0}, {"d2": 100.1, "e2": 100.1}, ["e2"]),
        ({"d2": 100.0, "p_value": 0.01}, {"d2": 100.3, "p_value": 0.011}, ["d2", "p_value"]),
        ({"a": [1, {"b": 2}]}, {"a": [1, {"b": 3}]}, ["a[1].b"]),
        ({"a": [1]}, {"a": [1, 2]}, ["a"]),
        ({"a": None}, {"a": 0.0}, ["a"]),
        ({"a": True}, {"a": 1}, []),
        ({"a": "x"}, {}, ["a"]),
        ({"a": math.nan}, {"a": 1.0}, ["a"]),
    ],
)
def test_differences(old, new, names):
    assert [line.partition(":")[0] for line in differences(old, new)] == names


LATER_FIELDS = ("map_place", "between_tilts")


def as_written_before(folder):
    """The record without what came later, sealed anew, as an earlier version wrote it."""
    path = folder / RECORD_NAME
    content = json.loads(path.read_text(encoding="utf-8"))
    del content["calibrations"]
    for name in LATER_FIELDS:
        del content["details"][name]
    for pose in content["poses"]:
        del pose["dropped"]
    del content["details"]["area"]["learnt"]
    content["software"] = "anisoscope 0.0.1"
    content["files"].append({"name": "report.html", "sha256": sha256_of(folder / "report.html")})
    (folder / "report.sha256").unlink()
    text = json.dumps(content | {"seal": UNSEALED}, indent=2)
    path.write_text(text.replace(UNSEALED, hashlib.sha256(text.encode()).hexdigest()), encoding="utf-8")


def test_what_an_earlier_version_did_not_tell_is_no_difference(finished):
    as_written_before(finished)
    assert verify(finished).intact
    report = (finished / "report.html").read_bytes()
    (finished / "report.html").unlink()
    assert verify(finished).missing == ("report.html",)
    with pytest.raises(
        RecordError, match="its record lists the report that was written then, which is missing"
    ):
        write_report_again(finished)
    (finished / "report.html").write_bytes(report)
    found = recompute(finished)
    assert (found.verdict, found.differences) == ("PASS", ())
    assert "recorded by anisoscope 0.0.1" in found.notes[0]
    assert "did not tell it: calibrations, details.area.learnt, details.between_tilts" in found.notes[1]
    assert "poses[].dropped" in found.notes[1]


def test_a_record_without_copies_of_its_inputs_says_that_it_cannot_be_computed_again(finished):
    record = read_record(finished)
    write_record(record.model_copy(update={"files": ()}), finished)
    (finished / "job.json").unlink()
    shutil.rmtree(finished / "inputs")
    with pytest.raises(RecordError, match=r"kept no copies of recipe, .*can be read, but not computed again"):
        recompute(finished)
    assert read_record(finished).verdict == "PASS"
