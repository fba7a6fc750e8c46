"""Forms that are fitted are the forms that were made, with gaps and oblong pixels."""

import numpy as np
import pytest

from anisoscope.base.errors import HeightMapError
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.profiles.textures.filters import without_form
from anisoscope.profiles.textures.forms import fit_form, form_order

PIXEL = 2.0, 3.0  # x, y in µm


def field(shape=(120, 200)):
    y, x = np.mgrid[: shape[0], : shape[1]]
    return (x - 0.5 * (shape[1] - 1)) * PIXEL[0], (y - 0.5 * (shape[0] - 1)) * PIXEL[1]


def with_gaps(z, share=0.2):
    return HeightMap(np.where(np.random.default_rng(1).random(z.shape) < share, np.nan, z), *PIXEL)


@pytest.mark.parametrize("radius", [700.0, -700.0, 2e7])
def test_a_sphere_is_found_by_its_distances(radius):
    x, y = field()
    z = np.sign(radius) * (np.sqrt(radius**2 - (x - 30.0) ** 2 - (y + 20.0) ** 2) - abs(radius))
    fitted = fit_form(with_gaps(z), "sphere")
    assert fitted.values["radius_um"] == pytest.approx(radius, rel=1e-6)
    assert np.abs(fitted.height_um - z).max() < 1e-8 * max(1.0, np.ptp(z))
    if abs(radius) < 1e6:
        slope = np.sign(radius) * 30.0 / np.sqrt(radius**2 - 30.0**2 - 20.0**2)
        assert fitted.values["tilt_x_deg"] == pytest.approx(np.degrees(np.arctan(slope)), abs=1e-6)


@pytest.mark.parametrize("turned", [-80.0, 0.0, 25.0])
def test_a_cylinder_is_found_with_its_axis(turned):
    x, y = field()
    angle = np.radians(turned)
    across = x * np.cos(angle) + y * np.sin(angle) - 15.0
    z = np.sqrt(900.0**2 - across**2)
    fitted = fit_form(with_gaps(z), "cylinder")
    assert fitted.values["radius_um"] == pytest.approx(900.0, rel=1e-6)
    assert fitted.values["axis_deg"] == pytest.approx(turned, abs=1e-5)
    assert np.abs(fitted.height_um - z).max() < 1e-7


def test_noise_does_not_bend_a_cylinder():
    x, _ = field((60, 90))
    z = np.sqrt(900.0**2 - x**2)
    rng = np.random.default_rng(2)
    radii = [
        fit_form(HeightMap(z + 0.05 * rng.standard_normal(z.shape), *PIXEL), "cylinder").values["radius_um"]
        for _ in range(6)
    ]
    assert np.mean(radii) == pytest.approx(900.0, rel=3e-3)


@pytest.mark.parametrize("order", [1, 3, 6, 10])
def test_polynomials_are_exact_and_least_squares(order):
    x, y = field((40, 60))
    u, v = x / 100.0, y / 100.0
    rng = np.random.default_rng(order)
    terms = [(a, b) for a in range(order + 1) for b in range(order + 1 - a)]
    z = sum(rng.standard_normal() * u**a * v**b for a, b in terms)
    surface = with_gaps(z)
    assert np.abs(fit_form(surface, f"poly{order}").height_um - z).max() < 1e-7 * np.ptp(z)
    noise = rng.standard_normal(z.shape)
    left = without_form(with_gaps(noise), f"poly{order}")
    for a, b in terms:  # what is left is at right angles to every term
        part = np.nansum(left * u**a * v**b) - np.nanmean(left) * np.nansum(u**a * v**b * ~np.isnan(left))
        assert abs(part) < 1e-6 * np.nansum(np.abs(u**a * v**b))


def test_slopes_of_a_plane():
    x, y = field()
    fitted = fit_form(with_gaps(0.1 * x - 0.02 * y), "poly4")
    assert fitted.values["tilt_x_deg"] == pytest.approx(np.degrees(np.arctan(0.1)))
    assert fitted.values["tilt_y_deg"] == pytest.approx(np.degrees(np.arctan(-0.02)))


@pytest.mark.parametrize("form", ["cone", "poly0", "poly11", "poly", "poly2 ", ""])
def test_forms_that_there_are_not(form):
    with pytest.raises(HeightMapError, match="form is one of"):
        form_order(form)


@pytest.mark.parametrize("form", ["plane", "poly5", "sphere", "cylinder"])
def test_points_that_determine_no_form(form):
    z = np.full((30, 30), np.nan)
    z[4] = np.arange(30.0)
    with pytest.raises(HeightMapError, match="determine"):
        fit_form(HeightMap(z, 1.0, 1.0), form)
