"""Every fault of a bench file does to the frames what its table says."""

import numpy as np
import pytest

from anisoscope.base.errors import RigFileError
from anisoscope.imaging.registration.placement import find_markers
from anisoscope.sim.bench.benchfile import read_bench

EXPOSURE_S = 0.004
QUIET = {"prnu": 0.0, "dsnu_e": 0.0, "read_noise_e": 0.0, "dark_current_e_s": 0.0}
SMOOTH = {"kind": "ridges", "reflections": False, "resolved_alpha": 0.0}


@pytest.fixture
def frames(make_bench):
    """``frames(angles, tile=True, dark=0, **faults)``: dark frames, and a lit one per angle, in counts above black."""

    def take(angles=(0.0,), tile=True, dark=0, sensor=QUIET, **faults):
        sample = {"kind": "white-tile", "reflectance": 0.2} if tile else SMOOTH
        bench = make_bench(faults=faults, sensor=sensor, sample=sample)
        found = [bench.photograph(EXPOSURE_S, 1.0) for _ in range(dark)]
        bench.light_on = True
        for angle in angles:
            bench.axis.start_move(10.0 + angle)
            found.append(bench.photograph(EXPOSURE_S, 1.0))
        return np.stack(found).astype(float) - 64.0

    return take


def levels(found):
    return np.median(found, axis=(1, 2))


def test_lamp_exposure_and_gain_have_a_factor_per_pose(frames):
    angles = (0.0, 0.0, 90.0, 180.0, 270.0)
    usual = levels(frames(angles))
    for fault in ("lamp", "exposure", "gain"):
        ratio = levels(frames(angles, **{fault: [1.0, 0.5, 0.25]})) / usual
        assert ratio == pytest.approx([1.0, 1.0, 0.5, 0.25, 0.25], rel=0.02)


def test_a_sloping_lamp_dims_one_side(frames):
    ratio = frames(lamp_slope=[0.1, 0.0])[0] / frames()[0]
    assert np.median(ratio[:, -20:]) == pytest.approx(1.095, abs=0.01)
    assert np.median(ratio[:, :20]) == pytest.approx(0.905, abs=0.01)
    up = frames(lamp_slope=[0.0, 0.1])[0] / frames()[0]
    assert np.median(up[:20]) > 1.08
    assert np.median(up[-20:]) < 0.92


def test_glare_is_in_lit_frames_alone_and_room_light_in_all(frames):
    glare = frames(dark=1, glare_radiance=0.01) - frames(dark=1)
    assert levels(glare) == pytest.approx([0.0, 0.01 * 6e6 * EXPOSURE_S / 7.5], abs=1.0)
    room = frames((0.0, 90.0), dark=2, room_radiance=[0.01, 0.01, 0.02]) - frames((0.0, 90.0), dark=2)
    assert levels(room) == pytest.approx(np.array([1.0, 1.0, 2.0, 2.0]) * 32.0, abs=1.0)
    slope = (frames(glare_radiance=0.01, glare_slope=[0.5, 0.0]) - frames())[0]
    assert np.median(slope[:, -10:]) > 2.5 * np.median(slope[:, :10])


def test_dark_frames_lie_higher(frames):
    assert levels(frames(dark=1, black_in_dark=60.0) - frames(dark=1)) == pytest.approx([60.0, 0.0], abs=1.0)


def test_automatic_gain_gives_every_pose_one_mean(frames):
    angles = (0.0, 90.0, 180.0)
    usual = frames(angles, tile=False).mean(axis=(1, 2))
    automatic = frames(angles, tile=False, automatic_gain=True).mean(axis=(1, 2))
    assert np.ptp(usual) > 0.1 * usual.mean()
    assert automatic == pytest.approx(usual[0], rel=0.01)


def test_the_first_frame_of_a_pose_is_that_of_the_pose_before(frames):
    angles = (0.0, 0.0, 90.0, 90.0, 180.0)
    usual, stale = frames(angles, tile=False), frames(angles, tile=False, stale_pose=True)
    for number, shown in enumerate((0, 0, 0, 2, 2)):
        alike = [np.abs(stale[number] - one).mean() for one in (usual[0], usual[2], usual[4])]
        assert int(np.argmin(alike)) == shown // 2


def test_every_second_frame_is_the_one_before_bit_for_bit(frames):
    found = frames((0.0,) * 4, repeats_every=2)
    assert np.array_equal(found[0], found[1])
    assert np.array_equal(found[2], found[3])
    assert not np.array_equal(found[1], found[2])


@pytest.mark.parametrize(("torn", "share"), [("zero", 1 / 3), ("shifted", 2 / 3), ("dropped", 2 / 3)])
def test_every_second_lit_frame_is_torn_below(frames, torn, share):
    usual, found = (frames((0.0,) * 2, tile=False, **how) for how in ({}, {"torn": torn, "torn_every": 2}))
    changed = (found != usual).any(axis=2)
    assert not changed[0].any()
    assert not changed[1][:90].any()
    assert 0.3 * share < changed[1].mean() <= share + 0.01


def test_plateau_and_stuck_pixels(frames):
    assert frames(plateau_counts=150).max() == 150 - 64
    found = frames(dark=1, stuck_columns=[7], stuck_pixels=[[3, 5]], stuck_counts=4000)
    assert (found[:, :, 7] == 4000 - 64).all()
    assert (found[:, 3, 5] == 4000 - 64).all()
    assert (found == 4000 - 64).sum() == 2 * (288 + 1)


def test_a_mirrored_camera_exchanges_left_and_right(frames):
    usual, mirrored = frames(tile=False)[0], frames(tile=False, mirrored=True)[0]
    assert np.abs(usual[:, ::-1] - mirrored).mean() < 0.2 * np.abs(usual - mirrored).mean()


def test_a_barrel_moves_corners_inwards_by_its_share(make_bench):
    """The corners of the markers against those of a straight lens, about the middle of the picture."""
    places = []
    for barrel in (0.0, 0.05):
        bench = make_bench(sample=SMOOTH, sensor=QUIET, faults={"barrel": barrel})
        bench.light_on = True
        picture = bench.photograph(EXPOSURE_S, 1.0).astype(np.float32) - 64.0
        found = sorted(find_markers(picture, bench.file.fixture), key=lambda marker: marker.id)
        places.append(np.concatenate([marker.corners for marker in found]) - [159.5, 143.5])
    straight, bent = (np.hypot(*place.T) for place in places)
    assert bent / straight == pytest.approx(1.0 - 0.05 * (straight / np.hypot(159.5, 143.5)) ** 2, abs=2e-3)


@pytest.mark.parametrize(
    ("fault", "alike"),
    [({"seated_deg": 180.0}, (180.0, 0.0)), ({"slips_at": 2, "slip_deg": -180.0}, (0.0, 0.0))],
    ids=["turned in its seat", "slips"],
)
def test_the_part_stands_otherwise_than_its_fixture(frames, fault, alike):
    """Its brightness is that of another angle; its markers stay."""
    angles = (0.0, 180.0)
    middle = np.s_[:, 130:158, 145:175]
    usual = frames((*angles, *alike), tile=False)[middle].mean(axis=(1, 2))
    found = frames(angles, tile=False, **fault)[middle].mean(axis=(1, 2))
    assert found == pytest.approx(usual[2:], rel=0.02)
    assert abs(usual[0] / usual[1] - 1.0) > 0.2


def test_upside_down_ridges_lean_to_the_other_side(frames):
    middle = np.s_[:, 130:158, 145:175]
    usual, turned = (
        frames((0.0, 180.0), tile=False, **how)[middle].mean(axis=(1, 2))
        for how in ({}, {"upside_down": True})
    )
    assert turned == pytest.approx(usual[::-1], rel=0.05)


@pytest.mark.parametrize("fault", ["dirty_marker", "shadowed_marker"])
def test_one_marker_is_dirty_or_in_shadow(frames, fault):
    """The marker to the right changes, the one to the left does not."""
    change = np.abs(frames(tile=False, **{fault: 0})[0] - frames(tile=False)[0])
    row, right, left = 142, 163 + 111, 163 - 111
    assert change[row - 15 : row + 15, right - 5 : right + 15].mean() > 20.0
    assert change[row - 15 : row + 15, left - 15 : left + 5].mean() < 1.0


@pytest.mark.parametrize(
    ("faults", "message"),
    [({"dirty_marker": 9}, "no marker 9"), ({"stuck_columns": [400]}, "within 288 rows and 320 columns")],
)
def test_a_fault_where_there_is_nothing_is_refused(bench_path, faults, message):
    with pytest.raises(RigFileError, match=message):
        read_bench(bench_path(faults=faults))
