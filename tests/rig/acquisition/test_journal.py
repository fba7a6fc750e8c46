"""The journal of frames: appended, read back, damaged."""

import pytest

from anisoscope.base.errors import RecordError
from anisoscope.rig.acquisition.journal import JOURNAL, FrameLine, JournalFile, RunLine, read_journal


def run_line(run=0):
    return RunLine(run=run, stage="S", tilt=None, camera="C", started_at="now")


def frame_line(step, run=0, name="frames/0.tif"):
    return FrameLine(
        run=run,
        step=step,
        name=name,
        sha256="0" * 64,
        kind="sample",
        again=step is None,
        pose_deg=(90.0, 10.0),
        stage_deg=90.001,
        tilt_deg=9.99,
        exposure_s=0.01,
        gain=1.0,
        captured_at="now",
    )


def test_what_is_appended_is_read_back(tmp_path):
    lines = [run_line(), frame_line(0), frame_line(1), run_line(1), frame_line(None, 1), frame_line(1, 1)]
    for line in lines:
        with JournalFile(tmp_path) as file:
            file.append([line])
    journal = read_journal(tmp_path)
    assert [*journal.runs, *journal.frames] == [
        line for kind in (RunLine, FrameLine) for line in lines if isinstance(line, kind)
    ]
    assert journal.by_step == {0: lines[1], 1: lines[5]}  # what was taken anew counts
    assert journal.checks(1) == (lines[4],)
    assert journal.checks(2) == ()  # a check that was not finished does not
    assert journal.frames[0].pose.tilt_deg == 10.0


def test_without_a_journal_nothing_was_taken(tmp_path):
    assert read_journal(tmp_path).frames == ()


def test_a_torn_last_line_does_not_count_and_is_cut_off(tmp_path):
    with JournalFile(tmp_path) as file:
        file.append([run_line(), frame_line(0)])
    whole = (tmp_path / JOURNAL).read_bytes()
    (tmp_path / JOURNAL).write_bytes(whole + whole[:50])
    assert len(read_journal(tmp_path).frames) == 1
    with JournalFile(tmp_path) as file:
        file.append([frame_line(1)])
    assert [line.step for line in read_journal(tmp_path).frames] == [0, 1]


@pytest.mark.parametrize("damage", [b"{}\n", b"\n", b"\xff\n", b'{"line": "frame", "run": 0}\n'])
def test_a_damaged_line_is_named(tmp_path, damage):
    with JournalFile(tmp_path) as file:
        file.append([run_line()])
    path = tmp_path / JOURNAL
    path.write_bytes(path.read_bytes() + damage)
    with pytest.raises(RecordError, match="line 2 is damaged"):
        read_journal(tmp_path)


def test_a_folder_that_cannot_be_written(tmp_path):
    with pytest.raises(RecordError, match="cannot be written: No such file"):
        JournalFile(tmp_path / "none")
    (tmp_path / JOURNAL).mkdir()
    with pytest.raises(RecordError, match="cannot be read: Is a directory"):
        read_journal(tmp_path)


def test_a_full_disk(tmp_path, monkeypatch):
    with JournalFile(tmp_path) as file:
        monkeypatch.setattr(
            "os.fsync", lambda _: (_ for _ in ()).throw(OSError(28, "No space left on device"))
        )
        with pytest.raises(RecordError, match="No space left"):
            file.append([run_line()])
