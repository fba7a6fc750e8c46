"""Ridges on parts that are curved or wavy, flanks that are not straight, and ridges of two directions."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest

from anisoscope.base.errors import HeightMapError
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.profiles import patterns
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.profiles.metrology.ridges import measure_ridges

SPEC = importlib.util.spec_from_file_location("ridgesurfaces", Path(__file__).with_name("ridgesurfaces.py"))
surfaces = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(surfaces)
Truth = surfaces.Truth

SHAPE = (600, 700)
Y, X = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)


def form(name):
    """Heights in µm beneath the ridges, on a field of 700 × 600 µm."""
    away = (X - 300.0) ** 2 + (Y - 350.0) ** 2
    return {
        "sphere of 5 mm": away / 2.0 / 5e3,
        "sphere of 20 mm": -away / 2.0 / 2e4,
        "wave along": 2.0 * np.sin(2.0 * np.pi * Y / 500.0),
        "wave across": 2.0 * np.sin(2.0 * np.pi * X / 700.0),
    }[name]


@pytest.fixture(scope="module")
def flat():
    """A rough ridged map, its truth and what is measured on it; ridges at 3°."""
    truth = Truth(direction=3.0, tilt=(0.1, 0.0), shape=SHAPE, burrs=10, spikes=10)
    surface = truth.surface(3)
    return truth, surface, measure_ridges(surface)


@pytest.mark.parametrize(
    "name",
    ["sphere of 5 mm", pytest.param("sphere of 20 mm", marks=pytest.mark.soak), "wave along", "wave across"],
)
def test_form_beneath_the_ridges_is_no_roughness(flat, name):
    truth, surface, plain = flat
    curved = form(name)
    found = measure_ridges(surface.with_height(surface.height_um + curved))
    assert found.alpha_along.value == pytest.approx(truth.alpha_along, abs=3.0 * found.alpha_along.u)
    assert found.alpha_across.value == pytest.approx(truth.alpha_across, abs=3.0 * found.alpha_across.u)
    assert found.alpha_along.value == pytest.approx(plain.alpha_along.value, rel=0.005)
    assert found.ridge_angle_deg.value == pytest.approx(plain.ridge_angle_deg.value, abs=0.03)
    assert found.ridge_angle_deg.u < 2.0 * plain.ridge_angle_deg.u + 0.02
    plane = np.stack([np.ones(X.size), X.ravel(), Y.ravel()], axis=1)
    beyond = curved.ravel() - plane @ np.linalg.lstsq(plane, curved.ravel(), rcond=None)[0]
    assert found.form_um == pytest.approx(float(np.std(beyond)), rel=0.1)
    assert any("form of" in remark for remark in found.remarks())


def test_a_flat_map_keeps_every_number(flat):
    plain = flat[2]
    assert plain.form_um == 0.0
    assert plain.remarks() == ()
    assert plain.straight
    assert plain.stated() is plain
    assert plain.facet_bow < 0.005


def test_waves_too_short_to_be_form_are_in_the_uncertainty(flat):
    truth, surface, plain = flat
    found = measure_ridges(
        surface.with_height(surface.height_um + 1.5 * np.sin(2.0 * np.pi * (X + Y) / 250.0))
    )
    assert found.alpha_along.u > 2.0 * plain.alpha_along.u
    assert found.alpha_along.value == pytest.approx(truth.alpha_along, abs=3.0 * found.alpha_along.u)


def test_a_sinusoid_has_no_straight_flanks():
    noise = 0.01 * np.random.default_rng(0).normal(size=SHAPE)
    found = measure_ridges(HeightMap(3.0 * np.sin(2.0 * np.pi * X / 100.0) + noise, 1.0, 1.0))
    assert not found.straight
    assert found.ridge_angle_deg.u > 0.1
    stated = found.stated()
    unknown = {name for name, one in stated.quantities().items() if not one.known}
    assert unknown >= {"ridge_angle_deg", "wall_angle_deg", "height_um", "edge_radius_um", "alpha_across"}
    assert not unknown & {"pitch_um", "direction_deg"}
    assert not any(ridge.angle_deg.known or ridge.height_um.known for ridge in stated.ridges)
    assert "ridge angle –" in repr(found)


def test_ridges_that_cross_are_said():
    design = RidgeDesign(60.0, 10.0)
    both = [patterns.turned_ridges(design, SHAPE, 1.0, direction_deg=one).height_um for one in (10.0, 70.0)]
    noise = 0.05 * np.random.default_rng(0).normal(size=SHAPE)
    found = measure_ridges(HeightMap(both[0] + 0.4 * both[1] + noise, 1.0, 1.0))
    assert found.direction_deg.value == pytest.approx(10.0, abs=0.1)
    assert found.second_direction_deg == pytest.approx(70.0, abs=1.0)
    assert any("70.0°" in remark for remark in found.remarks())


def test_parts_of_two_directions_are_refused_by_name():
    surface = patterns.checkerboard(RidgeDesign(60.0, 10.0), (800, 800), 1.0, 400.0)
    with pytest.raises(HeightMapError, match=r"more than one direction.*crop"):
        measure_ridges(surface)
