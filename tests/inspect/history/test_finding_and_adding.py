"""Inspections enter the history from their folders, and are found again."""

import shutil

import pytest

from anisoscope.base.errors import RecordError, UsageError
from anisoscope.history.adding import add_folders, finished_folders
from anisoscope.history.comparing import record_of
from anisoscope.history.store import find
from anisoscope.record.schema import RECORD_NAME


def test_a_whole_tree_enters_once(sqlite_history, inspected, tmp_path):
    folders = [inspected(f"A{number}", name=f"deep/{number}/A{number}") for number in range(5)]
    first = add_folders(sqlite_history, [tmp_path])
    assert (first.added, first.known, first.refused) == (5, 0, ())
    inspected("B1")
    again = add_folders(sqlite_history, [tmp_path, folders[0]])
    assert (again.added, again.known, again.refused) == (1, 5, ())
    assert sqlite_history.count() == 6
    assert sqlite_history.verify_chain() == []


def test_a_copy_of_a_folder_is_the_same_inspection(sqlite_history, inspected, tmp_path):
    folder = inspected("A1")
    shutil.copytree(folder, tmp_path / "inspections" / "copy")
    found = add_folders(sqlite_history, [tmp_path])
    assert (found.added, found.known) == (1, 1)


def test_a_damaged_record_is_named_and_keeps_nobody_else_out(sqlite_history, inspected, tmp_path):
    bad, good = inspected("A1"), inspected("A2")
    path = bad / RECORD_NAME
    path.write_text(path.read_text().replace('"PASS"', '"FAIL"', 1))
    found = add_folders(sqlite_history, [tmp_path])
    assert found.added == 1
    assert len(found.refused) == 1
    assert f"{path} is damaged" in found.refused[0]
    assert [row.folder for row in sqlite_history.rows()] == [str(good)]


def test_unfinished_inspections_are_no_inspections(sqlite_history, tmp_path):
    (tmp_path / "A1").mkdir()
    (tmp_path / "A1" / "job.json").write_text("{}")
    assert finished_folders([tmp_path]) == []
    assert add_folders(sqlite_history, [tmp_path]).added == 0
    with pytest.raises(UsageError, match="there is no such folder"):
        add_folders(sqlite_history, [tmp_path / "none"])


def test_found_by_serial_id_and_folder(sqlite_history, inspected, tmp_path):
    folder = inspected("A1")
    inspected("A1", name="later", created_at="2026-11-02T06:00:00+00:00")
    add_folders(sqlite_history, [tmp_path])
    later = find(sqlite_history, "A1")
    assert later.folder.endswith("later")
    first = find(sqlite_history, str(folder))
    assert first.id != later.id
    assert find(sqlite_history, str(first.id)) == find(sqlite_history, f"id:{first.id}") == first


def test_a_number_that_could_be_both_is_asked_about(sqlite_history, new_row):
    sqlite_history.append_all([new_row(1), new_row(2, serial="1")])
    with pytest.raises(UsageError, match="say id:1 or serial:1"):
        find(sqlite_history, "1")
    assert find(sqlite_history, "id:1").serial == "A1"
    assert find(sqlite_history, "serial:1").id == 2


@pytest.mark.parametrize(
    "name", ["nobody", "99", "id:x", "id:", "serial:", "", "²", "9" * 40, "a\0b", "' OR 1=1"]
)
def test_nothing_is_found(sqlite_history, new_row, name):
    sqlite_history.append(new_row(1))
    with pytest.raises(UsageError, match="has no inspection"):
        find(sqlite_history, name)


def test_a_folder_that_was_not_added(sqlite_history, inspected):
    folder = inspected("A1")
    with pytest.raises(UsageError, match=f"`anisoscope history add {folder}` adds it"):
        find(sqlite_history, str(folder))


def test_the_record_of_a_row_is_the_one_that_was_added(sqlite_history, inspected, tmp_path):
    folder = inspected("A1")
    add_folders(sqlite_history, [tmp_path])
    row = find(sqlite_history, "A1")
    assert record_of(row).serial == "A1"
    other = inspected("A2")
    shutil.copy(other / RECORD_NAME, folder / RECORD_NAME)
    with pytest.raises(RecordError, match="another record than the history knows"):
        record_of(row)
