"""What users type and what programs read: options of all commands, and keys of their JSON.

Both are kept in text files beside the tests of the commands. A change shows in their diff, and belongs into the
changelog.
"""

import contextlib
import json
import os
import re
from pathlib import Path

from cyclopts import App

from anisoscope import cli
from anisoscope.cli import json_output

HERE = Path(__file__).parent / "cli"
OPTIONS, KEYS = HERE / "options.txt", HERE / "json_keys.txt"
WRITE = "ANISOSCOPE_WRITE_KEYS"
"""Folder that takes the keys which are new, in place of a failure."""
NAME = re.compile(r"[a-z][a-z0-9_]*")
FOLDERS = ("cli", "history", "line")
"""Folders of tests whose commands print what the file of keys lists."""
BY_NAME = 24
"""A table with more keys of one kind than this is one of names, not of fields."""


def commands(app: App = cli.app, path=()):
    """All commands that run, with the words that call them."""
    if app.default_command is not None:
        yield " ".join(path), app
    for word in app:
        if word not in (*app.help_flags, *app.version_flags):
            yield from commands(app[word], (*path, word))


def kind_of(hint) -> str:
    """A type in short: choices by their words, classes by their names."""
    text = getattr(hint, "__name__", None) if isinstance(hint, type) else str(hint)
    text = re.sub(r"typing\.|pathlib\.|[a-z_.]+\.(?=[A-Z])", "", text)
    text = re.sub(r"Optional\[(.*)\]$", r"\1 | None", text)
    # the order of a Literal is that of the first one with the same words in a process
    return re.sub(
        r"Literal\[(.*?)\]", lambda words: f"Literal[{', '.join(sorted(words[1].split(', ')))}]", text
    )


def lines_of_options() -> list[str]:
    """One line for each option: command, its names, type, default."""
    found = []
    for words, command in commands():
        for one in command.assemble_argument_collection():
            names = [name for name in one.names if name != "*"]
            if names:
                default = one.field_info.default
                shown = "required" if default is one.field_info.empty else repr(default)
                if default is None and isinstance(one.show_default, str):  # of a parameter model
                    shown = one.show_default
                shown = re.sub(r"PosixPath\((.*?)\)", r"\1", shown)
                found.append(f"{words}: {' '.join(names)} ({kind_of(one.hint)}) = {shown}")
    return sorted(found)


def keys(value, at="") -> set[str]:
    """Paths of the keys of a JSON document; items of lists count as one, names that are data as *."""
    if isinstance(value, list):
        return set().union(*(keys(item, at) for item in value))
    if not isinstance(value, dict):
        return set()
    fixed = len(value) <= BY_NAME or all(NAME.fullmatch(key) for key in value)
    found = set()
    for key, item in value.items():
        path = f"{at}{key if fixed and NAME.fullmatch(key) else '*'}"
        found |= {path} | keys(item, f"{path}.")
    return found


def known_keys() -> dict[str, set[str]]:
    """Keys by command, from the file."""
    found = {}
    for line in KEYS.read_text(encoding="utf-8").splitlines() if KEYS.exists() else ():
        words, _, names = line.partition(": ")
        found.setdefault(words, set()).update(names.split())
    return found


def known_commands() -> set[str]:
    """Words of all commands, from the file."""
    return {line.partition(":")[0] for line in OPTIONS.read_text(encoding="utf-8").splitlines()}


class Watch:
    """Looks at the JSON that commands print, and notes keys that the file does not know."""

    def __init__(self):
        self.known, self.commands = known_keys(), known_commands()
        self.command = ""
        self.unknown: dict[str, set[str]] = {}

    def begins(self, arguments):
        """A command line is about to run in this process."""
        words = [str(one) for one in arguments[:4]]
        starts = (" ".join(words[:count]) for count in (3, 2, 1))
        self.command = next((start for start in starts if start in self.commands), "")

    def prints(self, value):
        """The command prints a document."""
        if self.command and (new := keys(value) - self.known.get(self.command, set())):
            self.unknown.setdefault(self.command, set()).update(new)

    def printed(self, arguments, text):
        """A command in another process printed this."""
        if "--json" not in arguments:
            return
        self.begins(arguments)
        with contextlib.suppress(ValueError):
            self.prints(json.loads(text))
        self.command = ""

    def check(self):
        """Fail where a command printed a key that the file does not know; with `WRITE` note it instead."""
        new, self.unknown = self.unknown, {}
        if new and WRITE in os.environ:
            with (Path(os.environ[WRITE]) / f"{os.getpid()}.json").open("a", encoding="utf-8") as file:
                file.write(json.dumps({words: sorted(names) for words, names in new.items()}) + "\n")
            return
        assert not new, f"keys of JSON that {KEYS.name} does not know: {new}"


def watch(monkeypatch) -> Watch:
    """Look at all commands that run in this process."""
    call, as_json, eyes = cli._call, json_output.as_json, Watch()

    def called(arguments):
        eyes.begins(arguments)
        try:
            return call(arguments)
        finally:
            eyes.command = ""

    def shown(value):
        found = as_json(value)
        eyes.prints(found)
        return found

    monkeypatch.setattr(cli, "_call", called)
    monkeypatch.setattr(json_output, "as_json", shown)
    return eyes
