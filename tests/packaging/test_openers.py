"""Files that a user or another program hands over are opened by `anisoscope.base.regular_file` alone."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("inspect", "rig", "profiles", "sim")
OWN = {
    "inspect/base/cache.py": "the folder of the cache",
    "inspect/base/language.py": "catalogues of the package",
    "inspect/base/regular_file.py": "the opener itself",
    "inspect/console/pages.py": "files of the package",
    "inspect/inspection/archive_store.py": "objects of the archive, by their hashes",
    "inspect/line/opcua_types.py": "types of the package",
    "inspect/operations/qualification.py": "sources of the package",
    "rig/cameras/uvc.py": "the kernel's files on a device",
    "rig/portholder.py": "the kernel's files on a process",
    "profiles/files/decoder_worker.py": "a file that the process before it has looked at; the kernel's files",
}
"""Modules that open what nobody else writes."""


def bare_openers(tree):
    """Line numbers of calls that read a file without looking at what it is."""
    for call in (node for node in ast.walk(tree) if isinstance(node, ast.Call)):
        name = call.func.attr if isinstance(call.func, ast.Attribute) else getattr(call.func, "id", "")
        receiver = ast.unparse(call.func.value) if isinstance(call.func, ast.Attribute) else ""
        if "files(" in receiver:  # data of the package
            continue
        modes = [
            one.value
            for one in (*call.args, *(key.value for key in call.keywords if key.arg == "mode"))
            if isinstance(one, ast.Constant) and isinstance(one.value, str)
        ]
        is_reading = "rb" in modes or "r" in modes or (not modes and not receiver)
        if (name in {"read_text", "read_bytes"} and receiver) or (
            name == "open"
            and (is_reading or receiver.endswith("Image"))
            and not (receiver.endswith("Image") and ast.unparse(call.args[0]) in {"file", "stream"})
        ):
            yield call.lineno


@pytest.mark.parametrize("package", PACKAGES)
def test_no_module_opens_files_of_others_by_itself(package):
    found = [
        f"{path.relative_to(ROOT).as_posix()}:{line}"
        for path in sorted((ROOT / package).rglob("*.py"))
        if path.relative_to(ROOT).as_posix() not in OWN
        for line in bare_openers(ast.parse(path.read_text(encoding="utf-8")))
    ]
    assert not found, "use bounded_bytes, bounded_text or regular_file of anisoscope.base.regular_file"


def test_modules_that_may_are_there_and_do():
    for name in OWN:
        assert list(bare_openers(ast.parse((ROOT / name).read_text(encoding="utf-8")))), name


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("path.read_text()", [1]),
        ("open(path)", [1]),
        ("path.open('rb')", [1]),
        ("PIL.Image.open(path)", [1]),
        ("PIL.Image.open(file)", []),
        ("path.open('wb')", []),
        ("files('anisoscope').joinpath('x').read_text()", []),
        ("history.open()", []),
    ],
)
def test_what_is_found(text, found):
    assert list(bare_openers(ast.parse(text))) == found
