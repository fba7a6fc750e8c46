"""The published schema of records is that of the code, and real records keep it; so do those of the first version.

ANISOSCOPE_WRITE_DOCS=1 writes the schema anew.
"""

import json
import os
import re
from pathlib import Path

import pytest

from anisoscope.base.errors import RecordError
from anisoscope.decision.reference_parts import GoldenSet, write_golden
from anisoscope.record.json_schema import record_schema
from anisoscope.record.schema import RECORD_NAME, read_record, write_record

FIRST = Path(__file__).parents[3] / "docs" / "schema" / "record-1.schema.json"
FILE = Path(__file__).parents[3] / "docs" / "schema" / "record-2.schema.json"
PLAIN = {"string": str, "integer": int, "number": (int, float), "boolean": bool, "null": type(None)}
KNOWN = {
    "type",
    "properties",
    "required",
    "additionalProperties",
    "items",
    "anyOf",
    "enum",
    "const",
    "pattern",
}
KNOWN |= {
    "title",
    "description",
    "default",
    "$defs",
    "$schema",
    "$ref",
    "prefixItems",
    "minItems",
    "maxItems",
}

FIRST_VERSION = """{
  "schema": 1, "software": "anisoscope 0.1.0", "created_at": "2026-01-02T03:04:05+00:00", "serial": "S 1",
  "particulars": {"operator": null, "lot": "7", "cavity": null, "station": null},
  "product": "plate", "verdict": "PASS", "reasons": ["one"], "model": "corrected",
  "convention": {"light_angle_deg": 10.0, "facet_azimuth_deg": 0.0},
  "poses": [{"stage_deg": 0.0, "tilt_deg": 0.0, "measured": 0.1, "predicted": 0.11, "marker_angle_deg": 359.99,
    "pixel_um": 4.0, "residual_px": 0.1, "markers": 4}],
  "contrasts": [{"from_deg": 0.0, "to_deg": 90.0, "tilt_deg": 0.0, "kind": "log_ratio", "measured": 0.3,
    "predicted": 0.31, "u": 0.01, "tolerance": 0.25, "guard": 0.016, "conformance_probability": 1.0,
    "verdict": "PASS", "p_value": 0.4, "tolerance_ratio": 12.5}],
  "d2": 1.5, "dof": 2, "p_value": 0.5,
  "area": {"share": 0.001, "u": 0.0002, "max_share": 0.03, "cells": 2800, "verdict": "PASS"},
  "budget": [{"source": "albedo", "kind": "prediction", "contributions": [0.1]}],
  "drift": 0.001, "conformance_probability": 1.0, "regions": [], "diagnosis": null, "comparisons": [],
  "reading": null, "shape": null, "golden": null, "rounds": 1, "notes": [],
  "white_reference": {"taken_at": "2026-01-01", "reflectance": 0.99, "camera": "X", "sha256": "0"},
  "recipe": {"schema": 1}, "rig": {"schema": 1}, "camera": "X", "stage": "Y",
  "inputs": [{"name": "inputs/recipe.toml", "sha256": "0"}],
  "frames": [{"name": "frames/000_dark.tif", "sha256": "0", "kind": "dark", "again": false, "tilt_deg": null,
    "stage_deg": 0.0, "commanded_deg": 0.0, "exposure_s": 0.01, "gain": 1.0, "captured_at": "now"}],
  "files": []
}"""


def complaints(value, rule, root, at="record"):
    """What breaks a rule, for the words of JSON Schema that pydantic uses here; an unknown word is an error."""
    if "$ref" in rule:
        return complaints(value, root["$defs"][rule["$ref"].rpartition("/")[2]], root, at)
    unknown = rule.keys() - KNOWN
    assert not unknown, unknown
    found = of_value(value, rule, at)
    if "anyOf" in rule and all(complaints(value, one, root, at) for one in rule["anyOf"]):
        found.append(f"{at}: fits nothing of {rule['anyOf']}")
    if rule.get("type") == "object":
        found += of_object(value, rule, root, at)
    elif rule.get("type") == "array":
        items = value if isinstance(value, list) else []
        found += [] if isinstance(value, list) else [f"{at}: no list"]
        if not rule.get("minItems", 0) <= len(items) <= rule.get("maxItems", len(items)):
            found.append(f"{at}: {len(items)} values")
        first = rule.get("prefixItems", ())
        for number, one in enumerate(items):
            found += complaints(
                one, first[number] if number < len(first) else rule.get("items", {}), root, f"{at}[{number}]"
            )
    return found


def of_value(value, rule, at):
    found = []
    if "enum" in rule and value not in rule["enum"]:
        found.append(f"{at}: {value!r} is not one of {rule['enum']}")
    if "const" in rule and value != rule["const"]:
        found.append(f"{at}: {value!r} is not {rule['const']!r}")
    if "pattern" in rule and not re.search(rule["pattern"], str(value)):
        found.append(f"{at}: {value!r} does not match {rule['pattern']}")
    wanted = PLAIN.get(rule.get("type"), object)
    if not isinstance(value, wanted) or (isinstance(value, bool) and wanted not in (bool, object)):
        found.append(f"{at}: {value!r} is no {rule['type']}")
    return found


def of_object(value, rule, root, at):
    if not isinstance(value, dict):
        return [f"{at}: no object"]
    found = [f"{at}: {name} is missing" for name in rule.get("required", ()) if name not in value]
    for name, one in value.items():
        if name in rule.get("properties", {}):
            found += complaints(one, rule["properties"][name], root, f"{at}.{name}")
        elif rule.get("additionalProperties") is False:
            found.append(f"{at}: {name} is unknown")
    return found


def test_the_published_schema_is_that_of_the_code():
    text = json.dumps(record_schema(), indent=2, ensure_ascii=False) + "\n"
    if os.environ.get("ANISOSCOPE_WRITE_DOCS") == "1":
        FILE.parent.mkdir(exist_ok=True)
        FILE.write_text(text, encoding="utf-8")
    assert FILE.read_text(encoding="utf-8") == text


def test_a_real_record_keeps_the_schema_and_a_forged_one_does_not(inspected_part):
    content = json.loads((inspected_part[1].folder / RECORD_NAME).read_text(encoding="utf-8"))
    schema = record_schema()
    assert complaints(content, schema, schema) == []
    for change in ({"verdict": "GOOD"}, {"d2": "much"}, {"more": 1}, {"seal": "x"}, {"poses": [{}]}):
        assert complaints(content | change, schema, schema), change
    del content["serial"]
    assert complaints(content, schema, schema) == ["record: serial is missing"]


def test_records_of_the_first_version_are_read_and_keep_the_schema(tmp_path):
    (tmp_path / RECORD_NAME).write_text(FIRST_VERSION, encoding="utf-8")
    record, schema = read_record(tmp_path), json.loads(FIRST.read_text(encoding="utf-8"))
    assert (record.serial, record.poses[0].dropped, record.details.area.learnt) == ("S 1", (), False)
    assert record.calibrations == ()
    assert complaints(json.loads(FIRST_VERSION), schema, schema) == []
    now = record_schema()
    again = write_record(record, tmp_path).read_text(encoding="utf-8")
    assert complaints(json.loads(again), now, now) == []


@pytest.mark.parametrize("change", [{"schema": 3}, {"hue": 3.0}])
def test_records_of_later_versions_ask_for_an_update(tmp_path, change):
    content = json.loads(FIRST_VERSION) | change
    (tmp_path / RECORD_NAME).write_text(json.dumps(content), encoding="utf-8")
    with pytest.raises(RecordError, match=r"written by a later version .*(schema 3|holds hue)"):
        read_record(tmp_path)


OLD_GOLDEN = {
    "schema": 1,
    "product": "ridged test plate",
    "poses": [[0.0, 0.0], [90.0, 0.0], [180.0, 0.0]],
    # the key that the version before made for the recipe of these tests
    "recipe_key": "dad4d7c18ba518cd5e9e690a4e5fbd7eab1c6bc8186788fcdc4ba0243e4058ac",
    "parts": [
        {
            "serial": "G1",
            "inspected_at": "2026-01-02T03:04:05+00:00",
            "log_radiance": [-1.0, -2.0, -3.0],
            "area_share": 0.01,
            "verdict": "PASS",
        }
    ],
}


def test_golden_parts_of_before_are_read_and_get_the_key_of_now(make_recipe, tmp_path):
    recipe, path = make_recipe(), tmp_path / "r.golden.json"
    path.write_text(json.dumps(OLD_GOLDEN), encoding="utf-8")
    found = GoldenSet.read(path, recipe)
    assert (len(found.parts), found.recipe_key, found.area_limit(recipe)) == (
        1,
        GoldenSet.key_of(recipe),
        None,
    )
    write_golden(path, found)
    assert GoldenSet.read(path, recipe) == found


def test_the_key_is_that_of_what_changes_a_measurement(make_recipe):
    key = GoldenSet.key_of(make_recipe())
    for same in (
        {"acquisition": {"settle_s": 3.0}},
        {"decision": {"alpha": 0.05}},
        {"acquisition": {"gain": 1.0}},
    ):
        assert GoldenSet.key_of(make_recipe(**same)) == key
    for other in (
        {"acquisition": {"exposure_s": 0.003}},
        {"acquisition": {"frames_per_pose": 3}},
        {"acquisition": {"brackets": [4.0]}},
        {"poses": {"angles_deg": [0.0, 90.0]}},
        {"region": {"size_mm": [0.8, 0.8]}},
    ):
        assert GoldenSet.key_of(make_recipe(**other)) != key
