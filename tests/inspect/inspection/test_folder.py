"""Folders of inspections on a Windows that is simulated: its locks, and the names that it takes for devices."""

import errno
import fcntl
import os
import sys
import tempfile
from pathlib import PureWindowsPath
from types import SimpleNamespace

import pytest

from anisoscope.base.errors import RecordError
from anisoscope.inspection.folder import make_folder, working_in


@pytest.fixture
def windows(monkeypatch, tmp_path):
    """No fcntl, and an msvcrt that locks as the C library of Windows does: the file, and PermissionError if taken."""

    def locking(descriptor, mode, count):
        assert (mode, count) == (2, 1)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES)) from None

    monkeypatch.setitem(sys.modules, "fcntl", None)
    monkeypatch.setitem(sys.modules, "msvcrt", SimpleNamespace(locking=locking, LK_NBLCK=2))
    place = tmp_path / "temporary"
    place.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(place))


def check_lock(tmp_path):
    folder = tmp_path / "A-1"
    folder.mkdir()
    (tmp_path / "A-2").mkdir()
    with working_in(folder):
        with pytest.raises(RecordError, match="another process is at work"), working_in(folder):
            pass
        with working_in(tmp_path / "A-2"):
            pass
        assert list(folder.iterdir()) == [], "nothing is added to what is sealed"
    with working_in(folder):
        pass
    with pytest.raises(RecordError, match="cannot be opened: No such file"), working_in(tmp_path / "A-3"):
        pass


def test_a_folder_is_locked_on_windows(windows, tmp_path):
    check_lock(tmp_path)


def test_a_folder_is_locked(tmp_path):
    check_lock(tmp_path)


@pytest.mark.parametrize("serial", ["CON", "nul.txt", "Com1.2", "aux", "A-1", 'a<b>:"/\\|?*', "x.", " y "])
def test_serial_numbers_make_names_that_windows_takes(tmp_path, serial):
    name = make_folder(tmp_path, serial).name
    stem = PureWindowsPath(name).name.partition(".")[0].upper()
    assert stem not in {"CON", "PRN", "AUX", "NUL", "COM1", "LPT9"}
    assert not set(name) & set('<>:"/\\|?*')
    assert name[-1] not in ". "
