"""Charts of many values: the outline and every flagged value stay."""

import numpy as np
import pytest

from anisoscope.quality.control import Settings, control_study
from anisoscope.quality.limits import individuals
from anisoscope.quality.readings import Readings
from anisoscope.report.spc_page import BUCKETS, Points, control_picture, distinct_on_paper, outline


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


def test_marks_stand_at_the_values_and_lead_to_their_reports(tmp_path):
    values = np.array([1.0, 2.0, 1.5, np.nan, 1.2, 1.8, 1.4, 1.1])
    folder = tmp_path / "A5"
    folder.mkdir()
    (folder / "report.html").touch()
    texts = {
        "time": tuple(f"2026-11-0{k + 1} 06:00+00:00" for k in range(8)),
        "folder": tuple("A5" if k == 5 else "gone" for k in range(8)),
    }
    readings = Readings("a file", texts, {"x": values}, base=tmp_path)
    study = control_study("x", individuals(values, tuple(f"A{k}" for k in range(8))), Settings())
    _, marks = control_picture(study, Points(readings, tmp_path / "spc.html"))
    measured = values[~np.isnan(values)]
    assert [mark.link for mark in marks] == [None, None, None, None, "A5/report.html", None, None]
    slope = np.polyfit(measured, [mark.y for mark in marks], 1)
    assert [mark.y for mark in marks] == pytest.approx(np.polyval(slope, measured))
    assert slope[0] < 0.0
    assert np.all(np.diff([mark.x for mark in marks]) > 0.0)
    assert "A5" in marks[4].text
    assert f"{readings.moment(5):%Y-%m-%d %H:%M}" in marks[4].text
