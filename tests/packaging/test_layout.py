"""Guards against the traps of a folder named like a module of the standard library."""

import ast
import importlib
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
FOLDERS = {
    "anisoscope": "inspect",
    "anisoscope.rig": "rig",
    "anisoscope.profiles": "profiles",
    "anisoscope.sim": "sim",
}


@pytest.fixture(scope="module")
def project():
    return tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))


def python(*arguments):
    done = subprocess.run(
        [sys.executable, *arguments], cwd=ROOT, capture_output=True, text=True, check=False, timeout=120
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def test_inspect_is_a_namespace_root_without_init():
    assert not (ROOT / "inspect" / "__init__.py").exists()


def test_tests_have_no_init_files():
    assert list((ROOT / "tests").rglob("__init__.py")) == []


def test_packages_are_the_folders_with_modules(project):
    """As setup.py hands them over, without building anything."""
    script = (
        "import runpy, setuptools\n"
        "setuptools.setup = lambda packages: print(*packages)\n"
        "runpy.run_path('setup.py', run_name='__main__')"
    )
    found = {"anisoscope"}
    for package, folder in FOLDERS.items():
        for module in (ROOT / folder).rglob("*.py"):
            found.add(".".join([package, *module.parent.relative_to(ROOT / folder).parts]))
    packages = python("-c", script).split()
    assert sorted(packages) == sorted(found)
    assert project["tool"]["setuptools"]["package-dir"] == FOLDERS


def test_the_contract_of_kinds_names_all_kinds(project):
    folders = {path.parent.name for path in (ROOT / "inspect" / "kinds").glob("*/__init__.py")}
    modules = {
        module
        for contract in project["tool"]["importlinter"]["contracts"]
        if contract["type"] == "independence"
        for module in contract["modules"]
    }
    points = project["project"]["entry-points"]["anisoscope.kinds"].values()
    assert modules == {f"anisoscope.kinds.{name}" for name in folders}
    assert modules == {point.partition(":")[0].rpartition(".")[0] for point in points}


def test_every_file_beside_modules_gets_into_the_wheel(project):
    """From a checkout a command would find it all the same, and only users would miss it."""
    patterns = project["tool"]["setuptools"]["package-data"]["*"]
    files, taken = set(), set()
    for folder in (ROOT / name for name in FOLDERS.values()):
        beside = (path for path in folder.rglob("*") if path.is_file() and path.suffix != ".py")
        files |= {path for path in beside if path.parent.name != "__pycache__"}  # of Python and numba
        packages = {folder, *(init.parent for init in folder.rglob("__init__.py"))}
        taken |= {path for package in packages for pattern in patterns for path in package.glob(pattern)}
    # the sketch is for the board, by the Arduino IDE
    assert files - taken == {ROOT / "rig" / "firmware" / "light" / "light.ino"}


def test_no_folder_with_modules_lacks_an_init():
    for folder in FOLDERS.values():
        for module in (ROOT / folder).rglob("*.py"):
            if module.parent != ROOT / "inspect":
                assert (module.parent / "__init__.py").exists(), module


def test_no_module_of_inspect_bears_a_name_of_the_standard_library():
    names = {path.stem for path in (ROOT / "inspect").glob("*") if path.suffix in ("", ".py")} - {"__main__"}
    assert names & sys.stdlib_module_names == set()


@pytest.mark.parametrize("path", sorted((ROOT / "tests/benchmarks").glob("*.py")), ids=lambda path: path.stem)
def test_what_a_benchmark_imports_of_ours_is_there(path):
    """They run in `make benchmark` only, and what they time may have moved."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("anisoscope"):
            module = importlib.import_module(node.module)
            for one in node.names:
                assert hasattr(module, one.name) or importlib.import_module(f"{node.module}.{one.name}")


def test_no_file_has_the_name_of_an_accident():
    """What a shell or an editor leaves in the root is no part of the distribution."""
    names = [path.name for path in ROOT.iterdir()]
    assert [name for name in names if not re.fullmatch(r"[\w.-]+", name)] == []


def test_import_inspect_in_the_root_is_the_standard_library():
    assert python("-c", "import inspect; print(inspect.signature(len))") == "(obj, /)"


def test_python_m_anisoscope_works_in_the_root():
    assert python("-m", "anisoscope", "--version") == "0.1.0"


def test_help_is_cheap():
    """Neither a library of numbers nor one of models is loaded to print the help."""
    script = (
        "import sys, anisoscope.cli as cli\n"
        "cli.run(['--help'])\n"
        "libraries = {'numpy', 'pydantic', 'markdown_it', 'scipy', 'cv2', 'matplotlib', 'numba', 'pyvista', 'vtk'}\n"
        "heavy = (libraries | {'skimage', 'tifffile'}) & set(sys.modules)\n"
        "print('heavy:', sorted(heavy))"
    )
    assert python("-c", script).endswith("heavy: []")


def test_light_models_import_without_numba_and_scipy():
    modules = "sys, anisoscope.sim.light.relief, anisoscope.sim.light.corrected"
    assert python("-c", f"import {modules}\nprint({{'numba', 'scipy'}} & set(sys.modules))") == "set()"


def test_asyncua_which_is_lgpl_is_imported_by_opc_ua_alone():
    root = ROOT
    found = [
        path.relative_to(root).as_posix()
        for folder in ("inspect", "rig", "profiles", "sim")
        for path in (root / folder).rglob("*.py")
        if re.search(r"^\s*(from|import) asyncua\b", path.read_text(encoding="utf-8"), re.MULTILINE)
    ]
    assert sorted(found) == [
        "inspect/line/opcua.py",
        "inspect/line/opcua_security.py",
        "inspect/line/opcua_types.py",
        "inspect/line/press.py",
        "sim/press_server.py",
    ]


def test_no_module_of_the_package_is_named_like_a_test():
    """Else pytest would collect it, where it is asked for a folder of the package."""
    modules = [path.name for folder in FOLDERS.values() for path in (ROOT / folder).rglob("*.py")]
    assert [name for name in modules if name.startswith("test_") or name.endswith("_test.py")] == []
