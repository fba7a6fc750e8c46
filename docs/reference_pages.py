"""Write the pages of the reference: commands, public names of the API, messages of errors, and notebooks.

Sphinx calls this when it builds the site, so that the reference cannot lag behind the code.

python docs/reference_pages.py FOLDER
"""

import ast
import base64
import re
import sys
from collections.abc import Iterator
from pathlib import Path

import nbformat

import anisoscope.api as an
from anisoscope.base.errors import AnisoscopeError
from anisoscope.cli import app
from anisoscope.cli.help_page import examples

ROOT = Path(__file__).resolve().parent.parent
SOURCES = ("inspect", "rig", "profiles", "sim")
OF_THE_COMMAND_LINE = 64
COMMAND = re.compile(r"^## anisoscope ", re.MULTILINE)
HEADING = re.compile(r"^#{2,} anisoscope (?P<words>.*)$", re.MULTILINE)
MARKUP = re.compile(r"[\\`*_{}\[\]<>#|$~]")


def command_pages() -> dict[str, str]:
    """Markdown by the name of a top-level command; its subcommands are sections of its page."""
    text = app.generate_docs(output_format="markdown")
    found = {}
    for section in COMMAND.split(HEADING.sub(with_examples, text))[1:]:
        name, _, rest = section.partition("\n")
        found[name.strip()] = f"# anisoscope {name.strip()}\n{re.sub('^##', '#', rest, flags=re.MULTILINE)}"
    return found


def with_examples(heading: re.Match[str]) -> str:
    """The heading of a command with the examples of its help below."""
    command = app
    for word in heading["words"].split():
        command = command[word]
    shown = "\n".join(examples(command))
    return f"{heading[0]}\n\n```sh\n{shown}\n```" if shown else heading[0]


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
    lines = [
        "# Python API",
        "",
        "[Examples of all names](python-examples.md). Lengths are in µm, angles in degrees.",
    ]
    for title, names in groups.items():
        lines += ["", f"## {title}", ""]
        lines += [f"```{{eval-rst}}\n{name}\n```\n" for name in names]
    return "\n".join(lines)


def error_classes() -> dict[str, type[AnisoscopeError]]:
    """All errors by name, of modules that are imported by now."""
    found: dict[str, type[AnisoscopeError]] = {}
    waiting: list[type[AnisoscopeError]] = [AnisoscopeError]
    while waiting:
        one = waiting.pop()
        found[one.__name__] = one
        waiting += one.__subclasses__()
    return found


def messages(source: str) -> Iterator[tuple[str, str]]:
    """Name of the error and its message, values as …, for each error that a source raises with a text of its own."""
    for node in ast.walk(ast.parse(source)):
        if not isinstance(node, ast.Call) or not isinstance(node.func, ast.Name) or not node.args:
            continue
        text = node.args[0]
        if isinstance(text, ast.JoinedStr):
            parts = [str(one.value) if isinstance(one, ast.Constant) else "…" for one in text.values]
            yield node.func.id, "".join(parts)
        elif isinstance(text, ast.Constant) and isinstance(text.value, str):
            yield node.func.id, text.value


def messages_page() -> str:
    """All messages of errors other than those of the command line, by class, with the exit code."""
    classes = error_classes()
    found: dict[str, set[str]] = {}
    for folder in SOURCES:
        for path in sorted((ROOT / folder).rglob("*.py")):
            for name, text in messages(path.read_text(encoding="utf-8")):
                if (
                    name in classes
                    and classes[name].exit_code != OF_THE_COMMAND_LINE
                    and len(text) > len("… …")
                ):
                    found.setdefault(name, set()).add(text)
    lines = [
        "# Messages",
        "",
        "Errors by class, with the exit code of the command; … is a value. [What to do](../troubleshooting.md).",
        "Errors of the command line (exit code 64) name the option, and are not listed.",
    ]
    for name in sorted(found, key=lambda one: (classes[one].exit_code, one)):
        meaning = (classes[name].__doc__ or "").splitlines()[0]
        lines += ["", f"## {name}: exit code {classes[name].exit_code}", "", meaning, ""]
        lines += [f"- {MARKUP.sub(lambda sign: chr(92) + sign[0], text)}" for text in sorted(found[name])]
    return "\n".join([*lines, ""])


def notebook_page(path: Path, pictures: Path) -> str:
    """A notebook as Markdown, with the outputs that it holds; its pictures are written beside the page."""
    lines = []
    for number, cell in enumerate(nbformat.read(path, as_version=4).cells):
        if cell.cell_type == "markdown":
            lines += [cell.source, ""]
            continue
        lines += ["```python", cell.source, "```", ""]
        for output in cell.outputs:
            data = output.get("data", {"text/plain": output.get("text", "")})
            if "image/png" in data:
                name = f"{path.stem}-{number}.png"
                (pictures / name).write_bytes(base64.b64decode(data["image/png"]))
                lines += [f"![{path.stem}, output of cell {number}]({name})", ""]
            else:
                lines += ["```text", str(data["text/plain"]).rstrip(), "```", ""]
    lines += [f"The notebook is `docs/notebooks/{path.name}`.", ""]
    return "\n".join(lines)


def write_reference(folder: Path) -> None:
    """Write all pages; a page that has not changed keeps its time, so that Sphinx does not read it again."""
    commands = command_pages()
    pages = {f"commands/{name}.md": text for name, text in commands.items()}
    pages |= {
        "command-line.md": commands_index(commands),
        "python.md": api_page(),
        "python-examples.md": (ROOT / "docs" / "examples" / "api.md").read_text(encoding="utf-8"),
        "messages.md": messages_page(),
    }
    for place in ("commands", "notebooks"):
        (folder / place).mkdir(parents=True, exist_ok=True)
    for path in sorted((ROOT / "docs" / "notebooks").glob("*.ipynb")):
        pages[f"notebooks/{path.stem}.md"] = notebook_page(path, folder / "notebooks")
    for old in {*folder.rglob("*.md")} - {folder / name for name in pages}:
        old.unlink()
    for name, text in pages.items():
        path = folder / name
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    write_reference(Path(sys.argv[1]))
