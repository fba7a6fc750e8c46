"""The area of spots from pixels: on the virtual rig's pictures, and on mosaics that are made up."""

import re
from dataclasses import replace

import numpy as np
import pytest

from anisoscope.imaging.linearisation import RadianceImage
from anisoscope.imaging.registration.placement import Grid, Placement, View
from anisoscope.inspection.frames import read_frames
from anisoscope.inspection.manifest import reopen
from anisoscope.inspection.pipeline import judge
from anisoscope.kinds.prints.colour_map import spot_shares
from anisoscope.kinds.prints.lighting import expectation_of_print
from anisoscope.kinds.prints.measurement import Mosaics
from anisoscope.rig.bayer import channel_of_pixels


@pytest.mark.parametrize("filters", ["rggb", "gbrg"])
@pytest.mark.parametrize("turn", [0.0, 33.0])
def test_disks_of_a_known_area(good, filters, turn):
    """Disks of several sizes, one across corners of cells, on a mosaic that lies turned under the cells."""
    _, expected = good
    size, pixel_mm, grid = 400, 0.005, Grid((0.0, 0.0), 0.2, (6, 6))
    cos, sin = np.cos(np.radians(turn)) / pixel_mm, np.sin(np.radians(turn)) / pixel_mm
    middle = 0.5 * (size - 1)
    place = Placement(
        np.array([[cos, -sin, middle], [-sin, -cos, middle]]), turn, 1e3 * pixel_mm, (middle, middle), 0.0, 4
    )
    row, column = np.indices((size, size)) - middle
    x, y = (cos * column - sin * row) * pixel_mm**2, (-sin * column - cos * row) * pixel_mm**2
    usual = expected.channels[:1]
    channel = channel_of_pixels(filters, (size, size))
    share = np.ones((size, size))
    disks = [(-0.3, 0.3, 0.15), (0.2, 0.2, 0.06), (0.37, -0.35, 0.22)]
    for a, b, radius in disks:
        share[np.hypot(x - a, y - b) < radius] = 0.4
    value = usual[0][channel] * share * np.exp(0.005 * np.random.default_rng(4).standard_normal((size, size)))
    scatter, none = np.zeros((size, size), np.float32), np.zeros((size, size), bool)
    image = RadianceImage(value.astype(np.float32), scatter, none, 0.5)
    pictures = Mosaics((View(0.0, 0.0, image, place),), filters)
    labels, off = np.zeros((6, 6), np.int32), np.zeros((1, 6, 6))
    for number, (a, b, _) in enumerate(disks, start=1):
        labels[int((0.6 - b) / 0.2), int((a + 0.6) / 0.2)] = number
    found = spot_shares(labels, off, pictures, grid, expected.eye, usual, 3.0)
    for share_found, (_, _, radius) in zip(found, disks, strict=True):
        rim = 2.0 * np.pi * radius * 0.8 * pixel_mm  # fours of pixels that lie on the edge count whole
        assert 0.0 <= share_found * 1.2**2 - np.pi * radius**2 < rim


def test_a_spot_on_the_rig_has_its_area_and_dirt_is_no_spot(print_rig):
    """A spot of 0.4 mm takes 3.14 % of 2 × 2 mm; with a dirty white tile the same frames make no verdict."""
    spot = {"x_mm": 0.33, "y_mm": -0.27, "diameter_mm": 0.4, "missing_share": 0.6}
    done = print_rig.inspect({"spots": [spot]})
    found, true = done.record.details.map, np.pi * 0.2**2 / 4.0
    (spot,) = found.spots
    assert spot.area_share == found.share
    assert spot.area_share == pytest.approx(true, rel=0.15)
    assert spot.cells / (found.rows * found.cols) > 1.25 * spot.area_share
    assert abs(found.share - true) < 3.0 * found.u
    assert done.record.verdict == "FAIL"

    made, job = reopen(done.folder)
    signal = job.white.signal.copy()
    rows, cols = np.indices(signal.shape)
    signal[np.hypot(rows - 280, cols - 174) < 8] *= 0.8
    dirty = replace(job, white=replace(job.white, signal=signal))
    expected = expectation_of_print(job.recipe, job.rig)
    record, *_ = judge(made, dirty, expected, read_frames(done.folder, made))
    assert record.verdict == "INVALID"
    place = re.search(
        r"something stays at column (\d+), row (\d+) of the picture while the print", record.reasons[0]
    )
    assert [int(number) for number in place.groups()] == pytest.approx([174, 280], abs=2)
