"""The report of a print: its sections, words and pictures, and nothing from outside."""

import re

import numpy as np
import pytest

from anisoscope.diagnosis.part_diagnosis import diagnosis_record
from anisoscope.imaging.linearisation import RadianceImage
from anisoscope.imaging.registration.placement import Placement, View
from anisoscope.inspection.pipeline import pose_records
from anisoscope.kinds.prints.causes import explain_print
from anisoscope.kinds.prints.decision import print_results
from anisoscope.kinds.prints.kind import PRINTS
from anisoscope.kinds.prints.model import State
from anisoscope.kinds.prints.report import print_rule, quantity_row
from anisoscope.record.schema import Record
from anisoscope.report.inspection_page import Pictures, report_page

RIG = {
    "name": "rig <b>",
    "camera": {"pixel_um": 5.0},
    "light": {"driver": "simulated", "angle_deg": 10.0},
}


def views(expected):
    """Poses as seen, of which the record takes where the markers stood."""
    image = RadianceImage(
        np.ones((4, 4), np.float32), np.ones((4, 4), np.float32), np.zeros((4, 4), bool), 0.5
    )
    place = Placement(np.eye(3)[:2], 0.0, 5.0, (1.5, 1.5), 0.1, 4)
    return [View(pose.stage_deg, pose.tilt_deg, image, place) for pose in expected.poses]


def recorded(sheet, **told):
    """The record of an inspection."""
    return Record.model_validate(
        {
            "software": "anisoscope test",
            "created_at": "2026-01-02T03:04:05+00:00",
            "serial": "P<1>",
            "product": sheet.recipe.product,
            "model": sheet.expected.model,
            "convention": vars(sheet.expected.convention),
            "white_reference": {"taken_at": "2026-01-01", "reflectance": 0.99, "camera": "X", "sha256": "0"},
            "recipe": sheet.recipe.model_dump(mode="json", by_alias=True),
            "rig": RIG,
            "camera": "X",
            "stage": "Y",
            "inputs": (),
            "frames": (),
            **told,
        }
    )


@pytest.fixture
def page(sheet, tmp_path):
    """Writes the report of a sheet; returns its text and its record."""

    def write(state=None, spot=None):
        if state is not None:
            sheet.all(state)
        if spot is not None:
            sheet.spotted(*spot)
        recipe, expected = sheet.recipe, sheet.expected
        measured, decision = sheet.decided()
        found = explain_print(recipe, expected, measured, decision)
        told = print_results(expected, decision, ("made-up", "rggb"))
        record = Record.model_validate(
            {
                "software": "anisoscope test",
                "created_at": "2026-01-02T03:04:05+00:00",
                "serial": "P<1>",
                "product": recipe.product,
                "verdict": decision.verdict.value,
                "reasons": decision.reasons,
                "model": expected.model,
                "convention": vars(expected.convention),
                "white_reference": {
                    "taken_at": "2026-01-01",
                    "reflectance": 0.99,
                    "camera": "X",
                    "sha256": "0",
                },
                "recipe": recipe.model_dump(mode="json", by_alias=True),
                "rig": RIG,
                "camera": "X",
                "stage": "Y",
                "inputs": (),
                "frames": (),
                "diagnosis": diagnosis_record(found, 0.01, "print"),
                "kind": "prints",
                "details": told.details,
                "poses": pose_records(views(expected), told.measured, told.predicted),
                "budget": told.budget,
                "d2": told.d2,
                "dof": told.dof,
                "p_value": told.p_value,
                "drift": measured.drift,
            }
        )
        pictures = PRINTS.pictures(recipe, expected, measured, decision)
        return report_page(record, pictures, tmp_path, None, PRINTS.sections(record, pictures)), record

    return write


def test_a_failed_print_is_explained(page):
    text, record = page(State(ratio=np.log(1.15)), spot=(slice(3, 6), slice(3, 7), 0.6))
    assert 'class="verdict bg-FAIL"' in text
    for heading in ("Measured, predicted, difference", "What was judged", "The lobe", "Maps", "Diagnosis"):
        assert f"<h2>{heading}</h2>" in text
    assert "outside the limit by more than the guard band (ISO 14253-1)" in text
    assert print_rule(record) in text
    assert "brushed print: roughness at 90° over 0°" in text
    assert text.count('class="patch"') == len(record.details.colours) == 21
    assert record.details.not_judged[0] in text
    assert "P&lt;1&gt;" in text
    assert "<b>" not in text


def test_nothing_comes_from_outside(page):
    text, _ = page()
    assert "default-src 'none'; img-src data:; style-src 'unsafe-inline'" in text
    assert re.findall(r"""(?:src|href)=["'](?!data:)""", text) == []
    assert "<script" not in text
    assert "<h2>Contrasts" not in text


def test_quantities_are_worded_in_their_units(sheet):
    _, decision = sheet.all(State(alpha=np.log(1.1))).decided()
    told = print_results(sheet.expected, decision, ("made-up", "rggb")).details
    rows = {one.name: quantity_row(one) for one in told.quantities}
    assert (rows["alpha x"].value, rows["alpha x"].limit, rows["alpha x"].verdict) == (
        "0.209",
        "±5 %",
        "FAIL",
    )
    assert rows["alpha x"].deviation.startswith("+")
    assert rows["tilt"].limit == "≤ 0.5°"
    assert rows["chromaticity"].limit == "≤ 0.005"


def test_an_invalid_print_shows_what_the_camera_saw(sheet, tmp_path):
    nothing = dict.fromkeys(("d2", "dof", "p_value", "drift"))
    nothing |= {"poses": (), "budget": (), "kind": "prints"}
    record = recorded(sheet, verdict="INVALID", reasons=("the lamp drifts",), **nothing)
    raw = (("0°", np.ones((20, 30), np.float32)),)
    text = report_page(record, Pictures(raw=raw), tmp_path, None, PRINTS.sections(record, Pictures()))
    assert "the lamp drifts" in text
    assert "<h2>What the camera saw</h2>" in text
    assert "What was judged" not in text
