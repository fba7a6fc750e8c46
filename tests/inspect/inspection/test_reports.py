"""Reports after the record: in the background, sealed by a line of their own, made again after a kill."""

import subprocess
import threading
from dataclasses import replace

import pytest

from anisoscope.base.errors import RecordError
from anisoscope.inspection.integrity import verify
from anisoscope.inspection.report_seal import report_state, write_report_sealed
from anisoscope.inspection.reports import WAITING, PendingReport, Reports
from anisoscope.inspection.run import missing_report, resume_part, write_report_again
from anisoscope.record.schema import read_record

REPORT, SEAL = "report.html", "report.sha256"


@pytest.fixture
def finished(inspected_part):
    """The folder of a finished inspection."""
    return inspected_part[1].folder


def without_report(folder):
    """As a program leaves it that was killed between record and report."""
    for name in (REPORT, SEAL):
        (folder / name).unlink()
    return folder


def pending(folder, page="page", discarded=None, before=lambda: None):
    def make():
        before()
        return page, ()

    return PendingReport(folder, make, lambda: None if discarded is None else discarded.append(folder))


@pytest.fixture
def folders(tmp_path):
    """``folders(n)``: folders with a record, as far as a report is concerned."""

    def make(count):
        made = [tmp_path / str(number) for number in range(count)]
        for folder in made:
            folder.mkdir()
            (folder / "record.json").write_text(folder.name)
        return made

    return make


def test_the_record_is_on_disk_before_the_report_is_made(virtual_rig, plain):
    rig, seen = virtual_rig(), []

    def look(record, _pictures, folder, *_):
        seen.append((read_record(folder), verify(folder).intact, (folder / REPORT).exists()))
        return record.verdict

    found = rig.inspect(methods=replace(plain, page=look))
    assert seen == [(found.record, True, False)]
    assert (verify(found.folder).intact, found.report.read_text()) == (True, "PASS")
    assert REPORT not in {file.name for file in found.record.files}


def test_a_report_that_fails_is_a_note_and_can_be_written_later(virtual_rig, plain):
    def full(*_):
        raise OSError(28, "No space left on device")

    found = virtual_rig().inspect(methods=replace(plain, page=full))
    assert (found.record.verdict, found.report.exists()) == ("PASS", False)
    assert "No space left on device; `anisoscope report" in found.notes[-1]
    assert (verify(found.folder).intact, verify(found.folder).report_written) == (True, False)


def test_a_report_is_made_again_after_a_kill(finished):
    (without_report(finished) / f".{REPORT}.partial").write_bytes(b"half")
    assert verify(finished).intact
    assert not verify(finished).report_written
    with pytest.raises(RecordError, match="its report is missing: `anisoscope report"):
        resume_part(finished)
    assert missing_report(finished) is not None
    assert write_report_again(finished) == "made again from the frames"
    assert missing_report(finished) is None
    page = (finished / REPORT).read_text(encoding="utf-8")
    assert read_record(finished).serial in page
    assert verify(finished).intact
    assert not (finished / f".{REPORT}.partial").exists()
    assert write_report_again(finished) == "as the inspection wrote it"
    assert (finished / REPORT).read_text(encoding="utf-8") == page


@pytest.mark.parametrize(
    ("damage", "name"),
    [
        (lambda folder: (folder / REPORT).write_text("all is well"), REPORT),
        (lambda folder: (folder / SEAL).unlink(), REPORT),
        (lambda folder: (folder / SEAL).write_text("nothing\n"), SEAL),
        (lambda folder: (folder / SEAL).write_bytes(b"\xff"), SEAL),
        (lambda folder: write_report_sealed(folder, "x") and another_record(folder), SEAL),
    ],
    ids=["report", "no seal", "damaged seal", "no text", "seal of another record"],
)
def test_a_changed_report_or_seal_is_named(finished, damage, name):
    damage(finished)
    found = verify(finished)
    assert (found.changed, found.intact) == ((name,), False)
    assert report_state(finished).state == "changed"


def another_record(folder):
    text = (folder / SEAL).read_text()
    (folder / SEAL).write_text(("1" if text[0] != "1" else "2") + text[1:])


def test_reports_are_written_while_the_next_part_is_at_work_and_in_their_order(folders):
    gate, order = threading.Event(), []
    made = folders(1 + WAITING)
    with Reports() as reports:
        for folder in made:
            reports.add(pending(folder, before=lambda at=folder: gate.wait() and order.append(at)))
        assert order == []  # all were handed over, and none is written
        gate.set()
        assert reports.finish() == ()
    assert order == made
    assert all(report_state(folder, ()).state == "written" for folder in made)


def test_one_report_too_many_waits_for_the_first(folders):
    gate, added = threading.Event(), []
    made = folders(2 + WAITING)

    def add_all(reports):
        for folder in made:
            reports.add(pending(folder, before=gate.wait))
            added.append(folder)

    with Reports() as reports:
        thread = threading.Thread(target=add_all, args=(reports,))
        thread.start()
        thread.join(0.3)
        assert (thread.is_alive(), added) == (True, made[:-1])
        gate.set()
        thread.join()
    assert added == made


def test_after_an_interruption_the_report_at_work_is_finished_and_the_others_are_given_up(folders):
    begun, gate, discarded = threading.Event(), threading.Event(), []
    made = folders(3)

    def wait():
        begun.set()
        gate.wait()

    with pytest.raises(KeyboardInterrupt), Reports() as reports:
        for folder in made:
            reports.add(pending(folder, discarded=discarded, before=wait))
        begun.wait()
        threading.Timer(0.1, gate.set).start()
        raise KeyboardInterrupt
    assert [report_state(folder, ()).state for folder in made] == ["written", "missing", "missing"]
    assert sorted(discarded) == made


def test_what_goes_wrong_in_the_background_is_told_with_its_folder(folders):
    told, (folder, other) = [], folders(2)
    with Reports(told.append) as reports:
        reports.add(PendingReport(folder, lambda: 1 / 0))
        reports.add(pending(other))
    assert [note.partition(";")[0] for note in told] == ["0: no report: ZeroDivisionError: division by zero"]
    assert report_state(other, ()).state == "written"


def test_sha256sum_checks_a_report(finished):
    check = ["sha256sum", "--check", "--quiet", "--strict", SEAL]
    assert subprocess.run(check, cwd=finished, check=False).returncode == 0
