"""A good part teaches exposure, region and tolerances."""

import numpy as np
import pytest

from anisoscope.base.errors import MeasurementError, RecordError
from anisoscope.inspection.teach import teach
from anisoscope.kinds.registry import read_recipe
from anisoscope.record.schema import read_record

UNTAUGHT = {
    "acquisition": {"exposure_s": 0.0001},
    "region": {"size_mm": [0.3, 0.3]},
    "decision": {"tolerance": None},
}


@pytest.fixture
def flat_at_any_exposure(virtual_rig):
    """A rig with a recipe that knows nothing yet."""
    return virtual_rig(recipe=UNTAUGHT)


def test_a_good_part_teaches_the_recipe(flat_at_any_exposure, plain):
    rig = flat_at_any_exposure
    before = rig.recipe.read_text()
    found = teach(rig.recipe, rig.rig, "GOOD-1", rig.out, methods=plain)
    recipe, record = read_recipe(rig.recipe), read_record(found.folder)
    assert (recipe.version, found.version, found.kept.read_text()) == (2, 2, before)
    assert read_recipe(found.kept).version == 1
    # the plate is 1.2 mm wide, its markers keep off
    assert recipe.region.size_mm[0] == recipe.region.size_mm[1]
    assert 0.8 <= recipe.region.size_mm[0] <= 1.2
    assert recipe.acquisition.exposure_s > 0.0005
    wanted = [8.0 * contrast.u for contrast in record.details.contrasts]
    assert recipe.decision.tolerance == pytest.approx(wanted, rel=0.06)
    assert {change.key for change in found.changes} == {
        "acquisition.exposure_s",
        "region.size_mm",
        "decision.tolerance",
    }
    frame = max(np.max(seen) for seen in (record.poses[k].measured for k in range(len(record.poses))))
    assert frame > 0.0
    assert not list(rig.recipe.parent.glob(".*.toml"))


def test_a_part_that_cannot_be_measured_leaves_the_recipe(virtual_rig, plain):
    rig = virtual_rig(recipe={**UNTAUGHT, "limits": {"registration_px": 0.0001}})
    before = rig.recipe.read_text()
    with pytest.raises(MeasurementError, match="cannot teach the recipe, which stays as it is"):
        teach(rig.recipe, rig.rig, "GOOD-1", rig.out, methods=plain)
    assert rig.recipe.read_text() == before
    assert sorted(path.name for path in rig.recipe.parent.glob("*recipe*")) == ["recipe.toml"]


def test_an_old_version_is_never_overwritten(flat_at_any_exposure, plain):
    rig = flat_at_any_exposure
    rig.recipe.with_name("recipe.v1.toml").write_text("mine")
    with pytest.raises(RecordError, match="exists already"):
        teach(rig.recipe, rig.rig, "GOOD-1", rig.out, methods=plain)
    assert rig.recipe.with_name("recipe.v1.toml").read_text() == "mine"
    assert rig.folders == []
