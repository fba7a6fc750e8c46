"""Work shared among threads; threads of BLAS."""

import multiprocessing
import subprocess
import sys
import threading
from functools import partial

import pytest
from threadpoolctl import threadpool_info

from anisoscope.base import parallel
from anisoscope.base.parallel import for_each, one_blas_thread

four = partial(for_each, threads=4)


@pytest.fixture(autouse=True)
def _unused_threads(monkeypatch):
    monkeypatch.setattr(parallel, "_helpers", parallel._Helpers())


def test_results_come_in_the_order_of_the_items():
    assert four(lambda n: n * n, range(50)) == [n * n for n in range(50)]
    assert four(str, []) == []


def test_the_caller_works_and_the_others_are_kept():
    met = threading.Barrier(4)
    names = [four(lambda _: (met.wait(30.0), threading.get_ident())[1], range(4)) for _ in range(2)]
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
        four(work, range(1000))
    assert 0 in ended
    assert four(abs, [-1, -2, -3]) == [1, 2, 3]


def test_work_may_share_out_work():
    found = four(lambda n: sum(four(lambda m: n * m, range(20))), range(20))
    assert found == [190 * n for n in range(20)]


def _in_a_child(pipe):
    pipe.send(four(abs, [-1, -2, -3]))


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux forks processes that have threads")
@pytest.mark.filterwarnings("ignore:This process .* is multi-threaded:DeprecationWarning")
def test_a_forked_process_starts_its_own():
    four(abs, [-1, -2])
    here, there = multiprocessing.Pipe()
    child = multiprocessing.get_context("fork").Process(target=_in_a_child, args=(there,))
    child.start()
    assert here.poll(60.0)
    assert here.recv() == [1, 2, 3]
    child.join()


INTERRUPTED = """
import threading
from anisoscope.base.parallel import for_each

def start(thread, really=threading.Thread.start):
    really(thread)
    if threading.current_thread() is threading.main_thread():
        raise KeyboardInterrupt

threading.Thread.start = start
for_each(abs, range(4), 2)
"""


def test_a_process_that_is_interrupted_while_threads_start_ends():
    command = [sys.executable, "-Ic", INTERRUPTED]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300.0, check=False)
    assert done.returncode != 0
    assert "KeyboardInterrupt" in done.stderr


def threads():
    return {one["num_threads"] for one in threadpool_info() if one["user_api"] == "blas"}


def test_products_take_one_thread_until_the_last_caller_leaves():
    before = threads()
    first, second = one_blas_thread(), one_blas_thread()
    first.__enter__()
    second.__enter__()
    assert threads() == {1}
    first.__exit__(None, None, None)
    assert threads() == {1}
    second.__exit__(None, None, None)
    assert threads() == before
