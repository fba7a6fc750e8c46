"""Filters of ISO 16610 against their transmission, their weights, and each other."""

import numpy as np
import pytest

from anisoscope.base.errors import HeightMapError
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.profiles.textures.filters import (
    gaussian_mean,
    morphological,
    robust_gaussian_mean,
    spline_mean,
)


def wave(length, count=2000, axis="x", rows=3):
    z = np.broadcast_to(np.cos(2 * np.pi * np.arange(count) / length), (rows, count))
    return HeightMap(z, 1.0, 1.0) if axis == "x" else HeightMap(z.T, 1.0, 1.0)


def passed(found, surface):
    """Share of the amplitude in the middle half of the field."""
    mean, z = (
        one[:, one.shape[1] // 4 : 3 * one.shape[1] // 4] if one.shape[1] > one.shape[0] else
        one[one.shape[0] // 4 : 3 * one.shape[0] // 4]
        for one in (found, surface.height_um)
    )  # fmt: skip
    return float(np.sum(mean * z) / np.sum(z * z))


@pytest.mark.parametrize("axis", ["x", "y"])
@pytest.mark.parametrize("ratio", [0.5, 1.0, 2.0, 4.0])
def test_transmission_of_gaussian_and_spline(axis, ratio):
    """exp(−π(αλc/λ)²) with α² = ln 2/π, and 1/(1 + (sin(πΔ/λ)/sin(πΔ/λc))⁴)."""
    surface = wave(50.0 * ratio, axis=axis)
    assert passed(gaussian_mean(surface, 50.0, direction=axis), surface) == pytest.approx(
        np.exp(-np.log(2.0) / ratio**2), abs=2e-4
    )
    expected = 1.0 / (1.0 + (np.sin(np.pi / (50.0 * ratio)) / np.sin(np.pi / 50.0)) ** 4)
    assert passed(spline_mean(surface, 50.0, direction=axis), surface) == pytest.approx(expected, abs=2e-4)


def test_along_one_axis_lines_know_nothing_of_each_other():
    z = np.random.default_rng(0).standard_normal((6, 80))
    z[2, 10:14] = np.nan
    for mean in (gaussian_mean, robust_gaussian_mean, spline_mean):
        whole = mean(HeightMap(z, 1.0, 7.0), 10.0, direction="x")
        single = mean(HeightMap(z[1:3], 1.0, 7.0), 10.0, direction="x")
        shift = 0.0 if mean is not robust_gaussian_mean else 0.6  # its weights come from all residuals
        np.testing.assert_allclose(whole[1:3], single, atol=1e-12 + shift)
    assert np.isnan(whole[2, 10:14]).all()
    assert np.count_nonzero(np.isnan(whole)) == 4


@pytest.mark.parametrize("order", [0, 1, 2])
@pytest.mark.parametrize("mean", [gaussian_mean, robust_gaussian_mean])
def test_regression_follows_a_polynomial_of_its_order_to_ends_and_gaps(mean, order):
    y, x = np.mgrid[:40, :60] * 1.0
    shapes = [np.full(x.shape, 3.0), 0.3 * x - 0.2 * y, 0.01 * x * x - 0.02 * x * y + 0.005 * y * y]
    z = sum(shapes[: order + 1])
    z[5:9, 20:30] = np.nan
    z[np.random.default_rng(1).random(z.shape) < 0.1] = np.nan
    found = mean(HeightMap(z, 2.0, 1.0), 12.0, order=order)
    np.testing.assert_allclose(found, z, atol=1e-8)
    if order < 2:
        bent = mean(HeightMap(z + shapes[2], 2.0, 1.0), 12.0, order=order)
        assert np.nanmax(np.abs(bent - z - shapes[2])) > 1e-3


def test_robust_filter_passes_by_deep_grooves():
    """Grooves over a tenth of a wavy surface: the robust mean stays on the wave, the plain one does not."""
    x = np.arange(400.0)
    base = 0.5 * np.sin(2 * np.pi * x / 200.0)
    z = np.tile(base, (12, 1)) + 0.01 * np.random.default_rng(3).standard_normal((12, 400))
    z[:, (x % 40) < 4] -= 10.0
    surface = HeightMap(z, 1.0, 1.0)
    inner = slice(20, 380)
    robust = robust_gaussian_mean(surface, 60.0, direction="x", order=2)[:, inner] - base[inner]
    plain = gaussian_mean(surface, 60.0, direction="x")[:, inner] - base[inner]
    assert np.abs(robust).max() < 0.03
    assert np.abs(plain).max() > 0.9


def test_the_areal_spline_is_separable():
    """A wave of the nesting index at 45° is one of √2 times that length along both axes: 0.8 · 0.8 of it pass."""
    y, x = np.indices((240, 240))
    surface = HeightMap(np.cos(2.0 * np.pi * (x + y) / (40.0 * np.sqrt(2.0))), 1.0, 1.0)
    middle = slice(60, -60)
    mean = spline_mean(surface, 40.0)[middle, middle]
    wave = surface.height_um[middle, middle]
    assert np.sum(mean * wave) / np.sum(wave * wave) == pytest.approx(0.64, abs=0.01)


def test_spline_follows_a_slope_and_bridges_gaps():
    z = np.tile(0.3 * np.arange(100.0), (4, 1))
    z[1, 40:60] = np.nan
    z[2] = np.nan
    z[3, 1:] = np.nan
    found = spline_mean(HeightMap(z, 1.0, 1.0), 20.0, direction="x")
    np.testing.assert_allclose(found, z, atol=1e-9)


def test_rolling_ball_on_single_points_is_a_ball():
    z = np.zeros((41, 41))
    z[20, 20] = 3.0
    found = morphological(HeightMap(z, 1.0, 1.0), 6.0)
    r = np.hypot(*(np.mgrid[:41, :41] - 20.0))
    # highest centre of a ball that still touches the spike and the plane, seen from below
    assert found[20, 20] == 3.0
    assert (found >= z).all()
    assert found[r > 12].max() == pytest.approx(0.0)
    cut = morphological(HeightMap(z, 1.0, 1.0), 6.0, closing=False)
    assert cut[20, 20] < 0.2  # a ball from below does not enter the spike
    flat = morphological(HeightMap(z, 1.0, 1.0), 6.0, closing=False, element="disk")
    assert (flat == 0.0).all()


def test_morphological_filters_are_extensive_idempotent_and_dual():
    rng = np.random.default_rng(4)
    z = rng.standard_normal((40, 50))
    z[rng.random(z.shape) < 0.1] = np.nan
    surface = HeightMap(z, 1.0, 2.0)
    known = np.isfinite(z)
    for element in ("ball", "disk"):
        up = morphological(surface, 5.0, element=element)
        down = morphological(surface, 5.0, closing=False, element=element)
        assert (up[known] >= z[known] - 1e-12).all()
        assert (down[known] <= z[known] + 1e-12).all()
        assert np.isnan(up[~known]).all()
        np.testing.assert_allclose(
            down, -morphological(surface.with_height(-z), 5.0, element=element), atol=1e-12
        )
        again = morphological(surface.with_height(up), 5.0, element=element)
        np.testing.assert_allclose(again, up, atol=1e-12)


def test_a_groove_narrower_than_the_disk_is_closed_and_a_wider_one_is_not():
    z = np.zeros((30, 100))
    z[:, 20:27] = z[:, 50:75] = -1.0
    found = morphological(HeightMap(z, 1.0, 1.0), 5.0, element="disk")
    assert (found[5:-5, 20:27] == 0.0).all()  # at the ends of the field nothing bounds the disk beyond
    assert (found[8:-8, 55:70] == -1.0).all()


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda s: gaussian_mean(s, 5.0, order=3), "order"),
        (lambda s: gaussian_mean(s, 5.0, direction="z"), "along"),
        (lambda s: spline_mean(s, 1.0), "two pixels"),
        (lambda s: gaussian_mean(s, 45.0, direction="x"), "field"),
        (lambda s: morphological(s, 0.5), "smaller than a pixel"),
        (lambda s: morphological(s, 200.0), "at most"),
        (lambda s: morphological(s, float("nan")), "smaller than a pixel"),
    ],
)
def test_filters_that_cannot_be(call, message):
    with pytest.raises(HeightMapError, match=message):
        call(HeightMap(np.eye(40), 1.0, 2.0))


def test_the_longer_axis_holds_a_longer_cutoff():
    surface = HeightMap(np.random.default_rng(0).random((10, 200)), 1.0, 1.0)
    gaussian_mean(surface, 60.0, direction="x")
    with pytest.raises(HeightMapError, match="field"):
        gaussian_mean(surface, 60.0)
