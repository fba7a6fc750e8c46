"""Progress without a terminal: lines of the steps that last, and the steps in the log file."""

import logging
import time

from anisoscope.cli import log
from anisoscope.cli.progress import Lines, progress


def test_a_short_job_prints_no_line(capsys):
    with progress("part") as advance:
        advance("frames", 0, 2)
        advance("judging", 1, 2)
    assert capsys.readouterr().err == ""


def test_a_step_that_lasts_is_printed_once_and_short_ones_are_left_out(capsys):
    lines = Lines("part", patience_s=0.05, gap_s=0.05)
    for _ in range(3):
        lines("reading", 0, 3)
    lines("frames", 1, 3)
    while lines._printed != "frames":  # until the timer has printed it
        time.sleep(0.01)
    time.sleep(0.06)
    lines("frames", 2, 3)
    lines("judging", 2, 3)
    lines.close()
    assert capsys.readouterr().err == "part: frames\npart: judging\n"


def test_the_log_file_gets_the_steps_of_a_quiet_command(tmp_path, capsys):
    options = log.LogOptions(quiet=True, file=tmp_path / "run.log")
    with log.listening(options), progress("part") as advance:
        advance("frames", 0, 2)
        advance("frames", 1, 2)
    text = (tmp_path / "run.log").read_text()
    assert text.count("part: frames") == 1
    assert capsys.readouterr().err == ""


def test_a_long_motion_is_told_by_every_command(capsys):
    for quiet in ((), ("-v",)):
        with log.listening(log.options_of(quiet)[1]):
            logging.getLogger("anisoscope.waiting").warning("the stage has moved for 8 s")
        assert capsys.readouterr().err == "anisoscope: the stage has moved for 8 s\n"
