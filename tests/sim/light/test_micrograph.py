import numpy as np
import pytest

from anisoscope.base.errors import ModelError
from anisoscope.parameters.geometry import Convention, Pose
from anisoscope.parameters.material import Material
from anisoscope.parameters.microscope import Lens
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.profiles.ideal import add_facet_roughness, ridges
from anisoscope.sim.light import relief
from anisoscope.sim.light.geometry import directions
from anisoscope.sim.light.micrograph import blurred, micrograph, subpixels
from anisoscope.sim.light.picture import View, view_of

SHARP = Lens(na=0.0)


@pytest.fixture
def rng():
    return np.random.default_rng(9)


def facets_of(pose, rng, shape=(201, 301)):
    surface = add_facet_roughness(ridges(RidgeDesign(50.0, 10.0), shape, 1.0), 0.05, 0.05, 6.0, rng)
    prepared = relief.Relief(surface, 50.0)
    light, camera = directions((pose,), Convention())
    return next(relief.radiance_maps(prepared, light, camera, Material())), prepared, light, camera


@pytest.mark.parametrize("stage", [0.0, 90.0, 180.0])
def test_without_a_lens_pixels_are_means_of_facets(stage, rng):
    facets, *_ = facets_of(Pose(stage), rng)
    shape = (50, 75) if stage != 90.0 else (75, 50)
    found = micrograph(facets, (1.0, 1.0), view_of(Pose(stage), Convention(), shape, 4.0), SHARP)
    upright = np.rot90(
        facets[::-1], round(stage / 90.0)
    )  # rows of the map rise with y, those of a picture fall
    expected = upright.reshape(shape[0], 4, shape[1], 4).mean(axis=(1, 3))
    np.testing.assert_allclose(found.radiance, expected, rtol=1e-5)
    assert not found.missing.any()
    assert found.covered.all()


@pytest.mark.parametrize("stage", [0.0, 30.0, 90.0])
def test_the_mean_of_the_picture_is_the_radiance_of_the_surface(stage, rng):
    facets, prepared, light, camera = facets_of(Pose(stage), rng)
    view = view_of(Pose(stage), Convention(), (220, 220), 1.7)
    found = micrograph(facets, (1.0, 1.0), view, Lens())
    expected = relief.radiance(prepared, light, camera, Material())[0]
    assert found.radiance[np.isfinite(found.radiance)].mean() == pytest.approx(expected, rel=0.01)


@pytest.mark.parametrize("lens", [SHARP, Lens(0.1), Lens(0.3, 0.5, 10.0)])
def test_an_even_surface_stays_even_up_to_its_edges(lens):
    found = micrograph(np.full((60, 60), 0.2, dtype=np.float32), (1.0, 1.0), View((50, 50), 2.0, 20.0), lens)
    np.testing.assert_allclose(found.radiance[found.covered], 0.2, rtol=1e-4)
    assert np.isnan(found.radiance[~found.covered]).all()
    assert found.covered.sum() * 4.0 == pytest.approx(3600.0, rel=0.02)


@pytest.mark.parametrize(
    ("stage", "row", "column"), [(0, 10, 70), (90, 29, 10), (180, 89, 29), (270, 70, 89)]
)
def test_a_bright_facet_lands_where_the_turned_sample_has_it(stage, row, column):
    """It stands 20.5 right of and 39.5 above the middle; at 90° that is 39.5 left and 20.5 above."""
    facets = np.zeros((100, 100), dtype=np.float32)
    facets[89, 70] = 1.0
    view = view_of(Pose(stage), Convention(), (100, 100), 1.0)
    for lens in (SHARP, Lens(0.2)):
        found = micrograph(facets, (1.0, 1.0), view, lens).radiance
        assert np.unravel_index(int(np.argmax(found)), found.shape) == (row, column)


def test_unequal_pixels_of_the_map_are_shown_in_proportion():
    facets = np.zeros((20, 100), dtype=np.float32)
    facets[10:, :] = 1.0
    facets[:, 75:] = 2.0
    found = micrograph(facets, (5.0, 1.0), View((50, 50), 2.0), SHARP).radiance
    np.testing.assert_allclose(found[:25, :37], 1.0)
    np.testing.assert_allclose(found[25:, :37], 0.0)
    np.testing.assert_allclose(found[:, 38:], 2.0)


def test_blur_keeps_light_and_adds_no_darkness_below_zero():
    lens = Lens(0.12, 0.55)
    image = np.zeros((400, 400), dtype=np.float32)
    image[200, 200] = 1.0
    spread = blurred(image, 0.5 / lens.cutoff_per_um, lens)
    assert spread.sum() == pytest.approx(1.0, abs=0.02)
    assert spread.min() > -1e-6


def test_a_point_becomes_the_airy_pattern():
    from scipy.special import j1

    lens, step = Lens(0.1, 0.55), 0.4
    image = np.zeros((256, 256), dtype=np.float32)
    image[128, 128] = 1.0
    spread = blurred(image, step, lens)
    radius = np.arange(1, 40) * step
    x = 2.0 * np.pi * lens.na / lens.wavelength_um * radius
    airy = (2.0 * j1(x) / x) ** 2
    np.testing.assert_allclose(spread[128, 129:168] / spread[128, 128], airy, atol=2e-3)
    first_dark = radius[np.argmin(airy[:12])]
    assert first_dark == pytest.approx(0.61 * lens.wavelength_um / lens.na, abs=step)


def test_far_out_of_focus_a_point_becomes_a_disc():
    lens, step = Lens(0.2, 0.4, 100.0), 0.5
    image = np.zeros((300, 300), dtype=np.float32)
    image[150, 150] = 1.0
    spread = blurred(image, step, lens)
    y, x = np.indices(image.shape)
    distance = np.hypot(y - 150, x - 150) * step
    assert lens.disc_um == pytest.approx(20.41, abs=0.01)
    assert spread[distance < lens.disc_um + 2.0].sum() == pytest.approx(1.0, abs=0.03)
    even = spread[distance < 0.7 * lens.disc_um]
    assert even.mean() == pytest.approx(step**2 / (np.pi * lens.disc_um**2), rel=0.03)


def test_gaps_are_marked_and_do_not_darken_their_neighbours():
    facets = np.full((80, 80), 0.3, dtype=np.float32)
    facets[30:50, 20:40] = np.nan
    found = micrograph(facets, (1.0, 1.0), View((80, 80), 1.0), Lens(0.05))
    np.testing.assert_array_equal(found.missing, np.isnan(facets)[::-1])
    np.testing.assert_allclose(found.radiance[~found.missing], 0.3, rtol=1e-3)


def test_pixels_are_sampled_as_finely_as_facets_and_lens_ask():
    assert subpixels(View((10, 10), 4.0), (2.0, 1.0), SHARP) == 4
    assert subpixels(View((10, 10), 4.0, 0.0, (1.0, 0.5)), (1.0, 1.0), SHARP) == 8
    assert subpixels(View((10, 10), 4.0), (50.0, 50.0), Lens(0.1, 0.5)) == 4
    with pytest.raises(ModelError, match="smaller region"):
        subpixels(View((1000, 1000), 10.0), (0.1, 0.1), SHARP)


@pytest.mark.parametrize(
    "options", [{"na": 1.0}, {"na": -0.1}, {"wavelength_um": 0.0}, {"defocus_um": np.nan}]
)
def test_impossible_lenses_are_refused(options):
    with pytest.raises(ModelError):
        Lens(**options)
