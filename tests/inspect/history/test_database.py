"""Files of others, media that cannot be written, and rigs that vanish while they write."""

import contextlib
import logging
import os
import shutil
import sqlite3
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest
from pg8000 import InterfaceError
from sqlalchemy import text

from anisoscope.history.address import parse_address
from anisoscope.history.database import Database
from anisoscope.history.problems import HistoryError
from anisoscope.history.store import open_history

NOBODY = 65534


def test_the_database_of_another_program_stays_as_it_is(tmp_path):
    path = tmp_path / "foreign.sqlite"
    with contextlib.closing(sqlite3.connect(path)) as connection:
        connection.execute("CREATE TABLE cows (milk REAL)")
        connection.commit()
    before = path.read_bytes()
    for create in (True, False):
        with pytest.raises(
            HistoryError, match=r"foreign\.sqlite is no history: .* \(cows\); name another file"
        ):
            open_history(path, create=create)
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


FULL = """
import resource, signal, sys
from dataclasses import replace
from pathlib import Path
from anisoscope.history.problems import HistoryError
from anisoscope.history.store import open_history
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))  # no file grows
with open_history(Path(sys.argv[1])) as history:
    print([row.serial for row in history.rows()])
    try:
        history.append(replace(history.rows()[0], seal="ab" * 32))
    except HistoryError as error:
        print(error)
"""


@pytest.mark.skipif(os.name != "posix", reason="needs limits of a process")
def test_on_a_full_disk_a_history_is_read(tmp_path, new_row):
    path = tmp_path / "history.sqlite"
    with open_history(path) as history:
        history.append(new_row(1))
    with open_history(path) as other:  # whose memory is shared as long as it reads
        assert other.count() == 1
    assert [one.name for one in tmp_path.iterdir()] == [path.name]
    said = subprocess.run(
        [sys.executable, "-c", FULL, str(path)], capture_output=True, text=True, check=False
    )
    assert said.stdout.splitlines()[0] == "['A1']", said.stderr
    assert "cannot write the history" in said.stdout
    with open_history(path) as history:
        assert history.count() == 1


def test_an_empty_file_is_no_history_until_something_is_added(tmp_path):
    path = tmp_path / "history.sqlite"
    path.touch()
    with pytest.raises(HistoryError, match="there is no history"):
        open_history(path, create=False)
    assert path.read_bytes() == b""
    with open_history(path) as history:
        assert history.count() == 0


def test_reading_changes_no_byte(sqlite_place, new_row):
    with open_history(sqlite_place) as history:
        history.append(new_row(0))
    before = Path(sqlite_place).read_bytes()
    with open_history(sqlite_place, create=False) as history:
        assert history.verify_chain() == []
        assert history.rows()[0].serial == "A0"
    assert Path(sqlite_place).read_bytes() == before


@pytest.fixture
def read_only(sqlite_place, new_row):
    """``read_only(log)``: a history of one row in a folder that this user cannot write, with rows in a log or not."""
    with open_history(sqlite_place) as history:
        history.append(new_row(0))
        history.verify_chain()
        folder = Path(tempfile.mkdtemp())
        user = os.geteuid()

        @contextlib.contextmanager
        def medium(log):
            copy = folder / "history.sqlite"
            shutil.copy(sqlite_place, copy)
            if log:
                copy.with_name("history.sqlite-wal").write_bytes(b"rows")
            folder.chmod(0o555)
            copy.chmod(0o444)
            if user == 0:  # root writes everywhere
                os.seteuid(NOBODY)
            try:
                yield copy
            finally:
                os.seteuid(user)
                folder.chmod(0o755)

        history.close()  # writes the log into the file
        yield medium
    shutil.rmtree(folder)


def test_a_history_on_a_read_only_medium_is_read_and_verified(read_only, new_row):
    with read_only(log=False) as copy:
        with open_history(copy, create=False) as history:
            assert history.verify_chain() == []
            assert history.rows()[0].serial == "A0"
            with pytest.raises(HistoryError, match=r"cannot write the history .*readonly"):
                history.append(new_row(1))
        assert [path.name for path in copy.parent.iterdir()] == ["history.sqlite"]


def test_rows_in_the_log_of_a_read_only_medium_are_not_left_out(read_only):
    with read_only(log=True) as copy, pytest.raises(HistoryError, match="copy both files"):
        open_history(copy, create=False)


def test_who_writes_for_too_long_is_named_and_the_others_can_still_read(postgresql_place, new_row):
    with open_history(postgresql_place) as history:
        history.append(new_row(0))
        writer, waiting = (Database(parse_address(postgresql_place), wait_s=wait) for wait in (12.0, 0.1))
        with (
            writer.writing(),
            pytest.raises(HistoryError, match=rf"anisoscope, process {os.getpid()} on .* writing for \d+ s"),
            waiting.writing(),
        ):
            raise AssertionError("two write at once")
        with waiting.writing():
            assert history.count() == 1
        writer.close()
        waiting.close()


def test_a_connection_that_is_cut_is_one_line(postgresql_place, capfd, monkeypatch):
    monkeypatch.setattr(
        logging.getLogger(), "handlers", []
    )  # as in a program: those of pytest write elsewhere
    cut, other = Database(parse_address(postgresql_place)), Database(parse_address(postgresql_place))
    with pytest.raises(HistoryError, match="cannot read the history") as caught, cut.reading() as connection:
        number = connection.scalar(text("SELECT pg_backend_pid()"))
        with other.reading() as its:
            assert its.scalar(text(f"SELECT pg_terminate_backend({number}, 10000)"))
        connection.execute(text("SELECT 1"))
    assert "\n" not in str(caught.value)
    with cut.reading() as connection:
        assert connection.scalar(text("SELECT 1")) == 1
    cut.close()
    other.close()
    assert capfd.readouterr().err == ""


def test_a_line_that_is_cut_while_a_transaction_begins_is_one_line(postgresql_place, monkeypatch):
    """SQLAlchemy passes the driver's own error on there."""
    database = Database(parse_address(postgresql_place))

    def cut(*_):
        raise InterfaceError("network error")

    monkeypatch.setattr(database.engine.dialect, "set_isolation_level", cut)
    with pytest.raises(HistoryError, match=r"cannot read the history .*: network error"), database.reading():
        pass
    database.close()


def test_the_server_misses_a_rig_that_lost_its_power(postgresql_place):
    database = Database(parse_address(postgresql_place))
    with database.reading() as connection:
        settings = "tcp_keepalives_idle", "tcp_keepalives_count", "idle_in_transaction_session_timeout"
        found = [connection.scalar(text(f"SHOW {name}")) for name in settings]
    database.close()
    assert found == ["10", "3", "1min"]
