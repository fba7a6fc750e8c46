from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from anisoscope.base.errors import HeightMapError
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.profiles.ideal import add_facet_roughness, ridges
from anisoscope.profiles.textures.amplitude import amplitude


@settings(deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow])
@given(pitch=st.floats(10, 500), angle=st.floats(0.5, 44.5))
def test_perpendicular_wall_in_closed_form(pitch, angle):
    design = RidgeDesign(pitch, angle)
    theta = np.radians(angle)
    assert design.facet_width_um == pytest.approx(pitch * np.cos(theta) ** 2)
    assert design.wall_width_um == pytest.approx(pitch * np.sin(theta) ** 2)
    assert design.height_um == pytest.approx(pitch * np.sin(theta) * np.cos(theta))
    facet = np.array([design.facet_width_um, -design.height_um])
    wall = np.array([design.wall_width_um, design.height_um])
    assert facet @ wall == pytest.approx(0.0, abs=1e-9 * pitch**2)


@settings(deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow])
@given(angle=st.floats(1.0, 40.0), loss=st.floats(0.0, 1.0))
def test_facets_lean_toward_plus_x_at_the_ridge_angle(angle, loss):
    design = RidgeDesign(100.0, angle, height_loss=loss)
    low = (1.0 - 0.9 * (1.0 - loss)) * design.facet_width_um
    x = np.array([low, 0.5 * (low + design.facet_width_um)])
    slope = (
        float(np.diff(design.profile(x))[0] / np.diff(x)[0]) if loss < 0.999 else -np.tan(np.radians(angle))
    )
    normal = np.array([-slope, 1.0]) / np.hypot(slope, 1.0)
    np.testing.assert_allclose(normal, [np.sin(np.radians(angle)), np.cos(np.radians(angle))], atol=1e-6)


@pytest.mark.parametrize("wall", ["perpendicular", "vertical"])
@pytest.mark.parametrize("loss", [0.0, 0.3])
def test_height_foot_and_plateau(wall, loss):
    design = RidgeDesign(100.0, 10.0, wall, loss)
    profile = design.profile(np.linspace(0.0, 100.0, 100_001))
    assert profile.max() == pytest.approx((1 - loss) * design.full_height_um)
    assert profile.min() == pytest.approx(0.0, abs=0.02)
    plateau = np.mean(profile >= profile.max() - 1e-9) * 100.0
    assert plateau == pytest.approx(design.height_loss * design.pitch_um, abs=0.01)


def test_map_is_constant_along_y_and_repeats_along_x():
    surface = ridges(RidgeDesign(50.0, 12.0), (30, 200), (2.0, 0.5), phase=0.25)
    assert surface.pixel_y_um == 2.0
    assert np.ptp(surface.height_um, axis=0).max() == 0.0
    np.testing.assert_allclose(surface.height_um[0, :100], surface.height_um[0, 100:], atol=1e-9)
    assert int(np.argmax(surface.height_um[0])) * 0.5 == pytest.approx(12.5)


def test_flat_design():
    assert np.ptp(ridges(RidgeDesign(50.0, 0.0), (5, 9), 1.0).height_um) == 0.0


@pytest.mark.parametrize(
    "arguments",
    [
        (0.0, 10.0),
        (np.nan, 10.0),
        (100.0, -1.0),
        (100.0, 45.0),
        (100.0, 10.0, "steep"),
        (1.0, 1.0, "vertical", 1.5),
    ],
)
def test_designs_that_cannot_be(arguments):
    with pytest.raises(HeightMapError):
        RidgeDesign(*arguments)


@pytest.mark.parametrize(
    ("along", "across", "length", "pixel"),
    [(0.06, 0.10, 5.0, (1.0, 1.0)), (0.1, 0.03, 8.0, (2.0, 1.0)), (0.2, 0.2, 3.0, (1.0, 1.0))],
)
def test_roughness_has_the_slopes_asked_for(along, across, length, pixel):
    flat = HeightMap(np.zeros((700, 700)), pixel[1], pixel[0])
    found = []
    for seed in range(5):  # of whose mean the standard deviation is .35 %
        z = add_facet_roughness(flat, along, across, length, np.random.default_rng(seed)).height_um
        found.append((np.std(np.diff(z, axis=0)) / pixel[0], np.std(np.diff(z, axis=1)) / pixel[1]))
    np.testing.assert_allclose(np.mean(found, axis=0), np.array([along, across]) / np.sqrt(2.0), rtol=0.015)


def test_roughness_height_and_correlation_follow_the_formula():
    flat = HeightMap(np.zeros((800, 800)), 1.0, 1.0)
    z = add_facet_roughness(flat, 0.05, 0.1, 12.0, np.random.default_rng(0)).height_um
    assert z.std() == pytest.approx(12.0 * np.sqrt(0.05 * 0.1) / 2.0, rel=0.06)
    lx, ly = 12.0 * np.sqrt(0.5), 12.0 * np.sqrt(2.0)
    shift = round(lx)
    assert np.mean(z[:, shift:] * z[:, :-shift]) / z.var() == pytest.approx(
        np.exp(-((shift / lx) ** 2)), abs=0.06
    )
    shift = round(ly)
    assert np.mean(z[shift:] * z[:-shift]) / z.var() == pytest.approx(np.exp(-((shift / ly) ** 2)), abs=0.06)


def test_roughness_in_one_direction_reproducible_and_with_gaps():
    flat = HeightMap(np.where(np.eye(60) > 0, np.nan, 0.0), 1.0, 1.0)
    one, two = (add_facet_roughness(flat, 0.0, 0.1, 4.0, np.random.default_rng(3)) for _ in range(2))
    assert np.array_equal(one.height_um, two.height_um, equal_nan=True)
    assert np.array_equal(np.isnan(one.height_um), np.isnan(flat.height_um))
    assert np.nanmax(np.abs(np.diff(one.height_um, axis=0))) < 1e-12
    assert add_facet_roughness(flat, 0.0, 0.0, 4.0, np.random.default_rng(3)) is flat


def test_roughness_finer_than_the_pixels_is_refused():
    flat = HeightMap(np.zeros((60, 60)), 4.0, 4.0)
    with pytest.raises(HeightMapError, match="cannot be sampled"):
        add_facet_roughness(flat, 0.05, 0.1, 3.0, np.random.default_rng(0))
    with pytest.raises(HeightMapError, match="negative"):
        add_facet_roughness(flat, -0.05, 0.1, 30.0, np.random.default_rng(0))


def test_amplitude_of_a_known_profile_ignores_gaps():
    z = np.tile([0.0, 2.0], (4, 3))
    z[0, 0] = z[1, 1] = np.nan
    found = amplitude(HeightMap(z, 1.0, 1.0))
    assert (found.sa_um, found.sq_um, found.sz_um) == pytest.approx((1.0, 1.0, 2.0))
    with pytest.raises(HeightMapError, match="missing"):
        amplitude(HeightMap(np.full((3, 3), np.nan), 1.0, 1.0))


@pytest.mark.parametrize("angle", [5.0, 20.0])
def test_a_draft_angle_is_that_of_the_wall(angle):
    for draft, named in ((angle, "perpendicular"), (0.0, "vertical")):
        one, other = RidgeDesign(100.0, angle, draft), RidgeDesign(100.0, angle, named)
        assert one.facet_width_um == pytest.approx(other.facet_width_um, rel=1e-12)
        assert one.full_height_um == pytest.approx(other.full_height_um, rel=1e-12)
    steep = RidgeDesign(100.0, angle, 30.0)
    assert steep.wall_width_um / steep.full_height_um == pytest.approx(np.tan(np.radians(30.0)))
    assert steep.full_height_um / steep.facet_width_um == pytest.approx(np.tan(np.radians(angle)))
    assert steep.wall_length_um == pytest.approx(np.hypot(steep.wall_width_um, steep.full_height_um))


@pytest.mark.parametrize("wall", ["perpendicular", "vertical", 25.0])
def test_a_rounded_crest_is_what_a_ball_reaches(wall):
    """The opening of the sharp profile by a disc, point by point."""
    design, radius = RidgeDesign(100.0, 15.0, wall, edge_radius_um=6.0), 6.0
    x = np.arange(-100.0, 100.0, 0.05)
    sharp = RidgeDesign(100.0, 15.0, wall).profile(x)
    offset = np.arange(-radius, radius + 0.01, 0.05)
    rim = np.sqrt(np.maximum(radius**2 - offset**2, 0.0))
    wide = [np.interp(x + d, x, sharp) - h for d, h in zip(offset, rim, strict=True)]
    centre = np.min(wide, axis=0)
    opened = np.max([np.interp(x - d, x, centre) + h for d, h in zip(offset, rim, strict=True)], axis=0)
    middle = (np.abs(x) < 60.0) & (np.abs(x) > 1.0)  # a vertical wall, and what rises steeply beside it
    off = np.abs(np.minimum(opened, sharp) - design.profile(x))[middle]
    assert np.max(off) < 0.1
    assert np.max(sharp - design.profile(x)) > 1.0


@pytest.mark.parametrize("wall", ["perpendicular", "vertical", 25.0])
def test_a_rounded_foot_is_a_crest_upside_down(wall):
    """Turned by half a circle the ridges are the same; a plateau cuts both."""
    crest, foot = (RidgeDesign(100.0, 15.0, wall, **{f"{end}_radius_um": 6.0}) for end in ("edge", "foot"))
    x = np.arange(0.5, 100.0, 0.5)
    turned = crest.full_height_um - foot.profile(foot.facet_width_um - x)
    np.testing.assert_allclose(turned, crest.profile(x), atol=1e-9)
    full = replace(foot, height_loss=0.8)
    np.testing.assert_allclose(full.profile(x), np.minimum(foot.profile(x), full.height_um), atol=1e-9)
    for one in (foot, full, replace(crest, foot_radius_um=3.0)):
        corners = one.outline(widest_rad=0.02)
        inner = corners.x_um[0] + 1e-9
        ends = np.abs(one.profile(inner) - corners.z_um[0])
        assert np.quantile(ends, 0.9) < 1e-4  # but for a vertical wall


@pytest.mark.parametrize(
    "wrong",
    [
        {"foot_radius_um": -1.0},
        {"foot_radius_um": 1000.0},
        {"foot_radius_um": 12.0, "edge_radius_um": 12.0},
        {"wall": -1.0},
        {"wall": 80.0},
        {"wall": "slanting"},
        {"edge_radius_um": -1.0},
        {"edge_radius_um": 1000.0},
    ],
)
def test_impossible_walls_and_edges_are_refused(wrong):
    with pytest.raises(HeightMapError):
        RidgeDesign(100.0, 10.0, **wrong)


@pytest.mark.parametrize("direction", [0.0, 90.0, 30.0, -50.0])
@pytest.mark.parametrize("alphas", [(0.05, 0.15), (0.1, 0.0), (0.0, 0.1)])
def test_roughness_follows_the_direction(direction, alphas):
    """Rms slopes along and across, from the gradient of a field that is smooth over the pixels."""
    flat = HeightMap(np.zeros((500, 600)), 1.0, 1.0)
    rough = add_facet_roughness(flat, *alphas, 10.0, np.random.default_rng(4), direction_deg=direction)
    slope_y, slope_x = np.gradient(rough.height_um)
    a = np.radians(direction)
    along = np.sqrt(2.0) * np.std(slope_y * np.cos(a) - slope_x * np.sin(a))
    across = np.sqrt(2.0) * np.std(slope_x * np.cos(a) + slope_y * np.sin(a))
    spread = 0.08 if min(alphas) > 0.0 else 0.3  # a profile of some forty correlation lengths
    assert along == pytest.approx(alphas[0], rel=spread, abs=1e-3)
    assert across == pytest.approx(alphas[1], rel=spread, abs=1e-3)
