"""Figures of docs/evidence/reflectance.md: a test says what it found, and the page must have the same.

With ANISOSCOPE_WRITE_DOCS=1 it has: the row is written with the date and the commit on which the tree is built, and the
rows of tests that did not run keep theirs (`make figures`).
"""

import datetime as dt
import os
import re
import subprocess
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs" / "evidence" / "reflectance.md"
NUMBER = re.compile(r"\d*\.?\d+")
SHARE = 0.05
"""Relative difference of two numbers that are the same, or two units of the last digit."""


def figure(part, what, judge, found, goal):
    """Compare a row with the page, or write it.

    Args:
        part: heading of its table.
        what: is compared.
        judge: with which.
        found: number with its unit, as the page shows it.
        goal: likewise.
    """
    text = PAGE.read_text(encoding="utf-8")
    before, heading, after = text.partition(f"\n## {part}\n")
    assert heading, f"{PAGE} has no heading {part!r}"
    table, following, rest = after.partition("\n## ")
    lines, row = table.split("\n"), f"| {what} | {judge} | {goal} | "
    here = [number for number, line in enumerate(lines) if line.startswith(row)]
    if os.environ.get("ANISOSCOPE_WRITE_DOCS") != "1":
        assert here, f"no row {row!r} in {PAGE}: run `make figures`"
        shown = lines[here[0]].removeprefix(row).partition(" | ")[0]
        assert same(shown, found), f"{what}: the page has {shown}, today it is {found}: run `make figures`"
        return
    now = f"{row}{found} | {dt.datetime.now(dt.UTC):%Y-%m-%d}, `{commit()}` |"
    if here:
        lines[here[0]] = now
    else:
        last = max(number for number, line in enumerate(lines) if line.startswith("|"))
        lines.insert(last + 1, now)
    PAGE.write_text(before + heading + "\n".join(lines) + following + rest, encoding="utf-8")


def same(first, second):
    """Whether two texts have the same words, and numbers within `SHARE` or two units of the last digit."""
    if NUMBER.sub("#", first) != NUMBER.sub("#", second):
        return False
    pairs = zip(NUMBER.findall(first), NUMBER.findall(second), strict=True)
    return all(
        abs(float(a) - float(b)) <= max(SHARE * abs(float(a)), 2.001 * 10.0 ** -len(a.partition(".")[2]))
        for a, b in pairs
    )


def commit():
    """The commit that is checked out, in short."""
    done = subprocess.run(
        ["git", "rev-parse", "--short=8", "HEAD"], cwd=ROOT, capture_output=True, text=True, check=True
    )
    return done.stdout.strip()
