"""A simulated month: two stations, an object store, PostgreSQL, programs killed at random, a day without network."""

import os
import signal
import time
import tomllib
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
import tomli_w

from anisoscope.history.rows import row_of
from anisoscope.history.store import open_history
from anisoscope.inspection.archive import (
    archived,
    check_format,
    clear,
    due,
    hold,
    let_go,
    manifests,
    parse_rule,
    prove,
    push_all,
)
from anisoscope.inspection.archive_store import ArchiveError, S3Store, open_store
from anisoscope.operations.past import write_whatif_page
from anisoscope.parameters.workers import Workers
from anisoscope.record.schema import read_record
from anisoscope.study.whatif import what_if

DAYS = 30
INSPECTIONS = int(os.environ.get("ANISOSCOPE_SOAK_INSPECTIONS", "10000"))
KILLS = int(os.environ.get("ANISOSCOPE_SOAK_KILLS", "200"))
CUT_OFF = 10  # the day on which station B has no network
BEGAN = datetime(2026, 5, 1, tzinfo=UTC)


class Dying(S3Store):
    """The object store for a program that is killed before one of its operations."""

    left = 0

    def _do(self, what):
        self.left -= 1
        if self.left < 0:
            os.kill(os.getpid(), signal.SIGKILL)
        return super()._do(what)


def push_in_a_child(url, out, left):
    """Push and remove in a process that is killed before an operation; whether it was."""
    child = os.fork()
    if child == 0:
        try:
            store = Dying(url)
            store.left = left
            push_all(store, [out], remove=True, tell=lambda _: None)
        finally:
            os._exit(0)
    return os.WIFSIGNALED(os.waitpid(child, 0)[1])


class Month:
    """Two stations that inspect and push for a month; what they did."""

    def __init__(self, base, copy_of, folder, url):
        self.copy_of = copy_of
        self.base, self.model, self.url = base, read_record(base), url
        self.stations = {name: folder / name for name in "AB"}
        for out in self.stations.values():
            out.mkdir()
        self.rng, self.store = np.random.default_rng(3), open_store(url)
        self.serials, self.killed, self.push_s = [], 0, 0.0

    def inspect(self, station, day):
        """The inspections of a station on a day, made of one: other serial number, time and verdict, sealed anew."""
        folders = []
        for number in range(INSPECTIONS // (2 * DAYS)):
            serial, when = f"{station}-{len(self.serials)}", BEGAN + timedelta(days=day, seconds=60 * number)
            folder = self.stations[station] / f"{serial}-{when:%Y%m%dT%H%M%SZ}"
            verdict = "FAIL" if self.rng.random() < 0.03 else "PASS"
            particulars = self.model.particulars.model_copy(update={"station": station})
            change = {"serial": serial, "created_at": when.isoformat(), "verdict": verdict}
            folders.append(self.copy_of(self.base, folder, self.model, particulars=particulars, **change))
            self.serials.append(serial)
        return folders

    def push(self, station, count):
        """Push and remove what a station has; first by programs that are killed."""
        out, began = self.stations[station], time.perf_counter()
        for _ in range(self.rng.poisson(KILLS / (2 * DAYS))):
            self.killed += push_in_a_child(self.url, out, int(self.rng.integers(0, 40 * count + 20)))
        problems = []
        push_all(self.store, [out], remove=True, tell=problems.append)
        assert [one for one in problems if isinstance(one, str)] == []
        self.push_s += time.perf_counter() - began


def live(month, history, without_network):
    """The days of the month; what was made on the last one stays on the stations."""
    for day in range(DAYS):
        for name, out in month.stations.items():
            folders = month.inspect(name, day)
            history.append_all([row_of(read_record(one), one) for one in folders])
            if name == "B" and day == CUT_OFF:
                with pytest.raises(ArchiveError, match="no answer"):
                    push_all(without_network, [out], remove=True, tell=print)
                assert all(one.exists() for one in folders)
            elif day < DAYS - 1:
                month.push(name, len(folders))


def by_rules(store, there):
    """Delete by rules, but for one that is held; what was deleted and what is left."""
    hold(store, there[0], "claim", "R", BEGAN)
    gone = [
        one
        for one in due(store, [parse_rule("FAIL:3650"), parse_rule("PASS:20")], BEGAN + timedelta(days=DAYS))
        if one.held is None
    ]
    for one in gone:
        let_go(store, one, "soak", BEGAN + timedelta(days=DAYS))
    clear(store, datetime.now(UTC) + timedelta(days=2))
    left = list(manifests(store, archived(store)))
    assert len(left) + len(gone) == len(there)
    assert len(list(store.files("deleted"))) == len(gone)
    assert prove(store, 0.0, 0.95, np.random.default_rng(1)).intact
    return gone, left


@pytest.mark.soak
def test_a_month_of_two_stations(inspected_part, copy_of, database, s3, tmp_path):
    """Nothing is lost, nothing doubles, nothing local is gone that is not proven elsewhere; numbers are printed."""
    rig, inspected = inspected_part
    month = Month(inspected.folder, copy_of, tmp_path, s3("month"))
    store = month.store
    check_format(store, begin=True)
    with open_history(database, create=True) as history:
        live(month, history, open_store(s3("month", "http://127.0.0.1:9")))
        rows = history.rows()
        local = [row for row in rows if Path(row.folder).is_dir()]
        for one in local[::5]:
            decision = "accept" if one.verdict == "PASS" else "reject"
            history.dispose(one.id, reviewer="R", decision=decision, comment="")
        decided = {one.id: "accept" if one.verdict == "PASS" else "reject" for one in local[::5]}
    assert sorted(row.serial for row in rows) == sorted(month.serials)
    there = list(manifests(store, archived(store)))
    assert sorted([one.serial for one in there] + [row.serial for row in local]) == sorted(month.serials)
    stored, whole = sum(one.size for one in store.files("objects")), sum(one.bytes for one in there)

    verify_s = time.perf_counter()
    proven = prove(store, 0.001, 0.95, np.random.default_rng(1))
    verify_s = time.perf_counter() - verify_s
    assert (proven.intact, proven.share <= 0.001) == (True, True)
    gone, left = by_rules(store, there)

    table = tomllib.loads(rig.recipe.read_text(encoding="utf-8"))
    table["decision"]["tolerance"] = 0.0005
    other = rig.recipe.with_name("tighter.toml")
    other.write_text(tomli_w.dumps(table), encoding="utf-8")
    judge_s = time.perf_counter()
    found = what_if(other, local, decided, Workers(2))
    judge_s = time.perf_counter() - judge_s
    page = Path(os.environ.get("ANISOSCOPE_SOAK_PAGE", tmp_path / "whatif.html"))
    write_whatif_page(page, found, {row.id: row for row in local})
    assert (found.unjudged, found.from_kept) == ((), len(local))
    print(  # noqa: T201 - numbers for whoever runs a campaign
        f"{len(month.serials)} inspections of two stations, {month.killed} pushes killed\n"
        f"archive: {stored / 1e6:.0f} MB for {whole / 1e6:.0f} MB of files, pushed in {month.push_s:.0f} s "
        f"({1e3 * month.push_s / max(len(there), 1):.0f} ms each)\n"
        f"verify: {proven.hashed} of {proven.objects} files in {verify_s:.1f} s\n"
        f"rules: {len(gone)} deleted, {len(left)} left\n"
        f"what-if: {len(local)} in {judge_s:.1f} s ({1e3 * judge_s / len(local):.0f} ms each), {dict(found.flips)}, "
        f"page {page.stat().st_size / 1e3:.0f} kB"
    )
