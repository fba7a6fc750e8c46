import numpy as np
import pytest

from anisoscope.base.errors import HeightMapError
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.profiles.defects import burrs, ridge_angle_error
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.profiles.ideal import add_facet_roughness, ridges

DESIGN = RidgeDesign(100.0, 10.0)


@pytest.mark.parametrize("pixel", [pytest.param(0.5, marks=pytest.mark.soak), 1.0, 4.0])
@pytest.mark.parametrize("coverage", [0.01, 0.1, 0.25])
def test_burrs_reach_their_coverage_and_only_add(pixel, coverage):
    side = round(1000.0 / pixel)
    surface = ridges(DESIGN, (side, side), pixel, phase=0.4)
    spoiled = burrs(surface, coverage, pitch_um=100.0, rng=np.random.default_rng(7))
    added = spoiled.map.height_um - surface.height_um
    assert spoiled.mask.mean() == pytest.approx(coverage, rel=0.05)
    assert (added[spoiled.mask] > 0.0).all()
    assert (added[~spoiled.mask] == 0.0).all()
    assert added.max() < 12.0
    slopes = np.hypot(*np.gradient(added, pixel))
    assert np.quantile(slopes[spoiled.mask], 0.999) < np.tan(np.radians(60.0))


def test_burrs_stand_on_the_crests_and_are_longer_along_them():
    surface = ridges(DESIGN, (1000, 1000), 1.0, phase=0.4)
    mask = burrs(surface, 0.05, pitch_um=100.0, rng=np.random.default_rng(1)).mask
    phase = (np.nonzero(mask)[1] / 100.0 - 0.4 + 0.5) % 1.0 - 0.5
    assert abs(phase.mean()) < 0.03
    assert np.abs(phase).max() < 0.5
    runs = [
        np.count_nonzero(mask) / np.count_nonzero(np.diff(mask.astype(int), axis=axis) == 1)
        for axis in (0, 1)
    ]
    assert runs[0] > 1.3 * runs[1]


def test_burrs_are_reproducible_and_leave_gaps_alone():
    surface = ridges(DESIGN, (300, 300), 1.0)
    z = surface.height_um.copy()
    z[100:150] = np.nan
    surface = surface.with_height(z)
    one, two = (burrs(surface, 0.1, pitch_um=100.0, rng=np.random.default_rng(5)) for _ in range(2))
    assert np.array_equal(one.map.height_um, two.map.height_um, equal_nan=True)
    assert not one.mask[100:150].any()
    assert one.mask.sum() / np.isfinite(z).sum() == pytest.approx(0.1, rel=0.05)
    assert not burrs(surface, 0.0, pitch_um=100.0, rng=np.random.default_rng(5)).mask.any()


def test_a_trace_of_burrs_is_no_error():
    surface = ridges(DESIGN, (1000, 1000), 1.0)
    for coverage in (1e-7, 3e-6, 2e-5):
        mask = burrs(surface, coverage, pitch_um=100.0, rng=np.random.default_rng(0)).mask
        assert abs(mask.sum() - 1e6 * coverage) < 50


@pytest.mark.parametrize(
    "arguments",
    [
        {"coverage": -0.1, "pitch_um": 100.0},
        {"coverage": 1.0, "pitch_um": 100.0},
        {"coverage": 0.1, "pitch_um": 0.0},
        {"coverage": 0.1, "pitch_um": 100.0, "height_um": (5.0, 2.0)},
        {"coverage": 0.9, "pitch_um": 100.0, "size_um": (10.0, 12.0)},
    ],
)
def test_burrs_that_cannot_be(arguments):
    surface = ridges(DESIGN, (200, 200), 1.0)
    with pytest.raises(HeightMapError):
        burrs(surface, rng=np.random.default_rng(0), **arguments)


@pytest.mark.parametrize("delta", [-3.0, 2.0])
def test_ridge_angle_error_turns_facets_and_keeps_roughness(delta):
    smooth = ridges(DESIGN, (600, 800), 1.0)
    rough = add_facet_roughness(smooth, 0.06, 0.1, 6.0, np.random.default_rng(0))
    spoiled = ridge_angle_error(rough, delta, ridge_angle_deg=10.0)
    inner = slice(20, 80)
    folded = np.median(spoiled.height_um, axis=0)[:800].reshape(8, 100).mean(axis=0)
    slope = np.polyfit(np.arange(20, 80), folded[inner], 1)[0]
    assert np.degrees(np.arctan(-slope)) == pytest.approx(10.0 + delta, abs=0.1)
    before, after = (np.std(np.diff(m.height_um, axis=0)) for m in (rough, spoiled))
    assert after == pytest.approx(before, rel=0.005)
    assert spoiled.origin["ridge_angle_error"]["scaled"] == "median ridge"


def test_ridge_angle_error_without_a_period_scales_everything():
    surface = ridges(DESIGN, (50, 150), 1.0)
    spoiled = ridge_angle_error(surface, 5.0, ridge_angle_deg=10.0)
    gain = np.tan(np.radians(15.0)) / np.tan(np.radians(10.0))
    assert np.ptp(spoiled.height_um) == pytest.approx(gain * np.ptp(surface.height_um))
    assert spoiled.origin["ridge_angle_error"]["scaled"] == "all heights"


@pytest.mark.parametrize(("theta", "delta"), [(0.0, 1.0), (10.0, -11.0), (40.0, 6.0)])
def test_ridge_angles_that_cannot_be(theta, delta):
    with pytest.raises(HeightMapError):
        ridge_angle_error(HeightMap(np.eye(9), 1.0, 1.0), delta, ridge_angle_deg=theta)
