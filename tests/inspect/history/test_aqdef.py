"""AQDEF: files read back by another program's reader, round trips, and wrong files that are refused by name."""

import math
import warnings
from datetime import datetime

import numpy as np
import pytest

from anisoscope.base.errors import UsageError
from anisoscope.history.aqdef import MARK, AqdefFile, description_lines, read_aqdef, value_lines
from anisoscope.quality.capability import specification
from anisoscope.quality.readings import read_readings

with warnings.catch_warnings():
    warnings.simplefilter("ignore", DeprecationWarning)  # the reader imports a name that chardet moved
    import aqdefreader

NAN = math.nan
FILE = AqdefFile(
    "plate 7",
    {
        "time": ("13.11.2026/08:00:00", "14.11.2026/09:30:15", "25.12.2026/23:59:59"),
        "serial": ("A1", "", "A3"),
        "lot": ("L1", "L1", "L2"),
        "cavity": ("2", "1", "2"),
        "operator": ("Ada", "", "Grace"),
        "station": ("north", "north", "south"),
        "verdict": ("PASS", "INVALID", "FAIL"),
    },
    {"ln 0-90": np.array([1.25, NAN, -1.5e-7]), "ln 0-180": np.array([0.1, NAN, NAN])},
    {"ln 0-90": (1.0, 1.5), "ln 0-180": (None, 0.2)},
    {"ln 0-90": 1.25},
    {"ln 0-90": "1", "ln 0-180": "deg"},
)


def encoded(lines):
    """A file as the export writes it."""
    text = "".join(lines)
    return (text if text.startswith(MARK) else MARK + text).encode()


def written(folder, found=FILE, *, apart=False):
    """Path of the file, or of the description of two."""
    if not apart:
        path = folder / "parts.dfq"
        path.write_bytes(encoded([*description_lines(found), *value_lines(found)]))
        return path
    (folder / "parts.dfx").write_bytes(encoded(value_lines(found)))
    path = folder / "parts.dfd"
    path.write_bytes(encoded(description_lines(found)))
    return path


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # the reader leaves files open
def test_another_program_reads_values_limits_and_numbers_of_catalogues(tmp_path, capsys):
    read = aqdefreader.read_dfq_file(written(tmp_path))
    said = capsys.readouterr().out
    assert "utf-8" in said
    assert "Warning" not in said
    assert read.part_count() == 1
    part = read.get_part(0)
    assert part.get_data("K1001") == "plate 7"
    first, second = part.get_characteristics()
    assert (first.get_data("K2002"), second.get_data("K2002")) == ("ln 0-90", "ln 0-180")
    assert [str(one.get_data("K2142")) for one in (first, second)] == ["1", "deg"]
    assert [float(first.get_data(key)) for key in ("K2101", "K2110", "K2111")] == [1.25, 1.0, 1.5]
    assert (second.get_data("K2110"), float(second.get_data("K2111"))) == (None, 0.2)
    one, other = first.get_measurements()  # the INVALID inspection is no measurement
    assert [found.value for found in (one, other)] == [1.25, -1.5e-7]
    assert (one.batch_no, one.nest_no, one.controller_no, one.machine_no) == ("L1", 1, 1, 1)
    assert (other.batch_no, other.nest_no, other.controller_no, other.machine_no) == ("L2", 1, 2, 2)
    assert one.datetime == datetime(2026, 11, 13, 8)  # noqa: DTZ001 - the format has no zone
    assert [found.value for found in second.get_measurements()] == [0.1]


@pytest.mark.parametrize("apart", [False, True])
def test_what_was_written_is_read(tmp_path, apart):
    path = written(tmp_path, apart=apart)
    for named in {path, path.with_suffix(".dfx") if apart else path}:
        found = read_aqdef(named)
        assert found.product == "plate 7"
        assert (found.limits, found.nominal, found.units) == (FILE.limits, FILE.nominal, FILE.units)
        assert list(found.numbers) == list(FILE.numbers)
        for name, values in FILE.numbers.items():
            np.testing.assert_array_equal(found.numbers[name], values)
        times = ("2026-11-13 08:00:00", "2026-11-14 09:30:15", "2026-12-25 23:59:59")
        assert found.texts == {**FILE.texts, "time": times}


def test_statistics_take_the_file_with_its_limits(tmp_path):
    readings = read_readings(written(tmp_path))
    assert readings.labels == ("A1", "#2", "A3")
    assert readings.column("operator") == ("Ada", "", "Grace")
    limits = specification(readings.only({"station": "north"}), "ln 0-90")
    assert (limits.lower, limits.upper) == (1.0, 1.5)
    with pytest.raises(UsageError, match="no values"):
        described = tmp_path / "only.dfd"
        described.write_bytes(encoded(description_lines(FILE)))
        read_readings(described)


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # the reader leaves files open
def test_letters_of_all_languages_are_written_in_utf_8_with_its_mark(tmp_path, capsys):
    name = "Łódź\x14\n3"
    found = AqdefFile("p", {"operator": (name,)}, {"x": np.array([1.0])}, {}, {})
    path = written(tmp_path, found)
    assert path.read_bytes()[:3] == b"\xef\xbb\xbf"
    assert read_aqdef(path).texts["operator"] == ("Łódź  3",)
    latin = written(tmp_path, AqdefFile("Gehäuse µ", {}, {"x": np.array([1.0])}, {}, {}))
    assert read_aqdef(latin).product == "Gehäuse µ"
    assert aqdefreader.read_dfq_file(latin).get_part(0).get_data("K1001") == "Gehäuse µ"
    assert "utf-8" in capsys.readouterr().out


def test_files_of_other_programs(tmp_path):
    """Other times, decimal commas, no catalogue, fewer fields, a byte order mark."""
    path = tmp_path / "p.dfq"
    path.write_text(
        "K0100 2\nK1001 12\nK1002 housing\nK2002/1 a\nK2101/1 1,5\nK2002/2 b\nK2142/2 mm\n"
        "1,25\x140\x142026-01-02/03:04:05\x14\x14#L1\x140\x147\x140\x0f2\n1,5\x0f3\x14256\n",
        encoding="utf-16",
    )
    found = read_aqdef(path)
    assert found.nominal == {"a": 1.5}
    assert found.numbers["a"].tolist() == [1.25, 1.5]
    assert found.numbers["b"][0] == 2.0
    assert math.isnan(found.numbers["b"][1])
    assert found.texts == {"time": ("2026-01-02 03:04:05", ""), "lot": ("L1", ""), "operator": ("7", "")}


def test_limits_as_other_programs_write_them(tmp_path):
    """Allowances, natural limits, what holds for all characteristics, letters of Windows, keys that are not used."""
    path = tmp_path / "p.dfd"
    lines = (
        *("K0100 4", "K0101 2", "K1001/1 0 433 171 914", "K1002/1 Gehäuse", "K1053/1 20181030", "K2022/0 3"),
        *("K2142/0 mm", "K2001/1 1", "K2002/1 Länge", "K2101/1 152,019", "K2112/1 -,02", "K2113/1 0.2"),
        *("K2001/2 2", "K2002/2 Ebenheit", "K2110/2 0", "K2111/2 0.05", "K2120/2 2", "K2121/2 1"),
        *("K2001/3 3", "K2101/3 50.45", "K2110/3 50.30", "K2111/3 5.06E+01", "K2112/3 -0.15", "K5001/1 0"),
        *("K2001/4 D67 H9", "K2101/4 67", "K2111/4 67.074"),
    )
    path.write_bytes("\r\n".join(lines).encode("cp1252"))
    found = read_aqdef(path)
    assert found.product == "0 433 171 914"
    assert found.limits == {
        "Länge": (pytest.approx(151.999, abs=1e-9), pytest.approx(152.219, abs=1e-9)),
        "Ebenheit": (None, 0.05),
        "3": (50.30, 50.6),
        "D67 H9": (None, 67.074),
    }


HEAD = "K0100 1\nK1001 p\nK2002/1 a\n"


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("K0100 1\nK1001 p\n", "no characteristic"),
        ("K0100 2\nK2002/1 a\n", "K0100 says 2 characteristics, 1 are described"),
        ("K0100 2\nK2002/1 a\nK2002/2 a\n", "two characteristics are named 'a'"),
        ("1.5\n", "line 1: values before any characteristic"),
        (HEAD + "1.5\x0f2\n", "line 4: 1 characteristics are described, 2 values found"),
        (HEAD + "high\n", "line 4: 'high' is not a finite number"),
        (HEAD + "1\x140\x14yesterday\n", "line 4: 'yesterday' is no time"),
        (
            HEAD + "K4092/1 Ada\n1\x140\x14\x14\x14\x140\x142\n",
            "line 5: operator 2 is not in the catalogue K4092",
        ),
        (
            HEAD + "K4063/2 north\n1\x140\x14\x14\x14\x140\x140\x141\n",
            "station 1 is not in the catalogue K4063",
        ),
        (HEAD + "1\x140\x14\x14\x14\x14left\n", "cavity 'left' is no number of the catalogue K4252"),
        (HEAD + "K1001/2 q\n", "line 4: a second part"),
        (HEAD + "K0001/1 1.5\n", "line 4: values by keys"),
        (HEAD + "Kilo 1\n", "line 4: 'Kilo' is no key"),
        (HEAD + "K2112/1 -0.1\n", "'a' has the allowance K2112 and no nominal value"),
        (HEAD + "K2110/1 low\n", "K2110: 'low' is not a finite number"),
    ],
)
def test_a_wrong_file_is_refused_by_name(tmp_path, text, word):
    path = tmp_path / "w.dfq"
    path.write_text(text)
    with pytest.raises(UsageError, match=word):
        read_aqdef(path)


def test_a_missing_file_is_one_line(tmp_path):
    with pytest.raises(UsageError, match="cannot read"):
        read_aqdef(tmp_path / "none.dfx")
