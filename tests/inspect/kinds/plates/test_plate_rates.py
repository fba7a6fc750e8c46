"""Plates with tolerances through the whole inspection: verdicts, defects by name, and what the code says."""

import numpy as np
import pytest

from anisoscope.base.progress import silent
from anisoscope.inspection.run import inspect_part
from anisoscope.operations.demo import plates as demo
from anisoscope.operations.demo.folder import write_bench
from anisoscope.profiles.plates import Plan

pytestmark = pytest.mark.soak

KINDS = ("good", "good", "missing", "good", "direction", "good", "merged", "good", "filled", "turned")
NAMES = {"missing": "missing", "direction": "wrong direction", "merged": "merged", "filled": "filled"}
PLATES = 40


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return demo.SCENE.lay_out(tmp_path_factory.mktemp("plates"), 1, silent)


def test_forty_plates_get_their_verdicts(folder):
    rows, rng = demo.plan_rows(), np.random.default_rng(7)
    wrong, passed = [], []
    for number in range(PLATES):
        kind, name = KINDS[number % len(KINDS)], f"P-{number}"
        sample = demo.sample("good", rows, rng)
        place = {"row": int(rng.integers(12)), "col": int(rng.integers(12))}
        if kind in NAMES:
            sample["plate"]["defects"] = [place | {"defect": kind}]
        if kind == "turned":
            turned = Plan(rows, demo.AZIMUTHS_DEG, demo.MODULE_MM).turned(1 + number // len(KINDS) % 3)
            sample["plate"] |= {"plan": list(turned.rows), "facet_azimuths_deg": dict(turned.azimuths_deg)}
        write_bench(folder, name, demo.bench(sample, int(rng.integers(2**31))), demo.rig(name))
        record = inspect_part(
            folder / "recipe.toml", folder / "bench" / name / "rig.toml", name, folder / "inspections"
        ).record
        if kind == "turned":
            # by 180° no class faces the light in any pose, and nothing of the plan is seen
            right = record.verdict == "INVALID" and (
                "the plate lies turned by" in record.reasons[0]
                or "not those of the plan" in record.reasons[0]
            )
        elif kind == "good":
            passed.append(record.verdict == "PASS")  # T/U is 1.6, so that one in ten is undecided
            right = record.verdict != "FAIL" and record.details.code.unread == ()
        else:
            (found,) = [one for one in record.details.fields if one.verdict == "FAIL"]
            right = (found.row, found.col, found.looks_like) == (place["row"], place["col"], NAMES[kind])
            right &= record.verdict == "FAIL"
        if not right:
            wrong.append((name, kind, place, record.verdict, record.reasons))
    assert wrong == []
    assert np.mean(passed) >= 0.75
