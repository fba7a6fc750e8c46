"""A good print teaches exposure, region and tolerances."""

from types import SimpleNamespace

import pytest

from anisoscope.prints.recipe import read_print_recipe
from anisoscope.prints.tolerances import KEYS, taught_tolerances
from anisoscope.record import read_record
from anisoscope.teaching import teach


@pytest.mark.usefixtures("plain_report")
def test_a_good_print_teaches_its_recipe(print_rig):
    untaught = {"acquisition": {"exposure_s": 0.0004}, "region": {"size_mm": [0.4, 0.4]}}
    recipe_path, rig_path = print_rig.lay_out({}, recipe=untaught)
    before = recipe_path.read_text()
    found = teach(recipe_path, rig_path, "GOOD-1", print_rig.folder / "inspections")
    recipe, record = read_print_recipe(recipe_path), read_record(found.folder)
    assert (recipe.version, found.version, found.kept.read_text()) == (2, 2, before)
    # the sheet is 2.4 mm wide; a cell of 0.2 mm stays away from its edge
    assert recipe.region.size_mm[0] == recipe.region.size_mm[1]
    assert 1.6 <= recipe.region.size_mm[0] <= 2.2
    assert 0.002 < recipe.acquisition.exposure_s < 0.008
    frame_level = max(pose.measured for pose in record.poses)
    assert frame_level > 0.0
    limits = recipe.tolerances.model_dump()
    for one in record.print.quantities:
        limit = limits[KEYS[one.name]]
        assert limit >= 8.0 * one.u
        assert abs(one.deviation) + 1.645 * one.u < limit
    assert {change.key for change in found.changes} == {
        "acquisition.exposure_s",
        "region.size_mm",
        *(f"tolerances.{name}" for name in limits),
    }
    assert not list(recipe_path.parent.glob(".*.toml"))


def test_tolerances_are_rounded_up_and_cover_the_print(make_recipe):
    quantities = [
        SimpleNamespace(name="delta_e", u=0.11, deviation=0.9),
        SimpleNamespace(name="alpha x", u=0.0101, deviation=0.002),
        SimpleNamespace(name="alpha y", u=0.005, deviation=-0.1),
    ]
    record = SimpleNamespace(print=SimpleNamespace(quantities=quantities))
    assert taught_tolerances(record, make_recipe()) == {"delta_e": 1.3, "alpha_share": 0.12}
