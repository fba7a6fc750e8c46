"""golden and recipe on the command line."""

import re
import shutil
from dataclasses import replace

import pytest

from anisoscope.base.errors import CalibrationError
from anisoscope.decision.certificate import certificate_path
from anisoscope.decision.reference_parts import golden_path
from anisoscope.inspection.run import Methods
from anisoscope.kinds.registry import read_recipe


def test_golden_parts_are_added_shown_and_removed(anisoscope, virtual_rig):
    rig = virtual_rig()
    folders = [rig.inspect(serial).folder for serial in ("A", "B")]
    at = ("--recipe", rig.recipe)
    done = anisoscope("golden", "show", *at)
    assert (done.code, done.err.count("\n")) == (64, 1)
    assert "there are no golden parts" in done.err
    page = rig.recipe.with_name("certificate.html")
    done = anisoscope("golden", "certify", *at, *folders, "--false-alarms", 0.7, "--html", page)
    assert (done.code, done.err) == (1, "")
    assert "not certified: at most 77.64 % false alarms with 95 % confidence after 2 good parts" in done.out
    assert "Certificate of false alarms" in page.read_text(encoding="utf-8")
    done = anisoscope("golden", "certify", *at, *folders, "--false-alarms", 0.8, "--json")
    assert (done.code, done.json["certified"], done.json["needed"]) == (0, True, 2)
    done = anisoscope("golden", "certify", *at, folders[0], folders[0])
    assert (done.code, "name each part once" in done.err) == (64, True)
    done = anisoscope("golden", "add", *at, *folders)
    assert done.code == 0, done.err
    assert "2 added, 2 golden parts" in done.out
    found = anisoscope("golden", "show", *at, "--json").json
    assert [part["serial"] for part in found["parts"]] == ["A", "B"]
    assert (found["compared_with"], len(found["mean"])) == (True, 2)
    loss = {count: sizes["height loss 10%"] for count, sizes in found["detectable"].items()}
    assert min(loss["1"], loss["2"]) > loss["25"] > 0.0
    assert found["birge"] > 0.0
    assert found["batches"] == 1  # of one day
    low, high = found["size_interval"]
    assert low < found["birge"] < high
    assert found["size"] == pytest.approx((0.5 + 2.0 * found["birge"]) / 2.5)
    assert all(part["cell_limit"] > 0.0 for part in found["parts"])
    shown = anisoscope("golden", "show", *at).out
    assert "golden parts: ridged test plate" in shown
    assert "what golden parts can show" in shown
    done = anisoscope("golden", "certify", *at, folders[0])
    assert (done.code, "A is a golden part" in done.err) == (64, True)
    again = anisoscope("golden", "add", *at, folders[0])
    assert again.code >= 64
    assert "in the set already" in again.err
    done = anisoscope("golden", "remove", *at, "A", "--json")
    assert (done.code, done.json["removed"], done.json["count"]) == (0, 1, 1)
    assert anisoscope("golden", "remove", *at, "C").code >= 64
    done = anisoscope("golden", "certify", *at, folders[0])
    assert (done.code, "was judged by another" in done.err) == (64, True)
    assert anisoscope("golden", "remove", *at, "B").code == 0
    assert not golden_path(rig.recipe).exists()


def test_reports_print_the_certificate_that_is_stored_for_their_recipe(anisoscope, virtual_rig, undiagnosed):
    rig = virtual_rig()
    path, at = certificate_path(rig.recipe), ("--recipe", rig.recipe)
    first = rig.inspect("A", methods=undiagnosed).folder
    done = anisoscope("golden", "certify", *at, first, "--for-reports")
    assert (done.code, f"stored in {path}" in done.out) == (1, True)
    page = (
        rig.inspect("B", methods=replace(undiagnosed, page=Methods().page)).folder / "report.html"
    ).read_text(encoding="utf-8")
    assert re.search(
        r"<li id=\"certificate\">False alarms: at most 95\.00 % with 95 % confidence, whatever the distribution "
        r"\(0 of 1 good parts failed; \d{4}-\d\d-\d\d\); the model states 1\.00 %\.</li>",
        page.replace("\N{NO-BREAK SPACE}", " "),
    )
    whole = path.read_bytes()
    path.write_text("{}")
    with pytest.raises(CalibrationError, match=r"cannot be read: .*: certify again"):
        rig.inspect("C", methods=undiagnosed)
    path.write_bytes(whole)
    assert anisoscope("golden", "add", *at, first).code == 0
    later = rig.inspect("D", methods=undiagnosed)
    assert f"inputs/{path.name}" not in [one.name for one in later.record.inputs]


def test_a_new_recipe_and_what_is_refused(anisoscope, tmp_path):
    path = tmp_path / "new.toml"
    done = anisoscope(
        "recipe", "new", "--out", path, "--product", "plate", "--pitch", 80, "--ridge-angle", 12
    )
    assert done.code == 0, done.err
    recipe = read_recipe(path)
    assert (recipe.product, recipe.surface.pitch_um, recipe.surface.design.ridge_angle_deg) == (
        "plate",
        80,
        12,
    )
    before = path.read_text()
    done = anisoscope("recipe", "new", "--out", path)
    assert (done.code, path.read_text()) == (64, before)
    done = anisoscope("recipe", "new", "--out", tmp_path / "b.toml", "--height-map", tmp_path / "none.x3p")
    assert (done.code, (tmp_path / "b.toml").exists()) == (64, False)
    done = anisoscope("recipe", "new", "--out", tmp_path / "c.toml", "--pitch", -1)
    assert done.code >= 64
    assert not (tmp_path / "c.toml").exists()
    shutil.copy(path, tmp_path / "d.toml")
    assert anisoscope("golden", "add", "--recipe", path).code == 64


def test_parts_of_a_lot_of_unknown_quality_without_the_one_that_deviates(anisoscope, virtual_rig):
    rig = virtual_rig()
    at = ("--recipe", rig.recipe)
    first = rig.inspect("LOT-1").folder
    few = anisoscope("golden", "add", *at, "--unlabelled", first)
    assert (few.code, few.err.count("\n")) == (64, 1)
    assert "1 part of unknown quality: 3 of a lot or more" in few.err
    assert not golden_path(rig.recipe).exists()
    folders = [first, *(rig.inspect(f"LOT-{number}").folder for number in (2, 3))]
    bench = rig.recipe.with_name("bench.toml")
    text = bench.read_text(encoding="utf-8")
    off = text.replace("ridge_angle_deg = 10.0", "ridge_angle_deg = 8.0")
    assert off != text
    bench.write_text(off, encoding="utf-8")
    folders.append(rig.inspect("LOT-4").folder)
    done = anisoscope("golden", "add", *at, "--unlabelled", *folders, "--json")
    assert (done.code, done.json["added"], done.json["left_out"]) == (0, 3, ["LOT-4"])
    assert "left out, as they deviate from the others: LOT-4" in done.err
    assert "in common is not seen" in done.err
    bench.write_text(text, encoding="utf-8")
    record = rig.inspect("LOT-5").record
    assert record.verdict == "PASS"
    assert (
        record.reasons[-1] == "compared with 3 parts of unknown quality: what they have in common is not seen"
    )
    assert record.details.golden.unjudged == 3
