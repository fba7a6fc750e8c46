"""docs/faults.md is what the conformance tests expect, fault by fault; ANISOSCOPE_WRITE_DOCS=1 writes it anew."""

import ast
import itertools
import os
from pathlib import Path

import pytest

from anisoscope.sim.bench.firmware import faults as faults_module
from anisoscope.sim.bench.firmware.faults import FaultKind

PAGE = Path(__file__).parents[3] / "docs" / "faults.md"
HEAD = """# What a driver does when its stage fails

This table is written by the tests that check it (`tests/rig/stages`), on every kind of line: in process, pseudo
terminal, TCP. Where a class of error stands, the driver raises it within the time that the motion may take, tells the
stage to stop, and closes the port; no thread is left, and once the fault is gone the next connection works. "goes on":
the driver copes, and the angle is right. A number after the colon is the fault's parameter, as in
`anisoscope rig sim zaber --fault stall:47.5`. The times come from distance, velocity and acceleration of the stage:
1.5 times what the move takes, plus two seconds.
"""


def meanings():
    """The sentence that stands below every member of `FaultKind` in its source."""
    tree = ast.parse(Path(faults_module.__file__).read_text(encoding="utf-8"))
    body = next(
        node for node in tree.body if isinstance(node, ast.ClassDef) and node.name == "FaultKind"
    ).body
    found = {}
    for name, text in itertools.pairwise(body):
        if isinstance(name, ast.Assign) and isinstance(text, ast.Expr):
            found[FaultKind(name.value.value)] = text.value.value
    return found


def cell(case, fault):
    expected = case.error_of(fault)
    return "goes on" if expected is None else f"{expected[0].__name__}: {expected[1]}".replace("|", "\\|")


def table_of(cases):
    told = meanings()
    lines = [HEAD]
    for kind in FaultKind:
        lines += [f"## {kind}", "", told[kind], "", "| stage | fault | driver |", "|---|---|---|"]
        for case in cases.values():
            rows = [fault for fault in case.faults if fault.partition(":")[0] == str(kind)]
            lines += [f"| {case.protocol} | `{fault}` | {cell(case, fault)} |" for fault in rows]
            if not rows:
                lines.append(f"| {case.protocol} | – | a device of this protocol cannot have it |")
        lines.append("")
    return "\n".join(lines)


def test_the_page_of_faults_is_true(all_cases):
    text = table_of(all_cases)
    if os.environ.get("ANISOSCOPE_WRITE_DOCS") == "1":
        PAGE.write_text(text, encoding="utf-8")
    if not PAGE.exists() or PAGE.read_text(encoding="utf-8") != text:
        pytest.fail(f"{PAGE.name} is out of date: run this test with ANISOSCOPE_WRITE_DOCS=1")


def test_every_fault_has_its_sentence():
    assert set(meanings()) == set(FaultKind)
