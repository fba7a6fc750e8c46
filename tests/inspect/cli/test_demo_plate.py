"""The demo with plates: from a code of ridges to the verdicts, and the code read in both poses."""

import json


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
            assert dead == {(3, 4): "missing", (6, 8): "missing", (9, 2): "missing"}
        else:
            assert dead == {}
        page = (folder / "report.html").read_text()
        assert "plate-contrasts" in page
        assert "plate-grades" in page
    dead_folder = next(folder for folder in folders if "dead" in folder.name)
    again = anisoscope("recompute", dead_folder)
    assert again.code == 0, again.out + again.err
