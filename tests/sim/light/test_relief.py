import numpy as np
import pytest

from anisoscope.base.errors import HeightMapError, ModelError
from anisoscope.parameters.geometry import Convention
from anisoscope.parameters.material import Material
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.profiles.patterns import turned_ridges
from anisoscope.sim.light import corrected
from anisoscope.sim.light.census import added, shine_at_nodes
from anisoscope.sim.light.geometry import directions, pose_grid
from anisoscope.sim.light.horizon import Horizon, bands
from anisoscope.sim.light.material import diffuse_scale, facet_brdf, fresnel, transmittance
from anisoscope.sim.light.relief import Relief, radiance, radiance_maps, radiance_of_cells
from anisoscope.sim.light.ridge_profile import ridge_polyline
from anisoscope.sim.light.shine import shine_in

RIDGE_ANGLES = (5.0, 10.0, 15.0, 20.0)
TABLE = pose_grid((0, 90, 180), (-20, -10, 0, 10, 20))


def sampled(design, pixel_um, rows=4, periods=1, pixel_y_um=1.0):
    """Ideal ridges sampled by the tests themselves, one row repeated."""
    x, z = ridge_polyline(design)
    count = round(periods * design.pitch_um / pixel_um) + 1
    line = np.interp(np.arange(count) * pixel_um, *_repeated(x, z, periods + 1))
    return HeightMap(np.tile(line, (rows, 1)), pixel_um, pixel_y_um)


def _repeated(x, z, periods):
    period = x[-1] - x[0]
    shift = np.repeat(np.arange(-1, periods) * period, x.size - 1)
    return np.tile(x[:-1], periods + 1) + shift, np.tile(z[:-1], periods + 1)


@pytest.mark.parametrize("angle", RIDGE_ANGLES)
def test_relief_equals_corrected_on_ideal_ridges(angle):
    design = RidgeDesign(100.0, angle)
    to_light, to_camera = directions(TABLE, Convention())
    expected = corrected.radiance(to_light, to_camera, design, Material())
    found = radiance(Relief(sampled(design, 0.1), 100.0), to_light, to_camera, Material())
    np.testing.assert_allclose(found, expected, rtol=0.002)


@pytest.mark.parametrize("azimuth", [-140.0, -33.0, 17.0, 60.0, 133.0])
@pytest.mark.parametrize("elevation", [20.0, 35.0, 70.0])
def test_visibility_on_any_azimuth_matches_the_closed_form(azimuth, elevation):
    """Straight ridges: what is visible depends on ω_x/ω_z alone, however oblique the slices run."""
    design = RidgeDesign(100.0, 20.0)
    surface = sampled(design, 0.25, rows=9, periods=2, pixel_y_um=0.7)
    a, e = np.radians([azimuth, elevation])
    direction = np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
    shares = Horizon(Relief(surface, 100.0)).shares(direction)
    x, z = ridge_polyline(design)
    facet = corrected.visible_shares(x, z, direction[0] / direction[2])[0]
    on_facet = np.diff(surface.height_um[0]) < 0
    assert shares[:, on_facet].mean() == pytest.approx(facet, abs=0.006)


def test_a_step_casts_the_shadow_that_geometry_says():
    height = np.zeros((6, 101))
    height[:, 50:] = 10.0
    direction = np.array([np.sin(0.7), 0.0, np.cos(0.7)])  # light from +x, over the step
    shares = Horizon(Relief(HeightMap(height, 1.0, 1.0))).shares(direction)
    length = 10.0 * np.tan(0.7)
    assert (1.0 - shares[0, :49]).sum() == pytest.approx(length - 1.0, abs=1e-5)  # the step is one pixel wide
    np.testing.assert_array_equal(shares[:, 50:], 1.0)
    assert shares[0, 49] == 0.0


@pytest.mark.parametrize("pitch_um", [None, 100.0])
def test_what_is_known_to_hide_nothing_needs_no_march(pitch_um, monkeypatch):
    """Marching all the same gives shares of one; of the directions of the table, some do cast shadows."""
    relief = Relief(rough_ridges(rows=40), pitch_um)
    looking = np.concatenate(directions(TABLE, Convention()))
    whole = [Horizon(relief).whole(direction) for direction in looking]
    assert 0 < sum(whole) < len(whole)
    monkeypatch.setattr(Horizon, "whole", lambda *_: False)
    horizon = Horizon(relief)
    for direction in looking[whole]:
        if np.any(np.abs(direction[:2]) > 1e-9):  # a march needs an azimuth
            np.testing.assert_array_equal(horizon.shares(direction), 1.0)


@pytest.mark.parametrize("pitch_um", [None, 100.0])
@pytest.mark.parametrize("azimuth", [0.0, 180.0, 90.0, -90.0, 30.0, 120.0, -70.0, 215.0])
def test_a_band_of_rows_has_the_shares_of_the_whole_map(azimuth, pitch_um):
    """Longer than two blocks of the march, whichever end they are counted from; bands with holes, and at both ends."""
    relief = Relief(rough_ridges(rows=560, missing=0.01), pitch_um)
    a = np.radians(azimuth)
    direction = np.array([0.97 * np.cos(a), 0.97 * np.sin(a), np.sqrt(1.0 - 0.97**2)])
    whole = Horizon(relief).shares(direction)
    assert (whole < 1.0).mean() > 0.02
    for first, last in ((0, 130), (130, 131), (131, 420), (420, 559)):
        part = Horizon(relief, band=(first, last)).shares(direction)
        np.testing.assert_allclose(part, whole[first:last], rtol=0.0, atol=2e-6)


@pytest.mark.parametrize("facets", ["symmetric", "diagonal"])
def test_bands_of_rows_add_up_to_the_map(facets):
    relief, material = Relief(rough_ridges(rows=120, missing=0.01), 100.0, facets=facets), Material()
    census = relief.census(material)
    for light, camera in zip(*directions(TABLE, Convention()), strict=True):
        shine = shine_in(light, camera, material)
        nodes = shine_at_nodes(census, shine)
        whole = added(census, shine, Horizon(relief), nodes)
        parts = ((0, 33), (33, 90), (90, 119))
        sums = [added(census.band(*rows), shine, Horizon(relief, band=rows), nodes) for rows in parts]
        assert sum(sums) == pytest.approx(whole, rel=1e-6, abs=1e-9)


def test_a_map_in_bands_has_the_radiance_of_its_halves():
    """Above a million points the bands are taken one by one; the halves are taken whole."""
    surface = rough_ridges(rows=1601, cols=800)
    assert len(bands(surface.shape)) == 1
    assert len(bands((3201, 800))) == 2
    height = np.concatenate([surface.height_um, surface.height_um[-2::-1]])
    to_light, to_camera = directions(pose_grid((0.0, 180.0), (-10.0, 10.0)), Convention())
    found = radiance(Relief(surface.with_height(height), 100.0), to_light, to_camera, Material())
    half = radiance(Relief(surface, 100.0), to_light, to_camera, Material())
    np.testing.assert_allclose(found, half, rtol=1e-3)


def test_a_map_whose_edge_is_missing_can_be_predicted():
    surface = sampled(RidgeDesign(100.0, 10.0), 1.0, rows=20, periods=3)
    height = surface.height_um.copy()
    height[:, [0, -1]] = np.nan
    to_light, to_camera = directions(pose_grid((0, 90, 180)), Convention())
    whole = radiance(Relief(surface, 100.0), to_light, to_camera, Material())
    cut = radiance(Relief(surface.with_height(height), 100.0), to_light, to_camera, Material())
    np.testing.assert_allclose(cut, whole, rtol=0.02)


def test_holes_are_always_marched_over():
    """Beside a hole the height may jump by more than any two neighbours do."""
    horizon = Horizon(Relief(rough_ridges(missing=0.02), 100.0))
    assert not horizon.whole(np.array([-0.2, 0.0, np.sqrt(0.96)]))


@pytest.mark.parametrize("turn", [0, 1, 2, 3])
def test_turning_map_and_directions_together_changes_nothing(turn):
    """Quarter turns of the map are exact, so they check all four ways to march over it."""
    rng = np.random.default_rng(2)
    height = 0.2 * rng.normal(size=(40, 40))  # rough, but without edges: those are looked for across x only
    to_light, to_camera = directions(pose_grid((20.0, 110.0), (25.0,)), Convention(35.0))
    quarter = np.array(
        [[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
    )  # row vectors, a quarter turn of +z
    rotation = np.linalg.matrix_power(quarter, turn)
    # rows count +y, so that a counter-clockwise turn of the sample is a clockwise np.rot90
    turned = np.rot90(height, -turn)
    plain = list(radiance_maps(Relief(HeightMap(height, 1.0, 1.0)), to_light, to_camera, Material(0.2, 0.2)))
    moved = radiance_maps(
        Relief(HeightMap(turned, 1.0, 1.0)), to_light @ rotation, to_camera @ rotation, Material(0.2, 0.2)
    )
    for before, after in zip(plain, moved, strict=True):
        np.testing.assert_allclose(np.rot90(before, -turn), after, rtol=2e-5, atol=1e-6)


@pytest.mark.parametrize("pixel_um", [0.5, 1.0, 2.0])
def test_edges_between_points_leave_no_bias(pixel_um):
    """Wherever crest and foot fall between the points, at walls down to 1.5 pixels wide."""
    to_light, to_camera = directions(pose_grid((0, 90, 180), (-10, 0, 10)), Convention())
    for angle in np.linspace(8.0, 12.0, 17):
        design = RidgeDesign(100.0, angle)
        expected = corrected.radiance(to_light, to_camera, design, Material(0.055, 0.095))
        relief = Relief(sampled(design, pixel_um, periods=10), 100.0)
        found = radiance(relief, to_light, to_camera, Material(0.055, 0.095))
        np.testing.assert_allclose(found, expected, rtol=2e-3)


def test_missing_points_are_left_out_of_the_mean():
    design = RidgeDesign(100.0, 10.0)
    surface = sampled(design, 1.0, rows=60, periods=3)
    to_light, to_camera = directions(pose_grid((0, 90, 180)), Convention())
    whole = radiance(Relief(surface, 100.0), to_light, to_camera, Material())
    height = surface.height_um.copy()
    height[np.random.default_rng(1).random(height.shape) < 0.01] = np.nan
    holed = radiance(Relief(surface.with_height(height), 100.0), to_light, to_camera, Material())
    np.testing.assert_allclose(holed, whole, rtol=0.01)


def test_mean_runs_over_whole_pitches():
    design = RidgeDesign(100.0, 10.0)
    to_light, to_camera = directions(pose_grid((0, 90, 180)), Convention())
    whole = radiance(Relief(sampled(design, 0.5, periods=3), 100.0), to_light, to_camera, Material())
    surface = sampled(design, 0.5, periods=4)
    part = HeightMap(surface.height_um[:, :731], 0.5, 1.0)
    np.testing.assert_allclose(
        radiance(Relief(part, 100.0), to_light, to_camera, Material()), whole, rtol=2e-3
    )


def test_a_map_with_too_many_holes_is_refused():
    height = np.zeros((50, 50))
    height[::2, ::2] = np.nan
    with pytest.raises(HeightMapError, match="missing"):
        Relief(HeightMap(height, 1.0, 1.0))


def test_a_map_narrower_than_a_pitch_is_refused():
    with pytest.raises(HeightMapError, match="less than one pitch"):
        Relief(HeightMap(np.zeros((10, 50)), 1.0, 1.0), 100.0)


def test_rough_map_stays_below_the_white_furnace(hemisphere):
    rng = np.random.default_rng(7)
    surface = HeightMap(0.1 * rng.normal(size=(60, 60)), 1.0, 1.0)
    out, solid_angle = hemisphere(16, 32)
    light = np.broadcast_to([np.sin(0.6), 0.0, np.cos(0.6)], out.shape)
    shown = radiance(Relief(surface), light, out, Material(0.3, 0.3, albedo=1.0))
    assert 0.7 < np.sum(shown * out[:, 2] * solid_angle) / np.cos(0.6) <= 1.0


def rough_ridges(rows=90, cols=301, missing=0.0):
    """Ridges with roughness, and holes."""
    rng = np.random.default_rng(5)
    height = sampled(RidgeDesign(100.0, 12.0), 1.0, rows=rows, periods=(cols - 1) // 100).height_um
    height = height + 0.05 * rng.normal(size=height.shape)
    height[rng.random(height.shape) < missing] = np.nan
    return HeightMap(height, 1.0, 0.8)


@pytest.mark.parametrize("facets", ["symmetric", "diagonal", "antidiagonal"])
@pytest.mark.parametrize(
    ("alpha", "tail", "second_lobe"),
    [
        (0.002, 0.0, None),
        (0.06, 0.0, None),
        (0.3, 0.0, None),
        (0.06, 1.0, None),
        (0.3, 1.6, None),
        (0.06, 0.0, (0.2, 3.0)),
    ],
)
def test_counting_by_slope_equals_facet_by_facet(facets, alpha, tail, second_lobe):
    """Means over the census, of the map and of its cells, against those of the maps, which know nothing of it."""
    relief = Relief(rough_ridges(missing=0.02), 100.0, facets=facets)
    material = Material(alpha, 1.5 * alpha, tail=tail, second_lobe=second_lobe)
    to_light, to_camera = directions(pose_grid((0, 40, 90, 180), (-20, 10)), Convention())
    found = radiance(relief, to_light, to_camera, material)
    also, cells = radiance_of_cells(relief, to_light, to_camera, material, 20.0)
    np.testing.assert_allclose(also, found, rtol=1e-12)
    weights = relief.column_weights()
    for value, cell, shown in zip(
        found, cells, radiance_maps(relief, to_light, to_camera, material), strict=True
    ):
        known = np.isfinite(shown)
        mean = np.nansum(shown, axis=0, dtype=float) @ weights / (known.sum(axis=0) @ weights)
        assert value == pytest.approx(mean, rel=2e-4)
        first = shown[25:50, 280:300]  # rows 0.8 µm apart
        assert cell.shape == (4, 15)
        assert cell[1, 14] == pytest.approx(float(np.nanmean(first, dtype=float)), rel=2e-3, abs=2e-4 * mean)


@pytest.mark.parametrize("second_lobe", [None, (0.3, 2.0)])
@pytest.mark.parametrize("tail", [0.0, 1.0])
def test_a_level_plane_shows_the_lobe(tail, second_lobe):
    """The textbook's formulae: Beckmann, and Trowbridge-Reitz (Heitz 2014) for a tail of 1."""
    material = Material(0.06, 0.1, 0.2, tail=tail, second_lobe=second_lobe)
    plane = Relief(HeightMap(np.zeros((3, 5)), 1.0, 1.0))
    to_light, to_camera = directions(pose_grid((0, 37, 90), (-40, 7)), Convention(30.0))
    along, across, up = np.eye(3)[[1, 0, 2]]
    expected = facet_brdf(to_light, to_camera, along, across, up, material) * to_light[:, 2]
    for value, shown in zip(expected, radiance_maps(plane, to_light, to_camera, material), strict=True):
        np.testing.assert_allclose(shown, value, rtol=1e-4)
    if tail == 1.0 and second_lobe is None:
        wide = np.array([0.1, 0.06])
        for i, o, value in zip(to_light, to_camera, expected, strict=True):
            half = (i + o) / np.linalg.norm(i + o)
            lobe = 1.0 / (np.pi * wide.prod() * (np.sum((half[:2] / wide) ** 2) + half[2] ** 2) ** 2)
            far = [0.5 * (np.sqrt(1.0 + np.sum((wide * d[:2]) ** 2) / d[2] ** 2) - 1.0) for d in (i, o)]
            glossy = fresnel(i @ half, 1.5) * lobe / ((1.0 + sum(far)) * 4.0 * i[2] * o[2])
            base = diffuse_scale(material) * transmittance(i[2], material) * transmittance(o[2], material)
            assert value == pytest.approx((glossy + base) * i[2], rel=1e-9)


def test_diagonals_mirror_each_other():
    """Turning the map over along x exchanges the two ways to cut its cells."""
    surface = rough_ridges()
    mirrored = HeightMap(surface.height_um[:, ::-1], 1.0, 0.8)
    to_light, to_camera = directions(pose_grid((0, 90, 180), (-10, 10)), Convention())
    mirror = np.array([-1.0, 1.0, 1.0])
    one = radiance(Relief(surface, facets="diagonal"), to_light, to_camera, Material())
    other = radiance(
        Relief(mirrored, facets="antidiagonal"), to_light * mirror, to_camera * mirror, Material()
    )
    same = radiance(Relief(surface, facets="antidiagonal"), to_light, to_camera, Material())
    np.testing.assert_allclose(one, other, rtol=1e-4)
    assert np.max(np.abs(one / same - 1.0)) > 1e-3


def test_poses_do_not_disturb_each_other():
    """Shares are kept and overwritten between poses: many at once give what each gives alone."""
    relief = Relief(rough_ridges(), 100.0)
    to_light, to_camera = directions(pose_grid(tuple(np.arange(9) * 40.0), (-20, 0, 15)), Convention())
    together = radiance(relief, to_light, to_camera, Material())
    alone = [radiance(relief, to_light[[p]], to_camera[[p]], Material())[0] for p in range(len(to_light))]
    np.testing.assert_allclose(together, alone, rtol=1e-12)


def test_the_number_of_threads_changes_nothing():
    import numba

    relief = Relief(rough_ridges(rows=700), 100.0)
    to_light, to_camera = directions(pose_grid((0, 30, 90), (0, 20)), Convention())
    before = numba.get_num_threads()
    found = []
    try:
        for count in (1, numba.config.NUMBA_NUM_THREADS):
            numba.set_num_threads(count)
            found.append(radiance(relief, to_light, to_camera, Material()))
    finally:
        numba.set_num_threads(before)
    np.testing.assert_array_equal(found[0], found[1])


def test_facets_of_no_kind_are_refused():
    with pytest.raises(ModelError, match="symmetric, diagonal, antidiagonal"):
        Relief(rough_ridges(), facets="hexagons")


def test_a_direction_at_the_horizon_is_refused():
    light = np.array([[1.0, 0.0, 0.0]])
    with pytest.raises(ModelError, match="horizon"):
        radiance(Relief(rough_ridges(), 100.0), light, np.array([[0.0, 0.0, 1.0]]), Material())


def test_a_wall_at_right_angles_to_the_half_vector_is_no_trouble():
    """Perpendicular walls of 5° ridges lie at exactly 90° from the half vector of light and camera 10° apart."""
    design = RidgeDesign(100.0, 5.0)
    to_light, to_camera = directions(TABLE, Convention())
    found = radiance(Relief(sampled(design, 5.0, periods=10), 100.0), to_light, to_camera, Material())
    assert np.all(np.isfinite(found))
    np.testing.assert_allclose(found, corrected.radiance(to_light, to_camera, design, Material()), rtol=0.06)


@pytest.mark.parametrize("direction", [5.0, 37.0, -52.0])
def test_the_lobe_follows_the_ridges_and_not_the_axes_of_the_map(direction):
    """The same ridges at another direction on the map, light and camera turned with them."""
    design, material, pixel = RidgeDesign(100.0, 10.0), Material(), 0.5
    surface = turned_ridges(design, (701, 701), pixel, direction_deg=direction)
    repeat = 100.0 / np.cos(np.radians(direction))
    relief = Relief(surface, repeat, direction_deg=direction)
    poses = pose_grid((0, 90, 180), (0, -10))
    turned = directions(poses, Convention(facet_azimuth_deg=-direction))
    expected = corrected.radiance(*directions(poses, Convention()), design, material)
    np.testing.assert_allclose(radiance(relief, *turned, material), expected, rtol=0.01)
    shown = [
        float(np.average(found.mean(axis=0), weights=relief.column_weights()))
        for found in radiance_maps(relief, *turned, material)
    ]
    np.testing.assert_allclose(shown, expected, rtol=0.01)
    if direction == 37.0:  # along the axes of the map it would be another light altogether
        axes = radiance(Relief(surface, repeat), *turned, material)
        assert np.max(np.abs(axes / expected - 1.0)) > 0.3
