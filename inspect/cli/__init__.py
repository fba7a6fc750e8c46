"""The command line ``anisoscope``: a thin layer over the package.

Commands import what they need when they run, so that ``--help`` answers at once.
"""

import io
import os
import signal
import sys
from types import FrameType
from typing import NoReturn

from cyclopts import App, ArgumentCollection, Group
from cyclopts.exceptions import CycloptsError

from anisoscope.base.errors import AnisoscopeError, UsageError
from anisoscope.cli.help_page import (
    ALL_FLAG,
    FIRST_EXAMPLES,
    GLOBAL_OPTIONS,
    asks_for_help,
    command_of,
    examples,
    first_options,
    print_below,
)
from anisoscope.cli.log import listening, options_of, report
from anisoscope.cli.mistakes import file_advice, of_today, usage_text
from anisoscope.operations.project_place import project_files
from anisoscope.rig.acquisition.interruptions import INTERRUPTIONS

EXIT_INTERRUPTED = 130


def _apply_project(app: App, commands: tuple[str, ...], arguments: ArgumentCollection) -> None:
    """What a project file states, where there is one: only then is the library loaded that reads it."""
    if project_files():
        from anisoscope.cli.setup.project_file import apply_project

        apply_project(app, commands, arguments)


app = App(
    name="anisoscope",
    help="Inspect engineered surfaces: photograph a part at several angles, compare the contrasts with the prediction, "
    "decide.",
    version_flags=["--version"],
    help_flags=["--help", "-h"],
    result_action="return_value",
    suppress_keyboard_interrupt=False,
    config=(_apply_project,),
)
COMMANDS = {
    "Inspect": {
        "demo": (
            "demo.demo:demo",
            "Inspect good and defective parts on a virtual rig; no hardware is needed.",
        ),
        "init": (
            "setup.init:init",
            "Write a job folder: recipe, rig file and anisoscope.toml, which names them for all commands.",
        ),
        "inspect": (
            "inspect.inspection:inspect",
            "Photograph a part, compare its contrasts (of a print: its colours) with the prediction, and decide.",
        ),
        "batch": (
            "inspect.batch:batch",
            "Inspect the parts of a tray list; a fault at one part does not stop the others.",
        ),
        "watch": (
            "inspect.watch:watch",
            "Inspect every folder of frames that another program writes; Ctrl-C stops after the current one.",
        ),
        "serve": (
            "console.serve:serve",
            "Serve the console: a page at the station and a page over all stations, until Ctrl-C.",
        ),
        "line": (
            "line.line:app",
            "Serve a rig to the controller of a line: jobs by OPC UA, MQTT or Modbus/TCP.",
        ),
        "resume": (
            "inspect.inspection:resume",
            "Continue an interrupted inspection: photograph what is missing, judge, write record and report.",
        ),
        "read-code": (
            "inspect.codes:read_code",
            "Read the Data Matrix, Code 128 or QR code on a part; GS1 codes give lot and serial number.",
        ),
    },
    "Review": {
        "show": (
            "history.history:show",
            "Show one inspection: verdict, numbers, reviewers' decisions, and whether its folder is unchanged.",
        ),
        "angle-map": (
            "inspect.facets:angle_map",
            "Measure the angle of the facets of an inspected part from its photographs, cell by cell.",
        ),
        "compare": (
            "history.history:compare",
            (
                "Compare two inspections: contrasts side by side, and what changed in recipe, rig, calibrations "
                "and software."
            ),
        ),
        "history": (
            "history.history:app",
            "List past inspections; add and check them, record reviewers' decisions.",
        ),
        "export": (
            "history.export:export",
            "Export past inspections as CSV, JSON, JUnit or AQDEF; the filters are those of history.",
        ),
        "whatif": (
            "history.whatif:whatif",
            "Judge past inspections by another recipe: which verdicts change, what that means for escapes and cost.",
        ),
        "spc": (
            "statistics.spc:spc",
            "Control charts and capability: I-MR, EWMA, Nelson's rules, Cp, Cpk; drift, and what it came with.",
        ),
        "msa": (
            "statistics.msa:app",
            "Measurement system analysis: gauge R&R, bias, linearity, stability, attributes, type 1, VDA 5.",
        ),
        "archive": (
            "history.archive:app",
            "Archive finished inspections on a share or in an object store, by rules.",
        ),
        "verify": (
            "inspect.inspection:verify",
            "Check the hashes of an inspection folder: name files that were changed, removed or added.",
        ),
        "report": (
            "inspect.inspection:report",
            "Write the report of a finished inspection into its folder, where it is missing: the program was killed.",
        ),
        "recompute": (
            "inspect.inspection:recompute",
            "Judge inspections again from their raw frames and compare with their records; nothing is written.",
        ),
    },
    "Set up the rig": {
        "rig": (
            "rig.rig:app",
            "Operate and check the rig: ports, motion, live picture, commissioning; simulated devices.",
        ),
        "calibrate": (
            "rig.calibrate:app",
            "Calibrate the rig: white tile, dark frames, linearity, rotation centre, material.",
        ),
        "camera": (
            "statistics.camera:camera",
            "Show the properties of the camera after EMVA 1288, from its linearity calibration.",
        ),
        "recipe": (
            "recipe.recipe:app",
            "Write, check and teach recipes: how a part is photographed and judged.",
        ),
        "golden": (
            "recipe.golden:app",
            "Manage the golden parts of a recipe: parts that are known to be good.",
        ),
    },
    "Predict and design": {
        "predict": (
            "predict.predict:predict",
            "Predict contrasts and radiances, with uncertainty, of a design, a height map or a recipe's part.",
        ),
        "render": (
            "render.render:app",
            "Render pictures of ridged plates and of height maps under the rig's light.",
        ),
        "profile": ("profile.profile:app", "Read, measure, edit, compare, convert and make height maps."),
        "optimise": (
            "study.optimise:optimise",
            "Find the ridge design with the most contrast, nominal or under tolerances.",
        ),
        "design": (
            "design.design:app",
            "Design surfaces: diffractive steps, depths, dots, patterns and masks, and codes made of ridges.",
        ),
        "ink": ("ink.ink:app", "Fit, show, halftone and soft-proof structural-colour inks."),
        "bsdf": (
            "bsdf.bsdf:app",
            "Exchange reflectance with renderers and instruments: export, import, show.",
        ),
        "fit": ("fit.fit:app", "Fit the parameters of the reflectance models to measured values."),
    },
    "Research": {
        "research": (
            "study.study:app",
            "Repeat published results, and simulate how defects change contrasts and verdicts.",
        ),
    },
    "This computer": {
        "doctor": (
            "setup.doctor:doctor",
            (
                "List what is installed, compiled, reachable and calibrated on this machine; nothing moves, no "
                "device is opened."
            ),
        ),
        "qualify": (
            "setup.qualify:qualify",
            "Write evidence that this installation is as released (IQ) and computes what it should (OQ).",
        ),
        "warm": (
            "cache.warm:warm",
            "Compile the kernels of all models for this machine, once; later commands then start without this delay.",
        ),
        "cache": ("cache.cache:app", "Show or clear the cache of results that can be computed again."),
        "key": (
            "setup.key:app",
            "Make, show, trust, retire and revoke the keys that sign records.",
        ),
        "user": ("console.users:app", "Accounts of the console: add, change, remove, list."),
        "completion": (
            "setup.completion:completion",
            "Print or install the script by which bash, zsh, fish or PowerShell complete commands and options.",
        ),
    },
}
"""Commands by the user who needs them, in the order of the help: name, the attribute that runs it, and the first
sentence of its help, for the page of `anisoscope --help` shows it without the import of the command."""


EVERYDAY = {
    "Begin": ("demo", "init"),
    "Rig operator": ("rig", "calibrate", "inspect", "batch", "resume", "serve"),
    "Quality engineer": ("recipe", "golden", "show", "history", "spc", "msa"),
    "Surface engineer": ("predict", "profile", "optimise", "design"),
    "Integrator": ("watch", "line"),
}
"""Everyday commands of every user in the order of work, which the first page shows; `ALL_FLAG` shows all."""


def _more_commands() -> list[str]:
    """Names of the other commands, a line for every group."""
    shown = {name for names in EVERYDAY.values() for name in names}
    rest = {title: [name for name in names if name not in shown] for title, names in COMMANDS.items()}
    width = max(map(len, rest))
    return [
        f"More commands, with their sentences: anisoscope {ALL_FLAG}",
        *(f"  {title:<{width}}  {' · '.join(names)}" for title, names in rest.items() if names),
    ]


def _first_page(*, everything: bool) -> App:
    """The page of ``anisoscope --help`` as a program without commands that run: nothing is imported for it."""
    page = App(
        name=app.name[0],
        help=app.help,
        version_flags=app.version_flags,
        help_flags=app.help_flags,
        help_format="plaintext",
        result_action="return_value",
    )
    for flag in (*page.help_flags, *page.version_flags):
        page[flag].group = "Options"
    sentences = {name: sentence for group in COMMANDS.values() for name, (_, sentence) in group.items()}
    for place, (title, names) in enumerate((COMMANDS if everything else EVERYDAY).items()):
        group = Group(title, sort_key=place)
        for number, name in enumerate(names):
            page.command(App(name=name, help=sentences[name], group=group, sort_key=number))
    return page


for _flag in (*app.help_flags, *app.version_flags):
    app[_flag].group = "Options"
for _place, (_title, _commands) in enumerate(COMMANDS.items()):
    _group = Group(_title, sort_key=_place)
    for _number, (_name, (_attribute, _)) in enumerate(_commands.items()):
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
    if arguments[:1] == ["help"]:
        arguments = [*arguments[1:], "--help"]
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
        return _report(usage_text(error, arguments, app), UsageError.exit_code)
    if isinstance(error, AnisoscopeError):
        command = " ".join(app.parse_commands(arguments)[0])
        see = f" (see anisoscope {command} --help)" if type(error) is UsageError else ""
        said = str(error) + file_advice(arguments, str(error), app) + see
        return _report("; ".join([said, *_notes(error)]), error.exit_code)
    if _signalled:
        return _report("; ".join(["interrupted", *_notes(error)]), EXIT_INTERRUPTED)
    from anisoscope.base.crash import as_foreseen

    found = as_foreseen(error, "anisoscope " + " ".join(map(str, arguments)))
    return _report("; ".join([str(found), *_notes(error)]), found.exit_code)


def _call(arguments: list[str]) -> object:
    everything = ALL_FLAG in arguments
    arguments = ["--help" if token == ALL_FLAG else token for token in arguments]
    helps = asks_for_help(app, arguments)
    if helps and not set(arguments) - {*app.help_flags, "--"}:
        _first_page(everything=everything)(app.help_flags[:1])
        print_below(
            FIRST_EXAMPLES, "\n".join([*([] if everything else [*_more_commands(), ""]), GLOBAL_OPTIONS])
        )
        return 0
    if not helps:
        return app(arguments, exit_on_error=False, print_error=False)
    command = command_of(app, arguments)
    shown = examples(command)  # first: it imports the commands of a group, whose sentences are shown then
    short, rest = first_options()
    app.help_formatter = None if everything or command.default_command is None else short
    try:
        app(arguments, exit_on_error=False, print_error=False)
    finally:
        app.help_formatter = None
    words = " ".join(app.parse_commands([token for token in arguments if token not in app.help_flags])[0])
    print_below(shown, f"{rest()}: anisoscope {words} {ALL_FLAG}" if rest() else "")
    return 0


def take_any_letter(*streams: object) -> None:
    """Have streams write "?" for letters that their encoding lacks, such as σ on a Windows pipe, instead of failing."""
    for stream in streams:
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")


def main() -> NoReturn:
    """Entry point of the ``anisoscope`` command."""
    take_any_letter(sys.stdout, sys.stderr)
    for number in INTERRUPTIONS:
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
    for number in INTERRUPTIONS:  # all is done; nobody needs a traceback of the end
        signal.signal(number, signal.SIG_IGN)
    sys.exit(code)
