"""Parts of a lot are compared with each other from the third one on; open ones are judged anew then."""

import json
import time
from functools import partial

import pytest

from anisoscope.decision.reference_parts import golden_path
from anisoscope.history.filters import Filters
from anisoscope.history.store import open_history
from anisoscope.inspection.batch.operator import Unattended
from anisoscope.inspection.batch.run import run_batch
from anisoscope.inspection.batch.start import Order
from anisoscope.inspection.batch.tray import read_tray
from anisoscope.inspection.integrity import verify
from anisoscope.inspection.recompute import recompute
from anisoscope.inspection.reports import PendingReport, Reports
from anisoscope.inspection.run import inspect_part
from anisoscope.operations.past import whatif
from anisoscope.operations.remembering import judge_lot, lot_mates, remember
from anisoscope.record.schema import Particulars

LOT = "4711"
RULE = {"unexcluded": "inconclusive", "compare_with_lot": True, "tolerance": None, "remeasure": 0}
UNMEASURED = {
    "decision": RULE,
    "material": {"u_tail": 0.5, "u_alpha_share": 0.2, "u_albedo": 0.05},
    "defects": {"ridge_angle_deg": 1.0, "roughness_share": 0.5},
}
OFF = {"ridge_angle_deg = 10.0": "ridge_angle_deg = 8.0"}


@pytest.fixture
def of_lot(virtual_rig, undiagnosed, tmp_path):
    """``of_lot("A")`` inspects a part of a lot; the inspection, and those that were judged anew by it."""
    return lot_on(virtual_rig(recipe=UNMEASURED), undiagnosed, tmp_path)


@pytest.fixture
def of_lot_with_causes(virtual_rig, plain, tmp_path):
    """The same with a diagnosis."""
    return lot_on(virtual_rig(recipe=UNMEASURED), plain, tmp_path)


def lot_on(rig, methods, tmp_path):
    place = tmp_path / "history.sqlite"
    bench = rig.recipe.with_name("bench.toml")
    good = bench.read_text(encoding="utf-8")

    def inspect(serial, changes=None, lot=LOT, judged=True):
        text = good.replace("seed = 11", f"seed = {ord(serial)}")
        for before, after in (changes or {}).items():
            assert before in text
            text = text.replace(before, after)
        bench.write_text(text, encoding="utf-8")
        found = inspect_part(
            rig.recipe,
            rig.rig,
            serial,
            rig.out,
            particulars=Particulars(lot=lot),
            lot_mates=lot_mates(place, lot),
            methods=methods,
        )
        remember(found, place)
        return found, judged and judge_lot(found, place, methods=methods)

    inspect.rig, inspect.place = rig, place
    return inspect


def test_parts_of_a_lot_wait_for_the_third_one_and_are_judged_anew_then(of_lot_with_causes):
    of_lot = of_lot_with_causes
    first, none = of_lot("A")
    assert (first.record.verdict, none) == ("INCONCLUSIVE", ())
    assert first.record.reasons[0].startswith("not excluded: ")
    assert "inspect the lot up to part" in first.record.reasons[0]
    waits = f"part 1 of lot {LOT}: from part 3 on, the parts of the lot are compared with each other"
    assert waits in first.record.notes
    second, none = of_lot("B")
    assert (second.record.verdict, none) == ("INCONCLUSIVE", ())
    third, anew = of_lot("C")
    assert third.record.verdict == "PASS"
    assert any(one.startswith(f"compared with 2 other parts of lot {LOT}") for one in third.record.reasons)
    assert third.record.details.golden.lot == LOT
    assert [(one.record.serial, one.record.verdict) for one in anew] == [("A", "PASS"), ("B", "PASS")]
    for before, after in zip((first, second), anew, strict=True):
        assert after.record.judged_anew.startswith(f"INCONCLUSIVE in {before.folder.name} (record.json ")
        assert verify(before.folder).intact
        assert verify(after.folder).intact
        assert recompute(after.folder).same
        assert recompute(before.folder).same
        frame = before.record.frames[0].name
        assert (before.folder / frame).samefile(after.folder / frame)
    with open_history(of_lot.place) as history:
        rows = history.rows(Filters(lot=LOT))
    assert [(row.serial, row.verdict) for row in rows] == [
        ("A", "INCONCLUSIVE"),
        ("B", "INCONCLUSIVE"),
        ("C", "PASS"),
        ("A", "PASS"),
        ("B", "PASS"),
    ]
    assert [row.serial for row in rows if "ln 0-90" in row.numbers] == ["A", "B", "C"]


def test_a_part_that_waits_for_its_lot_is_photographed_once(of_lot):
    recipe = of_lot.rig.recipe
    recipe.write_text(
        recipe.read_text(encoding="utf-8").replace("remeasure = 0", "remeasure = 1"), encoding="utf-8"
    )
    first, _ = of_lot("A")
    alone, _ = of_lot("B", lot=None)  # without a lot, a second round is all that may help
    assert (first.record.verdict, alone.record.verdict) == ("INCONCLUSIVE", "INCONCLUSIVE")
    assert len(alone.record.frames) == 2 * len(first.record.frames)


def test_a_part_that_deviates_from_its_lot_fails_and_is_left_out_for_the_others(of_lot):
    for serial in "ABC":
        of_lot(serial)
    bad, _ = of_lot("X", OFF)
    assert bad.record.verdict == "FAIL"
    assert "like the 3 other parts of the lot" in bad.record.reasons[0]
    good, _ = of_lot("D")
    assert good.record.verdict == "PASS"
    assert any("without X, unlike the others" in one for one in good.record.reasons)


def test_a_part_that_deviates_first_is_found_when_the_lot_is_known(of_lot):
    bad, _ = of_lot("X", OFF)
    assert bad.record.verdict == "INCONCLUSIVE"
    verdicts = {}
    for serial in "ABCD":
        found, anew = of_lot(serial)
        verdicts |= {one.record.serial: one.record.verdict for one in (found, *anew)}
    assert verdicts == {"A": "PASS", "B": "PASS", "C": "PASS", "D": "PASS", "X": "FAIL"}


def test_a_lot_that_deviates_as_a_whole_fails_against_the_prediction(virtual_rig, undiagnosed, tmp_path):
    of_lot = lot_on(virtual_rig(recipe={"decision": RULE}), undiagnosed, tmp_path)
    for serial in "AB":
        of_lot(serial, OFF)
    found, _ = of_lot("C", OFF)
    assert found.record.details.golden is None
    assert known(found) == ["A", "B"]
    assert found.record.verdict == "FAIL"
    assert "for a part as predicted" in found.record.reasons[0]
    assert found.record.reasons[-1].startswith(f"compared with 2 other parts of lot {LOT}")


def known(inspected):
    """Serial numbers of the other parts of the lot, as its folder says."""
    found = json.loads((inspected.folder / "inputs" / "lot.json").read_text(encoding="utf-8"))
    return [part["serial"] for part in found["parts"]]


def test_other_recipes_lots_and_rigs_are_no_part_of_a_lot(of_lot):
    rig = of_lot.rig
    first, _ = of_lot("A")
    other, _ = of_lot("B", lot="4712")
    assert known(first) == known(other) == []
    text = rig.recipe.read_text(encoding="utf-8")
    assert "exposure_s = 0.0015" in text
    rig.recipe.write_text(text.replace("exposure_s = 0.0015", "exposure_s = 0.001"), encoding="utf-8")
    longer, _ = of_lot("C")
    assert known(longer) == []
    lot = json.loads((longer.folder / "inputs" / "lot.json").read_text(encoding="utf-8"))
    assert lot["refused"] == [
        "A was inspected with another recipe (poses, region or exposure differ): inspect it again"
    ]
    assert first.record.verdict == longer.record.verdict == "INCONCLUSIVE"


def test_a_part_that_cannot_be_judged_anew_leaves_the_verdict_of_the_next_one(of_lot, capsys):
    first, _ = of_lot("A")
    of_lot("B")
    (first.folder / first.record.frames[0].name).write_bytes(b"damaged")
    third, anew = of_lot("C")
    assert third.record.verdict == "PASS"
    assert [one.record.serial for one in anew] == ["B"]
    assert f"A of lot {LOT} is not judged anew: " in capsys.readouterr().err


def test_a_batch_shows_the_verdicts_of_the_whole_lot(virtual_rig, undiagnosed, tmp_path):
    rig, place = virtual_rig(recipe=UNMEASURED), tmp_path / "history.sqlite"
    path = tmp_path / "tray.csv"
    path.write_text(f"slot,serial,lot\n1,A,{LOT}\n2,B,{LOT}\n3,C,{LOT}\n", encoding="utf-8")
    order = Order(
        read_tray(path),
        rig.recipe,
        rig.rig,
        tmp_path / "batch",
        lot_mates=lambda lot: lot_mates(place, lot),
        judge_lot=partial(judge_lot, place=place, methods=undiagnosed),
    )
    found = run_batch(order, Unattended(), lambda one: remember(one, place), methods=undiagnosed)
    assert [slot.verdict for slot in found.slots] == ["PASS"] * 3
    assert found.exit_code == 0
    for slot in found.slots:
        assert (order.out / slot.folder / "record.json").is_file()
    again = run_batch(order, Unattended(), lambda one: remember(one, place), methods=undiagnosed, resume=True)
    assert [slot.folder for slot in again.slots] == [slot.folder for slot in found.slots]


def test_reports_that_are_still_written_keep_no_part_from_being_judged_anew(of_lot, undiagnosed):
    """A report holds the folder of its part."""
    notes = []

    def slow(record, *_):
        time.sleep(1.0)
        return record.verdict

    with Reports(notes.append) as reports:
        for serial in "ABC":
            found, _ = of_lot(serial, judged=False)
            late = PendingReport(found.folder, lambda found=found: (slow(found.record), ()))
            reports.add(late)
        anew = judge_lot(found, of_lot.place, methods=undiagnosed, reports=reports)
    assert [one.record.serial for one in anew] == ["A", "B"]
    assert notes == []


def test_another_recipe_is_tried_on_a_lot_that_is_known_as_a_whole(virtual_rig, undiagnosed, tmp_path):
    alone = {**UNMEASURED, "decision": {**RULE, "compare_with_lot": False}}
    rig, place = virtual_rig(recipe=alone), tmp_path / "history.sqlite"
    for serial in "ABC":
        particulars = Particulars(lot=LOT)
        found = inspect_part(
            rig.recipe, rig.rig, serial, rig.out, particulars=particulars, methods=undiagnosed
        )
        assert found.record.verdict == "INCONCLUSIVE"
        remember(found, place)
        assert judge_lot(found, place, methods=undiagnosed) == ()
    text = rig.recipe.read_text(encoding="utf-8")
    other = rig.recipe.with_name("with-lot.toml")
    other.write_text(text.replace("compare_with_lot = false", "compare_with_lot = true"), encoding="utf-8")
    assert not golden_path(other).exists()
    with open_history(place) as history:
        tried = whatif(history, other)
    assert dict(tried.flips) == {"INCONCLUSIVE → PASS": 3}
