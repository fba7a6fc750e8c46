"""A camera with a gamma curve is told to be uncalibrated until its response curve is taken; then it measures."""

from dataclasses import replace

import numpy as np
import pytest

from anisoscope.base.errors import CalibrationError, RigFileError
from anisoscope.calibration.linearity import calibrate_response
from anisoscope.calibration.pictures import take_flat
from anisoscope.cli import run
from anisoscope.inspection.recompute import recompute
from anisoscope.inspection.replay import inspect_frames
from anisoscope.parameters.taking import Taking
from anisoscope.rig.cameras.response import ResponseCurve, read_response, write_response
from anisoscope.rig.drivers import open_camera
from anisoscope.rig.frame import read_frame
from anisoscope.rig.framefolder import write_frame_folder

GAMMA = 2.2
WEBCAM = {"bit_depth": 8, "black_level": 2.0, "gain_e_per_dn": 110.0, "gamma": GAMMA, "auto_exposure": "off"}
CLIPS_S = 0.0045


def lay_out(virtual_rig, name, **camera):
    """A part under such a camera, with a flat that it took itself."""
    options = {"camera": {"options": camera}}
    tile = virtual_rig(
        f"{name}-tile", bench={"sample": {"kind": "white-tile"}, "sensor": WEBCAM}, rig=options
    )
    flat = tile.rig.with_name("flat.tif")
    take_flat(tile.rig, flat, exposure_s=0.0015, frames=16)
    return virtual_rig(
        name,
        recipe={
            "acquisition": {"exposure_s": 0.003, "frames_per_pose": 8},
            "surface": {"reflections": "direct"},
        },
        bench={"sensor": WEBCAM, "sample": {"reflections": False}},  # direct light is predicted to 1 %
        rig={**options, "calibration": {"flat": str(flat)}},
    )


@pytest.fixture
def curve(virtual_rig, capsys):
    """The curve as the command takes it."""
    rig = virtual_rig("curve", bench={"sensor": WEBCAM})
    path = rig.rig.with_name("response.json")
    order = ["calibrate", "response", "-g", rig.rig, "--out", path, "--exposure", CLIPS_S]
    assert run([str(word) for word in order]) == 0
    assert "name it in the rig file under [camera.options] response" in capsys.readouterr().out
    return read_response(path), path


def test_the_curve_is_the_gamma_of_the_camera(curve):
    found, _ = curve
    counts = np.arange(40, 240)
    share = (counts - WEBCAM["black_level"]) / (255 - WEBCAM["black_level"])
    light = np.asarray(found.light)[counts]
    ratio = light / share**GAMMA
    np.testing.assert_allclose(ratio / np.median(ratio), 1.0, atol=0.03)


def test_uncalibrated_is_written_down_until_the_curve_is_given(virtual_rig, curve):
    _, path = curve
    bent = virtual_rig(bench={"sensor": WEBCAM})
    record = bent.inspect().record
    assert record.verdict != "PASS"
    assert record.notes[0].startswith("uncalibrated: the camera does not count in proportion to light")
    assert recompute(bent.folders[0]).differences == ()
    found = lay_out(virtual_rig, "good", response=str(path)).inspect().record
    assert found.verdict == "PASS", found.reasons
    assert not any("uncalibrated" in note for note in found.notes)
    for pair in found.details.contrasts:
        assert pair.measured == pytest.approx(pair.predicted, rel=0.03)


def test_folders_of_frames_are_read_through_the_curve(virtual_rig, curve, undiagnosed, tmp_path):
    _, path = curve
    bent = lay_out(virtual_rig, "bent").inspect(methods=undiagnosed)
    frames = [replace(read_frame(bent.folder / one.name), serial=None) for one in bent.record.frames]
    again = [one.again for one in bent.record.frames]
    write_frame_folder(tmp_path / "frames", frames, again)

    def judged(rig, folder="frames"):
        how = {"rig_path": rig.rig, "methods": undiagnosed}
        return inspect_frames(tmp_path / folder, rig.recipe, "F-1", tmp_path / "out", **how)

    found = judged(lay_out(virtual_rig, "good", response=str(path)))
    assert found.record.verdict == "PASS", found.record.reasons
    assert not any("uncalibrated" in note for note in found.record.notes)
    for pair in found.record.details.contrasts:
        assert pair.measured == pytest.approx(pair.predicted, rel=0.03)
    path.rename(path.with_name("gone.json"))  # the inspection has its own copy
    again_found = recompute(found.folder).differences
    diagnosed = ("details.", "diagnosis", "notes")  # with the note that sink marks are not judged
    assert [one for one in again_found if not one.startswith(diagnosed)] == []
    path.with_name("gone.json").rename(path)

    stated = lay_out(virtual_rig, "stated")
    text = stated.rig.read_text(encoding="utf-8")
    stated.rig.write_text(
        text.replace("[camera.options]", "[camera.options]\nlinear = false"), encoding="utf-8"
    )
    told = judged(stated).record
    assert told.notes[0].startswith("uncalibrated: the camera does not count in proportion to light")
    other = [replace(frame, camera="another 7") for frame in frames]
    write_frame_folder(tmp_path / "other", other, again)
    with pytest.raises(RigFileError, match="of camera another 7"):
        judged(lay_out(virtual_rig, "foreign", response=str(path)), "other")


def test_a_curve_of_another_camera_and_a_camera_that_is_linear(virtual_rig, tmp_path):
    made = ResponseCurve(
        schema=1,
        camera="SOMEBODY",
        bit_depth=8,
        black_level=2.0,
        white_level=255,
        light=tuple(np.linspace(0.0, 1.0, 256)),
        residual=0.0,
        exposures_s=(0.1, 0.2, 0.4),
    )
    other = tmp_path / "other.json"
    write_response(other, made)
    bench = virtual_rig("other", bench={"sensor": WEBCAM}).rig.with_name("bench.toml")
    with pytest.raises(RigFileError, match="belongs to camera SOMEBODY"):
        open_camera("simulated", bench=str(bench), response=str(other))
    with pytest.raises(CalibrationError, match="counts in proportion to light already"):
        calibrate_response(virtual_rig("linear").rig, tmp_path / "no.json", Taking(CLIPS_S))
    assert not (tmp_path / "no.json").exists()
