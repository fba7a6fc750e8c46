"""Processes of a sweep: kept for the next one, ended with the one that is broken off or with their parent."""

import os
import signal
import subprocess
import sys
import textwrap
import threading
import time
from multiprocessing.context import SpawnProcess
from pathlib import Path

import pytest

from anisoscope.study.processes import BrokenProcessPool, lent


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

    with lent(2) as processes:
        assert list(processes.map(late, range(20))) == list(range(20))


def test_what_no_module_holds_travels_both_ways():
    class Found:
        def __init__(self, value):
            self.value = value

    with lent(2) as processes:
        assert [found.value for found in processes.map(Found, range(4))] == [0, 1, 2, 3]


def test_idle_processes_serve_the_next_sweep():
    with lent(2) as processes:
        first = set(processes.map(own_pid(), range(8)))
    with lent(2) as processes:
        again = set(processes.map(own_pid(), range(8)))
    assert first & again
    assert len(first | again) <= 2


def test_processes_killed_while_idle_are_replaced():
    with lent(2) as processes:
        before = set(processes.map(own_pid(), range(8)))
    for pid in before:
        os.kill(pid, signal.SIGKILL)
    assert all(gone(pid) for pid in before)
    with lent(2) as processes:
        after = set(processes.map(own_pid(), range(8)))
    assert not before & after


def test_a_killed_process_breaks_the_sweep_only():
    def dies(task):
        os.kill(os.getpid(), signal.SIGKILL)

    with pytest.raises(BrokenProcessPool), lent(2) as processes:
        list(processes.map(dies, range(4)))
    with lent(2) as processes:
        assert len(list(processes.map(own_pid(), range(4)))) == 4


def test_an_exception_kills_whatever_still_computes(tmp_path):
    def begins(task):
        (tmp_path / str(os.getpid())).touch()
        if task > 0:
            time.sleep(600)

    with pytest.raises(ValueError, match="enough"), lent(2) as processes:
        next(processes.map(begins, range(4)))
        while len(list(tmp_path.iterdir())) < 2:
            time.sleep(0.02)
        raise ValueError("enough")
    assert all(gone(int(file.name)) for file in tmp_path.iterdir())


def test_sweeps_broken_off_again_and_again_leave_no_thread_and_no_process(tmp_path):
    def first_fails(task):
        (tmp_path / str(os.getpid())).touch()
        if task < 3:
            raise ValueError("so it is")
        return task

    threads = set(threading.enumerate())
    for _ in range(3):
        with pytest.raises(ValueError, match="so it is"), lent(2) as processes:
            list(processes.map(first_fails, range(40)))
    assert set(threading.enumerate()) <= threads
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
    with pytest.raises(KeyboardInterrupt), lent(2) as processes:
        list(processes.map(begins, [bytes(mebibytes * 2**20)] * 12))
    later.join()
    assert all(gone(int(file.name)) for file in tmp_path.iterdir())


@pytest.mark.parametrize("moment", ["before", "after"])
def test_an_interruption_while_a_process_starts_leaves_none(monkeypatch, moment):
    """Another thread's stack takes the signal; the main thread answers it wherever it is."""
    start, started, other = SpawnProcess.start, [], threading.Event()

    def interrupted(process):
        if moment == "before":
            os.kill(os.getpid(), signal.SIGINT)
        start(process)
        started.append(process.pid)
        if moment == "after":
            os.kill(os.getpid(), signal.SIGINT)

    monkeypatch.setattr(SpawnProcess, "start", interrupted)
    takes_signals = threading.Thread(target=other.wait)
    takes_signals.start()
    try:
        with pytest.raises(KeyboardInterrupt), lent(3) as processes:
            list(processes.map(own_pid(), range(6)))
    finally:
        other.set()
        takes_signals.join()
    assert len(started) == 1
    assert gone(started[0])


def test_ctrl_c_means_nothing_to_a_process_that_has_just_begun(tmp_path):
    """The terminal sends it to all processes alike, also to those that are still importing."""
    program = tmp_path / "program.py"
    program.write_text(
        textwrap.dedent(f"""
        import os
        import signal
        from pathlib import Path
        from anisoscope.study.processes import lent

        if __name__ != "__main__":
            os.kill(os.getpid(), signal.SIGINT)
            Path({str(tmp_path)!r}, f"begun-{{os.getpid()}}").touch()

        def double(task):
            return 2 * task

        if __name__ == "__main__":
            with lent(2) as processes:
                print(list(processes.map(double, range(4))))
        """)
    )
    command = [sys.executable, program]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)
    assert (done.returncode, done.stdout, done.stderr) == (0, "[0, 2, 4, 6]\n", "")
    assert len(list(tmp_path.glob("begun-*"))) == 2


def test_a_map_that_is_left_half_way_gives_its_processes_to_nobody(tmp_path):
    def begins(task):
        (tmp_path / str(os.getpid())).touch()
        time.sleep(600 * (task > 0))
        return task

    with lent(2) as processes:
        assert next(processes.map(begins, range(4))) == 0
    assert all(gone(int(file.name)) for file in tmp_path.iterdir())
    with lent(2) as processes:
        assert list(processes.map(str, range(4))) == list("0123")


def test_an_exception_says_where_it_was_raised_and_one_that_cannot_travel_is_told_in_words():
    def falls_over(task):
        raise LookupError("nothing here")

    class Bound(Exception):
        def __reduce__(self):
            raise TypeError("stays where it is")

    def stays(task):
        raise Bound("here")

    with pytest.raises(LookupError, match="nothing here") as caught, lent(2) as processes:
        list(processes.map(falls_over, range(4)))
    assert "falls_over" in caught.value.__notes__[0]
    with pytest.raises(RuntimeError, match=r"^Bound: here$"), lent(2) as processes:
        list(processes.map(stays, range(4)))


def test_results_that_cannot_travel_are_told():
    def opens(task):
        return threading.Lock()

    with pytest.raises(TypeError, match="pickle"), lent(2) as processes:
        list(processes.map(opens, range(2)))


@pytest.mark.skipif(sys.platform == "win32", reason="there is no SIGKILL")
def test_processes_end_with_their_parent(tmp_path):
    program = tmp_path / "program.py"
    program.write_text(
        textwrap.dedent(f"""
        import os
        import time
        from pathlib import Path
        from anisoscope.study.processes import lent

        def stays(task):
            Path({str(tmp_path)!r}, f"begun-{{os.getpid()}}").touch()
            time.sleep(600)

        if __name__ == "__main__":
            with lent(2) as processes:
                list(processes.map(stays, range(4)))
        """)
    )
    with subprocess.Popen([sys.executable, program]) as running:
        while len(begun := list(tmp_path.glob("begun-*"))) < 2:
            assert running.poll() is None
            time.sleep(0.05)
        running.kill()
    assert all(gone(int(file.name.removeprefix("begun-"))) for file in begun)
