"""Prints of a lot of unknown quality on the virtual rig: compared with each other from the fourth one on."""

import re

import pytest

from anisoscope.base.errors import CalibrationError
from anisoscope.decision.reference_parts import golden_path
from anisoscope.inspection.recompute import recompute
from anisoscope.inspection.run import inspect_part, report_again
from anisoscope.kinds.prints.kind import PRINTS
from anisoscope.operations.remembering import judge_lot, lot_mates, remember
from anisoscope.operations.teaching import add_golden
from anisoscope.record.schema import Particulars

LOT = "R-7"
VAGUE = {"print": {"u_alpha_share": 0.2, "u_rho_share": 0.2, "u_colour_share": 0.1}}
RULE = {"decision": {"compare_with_lot": True, "remeasure": 0}}


@pytest.fixture
def of_lot(print_rig, tmp_path, plain):
    """``of_lot("A", {"missing_share": 0.1})`` inspects a print of the lot; it, and those judged anew by it."""
    place = tmp_path / "history.sqlite"
    recipe, rig = print_rig.lay_out({}, recipe=VAGUE | RULE)

    def inspect(serial, defects=None):
        other, _ = print_rig.lay_out(defects or {}, name=serial, bench={"seed": ord(serial)})
        recipe.with_name("bench.toml").write_text(other.with_name("bench.toml").read_text())
        found = inspect_part(
            recipe,
            rig,
            serial,
            tmp_path / "inspections",
            particulars=Particulars(lot=LOT),
            lot_mates=lot_mates(place, LOT),
            methods=plain,
        )
        remember(found, place)
        return found, judge_lot(found, place, methods=plain)

    inspect.recipe = recipe
    return inspect


def test_prints_of_a_lot_are_compared_from_the_fourth_one_on(of_lot):
    waiting = [of_lot(serial) for serial in "ABC"]
    assert [(one.record.verdict, anew) for one, anew in waiting] == 3 * [("INCONCLUSIVE", ())]
    notes = waiting[2][0].record.notes
    assert f"part 3 of lot {LOT}: from part 4 on, the parts of the lot are compared with each other" in notes
    fourth, anew = of_lot("D")
    assert fourth.record.verdict == "PASS"
    assert fourth.record.reasons[-1].startswith(f"compared with 3 other parts of lot {LOT}: of all of them")
    assert (fourth.record.details.golden.lot, fourth.record.details.golden.parts) == (LOT, 3)
    assert [(one.record.serial, one.record.verdict) for one in anew] == [(name, "PASS") for name in "ABC"]
    assert recompute(fourth.folder).same
    assert recompute(anew[0].folder).same
    bad, _ = of_lot("X", {"missing_share": 0.1})
    assert bad.record.verdict == "FAIL"
    assert any("like the 4 other parts of the lot" in one for one in bad.record.reasons)
    page = re.sub(r"data:[^\"]*", "", report_again(bad.folder, bad.record))
    assert f"<h2>Compared with the other prints of lot {LOT}</h2>" in page
    assert f"against 4 other prints of lot {LOT}" in page
    assert "golden" not in re.sub(r"<[^>]*>|teach golden prints", "", page.partition("<h2>")[2])

    folders = [one.folder for one, _ in waiting]
    with pytest.raises(
        CalibrationError, match="3 prints of unknown quality: 4 of a lot or more show which one"
    ):
        add_golden(of_lot.recipe, folders, unlabelled=True)
    assert not golden_path(of_lot.recipe).exists()
    found = add_golden(of_lot.recipe, [*folders, fourth.folder, bad.folder], unlabelled=True)
    assert (found.changed, found.left_out, found.failed) == ({"added": 4}, ("X",), ())
    with pytest.raises(CalibrationError, match="A has the radiances of A to the last digit"):
        add_golden(of_lot.recipe, [anew[0].folder])
    known = PRINTS.read_reference(golden_path(of_lot.recipe), PRINTS.read_recipe(of_lot.recipe))
    assert known.unjudged == 4
