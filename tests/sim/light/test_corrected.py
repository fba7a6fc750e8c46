import json
from pathlib import Path

import numpy as np
import pytest

from anisoscope.parameters.geometry import Convention, Pose
from anisoscope.parameters.material import Material
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.profiles.ideal import ridges
from anisoscope.sim.light import relief, relief_paths
from anisoscope.sim.light.corrected import indirect_radiance, radiance, radiance_of_profile
from anisoscope.sim.light.geometry import directions, pose_grid
from anisoscope.sim.light.material import facet_brdf
from anisoscope.sim.light.ridge_profile import ridge_outline, ridge_polyline, sharp_groove, visible_shares

X, Y, Z = np.eye(3)
TANGENTS = np.concatenate([-np.geomspace(8, 0.01, 25), np.geomspace(0.01, 8, 25)])


@pytest.mark.parametrize("angle", [5.0, 10.0, 20.0, 40.0])
def test_visibility_of_perpendicular_ridges_is_the_closed_form(angle):
    theta = np.radians(angle)
    x, z = ridge_polyline(RidgeDesign(100.0, angle))
    for t in TANGENTS:
        facet, wall = visible_shares(x, z, t)
        one_sided = 1.0 if t <= np.tan(theta) else 1.0 / ((1 + t * np.tan(theta)) * np.cos(theta) ** 2)
        assert facet == pytest.approx(one_sided if t > -1 / np.tan(theta) else 0.0, abs=1e-12)
        beyond = 1.0 / (np.sin(theta) ** 2 + np.sin(theta) * np.cos(theta) * abs(t))
        assert wall == pytest.approx(0.0 if t >= np.tan(theta) else min(1.0, beyond), abs=1e-12)


@pytest.mark.parametrize("angle", [5.0, 20.0])
def test_visibility_of_vertical_walls_is_the_closed_form(angle):
    tangent = np.tan(np.radians(angle))
    x, z = ridge_polyline(RidgeDesign(100.0, angle, wall="vertical"))
    for t in TANGENTS:
        facet, wall = visible_shares(x, z, t)
        assert facet == pytest.approx(
            1.0 / (1 + t * tangent) if t > 0 else float(t * tangent > -1), abs=1e-12
        )
        assert wall == pytest.approx(0.0 if t >= 0 else min(1.0, 1 / (tangent * abs(t))), abs=1e-12)


@pytest.mark.parametrize("height_loss", [0.0, 0.1, 0.4])
@pytest.mark.parametrize("wall", ["perpendicular", "vertical"])
@pytest.mark.parametrize("t", [-4.0, -0.7, -0.1, 0.0, 0.1, 0.9, 5.0])
def test_every_ray_meets_the_surface_once(height_loss, wall, t):
    """Identity: the visible parts, projected along the ray, tile the period without gap or overlap."""
    x, z = ridge_polyline(RidgeDesign(80.0, 15.0, wall=wall, height_loss=height_loss))
    projected = np.maximum(np.diff(x - t * z), 0.0) * visible_shares(x, z, t)
    assert projected.sum() == pytest.approx(80.0, rel=1e-12)


@pytest.mark.parametrize("height_loss", [0.0, 0.2])
@pytest.mark.parametrize("wall", ["perpendicular", "vertical"])
def test_radiance_is_reciprocal(wall, height_loss):
    rng = np.random.default_rng(5)
    raw = rng.normal(size=(2, 100, 3))
    raw[..., 2] = np.abs(raw[..., 2]) + 0.3
    first, second = raw / np.linalg.norm(raw, axis=-1, keepdims=True)
    design, material = RidgeDesign(100.0, 18.0, wall=wall, height_loss=height_loss), Material(0.2, 0.3, 0.5)
    there = radiance(first, second, design, material) / first[:, 2]
    back = radiance(second, first, design, material) / second[:, 2]
    np.testing.assert_allclose(there, back, rtol=1e-10)


@pytest.mark.parametrize("angle", [5.0, 10.0, 20.0])
@pytest.mark.parametrize("tilt", [0.0, 40.0, 60.0])
def test_white_furnace_stays_below_one(angle, tilt, hemisphere):
    directions_out, solid_angle = hemisphere(48, 96)
    for azimuth in (0.0, 90.0, 180.0):
        light = np.radians([tilt, azimuth])
        vector = [np.sin(light[0]) * np.cos(light[1]), np.sin(light[0]) * np.sin(light[1]), np.cos(light[0])]
        incoming = np.broadcast_to(vector, directions_out.shape)
        shown = radiance(incoming, directions_out, RidgeDesign(100.0, angle), Material(0.2, 0.2, albedo=1.0))
        assert 0.5 < np.sum(shown * directions_out[:, 2] * solid_angle) / vector[2] <= 1.0 + 2e-3


@pytest.mark.parametrize("tilt", [-20.0, -5.0, 10.0])
def test_mirror_symmetry(tilt):
    to_light, to_camera = directions((Pose(90.0, tilt), Pose(270.0, -tilt)), Convention())
    left, right = radiance(to_light, to_camera, RidgeDesign(100.0, 12.0), Material())
    assert left == pytest.approx(right, rel=1e-12)


@pytest.mark.parametrize("wall", ["perpendicular", "vertical"])
def test_flat_limit_is_the_plain_microfacet_brdf(wall):
    poses = pose_grid((0, 45, 90), (-20, 0, 20))
    to_light, to_camera = directions(poses, Convention())
    expected = facet_brdf(to_light, to_camera, Y, -X, Z, Material()) * to_light[:, 2]
    nearly_flat = radiance(to_light, to_camera, RidgeDesign(100.0, 1e-6, wall=wall), Material())
    np.testing.assert_allclose(nearly_flat, expected, rtol=1e-5)
    np.testing.assert_allclose(
        radiance(to_light, to_camera, RidgeDesign(100.0, 0.0), Material()), expected, rtol=1e-12
    )


def test_radiance_does_not_depend_on_the_pitch():
    to_light, to_camera = directions(pose_grid((0, 90, 180)), Convention())
    small, large = (radiance(to_light, to_camera, RidgeDesign(p, 10.0), Material()) for p in (50.0, 150.0))
    np.testing.assert_allclose(small, large, rtol=1e-12)


@pytest.mark.parametrize(
    ("lobe", "expected"),
    [
        ({}, [275.441, 30.701, 27.584, 28.297, 93.390, 26.696, 28.297, 26.147, 26.696]),
        ({"tail": 0.5}, [229.36, 39.482, 33.334, 31.358, 90.475, 27.522, 31.358, 27.152, 27.522]),
        ({"tail": 1.0}, [198.88, 42.099, 36.104, 33.562, 84.248, 28.834, 33.562, 28.647, 28.834]),
        (
            {"second_lobe": (0.15, 2.5)},
            [249.69, 36.075, 32.082, 31.353, 92.952, 27.816, 31.353, 27.502, 27.816],
        ),
    ],
)
def test_direct_light_of_lobes_of_several_shapes(lobe, expected):
    """Sharp ridges of 10°, against numbers of a separate program (10³ L)."""
    table = directions(pose_grid((0, 90, 180), (0, -10, 10)), Convention())
    found = radiance(*table, RidgeDesign(100.0, 10.0), Material(0.06, 0.10, 0.2, **lobe))
    np.testing.assert_allclose(1e3 * found, expected, rtol=1e-4)


STANDARD = directions(pose_grid((0, 90, 180)), Convention())
ROUNDED = [
    RidgeDesign(100.0, 10.0, edge_radius_um=0.5),
    RidgeDesign(100.0, 10.0, height_loss=0.3, edge_radius_um=10.0),
    RidgeDesign(100.0, 10.0, height_loss=0.15, edge_radius_um=10.0),
    RidgeDesign(100.0, 10.0, "vertical", edge_radius_um=5.0),
    RidgeDesign(100.0, 10.0, 25.0, edge_radius_um=5.0),
    RidgeDesign(100.0, 5.0, edge_radius_um=30.0),  # the ball touches the foot of the wall
    RidgeDesign(100.0, 10.0, 5.0),
]


@pytest.mark.parametrize("design", ROUNDED)
def test_the_outline_of_rounded_ridges_is_their_profile(design):
    outline = ridge_outline(design, 0.01)
    place = np.linspace(outline.x_um[0], outline.x_um[-1], 3001)[1:-1]
    chords = np.interp(place, outline.x_um, outline.z_um)
    beside = np.abs(place - 100.0) > 0.2  # a vertical wall
    np.testing.assert_allclose(chords[beside], design.profile(place)[beside], atol=2e-3)
    assert outline.z_um.max() == pytest.approx(design.profile(np.linspace(-50, 50, 200_001)).max(), abs=1e-3)
    assert outline.normal @ [0.0, 1.0] @ outline.length_um == pytest.approx(
        100.0, rel=1e-9
    )  # covers the plane
    assert outline.normal @ [1.0, 0.0] @ outline.length_um == pytest.approx(0.0, abs=1e-7)  # and closes
    for t in TANGENTS[::7]:
        shares = visible_shares(outline.x_um, outline.z_um, t)
        projected = np.maximum(np.diff(outline.x_um - t * outline.z_um), 0.0)
        assert shares @ projected == pytest.approx(100.0, rel=1e-9)


@pytest.mark.parametrize("design", ROUNDED)
def test_rounded_crests_shine_as_on_a_fine_map(design):
    material = Material(0.08, 0.08, 0.1)
    expected = relief.radiance(
        relief.Relief(ridges(design, (3, 5001), (1.0, 0.04)), 100.0), *STANDARD, material
    )
    np.testing.assert_allclose(radiance(*STANDARD, design, material), expected, rtol=2e-3)


def test_a_small_radius_is_a_sharp_crest_and_chords_do_not_matter():
    material = Material(0.02, 0.02, 0.1)
    sharp, nearly = (RidgeDesign(100.0, 10.0, edge_radius_um=radius) for radius in (0.0, 1e-6))
    np.testing.assert_allclose(
        radiance(*STANDARD, nearly, material, None), radiance(*STANDARD, sharp, material, None), rtol=1e-5
    )
    design = RidgeDesign(100.0, 10.0, edge_radius_um=5.0)
    wide, narrow = (
        radiance(*STANDARD, design, Material(0.3, 0.1, 0.1, second_lobe=second))
        for second in ((1e-9, 1.0), (1e-9, 0.1))
    )
    np.testing.assert_allclose(wide, narrow, rtol=1e-5)


@pytest.mark.parametrize(
    ("radius", "errors"),
    [pytest.param(0.5, (0.002, 0.01, 0.01), marks=pytest.mark.soak), (10.0, (0.003, 0.01, 0.01))],
)
def test_worn_crests_reflect_as_the_shortened_groove(radius, errors):
    """Direct light and paths on a fine map of the worn ridges against the profile's direct light and the groove."""
    design, material = RidgeDesign(100.0, 10.0, edge_radius_um=radius), Material(0.08, 0.08, 0.1)
    pixel = 0.1 if radius < 1.0 else 0.5
    surface = relief.Relief(ridges(design, (20, round(200 / pixel) + 1), (1.0, pixel)), 100.0)
    direct = relief.radiance(surface, *STANDARD, material)
    traced = relief_paths.interreflection(surface, *STANDARD, material, paths=16384)
    found = radiance(*STANDARD, design, material, None) / (direct + traced.radiance) - 1.0
    assert np.all(np.abs(found) < errors)
    if radius == 10.0:  # neither adding the whole groove nor multiplying by its share would do
        sharp = RidgeDesign(100.0, 10.0)
        whole = indirect_radiance(*STANDARD, sharp, material)
        share = 1.0 + whole / radiance(*STANDARD, sharp, material)
        for wrong in (direct + whole, direct * share):
            assert np.max(np.abs(wrong / (direct + traced.radiance) - 1.0)) > 0.08


def test_a_profile_of_its_own_takes_the_groove_of_a_design():
    design, material = RidgeDesign(100.0, 10.0, height_loss=0.2), Material()
    np.testing.assert_allclose(
        radiance_of_profile(*STANDARD, ridge_polyline(design), design, material),
        radiance(*STANDARD, design, material, None),
        rtol=1e-12,
    )
    worn = RidgeDesign(100.0, 10.0, edge_radius_um=5.0)
    outline = ridge_outline(worn, 0.01)
    fine = outline.x_um, outline.z_um
    np.testing.assert_allclose(
        radiance_of_profile(*STANDARD, fine, worn, material),
        radiance(*STANDARD, worn, material, None),
        rtol=1e-3,
    )
    assert sharp_groove(worn).height_loss == pytest.approx(0.8 * 5.0 / (100.0 * np.sin(np.radians(10.0))))
    assert sharp_groove(RidgeDesign(100.0, 5.0, edge_radius_um=30.0)).height_loss == 0.9


def test_an_edge_of_half_a_micrometre_counts_where_it_mirrors():
    """With all reflections, α .08 and ρ .1: .01744 with a sharp crest, .01769 with the arc."""
    material = Material(0.08, 0.08, 0.1)
    sharp, rounded = (
        radiance(*STANDARD, RidgeDesign(100.0, 10.0, edge_radius_um=radius), material, None)
        for radius in (0.0, 0.5)
    )
    assert sharp[2] == pytest.approx(0.01744, abs=1e-5)
    assert rounded[2] == pytest.approx(0.01769, abs=2e-5)
    for lobe in ({}, {"tail": 0.5}, {"tail": 1.0}, {"second_lobe": (0.15, 2.5)}):
        plastic = Material(**lobe)
        sharp, rounded = (
            radiance(*STANDARD, RidgeDesign(100.0, 10.0, edge_radius_um=radius), plastic)
            for radius in (0.0, 0.5)
        )
        assert 0.009 < rounded[2] / sharp[2] - 1.0 < 0.018
        assert np.all(np.abs(rounded[:2] / sharp[:2] - 1.0) < 0.004)


MITSUBA = json.loads(
    (Path(__file__).parents[2] / "data" / "mitsuba" / "wear.json").read_text(encoding="utf-8")
)
"""Worn ridges by another renderer: tools/render_mitsuba_wear.py."""


@pytest.mark.parametrize(("plastic", "of_change"), [("smooth, dark", 0.05), ("rough, bright", 0.17)])
def test_worn_ridges_are_as_bright_as_mitsuba_renders_them(plastic, of_change):
    """Crests of up to a fifth of the pitch; changes by wear, rms over poses and radii, as a share of themselves."""
    poses = [Pose(*pose) for pose in MITSUBA["poses"]]
    sides = directions(poses, Convention(MITSUBA["light_angle_deg"]))
    own = MITSUBA["plastics"][plastic]
    material = Material(own["alpha"], own["alpha"], own["albedo"], MITSUBA["index"])
    rows = [row for row in MITSUBA["rows"] if row["plastic"] == plastic]
    assert [row["radius_um"] for row in rows] == [0.0, 2.5, 5.0, 10.0, 20.0]
    ours, theirs = [], []
    for row in rows:
        worn = RidgeDesign(MITSUBA["pitch_um"], MITSUBA["ridge_angle_deg"], edge_radius_um=row["radius_um"])
        direct = radiance(*sides, worn, material)
        np.testing.assert_allclose(direct, row["direct"], rtol=0.006)
        found = direct + indirect_radiance(*sides, worn, material)
        assert max(np.array(row["all_error"]) / row["all"]) < 0.002
        np.testing.assert_allclose(found, row["all"], rtol=0.011)
        ours.append(np.log(found))
        theirs.append(np.log(row["all"]))
    change, reference = (np.array(one[1:]) - one[0] for one in (ours, theirs))
    assert np.sqrt(np.sum((change - reference) ** 2) / np.sum(reference**2)) < of_change
