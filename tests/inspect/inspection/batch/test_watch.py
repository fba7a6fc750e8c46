"""Folders of frames that arrive: whole, in pieces, broken, twice; and a program that dies in between."""

import contextlib
import os
import shutil
import threading
import time
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import tomli_w
import zxingcpp

from anisoscope.base.errors import ConfigError, RecordError, UsageError
from anisoscope.base.regular_file import NO_FILE
from anisoscope.inspection.batch import watch as watching
from anisoscope.inspection.batch.watch import (
    WATCH_NAME,
    Watch,
    Watched,
    WatchJournal,
    arrivals,
    silence,
    whose,
)
from anisoscope.inspection.integrity import verify
from anisoscope.operations.demo.folder import FIXTURE
from anisoscope.operations.remembering import lot_mates, remember
from anisoscope.record.schema import read_record
from anisoscope.rig.frame import Frame
from anisoscope.rig.framefolder import write_frame_folder

RIG = {
    "schema": 1,
    "name": "elsewhere",
    "camera": {"driver": "folder", "pixel_um": 8.0},
    "light": {"driver": "none", "angle_deg": 10.0},
    "stage": {"driver": "manual"},
    "fixture": FIXTURE,
}


def frame(kind, stage_deg, level, rng):
    return Frame(
        counts=np.asarray(level + rng.integers(0, 4, (64, 64)), np.uint16),
        kind=kind,
        bit_depth=12,
        black_level=64.0,
        exposure_s=0.001,
        gain=1.0,
        stage_deg=stage_deg,
        commanded_deg=stage_deg,
        tilt_deg=0.0,
        captured_at="2026-01-01T00:00:00+00:00",
        camera="other 1",
    )


def write_part(folder, seed, rig=True, first=1000):
    """Frames without markers: INVALID, and quickly so; ``first`` is the level, or the picture, at the first pose."""
    rng = np.random.default_rng(seed)
    levels = [("dark", 0.0, 64), ("flat", 0.0, 2000), ("sample", 0.0, first), ("sample", 90.0, 800)]
    write_frame_folder(folder, [frame(*one, rng) for one in levels for _ in range(2)])
    if rig:
        (folder / "rig.toml").write_text(tomli_w.dumps(RIG))
    return folder


def coded(text, options=""):
    """(64, 64) counts of a part with a QR code."""
    code = zxingcpp.create_barcode(text, zxingcpp.BarcodeFormat.QRCode, options=options)
    share = np.kron(np.array(code.to_image(scale=1)) / 255.0, np.ones((2, 2)))
    picture = np.ones((64, 64))
    picture[: share.shape[0], : share.shape[1]] = share
    return 400.0 + 600.0 * picture


class Heard:
    """What was told."""

    def __init__(self):
        self.events = []

    def inspected(self, name, inspected):
        self.events.append((name, inspected.record.verdict))

    def same(self, name, other):
        self.events.append((name, f"same as {other}"))

    def bad(self, name, reason):
        self.events.append((name, reason))

    progress = staticmethod(silence)


@pytest.fixture
def start(undiagnosed):
    """``start(place, heard, remember)`` is a watch whose parts are inspected without diagnosis and drawing."""
    return partial(Watch, methods=undiagnosed)


@pytest.fixture
def look(start):
    """``look(place)``: one look of a program that has just been started; returns what was told, and the watch."""

    def once(place, remembered=None):
        heard, stop = Heard(), threading.Event()
        remember = lambda found: None if remembered is None else remembered.append(found.record.serial)  # noqa: E731
        started = start(place, heard, remember)
        with started.open():
            started.run_once(stop)
        return heard.events, started

    return once


@pytest.fixture
def place(tmp_path, virtual_rig):
    rig = virtual_rig(recipe={"poses": {"angles_deg": [0.0, 90.0]}})
    (tmp_path / "in").mkdir()
    return Watched(tmp_path / "in", tmp_path / "out", rig.recipe, settle_s=0.0, poll_s=0.02)


def inspections(place):
    return sorted(path.parent for path in place.out.glob("*/*/record.json"))


def test_every_folder_is_inspected_once_and_remembered(place, look):
    for number in range(3):
        write_part(place.root / f"P{number}", number)
    remembered = []
    assert look(place, remembered)[0] == [(f"P{number}", "INVALID") for number in range(3)]
    assert remembered == ["P0", "P1", "P2"]
    assert look(place, remembered)[0] == []
    assert len(inspections(place)) == len(remembered) == 3
    (place.root / "P1" / "frames.csv").touch()  # looked at again, but nothing is new
    write_part(place.root / "P3", 3)
    assert look(place, remembered)[0] == [("P3", "INVALID")]
    shutil.copytree(place.root / "P0", place.root / "Q0")
    assert look(place, remembered)[0] == [("Q0", "same as P0")]
    assert look(place, remembered)[0] == []


def test_frames_of_another_part_take_a_reason(place, look):
    write_part(place.root / "P0", 0)
    known = replace(place, used_before=lambda *_: "serial number A on 2026-01-01")
    ((name, reason),) = look(known)[0]
    assert name == "P0"
    assert "judged as serial number A on 2026-01-01" in reason
    assert "--reuse REASON" in reason
    assert inspections(place) == []
    assert look(replace(known, reuse="study of the gauge"))[0] == [("P0", "INVALID")]
    (folder,) = inspections(place)
    assert read_record(folder).reuse == "study of the gauge"


def test_what_is_wrong_with_one_folder_does_not_stop_the_line(place, start, look, tmp_path, monkeypatch):
    for name in ("P0", "P1", "P2"):
        write_part(place.root / name, int(name[1]))
    (place.root / "P0" / "part.toml").write_text("a = " + "[" * 1000)
    (serial, reason), *others = look(place)[0]
    assert (serial, "part.toml: tables or lists nested" in reason) == ("P0", True)
    assert others == [("P1", "INVALID"), ("P2", "INVALID")]

    def break_down(found):
        if found.record.serial == "P3":
            raise RuntimeError("never foreseen")

    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    for name in ("P3", "P4"):
        write_part(place.root / name, int(name[1]))
    heard, stop = Heard(), threading.Event()
    started = start(place, heard, break_down)
    with started.open():
        started.run_once(stop)
    told = dict(heard.events)
    assert told["P3"].startswith("internal error (RuntimeError: never foreseen): this is no verdict; ")
    assert told["P4"] == "INVALID"
    (log,) = tmp_path.glob("anisoscope-crash-*.log")
    assert "never foreseen" in log.read_text()
    assert look(place)[0][0][0] == "P0"  # and only that one: the record of P3 was there


def test_serial_number_and_lot_have_three_sources(place, look):
    folder = write_part(place.root / "P 1", 1)
    assert whose(folder) == ("P 1", whose(folder)[1])
    table = folder / "frames.csv"
    lines = table.read_text().splitlines()
    table.write_text("\n".join([lines[0] + ",serial,lot", *(line + ",A17,L7" for line in lines[1:])]))
    assert (whose(folder)[0], whose(folder)[1].lot) == ("A17", "L7")
    (folder / "part.toml").write_text('serial = "A18"\ncavity = "2"\noperator = "[bold]M. M."\n')
    serial, who = whose(folder)
    assert (serial, who.lot, who.cavity, who.operator) == ("A18", "L7", "2", "[bold]M. M.")
    look(place)
    (found,) = inspections(place)
    record = read_record(found)
    assert (record.serial, record.particulars) == ("A18", who)
    (folder / "part.toml").write_text("serail = 1\n")
    with pytest.raises(ConfigError, match="serail"):
        whose(folder)
    table.write_text("\n".join([lines[0] + ",serial", lines[1] + ",A17", lines[2] + ",A18"]))
    (folder / "part.toml").unlink()
    with pytest.raises(UsageError, match="line 3, column serial: 'A18', but 'A17' before"):
        whose(folder)
    with pytest.raises(UsageError, match="its name stands in for one; write it into"):
        whose(write_part(place.root / "#1", 1))


def test_bad_folders_are_told_once_and_inspected_when_they_are_mended(place, start):
    missing, torn, plain = (
        write_part(place.root / name, seed) for seed, name in enumerate(("A", "B", "C"), 1)
    )
    (kept := missing / "frame.away").write_bytes(b"")
    first = next(missing.glob("*.tif"))
    first.rename(kept)
    half = next(torn.glob("*.tif"))
    whole = half.read_bytes()
    half.write_bytes(whole[: len(whole) // 2])
    (place.root / "empty").mkdir()
    (place.root / ".hidden").mkdir()
    shutil.copytree(plain, place.root / "D.partial")
    heard, stop = Heard(), threading.Event()
    watch = start(place, heard, lambda _: None)
    with watch.open():
        for _ in range(3):
            watch.look(stop)
        assert [name for name, _ in heard.events] == ["A", "B", "C"]
        assert "the table names" in heard.events[0][1]
        assert half.name in heard.events[1][1]
        assert sorted(watch.bad) == ["A", "B"]
        kept.rename(first)
        half.write_bytes(whole)
        (place.root / "D.partial").rename(place.root / "D")
        watch.look(stop)
        assert heard.events[3:] == [("A", "INVALID"), ("B", "INVALID"), ("D", "same as C")]
        assert watch.bad == {}


def test_a_slowly_written_folder_is_taken_when_it_is_whole(place, start):
    source = write_part(place.root.parent / "source", 5)
    slow = place.root / "slow"

    def write():
        slow.mkdir()
        names = [TABLE, *sorted(path.name for path in source.iterdir() if path.name != TABLE)]
        for name in names:  # the table first: the worst order
            data = (source / name).read_bytes()
            with (slow / name).open("wb", buffering=0) as stream:
                for at in range(0, len(data), len(data) // 2 + 1):
                    stream.write(data[at : at + len(data) // 2 + 1])
                    time.sleep(0.02)

    place = Watched(place.root, place.out, place.recipe, settle_s=0.6, poll_s=0.02)
    heard, stop = Heard(), threading.Event()
    watch = start(place, heard, lambda _: stop.set())
    writer, timer = threading.Thread(target=write), threading.Timer(60.0, stop.set)
    with watch.open():
        writer.start()
        timer.start()
        watch.run(stop)
    writer.join()
    timer.cancel()
    assert heard.events[-1] == ("slow", "INVALID")
    (found,) = inspections(place)
    assert len(read_record(found).frames) == 8
    for path in (found / "frames").iterdir():
        assert path.read_bytes() == (source / path.name).read_bytes()


TABLE = "frames.csv"


class Killed(BaseException):
    """As kill -9: nothing runs afterwards."""


@pytest.mark.parametrize("moment", ["before", "while", "after", "noted"])
def test_whenever_it_dies_nothing_is_lost_and_nothing_doubled(place, monkeypatch, moment, look):
    write_part(place.root / "A", 1)
    write_part(place.root / "B", 2)
    remembered = []
    with monkeypatch.context() as patch:
        inspect, add = watching.inspect_frames, WatchJournal.add

        def die(*arguments, **options):
            if moment == "after":
                inspect(*arguments, **options)
            if moment == "while":
                options = {**options}
                arguments = list(arguments)
                arguments[4] = lambda doing, done, total: (
                    (_ for _ in ()).throw(Killed) if doing == "measurement" else None
                )
                inspect(*arguments, **options)
            raise Killed

        def die_later(journal, line):
            if line.line == "done":
                raise Killed
            add(journal, line)

        if moment == "noted":  # in the history, but not in the journal
            patch.setattr(WatchJournal, "add", die_later)
        else:
            patch.setattr(watching, "inspect_frames", die)
        with pytest.raises(Killed):
            look(place, remembered)
    if moment == "while":
        (left,) = (place.out / "A").iterdir()
        assert (left / "job.json").exists()
        assert not (left / "record.json").exists()
    look(place, remembered)
    assert sorted(set(remembered)) == ["A", "B"]
    assert [read_record(path).serial for path in inspections(place)] == ["A", "B"]
    assert look(place)[0] == []
    assert len(list((place.out / "A").iterdir())) == 1


def test_a_torn_line_of_the_journal_is_dropped_and_a_damaged_one_named(place, look):
    write_part(place.root / "A", 1)
    look(place)
    path = place.out / WATCH_NAME
    whole = path.read_bytes()
    path.write_bytes(whole + b'{"line": "begin", "fol')
    assert look(place)[0] == []
    assert path.read_bytes() == whole
    path.write_bytes(b"{}\n" + whole)
    with pytest.raises(RecordError, match="line 1 is damaged"):
        look(place)


def test_frames_that_change_while_they_are_copied_are_looked_at_again(place, monkeypatch, look):
    folder = write_part(place.root / "A", 1)
    inspect, picture = watching.inspect_frames, min(folder.glob("*.tif")).name
    read = (folder / picture).read_bytes()

    def change_first(*arguments, **options):
        monkeypatch.setattr(watching, "inspect_frames", inspect)
        shutil.rmtree(folder)
        write_part(folder, 2)
        return inspect(*arguments, **options)

    monkeypatch.setattr(watching, "inspect_frames", change_first)
    look(place)
    (first,) = inspections(place)
    assert (first / "frames" / picture).read_bytes() == read  # of what was read, and sealed as such
    assert look(place)[0] == [("A", "INVALID")]  # of what is there now
    assert look(place)[0] == []


def test_a_full_disk_is_tried_again_later(place, monkeypatch, start):
    write_part(place.root / "A", 1)

    def fail(*_, **__):
        raise RecordError("cannot write: No space left on device")

    heard, stop = Heard(), threading.Event()
    watch = start(place, heard, lambda _: None)
    with watch.open():
        with monkeypatch.context() as patch:
            patch.setattr(watching, "inspect_frames", fail)
            watch.look(stop)
            watch.look(stop)
        assert heard.events == [("A", "cannot write: No space left on device")]
        monkeypatch.setattr(watching.time, "monotonic", lambda now=time.monotonic: now() + 61.0)
        watch.look(stop)
    assert heard.events[1:] == [("A", "INVALID")]


def test_only_one_watch_works_in_a_folder_and_only_what_can_be_watched_is(place, look, start):
    watch = start(place, Heard(), lambda _: None)
    with watch.open(), pytest.raises(RecordError, match="another process is at work"):
        look(place)
    with pytest.raises(UsageError, match="there is no such folder to watch"):
        look(Watched(place.root / "none", place.out, place.recipe))


def test_old_folders_cost_one_look_at_their_table_each(place, monkeypatch, start):
    for number in range(300):
        (folder := place.root / f"old{number:03d}").mkdir()
        (folder / "frames.csv").write_text("x")
    watch = start(place, Heard(), lambda _: None)
    with watch.open(), contextlib.ExitStack() as stack:
        watch._journal.marks = {one.folder: one.mark for one in arrivals(place.root, place.out)}
        count, stat = [], os.stat
        patch = stack.enter_context(monkeypatch.context())
        patch.setattr(os, "stat", lambda *a, **k: (count.append(a), stat(*a, **k))[1])
        patch.setattr(watching, "signature_of", lambda _: 1 / 0)
        watch.look(threading.Event())
    assert len(count) <= 301


def test_the_code_on_a_part_says_who_it_is(place, look):
    place = replace(place, code_kind="any")
    root = place.root
    write_part(root / "by-code", 1, first=coded("A17"))
    write_part(root / "by-gs1", 2, first=coded("(10)L7(21)A18", "gs1"))
    write_part(root / "agreed", 3, first=coded("A19"))
    (root / "agreed" / "part.toml").write_text('serial = "A19"\nlot = "L8"\n')
    write_part(root / "wrong", 4, first=coded("A71"))
    (root / "wrong" / "part.toml").write_text('serial = "A17"\n')
    write_part(root / "wrong-lot", 5, first=coded("(10)L7(21)A20", "gs1"))
    (root / "wrong-lot" / "part.toml").write_text('lot = "L8"\n')
    write_part(root / "none", 6)
    events, watch = look(place)
    found = [read_record(path) for path in inspections(place)]
    assert [(one.serial, one.particulars.lot) for one in found] == [
        ("A19", "L8"),
        ("A17", None),
        ("A18", "L7"),
    ]
    told = dict(events)
    assert told["wrong"].endswith("wrong should hold A17, its code reads A71")
    assert told["wrong-lot"].endswith("wrong-lot should hold lot L8, its code reads lot L7")
    assert "no code can be read in" in told["none"]
    assert sorted(watch.bad) == ["none", "wrong", "wrong-lot"]
    (root / "wrong" / "part.toml").write_text('serial = "A71"\n')
    assert ("wrong", "INVALID") in look(place)[0]


def test_of_several_exposures_the_one_that_shows_the_code_is_read(place, look):
    rng = np.random.default_rng(1)
    pictures = [(0.001, 70), (0.004, coded("A17"))]
    frames = [replace(frame("dark", 0.0, 64, rng), exposure_s=at) for at, _ in pictures for _ in range(2)]
    frames += [replace(frame("flat", 0.0, 2000, rng), exposure_s=0.001) for _ in range(2)]
    for stage_deg in (0.0, 90.0):
        frames += [
            replace(frame("sample", stage_deg, one, rng), exposure_s=at)
            for at, one in pictures
            for _ in range(2)
        ]
    write_frame_folder(place.root / "B", frames)
    (place.root / "B" / "rig.toml").write_text(tomli_w.dumps(RIG))
    look(replace(place, code_kind="qr"))
    assert [read_record(path).serial for path in inspections(place)] == ["A17"]


def test_every_part_is_shown_beside_those_of_its_lot(place, undiagnosed, tmp_path, start):
    lots, write = [], undiagnosed.page

    def note(record, pictures, *others):
        lots.append((record.serial, pictures.lot and [part.serial for part in pictures.lot.parts]))
        return write(record, pictures, *others)

    history = tmp_path / "history.sqlite"
    for number in range(3):
        (write_part(place.root / f"P{number}", number) / "part.toml").write_text(f'lot = "L{number % 2}"\n')
    watch = start(
        replace(place, lot_mates=lambda lot: lot_mates(history, lot)),
        Heard(),
        lambda found: remember(found, history),
        methods=replace(undiagnosed, page=note),
    )
    with watch.open():
        watch.run_once(threading.Event())
    assert lots == [("P0", None), ("P1", None), ("P2", ["P0"])]


def test_parts_of_a_lot_that_were_judged_anew_are_heard_of(place, undiagnosed, start):
    for number in range(2):
        write_part(place.root / f"P{number}", number)
    judged, heard = [], Heard()

    def judge_lot(inspected):
        anew, judged[:] = tuple(judged), [*judged, inspected]
        return anew

    watch = start(replace(place, judge_lot=judge_lot), heard, lambda _: None, methods=undiagnosed)
    with watch.open():
        watch.run_once(threading.Event())
    assert [name for name, _ in heard.events] == ["P0", "P1", "P0 (judged anew)"]
    assert len(watch.verdicts) == 3


def test_links_to_themselves_and_pipes_do_not_stop_the_line(place, start):
    (place.root / "loop").symlink_to("loop")
    pipe = place.root / "pipe"
    pipe.mkdir()
    os.mkfifo(pipe / "frames.csv")
    write_part(place.root / "P1", 1)
    heard = Heard()
    watch = start(place, heard, lambda _: None)
    with watch.open():
        watch.run_once(threading.Event())
    assert ("P1", "INVALID") in heard.events
    assert [(name, text) for name, text in heard.events if name == "pipe" and NO_FILE in text]


def test_a_folder_that_is_away_for_a_while_ends_no_watch(place, start):
    heard, stop = Heard(), threading.Event()
    watch = start(replace(place, poll_s=0.01), heard, lambda _: None)
    away = place.root.with_name("away")
    with watch.open():
        line = threading.Thread(target=watch.run, args=(stop,))
        line.start()
        place.root.rename(away)
        until(lambda: any("it is tried again" in text for _, text in heard.events))
        write_part(away / "P1", 1)
        away.rename(place.root)
        until(lambda: any(name == "P1" for name, _ in heard.events))
        stop.set()
        line.join(20.0)
    assert not line.is_alive()
    assert sum("it is tried again" in text for _, text in heard.events) == 1


def until(happened, seconds=30.0):
    """Wait until something has happened."""
    end = time.monotonic() + seconds
    while not happened():
        assert time.monotonic() < end
        time.sleep(0.01)


def test_a_watch_that_starts_again_writes_the_last_reports(place, look):
    for number in range(2):
        write_part(place.root / f"P{number}", number)
    look(place)
    for folder in inspections(place):
        for name in ("report.html", "report.sha256"):
            (folder / name).unlink()
    assert look(place)[0] == []
    assert all(verify(folder).report_written and verify(folder).intact for folder in inspections(place))


def test_a_field_beyond_all_measure_is_bad_input(tmp_path):
    (tmp_path / "frames.csv").write_text("lot,file\n" + 200_000 * "x" + ",a.tif\n")
    with pytest.raises(UsageError, match=r"frames\.csv, line 2: field larger than field limit"):
        whose(tmp_path)
