"""What holds for every defect."""

import json
from itertools import pairwise

import numpy as np
import pytest

from anisoscope.base.errors import HeightMapError
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.profiles.defect_injection import DEFECTS, inject_defect, values_of
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.profiles.ideal import add_facet_roughness, ridges

ADDING = {"burrs", "dust"}
REMOVING = {"wear", "incomplete-filling", "scratches", "missing-ridges"}
NAMES = sorted(DEFECTS)


@pytest.fixture(scope="module")
def part():
    smooth = ridges(RidgeDesign(60.0, 10.0), (300, 420), 1.0, phase=0.4)
    rough = add_facet_roughness(smooth, 0.03, 0.04, 6.0, np.random.default_rng(0))
    z = rough.height_um.copy()
    z[100:120, 50:300] = np.nan
    z[np.random.default_rng(1).random(z.shape) < 0.01] = np.nan
    return rough.with_height(z)


def spoiled(part, name, severity, seed=3):
    return inject_defect(part, name, np.random.default_rng(seed), severity=severity)


@pytest.mark.parametrize("name", NAMES)
def test_no_severity_is_the_identity(part, name):
    assert np.array_equal(spoiled(part, name, 0.0).height_um, part.height_um, equal_nan=True)


@pytest.mark.parametrize("name", NAMES)
def test_missing_points_stay_missing_and_no_others_go(part, name):
    found = spoiled(part, name, 0.7).height_um
    assert np.array_equal(np.isnan(found), np.isnan(part.height_um))


@pytest.mark.parametrize("name", NAMES)
def test_deviation_grows_with_severity(part, name):
    steps = (0.0, 0.1, 0.4, 0.7, 1.0)
    rms = [np.sqrt(np.nanmean((spoiled(part, name, s).height_um - part.height_um) ** 2)) for s in steps]
    assert rms[0] == 0.0
    assert all(low <= high for low, high in pairwise(rms))
    assert rms[-1] > 0.2  # gross


@pytest.mark.parametrize("name", NAMES)
def test_material_is_added_or_removed(part, name):
    change = spoiled(part, name, 0.8).height_um - part.height_um
    change = change[np.isfinite(change)]
    assert change.any()
    if name in ADDING:
        assert change.min() >= 0.0
    if name in REMOVING:
        assert change.max() <= 0.0


@pytest.mark.parametrize("name", NAMES)
def test_a_seed_makes_it_again_and_another_another(part, name):
    one, two, other = (spoiled(part, name, 0.5, seed).height_um for seed in (3, 3, 4))
    assert np.array_equal(one, two, equal_nan=True)
    chance = name in ADDING | {"scratches", "missing-ridges", "chatter", "rough-facets"}
    assert np.array_equal(one, other, equal_nan=True) != chance


@pytest.mark.parametrize("name", NAMES)
def test_severity_is_a_value_of_its_extent(part, name):
    extent = DEFECTS[name].extent
    by_value = inject_defect(part, name, np.random.default_rng(3), values={extent.name: 0.5 * extent.default})
    assert np.array_equal(by_value.height_um, spoiled(part, name, 0.5).height_um, equal_nan=True)


@pytest.mark.parametrize("name", NAMES)
def test_every_defect_says_what_it_is(name):
    defect = DEFECTS[name]
    assert defect.cause
    for setting in (defect.extent, *defect.settings):
        assert setting.meaning
        assert setting.unit in {"", "µm", "°", "%", "1/mm²"}
        assert setting.name.endswith("_um") == (setting.unit == "µm")


def test_the_origin_lists_what_was_done(part):
    first = inject_defect(part, "wear", np.random.default_rng(0), severity=0.5, seed=0)
    both = inject_defect(first, "dust", np.random.default_rng(1), values={"density_per_mm2": 50.0}, seed=1)
    wear, dust = json.loads(json.dumps(both.origin["defects"]))
    assert wear == {"defect": "wear", "severity": 0.5, "parameters": {"radius_um": 10.0}, "seed": 0}
    assert dust["parameters"] == {"diameter_um": 10.0, "density_per_mm2": 50.0}
    assert "defects" not in part.origin


@pytest.mark.parametrize(
    ("name", "severity", "values", "message"),
    [
        ("rust", 0.5, {}, "unknown defect"),
        ("wear", 1.5, {}, "between 0"),
        ("wear", -0.1, {}, "between 0"),
        ("wear", float("nan"), {}, "between 0"),
        ("wear", None, {}, "either"),
        ("wear", 0.5, {"radius_um": 2.0}, "either"),
        ("wear", 0.5, {"radius": 2.0}, "radius_um"),
        ("wear", None, {"radius_um": float("inf")}, "finite"),
        ("wear", None, {"radius_um": -1.0}, "negative"),
        ("wear", None, {"radius_um": 100.0}, "pixels"),
        ("incomplete-filling", None, {"loss": 1.5}, "share"),
        ("incomplete-filling", 0.5, {"gradient": 2.0}, "gradient"),
        ("pitch", None, {"error_percent": -95.0}, "limit"),
        ("missing-ridges", None, {"share": 1.1}, "share"),
        ("scratches", 0.5, {"width_um": 0.0}, "positive"),
        ("dust", None, {"density_per_mm2": -5.0}, "density"),
        ("dust", 0.5, {"diameter_um": 0.0}, "positive"),
        ("chatter", None, {"amplitude_um": -1.0}, "negative"),
        ("chatter", 0.5, {"wavelength_um": 1.0}, "two pixels"),
        ("ridge-angle", None, {"delta_deg": 60.0}, "45"),
        ("burrs", None, {"coverage": 1.5}, "coverage"),
    ],
)
def test_defects_that_cannot_be(part, name, severity, values, message):
    with pytest.raises(HeightMapError, match=message):
        inject_defect(part, name, np.random.default_rng(0), severity=severity, values=values)


@pytest.mark.parametrize("name", ["burrs", "incomplete-filling", "missing-ridges", "pitch", "ridge-angle"])
def test_defects_of_ridges_need_ridges(name):
    ground = HeightMap(np.random.default_rng(0).standard_normal((200, 200)), 1.0, 1.0)
    with pytest.raises(HeightMapError, match="four ridges"):
        spoiled(ground, name, 0.5)


@pytest.mark.parametrize("name", ["wear", "rough-facets", "scratches", "dust", "chatter"])
def test_other_defects_do_not(name):
    plain = HeightMap(np.zeros((200, 200)), 1.0, 1.0)
    change = spoiled(plain, name, 1.0).height_um
    assert change.any() == (name != "wear")  # a plane has no edges


def test_burrs_want_ridges_along_y():
    from anisoscope.profiles.patterns import turned_ridges

    turned = turned_ridges(RidgeDesign(40.0, 10.0), (300, 300), 1.0, direction_deg=30.0)
    with pytest.raises(HeightMapError, match="Turn"):
        spoiled(turned, "burrs", 0.5)


def test_values_are_defaults_unless_given():
    found = values_of(DEFECTS["scratches"], 0.5, {"depth_um": 1.0})
    assert found == {"density_per_mm2": 30.0, "depth_um": 1.0, "width_um": 12.0, "length_um": 400.0}
