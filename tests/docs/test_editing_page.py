"""The table of editing steps in docs/height-maps.md is that of the program, and its steps are steps."""

import os
import re
from pathlib import Path

import numpy as np

from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.profiles.editing.operations import OPERATIONS
from anisoscope.profiles.editing.steps import Step, edit_map
from anisoscope.profiles.ideal import ridges

PAGE = Path(__file__).resolve().parents[2] / "docs" / "height-maps.md"
PLACE = re.compile(r"(<!-- steps: .*? -->\n).*?(<!-- end of steps -->)", re.DOTALL)


def table():
    """Steps with the names of their values, units and defaults; `--help` of each step has the meanings."""
    lines = ["| step | purpose | values (default) |", "|---|---|---|"]
    for operation in OPERATIONS.values():
        values = []
        for one in operation.parameters:
            unit = f" [{one.unit}]" if one.unit else ""
            default = {None: "", True: " (yes)", False: " (no)"}.get(one.default, f" ({one.default})")
            values.append(f"`{one.name}`{unit}{default}")
        lines.append(f"| `{operation.name}` | {operation.meaning} | {', '.join(values)} |")
    return "".join(f"{line}\n" for line in lines)


def test_table_of_steps():
    text = PAGE.read_text(encoding="utf-8")
    expected = PLACE.sub(lambda found: found[1] + table() + found[2], text)
    if os.environ.get("ANISOSCOPE_WRITE_DOCS"):
        PAGE.write_text(expected, encoding="utf-8")
    assert text == expected, "run once with ANISOSCOPE_WRITE_DOCS=1"


def test_steps_of_the_page_can_be_parsed():
    for text in re.findall(r"`([a-z]+=[^`]*)`", PAGE.read_text(encoding="utf-8").partition("## Editing")[2]):
        Step.parse(text)
    assert np.isfinite(
        edit_map(ridges(RidgeDesign(100.0, 10.0), (40, 400), 1.0), ["form=plane"]).height_um
    ).all()
