"""The demo with plates: from a code of ridges to the verdicts, and the code read in both poses."""

import json

import pytest

from anisoscope.base.progress import silent
from anisoscope.inspection.recompute import recompute
from anisoscope.inspection.run import inspect_part
from anisoscope.operations.demo.plates import SCENE

DEAD = {(3, 4): "missing", (6, 8): "missing", (9, 2): "missing"}


def test_a_plate_with_dead_fields_fails_and_is_computed_again(tmp_path):
    """One of the three plates of the demo, from fewer pictures."""
    folder = SCENE.lay_out(tmp_path, 1, silent)
    recipe = folder / "recipe.toml"
    frames = "frames_per_pose = {}\ndark_frames = {}"
    assert frames.format(4, 8) in recipe.read_text()
    recipe.write_text(recipe.read_text().replace(frames.format(4, 8), frames.format(2, 2)))
    done = inspect_part(recipe, folder / "bench" / "dead-fields" / "rig.toml", "P-1", folder / "out")
    details = done.record.details
    assert done.record.verdict == "FAIL"
    assert details.code.readings[:2] == ("A17", "A17")
    assert {(one.row, one.col): one.looks_like for one in details.fields} == DEAD
    page = done.report.read_text(encoding="utf-8")
    assert all(place in page for place in ("plate-contrasts", "plate-grades"))
    assert recompute(done.folder).differences == ()


@pytest.mark.soak
def test_every_plate_gets_its_verdict_and_its_code_is_read(anisoscope, tmp_path):
    done = anisoscope("demo", "--kind", "plates", "--out", tmp_path / "demo", "--json")
    assert done.code == 0, done.out + done.err
    parts = {one["serial"]: one for one in done.json["parts"]}
    assert {name: one["verdict"] for name, one in parts.items()} == {
        "DEMO-good": "PASS",
        "DEMO-dead-fields": "FAIL",
        "DEMO-worn": "FAIL",
    }
    folders = sorted((tmp_path / "demo" / "inspections").glob("DEMO-*"))
    for folder in folders:
        record = json.loads((folder / "record.json").read_text())
        assert record["kind"] == "plates"
        details = record["details"]
        assert details["code"]["readings"][:2] == ["A17", "A17"]
        assert details["alike"] > 0.95
        dead = {(one["row"], one["col"]): one["looks_like"] for one in details["fields"]}
        if "dead" in folder.name:
            assert dead == DEAD
        else:
            assert dead == {}
        page = (folder / "report.html").read_text()
        assert "plate-contrasts" in page
        assert "plate-grades" in page
    dead_folder = next(folder for folder in folders if "dead" in folder.name)
    again = anisoscope("recompute", dead_folder)
    assert again.code == 0, again.out + again.err
