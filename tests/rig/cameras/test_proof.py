"""The proof of the exposure convicts cameras that adjust themselves, and only those."""

import numpy as np
import pytest

from anisoscope.base.errors import CameraError, UsageError
from anisoscope.rig.camera import CameraInfo, CameraSettings
from anisoscope.rig.cameras.proof import prove_exposure


class Model:
    """A camera of 12 bits whose mean brightness is given by a function of exposure and frame number."""

    def __init__(self, signal, linear=True, black=64.0):
        self.signal, self.black = signal, black
        self.info = CameraInfo("model", "1", 20, 20, 12, black, linear=linear)
        self.rng = np.random.default_rng(0)
        self.taken = 0

    def configure(self, exposure_s, gain):
        self.settings = CameraSettings(exposure_s, gain)
        self.taken = 0
        return self.settings

    def grab(self):
        self.taken += 1
        mean = self.black + self.signal(self.settings.exposure_s, self.taken)
        counts = np.full((20, 20), mean) + self.rng.normal(0.0, 5.0, (20, 20))
        return np.clip(np.rint(counts), 0, 4095).astype(np.uint16)

    def close(self):
        pass


def test_a_linear_camera():
    proof = prove_exposure(Model(lambda t, _: 1e5 * t), (0.016, 0.004, 0.008))
    assert proof.exponents == pytest.approx((1.0, 1.0), abs=0.02)
    assert proof.exposures_s == (0.016, 0.004, 0.008, 0.016)
    assert proof.signals == pytest.approx((1600, 400, 800, 1600), rel=0.01)
    assert proof.drift < 0.01


def test_the_dark_level_counts():
    camera = Model(lambda t, _: 1e5 * t + 200.0)  # 200 counts of stray dark signal
    with pytest.raises(CameraError, match=r"the exposure grew x2 .*, the brightness x1\.67"):
        prove_exposure(camera, (0.004, 0.008))
    assert prove_exposure(camera, (0.004, 0.008), dark_counts=264.0).exponents == pytest.approx(
        (1.0,), abs=0.02
    )


@pytest.mark.parametrize(
    ("signal", "linear", "message"),
    [
        (lambda t, k: 1500.0, True, "the brightness x1: auto exposure or auto gain"),
        (lambda t, k: 1500.0, False, "the brightness x1: auto exposure or auto gain"),
        (lambda t, k: 1e5 * t**1.5 * 10, False, "the brightness x"),
        (lambda t, k: 20e3 * t**0.5, True, r"x4 .*, the brightness x2: auto"),
        (lambda t, k: 1e5 * t * (1.0 + 0.1 * k), True, "% while the exposure stands at 0.004 s"),
    ],
)
def test_cameras_that_adjust_themselves(signal, linear, message):
    with pytest.raises(CameraError, match=message):
        prove_exposure(Model(signal, linear), (0.004, 0.016))


def test_a_camera_that_does_not_come_back():
    camera = Model(None)
    changes = []

    def signal(exposure_s, taken):
        changes.append(exposure_s)
        return 1e5 * exposure_s * (0.8 if changes.count(0.004) > 3 else 1.0)

    camera.signal = signal
    with pytest.raises(CameraError, match=r"does not come back with the exposure of 0\.004 s"):
        prove_exposure(camera, (0.004, 0.016))


@pytest.mark.parametrize(
    ("level", "message"),
    [(2e3, "too dark for a proof.*switch the light on"), (3e5, "too bright for a proof")],
)
def test_a_scene_that_proves_nothing(level, message):
    with pytest.raises(CameraError, match=message):
        prove_exposure(Model(lambda t, _: level * t), (0.016, 0.004))


def test_a_camera_that_takes_all_exposures_as_one():
    camera = Model(lambda t, _: 1e5 * t)
    configure = camera.configure
    camera.configure = lambda exposure_s, gain: configure(0.008, gain)
    with pytest.raises(CameraError, match=r"takes all of these exposures as 0\.008 s"):
        prove_exposure(camera, (0.006, 0.01))


@pytest.mark.parametrize("exposures_s", [(), (0.01,), (0.01, 0.012)])
def test_exposures_that_prove_nothing(exposures_s):
    with pytest.raises(UsageError, match="needs two exposures that differ"):
        prove_exposure(Model(lambda t, _: 1e5 * t), exposures_s)
