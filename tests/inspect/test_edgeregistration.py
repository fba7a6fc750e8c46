"""Turned pictures without markers: what was put in comes back, or it is said that it cannot."""

import cv2
import numpy as np
import pytest

from anisoscope.edgeregistration import Seen, place_by_edges
from anisoscope.errors import RegistrationError

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
            cv2.line(kinds, (x, y), tuple(int(v) for v in to), int(rng.integers(3, 8)), int(rng.integers(8, 20)))
        else:
            cv2.circle(kinds, (x, y), int(rng.integers(15, 60)), int(rng.integers(3, 8)), -1)
    return kinds


def photograph(kinds, rng, angle_deg, axis_px, *, slip=(0.0, 0.0, 0.0), tilt_deg=0.0, noise=0.004, levels=None):
    """Every kind has a grey value of its own in every picture: contrasts flip. ``slip``: mm, mm, degrees."""
    levels = rng.uniform(0.02, 0.4, 8) if levels is None else np.asarray(levels)
    texture = cv2.GaussianBlur(levels[kinds].astype(np.float32), (0, 0), 2.0)
    turn, more = np.radians(angle_deg), np.radians(slip[2])
    motion = np.array([[np.cos(more), -np.sin(more), slip[0]], [np.sin(more), np.cos(more), slip[1]], [0, 0, 1]])
    s, c = 1000 / PIXEL_UM, np.cos(np.radians(tilt_deg))
    cos, sin = np.cos(turn), np.sin(turn)
    to_pixel = np.array([[s * cos, -s * sin, axis_px[0]], [-c * s * sin, -c * s * cos, axis_px[1]], [0, 0, 1]]) @ motion
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


@pytest.mark.parametrize("known_axis", [True, False])
@pytest.mark.parametrize("part_of", range(5))
def test_the_part_is_found_within_a_third_of_a_pixel(part_of, known_axis):
    rng, errors = np.random.default_rng([part_of, known_axis]), []
    for _ in range(5):
        kinds, axis = part(rng, pitch_um=rng.uniform(60, 140)), middle(rng, 3.0 if known_axis else 8.0)
        angles = (0.0, *rng.uniform(20, 340, 2))
        slips = [(0.0, 0.0, 0.0), *((*rng.uniform(-0.012, 0.012, 2), rng.uniform(-0.1, 0.1)) for _ in range(2))]
        shots = [photograph(kinds, rng, a, axis, slip=s) for a, s in zip(angles, slips, strict=True)]
        seen = [Seen(image, angle) for (image, _), angle in zip(shots, angles, strict=True)]
        places = place_by_edges(seen, PIXEL_UM, axis if known_axis else None)
        errors += [
            worst_px(place, places[0], true, shots[0][1]) for place, (_, true) in zip(places[1:], shots[1:], strict=True)
        ]
    print(np.round(sorted(errors), 2))
    assert max(errors) < 0.3
