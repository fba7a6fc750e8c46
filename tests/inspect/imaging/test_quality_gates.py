"""Every gate on small scenes: what is unfit is INVALID, and the words say what to do."""

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from anisoscope.base.errors import CalibrationError, MeasurementError, RecipeError, RegistrationError
from anisoscope.imaging.linearisation import RadianceImage
from anisoscope.imaging.quality_gates import (
    check_dirt,
    check_edges,
    check_sharpness,
    check_tilt,
    check_views,
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
    return Placement(matrix, angle, PIXEL_UM, axis, 0.05, 4, **{"blur_px": 0.8} | changes)


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


def test_a_gate_that_sees_nothing_says_so(make_recipe):
    edges = [view(angle, 10.0, blur_px=None) for angle in ANGLES]
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


@pytest.mark.parametrize(
    "marks",
    [
        (),
        [(0.2, 0.2, 0.1), (-0.3, 0.1, 0.08)],
        [(0.0, 0.0, 0.1)],
        [(0.03, -0.02, 0.24)],
        [(0.02, 0.0, 0.3), (0.3, 0.3, 0.05)],
        "many",
    ],
)
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
