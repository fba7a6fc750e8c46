"""A fourth kind of part from a package of a third party, from recipe to report, without a change in shared code.

It is the example of docs/own-kind.md.
"""

import ast
import json
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

DOCS = Path(__file__).resolve().parents[3] / "docs"
EXAMPLE = DOCS / "examples" / "cards"
CARD = {
    "kind": "cards",
    "surface": None,
    "material": None,
    "decision": None,
    "uncertainty": None,
    "card": {"radiance": 0.05, "limit": 0.05},
}


def install(folder, name, points, files):
    """A distribution on the search path, as pip leaves it."""
    about = folder / f"{name}-1.0.dist-info"
    about.mkdir(parents=True)
    (about / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text(points)
    for path, text in files.items():
        (folder / path).write_text(text, encoding="utf-8")
    return folder


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """The folder with the example and its entry point."""
    project = tomllib.loads((EXAMPLE / "pyproject.toml").read_text(encoding="utf-8"))
    (group, entries), *_ = project["project"]["entry-points"].items()
    points = f"[{group}]\n" + "".join(f"{key} = {value}\n" for key, value in entries.items())
    files = {"cards.py": (EXAMPLE / "cards.py").read_text(encoding="utf-8")}
    return install(tmp_path_factory.mktemp("third party"), "cards_kind", points, files)


@pytest.fixture
def run(anisoscope):
    """``run("inspect", ..., path=folder)`` runs a command where the packages in folders are installed."""

    def go(*arguments, path=None):
        folders = [] if path is None else str(path).split(os.pathsep)
        return anisoscope(*arguments, path=folders)

    return go


def afresh(*arguments, path):
    """Runs a command in a new interpreter, which finds the package as a user's does."""
    command = [sys.executable, "-m", "anisoscope", *map(str, arguments)]
    environment = os.environ | {"PYTHONPATH": str(path)}
    return subprocess.run(command, capture_output=True, text=True, check=False, timeout=300, env=environment)


def test_a_card_goes_from_recipe_to_report(virtual_rig, run, installed):
    part = virtual_rig(recipe=CARD)
    history = f"sqlite:///{part.out.parent / 'history.sqlite'}"
    options = ("-r", part.recipe, "-g", part.rig, "-s", "C-1", "--out", part.out, "--history", history)
    done = afresh("inspect", *options, "--json", path=installed)
    assert done.returncode in {0, 1}, done.stdout + done.stderr
    found = json.loads(done.stdout)
    folder = Path(found["folder"])
    record = json.loads((folder / "record.json").read_text(encoding="utf-8"))
    assert (record["schema"], record["kind"]) == (2, "cards")
    assert record["details"] == found["card"]
    assert (found["verdict"] == "PASS") == (abs(found["card"]["mean"] - 0.05) <= 0.05)
    assert "<h2>The card</h2>" in (folder / "report.html").read_text(encoding="utf-8")
    assert run("verify", folder, path=installed).code == 0
    again = run("recompute", folder, "--json", path=installed)
    assert json.loads(again.out)["differences"] == [], again.out + again.err
    shown = run("show", folder, "--history", history, "--json", path=installed)
    assert shown.code == 0, shown.out + shown.err
    assert '"card radiance"' in shown.out
    # the package is not installed any more
    assert run("verify", folder).code == 0
    refused = run("history", "add", folder, "--history", f"{history}.new")
    assert refused.code == 1, refused.out + refused.err
    assert "record.json: there is no kind of part 'cards'" in " ".join((refused.out + refused.err).split())
    whole = (folder / "record.json").read_text(encoding="utf-8")
    invalid = {key: value for key, value in record.items() if key != "seal"}
    invalid |= {"verdict": "INVALID", "details": None}
    (folder / "record.json").write_text(json.dumps(invalid), encoding="utf-8")
    refused = run("history", "add", folder, "--history", f"{history}.new")
    assert refused.code == 1
    assert "record.json: there is no kind of part 'cards'" in " ".join((refused.out + refused.err).split())
    (folder / "record.json").write_text(whole.replace('"C-1"', '"C-2"', 1), encoding="utf-8")
    assert "changed: record.json" in run("verify", folder).out
    (folder / "record.json").write_text(whole, encoding="utf-8")
    good = virtual_rig("good")
    other = run("golden", "add", folder, "-r", good.recipe, path=installed)
    line = " ".join((other.out + other.err).split())
    assert other.code == 64
    assert "C-1 was inspected as a part of the kind 'cards'" in line
    assert "is a recipe of the kind 'ridges'" in line
    without = run("recompute", folder)
    assert without.code >= 64
    assert (
        "there is no kind of part 'cards'; installed: plates, prints, ridges, wafers"
        in without.out + without.err
    )


def test_good_cards_are_collected_shown_and_compared(virtual_rig, run, installed):
    part = virtual_rig(recipe=CARD)
    checked = run("recipe", "check", part.recipe, "-g", part.rig, "--json", path=installed)
    assert (checked.code, checked.json["complaints"]) == (0, [])
    assert [one["level"] for one in checked.json["findings"]] == ["note"]
    history = f"sqlite:///{part.out.parent / 'history.sqlite'}"
    options = ("-r", part.recipe, "-g", part.rig, "--out", part.out, "--json")
    done = run("inspect", *options, "--history", history, "-s", "C-1", path=installed)
    first = Path(done.json["folder"])
    added = run("golden", "add", first, "-r", part.recipe, "--json", path=installed)
    assert (added.code, added.json["count"], added.json["compared_with"]) == (0, 1, False), added.err
    assert added.json["lacking"] == "1 golden part: from 3 on parts are compared with them"
    again = run("golden", "add", first, "-r", part.recipe, path=installed)
    assert again.code == 64
    assert "is in the set already" in " ".join(again.err.split())
    path = part.recipe.with_name("recipe.golden.json")
    stored = json.loads(path.read_text(encoding="utf-8"))
    (row,) = stored["parts"]
    # golden cards whose first pose is brighter by 0.3 in ln than that of this card
    off = ((0.3, 0.0, 0.01), (0.3, 0.01, 0.0), (0.3, -0.01, 0.01), (0.3, 0.0, -0.02))
    stored["parts"] = [
        row
        | {
            "serial": f"G-{k}",
            "log_radiance": [a + b for a, b in zip(row["log_radiance"], more, strict=True)],
        }
        for k, more in enumerate(off)
    ]
    path.write_text(json.dumps(stored), encoding="utf-8")
    shown = run("golden", "show", "-r", part.recipe, "--json", path=installed)
    assert (shown.json["compared_with"], len(shown.json["mean"])) == (True, 2)
    judged = run("inspect", *options, "--history", history, "-s", "C-2", path=installed)
    assert judged.code == 1, judged.err
    assert judged.json["verdict"] == "FAIL", judged.out
    assert judged.json["reasons"][0].startswith("not like the good cards (p = ")
    compared = run("compare", "C-1", "C-2", "--history", history, "--json", path=installed)
    assert compared.code == 0, compared.err
    removed = run("golden", "remove", "G-0", "-r", part.recipe, path=installed)
    assert "1 removed, 3 golden parts" in removed.out


def test_an_unknown_kind_is_one_line_that_names_the_known_ones(virtual_rig, run):
    part = virtual_rig(recipe=CARD | {"kind": "discs"})
    done = run("inspect", "-r", part.recipe, "-g", part.rig, "-s", "C-1", "--out", part.out)
    said = done.out + done.err
    assert done.code >= 64
    assert "Traceback" not in said
    assert "kind: there is no kind of part 'discs'; installed: plates, prints, ridges, wafers" in " ".join(
        said.split()
    )


def test_a_broken_plug_in_is_one_line_and_does_not_spoil_other_recipes(virtual_rig, run, tmp_path):
    points = "[anisoscope.kinds]\nbroken = broken_kind:KIND\n"
    path = install(
        tmp_path / "site", "broken_kind", points, {"broken_kind.py": "import nothing_of_this_name\n"}
    )
    part = virtual_rig(recipe=CARD | {"kind": "broken"})
    done = run("recipe", "check", part.recipe, path=path)
    said = " ".join((done.out + done.err).split())
    assert done.code >= 64
    assert "Traceback" not in said
    assert "the kind of part 'broken' does not load: No module named 'nothing_of_this_name'" in said
    good = virtual_rig("good")
    done = run("golden", "show", "-r", good.recipe, path=path)
    assert "there are no golden parts of this recipe" in " ".join((done.out + done.err).split())


PLAIN = """
from cards import Cards
from anisoscope.kinds.plugin import CommandOutput, Convention, Details, Judgement, Kind, Prediction
from anisoscope.kinds.plugin import RecipeBase, Reporting, Results, Verdict
import numpy as np


class Plain(Kind):
    name, one, recipe, details = "plain", "a plain part", RecipeBase, Details
    measure = Cards.measure

    def predict(self, recipe, rig, *, cached):
        return Prediction(recipe.poses.poses(), Convention(rig.light.angle_deg), "plain")

    def decide(self, sitting, recipe, expected, measured, reference):
        return Judgement(Verdict.PASS, ("nothing is judged",))

    def results(self, sitting, recipe, expected, measured, decided, reference):
        return Results(measured.radiance, np.full(len(expected.poses), 0.05), Details())


class Loud(Plain, Reporting):
    name = "loud"

    def summary(self, record):
        return CommandOutput({"kind": 7, "verdict": "FAIL", "reasons": [], "notes": None, "own": 1})


PLAIN, LOUD = Plain(), Loud()
"""


def test_a_kind_with_nothing_but_what_it_must_give(virtual_rig, run, installed, tmp_path):
    points = "[anisoscope.kinds]\nplain = plain:PLAIN\nloud = plain:LOUD\n"
    install(tmp_path / "site", "plain_kind", points, {"plain.py": PLAIN})
    path = f"{tmp_path / 'site'}{os.pathsep}{installed}"
    history = f"sqlite:///{tmp_path / 'history.sqlite'}"
    for name in ("plain", "loud"):
        recipe = dict.fromkeys(CARD) | {"kind": name}
        part = virtual_rig(name, recipe=recipe)
        options = ("-r", part.recipe, "-g", part.rig, "-s", "P-1", "--out", part.out, "--history", history)
        done = run("inspect", *options, "--json", path=path)
        assert done.code == 0, done.out + done.err
        found = json.loads(done.out)
        assert (found["kind"], found["verdict"], found["reasons"]) == (name, "PASS", ["nothing is judged"])
        assert isinstance(found["notes"], list)
        assert found.get("own") == (1 if name == "loud" else None)
    page = (Path(found["folder"]) / "report.html").read_text(encoding="utf-8")
    assert "never fails a part" not in page
    assert 'id="rule"' not in page
    shown = run("show", found["folder"], "--history", history, "--json", path=path)
    assert shown.code == 0, shown.out + shown.err
    exported = run("export", "--csv-file", tmp_path / "all.csv", "--history", history, path=path)
    assert exported.code == 0, exported.out + exported.err
    assert "P-1" in (tmp_path / "all.csv").read_text(encoding="utf-8")
    refused = run("spc", "--recipe", part.recipe, "--history", history, path=path)
    line = " ".join((refused.out + refused.err).split())
    assert refused.code == 64
    assert "gives no tolerances: give --lower and --upper" in line


@pytest.mark.parametrize(
    ("command", "says"),
    [
        (("golden", "show", "-r"), "good parts are not collected of this kind of part"),
        (("recipe", "new", "--kind", "plain", "--out"), "there is no recipe of a plain part to begin with"),
        (("recipe", "teach", "--golden", "--rig", "RIG"), "good parts alone do not teach it"),
    ],
)
def test_what_a_kind_does_not_have_is_one_line(virtual_rig, run, installed, tmp_path, command, says):
    points = "[anisoscope.kinds]\nplain = plain:PLAIN\n"
    install(tmp_path / "site", "plain_kind", points, {"plain.py": PLAIN})
    part = virtual_rig(recipe=dict.fromkeys(CARD) | {"kind": "plain"})
    file = tmp_path / "new.toml" if command[1] == "new" else part.recipe
    command = [part.rig if word == "RIG" else word for word in command]
    done = run(*command, file, path=f"{tmp_path / 'site'}{os.pathsep}{installed}")
    said = " ".join((done.out + done.err).split())
    assert done.code == 64
    assert says in said
    assert "Traceback" not in said


def test_an_object_that_is_no_kind_is_one_line_of_the_recipe_that_names_it(virtual_rig, run, tmp_path):
    points = "[anisoscope.kinds]\nthree = three_kind:KIND\nlike = three_kind:LIKE\n"
    source = (
        "KIND = 3\n\n\nclass Like:\n    name, fallback, details = 'like', False, None\n\n"
        "    def recognises(self, table):\n        return False\n\n\nLIKE = Like()\n"
    )
    path = install(tmp_path / "site", "three_kind", points, {"three_kind.py": source})
    for name in ("three", "like"):
        done = run("recipe", "check", virtual_rig(name, recipe=CARD | {"kind": name}).recipe, path=path)
        said = " ".join((done.out + done.err).split())
        assert done.code >= 64
        assert "Traceback" not in said
        assert f"kind: the kind of part '{name}' does not load" in said
        assert "is not an object of a class of Kind" in said
    good = virtual_rig("good")
    done = run("golden", "show", "-r", good.recipe, path=path)
    assert "there are no golden parts of this recipe" in " ".join((done.out + done.err).split())
    done = run("recipe", "new", "--out", tmp_path / "new.toml", path=path)
    assert done.code == 0, done.out + done.err


def test_two_packages_with_one_name_are_an_error_that_names_them(virtual_rig, run, tmp_path):
    points = "[anisoscope.kinds]\nridges = my_ridges:KIND\n"
    path = install(tmp_path / "site", "my_ridges", points, {"my_ridges.py": "KIND = 3\n"})
    for recipe in ({}, {"kind": "ridges"}):
        done = run("golden", "show", "-r", virtual_rig(str(len(recipe)), recipe=recipe).recipe, path=path)
        said = " ".join((done.out + done.err).split())
        assert done.code >= 64
        assert "Traceback" not in said
        assert (
            "several packages install a kind of part 'ridges': anisoscope, my_ridges: uninstall all but one"
            in said
        )


@pytest.mark.parametrize("kind", [3, ["ridges"]])
def test_a_kind_that_is_no_text(virtual_rig, anisoscope, kind):
    done = anisoscope("recipe", "check", virtual_rig(recipe={"kind": kind}).recipe)
    assert done.code >= 64
    assert "kind: expected text" in " ".join(done.err.split())


def test_a_recipe_may_name_its_kind(virtual_rig):
    from anisoscope.kinds.registry import kind_of

    assert kind_of(virtual_rig(recipe={"kind": "ridges"}).recipe).name == "ridges"
    assert kind_of(virtual_rig("unsaid").recipe).name == "ridges"


def test_what_the_page_shows_is_in_the_files():
    page = (DOCS / "own-kind.md").read_text(encoding="utf-8")
    for language, name in (("python", "cards.py"), ("toml", "pyproject.toml")):
        (shown,) = re.findall(rf"```{language}\n(.*?)```", page, re.DOTALL)
        assert shown in (EXAMPLE / name).read_text(encoding="utf-8"), name


def test_the_example_imports_the_public_names_of_plug_ins_and_nothing_else():
    tree = ast.parse((EXAMPLE / "cards.py").read_text(encoding="utf-8"))
    modules = {node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
    modules |= {one.name for node in ast.walk(tree) if isinstance(node, ast.Import) for one in node.names}
    assert {name for name in modules if name.startswith("anisoscope")} == {"anisoscope.kinds.plugin"}


def test_what_a_kind_receives_and_returns_is_among_the_public_names():
    """Every class of this distribution in the signatures of `Kind` can be imported from the public place."""
    from anisoscope.kinds import plugin

    named = set()
    parts = (
        *(plugin.Kind, plugin.References, plugin.Redeciding, plugin.Beginning, plugin.Teaching),
        *(plugin.Checking, plugin.Tolerances, plugin.Reporting),
    )
    for method in (method for part in parts for method in vars(part).values()):
        annotations = getattr(getattr(method, "fget", method), "__annotations__", {})
        named |= set(re.findall(r"anisoscope\.[\w.]+\.(\w+)", " ".join(map(str, annotations.values()))))
        classes = {one for one in annotations.values() if isinstance(one, type)}
        named |= {one.__name__ for one in classes if one.__module__.startswith("anisoscope")}
    assert {"Record", "Sitting"} <= named
    assert named - set(plugin.__all__) == set()
    assert all(getattr(plugin, name) is not None for name in plugin.__all__)
