"""Options that a command line leaves out take the values of the project file; options have precedence."""

import os
from typing import TYPE_CHECKING

from anisoscope.base.csv_style import use_style
from anisoscope.base.signature import use_key
from anisoscope.cli.log import LOG, choose_language, chosen_csv_style, chosen_language
from anisoscope.operations.project import project_defaults

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


def apply_project(app: "App", commands: tuple[str, ...], arguments: "ArgumentCollection") -> None:
    """Give options that the command line leaves out the values of the project file; a configuration of cyclopts."""
    from cyclopts.config import Dict

    known = project_defaults()
    lang = known.pop("lang", None)
    if lang is not None and chosen_language() is None:
        choose_language(lang.value)
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
