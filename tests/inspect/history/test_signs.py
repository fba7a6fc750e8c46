"""Signs of stations: what is kept of them in either database, and that silence is not taken for rest."""

import subprocess
import sys
import time
from datetime import UTC, datetime, timedelta

import pytest
from sqlalchemy import text

from anisoscope.history import schema, signs
from anisoscope.history.address import parse_address
from anisoscope.history.columns import to_us
from anisoscope.history.database import Database
from anisoscope.history.signs import SILENT_S, Beacon, give_sign, read_signs
from anisoscope.history.store import open_history

SAYS = """
import sys, threading
from anisoscope.history.signs import Beacon

class Loud(Beacon):
    def _give(self):
        doing = self._now[0]  # what changes during the writing is written after it
        super()._give()
        print(doing, flush=True)

with Loud(sys.argv[1], "east", beat_s=3600.0) as found:
    found.show("running", "A1")
    threading.Event().wait()
"""


@pytest.fixture
def clock(monkeypatch):
    """``clock(seconds, start)``: sets the clock of the database so long after a start, where it stands still."""

    def set_to(seconds, start=datetime(2026, 11, 27, 6, 0, tzinfo=UTC)):
        moment = to_us(start) + round(1e6 * seconds)
        monkeypatch.setattr(signs, "moment_us", lambda _: moment)

    set_to(0.0)
    return set_to


def test_a_sign_replaces_the_one_before_and_what_is_done_has_begun_once(history, clock):
    give_sign(history, "east", "idle")
    give_sign(history, "west", "running", "A1")
    before = {one.station: one for one in read_signs(history)}
    clock(20.0)
    give_sign(history, "east", "idle")
    give_sign(history, "west", "fault", "the camera does not answer" + "." * 1000)
    east, west = read_signs(history)
    assert east.now() == ("idle", before["east"].since)
    assert east.seen - before["east"].seen == timedelta(seconds=20)
    assert west.now()[0] == "fault"
    assert west.since > before["west"].since
    assert west.words.startswith("the camera does not answer")
    assert len(west.words) <= signs.MOST_WORDS
    assert history.verify_chain() == []
    with history.reading() as connection:
        assert schema.unguarded(connection) == []


def test_who_says_nothing_is_not_called_idle_but_who_ended_is_off(history, clock):
    for station, doing in (("east", "idle"), ("north", "running"), ("west", "off")):
        give_sign(history, station, doing)
    seen = {one.station: one.seen for one in read_signs(history)}
    clock(SILENT_S - 5.0)
    assert [one.now()[0] for one in read_signs(history)] == ["idle", "running", "off"]
    clock(SILENT_S + 5.0)
    found = {one.station: one for one in read_signs(history)}
    assert [one.now() for one in found.values()] == [
        ("no sign", seen["east"]),
        ("no sign", seen["north"]),
        ("off", seen["west"]),
    ]
    # a later inspection, by a program that gives no signs, is the last that was heard
    inspected = seen["west"] + timedelta(seconds=30)
    assert found["west"].now(inspected) == ("no sign", inspected)
    assert found["east"].now(inspected) == ("no sign", inspected)


def test_a_station_that_is_killed_falls_silent(place, clock):
    with open_history(place):
        pass
    with subprocess.Popen(
        [sys.executable, "-c", SAYS, place],
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        assert "running\n" in iter(process.stdout.readline, "")
        process.kill()
    with open_history(place) as history:
        (sign,) = read_signs(history)
        assert (sign.doing, sign.words) == ("running", "A1")
        clock(SILENT_S - 1.0, sign.seen)
        (again,) = read_signs(history)
        assert again.now() == ("running", sign.since)
        clock(SILENT_S + 1.0, sign.seen)
        (sign,) = read_signs(history)
        assert sign.now() == ("no sign", sign.seen)


def test_a_program_that_ends_says_so(place):
    with Beacon(place, "east", beat_s=3600.0) as beacon:
        beacon.show("running", "A1")
    with open_history(place) as history:
        (sign,) = read_signs(history)
    assert (sign.now()[0], sign.words) == ("off", "")


def test_without_a_history_or_a_name_nothing_is_written(tmp_path):
    for place, station in ((None, "east"), (tmp_path / "history.sqlite", None)):
        with Beacon(place, station) as beacon:
            beacon.show("running")
    assert list(tmp_path.iterdir()) == []


def test_a_history_that_cannot_be_reached_is_complained_of_once(tmp_path):
    (tmp_path / "file").write_text("no folder")
    said = []
    with Beacon(tmp_path / "file" / "history.sqlite", "east", said.append, beat_s=0.0) as beacon:
        beacon.show("running", "A1")
    assert len(said) == 1
    assert "cannot make the history" in said[0]


def test_a_history_of_an_earlier_version_has_no_signs_and_gets_them(place):
    database = Database(parse_address(place))
    with database.writing() as connection:
        schema.migrate(connection, to=5)
    database.close()
    with open_history(place) as history:
        assert read_signs(history) == []
        give_sign(history, "east", "idle")
        assert [one.station for one in read_signs(history)] == ["east"]


def test_on_postgresql_the_clock_is_that_of_the_server(postgresql_place, monkeypatch):
    monkeypatch.setattr(time, "time_ns", lambda: 0)
    now = text("SELECT clock_timestamp()")
    with open_history(postgresql_place) as history:
        with history.reading() as connection:
            before = connection.scalar(now)
        give_sign(history, "east", "idle")
        with history.reading() as connection:
            after = connection.scalar(now)
        (sign,) = read_signs(history)
    assert before <= sign.seen <= after
