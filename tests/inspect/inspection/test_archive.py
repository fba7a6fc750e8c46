"""Inspections in an archive: pushed once, whole, and proven; fetched, held, and deleted by rules with a note.

The object store is moto's server with its authentication enforced; it is somebody else's, but no full S3 server.
"""

import contextlib
import json
import os
import resource
import signal
from collections import Counter
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from anisoscope.base.errors import RecordError, UsageError
from anisoscope.base.signature import VARIABLE, make_key
from anisoscope.inspection import archive as module
from anisoscope.inspection.archive import (
    archived,
    archived_verdicts,
    check_clock,
    check_format,
    clear,
    due,
    hold,
    let_go,
    parse_rule,
    prove,
    pull,
    push,
    push_all,
    read_manifest,
    release,
    sample_size,
    upper_share,
)
from anisoscope.inspection.archive_store import ArchiveError, FolderStore, open_store
from anisoscope.inspection.integrity import verify
from anisoscope.inspection.recompute import recompute
from anisoscope.record.schema import read_record, write_record

NOW = datetime(2026, 7, 1, tzinfo=UTC)


@pytest.fixture
def finished(inspected_part):
    return inspected_part[1].folder


@pytest.fixture
def folder_store(tmp_path):
    store = FolderStore(tmp_path / "share")
    check_format(store, begin=True)
    return store


def everything(store):
    return {
        one.name for below in ("inspections", "objects", "holds", "deleted") for one in store.files(below)
    }


def test_what_was_pushed_comes_back_and_is_judged_as_before(finished, folder_store, tmp_path):
    done = push(folder_store, finished)
    again = push(folder_store, finished)
    assert (done.new, again.new, again.sent_bytes) == (True, False, 0)
    assert done.sent_bytes >= sum(path.stat().st_size for path in finished.rglob("*") if path.is_file())
    (name,) = archived(folder_store)
    folder = pull(folder_store, read_manifest(folder_store, name), tmp_path / "restored")
    assert verify(folder).intact
    assert read_record(folder) == read_record(finished)
    assert recompute(folder).differences == ()
    assert pull(folder_store, read_manifest(folder_store, name), tmp_path / "restored") == folder


class Counting(FolderStore):
    """A folder that counts how often its objects are read."""

    def __init__(self, folder):
        super().__init__(folder)
        self.reads = Counter()

    def read(self, name):
        self.reads[name] += name.startswith("objects/")
        return super().read(name)


def test_what_inspections_share_is_read_back_once_but_again_where_it_went(finished, copy_of, tmp_path):
    store, model, proven = Counting(tmp_path / "share"), read_record(finished), set()
    check_format(store, begin=True)
    folders = [copy_of(finished, tmp_path / "out" / f"P-{n}", model, serial=f"P-{n}") for n in range(3)]
    push(store, folders[0], remove=True, proven=proven)
    push(store, folders[1], remove=True, proven=proven)
    assert set(store.reads.values()) == {0, 1}
    gone = next(file.object for file in read_manifest(store, archived(store)[0]).files if "dark" in file.name)
    store.delete(gone)
    push(store, folders[2], remove=True, proven=proven)
    assert store.reads[gone] == 2
    assert prove(store, 0.0, 0.95, np.random.default_rng(1)).intact


def test_two_stations_of_one_name_are_one_line_and_a_key_that_replaced_another_is_none(
    finished, copy_of, folder_store, tmp_path, monkeypatch
):
    model, lines = read_record(finished), []
    for name in "AB":
        make_key(tmp_path / f"{name}.pem")

    def inspect_and_push(key):
        monkeypatch.setenv(VARIABLE, str(tmp_path / f"{key}.pem"))
        number = len(list((tmp_path / "out").glob("*")))
        who = model.particulars.model_copy(update={"station": "line 1/east"})
        copy_of(finished, tmp_path / "out" / f"P-{number}", model, particulars=who)
        push_all(folder_store, [tmp_path / "out"], remove=False, tell=lines.append)
        return [line for line in lines if isinstance(line, str)]

    assert inspect_and_push("A") == []
    assert inspect_and_push("A") == []
    assert inspect_and_push("B") == []
    (line,) = inspect_and_push("A")
    assert line.startswith("two stations are called 'line 1/east': the keys ed25519:")
    assert line.endswith("sign in turn; give one of them another name")
    assert len(archived(folder_store)) == 4
    other = copy_of(finished, tmp_path / "other", model, serial="other")
    with pytest.raises(RecordError, match="shows a part of serial number T-1, not other"):
        push(folder_store, other)


def test_an_object_store_does_the_same(finished, s3, tmp_path):
    store = open_store(s3())
    with pytest.raises(ArchiveError, match="is no archive, or an empty one"):
        check_format(store)
    lines = []
    assert push_all(store, [finished.parent], remove=True, tell=lines.append) == (1, 0)
    assert lines[0].removed
    assert not finished.exists()
    proven = prove(store, 0.0, 0.95, np.random.default_rng(1))
    assert (proven.intact, proven.share, proven.hashed) == (True, 0.0, proven.objects)
    check_clock(store, datetime.now(UTC))
    with pytest.raises(ArchiveError, match="48 h ahead of that of the archive"):
        check_clock(store, datetime.now(UTC) + timedelta(days=2))
    (name,) = archived(store)
    folder = pull(store, read_manifest(store, name), tmp_path / "restored")
    assert verify(folder).intact
    found = due(store, [parse_rule("all:1")], NOW + timedelta(days=4000))
    let_go(store, found[0], "me", NOW)
    assert archived(store) == []
    assert clear(store, datetime.now(UTC))[0] == 0  # of today
    assert clear(store, datetime.now(UTC) + timedelta(days=2))[0] == proven.objects
    assert {name.split("/")[0] for name in everything(store)} == {"deleted"}


def test_wrong_credentials_and_a_server_that_is_gone_are_one_line(finished, s3, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setenv("AWS_SECRET_ACCESS_KEY", "wrong")
        with pytest.raises(
            ArchiveError, match=r"the server refuses these credentials .*: check AWS_ACCESS_KEY_ID"
        ):
            push_all(open_store(s3("other")), [finished.parent], remove=True, tell=print)
    with pytest.raises(ArchiveError, match=r"no answer, or a wrong one: ") as caught:
        push_all(open_store(s3("other", "http://127.0.0.1:9")), [finished.parent], remove=True, tell=print)
    assert "\n" not in str(caught.value)
    assert verify(finished).intact
    with pytest.raises(UsageError, match="not ftp://"):
        open_store("ftp://host/x")
    with pytest.raises(UsageError, match="name a bucket"):
        open_store("s3:///x")


class Dying(FolderStore):
    """A store whose program is killed before its n-th operation."""

    def __init__(self, folder, left):
        super().__init__(folder)
        self.left = left

    def _count(self):
        self.left -= 1
        if self.left < 0:
            os.kill(os.getpid(), signal.SIGKILL)

    def put(self, name, path):
        self._count()
        super().put(name, path)

    def write(self, name, content):
        self._count()
        super().write(name, content)

    def read(self, name):
        self._count()
        return super().read(name)

    def delete(self, name):
        self._count()
        super().delete(name)


def killed_in_a_child(work, left):
    """Run something in a child that is killed before an operation; whether it was."""
    child = os.fork()
    if child == 0:
        try:
            work(left)
        finally:
            os._exit(0)
    return os.WIFSIGNALED(os.waitpid(child, 0)[1])


def test_a_push_that_is_killed_anywhere_goes_on_and_loses_nothing(finished, tmp_path, monkeypatch):
    monkeypatch.setattr(module, "for_each", lambda function, items: [function(one) for one in items])
    share, out = tmp_path / "share", finished.parent
    record = read_record(finished)
    left, kills = 0, 0
    while killed_in_a_child(
        lambda n: push_all(Dying(share, n), [out], remove=True, tell=lambda _: None), left
    ):
        kills += 1
        left += 5
        store = FolderStore(share)
        names = archived(store)
        if finished.exists():
            assert verify(finished).intact
        else:  # removed: then it is proven
            (name,) = names
            assert prove(store, 0.0, 0.95, np.random.default_rng(1)).intact
    assert kills >= 5
    store = FolderStore(share)
    (name,) = archived(store)
    assert not finished.exists()
    assert not list(out.glob(".removed-*"))
    folder = pull(store, read_manifest(store, name), tmp_path / "restored")
    assert verify(folder).intact
    assert read_record(folder) == record


@contextlib.contextmanager
def files_up_to(count):
    """The operating system refuses every file that becomes longer, as on a full disk."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (count, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def test_a_store_without_space_is_one_line_and_the_push_goes_on_later(finished, folder_store, tmp_path):
    with files_up_to(50_000), pytest.raises(ArchiveError, match=r"cannot be written: File too large$"):
        push_all(folder_store, [finished.parent], remove=True, tell=lambda _: None)
    assert (archived(folder_store), verify(finished).intact) == ([], True)
    push_all(folder_store, [finished.parent], remove=True, tell=lambda _: None)
    (name,) = archived(folder_store)
    with files_up_to(50_000), pytest.raises(RecordError, match=r"cannot write .*: File too large$"):
        pull(folder_store, read_manifest(folder_store, name), tmp_path / "restored")
    assert verify(pull(folder_store, read_manifest(folder_store, name), tmp_path / "restored")).intact
    assert [one.name for one in (tmp_path / "restored").iterdir() if one.name.startswith(".")] == []


def test_a_mistyped_archive_holds_no_verdicts(tmp_path):
    with pytest.raises(ArchiveError, match="is no archive, or an empty one"):
        archived_verdicts(FolderStore(tmp_path / "archvie"))


def test_a_damaged_folder_and_a_damaged_archive_are_refused(finished, folder_store, tmp_path):
    path = finished / "frames" / "000_dark.tif"
    content = path.read_bytes()
    path.write_bytes(content[:-1] + b"!")
    with pytest.raises(RecordError, match=r"is not as it was \(frames/000_dark\.tif\): it is not archived"):
        push(folder_store, finished)
    path.write_bytes(content)
    push(folder_store, finished)
    name = next(one.name for one in folder_store.files("objects") if one.size == len(content))
    stored = folder_store.folder / name
    stored.write_bytes(stored.read_bytes()[:-1] + b"!")
    with pytest.raises(ArchiveError, match="the archive holds damaged files"):
        push(folder_store, finished, remove=True)
    assert verify(finished).intact
    with pytest.raises(ArchiveError, match="is damaged; it is frames/"):
        pull(folder_store, read_manifest(folder_store, archived(folder_store)[0]), tmp_path / "restored")
    assert prove(folder_store, 0.0, 0.95, np.random.default_rng(1)).damaged == (name,)
    stored.unlink()
    proven = prove(folder_store, 0.5, 0.95, np.random.default_rng(1))
    assert (proven.missing, proven.intact) == ((name,), False)
    push(folder_store, finished)  # sends what is missing
    assert prove(folder_store, 0.0, 0.95, np.random.default_rng(1)).intact


def with_serial(folder, serial, created_at, verdict):
    """A copy of an inspection under another serial number, sealed anew."""
    import shutil

    other = folder.parent / f"{serial}-{created_at:%Y%m%dT%H%M%SZ}"
    shutil.copytree(folder, other)
    record = read_record(other)
    changed = {"serial": serial, "created_at": created_at.isoformat(), "verdict": verdict}
    write_record(record.model_copy(update=changed), other)
    (other / "report.sha256").unlink()
    (other / "report.html").unlink()
    return other


def test_rules_delete_what_is_due_but_for_holds_and_leave_a_note(finished, folder_store):
    for serial, days, verdict in (
        ("P-1", 400, "PASS"),
        ("P-2", 300, "PASS"),
        ("F-1", 400, "FAIL"),
        ("P-3", 400, "PASS"),
    ):
        push(folder_store, with_serial(finished, serial, NOW - timedelta(days=days), verdict))
    rules = [
        parse_rule("FAIL:3650"),
        parse_rule("product=ridged test plate,PASS:365"),
        parse_rule("all:ever"),
    ]
    manifests = {read_manifest(folder_store, name).serial: name for name in archived(folder_store)}
    held = read_manifest(folder_store, manifests["P-3"])
    hold(folder_store, held, "claim 17", "R. R.", NOW)
    before = everything(folder_store)
    found = due(folder_store, rules, NOW)
    assert {one.inspection.serial: one.held for one in found} == {"P-1": None, "P-3": "claim 17"}
    assert everything(folder_store) == before
    with pytest.raises(UsageError, match="is under legal hold"):
        let_go(folder_store, next(one for one in found if one.held), "me", NOW)
    let_go(folder_store, next(one for one in found if not one.held), "me", NOW)
    count, _ = clear(folder_store, datetime.now(UTC) + timedelta(days=2))
    assert count == 1  # the record of P-1 is its own, all else is shared
    assert {read_manifest(folder_store, name).serial for name in archived(folder_store)} == {
        "P-2",
        "F-1",
        "P-3",
    }
    assert prove(folder_store, 0.0, 0.95, np.random.default_rng(1)).intact
    (note,) = (folder_store.folder / "deleted").iterdir()
    said = json.loads(note.read_text())
    assert (said["by"], said["rule"]) == ("me", "verdict PASS, product ridged test plate: 365 days")
    assert said["inspection"]["serial"] == "P-1"
    with pytest.raises(UsageError, match=r"already, by R\. R\.: claim 17"):
        hold(folder_store, held, "claim 18", "Q. Q.", NOW)
    assert release(folder_store, held, "it is settled", "Q. Q.", NOW)
    assert not release(folder_store, held, "it is settled", "Q. Q.", NOW)
    (note,) = (folder_store.folder / "released").iterdir()
    said = json.loads(note.read_text())
    assert (said["by"], said["reason"], said["hold"]["reason"]) == ("Q. Q.", "it is settled", "claim 17")


def test_a_retention_that_is_killed_anywhere_deletes_nothing_else_and_leaves_its_notes(finished, tmp_path):
    share, later = tmp_path / "share", datetime.now(UTC) + timedelta(days=2)
    store = FolderStore(share)
    check_format(store, begin=True)
    for serial, days in (("P-1", 400), ("P-2", 300), ("P-3", 400), ("P-4", 410)):
        push(store, with_serial(finished, serial, NOW - timedelta(days=days), "PASS"))
    there = {one.serial: one for one in (read_manifest(store, name) for name in archived(store))}
    hold(store, there["P-3"], "claim 17", "R. R.", NOW)

    def retain(left):
        dying = Dying(share, left)
        for one in due(dying, [parse_rule("PASS:365")], NOW):
            if one.held is None:
                let_go(dying, one, "me", NOW)
        clear(dying, later)

    left = 0
    while killed_in_a_child(retain, left):
        left += 1
        stays = {read_manifest(store, name).serial for name in archived(store)}
        noted = {
            json.loads(path.read_text())["inspection"]["serial"] for path in (share / "deleted").glob("*")
        }
        assert {"P-2", "P-3"} <= stays
        assert noted <= {"P-1", "P-4"}
        assert stays | noted == set(there)  # none is gone without its note
        assert prove(store, 0.0, 0.95, np.random.default_rng(1)).intact
    assert left >= 8
    assert {read_manifest(store, name).serial for name in archived(store)} == {"P-2", "P-3"}
    assert prove(store, 0.0, 0.95, np.random.default_rng(1)).intact
    (share / "clearing.json").unlink(missing_ok=True)


def test_a_push_does_not_end_while_objects_are_cleared_away(finished, folder_store):
    folder_store.write("clearing.json", datetime.now(UTC).isoformat().encode())
    with pytest.raises(ArchiveError, match="`archive retain` is at work there"):
        push(folder_store, finished, remove=True)
    assert verify(finished).intact
    folder_store.write("clearing.json", (datetime.now(UTC) - timedelta(days=2)).isoformat().encode())
    assert push(folder_store, finished, remove=True).removed


@pytest.mark.parametrize(("hours", "which"), [(26.0, "26 h ahead of"), (-3.0, "3 h behind")])
def test_a_clock_that_jumped_deletes_nothing(finished, folder_store, hours, which):
    now = datetime.now(UTC) + timedelta(hours=hours)
    with pytest.raises(ArchiveError, match=f"clock of this computer is {which} that of the archive: set the"):
        check_clock(folder_store, now)
    folder_store.write("clearing.json", datetime.now(UTC).isoformat().encode())
    with pytest.raises(ArchiveError, match="set the clock"):
        push(folder_store, finished, remove=True, now=now)
    assert verify(finished).intact
    check_clock(folder_store, datetime.now(UTC))


def test_a_mark_of_a_clock_that_was_years_ahead_stops_no_push(finished, folder_store):
    folder_store.write("clearing.json", (datetime.now(UTC) + timedelta(days=900)).isoformat().encode())
    assert push(folder_store, finished, remove=True).removed


def test_an_archive_of_a_later_version_is_left_alone(finished, folder_store):
    folder_store.write("archive.json", b'{"anisoscope_archive": 2}')
    with pytest.raises(ArchiveError, match=r"a later version of anisoscope .* \(2\): update anisoscope"):
        push_all(folder_store, [finished.parent], remove=True, tell=print)
    folder_store.write("archive.json", b"[")
    with pytest.raises(ArchiveError, match="is damaged"):
        check_format(folder_store)


@pytest.mark.parametrize(("objects", "share"), [(200, 0.05), (5000, 0.001), (1000, 0.01)])
def test_a_sample_finds_more_damage_than_stated_with_the_stated_confidence(objects, share):
    """More than the stated share is missed in 5 % of samples at most, and a tenth less is too few."""
    drawn = sample_size(objects, share, 0.95)
    bad = int(share * objects) + 1
    rng = np.random.default_rng(4)
    missed = np.mean(rng.hypergeometric(bad, objects - bad, drawn, size=20000) == 0)
    assert missed <= 0.05 + 4.0 * np.sqrt(0.05 * 0.95 / 20000)
    fewer = np.mean(rng.hypergeometric(bad, objects - bad, drawn - max(1, drawn // 10), size=20000) == 0)
    assert fewer > 0.05
    assert upper_share(objects, drawn, 0, 0.95) <= share
    assert sample_size(objects, 0.0, 0.95) == objects


@pytest.mark.parametrize("text", ["PASS", "PASS:0", "GOOD:10", "PASS:-1", ":x", "colour=red:5"])
def test_rules_that_are_none(text):
    with pytest.raises(UsageError, match=r"--rule takes WHAT:DAYS"):
        parse_rule(text)


def test_the_commands(finished, anisoscope, tmp_path):
    share, out = tmp_path / "share", finished.parent
    (tmp_path / "anisoscope.toml").write_text('store = "share"\n', encoding="utf-8")
    done = anisoscope("archive", "push", out, cwd=tmp_path)
    assert (done.code, "1 inspection in" in done.out) == (0, True), done.err
    listed = anisoscope("archive", "list", "T-1", "--store", share, "--json").json
    assert [one["serial"] for one in listed["inspections"]] == ["T-1"]
    proven = anisoscope("archive", "verify", "--store", share)
    assert (proven.code, "none damaged; at most" in proven.out) == (0, True)
    missing = anisoscope("archive", "pull", "X-9", cwd=tmp_path)
    assert (missing.code, "holds no inspection of 'X-9'" in missing.err) == (64, True)
    dry = anisoscope("archive", "retain", "--rule", "all:1", "--dry-run", cwd=tmp_path)
    assert "0 deleted" in dry.out
    unreasoned = anisoscope("archive", "hold", "T-1", "--release", cwd=tmp_path)
    assert (unreasoned.code, "ends for a reason: --reason TEXT" in unreasoned.err) == (64, True)
    assert Path(share / "archive.json").is_file()
