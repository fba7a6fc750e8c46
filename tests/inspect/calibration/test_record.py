"""The record of a calibration: sealed, dated, and what is said of one that was touched."""

import json
from datetime import UTC, datetime, timedelta

import pytest

from anisoscope.base.errors import CalibrationError, RecordError, UsageError
from anisoscope.calibration.record import (
    KINDS,
    VALID_FOR_DAYS,
    dated,
    picture_of,
    read_calibration,
    record_path,
    write_calibration,
)

CAMERA = {"model": "SIM", "serial": "CAM-7", "rows": 4, "cols": 5, "bit_depth": 12}
CONTENT = {
    "rig": "rig",
    "camera": CAMERA,
    "exposure_s": 0.5,
    "gain": 1.0,
    "frames": 8,
    "values": {"level": {"value": 64.0, "u": 0.1, "unit": "counts"}, "share": {"value": 0.5}},
}


@pytest.fixture
def dark(tmp_path):
    """A dark calibration on disk: its record and the path of its picture."""
    picture = tmp_path / "dark.tif"
    picture.write_bytes(b"pixels")
    record = dated("dark", CONTENT | {"picture": picture_of(picture)}, valid_days=2.0)
    write_calibration(record, picture)
    return record, picture


def test_what_is_written_is_read_by_either_name(dark):
    record, picture = dark
    assert read_calibration(picture, "dark") == record
    assert read_calibration(record_path(picture), "dark") == record
    assert record.id.startswith(f"dark-{record.taken_at:%Y%m%d}-")
    assert (record.number("level"), record.uncertainty("level"), record.uncertainty("share")) == (
        64.0,
        0.1,
        0.0,
    )
    with pytest.raises(CalibrationError, match=r"holds no gain.*calibrate dark"):
        record.number("gain")


def test_it_holds_until_its_end_and_not_beyond(dark):
    record, _ = dark
    assert record.valid_until - record.taken_at == timedelta(days=2)
    just_before, end = record.valid_until - timedelta(seconds=1), record.valid_until
    assert record.invalid_reason(just_before) is None
    assert "expired" in record.invalid_reason(end)
    assert "anisoscope calibrate dark" in record.invalid_reason(end)
    unfit = record.model_copy(update={"in_limits": False, "remarks": ("the lamp leaks",)})
    assert "out of its limits (the lamp leaks)" in unfit.invalid_reason(just_before)


def test_every_kind_has_a_usual_validity_and_two_records_two_ids():
    ids = set()
    for kind in KINDS:
        for exposure_s in (0.5, 0.6):
            record = dated(kind, CONTENT | {"exposure_s": exposure_s}, valid_days=None)
            assert record.valid_for_days == VALID_FOR_DAYS[kind]
            assert abs(record.taken_at - datetime.now(UTC)) < timedelta(minutes=5)
            ids.add(record.id)
    assert len(ids) == 2 * len(KINDS)


@pytest.mark.parametrize("days", [0.0, -1.0, 1e6, float("nan")])
def test_a_senseless_validity_is_refused(days):
    with pytest.raises(UsageError, match="--valid-days"):
        dated("dark", CONTENT, valid_days=days)


def change_record(picture):
    path = record_path(picture)
    path.write_text(path.read_text().replace("64.0", "63.0"))


def later_end(picture):
    path = record_path(picture)
    content = json.loads(path.read_text())
    content["valid_until"] = "2100-01-01T00:00:00Z"
    path.write_text(json.dumps(content, indent=2))


def other_schema(picture):
    path = record_path(picture)
    path.write_text(json.dumps({"schema": 2, "seal": "0"}))


TAMPERED = {
    "value": (change_record, "was changed after"),
    "end": (later_end, "was changed after"),
    "picture": (lambda picture: picture.write_bytes(b"pixel!"), "was changed since its calibration"),
    "no picture": (
        lambda picture: picture.unlink(),
        "dark.tif, the picture of the dark calibration, cannot be read",
    ),
    "no record": (lambda picture: record_path(picture).unlink(), "does not exist"),
    "empty": (lambda picture: record_path(picture).write_text(""), "is no record of a calibration"),
    "list": (lambda picture: record_path(picture).write_text("[]"), "was changed|is no record"),
    "bytes": (
        lambda picture: record_path(picture).write_bytes(b"\xff\xfe\x00"),
        "is no record of a calibration",
    ),
    "schema": (other_schema, "was changed|is no record"),
}


@pytest.mark.parametrize("case", TAMPERED)
def test_what_was_touched_is_named_with_the_remedy(dark, case):
    tamper, message = TAMPERED[case]
    tamper(dark[1])
    with pytest.raises(CalibrationError, match=message) as caught:
        read_calibration(dark[1], "dark")
    assert "anisoscope calibrate dark" in str(caught.value)
    assert "\n" not in str(caught.value)
    assert caught.value.exit_code == 3


def test_a_record_of_another_kind_is_refused(dark):
    with pytest.raises(CalibrationError, match="is a dark calibration, not a stray one"):
        read_calibration(dark[1], "stray")


def test_a_place_that_cannot_be_written_is_named(dark, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(RecordError, match="cannot write"):
        write_calibration(dark[0], tmp_path / "file" / "dark.json")
