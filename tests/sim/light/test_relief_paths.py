import numba
import numpy as np
import pytest

from anisoscope.base.errors import ModelError
from anisoscope.parameters.geometry import Convention
from anisoscope.parameters.material import Material
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.profiles.ideal import add_facet_roughness, ridges
from anisoscope.sim.light import bounces, corrected, relief_blocks
from anisoscope.sim.light.geometry import directions, pose_grid
from anisoscope.sim.light.relief import Relief, radiance
from anisoscope.sim.light.relief_paths import interreflection

POSES = directions(pose_grid((0, 90, 180), (-20, 0)), Convention())
OBLIQUE = (
    np.array([[0.9, 0.1, 0.3], [-0.8, 0.3, 0.3], [0.9, 0.0, 0.2], [-0.9, 0.2, 0.15], [0.1, 0.0, 0.9]]),
    np.array([[-0.2, 0.1, 0.9], [0.8, 0.1, 0.4], [0.8, 0.3, 0.3], [-0.8, -0.2, 0.4], [0.9, 0.2, 0.2]]),
)
OBLIQUE = tuple(vectors / np.linalg.norm(vectors, axis=1, keepdims=True) for vectors in OBLIQUE)
CASES = [
    (10.0, (0.06, 0.10), 0.2),
    (10.0, (0.2, 0.2), 0.05),
    (20.0, (0.1, 0.1), 0.2),
    (20.0, (0.2, 0.2), 0.5),
]


def rms(values):
    return np.sqrt(np.mean(np.square(values)))


def ridged(angle, pixel_um, rows=60):
    """Two ideal ridges of 100 µm, and the first points of the third."""
    return Relief(
        ridges(RidgeDesign(100.0, angle), (rows, round(200 / pixel_um) + 1), (1.0, pixel_um)), 100.0
    )


def rough(rng, shape=(60, 201)):
    surface = ridges(RidgeDesign(50.0, 15.0), shape, 1.0)
    return add_facet_roughness(surface, 0.1, 0.1, 4.0, rng)


@pytest.mark.parametrize(
    ("angle", "alpha", "albedo", "pixel_um"),
    [(*case, 1.0) for case in CASES]
    + [(*CASES[0], 0.2)]
    + [pytest.param(*case, 0.2, marks=pytest.mark.soak) for case in CASES[1:]],
)
def test_ideal_ridges_reflect_as_the_groove_does(angle, alpha, albedo, pixel_um):
    design, material = RidgeDesign(100.0, angle), Material(*alpha, albedo)
    expected = bounces.interreflection(*POSES, design, material)
    total = expected + corrected.radiance(*POSES, design, material)
    found = interreflection(ridged(angle, pixel_um), *POSES, material, paths=32768)
    deviation = found.radiance - expected
    assert np.all(np.abs(deviation) < 5.0 * found.standard_error + 0.02 * expected)
    assert np.all(np.abs(deviation) < 0.01 * total)
    assert np.all(found.standard_error < 0.01 * total)


@pytest.mark.parametrize("lobe", [{"tail": 1.0}, {"tail": 1.6}, {"second_lobe": (0.3, 2.5)}])
def test_lobes_of_any_shape_reflect_as_in_the_groove(lobe):
    design, material = RidgeDesign(100.0, 10.0), Material(0.06, 0.10, 0.2, **lobe)
    expected = bounces.interreflection(*POSES, design, material)
    found = interreflection(ridged(10.0, 0.5), *POSES, material, paths=32768)
    total = expected + corrected.radiance(*POSES, design, material)
    assert np.all(np.abs(found.radiance - expected) < 5.0 * found.standard_error + 0.02 * expected)
    assert np.all(found.standard_error < 0.005 * total)


@pytest.mark.parametrize("shown", [POSES, OBLIQUE])
def test_exactly_two_reflections_are_those_of_the_groove(shown):
    """Oblique light and view leave parts of both sides of the groove in shadow and out of sight."""
    design, material = RidgeDesign(100.0, 20.0), Material(0.15, 0.15, 0.3)
    expected = bounces.interreflection(*shown, design, material, bounces=2)
    found = interreflection(ridged(20.0, 0.5), *shown, material, bounces=2, paths=65536)
    deviation, seen = np.abs(found.radiance - expected), expected > 1e-9
    assert np.all(deviation[seen] < 4.0 * found.standard_error[seen] + 0.01 * expected[seen])
    assert np.all(deviation[~seen] < 1e-8)


def test_white_surface_gives_back_no_more_than_it_receives(hemisphere):
    """A deep white groove keeps much light at the first reflection; all reflections bring most of it back."""
    material = Material(0.25, 0.25, 1.0)
    out, solid_angle = hemisphere(6, 8)
    light = np.broadcast_to([np.sin(0.3), 0.0, np.cos(0.3)], out.shape)
    relief = Relief(ridges(RidgeDesign(40.0, 40.0), (40, 81), 1.0), 40.0)
    once = radiance(relief, light, out, material)
    more = interreflection(relief, light, out, material, paths=512).radiance
    share = [float(np.sum(shown * out[:, 2] * solid_angle) / light[0, 2]) for shown in (once, once + more)]
    flat = Relief(HeightMap(np.zeros((5, 5)), 1.0, 1.0))
    furnace = float(np.sum(radiance(flat, light, out, material) * out[:, 2] * solid_angle) / light[0, 2])
    assert share[0] < 0.75
    assert 0.95 * furnace < share[1] < furnace


def test_a_plane_gives_nothing():
    flat = interreflection(
        Relief(HeightMap(np.full((20, 30), 2.0), 1.0, 1.0)), *POSES, Material(), paths=1024
    )
    np.testing.assert_array_equal(flat.radiance, 0.0)
    ripple = HeightMap(1e-4 * np.random.default_rng(2).normal(size=(40, 40)), 1.0, 1.0)
    almost = interreflection(Relief(ripple), *POSES, Material(), paths=1024)
    assert np.all(almost.radiance < 1e-5 * radiance(Relief(ripple), *POSES, Material()))


def test_every_reflection_adds_light():
    relief = Relief(rough(np.random.default_rng(3)), 50.0)
    material = Material(0.1, 0.1, 0.9)
    counts = (1, 2, 3, 5, 8, None)
    found = np.array(
        [interreflection(relief, *POSES, material, count, paths=4096).radiance for count in counts]
    )
    np.testing.assert_array_equal(found[0], 0.0)
    assert np.all(np.diff(found[:3], axis=0) > 0.0)
    assert np.all(np.diff(found, axis=0) >= -1e-15)
    assert np.all(found[-1] - found[-2] < 0.05 * found[-1])


def test_light_and_camera_may_change_places():
    relief = Relief(rough(np.random.default_rng(4)), 50.0)
    to_light, to_camera = POSES
    there = interreflection(relief, to_light, to_camera, Material(0.2, 0.2), paths=32768)
    back = interreflection(relief, to_camera, to_light, Material(0.2, 0.2), paths=32768)
    first, second = there.radiance * to_camera[:, 2], back.radiance * to_light[:, 2]
    error = np.hypot(there.standard_error * to_camera[:, 2], back.standard_error * to_light[:, 2])
    assert np.all(
        np.abs(first - second) < 5.0 * error + 0.01 * first
    )  # edges: what lies beyond reflects, unseen


def test_a_long_map_without_a_pitch_is_as_one_that_repeats():
    surface = ridges(RidgeDesign(50.0, 20.0), (60, 1001), 1.0)
    material = Material(0.2, 0.2, 0.5)
    wrapped = interreflection(Relief(surface, 50.0), *POSES, material, paths=32768)
    finite = interreflection(Relief(surface), *POSES, material, paths=32768)
    np.testing.assert_allclose(finite.radiance, wrapped.radiance, rtol=0.06)


@pytest.mark.parametrize("facets", ["diagonal", "antidiagonal"])
def test_triangles_are_nearly_the_facets(facets):
    surface = rough(np.random.default_rng(5))
    material = Material(0.2, 0.2, 0.5)
    whole = interreflection(Relief(surface), *POSES, material, paths=16384)
    split = interreflection(Relief(surface, facets=facets), *POSES, material, paths=16384)
    once = radiance(Relief(surface), *POSES, material)
    assert np.all(np.abs(split.radiance - whole.radiance) < 0.02 * once)


def test_numbers_do_not_depend_on_the_number_of_threads():
    relief = Relief(rough(np.random.default_rng(6)), 50.0)
    before, found = numba.get_num_threads(), []
    for count in (1, min(2, numba.config.NUMBA_NUM_THREADS)):
        numba.set_num_threads(count)
        found.append(interreflection(relief, *POSES, Material(), paths=4096))
    numba.set_num_threads(before)
    np.testing.assert_array_equal(found[0].radiance, found[1].radiance)
    np.testing.assert_array_equal(found[0].standard_error, found[1].standard_error)


def test_poses_traced_together_are_those_traced_alone():
    relief = Relief(rough(np.random.default_rng(7)), 50.0)
    together = interreflection(relief, *POSES, Material(), paths=4096)
    for pose in (0, 4):
        alone = interreflection(relief, POSES[0][[pose]], POSES[1][[pose]], Material(), paths=4096)
        np.testing.assert_allclose(alone.radiance, together.radiance[[pose]], rtol=1e-12)


def test_standard_error_says_how_far_the_mean_may_be_off():
    relief, material = Relief(rough(np.random.default_rng(8)), 50.0), Material(0.2, 0.2, 0.5)
    true = interreflection(relief, *POSES, material, paths=1 << 17)
    few = interreflection(relief, *POSES, material, paths=2048)
    off = np.abs(few.radiance - true.radiance) / np.hypot(few.standard_error, true.standard_error)
    assert np.all(off < 6.0)
    assert rms(off) < 2.5
    assert rms(true.standard_error / few.standard_error) < 0.4


def test_missing_points_are_left_out():
    surface, material = ridges(RidgeDesign(50.0, 15.0), (300, 201), 1.0), Material(0.2, 0.2, 0.5)
    height = surface.height_um.copy()
    height[100:150] = np.nan
    height[np.random.default_rng(1).random(height.shape) < 0.005] = np.nan
    whole = interreflection(Relief(surface, 50.0), *POSES, material, paths=16384)
    holed = interreflection(Relief(surface.with_height(height), 50.0), *POSES, material, paths=16384)
    error = np.hypot(holed.standard_error, whole.standard_error)
    assert np.all(np.isfinite(holed.radiance))
    assert np.all(np.abs(holed.radiance - whole.radiance) < 0.03 * whole.radiance + 2.0 * error)


@pytest.mark.parametrize("facets", ["symmetric", "diagonal"])
@pytest.mark.parametrize("pitch_um", [None, 50.0])
def test_rays_leap_over_nothing_that_they_would_meet(facets, pitch_um, monkeypatch):
    """The same paths with ceilings so high that no block is leapt over; odd sizes leave blocks cut off."""
    surface = rough(np.random.default_rng(9), (61, 203))
    height = surface.height_um.copy()
    height[np.random.default_rng(1).random(height.shape) < 0.01] = np.nan
    relief = Relief(surface.with_height(height), pitch_um, facets=facets)
    leaping = interreflection(relief, *OBLIQUE, Material(0.2, 0.2, 0.8), paths=8192)
    monkeypatch.setattr(relief_blocks, "ceilings", lambda z, *_: np.full(z.shape, np.inf, dtype=np.float32))
    walking = interreflection(relief, *OBLIQUE, Material(0.2, 0.2, 0.8), paths=8192)
    np.testing.assert_allclose(leaping.radiance, walking.radiance, rtol=1e-6)


def test_progress_goes_to_the_end():
    told = []
    relief = Relief(rough(np.random.default_rng(1)), 50.0)
    interreflection(relief, *POSES, Material(), paths=64, progress=lambda *news: told.append(news))
    done = [news[1] for news in told]
    assert done == list(range(1, told[-1][2] + 1))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"bounces": 0}, "at least once"),
        ({"paths": 0}, "at least one path"),
    ],
)
def test_impossible_wishes_are_refused(arguments, message):
    with pytest.raises(ModelError, match=message):
        interreflection(Relief(rough(np.random.default_rng(1))), *POSES, Material(), **arguments)


@pytest.mark.parametrize("which", [0, 1])
def test_directions_at_the_horizon_are_refused(which):
    low = [POSES[0].copy(), POSES[1].copy()]
    low[which][2] = [1.0, 0.0, 0.0]
    with pytest.raises(ModelError, match="horizon"):
        interreflection(Relief(rough(np.random.default_rng(1))), *low, Material())
