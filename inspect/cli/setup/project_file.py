"""Project file ``anisoscope.toml``: what commands take where their command line leaves it out.

The file is searched in the working folder and all folders above it; what it does not state is taken from the file
``config.toml`` in the user's folder of settings. An option of the command line has precedence over both.
"""

import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from pydantic import Field

from anisoscope.base.csv_style import use_style
from anisoscope.base.errors import ConfigError
from anisoscope.base.language import use
from anisoscope.base.signature import use_key
from anisoscope.base.toml_file import LocalPath, Part, read_toml_model
from anisoscope.cli.log import LOG, chosen_csv_style, chosen_language
from anisoscope.cli.setup.project_place import project_files

if TYPE_CHECKING:
    from cyclopts import App, ArgumentCollection

ACQUIRE = (("inspect",), ("batch",), ("watch",))
REVIEW = (("show",), ("compare",), ("history",), ("export",), ("whatif",), ("spc",), ("msa",))
COMMANDS: dict[str, tuple[tuple[str, ...], ...]] = {
    "recipe": (*ACQUIRE, ("golden",)),
    "rig": (
        ("inspect",),
        ("batch",),
        ("serve",),
        ("rig",),
        ("calibrate",),
        ("recipe", "check"),
        ("recipe", "teach"),
    ),
    "out": (*ACQUIRE, ("serve",), ("recipe", "teach")),
    "operator": (("inspect",), ("batch",), ("calibrate",)),
    "station": (("inspect",), ("batch",), ("serve",)),
    "history": (*ACQUIRE, ("resume",), ("serve",), *REVIEW),
    "store": (("archive",),),
}
"""Key of the file -> commands that take it as an option; elsewhere an option of that name means something else."""
INSTEAD = {"rig": ("--frames", "--driver"), "history": ("--csv",)}
"""Key of the file -> options in whose presence it is left out, because they stand in its place."""


class ProjectFile(Part):
    """Keys of the project file; paths count from its folder."""

    recipe: LocalPath | None = None
    rig: LocalPath | None = None
    out: LocalPath | None = None
    history: str | None = Field(default=None, min_length=1)
    store: str | None = Field(default=None, min_length=1)
    operator: str | None = Field(default=None, min_length=1)
    station: str | None = Field(default=None, min_length=1)
    lang: Literal["en", "de", "da"] | None = None
    csv_style: Literal["comma", "semicolon"] | None = None
    signing_key: str | None = Field(default=None, min_length=1)


@dataclass(frozen=True)
class Default:
    """A value and the file that states it."""

    value: str
    source: Path


def read_project(path: Path) -> dict[str, Default]:
    """Values of one file.

    Raises:
        ConfigError: the file cannot be read, or has an unknown key.
    """
    found = read_toml_model(path, ProjectFile, error=ConfigError)
    values = {name: value for name, value in found.model_dump().items() if value is not None}
    if found.history is not None and found.history != "none" and "://" not in found.history:
        values["history"] = path.resolve().parent / found.history
    if found.signing_key is not None and ":" not in found.signing_key and found.signing_key != "none":
        values["signing_key"] = path.resolve().parent / found.signing_key
    if found.store is not None and "://" not in found.store:
        values["store"] = path.resolve().parent / found.store
    return {name: Default(str(value), path) for name, value in values.items()}


def project_defaults() -> dict[str, Default]:
    """Values of the project file, and of the user's file what that leaves out.

    Raises:
        ConfigError: one of the files cannot be read.
    """
    found: dict[str, Default] = {}
    for path in project_files():
        found |= read_project(path)
    return found


def apply_project(app: "App", commands: tuple[str, ...], arguments: "ArgumentCollection") -> None:
    """Give options that the command line leaves out the values of the project file; a configuration of cyclopts."""
    from cyclopts.config import Dict

    known = project_defaults()
    lang = known.pop("lang", None)
    if lang is not None and chosen_language() is None:
        use(lang.value)
    style = known.pop("csv_style", None)
    if style is not None and chosen_csv_style() is None:
        use_style(style.value)
    signing = known.pop("signing_key", None)
    if signing is not None:
        use_key(signing.value)
    given = {name for one in arguments if one.tokens for name in one.names}
    if "out" in known and "history" not in known and any(commands[: len(one)] == one for one in REVIEW):
        known["history"] = known["out"]  # inspections enter the history of their folder
    if os.environ.get("ANISOSCOPE_HISTORY", "").strip():
        known.pop("history", None)
    options = {name for one in arguments for name in one.names}
    for key, default in known.items():
        wanted = any(commands[: len(one)] == one for one in COMMANDS[key])
        replaced = given & {f"--{key}", *INSTEAD.get(key, ())}
        if wanted and not replaced and f"--{key}" in options:
            LOG.info("%s: --%s %s", default.source, key, default.value)
            table: dict[str, object] = {key: default.value}
            for name in reversed(commands):
                table = {name: table}
            source = Dict(table, source=str(default.source))
            source(app, commands, arguments)
