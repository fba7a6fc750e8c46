"""Predictions kept: made once for all parts of a recipe, never used for anything else than what they were made from."""

import shutil

import numpy as np
import pytest

from anisoscope.diagnosis import signature_cache as remembering
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.prediction import cache as keptprediction
from anisoscope.prediction.cache import cached_expectation, forget, packed
from anisoscope.prediction.expectation import PLASTIC, expectation
from anisoscope.profiles.files.load import write_height_map
from anisoscope.profiles.ideal import ridges


@pytest.fixture
def made(monkeypatch, tmp_path):
    """What was predicted anew; memory and folder are empty at the start."""
    monkeypatch.setenv("ANISOSCOPE_CACHE", str(tmp_path / "cache"))
    forget()
    found = []

    def noted(recipe, light_angle_deg, _optics):
        found.append(light_angle_deg)
        return expectation(recipe, light_angle_deg)

    monkeypatch.setattr(keptprediction, "expectation", noted)
    yield found
    forget()


@pytest.fixture
def of_a_map(make_recipe, tmp_path):
    """A recipe with a height map in a folder of a name."""

    def lay(folder="first", angle_deg=10.0, **changes):
        original, path = tmp_path / f"{angle_deg}.x3p", tmp_path / folder / "map.x3p"
        if not original.exists():  # the format holds the time of writing
            write_height_map(ridges(RidgeDesign(100.0, angle_deg), (41, 251), (4.0, 2.0)), original)
        path.parent.mkdir(exist_ok=True)
        shutil.copy(original, path)
        return make_recipe(surface={"design": None, "height_map": str(path)}, **changes)

    return lay


def files(tmp_path):
    return list((tmp_path / "cache").rglob("*.entry"))


def test_a_design_is_predicted_once_and_leaves_nothing_on_disk(made, make_recipe, tmp_path):
    first = cached_expectation(make_recipe(), 10.0)
    assert cached_expectation(make_recipe(product="another name"), 10.0) is first
    assert (len(made), files(tmp_path)) == (1, [])


def test_what_the_prediction_rests_on_makes_it_anew(made, make_recipe):
    changes = (
        {},
        {"material": {"albedo": 0.21}},
        {"uncertainty": {"seating_tilt_deg": 0.06}},
        {"surface": {"design": {"u_ridge_angle_deg": 0.1}}},
    )
    found = [cached_expectation(make_recipe(**change), 10.0) for change in changes]
    found.append(cached_expectation(make_recipe(), 11.0))
    assert len(made) == len({packed(one) for one in found}) == 5


def test_a_prediction_from_a_map_outlives_the_program_without_loss(made, of_a_map, tmp_path):
    recipe = of_a_map()
    first = cached_expectation(recipe, 10.0)
    forget()
    again = cached_expectation(of_a_map("a copy of it"), 10.0)
    assert (len(made), len(files(tmp_path))) == (1, 1)
    assert packed(again) == packed(first) == packed(expectation(recipe, 10.0))
    assert (again.poses, again.convention, again.model) == (first.poses, first.convention, "relief")
    assert not again.surface.height_um.flags.writeable
    np.testing.assert_array_equal(again.response.bend, first.response.bend)


def test_another_map_of_the_same_name_is_predicted_anew(made, of_a_map):
    cached_expectation(of_a_map(), 10.0)
    cached_expectation(of_a_map(angle_deg=9.0), 10.0)
    assert len(made) == 2


def test_damaged_files_other_code_and_missing_folders_cost_a_prediction_only(
    made, of_a_map, monkeypatch, tmp_path
):
    recipe = of_a_map()
    first = packed(cached_expectation(recipe, 10.0))
    for spoil in (
        lambda: files(tmp_path)[0].write_bytes(files(tmp_path)[0].read_bytes()[:1000]),
        lambda: monkeypatch.setattr("anisoscope.base.cache.source_digest", lambda *_: "another"),
        lambda: monkeypatch.setenv("ANISOSCOPE_CACHE", "/dev/null"),
    ):
        spoil()
        forget()
        before = len(made)
        assert packed(cached_expectation(recipe, 10.0)) == first
        assert len(made) == before + 1


def test_a_map_that_is_not_there_is_said_by_the_prediction(made, of_a_map):
    recipe = of_a_map()
    recipe.surface.height_map.unlink()
    with pytest.raises(Exception, match=r"map\.x3p"):
        cached_expectation(recipe, 10.0)
    assert len(made) == 1


def test_only_some_predictions_stay_in_memory(made, make_recipe):
    angles = [8.0 + 0.5 * number for number in range(keptprediction.MAX_IN_MEMORY + 1)]
    for angle in (*angles, angles[-1], angles[0]):
        cached_expectation(make_recipe(), angle)
    assert made == [*angles, angles[0]]


def test_signatures_know_a_copy_of_a_map_as_well(of_a_map):
    keys = [
        remembering.signature_key(of_a_map(*given), 10.0) for given in (("one",), ("other",), ("third", 9.0))
    ]
    assert keys[0] == keys[1] != keys[2]


def test_other_optics_are_another_prediction(made, make_recipe):
    class OtherOptics(type(PLASTIC)):
        pass

    first = cached_expectation(make_recipe(), 10.0)
    assert cached_expectation(make_recipe(), 10.0, OtherOptics()) is not first
    assert cached_expectation(make_recipe(), 10.0) is first
    assert len(made) == 2
