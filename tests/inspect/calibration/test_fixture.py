"""The fixture as a grey card: taught on the virtual rig, and what inspections make of it."""

import json

import numpy as np
import pytest

from anisoscope.base.errors import RigFileError, Saturated, UsageError
from anisoscope.calibration.corrections import read_calibrations
from anisoscope.calibration.fixture import calibrate_fixture
from anisoscope.calibration.record import read_calibration
from anisoscope.inspection.recompute import recompute
from anisoscope.parameters.taking import Taking
from anisoscope.rig.rigfile import CalibrationPart

TAKING = Taking(0.004, frames=2)
EMPTY = {"sample": {"kind": "none"}}
PAPER_WHITE, PAPER_BLACK = 0.75, 0.03  # of the bench's print


@pytest.fixture(scope="module")
def taught(virtual_rigs, tmp_path_factory):
    """The reference of the sound small rig."""
    path = tmp_path_factory.mktemp("taught") / "fixture.json"
    record = calibrate_fixture(virtual_rigs("empty", bench=EMPTY).rig, path, TAKING, angles=6)
    assert record.in_limits
    return path


def with_reference(taught):
    """Change of a rig file that names the reference."""
    return {"calibration": {"fixture": str(taught)}}


def test_the_reference_holds_the_radiances_of_the_print(taught):
    record = read_calibration(taught, "fixture", None)
    # the lamp stands 10° off the normal of the fixture, as of the white tile
    assert record.number("white") == pytest.approx(PAPER_WHITE * np.cos(np.radians(10.0)) / np.pi, rel=0.01)
    assert record.uncertainty("white") < 0.001 * record.number("white")
    # the lens spreads white over a border that is 10 px wide
    assert PAPER_BLACK / PAPER_WHITE < record.number("black_share") < 0.06
    reference = read_calibrations(CalibrationPart(flat="none.tif", fixture=taught)).fixture_reference
    assert reference.id == record.id
    assert [one.tilt_deg for one in reference.tilts] == [0.0]


def test_inspections_are_corrected_for_stray_light_and_a_dimmed_lamp(
    virtual_rigs, taught, plain, undiagnosed
):
    rig = with_reference(taught)
    sound = virtual_rigs("sound", rig=rig).inspect("S", undiagnosed).record
    dim = virtual_rigs("dim", rig=rig, bench={"optics": {"electrons": 2.3e7, "stray_radiance": 0.0022}})
    changed = dim.inspect("D", plain).record
    assert (
        sound.rig_monitor.reference
        == changed.rig_monitor.reference
        == read_calibration(taught, "fixture", None).id
    )
    for pose in changed.rig_monitor.poses:
        assert pose.level == pytest.approx(2.3 / 2.4, abs=0.002)
        assert pose.stray == pytest.approx(0.002, abs=0.0004)
    assert any("4." in note and "darker than at the reference" in note for note in changed.notes)
    for before, after in zip(sound.poses, changed.poses, strict=True):
        assert after.measured == pytest.approx(before.measured, rel=0.01)
    found = recompute(dim.folders[0])
    assert found.same, found.differences


def test_glare_is_invalid_and_shown_in_the_record(virtual_rigs, taught, undiagnosed):
    glare = virtual_rigs("glare", rig=with_reference(taught), bench={"optics": {"stray_radiance": 0.03}})
    record = glare.inspect("G", undiagnosed).record
    assert record.verdict == "INVALID"
    assert "stray light is 1" in record.reasons[0]
    assert "look for glare" in record.reasons[0]
    assert [pose.stage_deg for pose in record.rig_monitor.poses] == [0.0, 90.0, 180.0, 0.0]
    assert (
        json.loads((glare.folders[0] / "record.json").read_text())["rig_monitor"]["poses"][0]["stray"] > 0.02
    )


def test_without_a_reference_the_record_says_what_was_not_watched(virtual_rigs, undiagnosed):
    record = virtual_rigs("untaught").inspect("U", undiagnosed).record
    assert record.rig_monitor.reference is None
    assert "calibrate fixture" in record.rig_monitor.not_watched[0]


def test_a_rig_without_fixture_or_flat_is_refused(virtual_rig, tmp_path):
    bare = virtual_rig("bare", bench=EMPTY)
    text = bare.rig.read_text().split("[fixture]")[0]
    bare.rig.write_text(text)
    with pytest.raises(RigFileError, match=r"describes no \[fixture\]"):
        calibrate_fixture(bare.rig, tmp_path / "fixture.json", TAKING)


def test_too_few_angles_and_too_long_an_exposure_name_their_options(virtual_rig, tmp_path):
    empty = virtual_rig("empty", bench=EMPTY)
    with pytest.raises(UsageError, match="needs at least 6 angles, not 3: give more --steps"):
        calibrate_fixture(empty.rig, tmp_path / "fixture.json", TAKING, angles=3)
    with pytest.raises(Saturated, match="saturated at 1 s: shorten --exposure"):
        calibrate_fixture(empty.rig, tmp_path / "fixture.json", Taking(1.0, frames=2), angles=6)
