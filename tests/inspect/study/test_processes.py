"""Processes of a sweep: kept for the next one, ended with the one that is broken off or with their parent."""

import os
import signal
import subprocess
import sys
import textwrap
import time

import pytest

from anisoscope.study.processes import BrokenProcessPool, lent


def own_pid():
    """A function that other processes can rebuild: they cannot import a test module."""

    def pid(task):
        return os.getpid()

    return pid


def gone(pid, within_s=10.0):
    deadline = time.monotonic() + within_s
    while time.monotonic() < deadline:
        try:
            os.kill(pid, 0)
        except ProcessLookupError:
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

    began = time.monotonic()
    with pytest.raises(ValueError, match="enough"), lent(2) as processes:
        next(processes.map(begins, range(4)))
        while len(list(tmp_path.iterdir())) < 2:
            time.sleep(0.02)
        raise ValueError("enough")
    assert time.monotonic() - began < 60
    assert all(gone(int(file.name)) for file in tmp_path.iterdir())


def test_sweeps_broken_off_again_and_again_leave_no_thread_in_trouble():
    """Every exception of a thread fails this test, as warnings do."""

    def first_fails(task):
        if task < 3:
            raise ValueError("so it is")
        return task

    for _ in range(6):
        with pytest.raises(ValueError, match="so it is"), lent(2) as processes:
            list(processes.map(first_fails, range(40)))


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
