"""Where a history is, and when an inspection was: as people write it."""

import time
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from sqlalchemy import make_url, text

from anisoscope.base.errors import UsageError
from anisoscope.history.address import VARIABLE, chosen, parse_address
from anisoscope.history.filters import parse_moment
from anisoscope.history.store import open_history

NOW = datetime(2026, 11, 22, 0, 30, tzinfo=UTC)


def test_files_and_folders(tmp_path):
    file = tmp_path / "a.sqlite"
    assert (
        parse_address(file).path == parse_address(str(file)).path == parse_address(f"sqlite:///{file}").path
    )
    assert parse_address(file).path == file
    assert parse_address(tmp_path).path == tmp_path / "history.sqlite"
    assert str(parse_address(file)) == str(file)


@pytest.mark.parametrize("scheme", ["postgresql", "postgres", "postgresql+pg8000"])
def test_servers(scheme):
    found = parse_address(f"{scheme}://me:se%40cret@host:5433/db")
    assert (found.path, found.url.drivername, found.url.password) == (None, "postgresql+pg8000", "se@cret")
    assert "cret" not in str(found)
    assert "cret" not in repr(found)


def test_sockets_and_encryption():
    found = parse_address("postgresql://me@/db?host=/run/postgresql")
    assert found.url.query == {"unix_sock": "/run/postgresql/.s.PGSQL.5432"}
    assert parse_address("postgresql://me@h/db").tls is None
    assert not parse_address("postgresql://me@h/db?sslmode=require").tls.check_hostname
    assert parse_address("postgresql://me@h/db?sslmode=verify-full").tls.check_hostname


@pytest.mark.parametrize(
    "text",
    [
        "mysql://me:secret@h/db",
        "postgresql://me:secret@h",
        "postgresql://me:secret@h/db?nonsense=1",
        "postgresql://me:secret@h/db?sslmode=maybe",
        "postgresql://me:secret@h:port/db",
        "sqlite://",
        "sqlite:///:memory:",
        "://",
    ],
)
def test_what_is_no_address_is_said_without_its_password(text):
    with pytest.raises(UsageError) as caught:
        parse_address(text)
    assert "secret" not in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_server_reached_by_its_socket_is_the_same_history(postgresql_place, new_row):
    with open_history(postgresql_place) as history:
        history.append(new_row(1))
        with history._database.reading() as connection:
            folder = connection.scalar(text("SHOW unix_socket_directories")).split(",")[0].strip()
    url = make_url(postgresql_place)
    local = f"postgresql://{url.username}:{url.password}@:{url.port}/{url.database}?host={folder}"
    with open_history(local) as history:
        assert history.count() == 1


def test_the_option_comes_before_the_environment_and_that_before_the_folder(monkeypatch):
    monkeypatch.delenv(VARIABLE, raising=False)
    assert chosen(None, Path("out")) == Path("out/history.sqlite")
    monkeypatch.setenv(VARIABLE, " ")
    assert chosen(None, Path("out")) == Path("out/history.sqlite")
    monkeypatch.setenv(VARIABLE, "postgresql://h/db")
    assert chosen(None, Path("out")) == "postgresql://h/db"
    assert chosen("mine.sqlite", Path("out")) == "mine.sqlite"
    assert chosen("none", Path("out")) is None
    monkeypatch.setenv(VARIABLE, "none")
    assert chosen(None, Path("out")) is None


@pytest.fixture
def in_auckland(monkeypatch):
    """13 hours east of Greenwich in November."""
    monkeypatch.setenv("TZ", "Pacific/Auckland")
    time.tzset()
    yield
    monkeypatch.undo()
    time.tzset()


@pytest.mark.usefixtures("in_auckland")
@pytest.mark.parametrize(
    ("text", "moment"),
    [
        ("2026-11-01", datetime(2026, 10, 31, 11, tzinfo=UTC)),
        ("1.11.2026", datetime(2026, 10, 31, 11, tzinfo=UTC)),
        ("1 Nov 2026", datetime(2026, 10, 31, 11, tzinfo=UTC)),
        ("13/11/2026", datetime(2026, 11, 12, 11, tzinfo=UTC)),
        ("11/13/2026", datetime(2026, 11, 12, 11, tzinfo=UTC)),
        ("2026/11/01", datetime(2026, 10, 31, 11, tzinfo=UTC)),
        ("November 1, 2026", datetime(2026, 10, 31, 11, tzinfo=UTC)),
        ("2026-11-01T14:30", datetime(2026, 11, 1, 1, 30, tzinfo=UTC)),
        ("2026-11-01 14:30", datetime(2026, 11, 1, 1, 30, tzinfo=UTC)),
        ("2026-11-01T14:30Z", datetime(2026, 11, 1, 14, 30, tzinfo=UTC)),
        ("today", datetime(2026, 11, 21, 11, tzinfo=UTC)),
        ("yesterday", datetime(2026, 11, 20, 11, tzinfo=UTC)),
        ("7d", NOW - timedelta(days=7)),
        (" 90m ", NOW - timedelta(minutes=90)),
        ("12h", NOW - timedelta(hours=12)),
        ("2w", NOW - timedelta(weeks=2)),
    ],
)
def test_moments_are_those_of_the_place(text, moment):
    assert parse_moment(text, "--since", now=NOW) == moment


@pytest.mark.usefixtures("in_auckland")
def test_a_day_includes_its_end():
    until = parse_moment("2026-11-01", "--until", now=NOW, at_end=True)
    assert until == datetime(2026, 11, 1, 11, tzinfo=UTC)
    assert parse_moment("7d", "--until", now=NOW, at_end=True) == NOW - timedelta(days=7)


@pytest.mark.parametrize(
    "text", ["", "soon", "7", "7y", "-7d", "2026-13-01", "31.11.2026", "13/13/2026", "999999w", "d"]
)
def test_what_is_no_moment(text):
    with pytest.raises(UsageError, match="--since takes 2026-11-01"):
        parse_moment(text, "--since", now=NOW)


def test_a_date_with_strokes_that_could_be_two_days_is_asked_for():
    with pytest.raises(UsageError, match="write 2026-03-04 or 2026-04-03"):
        parse_moment("03/04/2026", "--since", now=NOW)
