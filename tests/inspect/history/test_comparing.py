"""Two inspections side by side."""

import math
import shutil
from itertools import product
from pathlib import Path

import pytest

from anisoscope.base.errors import RecordError, UsageError
from anisoscope.history.adding import add_folders
from anisoscope.history.comparing import MAX_CHANGES, Change, compare
from anisoscope.inspection.run import Inspected
from anisoscope.record.schema import read_record


@pytest.fixture
def pair(sqlite_history, inspected):
    """Two inspections of one part, between which some things changed."""
    folders = [
        inspected("A1", name="first"),
        inspected(
            "A1",
            name="second",
            software="anisoscope 0.2.0",
            created_at="2026-11-02T06:00:00+00:00",
            recipe={"product": "ridged plate", "decision": {"tolerance": 0.3, "alpha": 0.01}},
            rig={"name": "rig", "poses": [0, 45]},
            inputs=(
                {"name": "inputs/recipe.toml", "sha256": "beef" * 16},
                {"name": "inputs/flat.tif", "sha256": "f1a7" * 16},
            ),
        ),
    ]
    add_folders(sqlite_history, folders)
    return sqlite_history.rows()


def test_contrasts_differ_by_so_much_of_their_combined_uncertainty(sqlite_history, new_row):
    numbers = {"ln 0-90": 2.1, "u ln 0-90": 0.03, "only here": 1.0, "d2": 1.0}
    first, second = sqlite_history.append_all(
        [
            new_row(1, numbers=numbers),
            new_row(2, numbers={"ln 0-90": 2.2, "u ln 0-90": 0.04, "d2": 4.0, "deviation ln 0-90": 0.1}),
        ]
    )
    found = compare(first, second)
    (one,) = found.contrasts
    assert (one.label, one.first, one.second) == ("ln 0-90", 2.1, 2.2)
    assert one.difference == pytest.approx(0.1)
    assert one.u == pytest.approx(math.hypot(0.03, 0.04))
    assert one.ratio == pytest.approx(2.0)
    rest = {one.label: one for one in found.numbers}
    assert set(rest) == {"only here", "d2"}
    assert (rest["only here"].second, rest["only here"].difference) == (None, None)
    assert (rest["d2"].difference, rest["d2"].u, rest["d2"].ratio) == (3.0, None, None)


def test_what_changed_in_recipe_rig_calibration_and_software(pair):
    found = compare(*pair)
    changes = {change.what: (change.first, change.second) for change in found.changes}
    assert changes["software"] == ("anisoscope 0.1.0", "anisoscope 0.2.0")
    assert changes["recipe"] == ("ridged plate 5eed5eed5eed", "ridged plate beefbeefbeef")
    assert changes["recipe: decision.tolerance"] == ("0.25", "0.3")
    assert changes["recipe: decision.alpha"] == (None, "0.01")
    assert changes["rig: poses[1]"] == ("90", "45")
    assert changes["file inputs/flat.tif"] == (None, "f1a7f1a7f1a7")
    assert "rig: name" not in changes
    assert found.notes == ()
    assert compare(pair[0], pair[0]).changes == ()


def test_records_inspections_folders_and_rows_compare_alike(pair, tmp_path):
    """In any mixture; an inspection that just ended is what has a record and a folder."""
    changes = compare(*pair).changes
    assert len(changes) > 3
    folders = [Path(row.folder) for row in pair]
    records = [read_record(folder) for folder in folders]
    ended = [
        Inspected(record, folder, folder / "report.html")
        for record, folder in zip(records, folders, strict=True)
    ]
    forms = [[str(folder) for folder in folders], folders, records, ended, pair]
    for form, other in product(forms, forms):
        found = compare(form[0], other[1])
        assert found.changes == changes
        assert found.notes == ()
        assert (found.first.serial, found.second.software) == ("A1", "anisoscope 0.2.0")
    numbers = [one.label for one in compare(*pair).numbers]
    assert [one.label for one in compare(*records).numbers] == numbers


@pytest.mark.parametrize("other", [3, None, {"record": 1}])
def test_what_is_no_inspection_is_refused(pair, other):
    with pytest.raises(UsageError, match="compare takes two inspections, each a row of a history, a record"):
        compare(pair[0], other)


def test_a_folder_without_a_record_is_refused(pair, tmp_path):
    with pytest.raises(RecordError, match="cannot read"):
        compare(pair[0], tmp_path)


def test_without_the_folders_the_history_alone_is_compared(pair, tmp_path):
    shutil.rmtree(tmp_path / "inspections" / "second")
    found = compare(*pair)
    assert Change("software", "anisoscope 0.1.0", "anisoscope 0.2.0") in found.changes
    assert not any(change.what.startswith("rig:") for change in found.changes)
    assert len(found.notes) == 1
    assert "second" in found.notes[0]


def test_more_changes_than_anybody_reads(sqlite_history, inspected):
    many = {str(number): number for number in range(60)}
    folders = [inspected("A1", recipe={}), inspected("A2", recipe=many)]
    add_folders(sqlite_history, folders)
    found = compare(*sqlite_history.rows())
    assert len(found.changes) == MAX_CHANGES
    assert found.notes == (f"{60 - MAX_CHANGES} more things differ",)
