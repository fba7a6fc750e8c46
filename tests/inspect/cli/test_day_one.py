"""docs/day-one.md, walked as it stands, on a virtual rig behind ptys: from the unpacked box to the first verdicts."""

import io
import json
import os
import re
import shlex
import shutil
import sys
import textwrap
import tomllib
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest
import tomli_w
from PIL import Image, ImageDraw

from anisoscope.cli import run
from anisoscope.inspection import run as inspection
from anisoscope.kinds.kind import Explanation
from anisoscope.rig.rigfile import read_rig
from anisoscope.sim.bench.bench import Bench
from anisoscope.sim.bench.benchfile import BenchFile, SamplePart
from anisoscope.sim.bench.serving import serve_bench, write_rig_file

DOCS = Path(__file__).resolve().parents[3] / "docs"
PAGE, FILM = (DOCS / "day-one.md").read_text(encoding="utf-8"), DOCS / "pictures" / "day-one.gif"
SHEET = DOCS / "pictures" / "day-one-steps.png"
STEP = re.compile(
    r"\*\*(the known part|the white tile|a part that must fail)\*\*|^```(sh|toml)\n(.*?)^```",
    re.MULTILINE | re.DOTALL,
)
NOT_HERE = re.compile(
    r"pip |anisoscope rig (sim|ports --probe|live)"
)  # installs, serves, opens every port, waits
LOBE = {"alpha_along": 0.06, "alpha_across": 0.10, "albedo": 0.2, "index": 1.5}
PART = {"kind": "ridges", "size_mm": 2.4, "resolved_alpha": 0.0, "material": LOBE}
SAMPLES = {
    "the known part": PART,
    "the white tile": {"kind": "white-tile"},
    "a part that must fail": PART | {"ridge_angle_deg": 14.0},
    "the fixture": {"kind": "none"},
}
STAGES = ("elliptec", "zaber", "grbl", "apt", "smc100")
GUESSES = ("zero_deg", "turns", "pixel_um", "angle_deg")


class Operator(io.StringIO):
    """A terminal at which somebody says yes, and takes the tile away when the fixture is asked for."""

    def __init__(self, bench):
        super().__init__()
        self.bench = bench

    def isatty(self):
        return True

    def readline(self):
        if self.bench.file.sample.kind == "white-tile":
            self.bench.lay(SamplePart(**SAMPLES["the fixture"]))
        return "y\n"


def fixture_of_page():
    return tomllib.loads(re.search(r"^```toml\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)[1])["fixture"]


def bench_of(fixture, protocol, turns, zero_deg):
    """A virtual rig of which the rig file of the page knows neither sense nor zero nor the size of a pixel."""
    return Bench(
        BenchFile.model_validate(
            {
                "schema": 1,
                "seed": 3,
                "sample": PART,
                "sensor": {"rows": 512, "cols": 512},
                "optics": {"pixel_um": 8.0, "blur_um": 5.0, "electrons": 6.0e6},
                "stage": {"protocol": protocol, "time_scale": 0.0, "turns": turns, "zero_deg": zero_deg},
                "geometry": {"light_angle_deg": 10.2},
                "fixture": fixture,
            }
        )
    )


def rig_of(page, bench, urls, path):
    """The rig file of the page with the devices of the bench in place of its own; all that is guessed stays."""
    write_rig_file(bench, urls, path)
    own = tomllib.loads(path.read_text(encoding="utf-8"))
    for table in ("stage", "camera", "light"):
        guessed = {key: value for key, value in page[table].items() if key in GUESSES}
        own[table] = own[table] | guessed
    path.write_text(
        tomli_w.dumps(page | {table: own[table] for table in ("stage", "camera", "light")}), "utf-8"
    )


def walk(folder, monkeypatch, stage, turns, zero_deg, *, quick, film=None):
    """Do what the page says, from top to bottom; exit codes by command. Quick: fewer pictures, no causes."""
    if quick:
        monkeypatch.setattr(inspection, "USUAL", inspection.Methods(diagnose=lambda *_: Explanation()))
    monkeypatch.chdir(folder)
    bench, codes = bench_of(fixture_of_page(), stage, turns, zero_deg), {}
    monkeypatch.setattr(sys, "stdin", Operator(bench))
    if film is not None:
        monkeypatch.setattr(bench, "photograph", film.watched(bench.photograph))
    with ExitStack() as stack:
        _, urls = serve_bench(bench, 0, stack, pty=True)
        for laid, language, text in STEP.findall(PAGE):
            if laid:
                bench.lay(SamplePart.model_validate(SAMPLES[laid]))
            elif language == "toml":
                rig_of(tomllib.loads(text), bench, urls, folder / "rig.toml")
            for line in text.splitlines() if language == "sh" else ():
                words = shlex.split(line, comments=True)
                if NOT_HERE.match(line) or (quick and words[1:3] == ["recipe", "check"]):
                    continue
                more = ["--step", "45"] if quick and words[2] == "commission" else []
                if film is not None:
                    film.scene(" ".join(words))
                codes[" ".join(words)] = run([*words[1:], *more])
    return codes


class Film:
    """What the camera sees on day one: a few pictures of every command, below its words."""

    SIDE, BAR, SHOWN = 288, 40, 6

    def __init__(self):
        self.scenes = []

    def scene(self, words):
        self.scenes.append((words, []))

    def watched(self, photograph):
        def take(exposure_s, gain):
            counts = photograph(exposure_s, gain)
            if counts.mean() > 80.0:  # the light is on
                self.scenes[-1][1].append(np.sqrt(np.clip(counts / 2400.0, 0.0, 1.0)))
            return counts

        return take

    def sheet(self, path, verdicts):
        """The first picture and one from the middle of every command that photographs, side by side for paper."""
        scenes = [(words, seen[0], seen[len(seen) // 2]) for words, seen in self.scenes if seen]
        sheet = Image.new("L", (len(scenes) * (self.SIDE + 8) - 8, self.BAR + 2 * self.SIDE + 8), 255)
        for column, (words, *ends) in enumerate(scenes):
            left = column * (self.SIDE + 8)
            serial = next((one for one in verdicts if one in words), "")
            text = " ".join(
                [words.removeprefix("anisoscope ").partition(" --")[0], serial, verdicts.get(serial, "")]
            )
            ImageDraw.Draw(sheet).text((left + 4, 8), text, 0, font_size=20)
            for row, one in enumerate(ends):
                shown = Image.fromarray((255 * one).astype(np.uint8)).resize((self.SIDE, self.SIDE))
                sheet.paste(shown, (left, self.BAR + row * (self.SIDE + 8)))
        sheet.quantize(48).save(path, optimize=True)

    def write(self, path, verdicts):
        pictures, spans_ms = [], []
        for words, seen in self.scenes:
            serial = next((one for one in verdicts if one in words), "")
            some = seen[:: max(1, len(seen) // self.SHOWN)][: self.SHOWN] or [np.zeros((8, 8))]
            for number, one in enumerate(some):
                picture = Image.new("L", (self.SIDE, self.SIDE + self.BAR), 255)
                picture.paste(
                    Image.fromarray((255 * one).astype(np.uint8)).resize((self.SIDE, self.SIDE)),
                    (0, self.BAR),
                )
                last = serial and number == len(some) - 1
                text = f"$ {words}\n{verdicts[serial]}" if last else f"$ {words}"
                lines = [line for part in text.split("\n") for line in textwrap.wrap(part, 48)]
                ImageDraw.Draw(picture).multiline_text(
                    (4, 2), "\n".join(lines[:2] + lines[2:][-1:]), 0, spacing=1
                )
                pictures.append(picture.quantize(48))
                spans_ms.append(2500 if last else 450 if seen else 1200)
        first, *others = pictures
        first.save(path, save_all=True, append_images=others, duration=spans_ms, loop=0, optimize=True)


def verdicts(folder):
    records = [json.loads(path.read_text()) for path in sorted((folder / "parts").glob("*/record.json"))]
    return {record["serial"]: record["verdict"] for record in records}


def check(folder, codes, turns, zero_deg):
    failed = {line: code for line, code in codes.items() if code and "FIRST-2" not in line}
    assert not failed
    assert verdicts(folder) == {"FIRST-1": "PASS", "FIRST-2": "FAIL"}
    found = read_rig(folder / "rig.toml")
    assert (found.stage.turns, found.camera.pixel_um) == (turns, pytest.approx(8.0, rel=0.002))
    assert (found.stage.zero_deg - zero_deg + 180.0) % 360.0 - 180.0 == pytest.approx(0.0, abs=0.01)
    assert 0.0 <= found.stage.zero_deg <= 360.0
    assert found.calibration.fixture == folder / "fixture.json"
    assert "# a guess" not in (folder / "rig.toml").read_text(encoding="utf-8")


def test_day_one_ends_with_a_part_that_passes_and_one_that_fails(tmp_path, monkeypatch, capsys):
    codes = walk(tmp_path, monkeypatch, "elliptec", "cw", 181.0, quick=True)
    check(tmp_path, codes, "cw", 181.0)
    said = capsys.readouterr()
    assert re.search(r"never commissioned; stage home and turn.*Go on\?", said.err)
    printed = re.search(r"^\[fixture\]\n.*?^greys = .*?\]$", said.out, re.MULTILINE | re.DOTALL)[0]
    assert tomllib.loads(printed)["fixture"] == fixture_of_page()
    for serial, angle_deg in (("FIRST-1", 10.0), ("FIRST-2", 14.0)):
        check_angle_map(tmp_path, serial, angle_deg, capsys)


def check_angle_map(folder, serial, angle_deg, capsys):
    """What `angle-map` prints and writes of a part, whose ridges are all alike and rougher than its recipe says."""
    (inspected,) = (folder / "parts").glob(f"{serial}-*")
    files = [folder / f"{serial}{suffix}" for suffix in (".csv", ".npz")]
    outs = [word for file in files for word in ("--out", str(file))]
    page = folder / f"{serial}.html"
    assert run(["angle-map", str(inspected), *outs, "--html", str(page), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["mean_deg"] == pytest.approx(angle_deg, abs=2.0 * found["u_mean_deg"])
    assert found["spread_deg"] < 0.2
    assert found["unseen_share"] < 0.01
    assert {one["ridge"] for one in found["ridges"]} >= set(range(-5, 6))
    head, *rows = files[0].read_text("utf-8").splitlines()
    assert head.startswith("x [mm],y [mm],ridge,across [deg],u [deg]")
    assert sum(row.endswith(",facet") for row in rows) == found["cells"]
    with np.load(files[1]) as arrays:
        assert np.isfinite(arrays["angle_deg"]).sum() == found["cells"]
    assert "The facets lean" in page.read_text("utf-8")
    assert "The facets lean" in (inspected / "report.html").read_text("utf-8")
    assert run(["angle-map", str(inspected), "--out", str(folder / "form.x3p")]) == 3
    assert "heights need the lean along the ridges" in capsys.readouterr().err
    assert run(["angle-map", str(inspected), "--out", str(folder / "form.doc")]) == 64
    assert "an angle map is written as .csv, .npz, .x3p" in capsys.readouterr().err


@pytest.mark.soak
def test_the_film_of_the_page_is_written(tmp_path, monkeypatch):
    film = Film()
    walk(tmp_path, monkeypatch, "zaber", "ccw", 37.0, quick=True, film=film)
    film.write(tmp_path / FILM.name, verdicts(tmp_path))
    film.sheet(tmp_path / SHEET.name, verdicts(tmp_path))
    with Image.open(tmp_path / FILM.name) as found:
        assert found.n_frames > 20
    if os.environ.get("ANISOSCOPE_WRITE_DOCS") == "1":
        shutil.copy(tmp_path / FILM.name, FILM)
        shutil.copy(tmp_path / SHEET.name, SHEET)


@pytest.mark.soak
@pytest.mark.parametrize("zero_deg", [0.0, 37.0, 181.0, 359.9])
@pytest.mark.parametrize("turns", ["ccw", "cw"])
@pytest.mark.parametrize("stage", STAGES)
def test_day_one_on_every_stage(tmp_path, monkeypatch, stage, turns, zero_deg):
    codes = walk(tmp_path, monkeypatch, stage, turns, zero_deg, quick=(stage, zero_deg) != ("zaber", 37.0))
    check(tmp_path, codes, turns, zero_deg)
