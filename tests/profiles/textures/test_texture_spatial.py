import numpy as np
import pytest

from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.profiles.ideal import add_facet_roughness
from anisoscope.profiles.patterns import turned_ridges
from anisoscope.profiles.textures.spatial import autocorrelation, spatial
from anisoscope.profiles.textures.spectra import areal_density, lay, line_density, radial_density

FALL = np.sqrt(np.log(5.0))  # exp(−t²) falls to 0.2


def rough(shape, pixel, along=0.1, across=0.1, correlation=8.0, seed=0):
    flat = HeightMap(np.zeros(shape), pixel[1], pixel[0])
    return add_facet_roughness(flat, along, across, correlation, np.random.default_rng(seed))


@pytest.mark.parametrize("gaps", [False, True])
def test_autocorrelation_length_of_an_isotropic_gaussian_surface(gaps):
    surface = rough((900, 900), (1.0, 1.0))
    if gaps:
        z = surface.height_um.copy()
        z[np.random.default_rng(1).random(z.shape) < 0.3] = np.nan
        surface = surface.with_height(z)
    found = spatial(surface)
    assert found.sal_um == pytest.approx(8.0 * FALL, rel=0.05)
    assert found.str_ > 0.93
    assert not found.str_is_bound


@pytest.mark.parametrize("pixel", [(1.0, 1.0), (0.5, 1.5), (2.0, 0.5)])
def test_aspect_ratio_of_a_stretched_gaussian_surface(pixel):
    shape = (round(900 / pixel[0]), round(900 / pixel[1]))
    found = spatial(rough(shape, pixel, along=0.05, across=0.15, correlation=12.0))
    assert found.str_ == pytest.approx(1 / 3, rel=0.12)  # lengths stand as the inverse of the slopes
    assert found.sal_um == pytest.approx(12.0 / np.sqrt(3.0) * FALL, rel=0.07)
    assert found.std_deg == pytest.approx(0.0, abs=4.0)


@pytest.mark.parametrize("direction", [0.0, 20.0, -45.0, 75.0, 90.0])
@pytest.mark.parametrize("pixel", [(1.0, 1.0), (1.5, 0.75)])
def test_lay_and_aspect_ratio_of_ridges(direction, pixel):
    surface = turned_ridges(RidgeDesign(40.0, 10.0), (400, 500), pixel, direction_deg=direction)
    found = spatial(surface)
    assert (found.std_deg - direction + 90.0) % 180.0 - 90.0 == pytest.approx(0.0, abs=0.3)
    assert -90.0 < found.std_deg <= 90.0
    assert found.str_ < 0.06
    assert found.str_is_bound


def test_autocorrelation_of_a_sawtooth_is_its_closed_form():
    """Of a linear ramp of period p: 1 − 6 t/p + 6 (t/p)²."""
    profile = (np.arange(2000) % 100) / 100.0
    acf = autocorrelation(HeightMap(np.broadcast_to(profile, (40, 2000)), 1.0, 1.0))
    lag, value = acf.along_x()
    share = (lag % 100.0) / 100.0
    assert np.abs(value - (1.0 - 6.0 * share + 6.0 * share**2))[:500].max() < 0.03
    assert np.allclose(acf.along_y()[1], 1.0)
    assert acf.value[acf.centre] == pytest.approx(1.0)
    assert np.allclose(acf.value, acf.value[::-1, ::-1])


@pytest.mark.parametrize(("shape", "pixel"), [((60, 81), (1.0, 0.5)), ((61, 80), (0.3, 2.0))])
def test_densities_hold_the_variance(shape, pixel):
    """Parseval, exact without a window."""
    z = np.random.default_rng(0).standard_normal(shape).cumsum(axis=1)
    surface = HeightMap(z, pixel[1], pixel[0])
    variance = float(np.var(z))
    fy, fx, density = areal_density(surface, "none")
    assert density.sum() * fy[1] * fx[1] == pytest.approx(variance)
    for axis in ("x", "y"):
        line = line_density(surface, axis, "none")
        assert line.density.sum() * line.frequency[1] == pytest.approx(variance)


def test_windowed_densities_hold_the_variance_on_average():
    surface = rough((500, 600), (1.0, 1.0))
    z = surface.height_um.copy()
    variance = float(np.var(z))
    z[np.random.default_rng(1).random(z.shape) < 0.2] = np.nan
    for one in (surface, surface.with_height(z)):
        for axis in ("x", "y"):
            line = line_density(one, axis)
            assert line.density.sum() * line.frequency[1] == pytest.approx(variance, rel=0.05)


def test_gaps_take_no_power_from_the_areal_density():
    surface = rough((500, 600), (1.0, 0.5))
    z = surface.height_um.copy()
    z[np.random.default_rng(1).random(z.shape) < 0.2] = np.nan
    (_, _, full), (_, _, part) = (areal_density(one) for one in (surface, surface.with_height(z)))
    assert part.sum() == pytest.approx(full.sum(), rel=0.02)


def test_spectrum_of_a_gaussian_surface_is_its_closed_form():
    """Of σ²·exp(−r²/l²): C = π l² σ² exp(−π² l² f²)."""
    surface = rough((1000, 1000), (1.0, 1.0))
    found = radial_density(surface)
    low = (found.frequency > 0.01) & (found.frequency < 0.06)
    variance = float(np.var(surface.height_um))
    wanted = np.pi * 64.0 * variance * np.exp(-((np.pi * 8.0 * found.frequency) ** 2))
    assert np.mean(found.density[low] / wanted[low]) == pytest.approx(1.0, abs=0.085)  # .99 ± .024


def test_spectrum_of_a_sinusoid_peaks_at_its_frequency():
    x = np.arange(640) * 0.5
    surface = HeightMap(np.broadcast_to(3.0 * np.sin(2 * np.pi * x / 20.0), (50, 640)), 0.5, 1.0)
    found = line_density(surface, "x", "none")
    peak = int(np.argmax(found.density))
    assert found.frequency[peak] == pytest.approx(1 / 20.0)
    assert found.density[peak] * found.frequency[1] == pytest.approx(4.5)


@pytest.mark.filterwarnings("ignore")  # the other library warns about itself
def test_densities_agree_with_another_library():
    from SurfaceTopography import Topography

    z = np.random.default_rng(3).standard_normal((128, 96)).cumsum(axis=0)
    surface = HeightMap(z - z.mean(), 0.5, 0.7)  # the library's x is our y
    sizes = 128 * 0.7, 96 * 0.5
    other = Topography(z - z.mean(), physical_sizes=sizes, unit="um", periodic=True)
    q, density = other.power_spectrum_from_profile(window=None, resampling_method=None)
    ours = line_density(surface, "y", "none")
    assert np.allclose(2 * np.pi * ours.frequency[1:-1], q[1 : ours.frequency.size - 1])
    ratio = ours.density[1:-1] / density[1 : ours.frequency.size - 1]
    assert np.allclose(ratio, ratio[0])


def test_a_map_without_texture_has_no_lay():
    assert np.isnan(lay(HeightMap(np.ones((40, 40)), 1.0, 1.0)))
    tiny = spatial(HeightMap(np.array([[0.0, 1.0], [1.0, 0.0]]), 1.0, 1.0))
    assert tiny.str_is_bound in (True, False)


def test_a_hole_in_the_map_does_not_invent_texture():
    surface = rough((400, 400), (1.0, 1.0))
    z = surface.height_um.copy()
    z[100:250, 120:300] = np.nan
    found, full = spatial(surface.with_height(z)), spatial(surface)
    assert found.sal_um == pytest.approx(full.sal_um, rel=0.07)
    assert found.str_ > 0.85


def test_a_surface_without_lay_has_no_direction():
    rng = np.random.default_rng(3)
    fy, fx = np.fft.fftfreq(256)[:, None], np.fft.fftfreq(256)[None, :]

    def rough(along, across):
        gain = np.exp(-0.5 * np.pi**2 * ((across * fx) ** 2 + (along * fy) ** 2))
        return HeightMap(np.fft.ifft2(np.fft.fft2(rng.standard_normal((256, 256))) * gain).real, 1.0, 1.0)

    even = spatial(rough(6.0, 6.0))
    assert even.str_ > 0.5
    assert np.isnan(even.std_deg)
    lay = spatial(rough(30.0, 6.0))
    assert lay.str_ < 0.5
    assert abs(lay.std_deg) < 10.0


def test_lags_of_a_map_with_gaps_are_means_over_pairs():
    """f_ACF against sums over all pairs, one lag after the other."""
    rng = np.random.default_rng(5)
    height = rng.normal(size=(15, 21))
    height[rng.random(height.shape) < 0.2] = np.nan
    found = autocorrelation(HeightMap(height, 1.0, 1.0))
    zero = height - np.nanmean(height)
    for i in range(-7, 8):
        for j in range(-10, 11):
            first = zero[max(0, -i) : 15 - max(0, i), max(0, -j) : 21 - max(0, j)]
            second = zero[max(0, i) : 15 - max(0, -i), max(0, j) : 21 - max(0, -j)]
            expected = np.nanmean(first * second) / np.nanmean(zero**2)
            assert found.value[i + 7, j + 10] == pytest.approx(expected, abs=1e-12)
