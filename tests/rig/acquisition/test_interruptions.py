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


def test_what_came_meanwhile_is_delivered_at_the_end(monkeypatch):
    came = []
    before = signal.signal(signal.SIGTERM, lambda number, _: came.append(number))
    try:
        with undisturbed():
            signal.raise_signal(signal.SIGTERM)
            assert came == []
        assert came == [signal.SIGTERM]
        with pytest.raises(KeyboardInterrupt), undisturbed():
            signal.raise_signal(signal.SIGINT)
    finally:
        signal.signal(signal.SIGTERM, before)
