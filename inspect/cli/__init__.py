"""The command line ``anisoscope``: a thin layer over the package.

Commands import what they need when they run, so that ``--help`` answers at once.
"""

import os
import signal
import sys
from types import FrameType
from typing import NoReturn

from cyclopts import App, Group
from cyclopts.exceptions import CycloptsError

from anisoscope.base.errors import AnisoscopeError, UsageError
from anisoscope.cli.help_page import asks_for_help, of_today, print_examples, usage_text
from anisoscope.cli.log import listening, options_of, report
from anisoscope.cli.recipe_options import apply_recipe
from anisoscope.cli.setup.project_file import apply_project

EXIT_INTERRUPTED = 130

app = App(
    name="anisoscope",
    help="Inspect engineered surfaces: photograph a part at several angles, compare the contrasts with the prediction, "
    "decide.",
    version_flags=["--version"],
    help_flags=["--help", "-h"],
    result_action="return_value",
    suppress_keyboard_interrupt=False,
    config=(apply_project, apply_recipe),
)
COMMANDS = {
    "Inspect": {
        "demo": "demo.demo:demo",
        "init": "setup.init:init",
        "inspect": "inspect.inspection:inspect",
        "batch": "inspect.batch:batch",
        "watch": "inspect.watch:watch",
        "resume": "inspect.inspection:resume",
        "read-code": "inspect.codes:read_code",
    },
    "Review": {
        "show": "history.history:show",
        "compare": "history.history:compare",
        "history": "history.history:app",
        "export": "history.history:export",
        "spc": "statistics.spc:spc",
        "msa": "statistics.msa:app",
        "verify": "inspect.inspection:verify",
        "recompute": "inspect.inspection:recompute",
    },
    "Set up the rig": {
        "rig": "rig.rig:app",
        "calibrate": "rig.calibrate:app",
        "camera": "statistics.camera:camera",
        "recipe": "recipe.recipe:app",
        "golden": "recipe.golden:app",
    },
    "Predict and design": {
        "predict": "predict.predict:predict",
        "render": "render.render:app",
        "profile": "profile.profile:app",
        "optimise": "study.optimise:optimise",
        "design": "design.design:app",
        "ink": "ink.ink:app",
        "fit": "fit.fit:app",
    },
    "Research": {"research": "study.study:app"},
    "This computer": {
        "doctor": "setup.doctor:doctor",
        "warm": "cache.warm:warm",
        "cache": "cache.cache:app",
        "completion": "setup.completion:completion",
    },
}
"""Commands by the user who needs them, in the order of the help: name and the attribute that runs it."""

for _flag in (*app.help_flags, *app.version_flags):
    app[_flag].group = "Options"
for _place, (_title, _commands) in enumerate(COMMANDS.items()):
    _group = Group(_title, sort_key=_place)
    for _number, (_name, _attribute) in enumerate(_commands.items()):
        app.command(
            f"anisoscope.cli.{_attribute}",
            name=_name,
            group=_group,
            sort_key=_number,
        )


def _version() -> str:
    from importlib.metadata import version

    return version("anisoscope")


app.version = _version


_signalled: list[int] = []
"""Signals that have arrived: where one meets a callback of the compiler, its exception is lost."""


def _terminate(signal_: int, _frame: FrameType | None) -> NoReturn:
    _signalled.append(signal_)
    raise KeyboardInterrupt


def _report(message: str, code: int) -> int:
    report(message)
    return code


def _notes(error: BaseException | None) -> list[str]:
    """Notes on the state of rig and folder that errors carry, including errors hit by a second interruption."""
    found: list[str] = []
    while error is not None:
        found += [note for note in getattr(error, "__notes__", ()) if note not in found]
        error = error.__context__
    return found


def _crash(error: Exception, arguments: list[str]) -> str:
    """Write the traceback of an error that no command foresaw to a file, and name both in one line."""
    import tempfile
    import traceback

    lines = ["anisoscope " + " ".join(map(str, arguments)), f"version {_version()}", ""]
    content = "\n".join([*lines, "".join(traceback.format_exception(error))])
    try:
        with tempfile.NamedTemporaryFile(
            "w", encoding="utf-8", prefix="anisoscope-crash-", suffix=".log", delete=False
        ) as file:
            file.write(content)
        where = f"the details are in {file.name}; report it with that file"
    except OSError:
        where = "run the command again with --debug, and report it with what that prints"
    kind = type(error).__name__
    return "; ".join([f"internal error ({kind}: {error}): this is no verdict; {where}", *_notes(error)])


def run(arguments: list[str]) -> int:
    """Run one command line and return its exit code; every error becomes one line on stderr.

    An error that no command foresaw ends with 70, never with the code of a verdict.
    """
    try:
        arguments, log_options = options_of(arguments)
        with listening(log_options):
            return _run(arguments, debug=log_options.debug)
    except UsageError as error:  # a log file that cannot be written
        return _report(str(error), error.exit_code)


def _run(arguments: list[str], *, debug: bool) -> int:
    arguments, remarks = of_today(arguments)
    for remark in remarks:
        _report(f"note: {remark}", 0)
    try:
        result = _call(arguments)
    except KeyboardInterrupt as interruption:
        return _report("; ".join(["interrupted", *_notes(interruption)]), EXIT_INTERRUPTED)
    except BrokenPipeError:  # no fault: the reader of the output has ended
        raise
    except Exception as error:
        if debug and not _signalled:
            raise
        return _failed(error, arguments)
    return result if isinstance(result, int) else 0


def _failed(error: Exception, arguments: list[str]) -> int:
    """Report an error in one line, and return its exit code."""
    if isinstance(error, CycloptsError):
        return _report(usage_text(error, arguments), UsageError.exit_code)
    if isinstance(error, AnisoscopeError):
        command = " ".join(app.parse_commands(arguments)[0])
        see = f" (see anisoscope {command} --help)" if type(error) is UsageError else ""
        return _report("; ".join([str(error) + see, *_notes(error)]), error.exit_code)
    if _signalled:
        return _report("; ".join(["interrupted", *_notes(error)]), EXIT_INTERRUPTED)
    return _report(_crash(error, arguments), AnisoscopeError.exit_code)


def _call(arguments: list[str]) -> object:
    helps = asks_for_help(app, arguments)
    if helps:
        for name in app:  # the page shows the first sentence of every command
            app[name]
    result = app(arguments, exit_on_error=False, print_error=False)
    if helps:
        print_examples(app, arguments)
    return result


def main() -> NoReturn:
    """Entry point of the ``anisoscope`` command."""
    # SIGHUP: the terminal was closed; nohup ignores it, and Windows knows none.
    numbers = [getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]
    for number in (signal.SIGINT, *numbers):
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, _terminate)
    try:
        code = run(sys.argv[1:])
        sys.stdout.flush()
    except BrokenPipeError:  # the reader of our output went away, as `| head` does
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        code = 0
    except KeyboardInterrupt:  # a second one, while the first was being reported
        code = EXIT_INTERRUPTED
    for number in (signal.SIGINT, *numbers):  # all is done; nobody needs a traceback of the end
        signal.signal(number, signal.SIG_IGN)
    sys.exit(code)
