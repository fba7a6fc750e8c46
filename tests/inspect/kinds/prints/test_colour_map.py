"""The map of a print: how the flakes lean from cell to cell, what counts as curl, and what as a spot."""

import numpy as np
import pytest

from anisoscope.kinds.prints.model import State
from anisoscope.record.verdict import Verdict


@pytest.mark.parametrize("axis", [0, 1])
def test_the_lean_of_every_cell_is_found(sheet, axis):
    """A tenth of the region leans by a degree; the others stay upright."""
    rows, cols = slice(2, 8), slice(4, 10)
    lean = {"tilt_x_deg": 1.0} if axis == 0 else {"tilt_y_deg": -1.0}
    sheet.states[rows, cols] = State(**lean)
    _, decision = sheet.decided()
    found = decision.map.lean_deg
    wanted = np.zeros_like(found)
    wanted[axis][rows, cols] = 1.0 if axis == 0 else -1.0
    assert found == pytest.approx(wanted, abs=0.06)


def test_curl_along_a_diagonal_is_a_matrix(sheet):
    """The normal follows the gradient of a paraboloid that bends along x only by half as much as along y."""
    rows, cols = sheet.grid.shape
    for row in range(rows):
        for col in range(cols):
            x, y = (col + 0.5) / cols - 0.5, 0.5 - (row + 0.5) / rows
            sheet.states[row, col] = State(tilt_x_deg=0.4 * x, tilt_y_deg=0.8 * y)
    _, decision = sheet.decided()
    assert decision.map.record.curl_deg == pytest.approx(np.diag([0.4, 0.8]), abs=0.02)
    curl = next(one for one in decision.quantities if one.name == "curl")
    assert curl.value == pytest.approx(0.8, abs=0.02)
    assert curl.verdict is Verdict.FAIL


def test_a_spot_is_no_curl_and_a_grain_is_no_spot(sheet):
    _, decision = sheet.spotted(slice(0, 5), slice(15, 20), 0.6).decided()
    assert np.abs(decision.map.record.curl_deg).max() < 0.05
    _, clean = sheet.all(State()).decided()
    assert clean.map.record.share == 0.0
    assert clean.map.local.max() < 3.0 * clean.map.record.noise + 1.0
    assert clean.map.record.verdict is Verdict.PASS


def test_two_spots_are_two(sheet):
    sheet.spotted(slice(2, 4), slice(2, 5), 0.5).spotted(slice(12, 16), slice(12, 14), 0.4)
    _, decision = sheet.decided()
    large, small = decision.map.record.spots
    assert (large.cells, small.cells) == (8, 6)
    assert small.delta_e > large.delta_e
    assert large.area_share == pytest.approx(8.0 / 400.0)


def test_what_all_cells_share_shows_against_the_prediction_only(sheet):
    _, decision = sheet.all(State(missing=0.15)).decided()
    assert decision.map.local.max() < 2.0
    assert decision.map.total.min() > 2.0
    assert decision.map.record.verdict is Verdict.PASS


def test_cells_of_a_halftone_are_judged_by_how_all_of_them_scatter(sheet):
    """Few dots in a cell make levels that differ by 10 % and more: no cell of a good print deviates, a spot does."""
    rng = np.random.default_rng(6)
    for place in np.ndindex(sheet.grid.shape):
        sheet.states[place] = State(missing=0.3 + 0.1 * rng.standard_normal())
    _, good = sheet.decided()
    record = good.map.record
    assert np.mean(good.map.local > record.cell_delta_e) > 0.3
    assert (record.share < 0.01, record.verdict) == (True, Verdict.PASS)
    assert record.cell_limit == record.threshold > record.cell_delta_e
    for place in np.ndindex((3, 4)):
        sheet.states[place] = State(missing=0.97)
    _, spotted = sheet.decided()
    assert spotted.map.record.verdict is Verdict.FAIL
    assert spotted.map.record.spots[0].cells >= 10


def test_ink_that_thins_out_across_a_print_is_no_scatter_of_dots(sheet):
    rows, cols = sheet.grid.shape
    for row, col in np.ndindex(rows, cols):
        sheet.states[row, col] = State(missing=0.5 * (col + 0.5) / cols)
    _, decision = sheet.decided()
    record = decision.map.record
    assert (record.cell_limit, record.verdict) == (None, Verdict.FAIL)
    assert record.share > 0.5
