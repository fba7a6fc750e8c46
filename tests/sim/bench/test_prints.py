"""A printed sheet on the bench: each fault does to the radiance what its formula says."""

from dataclasses import replace

import numpy as np
import pytest

from anisoscope.base.errors import RigFileError
from anisoscope.imaging.registration.placement import angle_between, locate
from anisoscope.parameters.geometry import Convention, Pose
from anisoscope.rig.bayer import channel_of_pixels, grey_of
from anisoscope.sim.bench.printpart import PrintPart
from anisoscope.sim.bench.prints import PrintSample, printed_ink
from anisoscope.sim.light.colour.lamps import synthetic_white_led
from anisoscope.sim.light.colour.vision import Vision, synthetic_bayer, synthetic_silicon
from anisoscope.sim.light.geometry import directions
from anisoscope.sim.light.ink.distributions import density
from anisoscope.sim.light.ink.model import brdf
from anisoscope.sim.materials.inks import synthetic_ink, write_ink

VISION = Vision(synthetic_white_led(), synthetic_bayer())
RED, BLUE = synthetic_ink("synthetic-red"), synthetic_ink("synthetic-blue")
FLAT = {"grain_share": 0.0, "substrate": 0.04}


def sheet(vision=VISION, size_mm=0.4, seed=1, **part):
    made = PrintPart.model_validate(FLAT | {"raster_um": 50.0} | part)
    return PrintSample(made, size_mm, 4.0, vision, np.random.default_rng(seed))


def at(stage_deg, tilt_deg):
    """Directions to light and camera on the rig, 10° apart."""
    to_light, to_camera = directions((Pose(stage_deg, tilt_deg),), Convention())
    return to_light[0], to_camera[0]


def between(half_deg, azimuth_deg, apart_deg=10.0):
    """Directions whose half vector leans by an angle to an azimuth; the light stands on the far side of it."""
    turn = np.radians(azimuth_deg)
    light, camera = (
        np.array([np.sin(lean) * np.cos(turn), np.sin(lean) * np.sin(turn), np.cos(lean)])
        for lean in np.radians([half_deg + apart_deg / 2, half_deg - apart_deg / 2])
    )
    return light, camera


def shown(sample, ways):
    """(channels,) mean radiance."""
    return sample.radiance(*ways).astype(float).mean(axis=(1, 2))


def expected(ink, ways, vision=VISION):
    """(channels,) cosθi · f of a solid print, wavelength by wavelength."""
    return ways[0][2] * (brdf(ink, *ways) @ vision.weights(ink.nm))


POSES = [(0.0, 0.0), (35.0, 12.0), (180.0, 25.0)]
INKS = [
    {},
    {"distribution": "beckmann"},
    {"anisotropy": 1.4, "brush_deg": 25.0},
    {"distribution": "beckmann", "anisotropy": 0.7, "alpha": 0.3, "ink": "synthetic-green"},
]


@pytest.mark.parametrize("pose", POSES)
@pytest.mark.parametrize("part", INKS)
def test_a_solid_print_has_the_radiance_of_its_ink(pose, part):
    np.testing.assert_allclose(
        shown(sheet(**part), at(*pose)), expected(printed_ink(PrintPart(**part)), at(*pose)), rtol=2e-5
    )


@pytest.mark.parametrize("part", INKS)
def test_a_bent_sheet_shines_at_every_place_as_its_normal_wants(part):
    """The frame of every place, built here: normal, and the tangent that was +x."""
    sample = sheet(curl_deg=4.0, curl_azimuth_deg=30.0, **part)
    ink, ways = sample.inks[0], at(50.0, 10.0)
    picture = sample.radiance(*ways)
    for row, col in [(0, 0), (3, 7), (8, 4)]:
        z = sample._normal[row, col].astype(float)
        x = np.array([1.0, 0.0, 0.0]) - z[0] * z
        x /= np.linalg.norm(x)
        frame = np.stack([x, np.cross(z, x), z])
        np.testing.assert_allclose(
            picture[:, row, col], expected(ink, [frame @ way for way in ways]), rtol=5e-5
        )


@pytest.mark.parametrize("coverage", [0.0, 0.3, 1.0])
def test_dots_and_sheet_mix_by_their_area(coverage):
    ways = at(20.0, 5.0)
    paper = 0.04 / np.pi * ways[0][2]
    np.testing.assert_allclose(
        shown(sheet(coverage=coverage), ways),
        coverage * expected(RED, ways) + (1.0 - coverage) * paper,
        rtol=2e-5,
    )


def test_a_coloured_substrate_is_seen_by_every_channel_in_its_own_way(tmp_path):
    path = tmp_path / "paper.csv"
    path.write_text("wavelength_nm,reflectance\n400,0.1\n700,0.7\n")
    ways, nm = at(0.0, 0.0), np.array([400.0, 700.0])
    found = shown(sheet(coverage=0.0, substrate=str(path)), ways)
    np.testing.assert_allclose(
        found, np.array([0.1, 0.7]) @ VISION.weights(nm) / np.pi * ways[0][2], rtol=1e-5
    )
    assert found[0] > found[1] > found[2]


def test_missing_ink_shows_the_sheet():
    ways = at(0.0, 0.0)
    paper = 0.04 / np.pi * ways[0][2]
    np.testing.assert_allclose(
        shown(sheet(missing_share=0.1), ways), 0.9 * expected(RED, ways) + 0.1 * paper, rtol=2e-5
    )


def test_a_rough_ink_is_darker_in_the_mirror_direction_and_brighter_beside_it():
    good, rough, binder = sheet(), sheet(alpha_share=0.1), sheet(alpha=0.3)
    ways = between(0.0, 0.0)
    np.testing.assert_allclose(shown(rough, ways) / shown(good, ways), 1.1**-2, rtol=1e-5)
    np.testing.assert_allclose(shown(binder, ways) / shown(good, ways), (0.19 / 0.3) ** 2, rtol=1e-5)
    assert np.all(shown(rough, between(25.0, 0.0)) > 1.1 * shown(good, between(25.0, 0.0)))


def test_brushing_is_invisible_head_on_and_seen_beside_it():
    good, brushed = sheet(), sheet(anisotropy=1.15, brush_deg=20.0)
    ink = brushed.inks[0]
    assert ink.across / ink.alpha == pytest.approx(1.15)
    assert ink.across * ink.alpha == pytest.approx(0.19**2)
    np.testing.assert_allclose(shown(brushed, between(0.0, 20.0)), shown(good, between(0.0, 20.0)), rtol=1e-5)
    along, across = (shown(brushed, between(15.0, azimuth)) for azimuth in (20.0, 110.0))
    sine, cosine = np.sin(np.radians(15.0)), np.cos(np.radians(15.0))
    lobe = density(np.array([[sine, 0.0, cosine], [0.0, sine, cosine]]), ink.alpha, ink.across)
    np.testing.assert_allclose(across / along, lobe[1] / lobe[0], rtol=1e-4)
    assert lobe[1] / lobe[0] > 1.1


@pytest.mark.parametrize(("tilt_deg", "log_ratio"), [(0.0, -0.098), (5.0, 0.0), (10.0, 0.172), (20.0, 0.390)])
def test_brushing_on_the_rig_is_invisible_where_the_half_vector_lies_between_both_axes(tilt_deg, log_ratio):
    """Light and camera stand 10° apart: the half vector leans by 5° at tilt 0, along the brushing at 0° and across it
    at 90°. At a tilt of 5° it lies midway at both.
    """
    brushed = sheet(anisotropy=1.15)
    ratio = shown(brushed, at(0.0, tilt_deg)) / shown(brushed, at(90.0, tilt_deg))
    np.testing.assert_allclose(np.log(ratio), log_ratio, atol=1e-3)


@pytest.mark.parametrize("azimuth_deg", [0.0, 130.0])
@pytest.mark.parametrize("tilt_deg", [1.0, -2.5])
def test_shingled_flakes_move_the_lobe_by_exactly_their_angle(tilt_deg, azimuth_deg):
    good, shingled = sheet(), sheet(flake_tilt_deg=tilt_deg, flake_azimuth_deg=azimuth_deg)

    def lobe(lean_deg):
        lean = np.radians(lean_deg)
        return density(np.array([np.sin(lean), 0.0, np.cos(lean)]), 0.19, 0.19)

    for half_deg in (-12.0, 0.0, tilt_deg, 8.0):
        ways = between(half_deg, azimuth_deg)
        ratio = shown(shingled, ways) / shown(good, ways)
        np.testing.assert_allclose(ratio, lobe(half_deg - tilt_deg) / lobe(half_deg), rtol=1e-4)


def test_shingled_flakes_across_the_plane_of_light_and_camera_lean_in_the_same_sense():
    """Leaning towards +y they look like a half vector that leans towards −y."""
    shingled = sheet(flake_tilt_deg=3.0, flake_azimuth_deg=90.0)
    up, down = (shown(shingled, between(8.0, azimuth)) for azimuth in (90.0, -90.0))
    assert np.all(up > 1.2 * down)


def test_a_thicker_film_moves_the_spectrum_and_so_the_colour():
    thicker = printed_ink(PrintPart(ink="synthetic-green", film_shift_nm=10.0))
    thin = synthetic_ink("synthetic-green")
    assert thicker.nm[np.argmax(thicker.rho)] - thin.nm[np.argmax(thin.rho)] == 10.0
    np.testing.assert_allclose(thicker.rho[5:], thin.rho[4:-1])
    np.testing.assert_allclose(thicker.c[5:], thin.c[4:-1])
    ways = at(0.0, 0.0)
    seen = shown(sheet(ink="synthetic-green", film_shift_nm=10.0), ways)
    np.testing.assert_allclose(seen, expected(thicker, ways), rtol=2e-5)
    before = shown(sheet(ink="synthetic-green"), ways)
    assert np.linalg.norm(seen / seen.sum() - before / before.sum()) > 0.01


def test_the_wrong_ink_mixes_by_its_share():
    ways = at(90.0, 10.0)
    found = shown(sheet(wrong_ink="synthetic-blue", wrong_share=0.05), ways)
    mixed = 0.95 * expected(RED, ways) + 0.05 * expected(BLUE, ways)
    np.testing.assert_allclose(found, mixed, rtol=2e-5)
    pure = expected(RED, ways)
    assert mixed[2] / mixed.sum() > 1.05 * pure[2] / pure.sum()


def test_a_camera_without_filters_sees_one_channel():
    vision = Vision(synthetic_white_led(), synthetic_silicon())
    sample, ways = sheet(vision), at(0.0, 10.0)
    assert sample.radiance(*ways).shape == (1, 9, 9)
    np.testing.assert_allclose(shown(sample, ways), expected(RED, ways, vision), rtol=2e-5)


def test_an_ink_of_a_file_that_is_brushed_already_and_too_rough(tmp_path):
    write_ink(replace(RED, alpha=0.1, alpha_y=0.2, brush_deg=30.0), tmp_path / "mine.toml")
    ink = printed_ink(PrintPart(ink=str(tmp_path / "mine.toml"), alpha_share=0.1))
    assert (ink.alpha, ink.across, ink.brush_deg) == pytest.approx((0.11, 0.22, 30.0))


def test_the_anisotropy_is_that_of_the_print_even_of_an_ink_that_was_brushed_otherwise(tmp_path):
    write_ink(replace(RED, alpha=0.1, alpha_y=0.4, brush_deg=30.0), tmp_path / "mine.toml")
    ink = printed_ink(PrintPart(ink=str(tmp_path / "mine.toml"), anisotropy=1.15, brush_deg=90.0))
    assert (ink.across / ink.alpha, ink.across * ink.alpha, ink.brush_deg) == pytest.approx(
        (1.15, 0.04, 90.0)
    )


@pytest.mark.parametrize(
    ("part", "words"),
    [
        ({"ink": "gold"}, r"sample\.print\.ink: no ink is named 'gold'"),
        ({"ink": "none.toml"}, r"sample\.print\.ink: .*none\.toml: there is no such file"),
        ({"wrong_ink": "gold", "wrong_share": 0.1}, r"sample\.print\.wrong_ink: no ink is named 'gold'"),
        ({"substrate": "none.csv"}, r"sample\.print\.substrate: cannot read none\.csv"),
        ({"alpha": 0.9, "alpha_share": 0.5}, r"sample\.print: alpha must lie above 0 and at most at 1"),
    ],
)
def test_what_cannot_be_printed_is_told_with_its_key(part, words):
    with pytest.raises(RigFileError, match=words):
        sheet(**part)


# On the bench

PICTURE = {"rows": 256, "cols": 288, "filters": "grbg"}
CLEAN = {"prnu": 0.0, "dsnu_e": 0.0, "dark_current_e_s": 0.0}


@pytest.fixture
def print_bench(make_bench):
    def make(sensor=None, optics=None, size_mm=2.0, geometry=None, **part):
        bench = make_bench(
            sample={"kind": "print", "size_mm": size_mm, "print": FLAT | part},
            sensor=PICTURE | CLEAN | (sensor or {}),
            optics={"vignetting": 0.0, "stray_radiance": 0.0} | (optics or {}),
            geometry=geometry or {},
        )
        bench.light_on = True
        return bench

    return make


def channels(bench, exposure_s, patch, frames=4):
    """(3,) mean radiance of the channels in a patch of the picture, white balanced by what the filters pass."""
    counts = np.mean([bench.photograph(exposure_s, 1.0) for _ in range(frames)], axis=0)[patch]
    seen = channel_of_pixels(bench.file.sensor.filters, (bench.file.sensor.rows, bench.file.sensor.cols))[
        patch
    ]
    radiance = (counts - 64.0) * 7.5 / (bench.file.optics.electrons * exposure_s)
    return np.array([radiance[seen == k].mean() for k in range(3)]) / VISION.strengths()


@pytest.mark.parametrize("angle_deg", [0.0, 70.0])
def test_the_picture_of_a_print_has_its_radiance_behind_every_filter(print_bench, angle_deg):
    bench = print_bench(geometry={"tilt_deg": 12.0})
    bench.axis.start_move(bench.file.stage.zero_deg + angle_deg)
    middle = (slice(108, 148), slice(124, 164))
    found = channels(bench, 0.004, middle)
    np.testing.assert_allclose(found, expected(RED, at(angle_deg, 12.0)), rtol=5e-3)


def test_plate_and_markers_are_grey_and_say_where_the_print_lies(print_bench):
    bench = print_bench(size_mm=0.6)
    bench.axis.start_move(bench.file.stage.zero_deg + 40.0)
    corner = (slice(2, 22), slice(2, 22))
    plate = channels(bench, 0.05, corner, frames=8)
    np.testing.assert_allclose(plate, 0.04 / np.pi * np.cos(np.radians(10.0)), rtol=0.01)
    grey = grey_of(bench.photograph(0.02, 1.0), "grbg").astype(np.float32) - 64.0
    placed = locate(grey, bench.file.fixture)
    assert angle_between(0.0, placed.angle_deg) == pytest.approx(40.0, abs=0.1)


def test_a_spot_is_where_it_was_put_and_turns_with_the_sheet(print_bench):
    spots = [{"x_mm": 0.5, "y_mm": 0.2, "diameter_mm": 0.25}]
    bench = print_bench(spots=spots, optics={"axis_px": [0.0, 0.0]})
    bench.axis.start_move(bench.file.stage.zero_deg + 90.0)
    picture = grey_of(bench.photograph(0.003, 1.0), "grbg").astype(float)
    middle = picture[64:192, 80:208]
    row, col = np.argwhere(middle < 0.5 * np.median(middle)).mean(axis=0)
    turned = (0.5 + 0.2j) * 1j * 1000.0 / 14.0
    np.testing.assert_allclose([64 + row, 80 + col], [127.5 - turned.imag, 143.5 + turned.real], atol=1.0)


def test_the_seed_makes_the_print(print_bench):
    pictures = [print_bench(grain_share=0.05).photograph(0.003, 1.0) for _ in range(2)]
    np.testing.assert_array_equal(*pictures)


def test_a_near_lamp_lights_every_place_from_its_own_direction():
    """Each against the formula with the direction from there to a lamp at 80 mm."""
    part = PrintPart.model_validate(FLAT | {"raster_um": 100.0, "ink": "synthetic-red"})
    sample = PrintSample(part, 2.4, 4.0, VISION, np.random.default_rng(1), lamp_distance_mm=80.0)
    to_light, to_camera = at(35.0, 12.0)
    found = sample.radiance(to_light, to_camera)
    middle = expected(RED, (to_light, to_camera))
    np.testing.assert_allclose(found[:, 12, 12], middle, rtol=2e-3)
    for row, col in ((0, 0), (3, 20), (24, 7), (17, 24)):
        way = 80.0 * to_light - [0.1 * (col - 12), 0.1 * (row - 12), 0.0]
        near = expected(RED, (way / np.linalg.norm(way), to_camera))
        assert np.abs(near / middle - 1.0).max() > 0.01
        np.testing.assert_allclose(found[:, row, col], near, rtol=2e-3)
