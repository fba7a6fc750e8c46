import html
import json
import re
import tomllib
from pathlib import Path
from typing import get_args

import numpy as np
import pytest
import tomli_w

from anisoscope.base.language import shown as as_shown
from anisoscope.base.notation import true_minus
from anisoscope.base.progress import silent
from anisoscope.cli.demo.demo import SCENES, Kind
from anisoscope.inspection.recompute import recompute
from anisoscope.inspection.run import inspect_part
from anisoscope.operations.demo.ridges import PARTS, SCENE


@pytest.fixture
def verdicts_of(plain, tmp_path):
    """``verdicts_of(seed)`` runs the job of the demo without its pages: pages do not change verdicts."""

    def run(seed):
        folder = SCENE.lay_out(tmp_path / str(seed), seed, silent)
        rigs = [folder / "bench" / name / "rig.toml" for name in PARTS]
        found = [
            inspect_part(folder / "recipe.toml", rig, "P", folder / "out", methods=plain) for rig in rigs
        ]
        return [inspected.record.verdict for inspected in found]

    return run


@pytest.mark.soak
def test_twenty_seeds_of_the_virtual_rig(verdicts_of):
    """And nearly all are decided."""
    verdicts = [verdicts_of(seed) for seed in range(20)]
    assert all(good != "FAIL" for good, _, _ in verdicts), verdicts
    assert all("PASS" not in defective for _, *defective in verdicts), verdicts
    assert not any("INVALID" in three for three in verdicts), verdicts
    assert sum(three == ["PASS", "FAIL", "FAIL"] for three in verdicts) >= 19, verdicts


def test_demo_writes_what_it_promises(anisoscope, demo_folder):
    records = sorted((demo_folder / "inspections").glob("*/record.json"))
    assert len(records) == 3
    assert {json.loads(path.read_text())["serial"] for path in records} == {
        "DEMO-good",
        "DEMO-burrs",
        "DEMO-angle",
    }
    assert all((Path(path).parent / "report.html").is_file() for path in records)


def bytes_added(inspections):
    """Mean bytes that an inspection adds to what they have in common."""
    folders = [path.parent for path in inspections.glob("*/record.json")]
    files = [path.stat() for folder in folders for path in folder.rglob("*") if path.is_file()]
    return sum(one.st_size for one in files if one.st_nlink == 1) / len(folders)


def test_an_inspection_adds_20_mb(demo):
    assert bytes_added(demo[0] / "inspections") <= 20.5e6


@pytest.mark.soak
def test_with_jpeg_xl_an_inspection_adds_14_mb(tmp_path):
    folder = SCENE.lay_out(tmp_path, 5, silent)
    for name in PARTS:
        path = folder / "bench" / name / "rig.toml"
        table = tomllib.loads(path.read_text())
        table["camera"]["compression"] = "jpeg-xl"
        path.write_text(tomli_w.dumps(table))
        done = inspect_part(folder / "recipe.toml", path, f"P-{name}", folder / "out")
        assert recompute(done.folder).differences == ()
    assert bytes_added(folder / "out") <= 14e6


def test_page_1_of_its_reports_has_finding_action_and_pictures(demo_folder):
    paths = sorted((demo_folder / "inspections").glob("DEMO-*/report.html"))
    assert len(paths) >= 3
    for path in paths:
        conclusion = json.loads(path.with_name("record.json").read_text())["conclusion"]
        page_1 = path.read_text(encoding="utf-8").partition('<div lang="en">')[0]
        finding = re.search(r'<p id="finding"><bdi>([^<]+\.)</bdi>', page_1)[1]
        action = re.search(r'<p id="action"><strong>What to do next:</strong> <bdi>([^<]+\.)</bdi>', page_1)[
            1
        ]
        shown = [html.unescape(text).replace("\N{NO-BREAK SPACE}", " ") for text in (finding, action)]
        meant = [as_shown(true_minus(conclusion[key])) for key in ("finding", "action")]
        assert shown == [text.replace("\N{NO-BREAK SPACE}", " ") for text in meant]
        if "DEMO-angle" in path.parent.name:
            assert re.match(r"Ridges are about \d\.\d° (flatter|steeper) than designed \(", finding)
        pictures = re.search(r'<section class="poses" id="pictures">.*?</section>', page_1, re.DOTALL)[0]
        assert re.findall(r'alt="(\w+): ', pictures) == ["Measured", "Predicted", "Difference"] * 3


def test_facets_lean_as_the_parts_were_made(demo_folder):
    for part in ("good", "burrs", "angle"):
        (path,) = (demo_folder / "inspections").glob(f"DEMO-{part}-*/record.json")
        found = json.loads(path.read_text("utf-8"))["details"]["angles"]
        made = tomllib.loads((demo_folder / "bench" / part / "bench.toml").read_text("utf-8"))["sample"]
        assert found["mean_deg"] == pytest.approx(made["ridge_angle_deg"], abs=2.0 * found["u_mean_deg"])
        across = np.hypot(made["material"]["alpha_across"], made["resolved_alpha"]) / np.hypot(0.095, 0.03)
        assert found["alpha"] == pytest.approx(across, abs=2.0 * found["u_alpha"])


def test_its_rig_repeats_within_the_tenth_of_a_percent_that_the_docs_say(demo_folder):
    for path in (demo_folder / "inspections").glob("DEMO-*/record.json"):
        found = json.loads(path.read_text())["rig_monitor"]
        assert found["not_watched"] == []
        for pose in found["poses"]:
            assert abs(pose["level"] - 1.0) < 0.001
            assert abs(pose["stray"]) < 0.0005 * pose["white"]


@pytest.mark.soak
def test_demo_in_json_and_again_into_the_same_folder(anisoscope, demo_folder):
    done = anisoscope("demo", "--out", demo_folder, "--seed", 6, "--json")
    assert done.code == 0, done.err
    parts = done.json["parts"]
    assert [(part["serial"], part["expected"], part["verdict"]) for part in parts] == [
        ("DEMO-good", "PASS", "PASS"),
        ("DEMO-burrs", "FAIL", "FAIL"),
        ("DEMO-angle", "FAIL", "FAIL"),
    ]
    assert all(Path(part["report"]).is_file() for part in parts)
    assert len(list((demo_folder / "inspections").glob("*/record.json"))) == 6


def test_every_built_in_kind_has_a_demo_under_its_name():
    assert {"ridges", "wafers", "prints"} <= set(SCENES) <= set(get_args(Kind))
    assert (SCENES["wafer"], SCENES["print"]) == (SCENES["wafers"], SCENES["prints"])
