"""Cells that deviate in parts rendered by the path tracer: marks are found without golden parts, good cells are not."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from anisoscope.imaging.deviation_map import CROWDED, cell_map
from anisoscope.imaging.pose_radiance import Measured
from anisoscope.imaging.registration.placement import Grid
from anisoscope.parameters.geometry import Convention, Pose
from anisoscope.parameters.material import Material
from anisoscope.profiles.defect_injection import inject_defect
from anisoscope.profiles.ideal import add_facet_roughness, ridges
from anisoscope.recipe.poses import PosesPart
from anisoscope.sim.light.geometry import directions
from anisoscope.sim.light.relief import Relief, radiance_maps
from detection_study.traced import UPRIGHT, Part, recipe_of

NINE = tuple(Pose(angle, tilt) for tilt in (0.0, -10.0, 10.0) for angle in (0.0, 90.0, 180.0))
CHANGED_UM, SPOILED = 0.2, 0.15
"""Change of a height of a mark, and share of a cell that has it; cells where none is above a quarter are good."""
SIZE = (1640, 1240)
PITCH_UM = 96.0  # a whole number of points a cell, as regions have it
MARKS = {
    "good": {},
    "scratches": {"spoiled": ("scratches", {"density_per_mm2": 11.7})},
    "burrs": {"spoiled": ("burrs", {"coverage": 0.02})},
    "missing": {"flat_ridge": 8},
}


def recipe_with(poses):
    table = PosesPart(stage_and_tilt_deg=tuple((pose.stage_deg, pose.tilt_deg) for pose in poses))
    return recipe_of(pitch_um=PITCH_UM).model_copy(update={"poses": table})


@pytest.fixture(scope="module")
def parts():
    """A part of every kind in nine poses."""
    return {
        name: Part(20 + k, NINE, pitch=PITCH_UM, size=SIZE, spread=0.1, **how)
        for k, (name, how) in enumerate(MARKS.items())
    }


def found_in(part, poses=range(9), changed=lambda picture: picture):
    seen = part.measured(list(poses), pitch_um=PITCH_UM, margin=1)
    seen = replace(seen, aligned=tuple(changed(one) for one in seen.aligned))
    return cell_map(seen, recipe_with([NINE[k] for k in poses]))


@pytest.mark.parametrize("poses", [range(3), range(9)], ids=["three poses", "nine poses"])
def test_a_good_part_hardly_deviates_whatever_the_number_of_poses(parts, poses):
    assert found_in(parts["good"], poses).deviating().mean() < 0.015


@pytest.mark.parametrize(
    ("name", "poses", "least"),
    [
        ("scratches", range(9), 0.7),
        ("scratches", range(3), 0.4),
        ("burrs", range(9), 0.75),
        ("burrs", range(3), 0.55),
    ],
)
def test_marks_are_found_without_golden_parts(parts, name, poses, least):
    over = found_in(parts[name], poses).deviating()
    mark = parts[name].spoiled_share(CHANGED_UM, pitch_um=PITCH_UM, margin=1) >= SPOILED
    good = parts[name].spoiled_share(0.25 * CHANGED_UM, pitch_um=PITCH_UM, margin=1) == 0.0
    hit, missed, false = np.sum(over & mark), np.sum(~over & mark), np.sum(over & good)
    assert 2.0 * hit / (2.0 * hit + missed + false) > least
    assert over.mean() > 0.018


@pytest.mark.parametrize("poses", [range(3), range(9)], ids=["three poses", "nine poses"])
def test_a_missing_ridge_deviates_all_along(parts, poses):
    over = found_in(parts["missing"], poses).deviating()
    whole = over.mean(axis=0) > 0.9
    assert 3 <= whole.sum() <= 5
    assert over[:, ~whole].mean() < 0.03


@pytest.mark.parametrize(
    "changed",
    [
        lambda one: 0.7 * one,
        lambda one: one + np.float32(0.005 * one.mean()),
        lambda one: (one / one.mean()) ** np.float32(0.95),
        lambda one: np.roll(one, 1, axis=1),
    ],
    ids=["lamp", "ambient light", "gamma", "shift"],
)
def test_lamp_ambient_light_gamma_and_shift_change_next_to_nothing(parts, changed):
    for name in ("good", "scratches"):
        plain, other = (found_in(parts[name], changed=one).deviating() for one in (lambda one: one, changed))
        assert abs(plain.mean() - other.mean()) < 0.008


def test_one_pose_that_is_darker_is_no_deviation(parts):
    seen = parts["good"].measured(pitch_um=PITCH_UM, margin=1)
    dark = replace(seen, aligned=(0.9 * seen.aligned[0], *seen.aligned[1:]))
    recipe = recipe_with(NINE)
    np.testing.assert_allclose(cell_map(seen, recipe).score, cell_map(dark, recipe).score, atol=1e-3)


def test_without_pictures_the_cells_are_compared(parts):
    """As of inspections of earlier versions, whose frames are not kept: coarser, but no other verdict."""
    recipe = recipe_with(UPRIGHT)
    shares = []
    for name in ("good", "burrs"):
        seen = replace(parts[name].measured([0, 1, 2], pitch_um=PITCH_UM, margin=1), aligned=())
        shares.append(cell_map(seen, recipe).deviating().mean())
    assert shares[0] < 0.01
    assert shares[1] > 0.012


def test_three_ridges_and_a_spoiled_half_are_judged(parts):
    seen = parts["good"].measured([0, 1, 2], pitch_um=PITCH_UM, margin=1)
    step = seen.aligned[0].shape[1] // (seen.cells.shape[2] // 4)
    few = replace(
        seen, aligned=tuple(one[:, : 3 * step] for one in seen.aligned), cells=seen.cells[:, :, :12]
    )
    assert cell_map(few, recipe_with(UPRIGHT)).deviating().mean() < 0.02
    rng = np.random.default_rng(1)
    half = [one.copy() for one in seen.aligned]
    for one in half:
        one[: len(one) // 2] *= rng.lognormal(0.0, 0.5, (len(one) // 2, one.shape[1])).astype(np.float32)
    over = cell_map(replace(seen, aligned=tuple(half)), recipe_with(UPRIGHT))
    assert over.deviating().mean() > 0.3


def textured(recipe, coverage=0.0, *, patch_rows=0, patch=0.0):
    """A part of textured ridges with burrs, photographed with 3 µm points: measurement of its pictures.

    The first ``patch_rows`` cells of every column have facets of another roughness.
    """
    rng = np.random.default_rng(3)
    smooth = ridges(recipe.surface.ridge_design(), (257, 513), (PITCH_UM / 32, PITCH_UM / 32))
    surface = add_facet_roughness(smooth, 0.03, 0.03, 8.0, rng)
    if patch_rows:
        height = np.array(surface.height_um)
        other = add_facet_roughness(smooth, patch, patch, 8.0, rng)
        height[: 8 * patch_rows] = other.height_um[: 8 * patch_rows]
        surface = surface.with_height(height)
    if coverage:
        surface = inject_defect(surface, "burrs", rng, values={"coverage": coverage})
    relief = Relief(surface, PITCH_UM, max_missing_share=1.0)
    sides = directions(recipe.poses.poses(), Convention(10.0))
    lobe = Material(alpha_along=0.06, alpha_across=0.09, albedo=0.2, index=1.5)
    seen = [
        np.float32(cv2.GaussianBlur(one[1:, 1:], (0, 0), 1.0)) for one in radiance_maps(relief, *sides, lobe)
    ]
    cells = np.stack([cv2.resize(one, (64, 32), interpolation=cv2.INTER_AREA) for one in seen])
    grid = Grid((0.0, 0.0), PITCH_UM / 32000.0, seen[0].shape, 0.0)
    radiance, noise = cells.mean(axis=(1, 2)), np.full(len(seen), 0.001)
    return Measured(radiance, (), tuple(seen), cells.astype(np.float64), noise, grid, None)


def test_more_marks_deviate_in_more_cells_up_to_a_third_of_the_part_and_half_of_it_fails():
    """At a third the crests are covered nearly all along: their own points are no reference any more."""
    recipe = recipe_with(UPRIGHT)
    maps = [cell_map(textured(recipe, coverage), recipe) for coverage in (0.0, 0.02, 0.1, 0.3, 0.5)]
    shares = [one.deviating().mean() for one in maps]
    assert shares[0] < 0.015
    assert shares[1] > 0.018
    assert np.all(np.diff(shares[:-1]) > 0.0)
    assert shares[-1] > 0.25
    assert [one.over > CROWDED for one in (maps[1], maps[-1])] == [False, True]


@pytest.mark.parametrize("rows", [6, 16])
def test_a_patch_of_another_texture_deviates_and_the_rest_does_not(rows):
    """Means of cells hardly change with the roughness seen upright; the scatter of their points does."""
    recipe = recipe_with(UPRIGHT)
    same = cell_map(textured(recipe, patch_rows=rows, patch=0.03), recipe).deviating()
    over = cell_map(textured(recipe, patch_rows=rows, patch=0.09), recipe).deviating()
    assert same.mean() < 0.015
    assert over[: rows - 1].mean() > 0.9
    assert over[rows + 1 :].mean() < 0.02


@pytest.mark.parametrize(("crest_um", "phase"), [(4.0, 0.1), (4.0, 0.9), (8.0, 0.5)])
def test_glints_of_rounded_crests_are_no_marks(crest_um, phase):
    """Few facets of the texture send them, and they are as narrow as a point of a picture: 2 to 12 % deviated."""
    part = Part(50_000, UPRIGHT, size=(1000.0, 800.0), spread=0.1, phase=phase, crest_um=crest_um)
    assert cell_map(part.measured(margin=1), recipe_of()).deviating().mean() < 0.016
