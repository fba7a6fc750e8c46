import numpy as np
import pytest

from anisoscope.base.errors import HeightMapError, UsageError
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.profiles.textures.filters import (
    gaussian_mean,
    scale_limited,
    transmission,
    weights,
    without_form,
)
from anisoscope.profiles.textures.texture import heights, texture


def wave(period, shape=(64, 800), pixel=(1.0, 1.0), axis=1):
    place = np.arange(shape[axis]) * pixel[axis]
    z = np.cos(2 * np.pi * place / period)
    return HeightMap(np.broadcast_to(z if axis == 1 else z[:, None], shape), pixel[1], pixel[0])


@pytest.mark.parametrize(("axis", "pixel"), [(1, (1.0, 1.0)), (1, (2.0, 0.5)), (0, (0.5, 2.0))])
@pytest.mark.parametrize("ratio", [0.5, 1.0, 2.0])
def test_the_filter_passes_half_at_its_nesting_index(axis, pixel, ratio):
    """ISO 16610-61: the amplitude passes by 2^−(λc/λ)²."""
    cutoff = 40.0
    shape = (64, 1200) if axis == 1 else (1200, 64)
    surface = wave(ratio * cutoff, shape, pixel, axis)
    mean = gaussian_mean(
        surface, 0.999 * min(surface.extent_um) if cutoff > min(surface.extent_um) else cutoff
    )
    used = min(cutoff, 0.999 * min(surface.extent_um))
    inner = slice(400, 800)
    before = surface.height_um[32, inner] if axis == 1 else surface.height_um[inner, 32]
    after = mean[32, inner] if axis == 1 else mean[inner, 32]
    gain = float(after @ before / (before @ before))
    assert gain == pytest.approx(2.0 ** -((used / (ratio * cutoff)) ** 2), abs=2e-3)


def test_transmission_of_the_sampled_filter():
    assert transmission(40.0, 1.0, 40.0) == pytest.approx(0.5, abs=1e-5)
    assert transmission(4.0, 1.0, 4.0) == pytest.approx(0.5, abs=3e-3)
    assert transmission(2.0, 1.0, 2.0) == pytest.approx(
        8 / 9, abs=1e-2
    )  # weights 1/16, 1, 1/16 … at the pixels
    assert transmission(10.0, 1.0, 1e9) == pytest.approx(1.0)
    assert weights(10.0, 1.0).sum() == pytest.approx(1.0)


def test_constants_stay_at_ends_and_beside_gaps():
    z = np.full((60, 70), 3.25)
    z[20:40, 30:33] = np.nan
    mean = gaussian_mean(HeightMap(z, 1.0, 2.0), 20.0)
    assert np.isnan(mean).sum() == 60
    assert np.nanmax(np.abs(mean - 3.25)) < 1e-12


def test_missing_points_hardly_change_the_mean_surface():
    surface = wave(100.0, (200, 400))
    z = surface.height_um.copy()
    z[np.random.default_rng(0).random(z.shape) < 0.2] = np.nan
    known = np.isfinite(z)
    full, part = gaussian_mean(surface, 30.0), gaussian_mean(surface.with_height(z), 30.0)
    assert np.abs(full - part)[known].max() < 0.05
    assert np.abs(full - part)[known].mean() < 0.005


def test_low_and_high_waves_go_to_their_filters():
    shape, pixel = (200, 1000), (1.0, 1.0)
    short, middle, long = (wave(period, shape, pixel).height_um for period in (5.0, 50.0, 1000.0))
    surface = HeightMap(short + middle + long, 1.0, 1.0)
    limited = scale_limited(surface, form="none", s_filter_um=15.0, l_filter_um=180.0)
    inner = (slice(None), slice(200, 800))
    left = limited.map.height_um[inner] - middle[inner]
    assert np.sqrt(np.mean(left**2)) < 0.1
    assert "S-L" in limited.name
    assert limited.map.origin["filtering"] == {
        "form": "none",
        "s_filter_um": 15.0,
        "l_filter_um": 180.0,
        "s_filter": "gaussian",
        "l_filter": "gaussian",
    }


def test_forms_are_removed_exactly_with_gaps_and_oblong_pixels():
    y, x = np.mgrid[:90, :120]
    rng = np.random.default_rng(0)
    plane, bowl = 2.0 + 0.3 * x - 0.1 * y, 1e-3 * x**2 - 2e-3 * x * y + 3e-3 * y**2
    gaps = rng.random(plane.shape) < 0.3
    for form, shape in (("plane", plane), ("poly2", plane + bowl)):
        left = without_form(HeightMap(np.where(gaps, np.nan, shape), 2.0, 0.5), form)
        assert np.nanmax(np.abs(left)) < 1e-10
    assert np.nanmax(np.abs(without_form(HeightMap(plane + bowl, 1.0, 1.0), "plane"))) > 1.0
    assert np.ptp(without_form(HeightMap(plane, 1.0, 1.0), "none")) == pytest.approx(np.ptp(plane))


def test_tilt_does_not_reach_the_ends_through_the_s_filter():
    x = np.arange(300.0)
    z = np.random.default_rng(1).standard_normal((300, 300)) * 0.01
    level = scale_limited(HeightMap(z, 1.0, 1.0), s_filter_um=20.0)
    tilted = scale_limited(HeightMap(z + 0.5 * x, 1.0, 1.0), s_filter_um=20.0)
    assert np.abs(level.map.height_um - tilted.map.height_um).max() < 1e-9


def test_filters_only_take_away():
    z = np.random.default_rng(2).standard_normal((200, 200)).cumsum(axis=0).cumsum(axis=1) * 0.01
    surface = HeightMap(z, 1.0, 1.0)
    all_of_it, smooth, narrow = (
        texture(surface, s_filter_um=s, l_filter_um=limit)
        for s, limit in ((None, None), (5.0, None), (5.0, 50.0))
    )
    assert narrow.heights.sq_um < smooth.heights.sq_um < all_of_it.heights.sq_um
    assert narrow.spatial.sal_um < smooth.spatial.sal_um
    assert heights(narrow.surface.map).sa_um == narrow.heights.sa_um


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"s_filter_um": 3.9}, "two pixels"),
        ({"s_filter_um": -1.0}, "two pixels"),
        ({"s_filter_um": float("nan")}, "two pixels"),
        ({"l_filter_um": 51.0}, "field"),
        ({"s_filter_um": 20.0, "l_filter_um": 10.0}, "below the L-filter"),
        ({"form": "cone"}, "form"),
    ],
)
def test_filters_that_cannot_be(arguments, message):
    surface = HeightMap(np.random.default_rng(0).standard_normal((50, 50)), 2.0, 1.0)
    with pytest.raises(HeightMapError, match=message):
        scale_limited(surface, **arguments)


def test_points_on_one_line_do_not_determine_a_plane():
    z = np.full((30, 30), np.nan)
    z[4] = 1.0
    with pytest.raises(HeightMapError, match="determine"):
        without_form(HeightMap(z, 1.0, 1.0), "plane")


@pytest.mark.parametrize("kind", ["gaussian", "robust", "spline"])
def test_every_kind_separates_short_from_long_waves(kind):
    """Waves of 8 and 80 µm between filters of 25 and 240: each filter takes one of them away and leaves the other."""
    y, x = np.mgrid[:160, :100] * 1.0
    short, long = np.cos(2 * np.pi * x / 8.0), np.cos(2 * np.pi * y / 80.0)
    surface = HeightMap(short + long + 1e-3 * x, 1.0, 1.0)
    smooth = scale_limited(surface, s_filter_um=25.0, s_filter=kind)
    rough = scale_limited(surface, l_filter_um=25.0, l_filter=kind)
    inner = (slice(40, -40), slice(30, -30))
    gain = 2.0 ** -((25.0 / 80.0) ** 2) if kind == "gaussian" else 1.0
    np.testing.assert_allclose(smooth.map.height_um[inner], gain * long[inner], atol=0.06)
    np.testing.assert_allclose(rough.map.height_um[inner], (short + (1.0 - gain) * long)[inner], atol=0.06)
    assert (smooth.s_filter, rough.l_filter) == (kind, kind)
    assert smooth.map.origin["filtering"]["s_filter"] == kind


def test_a_robust_l_filter_leaves_deep_dales_their_depth():
    """Grooves 3 µm deep over a tenth of a wavy surface pull at Gaussian and spline, not at the robust mean."""
    x = np.arange(200.0)
    z = 0.5 * np.cos(2 * np.pi * x / 200.0) + 0.02 * np.random.default_rng(0).standard_normal((55, 200))
    groove = np.broadcast_to((x + 20.0) % 50.0 < 5.0, z.shape)
    surface = HeightMap(np.where(groove, z - 3.0, z), 1.0, 1.0)
    plateau, depth = {}, {}
    for kind in ("gaussian", "robust", "spline"):
        height = scale_limited(surface, form="none", l_filter_um=50.0, l_filter=kind).map.height_um
        plateau[kind], depth[kind] = np.std(height[~groove]), -np.mean(height[groove])
    assert plateau["robust"] < 0.03
    assert min(plateau["gaussian"], plateau["spline"]) > 0.1
    assert depth["robust"] == pytest.approx(2.7, abs=0.03)  # from the mean, which lies 0.1 of the depth down


def test_filters_that_there_are_not():
    with pytest.raises(UsageError, match="gaussian, robust or spline"):
        scale_limited(wave(50.0, (40, 40)), s_filter_um=5.0, s_filter="median")
