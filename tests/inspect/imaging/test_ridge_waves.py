"""Ridges in the aligned pictures: another pitch, another direction and a part that slips are named pose by pose."""

import re

import cv2
import numpy as np
import pytest

from anisoscope.base.errors import MeasurementError
from anisoscope.imaging.registration.placement import Grid
from anisoscope.imaging.ridge_waves import check_ridges, find_ridges

PITCH_UM = 100.0
ANGLES = (0.0, 90.0, 180.0)
GRID = Grid((0.0, 0.0), PITCH_UM / 12 / 1000, (120, 120))


def wave(pitch_um, turn_deg=0.0, shape=(0.7, 0.2, 0.1), noise=0.1):
    """A picture of ridges with harmonics, turned."""
    rng = np.random.default_rng(1)
    y, x = np.indices(GRID.shape) * GRID.pixel_mm * 1000.0
    along = x * np.cos(np.radians(turn_deg)) + y * np.sin(np.radians(turn_deg))
    ridges = sum(a * np.cos(2 * np.pi * (k + 1) * along / pitch_um) for k, a in enumerate(shape))
    return (0.1 * (1.0 + 0.5 * ridges + noise * rng.standard_normal(x.shape))).astype(np.float32)


@pytest.mark.parametrize("pitch_um", [80.0, 93.0, 100.0, 107.0, 125.0])
@pytest.mark.parametrize("turn", [0.0, 2.0, -40.0, 90.0])
def test_pitch_and_direction_are_read_from_the_picture(pitch_um, turn):
    found = find_ridges((wave(pitch_um, turn),), GRID.pixel_mm * 1000.0, PITCH_UM)
    assert found.pitch_um == pytest.approx(pitch_um, rel=0.015)
    assert (found.direction_deg - turn + 90) % 180 - 90 == pytest.approx(0.0, abs=1.0)


RIDGES = {
    "turned part": (wave(100.0, 90.0), r"the ridges run 90° from where the recipe says: lay the part"),
    "askew": (wave(100.0, 8.0), r"the ridges run \d+° from"),
    "other pitch": (wave(90.0), r"ridges are (89|90)\.\d µm apart, the recipe says 100 µm .*another product"),
    "half the pitch": (wave(50.0), r"ridges are (49|50)\.\d µm apart"),
}


@pytest.mark.parametrize("case", RIDGES)
def test_another_part_or_one_laid_the_wrong_way_is_named(case, make_recipe):
    picture, words = RIDGES[case]
    with pytest.raises(MeasurementError, match=words):
        check_ridges((picture,), (0.0,), GRID, make_recipe())


@pytest.mark.parametrize(
    "picture",
    [wave(100.0), wave(102.0), wave(100.0, 2.0), wave(100.0, 0, (0.3, 0.7, 0.1))],
    ids=["right", "a little wide", "a little askew", "strong harmonic"],
)
def test_the_right_part_passes(picture, make_recipe):
    assert check_ridges((picture,), (0.0,), GRID, make_recipe()) == ()


def test_a_harmonic_alone_is_another_pitch_unless_some_pose_shows_the_fundamental(make_recipe):
    both_flanks_alike, flanks_differ = wave(100.0, shape=(0.0, 0.7, 0.1)), wave(100.0)
    assert check_ridges((both_flanks_alike, flanks_differ), (90.0, 180.0), GRID, make_recipe()) == ()
    with pytest.raises(MeasurementError, match=r"ridges are 50\.0 µm apart"):
        check_ridges((both_flanks_alike, both_flanks_alike), (0.0, 90.0), GRID, make_recipe())


def part_of(pitch_um, azimuth_deg, rng, *, defect="", turn_deg=0.0):
    """Picture of 20 pitches of 100 µm: two flanks, crests and grooves under a lamp, with texture, blur and noise."""
    y, x = np.indices((480, 480)) * 100.0 / 24.0
    phase = (x * np.cos(np.radians(turn_deg)) + y * np.sin(np.radians(turn_deg))) / pitch_um
    within, ridge = np.mod(phase, 1.0), np.floor(phase).astype(int)
    tilt = np.cos(np.radians(azimuth_deg))
    light = np.where(within < 0.5, 1.0 + 0.3 * tilt, 1.0 - 0.3 * tilt)
    round_um = 20.0 if defect == "wear" else 3.0
    light += 0.5 * np.exp(-(((within - 0.5) * pitch_um / round_um) ** 2))  # crests catch light in every pose
    if defect == "half filled":
        light = np.where(np.abs(within - 0.5) < 0.25, 1.4, light)
    if defect == "missing ridges":
        gone = rng.random(ridge.max() - ridge.min() + 1) < 0.4
        light = np.where(gone[ridge - ridge.min()], 6.0, light)
    if defect == "burrs":
        spots = cv2.GaussianBlur(rng.standard_normal(x.shape), (0, 0), 3.0)
        light = np.where((spots > np.quantile(spots, 0.8)) & (np.abs(within - 0.5) < 0.2), 3.0, light)
    texture = cv2.GaussianBlur(rng.standard_normal(x.shape), (0, 0), 1.5)
    light = cv2.GaussianBlur(light * np.exp(0.2 * texture / texture.std()), (0, 0), 1.2)
    return (0.1 * light * (1.0 + 0.02 * rng.standard_normal(x.shape))).astype(np.float32)


WIDE = Grid((0.0, 0.0), PITCH_UM / 24 / 1000, (480, 480))


@pytest.mark.parametrize("pitch_um", [33.0, 45.0, 48.0, 50.0, 52.0, 60.0, 90.0, 150.0, 200.0])
def test_another_product_is_named_by_its_pitch(pitch_um, make_recipe):
    rng = np.random.default_rng(5)
    aligned = tuple(part_of(pitch_um, azimuth, rng) for azimuth in ANGLES)
    with pytest.raises(MeasurementError, match=r"the recipe says 100 µm .*another product") as caught:
        check_ridges(aligned, ANGLES, WIDE, make_recipe())
    named = float(re.findall(r"ridges are (\d+\.\d) µm", str(caught.value))[0])
    assert named == pytest.approx(pitch_um, rel=0.03)


@pytest.mark.parametrize("defect", ["", "burrs", "wear", "missing ridges", "half filled"])
def test_a_defective_part_of_the_product_is_of_its_pitch(defect, make_recipe):
    rng = np.random.default_rng(6)
    aligned = tuple(part_of(100.0, azimuth, rng, defect=defect) for azimuth in ANGLES)
    notes = check_ridges(aligned, ANGLES, WIDE, make_recipe())
    assert notes == () or "no clear" in notes[0]
    assert (notes == ()) or defect == "missing ridges"


@pytest.mark.parametrize("turns", [(0.0, 0.0, 3.0), (0.0, 0.0, -90.0), (0.0, 40.0, 40.0)])
def test_a_part_that_does_not_follow_its_fixture_is_named_with_pose_and_angle(turns, make_recipe):
    rng = np.random.default_rng(7)
    aligned = tuple(part_of(100.0, at, rng, turn_deg=turn) for at, turn in zip(ANGLES, turns, strict=True))
    where = "between 0° and 90°" if turns[1] else "between 90° and 180°"
    with pytest.raises(MeasurementError, match=rf"{where} the part turned by .* seat the part so") as caught:
        check_ridges(aligned, ANGLES, WIDE, make_recipe())
    turned = float(re.findall(r"turned by ([+-]\d+\.\d)°", str(caught.value))[0])
    assert abs(turned) == pytest.approx(max(np.abs(turns)), abs=0.5)
    if abs(turned) < 5.0:
        limits = {"part_turn_deg": 4.0}
        assert check_ridges(aligned, ANGLES, WIDE, make_recipe(limits=limits)) == ()


def test_ridges_that_cannot_be_seen_are_a_note(make_recipe):
    coarse = Grid((0.0, 0.0), 0.04, (120, 120))
    unseen = wave(100.0, 0, (0.0,), 0.3)
    assert "fewer than 3 points" in check_ridges((unseen,), (0.0,), coarse, make_recipe())[0]
    assert "no clear wave" in check_ridges((unseen,), (0.0,), GRID, make_recipe())[0]
    (one,) = check_ridges((wave(100.0), unseen), (0.0, 90.0), GRID, make_recipe())
    assert "follows its fixture at 90°" in one
