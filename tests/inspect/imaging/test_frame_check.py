"""Single frames are looked at before those of a pose are averaged."""

from dataclasses import replace

import numpy as np
import pytest

from anisoscope.base.errors import MeasurementError
from anisoscope.imaging.frame_check import usable_frames
from anisoscope.imaging.frames import AcquiredFrames, Shot
from anisoscope.recipe.base import LimitsPart
from anisoscope.rig.acquisition.plan import Pose
from anisoscope.rig.frame import Frame

ROWS, COLS, BLACK, FULL = 96, 128, 64, 4095
FIRST = 3  # frame of a pose that is damaged; the ones before are dark


def counts_of(rng, angle, kind, full=FULL):
    """Stripes in an even surface, with photon and read noise."""
    y, x = np.mgrid[:ROWS, :COLS]
    turn = np.radians(angle)
    light = 900.0 * (1.0 + 0.6 * np.sin((x * np.cos(turn) + y * np.sin(turn)) / 3.0)) * (kind != "dark")
    noisy = BLACK + light + rng.normal(size=light.shape) * np.sqrt(4.0 + 0.4 * light)
    return np.clip(np.rint(noisy), 0, full).astype(np.uint16)


@pytest.fixture(scope="module")
def shots():
    rng = np.random.default_rng(5)
    made = []
    for angle, kind, count in ((0, "dark", FIRST), (0, "sample", 4), (90, "sample", 4)):
        for number in range(count):
            counts = counts_of(rng, angle, kind)
            frame = Frame(counts, kind, 12, BLACK, 0.01, 1.0, angle, angle, 0.0, "", "camera")
            made.append(Shot(f"{kind}_{angle}_{number}.tif", "", frame, Pose(angle, 0.0), False, 0, False))
    return tuple(made)


def checked(shots, changed, limits=None):
    """Check of the frames with some counts changed, by their numbers."""
    made = [
        replace(shot, frame=replace(shot.frame, counts=changed.get(number, shot.frame.counts)))
        for number, shot in enumerate(shots)
    ]
    return usable_frames(AcquiredFrames(tuple(made), "camera", "stage"), limits or LimitsPart())


def scaled(counts, factor):
    return np.rint(np.clip((counts.astype(float) - BLACK) * factor + BLACK, 0, FULL)).astype(np.uint16)


def torn(counts, how):
    found = counts.copy()
    if how == "zero":
        found[30:33] = 0
    elif how == "repeated":
        found[31:33] = found[30]
    elif how == "shifted":
        found[60:] = np.roll(found[60:], 9, axis=1)
    return found


def test_sound_frames_are_all_used(shots):
    frames, notes = checked(shots, {})
    assert frames.shots == frames.shots[: len(shots)]
    assert len(frames.shots) == len(shots)
    assert notes == ()


@pytest.mark.parametrize("how", ["zero", "repeated", "shifted"])
def test_a_torn_frame_is_left_out(shots, how):
    frames, (note,) = checked(shots, {FIRST: torn(shots[FIRST].frame.counts, how)})
    assert len(frames.shots) == len(shots) - 1
    assert "frame 1 at 0° (sample_0_0.tif) was left out: it is torn" in note


@pytest.mark.parametrize(
    ("number", "other", "says"),
    [
        (FIRST, 0, "frame 1 at 0° (sample_0_0.tif) was left out: it is black"),
        (
            FIRST + 4,
            FIRST,
            "frame 1 at 90° (sample_90_0.tif) was left out: it is stale: it shows the picture at 0°",
        ),
        (
            1,
            FIRST,
            "frame 2 of the dark frames (dark_0_1.tif) was left out: it is stale: it shows the picture at 0°",
        ),
        (FIRST + 1, FIRST, "is the same picture bit for bit as sample_0_0.tif"),
    ],
)
def test_a_frame_of_another_moment_is_left_out(shots, number, other, says):
    frames, (note,) = checked(shots, {number: shots[other].frame.counts})
    assert shots[number].name not in {shot.name for shot in frames.shots}
    assert says in note


def test_a_frame_exposed_otherwise_is_left_out_at_the_limit_of_the_recipe(shots):
    half = {FIRST: scaled(shots[FIRST].frame.counts, 0.75)}
    _, (note,) = checked(shots, half)
    assert "75% of the others' light (limit ±5%, limits.frame_level): its exposure is stale" in note
    assert checked(shots, half, LimitsPart(frame_level=0.3))[1] == ()


def test_a_pose_of_one_picture_is_refused(shots):
    frozen = {FIRST + number: shots[FIRST].frame.counts for number in range(4)}
    with pytest.raises(MeasurementError, match="frames 1 to 4 at 0° are the same picture bit for bit"):
        checked(shots, frozen)


def test_no_majority_is_refused(shots):
    halves = {FIRST + number: scaled(shots[FIRST + number].frame.counts, 0.5) for number in range(2)}
    with pytest.raises(MeasurementError, match=r"frame 1 at 0° .* \(and 3 more of 4 cannot"):
        checked(shots, halves)


def test_a_plateau_below_full_scale_is_refused(shots):
    clipped = {number: np.minimum(shots[number].frame.counts, 1100) for number in range(FIRST, len(shots))}
    with pytest.raises(MeasurementError, match=r"on 1100 counts, its largest, below the full scale of 4095"):
        checked(shots, clipped)
    assert checked(shots, clipped, LimitsPart(plateau_share=0.9))[1] == ()


def test_full_scale_is_no_plateau_of_the_camera(shots):
    bright = {number: scaled(shots[number].frame.counts, 4.0) for number in range(FIRST, len(shots))}
    assert np.mean(bright[FIRST] == FULL) > 0.05
    assert checked(shots, bright)[1] == ()


def test_dark_frames_without_visible_noise_are_used(shots):
    """An 8-bit camera clips its dark frames at zero."""
    eight = {
        number: np.zeros((ROWS, COLS), np.uint16) if number < FIRST else shot.frame.counts // 16
        for number, shot in enumerate(shots)
    }
    assert checked(shots, eight)[1] == ()


def test_pictures_without_noise_are_not_called_torn(shots):
    """Rendered pictures repeat rows and have a brightest count on many pixels; one frame a pose."""
    smooth = np.full((ROWS, COLS), 700, np.uint16)
    smooth[:, ::5] = 400
    few = tuple(shots[number] for number in (0, FIRST))
    assert checked(few, {1: smooth})[1] == ()
