"""The pages that show how the code is laid out say what the contract and the imports say."""

import importlib.util
import json
import pkgutil
import re
import sys
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "layout.md"
DESCRIPTION = "{http://purl.org/dc/elements/1.1/}description"


@pytest.fixture(scope="module")
def tools():
    """The scripts of tools/, which import each other by name."""
    sys.path.insert(0, str(ROOT / "tools"))
    try:
        yield {name: importlib.import_module(name) for name in ("house", "draw_layout")}
    finally:
        sys.path.remove(str(ROOT / "tools"))


@pytest.fixture(scope="module")
def table_of_floors():
    """Rows of the table: the names of a floor, and what is said of it."""
    table = PAGE.read_text(encoding="utf-8").split("<!-- floors: the layers of pyproject.toml -->")[1]
    lines = table.split("<!-- end of floors -->")[0].strip().splitlines()
    return [(named(line.split("|")[1]), line.split("|")[2]) for line in lines[2:]]


def named(text):
    return re.findall(r"`([^`]+)`", text)


def test_the_table_of_floors_is_the_import_contract(table_of_floors, tools):
    assert [names for names, _ in table_of_floors] == tools["house"].contract_layers(ROOT)


def test_the_floors_within_the_simulation_are_its_contract(table_of_floors, tools):
    [text] = [said for names, said in table_of_floors if names == ["sim"]]
    assert [named(floor) for floor in text.split(" over ")] == tools["house"].contract_layers(
        ROOT, "anisoscope.sim"
    )


def test_modules_that_a_frame_passes_exist():
    text = PAGE.read_text(encoding="utf-8").split("## The way of a frame")[1].split("## Floors")[0]
    named = re.findall(r"`(anisoscope\.[a-z_.]+)`", text)
    assert len(named) > 10
    for name in named:
        assert importlib.util.find_spec(name) is not None, name


def test_everything_of_ours_that_contributing_names_exists():
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    names = set(re.findall(r"`(anisoscope(?:\.\w+)+)[`(]", text))
    assert len(names) > 5
    for name in names:
        assert pkgutil.resolve_name(name) is not None


def test_arrows_that_a_longer_way_says_are_left_out(tools):
    graph = {"top": {"middle", "ground"}, "middle": {"ground"}, "ground": set()}
    assert tools["draw_layout"].thinned(graph) == {"top": {"middle"}, "middle": {"ground"}, "ground": set()}


def test_neighbours_in_the_picture_do_not_overlap(tools):
    arrows = {"a": {"c", "d"}, "b": {"c", "d"}, "c": {"e"}, "d": {"e"}, "e": set()}
    place, chains = tools["draw_layout"].places(arrows, tools["house"].floors(arrows))
    assert len(chains) == 6
    for row in ("ab", "cd"):
        first, second = (x for (name, _, _), x in place.items() if name in row)
        assert abs(first - second) >= tools["draw_layout"].BOX[0]


def test_a_picture_says_which_arrows_it_shows(tools, tmp_path):
    """Drawn twice it is the same file."""
    arrows = {"cli": {"base"}, "rig": {"base"}, "base": set()}
    for name in ("one.svg", "two.svg"):
        tools["draw_layout"].draw(arrows, tools["house"].floors(arrows), tmp_path / name)
    assert (tmp_path / "one.svg").read_bytes() == (tmp_path / "two.svg").read_bytes()
    shown = json.loads(next(ET.parse(tmp_path / "one.svg").iter(DESCRIPTION)).text)
    assert shown == {"base": [], "cli": ["base"], "rig": ["base"]}


def test_the_picture_shows_the_imports_as_they_are(tools):
    """Where it does not: python tools/draw_layout.py."""
    shown = json.loads(next(ET.parse(tools["draw_layout"].PICTURE).iter(DESCRIPTION)).text)
    now = tools["draw_layout"].thinned(tools["draw_layout"].downward(ROOT))
    assert shown == {name: sorted(found) for name, found in now.items()}
