"""Maps of several ridge directions: each region is predicted in the frame of its own ridges."""

import importlib.util
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from anisoscope.base.errors import HeightMapError
from anisoscope.parameters.geometry import Convention, Pose
from anisoscope.parameters.inputs import InputUncertainty
from anisoscope.parameters.material import Material
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.prediction.monte_carlo import MonteCarlo
from anisoscope.prediction.predict import predict_design
from anisoscope.prediction.region_prediction import FieldGrid, predict_fields, predict_map
from anisoscope.profiles.ideal import ridges
from anisoscope.profiles.patterns import checkerboard
from anisoscope.profiles.plates import Plan, plate_map

BOARDS = Path(__file__).resolve().parents[2] / "profiles" / "metrology" / "boards.py"
SPEC = importlib.util.spec_from_file_location("boards", BOARDS)
boards = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(boards)
turned_board = boards.turned_board

PLASTIC = Material(0.06, 0.10, 0.2)
POSES = tuple(Pose(angle) for angle in (0.0, 90.0, 180.0))
DESIGN = RidgeDesign(100.0, 10.0)


@pytest.mark.parametrize("step_um", [pytest.param(2.0, marks=pytest.mark.soak), 2.5])
def test_a_board_of_two_directions_is_as_bright_after_a_quarter_turn(step_um):
    """Small fields, at 2 µm and 2.5 µm: one direction at 0° is the other at 90°, within .2 %."""
    surface = checkerboard(DESIGN, (round(500 / step_um), round(500 / step_um)), step_um, 250.0)
    found = predict_map(surface, PLASTIC, POSES, Convention())
    first, second = found.notes["regions"]
    assert first["predicted_regions"] == second["predicted_regions"] == 0
    assert first["radiance"][0] == pytest.approx(second["radiance"][1], rel=0.002)
    assert first["radiance"][1] == pytest.approx(second["radiance"][0], rel=0.002)
    ideal = predict_design(DESIGN, PLASTIC, POSES, Convention()).radiance
    np.testing.assert_allclose(first["radiance"], ideal, rtol=0.02)
    shares = [one["share"] for one in (first, second)]
    mean = np.average([first["radiance"], second["radiance"]], axis=0, weights=shares)
    np.testing.assert_allclose(found.radiance, mean, rtol=1e-12)


def test_fields_of_four_ridges_are_predicted_alike_in_any_orientation_of_the_map():
    truth = [
        predict_design(DESIGN, PLASTIC, POSES, Convention(facet_azimuth_deg=turn)).radiance
        for turn in (0.0, -90.0)
    ]
    by_turn = []
    for turn_deg in (0.0, 37.0):
        surface, _ = turned_board(turn_deg, 400, 2.8, 560.0)
        found = predict_map(surface, PLASTIC, POSES, Convention())
        regions = sorted(found.notes["regions"], key=lambda one: -one["facet_azimuth_deg"])
        assert [one["facet_azimuth_deg"] for one in regions] == pytest.approx([0.0, -90.0], abs=0.2)
        assert min(one["predicted_regions"] for one in regions) > 0
        by_turn.append([one["radiance"] for one in regions])
        np.testing.assert_allclose(by_turn[-1], truth, rtol=0.02)
    np.testing.assert_allclose(by_turn[0], by_turn[1], rtol=0.01)


@pytest.mark.parametrize(
    ("turn_deg", "radius_um", "off"),
    [  # all angles are among the statistics
        pytest.param(0.0, 0.0, 0.016, marks=pytest.mark.statistics),
        (5.0, 0.0, 0.01),
        (37.0, 3.0, 0.01),
        pytest.param(123.0, 0.0, 0.01, marks=pytest.mark.statistics),
    ],
)
def test_small_fields_are_predicted_within_a_percent_however_the_map_is_turned(turn_deg, radius_um, off):
    """Two and a half ridges a field, also dark radiances of fields that face away; against ideal ridges."""
    design = replace(DESIGN, edge_radius_um=radius_um)
    surface, _ = turned_board(turn_deg, 400, 2.5, 250.0, design)
    regions = predict_map(surface, PLASTIC, POSES, Convention()).notes["regions"]
    regions = sorted(regions, key=lambda one: -one["facet_azimuth_deg"])
    for one, turn in zip(regions, (0.0, -90.0), strict=True):
        assert one["predicted_regions"] == 0
        truth = predict_design(design, PLASTIC, POSES, Convention(facet_azimuth_deg=turn)).radiance
        np.testing.assert_allclose(one["radiance"], truth, rtol=off)


@pytest.mark.parametrize(
    ("design", "points", "field_um", "off"),
    [  # the statistics have these and 72 more
        pytest.param(RidgeDesign(100.0, 5.0), 50.0, 200.0, 0.006, marks=pytest.mark.statistics),
        pytest.param(RidgeDesign(100.0, 10.0), 25.0, 200.0, 0.015, marks=pytest.mark.statistics),
        (RidgeDesign(100.0, 15.0, "vertical"), 40.0, 250.0, 0.06),
        pytest.param(
            RidgeDesign(100.0, 10.0, height_loss=0.1), 51.5, 250.0, 0.005, marks=pytest.mark.statistics
        ),
        (RidgeDesign(100.0, 15.0, height_loss=0.2), 30.3, 250.0, 0.005),
    ],
)
def test_small_fields_along_the_grid_are_predicted_within_their_budget(design, points, field_um, off):
    """Narrow walls, two ridges a field, cut crests (facet by facet 7 to 22 % off), against ideal ridges."""
    fields, board, within = board_along_the_grid(design, points, field_um)
    assert np.abs(fields).max() < off
    assert (np.abs(board) <= 2.0 * within).all()


@pytest.mark.statistics
@pytest.mark.parametrize("step_um", [1.0, 2.5])
def test_a_map_of_two_directions_may_lie_at_any_angle(step_um):
    """Against ideal ridges, and of one angle against others."""
    found = []
    for turn_deg in (0.0, 5.0, 12.0, 30.0, 33.0, 37.0, 45.0, 60.0, 90.0, 123.0, 180.0):
        surface, _ = turned_board(turn_deg, round(1000.0 / step_um), step_um, 250.0)
        regions = predict_map(surface, PLASTIC, POSES, Convention()).notes["regions"]
        regions = sorted(regions, key=lambda one: -one["facet_azimuth_deg"])
        truth = [
            predict_design(DESIGN, PLASTIC, POSES, Convention(facet_azimuth_deg=turn)).radiance
            for turn in (0.0, -90.0)
        ]
        found.append(np.array([one["radiance"] for one in regions]) / truth - 1.0)
    np.testing.assert_allclose(found, 0.0, atol=0.016 if step_um > 1.0 else 0.009)
    assert np.ptp(found, axis=0).max() < 0.012


SHAPES = [
    RidgeDesign(100.0, 5.0),
    RidgeDesign(100.0, 5.0, "vertical"),
    RidgeDesign(100.0, 10.0),
    RidgeDesign(100.0, 10.0, "vertical"),
    RidgeDesign(100.0, 10.0, 5.0),
    RidgeDesign(100.0, 10.0, edge_radius_um=3.0),
    RidgeDesign(100.0, 10.0, height_loss=0.1),
    RidgeDesign(100.0, 10.0, "vertical", 0.1),
    RidgeDesign(100.0, 15.0, "vertical"),
    RidgeDesign(100.0, 15.0, edge_radius_um=5.0),
    RidgeDesign(100.0, 15.0, height_loss=0.2),
]
SAMPLINGS = [
    (20.0, 250.0),
    (25.0, 200.0),
    (30.3, 250.0),
    (40.0, 250.0),
    (50.0, 250.0),
    (50.0, 200.0),
    (51.5, 250.0),
]


def drawn_boards(count):
    """Boards that served nobody to set a limit: any ridge angle, wall, form of crest, points a pitch, and field."""
    rng = np.random.default_rng(4711)
    for number in range(count):
        angle = float(np.round(rng.uniform(4.0, 16.0), 1))
        wall = ["perpendicular", "vertical", float(np.round(rng.uniform(0.0, 15.0), 1))][rng.integers(3)]
        radius = float(np.round(rng.uniform(0.5, 6.0), 1)) if number % 3 == 1 else 0.0
        loss = float(np.round(rng.uniform(0.04, 0.25), 2)) if number % 3 == 2 else 0.0
        whole = rng.random() < 0.4
        points = float(rng.integers(18, 56)) if whole else float(np.round(rng.uniform(18.0, 55.0), 1))
        design = RidgeDesign(100.0, angle, wall, loss, radius)
        yield design, points, float(rng.choice([200.0, 250.0, 300.0]))


@pytest.mark.statistics
@pytest.mark.parametrize("drawn", [False, True])
def test_errors_of_small_fields_along_the_grid_are_as_their_budget_says(drawn):
    """77 boards, and 40 drawn ones; errors over u of what the points leave open of walls."""
    boards_tried = drawn_boards(40) if drawn else ((one, *two) for one in SHAPES for two in SAMPLINGS)
    over_u = []
    for board in boards_tried:
        _, off, within = board_along_the_grid(*board)
        over_u.append(np.abs(off) / within)
    share = [np.mean(np.array(over_u) < bound) for bound in (1.0, 2.0)]
    assert share[0] > 0.85
    assert share[1] > 0.95
    assert np.max(over_u) < 3.0


def board_along_the_grid(design, points, field_um):
    """Relative errors of the bright fields and of the board at 0°, 90°, 180°, against ideal ridges; u by walls."""
    pixel_um = 100.0 / points
    surface, _ = turned_board(0.0, int(1000.0 / pixel_um), pixel_um, field_um, design)
    found = predict_map(surface, PLASTIC, POSES, Convention(), inputs=InputUncertainty())
    bright, dark = sorted(found.notes["regions"], key=lambda one: -one["facet_azimuth_deg"])
    assert bright["predicted_regions"] == dark["predicted_regions"] == 0
    truth, turned = (
        predict_design(design, PLASTIC, POSES, Convention(facet_azimuth_deg=turn)).radiance
        for turn in (0.0, -90.0)
    )
    mean = (bright["share"] * truth + dark["share"] * turned) / (bright["share"] + dark["share"])
    assert found.budget is not None
    walls = [one.absolute for one in found.budget.contributions if "walls" in one.source]
    within = np.sqrt(np.sum(np.square(walls), axis=0)) / mean
    return bright["radiance"] / truth - 1.0, found.radiance / mean - 1.0, within


def test_one_direction_is_predicted_as_before_and_has_no_regions():
    surface = ridges(DESIGN, (40, 801), (1.0, 1.0))
    found = predict_map(surface, PLASTIC, POSES, Convention())
    assert "regions" not in found.notes
    truth = predict_design(DESIGN, PLASTIC, POSES, Convention()).radiance
    np.testing.assert_allclose(found.radiance, truth, rtol=0.02)


def test_the_seat_of_a_plate_moves_both_directions_and_its_budget_says_so():
    """By symmetry the uncertainties of the directions are the same after a quarter turn."""
    surface = checkerboard(DESIGN, (400, 400), 3.0, 250.0)
    inputs = InputUncertainty()
    found = predict_map(surface, PLASTIC, POSES, Convention(), inputs=inputs)
    first, second = (np.array(one["u"]) for one in found.notes["regions"])
    np.testing.assert_allclose(first[:2], second[1::-1], rtol=0.05)
    assert found.budget is not None
    seat = {one.source: one.absolute for one in found.budget.contributions}
    about_x, about_y = seat["seating tilt about x"], seat["seating tilt about y"]
    # at 0° the bright fields lean toward +x, at 90° the bright ones lean toward −y
    assert abs(about_y[0]) > 3.0 * abs(about_x[0])
    assert abs(about_x[1]) > 3.0 * abs(about_y[1])


def test_what_cannot_be_predicted_by_regions_is_refused():
    surface = checkerboard(DESIGN, (400, 400), 3.0, 250.0)
    with pytest.raises(HeightMapError, match="without Monte Carlo"):
        predict_map(
            surface, PLASTIC, POSES, Convention(), inputs=InputUncertainty(), monte_carlo=MonteCarlo(20)
        )
    height = surface.height_um.copy()
    height[:200] = np.nan
    with pytest.raises(HeightMapError, match=r"50\.0% of the heights of this map are missing"):
        predict_map(surface.with_height(height), PLASTIC, POSES, Convention())


def test_the_lobe_of_a_field_turns_with_its_own_ridges_and_not_with_the_plan():
    azimuths, design = {"A": 0.0, "B": -90.0}, RidgeDesign(50.0, 10.0)
    plan = Plan(("ABB", "BAB"), azimuths, 0.2)
    surface = plate_map(plan, design, 2.0)
    height = surface.height_um.copy()
    first = height[:100, 100:200].copy()  # row index rises with y: an A in the second row of the plan
    height[100:, 100:200] = first
    height[100:, 250:] = first[:, :50]
    height[:100, 200:] = height.mean()
    grid = FieldGrid(plan.classes(), (0.0, -90.0), (design, design), 0.7)
    found = predict_fields(surface.with_height(height), grid, PLASTIC, POSES[:2], Convention())
    light, dark = found[:, 1, 1]
    assert light > 5.0 * dark
    np.testing.assert_allclose(found[:, 0, 0], found[:, 1, 1], rtol=0.01)
    np.testing.assert_allclose(found[:, 1, 0], [dark, light], rtol=0.01)
    np.testing.assert_allclose(found[:, 0, 1], [light, dark], rtol=0.01)  # of a wrong direction
    np.testing.assert_allclose(found[:, 0, 2], 0.5 * (light + dark), rtol=0.05)  # half of one
    of_first = replace(grid, classes=np.zeros((2, 3), dtype=np.int64))
    level = predict_fields(surface.with_height(height), of_first, PLASTIC, POSES[:2], Convention())
    np.testing.assert_allclose(found[:, 1, 2], level[:, 1, 2], rtol=1e-6)  # level land: as of the first class
