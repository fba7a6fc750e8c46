"""Readings from CSV files: what they hold, what is missing, and mistakes told with line and column."""

import numpy as np
import pytest

from anisoscope.base.errors import UsageError
from anisoscope.operations.statistics import msa_gauge
from anisoscope.quality.gauge import gauge_data
from anisoscope.quality.readings import read_readings

TEXT = """serial,lot,ln 0-90,drift,verdict
A1,7,0.5,0.01,PASS
A2,7,,0.02,FAIL

A3,8,0.7,0.03,INVALID
A4,8,nan,0.04,PASS
"""


@pytest.fixture
def made(tmp_path):
    def write(text):
        path = tmp_path / "readings.csv"
        path.write_text(text, encoding="utf-8")
        return path

    return write


def test_words_numbers_and_what_is_missing(made):
    found = read_readings(made(TEXT))
    assert list(found.numbers) == ["ln 0-90", "drift"]
    assert found.labels == ("A1", "A2", "A3", "A4")
    # A3 is INVALID: what was measured says nothing about the part
    np.testing.assert_array_equal(found.numbers["ln 0-90"], [0.5, np.nan, np.nan, np.nan])
    np.testing.assert_array_equal(found.numbers["drift"], [0.01, 0.02, np.nan, 0.04])
    assert found.number(None)[0] == "ln 0-90"
    assert len(found) == 4


def test_choosing_grouping_and_the_latest(made):
    found = read_readings(made(TEXT))
    assert found.only({"lot": "8", "serial": None}).labels == ("A3", "A4")
    assert {name: part.labels for name, part in found.grouped("lot").items()} == {
        "7": ("A1", "A2"),
        "8": ("A3", "A4"),
    }
    assert found.grouped(None)[""] is found
    assert found.latest(3).labels == ("A2", "A3", "A4")
    assert found.latest(0) is found
    assert len(found.latest(99)) == 4
    with pytest.raises(UsageError, match="no reading has lot 9"):
        found.only({"lot": "9"})
    with pytest.raises(UsageError, match="no column 'cavity'"):
        found.grouped("cavity")
    with pytest.raises(UsageError, match="there are: ln 0-90, drift"):
        found.number("ln 9-9")


def test_without_serials_times_or_places_name_the_readings(made):
    assert read_readings(made("time,x\n08:00,1\n,2\n")).labels == ("08:00", "#2")
    assert read_readings(made("x\n1\n2\n")).labels == ("#1", "#2")


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("", "line 1: the header"),
        ("a,a\n1,2\n", "line 1: the header must name every column"),
        ("serial,lot\nA,7\n", "line 1: there is no column of numbers"),
        ("x,y\n", "line 2: no readings"),
        ("x,y\n1,2\n3\n", "line 3: 2 values expected, 1 found"),
        ("x,y\n1,2\n\n3,4o\n", "line 4: y is not a number: '4o'"),
        ("x\n1\ninf\n", "line 3: x must be a finite number"),
    ],
)
def test_mistakes_are_told_with_line_and_column(made, text, word):
    with pytest.raises(UsageError, match=word) as raised:
        read_readings(made(text))
    assert "\n" not in str(raised.value)


def test_a_file_that_is_not_there(tmp_path):
    with pytest.raises(UsageError, match="cannot read"):
        read_readings(tmp_path / "none.csv")


GAUGE = "part,appraiser,value\nP1,A,1\nP2,A,2\nP1,B,3\nP2,B,4\nP1,A,5\nP2,A,6\nP1,B,7\nP2,B,8\n"


def test_a_gauge_study_is_sorted_by_part_and_appraiser(made):
    found = gauge_data(read_readings(made(GAUGE)))
    assert (found.parts, found.appraisers) == (("P1", "P2"), ("A", "B"))
    np.testing.assert_array_equal(found.values, [[[1, 5], [3, 7]], [[2, 6], [4, 8]]])


def test_serials_and_operators_serve_as_parts_and_appraisers(made):
    other = made(GAUGE.replace("part,appraiser", "serial,operator"))
    np.testing.assert_array_equal(gauge_data(read_readings(other)).values[1], [[2, 6], [4, 8]])
    alone = gauge_data(read_readings(made("part,x\nP1,1\nP2,2\nP1,3\nP2,5\n")))
    assert (len(alone.appraisers), alone.values.shape) == (1, (2, 1, 2))


def test_a_gauge_study_with_holes_is_one_with_missing_values(made):
    found = gauge_data(read_readings(made(GAUGE.replace("P2,B,4\n", "P2,B,\n") + "P1,B,9\n")))
    np.testing.assert_array_equal(found.values[0, 1], [3, 7, 9])
    np.testing.assert_array_equal(found.values[1, 1], [8, np.nan, np.nan])
    assert found.design == "unbalanced"
    nested = gauge_data(read_readings(made(GAUGE)), nested=True)
    assert (nested.parts[0], len(nested.parts), nested.design) == ("P1 of A", 4, "nested")
    with pytest.raises(UsageError, match="no column 'part'"):
        gauge_data(read_readings(made("x\n1\n2\n")))


def test_a_blank_line_of_one_column_is_a_missing_reading(tmp_path):
    path = tmp_path / "values.csv"
    path.write_text("value\n\n10\n11\n\n13\n12\n\n\n")
    np.testing.assert_array_equal(
        read_readings(path).numbers["value"], [np.nan, 10.0, 11.0, np.nan, 13.0, 12.0]
    )
    path.write_text("value,other\n10,1\n\n11,2\n\n")
    assert len(read_readings(path)) == 2


def test_headers_of_other_programs_name_the_same_columns(tmp_path):
    """As in the examples of statistics programs: capitals, blanks, and their own words."""
    path = tmp_path / "gauge.csv"
    for header in (
        "Part,Operator,Measurement",
        "Part ID,Inspector,Measurement",
        "part_no,APPRAISER,Measurement",
    ):
        rows = [f"{part},{whom},{part + 0.1 * trial}" for part in (1, 2) for whom in "AB" for trial in (1, 2)]
        path.write_text("\n".join([header, *rows]) + "\n")
        found = read_readings(path)
        assert list(found.numbers) == ["Measurement"]
        study = msa_gauge(found)
        assert (study.data.parts, study.data.appraisers) == (("1", "2"), ("A", "B"))
    path.write_text("Time,Serial Number,Batch,Height\n2026-11-01,A1,L1,1.0\n")
    assert set(read_readings(path).texts) == {"time", "serial", "lot"}
    path.write_text("Part,part,Height\n1,1,1.0\n")
    with pytest.raises(UsageError, match="each of them once"):
        read_readings(path)
