import sys

import numpy as np
import pytest
from scipy import special

from anisoscope.base.errors import ModelError
from anisoscope.parameters.material import Material
from anisoscope.sim.light.interface_kernels import _beckmann_lambda
from anisoscope.sim.light.material import (
    _gauss_legendre,
    _lobe_albedos,
    diffuse_scale,
    distribution,
    facet_brdf,
    fresnel,
    lobe_albedo,
    slope_density,
    smith_lambda,
    transmittance,
)
from anisoscope.sim.light.shadowing import UNSHADOWED

X, Y, Z = np.eye(3)


def test_fresnel_reference_values():
    assert fresnel(np.array(1.0), 1.5) == pytest.approx(0.04)
    assert fresnel(np.array(0.0), 1.5) == pytest.approx(1.0)
    brewster = np.cos(np.arctan(1.5))
    assert fresnel(np.array(brewster), 1.5) == pytest.approx(0.5 * ((1.5**2 - 1) / (1.5**2 + 1)) ** 2)
    assert fresnel(np.array(0.2), 1 / 1.5) == 1.0  # beyond total reflection


@pytest.mark.parametrize(
    "material",
    [
        Material(0.06, 0.10),
        Material(0.2, 0.1),
        Material(0.5, 0.5),
        Material(0.06, 0.1, tail=0.5),
        Material(0.2, 0.1, tail=1.0),
        Material(0.1, 0.1, tail=1.6),
        Material(0.06, 0.10, second_lobe=(0.15, 2.5)),
        Material(0.2, 0.1, tail=1.0, second_lobe=(0.3, 0.5)),
    ],
)
def test_microfacets_cover_the_macro_surface_exactly_once(material, hemisphere):
    directions, solid_angle = hemisphere(600, 720)
    density = distribution(directions, Y, X, Z, material)
    assert np.sum(density * directions[:, 2] * solid_angle) == pytest.approx(1.0, rel=1e-4)


def test_density_of_slopes_with_a_tail():
    r = np.array([0.0, 1.0, 2.0, 4.0])
    heavy = slope_density(r**2, Material(tail=1.0)) / np.pi
    np.testing.assert_allclose(heavy, 1.0 / (np.pi * (1.0 + r**2) ** 2), rtol=1e-12)
    np.testing.assert_allclose(heavy, [0.31831, 0.079577, 0.012732, 0.0011014], rtol=5e-5)
    middle = slope_density(r**2, Material(tail=0.5)) / np.pi
    np.testing.assert_allclose(middle, [0.31831, 0.094314, 0.011789, 0.00043664], rtol=5e-5)
    short = slope_density(r**2, Material(tail=2e-4))
    np.testing.assert_allclose(short, np.exp(-(r**2)), rtol=0.05)
    assert np.array_equal(slope_density(r**2, Material(tail=5e-5)), np.exp(-(r**2)))


@pytest.mark.parametrize("tail", [0.1, 0.5, 1.0, 1.6])
def test_a_tail_is_a_mixture_of_beckmann_lobes(tail):
    """P = ∫ λ/π·exp(−λ r²) over the gamma distribution of λ with shape and rate 1/τ; so is the shadowing."""
    from scipy.stats import gamma

    node, weight = np.polynomial.legendre.leggauss(400)
    root = 1.1 * (node + 1.0)  # λ is its eighth power: the density may be infinite at 0
    width = root**8
    share = gamma(1.0 / tail, scale=tail).pdf(width) * 8.0 * root**7 * 1.1 * weight
    for r in (0.0, 0.7, 3.0):
        mixed = np.sum(share * width * np.exp(-width * r**2))
        assert slope_density(np.array(r**2), Material(tail=tail)) == pytest.approx(mixed, rel=1e-6)
    for slant in (0.2, 1.0, 4.0):
        mixed = np.sum(share * smith_lambda(slant / np.sqrt(width)))
        assert float(smith_lambda(np.array(slant), tail)) == pytest.approx(mixed, rel=1e-4)


def test_shadowing_of_known_lobes():
    slant = np.geomspace(1e-3, 30.0, 50)
    np.testing.assert_allclose(
        smith_lambda(slant, 1.0), 0.5 * (np.sqrt(1.0 + slant**2) - 1.0), rtol=1e-8, atol=1e-12
    )
    few = np.array([0.1, 0.3, 1.0])
    np.testing.assert_allclose(smith_lambda(few, 1.0), [0.0024938, 0.022015, 0.20711], rtol=5e-5)
    np.testing.assert_allclose(smith_lambda(few, 0.5), [2.451e-5, 0.0017130, 0.077341], rtol=5e-4)
    np.testing.assert_allclose(smith_lambda(few, 1e-3), smith_lambda(few), rtol=0.01, atol=1e-4)
    two = 0.7 * smith_lambda(few, 0.5) + 0.3 * smith_lambda(2.0 * few)
    np.testing.assert_allclose(smith_lambda(few, 0.5, (0.3, 2.0)), two, rtol=1e-12)


@pytest.mark.parametrize("tail", [2e-4, 0.02, 0.5, 1.6])
def test_the_table_of_shadowing_is_the_closed_form(tail):
    from anisoscope.sim.light.kernels import shadowing
    from anisoscope.sim.light.shine import lobe_shape

    lobe, slant = lobe_shape(Material(tail=tail)), np.geomspace(1e-4, 100.0, 400)
    seen = 1.0 / (1.0 + np.array([shadowing(float(s), lobe) for s in slant]))
    np.testing.assert_allclose(seen, 1.0 / (1.0 + smith_lambda(slant, tail)), rtol=3e-4)


def test_smith_lambda_is_the_shadowing_of_gaussian_slopes():
    # Λ = ∫ over slopes q > cot θ of (q tan θ − 1) P(q): the definition, by brute force
    alpha, tangent = 0.4, 2.5
    slope = np.linspace(1 / tangent, 8.0, 200_001)
    density = np.exp(-((slope / alpha) ** 2)) / (alpha * np.sqrt(np.pi))
    assert smith_lambda(np.array(alpha * tangent)) == pytest.approx(
        np.trapezoid((slope * tangent - 1) * density, slope), rel=1e-6
    )


def test_shadowing_from_tables_is_that_of_the_closed_form():
    a = np.append(np.geomspace(1e-3, UNSHADOWED, 300), [np.nextafter(UNSHADOWED, 0.0), 30.0])
    closed = 0.5 * (np.exp(-(a**2)) / (a * np.sqrt(np.pi)) - special.erfc(a))
    compiled = np.array([_beckmann_lambda(float(one)) for one in a])
    np.testing.assert_allclose(1.0 + compiled, 1.0 + closed, rtol=5e-15)
    np.testing.assert_allclose(1.0 + smith_lambda(1.0 / a), 1.0 + closed, rtol=5e-15)


@pytest.mark.parametrize("nodes", [16, 32, 256])
def test_rules_of_quadrature_are_those_of_scipy(nodes):
    np.testing.assert_allclose(_gauss_legendre(nodes), special.roots_legendre(nodes), atol=1e-13)


@pytest.mark.parametrize("alpha", [0.001, 0.08, 1.0])
@pytest.mark.parametrize("index", [1.5, 1 / 1.5])
def test_albedos_by_arrays_are_those_of_the_kernel(alpha, index):
    cosine = np.linspace(0.0, 1.0, 40)
    by_arrays = _lobe_albedos(cosine, alpha, index, _gauss_legendre(32), _gauss_legendre(16))
    assert "numba" in sys.modules
    np.testing.assert_allclose(by_arrays, lobe_albedo(cosine, alpha, index), rtol=1e-11, atol=1e-14)


@pytest.mark.parametrize("alpha", [0.05, 0.1, 0.3])
def test_lobe_albedo_agrees_with_integration_over_the_hemisphere(alpha, hemisphere):
    directions, solid_angle = hemisphere(500, 1000)
    light = np.array([np.sin(0.5), 0.0, np.cos(0.5)])
    material = Material(alpha, alpha, albedo=0.0)
    brdf = facet_brdf(np.broadcast_to(light, directions.shape), directions, Y, X, Z, material)
    integral = np.sum(brdf * directions[:, 2] * solid_angle)
    assert lobe_albedo(np.array([np.cos(0.5)]), alpha, 1.5)[0] == pytest.approx(integral, rel=2e-3)


@pytest.mark.parametrize(("alpha", "least"), [(0.05, 0.97), (0.1, 0.97), (0.3, 0.88)])
@pytest.mark.parametrize("mu", [0.95, 0.7, 0.4])
def test_white_plastic_reflects_no_more_than_it_receives_and_not_much_less(alpha, least, mu, hemisphere):
    directions, solid_angle = hemisphere(300, 600)
    light = np.broadcast_to([np.sqrt(1 - mu**2), 0.0, mu], directions.shape)
    brdf = facet_brdf(light, directions, Y, X, Z, Material(alpha, alpha, albedo=1.0))
    energy = np.sum(brdf * directions[:, 2] * solid_angle)
    assert least <= energy <= 1.0 + 1e-3


def test_brdf_is_reciprocal():
    rng = np.random.default_rng(3)
    first, second = (
        v / np.linalg.norm(v, axis=1, keepdims=True) for v in np.abs(rng.normal(size=(2, 200, 3))) + 0.05
    )
    material = Material(0.2, 0.4, 0.5, tail=0.7, second_lobe=(0.2, 0.6))
    there = facet_brdf(first, second, Y, X, Z, material)
    np.testing.assert_allclose(there, facet_brdf(second, first, Y, X, Z, material), rtol=1e-12)


def test_internal_reflection_brightens_the_diffuse_base_and_more_so_when_linear():
    nonlinear, linear = (
        diffuse_scale(Material(albedo=0.3, internal_reflection=x)) for x in ("nonlinear", "linear")
    )
    assert 0.3 / (np.pi * 1.5**2) < nonlinear < linear
    one = [diffuse_scale(Material(albedo=1.0, internal_reflection=x)) for x in ("nonlinear", "linear")]
    assert one[0] == pytest.approx(one[1])


def test_transmittance_of_a_smooth_interface_is_one_minus_fresnel():
    cosines = np.array([1.0, 0.8, 0.5])
    smooth = transmittance(cosines, Material(0.005, 0.005))
    np.testing.assert_allclose(smooth, 1 - fresnel(cosines, 1.5), atol=2e-4)


@pytest.mark.parametrize(
    "field",
    [
        {"alpha_along": 0.0},
        {"alpha_across": -0.1},
        {"albedo": 1.5},
        {"index": 1.0},
        {"internal_reflection": "x"},
        {"tail": -0.1},
        {"tail": 1.7},
        {"second_lobe": (1.0, 2.0)},
        {"second_lobe": (0.2, 20.0)},
    ],
)
def test_impossible_materials_are_refused(field):
    with pytest.raises(ModelError):
        Material(**field)


@pytest.mark.parametrize("alpha", [0.06, 0.3])
@pytest.mark.parametrize("cosine", [0.05, 0.1, 0.3, 0.8])
def test_albedo_of_the_lobe_equals_what_leaves_in_all_directions(alpha, cosine):
    """The slopes' integral against the BRDF summed over the hemisphere, down to grazing incidence."""
    node, weight = np.polynomial.legendre.leggauss(240)
    side, side_weight = 0.5 * (node + 1.0), 0.5 * weight
    # squares: denser at grazing exit, and around azimuth 0, the mirror direction; both halves of the azimuth count
    out_cos, azimuth = np.meshgrid(side**2, np.pi * side**2, indexing="ij")
    area = np.outer(2.0 * side * side_weight, 4.0 * np.pi * side * side_weight)
    sine = np.sqrt(1.0 - out_cos**2)
    out = np.stack([-sine * np.cos(azimuth), sine * np.sin(azimuth), out_cos], axis=-1)
    light = np.broadcast_to([np.sqrt(1.0 - cosine**2), 0.0, cosine], out.shape)
    black = Material(alpha, alpha, albedo=0.0)
    axes = np.eye(3)
    value = facet_brdf(light, out, axes[1], axes[0], axes[2], black)
    expected = np.sum(value * out_cos * area)
    assert lobe_albedo(np.array([cosine]), alpha, 1.5)[0] == pytest.approx(expected, rel=2e-3)
