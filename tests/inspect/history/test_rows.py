"""What the history remembers of a record."""

import json
from datetime import UTC, datetime

import pytest

from anisoscope.base.errors import RecordError
from anisoscope.history.columns import columns_of, labels_of, row_from
from anisoscope.history.problems import HistoryError
from anisoscope.history.rows import numbers_of, row_of, seal_of
from anisoscope.record.schema import RECORD_NAME, read_record


def contrast(record, **changes):
    return record.details.contrasts[0].model_copy(update=changes)


def test_a_row_says_what_the_record_says(inspected):
    folder = inspected()
    record = read_record(folder)
    row = row_of(record, folder)
    assert (row.serial, row.lot, row.cavity, row.station, row.operator) == ("A1", "L1", "3", None, "M. M.")
    assert row.created_at == datetime(2026, 11, 1, 6, 0, tzinfo=UTC)
    assert row.recipe == "ridged plate 5eed5eed5eed"
    assert row.seal == json.loads((folder / RECORD_NAME).read_text())["seal"]
    assert (row.verdict, row.reasons) == ("PASS", record.reasons)
    assert row.folder == str(folder.resolve())


def test_contrasts_are_called_by_kind_angles_and_tilt(inspected):
    record = read_record(inspected())
    kinds = (
        contrast(record),
        contrast(record, tilt_deg=10.0, kind="michelson", tolerance=None),
        contrast(record, from_deg=90.0, to_deg=180.0, tilt_deg=-7.5, kind="difference"),
    )
    found = numbers_of(
        record.model_copy(update={"details": record.details.model_copy(update={"contrasts": kinds})})
    )
    assert found["ln 0-90"] == 2.1
    assert found["u ln 0-90"] == 0.05
    assert found["deviation ln 0-90"] == pytest.approx(0.1)
    assert found["tolerance ln 0-90"] == 0.25
    assert "Michelson 0-90 @10" in found
    assert "tolerance Michelson 0-90 @10" not in found
    assert "difference 90-180 @-7.5" in found
    assert (found["d2"], found["p"]) == (4.0, 0.05)
    assert "area share" not in found


def test_an_inspection_that_could_not_be_judged_has_no_numbers(inspected):
    folder = inspected(verdict="INVALID", contrasts=(), d2=None, p_value=None)
    assert row_of(read_record(folder), folder).numbers == {}


def test_a_changed_recipe_has_another_identity_whatever_its_product_is_called(inspected):
    first, second = (
        inspected("A1"),
        inspected("A2", inputs=({"name": "inputs/recipe.toml", "sha256": "beef" * 16},)),
    )
    rows = [row_of(read_record(folder), folder) for folder in (first, second)]
    assert rows[0].product == rows[1].product
    assert rows[0].recipe != rows[1].recipe


def test_long_reasons_are_shortened_and_say_so(inspected):
    reasons = tuple(f"reason {number} " + 60 * "x" for number in range(20))
    folder = inspected(reasons=reasons)
    kept = row_of(read_record(folder), folder).reasons
    assert kept[: len(kept) - 1] == reasons[: len(kept) - 1]
    assert kept[-1] == f"… {20 - len(kept) + 1} more in the record"
    assert sum(map(len, kept)) < 500


def test_text_that_databases_refuse_is_made_storable(inspected):
    folder = inspected(particulars={"lot": "a\0b", "operator": 500 * "é"})
    row = row_of(read_record(folder), folder)
    assert row.lot == "a\ufffdb"
    assert len(row.operator) == 200


def test_a_folder_without_a_record(tmp_path):
    with pytest.raises(RecordError, match="was this inspection finished"):
        seal_of(tmp_path)


def test_a_damaged_row_is_named(inspected):
    folder = inspected()
    new = row_of(read_record(folder), folder)
    values = columns_of(new, None) | {"id": 7, "labels": labels_of(new), "hash": bytes(32)}
    assert row_from(values, None).serial == "A1"
    for damage in (
        {"reasons": "["},
        {"numbers": b"abc"},
        {"labels": "{"},
        {"numbers": b""},
        {"created_us": None},
    ):
        with pytest.raises(
            HistoryError, match=r"inspection 7 of the history is damaged \(.+\): its record is in"
        ):
            row_from(values | damage, None)
