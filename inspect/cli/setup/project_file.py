"""Options that a command line leaves out take the values of the project file; options have precedence."""

import os
from pathlib import Path
from typing import TYPE_CHECKING

from anisoscope.base.csv_style import use_style
from anisoscope.base.signature import use_key
from anisoscope.cli.log import LOG, choose_language, chosen_csv_style, chosen_language
from anisoscope.operations.project import Default, project_defaults

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
OF_RECIPE = {("recipe", word) for word in ("check", "suggest", "teach", "yield")}
"""Commands whose FILE is the recipe of the project file where none is named."""


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
    _choose_history(known, commands, arguments)
    if commands in OF_RECIPE and "recipe" in known:
        _name_file(arguments, known["recipe"])
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


def _choose_history(
    known: dict[str, Default], commands: tuple[str, ...], arguments: "ArgumentCollection"
) -> None:
    """Inspections enter the history of their folder; others than the project's are not looked up in it."""
    if "out" in known and any(commands[: len(one)] == one for one in REVIEW):
        known.setdefault("history", known["out"])
    foreign = commands in {("show",), ("compare",)} and not _inside(arguments, known.get("out"))
    if foreign or os.environ.get("ANISOSCOPE_HISTORY", "").strip():
        known.pop("history", None)


def _name_file(arguments: "ArgumentCollection", recipe: Default) -> None:
    """Give FILE the recipe, unless the command line names one."""
    from cyclopts import Token

    for one in arguments:
        if one.index == 0 and not one.tokens:
            one.append(Token(value=recipe.value, source=str(recipe.source)))


def _inside(arguments: "ArgumentCollection", out: Default | None) -> bool:
    """Whether an inspection is named that the project's history may have: no folder, or one in its own folder."""
    folders = [Path(token.value) for one in arguments if one.index is not None for token in one.tokens]
    return not all(one.is_dir() for one in folders) or any(
        out is not None and one.resolve().is_relative_to(Path(out.value).resolve()) for one in folders
    )
