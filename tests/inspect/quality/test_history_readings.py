"""Readings and limits of good parts from a real history."""

import hashlib
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest

from anisoscope.base.errors import UsageError
from anisoscope.history.filters import Filters
from anisoscope.history.problems import HistoryError
from anisoscope.history.rows import NewRow
from anisoscope.history.store import open_history
from anisoscope.quality.capability import Specification, charted, specification
from anisoscope.quality.readings import history_readings


def row(number, rng, *, predicted=0.5, tolerance=0.1, verdict="PASS"):
    measured = predicted + 0.02 * rng.normal()
    return NewRow(
        created_at=datetime(2026, 11, 1, tzinfo=UTC) + timedelta(minutes=number),
        serial=f"SN-{number}",
        product="plate",
        recipe="plate 0123456789ab",
        lot=f"L{number // 20}",
        cavity=str(number % 2 + 1),
        station=None,
        operator="Ada",
        verdict=verdict,
        reasons=(),
        folder=f"/parts/{number}",
        seal=hashlib.sha256(str(number).encode()).hexdigest(),
        software="anisoscope 0",
        numbers={
            "ln 0-90": measured,
            "u ln 0-90": 0.01,
            "deviation ln 0-90": measured - predicted,
            "tolerance ln 0-90": tolerance,
            "drift": 0.001,
        },
    )


@pytest.fixture
def place(tmp_path, rng):
    rows = [row(k, rng, verdict="INVALID" if k == 7 else "PASS") for k in range(60)]
    with open_history(tmp_path / "h.sqlite") as history:
        history.append_all(rows)
    return tmp_path / "h.sqlite"


def test_all_columns_come_in_the_order_of_measurement(place):
    found = history_readings(place, Filters())
    assert found.labels[:2] == ("SN-0", "SN-1")
    assert found.texts["lot"][19:21] == ("L0", "L1")
    assert found.texts["station"][0] == ""
    assert charted(found) == ("ln 0-90", "deviation ln 0-90", "drift")
    assert np.flatnonzero(np.isnan(found.numbers["ln 0-90"])).tolist() == [7]
    assert len(history_readings(place, Filters(lot="L1"))) == 20
    assert history_readings(place, Filters(limit=3)).labels == ("SN-57", "SN-58", "SN-59")


def test_limits_are_those_that_the_history_remembers(place):
    found = history_readings(place, Filters())
    contrast = specification(found, "ln 0-90")
    assert (contrast.lower, contrast.upper) == (pytest.approx(0.4), pytest.approx(0.6))
    assert specification(found, "deviation ln 0-90") == Specification(-0.1, 0.1)
    assert specification(found, "drift") is None


def test_a_recipe_takes_the_place_of_what_is_remembered(place):
    found = history_readings(place, Filters())
    given = specification(found, "ln 0-90", {"ln 0-90": 0.2})
    assert (given.lower, given.upper) == (pytest.approx(0.3), pytest.approx(0.7))
    assert specification(found, "ln 0-90", {"ln 90-180": 0.2}) is None


def test_parts_of_two_recipes_have_no_common_limits(place, rng):
    with open_history(place) as history:
        history.append_all([row(100, rng, predicted=0.7)])
    found = history_readings(place, Filters())
    with pytest.raises(UsageError, match=r"predicted as 0\.5 to 0\.7"):
        specification(found, "ln 0-90")
    assert specification(found, "deviation ln 0-90") is not None
    with open_history(place) as history:
        history.append_all([row(101, rng, tolerance=0.3)])
    with pytest.raises(UsageError, match="choose one recipe"):
        specification(history_readings(place, Filters()), "deviation ln 0-90")


def test_nothing_to_chart_is_said(place, tmp_path):
    with pytest.raises(UsageError, match="no inspection of this kind"):
        history_readings(place, Filters(lot="none"))
    with pytest.raises(HistoryError, match="there is no history"):
        history_readings(tmp_path / "other.sqlite", Filters())
    assert not (tmp_path / "other.sqlite").exists()


def test_words_that_many_readings_have_are_kept_once(place):
    texts = history_readings(place, Filters()).texts
    assert texts["lot"][0] is texts["lot"][1]
    assert len({id(one) for one in texts["recipe"]}) == 1
