"""batch, watch and code as real commands: prompts, texts that stay text, kill −9."""

import importlib.util
import json
import random
import re
import shutil
import sqlite3
import time
from pathlib import Path

import pytest
import tomli_w

from anisoscope.calibration.pictures import take_flat
from anisoscope.cli.inspect.batch_operator import Terminal, table_of
from anisoscope.cli.tables import console
from anisoscope.history.rows import seal_of
from anisoscope.history.store import open_history
from anisoscope.inspection.batch.journal import read_batch
from anisoscope.inspection.batch.tray import read_tray
from anisoscope.inspection.integrity import verify
from anisoscope.operations.demo.folder import FIXTURE
from anisoscope.rig.frame import read_frame
from anisoscope.rig.framefolder import read_frame_folder, write_frame_folder

SPEC = importlib.util.spec_from_file_location("nursery", Path(__file__).with_name("nursery.py"))
nurseries = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(nurseries)

EXPOSURE_S = 0.0015
RECIPE = {
    "schema": 1,
    "product": "ridged [red]plate[/]",
    "surface": {"pitch_um": 100.0, "design": {"ridge_angle_deg": 10.0}},
    "material": {"alpha_along": 0.06, "alpha_across": 0.10, "albedo": 0.2, "index": 1.5, "u_tail": 0.0},
    "poses": {"angles_deg": [0.0, 90.0]},
    "acquisition": {"exposure_s": EXPOSURE_S, "frames_per_pose": 2, "dark_frames": 2, "settle_s": 0.0},
    "region": {"size_mm": [1.0, 1.0]},
    "decision": {"tolerance": 0.3},
}
# Pictures of a tile have no markers: INVALID, and quickly so.
BENCH = {
    "schema": 1,
    "seed": 11,
    "sample": {"kind": "white-tile"},
    "sensor": {"rows": 128, "cols": 128},
    "optics": {"pixel_um": 8.0, "blur_um": 5.0, "electrons": 2.4e7},
    "stage": {"time_scale": 0.0},
    "fixture": FIXTURE,
}
INVALID = 3
SLOTS = 4


@pytest.fixture(scope="module")
def rig(tmp_path_factory):
    folder = tmp_path_factory.mktemp("batch") / "rig"
    folder.mkdir()
    part = {"driver": "simulated", "options": {"bench": "${here}/bench.toml"}}
    file = {
        "schema": 1,
        "name": "virtual rig",
        "stage": {
            "driver": "elliptec",
            "port": "sim://elliptec?bench=${here}/bench.toml",
            "zero_deg": 10.0,
            "options": {"move_gap_s": 0.0},
        },
        "camera": part | {"pixel_um": 8.0},
        "light": part,
        "fixture": FIXTURE,
    }
    (folder / "bench.toml").write_text(tomli_w.dumps(BENCH))
    (folder / "rig.toml").write_text(tomli_w.dumps(file))
    take_flat(folder / "rig.toml", folder / "flat.tif", exposure_s=EXPOSURE_S, frames=4)
    (folder / "rig.toml").write_text(tomli_w.dumps(file | {"calibration": {"flat": "flat.tif"}}))
    (folder / "recipe.toml").write_text(tomli_w.dumps(RECIPE))
    rows = [f"{number},A{number},[bold]L{number}<b>," for number in range(1, SLOTS + 1)]
    (folder / "tray.csv").write_text("\n".join(["slot,serial,lot,cavity", *rows]))
    return folder


@pytest.fixture(scope="module")
def start(tmp_path_factory, rig):
    """``start("batch", …)`` runs the command line on a terminal of its own."""
    folder = tmp_path_factory.mktemp("nursery")
    with nurseries.nursery(folder, rig / "recipe.toml") as command:
        yield command


def batch_of(rig, out, *more):
    job = ("batch", rig / "tray.csv", "-r", rig / "recipe.toml", "-g", rig / "rig.toml", "--out", out)
    return (*job, "--history", out / "history.sqlite", *more)


def rows_in(path):
    with sqlite3.connect(path) as database:
        found = database.execute("select serial, seal from inspections").fetchall()
    database.close()
    return found


def wait_until(command, condition, what):
    deadline = time.monotonic() + 120
    while command.running and not condition():
        assert time.monotonic() < deadline, f"{what} never came: {command._shown[-800:].decode()}"
        time.sleep(0.005)


def assert_kept(out, said):
    """What was said to be done is kept; the history and the folders show whole inspections, each once.

    Args:
        out: folder of the inspections, with the history.
        said: serial numbers whose verdict was shown.
    """
    folders = [path.parent for path in out.rglob("record.json")]
    assert all(verify(folder).intact for folder in folders)
    seals = {seal_of(folder) for folder in folders}
    rows = []
    if (out / "history.sqlite").exists():
        with open_history(out / "history.sqlite") as history:
            assert history.verify_chain() == []
            rows = history.rows()
    assert len(rows) == len({row.seal for row in rows})
    assert {row.seal for row in rows} <= seals
    assert all(len(row.reasons) > 0 and row.verdict == "INVALID" for row in rows)
    assert set(said) <= {row.serial for row in rows}


def assert_complete(out, serials):
    """Every part was inspected once, and every inspection stands in the history once."""
    assert_kept(out, serials)
    records = [json.loads(path.read_text()) for path in out.rglob("record.json")]
    assert sorted(record["serial"] for record in records) == sorted(serials)
    assert len(rows_in(out / "history.sqlite")) == len(serials)


def kill_at_random(command, journal, rng, parts):
    """Kill a command at a random moment of its work; returns whether it hit, and what was shown.

    Args:
        command: a batch or a watch.
        journal: its journal, which says ``"done"`` once for every part that is.
        rng: draws how many parts it may finish first, and how far it may come with the next.
        parts: how many parts there are.
    """

    def done():
        return journal.read_bytes().count(b'"done"') if journal.exists() else -1

    before = max(done(), 0)
    wanted = before + rng.randrange(max(parts - before, 1))
    wait_until(command, lambda: done() >= wanted, "the journal")
    time.sleep(rng.uniform(0.0, 0.4))
    command.interrupt("SIGKILL")
    code, shown = command.finish()
    assert "Traceback" not in shown
    assert code in {-9, INVALID}, shown
    return code == -9, shown


def kill_batches(start, rig, out, rng):
    """A batch that is killed up to three times and then goes on to its end; returns how many kills hit."""
    out.mkdir()
    begun, kills, said = out / "batch-tray" / "batch.json", 0, set()
    for attempt in range(3):
        more = ("--resume",) if begun.exists() else ()
        if attempt == 0 or more:
            hit, shown = kill_at_random(start(*batch_of(rig, out, "--yes", *more)), begun, rng, SLOTS)
            kills += hit
            said |= set(re.findall(r"slot \d+, (A\d+): INVALID", shown))
            assert_kept(out, said)
            if begun.exists():
                assert said <= {
                    slot.serial for slot in read_batch(begun.parent).slots if slot.state == "done"
                }
    command = start(*batch_of(rig, out, "--yes", *(("--resume",) if begun.exists() else ())))
    code, shown = command.finish(120)
    assert code == INVALID, shown
    assert [slot.state for slot in read_batch(begun.parent).slots] == ["done"] * SLOTS
    assert_complete(out, [f"A{number}" for number in range(1, SLOTS + 1)])
    return kills


def enough(kills_of, wanted):
    """Rounds until so many kills have hit; on a quick machine some come too late."""
    kills = rounds = 0
    while kills < wanted:
        assert rounds < 2 * wanted, f"{kills} of {rounds} rounds were hit"
        kills += kills_of(rounds)
        rounds += 1
    return kills


def test_after_kill_9_a_batch_goes_on_and_doubles_nothing(start, rig, tmp_path):
    rng = random.Random(1)
    assert enough(lambda number: kill_batches(start, rig, tmp_path / str(number), rng), 2) >= 2


@pytest.mark.soak
def test_fifty_kills_of_a_batch(start, rig, tmp_path):
    rng = random.Random(2)
    kills = enough(lambda number: kill_batches(start, rig, tmp_path / str(number), rng), 50)
    assert kills >= 50


def test_a_person_at_the_terminal(start, rig, tmp_path):
    out = tmp_path / "out"
    out.mkdir()
    command = start(*batch_of(rig, out))
    for number, answer in enumerate(("\r", "]d210[bold]L2<b>", "s\r", "q\r"), start=1):
        wait_until(
            command, lambda n=number: f"slot {n}: place part A{n}".encode() in command._shown, "the prompt"
        )
        text = "]d121A2\r" if number == 2 else answer
        nurseries.os.write(command._ours, text.encode())
    code, shown = command.finish()
    assert code == INVALID, shown
    batch = json.loads((out / "batch-tray" / "batch.json").read_text())
    assert [slot["state"] for slot in batch["slots"]] == ["done", "done", "skipped", "waiting"]
    assert "slot 2 should hold A2, its code reads 21A2" in " ".join(shown.split())
    assert "lot [bold]L1<b>" in shown  # as it stands in the list
    assert (out / "batch-tray" / "batch.html").exists()


def test_inspect_takes_a_scanned_serial_number_and_lot(start, rig, tmp_path):
    job = (
        "inspect",
        "-r",
        rig / "recipe.toml",
        "-g",
        rig / "rig.toml",
        "--out",
        tmp_path,
        "--history",
        "none",
    )
    command = start(*job)
    wait_until(command, lambda: b"serial number (type it" in command._shown, "the prompt")
    nurseries.os.write(command._ours, b"]d210L7<GS>21A 17\r")
    code, shown = command.finish()
    assert code == INVALID, shown
    (path,) = tmp_path.glob("*/record.json")
    record = json.loads(path.read_text())
    assert (record["serial"], record["particulars"]["lot"]) == ("A 17", "L7")


def test_texts_of_the_list_stay_texts(rig, capsys):
    from anisoscope.inspection.batch.journal import new_batch

    tray = read_tray(rig / "tray.csv")
    batch = new_batch(tray, rig / "recipe.toml", rig / "rig.toml", None, None)
    batch = batch.with_slot(0, state="fault", reason="[red]no[/red] [link=x]")
    console().print(table_of(batch))
    Terminal(quiet=False, answers=False).finished(batch, 0)
    said = capsys.readouterr()
    assert "[red]no[/red] [link=x]" in said.out
    assert "[red]no[/red] [link=x]" in said.err


@pytest.fixture(scope="module")
def arriving(start, rig, tmp_path_factory):
    """A folder with one part's frames, as they arrive."""
    out = tmp_path_factory.mktemp("taken")
    command = start(
        "inspect",
        "-r",
        rig / "recipe.toml",
        "-g",
        rig / "rig.toml",
        "-s",
        "T",
        "--out",
        out,
        "--history",
        "none",
    )
    assert command.finish()[0] == INVALID
    frames = [read_frame(path) for path in sorted(out.glob("*/frames/*.tif"))]
    write_frame_folder(out / "source", frames)
    return out / "source"


PARTS = [f"P{number}" for number in range(4)]


def lay_in(arriving, root):
    """Four folders with nearly the same frames, each said to show another part."""
    entries = read_frame_folder(arriving).entries
    for number, name in enumerate(PARTS):
        frames = [entry.load() for entry in entries]
        for frame in frames:
            frame.counts[0, number] ^= 1
        write_frame_folder(root / name, frames, [entry.again for entry in entries])
        (root / name / "part.toml").write_text(f'serial = "{name}"\nlot = "[b]"\n')


def watching(rig, root, out, *more):
    job = (
        "watch",
        root,
        "-r",
        rig / "recipe.toml",
        "-g",
        rig / "rig.toml",
        "--out",
        out,
        "--stable-for",
        0.1,
    )
    return (*job, "--poll", 0.05, "--history", out / "history.sqlite", *more)


def kill_watches(start, rig, arriving, place, rng):
    """A watch that is killed three times and then inspects what is left; returns how many kills hit."""
    root, out = place / "in", place / "out"
    out.mkdir(parents=True)
    lay_in(arriving, root)
    kills, said = 0, set()
    for _ in range(3):
        hit, shown = kill_at_random(start(*watching(rig, root, out)), out / "watch.jsonl", rng, len(PARTS))
        kills += hit
        said |= set(re.findall(r"(P\d): INVALID", shown))
        assert_kept(out, said)
    command = start(*watching(rig, root, out))
    wait_until(
        command,
        lambda: b"Ctrl-C ends" in command._shown and len(list(out.glob("*/*/record.json"))) == len(PARTS),
        "the last record",
    )
    command.interrupt("SIGTERM")
    code, shown = command.finish()
    assert code == 0, shown
    assert "Traceback" not in shown
    assert_complete(out, PARTS)
    return kills


def test_after_kill_9_watch_goes_on_and_ends_when_it_is_told(start, rig, arriving, tmp_path):
    rng = random.Random(3)
    assert enough(lambda n: kill_watches(start, rig, arriving, tmp_path / str(n), rng), 3) >= 3
    out = tmp_path / "0" / "out"
    records = [json.loads(path.read_text()) for path in out.rglob("record.json")]
    assert {record["particulars"]["lot"] for record in records} == {"[b]"}
    code, shown = start(*watching(rig, tmp_path / "0" / "in", out, "--once", "--json")).finish()
    assert (code, json.loads(shown.strip().splitlines()[-1])["counts"]) == (0, {})


@pytest.mark.soak
def test_fifty_kills_of_a_watch(start, rig, arriving, tmp_path):
    rng = random.Random(4)
    kills = enough(lambda n: kill_watches(start, rig, arriving, tmp_path / str(n), rng), 50)
    assert kills >= 50


def test_code_reads_a_file_and_the_camera(start, rig, tmp_path):
    bench = BENCH | {
        "sample": {
            "kind": "ridges",
            "size_mm": 0.2,
            "code": {"text": "A17", "x_mm": 0, "y_mm": 0, "width_mm": 0.9},
        },
        "sensor": {"rows": 256, "cols": 256},
    }
    place = tmp_path / "rig"
    shutil.copytree(rig, place)
    bench["sample"]["code"] |= {"x_mm": 0.5, "y_mm": 0.5, "kind": "qr"}
    (place / "bench.toml").write_text(tomli_w.dumps(bench))
    code, shown = start("read-code", "--rig", place / "rig.toml", "-r", place / "recipe.toml").finish()
    assert (code, shown.strip()) == (0, "QR code: A17")
    code, shown = start("read-code", rig / "flat.tif").finish()
    assert code in {3, 74}
    code, shown = start("read-code").finish()
    assert (code, "name a picture, or a rig file" in shown) == (64, True)
