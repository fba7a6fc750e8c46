"""Every gate on small scenes: what is unfit is INVALID, and the words say what to do."""

import re
from dataclasses import replace
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from anisoscope.base.errors import CalibrationError, MeasurementError, RecipeError, RegistrationError
from anisoscope.imaging.linearisation import RadianceImage
from anisoscope.imaging.quality_gates import (
    check_dirt,
    check_edges,
    check_ridges,
    check_sharpness,
    check_tilt,
    check_views,
    find_ridges,
    overhangs,
    unwatched,
)
from anisoscope.imaging.registration.placement import Grid, Placement, View

SIZE, PIXEL_UM, PITCH_UM = 240, 8.0, 100.0
GRID = Grid((0.0, 0.0), PITCH_UM / 12 / 1000, (120, 120))
ANGLES = (0.0, 90.0, 180.0)


def placed(angle, **changes):
    factor = np.exp(1j * np.radians(angle)) * 1000.0 / PIXEL_UM
    axis = ((SIZE - 1) / 2, (SIZE - 1) / 2)
    matrix = np.array([[factor.real, -factor.imag, axis[0]], [-factor.imag, -factor.real, axis[1]]])
    return Placement(
        matrix, angle, PIXEL_UM, axis, 0.05, 4, **{"blur_px": 0.8, "black_share": 0.05} | changes
    )


def view(angle, tilt=0.0, **changes):
    value = np.full((SIZE, SIZE), 0.1, np.float32)
    image = RadianceImage(value, 0.001 * value, np.zeros(value.shape, bool), 0.5)
    return View(angle, tilt, image, placed(angle, **changes))


@pytest.mark.parametrize(("arm", "markers"), [(0.0, 6.0), (10.0, 13.2), (20.0, 17.0), (-15.0, 0.0)])
def test_the_arm_stands_elsewhere_than_it_says(arm, markers):
    squeeze = np.cos(np.radians(markers)) / np.cos(np.radians(arm))
    one = view(90.0, arm, squeeze=squeeze, u_squeeze=1e-4)
    words = rf"at 90° the arm stands at {arm:.1f}° tilt, (the markers say {markers:.1f}°|.*columns)"
    with pytest.raises(RegistrationError, match=words):
        check_tilt(one)


@pytest.mark.parametrize("arm", [0.0, 10.0, -20.0])
def test_a_little_tilt_beside_is_no_matter(arm):
    squeeze = np.cos(np.radians(abs(arm) + 0.5)) / np.cos(np.radians(arm))
    check_tilt(view(0.0, arm, squeeze=squeeze, u_squeeze=1e-4))


def test_defocus_in_one_pose_is_named_whichever_it_is(make_recipe):
    sharp, dull = view(0.0), view(90.0, blur_px=1.6)
    for first, other in ((sharp, dull), (replace(dull, stage_deg=90.0), sharp)):
        with pytest.raises(
            MeasurementError, match=r"at 90° the picture is less sharp than at 0° .*focus again"
        ):
            check_sharpness(other, first, make_recipe())
    check_sharpness(view(90.0, blur_px=1.0), sharp, make_recipe())


def test_a_blur_of_a_quarter_pitch_hides_the_cells(make_recipe):
    dull = [view(angle, blur_px=3.5) for angle in ANGLES]
    with pytest.raises(
        MeasurementError, match=r"at 0° the picture is out of focus: .* 28.0 µm \(limit 25 µm"
    ):
        check_views(dull, make_recipe())
    check_views(dull, make_recipe().model_copy(update={"area": None}))


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


def test_a_gate_that_sees_nothing_says_so(make_recipe):
    coarse = Grid((0.0, 0.0), 0.04, (120, 120))
    unseen = wave(100.0, 0, (0.0,), 0.3)
    assert "fewer than 3 points" in check_ridges((unseen,), (0.0,), coarse, make_recipe())[0]
    assert "no clear wave" in check_ridges((unseen,), (0.0,), GRID, make_recipe())[0]
    (one,) = check_ridges((wave(100.0), unseen), (0.0, 90.0), GRID, make_recipe())
    assert "follows its fixture at 90°" in one
    edges = [view(angle, 10.0, blur_px=None, black_share=None) for angle in ANGLES]
    edges = [replace(one, placement=replace(one.placement, markers=0)) for one in edges]
    assert unwatched(edges) == ("not watched: tilt, sharpness (no markers in the pictures)",)
    assert unwatched([view(angle) for angle in ANGLES]) == ()
    few = SimpleNamespace(cells=np.ones((3, 4, 4)), grid=GRID)
    assert "fewer than 64 cells" in check_dirt([view(angle) for angle in ANGLES], few, 0.1)[0]
    assert "narrower than a pitch" in check_edges(np.ones((3, 3, 3)), GRID, make_recipe())[0]


def cells_with(rng, on_sensor=(), on_part=(), angles=ANGLES):
    """Views and cell maps; marks are disks (x, y, r in mm) that stay with the sensor, or turn with the part."""
    rows, cols = np.indices((40, 40)) - 19.5
    x, y = cols * 0.025, -rows * 0.025
    maps = []
    for angle in angles:
        cos, sin = np.cos(np.radians(angle)), np.sin(np.radians(angle))
        seen_x, seen_y = cos * x - sin * y, sin * x + cos * y
        level = 0.1 * np.exp(0.03 * rng.standard_normal(x.shape))
        for a, b, r in on_sensor:
            level[np.hypot(seen_x - a, seen_y - b) < r] *= 0.7
        for a, b, r in on_part:
            level[np.hypot(x - a, y - b) < r] *= 0.7
        maps.append(level)
    return [view(angle) for angle in angles], SimpleNamespace(cells=np.array(maps), grid=GRID)


@pytest.mark.parametrize("angles", [ANGLES, (0.0, 45.0, 90.0), (0.0, 90.0)])
def test_dirt_on_lens_or_white_tile_stays_while_the_part_turns(angles):
    views, measured = cells_with(np.random.default_rng(2), on_sensor=[(0.25, 0.15, 0.09)], angles=angles)
    with pytest.raises(
        CalibrationError, match=r"stays at column (\d+), row (\d+) .*clean lens .* take a new flat"
    ) as caught:
        check_dirt(views, measured, 0.15)
    column, row = (int(n) for n in re.findall(r"column (\d+), row (\d+)", str(caught.value))[0])
    assert column == pytest.approx((SIZE - 1) / 2 + 0.25 * 125, abs=4)
    assert row == pytest.approx((SIZE - 1) / 2 - 0.15 * 125, abs=4)


@pytest.mark.parametrize("marks", [(), [(0.2, 0.2, 0.1), (-0.3, 0.1, 0.08)], [(0.0, 0.0, 0.1)], "many"])
def test_marks_on_the_part_turn_with_it(marks):
    rng = np.random.default_rng(3)
    if marks == "many":
        marks = [(*rng.uniform(-0.45, 0.45, 2), 0.03) for _ in range(60)]
    views, measured = cells_with(rng, on_part=marks)
    check_dirt(views, measured, 0.15)


BENCHES = {
    "lens cap": ({"bench": {"optics": {"lens_cap": True}}}, "is the lens cap on"),
    "lamp too bright": ({"bench": {"optics": {"electrons": 4e8}}}, "saturated.*turn the lamp down"),
    "lamp drifts": ({"bench": {"optics": {"lamp_drift_per_frame": 0.01}}}, "let the lamp warm up"),
    "defocus": ({"bench": {"optics": {"blur_um": 40.0}}}, "focus"),
    "other pitch": (
        {"bench": {"sample": {"pitch_um": 50.0}}},
        r"ridges are \d+\.\d µm apart, the recipe says 100 µm",
    ),
    "stray light": ({"bench": {"optics": {"stray_radiance": 0.1}}}, "keep other light off"),
    "tilted arm": (
        {"bench": {"geometry": {"tilt_deg": 12.0}}},
        "the arm stands at 0.0° tilt, the markers say 12",
    ),
}


OVER = np.indices((40, 40))
CUTS = {
    "nothing": (np.zeros((40, 40), bool), []),
    "a strip on the right": (OVER[1] >= 36, [100.0, 100.0]),
    "a strip below, half a pitch": (OVER[0] >= 38, [50.0, 50.0]),
    "a corner, by a turned edge": (OVER[0] + 2 * (39 - OVER[1]) < 20, [224.0]),
    "all round": ((OVER < 4).any(axis=0) | (OVER >= 36).any(axis=0), [100.0] * 4),
    "a strip of a quarter of a pitch": (OVER[1] >= 39, []),
    "a scratch on the first row": (OVER[0] == 0, []),
    "specks": (np.add(*OVER) % 7 == 0, []),
    "a scratch along a side": ((OVER[1] == 38) | (OVER[1] == 37), []),
    "a mark of a pitch off the corner": ((OVER >= 6).all(axis=0) & (OVER < 16).all(axis=0), []),
}


@pytest.mark.parametrize("case", CUTS)
def test_corners_beyond_the_part_are_found(case):
    foreign, distances = CUTS[case]
    rng = np.random.default_rng(4)
    pattern = np.tile([0.3, 1.0, 1.7, 1.0], 10) * np.array([0.28, 0.03, 0.035])[:, None, None]
    cells = pattern * rng.lognormal(0.0, 0.1, (3, 40, 40))
    cells[:, foreign] = 0.0127  # a dark plate
    found = overhangs(cells, GRID)
    assert [one.beyond_um for one in found] == pytest.approx(distances, rel=0.2, abs=30.0)
    assert all(np.max(np.abs(one.at_mm)) == pytest.approx(0.5, abs=0.01) for one in found)


def test_what_differs_in_one_pose_alone_is_a_defect():
    cells = np.full((3, 40, 40), 0.1)
    cells[:2, :, 30:] = 0.01
    assert overhangs(cells, GRID) == ()


@pytest.mark.parametrize("case", ["two corners", "allowed", "markers"])
def test_a_region_that_leaves_the_part_is_invalid(virtual_rig, undiagnosed, case):
    region = {"size_mm": [1.0, 1.0], "center_mm": [0.2, 0.0]}
    if case == "markers":
        rig = virtual_rig(recipe={"region": {"size_mm": [3.2, 3.2]}})
        with pytest.raises(RecipeError, match=r"recipe\.toml: the region covers markers \d.* of the fixture"):
            rig.inspect()
        return
    limits = {"beyond_part_um": 150.0} if case == "allowed" else {}
    record = virtual_rig(recipe={"region": region, "limits": limits}).inspect(methods=undiagnosed).record
    if case == "allowed":
        assert record.verdict == "FAIL"
        return
    assert record.verdict == "INVALID"
    (reason,) = record.reasons
    assert "beyond the part at 2 corners: " in reason
    assert re.search(r"x \+0\.7\d? mm, y [+-]0\.\d+ mm", reason)


@pytest.mark.parametrize("case", BENCHES)
def test_an_unfit_rig_is_invalid_and_says_what_to_do(case, virtual_rig):
    changes, words = BENCHES[case]
    record = virtual_rig(**changes).inspect().record
    assert record.verdict == "INVALID"
    assert re.search(words, record.reasons[0]), record.reasons


def test_without_a_fixture_the_edges_of_the_part_align_the_pictures(virtual_rig, undiagnosed, inspected_part):
    with_markers = inspected_part[1].record
    record = virtual_rig("edges", rig={"fixture": None}).inspect(methods=undiagnosed).record
    assert record.verdict in {"PASS", "INVALID"}
    if record.verdict == "PASS":
        assert [pose.markers for pose in record.poses] == [0, 0, 0]
        assert [p.measured for p in record.poses] == pytest.approx(
            [p.measured for p in with_markers.poses], rel=0.02
        )
    else:
        assert "describe a [fixture]" in record.reasons[0]
