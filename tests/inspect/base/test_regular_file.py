"""Pipes, devices and folders in place of a file: refused at once, in one line, whoever reads it."""

import os
import resource
import threading

import pytest

from anisoscope.base.csv_table import read_text
from anisoscope.base.errors import AnisoscopeError, HeightMapError
from anisoscope.base.lock import locked
from anisoscope.base.regular_file import NO_FILE, bounded_bytes, regular_file
from anisoscope.base.toml_file import read_toml
from anisoscope.inspection.batch.codes import read_picture
from anisoscope.profiles.files.load import read_height_map
from anisoscope.record.schema import sha256_of
from anisoscope.rig.frame import file_content
from anisoscope.rig.framefolderline import read_lines

pytestmark = pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no named pipes")
READERS = [bounded_bytes, read_text, read_toml, read_picture, file_content, read_lines, sha256_of]


def in_time(function, path):
    """The error of a reader; a reader that waits fails the test and not the run."""
    found = []

    def read():
        try:
            function(path)
        except (AnisoscopeError, OSError) as error:
            found.append(error)

    thread = threading.Thread(target=read, daemon=True)
    thread.start()
    thread.join(2.0)
    assert found, "it waits for ever"
    return str(found[0])


@pytest.mark.parametrize("reader", READERS, ids=lambda one: one.__name__)
def test_what_is_no_file_is_refused_at_once(reader, tmp_path):
    pipe, zeros = tmp_path / "pipe.csv", tmp_path / "zeros.csv"
    os.mkfifo(pipe)
    zeros.symlink_to("/dev/zero")
    for path in (pipe, zeros):
        said = in_time(reader, path)
        assert NO_FILE in said
        assert path.name in said
    assert "directory" in in_time(reader, tmp_path).lower()


def test_a_larger_file_than_allowed_is_read_no_further(tmp_path):
    path = tmp_path / "large.bin"
    with path.open("wb") as stream:
        stream.truncate(1 << 40)  # takes no room
    with pytest.raises(OSError, match="more than 1 MiB"):
        bounded_bytes(path, 1 << 20)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(HeightMapError, match="at most 8589934592 are read"):
        read_height_map(path)
    with pytest.raises(OSError, match="more than 1024 MiB"):
        bounded_bytes(path, 1 << 30)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 64 << 10  # KiB
    with regular_file(path) as stream:
        assert stream.read(3) == b"\0\0\0"


def test_a_pipe_is_locked_at_once_and_a_link_to_itself_named(tmp_path, anisoscope):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "loop.toml").symlink_to(tmp_path / "loop.toml")
    with locked(tmp_path / "pipe"):
        pass
    done = anisoscope("recipe", "check", tmp_path / "loop.toml")
    assert done.code in (64, 78)  # Python 3.13 resolves it, and the file cannot be read
    assert "loop.toml" in done.err
    assert done.err.count("\n") == 1
