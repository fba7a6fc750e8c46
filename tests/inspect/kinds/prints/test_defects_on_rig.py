"""Prints on the virtual rig: good ones pass, defects fail and their cause is named, in both worlds."""

import json

import pytest

from anisoscope.base.errors import CalibrationError
from anisoscope.cli.inspect.inspection import _exit_code, _print
from anisoscope.history.rows import numbers_of
from anisoscope.inspection.integrity import verify
from anisoscope.inspection.recompute import recompute
from anisoscope.operations.findings import content_of
from anisoscope.record.schema import RECORD_NAME


def causes(record):
    """Names of the best cause and those tied with it."""
    return [one.cause for one in record.diagnosis.causes if one.tie]


def quantity(record, name):
    """A judged quantity."""
    return next(one for one in record.details.quantities if one.name == name)


def test_a_good_print_passes_and_its_folder_explains_itself(good_print, capsys):
    done = good_print
    record = done.record
    assert record.verdict == "PASS", record.reasons
    assert record.model == "ink"
    assert record.diagnosis.says.startswith("nothing")
    assert max(one.delta_e for one in record.details.colours) < 0.6
    assert quantity(record, "alpha x").value == pytest.approx(0.19, rel=0.01)
    assert abs(record.details.lobe.form) < 0.05
    roles = {file.name for file in record.inputs}
    assert {"inputs/synthetic-green.toml", "inputs/synthetic-red.toml"} <= roles
    assert "<h2>What was judged</h2>" in done.report.read_text()
    again = recompute(done.folder)
    assert (again.differences, again.notes) == ((), ())
    assert verify(done.folder).intact
    numbers = numbers_of(record)
    alpha = quantity(record, "alpha x")
    assert numbers["print alpha x"] == alpha.value
    # all of it in units of the value: value − deviation is what the recipe predicts
    assert alpha.value - numbers["deviation print alpha x"] == pytest.approx(alpha.nominal)
    assert numbers["u print alpha x"] == pytest.approx(alpha.nominal * alpha.u)
    assert numbers["tolerance print alpha x"] == pytest.approx(alpha.nominal * alpha.limit)
    assert numbers["p"] == record.p_value
    said = content_of(done)
    assert said["print"]["quantities"][0]["name"] == "alpha x"
    _print(done)
    assert _exit_code(done) == 0
    printed = capsys.readouterr().out
    assert "roughness along x" in printed
    assert "PASS" in printed
    assert json.loads((done.folder / RECORD_NAME).read_text())["details"]["not_judged"][0].startswith(
        "c of the ink"
    )


@pytest.mark.parametrize(
    ("defects", "failing", "cause"),
    [
        ({"anisotropy": 1.15, "brush_deg": 30.0}, "ratio", "brushing"),
        pytest.param(
            {"wrong_ink": "synthetic-red", "wrong_share": 0.05},
            "chromaticity",
            "wrong-ink-synthetic red",
            marks=pytest.mark.soak,
        ),
    ],
)
def test_a_defect_fails_and_its_cause_is_named(print_rig, defects, failing, cause):
    record = print_rig.inspect(defects).record
    assert record.verdict == "FAIL", record.reasons
    assert quantity(record, failing).verdict == "FAIL"
    assert causes(record) == [cause]


def test_a_region_that_leaves_the_sheet_is_noted(print_rig):
    """What is beyond looks like missing ink, as which it is judged."""
    region = {"center_mm": [0.2, 0.0], "size_mm": [1.6, 1.6]}
    done = print_rig.inspect({}, recipe={"region": region}, bench={"sample": {"size_mm": 1.6}})
    assert done.record.verdict == "FAIL"
    assert any("the region reaches beyond the part at 2 corners: " in note for note in done.notes)


@pytest.mark.parametrize(
    ("filters", "says"),
    [("mono", "needs a camera with colour filters"), ("bggr", "flat was taken through filters 'rggb'")],
)
def test_a_camera_that_cannot_see_the_colours_is_refused_before_anything_moves(print_rig, filters, says):
    """Of a camera without filters, or with others than its flat; the stage has not moved, and no folder was made."""
    with pytest.raises(CalibrationError, match=says):
        print_rig.inspect({}, bench={"sensor": {"filters": filters}})
    assert not list(print_rig.folder.glob("inspections/*"))
