import numpy as np
import pytest

from anisoscope.base.errors import HeightMapError
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.profiles.ideal import ridges
from anisoscope.profiles.patterns import GrooveDesign, checkerboard, flat, turned_ridges, v_grooves
from anisoscope.profiles.period import find_period

DESIGN = RidgeDesign(50.0, 10.0)


def test_turned_by_nothing_they_are_the_ridges():
    one, two = (
        turned_ridges(DESIGN, (30, 200), (2.0, 0.7), phase=0.3),
        ridges(DESIGN, (30, 200), (2.0, 0.7), 0.3),
    )
    assert np.array_equal(one.height_um, two.height_um)
    assert (one.pixel_y_um, one.pixel_x_um) == (2.0, 0.7)
    assert one.origin["ideal"] == "ridges"


@pytest.mark.parametrize("direction", [30.0, -60.0, 90.0])
@pytest.mark.parametrize("pixel", [(1.0, 1.0), (1.5, 0.8)])
def test_turned_ridges_have_pitch_and_direction(direction, pixel):
    period = find_period(turned_ridges(DESIGN, (500, 500), pixel, direction_deg=direction))
    assert period.pitch_um == pytest.approx(50.0, rel=1e-3)
    assert period.direction_deg == pytest.approx(direction, abs=0.05)


def test_a_quarter_turn_turns_the_lean_counter_clockwise():
    """From falling toward +x to falling toward +y."""
    turned = turned_ridges(DESIGN, (200, 10), 1.0, direction_deg=90.0)
    upright = ridges(DESIGN, (10, 200), 1.0)
    assert np.allclose(turned.height_um, upright.height_um.T, atol=1e-9)
    assert np.median(np.diff(turned.height_um, axis=0)) == pytest.approx(-np.tan(np.radians(10.0)))


@pytest.mark.parametrize("land", [0.0, 12.0])
def test_grooves_have_flanks_depth_and_land(land):
    design = GrooveDesign(40.0, 35.0, land)
    surface = v_grooves(design, (4, 4000), 0.1, phase=0.25)
    z = surface.height_um[0]
    assert design.depth_um == pytest.approx((40.0 - land) / 2 * np.tan(np.radians(35.0)))
    assert np.ptp(z) == pytest.approx(design.depth_um, rel=1e-3)
    assert z[100] == pytest.approx(0.0, abs=1e-9)  # a bottom at 0.25 of the pitch
    slopes = np.abs(np.diff(z)) / 0.1
    assert np.median(slopes[slopes > 1e-6]) == pytest.approx(np.tan(np.radians(35.0)))
    assert np.mean(z > design.depth_um - 1e-9) == pytest.approx(land / 40.0, abs=0.01)
    # volume above the bottom of a triangle is half its box
    assert z.mean() == pytest.approx(design.depth_um * (0.5 + 0.5 * land / 40.0), rel=0.01)
    assert np.allclose(design.profile(np.array([-7.0])), design.profile(np.array([7.0])))


def test_a_checkerboard_has_both_directions_and_a_quarter_turn_exchanges_them():
    board = checkerboard(DESIGN, (400, 600), 1.0, 200.0)
    z = board.height_um
    first, second = z[:200, :200], z[:200, 200:400]
    assert np.array_equal(first, np.broadcast_to(first[0], first.shape))
    assert np.array_equal(second, np.broadcast_to(second[:, :1], second.shape))
    assert np.array_equal(z[200:, 200:400], first)
    assert np.array_equal(z[200:, :200], second)
    assert np.median(np.diff(first, axis=1)) == pytest.approx(-np.tan(np.radians(10.0)))
    assert np.median(np.diff(second, axis=0)) == pytest.approx(np.tan(np.radians(10.0)))  # leans toward −y


def test_flat_is_flat():
    surface = flat((3, 4), (2.0, 1.0))
    assert not surface.height_um.any()
    assert surface.extent_um == (6.0, 4.0)


@pytest.mark.parametrize(
    "make",
    [
        lambda: GrooveDesign(0.0, 30.0),
        lambda: GrooveDesign(10.0, 0.0),
        lambda: GrooveDesign(10.0, 85.0),
        lambda: GrooveDesign(10.0, 30.0, 10.0),
        lambda: checkerboard(DESIGN, (20, 20), 1.0, 0.5),
        lambda: flat((1, 5), 1.0),
        lambda: flat((5, 5), 0.0),
    ],
)
def test_patterns_that_cannot_be(make):
    with pytest.raises(HeightMapError):
        make()
