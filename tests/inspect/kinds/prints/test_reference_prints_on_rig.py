"""Golden prints on the virtual rig: added from inspections, and what the next print is judged by."""

import json

import numpy as np
import pytest

from anisoscope.base.errors import CalibrationError, MeasurementError, UsageError
from anisoscope.cli import run
from anisoscope.cli.recipe import golden as command
from anisoscope.cli.rig import calibrate
from anisoscope.decision.reference_parts import golden_path, write_golden
from anisoscope.inspection.integrity import verify
from anisoscope.inspection.job import prepare
from anisoscope.inspection.recompute import recompute
from anisoscope.inspection.run import inspect_part
from anisoscope.kinds.parts import usable
from anisoscope.kinds.prints import rig_ink
from anisoscope.kinds.prints.lighting import expectation_of_print
from anisoscope.kinds.prints.lobe_fit import PARAMETERS
from anisoscope.kinds.prints.model import State
from anisoscope.kinds.prints.recipe import PrintRecipe
from anisoscope.kinds.prints.reference_prints import GoldenPrints, read_golden_prints
from anisoscope.operations.inks import calibrate_ink
from anisoscope.operations.teaching import teach
from anisoscope.rig.rigfile import read_rig
from anisoscope.sim.materials.inks import read_ink, synthetic_ink

GOOD = {"alpha": 0.01, "ratio": 0.01, "skew": 0.01, "tilt_x_deg": 0.1, "tilt_y_deg": 0.1, "red": 0.01,
        "green": 0.01, "blue": 0.01, "lobe": 0.03}  # fmt: skip


def filled(recipe_path, rig_path, count):
    """The set with so many prints that vary as good prints do about the one that was inspected."""
    recipe, rig = PrintRecipe.read(recipe_path), read_rig(rig_path)
    known = read_golden_prints(golden_path(recipe_path), recipe, rig)
    scene, rng = expectation_of_print(recipe, rig).scene, np.random.default_rng(2)
    slopes = np.stack([GOOD[name] * scene.slope(name, State()) for name in PARAMETERS], axis=-1)
    first, parts = known.parts[0], []
    for number in range(count):
        logs = known.logs()[0] + slopes @ rng.standard_normal(9)
        logs += 0.001 * rng.standard_normal(logs.size)
        rows = tuple(map(tuple, logs.reshape(-1, 3).tolist()))
        parts.append(first.model_copy(update={"serial": f"G-{number}", "log_channels": rows}))
    return known.model_copy(update={"parts": tuple(parts)})


def refused(recipe_path, rig_path, match):
    """The job is refused before anything moves."""
    with pytest.raises(CalibrationError, match=match):
        prepare(recipe_path, rig_path, "P-2")


def check_that_they_teach(recipe_path, rig_path, capsys):
    """The tolerances become those that the golden prints teach; all else stays."""
    before, limits = recipe_path.read_text(), PrintRecipe.read(recipe_path).tolerances
    with pytest.raises(UsageError, match="name a good part with --serial, or --golden"):
        teach(recipe_path, rig_path)
    assert run(["recipe", "teach", str(recipe_path), "--rig", str(rig_path), "--golden", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    taught = PrintRecipe.read(recipe_path)
    assert (taught.version, told["folder"]) == (2, None)
    assert recipe_path.with_name("recipe.v1.toml").read_text() == before
    for change in told["changes"]:
        key = change["key"].removeprefix("tolerances.")
        assert (change["old"], change["new"]) == (getattr(limits, key), getattr(taught.tolerances, key))
        assert "23 golden prints: at least 95% of good prints pass all limits" in change["why"]
    assert len(told["changes"]) == 7
    assert told["notes"] == ["the limit of the area is learnt at every inspection: it is 1.00% now"]
    # exposure, region and poses stay, and with them the golden prints
    assert prepare(recipe_path, rig_path, "P-3").reference.lacking is None


def test_golden_prints_are_kept_and_decide_what_deviates(print_rig, good_print, capsys):
    done = good_print
    recipe_path, rig_path = (print_rig.folder / "print" / f"{name}.toml" for name in ("recipe", "rig"))
    path, recipe = golden_path(recipe_path), PrintRecipe.read(recipe_path)
    assert command.add(done.folder, recipe=recipe_path) == 0
    assert "1 added, 1 golden print\n" in capsys.readouterr().out
    assert command.show(recipe=recipe_path, json_=True) == 0
    told = json.loads(capsys.readouterr().out)
    assert (told["count"], told["seen"]["lamp"], told["compared_with"]) == (
        1,
        done.record.details.lamp,
        False,
    )
    shown = np.array([one.measured for one in done.record.details.colours])
    assert np.exp(told["mean"]) == pytest.approx(shown)
    with pytest.raises(UsageError, match="is in the set already"):
        command.add(done.folder, recipe=recipe_path)
    job = prepare(recipe_path, rig_path, "P-2")
    assert usable(job.reference) is None
    assert job.reference.lacking.startswith("1 golden print: from 3 on")

    for file, old, new, match in (
        (rig_path, "led-white", "d65", "seen with the lamp 'led-white .*, now it is 'D65'"),
        (recipe_path, "exposure_s = 0.004", "exposure_s = 0.003", "other poses, region or exposure"),
        (path, '"kind"', '"sort"', "cannot be read"),
    ):
        text = file.read_text()
        assert old in text
        file.write_text(text.replace(old, new))
        refused(recipe_path, rig_path, match)
        file.write_text(text)
    blue = recipe.print.model_copy(update={"ink": "synthetic-blue"})
    with pytest.raises(
        CalibrationError, match="seen with the ink 'synthetic green', now it is 'synthetic blue'"
    ):
        read_golden_prints(path, recipe.model_copy(update={"print": blue}))
    with pytest.raises(CalibrationError, match="an INVALID inspection says nothing"):
        GoldenPrints.with_inspection(None, recipe, done.record.model_copy(update={"verdict": "INVALID"}))
    darker = recipe.acquisition.model_copy(update={"exposure_s": 0.003})
    with pytest.raises(CalibrationError, match="inspected with another recipe"):
        GoldenPrints.with_inspection(None, recipe.model_copy(update={"acquisition": darker}), done.record)

    write_golden(path, filled(recipe_path, rig_path, 24))
    other, _ = print_rig.lay_out({"wrong_ink": "synthetic-red", "wrong_share": 0.05}, name="other")
    (recipe_path.with_name("bench.toml")).write_text(other.with_name("bench.toml").read_text())
    found = inspect_part(recipe_path, rig_path, "P-2", print_rig.folder / "inspections")
    record = found.record
    beside = record.details.golden
    assert (beside.parts, len(beside.fitted), len(beside.colours), record.dof) == (24, 9, 9, 9)
    assert record.p_value < 0.005
    assert min(one.p_value for one in beside.colours) == record.p_value
    assert "wrong-ink-synthetic red" in [one.cause for one in record.diagnosis.causes if one.tie]
    seen = record.details.map
    assert (seen.learnt, seen.verdict) == (True, "PASS")
    # 100 cells of which none deviated on the golden prints
    assert seen.max_share == pytest.approx(0.01)
    assert "The area shares it too" in found.report.read_text()
    again = recompute(found.folder)
    assert (again.differences, again.notes) == ((), ())
    assert verify(found.folder).intact
    assert command.show(recipe=recipe_path) == 0
    assert "golden prints: " in capsys.readouterr().out
    assert command.remove("G-1", recipe=recipe_path) == 0
    assert "1 removed, 23 golden prints" in capsys.readouterr().out
    check_that_they_teach(recipe_path, rig_path, capsys)


def test_inspections_make_the_ink_file(good_print, tmp_path, monkeypatch, capsys, guard):
    """Of nine poses, which is few: they do if all count alike; 21 usual ones in another world are in the evidence."""
    out, folder = tmp_path / "mine.toml", good_print.folder
    with pytest.raises(UsageError, match=r"9 poses do not tell .* inspect the print at 21 or more"):
        calibrate.ink(folder, out=out)
    with pytest.raises(UsageError, match="name the folders"):
        calibrate_ink([], "none")
    monkeypatch.setattr(rig_ink, "LEAST_POSES", 9)
    with pytest.raises(MeasurementError, match="how wide the lobe is"):
        calibrate.ink(folder, out=out)
    monkeypatch.setattr(rig_ink, "_DIM", 1e-4)
    assert calibrate.ink(folder, folder, out=out, json_=True) == 0
    told, made = json.loads(capsys.readouterr().out), read_ink(out)
    assert guard.keys(told) == guard.known_keys()["calibrate ink"]
    assert (told["file"], told["poses"], made.source) == (str(out), 9, "9 poses of 2 good prints on a rig")
    assert made.alpha == pytest.approx(synthetic_ink("synthetic-green").alpha, rel=0.03)
    assert made.distribution == pytest.approx(1.0, abs=0.2)  # the file of the package has GGX
    assert calibrate.ink(folder, out=out, overwrite=True) == 0
    assert capsys.readouterr().out.startswith("mine: alpha 0.1")
