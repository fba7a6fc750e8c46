"""A good part teaches exposure, region and tolerances; limits of a file teach tolerances."""

import tomllib
from dataclasses import replace

import numpy as np
import pytest
import tomli_w

from anisoscope.base.errors import (
    MeasurementError,
    RecipeError,
    RecordError,
    RigError,
    RigFileError,
    UsageError,
)
from anisoscope.inspection.replay import check_with_frames
from anisoscope.inspection.teach import teach, teach_by_frames, teach_by_limits
from anisoscope.kinds.recipe_check import RecipeCheck
from anisoscope.kinds.registry import kind_of, read_recipe
from anisoscope.kinds.ridges.kind import Ridges
from anisoscope.record.schema import read_record
from anisoscope.rig.frame import read_frame
from anisoscope.rig.framefolder import write_frame_folder

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


@pytest.fixture
def photographed(inspected_part, flat):
    """A part's frames in a folder, with a rig file of geometry and calibrations alone; (recipe, frames, rig file)."""
    rig, inspected = inspected_part
    frames = [
        replace(read_frame(inspected.folder / entry.name), serial=None) for entry in inspected.record.frames
    ]
    folder = rig.out.parent / "frames"
    write_frame_folder(folder, frames, [entry.again for entry in inspected.record.frames])
    table = tomllib.loads(rig.rig.read_text())
    alone = {key: table[key] for key in ("schema", "fixture")}
    alone |= {"camera": {"pixel_um": 8.0}, "light": {"angle_deg": 10.0}, "calibration": {"flat": str(flat)}}
    path = folder / "rig.toml"
    path.write_text(tomli_w.dumps(alone))
    rig.rig.with_name("bench.toml").unlink()
    recipe = tomllib.loads(rig.recipe.read_text())
    recipe["region"]["size_mm"], recipe["acquisition"]["exposure_s"] = [0.3, 0.3], 0.1
    rig.recipe.write_text(tomli_w.dumps(recipe))
    return rig.recipe, folder, path


def test_frames_teach_the_recipe_without_devices(photographed, plain, tmp_path):
    recipe_path, frames, _ = photographed
    found = teach_by_frames(recipe_path, frames, "GOOD-1", tmp_path / "out", methods=plain)
    recipe, record = read_recipe(recipe_path), read_record(found.folder)
    assert (found.version, recipe.acquisition.exposure_s, record.verdict) == (2, 0.0015, "PASS")
    assert 0.8 <= recipe.region.size_mm[0] <= 1.2
    wanted = [8.0 * contrast.u for contrast in record.details.contrasts]
    assert recipe.decision.tolerance == pytest.approx(wanted, rel=0.06)
    assert "not checked: whether another" in found.notes[-1]


def test_photographs_cannot_be_taken_without_devices(photographed, plain, tmp_path):
    recipe, _, rig = photographed
    with pytest.raises(RigFileError, match="describes no devices"):
        teach(recipe, rig, "GOOD-1", tmp_path / "out", methods=plain)


@pytest.fixture
def quick_capability(monkeypatch):
    """Causes are not looked at: their signatures are not what is tested."""
    monkeypatch.setattr(Ridges, "capability", lambda *_: RecipeCheck(product="plate"))


def test_a_recipe_is_checked_without_devices(photographed, quick_capability):
    recipe, frames, rig = photographed
    found = kind_of(recipe).check_recipe(recipe, rig, 10.0)
    assert "the rig file describes no devices" in found.findings[-1].text
    found = check_with_frames(recipe, frames, None)
    assert found.complaints == ()
    assert "can be measured by these frames, at all 3 poses" in found.frames[0]
    assert found.findings[-1].text.startswith("not checked: whether another exposure")
    text = recipe.read_text().replace("[region]", "[limits]\nregistration_px = 0.0001\n[region]")
    recipe.write_text(text)
    (line,) = check_with_frames(recipe, frames, rig).complaints
    assert "would be INVALID: at 0° the fixture markers fit with" in line


def test_a_tilt_that_a_fixed_arm_does_not_have_shows_in_the_check(virtual_rig, quick_capability):
    rig = virtual_rig(recipe={"poses": {"tilts_deg": [0.0, 10.0]}})
    with pytest.raises(RigError, match="a tilt of 10° was asked for, but the camera arm"):
        kind_of(rig.recipe).check_recipe(rig.recipe, rig.rig, 10.0)


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


def limits_file(folder, record, below, above, *, nominal=None):
    """An AQDEF file as another program writes it, with limits about what an inspection had as prediction."""
    lines = [f"K0100 {len(record.details.contrasts)}", f"K1001/1 {record.product}"]
    for number, one in enumerate(record.details.contrasts, start=1):
        lines += [f"K2002/{number} ln {one.from_deg:g}-{one.to_deg:g}"]
        keyed = {"K2101": nominal, "K2110": one.predicted - below, "K2111": one.predicted + above}
        lines += [f"{key}/{number} {value:.6f}" for key, value in keyed.items() if value is not None]
    path = folder / "drawing.dfq"
    path.write_text("\r\n".join(lines) + "\r\n")
    return path


def test_limits_of_a_file_become_tolerances(inspected_part):
    rig, inspected = inspected_part
    before = rig.recipe.read_text()
    found = teach_by_limits(
        rig.recipe, rig.rig, limits_file(rig.out, inspected.record, 0.2, 0.3, nominal=0.1)
    )
    recipe = read_recipe(rig.recipe)
    assert recipe.decision.tolerance == pytest.approx(
        [0.2, 0.2], abs=2e-6
    )  # no part passes below the lower limit
    assert (recipe.version, found.kept.read_text()) == (2, before)
    assert "nominal +0.1000" in found.notes[0]
    assert found.changes[0].old == 0.25


@pytest.mark.parametrize(
    ("below", "above", "words"),
    [
        (-0.01, 0.3, "within .* predicts"),
        (None, 0.3, "needs a lower and an upper limit"),
        (0.3, -0.4, "is not below the upper one"),
        (40.0, 40.0, "tolerance"),
    ],
)
def test_limits_that_fit_no_recipe_change_nothing(inspected_part, below, above, words):
    rig, inspected = inspected_part
    before = rig.recipe.read_text()
    path = limits_file(rig.out, inspected.record, below or 0.2, above)
    if below is None:
        path.write_text("\r\n".join(one for one in path.read_text().splitlines() if "K2110" not in one))
    with pytest.raises((UsageError, RecipeError), match=words):
        teach_by_limits(rig.recipe, rig.rig, path)
    assert rig.recipe.read_text() == before
    assert sorted(one.name for one in rig.recipe.parent.glob("*recipe*")) == ["recipe.toml"]
