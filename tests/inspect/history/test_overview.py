"""Facts of all inspections in memory, against the rows themselves."""

from collections import Counter
from datetime import timedelta

import numpy as np
import pytest

from anisoscope.base.errors import UsageError
from anisoscope.history.filters import MOST_IDS, Filters
from anisoscope.history.overview import Overview, cause_of
from anisoscope.history.rows import numbers_of
from anisoscope.history.store import open_history
from anisoscope.record.schema import CauseRecord, DiagnosisRecord, read_record

COUNT = 60


@pytest.fixture
def filled(history, new_row):
    def row(number):
        changes = {"station": None} if number % 7 == 0 else {"station": f"line {number % 3}"}
        if number % 10 == 2:
            changes["numbers"] = {"ln 0-90": 2.0, "cause haze": 0.9}
        # some come late: a station that was offline delivers what waited
        return new_row(number, **changes | {"created_at": new_row(number * 37 % COUNT).created_at})

    history.append_all([row(number) for number in range(COUNT)])
    return history


CHOICES = [
    Filters(),
    Filters(verdict="FAIL"),
    Filters(lot="L1", cavity="2"),
    Filters(station="line 2", product="ridged plate"),
    Filters(station="none"),
]


@pytest.mark.parametrize("filters", CHOICES, ids=str)
def test_what_matches_are_the_rows_of_the_same_filters_in_their_order(filled, filters, new_row):
    facts = Overview().facts(filled)
    for since, until in ((None, None), (20, 40)):
        bounds = {"since": since and new_row(since).created_at, "until": until and new_row(until).created_at}
        chosen = Filters(
            **{name: getattr(filters, name) for name in ("verdict", "lot", "cavity", "station")}, **bounds
        )
        places = facts.ordered(facts.matching(chosen))
        assert facts.ids[places].tolist() == [row.id for row in filled.rows(chosen)]


def test_counts_are_those_of_the_rows(filled):
    facts = Overview().facts(filled)
    every = np.ones(COUNT, dtype=bool)
    rows = filled.rows()
    assert facts.counts("station", every) == Counter(row.station or "" for row in rows)
    assert facts.counts("verdict", every) == Counter(row.verdict for row in rows)
    assert sum(facts.counts("cause", every).values()) == COUNT
    assert facts.counts("cause", every)[""] == sum(row.verdict == "PASS" for row in rows)
    by_cause = facts.ids[facts.ordered(facts.matching(Filters(), "haze"))].tolist()
    assert by_cause == [row.id for row in rows if "cause haze" in row.numbers and row.verdict != "PASS"]
    assert len(by_cause) == COUNT // 10


def test_only_what_came_since_is_read_again(filled, new_row, monkeypatch):
    overview, read = Overview(), []
    part = Overview._part
    monkeypatch.setattr(
        Overview, "_part", lambda self, rows, labels: read.append(len(rows)) or part(self, rows, labels)
    )
    first = overview.facts(filled)
    assert overview.facts(filled) is first
    filled.append(new_row(COUNT, station="new"))
    grown = overview.facts(filled)
    assert read == [COUNT, 1]
    assert len(grown) == COUNT + 1
    assert grown.counts("station", grown.matching(Filters(station="new"))) == {"new": 1}
    assert len(first) == COUNT


def test_another_history_in_its_place_is_read_anew(tmp_path, new_row):
    overview = Overview()
    with open_history(tmp_path / "one.sqlite") as one, open_history(tmp_path / "two.sqlite") as two:
        assert len(overview.facts(one)) == 0
        one.append_all([new_row(number) for number in range(5)])
        two.append_all([new_row(number, station="west") for number in range(10, 18)])
        assert len(overview.facts(one)) == 5
        found = overview.facts(two)
    assert found.counts("station", np.ones(8, dtype=bool)) == {"west": 8}


def test_reasons_that_differ_in_their_numbers_are_one_cause():
    one, two = (
        cause_of((), (f"ln ratio 0° / {to}°, tilt 0° deviates by {by} (tolerance ±0.25, guard band 0.08)",))
        for to, by in ((90, "-0.023"), (180, "+1.2e-03"))
    )
    assert one == two == "ln ratio …° / …°, tilt …° deviates by …"
    assert cause_of(("d2", "cause seating-x"), ("whatever",)) == "seating-x"
    assert cause_of((), ()) == "no reason recorded"
    assert len(cause_of((), (200 * "x",))) == 120


def test_a_diagnosed_cause_enters_the_history_of_parts_that_did_not_pass(inspected):
    cause = CauseRecord(
        cause="haze",
        title="haze",
        unit="",
        severity=0.1,
        u=0.01,
        weight=0.8,
        chi2=1.0,
        at_bound=False,
        tie=False,
    )
    record = read_record(inspected())
    for verdict, name, labels in (
        ("FAIL", "haze", ["cause haze"]),
        ("FAIL", "nothing", []),
        ("PASS", "haze", []),
    ):
        diagnosis = DiagnosisRecord(says="", causes=(cause.model_copy(update={"cause": name}),))
        found = numbers_of(record.model_copy(update={"verdict": verdict, "diagnosis": diagnosis}))
        assert [label for label in found if label.startswith("cause ")] == labels
    assert (
        numbers_of(record.model_copy(update={"verdict": "FAIL", "diagnosis": DiagnosisRecord(says="")}))["d2"]
        == 4.0
    )


def test_inspections_are_selected_by_their_ids(filled, new_row):
    assert sorted(row.id for row in filled.rows(Filters(ids=(3, 1, 999)))) == [1, 3]
    assert filled.rows(Filters(ids=())) == []
    late = Filters(ids=(1, 2, 3), since=new_row(0).created_at + timedelta(minutes=30))
    assert {row.id for row in filled.rows(late)} < {1, 2, 3}
    with pytest.raises(UsageError, match="names 5000 ids at most"):
        filled.rows(Filters(ids=tuple(range(MOST_IDS + 1))))
