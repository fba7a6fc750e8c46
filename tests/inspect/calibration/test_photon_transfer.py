"""What was set in the virtual sensor comes back within 2 %, from its frames alone (EMVA 1288)."""

import math

import numpy as np
import pytest

from anisoscope.base.errors import CalibrationError, UsageError
from anisoscope.calibration.linearity import ExposureStep, photo_transfer
from anisoscope.sim.bench.benchfile import SensorPart
from anisoscope.sim.bench.sensor import Sensor

ELECTRONS_PER_S = 30_000.0
EXPOSURES = np.concatenate([np.linspace(0.01, 0.85, 16), np.arange(0.87, 1.05, 0.01), [1.3, 1.5]])


def sensor(seed=1, **fields):
    values = {
        "rows": 256,
        "cols": 256,
        "hot_pixel_share": 0.0,
        "bit_depth": 14,
        "gain_e_per_dn": 2.5,
    } | fields
    return Sensor(SensorPart(**values), np.random.default_rng(seed))


def frames(device, count, exposure_s, *, lit, shade=1.0):
    shape = (device.part.rows, device.part.cols)
    signal = np.broadcast_to(ELECTRONS_PER_S * exposure_s * shade * lit, shape)
    return np.stack([device.expose(signal, exposure_s, 1.0) for _ in range(count)])


def steps_of(device, exposures=EXPOSURES):
    return [
        ExposureStep(float(t), frames(device, 2, t, lit=True), frames(device, 2, t, lit=False))
        for t in exposures
    ]


def analysed(count=40, shade=1.0, highpass_px=0, exposures=EXPOSURES, **fields):
    device = sensor(**fields)
    half = {"exposure_s": 0.5, "count": count}
    light, dark = (frames(device, lit=lit, shade=shade, **half) for lit in (True, False))
    return photo_transfer(steps_of(device, exposures), light, dark, highpass_px=highpass_px)


@pytest.mark.parametrize(
    "set_to",
    [
        {"gain_e_per_dn": 2.5, "read_noise_e": 6.0, "prnu": 0.01, "dsnu_e": 8.0, "full_well_e": 30_000.0},
        {"gain_e_per_dn": 1.9, "read_noise_e": 15.0, "prnu": 0.02, "dsnu_e": 20.0, "full_well_e": 27_000.0},
    ],
)
def test_what_was_set_comes_back_within_two_percent(set_to):
    found = analysed(dark_current_e_s=400.0, **set_to)
    assert 1.0 / found.gain_dn_per_e.value == pytest.approx(set_to["gain_e_per_dn"], rel=0.02)
    assert found.read_noise_e.value == pytest.approx(set_to["read_noise_e"], rel=0.02)
    assert found.dark_current_e_s.value == pytest.approx(400.0, rel=0.02)
    assert found.dsnu_e.value == pytest.approx(set_to["dsnu_e"], rel=0.02)
    assert found.prnu.value == pytest.approx(set_to["prnu"], rel=0.02)
    # in light the dark current fills the well too, and is subtracted again
    assert found.clipping_e.value == pytest.approx(set_to["full_well_e"] - 400.0 * 1.4, rel=0.02)
    # EMVA's saturation lies where the first pixels clip: a few spreads of shot noise and PRNU below
    spread = math.hypot(set_to["prnu"], 1.0 / math.sqrt(set_to["full_well_e"]))
    assert -5.0 * spread - 0.01 < found.saturation_e.value / set_to["full_well_e"] - 1.0 < 0.0
    assert found.dark_level_dn.value == pytest.approx(64.0, abs=0.1)
    assert found.linearity_error < 0.001
    assert found.snr_max == pytest.approx(math.sqrt(found.saturation_e.value))
    expected = found.saturation_e.value / (found.dark_noise_e.value + 0.5)
    assert found.dynamic_range == pytest.approx(expected, rel=0.02)


def test_saturation_is_where_shot_noise_is_largest():
    """Without fixed pattern and dark current, EMVA's maximum lies a few standard deviations below the full well."""
    found = analysed(8, prnu=0.0, dsnu_e=0.0, dark_current_e_s=0.0, full_well_e=29_000.0)
    below = (29_000.0 - found.saturation_e.value) / math.sqrt(29_000.0)
    assert -0.5 < below < 5.0
    assert found.saturation_e.uncertainty < 0.02 * 29_000.0


def test_uncertainties_are_as_large_as_the_errors():
    truth = {
        "gain_e_per_dn": 2.5,
        "read_noise_e": 6.0,
        "dsnu_e": 8.0,
        "prnu": 0.01,
        "dark_current_e_s": 400.0,
    }
    names = ("read_noise_e", "dsnu_e", "prnu", "dark_current_e_s")
    pulls = []
    for seed in range(12):
        found = analysed(16, seed=seed, rows=96, cols=96, exposures=EXPOSURES[::2], **truth)
        pulls.append((found.gain_dn_per_e.value - 0.4) / found.gain_dn_per_e.uncertainty)
        for name in names:
            estimate = getattr(found, name)
            pulls.append((estimate.value - truth[name]) / estimate.uncertainty)
    assert 0.6 < np.sqrt(np.mean(np.square(pulls))) < 1.6


@pytest.mark.parametrize("bend", [pytest.param(0.02, marks=pytest.mark.soak), 0.06, -0.03])
def test_a_bent_response_shows_as_linearity_error(bend):
    found = analysed(8, nonlinearity=bend, prnu=0.0, dsnu_e=0.0, dark_current_e_s=0.0, rows=128, cols=128)
    # the same line through the response without any noise
    x = EXPOSURES[:16] * ELECTRONS_PER_S
    x = x[(x > 0.05 * 29_500.0) & (x < 0.95 * 29_500.0)]
    y = x * (1.0 - bend * x / 30_000.0)
    slope, offset = np.polyfit(x, y, 1, w=1.0 / y)
    ideal = np.mean(np.abs(y / (offset + slope * x) - 1.0))
    assert found.linearity_error == pytest.approx(ideal, rel=0.25)
    assert found.linearity_error > 10 * analysed(8, rows=128, cols=128).linearity_error
    assert found.linearity_peak > found.linearity_error


def test_uneven_light_is_no_prnu_after_a_high_pass():
    ramp = np.linspace(0.8, 1.2, 256)[None, :] * np.ones((256, 1))
    plain = analysed(24, shade=ramp, prnu=0.01, exposures=EXPOSURES[::4])
    passed = analysed(24, shade=ramp, prnu=0.01, highpass_px=11, exposures=EXPOSURES[::4])
    assert plain.prnu.value > 0.1
    assert passed.prnu.value == pytest.approx(0.01 * math.sqrt(np.mean(ramp**2)), rel=0.03)


def test_one_exposure_and_several_lamps_know_no_dark_current():
    device = sensor(rows=64, cols=64)
    steps = []
    for amount in EXPOSURES:
        light = np.full((64, 64), ELECTRONS_PER_S * amount)
        lit = np.stack([device.expose(light, 0.01, 1.0) for _ in range(2)])
        steps.append(ExposureStep(0.01, lit, frames(device, 2, 0.01, lit=False), float(amount)))
    stack, dark = (frames(device, 8, 0.4, lit=lit) for lit in (True, False))
    found = photo_transfer(steps, stack, dark)
    assert found.dark_current_e_s is None
    assert 1.0 / found.gain_dn_per_e.value == pytest.approx(2.5, rel=0.05)


def test_a_series_that_does_not_saturate_is_refused():
    with pytest.raises(CalibrationError, match="still grows"):
        analysed(8, rows=64, cols=64, exposures=np.linspace(0.01, 0.8, 8))


def test_frames_without_light_are_refused():
    device = sensor(rows=64, cols=64, read_noise_e=20.0)
    dark = frames(device, 8, 0.01, lit=False)
    steps = [ExposureStep(0.01 + 0.01 * n, dark[:2], dark[2:4]) for n in range(7)]
    with pytest.raises(CalibrationError, match=r"does not grow|is it light|not brighter"):
        photo_transfer(steps, dark, dark)


def test_wrong_shapes_and_too_few_frames():
    device = sensor(rows=64, cols=64)
    steps = steps_of(device, EXPOSURES[::3])
    stack = frames(device, 8, 0.4, lit=True)
    with pytest.raises(UsageError, match="at least 6 exposures"):
        photo_transfer(steps[:3], stack, stack)
    with pytest.raises(UsageError, match="stacks of at least 8"):
        photo_transfer(steps, stack[:3], stack)
    with pytest.raises(UsageError, match=r"light frames of .* have shape"):
        photo_transfer(steps, stack[:, :32], stack[:, :32])
