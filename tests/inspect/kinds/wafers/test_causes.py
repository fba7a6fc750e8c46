"""Causes on wafers: what they would change, from which size they show, what is told apart; before any part is there."""

from dataclasses import replace

import numpy as np
import pytest
import tomli_w

from anisoscope.base.cache import VARIABLE
from anisoscope.diagnosis.separability import planned_covariance, separability
from anisoscope.diagnosis.signature_cache import cached_signatures
from anisoscope.kinds.wafers.causes import WAFER_CAUSES, wafer_causes, wafer_signatures
from anisoscope.kinds.wafers.kind import OPTICS
from anisoscope.kinds.wafers.recipe import WaferRecipe
from anisoscope.operations.demo import wafers as demo_wafer
from anisoscope.prediction.expectation import expectation
from anisoscope.recipe.surface import read_surface_recipe

TILE_UM = 256.0


@pytest.fixture(scope="module")
def recipe(tmp_path_factory):
    """The demo's recipe with a tile of 256 µm."""
    folder = tmp_path_factory.mktemp("wafer")
    with pytest.MonkeyPatch.context() as patch:
        for name, value in (("DOT_UM", 64.0), ("DOTS", 4), ("TILE_UM", TILE_UM)):
            patch.setattr(demo_wafer, name, value)
        demo_wafer.write_tile(folder, np.random.default_rng(2))
        table = demo_wafer.recipe()
        table["uncertainty"]["step_edges_nm"] = 0.0  # which hide small widths
        (folder / "recipe.toml").write_text(tomli_w.dumps(table))
    return read_surface_recipe(folder / "recipe.toml", WaferRecipe)


@pytest.fixture(scope="module")
def known(recipe):
    """All signatures."""
    return wafer_signatures(recipe, 0.0)


def by_name(known):
    return {one.cause.name: one for one in known.found}


def test_causes_of_wafers_and_of_plastic_keep_apart(known):
    names = set(by_name(known))
    assert names == {cause.name for cause in wafer_causes()}
    assert names & {"over-etch", "width-bias", "seating-x", "light-angle"}
    assert not names & {"burrs", "wear", "ridge-angle", "missing-ridges", "roughness-along", "colour"}
    assert known.left_out == ()


def test_too_deep_raises_the_mirror_direction_by_the_square_and_dims_all_else_alike(known):
    """τ² = sin²(2π·e/λ) of a balanced tile; the spike over the lobe grows with it, the lobe loses it."""
    one = by_name(known)["over-etch"]
    spike, lobe = one.change[:, :3], one.change[:, 3:]
    tau2 = np.sin(2.0 * np.pi * one.extents / demo_wafer.WAVELENGTH_NM) ** 2
    assert lobe == pytest.approx(np.log(1.0 - tau2)[:, None] * np.ones(3), abs=0.02)
    added = np.exp(spike[:, 0]) - 1.0 + tau2
    far = one.extents >= 6.0
    ratio = added[far] / tau2[far]
    assert ratio == pytest.approx(np.full(far.sum(), ratio.mean()), rel=0.03)
    assert ratio.mean() > 20.0
    assert spike == pytest.approx(spike[:, :1] * np.ones(3))  # the stage does not matter there


def test_too_wide_turns_the_contrast_as_too_deep_does_not(known):
    found = by_name(known)
    inversion = {name: one.change[-1, 3] - one.change[-1, 4] for name, one in found.items()}
    assert inversion["width-bias"] > 0.2
    assert abs(inversion["over-etch"]) < 0.01


def test_what_shows_and_what_is_told_apart(recipe, known):
    expected = expectation(recipe, 0.0, OPTICS)
    rows = {
        row.cause: row for row in separability(known, planned_covariance(recipe, expected), with_map=False)
    }
    assert rows["over-etch"].detection_extent < 6.0
    assert rows["width-bias"].detection_extent < 250.0
    assert rows["over-etch"].inseparable_causes == ("under-etch",)
    assert rows["over-etch"].separation_extents["width-bias"] < 10.0
    assert rows["width-bias"].separation_extents["over-etch"] < 350.0


def test_signatures_of_wafers_are_kept_and_belong_to_their_light(recipe, tmp_path, monkeypatch):
    monkeypatch.setenv(VARIABLE, str(tmp_path))
    names = ("over-etch", "scatter")
    few = replace(
        WAFER_CAUSES,
        signatures=lambda recipe, angle, advance, _: wafer_signatures(recipe, angle, advance, names),
    )
    first = cached_signatures(recipe, 0.0, causes=few)
    none = replace(WAFER_CAUSES, signatures=lambda *_: pytest.fail("computed again"))
    again = cached_signatures(recipe, 0.0, causes=none)
    for one, other in zip(first.found, again.found, strict=True):
        assert (one.cause.name, one.cause.extents) == (other.cause.name, other.cause.extents)
        assert np.array_equal(one.change, other.change)
    assert recipe.light is not None
    other_light = recipe.light.model_copy(update={"wavelength_nm": 530.0})
    with pytest.raises(pytest.fail.Exception, match="computed again"):
        cached_signatures(recipe.model_copy(update={"light": other_light}), 0.0, causes=none)
