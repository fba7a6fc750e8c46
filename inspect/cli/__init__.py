"""The command line ``anisoscope``: a thin layer over the package.

Commands import what they need when they run, so that ``--help`` answers at once.
"""

import logging
import os
import signal
import sys
from types import FrameType
from typing import NoReturn

from cyclopts import App, Group
from cyclopts.exceptions import CycloptsError

from anisoscope.base.errors import AnisoscopeError, UsageError

EXIT_INTERRUPTED = 130

app = App(
    name="anisoscope",
    help="Inspect engineered surfaces: turn them under a camera, compare the contrasts with the prediction, decide.",
    version_flags=["--version"],
    help_flags=["--help", "-h"],
    result_action="return_value",
    suppress_keyboard_interrupt=False,
)
_jobs = Group.create_ordered("Jobs")
app.command("anisoscope.cli.demo.demo:demo", group=_jobs)
app.command("anisoscope.cli.inspect.inspection:inspect", group=_jobs)
app.command("anisoscope.cli.inspect.batch:batch", group=_jobs)
app.command("anisoscope.cli.inspect.watch:watch", group=_jobs)
app.command("anisoscope.cli.inspect.codes:code", group=_jobs)
app.command("anisoscope.cli.inspect.inspection:resume", group=_jobs)
app.command("anisoscope.cli.inspect.inspection:recompute", group=_jobs)
app.command("anisoscope.cli.inspect.inspection:verify", group=_jobs)
app.command("anisoscope.cli.predict.predict:predict", group=_jobs)
app.command("anisoscope.cli.render.render:app", name="render", group=_jobs)
app.command("anisoscope.cli.experiment.experiment:app", name="experiment", group=_jobs)
_results = Group.create_ordered("Results")
app.command("anisoscope.cli.history.history:app", name="history", group=_results)
app.command("anisoscope.cli.history.history:show", group=_results)
app.command("anisoscope.cli.history.history:compare", group=_results)
app.command("anisoscope.cli.history.history:export", group=_results)
app.command("anisoscope.cli.statistics.spc:spc", group=_results)
app.command("anisoscope.cli.statistics.msa:app", name="msa", group=_results)
app.command("anisoscope.cli.statistics.camera:camera", group=_results)
_research = Group.create_ordered("Models and materials")
app.command("anisoscope.cli.fit.fit:app", name="fit", group=_research)
app.command("anisoscope.cli.study.optimise:optimise", group=_research)
app.command("anisoscope.cli.study.study:app", name="study", group=_research)
app.command("anisoscope.cli.ink.ink:app", name="ink", group=_research)
app.command("anisoscope.cli.design.design:app", name="design", group=_research)
_parts = Group.create_ordered("Parts of the job")
app.command("anisoscope.cli.recipe.recipe:app", name="recipe", group=_parts)
app.command("anisoscope.cli.recipe.golden:app", name="golden", group=_parts)
app.command("anisoscope.cli.profile.profile:app", name="profile", group=_parts)
app.command("anisoscope.cli.rig.calibrate:app", name="calibrate", group=_parts)
app.command("anisoscope.cli.rig.rig:app", name="rig", group=_parts)
app.command("anisoscope.cli.cache.cache:app", name="cache", group=_parts)


def _version() -> str:
    from importlib.metadata import version

    return version("anisoscope")


app.version = _version


def _terminate(_signal: int, _frame: FrameType | None) -> NoReturn:
    raise KeyboardInterrupt


def _report(message: str, code: int) -> int:
    print(f"anisoscope: {' '.join(message.split())}", file=sys.stderr)  # noqa: T201
    return code


def _notes(error: BaseException | None) -> list[str]:
    """Notes on the state of rig and folder that errors carry, including errors hit by a second interruption."""
    found: list[str] = []
    while error is not None:
        found += [note for note in getattr(error, "__notes__", ()) if note not in found]
        error = error.__context__
    return found


def _listen(debug: bool) -> None:
    """Log kernel compilation to stderr; with --debug everything that the package logs."""
    everything, compiled = logging.getLogger("anisoscope"), logging.getLogger("anisoscope.compiled")
    for log in (everything, compiled):
        log.handlers.clear()
    handler = logging.StreamHandler()
    handler.setFormatter(logging.Formatter("anisoscope: %(message)s"))
    (everything if debug else compiled).addHandler(handler)
    if not debug:
        everything.addHandler(logging.NullHandler())


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
    debug = "--debug" in arguments
    _listen(debug)
    arguments = [token for token in arguments if token != "--debug"]
    try:
        result = app(arguments, exit_on_error=False, print_error=False)
    except KeyboardInterrupt as interruption:
        return _report("; ".join(["interrupted", *_notes(interruption)]), EXIT_INTERRUPTED)
    except CycloptsError as error:
        if debug:
            raise
        return _report(f"{error} (see anisoscope --help)", UsageError.exit_code)
    except AnisoscopeError as error:
        if debug:
            raise
        return _report("; ".join([str(error), *_notes(error)]), error.exit_code)
    except BrokenPipeError:  # no fault: the reader of the output has ended
        raise
    except Exception as error:
        if debug:
            raise
        return _report(_crash(error, arguments), AnisoscopeError.exit_code)
    return result if isinstance(result, int) else 0


def main() -> NoReturn:
    """Entry point of the ``anisoscope`` command."""
    # SIGHUP: the terminal was closed; nohup ignores it, and Windows knows none.
    numbers = [getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]
    for number in numbers:
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
