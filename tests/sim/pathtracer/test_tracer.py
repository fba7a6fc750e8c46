import numpy as np
import pytest

from anisoscope.base.errors import ModelError
from anisoscope.parameters.geometry import Convention
from anisoscope.parameters.material import Material
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.profiles.ideal import add_facet_roughness, ridges
from anisoscope.sim.light import corrected
from anisoscope.sim.light.geometry import directions, pose_grid
from anisoscope.sim.pathtracer.plastic import LOBES, Plastic, brdf
from anisoscope.sim.pathtracer.tracer import EQUAL_ROWS, PathTracer

POSES = pose_grid((0.0, 90.0, 180.0), (0.0, -10.0, 10.0))
TO_LIGHT, TO_CAMERA = directions(POSES, Convention(10.0))
FEET, WALL = 96, 4  # cells of 1 µm: the facet falls over the first, the wall rises over the others
HEIGHT = 17.0


def sharp(rows: int = 3, pitches: int = 1) -> HeightMap:
    """Ridges whose corners are points of the grid, so that the mesh is the ridge."""
    x = np.arange(pitches * (FEET + WALL) + 1) % (FEET + WALL)
    z = np.where(x <= FEET, HEIGHT * (1.0 - x / FEET), HEIGHT * (x - FEET) / WALL)
    return HeightMap(np.broadcast_to(z, (rows, len(z))), 1.0, 2.0, {})


def closed_form(light: np.ndarray, camera: np.ndarray, plastic: Plastic) -> float:
    """Direct light of these ridges: each side by its own normal, less what the crest hides or shades.

    A direction that leans past a crest by q = ω_x/ω_z hides, of the side below it, the part that the line through
    the crest cuts off: from the crest at the right (x = p, height h) it leaves the facet at x where
    h·(1 − x/f) = h − (p − x)/q, and likewise at the left.
    """
    pitch = FEET + WALL

    def seen(direction: np.ndarray) -> tuple[tuple[float, float], tuple[float, float]]:
        """Intervals of x of facet and wall that a direction reaches."""
        lean = direction[0] / direction[2]
        facet, wall = (0.0, float(FEET)), (float(FEET), float(pitch))
        if lean > 0.0 and lean * HEIGHT > WALL:  # the next crest hides the wall and the foot of the facet
            # on the facet: h − h·x/f + (p − x)/lean = h
            facet = (0.0, min(FEET, pitch / lean / (HEIGHT / FEET + 1.0 / lean)))
            wall = (0.0, 0.0)
        elif lean < 0.0 and -lean * HEIGHT > FEET:
            facet = (0.0, 0.0)
        elif lean < 0.0 and -lean * HEIGHT / FEET < 1.0:
            pass  # the crest at the left hides nothing as long as the facet is less steep than the direction
        return facet, wall

    total = 0.0
    for rise, run, (lit, watched) in zip(
        (-HEIGHT, HEIGHT), (FEET, WALL), zip(seen(light), seen(camera), strict=True), strict=True
    ):
        normal = np.array([-rise, 0.0, run]) / np.hypot(rise, run)
        frame = np.stack([np.cross([0.0, 1.0, 0.0], normal), [0.0, 1.0, 0.0], normal])
        i, o = frame @ light, frame @ camera
        if i[2] <= 0.0 or o[2] <= 0.0:
            continue
        width = max(0.0, min(lit[1], watched[1]) - max(lit[0], watched[0]))
        size = np.hypot(rise, run) / run
        total += brdf(i, o, plastic) * i[2] * o[2] * size * width / pitch / camera[2]
    return float(total)


@pytest.mark.parametrize("lobe", LOBES)
def test_a_level_plate_is_its_brdf(lobe):
    plastic = Plastic(0.3, 0.2, 0.4, 1.5, lobe)
    plate = PathTracer(HeightMap(np.zeros((6, 8)), 1.0, 2.0, {}), plastic, paths=64)
    for light, camera in zip(TO_LIGHT, TO_CAMERA, strict=True):
        expected = brdf(light, camera, plastic) * light[2]
        assert plate.direct(light, camera) == pytest.approx(np.full((5, 7), expected), rel=1e-5)
        assert plate.indirect(light, camera).mean == 0.0


@pytest.mark.parametrize("lobe", LOBES)
def test_direct_light_of_sharp_ridges(lobe):
    plastic = Plastic(0.06, 0.1, 0.2, 1.5, lobe)
    tracer = PathTracer(sharp(rows=301), plastic, pitch_um=100.0, reflections=1)
    found = [tracer.radiance(*pose).mean(dtype=float) for pose in zip(TO_LIGHT, TO_CAMERA, strict=True)]
    expected = [closed_form(*pose, plastic) for pose in zip(TO_LIGHT, TO_CAMERA, strict=True)]
    assert found == pytest.approx(expected, rel=2e-3)


def test_shadows_of_low_light():
    """Light 60° aslant: the wall shades half a ridge, the random point of every triangle makes it right in the mean."""
    plastic = Plastic(0.3, 0.3, 0.5)
    tracer = PathTracer(sharp(rows=301), plastic, pitch_um=100.0, reflections=1)
    low = np.array([np.sin(np.radians(60.0)), 0.0, np.cos(np.radians(60.0))])
    up = np.array([0.0, 0.0, 1.0])
    assert tracer.radiance(low, up).mean(dtype=float) == pytest.approx(
        closed_form(low, up, plastic), rel=2e-3
    )


def test_more_ridges_look_like_one_that_repeats():
    plastic = Plastic(0.06, 0.1, 0.2)
    one = PathTracer(sharp(rows=201), plastic, pitch_um=100.0, reflections=1)
    many = PathTracer(sharp(rows=201, pitches=3), plastic, reflections=1)
    light, camera = TO_LIGHT[2], TO_CAMERA[2]
    middle = many.direct(light, camera)[:, 100:200].mean(axis=0, dtype=float)
    assert one.direct(light, camera).mean(axis=0, dtype=float) == pytest.approx(middle, rel=0.05, abs=2e-4)


@pytest.mark.parametrize(("alpha", "albedo"), [(0.08, 0.1), (0.2, 0.9)])
def test_two_reflections_are_the_double_integral(alpha, albedo):
    """Against the quadrature over both sides of a groove by which the prediction finds them: another method."""
    design = RidgeDesign(
        100.0, np.degrees(np.arctan(0.2))
    )  # a facet of slope 1:5, so that the foot is a point
    surface = ridges(design, (3, 26 * 16 + 1), (2.0, 100.0 / (26 * 16)))
    tracer = PathTracer(surface, Plastic(alpha, alpha, albedo), pitch_um=100.0, reflections=2, paths=1 << 18)
    material = Material(alpha, alpha, albedo)
    for number in (1, 2, 5, 7):
        sides = TO_LIGHT[number : number + 1], TO_CAMERA[number : number + 1]
        direct, both = (float(corrected.radiance(*sides, design, material, n)[0]) for n in (1, 2))
        found = tracer.indirect(sides[0][0], sides[1][0])
        # 1 % for the quadrature
        assert found.mean == pytest.approx(
            both - direct, abs=4.0 * found.standard_error + 0.01 * (both - direct)
        )
        assert (
            found.standard_error < 0.02 * found.mean
        )  # 0.06 where a narrow lobe has to catch the lamp by chance


def test_light_and_camera_may_be_exchanged():
    """Paths begin at the camera; those that begin at the lamp carry the same light."""
    surface = add_facet_roughness(sharp(rows=101, pitches=3), 0.05, 0.05, 8.0, np.random.default_rng(3))
    tracer = PathTracer(surface, Plastic(0.15, 0.25, 0.9, 1.5, "student"), pitch_um=100.0, paths=1 << 18)
    light, camera = TO_LIGHT[2], np.array([0.3, 0.3, np.sqrt(0.82)])
    there, back = tracer.indirect(light, camera), tracer.indirect(camera, light)
    error = np.hypot(there.standard_error / light[2], back.standard_error / camera[2])
    assert there.mean / light[2] == pytest.approx(back.mean / camera[2], abs=4.0 * error)
    assert error < 0.03 * there.mean


def test_a_white_surface_sends_back_what_it_gets():
    """White furnace: no interface (index 1) over a white base in deep grooves, the mean over directions."""
    x = np.arange(101) % 50
    grooves = HeightMap(np.broadcast_to(1.5 * np.minimum(x, 50.0 - x), (3, 101)), 1.0, 2.0, {})
    white = Plastic(0.5, 0.5, 1.0, 1.0 + 1e-9)
    tracer = PathTracer(grooves, white, pitch_um=100.0, reflections=60, paths=2048)
    light = np.array([-0.3, 0.2, np.sqrt(0.87)])
    rng = np.random.default_rng(5)
    level, turn = np.sqrt((np.arange(200) + rng.random(200)) / 200), 2.0 * np.pi * rng.random(200)
    cameras = np.stack([level * np.cos(turn), level * np.sin(turn), np.sqrt(1.0 - level**2)], axis=-1)
    # the cameras are drawn in proportion to their cosine: the mean of π·L is what leaves
    direct = np.array([tracer.direct(light, camera).mean(dtype=float) for camera in cameras])
    indirect = np.array([tracer.indirect(light, camera).mean for camera in cameras])
    leaving = np.pi * (direct + indirect) / light[2]
    assert leaving.mean() == pytest.approx(1.0, abs=4.0 * np.std(leaving) / np.sqrt(200) + 0.005)
    assert indirect.mean() > 0.25 * direct.mean()


def test_a_near_lamp_shines_from_another_direction_at_every_place():
    plastic = Plastic(0.1, 0.1, 0.2)
    plate = HeightMap(np.zeros((3, 2001)), 1.0, 2.0, {})
    near = PathTracer(plate, plastic, reflections=1, lamp_distance_um=150e3)
    light, camera = TO_LIGHT[0], TO_CAMERA[0]
    found = near.radiance(light, camera)[0]
    for col in (0, 999, 1999):
        to = 150e3 * light - np.array([col + 0.5 - 1000.0, -1.0, 0.0])
        to /= np.linalg.norm(to)
        assert found[col] == pytest.approx(brdf(to, camera, plastic) * light[2], rel=1e-4)
    assert found[1999] > 1.05 * found[0]


def test_equal_seeds_make_equal_pictures():
    surface = add_facet_roughness(sharp(rows=31), 0.05, 0.05, 8.0, np.random.default_rng(3))
    plastic = Plastic(0.06, 0.1, 0.2, 1.5, "ggx")
    first, again, other = (
        PathTracer(surface, plastic, pitch_um=100.0, paths=1024, seed=seed).radiance(
            TO_LIGHT[1], TO_CAMERA[1]
        )
        for seed in (1, 1, 2)
    )
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)


def test_equal_rows_are_rendered_once_and_repeated():
    """Alike all along, so the mean over rows is the same as where every row is rendered."""
    surface = sharp(rows=200)
    unequal = surface.with_height(surface.height_um + 1e-9 * (np.arange(200)[:, None] == 7))
    once, each = (
        PathTracer(made, Plastic(0.06, 0.1, 0.2), pitch_um=100.0, reflections=1).radiance(
            TO_LIGHT[2], TO_CAMERA[2]
        )
        for made in (surface, unequal)
    )
    assert np.array_equal(once[EQUAL_ROWS : 2 * EQUAL_ROWS], once[:EQUAL_ROWS])
    assert np.array_equal(once[:7], each[:7])
    assert once.shape == each.shape
    assert once.mean(dtype=float) == pytest.approx(each.mean(dtype=float), rel=2e-3)


def test_unknown_heights_stay_unknown():
    height = np.zeros((6, 8))
    height[2, 3] = np.nan
    found = PathTracer(HeightMap(height, 1.0, 1.0, {}), Plastic(0.1, 0.1, 0.2), paths=64).radiance(
        TO_LIGHT[0], TO_CAMERA[0]
    )
    unknown = np.zeros((5, 7), dtype=bool)
    unknown[1:3, 2:4] = True
    assert np.array_equal(np.isnan(found), unknown)


@pytest.mark.parametrize("wrong", [{"reflections": 0}, {"paths": 1}, {"lamp_distance_um": 0.0}])
def test_impossible_settings_are_refused(wrong):
    with pytest.raises(ModelError):
        PathTracer(sharp(), Plastic(0.1, 0.1, 0.2), **wrong)
