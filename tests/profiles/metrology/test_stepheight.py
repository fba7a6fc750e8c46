"""Steps and grooves of known height, with tilt, noise, rounded edges and gaps (ISO 5436-1)."""

import numpy as np
import pytest

from anisoscope.base.errors import HeightMapError
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.profiles.metrology.stepheight import step_height

PIXEL = 0.5
X = np.arange(400) * PIXEL


def groove(depth=1.2, edges=(80.0, 120.0), tilt_deg=0.0, rounding=0.0, noise=0.0, lines=60, seed=1):
    """A groove (negative: a ridge) whose edges are rounded like an error function of this width, in µm."""
    from scipy.special import erf

    inside = (edges[0] < X) & (edges[1] > X) if rounding == 0.0 else 0.5 * (
        erf((X - edges[0]) / rounding) - erf((X - edges[1]) / rounding)
    )  # fmt: skip
    line = -depth * inside + np.tan(np.radians(tilt_deg)) * X
    return line + noise * np.random.default_rng(seed).standard_normal((lines, X.size))


@pytest.mark.parametrize("depth", [1.2, -0.8])
@pytest.mark.parametrize("tilt_deg", [0.0, 0.3])
def test_a_groove_of_sharp_edges_has_its_depth(depth, tilt_deg):
    found = step_height(HeightMap(groove(depth, tilt_deg=tilt_deg), PIXEL, 1.0), edges_um=(80.0, 120.0))
    assert found.height_um == pytest.approx(-depth, abs=1e-9)
    assert found.kind == ("groove" if depth > 0.0 else "ridge")
    assert found.slope_deg == pytest.approx(tilt_deg, abs=1e-9)
    assert found.lines == 60


def test_edges_are_found_along_x_and_y():
    height = groove(rounding=2.0)
    for surface, direction in ((HeightMap(height, PIXEL, 1.0), "x"), (HeightMap(height.T, 1.0, PIXEL), "y")):
        found = step_height(surface, direction)
        assert found.edges_um == pytest.approx((80.0, 120.0), abs=0.1)
        assert found.height_um == pytest.approx(-1.2, abs=1e-6)  # rounded edges do not count


def test_uncertainty_holds_the_true_depth():
    """Of 200 drawn grooves with noise 95 % are within 2 u."""
    within = []
    for seed in range(200):
        found = step_height(
            HeightMap(groove(noise=0.05, seed=seed, lines=20), PIXEL, 1.0), edges_um=(80.0, 120.0)
        )
        within.append(abs(found.height_um + 1.2) <= 2.0 * found.u_um)
    assert 0.9 <= np.mean(within) <= 0.99


def test_rounded_heights_have_their_digit_in_u():
    coarse = np.round(groove(depth=1.23) / 0.1) * 0.1
    found = step_height(HeightMap(coarse, PIXEL, 1.0), edges_um=(80.0, 120.0))
    assert found.scatter_um == pytest.approx(0.0, abs=1e-9)
    assert abs(found.height_um + 1.23) <= 2.0 * found.u_um  # all lines share the error: no mean removes it
    fine = np.round(groove(depth=1.23, noise=0.1) / 0.1) * 0.1
    found = step_height(HeightMap(fine, PIXEL, 1.0), edges_um=(80.0, 120.0))
    assert found.u_um < 0.01
    assert abs(found.height_um + 1.23) <= 3.0 * found.u_um


def test_a_single_step_and_gaps():
    height = np.where(X > 90.0, 0.7, 0.0) + 0.002 * np.random.default_rng(2).standard_normal((50, X.size))
    height[10:20, 100:300] = np.nan
    height[25] = np.nan
    found = step_height(HeightMap(height, PIXEL, 1.0))
    assert found.kind == "step"
    assert found.height_um == pytest.approx(0.7, abs=3.0 * found.u_um + 1e-6)
    assert found.lines == 49
    assert found.edges_um[0] == pytest.approx(90.2, abs=0.5)


@pytest.mark.parametrize(
    ("height", "edges", "message"),
    [
        (np.zeros((5, 400)), (), "the surface is flat"),
        (np.tile(np.sin(X / 5.0), (5, 1)), (), "crosses its middle .* times"),
        (
            groove(),
            (80.0, 500.0),
            r"one edge of a step or two of a groove, between 0 and 199\.5 µm, not 80, 500",
        ),
        (groove(), (10.0, 20.0, 30.0), "one edge of a step or two"),
        (groove(), (80.0, 80.0), "one edge of a step or two"),
        (groove(edges=(1.0, 199.0)), (1.0, 199.0), "a groove needs its own width on either side"),
        (groove(), (80.0, 81.0), "3 are needed"),
        (np.where(X > 90.0, np.nan, groove()), (92.0,), "no line has 3 points"),
    ],
)
def test_what_is_no_step(height, edges, message):
    with pytest.raises(HeightMapError, match=message):
        step_height(HeightMap(height, PIXEL, 1.0), edges_um=edges)
