"""What help pages and usage errors say: examples, everyday options first, remedies; and former words of commands."""

import inspect
import re
from collections.abc import Callable, Collection, Sequence
from difflib import get_close_matches
from itertools import takewhile
from pathlib import Path
from typing import Annotated, Any, TypeVar

from cyclopts import App, Group, Parameter
from cyclopts.exceptions import (
    CycloptsError,
    MissingArgumentError,
    UnknownCommandError,
    UnknownOptionError,
    UnusedCliTokensError,
)

MORE = Group("More options", sort_key=50)
"""Panel of the options that few users need; the panel above it holds at most twelve."""
FIRST_OPTIONS = 10
ALL_FLAG = "--help-all"
"""Shows every option of a command; on the first page every command with its sentence."""
GLOBAL_OPTIONS = """Options of every command:
  -v, --verbose    print more: tables behind an answer, device messages
  --help-all       show all options of a command; without a command all commands
  -q, --quiet      print no progress, as with ANISOSCOPE_QUIET=1
  --log-file FILE  append what happens to a file, with times
  --lang LANGUAGE  en, de or da: messages and page 1 of reports; else that of the locale
  --csv-style STYLE  comma (1.5,2), or semicolon (1,5;2) for European spreadsheets: CSV files that are written
  --debug          print the traceback of an error"""
FIRST_EXAMPLES = (
    "anisoscope demo",
    "anisoscope init job --ridge-angle 10 --pitch 100",
    "anisoscope inspect --recipe recipe.toml --rig rig.toml --serial A-0001",
)
"""Examples of the first page: those of its first commands, stated here so that the page imports none of them."""
_NEGATIVE_VALUE = re.compile(r"-[\d.]")


T = TypeVar("T", bound=Callable[..., Any])


def everyday(*names: str) -> Callable[[T], T]:
    """Decorator: show these options of a command first, and all others in the panel `MORE`.

    Args:
        names: parameters of a function, or fields of a class of options (then below ``@dataclass``).
    """

    def mark(command: T) -> T:
        positional = {
            one.name
            for one in ([] if isinstance(command, type) else inspect.signature(command).parameters.values())
            if one.kind is not one.KEYWORD_ONLY
        }
        rest: Any = Annotated
        for name, kind in command.__annotations__.items():
            if name not in {*names, *positional, "return"}:
                command.__annotations__[name] = rest[kind, Parameter(group=MORE)]
        return command

    return mark


def first_options() -> tuple[Any, Callable[[], str]]:
    """A formatter of help pages that shows `FIRST_OPTIONS` options, and a line that names the panels of the others."""
    from cyclopts.help import DefaultFormatter

    class Short(DefaultFormatter):
        shown, hidden = 0, 0
        panels: tuple[str, ...] = ()

        def __call__(self, console: Any, options: Any, panel: Any) -> None:  # noqa: ANN401 - of cyclopts
            if panel.format == "parameter" and panel.title != "Arguments":
                known = len(panel.entries)
                panel.entries = panel.entries[: max(FIRST_OPTIONS - self.shown, 0)]
                self.shown += len(panel.entries)
                if known > len(panel.entries):
                    self.hidden += known - len(panel.entries)
                    self.panels = (*self.panels, str(panel.title))
            if panel.entries:
                super().__call__(console, options, panel)

    found = Short()

    def rest() -> str:
        where = ", ".join(name for name in found.panels if name not in {"Parameters", MORE.name})
        return f"{found.hidden} more options" + (f" ({where})" if where else "") if found.hidden else ""

    return found, rest


def examples(command: App) -> list[str]:
    """Command lines under a help page, at most three.

    They are those in the section ``Examples:`` of the docstring; of a group the first ones of its commands.
    """
    import docstring_parser

    if command.default_command is None:
        flags = (*command.help_flags, *command.version_flags)
        return [line for name in command if name not in flags for line in examples(command[name])[:1]][:3]
    parsed = docstring_parser.parse(command.default_command.__doc__ or "")
    return [line.strip() for one in parsed.examples for line in (one.description or "").splitlines() if line]


def asks_for_help(app: App, arguments: Sequence[str]) -> bool:
    """Whether a command line prints a help page: by a flag, or because it names no command that runs."""
    own = arguments[: arguments.index("--")] if "--" in arguments else arguments
    if any(flag in own for flag in app.help_flags):
        return True
    _, apps, unused = app.parse_commands(own)
    return apps[-1].default_command is None and not unused


def command_of(app: App, arguments: Sequence[str]) -> App:
    """The command, or the group of commands, that a command line names."""
    flags = (*app.help_flags, *app.version_flags)
    return app.parse_commands([token for token in arguments if token not in flags])[1][-1]


def print_below(shown: Sequence[str], further: str = "") -> None:
    """Print what is below a help page: the examples, in lines that can be copied, and further lines."""
    from anisoscope.cli.tables import print_lines

    print_lines(
        "Examples:",
        *(f"  {one}" for one in shown),
        *(["", *further.splitlines()] if further else []),
    )


def usage_text(error: CycloptsError, arguments: Sequence[str]) -> str:
    """One line for a command line that cannot be understood: the mistake, the remedy, and where to read on.

    Args:
        error: from the parser.
        arguments: the command line, without the program.
    """
    chain = " ".join(error.command_chain or ())
    return f"{_mistake(error, arguments)} (see {' '.join(filter(None, ('anisoscope', chain, '--help')))})"


def _mistake(error: CycloptsError, arguments: Sequence[str]) -> str:
    if isinstance(error, MissingArgumentError) and error.argument is not None:
        return _missing(error, arguments)
    if isinstance(error, UnusedCliTokensError):
        unused = error.unused_tokens or []
        if all(len(token.strip("-")) <= 2 and _NEGATIVE_VALUE.match(token) for token in unused):
            return f"{' '.join(unused)} is left over: a value that begins with a minus needs '=', as in --tilts=-10"
        return _by_options(error, unused) or f"too many arguments: {' '.join(unused)}"
    if isinstance(error, UnknownOptionError) and (word := _after_the_end(error, arguments)) is not None:
        return (
            f"{word} stands after '--', which ends the options: write the options before it, or leave it out"
        )
    if isinstance(error, UnknownCommandError):
        return _unknown_command(error, arguments)
    return str(error).removesuffix(".")


def _unknown_command(error: UnknownCommandError, arguments: Sequence[str]) -> str:
    if error.command_chain:
        chain = " ".join(error.command_chain)
        return str(error).replace("Unknown command", f"Unknown command of {chain}:", 1)
    if not arguments[0].startswith("-"):
        return str(error).removesuffix(".")
    flags = [*re.findall(r"--[\w-]+", GLOBAL_OPTIONS), "--version", "--help"]
    near = get_close_matches(arguments[0], flags, n=1)
    return f"Unknown option: {arguments[0]}" + (f". Did you mean {near[0]}?" if near else "")


FILE_OPTIONS = (
    (".toml", ("stage", "camera"), ("--rig",)),
    (".toml", ("product",), ("--recipe",)),
    (".csv", (), ("--csv", "--readings")),
    (".dfq", (), ("--csv",)),
)
"""Ending of a file, keys of which it has one, and the options that take such a file, of which a command has one."""


def _by_options(error: UnusedCliTokensError, unused: Sequence[str]) -> str | None:
    """The command line that names files by their options; None where some token is no file that an option takes."""
    known = None if error.app is None else error.app.assemble_argument_collection()
    names = {name for argument in known or () for name in argument.names}
    options = [_option_of(Path(token), names) for token in unused]
    if not options or None in options:
        return None
    chain = " ".join(("anisoscope", *(error.command_chain or ())))
    pairs = " ".join(f"{option} {token}" for option, token in zip(options, unused, strict=True))
    return f"files are named by options: {chain} {pairs}"


def _option_of(path: Path, names: Collection[str]) -> str | None:
    for suffix, keys, options in FILE_OPTIONS:
        known = next((option for option in options if option in names), None)
        if known is None or path.suffix.lower() != suffix:
            continue
        if not keys or keys_of(path) & set(keys):
            return known
    return None


def keys_of(path: Path) -> set[str]:
    """Keys of the first level of a TOML file; none where it cannot be read."""
    from anisoscope.base.errors import AnisoscopeError
    from anisoscope.base.toml_table import read_toml

    try:
        return set(read_toml(path))
    except AnisoscopeError:
        return set()


def _after_the_end(error: UnknownOptionError, arguments: Sequence[str]) -> str | None:
    """The option that the parser does not know because it stands after ``--``; None if it is unknown anyway."""
    word = error.token.keyword or error.token.value
    known = error.argument_collection or ()
    if "--" not in arguments or word not in arguments[list(arguments).index("--") :]:
        return None
    return word if any(word.partition("=")[0] in argument.names for argument in known) else None


def _missing(error: MissingArgumentError, arguments: Sequence[str]) -> str:
    """What an option that has no value lacks: the option itself, its value, or the ``=`` before a minus."""
    assert error.argument is not None
    names = error.argument.names
    given = next((k for k, token in enumerate(arguments) if token in names), None)
    if given is None:
        name = error.argument.name
        what = f"{name} is missing" if name.startswith("-") else f"{name.upper()} is missing"
        wrong = str(error).partition("Did you mean")
        return f"{what}. Did you mean{wrong[2]}".removesuffix(".") if wrong[1] else what
    following = arguments[given + 1] if given + 1 < len(arguments) else ""
    if _NEGATIVE_VALUE.match(following):
        return f"a value that begins with a minus needs '=': write {arguments[given]}={following}"
    if following and not following.startswith("-"):  # some of several values
        values = list(takewhile(lambda word: not word.startswith("-"), arguments[given + 1 :]))
        return f"{arguments[given]} needs {error.argument.token_count()[0]} values, not {len(values)}"
    return f"{arguments[given]} needs a value" + (f", and {following} is an option" if following else "")


FORMER_COMMANDS = {
    ("code",): ("read-code",),
    ("experiment", "ridges"): ("research", "experiment"),
    ("experiment", "findings"): ("research", "findings"),
    ("experiment",): ("research",),
    ("study",): ("research",),
}
"""Words of the version before -> words of today; the longer ones first."""
_COUNT = {"--frames": "--count"}
FORMER_OPTIONS: dict[tuple[str, ...], dict[str, str]] = {
    ("calibrate", "rotation"): _COUNT | {"--angles": "--steps"},
    **{("calibrate", kind): _COUNT for kind in ("flat", "dark", "stray", "linearity", "response")},
    ("rig", "snap"): _COUNT | {"--stage": "--read-axes", "--no-stage": "--no-read-axes"},
    ("rig", "live"): _COUNT | {"--port": "--web-port"},
    ("rig", "commission"): _COUNT | {"--part": "--recipe"},
    ("rig", "sim"): {"--model": "--device-type"},
    ("rig", "check"): _COUNT,
    **{("msa", study): {"--alpha": "--significance"} for study in ("bias", "linearity", "stability")},
    ("calibrate", "check"): {"--limit": "--max-deviation"},
    ("calibrate", "material"): {"--tilt": "--max-tilt"},
    ("spc",): {"--width": "--ewma-limit", "--center": "--known-mean", "--sigma": "--known-sigma"},
    ("export",): {"--json": "--json-file", "--csv": "--csv-file"},
    ("history", "dispose"): {"--by": "--reviewer"},
    ("watch",): {"--settle": "--stable-for"},
    ("recipe", "suggest"): {"--noise": "--u-pose"},
    ("optimise",): {"--tolerance": "--scatter"},
    ("render", "checkerboard"): {"--size": "--plate-width"},
    ("render", "frame"): {"--stage": "--angles"},
    ("design", "refine"): {"--method": "--search"},
    ("design", "pattern"): {"--size": "--plate-size"},
    ("design", "height"): {"--size": "--window-size", "--grid": "--pixel"},
    ("ink", "proof"): {
        "--pitch": "--pitch-angle",
        "--model": "--ink-model",
        "--gain": "--image-gain",
        "--size": "--picture-size",
    },
    ("ink", "show"): {"--exposure": "--brightness", "--model": "--ink-model", "--angles": "--light-angles"},
    ("ink", "halftone"): {"--gain": "--image-gain", "--width": "--print-width"},
    ("ink", "compare"): {"--size": "--picture-size", "--white": "--reflectance"},
    ("ink", "fit"): {"--method": "--fit-method", "--white": "--reflectance", "--noise": "--u-reading"},
    ("profile", "make"): {
        "--direction": "--lay",
        "--second-direction": "--second-lay",
        "--field": "--square",
        "--step": "--step-height",
    },
    ("profile", "rotate"): {"--field": "--extent"},
    ("profile", "texture"): {"--uncertainty": "--draws"},
    ("fit", "ridges"): {"--covariance": "--covariance-file", "--kind": "--quantity"},
    ("research", "experiment"): {"--csv": "--as-csv"},
    ("research", "findings"): {"--grid": "--grid-points"},
}
"""Command of today -> its options of the version before and of today."""


def of_today(arguments: Sequence[str]) -> tuple[list[str], list[str]]:
    """A command line in the words of today, and a remark for every word that was replaced.

    Args:
        arguments: the command line, without the program.
    """
    found, remarks = list(arguments), []
    for old, new in FORMER_COMMANDS.items():
        if tuple(found[: len(old)]) == old:
            found[: len(old)] = new
            remarks.append(f"`{' '.join(old)}` is `{' '.join(new)}` now")
            break
    for command, options in FORMER_OPTIONS.items():
        if tuple(found[: len(command)]) == command:
            found = [_renamed(token, options, remarks) for token in found]
    return found, remarks


def _renamed(token: str, options: dict[str, str], remarks: list[str]) -> str:
    name, equals, value = token.partition("=")
    if name not in options:
        return token
    remarks.append(f"`{name}` is `{options[name]}` now")
    return options[name] + equals + value
