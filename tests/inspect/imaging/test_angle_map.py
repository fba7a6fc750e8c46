"""Leans of facets in parts rendered by the path tracer, which shares nothing with the model of a facet."""

import re
from dataclasses import replace

import cv2
import numpy as np
import pytest

from anisoscope.base.errors import MeasurementError, UsageError
from anisoscope.imaging.angle_map import angle_map
from anisoscope.imaging.facet_fit import planned_worth, poses_for_angles
from anisoscope.imaging.phase_map import phase_map
from anisoscope.operations.facets import form_of, write_angle_map
from anisoscope.parameters.geometry import Convention, Pose
from anisoscope.prediction.expectation import Component, expectation, under_lamp
from anisoscope.profiles.files.load import read_height_map
from anisoscope.rig.rigfile import LightPart
from anisoscope.sim.light.geometry import pose_grid
from detection_study.traced import TEXTURE, UPRIGHT, Part, recipe_of


@pytest.fixture(scope="module")
def ten():
    """A part of 10° with a pose that tells the lean along the ridges."""
    return Part(1, (*UPRIGHT, Pose(90.0, -10.0)), formed=lambda x, y: 1.5 * np.sin(y / 130.0 + x / 400.0))


def test_leans_of_cells_and_their_uncertainty(ten):
    found = ten.map_by(recipe_of())
    across, along = ten.leans(found)
    known = np.isfinite(found.angle_deg)
    assert known.mean() > 0.9
    off = (found.angle_deg - across)[known]
    assert np.sqrt(np.mean(off**2)) < 0.12
    assert 0.7 < np.std(off / found.u_deg[known]) < 1.4
    assert np.corrcoef(found.angle_deg[known], across[known])[0, 1] > 0.9
    off = (found.along_deg - along)[known]
    assert np.sqrt(np.mean(off**2)) < 0.12
    assert np.corrcoef(found.along_deg[known], along[known])[0, 1] > 0.9
    assert abs(found.mean_deg - across[known].mean()) < 2.0 * found.u_mean_deg
    assert abs(found.alpha - 1.0) < 2.0 * found.u_alpha < 0.2
    assert found.pitch_um == pytest.approx(100.0, abs=0.15)


def test_three_upright_poses_tell_lean_and_roughness(ten):
    upright = Part.__new__(Part)
    upright.surface, upright.poses, upright.pictures = ten.surface, UPRIGHT, ten.pictures[:3]
    found = upright.map_by(recipe_of(alpha=0.07))  # the part is rougher than its recipe says
    across, _ = ten.leans(found)
    known = np.isfinite(found.angle_deg)
    assert found.along_deg is None
    assert np.sqrt(np.mean((found.angle_deg - across)[known] ** 2)) < 0.12
    assert abs(found.alpha - np.hypot(0.08, TEXTURE) / np.hypot(0.07, TEXTURE)) < 2.0 * found.u_alpha


STEEP = {"angle": 15.0, "pitch": 80.0, "alpha": 0.11}


def suggested(recipe):
    allowed = pose_grid(tuple(np.arange(0.0, 346.0, 15.0)), tuple(np.arange(-20.0, 21.0, 5.0)))
    return tuple(allowed[k] for k in poses_for_angles(recipe, allowed, Convention(10.0), 3))


def test_steeper_ridges_of_a_lobe_with_a_tail_in_suggested_poses():
    recipe = recipe_of(15.0, 80.0, 0.11, tail=1.0)
    part = Part(2, suggested(recipe), **STEEP, lobe="ggx")
    found = part.map_by(recipe)
    us = found.u_deg, found.u_along_deg
    for lean, u, true in zip((found.angle_deg, found.along_deg), us, part.leans(found), strict=True):
        off = (lean - true)[np.isfinite(lean)]
        assert np.sqrt(np.mean(off**2)) < 0.12
        assert 0.7 < np.std(off / u[np.isfinite(lean)]) < 1.4
    assert abs(found.mean_deg - 15.0) < 2.0 * found.u_mean_deg


SETS = {
    "10° in three poses upright": (recipe_of(), UPRIGHT, {}),
    "10° in four poses": (recipe_of(), (*UPRIGHT, Pose(90.0, -10.0)), {}),
    "10° in three suggested poses": (recipe_of(), suggested(recipe_of()), {}),
    "15° in three suggested poses": (
        recipe_of(15.0, 80.0, 0.11, tail=1.0),
        suggested(recipe_of(15.0, 80.0, 0.11, tail=1.0)),
        STEEP | {"lobe": "ggx"},
    ),
}


@pytest.mark.statistics
@pytest.mark.parametrize("name", SETS)
def test_uncertainties_of_cells_of_many_parts(name):
    """Of parts as rough as the recipe ± 15 %, in poses of which the light is known to 2 %."""
    each = np.array([errors_of(seed, *SETS[name]) for seed in range(100, 124)])
    known = np.isfinite(each).all(axis=1)
    assert known[:, 0].all()
    assert not known[:, 1].any() or known[:, 1].mean() > 0.9
    for axis in np.flatnonzero(known.any(axis=0)):
        rms, z = np.sqrt(np.mean(np.square(each[known[:, axis], :, axis]), axis=0))
        assert rms < 0.12
        assert 0.85 < z < 1.35


def errors_of(seed, recipe, poses, changed):
    """Standard deviations of the leans in degrees and in u, each across and along; NaN of what no pose tells."""
    rng = np.random.default_rng([5, seed])
    alpha = changed.get("alpha", 0.08) * (1.0 + 0.15 * rng.standard_normal())
    form = {"formed": lambda x, y: 1.5 * np.sin(y / 130.0 + x / 400.0)}
    part = Part(seed, poses, **changed | form | {"alpha": alpha})
    part.pictures = [one * np.float32(np.exp(0.02 * rng.standard_normal())) for one in part.pictures]
    found = part.map_by(recipe)
    known, (across, along) = np.isfinite(found.angle_deg), part.leans(found)
    errors = np.full((2, 2), np.nan)
    for axis, lean, u, true in (
        (0, found.angle_deg, found.u_deg, across), (1, found.along_deg, found.u_along_deg, along),
    ):  # fmt: skip
        if lean is not None:
            errors[:, axis] = np.std((lean - true)[known]), np.std(((lean - true) / u)[known])
    return errors


@pytest.mark.parametrize("alpha", [0.055, 0.2])
def test_a_part_of_half_or_twice_the_roughness_has_a_map(alpha):
    """Its fit ran out of the range of a material, and the inspection ended with an error about the recipe."""
    recipe = recipe_of(15.0, 80.0, 0.11, tail=1.0)
    found = Part(6, suggested(recipe), **STEEP | {"lobe": "ggx", "alpha": alpha}).map_by(recipe)
    assert np.isfinite(found.angle_deg).mean() > 0.9
    assert abs(np.nanmean(found.angle_deg) - 15.0) < 0.1
    assert abs(found.alpha - np.hypot(alpha, TEXTURE) / np.hypot(0.11, TEXTURE)) < 3.0 * found.u_alpha


def test_a_missing_ridge_is_the_worst_or_unseen():
    part = Part(3, UPRIGHT, flat_ridge=5)
    found = part.map_by(recipe_of())
    across, _ = part.leans(found)
    flat = int(found.ridge[np.argmin(np.abs(np.nanmean(across, axis=0)))])
    columns = found.ridge == flat
    level = np.isfinite(found.angle_deg[:, columns])
    assert np.all(np.abs(found.angle_deg[:, columns][level]) < 2.0)
    assert level.mean() > 0.9
    assert found.worst.ridge == flat
    assert abs(np.nanmedian(found.angle_deg[:, ~columns]) - 10.0) < 0.2


@pytest.fixture(scope="module")
def two_lamps():
    """One part under a lamp far away and under one at 40 mm."""
    poses = (*UPRIGHT, Pose(90.0, -10.0))
    return tuple(Part(7, poses, size=(1600.0, 1200.0), spread=0.0, lamp_um=far) for far in (None, 4e4))


def test_a_near_lamp_turns_the_leans_over_the_part(two_lamps):
    part = two_lamps[1]
    found = part.map_by(recipe_of())
    mended = found.under_lamp(40.0)
    for seen, right, true, place in (
        (found.angle_deg, mended.angle_deg, part.leans(found)[0], found.across_mm[None, :]),
        (found.along_deg, mended.along_deg, part.leans(found)[1], -found.along_mm[:, None]),
    ):
        known = np.isfinite(seen)
        x = np.broadcast_to(place, seen.shape)[known]
        turned, left = (np.polyfit(x, (one - true)[known], 1)[0] for one in (seen, right))
        assert turned == pytest.approx(np.degrees(0.5 / 40.0), rel=0.05)
        assert abs(left) < 0.04


def test_a_near_lamp_changes_the_mean_of_a_region(two_lamps):
    """By half a percent to one in poses far off the lobe's middle, as the path tracer says."""
    far, near = (np.array([one.mean() for one in part.pictures]) for part in two_lamps)
    poses = tuple((one.stage_deg, one.tilt_deg) for one in two_lamps[0].poses)
    recipe = recipe_of()
    recipe = recipe.model_copy(
        update={
            "poses": type(recipe.poses).model_validate({"stage_and_tilt_deg": poses}),
            "region": recipe.region.model_copy(update={"size_mm": (1.6, 1.2)}),
        }
    )
    plain = expectation(recipe, 10.0)
    lit = under_lamp(plain, recipe, LightPart(distance_mm=40.0))
    predicted, u = np.log(lit.radiance / plain.radiance), lit.components[-1].relative
    assert lit.components[-1].source == "distance of the lamp"
    assert np.abs(np.log(near / far) - predicted).max() < 2.0 * u.max() < 0.003
    assert predicted[1] > 0.004


@pytest.mark.parametrize("level", [0.2, 4.0, 20.0])
def test_ridges_that_mirror_leave_the_phase_of_the_others(ten, level):
    """Two of twelve, for a light of their own: the pitch was read 28 % too large."""
    pictures = [one.copy() for one in ten.pictures[:3]]
    whole = phase_map(pictures, 4.0, 100.0, None)
    rng = np.random.default_rng(4)
    for first in (62, 188):
        for one in pictures:
            one[:, first : first + 25] = level * np.median(one) * rng.normal(1.0, 0.05, (len(one), 25))
    found = phase_map(pictures, 4.0, 100.0, None)
    off = found.place - whole.place
    assert np.abs(off - np.round(np.median(off))).max() < 0.05
    assert found.pitch_um == pytest.approx(100.0, abs=0.4)


def test_pictures_without_a_common_phase_are_said(ten):
    rng = np.random.default_rng(3)
    pictures = [one.copy() for one in ten.pictures[:3]]
    for first in range(0, pictures[0].shape[1] - 25, 25):  # every ridge at a place of its own
        step = int(rng.integers(25))
        for one in pictures:
            one[:, first : first + 25] = np.roll(one[:, first : first + 25], step, axis=1)
    with pytest.raises(MeasurementError, match="phase of the ridges scatters by 0"):
        phase_map(pictures, 4.0, 100.0, None)


def test_a_sink_mark_has_its_depth(tmp_path):
    depth, width = 8.0, 250.0

    def sunk(x, y):
        return -depth * np.exp(-((x - 600.0) ** 2 + (y - 400.0) ** 2) / (2.0 * width**2))

    part = Part(4, (*UPRIGHT, Pose(90.0, -10.0)), spread=0.0, formed=sunk)
    found = part.map_by(recipe_of())
    write_angle_map(found, tmp_path / "form.x3p")
    form = read_height_map(tmp_path / "form.x3p")
    assert form.shape == found.angle_deg.shape
    x, y = np.meshgrid(600.0 + 1000.0 * found.across_mm, 400.0 + 1000.0 * found.along_mm[::-1])
    true = sunk(x, y)
    off = form.height_um - true
    off -= off.mean()
    assert np.ptp(true) > 5.0
    assert np.sqrt(np.mean(off**2)) < 0.25
    np.testing.assert_allclose(form.height_um, form_of(found).height_um, atol=1e-3)


def test_the_worth_of_poses_is_known_from_the_design():
    recipe = recipe_of()
    upright = expectation(recipe, 10.0)
    assert re.fullmatch(
        r"angle map: tells the mean lean of the facets across the ridges to ± 0\.\d+° \(k = 2\), their roughness to "
        r"± [\d.]+ %, not the lean along the ridges, which a pose at 90° with a tilt of −10° would tell",
        planned_worth(recipe, upright),
    )
    tilts = recipe.poses.model_copy(update={"tilts_deg": (0.0, -10.0)})
    tilted = recipe.model_copy(update={"poses": tilts})
    assert planned_worth(tilted, expectation(tilted, 10.0)).endswith(", the lean along the ridges too")


def test_what_all_cells_share_moves_the_mean_alone(ten):
    light = Component("light angle", "prediction", np.array([0.1, 0.02, 0.02, -0.1]), shared=True)
    plain, moved = ten.map_by(recipe_of()), ten.map_by(recipe_of(), parts=[light])
    np.testing.assert_array_equal(plain.u_deg, moved.u_deg)
    assert moved.u_mean_deg > 1.5 * plain.u_mean_deg


def test_an_unknown_roughness_moves_the_cells_of_a_ridge_at_once(ten):
    """It does not even out over the cells, and is no spread of theirs."""
    found = ten.map_by(recipe_of())
    alone = replace(found, u_deg=np.full(found.angle_deg.shape, 0.03), stretch_deg=0.0)
    both = replace(found, u_deg=np.full(found.angle_deg.shape, 0.05), stretch_deg=0.04)
    assert both.spread_deg == pytest.approx(alone.spread_deg)
    for one, other in zip(alone.by_ridge, both.by_ridge, strict=True):
        assert other.u_deg == pytest.approx(np.hypot(one.u_deg, 0.04))
    assert 0.0 < np.nanmax(np.abs(found.stretch_deg)) < np.nanmax(found.u_deg)


def test_a_smaller_cell_has_a_larger_uncertainty(ten):
    assert np.nanmedian(ten.map_by(recipe_of(), 24.0).u_deg) > 1.3 * np.nanmedian(
        ten.map_by(recipe_of()).u_deg
    )


def test_refusals(ten):
    picture = ten.pictures[0]
    with pytest.raises(
        MeasurementError, match=r"5\.0 points of 4 µm, facets are seen from 8 on: take a lens"
    ):
        phase_map([picture], 4.0, 20.0, 0.03)
    with pytest.raises(MeasurementError, match=r"holds 2\.0 pitches, the phase of the ridges needs 3"):
        phase_map([picture], 4.0, 400.0, 0.03)
    plain = np.random.default_rng(1).normal(1.0, 0.01, picture.shape).astype(np.float32)
    with pytest.raises(MeasurementError, match="no pose shows the ridges clearly enough"):
        phase_map([plain], 4.0, 100.0, 0.03)
    with pytest.raises(UsageError, match="cells of 2 µm are smaller than a point"):
        ten.map_by(recipe_of(), 2.0)
    with pytest.raises(UsageError, match="cells of 5000 µm are larger than the region"):
        ten.map_by(recipe_of(), 5000.0)
    with pytest.raises(MeasurementError, match="its frames"):
        angle_map(recipe_of(), expectation(recipe_of(), 10.0), replace(ten.measured(), aligned=()))


@pytest.mark.parametrize(("turn_deg", "pitch_um"), [(0.0, 100.0), (1.5, 100.0), (-0.7, 101.3)])
def test_phase_of_turned_ridges_and_another_pitch(turn_deg, pitch_um):
    """Square ridges with dark walls, turned, and a scratch that outshines them."""
    rows, cols = 250, 300
    turn = np.radians(turn_deg)

    def place(y, x):
        return (np.cos(turn) * x + np.sin(turn) * y) / pitch_um - 0.21

    fine = np.where(place(*np.mgrid[0 : 4 * rows, 0 : 4 * cols]) % 1.0 > 0.96, 0.02, 0.2).astype(np.float32)
    picture = cv2.resize(fine, (cols, rows), interpolation=cv2.INTER_AREA)
    true = place(*(np.mgrid[0:rows, 0:cols] * 4.0 + 1.5))
    picture[100:103] = 30.0
    found = phase_map([picture], 4.0, 100.0, 0.04)
    off = found.place - true
    off -= np.round(np.median(off))
    assert np.abs(off).max() < 0.03
    assert found.pitch_um == pytest.approx(pitch_um, rel=2e-3)
    assert found.turn_deg == pytest.approx(turn_deg, abs=0.02)
