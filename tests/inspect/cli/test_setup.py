"""Job folder, project file, doctor and completion."""

import json
import re
import subprocess
import tomllib
from pathlib import Path

import pytest

from anisoscope.base import signature
from anisoscope.base.language import language
from anisoscope.cli import app, run
from anisoscope.kinds.registry import kind_of
from anisoscope.operations import project_place
from anisoscope.operations.installation import OPTIONAL
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.profiles.comparison import turned_over
from anisoscope.profiles.files.load import write_height_map
from anisoscope.profiles.ideal import ridges
from anisoscope.rig.rigfile import read_rig

ROOT = Path(__file__).resolve().parents[3]


@pytest.fixture
def job(tmp_path, monkeypatch, capsys):
    """A job folder as ``init`` writes it, with the user's settings out of reach; the working folder is inside it."""
    monkeypatch.setattr(project_place, "user_path", lambda: tmp_path / "user.toml")
    monkeypatch.delenv("ANISOSCOPE_HISTORY", raising=False)
    monkeypatch.setattr(signature, "_chosen", None)  # the project file names a key, which stays in use
    folder = tmp_path / "job"
    assert run(["init", str(folder), "--ridge-angle", "8", "--station", "rig 2"]) == 0
    capsys.readouterr()
    (folder / "in" / "it").mkdir(parents=True)
    monkeypatch.chdir(folder / "in" / "it")
    return folder


def bound(*arguments):
    """What a command gets from command line and project file."""
    _, found, _ = app.parse_args(arguments, exit_on_error=False, print_error=False)
    return found.arguments


def test_init_writes_files_that_can_be_read_and_replaces_none(job, capsys):
    assert kind_of(job / "recipe.toml").name == "ridges"
    assert read_rig(job / "rig.toml").name == "rig 2"
    assert run(["init", str(job)]) == 64
    assert "exists already" in capsys.readouterr().err


def test_commands_take_from_the_project_file_what_the_command_line_leaves_out(job):
    found = bound("inspect", "--serial", "A")
    assert (found["recipe"], found["rig"]) == (job / "recipe.toml", job / "rig.toml")
    assert (found["into"].out, found["part"].station) == (job / "inspections", "rig 2")
    assert str(bound("inspect", "--recipe", "mine.toml")["recipe"]) == "mine.toml"
    assert bound("rig", "status")["which"].rig == job / "rig.toml"
    assert bound("show", "A")["place"] == str(job / "inspections")
    for command in ("check", "suggest", "teach", "yield"):
        assert bound("recipe", command)["file"] == job / "recipe.toml"
    assert str(bound("recipe", "check", "mine.toml")["file"]) == "mine.toml"


def test_a_folder_of_other_inspections_is_not_looked_up_in_the_history_of_the_job(job, tmp_path):
    other, own = tmp_path / "other", job / "inspections" / "A-1"
    for folder in (other, own):
        folder.mkdir(parents=True)
    assert bound("show", str(own))["place"] == str(job / "inspections")
    assert bound("compare", str(other), "A")["place"] == str(job / "inspections")
    assert bound("compare", str(other), str(own))["place"] == str(job / "inspections")
    assert "place" not in bound("show", str(other))
    assert "place" not in bound("compare", str(other), str(other))
    assert bound("show", str(other), "--history", "mine")["place"] == "mine"


def test_an_option_of_the_same_name_with_another_meaning_gets_nothing(job):
    assert "rig" not in bound("inspect", "--frames", "photographed", "--serial", "A")
    assert (
        "which" not in bound("rig", "status", "--driver", "zaber", "--port", "x")
        or bound("rig", "status", "--driver", "zaber", "--port", "x")["which"].rig is None
    )
    assert "recipe" not in bound("predict", "--ridge-angle", "10")
    assert "place" not in bound("spc", "--csv", "table.csv")


def test_the_project_file_precedes_the_users_file_and_mistakes_name_the_file(job, tmp_path, capsys):
    (tmp_path / "user.toml").write_text('operator = "U. S."\nstation = "home"\n')
    found = bound("inspect", "--serial", "A")
    assert (found["part"].operator, found["part"].station) == ("U. S.", "rig 2")
    (job / "anisoscope.toml").write_text('recipy = "recipe.toml"\n')
    assert run(["inspect", "--serial", "A"]) == 78
    assert "anisoscope.toml: recipy: unknown key; did you mean 'recipe'?" in capsys.readouterr().err


def test_doctor_names_what_is_missing(job, capsys):
    (job / "rig.toml").write_text((job / "rig.toml").read_text().replace("/dev/ttyUSB0", "/dev/ttyNOTHING"))
    assert run(["doctor", "--json"]) == 69
    found = {one["what"]: one for one in json.loads(capsys.readouterr().out)["findings"]}
    assert {name for name, one in found.items() if one["state"] == "missing"} == {
        "stage",
        "calibration: flat",
    }
    assert "/dev/ttyNOTHING" in found["stage"]["text"]
    assert found["packages"]["state"] == found["recipe"]["state"] == "ok"


@pytest.mark.soak
def test_completion_of_bash_knows_the_commands(tmp_path, capsys):
    script = tmp_path / "completion"
    assert run(["completion", "bash", "--install", "--out", str(script)]) == 0
    line = f"source {script}; COMP_WORDS=(anisoscope pred); COMP_CWORD=1; _anisoscope; echo ${{COMPREPLY[@]}}"
    done = subprocess.run(["bash", "-c", line], capture_output=True, text=True, check=True)
    assert done.stdout == "predict\n"
    assert run(["completion", "bash", "--out", "x"]) == 64


@pytest.fixture
def drawn(job, capsys):
    """JSON of a small picture by the recipe of the job, which gets replacements first."""

    def render(replaced, *options):
        text = (job / "recipe.toml").read_text(encoding="utf-8")
        for pattern, line in replaced.items():
            text = re.sub(pattern, line, text, flags=re.MULTILINE)
        (job / "recipe.toml").write_text(text, encoding="utf-8")
        small = ("--angles", "0", "--bounces", "1", "--panel", "64", "--out", "x.png", "--json")
        code = run(["render", "frame", "--recipe", str(job / "recipe.toml"), *small, *options])
        captured = capsys.readouterr()
        assert code == 0, captured.err
        return json.loads(captured.out)

    return render


def test_plastic_and_surface_of_a_recipe_are_those_of_other_commands(job, drawn, capsys):
    found = drawn({r"^alpha_along = .*$": "alpha_along = 0.0712345678901234"}, "--albedo", "0.5")
    assert (found["material"]["alpha_along"], found["material"]["albedo"]) == (0.0712345678901234, 0.5)
    assert found["surface"].startswith("Ideal ridges, 8°, pitch 100 µm")
    assert run(["optimise", "--recipe", str(job / "rig.toml")]) == 78
    assert "are the two swapped?" in capsys.readouterr().err


def test_a_recipe_with_a_height_map_is_rendered_as_its_map(job, drawn, capsys):
    surface = ridges(RidgeDesign(100.0, 8.0), (60, 400), 1.0)
    for name, part in (("part.x3p", surface), ("tool.x3p", turned_over(surface))):
        write_height_map(part, job / name)
    of_part = drawn({r"^design = .*$": 'height_map = "part.x3p"'})
    assert of_part["surface"] == "part.x3p"
    of_tool = drawn({r"^height_map = .*$": 'height_map = "tool.x3p"\nrole = "tool"'})
    assert of_tool["surface"] == "tool.x3p"
    mean = of_part["panels"][0]["mean_of_surface"]
    assert of_tool["panels"][0]["mean_of_surface"] == pytest.approx(mean, rel=1e-6)
    assert drawn({}, "--ridge-angle", "5")["surface"].startswith("Ideal ridges, 5°")
    board = ["render", "checkerboard", "--recipe", str(job / "recipe.toml"), "--out", "b.png"]
    assert run(board) == 64
    assert "its surface is a height map; say the --ridge-angle of the plate" in capsys.readouterr().err


def test_the_command_line_names_the_language_before_the_project_file(job, capsys):
    project = job / "anisoscope.toml"
    project.write_text(project.read_text(encoding="utf-8") + '\nlang = "da"\n', encoding="utf-8")
    seen = []
    app.command(lambda: seen.append(language()), name="speak")
    try:
        assert [run(["speak"]), run(["speak", "--lang", "de"]), run(["--lang=en", "speak"])] == [0, 0, 0]
    finally:
        del app["speak"]
    assert seen == ["da", "de", "en"]
    assert language() == "en"
    assert run(["doctor", "--lang", "fr"]) == 64
    assert run(["doctor", "--lang"]) == 64
    assert "en, de, da" in capsys.readouterr().err


def test_the_command_line_names_the_style_of_csv_before_the_project_file(job, capsys):
    project = job / "anisoscope.toml"
    plain = ["research", "experiment", "--as-csv"]
    assert run(plain) == 0
    usual = capsys.readouterr().out
    project.write_text(project.read_text(encoding="utf-8") + '\ncsv_style = "semicolon"\n', encoding="utf-8")
    assert run([*plain, "--csv-style", "comma"]) == 0
    assert capsys.readouterr().out == usual
    assert run([*plain, "--lang", "en"]) == 0
    assert capsys.readouterr().out == usual.replace(",", ";").replace(".", ",")
    assert run(["doctor", "--csv-style", "tab"]) == 64
    assert run(["doctor", "--csv-style"]) == 64
    assert capsys.readouterr().err.count("comma or semicolon") == 2


def test_the_bench_file_of_a_virtual_rig_is_no_rig_file(tmp_path, capsys):
    bench = tmp_path / "bench.toml"
    bench.write_text('schema = 1\nseed = 1\n[sample]\nkind = "white-tile"\n', encoding="utf-8")
    assert run(["rig", "status", "--rig", str(bench)]) == 78
    assert (
        f"`anisoscope rig sim bench {bench} --pty --write-rig rig.toml` serves it" in capsys.readouterr().err
    )


def test_doctor_knows_every_extra_by_a_package_of_it():
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]["optional-dependencies"]
    of_users = set(extras) - {"dev", "benchmark"}
    assert {extra for extra, _ in OPTIONAL.values()} == of_users
    for package, (extra, _) in OPTIONAL.items():
        assert any(one.lower().startswith(package.lower()) for one in extras[extra]), package
