import numpy as np
import pytest

from anisoscope.base.errors import CameraError
from anisoscope.rig.camera import Camera
from anisoscope.rig.drivers import open_camera, open_light
from anisoscope.rig.light import Light


@pytest.fixture
def devices(bench_path):
    path = str(bench_path(sample={"kind": "white-tile"}))
    return open_camera("simulated", bench=path), open_light("simulated", bench=path)


def test_drivers_are_found_by_name_and_are_a_camera_and_a_light(devices):
    camera, light = devices
    assert isinstance(camera, Camera)
    assert isinstance(light, Light)


def test_frames_are_what_the_camera_says_of_itself(devices):
    camera, light = devices
    settings = camera.configure(0.004, 1.0)
    assert (settings.exposure_s, settings.gain) == (0.004, 1.0)
    light.on()
    counts = camera.grab()
    info = camera.info
    assert (counts.dtype, counts.shape) == (np.uint16, (info.rows, info.cols))
    assert counts.max() < 2**info.bit_depth


def test_black_level_is_the_mean_without_light(devices):
    camera, light = devices
    camera.configure(1e-4, 1.0)
    light.off()
    assert camera.grab().mean() == pytest.approx(camera.info.black_level, abs=0.1)


def test_closing_the_light_switches_it_off(devices):
    camera, light = devices
    camera.configure(0.004, 1.0)
    light.on()
    bright = camera.grab().mean()
    light.close()
    assert camera.grab().mean() < 0.1 * bright


@pytest.mark.parametrize(
    ("exposure_s", "gain"), [(0.0, 1.0), (61.0, 1.0), (np.nan, 1.0), (0.01, 0.0), (0.01, 25.0)]
)
def test_settings_outside_the_range_are_refused(devices, exposure_s, gain):
    with pytest.raises(CameraError, match="must lie between"):
        devices[0].configure(exposure_s, gain)


def test_a_frame_before_the_settings_is_refused(devices):
    with pytest.raises(CameraError, match="before exposure"):
        devices[0].grab()
