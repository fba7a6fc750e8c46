"""The rig read from the greys of the fixture: level, stray light, linearity; pictures of another program's print."""

from collections.abc import Callable
from dataclasses import replace

import cv2
import numpy as np
import pytest

from anisoscope.imaging.linearisation import RadianceImage
from anisoscope.imaging.registration.lens import Lens
from anisoscope.imaging.registration.placement import View, locate
from anisoscope.imaging.rig_monitor import (
    FixtureReference,
    MarkerReading,
    RigMonitor,
    corrected,
    read_markers,
    teach,
    watch,
)
from anisoscope.recipe.base import LimitsPart
from anisoscope.rig.fixture import Fixture, Marker
from anisoscope.sim.bench.benchfile import OpticsPart, SensorPart
from anisoscope.sim.bench.optics import image_of_fixture, pixel_from_mm

LIMITS = LimitsPart()
SENSOR, OPTICS = SensorPart(rows=400, cols=400), OpticsPart(pixel_um=10.0, blur_um=8.0)
FIXTURE = Fixture.model_validate(
    {
        "marker_mm": 0.52,
        "markers": [
            {"id": 0, "x_mm": 1.56, "y_mm": 0.0},
            {"id": 1, "x_mm": 0.0, "y_mm": 1.56},
            {"id": 2, "x_mm": -1.56, "y_mm": 0.0},
            {"id": 3, "x_mm": 0.0, "y_mm": -1.56},
        ],
        "greys": [{"x_mm": 1.5, "y_mm": 0.75, "size_mm": 0.3}, {"x_mm": -1.5, "y_mm": 0.75, "size_mm": 0.3}],
    }
)
POSES = (0.0, 90.0, 180.0)
Image = np.ndarray
Fault = Callable[[Image, float], Image]


def picture(stage_deg: float, fault: Fault = lambda image, _: image, seed: int = 1) -> View:
    """A picture of the fixture in 1/sr, with shot noise of 9,000 electrons at white."""
    radiance = fault(image_of_fixture(FIXTURE, OPTICS, SENSOR, stage_deg) / np.pi, stage_deg)
    rng = np.random.default_rng([seed, int(stage_deg)])
    per_radiance = 9000.0 / (0.75 / np.pi)
    noisy = (rng.poisson(np.maximum(radiance, 0.0) * per_radiance) / per_radiance).astype(np.float32)
    image = RadianceImage(noisy, np.zeros_like(noisy), np.zeros(noisy.shape, dtype=bool), 0.3)
    return View(stage_deg, 0.0, image, locate(np.minimum(noisy, 0.5), FIXTURE))  # as of a long exposure


@pytest.fixture(scope="module")
def reference() -> FixtureReference:
    """Reference of the sound rig."""
    found, scatter = teach(
        [read_markers(picture(angle, seed=5), FIXTURE) for angle in range(0, 360, 45)], "ref"
    )
    assert scatter < 0.001
    return found


def test_the_greys_are_read_where_a_lens_shows_them() -> None:
    plain = picture(30.0)
    lens = Lens((400, 400), 0.12)
    rows, cols = np.indices((400, 400)).astype(np.float32)
    column, row = np.moveaxis(lens.straight(np.stack([cols, rows], axis=-1)), -1, 0).astype(np.float32)
    bent = cv2.remap(plain.image.value, column, row, cv2.INTER_LINEAR)
    view = replace(plain, image=replace(plain.image, value=bent), placement=locate(bent, FIXTURE, lens=lens))
    found, wanted = read_markers(view, FIXTURE), read_markers(plain, FIXTURE)
    np.testing.assert_allclose(found.white, wanted.white, rtol=0.01)
    np.testing.assert_allclose(found.black, wanted.black, rtol=0.25)


def watched(fault: Fault, reference: FixtureReference | None, limits: LimitsPart = LIMITS) -> RigMonitor:
    """Monitor of three poses and the return to the first."""
    return watch([picture(a, fault) for a in POSES], [picture(0.0, fault, 2)], FIXTURE, limits, reference)


def test_a_sound_rig_is_at_the_level_of_its_reference(reference: FixtureReference) -> None:
    found = watched(lambda image, _: image, reference)
    assert found.fault is None
    assert found.notes == ()
    assert found.light_watched
    for pose in found.poses:
        assert abs(pose.level - 1.0) < 4.0 * pose.u_level + 2e-4
        assert abs(pose.stray) < 3.0 * pose.u_stray + 1e-4
        assert pose.white == pytest.approx(0.75 / np.pi, rel=0.01)
        # the blur of the lens takes part in black as in the reference
        assert pose.black_share == pytest.approx(0.04, abs=0.02)


@pytest.mark.parametrize(
    ("fault", "says"),
    [
        (lambda image, _: image + 0.05 * 0.75 / np.pi, "stray light"),
        (lambda image, _: image - 0.03 * 0.75 / np.pi, "the dark frames hold light"),
        (lambda image, angle: image * (0.75 if angle == 0.0 else 1.0), "lamp, exposure or gain changed"),
        (lambda image, angle: image * (1.0 - angle / 900.0), "lamp, exposure or gain changed"),
        (lambda image, _: 0.5 * image, "at 50% of the reference"),
        (lambda image, _: 2.0 * image, "at 200% of the reference"),
        # level and black are restored by a scale, as an operator would turn the lamp up
        (lambda image, _: 0.75 / np.pi * (image / (0.75 / np.pi)) ** 0.9, "not linear"),
        (lambda image, _: image * (1.16 - 0.16 * image / (0.75 / np.pi)), "not linear"),
        (lambda image, _: image * np.linspace(0.9, 1.1, 400)[None, :].astype(np.float32), "uneven"),
    ],
    ids=[
        "glare",
        "black-level",
        "dim-pose",
        "lamp-falls",
        "half",
        "twice",
        "gamma",
        "saturating",
        "gradient",
    ],
)
def test_a_fault_of_the_light_is_named(fault: Fault, says: str, reference: FixtureReference) -> None:
    assert says in (watched(fault, reference).fault or "")


@pytest.mark.parametrize("share", [-0.004, 0.004, 0.008, 0.016])
def test_small_stray_light_is_measured_and_taken_off(share: float, reference: FixtureReference) -> None:
    white = 0.75 / np.pi
    views = [picture(angle, lambda image, _: image + share * white) for angle in POSES]
    found = watch(views, [], FIXTURE, LIMITS, reference)
    assert found.fault is None
    for view, state in zip(views, found.poses, strict=True):
        assert state.stray == pytest.approx(share * white, abs=2.0 * state.u_stray + 2e-4 * white)
        clean = corrected(view, state).image.value
        plate = image_of_fixture(FIXTURE, OPTICS, SENSOR, view.stage_deg)[180:220, 180:220].mean() / np.pi
        assert clean[180:220, 180:220].mean() == pytest.approx(plate, abs=2.0 * state.u_stray + 2e-4 * white)


@pytest.mark.parametrize("taught", [True, False])
def test_glare_of_a_part_that_shines_is_measured_against_its_own_light(
    taught: bool, reference: FixtureReference
) -> None:
    """A spike in the middle makes the picture ten times as bright as the labels; 0.5 % of its light lies everywhere."""

    def shines(image: Image, angle: float) -> Image:
        if angle == 90.0:
            image = image.copy()
            image[120:280, 120:280] += 0.75 / np.pi * 10.0 * image.size / 160.0**2
            image += 0.005 * image.mean()
        return image

    found = watched(shines, reference if taught else None)
    assert found.fault is None
    if taught:
        assert found.poses[1].stray == pytest.approx(0.005 * 10.0 * 0.75 / np.pi, rel=0.1)
    even = watched(lambda image, angle: image + 0.12 * (angle == 90.0), reference if taught else None)
    assert even.fault is not None


def test_a_lamp_that_drifts_is_taken_out(reference: FixtureReference) -> None:
    dimmed = {0.0: 1.0, 90.0: 0.995, 180.0: 0.991}
    views = [picture(angle, lambda image, stage: image * dimmed[stage]) for angle in POSES]
    found = watch(views, [], FIXTURE, LIMITS, reference)
    assert found.fault is None
    for view, state in zip(views, found.poses, strict=True):
        assert state.level == pytest.approx(dimmed[view.stage_deg], abs=1e-3)
        assert corrected(view, state).u_level == state.u_level > 0.0


def test_an_old_lamp_is_a_note(reference: FixtureReference) -> None:
    found = watched(lambda image, _: 0.94 * image, reference)
    assert found.fault is None
    assert found.notes == (
        "the markers are 6.0% darker than at the reference ref: has the lamp aged, or its level changed?",
    )


def test_a_dirty_marker_is_named_and_its_neighbours_serve(reference: FixtureReference) -> None:
    def dirty(image: Image, stage_deg: float) -> Image:
        column, row = (int(v) for v in (pixel_from_mm(OPTICS, SENSOR, stage_deg) @ [1.56, 0.0, 1.0])[:2])
        image = image.copy()
        image[max(0, row - 42) : row + 43, max(0, column - 42) : column + 43] *= 0.8
        return image

    found = watched(dirty, reference)
    assert found.fault is None
    assert found.dirty == (0,)
    assert found.notes == ("marker 0 is dirty or in shadow: its neighbours serve",)


def test_without_a_reference_poses_are_compared_and_the_rest_is_named() -> None:
    found = watched(lambda image, _: image, None)
    assert found.fault is None
    assert not found.light_watched
    assert [pose.stray for pose in found.poses] == [None] * 4
    assert "no reference of its fixture" in found.not_watched[0]
    dim = watched(lambda image, angle: image * (0.9 if angle == 90.0 else 1.0), None).fault
    assert "at 90° the white of the markers is 10.0% darker" in (dim or "")
    grey = watched(lambda image, _: image + 0.08 * 0.75 / np.pi, None).fault
    assert "limits.black_share" in (grey or "")
    # a print of grey black is the user's own choice
    wide = LimitsPart(black_share=0.2)
    assert watched(lambda image, _: image + 0.08 * 0.75 / np.pi, None, wide).fault is None


def test_a_tilt_that_was_not_taught_is_named(reference: FixtureReference) -> None:
    views = [picture(angle) for angle in POSES]
    tilted = [View(one.stage_deg, 20.0, one.image, one.placement) for one in views]
    found = watch([*views, *tilted], [], FIXTURE, LIMITS, reference)
    assert "does not hold tilt 20°" in found.not_watched[0]
    assert len(found.poses) == 6


def test_a_picture_whose_white_has_no_value_is_not_watched(reference: FixtureReference) -> None:
    burnt = picture(90.0)
    white = burnt.image.value > 0.5 * 0.75 / np.pi
    value = np.where(white, np.float32(np.nan), burnt.image.value)
    views = [picture(0.0), replace(burnt, image=replace(burnt.image, value=value))]
    found = watch(views, [], FIXTURE, LIMITS, reference)
    assert found.poses == ()
    assert found.fault is None
    assert "no white of a marker can be read at 90°" in found.not_watched[0]


def test_without_markers_nothing_is_watched() -> None:
    found = watch([picture(0.0)], [], None, LIMITS, None)
    assert found.poses == ()
    assert "no markers are seen" in found.not_watched[0]


def test_a_reference_survives_its_file(reference: FixtureReference) -> None:
    again = FixtureReference.from_details("ref", reference.as_details())
    assert again.as_details() == reference.as_details()


def test_a_print_whose_white_turns_with_the_stage_is_learnt() -> None:
    def paper(image: Image, stage_deg: float) -> Image:
        return image * (1.0 + 0.02 * np.cos(2.0 * np.radians(stage_deg)))

    readings: list[MarkerReading] = [read_markers(picture(a, paper), FIXTURE) for a in range(0, 360, 45)]
    taught, scatter = teach(readings, "paper")
    assert scatter < 0.001
    assert watched(paper, taught).fault is None
    assert "lamp, exposure or gain" in (watched(lambda image, _: image, taught).fault or "")


def test_the_pose_that_is_off_the_reference_is_the_wrong_one(reference: FixtureReference) -> None:
    found = watched(lambda image, angle: image * (0.75 if angle == 0.0 else 1.0), reference).fault
    assert "at 0° at the end the white of the markers is 25." in (found or "")
    assert "darker" in (found or "")


def test_blur_is_called_blur_and_not_stray_light(reference: FixtureReference) -> None:
    found = watched(lambda image, _: cv2.GaussianBlur(image.astype(np.float32), (0, 0), 1.7), reference)
    assert "the picture is out of focus" in (found.fault or "")


def test_a_marker_outside_the_picture_is_no_fault(reference: FixtureReference) -> None:
    views = [picture(angle) for angle in POSES]
    wider = FIXTURE.model_copy(update={"markers": (*FIXTURE.markers, Marker(id=9, x_mm=9.0, y_mm=9.0))})
    assert watch(views, [], wider, LIMITS, None).fault is None
    assert np.isnan(read_markers(views[0], wider).white[4])
    assert watch(views, [], FIXTURE, LIMITS, reference).fault is None


def test_blur_of_one_pose_is_no_change_of_the_lamp(reference: FixtureReference) -> None:
    def blurred(image: Image, stage_deg: float) -> Image:
        return cv2.GaussianBlur(image.astype(np.float32), (0, 0), 1.9) if stage_deg == 90.0 else image

    assert "at 90° the edges of the markers" in (watched(blurred, reference).fault or "")
