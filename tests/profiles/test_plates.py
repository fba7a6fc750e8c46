"""Plans of plates and their height maps."""

import numpy as np
import pytest

from anisoscope.base.errors import HeightMapError
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.profiles.metrology.regions import direction_regions
from anisoscope.profiles.plates import Plan, inner_share, plan_of_modules, plate_map, read_rows

AZIMUTHS = {"A": 0.0, "B": -90.0}
DESIGN = RidgeDesign(50.0, 10.0)


def test_the_map_of_a_plan_has_its_fields_where_the_plan_has_them():
    surface = plate_map(Plan(("AB.", "BAA"), AZIMUTHS, 0.4), DESIGN, 2.0)
    assert surface.shape == (400, 600)
    top_left, top_right = surface.height_um[200:, :200], surface.height_um[200:, 400:]
    assert np.array_equal(top_left, np.broadcast_to(top_left[:1], top_left.shape))  # ridges along y
    assert np.ptp(top_right) == 0.0
    assert surface.origin["plan"] == ["AB.", "BAA"]
    found = direction_regions(plate_map(Plan(("AB", "BA"), AZIMUTHS, 0.4), DESIGN, 2.0))
    assert sorted(found.azimuths_deg) == pytest.approx([-90.0, 0.0], abs=0.1)


def test_a_turned_plan_is_that_of_the_turned_map():
    plan = Plan(("AAB", "BAA"), AZIMUTHS, 0.2)
    turned = plate_map(plan.turned(1), DESIGN, 2.0)
    np.testing.assert_allclose(
        turned.height_um, np.rot90(plate_map(plan, DESIGN, 2.0).height_um, -1), atol=1e-9
    )
    assert plan.turned(4).rows == plan.rows


def test_a_code_becomes_light_and_dark_fields():
    plan = plan_of_modules(np.array([[False, True], [True, True]]), 0.2, (0.0, 90.0))
    assert plan.rows == ("AB", "BB")
    assert plan.classes().tolist() == [[0, 1], [1, 1]]
    assert plan.centre_mm(0, 0) == (-0.1, 0.1)
    assert read_rows(["# by hand", "A,B", "B;B", ""]) == plan.rows


def test_classes_may_have_a_ridge_angle_of_their_own_and_borders_a_draft():
    plan = Plan(("AB",), AZIMUTHS, 0.2, {"B": 5.0})
    assert plan.turned(1).ridge_angles_deg == {"B": 5.0}
    drafted = RidgeDesign(50.0, 10.0, 15.0)
    sharp, island = (plate_map(plan, drafted, 1.0, drafted=one).height_um for one in (False, True))
    assert np.ptp(sharp[:, :200]) > 1.9 * np.ptp(sharp[:, 200:])
    assert np.all(island[[0, -1]] < 0.5)
    assert np.all(island[:, [0, 199, 200, -1]] < 0.5)
    assert np.array_equal(island[10:-10, 10:190], sharp[10:-10, 10:190])
    # the steepest step at the border is that of the draft
    assert np.abs(np.diff(island[:, 100])).max() < 1.0 / np.tan(np.radians(15.0)) + 1e-9
    assert inner_share(drafted, 200.0) == pytest.approx(np.mean(island[:, :200] == sharp[:, :200]), abs=0.02)


@pytest.mark.parametrize(
    ("make", "match"),
    [
        (lambda: Plan((), AZIMUTHS, 0.2), "the plan has no fields"),
        (lambda: Plan(("AB", "A"), AZIMUTHS, 0.2), "row 2 of the plan has 1 fields, the first one 2"),
        (lambda: Plan(("AC",), AZIMUTHS, 0.2), r"row 1 of the plan holds 'C'.* \(known: A, B\)"),
        (lambda: Plan(("..",), AZIMUTHS, 0.2), "no field of the plan has ridges"),
        (lambda: Plan(("A" * 600,), AZIMUTHS, 0.2), "at most 512 × 512 fields"),
        (
            lambda: Plan(("A",), AZIMUTHS, 0.2, {"X": 5.0}),
            "a ridge angle is given for 'X', which is no class",
        ),
        (lambda: Plan(("A",), AZIMUTHS, -1.0), "positive number of mm, not -1"),
        (
            lambda: plate_map(Plan(("A",), AZIMUTHS, 0.09), DESIGN, 1.0),
            r"hold 1\.8 ridges of 50 µm, 2 are needed",
        ),
        (lambda: plate_map(Plan(("A",), AZIMUTHS, 0.2), DESIGN, 3.0), "no whole number of pixels of 3 µm"),
    ],
)
def test_a_plan_that_is_none_is_refused(make, match):
    with pytest.raises(HeightMapError, match=match):
        make()
