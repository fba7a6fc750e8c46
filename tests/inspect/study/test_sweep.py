"""Sweeps: the same numbers whoever computes, and plain words when it does not work."""

import os
import signal
import socket
import subprocess
import sys
import textwrap
import time

import pytest

from anisoscope.base.errors import HeightMapError, UsageError
from anisoscope.parameters.workers import Workers
from anisoscope.study import sweep as sweep_module
from anisoscope.study.sweep import SweepError, sweep


def draw():
    """A task function that other processes can rebuild: they cannot import a test module."""

    def drawn(task, rng):
        return task + rng.random()

    return drawn


def failing():
    def fails(task):
        if task == 5:
            raise ValueError("no\nsuch thing")
        return task

    return fails


def test_results_stand_in_the_order_of_the_tasks():
    assert sweep(lambda task: 2 * task, range(200), Workers()) == list(range(0, 400, 2))
    assert sweep(lambda task: task, [], Workers()) == []


def test_every_task_has_a_child_of_the_seed_of_its_own():
    values = [value % 1.0 for value in sweep(draw(), [0.0] * 200, Workers(), seed=3)]
    assert len(set(values)) == 200
    assert values == sweep(draw(), [0.0] * 200, Workers(), seed=3)
    assert values[:60] == sweep(draw(), [0.0] * 60, Workers(), seed=3), (
        "more tasks do not change the first ones"
    )
    assert values != sweep(draw(), [0.0] * 200, Workers(), seed=4)


def test_processes_give_the_numbers_of_this_process():
    assert sweep(draw(), range(300), Workers(2), seed=7) == sweep(draw(), range(300), Workers(), seed=7)


def test_processes_are_other_processes():
    def where(task):
        return os.getpid()

    assert os.getpid() not in sweep(where, range(8), Workers(2))


def test_a_cluster_gives_the_numbers_of_this_process(cluster):
    there = sweep(draw(), range(300), Workers(scheduler=cluster.address), seed=7)
    assert there == sweep(draw(), range(300), Workers(), seed=7)


def test_a_worker_killed_in_the_middle_changes_nothing(cluster, tmp_path):
    def slow(task, rng):
        (tmp_path / str(os.getpid())).touch()
        while len(list(tmp_path.iterdir())) < 2:  # until both are at work
            time.sleep(0.02)
        time.sleep(0.04)
        return task + rng.random()

    killed = []

    def advance(doing, done, total):
        pids = [int(file.name) for file in tmp_path.iterdir()]
        if not killed and done > 5 and len(pids) == 2:
            os.kill(pids[0], signal.SIGKILL)
            killed.append(done)

    try:
        there = sweep(slow, range(60), Workers(scheduler=cluster.address), seed=9, advance=advance)
    finally:
        cluster.add_worker()  # the other tests' second one
        cluster.wait_for_workers(2)
    assert killed
    assert killed[0] < 60
    assert there == sweep(draw(), range(60), Workers(), seed=9)


@pytest.mark.parametrize("jobs", [1, 2])
def test_progress_counts_every_task(jobs):
    said = []
    sweep(
        lambda task: task, range(100), Workers(jobs), advance=lambda *what: said.append(what), doing="trying"
    )
    assert said[0] == ("trying", 0, 100)
    assert said[-1] == ("trying", 100, 100)
    counts = [done for _, done, _ in said]
    assert counts == sorted(counts)


@pytest.mark.parametrize("jobs", [1, 2])
def test_a_failing_task_is_named_in_one_line(jobs):
    with pytest.raises(SweepError) as caught:
        sweep(failing(), range(10), Workers(jobs))
    assert str(caught.value) == "task 6 of 10 failed: ValueError: no such thing (task: 5)"


def test_a_failing_task_on_a_cluster_is_named_in_one_line(cluster):
    with pytest.raises(SweepError, match=r"^task 6 of 10 failed: ValueError: no such thing \(task: 5\)$"):
        sweep(failing(), range(10), Workers(scheduler=cluster.address))


def test_errors_of_ours_keep_their_kind():
    def fails(task):
        raise HeightMapError("this map is bad")

    for workers in (Workers(), Workers(2)):
        with pytest.raises(HeightMapError, match="this map is bad"):
            sweep(fails, range(4), workers)


def test_a_killed_process_is_told():
    def dies(task):
        os.kill(os.getpid(), signal.SIGKILL)

    with pytest.raises(SweepError, match="killed"):
        sweep(dies, range(4), Workers(2))


def test_without_jobs_no_sweep():
    with pytest.raises(UsageError, match="--jobs"):
        Workers(0)


def test_a_missing_extra_is_told(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(UsageError, match=r"pip install anisoscope\[cluster\]"):
        sweep(draw(), range(3), Workers(scheduler="tcp://127.0.0.1:1"), seed=1)


@pytest.mark.parametrize("kind", ["nobody listens", "silent", "nonsense"])
def test_a_missing_scheduler_is_told_within_seconds(monkeypatch, kind):
    pytest.importorskip("distributed")
    monkeypatch.setattr(sweep_module, "CONNECT_TIMEOUT_S", 1.0)
    with socket.create_server(("127.0.0.1", 0)) as silent:
        address = f"tcp://127.0.0.1:{silent.getsockname()[1]}"
        if kind == "nobody listens":
            silent.close()
        if kind == "nonsense":
            address = "nonsense://here"
        with pytest.raises(SweepError, match="no Dask scheduler answers at"):
            sweep(draw(), range(3), Workers(scheduler=address), seed=1)


def test_a_scheduler_without_workers_is_told(scheduler, monkeypatch):
    monkeypatch.setattr(sweep_module, "NO_WORKERS_TIMEOUT_S", 0.5)
    with pytest.raises(SweepError, match=f"dask worker {scheduler}"):
        sweep(draw(), range(3), Workers(scheduler=scheduler), seed=1)


@pytest.mark.parametrize("place", ["processes", "cluster", "cluster on a busy machine"])
def test_interruption_ends_it_cleanly(place, request, tmp_path):
    """Where the machine is busy, Ctrl-C may come before Dask has begun to wait."""
    options = "2" if place == "processes" else f"scheduler={request.getfixturevalue('cluster').address!r}"
    busy = place.endswith("busy machine")
    program = tmp_path / "program.py"
    program.write_text(
        textwrap.dedent(f"""
        import os
        import signal
        import threading
        import time
        from pathlib import Path
        from anisoscope.parameters.workers import Workers
        from anisoscope.study.sweep import sweep

        def slow(task):
            Path({str(tmp_path)!r}, f"begun-{{os.getpid()}}").touch()
            time.sleep(0.2)

        def hold_up(_doing, done, _total):
            if done and {busy}:
                import distributed
                distributed.default_client().loop.add_callback(time.sleep, 1.0)
                threading.Timer(0.3, os.kill, (os.getpid(), signal.SIGINT)).start()

        if __name__ == "__main__":
            try:
                sweep(slow, range(1000), Workers({options}), advance=hold_up)
            except KeyboardInterrupt:
                print("interrupted")
        """)
    )
    with subprocess.Popen(
        [sys.executable, program],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    ) as running:
        while len(list(tmp_path.glob("begun-*"))) < 2:  # both are past their imports
            assert running.poll() is None, running.stderr.read()
            time.sleep(0.05)
        if not busy:  # there the program interrupts itself
            time.sleep(0.3)
            os.killpg(running.pid, signal.SIGINT)  # as a terminal does: to every process in the foreground
        out, err = running.communicate(timeout=120)
    assert out == "interrupted\n"
    assert "Traceback" not in err, err
    deadline = time.monotonic() + 120
    with pytest.raises(ProcessLookupError):  # nobody goes on computing
        while time.monotonic() < deadline:
            os.killpg(running.pid, 0)
            time.sleep(0.05)
