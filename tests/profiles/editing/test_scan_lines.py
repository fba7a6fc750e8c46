"""Lines of a scan brought to one height, and scars taken out, against maps whose faults are known."""

import numpy as np
import pytest

from anisoscope.base.errors import HeightMapError
from anisoscope.profiles.editing.steps import edit_map
from anisoscope.profiles.heightmap import HeightMap

ROWS, COLS = 120, 160


def ridges(noise=0.01):
    """A sawtooth across the lines' direction x, tilted along y, with noise; in µm."""
    y, x = np.mgrid[:ROWS, :COLS].astype(float)
    rng = np.random.default_rng(5)
    return np.mod(x, 40.0) * 0.1 + 0.02 * y + noise * rng.standard_normal((ROWS, COLS))


def turned(height, direction):
    return HeightMap(height if direction == "x" else height.T, 1.0, 1.0)


@pytest.mark.parametrize("direction", ["x", "y"])
def test_lines_come_to_one_height_and_the_tilt_stays(direction):
    clean = ridges()
    drift = np.random.default_rng(6).normal(0.0, 0.2, ROWS)
    part = clean + drift[:, None]
    part[30, 20:60] = np.nan
    part[50] = np.nan
    edited = edit_map(turned(part, direction), [f"align-lines={direction}"])
    found = edited.height_um if direction == "x" else edited.height_um.T
    error = found - clean
    assert (
        np.nanstd(error - np.nanmean(error)) < 0.06
    )  # the slope of the drift itself is taken for that of the part
    across = np.nanmedian(np.diff(np.delete(error, 50, axis=0), axis=0), axis=1)
    assert np.nanstd(across) < 0.005
    slope = np.median(np.diff(np.nanmean(found[:50, 60:], axis=1)))
    assert slope == pytest.approx(0.02, abs=0.006)
    step = edited.origin["history"][-1]
    assert step["found"]["rms_of_lines_um"] == pytest.approx(0.2, rel=0.3)


def test_ridges_along_the_lines_are_not_taken_for_drift():
    with pytest.raises(HeightMapError, match="align-lines: ridges lie along the lines of y"):
        edit_map(HeightMap(ridges(), 1.0, 1.0), ["align-lines=y"])


@pytest.mark.parametrize("direction", ["x", "y"])
def test_scars_become_missing_and_nothing_else_does(direction):
    part = ridges()
    scars = np.zeros(part.shape, dtype=bool)
    scars[20, 30:90] = scars[70, 5:40] = True
    part[20, 30:90] += 0.3
    part[70, 5:40] -= 0.25
    edited = edit_map(turned(part, direction), [f"scars=scan:{direction}", "fill"])
    gaps = edit_map(turned(part, direction), [f"scars=scan:{direction}"])
    missing = np.isnan(gaps.height_um if direction == "x" else gaps.height_um.T)
    assert missing[scars].mean() > 0.95
    assert not missing[~scars].any()
    found = edited.height_um if direction == "x" else edited.height_um.T
    assert np.median(np.abs(found - ridges())[scars]) < 0.05
    assert gaps.origin["history"][-1]["found"] == {"points_taken_out": int(missing.sum())}


@pytest.mark.parametrize(
    ("step", "message"),
    [
        ("scars=limit:0", "the limit is above 0"),
        ("scars=length:1", "a scar has 2 points or more"),
    ],
)
def test_values_out_of_range(step, message):
    with pytest.raises(HeightMapError, match=message):
        edit_map(HeightMap(ridges(), 1.0, 1.0), [step])


def test_two_lines_are_too_few():
    part = HeightMap(ridges()[:2], 1.0, 1.0)
    for step in ("align-lines", "scars"):
        with pytest.raises(HeightMapError, match="fewer than three"):
            edit_map(part, [step])
