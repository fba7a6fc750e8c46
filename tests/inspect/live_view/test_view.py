"""What a live picture is judged by: identities, and the truth of the virtual rig."""

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest

from anisoscope.live_view.view import (
    Meter,
    View,
    focus_of,
    histogram_of,
    look_at,
    ridge_direction,
    saturated_share,
    signal_of,
    wrapped_deg,
)
from anisoscope.rig.bayer import channel_of_pixels
from anisoscope.rig.camera import CameraInfo

INFO = CameraInfo("test", "1", rows=240, cols=320, bit_depth=12, black_level=64.0)
FULL = 4095


def grating(angle_deg, pitch_px=14.3, shape=(240, 320), level=0.4, depth=0.2):
    """Ridges at an angle counter-clockwise from the picture's upright, as a share of full scale."""
    rows, cols = np.indices(shape)
    across = cols * math.cos(math.radians(angle_deg)) - rows * math.sin(math.radians(angle_deg))
    return (level + depth * np.cos(2.0 * np.pi * across / pitch_px)).astype(np.float32)


def counts_of(signal):
    return np.rint(np.clip(signal, 0.0, 1.0) * (FULL - 64) + 64).astype(np.uint16)


@pytest.mark.parametrize("angle_deg", [0.0, 12.5, 45.0, 89.0, 90.0, -30.0, -89.5])
@pytest.mark.parametrize("pitch_px", [6.0, 14.3, 30.0])
def test_direction_of_a_grating(angle_deg, pitch_px, rng):
    picture = grating(angle_deg, pitch_px) + 0.02 * rng.standard_normal((240, 320)).astype(np.float32)
    found, _ = ridge_direction(picture)
    assert abs(wrapped_deg(found - angle_deg)) < 0.3


def test_direction_does_not_depend_on_exposure_and_shading():
    shade = np.linspace(0.3, 1.0, 320, dtype=np.float32)[None, :]
    plain, _ = ridge_direction(grating(20.0))
    shaded, _ = ridge_direction(0.2 * shade * grating(20.0))
    assert shaded == pytest.approx(plain, abs=0.3)


@pytest.mark.parametrize(
    "picture",
    [
        lambda rng: 0.3 + 0.02 * rng.standard_normal((240, 320)),
        lambda rng: cv2.GaussianBlur(0.3 + 0.3 * rng.standard_normal((240, 320)), (0, 0), 3.0),
        lambda rng: 0.5 * (grating(10.0) + grating(100.0)),
        lambda rng: np.full((240, 320), 0.3),
        lambda rng: np.tile(np.linspace(0.1, 0.9, 320), (240, 1)),
        lambda rng: 0.001 * grating(10.0),
        lambda rng: grating(10.0)[:40, :40],
    ],
    ids=["noise", "blobs", "crossed", "even", "shaded", "dark", "tiny"],
)
def test_direction_is_undefined_where_there_is_none(picture, rng):
    assert ridge_direction(picture(rng).astype(np.float32))[0] is None


@pytest.mark.parametrize(
    "angle_deg", [30.0, *(pytest.param(one, marks=pytest.mark.soak) for one in (0.0, 90.0))]
)
def test_direction_is_the_angle_of_the_sample_on_the_virtual_rig(virtual_rig, angle_deg):
    from anisoscope.sim.bench.camera import SimulatedCamera

    bench = virtual_rig(bench={"sample": {"resolved_alpha": 0.01, "size_mm": 2.4}}).bench
    bench.axis.start_move(10.0 + angle_deg)
    bench.light_on = True
    camera = SimulatedCamera(bench)
    camera.configure(0.0015, 1.0)
    view = look_at(camera.grab(), camera.info)
    assert abs(wrapped_deg(view.ridge_deg - angle_deg)) < 0.3
    bench.light_on = False
    dark = look_at(camera.grab(), camera.info)
    assert dark.ridge_deg is None
    assert math.isnan(dark.focus)


@pytest.mark.parametrize("measure", ["tenengrad", "laplacian"])
def test_focus_falls_with_blur_and_not_with_exposure(measure, rng):
    sharp = grating(15.0) + 0.01 * rng.standard_normal((240, 320)).astype(np.float32)
    values = [focus_of(cv2.GaussianBlur(sharp, (0, 0), sigma), measure) for sigma in (0.5, 1.0, 2.0, 4.0)]
    assert values == sorted(values, reverse=True)
    assert values[-1] < 0.5 * values[0]
    assert focus_of(0.25 * sharp, measure) == pytest.approx(focus_of(sharp, measure), rel=1e-4)


def test_tenengrad_of_a_ramp_is_its_slope():
    ramp = np.tile(np.linspace(0.2, 0.4, 401, dtype=np.float32), (50, 1))
    slope = 0.2 / 400
    # replicated borders flatten the outermost columns only
    assert focus_of(ramp) == pytest.approx(slope**2 / 0.3**2, rel=0.02)


def test_histogram_counts_every_pixel_once():
    signal = np.array([[-0.1, 0.0, 0.124, 0.126], [0.5, 0.99, 1.0, 1.2]], dtype=np.float32)
    found = histogram_of(signal, 8)
    assert np.array(found) * 8 == pytest.approx([3, 1, 0, 0, 1, 0, 0, 3])


def test_black_and_full_scale_are_0_and_1():
    signal = signal_of(np.array([[64, FULL]], dtype=np.uint16), INFO)
    assert signal == pytest.approx(np.array([[0.0, 1.0]]))


def test_saturation_counts_from_98_percent():
    counts = np.array([[0, 4013, 4014, 4095]], dtype=np.uint16)  # 0.98 · 4095 = 4013.1
    assert saturated_share(counts, 12) == 0.5
    assert look_at(counts_of(grating(0.0)), INFO).saturated_share == 0.0


def view(focus):
    return View(0.3, 0.0, focus, None, 0.0, (1.0,))


def test_meter_holds_focus_against_the_best_and_counts_frames():
    meter = Meter()
    first = meter.read(view(math.nan), 10.0)
    assert math.isnan(first.relative_focus)
    assert math.isnan(first.frames_per_s)
    assert meter.read(view(2.0), 10.5).relative_focus == 1.0
    third = meter.read(view(1.0), 11.0)
    assert (third.frame, third.relative_focus) == (3, 0.5)
    assert third.frames_per_s == pytest.approx(2.0)
    assert math.isnan(meter.read(view(math.nan), 11.5).relative_focus)
    assert meter.read(view(4.0), 12.0).relative_focus == 1.0


@pytest.mark.parametrize(("angle", "line"), [(0, 0), (90, 90), (-90, 90), (180, 0), (135, -45), (450, 90)])
def test_lines_have_no_ends(angle, line):
    assert wrapped_deg(angle) == line


def test_a_mosaic_makes_neither_focus_nor_ridges(rng):
    """An even colour, and ridges of a grey part behind the filters: what is seen is what a grey camera sees."""
    info, passed = replace(INFO, filters="rggb"), np.array([0.85, 1.0, 0.4])
    seen = passed[channel_of_pixels("rggb", (240, 320))]
    noise = rng.normal(0.0, 3.0, (240, 320))
    picture = (64 + 2000.0 * seen).astype(np.uint16)
    even, as_grey = (look_at(picture, one, focus="laplacian") for one in (info, INFO))
    assert even.ridge_deg is None
    assert even.focus < 1e-3 * as_grey.focus  # the mosaic would be taken for detail
    rows, cols = np.mgrid[:240, :320]
    ridges = 1.0 + 0.4 * np.sin(2.0 * np.pi * (cols * np.cos(0.3) + rows * np.sin(0.3)) / 9.0)
    grey, colour = (
        look_at((64 + 1500.0 * ridges * s + noise).astype(np.uint16), i)
        for s, i in ((1.0, INFO), (seen, info))
    )
    assert colour.ridge_deg == pytest.approx(grey.ridge_deg, abs=0.3)
    assert colour.mean == pytest.approx(grey.mean * seen.mean(), rel=0.01)
