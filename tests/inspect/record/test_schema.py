import hashlib
import json
from pathlib import Path

import pytest

from anisoscope.base.atomic_write import write_text
from anisoscope.base.errors import RecordError
from anisoscope.record.schema import RECORD_NAME, Record, read_record, sha256_of, write_record


@pytest.fixture
def record():
    frame = {"kind": "dark", "stage_deg": -10.0, "commanded_deg": 0.0, "exposure_s": 0.01, "gain": 1.0}
    pose = {
        "stage_deg": 0.0,
        "tilt_deg": 0.0,
        "measured": 0.1,
        "predicted": 0.1 + 1e-17,
        "marker_angle_deg": 359.99,
    }
    contrast = {"from_deg": 0.0, "to_deg": 90.0, "tilt_deg": 0.0, "kind": "log_ratio", "measured": 1 / 3}
    return Record.model_validate(
        {
            "kind": "ridges",
            "software": "anisoscope 0",
            "created_at": "2026-01-02T03:04:05+00:00",
            "serial": "S 1",
            "product": "plate <µ>",
            "verdict": "PASS",
            "reasons": ["one", "two"],
            "model": "corrected",
            "convention": {"light_angle_deg": 10.0},
            "poses": [{**pose, "pixel_um": 4.0, "residual_px": 0.1, "markers": 4}],
            "details": {
                "contrasts": [
                    {
                        **contrast,
                        "predicted": 0.3,
                        "u": 0.01,
                        "tolerance": None,
                        "guard": None,
                        "conformance_probability": None,
                        "verdict": "PASS",
                    }
                ],
            },
            "d2": 1.5,
            "dof": 2,
            "p_value": 0.5,
            "budget": [{"source": "albedo", "kind": "prediction", "contributions": [0.1, 0.2]}],
            "drift": None,
            "white_reference": {},
            "recipe": {"schema": 1},
            "rig": {},
            "camera": "X",
            "stage": "Y",
            "inputs": [],
            "frames": [{**frame, "name": "frames/0.tif", "sha256": "0", "captured_at": "now"}],
        }
    )


def test_round_trip(record, tmp_path):
    write_record(record, tmp_path)
    assert read_record(tmp_path) == record
    assert [path.name for path in tmp_path.iterdir()] == [RECORD_NAME]


def test_the_file_says_its_schema(record, tmp_path):
    assert json.loads(write_record(record, tmp_path).read_text(encoding="utf-8"))["schema"] == 2


@pytest.mark.parametrize("step", ["replace", "open"])
def test_a_failing_write_leaves_the_old_file_and_no_half_one(monkeypatch, tmp_path, step):
    path = tmp_path / "report.html"
    write_text(path, "old")

    def fail(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, step, fail)
    with pytest.raises(RecordError, match=r"cannot write .*No space left"):
        write_text(path, "new")
    monkeypatch.undo()
    assert path.read_text() == "old"
    assert [p.name for p in tmp_path.iterdir()] == ["report.html"]


def test_a_text_that_cannot_be_encoded_leaves_nothing(tmp_path):
    with pytest.raises(UnicodeEncodeError):
        write_text(tmp_path / "report.html", "\ud800")
    assert not list(tmp_path.iterdir())


def test_what_is_no_number_is_never_written(record, tmp_path):
    with pytest.raises(ValueError, match="JSON"):
        write_record(record.model_copy(update={"d2": float("nan")}), tmp_path)
    assert not list(tmp_path.iterdir())


DAMAGE = {
    "truncated": lambda text: text[: len(text) // 2],
    "empty": lambda _: "",
    "other schema": lambda text: text.replace('"schema": 2,\n  "kind', '"schema": 3,\n  "kind'),
    "other verdict": lambda text: text.replace('"PASS",\n  "reasons', '"GOOD",\n  "reasons'),
    "further key": lambda text: text.replace("{", '{"more": 1,', 1),
}


@pytest.mark.parametrize("damage", DAMAGE)
def test_a_damaged_record_is_one_line_that_names_it(record, tmp_path, damage):
    path = write_record(record, tmp_path)
    changed = DAMAGE[damage](path.read_text(encoding="utf-8"))
    assert changed != path.read_text(encoding="utf-8")
    path.write_text(changed, encoding="utf-8")
    with pytest.raises(RecordError, match="is damaged") as caught:
        read_record(tmp_path)
    assert "\n" not in str(caught.value)


def test_a_folder_without_a_record_was_not_finished(tmp_path):
    with pytest.raises(RecordError, match="was this inspection finished"):
        read_record(tmp_path)


def test_the_fingerprint_is_that_of_the_bytes(tmp_path):
    path = tmp_path / "x"
    path.write_bytes(b"abc" * 10**6)
    assert sha256_of(path) == hashlib.sha256(b"abc" * 10**6).hexdigest()


def test_a_record_displays_itself_in_a_notebook(record):
    bad = record.model_copy(update={"serial": "<script>", "reasons": ("too dark",)})
    assert repr(bad) == f"Record(<script>, {bad.product}: {bad.verdict}, too dark)"
    assert "<script>" not in bad._repr_html_()
    assert "too dark" in bad._repr_html_()


def test_a_record_draws_its_poses_and_is_a_table(record):
    pytest.importorskip("pandas")
    assert list(record.to_frame().columns) == ["stage_deg", "tilt_deg", "measured", "predicted"]
    assert len(record.to_frame()) == len(record.poses)
    axes = record.plot()
    assert len(axes.get_lines()) == 2 * len({pose.tilt_deg for pose in record.poses})
