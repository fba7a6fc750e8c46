"""Work of kernels, cut into runs and shared among threads."""

import pytest

from anisoscope.sim.light import threads


def test_kernels_share_their_work():
    assert threads.each(lambda n: n * n, range(50)) == [n * n for n in range(50)]
    assert threads.each(str, []) == []


@pytest.mark.parametrize(
    ("length", "most", "runs"),
    [(10, 3, [(0, 3), (3, 6), (6, 10)]), (2, 5, [(0, 1), (1, 2)]), (0, 4, [(0, 0)])],
)
def test_runs_cover_everything_once(length, most, runs):
    assert threads.runs(length, most) == runs
