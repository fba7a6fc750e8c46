"""Causes on wafers: what they would change, from which size they show, what is told apart; before any part is there."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import tomli_w

from anisoscope.base.cache import VARIABLE
from anisoscope.diagnosis.part_diagnosis import evidence_of
from anisoscope.diagnosis.ranking import diagnose
from anisoscope.diagnosis.separability import planned_covariance, separability
from anisoscope.diagnosis.signature_cache import cached_signatures
from anisoscope.kinds.wafers.causes import WAFER_CAUSES, wafer_signatures
from anisoscope.kinds.wafers.kind import OPTICS
from anisoscope.kinds.wafers.recipe import WaferRecipe
from anisoscope.operations.demo import wafers as demo_wafer
from anisoscope.parameters.etching import PatternOptions
from anisoscope.prediction.expectation import Component, expectation
from anisoscope.profiles.files.load import write_height_map
from anisoscope.sim.bench.wafer import build_wafer
from anisoscope.sim.bench.waferpart import WaferPart
from anisoscope.sim.design.depths import design_depths
from anisoscope.sim.design.pattern import make_layout
from anisoscope.sim.light.geometry import directions

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
    return WaferRecipe.read(folder / "recipe.toml")


@pytest.fixture(scope="module")
def known(recipe):
    """All signatures."""
    return wafer_signatures(recipe, 0.0)


def by_name(known):
    return {one.cause.name: one for one in known.found}


def test_causes_of_wafers_and_of_plastic_keep_apart(recipe, known):
    names = set(by_name(known))
    assert names == {cause.name for cause in WAFER_CAUSES.causes(recipe)}
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


OFF = {"turned": ("turned", 90.0), "shifted": ("mask-x-2", 500.0), "deeper": ("deep-pass-1", 12.0)}


@pytest.fixture(scope="module")
def two_passes(tmp_path_factory):
    """Recipe and tile of a wafer with a pass for each axis; passes and masks are told apart by four tilts."""
    folder = tmp_path_factory.mktemp("two-passes")
    passes = design_depths(4, (450.0, 650.0)).passes_nm
    design = demo_wafer.design().model_copy(update={"passes_nm": passes})
    options = PatternOptions(64.0, 4)
    layout = make_layout(np.zeros((2, 2), np.int64), (design,), np.random.default_rng(1), options)
    write_height_map(layout.window(), folder / "tile.npz")
    table = demo_wafer.recipe()
    table["surface"]["pitch_um"] = 128.0
    table["region"]["size_mm"] = [0.384, 0.384]
    table["poses"]["tilts_deg"] = [0.0, 2.0, 3.0, 6.0]
    table["uncertainty"]["step_edges_nm"] = 0.0
    (folder / "recipe.toml").write_text(tomli_w.dumps(table))
    return WaferRecipe.read(folder / "recipe.toml"), layout.window(), 1e-3 * np.array(passes)


@pytest.mark.parametrize("wrong", OFF)
def test_a_turned_pattern_a_shifted_mask_and_a_deep_pass_are_named(two_passes, tmp_path, wrong):
    """The heights are changed here, and photographed point by point of the lamp; 0.3 % of every pose is added."""
    recipe, tile, passes_um = two_passes
    rng, expected = np.random.default_rng(3), expectation(recipe, 0.0, OPTICS)
    deep = np.stack(
        [np.abs(-tile.height_um - depth) < 1e-6 for depth in (passes_um[0], passes_um[1], passes_um.sum())]
    )
    masks = np.stack([deep[0] | deep[2], deep[1] | deep[2]])
    if wrong == "turned":
        masks = np.rot90(masks, axes=(1, 2))
    if wrong == "shifted":
        masks[1] = np.roll(masks[1], round(0.5 / tile.pixel_x_um), axis=1)
    if wrong == "deeper":
        passes_um[0] += 0.012
    made = tile.with_height(-np.tensordot(passes_um, masks, 1))
    write_height_map(made, tmp_path / "made.npz")
    part = WaferPart(file=tmp_path / "made.npz", reflectance=0.9, **demo_wafer.LIGHT)
    wafer = build_wafer(part, 0.5, rng)
    rows, cols = (round(128.0 / pixel) for pixel in wafer.pixel_um)
    views = zip(*directions(expected.poses, expected.convention), strict=True)
    seen = np.array([wafer.radiance(*view)[0, :rows, :cols].mean(dtype=float) for view in views])
    seen *= np.exp(0.003 * rng.standard_normal(len(seen)))
    errors = (Component("pictures", "measurement", np.full(len(seen), 0.003), shared=False),)
    measured = SimpleNamespace(radiance=seen, components=errors)
    decided = SimpleNamespace(area=None, deviating=None)
    found = diagnose(wafer_signatures(recipe, 0.0), evidence_of(recipe, expected, measured, decided))
    name, size = OFF[wrong]
    assert found.causes[0].cause == name
    assert abs(found.causes[0].severity) == pytest.approx(size, rel=0.2)
    assert found.causes[0].weight > 0.9
