"""Interrupted inspections: what is kept, what is taken again, what is refused."""

import errno
import json
import os
import shutil

import pytest

from anisoscope.base.errors import RecordError
from anisoscope.inspection import run as inspection
from anisoscope.inspection.folder import working_in
from anisoscope.inspection.integrity import verify
from anisoscope.inspection.recompute import recompute
from anisoscope.inspection.run import resume_part
from anisoscope.record.schema import read_record
from anisoscope.rig.acquisition.journal import JOURNAL, read_journal


@pytest.mark.parametrize(
    "after", [1, 4, pytest.param(9, marks=pytest.mark.soak)]
)  # of 2 dark frames and 4 × 2 at poses
def test_a_resumed_inspection_judges_as_an_undisturbed_one(virtual_rig, monkeypatch, plain, after):
    rig = virtual_rig()
    folder = rig.break_off(monkeypatch, after)
    assert verify(folder).intact
    assert not verify(folder).finished
    found = resume_part(folder, methods=plain)
    assert found.record.verdict == "PASS", found.record.reasons
    assert read_record(folder) == found.record
    again = [frame for frame in found.record.frames if frame.again]
    assert len(again) == (4 if after == 4 else 2)  # on resuming, and at the end
    assert verify(folder).intact
    assert recompute(folder).differences == ()
    with pytest.raises(RecordError, match="this inspection is finished; there is nothing to resume"):
        resume_part(folder, methods=plain)


@pytest.mark.parametrize(
    ("file", "times"), [("frames/.*.partial", 5), (JOURNAL, 7), (".record.json.partial", 1)]
)
def test_a_disk_that_is_full_loses_nothing(virtual_rig, monkeypatch, plain, file, times):
    """Frame, journal, record: there is no room when the file is to be safe on the disk; later there is."""
    rig, fsync, met = virtual_rig(), os.fsync, []

    def full(descriptor):
        files = [path for folder in rig.folders for path in folder.glob(file)]
        if any(os.path.samestat(os.fstat(descriptor), path.stat()) for path in files):
            met.append(descriptor)
            if len(met) == times:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        fsync(descriptor)

    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", full)
        with pytest.raises(RecordError, match="No space left"):
            rig.inspect(methods=plain)
    (folder,) = rig.folders
    assert not verify(folder).finished
    before = {line.name: line.sha256 for line in read_journal(folder).frames}
    assert len(before) >= 4
    record = resume_part(folder, methods=plain).record
    assert record.verdict == "PASS", record.reasons
    assert verify(folder).intact
    kept = {line.name: line.sha256 for line in read_journal(folder).frames}
    assert before.items() <= kept.items(), "what was photographed is used"


def test_an_inspection_may_be_interrupted_twice(virtual_rig, monkeypatch, plain):
    rig = virtual_rig()
    folder = rig.break_off(monkeypatch, 5)
    monkeypatch.setattr(rig.__class__, "inspect", lambda _: resume_part(folder, methods=plain))
    rig.break_off(monkeypatch, 3)
    assert resume_part(folder, methods=plain).record.verdict == "PASS"
    journal = read_journal(folder)
    assert [run.run for run in journal.runs] == [0, 1, 2]
    assert verify(folder).intact


def test_a_lamp_that_changed_meanwhile_makes_it_invalid(virtual_rig, monkeypatch, plain):
    rig = virtual_rig()
    folder = rig.break_off(monkeypatch, 6)
    bench = rig.rig.with_name("bench.toml")
    bench.write_text(bench.read_text().replace("electrons = 24000000.0", "electrons = 22000000.0"))
    record = resume_part(folder, methods=plain).record
    assert record.verdict == "INVALID"
    assert "when the inspection was resumed, the first pose had changed by -8." in record.reasons[0]
    assert recompute(folder).differences == ()


def test_with_all_frames_there_no_rig_is_needed(virtual_rig, monkeypatch, plain):
    rig = virtual_rig()
    with monkeypatch.context() as patch:
        patch.setattr(inspection, "judge", lambda *_, **__: 1 / 0)
        with pytest.raises(ZeroDivisionError) as caught:
            rig.inspect()
    (folder,) = rig.folders
    assert caught.value.__notes__ == [f"`anisoscope resume {folder}` goes on from here"]
    shutil.rmtree(rig.rig.parent / "bench.toml", ignore_errors=True)
    for path in (rig.rig, rig.recipe, rig.rig.with_name("bench.toml")):
        path.unlink()
    assert resume_part(folder, methods=plain).record.verdict == "PASS"


def test_what_is_undecided_gets_its_further_round_even_if_the_program_died_before_judging(
    virtual_rig, monkeypatch, plain
):
    wrong = {"sample": {"material": {"alpha_along": 0.09}}}
    first = virtual_rig("first", bench=wrong, recipe={"decision": {"remeasure": 0}}).inspect().record
    edge = max(abs(one.measured - one.predicted) for one in first.details.contrasts)
    rig = virtual_rig("edge", bench=wrong, recipe={"decision": {"tolerance": edge}, "area": None})
    with monkeypatch.context() as patch:
        patch.setattr(inspection, "judge", lambda *_, **__: 1 / 0)
        with pytest.raises(ZeroDivisionError):
            rig.inspect()
    (folder,) = rig.folders
    record = resume_part(folder, methods=plain).record
    assert (record.verdict, record.rounds) == ("INCONCLUSIVE", 2)
    assert sum(frame.kind == "sample" and not frame.again for frame in record.frames) == 2 * 6
    assert recompute(folder).differences == ()


def test_a_job_that_took_no_frame_yet_can_be_resumed(virtual_rig, monkeypatch, plain):
    rig = virtual_rig()
    folder = rig.break_off(monkeypatch, 1)
    for path in ((folder / JOURNAL), *(folder / "frames").iterdir()):
        path.unlink()
    assert resume_part(folder, methods=plain).record.verdict == "PASS"


def test_what_a_killed_program_leaves_half_done_is_swept_away(virtual_rig, monkeypatch, plain):
    rig = virtual_rig()
    folder = rig.break_off(monkeypatch, 5)
    frames = folder / "frames"
    shutil.copy(frames / "000_dark.tif", frames / "005_sample_0090.00.tif")  # written, not yet in the journal
    (frames / ".frame-x1").write_bytes(b"half")
    (folder / ".report.html.partial").write_bytes(b"half")
    with (folder / JOURNAL).open("ab") as stream:
        stream.write(b'{"line": "frame", "ru')
    assert set(verify(folder).additional) == {
        "frames/005_sample_0090.00.tif",
        "frames/.frame-x1",
        ".report.html.partial",
    }
    assert resume_part(folder, methods=plain).record.verdict == "PASS"
    assert verify(folder).intact


def flip(path, at=-100):
    data = bytearray(path.read_bytes())
    data[at] ^= 1
    path.write_bytes(bytes(data))


def break_line(folder):
    text = (folder / JOURNAL).read_text().splitlines(keepends=True)
    (folder / JOURNAL).write_text("".join([text[0], "{}\n", *text[2:]]))


DAMAGE = {
    "frames/001_dark.tif": (lambda folder: flip(folder / "frames/001_dark.tif"), "was changed since"),
    "frames/002_sample_0000.00.tif": (
        lambda folder: (folder / "frames/002_sample_0000.00.tif").unlink(),
        "cannot be read: No such file",
    ),
    "inputs/recipe.toml": (lambda folder: flip(folder / "inputs/recipe.toml", 5), "was changed since"),
    "inputs/flat.tif": (lambda folder: (folder / "inputs/flat.tif").unlink(), "cannot be read"),
    JOURNAL: (break_line, "line 2 is damaged"),
    "job.json": (lambda folder: (folder / "job.json").write_text("{}"), "is damaged"),
}


@pytest.mark.parametrize("name", DAMAGE)
def test_a_damaged_folder_is_not_resumed_and_the_file_is_named(virtual_rig, monkeypatch, name):
    rig = virtual_rig()
    folder = rig.break_off(monkeypatch, 5)
    damage, message = DAMAGE[name]
    damage(folder)
    with pytest.raises(RecordError, match=message) as caught:
        resume_part(folder)
    assert str(folder / name) in str(caught.value)
    assert "\n" not in str(caught.value)
    found = verify(folder)
    assert name in (*found.changed, *found.missing)


def test_folders_that_are_no_inspections(tmp_path):
    with pytest.raises(RecordError, match="cannot be opened: No such file"):
        resume_part(tmp_path / "none")
    (tmp_path / "inputs").mkdir()
    (tmp_path / "inputs" / "mine.txt").write_text("keep this")
    with pytest.raises(RecordError, match="no inspection of this version began here"):
        resume_part(tmp_path)
    assert (tmp_path / "inputs" / "mine.txt").exists()
    (tmp_path / "A-1").mkdir()
    (tmp_path / "A-1" / "job.json").write_text("{}")
    with pytest.raises(RecordError, match="but in folders of it: name one, such as A-1"):
        resume_part(tmp_path)


def test_two_cannot_work_in_one_folder(virtual_rig, monkeypatch, plain):
    rig = virtual_rig()
    folder = rig.break_off(monkeypatch, 5)
    with working_in(folder), pytest.raises(RecordError, match="another process is at work"):
        resume_part(folder, methods=plain)
    assert resume_part(folder, methods=plain).record.verdict == "PASS"


def test_what_was_said_of_the_part_goes_from_the_job_into_the_record(virtual_rig):
    rig = virtual_rig()
    who = inspection.Particulars(operator="M. Muster", lot="7")
    found = inspection.inspect_part(rig.recipe, rig.rig, "A 1", rig.out, particulars=who)
    job = json.loads((found.folder / "job.json").read_text())
    assert (job["serial"], job["particulars"]["operator"], job["schema"]) == ("A 1", "M. Muster", 1)
    assert job["plan"]["poses"][1] == {"stage_deg": 90.0, "tilt_deg": 0.0}
    assert found.record.particulars == who
