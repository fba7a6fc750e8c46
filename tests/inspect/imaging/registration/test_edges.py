"""Turned pictures without markers: what was put in comes back, or it is said that it cannot."""

import cv2
import numpy as np
import pytest

from anisoscope.base.errors import RegistrationError
from anisoscope.imaging.registration.edges import TurnedPicture, place_by_edges

SIZE, PIXEL_UM, SUB = 320, 8.0, 3
DOT_UM = 2.0
DOTS = 1401
ANGLES = (0.0, 90.0, 180.0)
PART_MM = 0.85


def part(rng, *, pitch_um=100.0, ridges=True, features=14):
    """Regions of a part as numbers: background, the part, its ridges, scratches and spots."""
    kinds = np.zeros((DOTS, DOTS), np.uint8)
    middle, half = DOTS // 2, round(PART_MM * 1000 / DOT_UM)
    box = slice(middle - half, middle + half)
    kinds[box, box] = 1
    if ridges:
        phase = np.arange(DOTS) * DOT_UM / pitch_um % 1.0
        kinds[box, box] = np.where(phase < 0.35, 2, 1)[None, box]
    for number in range(features):
        at = rng.uniform(-PART_MM, PART_MM, 2) * 1000 / DOT_UM + middle
        x, y = (round(value) for value in at)
        if number % 2:
            to = at + rng.uniform(-200, 200, 2)
            cv2.line(
                kinds, (x, y), tuple(int(v) for v in to), int(rng.integers(3, 8)), int(rng.integers(8, 20))
            )
        else:
            cv2.circle(kinds, (x, y), int(rng.integers(15, 60)), int(rng.integers(3, 8)), -1)
    return kinds


def photograph(
    kinds, rng, angle_deg, axis_px, *, slip=(0.0, 0.0, 0.0), tilt_deg=0.0, noise=0.004, levels=None
):
    """Every kind has a grey value of its own in every picture: contrasts flip. ``slip``: mm, mm, degrees."""
    levels = rng.permutation(np.linspace(0.03, 0.4, 8)) if levels is None else np.asarray(levels)
    texture = cv2.GaussianBlur(levels[kinds].astype(np.float32), (0, 0), 2.0)
    turn, more = np.radians(angle_deg), np.radians(slip[2])
    motion = np.array(
        [[np.cos(more), -np.sin(more), slip[0]], [np.sin(more), np.cos(more), slip[1]], [0, 0, 1]]
    )
    s, c = 1000 / PIXEL_UM, np.cos(np.radians(tilt_deg))
    cos, sin = np.cos(turn), np.sin(turn)
    to_pixel = (
        np.array([[s * cos, -s * sin, axis_px[0]], [-c * s * sin, -c * s * cos, axis_px[1]], [0, 0, 1]])
        @ motion
    )
    mm, mid = DOT_UM / 1000, (DOTS - 1) / 2
    to_mm = np.array([[mm, 0, -mid * mm], [0, -mm, mid * mm], [0, 0, 1]])
    fine = np.array([[SUB, 0, (SUB - 1) / 2], [0, SUB, (SUB - 1) / 2], [0, 0, 1]])
    size = (SIZE * SUB, SIZE * SUB)
    points = cv2.warpPerspective(texture, fine @ to_pixel @ to_mm, size, borderValue=float(levels[0]))
    clean = cv2.GaussianBlur(cv2.resize(points, (SIZE, SIZE), interpolation=cv2.INTER_AREA), (0, 0), 0.7)
    return (clean + noise * rng.standard_normal(clean.shape)).astype(np.float32), to_pixel


def worst_px(place, first, true, true_first):
    """Largest difference over the part between where a point of the first picture is and is said to be."""
    points = np.array([[x, y, 1.0] for x in (-0.7, 0.0, 0.7) for y in (-0.7, 0.0, 0.7)])
    on_first = points @ first.homography.T
    sample = on_first @ np.linalg.inv(true_first).T
    wanted = sample @ true.T
    found = points @ place.homography.T
    return np.linalg.norm((found - wanted)[:, :2], axis=1).max()


def middle(rng, spread=3.0):
    return tuple((SIZE - 1) / 2 + rng.uniform(-spread, spread, 2))


def random_shots(rng, known_axis):
    """Three pictures of a part at random angles that slipped a little, their true views, and the axis."""
    kinds, axis = part(rng, pitch_um=rng.uniform(60, 140)), middle(rng, 3.0 if known_axis else 8.0)
    angles = (0.0, *rng.uniform(20, 340, 2))
    slips = [(0.0, 0.0, 0.0), *((*rng.uniform(-0.012, 0.012, 2), rng.uniform(-0.1, 0.1)) for _ in range(2))]
    shots = [photograph(kinds, rng, a, axis, slip=s) for a, s in zip(angles, slips, strict=True)]
    seen = [TurnedPicture(image, angle) for (image, _), angle in zip(shots, angles, strict=True)]
    return seen, [true for _, true in shots], axis


def check_scenes(seed, known_axis, count, most_refused=0.25):
    """Whatever is placed is placed right, and most of it is placed."""
    rng, errors, refused = np.random.default_rng(seed), [], 0
    for _ in range(count):
        seen, true, axis = random_shots(rng, known_axis)
        try:
            places = place_by_edges(seen, PIXEL_UM, axis if known_axis else None)
        except RegistrationError:
            refused += 1
            continue
        errors += [
            worst_px(place, places[0], own, true[0]) for place, own in zip(places[1:], true[1:], strict=True)
        ]
    assert max(errors) < 0.3
    assert refused <= most_refused * count


@pytest.mark.parametrize("known_axis", [True, False])
def test_the_part_is_found_within_a_third_of_a_pixel(known_axis):
    check_scenes([1, known_axis], known_axis, 2)


@pytest.mark.soak
@pytest.mark.parametrize("known_axis", [True, False])
@pytest.mark.parametrize("part_of", range(10))
def test_a_hundred_scenes_more(part_of, known_axis):
    # of all hundred 17 are refused with an axis and 9 without; of ten there may be 4 by chance
    check_scenes([2, part_of, known_axis], known_axis, 10, 0.5)


def stripes(rng, pitch_um):
    """Ridges all over the picture and nothing else."""
    return np.tile((np.arange(DOTS) * DOT_UM / pitch_um % 1.0 < 0.4).astype(np.uint8), (DOTS, 1))


def disc(rng):
    """A round part with marks of its own."""
    kinds = part(rng, ridges=False)
    row, col = np.indices(kinds.shape) - DOTS // 2
    return np.where(np.hypot(row, col) * DOT_UM < 550, kinds, 0).astype(np.uint8)


HOPELESS = {
    "no structure": (lambda rng: np.zeros((DOTS, DOTS), np.uint8), None, {}),
    "only ridges": (lambda rng: stripes(rng, 100.0), None, {}),
    "wide ridges": (lambda rng: stripes(rng, 320.0), None, {}),
    "other part": (part, disc, {}),
    "slipped": (part, None, {"slip": (0.12, 0.05, 0.0)}),
    "turned": (part, None, {"slip": (0.0, 0.0, 1.5)}),
    "half outside": (part, None, {"slip": (1.2, 0.3, 0.0)}),
    "lamp off": (part, None, {"levels": np.zeros(8)}),
}


@pytest.mark.parametrize("scene", HOPELESS)
@pytest.mark.parametrize("known_axis", [True, False])
def test_what_cannot_be_aligned_is_refused(scene, known_axis):
    make, other, changes = HOPELESS[scene]
    if scene in {"slipped", "half outside"} and not known_axis:
        changes = {"slip": (changes["slip"][0] + 0.6, 0.4, 0.0)}  # without an axis small slips pass for one
    for seed in range(2):
        rng = np.random.default_rng([3, seed])
        axis, kinds = middle(rng, 1.0), make(rng)
        first, _ = photograph(kinds, rng, 0.0, axis)
        turned, _ = photograph(other(rng) if other else kinds, rng, 90.0, axis, **changes)
        with pytest.raises(RegistrationError, match=r"^at 90° .*(fixture|slip)") as caught:
            place_by_edges(
                [TurnedPicture(first, 0.0), TurnedPicture(turned, 90.0)],
                PIXEL_UM,
                axis if known_axis else None,
            )
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize("tilt", [10.0, -20.0])
def test_a_tilted_arm_is_taken_into_account(tilt):
    rng = np.random.default_rng(6)
    axis, kinds = middle(rng), part(rng)
    shots = [photograph(kinds, rng, angle, axis, tilt_deg=tilt) for angle in ANGLES]
    places = place_by_edges(
        [TurnedPicture(image, angle, tilt) for (image, _), angle in zip(shots, ANGLES, strict=True)],
        PIXEL_UM,
        axis,
    )
    for place, (_, true) in zip(places[1:], shots[1:], strict=True):
        assert worst_px(place, places[0], true, shots[0][1]) < 0.3


def test_an_axis_that_nobody_calibrated_is_found():
    rng = np.random.default_rng(7)
    axis, kinds = ((SIZE - 1) / 2 + 6.5, (SIZE - 1) / 2 - 5.0), part(rng)
    seen = [TurnedPicture(photograph(kinds, rng, angle, axis)[0], angle) for angle in ANGLES]
    for place in place_by_edges(seen, PIXEL_UM):
        np.testing.assert_allclose(place.axis_px, axis, atol=0.3)
