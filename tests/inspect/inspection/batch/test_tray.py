"""Tray lists: what is understood, and what is refused with its line and column."""

import pytest

from anisoscope.base.errors import UsageError
from anisoscope.history.aqdef import FIELD
from anisoscope.inspection.batch.tray import Slot, read_tray


def tray(tmp_path, text, encoding="utf-8"):
    path = tmp_path / "tray.csv"
    path.write_bytes(text.encode(encoding))
    return path


PLAIN = [Slot("1", "A17", "L 7", "2", line=2), Slot("2", "A18", line=3)]


@pytest.mark.parametrize(
    ("text", "encoding"),
    [
        ("slot,serial,lot,cavity\n1,A17,L 7,2\n2,A18,,\n", "utf-8"),
        ("slot;serial;lot;cavity\r\n1;A17;L 7;2\r\n2;A18;;\r\n", "utf-8-sig"),
        ("Slot\tSERIAL\tlot\tcavity\n1\tA17\tL 7\t2\n2\tA18\t\t\n", "utf-8"),
        ('"slot", "serial","lot","cavity"\n"1","A17","L 7","2"\n"2","A18","",""\n\n,,,\n', "utf-8"),
    ],
)
def test_separators_quotes_and_marks(tmp_path, text, encoding):
    assert list(read_tray(tray(tmp_path, text, encoding)).slots) == PLAIN


def test_a_hint_of_a_spreadsheet_and_further_columns_are_passed_over(tmp_path):
    found = read_tray(tray(tmp_path, "sep=;\nserial;colour;slot\nA17;red;1\n"))
    assert found.slots == (Slot("1", "A17", line=3),)
    assert "columns passed over: colour" in found.notes[0]


def test_quoted_fields_may_hold_separators_and_markup(tmp_path):
    found = read_tray(tray(tmp_path, 'slot,serial,lot\n1,A17,"a;b, [red]<b>"\n'))
    assert found.slots[0].lot == "a;b, [red]<b>"


def test_files_of_a_slot_count_from_the_list(tmp_path):
    (tmp_path / "sub").mkdir()
    (tmp_path / "sub" / "r.toml").touch()
    found = read_tray(tray(tmp_path, "slot,serial,recipe,rig\n1,,sub/r.toml,\n"))
    assert found.slots == (Slot("1", None, recipe=tmp_path / "sub" / "r.toml", line=2),)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "line 1: the file is empty"),
        ("slot,serail\n1,A\n", "line 1: the header has no column serial; is 'serail' meant?"),
        ("serial\nA\n", "line 1: the header has no column slot; it may have"),
        ("slot,serial,slot\n1,A,1\n", "line 1: the column slot stands twice"),
        ("slot,serial\n", "line 1: no slots follow the header"),
        ("slot,serial\n1,A\n2\n", "line 3: 2 values expected, 1 found"),
        ("slot,serial\n,A\n", "line 2, column slot: '' cannot name a slot"),
        ("slot,serial\n../1,A\n", "line 2, column slot: '../1' cannot name a slot"),
        ("slot,serial\n1,<b>\n", "line 2, column serial: the serial number '<b>' cannot be used"),
        ("slot,serial\n1,A\n\n2,A\n", "line 4, column serial: A stands already in line 2"),
        ("slot,serial\na1,A\nA1,B\n", "line 3, column slot: A1 stands already in line 2"),
        (
            "slot,serial,lot\n1,A,x\x1b[31m\n",
            "line 2, column lot: 'x\\x1b[31m' holds a sign that cannot be seen",
        ),
        ("slot,serial,lot\n1,A,a\u202eb\n", r"cannot be seen \(U\+202E\)"),
        ("slot,serial,lot\n1,A," + 201 * "x" + "\n", "line 2, column lot: longer than 200 signs"),
        ("slot,serial,recipe\n1,A,none.toml\n", "line 2, column recipe: there is no file"),
        ('slot,serial\n1,"A"x\n', "line 2: "),
    ],
)
def test_what_is_refused_is_named_by_line_and_column(tmp_path, text, said):
    with pytest.raises(UsageError) as caught:
        read_tray(tray(tmp_path, text))
    pattern = said if "\\(" in said else None
    assert "\n" not in str(caught.value)
    if pattern:
        assert caught.match(pattern)
    else:
        assert said in str(caught.value)


def test_no_text_at_all(tmp_path):
    with pytest.raises(UsageError, match="it is not UTF-8 text"):
        read_tray(tray(tmp_path, "slot,serial\n1,Ä\n", "latin-1"))
    with pytest.raises(UsageError, match="No such file"):
        read_tray(tmp_path / "none.csv")


AQDEF = """K0100 1
K1001 plate
K2001/1 1
K2002/1 length
{values}"""


def aqdef(tmp_path, *values):
    path = tmp_path / "parts.dfq"
    path.write_text(AQDEF.format(values="\n".join(values) + "\n"))
    return path


def test_parts_of_aqdef_are_in_slots_in_their_order(tmp_path):
    path = aqdef(tmp_path, "K0014/0 P-7", f"10.1{FIELD}0{FIELD}{FIELD}{FIELD}#L7", "K0014/0 P-9", "10.2")
    found = read_tray(path)
    assert found.slots == (
        Slot("1", "P-7", "L7", line=1),
        Slot("2", "P-9", line=2),
    )
    assert not found.placed
    assert found.sha256 == read_tray(path).sha256


@pytest.mark.parametrize(
    ("values", "said"),
    [
        (("10.1",), r"parts\.dfq: no serial numbers of parts \(K0014\)"),
        (
            ("K0014/0 A", "1", "K0014/0 A", "2"),
            r"part 2, column serial: A stands already in part 1",
        ),
        (("K0014/0 A", "1", "2"), r"part 2, K0014: "),
    ],
)
def test_aqdef_without_a_serial_number_for_each_part_is_refused(tmp_path, values, said):
    with pytest.raises(UsageError, match=said):
        read_tray(aqdef(tmp_path, *values))
