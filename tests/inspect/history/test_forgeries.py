"""Forgeries that were thought of, each tried: what notices it. A test writes the table in docs/evidence/forgeries.md.

The records are small ones, written, signed, entered and archived by what the program does that with.
"""

import base64
import contextlib
import importlib.util
import io
import json
import os
import shutil
import sqlite3
import zipfile
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from anisoscope.base import last_signed, signature
from anisoscope.base.errors import AnisoscopeError
from anisoscope.base.signature import TrustedKey, make_key, read_trust, signed
from anisoscope.console.trail import Trail
from anisoscope.history.adding import add_folders
from anisoscope.history.chain import DISPOSITION_FIELDS, INSPECTION_FIELDS, START, hash_of
from anisoscope.history.columns import to_us
from anisoscope.history.heads import add_time_stamp, rows_to_head, sign_head, time_stamp_request
from anisoscope.history.problems import HistoryError
from anisoscope.history.rows import row_of, seal_of
from anisoscope.history.store import open_history
from anisoscope.inspection.archive import archived, prove, push, push_all
from anisoscope.inspection.archive_store import open_store
from anisoscope.inspection.folder import files_in
from anisoscope.inspection.integrity import listed_files, verify
from anisoscope.inspection.report_seal import write_report_sealed
from anisoscope.operations.past import verify_history
from anisoscope.record.schema import read_record, sha256_of, write_record

DOCS = Path(__file__).parents[3] / "docs"
BEGUN, ENDED = (
    "<!-- forgeries: written by tests/inspect/history/test_forgeries.py -->\n",
    "<!-- end of forgeries -->",
)
COVERED, PARTS = 5, 8  # inspections under a signed head, and all
BAD = 7  # the part that failed, in the unsigned tail


@dataclass
class World:
    """A station, rig 1, with its key, inspections, history and archive, another one's key, and a thief's."""

    root: Path
    stranger_knows: dict[str, str] = field(default_factory=dict)

    def folder(self, number):
        return self.root / "out" / f"A{number}"

    def key(self, name):
        return signature.KeyFile(self.root / f"{name}.pem")

    @property
    def history(self):
        return self.root / "out" / "history.sqlite"

    @property
    def archive(self):
        return str(self.root / "archive")

    @contextlib.contextmanager
    def database(self):
        """The database of somebody who may do everything, and puts the triggers back."""
        with contextlib.closing(sqlite3.connect(self.history)) as connection:
            connection.row_factory = sqlite3.Row
            triggers = connection.execute(
                "SELECT name, sql FROM sqlite_master WHERE type = 'trigger'"
            ).fetchall()
            for one in triggers:
                connection.execute(f"DROP TRIGGER {one['name']}")
            yield connection
            for one in triggers:
                connection.execute(one["sql"])
            connection.commit()


def inspect(world, number, record_of, **changes):
    """Finish an inspection as the station does: files, record, report, history."""
    folder = world.folder(number)
    (folder / "frames").mkdir(parents=True)
    (folder / "frames" / "000.raw").write_bytes(bytes([number]) * 64)
    who = {"lot": "L1", "cavity": "3", "station": "rig 1", "operator": "M. M."}
    made = (datetime(2026, 11, 1, 6, tzinfo=UTC) + timedelta(minutes=number)).isoformat()
    values = {
        "particulars": who,
        "created_at": made,
        "verdict": "FAIL" if number == BAD else "PASS",
    } | changes
    record = record_of(f"A{number}", **values)
    record = record.model_copy(update={"origin": "rig", "files": listed_files(folder, {})})
    write_record(record, folder)
    write_report_sealed(folder, f"<h1>{record.verdict}</h1>")
    with open_history(world.history) as history:
        history.append(row_of(record, folder))
        sign_head(history, world.key("rig 1"))


@pytest.fixture(scope="module")
def pristine(tmp_path_factory, record_of, authority):
    """The world before any forgery, and a copy of it."""
    root = tmp_path_factory.mktemp("forgeries") / "world"
    root.mkdir()
    world = World(root)
    with pytest.MonkeyPatch.context() as patch:
        lines = ["schema = 1"]
        for name in ("rig 1", "rig 2", "thief"):
            public = base64.b64encode(make_key(root / f"{name}.pem").public).decode()
            if name != "thief":
                lines += ["[[keys]]", f'station = "{name}"', f'public = "{public}"']
                world.stranger_knows[name] = public
        (root / "keys.toml").write_text("\n".join(lines))
        patch.setenv(signature.VARIABLE, str(root / "rig 1.pem"))
        answer, certificate = authority
        shutil.copy(certificate, root / "authority.pem")
        for number in range(1, PARTS + 1):
            inspect(world, number, record_of)
            if number == COVERED:
                with open_history(world.history) as history:
                    history.dispose(2, reviewer="Q", decision="hold", comment="look again")
                    sign_head(history, world.key("rig 1"))
                    add_time_stamp(history, answer(time_stamp_request(history)))
        push_all(open_store(world.archive), [root / "out"], remove=False, tell=lambda _: None)
    shutil.copytree(root, root.with_name("copy"))
    return world


@pytest.fixture
def world(pristine, monkeypatch):
    """The world as it was, in the same place."""
    shutil.rmtree(pristine.root)
    shutil.copytree(pristine.root.with_name("copy"), pristine.root)
    monkeypatch.setenv(signature.VARIABLE, str(pristine.root / "rig 1.pem"))
    return pristine


# ---- who looks ------------------------------------------------------------------------------------------------------


def by_hashes(world, *, trust=None, at_station=True):
    """What `verify`, `history verify` and `archive verify` find: lines; with the keys that count, or without."""
    trusted, lines = None if trust is None else read_trust(trust), []
    for folder in sorted(path.parent for path in (world.root / "out").glob("*/record.json")):
        found = verify(folder, trusted)
        lines += [*found.changed, *found.missing, *found.additional, *found.distrust]
    with pytest.MonkeyPatch.context() as patch, open_history(world.history) as history:
        if not at_station:
            patch.setenv(signature.VARIABLE, "none")
        authorities = None if trust is None else world.root / "authority.pem"
        archive = None if trust is None else world.archive
        lines += verify_history(history, trust=trust, authorities=authorities, archive=archive).damage
    found = prove(open_store(world.archive), 0.0, 0.95, np.random.default_rng(1), trust=trusted)
    return [*lines, *found.damaged, *found.missing, *found.unread, *found.distrust]


def by_a_stranger(world, number):
    """What the script of the docs says of a bundle that the forger packs: its line, or why there is no bundle."""
    spec = importlib.util.spec_from_file_location("verify_bundle", DOCS / "verify_bundle.py")
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    folder, bundle = world.folder(number), world.root / "bundle.zip"
    try:
        with open_history(world.history) as history:
            row = history.row_by_seal(json.loads((folder / "record.json").read_text())["seal"])
            if row is None:
                return ["no row of the history is that of the record: no bundle"]
            rows, head = rows_to_head(history, row.id)
    except (AnisoscopeError, OSError) as error:
        return [str(error)]
    with zipfile.ZipFile(bundle, "w") as packed:
        for file in sorted(files_in(folder)):
            packed.write(folder / file, file)
        packed.writestr("history.json", json.dumps({"rows": rows, "head": head}))
    said = io.StringIO()
    keys = [f"{station}={public}" for station, public in world.stranger_knows.items()]
    with contextlib.redirect_stdout(said):
        code = script.main([str(bundle), *keys])
    return [said.getvalue()] if code else []


# ---- what is forged -------------------------------------------------------------------------------------------------


def rewrite_record(folder, **changes):
    """Another content under the right seal, as anybody can write it, with report and its hash."""
    record = read_record(folder)
    who = changes.pop("particulars", {})
    particulars = record.particulars.model_copy(update=who)
    unsigned = pytest.MonkeyPatch()
    kept = {name: (folder / name).read_bytes() for name in ("record.signature.json", "report.signature.json")}
    unsigned.setenv(signature.VARIABLE, "none")
    write_record(record.model_copy(update={"particulars": particulars, **changes}), folder)
    write_report_sealed(folder, f"<h1>{changes.get('verdict', record.verdict)}</h1>")
    unsigned.undo()
    for name, content in kept.items():
        (folder / name).write_bytes(content)


def sign_record(folder, key, *, linked=True, now=None, **changes):
    """Sign record and report with a key, as who has it can; what links it to the others is copied."""
    content = json.loads((folder / "record.json").read_text())
    old = signature.read_signed("record", (folder / "record.signature.json").read_text()).content
    said = {
        name: content[name] for name in ("serial", "product", "verdict", "created_at", "software", "origin")
    }
    said |= {name: content["particulars"][name] for name in ("lot", "station")}
    said |= {"record": sha256_of(folder / "record.json")}
    said |= {name: old[name] for name in ("number", "previous") if linked}
    (folder / "record.signature.json").write_text(signed("record", said | changes, key, now))
    hashes = {"record": said["record"], "report": sha256_of(folder / "report.html")}
    (folder / "report.signature.json").write_text(signed("report", hashes, key, now))


def chain_anew(world, change=lambda row: row, first=1):
    """Write the rows from one on anew, with right hashes, as `change` makes them; None leaves a row out."""
    with world.database() as connection:
        layouts = dict(connection.execute("SELECT id, labels FROM layouts").fetchall())
        rows = [dict(row) for row in connection.execute("SELECT * FROM inspections ORDER BY id")]
        connection.execute("DELETE FROM pictures")
        connection.execute("DELETE FROM inspections WHERE id >= ?", (first,))
        previous, number = START, 0
        for old in rows:
            row = old if old["id"] < first else change(old)
            if row is None:
                continue
            number += 1
            if old["id"] >= first:
                row |= {"id": number, "previous": previous}
                row["hash"] = hash_of(
                    "inspection", INSPECTION_FIELDS, row | {"labels": layouts[row["layout"]]}
                )
                names = ", ".join(row)
                marks = ", ".join("?" for _ in row)
                connection.execute(f"INSERT INTO inspections ({names}) VALUES ({marks})", tuple(row.values()))
            previous = row["hash"]


def passed(row, number=BAD):
    """The row of the failed part as one that passed."""
    return row | {"verdict": "PASS", "reasons": "[]"} if row["serial"] == f"A{number}" else row


def seal_in_row(world, number, *, clock=False):
    """Give the row of a part what its record says now."""
    new = row_of(read_record(world.folder(number)), world.folder(number))
    own = {"verdict": new.verdict, "station": new.station, "seal": bytes.fromhex(new.seal)}
    own |= {"created_us": to_us(new.created_at)} if clock else {}
    chain_anew(world, lambda row: row | own if row["serial"] == f"A{number}" else row, first=number)


def heads_of(world, key, *, keep=0):
    """Leave so many signed heads, and sign the present end with a key."""
    with world.database() as connection:
        connection.execute("DELETE FROM time_stamps")
        connection.execute("DELETE FROM signed_heads WHERE id > ?", (keep,))
    if key is not None:
        shutil.copytree(world.root / "out", aside := world.root / "aside")
        for path in (world.root / "out").glob("A*"):  # nothing hinders who writes the signature itself
            shutil.rmtree(path)
        Path(f"{key.path}.last.json").unlink(missing_ok=True)
        with open_history(world.history) as history:
            sign_head(history, key, always=True)
        for path in aside.glob("A*"):
            path.rename(world.root / "out" / path.name)
        shutil.rmtree(aside)


def report_hashed_anew(world, number=3):
    folder = world.folder(number)
    kept = (folder / "report.signature.json").read_bytes()
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(signature.VARIABLE, "none")
        write_report_sealed(folder, "<h1>FAIL</h1>")
    (folder / "report.signature.json").write_bytes(kept)


def report_unsigned(world):
    report_hashed_anew(world)
    (world.folder(3) / "report.signature.json").unlink()


def record_rewritten(world):
    rewrite_record(world.folder(3), verdict="FAIL")
    seal_in_row(world, 3)


def record_without_signature(world):
    record_rewritten(world)
    for name in ("record.signature.json", "report.signature.json"):
        (world.folder(3) / name).unlink()


def record_of_a_thief(world):
    record_rewritten(world)
    sign_record(world.folder(3), world.key("thief"))
    heads_of(world, world.key("thief"))


def record_of_another_rig(world):
    sign_record(world.folder(3), world.key("rig 2"))


def record_moved_to_another_rig(world):
    rewrite_record(world.folder(BAD), verdict="PASS", particulars={"station": "rig 2"})
    sign_record(world.folder(BAD), world.key("rig 2"))
    seal_in_row(world, BAD)


def statement_for_another_record(world):
    sign_record(world.folder(3), world.key("rig 1"), verdict="FAIL")


def rows_rewritten(world):
    chain_anew(world, lambda row: passed(row, 4) | {"lot": "L9"})


def rows_with_another_rigs_heads(world):
    for number in range(1, PARTS + 1):
        shutil.rmtree(world.folder(number))
    chain_anew(world, passed)
    heads_of(world, world.key("rig 2"))


def tail_rewritten(world):
    chain_anew(world, passed, first=COVERED + 1)


def tail_out_of_reach_rewritten(world):
    shutil.rmtree(world.folder(BAD))
    tail_rewritten(world)


def tail_and_heads_cut(world):
    with world.database() as connection:
        connection.execute("DELETE FROM time_stamps")
        connection.execute("DELETE FROM dispositions")
        connection.execute("DELETE FROM signed_heads WHERE id > 1")
        connection.execute("DELETE FROM pictures")
        connection.execute("DELETE FROM inspections WHERE id > 1")
    for number in range(2, PARTS + 1):
        shutil.rmtree(world.folder(number))


def end_cut(world):
    chain_anew(world, lambda row: None, first=BAD)
    for number in (BAD, PARTS):
        shutil.rmtree(world.folder(number))


def removed_in_the_middle(world):
    chain_anew(world, lambda row: None if row["serial"] == f"A{BAD}" else row, first=BAD)
    shutil.rmtree(world.folder(BAD))


def frames_exchanged(world):
    path = world.folder(3) / "frames" / "000.raw"
    path.write_bytes((world.folder(4) / "frames" / "000.raw").read_bytes())


def folders_exchanged(world):
    world.folder(3).rename(world.root / "aside")
    world.folder(4).rename(world.folder(3))
    (world.root / "aside").rename(world.folder(4))


def disposition_removed(world):
    with world.database() as connection:
        connection.execute("DELETE FROM dispositions")


def disposition_rewritten(world):
    with world.database() as connection:
        row = dict(connection.execute("SELECT * FROM dispositions").fetchone()) | {"decision": "release"}
        hash_ = hash_of("disposition", DISPOSITION_FIELDS, row)
        connection.execute("UPDATE dispositions SET decision = 'release', hash = ?", (hash_,))


def late_disposition_removed(world):
    with open_history(world.history) as history:
        history.dispose(1, reviewer="Q", decision="reject", comment="no")
    with world.database() as connection:
        connection.execute("DELETE FROM dispositions WHERE id = 2")


def stamp_replaced(world):
    with world.database() as connection:
        connection.execute("UPDATE time_stamps SET signed_head = 1")


def stamp_removed(world):
    with world.database() as connection:
        connection.execute("DELETE FROM time_stamps")


def tables_of_an_earlier_version(world):
    rows_rewritten(world)
    with world.database() as connection:
        connection.execute("DELETE FROM schema_versions WHERE version > 3")


def record_without_link(world):
    sign_record(world.folder(3), world.key("rig 1"), linked=False)


def clock_set_back(world):
    """The station inspected its last part with a clock of the day before."""
    yesterday = datetime.now(UTC) - timedelta(days=1)
    rewrite_record(world.folder(PARTS), created_at=yesterday.isoformat())
    sign_record(world.folder(PARTS), world.key("rig 1"), now=yesterday)
    seal_in_row(world, PARTS, clock=True)
    note = Path(f"{world.key('rig 1').path}.last.json")
    said = json.loads(note.read_text())
    (last,) = said["records"].values()
    last["seal"] = seal_of(world.folder(PARTS))
    note.write_text(json.dumps(said))


def clock_set_back_for_a_head(world):
    with open_history(world.history) as history:
        sign_head(history, world.key("rig 1"), always=True, now=datetime.now(UTC) - timedelta(days=1))


def trail_cut(world):
    trail = Trail(world.root / "out" / "console.audit.jsonl")
    for what in ("golden part", "tolerance"):
        trail.add("Q", what, "because")
    trail.path.write_bytes(trail.path.read_bytes().splitlines(keepends=True)[0])
    assert trail.damaged() == []


def object_exchanged(world):
    path = max((world.root / "archive" / "objects").rglob("*.sha256"))
    path.chmod(0o644)
    path.write_bytes(bytes(path.stat().st_size))


def manifest_with(world, number, **changes):
    store = open_store(world.archive)
    (name,) = (one for one in archived(store) if f"/A{number}~" in one)
    content = json.loads(store.read(name)) | changes
    store.delete(name)
    store.write(name, json.dumps(content).encode())


def archived_verdict_rewritten(world):
    manifest_with(world, BAD, verdict="PASS")


def archived_record_rewritten(world):
    """Another record, its object and its manifest: all hashes are right."""
    rewrite_record(world.folder(BAD), verdict="PASS")
    store = open_store(world.archive)
    (name,) = (one for one in archived(store) if f"/A{BAD}~" in one)
    store.delete(name)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("anisoscope.inspection.archive.verify", lambda _: verify(world.folder(1)))
        push(store, world.folder(BAD))
    shutil.rmtree(world.folder(BAD))
    shutil.copytree(world.root.with_name("copy") / "out" / f"A{BAD}", world.folder(BAD))


def manifest_removed(world):
    store = open_store(world.archive)
    (name,) = (one for one in archived(store) if "/A4~" in one)
    store.delete(name)


def key_exchanged(world):
    """From now on the station signs with the thief's key, which lies in place of its own."""
    shutil.copy(world.root / "thief.pem", world.root / "rig 1.pem")
    path = world.folder(PARTS)
    sign_record(path, world.key("rig 1"))


def older_copy(world):
    """The history as it was after the first part, and what came later entered again without what was decided."""
    tail_and_heads_cut(world)
    shutil.rmtree(world.root / "out")
    shutil.copytree(world.root.with_name("copy") / "out", world.root / "out")
    for path in (world.root / "out").glob("history.sqlite*"):
        path.unlink()
    with open_history(world.history) as history:
        add_folders(history, [world.root / "out"])


def revoked(world):
    """Not a forgery of files: the key was stolen, and is revoked."""
    trust = read_trust(world.root / "keys.toml")
    keys = [TrustedKey(**one.model_dump() | {"revoked": "stolen"}) for one in trust.keys[:1]]
    text = "".join(
        f'[[keys]]\nstation = "{one.station}"\npublic = "{one.public}"\nrevoked = "stolen"\n' for one in keys
    )
    (world.root / "keys.toml").write_text(f"schema = 1\n{text}")
    del world.stranger_knows["rig 1"]


YES, NO, SAID = "noticed", "–", "said"
OUT = "the station's own key signs what it is given"
FORGERIES = (
    # what, how, part whose bundle a stranger gets, (verify, --trust, stranger), how, or what is not covered
    ("report rewritten and hashed anew", report_hashed_anew, 3, (YES, YES, YES), ""),
    (
        "report rewritten, its signature removed",
        report_unsigned,
        3,
        (SAID, SAID, SAID),
        "“not covered by a signature”",
    ),
    ("record rewritten and sealed anew, row too", record_rewritten, 3, (YES, YES, YES), ""),
    ("… and its signature removed", record_without_signature, 3, (YES, YES, YES), ""),
    ("… signed by a key of the forger's, heads too", record_of_a_thief, 3, (YES, YES, YES), ""),
    (
        "record of rig 1 signed with the trusted key of rig 2",
        record_of_another_rig,
        3,
        (NO, YES, YES),
        "`verify` names the key",
    ),
    ("… which says that it is of rig 2, row too", record_moved_to_another_rig, BAD, (YES, YES, YES), ""),
    (
        "statement that says something else than its record",
        statement_for_another_record,
        3,
        (YES, YES, YES),
        "",
    ),
    ("rows under a signed head rewritten", rows_rewritten, 3, (YES, YES, YES), ""),
    (
        "all rows rewritten with heads of rig 2, folders removed",
        rows_with_another_rigs_heads,
        3,
        (NO, YES, YES),
        "",
    ),
    ("row after the last signed head rewritten", tail_rewritten, BAD, (YES, YES, YES), ""),
    (
        "… whose folder is out of reach",
        tail_out_of_reach_rewritten,
        BAD,
        (NO, YES, YES),
        ("by the archive (`--archive`); elsewhere nothing is left to compare with"),
    ),
    (
        "rows cut with the heads over them, folders too",
        tail_and_heads_cut,
        1,
        (NO, YES, NO),
        "by the note beside the key, or in the archive",
    ),
    (
        "the last rows and folders removed",
        end_cut,
        3,
        (NO, YES, NO),
        "by the note beside the key: at the station alone",
    ),
    (
        "record deleted in the middle, row and folder",
        removed_in_the_middle,
        3,
        (YES, YES, NO),
        "the bundle is of another part",
    ),
    ("frames exchanged", frames_exchanged, 3, (YES, YES, YES), ""),
    (
        "folders of two parts exchanged",
        folders_exchanged,
        3,
        (YES, YES, NO),
        "each bundle is true of its own part",
    ),
    ("disposition removed", disposition_removed, 3, (YES, YES, NO), "bundles hold no dispositions"),
    (
        "disposition rewritten, hashed anew",
        disposition_rewritten,
        3,
        (YES, YES, NO),
        "bundles hold no dispositions",
    ),
    (
        "… one that no head covers yet removed",
        late_disposition_removed,
        3,
        (NO, NO, NO),
        "covered by the next head: `history sign` at once",
    ),
    (
        "RFC 3161 stamp replaced by that of something else",
        stamp_replaced,
        3,
        (NO, YES, NO),
        "with `--tsa`; bundles hold no stamps",
    ),
    (
        "RFC 3161 stamp removed",
        stamp_removed,
        3,
        (NO, NO, NO),
        "`--tsa` prints the time of the stamps that are there",
    ),
    ("tables set back to an earlier version", tables_of_an_earlier_version, 3, (YES, YES, YES), ""),
    (
        "record signed without its link, as earlier versions did",
        record_without_link,
        3,
        (YES, YES, SAID),
        "needs the key of the station",
    ),
    (
        "archived object exchanged",
        object_exchanged,
        3,
        (YES, YES, NO),
        "`archive verify --damaged 0`; a sample may miss it",
    ),
    (
        "verdict in the archive's list rewritten",
        archived_verdict_rewritten,
        3,
        (NO, YES, NO),
        "the record itself is unchanged",
    ),
    ("archived record, object and list rewritten", archived_record_rewritten, 3, (NO, YES, NO), ""),
    (
        "inspection removed from the archive",
        manifest_removed,
        3,
        (NO, YES, NO),
        "the last ones: only if the history is there",
    ),
    (
        "inspection made with the clock of the station set back",
        clock_set_back,
        3,
        (SAID, SAID, NO),
        "by the record before it, from ten minutes on; an RFC 3161 stamp says until when, not since when",
    ),
    ("head signed with that clock", clock_set_back_for_a_head, 3, (SAID, SAID, NO), "by the head before it"),
    (
        "lines at the end of the console's trail of users removed",
        trail_cut,
        3,
        (NO, NO, NO),
        "the trail is chained, but no key signs it: a changed line shows, a cut end does not",
    ),
    ("key file exchanged", key_exchanged, 3, (NO, YES, NO), "what the new key signs is not trusted"),
    ("history begun anew from the folders", older_copy, 3, (NO, YES, YES), ""),
    ("key stolen, and revoked in the trust file", revoked, 3, (NO, YES, YES), ""),
)
BEYOND = (
    (
        "frames of another part under a new serial number",
        (
            f"{OUT}; `verify`, bundle and script say whether the rig took the frames"
            " or they were imported; pictures known in the history are refused"
        ),
    ),
    (
        "trust file, or the list of keys at the stranger's, exchanged",
        "who writes it says whose signatures count: keep a copy elsewhere",
    ),
    ("note beside the key rewritten", "who writes there can read the key"),
    (
        "key copied, and not noticed",
        (
            "it signs as the station; a record with a number that another one has "
            "shows only where both are in one history"
        ),
    ),
    (
        "record judged anew by an older version with the station's key",
        f"{OUT}; the record names software and version",
    ),
)


def seen(world, number):
    """Whether hashes, trusted keys and a stranger notice something, in words of the table."""
    lines = by_hashes(world), by_hashes(world, trust=world.root / "keys.toml"), by_a_stranger(world, number)
    return tuple(YES if one else NO for one in lines), lines


def test_without_a_forgery_nothing_is_noticed(world):
    outcomes, lines = seen(world, 3)
    assert outcomes == (NO, NO, NO), lines
    assert by_hashes(world, trust=world.root / "keys.toml", at_station=False) == []


@pytest.mark.parametrize("what", [one[0] for one in FORGERIES])
def test_a_forgery_is_noticed_or_the_table_says_that_it_is_not(world, what):
    _, forge, number, expected, _ = next(one for one in FORGERIES if one[0] == what)
    known = dict(world.stranger_knows)
    forge(world)
    outcomes, lines = seen(world, number)
    world.stranger_knows = known
    assert outcomes == tuple(NO if one == SAID else one for one in expected), lines


def test_a_clock_that_was_set_back_is_named(world):
    clock_set_back(world)
    clock_set_back_for_a_head(world)
    with open_history(world.history) as history:
        found = verify_history(history)
    assert found.intact
    assert [line.split(":")[0] for line in found.remarks] == [
        "signed head 3",
        f"inspection {PARTS} (A{PARTS})",
    ]
    assert all("signed 24.0 h before the one before it" in line for line in found.remarks)


def test_a_station_signs_no_tail_that_was_rewritten(world):
    tail_rewritten(world)
    says = r"its row says another .*verdict than its record.*nothing is signed"
    with open_history(world.history) as history, pytest.raises(HistoryError, match=says):
        sign_head(history, world.key("rig 1"), always=True)


def test_an_export_names_rows_that_are_not_their_records(world, anisoscope, tmp_path):
    asked = "export", "--history", str(world.history), "--csv-file", str(tmp_path / "all.csv")
    assert anisoscope(*asked).code == 0
    tail_rewritten(world)
    done = anisoscope(*asked)
    assert done.code == 1
    assert f"inspection {BAD} (A{BAD}): its row says another reasons, verdict than its record" in done.out


def test_a_station_signs_nothing_on_rows_that_were_rewritten_under_a_head(world):
    rows_rewritten(world)
    says = r"signed head 2: inspection 5 is another one now: the history was written anew.*nothing is signed"
    with open_history(world.history) as history, pytest.raises(HistoryError, match=says):
        sign_head(history, world.key("rig 1"))


def test_a_station_signs_no_history_that_was_cut(world):
    tail_and_heads_cut(world)
    says = r"signed head 2 was noted.*nothing is signed"
    with open_history(world.history) as history, pytest.raises(HistoryError, match=says):
        sign_head(history, world.key("rig 1"), always=True)


def test_the_archive_shows_a_cut_history_where_the_key_is_not(world):
    tail_and_heads_cut(world)
    lines = by_hashes(world, trust=world.root / "keys.toml", at_station=False)
    assert any("signed head 2 was noted" in line and "stations/rig%201.json" in line for line in lines)


def test_records_of_earlier_versions_are_read_and_named(world, record_of, anisoscope):
    for number in range(1, PARTS + 1):
        sign_record(world.folder(number), world.key("rig 1"), linked=False)
    said = anisoscope(
        "history", "verify", "--history", str(world.history), "--trust", str(world.root / "keys.toml")
    )
    assert f"{PARTS} compared with their records, {PARTS} not linked to the one before" in said.out
    assert said.code == 0
    assert "note: not linked to the record before it" in anisoscope("verify", str(world.folder(3))).out


def test_a_program_that_is_killed_while_it_signs_leaves_no_gap(world, record_of):
    key, series = world.key("rig 1"), str((world.root / "out").resolve())
    number, seal = last_signed.last_records(key)[series]
    with (
        contextlib.suppress(KeyboardInterrupt),
        last_signed.next_record(key, world.folder(20), "ab" * 32) as link,
    ):
        assert link == {"number": number + 1, "previous": seal}
        raise KeyboardInterrupt
    assert last_signed.last_records(key)[series] == (number, seal)
    inspect(world, PARTS + 1, record_of)
    assert last_signed.last_records(key)[series][0] == number + 1
    assert by_hashes(world, trust=world.root / "keys.toml") == []


def test_the_table_of_the_docs_is_this_one():
    assert len(FORGERIES) + len(BEYOND) >= 20
    lines = [
        "| forgery | `verify` | `verify --trust` | stranger | not covered, or how |",
        "|---|---|---|---|---|",
    ]
    lines += [f"| {what} | {' | '.join(found)} | {words} |" for what, _, _, found, words in FORGERIES]
    lines += [f"| {what} | – | – | – | out of reach: {words} |" for what, words in BEYOND]
    table = "\n".join(lines) + "\n"
    page = DOCS / "evidence" / "forgeries.md"
    text = page.read_text(encoding="utf-8")
    before, _, rest = text.partition(BEGUN)
    _, _, after = rest.partition(ENDED)
    new = f"{before}{BEGUN}\n{table}{ENDED}{after}"
    if os.environ.get("ANISOSCOPE_WRITE_DOCS") == "1":
        page.write_text(new, encoding="utf-8")
    assert text == new or os.environ.get("ANISOSCOPE_WRITE_DOCS") == "1", (
        f"{page.name} is out of date: run this test with ANISOSCOPE_WRITE_DOCS=1"
    )
