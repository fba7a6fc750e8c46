"""Ridges with rounded crests: against the corrected model, closed forms and the relief predictor."""

from dataclasses import replace

import numpy as np
import pytest

from anisoscope.base.errors import HeightMapError
from anisoscope.parameters.geometry import Convention
from anisoscope.parameters.material import Material
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.sim.light import corrected
from anisoscope.sim.light.geometry import directions, pose_grid
from anisoscope.sim.light.relief import Relief
from anisoscope.sim.light.relief import radiance as relief_radiance
from anisoscope.sim.light.ridge_profile import ridge_polyline
from anisoscope.study.ridges import ridge_radiance

POSES = directions(pose_grid((0.0, 90.0, 180.0), (-20.0, 0.0, 20.0)), Convention())


@pytest.mark.parametrize("wall", ["perpendicular", "vertical"])
@pytest.mark.parametrize("height_loss", [0.0, 0.1])
@pytest.mark.parametrize("angle", [5.0, 20.0])
@pytest.mark.parametrize("material", [Material(), Material(0.031, 0.17, 0.5)])
def test_sharp_crests_are_the_corrected_model(wall, height_loss, angle, material):
    design = RidgeDesign(80.0, angle, wall, height_loss)
    expected = corrected.radiance(*POSES, design, material)
    assert ridge_radiance(*POSES, design, 0.0, material) == pytest.approx(expected, rel=1e-4)
    assert ridge_radiance(*POSES, design, 1e-6, material) == pytest.approx(expected, rel=1e-4)


def test_radiance_is_continuous_in_the_roughness():
    design = RidgeDesign(100.0, 10.0)
    alphas = 0.06 * np.exp(np.linspace(0.0, 0.3, 121))
    values = np.array([ridge_radiance(*POSES, design, 0.0, Material(a, 0.1)) for a in alphas])
    steps = np.diff(np.log(values), axis=0)
    assert np.abs(np.diff(steps, axis=0)).max() < 0.02 * np.abs(steps).max()


def test_only_the_ratio_of_radius_and_pitch_counts():
    small = ridge_radiance(*POSES, RidgeDesign(50.0, 10.0), 3.0, Material())
    assert small == pytest.approx(
        ridge_radiance(*POSES, RidgeDesign(200.0, 10.0), 12.0, Material()), rel=1e-12
    )


@pytest.mark.parametrize("radius", [2.0, 6.0, 30.0])
@pytest.mark.parametrize("angle", [5.0, 20.0])
def test_profile_is_what_a_ball_inside_the_material_reaches(angle, radius):
    """Against the definition, evaluated on points: the highest ball whose surface stays below the sharp profile."""
    design = RidgeDesign(100.0, angle)
    x, z = ridge_polyline(replace(design, edge_radius_um=radius))
    assert (np.diff(x) >= 0).all()
    assert x[-1] - x[0] == pytest.approx(100.0)
    fine = np.arange(-110.0, 110.0, 0.004)
    sharp = design.profile(fine)
    offset = np.arange(-radius, radius + 1e-9, 0.004)
    cap = np.sqrt(np.maximum(radius**2 - offset**2, 0.0))
    at = np.array([-0.5, 0.0, 1.0, 5.0, 20.0])  # crest at 0
    centres = np.arange(-radius - 1.0, 25.0 + radius, 0.004 if radius < 10.0 else 0.04)
    height = np.array([np.min(np.interp(c + offset, fine, sharp) - cap) for c in centres])
    below = np.subtract.outer(at, centres)
    reached = np.where(
        np.abs(below) <= radius, height + np.sqrt(np.maximum(radius**2 - below**2, 0.0)), -np.inf
    )
    assert np.interp(at, x, z, period=100.0) == pytest.approx(reached.max(axis=1), abs=0.03)


@pytest.mark.parametrize(("radius", "foot"), [(2.0, 0.0), (20.0, 0.0), (2.0, 8.0), (0.0, 8.0)])
def test_relief_of_the_same_profile_agrees(radius, foot):
    design = RidgeDesign(100.0, 10.0, foot_radius_um=foot)
    x, z = ridge_polyline(replace(design, edge_radius_um=radius))
    at = np.arange(0.0, 100.0 + 0.025, 0.05)
    heights = np.interp(at, np.concatenate([x - 100.0, x[1:]]), np.concatenate([z, z[1:]]))
    surface = HeightMap(np.broadcast_to(heights, (3, at.size)).copy(), 0.05, 0.05)
    expected = relief_radiance(Relief(surface, 100.0), *POSES, Material())
    assert ridge_radiance(*POSES, design, radius, Material()) == pytest.approx(expected, rel=5e-3)


def test_height_loss_cuts_the_rounded_crest():
    _, rounded = ridge_polyline(RidgeDesign(100.0, 10.0, edge_radius_um=3.0))
    _, cut = ridge_polyline(RidgeDesign(100.0, 10.0, height_loss=0.3, edge_radius_um=3.0))
    assert cut.max() == pytest.approx(0.7 * RidgeDesign(100.0, 10.0).full_height_um)
    assert rounded.max() > cut.max()


@pytest.mark.parametrize(
    ("radius", "match"),
    [(9.9, "leaves no facet"), (100.0, "100 µm is larger than the pitch of 10 µm"), (-1.0, "0 µm or more")],
)
def test_radius_without_a_facet_left_is_refused(radius, match):
    with pytest.raises(HeightMapError, match=match):
        ridge_radiance(*POSES, RidgeDesign(10.0, 40.0), radius, Material())
