"""Figures of the import graph that must not get worse; tools/house.py counts them."""

import importlib.util
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, get_args

import pytest
from cyclopts import App, Parameter

ROOT = Path(__file__).resolve().parents[2]


def script(name):
    """A script of tools/ as a module."""
    spec = importlib.util.spec_from_file_location(name, ROOT / "tools" / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module


house = script("house")


@pytest.fixture(scope="module")
def graph():
    return house.import_graph(ROOT)


@pytest.fixture(scope="module")
def found(graph):
    return house.numbers(ROOT, graph)


def test_the_graph_holds_all_modules(graph):
    assert len(graph) > 0.9 * len(house.source_files(ROOT))


def test_every_package_of_the_first_level_has_its_floor(found):
    named, _, there = found["layers_cover"].partition(" of ")
    assert named == there


def test_an_array_type_is_declared_once(found):
    assert found["float_array_declarations"] == 1


def test_no_contract_ignores_an_import(found):
    assert found["ignored_imports"] == 0


def test_circles_are_found_and_floors_counted():
    graph = {"a": {"b"}, "b": {"c", "d"}, "c": {"b"}, "d": set(), "e": {"a", "d"}}
    assert house.circles(graph) == [["b", "c"]]
    assert house.floors(graph) == {"d": 1, "b": 2, "c": 2, "a": 3, "e": 4}


def test_an_import_that_goes_up_or_across_is_found():
    graph = {"anisoscope.low": {"anisoscope.high.one"}, "anisoscope.high.one": {"anisoscope.beside.two"}}
    layers = [["high", "beside"], ["low"]]
    assert house.upward_imports(graph, layers) == [
        ("anisoscope.low", "anisoscope.high.one"),
        ("anisoscope.high.one", "anisoscope.beside.two"),
    ]


def test_packages_import_each_other_through_their_modules():
    graph = {
        "anisoscope.a.x": {"anisoscope.a.y", "anisoscope.b"},
        "anisoscope.a.y": set(),
        "anisoscope.b": set(),
    }
    assert house.packages_of(graph) == {"a": {"b"}, "b": set()}


def test_code_is_neither_blank_nor_comment_nor_docstring():
    text = '"""What it is."""\n\n# why\nx = """a\nb"""\n\n\ndef f():\n    """Does."""\n    return x  # here\n'
    assert house.code_lines(text) == 4


def test_files_lines_and_code_are_counted(tmp_path):
    (tmp_path / "inspect").mkdir()
    (tmp_path / "pyproject.toml").write_text('[tool.setuptools.package-dir]\nanisoscope = "inspect"\n')
    for name in ("a", "b"):
        (tmp_path / "inspect" / f"{name}.py").write_text('"""What it is."""\n\nx = 1\n')
    assert house.sizes(tmp_path) == {"files": 2, "lines": 6, "code_lines": 2}


def test_comments_docstrings_and_those_of_private_names_are_counted():
    text = '"""What\n\nit is."""\n# why\nclass _A:\n    """A."""\n    def __init__(self):\n        """B."""\n'
    text += "    x = 1  # no\n"
    assert house.documentation(text) == {"comment_lines": 1, "docstring_lines": 5, "private_docstrings": 1}


def test_a_long_signature_has_more_than_eight_parameters_besides_self():
    eight = "def f(self, a, b, c, d, /, e, f, *, g, h):\n    pass\n"
    assert house.long_signatures(eight) == 0
    assert house.long_signatures(eight.replace("h)", "h, i)")) == 1


@dataclass
class _Lamp:
    power: float


@dataclass
class _Optics(_Lamp):
    aperture: Annotated[float, Parameter(name="--na")] = 0.1


_Wide = Annotated[bool, Parameter(name="--wide")]


def test_an_option_is_counted_where_it_is_declared():
    app = App()

    @app.command
    def one(
        name: str, *, seed: int = 1, wide: _Wide = False, optics: Annotated[_Optics, Parameter(name="*")]
    ):
        pass

    @app.command
    def two(*, wide: _Wide = False, optics: Annotated[_Optics, Parameter(name="*")]):
        pass

    commands, found = house.declared_options(app)
    assert commands == 2
    here = "test_an_option_is_counted_where_it_is_declared.<locals>.one"
    assert found == {
        (__name__, f"{here}.name"),
        (__name__, f"{here}.seed"),
        (".".join(__name__.split(".")[:2]), f"wide: {get_args(_Wide)}"),
        (__name__, "_Lamp.power"),
        (__name__, "_Optics.aperture"),
    }


def test_options_of_the_command_line_are_counted():
    found = house.options(ROOT)
    assert found["commands"] > 100
    assert found["options_by_hand"] + found["options_of_models"] > 500


def test_identifiers_that_name_a_kind():
    text = (
        "print(record.print)\n"
        "console.print('PrintRecipe')  # a wafer\n"
        "is_wafer = golden_prints\n"
        "print_table(fingerprint, footprints, blueprint)\n"
        "x = PrintRecipe\n"
    )
    assert house.kind_lines(text, verbs=True) == [1, 3, 5]
    assert house.kind_lines(text) == [1, 3, 4, 5]


def test_no_import_goes_up(found):
    assert found["upward_imports"] == 0


def test_packages_of_the_first_level_have_no_circle(found):
    assert found["first_level_cycles"] == 0


def test_only_kinds_name_a_kind(found):
    assert found["kind_lines"] == 0


def test_no_module_is_in_a_circle(found):
    assert found["module_cycles"] == 0


def test_few_modules_have_exactly_one_importer(found):
    assert found["modules_with_one_importer"] - found["modules_of_tables"] <= 60


def test_no_module_is_a_fragment_of_its_only_importer(found):
    assert found["fragments"] == 0


def test_a_plug_in_of_a_table_is_no_fragment():
    table = min(house.TABLES)
    package = table.rpartition(".")[0]
    graph = {table: {f"{package}.one"}, f"{package}.main": {f"{package}.two"}, f"{package}.one": set()}
    graph |= {f"{package}.two": set()}
    single = house.modules_with_one_importer(graph)
    assert house.of_tables(single) == [f"{package}.one"]
    assert house.fragments(single, graph, dict.fromkeys(single, 20)) == [f"{package}.two"]


def test_a_fragment_is_small_and_in_the_package_of_its_only_importer():
    graph = {
        "a.b.main": {"a.b.small", "a.b.large", "a.b.kernels", "a.c.small", "a.b.shared"},
        "a.b.other": {"a.b.shared"},
        "a.b.small": set(),
    }
    single = house.modules_with_one_importer(graph)
    assert set(single) == {"a.b.small", "a.b.large", "a.b.kernels", "a.c.small"}
    lines = dict.fromkeys(single, 20) | {"a.b.large": 120}
    graph |= {name: set() for name in single}
    assert house.fragments(single, graph, lines) == ["a.b.small"]


def test_in_the_root_lie_the_public_names_and_the_entry_only():
    kept = {path.name for path in (ROOT / "inspect").iterdir() if path.is_file()}
    assert kept == {"__main__.py", "api.py", "py.typed"}
