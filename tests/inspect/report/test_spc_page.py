"""Charts of many values: the outline and every flagged value stay."""

import numpy as np
import pytest

from anisoscope.report.spc_page import BUCKETS, distinct_on_paper, outline


def test_few_values_are_all_drawn():
    np.testing.assert_array_equal(outline(np.arange(50.0)), np.arange(50))


@pytest.mark.parametrize("digits", [0, 1, 8])
def test_extremes_of_every_stretch_stay(rng, digits):
    values = np.round(rng.normal(size=100_000), digits)
    kept = outline(values)
    assert len(kept) <= 2 * BUCKETS
    assert np.all(np.diff(kept) > 0)
    for stretch in np.array_split(np.arange(len(values)), 173):
        inner = kept[(kept >= stretch[0] - 90) & (kept <= stretch[-1] + 90)]
        assert values[inner].max() >= values[stretch].max()
        assert values[inner].min() <= values[stretch].min()


def test_gaps_stay_gaps_and_lonely_values_stay():
    values = np.full(100_000, np.nan)
    values[:40_000] = 1.0
    values[70_000] = 5.0
    kept = outline(values)
    assert 70_000 in kept
    assert np.isnan(values[kept]).any()


def test_every_flagged_value_has_a_mark_where_it_would_be_drawn(rng):
    values = rng.normal(size=100_000)
    marked = rng.random(100_000) < 0.5
    kept = distinct_on_paper(values, marked)
    assert marked[kept].all()
    assert len(kept) < marked.sum()
    height = np.ptp(values) / 500
    by_place = {}
    for place in kept:
        by_place.setdefault(place * BUCKETS // len(values), []).append(values[place])
    for place in np.flatnonzero(marked)[::37]:
        near = np.array(by_place[place * BUCKETS // len(values)])
        assert np.min(np.abs(near - values[place])) <= height


def test_few_flags_are_all_kept(rng):
    values = rng.normal(size=100_000)
    marked = np.abs(values) > 3.2
    np.testing.assert_array_equal(distinct_on_paper(values, marked), np.flatnonzero(marked))
