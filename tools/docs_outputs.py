"""Printed results and pictures of the pages, from what makes them: python tools/docs_outputs.py (make docs-outputs).

A block of a page in the language ``console`` shows commands after ``$ `` and below each of them what it prints. All of
them run in a folder with the finished demo (seed 1) in ``demo-output``; the first is that demo. A line ``…`` leaves
out what follows up to the next line that the page shows. A test compares the pages with today's output
(`tests/inspect/cli/test_docs_outputs.py`).

Pictures whose command a page names (`anisoscope … docs/pictures/NAME`) and the photographs of the demo's reports are
made anew, and replaced where they look different. ``docs/pictures/made.json`` has a hash of every picture and of the
commands and scripts that name it: after a change of one of them without the other a test says which picture is old.
"""

import hashlib
import json
import re
import shlex
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from PIL import Image

from anisoscope.base.language import per_cent

ROOT = Path(__file__).resolve().parent.parent
PICTURES = ROOT / "docs/pictures"
MADE = PICTURES / "made.json"
MAKES = re.compile(r"`(anisoscope [^`]*?docs/pictures/([\w.-]+)[^`]*)`")
ALIKE = 0.5
"""Mean difference, in grey levels of 255, up to which two pictures are the same: fonts and browsers differ a little."""
BLOCK = re.compile(r"^```console\n(.*?)^```", re.MULTILINE | re.DOTALL)
NUMBER = re.compile(r"\d+(?:\.\d+)?(?:e[+-]?\d+)?")
LEFT_OUT = "…"
DEMO = "make demo"
TOLERANCE = 0.01


def pages() -> list[Path]:
    """Pages for users, which alone show outputs."""
    return [
        ROOT / "README.md",
        *sorted((ROOT / "docs").glob("*.md")),
        *sorted((ROOT / "docs/start").glob("*.md")),
    ]


def shown(text: str) -> Iterator[tuple[str, list[str]]]:
    """Commands of a page, each with the lines that it prints there."""
    for block in BLOCK.findall(text):
        for one in re.split(r"^\$ ", block, flags=re.MULTILINE)[1:]:
            command, *lines = one.rstrip("\n").split("\n")
            yield command, lines


def demo_lines(said: str) -> list[str]:
    """The verdicts of the demo as lines, as the console shows them, from its JSON."""
    parts = json.loads(said)["parts"]
    return [f"{part['serial']:<10}  {part['verdict']:<4}  {per_cent(part['finding'])}" for part in parts]


def left_out(lines: list[str], printed: list[str]) -> list[str]:
    """What a command prints today, without what the page leaves out.

    Args:
        lines: of the page.
        printed: today.
    """
    if LEFT_OUT not in lines or lines == [LEFT_OUT]:
        return printed
    at = lines.index(LEFT_OUT)
    rest = lines[at + 1 :]
    return [*printed[:at], LEFT_OUT, *(printed[-len(rest) :] if rest else [])]


def differences(lines: list[str], printed: list[str]) -> list[tuple[str, str]]:
    """Lines of a page that are not those of today, with today's: words exactly, numbers within a percent."""
    today = left_out(lines, printed)
    longest = max(len(lines), len(today))
    padded = [[*some, *[""] * (longest - len(some))] for some in (lines, today)]
    return [(old, new) for old, new in zip(*padded, strict=True) if not same(old, new)]


def same(first: str, second: str) -> bool:
    """Whether two lines have the same words, and numbers within a percent or two units of their last digit."""
    if NUMBER.sub("#", first).split() != NUMBER.sub("#", second).split():
        return False
    return all(map(_close, NUMBER.findall(first), NUMBER.findall(second)))


def _close(first: str, second: str) -> bool:
    digit = 10.0 ** -len(first.partition("e")[0].partition(".")[2])
    old, new = float(first), float(second)
    return abs(old - new) <= max(TOLERANCE * abs(old), 2.0 * digit if "." in first else 0.0)


def rewritten(text: str, printed: Callable[[str], list[str]]) -> str:
    """A page whose outputs are those of today; what is still right stays as it is."""

    def block(found: re.Match[str]) -> str:
        parts = []
        for command, lines in shown(found[0]):
            today = printed(command)
            keep = not differences(lines, today)
            parts += [f"$ {command}", *(lines if keep else left_out(lines, today))]
        return "\n".join(["```console", *parts, "```"])

    return BLOCK.sub(block, text)


def run_in(folder: Path) -> Callable[[str], list[str]]:
    """``run(command)``: the lines that a command prints in a folder, in which the demo has run."""
    known: dict[str, list[str]] = {}

    def run(command: str) -> list[str]:
        if command not in known:
            words = (
                ["anisoscope", "demo", "--out", "demo-output", "--json"]
                if command == DEMO
                else shlex.split(command)
            )
            done = subprocess.run(
                [sys.executable, "-Im", "anisoscope", "-q", *words[1:]],
                cwd=folder,
                capture_output=True,
                text=True,
                check=False,
            )
            if done.returncode > 3:  # 0 to 3 are verdicts
                sys.exit(f"{command}: {done.stderr.strip()}")
            known[command] = demo_lines(done.stdout) if command == DEMO else plain(done.stdout)
        return known[command]

    return run


def plain(printed: str) -> list[str]:
    """Lines without blanks at their ends."""
    return [line.rstrip() for line in printed.rstrip().split("\n")]


def commands() -> dict[str, str]:
    """Commands in the pages that make a picture, by the picture's name."""
    texts = [page.read_text(encoding="utf-8") for page in sorted((ROOT / "docs").rglob("*.md"))]
    return {name: " ".join(command.split()) for text in texts for command, name in MAKES.findall(text)}


def hashes() -> dict[str, str]:
    """Of the pictures that a command in a page or a script of the docs makes: of these, and of the file.

    Others have tests of their own, which compare what is drawn: plans of the code, findings, the first day.
    """
    by, found = commands(), {}
    scripts = [path.read_text(encoding="utf-8") for path in sorted((ROOT / "docs").glob("*.py"))]
    for picture in sorted(path for path in PICTURES.iterdir() if path.suffix in {".png", ".gif"}):
        names = f'"{picture.stem}"', picture.name
        makers = [by.get(picture.name, ""), *(text for text in scripts if any(map(text.__contains__, names)))]
        if any(makers):
            made = "".join(makers).encode() + picture.read_bytes()
            found[picture.name] = hashlib.sha256(made).hexdigest()
    return found


def look_alike(first: Path, second: Path) -> bool:
    """Whether two pictures look the same."""
    old, new = (np.asarray(Image.open(path).convert("RGB"), np.float64) for path in (first, second))
    return old.shape == new.shape and float(np.abs(old - new).mean()) <= ALIKE


def make_pictures(folder: Path) -> None:
    """Make pictures anew in the folder of the demo; replace those that look different, and name them."""
    new = folder / "docs/pictures"
    new.mkdir(parents=True)
    photographs = [str(ROOT / "docs/tutorial_pictures.py"), str(folder / "demo-output"), str(new)]
    asked = [
        shlex.split(command)[1:]
        for name, command in commands().items()
        if name.endswith(".png") and name != "render-code.png"  # that one takes a QR code of the reader's
    ]
    for words in [["-I", *photographs], *(["-Im", "anisoscope", "-q", *one] for one in asked)]:
        subprocess.run([sys.executable, *words], cwd=folder, stdout=subprocess.DEVNULL, check=True)
    for picture in sorted(new.iterdir()):
        if not look_alike(PICTURES / picture.name, picture):
            (PICTURES / picture.name).write_bytes(picture.read_bytes())
            sys.stdout.write(f"docs/pictures/{picture.name} is new: look at it\n")
    note_hashes()


def note_hashes() -> None:
    """Write the hashes of the pictures as they are."""
    MADE.write_text(json.dumps(hashes(), indent=1) + "\n", encoding="utf-8")


def main() -> None:
    """Write today's outputs into the pages and make their pictures, and name what has changed.

    With the word ``hashes`` nothing is made: for a picture that was made by hand.
    """
    if sys.argv[1:] == ["hashes"]:
        note_hashes()
        return
    with tempfile.TemporaryDirectory() as folder:
        run = run_in(Path(folder))
        run(DEMO)
        for page in pages():
            text = page.read_text(encoding="utf-8")
            new = rewritten(text, run)
            if new != text:
                page.write_text(new, encoding="utf-8")
                sys.stdout.write(f"{page.relative_to(ROOT)}: outputs are new\n")
        make_pictures(Path(folder))


if __name__ == "__main__":
    main()
