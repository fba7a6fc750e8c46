"""Hills, dales and the dominant wavelength of surfaces of closed form."""

import numpy as np
import pytest

from anisoscope.base.errors import HeightMapError
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.profiles.textures.features import features, hills
from anisoscope.profiles.textures.spectra import dominant_wavelength
from anisoscope.profiles.textures.texture import texture

PERIOD, HEIGHT = 24.0, 1.5


def egg_box(shape=(120, 144), pixel=(1.0, 1.0), noise=0.0):
    y, x = np.mgrid[: shape[0], : shape[1]]
    k = 2 * np.pi / PERIOD
    z = HEIGHT * (np.cos(k * (x * pixel[1] - 12.0)) + np.cos(k * (y * pixel[0] - 12.0)))
    return HeightMap(z + noise * np.random.default_rng(0).standard_normal(shape), pixel[1], pixel[0])


@pytest.mark.parametrize("pixel", [(1.0, 1.0), (1.0, 0.5)])
def test_egg_box(pixel):
    surface = egg_box((120, int(144 / pixel[1])), pixel)
    found = features(surface)
    assert found.peaks == 5 * 6
    assert found.spd_per_um2 == pytest.approx(1.0 / PERIOD**2)
    assert (found.s5p_um, found.s5v_um, found.s10z_um) == pytest.approx((3.0, 3.0, 6.0), rel=1e-9)
    # −½∇²z at a peak is A·k², here of differences: A·(2 sin(kΔ/2)/Δ)²
    curvature = sum((2.0 * np.sin(np.pi * p / PERIOD) / p) ** 2 for p in pixel) * 0.5 * HEIGHT
    assert found.spc_per_um == pytest.approx(curvature, rel=1e-9)
    assert found.sha_um2 == pytest.approx(PERIOD**2, rel=0.03)
    # above its saddles at z = 0, a hill is the diamond |x| + |y| ≤ P/2; its volume is 4A(P/π)²
    assert found.shv_um3 == pytest.approx(4.0 * HEIGHT * (PERIOD / np.pi) ** 2, rel=0.01)
    assert found.sdv_um3 == pytest.approx(found.shv_um3, rel=1e-6)


def test_summits_at_the_border_may_be_left_out():
    surface = egg_box()  # 5 × 6 hills of one period, whose saddles are at its border
    inner = features(surface, border=False)
    assert inner.peaks == 3 * 4
    assert inner.spd_per_um2 == pytest.approx(features(surface).spd_per_um2 * 12 / 30)
    assert (inner.sha_um2, inner.shv_um3) == (features(surface).sha_um2, features(surface).shv_um3)
    found = texture(surface, form="none", features=True, border_features=False)
    assert (found.features.peaks, found.features.pits) == (inner.peaks, inner.pits)


def test_hills_are_the_dales_of_the_negative():
    surface = HeightMap(np.random.default_rng(1).standard_normal((60, 70)).cumsum(axis=0), 1.0, 1.0)
    one, two = features(surface), features(surface.with_height(-surface.height_um))
    assert (one.peaks, one.s5p_um, one.shv_um3) == pytest.approx(
        (two.pits, two.s5v_um, two.sdv_um3), nan_ok=True
    )


def test_pruning_leaves_noise_out_and_counts_fall_with_it():
    clean, noisy = egg_box(), egg_box(noise=0.05)
    assert features(noisy, 0.1).peaks == features(clean).peaks
    rough = egg_box(noise=0.3)
    counts = [features(rough, share).peaks for share in (0.001, 0.01, 0.1, 0.6)]
    assert counts == sorted(counts, reverse=True)
    assert counts[0] > 100
    assert counts[-1] <= 1


def test_what_stands_between_two_hills_decides_by_its_saddle():
    x = np.arange(60.0)
    z = np.maximum(10.0 - np.abs(x - 15.0), 8.0 - np.abs(x - 30.0))  # the second stands 6 above the saddle
    height = np.tile(z, (5, 1))
    assert hills(height, 5.5).max() == 2
    assert hills(height, 6.5).max() == 1


def test_missing_points_open_their_hill():
    surface = egg_box()
    z = surface.height_um.copy()
    z[60, 60] = np.nan  # the top of one of the closed hills
    found = features(surface.with_height(z))
    assert found.peaks in (30, 31)
    labels = hills(z, 0.3)
    assert labels[60, 60] == 0
    assert (labels[~np.isnan(z)] > 0).all()


@pytest.mark.parametrize("share", [0.0, 1.0, -0.1, float("nan")])
def test_pruning_out_of_range(share):
    with pytest.raises(HeightMapError, match="Wolf pruning"):
        features(egg_box((30, 30)), share)


def test_a_flat_surface_has_no_hills():
    with pytest.raises(HeightMapError, match="flat"):
        features(HeightMap(np.full((10, 10), 3.0), 1.0, 1.0))


@pytest.mark.parametrize("angle", [0.0, 33.0, 90.0, 140.0])
def test_dominant_wavelength(angle):
    y, x = np.mgrid[:150, :200] * 1.0
    a = np.radians(angle)
    wave = np.sin(2 * np.pi * (x * np.cos(a) + y * np.sin(a)) / 17.3)
    surface = HeightMap(wave + 0.3 * np.sin(2 * np.pi * x / 9.0) + 3.0, 1.0, 1.0)
    assert dominant_wavelength(surface) == pytest.approx(17.3, rel=0.005)
    assert texture(surface).ssw_um == pytest.approx(17.3, rel=0.01)


def test_extreme_peak_height_of_a_linear_bearing_curve():
    surface = HeightMap(
        np.random.default_rng(0).permutation(np.linspace(0.0, 10.0, 10_000)).reshape(100, 100), 1.0, 1.0
    )
    found = texture(surface, form="none", features=True)
    assert found.sxp_um == pytest.approx(4.75, rel=0.01)
    assert found.features is not None
