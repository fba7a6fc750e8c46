"""A hundred random scenes of the fixture, painted here without the bench: how far off is the placement at worst?

The plate is a texture of 288 dots a marker, seen through a homography at 4 × 4 points a pixel, blurred, shaded, with
photon and read noise. Its part is bright, dark, or striped, so that its contrast to the plate flips.
"""

import cv2
import numpy as np
import pytest

from anisoscope.base.errors import RegistrationError
from anisoscope.imaging.linearisation import RadianceImage
from anisoscope.imaging.registration.placement import View, angle_between, locate
from anisoscope.imaging.rig_monitor import read_markers
from anisoscope.rig.fixture import Fixture, Marker

SIZE, SUB, PIXEL_UM = 460, 4, 9.0
MARKER_MM, MODULES = 0.52, 6
DOT_MM = MARKER_MM / MODULES / 48
PLACE_MM = 832 * DOT_MM
HALF_DOTS = round(2.2 / DOT_MM)
PLACES = {0: (1, 0), 1: (0, 1), 2: (-1, 0), 3: (0, -1)}
FIXTURE = Fixture(
    marker_mm=MARKER_MM,
    markers=tuple(Marker(id=k, x_mm=PLACE_MM * x, y_mm=PLACE_MM * y) for k, (x, y) in PLACES.items()),
)
PLATE, WHITE, BLACK = 0.02, 0.24, 0.01
PART_MM = 0.6
PARTS = [0, *(pytest.param(part, marks=pytest.mark.soak) for part in (1, 2, 3))]
"""A quarter of the scenes in every run."""


def dot(mm):
    """Index of the dot that begins at a place."""
    return round(mm / DOT_MM) + HALF_DOTS


def plate(part, missing=(), moved=None, covered=None, dirt=()):
    """The plate as a texture, first row at +y; ``moved`` shifts labels by mm, ``covered`` hides half of one."""
    texture = np.full((2 * HALF_DOTS, 2 * HALF_DOTS), PLATE, np.float32)
    a, b = dot(-PART_MM), dot(PART_MM)
    texture[a:b, a:b] = part if np.isscalar(part) else np.tile(part, (b - a, 20))[:, : b - a]
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    for marker in FIXTURE.markers:
        if marker.id in missing:
            continue
        code = cv2.aruco.generateImageMarker(dictionary, marker.id, MODULES, borderBits=1) > 0
        label = np.kron(np.pad(code, 1, constant_values=True), np.ones((48, 48)))
        shift = (moved or {}).get(marker.id, (0.0, 0.0))
        row, col = dot(-marker.y_mm - shift[1]) - 192, dot(marker.x_mm + shift[0]) - 192
        texture[row : row + 384, col : col + 384] = np.where(label > 0, WHITE, BLACK)
        if covered == marker.id:
            texture[row + 40 : row + 130, col : col + 384] = 0.1
    for x, y, r, level in dirt:
        cv2.circle(texture, (dot(x), dot(-y)), round(r / DOT_MM), level, -1)
    return texture


def view(angle_deg, pixel_um, shift_px, tilt_deg=0.0, distance_mm=np.inf):
    """(3, 3) map from sample millimetres to (column, row, 1): turn, then a camera tilted about the horizontal."""
    turn, tilt = np.radians(angle_deg), np.radians(tilt_deg)
    cos, sin = np.cos(turn), np.sin(turn)
    plane = np.array([[cos, -sin, 0], [-sin, -cos, 0], [0, 0, 1]])
    plane[:2, 2] = np.array(shift_px) * pixel_um / 1000
    tilted = np.array([[1, 0, 0], [0, np.cos(tilt), 0], [0, np.sin(tilt) / distance_mm, 1]])
    scale, middle = 1000.0 / pixel_um, (SIZE - 1) / 2
    return np.array([[scale, 0, middle], [0, scale, middle], [0, 0, 1]]) @ tilted @ plane


def photograph(texture, to_pixel, rng, *, blur=0.8, vignetting=0.0, electrons=20000.0, read=8.0):
    """A picture of the plate in 1/sr; ``electrons`` is what a radiance of 0.3 collects."""
    to_mm = np.array(
        [[DOT_MM, 0, (0.5 - HALF_DOTS) * DOT_MM], [0, -DOT_MM, (HALF_DOTS - 0.5) * DOT_MM], [0, 0, 1]]
    )
    fine = np.array([[SUB, 0, (SUB - 1) / 2], [0, SUB, (SUB - 1) / 2], [0, 0, 1.0]])
    # slightly blurred, because points in a lattice would put an upright edge at a multiple of their distance
    points = cv2.warpPerspective(
        cv2.GaussianBlur(texture, (0, 0), 1.0),
        fine @ to_pixel @ to_mm,
        (SIZE * SUB, SIZE * SUB),
        borderValue=PLATE,
    )
    pixels = cv2.resize(points, (SIZE, SIZE), interpolation=cv2.INTER_AREA)
    line = np.linspace(-1, 1, SIZE, dtype=np.float32) ** 2
    clean = cv2.GaussianBlur(pixels, (0, 0), blur) * (1.0 - vignetting * (line[:, None] + line) / 2)
    collected = clean * (electrons / 0.3)
    noisy = collected + np.sqrt(collected + read**2) * rng.standard_normal(clean.shape, dtype=np.float32)
    return (noisy * (0.3 / electrons)).astype(np.float32)


def worst_px(place, to_pixel):
    """Largest error over the part, in pixels."""
    points = np.array([[x, y, 1.0] for x in (-0.6, 0.0, 0.6) for y in (-0.6, 0.0, 0.6)])
    seen, true = points @ place.homography.T, points @ to_pixel.T
    return np.linalg.norm(seen[:, :2] / seen[:, 2:] - true[:, :2] / true[:, 2:], axis=1).max()


def random_scene(rng, tilt_deg=0.0, distance_mm=np.inf):
    """Arguments of `view`, `plate` and `photograph`, everything at random."""
    stripes = rng.uniform(0.005, 0.5, 2).repeat(27)
    part = [rng.uniform(0.3, 2.0), rng.uniform(0.001, 0.01), stripes][rng.integers(3)]
    defect = rng.integers(4)
    dirt = [(*rng.uniform(-1.9, 1.9, 2), rng.uniform(0.005, 0.03), rng.choice([0.01, 0.2])) for _ in range(6)]
    seen = view(
        rng.uniform(0, 360), PIXEL_UM * rng.uniform(0.97, 1.03), rng.uniform(-6, 6, 2), tilt_deg, distance_mm
    )
    look = {
        "blur": rng.uniform(0.5, 1.6),
        "vignetting": rng.uniform(0, 0.4),
        "electrons": rng.uniform(8e3, 3e4),
    }
    marks = {"missing": (int(rng.integers(4)),)} if defect == 0 else {"dirt": dirt} if defect == 1 else {}
    return seen, plate(part, **marks), look


@pytest.mark.parametrize("part", PARTS)
def test_the_placement_is_within_a_twentieth_of_a_pixel(part):
    rng, errors = np.random.default_rng([1, part]), []
    for _ in range(13):
        seen, texture, look = random_scene(rng)
        place = locate(photograph(texture, seen, rng, **look), FIXTURE)
        errors.append(worst_px(place, seen))
    assert max(errors) < 0.05


@pytest.mark.parametrize("part", PARTS)
def test_a_tilted_arm_leaves_it_within_a_seventh(part):
    """Telecentric for half of the scenes, and a lens 60 to 200 mm away for the others."""
    rng, errors = np.random.default_rng([2, part]), []
    for number in range(12):
        tilt = rng.uniform(-20.0, 20.0)
        distance = np.inf if number % 2 else rng.uniform(60.0, 200.0)
        seen, texture, look = random_scene(rng, tilt, distance)
        place = locate(photograph(texture, seen, rng, **look), FIXTURE, tilt)
        errors.append(worst_px(place, seen))
        assert place.squeeze == pytest.approx(1.0, abs=5 * place.u_squeeze + 1e-3)
    assert max(errors) < 0.15


def with_a_moved_marker(rng, moved_px, number, tilt):
    """A picture, its true view, and which marker stands elsewhere."""
    which, turn = (number + round(moved_px)) % 4, rng.uniform(0, 2 * np.pi)
    shift = moved_px * PIXEL_UM / 1000 * np.array([np.cos(turn), np.sin(turn)])
    seen, _, look = random_scene(rng, tilt)
    return photograph(plate(0.1, moved={which: shift}), seen, rng, **look), seen, which


@pytest.mark.parametrize("moved_px", [0.8, 1.5, 6.0, 30.0])
def test_a_marker_that_moved_is_named_and_left_out(moved_px):
    rng = np.random.default_rng([3, round(10 * moved_px)])
    for number in range(2):
        picture, seen, which = with_a_moved_marker(rng, moved_px, number, 0.0)
        place = locate(picture, FIXTURE)
        assert place.dropped == (which,)
        assert place.markers == 3
        assert worst_px(place, seen) < 0.06


@pytest.mark.parametrize("moved_px", [1.5, 6.0, 30.0])
def test_under_tilt_it_may_pass_for_perspective_but_never_moves_the_part(moved_px):
    rng = np.random.default_rng([13, round(10 * moved_px)])
    for number in range(3):
        picture, seen, which = with_a_moved_marker(rng, moved_px, number, 15.0)
        try:
            place = locate(picture, FIXTURE, 15.0)
        except RegistrationError:
            continue  # INVALID, and no wrong number
        assert place.dropped == (which,)
        assert worst_px(place, seen) < 0.15


@pytest.mark.parametrize("moved_px", [0.05, 0.2, 0.35])
def test_a_shift_too_small_to_be_told_does_no_harm(moved_px):
    rng = np.random.default_rng(4)
    seen, _, look = random_scene(rng)
    picture = photograph(plate(0.1, moved={2: (moved_px * PIXEL_UM / 1000, 0.0)}), seen, rng, **look)
    assert worst_px(locate(picture, FIXTURE), seen) < 0.05 + 0.25 * moved_px


@pytest.mark.parametrize("which", range(4))
def test_a_half_hidden_marker_does_not_count(which):
    rng = np.random.default_rng([5, which])
    seen, _, look = random_scene(rng)
    place = locate(photograph(plate(0.1, covered=which), seen, rng, **look), FIXTURE)
    assert place.markers == 3
    assert worst_px(place, seen) < 0.05


def test_among_three_nobody_can_tell_who_lies():
    rng = np.random.default_rng(6)
    seen, _, look = random_scene(rng)
    texture = plate(0.1, missing=(3,), moved={1: (0.02, 0.02)})
    with pytest.raises(RegistrationError, match=r"markers contradict each other .* clean them"):
        locate(photograph(texture, seen, rng, **look), FIXTURE)


def test_two_markers_that_moved_are_too_many():
    rng = np.random.default_rng(7)
    texture = plate(0.1, moved={1: (0.03, 0.0), 2: (0.0, 0.04)})
    seen, _, look = random_scene(rng)
    with pytest.raises(RegistrationError, match="contradict"):
        locate(photograph(texture, seen, rng, **look), FIXTURE)


@pytest.mark.parametrize("tilt", [5.0, -10.0, 20.0])
def test_markers_show_a_tilt_that_is_not_what_the_arm_says(tilt):
    rng = np.random.default_rng(8)
    seen, texture, look = random_scene(rng, tilt)
    place = locate(photograph(texture, seen, rng, **look), FIXTURE)
    assert place.squeeze == pytest.approx(np.cos(np.radians(tilt)), abs=5 * place.u_squeeze)
    assert place.u_squeeze < 0.001


@pytest.mark.parametrize("blur", [0.8, 1.1, 1.6])
def test_edges_say_how_sharp_the_picture_is(blur):
    rng = np.random.default_rng(9)
    picture = photograph(plate(0.1), view(33.0, PIXEL_UM, (2.0, 1.0)), rng, blur=blur)
    assert locate(picture, FIXTURE).blur_px == pytest.approx(np.hypot(blur, np.sqrt(1 / 12)), rel=0.2)


def test_stray_light_shows_in_the_black_of_the_markers():
    rng = np.random.default_rng(10)
    clean = photograph(plate(0.1), view(0.0, PIXEL_UM, (0.0, 0.0)), rng)
    for stray in (0.0, 0.02, 0.06):
        seen = clean + np.float32(stray)
        image = RadianceImage(seen, np.zeros_like(seen), np.zeros(seen.shape, bool), 0.3)
        found = read_markers(View(0.0, 0.0, image, locate(seen, FIXTURE)), FIXTURE)
        assert found.black_share == pytest.approx((BLACK + stray) / (WHITE + stray), abs=0.015)
        np.testing.assert_allclose(found.white, WHITE + stray, rtol=0.03)


@pytest.mark.parametrize("scale", [2, 3])
def test_large_pictures_are_searched_small_and_measured_whole(scale):
    seen = view(20.0, PIXEL_UM, (3.0, -2.0))
    picture = photograph(plate(0.1), seen, np.random.default_rng(11), electrons=1e6)
    large = cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC)
    place = locate(large, FIXTURE)
    centres = np.array([[scale, 0, (scale - 1) / 2], [0, scale, (scale - 1) / 2], [0, 0, 1]])
    assert worst_px(place, centres @ seen) < 0.05 * scale
    assert angle_between(20.0, place.angle_deg) == pytest.approx(0.0, abs=0.02)


@pytest.mark.soak
@pytest.mark.parametrize("seed", range(40))
def test_hundreds_of_scenes(seed):
    rng = np.random.default_rng([12, seed])
    for number in range(10):
        tilt = rng.uniform(-20.0, 20.0) if number % 2 else 0.0
        seen, texture, look = random_scene(rng, tilt, rng.uniform(60.0, 200.0) if number % 4 == 1 else np.inf)
        place = locate(photograph(texture, seen, rng, **look), FIXTURE, tilt)
        assert worst_px(place, seen) < (0.15 if tilt else 0.05)
