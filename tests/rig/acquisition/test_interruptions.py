"""The signals that end a program, on each system, and how they wait."""

import signal
from types import SimpleNamespace

import pytest

from anisoscope.rig.acquisition.interruptions import interruptions, undisturbed

WINDOWS = SimpleNamespace(SIGINT=2, SIGTERM=15, SIGBREAK=21, SIGABRT=22)
POSIX = SimpleNamespace(SIGINT=2, SIGTERM=15, SIGHUP=1, SIGKILL=9)


def test_every_system_has_its_own():
    assert interruptions(WINDOWS) == (2, 15, 21)
    assert interruptions(POSIX) == (2, 15, 1)


@pytest.mark.parametrize("one", [signal.SIGINT, signal.SIGTERM])
def test_what_came_meanwhile_is_delivered_at_the_end(one):
    came = []
    before = signal.signal(one, lambda number, _: came.append(number))
    try:
        with undisturbed():
            signal.raise_signal(one)
            assert came == []
        assert came == [one]
    finally:
        signal.signal(one, before)
