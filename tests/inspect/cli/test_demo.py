import json
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

SEEDS = range(20)


def test_twenty_seeds_of_the_virtual_rig(anisoscope, tmp_path):
    """The good part never FAILs, the defective ones never PASS, and the demo says so itself."""

    def demo(seed):
        return anisoscope("demo", "--out", tmp_path / str(seed), "--seed", seed, "--json", timeout=600)

    with ThreadPoolExecutor(2) as pool:
        finished = list(pool.map(demo, SEEDS))
    verdicts = [[part["verdict"] for part in done.json["parts"]] for done in finished]
    assert all(good != "FAIL" for good, _, _ in verdicts), verdicts
    assert all("PASS" not in defective for _, *defective in verdicts), verdicts
    assert not any("INVALID" in three for three in verdicts), verdicts
    expected = [verdict == ["PASS", "FAIL", "FAIL"] for verdict in verdicts]
    assert [done.code == 0 for done in finished] == expected
    assert sum(expected) >= len(SEEDS) - 2, verdicts


def test_demo_prints_json_as_documented(demo_folder):
    records = sorted((demo_folder / "inspections").glob("*/record.json"))
    assert len(records) == 3
    assert {json.loads(path.read_text())["serial"] for path in records} == {
        "DEMO-good",
        "DEMO-burrs",
        "DEMO-angle",
    }
    assert all((Path(path).parent / "report.html").is_file() for path in records)
