import numpy as np
import pytest
from scipy.integrate import quad

from anisoscope.base.errors import ModelError
from anisoscope.parameters.material import Material
from anisoscope.sim.light.material import diffuse_scale, facet_brdf
from anisoscope.sim.pathtracer.plastic import (
    COMPONENTS,
    LOBES,
    TAIL,
    Plastic,
    brdf,
    fresnel_reflectance,
    lobe_reflectance,
    shadowing,
    slope_density,
)


def sphere(polar: int, azimuths: int) -> tuple[np.ndarray, np.ndarray]:
    """Directions above the horizon and their solid angles, the polar angle at equal steps of its cosine."""
    node, weight = np.polynomial.legendre.leggauss(polar)
    mu = 0.5 * (node + 1.0)
    turn = 2.0 * np.pi * (np.arange(azimuths) + 0.5) / azimuths
    sine = np.sqrt(1.0 - mu**2)[:, None]
    level = np.broadcast_to(mu[:, None], (polar, azimuths))
    directions = np.stack([sine * np.cos(turn), sine * np.sin(turn), level], axis=-1)
    return directions, np.broadcast_to((0.5 * weight)[:, None] * 2.0 * np.pi / azimuths, level.shape)


def at(polar_deg: float, turn_deg: float = 0.0) -> np.ndarray:
    polar, turn = np.radians([polar_deg, turn_deg])
    return np.array([np.sin(polar) * np.cos(turn), np.sin(polar) * np.sin(turn), np.cos(polar)])


@pytest.mark.parametrize("tail", [0.0, 0.5, 1.0])
def test_slopes_are_a_distribution(tail):
    total, _ = quad(lambda r: 2.0 * np.pi * r * slope_density(np.array(r**2), tail), 0.0, np.inf)
    assert total == pytest.approx(1.0, abs=1e-7)


@pytest.mark.parametrize(
    ("tail", "expected"),
    [(0.5, [0.31831, 0.094314, 0.011789, 0.00043664]), (1.0, [0.31831, 0.079577, 0.012732, 0.0011014])],
)
def test_densities_of_tails(tail, expected):
    """(1 + τ r²)^−(1 + 1/τ)/π at r = 0, 1, 2, 4."""
    found = slope_density(np.array([0.0, 1.0, 2.0, 4.0]) ** 2, tail)
    assert found == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize("lobe", LOBES)
@pytest.mark.parametrize("a", [0.3, 1.0, 3.0])
def test_shadowing_is_the_integral_over_slopes(lobe, a):
    """Smith's Λ = (1/a)·∬ (q − a)⁺·P(q² + y²) dq dy, in polar coordinates from the least radius to infinity."""
    node, weight = np.polynomial.legendre.leggauss(300)
    turn, share = 0.25 * np.pi * (node + 1.0), 0.5 * (node + 1.0)
    weights = 0.25 * np.pi * weight[:, None] * 0.5 * weight
    expected = 0.0
    for part, factor in COMPONENTS[lobe]:
        own = a / factor
        least = own / np.cos(turn)[:, None]
        radius = least / share
        past = radius * np.cos(turn)[:, None] - own
        density = slope_density(radius**2, TAIL[lobe]) * radius * least / share**2
        expected += 2.0 * part * float(np.sum(weights * past * density)) / own
    assert shadowing(np.array(a), lobe) == pytest.approx(expected, rel=1e-4, abs=1e-9)


def test_fresnel():
    """Normal incidence ((n − 1)/(n + 1))², half of the light lost to the other polarisation at Brewster's angle."""
    assert fresnel_reflectance(np.array(1.0), 1.5) == pytest.approx(0.04)
    brewster = np.arctan(1.5)
    across = (
        np.sin(brewster - np.arcsin(np.sin(brewster) / 1.5)) ** 2
    )  # of the polarisation that is reflected
    assert fresnel_reflectance(np.cos(brewster), 1.5) == pytest.approx(0.5 * across)
    assert fresnel_reflectance(np.array([0.0, 0.7]), 1.0 / 1.5) == pytest.approx([1.0, 1.0])


@pytest.mark.parametrize("lobe", LOBES)
@pytest.mark.parametrize("polar_deg", [0.0, 40.0, 65.0])
def test_reflectance_of_the_lobe_is_the_integral_of_its_brdf(lobe, polar_deg):
    black = Plastic(0.25, 0.25, 0.0, 1.5, lobe)
    directions, solid = sphere(300, 96)
    total = np.sum(brdf(at(polar_deg), directions, black) * directions[..., 2] * solid)
    found = lobe_reflectance(np.array([np.cos(np.radians(polar_deg))]), 0.25, 1.5, lobe)[0]
    assert found == pytest.approx(total, rel=0.004)


def leaves(plastic: Plastic, mu: np.ndarray) -> np.ndarray:
    """Share of light that leaves a level plate, lobe and base."""
    node, weight = np.polynomial.legendre.leggauss(64)
    cosines = 0.5 * (node + 1.0)
    grid = np.linspace(0.0, 1.0, len(plastic.transmission))
    out = np.pi * np.sum(weight * cosines * np.interp(cosines, grid, plastic.transmission))
    entered = np.interp(mu, grid, plastic.transmission)
    return 1.0 - entered + plastic.base * entered * out


def test_a_white_smooth_plate_sends_all_light_back():
    """White furnace: (2∫T·μ dμ)/η² is then 1 less what the interface sends back from below."""
    assert leaves(Plastic(0.01, 0.01, 1.0), np.array([0.3, 0.6, 1.0])) == pytest.approx(1.0, abs=2e-3)


@pytest.mark.parametrize("lobe", LOBES)
def test_no_more_light_leaves_than_arrives(lobe):
    """A rough white plate loses what its lobes would have to reflect once more, and wins nothing."""
    for alpha in (0.1, 0.5):
        found = leaves(Plastic(alpha, alpha, 1.0, 1.5, lobe), np.array([0.1, 0.3, 0.6, 1.0]))
        assert np.all(found <= 1.0)
        assert np.all(np.diff(found) < 0.05)


@pytest.mark.parametrize("lobe", LOBES)
def test_light_and_camera_may_be_exchanged(lobe):
    plastic = Plastic(0.06, 0.2, 0.3, 1.5, lobe)
    there, back = (
        brdf(at(30.0, 20.0), at(50.0, 200.0), plastic),
        brdf(at(50.0, 200.0), at(30.0, 20.0), plastic),
    )
    assert there == pytest.approx(back, rel=1e-12)
    assert brdf(at(30.0), at(95.0), plastic) == 0.0


@pytest.mark.parametrize(("along", "across", "albedo"), [(0.06, 0.1, 0.2), (0.15, 0.15, 0.6)])
def test_the_beckmann_plastic_is_that_of_the_prediction(along, across, albedo):
    """Two derivations that share no line."""
    ours, theirs = Plastic(along, across, albedo), Material(along, across, albedo)
    assert ours.base == pytest.approx(diffuse_scale(theirs), rel=2e-4)
    for light, camera in (
        (at(10), at(0)),
        (at(20, 90), at(12, 70)),
        (at(55), at(60, 185)),
        (at(40, 30), at(40, 210)),
    ):
        across_axis, along_axis, normal = np.eye(3)
        expected = facet_brdf(light, camera, along_axis, across_axis, normal, theirs)
        assert brdf(light, camera, ours) == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize("wrong", [{"lobe": "phong"}, {"alpha_along": 0.0}, {"albedo": 1.2}, {"index": 1.0}])
def test_impossible_plastics_are_refused(wrong):
    with pytest.raises(ModelError):
        Plastic(**({"alpha_along": 0.1, "alpha_across": 0.1, "albedo": 0.2} | wrong))
