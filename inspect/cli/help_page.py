"""What help pages say: examples, and everyday options first."""

import inspect
from collections.abc import Callable, Sequence
from typing import Annotated, Any, TypeVar

from cyclopts import App, Group, Parameter

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
