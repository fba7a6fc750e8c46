import json
import os
import subprocess
import sys
from pathlib import Path

SEEDS = range(20)
PROCESSES = 2

# The job of the demo without its pages, for many seeds in one process: pages do not change verdicts.
MANY_DEMOS = """
import json, sys
from pathlib import Path
from anisoscope import inspection
from anisoscope.cli.demo_files import PARTS, lay_out
from anisoscope.progress import silent

inspection.start_renderer = lambda surface: None
inspection.write_report = lambda record, pictures, folder, view: folder
verdicts = []
for seed in map(int, sys.argv[2:]):
    folder = lay_out(Path(sys.argv[1]) / str(seed), seed, silent)
    rigs = [folder / "bench" / name / "rig.toml" for name in PARTS]
    found = [inspection.inspect_part(folder / "recipe.toml", rig, "P", folder / "out") for rig in rigs]
    verdicts.append([inspected.record.verdict for inspected in found])
print(json.dumps(verdicts))
"""


def test_twenty_seeds_of_the_virtual_rig(tmp_path):
    """The good part never FAILs, the defective ones never PASS, and nearly all are decided."""
    environment = {**os.environ, "NUMBA_NUM_THREADS": "1"}
    running = [
        subprocess.Popen(
            [sys.executable, "-I", "-c", MANY_DEMOS, str(tmp_path), *map(str, SEEDS[start::PROCESSES])],
            env=environment,
            stdout=subprocess.PIPE,
            text=True,
        )
        for start in range(PROCESSES)
    ]
    verdicts = []
    for process in running:
        out, _ = process.communicate(timeout=900)
        assert process.returncode == 0
        verdicts += json.loads(out)
    assert len(verdicts) == len(SEEDS)
    assert all(good != "FAIL" for good, _, _ in verdicts), verdicts
    assert all("PASS" not in defective for _, *defective in verdicts), verdicts
    assert not any("INVALID" in three for three in verdicts), verdicts
    assert sum(three == ["PASS", "FAIL", "FAIL"] for three in verdicts) >= len(SEEDS) - 1, verdicts


def test_demo_writes_what_it_promises(anisoscope, demo_folder):
    records = sorted((demo_folder / "inspections").glob("*/record.json"))
    assert len(records) == 3
    assert {json.loads(path.read_text())["serial"] for path in records} == {
        "DEMO-good",
        "DEMO-burrs",
        "DEMO-angle",
    }
    assert all((Path(path).parent / "report.html").is_file() for path in records)


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
