"""Response curves: known ones come back, from noisy 8-bit frames; frames that do not agree are refused."""

import json
from dataclasses import replace

import numpy as np
import pytest

from anisoscope.base.errors import CalibrationError, RigFileError
from anisoscope.rig.cameras.response import (
    LINEAR_BLACK,
    fit_response,
    read_response,
    write_response,
)
from anisoscope.rig.cameras.uvc import UvcCamera
from anisoscope.rig.frame import Frame

TIMES = 0.002 * 2.0 ** np.arange(6)
SHAPE = (90, 120)


def srgb(light):
    return np.where(light < 0.0031308, 12.92 * light, 1.055 * np.maximum(light, 1e-9) ** (1 / 2.4) - 0.055)


CURVES = {
    "linear": lambda light: light,
    "power": lambda light: light ** (1 / 2.2),
    "srgb": srgb,
    "logarithm": lambda light: np.log1p(20.0 * light) / np.log(21.0),
}


def scene(rng):
    """Relative light of a second of exposure; the longest exposure just clips the brightest place."""
    return np.exp(rng.uniform(np.log(0.03), 0.0, SHAPE)) / TIMES[-2]


def photograph(light, curve, rng, black=0, white=255):
    electrons = rng.poisson(np.maximum(light, 0.0) * 8000.0)
    exposed = np.clip(electrons / 8000.0 + rng.normal(0.0, 0.001, light.shape), 0.0, 1.0)
    counts = black + (white - black) * curve(exposed) + rng.normal(0.0, 0.4, light.shape)
    return np.clip(np.rint(counts), 0, white).astype(np.uint16)


def frame(counts, time_s, black=0.0, kind="sample"):
    return Frame(counts, kind, 8, black, time_s, 1.0, 0.0, 0.0, 0.0, "", "CAM 77")


def series(curve, rng, black=0, white=255, repeats=4):
    still = scene(rng)
    return [
        frame(photograph(still * t, curve, rng, black, white), t, black)
        for t in TIMES
        for _ in range(repeats)
    ]


@pytest.mark.parametrize(("black", "white"), [(0, 255), (16, 235)])
@pytest.mark.parametrize("name", CURVES)
def test_a_known_curve_comes_back(name, black, white):
    curve = CURVES[name]
    fitted = fit_response(series(curve, np.random.default_rng(1), black, white), white_level=white)
    light = np.geomspace(0.01, 1.0, 400)
    light = light[curve(light) < 0.98]
    found = np.interp(black + (white - black) * curve(light), np.arange(256), fitted.light)
    ratio = found / light
    ratio /= np.median(ratio)  # the scale of light is free
    assert np.max(np.abs(ratio[light > 0.03] - 1.0)) < 0.012
    assert np.max(np.abs(ratio - 1.0)) < 0.025
    assert fitted.residual < 0.012
    assert (fitted.black_level, fitted.white_level, fitted.camera) == (black, white, "CAM 77")
    assert np.all(np.diff(fitted.light) >= 0.0)


def test_black_is_that_of_the_dark_frames():
    rng = np.random.default_rng(2)
    linear = CURVES["linear"]
    darks = [frame(photograph(np.zeros(SHAPE), linear, rng, black=20), 0.01, kind="dark") for _ in range(4)]
    frames = [replace(one, black_level=0.0) for one in series(linear, rng, black=20)]
    fitted = fit_response(frames, darks)
    assert fitted.black_level == pytest.approx(20.0, abs=0.3)
    half, full = fitted.light[round(20 + 0.5 * 235 * 0.9)], fitted.light[round(20 + 235 * 0.9)]
    assert half / full == pytest.approx(0.5, rel=0.015)
    with pytest.raises(CalibrationError, match="black is not what was said"):
        fit_response(frames)  # which say that it is 0


def test_linearised_counts_follow_the_exposure():
    """The point of it all: mean counts of a curved camera, in proportion to the exposure."""
    rng = np.random.default_rng(3)
    fitted = fit_response(series(CURVES["power"], rng))
    still = np.full(SHAPE, 0.8 / TIMES[-1])
    means = [
        fitted.linearise(photograph(still * t, CURVES["power"], rng).astype(np.uint8)).mean() for t in TIMES
    ]
    rates = (np.array(means) - LINEAR_BLACK) / TIMES
    np.testing.assert_allclose(rates[1:], rates[-1], rtol=0.02)


def test_black_and_white_of_linearised_counts():
    fitted = fit_response(series(CURVES["srgb"], np.random.default_rng(4), 16, 235), white_level=235)
    table = fitted.linearise(np.arange(256, dtype=np.uint8))
    assert table.dtype == np.uint16
    assert table[16] == LINEAR_BLACK
    assert (table[235:] == 65535).all()
    assert (np.diff(table.astype(int)) >= 0).all()
    # noise about black is not cut off: it averages to black
    assert 0 < table[14] < table[16]
    assert int(table[18]) - int(table[16]) == pytest.approx(int(table[16]) - int(table[14]), rel=0.3)


def test_a_curve_survives_the_disk(tmp_path):
    fitted = fit_response(series(CURVES["srgb"], np.random.default_rng(5)))
    write_response(tmp_path / "curve.json", fitted)
    assert read_response(tmp_path / "curve.json") == fitted
    assert json.loads((tmp_path / "curve.json").read_text())["schema"] == 1


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"schema": 2}, "schema"),
        ({"light": [0.0] * 255}, "light needs 256 values, not 255"),
        ({"light": [0.0] * 100 + [1.0] + [0.5] * 155}, "light falls somewhere"),
        ({"light": [float("nan")] * 256}, "finite"),
        ({"white_level": 300}, "white_level must lie above black_level"),
        ({"residual": None}, "residual"),
        ({"more": 1}, "more"),
    ],
)
def test_files_that_hold_no_curve(tmp_path, change, message):
    fitted = fit_response(series(CURVES["srgb"], np.random.default_rng(5), repeats=1))
    path = tmp_path / "curve.json"
    path.write_text(json.dumps(fitted.model_dump(by_alias=True) | change))
    with pytest.raises(CalibrationError, match=message) as caught:
        read_response(path)
    assert "\n" not in str(caught.value)


def test_a_file_that_is_not_there(tmp_path):
    with pytest.raises(CalibrationError, match="cannot be read: No such file"):
        read_response(tmp_path / "no.json")
    (tmp_path / "bad.json").write_text("{")
    with pytest.raises(CalibrationError, match="not a response curve: Invalid JSON"):
        read_response(tmp_path / "bad.json")


# -- frames that give no curve ---------------------------------------------------------------------------------


def test_auto_exposure_gives_no_curve():
    rng = np.random.default_rng(6)
    still = scene(rng)
    frames = []
    for t in TIMES:
        light = still * t
        gain = (0.3 / light.mean()) ** 0.7  # fights back, mostly
        frames.append(frame(photograph(light * gain, CURVES["linear"], rng), t))
    with pytest.raises(CalibrationError, match="auto exposure was on"):
        fit_response(frames)


def test_a_scene_that_moves_gives_no_curve():
    rng = np.random.default_rng(7)
    still = scene(rng)
    frames = [
        frame(photograph(np.roll(still, 7 * k) * t, CURVES["power"], rng), t) for k, t in enumerate(TIMES)
    ]
    with pytest.raises(CalibrationError, match=r"the scene moved|hardly any place"):
        fit_response(frames)


def test_light_that_changes_gives_no_curve():
    rng = np.random.default_rng(8)
    still = scene(rng)
    frames = [
        frame(photograph(still * t * (1.3 if k % 2 else 1.0), CURVES["power"], rng), t)
        for k, t in enumerate(TIMES)
    ]
    with pytest.raises(CalibrationError, match="light changed"):
        fit_response(frames)


def flat(level, t):
    return frame(np.full(SHAPE, level, np.uint16), t)


@pytest.mark.parametrize(
    ("frames", "message"),
    [
        ([flat(10, 0.01), flat(20, 0.02)], "3 exposures or more, not 2"),
        ([flat(20, 0.01), flat(40, 0.02), flat(80, 0.04)], "cover only 8 % to 31 % of the range"),
        ([flat(255, 0.01), flat(255, 0.02), flat(255, 0.04)], "neither black nor clipped in two exposures"),
        ([flat(20, 0.01), flat(40, 0.02), replace(flat(80, 0.04), gain=2.0)], "differ in size, gain"),
    ],
)
def test_frames_from_which_no_curve_can_come(frames, message):
    with pytest.raises(CalibrationError, match=message):
        fit_response(frames)


# -- a camera with a curve -------------------------------------------------------------------------------------


@pytest.fixture
def gamma_camera(fake_uvc):
    def open_it(**options):
        light = np.tile(np.geomspace(0.5, 30.0, 64), (48, 1))
        device = fake_uvc(light, exponent=1 / 2.2)
        return UvcCamera.open(backend="v4l2", serial="A1", capture=lambda *_: device, **options)

    return open_it


def take_series(camera):
    frames = []
    for exposure_s in 0.001 * 2.0 ** np.arange(6):
        settings = camera.configure(exposure_s, 1.0)
        taken = [frame(camera.grab(), settings.exposure_s) for _ in range(4)]
        frames.extend(replace(one, camera="UVC camera 0 A1") for one in taken)
    return frames


def test_a_camera_becomes_linear_by_its_curve(gamma_camera, tmp_path):
    raw = gamma_camera()
    assert not raw.info.linear
    write_response(tmp_path / "curve.json", fit_response(take_series(raw)))
    raw.close()
    camera = gamma_camera(response=tmp_path / "curve.json")
    assert camera.info.linear
    assert (camera.info.bit_depth, camera.info.black_level) == (16, LINEAR_BLACK)
    proof = camera.prove_exposure((0.008, 0.016, 0.032), tolerance=0.02)  # in proportion now
    assert proof.exponents == pytest.approx((1.0, 1.0), abs=0.02)
    camera.close()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"serial": "B2"}, "belongs to camera UVC camera 0 A1, this is B2"),
        ({"white_level": 235}, "is for 8 bits and white_level 255, this camera has 8 and 235"),
        ({"response": "no.json"}, "response: no.json: cannot be read"),
    ],
)
def test_a_curve_that_is_not_this_cameras(gamma_camera, fake_uvc, tmp_path, options, message):
    raw = gamma_camera()
    write_response(tmp_path / "curve.json", fit_response(take_series(raw)))
    raw.close()
    device = fake_uvc(np.ones((48, 64)))
    options = {"serial": "A1", "response": tmp_path / "curve.json"} | options
    with pytest.raises(RigFileError, match=message):
        UvcCamera.open(backend="v4l2", capture=lambda *_: device, **options)
    assert device.released == 1
