"""Dirt stays in its place in the picture while a print turns; what lies on the print, and its form, do not."""

import re

import cv2
import numpy as np
import pytest

from anisoscope.base.errors import CalibrationError
from anisoscope.imaging.linearisation import RadianceImage
from anisoscope.imaging.registration.placement import Placement, View
from anisoscope.kinds.prints.measurement import check_print_dirt
from anisoscope.rig.bayer import channel_of_pixels

SIZE, PIXEL_MM = 320, 0.008
MIDDLE = 0.5 * (SIZE - 1)
POSES = [(angle, tilt) for tilt in (0.0, 10.0, -10.0) for angle in (0.0, 90.0, 180.0)]


def turned(sheet, angle):
    """What lies on the sheet, as the camera sees it."""
    matrix = cv2.getRotationMatrix2D((MIDDLE, MIDDLE), angle, 1.0)
    return cv2.warpAffine(sheet, matrix, (SIZE, SIZE), borderMode=cv2.BORDER_REFLECT)


def pictures(expected, rng, on_sensor=(), on_print=(), bowl=0.0, poses=POSES, grain=0.0):
    """Mosaics of a print; marks are disks (x, y, radius in mm, share of the light that is left)."""
    channel = channel_of_pixels("rggb", (SIZE, SIZE))
    row, column = np.indices((SIZE, SIZE)) - MIDDLE
    seen_x, seen_y = column * PIXEL_MM, -row * PIXEL_MM
    noise, views = np.exp(0.01 * rng.standard_normal((SIZE, SIZE))), []
    coarse = cv2.GaussianBlur(rng.standard_normal((SIZE, SIZE)), (0, 0), 4.0)
    for k, (angle, tilt) in enumerate(poses):
        cos, sin = np.cos(np.radians(angle)), np.sin(np.radians(angle))
        squeeze = np.cos(np.radians(tilt))
        x, y = cos * seen_x + sin * seen_y / squeeze, -sin * seen_x + cos * seen_y / squeeze
        value = (
            expected.channels[k % len(expected.channels)][channel]
            * noise
            * np.exp(grain * turned(coarse / coarse.std(), angle))
        )
        for a, b, radius, left in on_print:
            value[np.hypot(x - a, y - b) < radius] *= left
        for a, b, radius, left in on_sensor:
            value[np.hypot(seen_x - a, seen_y - b) < radius] *= left
        value *= np.exp(bowl * (seen_x**2 + seen_y**2) * (1.0 + 0.4 * tilt))
        matrix = np.array([[cos, -sin], [-squeeze * sin, -squeeze * cos]]) / PIXEL_MM
        place = Placement(
            np.hstack([matrix, [[MIDDLE], [MIDDLE]]]), angle, 1e3 * PIXEL_MM, (MIDDLE, MIDDLE), 0.0, 4
        )
        none = np.zeros((SIZE, SIZE), bool)
        image = RadianceImage(value.astype(np.float32), np.zeros((SIZE, SIZE), np.float32), none, 0.5)
        views.append(View(angle, tilt, image, place))
    return views


@pytest.fixture
def check(good):
    """``check(on_sensor=…)`` looks for dirt in the pictures of a print."""
    recipe, expected = good

    def run(**given):
        views = pictures(expected, np.random.default_rng(2), **given)
        check_print_dirt(views, recipe, "rggb", expected.eye, expected.channels)

    return run


@pytest.mark.parametrize(("left", "radius"), [(0.85, 0.08), (1.2, 0.06), (0.5, 0.04)])
def test_dirt_is_named_with_its_place(check, left, radius):
    """On lens or sensor it dims; in the flat it brightens what is divided by it."""
    with pytest.raises(
        CalibrationError, match=r"stays at .* while the print turns .* take a new flat"
    ) as caught:
        check(on_sensor=[(0.5, 0.3, radius, left)])
    column, row = (int(n) for n in re.findall(r"column (\d+), row (\d+)", str(caught.value))[0])
    assert column == pytest.approx(MIDDLE + 0.5 / PIXEL_MM, abs=3)
    assert row == pytest.approx(MIDDLE - 0.3 / PIXEL_MM, abs=3)


@pytest.mark.parametrize(
    "given",
    [
        {},
        {"on_print": [(0.5, 0.3, 0.1, 0.4), (-0.3, 0.2, 0.05, 0.0), (0.6, -0.6, 0.2, 0.7)]},
        {"on_print": [(0.0, 0.0, 0.4, 0.5)]},
        {"on_print": [(0.1, 0.05, 0.25, 0.5)]},
        {"bowl": 0.3},
        {"bowl": 0.3, "grain": 0.05},
        {"on_sensor": [(0.5, 0.3, 0.08, 0.98)]},
        {"on_sensor": [(0.5, 0.3, 0.08, 0.5)], "poses": [(0.0, 0.0), (10.0, 0.0)]},
    ],
    ids=[
        "good",
        "marks",
        "on the axis",
        "across the axis",
        "bowl",
        "grain",
        "hardly any dirt",
        "hardly turned",
    ],
)
def test_what_belongs_to_the_print_is_no_dirt(check, given):
    check(**given)
