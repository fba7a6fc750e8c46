"""Processes of a sweep: kept for the next one, ended with the one that is broken off or with their parent."""

import os
import signal
import subprocess
import sys
import textwrap
import threading
import time
from pathlib import Path

import pytest
from loky.backend.process import LokyProcess

from anisoscope.parameters.workers import Workers
from anisoscope.study import sweep as sweep_module
from anisoscope.study.sweep import SweepError, again_after_a_kill, sweep

TWO = Workers(2)


def own_pid():
    """A function that other processes can rebuild: they cannot import a test module."""

    def pid(task):
        return os.getpid()

    return pid


def gone(pid, within_s=60.0):
    """Whether it ends; one that ended and that nobody has asked about yet is gone, too."""
    deadline = time.monotonic() + within_s
    while time.monotonic() < deadline:
        try:
            state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
        except (FileNotFoundError, ProcessLookupError):
            return True
        if state in "ZX":
            return True
        time.sleep(0.02)
    return False


def test_results_come_in_the_order_of_their_tasks():
    def late(task):
        time.sleep(0.02 * (5 - task % 5))
        return task

    assert sweep(late, range(20), TWO) == list(range(20))


def test_what_no_module_holds_travels_both_ways():
    class Found:
        def __init__(self, value):
            self.value = value

    assert [found.value for found in sweep(Found, range(4), TWO)] == [0, 1, 2, 3]


def test_idle_processes_serve_the_next_sweep():
    """New processes would be three or more; one of two may take all tasks of a sweep."""
    seen = {pid for _ in range(3) for pid in sweep(own_pid(), range(8), TWO)}
    assert len(seen) <= 2


@pytest.mark.parametrize("noticed", [True, False])
def test_processes_killed_while_idle_are_replaced(noticed):
    """Also when the next sweep hands them work before anything has seen that they are gone."""
    for _ in range(3):
        before = set(sweep(own_pid(), range(8), TWO))
        for pid in before:
            os.kill(pid, signal.SIGKILL)
        if noticed:
            assert all(gone(pid) for pid in before)
        after = set(sweep(own_pid(), range(8), TWO))
        assert not before & after


def test_a_killed_process_breaks_the_sweep_only():
    def dies(task):
        os.kill(os.getpid(), signal.SIGKILL)

    for _ in range(2):  # with idle processes, and with new ones
        assert len(sweep(own_pid(), range(4), TWO)) == 4
        with pytest.raises(SweepError, match="a process of this sweep was killed"):
            sweep(dies, range(4), TWO)
        with pytest.raises(SweepError, match="a process of this sweep was killed"):
            sweep(dies, range(4), TWO)


def test_a_process_killed_at_work_ends_the_sweep_at_once(tmp_path):
    def begins(task):
        (tmp_path / str(os.getpid())).touch()
        time.sleep(600)

    def kill():
        while len(list(tmp_path.iterdir())) < 2:
            time.sleep(0.02)
        os.kill(int(next(tmp_path.iterdir()).name), signal.SIGKILL)

    sweep_module._idle.clear()
    later = threading.Thread(target=kill)
    later.start()
    with pytest.raises(SweepError, match="a process of this sweep was killed"):
        sweep(begins, range(4), TWO)
    later.join()
    assert all(gone(int(file.name)) for file in tmp_path.iterdir())


def test_an_exception_kills_whatever_still_computes(tmp_path):
    def begins(task):
        (tmp_path / str(os.getpid())).touch()
        if task > 0:
            time.sleep(600)

    def enough(doing, done, total):
        while done and len(list(tmp_path.iterdir())) < 2:
            time.sleep(0.02)
        if done:
            raise ValueError("enough")

    with pytest.raises(ValueError, match="enough"):
        sweep(begins, range(4), TWO, advance=enough)
    assert all(gone(int(file.name)) for file in tmp_path.iterdir())


def test_sweeps_broken_off_again_and_again_leave_no_thread_and_no_process(tmp_path):
    def first_fails(task):
        (tmp_path / str(os.getpid())).touch()
        if task < 3:
            raise ValueError("so it is")
        return task

    with pytest.raises(SweepError):
        sweep(first_fails, range(40), TWO)  # idle processes of another test go with it
    threads = set(threading.enumerate())
    for _ in range(3):
        with pytest.raises(SweepError, match="so it is"):
            sweep(first_fails, range(40), TWO)
    deadline = time.monotonic() + 30.0
    while not set(threading.enumerate()) <= threads:  # the thread that feeds a pool ends a moment after it
        assert time.monotonic() < deadline, threading.enumerate()
        time.sleep(0.01)
    assert all(gone(int(file.name)) for file in tmp_path.iterdir())


@pytest.mark.parametrize("mebibytes", [0, 8])
def test_a_sweep_that_waits_for_large_tasks_can_be_broken_off(tmp_path, mebibytes):
    """More than a pipe holds: whoever writes must not wait for readers that were killed."""

    def begins(task):
        (tmp_path / str(os.getpid())).touch()
        time.sleep(600)

    def interrupt():
        while len(list(tmp_path.iterdir())) < 2:
            time.sleep(0.02)
        os.kill(os.getpid(), signal.SIGINT)

    later = threading.Thread(target=interrupt)
    later.start()
    with pytest.raises(KeyboardInterrupt):
        sweep(begins, [bytes(mebibytes * 2**20)] * 12, TWO)
    later.join()
    assert all(gone(int(file.name)) for file in tmp_path.iterdir())


@pytest.mark.parametrize("moment", ["before", "after"])
def test_an_interruption_while_a_process_starts_leaves_none(monkeypatch, moment):
    """Another thread's stack takes the signal; the main thread answers it wherever it is."""
    start, started, other = LokyProcess.start, [], threading.Event()

    def interrupted(process):
        if moment == "before":
            os.kill(os.getpid(), signal.SIGINT)
        start(process)
        started.append(process.pid)
        if moment == "after":
            os.kill(os.getpid(), signal.SIGINT)

    monkeypatch.setattr(LokyProcess, "start", interrupted)
    takes_signals = threading.Thread(target=other.wait)
    takes_signals.start()
    try:
        with pytest.raises(KeyboardInterrupt):
            sweep(own_pid(), range(6), Workers(3))
    finally:
        other.set()
        takes_signals.join()
    assert len(started) == 3
    assert all(gone(pid) for pid in started)


def test_ctrl_c_means_nothing_to_a_process_that_has_just_begun(tmp_path):
    """The terminal sends it to all processes alike, also to those that are still importing."""
    (tmp_path / "sitecustomize.py").write_text(
        textwrap.dedent(f"""
        import os
        import signal
        import sys
        from pathlib import Path

        if "loky.backend.popen_loky_posix" in sys.orig_argv:
            os.kill(os.getpid(), signal.SIGINT)
            Path({str(tmp_path)!r}, f"begun-{{os.getpid()}}").touch()
        """)
    )
    program = tmp_path / "program.py"
    program.write_text(
        textwrap.dedent("""
        from anisoscope.parameters.workers import Workers
        from anisoscope.study.sweep import sweep

        def double(task):
            return 2 * task

        print(sweep(double, range(4), Workers(2)))
        """)
    )
    command = [sys.executable, program]
    environment = os.environ | {"PYTHONPATH": str(tmp_path)}
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=120, env=environment)
    assert (done.returncode, done.stdout, done.stderr) == (0, "[0, 2, 4, 6]\n", "")
    assert len(list(tmp_path.glob("begun-*"))) == 2


def test_a_sweep_that_is_left_half_way_gives_its_processes_to_nobody(tmp_path):
    def begins(task):
        (tmp_path / str(os.getpid())).touch()
        time.sleep(600 * (task > 0))
        return task

    left = sweep_module._run(sweep_module._parts(begins, range(4), None), TWO)
    assert next(left)[1] == [0]
    left.close()
    assert all(gone(int(file.name)) for file in tmp_path.iterdir())
    assert sweep(str, range(4), TWO) == list("0123")


def test_an_exception_that_cannot_travel_is_told_in_words():
    class Bound(Exception):
        def __reduce__(self):
            raise TypeError("stays where it is")

    def stays(task):
        raise Bound("here")

    with pytest.raises(SweepError, match=r"^task 1 of 4 failed: Bound: here \(task: 0\)$"):
        sweep(stays, range(4), TWO)


def test_results_that_cannot_travel_are_told():
    def opens(task):
        return threading.Lock()

    with pytest.raises(Exception, match="pickle"):
        sweep(opens, range(2), TWO)


@pytest.mark.skipif(sys.platform == "win32", reason="there is no SIGKILL")
def test_processes_end_with_their_parent(tmp_path):
    program = tmp_path / "program.py"
    program.write_text(
        textwrap.dedent(f"""
        import os
        import time
        from pathlib import Path
        from anisoscope.parameters.workers import Workers
        from anisoscope.study.sweep import sweep

        def stays(task):
            Path({str(tmp_path)!r}, f"begun-{{os.getpid()}}").touch()
            time.sleep(600)

        sweep(stays, range(4), Workers(2))
        """)
    )
    with subprocess.Popen([sys.executable, program]) as running:
        while len(begun := list(tmp_path.glob("begun-*"))) < 2:
            assert running.poll() is None
            time.sleep(0.05)
        running.kill()
    assert all(gone(int(file.name.removeprefix("begun-"))) for file in begun)


def test_a_killed_process_loses_nothing(tmp_path, monkeypatch):
    def dies_once(path):
        if not path.exists():
            path.write_text("dead")
            os.kill(os.getpid(), signal.SIGKILL)
        return path.name

    def dies_always(_):
        os.kill(os.getpid(), signal.SIGKILL)

    monkeypatch.setattr(sweep_module, "PORTION", 3)
    paths = [tmp_path / f"{number}" for number in range(6)]
    for path in paths:
        path.touch()
    paths[4].unlink()
    assert again_after_a_kill(dies_once, paths, Workers(2)) == [path.name for path in paths]
    with pytest.raises(SweepError, match="killed"):
        again_after_a_kill(dies_always, [Path(), Path()], Workers(2))
