"""The replaying camera: frames in the order of the table, with their settings, and then no more."""

from dataclasses import replace

import numpy as np
import pytest

from anisoscope.base.errors import CameraError, RigFileError
from anisoscope.rig.camera import Camera
from anisoscope.rig.cameras.folder import FolderCamera
from anisoscope.rig.drivers import open_camera
from anisoscope.rig.frame import Frame
from anisoscope.rig.framefolder import write_frame_folder


def frame(number, kind="sample", exposure_s=0.01, **changes):
    counts = np.full((6, 8), 100 * number + 1, np.uint16)
    made = Frame(counts, kind, 12, 64.0, exposure_s, 1.5, 90.0 * number, 0.0, 0.0, "", "C 7")
    return replace(made, **changes)


FRAMES = [frame(0, "dark"), frame(1), frame(2), frame(3, "flat", 0.02)]


@pytest.fixture
def folder(tmp_path):
    write_frame_folder(tmp_path / "old", FRAMES)
    return tmp_path / "old"


def served(camera, count):
    return [int(camera.grab()[0, 0]) for _ in range(count)]


def test_frames_come_in_the_order_of_the_table(folder):
    camera = open_camera("folder", folder=str(folder), serial="C-7")
    assert isinstance(camera, Camera)
    info = camera.info
    assert (info.rows, info.cols, info.bit_depth, info.black_level, info.linear) == (6, 8, 12, 64.0, True)
    assert (info.model, info.serial) == ("frames of old", "C-7")
    settings = camera.configure(0.010000001, 1.5)
    assert (settings.exposure_s, settings.gain) == (0.01, 1.5)
    assert served(camera, 3) == [1, 101, 201]
    camera.configure(0.02, 1.5)
    counts = camera.grab()
    assert (counts.dtype, counts.shape) == (np.uint16, (6, 8))
    assert camera.left == 0
    with pytest.raises(CameraError, match="all 4 frames were served; the plan asks for more"):
        camera.grab()
    with pytest.raises(CameraError, match="all 4 frames were served"):
        camera.configure(0.01, 1.5)
    camera.close()


def test_settings_that_are_not_those_of_the_recording(folder):
    camera = FolderCamera.open(folder=folder)
    for exposure_s, gain in ((0.02, 1.5), (0.01, 1.0)):
        with pytest.raises(
            CameraError, match=r"was taken with 0\.01 s and gain 1\.5, but .* replay with the plan"
        ):
            camera.configure(exposure_s, gain)
    with pytest.raises(CameraError, match="before exposure and gain were set"):
        camera.grab()
    camera.configure(0.01, 1.5)
    served(camera, 3)
    with pytest.raises(CameraError, match=r"003_flat.*was taken with 0\.02 s"):
        camera.grab()  # the plan did not change the exposure where the recording did
    assert camera.left == 1


def test_only_some_kinds(folder):
    camera = FolderCamera.open(folder=folder, kinds="dark, sample", linear=False)
    assert camera.left == 3
    assert not camera.info.linear
    camera = FolderCamera.open(folder=folder, kinds="sample")
    camera.configure(0.01, 1.5)
    assert served(camera, 2) == [101, 201]


def test_round_and_round(folder):
    camera = FolderCamera.open(folder=folder, kinds="sample", repeat=True)
    camera.configure(0.01, 1.5)
    assert served(camera, 5) == [101, 201, 101, 201, 101]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"kinds": "smple"}, "kinds: unknown: smple; known: sample, dark, flat, stray, reference"),
        ({"kinds": "stray"}, "holds no frames of kind stray"),
        ({"folder": "no"}, "folder: no: there is no such folder"),
    ],
)
def test_options_that_make_no_sense(folder, options, message):
    with pytest.raises(RigFileError, match=message):
        FolderCamera.open(**({"folder": folder} | options))


def test_the_filters_are_those_of_the_frames(folder, tmp_path):
    assert FolderCamera.open(folder=folder).info.filters == "mono"
    write_frame_folder(tmp_path / "colour", [replace(one, filters="bggr") for one in FRAMES])
    assert FolderCamera.open(folder=tmp_path / "colour").info.filters == "bggr"


def test_one_camera_has_one_bit_depth(tmp_path):
    write_frame_folder(tmp_path / "two", [frame(0), frame(1, bit_depth=10)])
    with pytest.raises(RigFileError, match="bit_depth and black_level change from frame to frame"):
        FolderCamera.open(folder=tmp_path / "two")


def test_files_that_go_away_or_change(folder):
    camera = FolderCamera.open(folder=folder)
    camera.configure(0.01, 1.5)
    first, second = sorted(folder.glob("*.tif"))[:2]
    second.write_bytes(first.read_bytes())
    first.unlink()
    with pytest.raises(CameraError, match="there is no such file"):
        camera.grab()
    assert camera.left == 4
