"""Marks painted into a map of cells: where they are, what they look like, and how often chance makes such."""

import numpy as np
import pytest

from anisoscope.imaging.defect_regions import (
    SPOT,
    MarkForm,
    chance_of_a_cell,
    chance_of_a_group,
    find_regions,
    form_of,
)
from anisoscope.imaging.deviation_map import CellMap
from anisoscope.imaging.mark_classes import UNKNOWN
from anisoscope.imaging.registration.placement import Grid

LIMIT = 0.3
ROWS, COLS = 80, 96
GRID = Grid((0.5, -0.2), 0.005, (ROWS * 5, COLS * 5))


def pattern(noise=0.03, seed=0):
    """ln ratios of a good part: four flanks a pitch, fading across the field."""
    rng = np.random.default_rng(seed)
    flanks = np.array([1.8, 1.6, -0.4, 0.7])[np.arange(COLS) % 4]
    return flanks + np.linspace(0, 0.4, COLS) + noise * rng.standard_normal((ROWS, COLS))


def regions_of(ratios, grid=GRID):
    """Regions of a map whose score is the size of its one deviation."""
    off = ratios - np.median(ratios, axis=0)
    off[:, np.abs(np.median(ratios, axis=0) - np.median(pattern(0.0), axis=0)) > 0.3] += 0.5
    return find_regions(CellMap(np.abs(off), LIMIT, off[None], np.array([LIMIT]), 0.01), grid)


def test_a_good_part_has_no_regions():
    assert regions_of(pattern()) == ()


def test_a_missing_ridge_is_one_region_over_the_whole_length():
    ratios = pattern()
    ratios[:, 40:44] = 0.1
    regions = regions_of(ratios)
    assert [region.cells >= 2 * ROWS for region in regions] == [True]
    region = regions[0]
    assert region.area_share == pytest.approx(4 / COLS, rel=0.3)
    assert region.p_value < 1e-9
    assert region.length == pytest.approx(ROWS * 0.025)
    assert region.x == pytest.approx(0.5 + (41.5 - (COLS - 1) / 2) * 0.025, abs=0.03)


def test_marks_are_found_where_they_are():
    ratios = pattern()
    ratios[10:12, 20:22] -= 1.0
    regions = regions_of(ratios)
    assert len(regions) == 1
    assert regions[0].cells == 4
    assert regions[0].x == pytest.approx(0.5 + (20.5 - (COLS - 1) / 2) * 0.025)
    assert regions[0].y == pytest.approx(-0.2 + ((ROWS - 1) / 2 - 10.5) * 0.025)
    assert regions[0].deviation == pytest.approx(-1.0, abs=0.1)


def test_places_turn_with_the_raster():
    ratios = pattern()
    ratios[10:12, 20:22] -= 1.0
    plain, turned = (regions_of(ratios, Grid((0.0, 0.0), 0.005, GRID.shape, turn))[0] for turn in (0.0, 90.0))
    assert (turned.x, turned.y) == pytest.approx((-plain.y, plain.x))


def test_kinds_come_from_the_poses_and_a_single_cell_has_none():
    ratios = pattern()
    ratios[10:12, 20:22] -= 1.0
    ratios[40, 50] -= 1.0
    assert {(region.cells, region.kind) for region in regions_of(ratios)} == {(4, UNKNOWN), (1, SPOT)}


@pytest.mark.parametrize("chance", [0.01, 0.03])
@pytest.mark.parametrize("cells", [1, 2, 3])
def test_the_chance_of_a_group_is_a_bound(chance, cells):
    """Maps of independent cells show groups of a size at most as often as said, and not much more seldom."""
    import cv2

    rng = np.random.default_rng(1)
    seen = 0
    for _ in range(400):
        over = (rng.random((20, 20)) < chance).astype(np.uint8)
        _, _, stats, _ = cv2.connectedComponentsWithStats(over, connectivity=8)
        seen += bool((stats[1:, cv2.CC_STAT_AREA] >= cells).any())
    said = chance_of_a_group(cells, 400, chance)
    share = seen / 400
    assert share <= said + 3.0 * np.sqrt(said * (1.0 - said) / 400) + 0.02
    assert said < 3.0 * share + 0.1


def test_the_chance_of_a_cell_is_the_tail_of_the_scatter():
    rng = np.random.default_rng(2)
    noise = rng.laplace(scale=0.05, size=(200, 200))
    assert chance_of_a_cell(noise, 0.1) == pytest.approx(np.exp(-2.0), rel=0.05)
    assert chance_of_a_cell(noise, 0.5) == pytest.approx(np.exp(-10.0), rel=0.5)
    normal = 0.1 * rng.standard_normal((200, 200))
    assert chance_of_a_cell(normal, 0.5) > 1e-6  # 6e-7 for a normal tail: the bound is on the safe side
    assert chance_of_a_cell(np.zeros((5, 5)), 0.2) == 0.0
    assert chance_of_a_group(3, 400, 0.0) == 0.0
    assert chance_of_a_group(40, 400, 0.9) == 1.0


def test_the_form_of_marks_tells_what_keeps_to_a_place_of_the_pitch_and_extends_along_it(rng):
    over = np.zeros((28, 100), dtype=bool)
    assert form_of(over) is None
    over[3:6, 3] = over[3:6, 4] = over[10:12, 47] = True  # the raster cuts the crests between columns 3 and 4
    assert form_of(over) == MarkForm(2, 1.0, 1.0, 0.0)
    over[20, 10] = over[20, 53] = True
    assert form_of(over) == MarkForm(4, 0.8, 0.8, 0.0)
    anywhere = form_of(rng.random((200, 400)) < 0.02)
    assert anywhere.in_line == pytest.approx(0.5, abs=0.04)
    assert anywhere.along == pytest.approx(0.04, abs=0.015)


@pytest.mark.parametrize(("rise", "aligned"), [(0, 1.0), (3, 1.0), (-4, 1.0), (6, 0.0)])
def test_nicks_of_a_scratch_are_in_line_from_ridge_to_ridge(rise, aligned):
    """Nicks in the crests of the eleven ridges that a scratch crosses; those at its ends have one neighbour only."""
    over = np.zeros((80, 44), dtype=bool)
    for ridge in range(11):
        over[40 + rise * (ridge - 5), 4 * ridge + 2] = True
    assert form_of(over).aligned == aligned
    over[:, 22] = False  # the middle one is missing
    assert form_of(over).aligned == pytest.approx(0.75 * aligned)
