"""A month of two stations, their history and archive with deletions by rule; then an attack, and what verifying names.

The records are small, and signed, entered, archived and deleted by what the program does that with.
"""

import base64
import json
import os
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest

from anisoscope.base import signature
from anisoscope.base.signature import KeyFile, make_key, read_signed, read_trust, signed
from anisoscope.history.heads import sign_head
from anisoscope.history.rows import row_of
from anisoscope.history.store import open_history
from anisoscope.inspection.archive import (
    ArchivedFile,
    archived,
    due,
    let_go,
    manifests,
    parse_rule,
    prove,
    push_all,
)
from anisoscope.inspection.archive_store import open_store
from anisoscope.inspection.integrity import listed_files
from anisoscope.inspection.report_seal import write_report_sealed
from anisoscope.operations.past import verify_history
from anisoscope.record.schema import sha256_of, write_record

DAYS, STATIONS = 30, ("rig 1", "rig 2")
BEGAN = datetime(2026, 5, 1, 6, tzinfo=UTC)
IN_REACH = 5  # days after which a folder is archived and removed


def a_day(root, day, per_day, record_of, history, monkeypatch):
    """The inspections of both stations on a day."""
    for station in STATIONS:
        key = root / f"{station}.pem"
        monkeypatch.setenv(signature.VARIABLE, str(key))
        os.environ[signature.VARIABLE] = str(key)
        for number in range(per_day):
            serial = f"{station[-1]}-{day:02}-{number:03}"
            folder = root / f"out {station[-1]}" / serial
            folder.mkdir(parents=True)
            (folder / "frame.raw").write_bytes(serial.encode() * 8)
            made = BEGAN + timedelta(days=day, minutes=number)
            values = {"created_at": made.isoformat(), "verdict": "FAIL" if number % 4 == 1 else "PASS"}
            who = {"lot": f"L{day}", "cavity": None, "station": station, "operator": "M. M."}
            record = record_of(serial, particulars=who, **values)
            write_record(
                record.model_copy(update={"origin": "rig", "files": listed_files(folder, {})}), folder
            )
            write_report_sealed(folder, f"<h1>{record.verdict}</h1>")
            history.append(row_of(record, folder))
            sign_head(history, KeyFile(key), now=made)


def attack(store, root):
    """The verdict of an archived part, another one whose record rig 2 signs for rig 1, one taken away, an object."""
    those = {one.serial: one for one in manifests(store, archived(store))}
    rewritten, moved, gone, damaged = (those[f"1-{day:02}-001"] for day in (3, 8, 22, 20))
    store.delete(rewritten.key)
    store.write(
        rewritten.key.replace("FAIL", "PASS"),
        json.dumps(json.loads(rewritten.model_dump_json(by_alias=True)) | {"verdict": "PASS"}).encode(),
    )
    name = next(file for file in moved.files if file.name == "record.signature.json")
    said = read_signed("record", store.read(name.object)).content
    other = root / "other.json"
    other.write_text(signed("record", said, KeyFile(root / "rig 2.pem")))
    file = ArchivedFile(name=name.name, sha256=sha256_of(other), size=other.stat().st_size)
    store.put(file.object, other)
    files = tuple(file if one.name == file.name else one for one in moved.files)
    store.write(moved.key, moved.model_copy(update={"files": files}).model_dump_json(by_alias=True).encode())
    store.delete(gone.key)
    spoiled = next(one for one in damaged.files if one.name == "frame.raw").object
    path = root / "archive" / spoiled
    path.chmod(0o644)
    path.write_bytes(bytes(path.stat().st_size))
    return spoiled


@pytest.mark.parametrize(
    "per_day",
    [
        2,
        pytest.param(
            int(os.environ.get("ANISOSCOPE_SOAK_INSPECTIONS", "10000")) // 60, marks=pytest.mark.soak
        ),
    ],
)
def test_a_month_is_verified_after_an_attack(tmp_path, record_of, monkeypatch, per_day):
    monkeypatch.setenv(signature.VARIABLE, "none")
    lines = ["schema = 1"]
    for station in STATIONS:
        public = base64.b64encode(make_key(tmp_path / f"{station}.pem").public).decode()
        lines += ["[[keys]]", f'station = "{station}"', f'public = "{public}"']
    trust = tmp_path / "keys.toml"
    trust.write_text("\n".join(lines))
    url, place = str(tmp_path / "archive"), tmp_path / "history.sqlite"
    store = open_store(url)
    with open_history(place) as history:
        for day in range(DAYS):
            a_day(tmp_path, day, per_day, record_of, history, monkeypatch)
            if day >= IN_REACH:
                for station in STATIONS:
                    monkeypatch.setenv(signature.VARIABLE, str(tmp_path / f"{station}.pem"))
                    out = tmp_path / f"out {station[-1]}"
                    old = sorted(out.glob(f"*-{day - IN_REACH:02}-*"))
                    push_all(store, old, remove=True, tell=lambda _: None)
        for one in due(store, [parse_rule("PASS:10"), parse_rule("all:ever")], BEGAN + timedelta(days=DAYS)):
            let_go(store, one, "rule", BEGAN + timedelta(days=DAYS))

        def looked_at():
            of_archive = prove(store, 0.0, 0.95, np.random.default_rng(1), trust=read_trust(trust))
            of_history = verify_history(history, trust=trust, archive=url)
            return of_history, (
                *of_archive.damaged,
                *of_archive.missing,
                *of_archive.unread,
                *of_archive.distrust,
            )

        of_history, of_archive = looked_at()
        assert (of_history.damage, of_archive) == ((), ())
        assert of_history.inspections == 2 * DAYS * per_day

        spoiled = attack(store, tmp_path)
        # and the verdict of a part within reach
        reported = tmp_path / "out 1" / f"1-{DAYS - 1:02}-000" / "record.json"
        reported.write_text(reported.read_text().replace("PASS", "FAIL"))
        of_history, of_archive = looked_at()
    follower = "1-23-000" if per_day == 2 else "1-22-002"
    wanted = (spoiled, "1-03-001", "1-08-001", follower)
    found = {name: [line for line in of_archive if name in line] for name in wanted}
    assert [len(lines) for lines in found.values()] == [1, 1, 1, 1], of_archive
    assert len(of_archive) == 4, of_archive
    assert "for the station rig 1" in found["1-08-001"][0]
    assert len(of_history.damage) == 2, of_history.damage
    assert "its row says FAIL, the archive PASS" in of_history.damage[0]
    assert "(1-29-000)" in of_history.damage[1]
