"""A part measured by a profilometer on the virtual rig: the place of its map in the pictures comes back, or is open."""

import cv2
import numpy as np
import pytest

from anisoscope.imaging.height_map_place import place_rendered, render
from anisoscope.imaging.registration.placement import Grid, Placement, resample
from anisoscope.parameters.geometry import Convention, Pose
from anisoscope.parameters.material import Material
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.profiles.ideal import add_facet_roughness, ridges
from anisoscope.sim.bench.benchfile import OpticsPart, SensorPart
from anisoscope.sim.bench.optics import image_of_surface, pixel_from_mm
from anisoscope.sim.light.geometry import directions
from anisoscope.sim.light.relief import Relief, radiance_maps
from detection_study.traced import UPRIGHT, Part

PITCH_UM, PIXEL_UM = 100.0, 8.0
MATERIAL = Material(0.06, 0.10, 0.2, 1.5)
POSES = (Pose(0.0), Pose(90.0))
OPTICS = OpticsPart(pixel_um=PIXEL_UM, blur_um=5.0)
SENSOR = SensorPart(rows=256, cols=256)


def surface(rough, seed=1):
    """A part of 1.4 mm × 1.4 mm, 4 µm × 2 µm pixels."""
    plain = ridges(RidgeDesign(PITCH_UM, 10.0), (351, 701), (4.0, 2.0))
    if not rough:
        return plain
    return add_facet_roughness(plain, rough, rough, 12.0, np.random.default_rng(seed))


def photographed(part, grid, noise=0.01):
    """Aligned pictures of a part under the camera, as the virtual rig shows it."""
    rng, pictures = np.random.default_rng(5), []
    lights = directions(POSES, Convention(10.0))
    shown = list(radiance_maps(Relief(part, PITCH_UM), *lights, MATERIAL))
    for pose, radiance in zip(POSES, shown, strict=True):
        image, _ = image_of_surface(
            radiance, (part.pixel_y_um, part.pixel_x_um), OPTICS, SENSOR, pose.stage_deg
        )
        image = image * (1.0 + noise * rng.standard_normal(image.shape, dtype=np.float32))
        place = Placement(pixel_from_mm(OPTICS, SENSOR, pose.stage_deg), 0.0, PIXEL_UM, (0.0, 0.0), 0.0, 4)
        pictures.append(resample(image, place, grid))
    return pictures


def patch(part, rows, cols):
    """A part of a map, and (x, y) in µm of its middle from the middle of the whole."""
    cut = HeightMap(part.height_um[rows, cols], part.pixel_x_um, part.pixel_y_um)
    starts = [
        s.start + (s.stop - s.start - 1) / 2 - (n - 1) / 2
        for s, n in zip((rows, cols), part.shape, strict=True)
    ]
    return cut, (starts[1] * part.pixel_x_um, starts[0] * part.pixel_y_um)


def placed(pictures, grid, surface_known):
    """The place of a map in aligned pictures, both on the raster of the pictures."""
    pixel_um = 1000.0 * grid.pixel_mm
    rendered = render(surface_known, POSES, MATERIAL, Convention(10.0), pixel_um, PITCH_UM)
    return place_rendered(pictures, rendered, pixel_um, PITCH_UM)


PATCHES = {
    "whole": (slice(0, 351), slice(0, 701)),
    "corner": (slice(20, 170), slice(30, 300)),
    "middle": (slice(100, 260), slice(210, 470)),
}


@pytest.mark.parametrize("where", PATCHES)
@pytest.mark.parametrize("center", [(0.0, 0.0), (0.0613, -0.0424)])
def test_the_place_of_the_map_comes_back(where, center):
    part = surface(0.05)
    grid = Grid(center, PITCH_UM / 12 / 1000, (96, 96))
    cut, middle = patch(part, *PATCHES[where])
    found = placed(photographed(part, grid), grid, cut)
    assert found.resolved, found.words
    wanted = np.array(middle) - 1000.0 * np.array(center)
    np.testing.assert_allclose([found.x_um, found.y_um], wanted, atol=0.3 * PIXEL_UM)
    off = (found.phase_um - wanted[0] + PITCH_UM / 2) % PITCH_UM - PITCH_UM / 2
    assert abs(off) < 0.3 * PIXEL_UM


@pytest.mark.parametrize("case", ["smooth part", "another part"])
def test_what_looks_alike_everywhere_is_said_to_be_unresolved(case):
    part = surface(0.0 if case == "smooth part" else 0.05)
    grid = Grid((0.0313, 0.0), PITCH_UM / 12 / 1000, (96, 96))
    cut, middle = patch(surface(0.05, seed=9), *PATCHES["middle"])
    found = placed(photographed(part, grid), grid, cut)
    assert not found.resolved
    assert found.words.startswith("unresolved: only means are compared")
    off = (found.phase_um - middle[0] + 31.3 + PITCH_UM / 2) % PITCH_UM - PITCH_UM / 2
    assert (
        abs(off) < 0.5 * PIXEL_UM
    )  # the phase is known all the same; bright poses lead, and their roughness is another


def test_rendered_pictures_show_what_the_camera_sees():
    part = surface(0.05)
    grid = Grid((0.0, 0.0), PIXEL_UM / 1000, (120, 120))
    seen = photographed(part, grid, noise=0.0)
    for drawn, picture in zip(render(part, POSES, MATERIAL, Convention(10.0), PIXEL_UM), seen, strict=True):
        rows, cols = ((a - 120) / 2 for a in drawn.shape)
        shift = np.array([[1.0, 0.0, -cols], [0.0, 1.0, -rows]])
        cut = cv2.GaussianBlur(cv2.warpAffine(drawn, shift, (120, 120)), (0, 0), 0.62)
        assert np.corrcoef(cut.ravel(), picture.ravel())[0, 1] > 0.98


def test_light_between_the_ridges_moves_no_phase():
    """A path tracer shows walls that steep facets light: a first harmonic of the pictures is half a pitch off there."""
    part = Part(200, UPRIGHT, angle=15.0, pitch=96.0, alpha=0.1, size=(800, 480))
    seen = part.measured(pitch_um=96.0, margin=1).aligned
    rendered = render(part.surface, UPRIGHT, Material(0.1, 0.1, 0.1, 1.5), Convention(10.0), 4.0, 96.0)
    found = place_rendered(seen, rendered, 4.0, 96.0)
    moved = 0.5 * 4.0 * (part.pictures[0].shape[1] - seen[0].shape[1]) - 96.0
    off = (found.phase_um - moved + 48.0) % 96.0 - 48.0
    assert abs(off) < 8.0
