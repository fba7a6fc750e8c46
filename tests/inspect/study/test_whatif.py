"""Kept inspections under another recipe: the verdicts of the frames, without the frames where these are not needed."""

import json
import os
import time
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import tomli_w

from anisoscope.base.errors import UsageError
from anisoscope.base.json_fields import as_json
from anisoscope.cli import run
from anisoscope.cli.history.options import filters_of
from anisoscope.cli.history.whatif import selection
from anisoscope.history.rows import Row, row_of
from anisoscope.history.store import open_history
from anisoscope.operations.past import write_whatif_page
from anisoscope.parameters.workers import Workers
from anisoscope.record.schema import read_record
from anisoscope.study import whatif as module
from anisoscope.study.whatif import Costs, what_if

HERE = Workers(1)


def row(folder, number=1):
    new = row_of(read_record(folder), folder)
    return Row(**vars(new), id=number)


@pytest.fixture
def past(inspected_part):
    """A recipe that can be written anew, and the row of a finished inspection by it."""
    rig, inspected = inspected_part
    table = tomllib.loads(rig.recipe.read_text(encoding="utf-8"))

    def other(**changes):
        path = rig.recipe.with_name("other.toml")
        path.write_text(
            tomli_w.dumps(table | {k: table.get(k, {}) | v for k, v in changes.items()}), encoding="utf-8"
        )
        return path

    return other, row(inspected.folder)


def test_the_same_recipe_changes_nothing(past):
    other, one = past
    found = what_if(other(), [one], {}, HERE)
    (part,) = found.inspections
    assert (part.before, part.after, part.judged_from, part.flip) == ("PASS", "PASS", "kept", None)
    assert found.flips == {}


def test_a_tolerance_is_judged_from_what_was_kept_as_from_the_frames(past, monkeypatch):
    other, one = past
    recipe = other(decision={"tolerance": 0.0005})
    kept = what_if(recipe, [one], {1: "accept"}, HERE, Costs(900.0, 4.0))
    (part,) = kept.inspections
    assert part.after != "PASS"
    assert (part.judged_from, kept.from_kept) == ("kept", 1)
    monkeypatch.setattr(
        type(module._plan(recipe.resolve(), "x").kind), "needs_frames", lambda *_: "a test asks"
    )
    from_frames = what_if(recipe, [one], {}, HERE)
    assert from_frames.inspections[0].judged_from == "frames"
    assert from_frames.inspections[0].frames_because == "a test asks"
    assert (from_frames.inspections[0].after, from_frames.inspections[0].reasons) == (
        part.after,
        part.reasons,
    )
    assert json.dumps(as_json(kept))


def test_a_fault_of_the_rig_takes_a_fail_back_as_in_the_inspection(virtual_rig, plain, monkeypatch):
    rig = virtual_rig(bench={"faults": {"seated_deg": 180.0}})
    inspected = rig.inspect(methods=plain)
    assert inspected.record.verdict == "INVALID"
    assert inspected.record.diagnosis.rig_fault == "turned-180"
    one = row(inspected.folder)
    (kept,) = what_if(rig.recipe, [one], {}, HERE).inspections
    assert (kept.after, kept.judged_from) == ("INVALID", "kept")
    assert kept.reasons[0] == inspected.record.reasons[0]
    kind = module._plan(rig.recipe.resolve(), "x").kind
    monkeypatch.setattr(type(kind), "needs_frames", lambda *_: "a test asks")
    (frames,) = what_if(rig.recipe, [one], {}, HERE).inspections
    assert (frames.after, frames.judged_from, frames.reasons[0]) == ("INVALID", "frames", kept.reasons[0])


def test_another_region_takes_the_frames_and_says_so(past):
    other, one = past
    (part,) = what_if(other(region={"size_mm": [0.8, 0.8]}), [one], {}, HERE).inspections
    assert (part.after, part.judged_from) == ("PASS", "frames")
    assert part.frames_because.startswith("region is ")


def test_a_changed_limit_of_drift_makes_it_invalid(past):
    other, one = past
    (part,) = what_if(other(limits={"drift": 1e-9}), [one], {}, HERE).inspections
    assert (part.after, part.judged_from) == ("INVALID", "kept")
    assert "at the end the first pose is" in part.reasons[0]


def test_what_cannot_be_judged_says_why(past, tmp_path):
    other, one = past
    rows = [
        replace(one, id=1, folder=str(tmp_path / "gone")),
        replace(one, id=2, seal="0" * 64),
        replace(one, id=3),
    ]
    found = what_if(other(poses={"angles_deg": [0.0, 45.0]}), rows, {}, HERE)
    reasons = [part.reasons[0] for part in found.unjudged]
    assert "was this inspection finished" in reasons[0]
    assert "holds another record than the history knows" in reasons[1]
    assert reasons[2] == "it was not photographed at 45°, tilt 0°"
    with pytest.raises(UsageError, match="no inspection is selected"):
        what_if(other(), [], {}, HERE)


def test_risks_are_counted_against_reviewers_with_intervals():
    parts = [
        ("reject", "PASS"),
        ("rework", "FAIL"),
        ("accept", "PASS"),
        ("accept", "FAIL"),
        (None, "FAIL"),
        ("hold", "PASS"),
    ]
    risks = module._risks(parts, Costs(100.0, 7.0))
    assert (risks.escapes.count, risks.escapes.of) == (1, 2)
    assert (risks.false_rejects.count, risks.false_rejects.of) == (1, 2)
    assert risks.cost == 107.0
    # Clopper and Pearson for 1 of 2: 0.0126 to 0.9874
    assert risks.escapes.low == pytest.approx(1.0 - np.sqrt(0.975), rel=1e-9)
    assert risks.escapes.high == pytest.approx(np.sqrt(0.975), rel=1e-9)
    assert module._risks([], None).cost is None


def test_the_page_shows_the_flips(past, tmp_path):
    other, one = past
    found = what_if(other(decision={"tolerance": 0.0005}), [one], {1: "accept"}, HERE)
    write_whatif_page(tmp_path / "flips.html", found, {1: one})
    page = (tmp_path / "flips.html").read_text(encoding="utf-8")
    assert "What if: 1 of 1 verdicts change" in page
    assert page.count("data:image/jpeg;base64,") == 1
    assert "0 of 1: 0 % (95 %: 0 to 98 %)" in page or "1 of 1: 1e+02 %" in page


@pytest.mark.parametrize(
    ("where", "message"),
    [(["colour=red"], "KEY=VALUE with one of since"), (["lot"], "KEY=VALUE"), (["lot=1", "lot=2"], "twice")],
)
def test_conditions_that_are_none(where, message):
    with pytest.raises(UsageError, match=message):
        selection(where)


@pytest.mark.parametrize("page", ["recipe.toml", "none/page.html"])
def test_a_page_that_cannot_be_written_is_refused_before_the_work(tmp_path, capsys, page):
    recipe = tmp_path / "recipe.toml"
    recipe.write_text("schema = 1")
    command = ["whatif", "--recipe", recipe, "--html", tmp_path / page, "--history", tmp_path / "h.sqlite"]
    assert run([str(one) for one in command]) == 64
    assert "name a page in a folder that exists, not the recipe" in capsys.readouterr().err
    assert recipe.read_text() == "schema = 1"


def test_conditions_are_those_of_the_history():
    assert filters_of(selection(["lot=L=1", "verdict=fail"])).verdict == "FAIL"


COUNT = int(os.environ.get("ANISOSCOPE_SOAK_INSPECTIONS", "10000"))


@pytest.fixture
def many(past, copy_of, tmp_path):
    """``many(count)`` gives the rows of so many inspections that share their files by hard links."""
    other, one = past
    base, model = Path(one.folder), read_record(Path(one.folder))

    def make(count):
        folders = [tmp_path / "many" / f"P-{number}" for number in range(count)]
        made = [copy_of(base, folder, model, serial=folder.name) for folder in folders]
        return other, [row(folder, number) for number, folder in enumerate(made, 1)]

    return make


def timed(*arguments):
    began = time.perf_counter()
    found = what_if(*arguments)
    return found, time.perf_counter() - began


@pytest.mark.soak
def test_ten_thousand_by_their_decision_alone_take_five_minutes(many):
    other, rows = many(COUNT)
    found, seconds = timed(other(decision={"tolerance": 0.0005}), rows, {}, Workers(2))
    print(f"{COUNT} inspections in {seconds:.0f} s, {1e3 * seconds / COUNT:.1f} ms each")  # noqa: T201
    assert (found.from_kept, found.unjudged) == (COUNT, ())
    assert sum(found.flips.values()) == COUNT
    assert seconds <= 300.0 * COUNT / 10_000


@pytest.mark.soak
def test_from_frames_a_part_takes_half_a_second_of_a_core(many):
    other, rows = many(100)
    found, seconds = timed(other(region={"size_mm": [0.8, 0.8]}), rows, {}, Workers(2))
    print(f"{len(rows)} inspections in {seconds:.0f} s, {2 * seconds / len(rows):.2f} s of a core each")  # noqa: T201
    assert (found.from_frames, found.unjudged) == (len(rows), ())
    assert seconds <= 0.5 * len(rows) / 2


@pytest.mark.soak
def test_a_killed_worker_of_a_cluster_loses_no_inspection(many, cluster):
    other, rows = many(500)
    recipe = other(decision={"tolerance": 0.0005})
    here, killed = what_if(recipe, rows, {}, HERE), []

    def advance(_, done, total):
        if 50 <= done < total and not killed:
            cluster.workers[-1].kill()
            killed.append(cluster.workers.pop())

    try:
        there = what_if(recipe, rows, {}, Workers(scheduler=cluster.address), advance=advance)
    finally:
        cluster.add_worker()  # the other tests' second one
        cluster.wait_for_workers(2)
    assert killed
    assert there == here


def test_folders_that_could_not_be_judged_are_no_success(past, tmp_path, capsys):
    other, one = past
    with open_history(tmp_path / "history.sqlite") as history:
        history.append_all([replace(one, folder=str(tmp_path / "gone"))])
    command = ["whatif", "--recipe", other(), "--history", tmp_path / "history.sqlite"]
    assert run([str(one) for one in command]) == 3
    assert "was this inspection finished" in capsys.readouterr().out
