"""Write the pages of the reference: every command from the command line itself, every public name of the API.

Sphinx calls this when it builds the site, so that the reference cannot lag behind the code.

python docs/reference_pages.py FOLDER
"""

import re
import sys
from pathlib import Path

import anisoscope.api as an
from anisoscope.cli import app

COMMAND = re.compile(r"^## anisoscope ", re.MULTILINE)


def command_pages() -> dict[str, str]:
    """Markdown by the name of a top-level command; its subcommands are sections of its page."""
    text = app.generate_docs(output_format="markdown")
    found = {}
    for section in COMMAND.split(text)[1:]:
        name, _, rest = section.partition("\n")
        found[name.strip()] = f"# anisoscope {name.strip()}\n{re.sub('^##', '#', rest, flags=re.MULTILINE)}"
    return found


def commands_index(pages: dict[str, str]) -> str:
    """List of all commands with their first sentence."""
    lines = [
        "# Command line",
        "",
        "Every command has `--help`. The pages below hold the same text for all commands.",
        "",
        "| command | what it does |",
        "|---|---|",
    ]
    for name, text in sorted(pages.items()):
        paragraphs = [part.strip() for part in text.split("\n\n")]
        first = next(part for part in paragraphs if part and not part.startswith(("#", "`", "*", "|")))
        lines.append(f"| [`{name}`](commands/{name}.md) | {' '.join(first.split())} |")
    listed = "\n".join(f"commands/{name}" for name in sorted(pages))
    return "\n".join([*lines, "", "```{toctree}", ":hidden:", "", listed, "```", ""])


def api_page() -> str:
    """All public names with signature and docstring, grouped as functions, types and errors."""
    groups: dict[str, list[str]] = {"Functions": [], "Types": [], "Errors": []}
    for name in an.__all__:
        thing = getattr(an, name)
        if not isinstance(thing, type):
            groups["Functions"].append(f".. autofunction:: anisoscope.api.{name}")
        elif issubclass(thing, Exception):
            groups["Errors"].append(f".. autoexception:: anisoscope.api.{name}")
        else:
            groups["Types"].append(f".. autoclass:: anisoscope.api.{name}\n   :members:")
    lines = ["# Python API", "", "[Examples of all names](../api.md). Lengths are in µm, angles in degrees."]
    for title, names in groups.items():
        lines += ["", f"## {title}", ""]
        lines += [f"```{{eval-rst}}\n{name}\n```\n" for name in names]
    return "\n".join(lines)


def write_reference(folder: Path) -> None:
    """Write all pages; a page that has not changed keeps its time, so that Sphinx does not read it again."""
    commands = command_pages()
    pages = {f"commands/{name}.md": text for name, text in commands.items()}
    pages |= {"command-line.md": commands_index(commands), "python.md": api_page()}
    (folder / "commands").mkdir(parents=True, exist_ok=True)
    for old in {*folder.rglob("*.md")} - {folder / name for name in pages}:
        old.unlink()
    for name, text in pages.items():
        path = folder / name
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    write_reference(Path(sys.argv[1]))
