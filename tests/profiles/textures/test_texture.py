import numpy as np
import pytest

from anisoscope.base.errors import HeightMapError
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.profiles.ideal import ridges
from anisoscope.profiles.textures.bearing import bearing, core, volumes
from anisoscope.profiles.textures.texture import heights, hybrid, texture

PERIOD = 50.0


def sinusoid(amplitude=2.0, shape=(300, 400), pixel=(0.5, 1.0)):
    x = np.arange(shape[1]) * pixel[1]
    return HeightMap(
        np.broadcast_to(amplitude * np.cos(2 * np.pi * (x + 0.25) / PERIOD), shape), pixel[1], pixel[0]
    )


def with_gaps(surface, share=0.1, seed=0):
    z = surface.height_um.copy()
    z[np.random.default_rng(seed).random(z.shape) < share] = np.nan
    return surface.with_height(z)


@pytest.mark.parametrize("gaps", [False, True])
def test_heights_of_a_sinusoid(gaps):
    surface = with_gaps(sinusoid()) if gaps else sinusoid()
    found = heights(surface)
    tolerance = 0.01 if gaps else 1e-3
    assert found.sa_um == pytest.approx(2 * 2.0 / np.pi, rel=tolerance)
    assert found.sq_um == pytest.approx(2.0 / np.sqrt(2.0), rel=tolerance)
    assert found.ssk == pytest.approx(0.0, abs=tolerance)
    assert found.sku == pytest.approx(1.5, rel=tolerance)
    assert found.sz_um == pytest.approx(found.sp_um + found.sv_um)
    assert found.sp_um == pytest.approx(2.0, rel=tolerance)


@pytest.mark.parametrize("share", [0.2, 0.5, -0.8])
def test_skewness_and_kurtosis_of_two_harmonics(share):
    """cos u + b cos 2u: mean square (1 + b²)/2, mean cube 3b/4, mean fourth power 3/8 + 3b²/2 + 3b⁴/8."""
    u = 2 * np.pi * np.arange(600) / 200
    z = np.broadcast_to(np.cos(u) + share * np.cos(2 * u), (5, 600))
    found, square = heights(HeightMap(z, 1.0, 1.0)), 0.5 * (1 + share**2)
    assert found.sq_um == pytest.approx(np.sqrt(square))
    assert found.ssk == pytest.approx(0.75 * share / square**1.5)
    assert found.sku == pytest.approx((0.375 + 1.5 * share**2 + 0.375 * share**4) / square**2)


def test_heights_of_gaussian_noise_with_a_tail():
    z = np.random.default_rng(1).standard_normal((500, 500))
    assert heights(HeightMap(z, 1.0, 1.0)).sku == pytest.approx(3.0, abs=0.03)
    skewed = heights(HeightMap(np.exp(z), 1.0, 1.0))
    assert skewed.ssk > 3.0
    assert skewed.sp_um > skewed.sv_um
    upside_down = heights(HeightMap(-np.exp(z), 1.0, 1.0))
    assert upside_down.ssk == pytest.approx(-skewed.ssk)
    assert upside_down.sp_um == pytest.approx(skewed.sv_um)


@pytest.mark.parametrize("axis", [0, 1])
def test_slopes_and_area_of_a_sinusoid(axis):
    """Sdr against the series g²/4 − 3g⁴/64 + 5g⁶/256 of the arc length, g the steepest slope."""
    surface = sinusoid(amplitude=4.0, pixel=(1.0, 0.5), shape=(200, 400))
    if axis == 0:
        surface = HeightMap(surface.height_um.T, surface.pixel_y_um, surface.pixel_x_um)
    steepest = 2 * np.pi * 4.0 / PERIOD
    found = hybrid(surface)
    assert found.sdq == pytest.approx(steepest / np.sqrt(2.0), rel=2e-3)
    series = steepest**2 / 4 - 3 * steepest**4 / 64 + 5 * steepest**6 / 256
    assert found.sdr == pytest.approx(series, rel=5e-3)


def test_slopes_and_area_of_a_plane_are_exact_with_gaps_and_oblong_pixels():
    y, x = np.mgrid[:40, :60]
    surface = with_gaps(HeightMap(0.3 * 2.0 * x - 0.4 * 0.5 * y, 2.0, 0.5), 0.2)
    found = hybrid(surface)
    assert found.sdq == pytest.approx(0.5)
    assert found.sdr == pytest.approx(np.sqrt(1.25) - 1.0)


def test_bearing_curve_of_a_sawtooth_is_a_line():
    surface = ridges(RidgeDesign(100.0, 10.0), (5, 1000), 0.1)
    height = 100.0 * np.sin(np.radians(10.0)) * np.cos(np.radians(10.0))
    curve = bearing(surface)
    line = curve.height_um[0] + (curve.height_um[-1] - curve.height_um[0]) * curve.ratio
    assert np.abs(curve.height_um - line).max() < 0.005 * height
    found = core(curve)
    assert found.sk_um == pytest.approx(height, rel=0.01)
    assert (found.spk_um, found.svk_um) == pytest.approx((0.0, 0.0), abs=0.01 * height)
    assert (found.smr1, found.smr2) == pytest.approx((0.0, 1.0), abs=0.01)
    assert found.top_um == pytest.approx(height / 2, rel=0.02)
    # triangles under a line of height h: p²h/2
    volume = volumes(curve)
    assert volume.vmp_um == pytest.approx(0.005 * height, rel=0.03)
    assert volume.vmp_um + volume.vmc_um == pytest.approx(0.32 * height, rel=0.01)
    assert volume.vvv_um == pytest.approx(0.02 * height, rel=0.03)
    assert volume.vvv_um + volume.vvc_um == pytest.approx(0.405 * height, rel=0.01)


def test_core_of_gaussian_heights():
    """A normal curve has its flattest 40 % about the mean; the line through them spans 2.59 σ."""
    from scipy.stats import norm

    z = np.random.default_rng(2).standard_normal((1000, 1000))
    found = core(bearing(HeightMap(z, 1.0, 1.0)))
    p = np.linspace(0.3, 0.7, 4001)
    sk = -np.polyfit(p, norm.isf(p), 1)[0]
    assert found.sk_um == pytest.approx(sk, rel=0.01)
    assert found.smr1 == pytest.approx(1.0 - found.smr2, abs=0.01)
    assert found.smr1 == pytest.approx(norm.sf(sk / 2), abs=0.01)
    assert found.spk_um == pytest.approx(found.svk_um, rel=0.05)


def test_a_plateau_with_deep_grooves_has_dales_and_no_peaks():
    z = np.random.default_rng(3).uniform(-0.1, 0.1, (400, 400))
    z[:, ::20] -= 5.0
    found = core(bearing(HeightMap(z, 1.0, 1.0)))
    assert found.svk_um > 4.0
    assert found.spk_um < 0.05
    assert found.smr2 == pytest.approx(0.95, abs=0.01)


def test_material_ratio_and_its_inverse_belong_together():
    z = np.random.default_rng(4).standard_normal((100, 100))
    curve = bearing(HeightMap(z, 1.0, 1.0))
    for ratio in (0.05, 0.5, 0.9):
        assert curve.smr(curve.smc(ratio)) == pytest.approx(ratio)
    assert curve.smr(0.0) == pytest.approx(np.mean(z >= z.mean()), abs=1e-3)
    assert (curve.smr(10.0), curve.smr(-10.0)) == (0.0, 1.0)
    assert volumes(curve).vmp_um == pytest.approx(
        np.mean(np.maximum(z - z.mean() - curve.smc(0.1), 0.0)), rel=0.01
    )


@pytest.mark.filterwarnings("ignore")  # the other library warns about itself
def test_parameters_agree_with_other_libraries():
    from scipy import stats
    from scipy.ndimage import gaussian_filter
    from SurfaceTopography import Topography

    z = gaussian_filter(np.random.default_rng(5).standard_normal((256, 192)), 3.0)
    surface = HeightMap(z, 0.5, 0.7)
    other = Topography(z, physical_sizes=(256 * 0.7, 192 * 0.5), unit="um")  # its x is our y
    found = heights(surface)
    assert found.sq_um == pytest.approx(other.rms_height_from_area())
    assert found.ssk == pytest.approx(stats.skew(z, axis=None))
    assert found.sku == pytest.approx(stats.kurtosis(z, axis=None, fisher=False))
    assert hybrid(surface).sdq == pytest.approx(other.rms_gradient(), rel=0.02)


def test_scaling_heights_scales_what_it_should():
    z = np.random.default_rng(6).standard_normal((80, 90)).cumsum(axis=1)
    one, two = (texture(HeightMap(f * z, 1.0, 1.0)) for f in (1.0, 2.0))
    assert two.heights.sa_um == pytest.approx(2 * one.heights.sa_um)
    assert two.heights.sku == pytest.approx(one.heights.sku)
    assert two.hybrid.sdq == pytest.approx(2 * one.hybrid.sdq)
    assert two.spatial.sal_um == pytest.approx(one.spatial.sal_um)
    assert two.core.sk_um == pytest.approx(2 * one.core.sk_um)
    assert two.volumes.vvc_um == pytest.approx(2 * one.volumes.vvc_um)


def test_a_flat_map_has_no_shape_and_no_spatial_parameters():
    found = texture(HeightMap(np.full((40, 50), 0.7), 1.0, 1.0))
    assert found.heights.sq_um == pytest.approx(0.0, abs=1e-12)
    assert np.isnan(found.heights.ssk)
    assert found.hybrid.sdr == pytest.approx(0.0, abs=1e-12)


def test_maps_that_cannot_be_measured():
    with pytest.raises(HeightMapError):
        texture(HeightMap(np.full((10, 10), np.nan), 1.0, 1.0))
    lonely = np.full((12, 12), np.nan)
    lonely[::2, ::2] = 1.0
    with pytest.raises(HeightMapError, match="side by side"):
        hybrid(HeightMap(lonely, 1.0, 1.0))
