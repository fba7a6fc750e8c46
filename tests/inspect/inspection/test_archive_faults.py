"""Programs killed and connections cut at random moments: nothing is lost, doubled, or deleted that is not proven."""

import contextlib
import json
import os
import signal
import socket
import threading
import time
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest
from sqlalchemy import make_url

from anisoscope.history.address import parse_address
from anisoscope.history.problems import HistoryError
from anisoscope.history.rows import row_of
from anisoscope.history.spool import WAITING, deliver, wait
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
from anisoscope.inspection.archive_store import ArchiveError, FolderStore, open_store
from anisoscope.inspection.integrity import verify
from anisoscope.record.schema import read_record

pytestmark = pytest.mark.soak
TIMES = int(os.environ.get("ANISOSCOPE_SOAK_KILLS", "200"))
NOW = datetime(2026, 6, 1, tzinfo=UTC)
AT_ONCE = 4  # inspections that wait for a push, or for a retention
AN_ARCHIVE = 20  # moments after which a new archive begins: the whole of it is verified after every one


def quiet(_):
    """Takes what a push says of each inspection."""


class CutLine:
    """A line to a server that is cut after so many bytes, whichever way they go; then it is refused, or cut anew."""

    def __init__(self, to):
        self.to, self.left, self.again, self.passed = to, None, None, 0
        self._lock, self._open = threading.Lock(), []
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port = self._listener.getsockname()[1]
        threading.Thread(target=self._serve, daemon=True).start()

    def cut_after(self, count, *, again=False):
        """From now on: None never; ``again`` lets the next connection live for as many bytes."""
        self.left, self.again = count, count if again else 0

    def _serve(self):
        with contextlib.suppress(OSError):
            while True:
                near, _ = self._listener.accept()
                try:
                    far = socket.create_connection(self.to)
                except OSError:
                    near.close()
                    continue
                with self._lock:
                    self._open.append((near, far))
                for pair in ((near, far), (far, near)):
                    threading.Thread(target=self._pass_on, args=pair, daemon=True).start()

    def _pass_on(self, source, target):
        with contextlib.suppress(OSError):
            while data := source.recv(1 << 16):
                with self._lock:
                    whole = self.left is None or len(data) <= self.left
                    passed = data if whole else data[: self.left]
                    self.passed += len(passed)
                    if self.left is not None:
                        self.left -= len(passed)
                target.sendall(passed)
                if not whole:
                    self._cut()
        for one in (source, target):
            with contextlib.suppress(OSError):
                one.shutdown(socket.SHUT_RDWR)
        source.close()  # the other direction closes the other one

    def _cut(self):
        with self._lock:
            cut, self._open, self.left = self._open, [], self.again
        for one in (end for pair in cut for end in pair):
            with contextlib.suppress(OSError):
                one.shutdown(socket.SHUT_RDWR)

    def close(self):
        self._cut()
        self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()


@pytest.fixture
def cut_line():
    """``cut_line((host, port))`` lays a line to a server."""
    lines = []

    def lay(to):
        lines.append(CutLine(to))
        return lines[-1]

    yield lay
    for line in lines:
        line.close()


class Station:
    """Inspections that a station makes, all of one; what must hold of them and the archive at any moment."""

    def __init__(self, base, copy_of, out, store):
        self.base, self.model, self.copy_of = base, read_record(base), copy_of
        self.out, self.store, self.made = out, store, []
        out.mkdir()

    def inspect(self, **changes):
        serial = f"P-{len(self.made)}"
        self.made.append(serial)
        return self.copy_of(self.base, self.out / serial, self.model, serial=serial, **changes)

    def fill(self):
        """Inspect until as many wait for a push as always."""
        for _ in range(AT_ONCE - len(self.local())):
            self.inspect()

    def push(self, store=None):
        push_all(store or self.store, [self.out], remove=True, tell=quiet)

    def local(self):
        return [path for path in self.out.iterdir() if path.name.startswith("P-")]

    def check(self):
        """Every inspection is here as it was, or in the archive once with all its files; how many are where."""
        there = [one.serial for one in manifests(self.store, archived(self.store))]
        here = self.local()
        assert len(set(there)) == len(there)
        assert {one.name for one in here} | set(there) == set(self.made)
        assert all(verify(one).intact for one in here)
        found = prove(self.store, 0.0, 0.95, np.random.default_rng(1))
        assert found.intact, (found.missing, found.damaged)
        return len(here), len(there)


@pytest.fixture
def station(inspected_part, copy_of, tmp_path):
    return lambda store, number=0: Station(
        inspected_part[1].folder, copy_of, tmp_path / f"station {number}", store
    )


def series():
    """How many moments each archive sees."""
    return [min(AN_ARCHIVE, TIMES - first) for first in range(0, TIMES, AN_ARCHIVE)]


def begun(work):
    """A child that does something."""
    child = os.fork()
    if child == 0:
        try:
            work()
        finally:
            os._exit(0)
    return child


def killed_after(work, seconds):
    """Do something in a child that is killed after a time; whether it was."""
    child = begun(work)
    time.sleep(seconds)
    os.kill(child, signal.SIGKILL)
    return os.WIFSIGNALED(os.waitpid(child, 0)[1])


def seconds_of(work):
    """How long a child takes for it undisturbed, its start with it."""
    start = time.perf_counter()
    os.waitpid(begun(work), 0)
    return time.perf_counter() - start


def test_a_push_killed_at_random_moments(station, tmp_path):
    rng, killed, broken, made = np.random.default_rng(11), 0, 0, 0
    for number, times in enumerate(series()):
        one = station(FolderStore(tmp_path / f"share {number}"), number)
        work = one.push
        one.fill()
        longest = seconds_of(work)
        for _ in range(times):
            one.fill()
            killed += killed_after(work, rng.uniform(0.0, longest))
            here, _ = one.check()
            broken += 0 < here < AT_ONCE
        work()
        assert one.check() == (0, len(one.made))
        assert not list(one.out.glob(".removed-*"))
        made += len(one.made)
    print(f"{killed} of {TIMES} pushes killed, {broken} between two inspections; {made} inspections")  # noqa: T201
    assert killed > TIMES // 10
    assert broken > TIMES // 20


class SlowShare(FolderStore):
    """A share over a network, on which what changes it takes some milliseconds: time in which a program is killed."""

    def write(self, name, content):
        time.sleep(0.005)
        super().write(name, content)

    def delete(self, name):
        time.sleep(0.005)
        super().delete(name)


class Ruled:
    """An archive of a station, of which a rule deletes what is old but for one inspection that is held."""

    def __init__(self, station):
        self.station, self.store = station, station.store
        check_format(self.store, begin=True)
        self.stay = {station.inspect(created_at=NOW.isoformat()).name for _ in range(AT_ONCE)}
        held = station.inspect(created_at=(NOW - timedelta(days=500)).isoformat()).name
        station.push()
        hold(self.store, next(one for one in self.there() if one.serial == held), "claim", "R", NOW)
        self.stay.add(held)

    def there(self):
        return list(manifests(self.store, archived(self.store)))

    def old(self):
        return {one.serial for one in self.there()} - self.stay

    def fill(self):
        """Archive old inspections until the rule has as many to delete as always."""
        for _ in range(AT_ONCE - len(self.old())):
            self.station.inspect(created_at=(NOW - timedelta(days=400)).isoformat())
        mark = self.store.folder / "clearing.json"  # of a program that was killed: it ends after a day
        mark.unlink(missing_ok=True)
        self.station.push()

    def retain(self):
        for one in due(self.store, [parse_rule("PASS:365")], NOW):
            if one.held is None:
                let_go(self.store, one, "me", NOW)
        clear(self.store, datetime.now(UTC) + timedelta(days=2))

    def check(self):
        """What stays is there, the rest is there or noted as deleted, and all is whole; how many old ones are left."""
        notes = (self.store.folder / "deleted").glob("[!.]*")
        noted = {json.loads(path.read_text())["inspection"]["serial"] for path in notes}
        assert self.stay <= {one.serial for one in self.there()}
        assert not noted & self.stay
        assert self.stay | self.old() | noted == set(self.station.made)
        assert prove(self.store, 0.0, 0.95, np.random.default_rng(1)).intact
        return len(self.old())


def test_a_retention_killed_at_random_moments(station, tmp_path):
    rng, killed, broken, gone = np.random.default_rng(12), 0, 0, 0
    for number, times in enumerate(series()):
        ruled = Ruled(station(SlowShare(tmp_path / f"share {number}"), number))
        ruled.fill()
        longest = seconds_of(ruled.retain)
        for _ in range(times):
            ruled.fill()
            killed += killed_after(ruled.retain, rng.uniform(0.0, longest))
            broken += 0 < ruled.check() < AT_ONCE
        ruled.retain()
        assert ruled.check() == 0
        gone += len(ruled.station.made) - len(ruled.stay)
    print(f"{killed} of {TIMES} retentions killed, {broken} between two inspections; {gone} deleted by rule")  # noqa: T201
    assert killed > TIMES // 10
    assert broken > TIMES // 20


def test_a_line_to_the_store_cut_at_random_bytes(station, s3, server, cut_line):
    host, port = server[0].removeprefix("http://").split(":")
    line, rng, refused, made, broken = cut_line((host, int(port))), np.random.default_rng(13), [], 0, 0
    for number, times in enumerate(series()):
        direct = open_store(s3(f"cut-{number}"))
        check_format(direct, begin=True)
        one = station(direct, number)
        line.cut_after(None)
        through = open_store(s3(f"cut-{number}", f"http://127.0.0.1:{line.port}"))
        for _ in range(2):  # the first sends what all of them share
            one.fill()
            before = line.passed
            one.push(through)
        longest = line.passed - before
        for _ in range(times):
            one.fill()
            line.cut_after(int(rng.integers(0, longest)), again=bool(rng.random() < 0.3))
            try:
                one.push(through)
            except ArchiveError as error:
                refused.append(str(error))
            here, _ = one.check()
            broken += 0 < here < AT_ONCE
        line.cut_after(None)
        one.push(through)
        assert one.check() == (0, len(one.made))
        made += len(one.made)
    print(f"{len(refused)} of {TIMES} pushes cut off, {broken} between two inspections; {made} inspections")  # noqa: T201
    assert not [line for line in refused if "\n" in line]
    assert len(refused) > TIMES // 10


@pytest.mark.filterwarnings(
    "ignore:unclosed <socket:ResourceWarning"
)  # pg8000's, where it breaks off while it opens
def test_a_line_to_postgresql_cut_at_random_bytes(database, inspected_part, cut_line, tmp_path):
    url = make_url(database)
    with open_history(database, create=True):
        pass
    line, rng, refused = cut_line((url.host, url.port)), np.random.default_rng(14), []
    place = url.set(host="127.0.0.1", port=line.port).render_as_string(hide_password=False)
    folder, made = inspected_part[1].folder, 0
    first = row_of(read_record(folder), folder)
    for _ in range(TIMES):
        for _ in range(5):
            new = {"serial": f"P-{made}", "seal": f"{made:064x}", "created_at": NOW + timedelta(minutes=made)}
            wait(type(first)(**vars(first) | new), parse_address(place), tmp_path)
            made += 1
        line.cut_after(int(rng.integers(0, 60_000)))
        try:
            with open_history(place) as history:
                deliver(history, tmp_path)
        except HistoryError as error:
            refused.append(str(error))
    line.cut_after(None)
    with open_history(place) as history:
        deliver(history, tmp_path)
        assert [(row.id, row.serial) for row in history.rows()] == [(n + 1, f"P-{n}") for n in range(made)]
        assert history.verify_chain() == []
    assert not list((tmp_path / WAITING).iterdir())
    print(f"{len(refused)} of {TIMES} deliveries ended by the cut line; {made} rows")  # noqa: T201
    assert not [line for line in refused if "\n" in line]
    assert len(refused) > TIMES // 10
