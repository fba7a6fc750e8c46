"""CSV files with semicolons and decimal commas: written on request, read as they are."""

import numpy as np
import pytest

from anisoscope.base.csv_style import CsvReader, csv_text, number_text, writing
from anisoscope.base.csv_table import read_table
from anisoscope.base.errors import UsageError
from anisoscope.quality.readings import read_readings


def test_a_table_in_either_style_reads_the_same(tmp_path):
    found = []
    for style in ("comma", "semicolon"):
        path = tmp_path / f"{style}.csv"
        with writing(style):
            rows = [
                ["serial", "height"],
                ["A1,5", number_text("-1.25e-3")],
                ["B; 2", number_text("7.5")],
                ["C", ""],
            ]
            path.write_bytes(csv_text(rows, line_end="\r\n").encode())
        found.append(read_readings(path))
    assert b'\r\nA1,5;-1,25e-3\r\n"B; 2";7,5\r\n' in path.read_bytes()
    assert found[0].texts["serial"] == found[1].texts["serial"] == ("A1,5", "B; 2", "C")
    np.testing.assert_array_equal(found[0].numbers["height"], [-1.25e-3, 7.5, np.nan])
    np.testing.assert_array_equal(found[1].numbers["height"], found[0].numbers["height"])


def test_tables_of_numbers_take_one_decimal_mark(tmp_path):
    path = tmp_path / "table.csv"
    path.write_text("a;b\n1,5;2\n\n3;4,25\n")
    assert read_table(path, (("a", "b"),)).rows.tolist() == [[1.5, 2.0], [3.0, 4.25]]
    path.write_text("a;b\n1.5;2\n")
    assert read_table(path, (("a", "b"),)).rows.tolist() == [[1.5, 2.0]]


@pytest.mark.parametrize("rows", ["1,5;2\n1.5;2", "1.000,5;2", "1,000.5;2", "1,000,5;2"])
def test_what_could_be_read_in_two_ways_is_refused(rows, tmp_path):
    path = tmp_path / "table.csv"
    path.write_text(f"a;b\n{rows}\n")
    with pytest.raises(UsageError, match=r"table\.csv"):
        read_table(path, (("a", "b"),))


def test_a_field_beyond_all_measure_is_one_line(tmp_path):
    reader = CsvReader("a,b\n1," + 200_000 * "x" + "\n", tmp_path / "a.csv")
    assert next(reader) == ["a", "b"]
    with pytest.raises(UsageError, match=r"a\.csv, line 2: field larger than field limit"):
        next(reader)
