"""Leans of facets in parts rendered by the path tracer, which shares nothing with the model of a facet."""

import re
from dataclasses import replace

import cv2
import numpy as np
import pytest

from anisoscope.base.errors import MeasurementError, UsageError
from anisoscope.imaging.angle_map import angle_map, planned_worth
from anisoscope.imaging.phase_map import phase_map
from anisoscope.imaging.pose_radiance import Measured
from anisoscope.imaging.registration.placement import Grid
from anisoscope.kinds.ridges.recipe import RidgeRecipe
from anisoscope.operations.facets import form_of, write_angle_map
from anisoscope.parameters.geometry import Convention, Pose
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.prediction.expectation import Component, expectation
from anisoscope.profiles.files.load import read_height_map
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.profiles.ideal import add_facet_roughness
from anisoscope.sim.light.geometry import directions
from anisoscope.sim.pathtracer.plastic import Plastic
from anisoscope.sim.pathtracer.tracer import PathTracer

POINT_UM, PICTURE_UM, BLUR_UM = 2.0, 4.0, 3.0
UPRIGHT = tuple(Pose(angle, 0.0) for angle in (0.0, 90.0, 180.0))
TEXTURE = 0.03
PHASE = 0.37


def recipe_of(angle_deg=10.0, pitch_um=100.0, alpha=0.08, tail=0.0):
    whole = float(np.hypot(alpha, TEXTURE))
    return RidgeRecipe.model_validate(
        {
            "schema": 1,
            "product": "traced ridges",
            "surface": {"pitch_um": pitch_um, "design": {"ridge_angle_deg": angle_deg}},
            "material": {
                "alpha_along": whole, "alpha_across": whole, "albedo": 0.1, "u_albedo": 0.003,
                "tail": tail, "u_tail": 0.0,
            },
            "poses": {"angles_deg": [0.0, 90.0, 180.0]},
            "acquisition": {"exposure_s": 0.001},
            "region": {"size_mm": [1.2, 0.8]},
            "uncertainty": {"seating_tilt_deg": 0.1},
        }
    )  # fmt: skip


class Part:
    """A part of ridges that lean differently, with waves of its form, and what the camera sees of it.

    ``formed`` adds heights over (x, y) in µm.
    """

    def __init__(self, seed, poses, *, angle=10.0, pitch=100.0, alpha=0.08, lobe="beckmann", size=(1200, 800),
                 spread=0.15, flat_ridge=None, formed=None):  # fmt: skip
        rng = np.random.default_rng(seed)
        cols, rows = (int(one / POINT_UM) + 1 for one in size)
        x = np.arange(cols) * POINT_UM - PHASE * pitch
        ridge = np.floor(x / pitch).astype(int)
        height = np.zeros(cols)
        for number in np.unique(ridge):
            lean = 0.0 if number == flat_ridge else angle + spread * rng.standard_normal()
            chosen = ridge == number
            height[chosen] = RidgeDesign(pitch, lean).profile(x[chosen])
        surface = HeightMap(np.tile(height, (rows, 1)), POINT_UM, POINT_UM, {})
        if formed is not None:
            at_x, at_y = np.meshgrid(np.arange(cols) * POINT_UM, np.arange(rows) * POINT_UM)
            surface = surface.with_height(surface.height_um + formed(at_x, at_y))
        self.surface = add_facet_roughness(surface, TEXTURE, TEXTURE, 8.0, rng)
        self.poses = poses
        tracer = PathTracer(
            self.surface, Plastic(alpha, alpha, 0.1, 1.5, lobe), reflections=3, paths=8192, seed=seed
        )
        self.pictures = []
        for light, camera in zip(*directions(poses, Convention(10.0)), strict=True):
            seen = cv2.GaussianBlur(tracer.radiance(light, camera), (0, 0), BLUR_UM / POINT_UM)[::-1]
            small = cv2.resize(seen, (seen.shape[1] // 2, seen.shape[0] // 2), interpolation=cv2.INTER_AREA)
            noise = 1.0 + 0.005 * rng.standard_normal(small.shape)
            self.pictures.append((small * noise).astype(np.float32))

    def measured(self):
        shape = self.pictures[0].shape
        grid = Grid((0.0, 0.0), PICTURE_UM / 1000.0, shape, 0.0)
        return Measured(
            np.array([one.mean() for one in self.pictures]), (), tuple(self.pictures), np.zeros((1, 1, 1)), np.zeros(1),
            grid, None,
        )  # fmt: skip

    def map_by(self, recipe, cell_um=48.0, parts=()):
        known = expectation(recipe, 10.0)
        expected = replace(
            known, poses=self.poses, components=tuple(parts), radiance=np.ones(len(self.poses))
        )
        return angle_map(recipe, expected, self.measured(), cell_um)

    def leans(self, found):
        """(A, C) true leans across and along of the cells of a map, averaged over them."""
        rows, cols = self.pictures[0].shape
        z = self.surface.height_um[: 2 * rows + 1, : 2 * cols + 1]
        slopes = np.diff(z, axis=1)[:-1] / POINT_UM, np.diff(z, axis=0)[:, :-1] / POINT_UM
        x = (np.arange(2 * cols) + 0.5 - cols) * POINT_UM
        y = (np.arange(2 * rows) + 0.5 - rows) * POINT_UM
        leans = []
        for slope, sign in zip(slopes, (-1.0, 1.0), strict=True):
            whole = np.zeros((2 * rows + 1, 2 * cols + 1))
            whole[1:, 1:] = np.cumsum(np.cumsum(slope, axis=0), axis=1)
            half_x, half_y = (0.5 * one for one in found.cell_um)
            left, right = (np.searchsorted(x, 1000.0 * found.across_mm + s) for s in (-half_x, half_x))
            low, high = (np.searchsorted(y, 1000.0 * found.along_mm + s) for s in (-half_y, half_y))
            total = (
                whole[np.ix_(high, right)] - whole[np.ix_(low, right)] - whole[np.ix_(high, left)]
                + whole[np.ix_(low, left)]
            )  # fmt: skip
            leans.append(sign * np.degrees(np.arctan(total / np.outer(high - low, right - left))))
        return leans


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


def test_steeper_ridges_of_a_lobe_with_a_tail():
    part = Part(2, (*UPRIGHT, Pose(90.0, -15.0)), angle=15.0, pitch=80.0, alpha=0.11, lobe="ggx")
    found = part.map_by(recipe_of(15.0, 80.0, 0.11, tail=1.0))
    across, _ = part.leans(found)
    known = np.isfinite(found.angle_deg)
    off = (found.angle_deg - across)[known]
    assert np.std(off) < 0.1
    assert abs(off.mean()) < 2.0 * found.u_mean_deg


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
