"""Radial distortion: there and back, its fit to painted markers, and what an inspection does with a bent lens."""

import re
from dataclasses import replace

import numpy as np
import pytest

from anisoscope.base.errors import CalibrationError
from anisoscope.calibration.corrections import Calibrations, read_calibrations
from anisoscope.calibration.rotation import calibrate_rotation
from anisoscope.imaging.registration.lens import Corners, Lens, fit_lens
from anisoscope.imaging.registration.placement import Grid, Placement, marker_corners_mm, resample
from anisoscope.inspection.recompute import recompute
from anisoscope.inspection.replay import inspect_frames
from anisoscope.operations.demo.folder import FIXTURE
from anisoscope.parameters.taking import Taking
from anisoscope.rig.fixture import Fixture
from anisoscope.rig.frame import read_frame
from anisoscope.rig.framefolder import write_frame_folder
from anisoscope.rig.rigfile import read_rig

SHAPE = (512, 640)
BENT = Lens(SHAPE, 0.012, -0.003)
KNOWN = np.concatenate(list(marker_corners_mm(Fixture.model_validate(FIXTURE)).values()))
BARREL = {"faults": {"barrel": 0.03}}  # as 1.2 % is to a camera with smaller pixels


@pytest.mark.parametrize("lens", [BENT, Lens(SHAPE, -0.03), Lens(SHAPE, 0.0)])
def test_straight_and_seen_places_are_each_others_inverse(lens):
    seen = np.random.default_rng(1).uniform([0.0, 0.0], [639.0, 511.0], (5, 20, 2))
    np.testing.assert_allclose(lens.seen(lens.straight(seen)), seen, atol=1e-6)


def test_a_corner_moves_by_its_share_and_the_middle_stays():
    corner, middle = np.array([639.0, 511.0]), np.array([319.5, 255.5])
    np.testing.assert_allclose(BENT.straight(corner) - middle, 1.009 * (corner - middle))
    np.testing.assert_allclose(BENT.straight(middle), middle)
    assert BENT.share == pytest.approx(0.009)


def turned(lens, count, rng, noise_px=0.01, size=1.0, squeeze=1.0):
    """Corners of the markers in pictures all round, by a lens, with markers printed larger by a share."""
    middles = np.repeat(KNOWN.reshape(-1, 4, 2).mean(axis=1), 4, axis=0)
    printed = middles + size * (KNOWN - middles)
    origin, found = np.array([322.0, 254.0]), []
    for angle in np.arange(count) * 2 * np.pi / count:
        cos, sin = np.cos(angle), np.sin(angle)
        straight = 125.0 * printed @ np.array([[cos, -squeeze * sin], [-sin, -squeeze * cos]])
        seen = lens.seen(straight + origin)
        found.append(Corners(KNOWN, seen + noise_px * rng.standard_normal(seen.shape), squeeze))
    return found


@pytest.mark.parametrize("squeeze", [1.0, 0.97])
@pytest.mark.parametrize("size", [1.0, 1.02])
def test_the_distortion_comes_back_whatever_the_size_of_the_print(rng, size, squeeze):
    found = fit_lens(turned(Lens(SHAPE, 0.012), 12, rng, size=size, squeeze=squeeze), SHAPE)
    assert found.lens.k1 == pytest.approx(0.012, abs=max(4 * found.u[0], 1e-5))
    assert found.lens.k2 == 0.0
    assert found.u[0] < 0.0015
    assert found.residual_px < 0.02 < found.plain_px


def test_a_straight_lens_gives_none_also_with_misprinted_corners(rng):
    assert fit_lens(turned(Lens(SHAPE, 0.0), 12, rng), SHAPE).lens is None
    misprint = 0.2 * rng.standard_normal(KNOWN.shape)
    pictures = [
        one._replace(points_mm=KNOWN, pixels=one.pixels + misprint)
        for one in turned(Lens(SHAPE, 0.0), 12, rng)
    ]
    assert fit_lens(pictures, SHAPE).lens is None


def test_a_strong_fourth_order_is_found(rng):
    found = fit_lens(turned(Lens(SHAPE, 0.02, 0.04), 12, rng, noise_px=0.002), SHAPE)
    assert (found.lens.k1, found.lens.k2) == pytest.approx((0.02, 0.04), abs=4 * float(found.u.max()))


def test_resampling_passes_through_the_lens():
    """A picture of the straight coordinates of every pixel, resampled on the part, gives those of the raster."""
    matrix = np.array([[125.0, 0.0, 322.0], [0.0, -125.0, 254.0]])
    place = Placement(matrix, 0.0, 8.0, (322.0, 254.0), 0.0, 4, lens=BENT)
    row, column = np.indices(SHAPE).astype(float)
    straight = BENT.straight(np.stack([column, row], axis=-1)).astype(np.float32)
    grid = Grid((0.1, 0.2), 0.03, (60, 80), 30.0)
    at = np.stack([*np.indices(grid.shape)[::-1], np.ones(grid.shape)]).reshape(3, -1)
    wanted = (matrix @ grid.to_mm() @ at).reshape(2, *grid.shape)
    for axis in (0, 1):
        np.testing.assert_allclose(resample(straight[..., axis], place, grid), wanted[axis], atol=0.02)
    np.testing.assert_allclose(place.straight(place.seen(wanted.T)), wanted.T, atol=1e-6)


@pytest.fixture(scope="module")
def inspected(virtual_rigs, undiagnosed):
    """By what is calibrated: the part under a straight lens, under a bent one, and under one that is calibrated."""
    straight, bent = virtual_rigs("straight"), virtual_rigs("bent", bench=BARREL)
    record = calibrate_rotation(bent.rig, bent.rig.with_name("rotation.json"), Taking(0.0015, frames=2))
    known = virtual_rigs(
        "known", bench=BARREL, rig={"calibration": {"rotation": str(bent.rig.with_name("rotation.json"))}}
    )
    parts = {"straight": straight, "bent": bent, "known": known}
    return record, parts, {name: rig.inspect(methods=undiagnosed) for name, rig in parts.items()}


def test_a_bent_lens_is_named_and_once_calibrated_changes_nothing(inspected):
    calibration, parts, done = inspected
    records = {name: one.record for name, one in done.items()}
    k1 = calibration.values["distortion_k1"]
    assert k1.value == pytest.approx(0.03, abs=2 * k1.u)
    assert k1.u < 0.004
    assert "distortion_k2" not in calibration.values
    assert calibration.in_limits
    assert records["bent"].verdict == "INVALID"
    assert re.search(r"a lens with (2\.[6-9]|3\.[0-3])% of barrel distortion", records["bent"].reasons[0])
    assert "calibrate rotation" in records["bent"].reasons[0]
    assert records["known"].verdict == records["straight"].verdict == "PASS"
    for one, other in zip(records["known"].poses, records["straight"].poses, strict=True):
        assert one.measured == pytest.approx(other.measured, rel=2e-3)
        assert one.pixel_um == pytest.approx(other.pixel_um, rel=1e-3)
        assert one.residual_px < 0.1
    found = read_calibrations(read_rig(parts["known"].rig).calibration)
    assert found.lens == Lens((512, 512), k1.value)
    assert Calibrations().lens is None


def test_folders_of_frames_are_straightened_as_live_pictures(inspected, tmp_path, undiagnosed):
    _, parts, done = inspected
    live = done["known"]
    frames = [replace(read_frame(live.folder / one.name), serial=None) for one in live.record.frames]
    again = [one.again for one in live.record.frames]
    write_frame_folder(tmp_path / "frames", frames, again)

    def judged(rig, folder="frames"):
        how = {"rig_path": parts[rig].rig, "methods": undiagnosed}
        return inspect_frames(tmp_path / folder, parts[rig].recipe, "L-1", tmp_path / "out", **how)

    found = judged("known")
    assert [one.measured for one in found.record.poses] == pytest.approx(
        [one.measured for one in live.record.poses], rel=1e-6
    )
    assert {one.kind for one in found.record.calibrations} >= {"rotation"}
    again_found = recompute(found.folder).differences  # with the diagnosis that was left out
    assert [one for one in again_found if not one.startswith(("details.", "diagnosis", "notes"))] == []
    assert "barrel distortion" in judged("bent").record.reasons[0]

    other = [replace(frame, camera="another 7") for frame in frames]
    flat = tmp_path / "flat"  # frames with a flat of their own are those of no rig's flat
    tile = [replace(frame, kind="flat", counts=np.full_like(frame.counts, 2000)) for frame in other[:4]]
    write_frame_folder(flat, [*other, *tile], [*again, *[False] * 4])
    with pytest.raises(CalibrationError, match=r"rotation calibration .* this is another 7"):
        judged("known", "flat")
