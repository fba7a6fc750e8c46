"""Work shared among threads."""

import multiprocessing
import sys
import threading

import pytest

from anisoscope.sim.light import threads


@pytest.fixture(autouse=True)
def _four(monkeypatch):
    monkeypatch.setattr(threads, "count", lambda: 4)
    monkeypatch.setattr(threads, "_helpers", threads._Helpers())


def test_results_come_in_the_order_of_the_items():
    assert threads.each(lambda n: n * n, range(50)) == [n * n for n in range(50)]
    assert threads.each(str, []) == []


def test_the_caller_works_and_the_others_are_kept():
    met = threading.Barrier(4)
    names = [threads.each(lambda _: (met.wait(30.0), threading.get_ident())[1], range(4)) for _ in range(2)]
    assert set(names[0]) == set(names[1])
    assert len(set(names[0])) == 4
    assert threading.get_ident() in names[0]


def test_the_first_exception_is_raised_after_all_that_had_begun():
    met, ended = threading.Barrier(3), []

    def work(number):
        if number < 3:
            met.wait(30.0)
        if number in (1, 2):
            raise ValueError(number)
        ended.append(number)

    with pytest.raises(ValueError, match="1"):
        threads.each(work, range(1000))
    assert 0 in ended
    assert threads.each(abs, [-1, -2, -3]) == [1, 2, 3]


def test_work_may_share_out_work():
    found = threads.each(lambda n: sum(threads.each(lambda m: n * m, range(20))), range(20))
    assert found == [190 * n for n in range(20)]


def _in_a_child(pipe):
    pipe.send(threads.each(abs, [-1, -2, -3]))


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux forks processes that have threads")
@pytest.mark.filterwarnings("ignore:This process .* is multi-threaded:DeprecationWarning")
def test_a_forked_process_starts_its_own():
    threads.each(abs, [-1, -2])
    here, there = multiprocessing.Pipe()
    child = multiprocessing.get_context("fork").Process(target=_in_a_child, args=(there,))
    child.start()
    assert here.poll(60.0)
    assert here.recv() == [1, 2, 3]
    child.join()


@pytest.mark.parametrize(
    ("length", "most", "runs"),
    [(10, 3, [(0, 3), (3, 6), (6, 10)]), (2, 5, [(0, 1), (1, 2)]), (0, 4, [(0, 0)])],
)
def test_runs_cover_everything_once(length, most, runs):
    assert threads.runs(length, most) == runs
