"""A good flat print under a lamp at 80 mm, whose light turns by 0.7° from the middle of the sheet to its side."""

import tomllib

import pytest
import tomli_w

from anisoscope.inspection.run import inspect_part


@pytest.fixture
def curl_of(print_rig, plain):
    """``curl_of("stated", 80.0)`` inspects it on a rig whose file states the distance: its record and its curl."""

    def inspect(name, stated_mm):
        recipe, rig = print_rig.lay_out({}, bench={"optics": {"lamp_distance_mm": 80.0}}, name=name)
        table = tomllib.loads(rig.read_text(encoding="utf-8"))
        if stated_mm is not None:
            table["light"]["distance_mm"] = stated_mm
        rig.write_text(tomli_w.dumps(table), encoding="utf-8")
        record = inspect_part(recipe, rig, name, print_rig.folder / "inspections", methods=plain).record
        (curl,) = (one for one in record.details.quantities if one.name == "curl")
        return record, curl

    return inspect


def test_a_near_lamp_is_no_curl_where_its_distance_is_stated(curl_of):
    record, curl = curl_of("stated", 80.0)
    assert (record.verdict, curl.verdict) == ("PASS", "PASS")
    assert curl.value < 2.0 * curl.u < 0.3
    record, curl = curl_of("unstated", None)
    assert record.verdict != "PASS"
    assert curl.verdict != "PASS"
    assert curl.value == pytest.approx(
        0.72, abs=0.1
    )  # 2 mm at 80 mm turn light by 1.43°, half vectors by half
