"""Camera, stage and light behind Micro-Manager, on its own demo adapters."""

import json
from pathlib import Path

import numpy as np
import pytest

from anisoscope.base.errors import CameraError, NotConnected, RigFileError
from anisoscope.cli import run
from anisoscope.rig import micromanager
from anisoscope.rig.camera import Camera
from anisoscope.rig.drivers import open_camera, open_light, open_stage
from anisoscope.rig.light import Light
from anisoscope.rig.stage import RotationStage

pytest.importorskip("pymmcore", reason="pip install 'anisoscope[micromanager]'")
demo = pytest.importorskip("mm_test_adapters", reason="pip install mm-test-adapters (extra dev)")

CONFIG = """
Device,Camera,DemoCamera,DCam
Device,Stage,DemoCamera,DStage
Device,Lamp,DemoCamera,DShutter
Property,Core,Initialize,1
Property,Camera,PixelType,16bit
Property,Camera,BitDepth,12
Property,Core,Camera,Camera
Property,Core,Shutter,Lamp
"""
RIG = """
schema = 1
name = "micromanager"
[stage]
driver = "micromanager"
options = {{ config = "{0}", label = "Stage", home = "here", min_deg = -90.0, max_deg = 90.0 }}
[camera]
driver = "micromanager"
pixel_um = 8.0
options = {{ config = "{0}" }}
[light]
driver = "micromanager"
options = {{ config = "{0}" }}
"""


@pytest.fixture(autouse=True)
def adapters(monkeypatch):
    folder = str(Path(demo.__file__).parent / "libs")
    monkeypatch.setenv("MICROMANAGER_PATH", folder)
    return folder


@pytest.fixture
def config(tmp_path):
    path = tmp_path / "rig.cfg"
    path.write_text(CONFIG)
    yield str(path)
    assert micromanager.Core._open == {}, "everything is let go of"


@pytest.fixture
def opened(config):
    """``opened(opener, …)`` opens a device that is closed in the end."""
    devices = []

    def open_one(opener, **options):
        devices.append(opener("micromanager", config=config, **options))
        return devices[-1]

    yield open_one
    for device in devices:
        device.close()
        device.close()


def test_a_camera_gives_frames_with_the_settings_that_it_uses(opened):
    camera = opened(open_camera)
    assert isinstance(camera, Camera)
    assert (camera.info.rows, camera.info.cols, camera.info.bit_depth) == (512, 512, 12)
    assert camera.info.model == "DemoCamera DCam"
    assert camera.configure(0.02, 1.0).exposure_s == pytest.approx(0.02)
    first, second = camera.grab(), camera.grab()
    assert (first.shape, first.dtype) == ((512, 512), np.uint16)
    assert first.max() < 4096
    assert not np.array_equal(first, second), "a picture of its own each time"
    with pytest.raises(CameraError, match="needs the option gain_property"):
        camera.configure(0.02, 2.0)
    with pytest.raises(CameraError, match="must lie above 0"):
        camera.configure(-5.0, 1.0)


def test_a_gain_is_a_property_that_is_named(opened, config):
    camera = opened(open_camera, gain_property="Gain")
    assert camera.configure(0.01, 4.0).gain == 4.0
    with pytest.raises(CameraError, match=r"Micro-Manager reports: .*Gain"):
        camera.configure(0.01, 400.0)
    with pytest.raises(RigFileError, match="Camera has no 'Gamma'"):
        open_camera("micromanager", config=config, gain_property="Gamma")


def test_a_light_is_a_shutter(opened):
    light = opened(open_light)
    assert isinstance(light, Light)
    light.on()
    assert light._mm.getShutterOpen("Lamp")
    light.off()
    assert not light._mm.getShutterOpen("Lamp")


def test_a_stage_moves_in_its_own_units(opened):
    stage = opened(open_stage, label="Stage", units_per_deg=2.0, home="here", max_deg=90.0)
    assert isinstance(stage, RotationStage)
    assert stage.home() == 0.0
    assert stage.move_to(30.0) == pytest.approx(30.0, abs=0.01)
    assert stage._mm.getPosition("Stage") == pytest.approx(60.0, abs=0.02)
    assert stage.move_by(-10.0) == pytest.approx(20.0, abs=0.02)
    stage.stop()


def test_a_focus_drive_is_the_axis_z_of_a_rig(tmp_path, capsys):
    path = tmp_path / "focus.cfg"
    path.write_text(
        CONFIG.replace(
            "Property,Core,Camera", "Device,Z,DemoCamera,DStage\nProperty,Core,Focus,Z\nProperty,Core,Camera"
        )
    )
    rig = tmp_path / "rig.toml"
    limits = "min_mm = -0.3, max_mm = 5.0"
    rig.write_text(
        RIG.format(path)
        + f'[z]\ndriver = "micromanager"\noptions = {{ config = "{path}", home = "here", {limits} }}\n'
    )
    assert run(["rig", "move", "0.1234", "--axis", "z", "--rig", str(rig), "--yes", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["after_mm"] == pytest.approx(0.1234, abs=1e-6)
    with open_stage(
        "micromanager", config=str(path), unit="mm", home="here", min_deg=-1.0, max_deg=1.0
    ) as drive:
        drive.home()
        drive.move_to(0.2)
        assert drive._mm.getPosition("Z") == pytest.approx(200.0, abs=1e-3), "µm of Micro-Manager"
        assert drive._mm.getPosition("Stage") == 0.0
    assert run(["rig", "move", "1", "--axis", "z", "--rig", str(rig), "--yes"]) == 69
    said = capsys.readouterr().err
    assert "Z: Micro-Manager reports" in said
    assert "Position out of range" in said
    assert micromanager.Core._open == {}


BEADS = """
Property,Core,Focus,Z
Property,Camera,Mode,Fluorescent Beads
Property,Camera,BeadDensity,500
Property,Camera,BeadBrightness,8
Property,Camera,BeadSize,6
"""


def test_the_beads_of_its_demo_camera_are_brought_into_focus(tmp_path, capsys):
    """They are sharpest where its focus drive reads 0."""
    path, rig = tmp_path / "beads.cfg", tmp_path / "rig.toml"
    path.write_text(f"\nDevice,Z,DemoCamera,DStage{CONFIG}{BEADS}")
    options = f'{{ config = "{path}", home = "here", min_mm = -0.3, max_mm = 0.3 }}'
    rig.write_text(RIG.format(path) + f'[z]\ndriver = "micromanager"\noptions = {options}\n')
    sweep = ["--exposure", "0.01", "--from=-0.03", "--to", "0.04", "--steps", "9", "--repeat", "1"]
    assert run(["rig", "focus", "--rig", str(rig), *sweep, "--yes", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["best_mm"] == pytest.approx(0.0, abs=2e-4)
    assert found["half_width_mm"] > 0.003
    assert micromanager.Core._open == {}


def test_devices_of_one_file_share_a_core(opened):
    camera, light = opened(open_camera), opened(open_light)
    assert camera._mm is light._mm
    camera.close()
    light.on()


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        (("PixelType,16bit", "PixelType,32bitRGB"), RigFileError, "set a monochrome PixelType"),
        (("Camera,DemoCamera,DCam", "Camera,DemoCamera,DNone"), NotConnected, "check the cables"),
        (("BitDepth,12", "BitDepth,13"), NotConnected, "check the cables"),
    ],
)
def test_what_is_wrong_is_one_line(tmp_path, change, error, message):
    path = tmp_path / "wrong.cfg"
    path.write_text(CONFIG.replace(*change))
    with pytest.raises(error, match=message) as caught:
        open_camera("micromanager", config=str(path))
    assert "\n" not in str(caught.value)
    assert micromanager.Core._open == {}


def test_a_folder_of_adapters_that_is_missing_or_named(config, adapters, monkeypatch):
    monkeypatch.setenv("MICROMANAGER_PATH", "")
    with pytest.raises(RigFileError, match=r"no folder \(none is named\); name the folder"):
        open_light("micromanager", config=config)
    with pytest.raises(RigFileError, match="there is no folder /none"):
        open_light("micromanager", config=config, adapters="/none")
    open_light("micromanager", config=config, adapters=adapters).close()


def test_a_file_or_label_that_does_not_exist(config):
    with pytest.raises(RigFileError, match=r"there is no file /none\.cfg"):
        open_camera("micromanager", config="/none.cfg")
    with pytest.raises(RigFileError, match=r"it has no shutter Sun; devices: Camera, Stage, Lamp"):
        open_light("micromanager", config=config, label="Sun")
    with pytest.raises(RigFileError, match="home is 'device' or 'here'"):
        open_stage("micromanager", config=config, label="Stage", home="there")


def test_a_rig_of_micro_manager_alone_serves_the_commands(config, tmp_path, capsys):
    rig = tmp_path / "rig.toml"
    rig.write_text(RIG.format(config))
    assert run(["rig", "move", "12", "--rig", str(rig), "--yes", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["after_deg"] == pytest.approx(12.0, abs=0.01)
    picture = tmp_path / "a.tif"
    assert run(["rig", "snap", "--rig", str(rig), "--exposure", "0.01", "--out", str(picture), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["rows"] == 512
    assert run(["rig", "status", "--rig", str(rig)]) == 0
    assert "512 × 512 pixels of 8 µm" in capsys.readouterr().out
