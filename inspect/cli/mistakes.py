"""What is said about a command line that does not work: the mistake, and the line that works; and former words."""

import re
import shlex
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from difflib import get_close_matches
from itertools import pairwise
from pathlib import Path

from cyclopts import App, Argument
from cyclopts.exceptions import (
    CoercionError,
    CycloptsError,
    MissingArgumentError,
    UnknownCommandError,
    UnknownOptionError,
    UnusedCliTokensError,
)

from anisoscope.cli.help_page import FIRST_EXAMPLES, GLOBAL_OPTIONS, command_of, examples

_NEGATIVE_VALUE = re.compile(r"-[\d.]")
_NUMBER = re.compile(r"[-+]?[\d.,]+")
MOST_MENDED = 6
"""Mistakes of one line that are mended before its command's example is shown instead."""
SYNONYMS = {
    "--sn": "--serial",
    "--serial-number": "--serial",
    "--output": "--out",
    "--seed-number": "--seed",
    "--angle": "--ridge-angle",
    "--images": "--frames",
    "--resolution": "--pixel",
    "--spacing": "--pitch",
    "--config": "--recipe",
    "version": "--version",
    "optimize": "optimise",
}
"""Words that people try -> words of commands and options."""
LOOKS = ("info", "show", "status", "check")
"""Commands of groups that look at a file without changing anything, the first of which a group has."""
MAPS = {".x3p", ".sur", ".gwy", ".npz", ".sdf", ".gsf", ".stl", ".plux", ".al3d", ".csv", ".txt"}
PHOTOGRAPHS = {".tif", ".tiff", ".png", ".jpg", ".jpeg", ".bmp"}
RECORDS = ("record.json", "job.json")
"""Files by which a folder is one of an inspection."""


def usage_text(error: CycloptsError, arguments: Sequence[str], app: App) -> str:
    """One line for a command line that cannot be understood: the mistake, a line that works, and where to read on.

    Args:
        error: from the parser.
        arguments: the command line, without the program.
        app: the program.
    """
    chain = " ".join(error.command_chain or ())
    see = f" (see {' '.join(filter(None, ('anisoscope', chain, '--help')))})"
    said, line = _mistake(error, arguments), _line_that_works(error, arguments, app)
    return (said.partition(". Did you mean")[0].partition("; there are: ")[0] + line if line else said) + see


def _mistake(error: CycloptsError, arguments: Sequence[str]) -> str:
    """The mistake, in the words of the command's user."""
    known = _arguments(error)
    dashes = [token for token in arguments if _is_long(token, known)]
    if dashes:
        return f"Unknown option: {dashes[0]}"
    words: dict[type[CycloptsError], Callable[..., str]] = {
        MissingArgumentError: _missing,
        UnusedCliTokensError: _unused,
        UnknownOptionError: _unknown_option,
        UnknownCommandError: _unknown_command,
        CoercionError: _no_number,
    }
    say = next((one for kind, one in words.items() if isinstance(error, kind)), None)
    return (say(error, arguments) if say else str(error)).removesuffix(".")


def _arguments(error: CycloptsError) -> Sequence[Argument]:
    """Options and arguments of the command that could not be called; none of a group."""
    return () if error.app is None else _arguments_of(error.app)


_KNOWN: dict[int, tuple[App, Sequence[Argument]]] = {}


def _arguments_of(command: App) -> Sequence[Argument]:
    if id(command) not in _KNOWN:
        runs = command.default_command is not None
        _KNOWN[id(command)] = (
            command,
            command.assemble_argument_collection() if runs else (),
        )
    return _KNOWN[id(command)][1]


def _is_long(token: str, known: Iterable[Argument]) -> bool:
    """Whether a word is an option of several letters with a single dash."""
    names = {name for argument in known for name in argument.names}
    return len(token) > 2 and f"-{token}".partition("=")[0] in names and token not in names


def _unused(error: UnusedCliTokensError, _: Sequence[str]) -> str:
    unused = error.unused_tokens or []
    if all(len(token.strip("-")) <= 2 and _NEGATIVE_VALUE.match(token) for token in unused):
        return (
            f"{' '.join(unused)} is left over: a value that begins with a minus needs '=', as in --tilts=-10"
        )
    names = {name for argument in _arguments(error) for name in argument.names}
    by_options = None not in [_option_of(Path(token), names) for token in unused]
    return "files are named by options" if by_options else f"too many arguments: {' '.join(unused)}"


def _unknown_option(error: UnknownOptionError, arguments: Sequence[str]) -> str:
    word = _word(error)
    if _stands_after_the_end(error, arguments):
        return (
            f"{word} stands after '--', which ends the options: write the options before it, or leave it out"
        )
    near = _near_option(word, error.argument_collection or ())
    return f"Unknown option: {word}" + (f". Did you mean {near}?" if near else "")


def _no_number(error: CoercionError, _: Sequence[str]) -> str:
    wanted = {int: "a whole number", float: "a number"}
    if error.token is None or error.target_type not in wanted:
        return str(error)
    name = error.token.keyword or (error.argument.name.upper() if error.argument else "this")
    return f"{name} takes {wanted[error.target_type]}, not {error.token.value!r}"


def _missing(error: MissingArgumentError, arguments: Sequence[str]) -> str:
    """What an option that has no value lacks: the option itself, its value, or the ``=`` before a minus."""
    if error.argument is None:
        return str(error)
    given = _place_of(error, arguments)
    if given is None:
        name = error.argument.name
        return f"{name if name.startswith('-') else name.upper()} is missing"
    following = arguments[given + 1] if given + 1 < len(arguments) else ""
    if _NEGATIVE_VALUE.match(following):
        return "a value that begins with a minus needs '='"
    if following and not following.startswith("-"):  # some of several values
        count = sum(1 for _ in _values(arguments, given))
        return f"{arguments[given]} needs {error.argument.token_count()[0]} values, not {count}"
    return f"{arguments[given]} needs a value" + (f", and {following} is an option" if following else "")


def _unknown_command(error: UnknownCommandError, arguments: Sequence[str]) -> str:
    chain = " ".join(error.command_chain or ())
    word = arguments[len(error.command_chain or ())]
    if word.startswith("-") and not chain:
        near = get_close_matches(word, _global_flags(), n=1)
        return f"Unknown option: {word}" + (f". Did you mean {near[0]}?" if near else "")
    known, _, listed = str(error).partition(" Available commands: ")
    known = known.removesuffix(".")
    if chain:
        known = known.replace("Unknown command", f"Unknown command of {chain}:", 1)
    return known if "Did you mean" in known or not chain else f"{known}; there are: {listed}"


def _global_flags() -> list[str]:
    return [*re.findall(r"--[\w-]+", GLOBAL_OPTIONS), "--version", "--help"]


def _word(error: UnknownOptionError) -> str:
    return (error.token.keyword or error.token.value).partition("=")[0]


def _near_option(word: str, known: Iterable[Argument]) -> str | None:
    names = [name for argument in known for name in argument.names if name.startswith("--")]
    long = "--" + word.lstrip("-")
    if SYNONYMS.get(long, long) in names:
        return SYNONYMS.get(long, long)
    return next(iter(get_close_matches(long, names, n=1, cutoff=0.7)), None)


def _stands_after_the_end(error: UnknownOptionError, arguments: Sequence[str]) -> bool:
    """Whether the parser does not know an option because it stands after ``--``."""
    word = error.token.keyword or error.token.value
    known = error.argument_collection or ()
    if "--" not in arguments or word not in arguments[list(arguments).index("--") :]:
        return False
    return any(word.partition("=")[0] in argument.names for argument in known)


def _line_that_works(error: CycloptsError, arguments: Sequence[str], app: App) -> str | None:
    """The line as it was meant, else an example of its command; None where neither is known."""
    line, found = list(arguments), error
    for _ in range(MOST_MENDED):
        mended = _mended(found, line, app)
        if mended is None:
            break
        line = mended
        if line[-1:] == ["--version"] or line[:1] == ["--help"]:
            return _shown(line)
        try:
            app.parse_args(line, exit_on_error=False, print_error=False)
        except CycloptsError as further:
            found = further
        else:
            return _shown(line)
    of_place = isinstance(error, CoercionError) and error.argument and error.argument.index is not None
    if isinstance(error, MissingArgumentError | UnusedCliTokensError) or of_place:
        return _example(error.app)
    return _example(error.app) if isinstance(error, UnknownCommandError) and error.command_chain else None


def _example(command: App | None) -> str | None:
    shown = examples(command) if command else []
    return f"; for example: {shown[0]}" if shown else None


def _shown(line: Sequence[str]) -> str:
    return f"; write: anisoscope {shlex.join(line)}"


def _mended(error: CycloptsError, line: list[str], app: App) -> list[str] | None:
    """The line without this mistake; None where it is not clear what was meant."""
    known = _arguments(error)
    if any(_is_long(token, known) for token in line):
        return [f"-{token}" if _is_long(token, known) else token for token in line]
    found: list[str] | None = None
    if isinstance(error, UnknownOptionError):
        word, near = _word(error), _near_option(_word(error), error.argument_collection or ())
        if near is not None and not _stands_after_the_end(error, line):
            found = [near + one.removeprefix(word) if one.partition("=")[0] == word else one for one in line]
    elif isinstance(error, UnknownCommandError):
        found = _with_a_command(error, line, app)
    elif isinstance(error, UnusedCliTokensError):
        found = _with_options(error, line)
    elif isinstance(error, MissingArgumentError) and error.argument is not None:
        found = _completed(error, line)
    return found


def _with_a_command(error: UnknownCommandError, line: list[str], app: App) -> list[str] | None:
    """The line with a command of the group: nearly the same, one behind, one of another group, or one for a file."""
    chain = list(error.command_chain or ())
    word, behind = line[len(chain)], line[len(chain) + 1 :]
    group = command_of(app, chain) if chain else app
    names = [name for name in group if not name.startswith("-")]
    if not chain and word.startswith("-"):
        near = get_close_matches(word, ["--version", "--help"], n=1)
        return near or None
    near = [SYNONYMS[word]] if word in SYNONYMS else get_close_matches(word, names, n=1, cutoff=0.6)
    if near:
        return [*chain, *near, *behind]
    later = next((token for token in behind if token in names), None)
    if chain and later is not None:
        behind.remove(later)
        return [*chain, later, word, *behind]
    look = next((name for name in LOOKS if name in names), None)
    if chain and look is not None and Path(word).exists():
        return [*chain, look, word, *behind]
    if chain:
        return None
    found = [one for one in names if word in app[one] and app[one].default_command is None]
    return [found[0], *line] if found else None


FILE_OPTIONS = (
    (".toml", ("stage", "camera"), ("--rig",)),
    (".toml", ("product",), ("--recipe",)),
    (".csv", (), ("--csv", "--readings", "--csv-file")),
    (".dfq", (), ("--csv", "--aqdef")),
    (".json", (), ("--json-file",)),
    (".sqlite", (), ("--history",)),
    (".html", (), ("--html", "--out")),
)
"""Ending of a file, keys of which it has one, and the options that take such a file, of which a command has one."""


def _with_options(error: UnusedCliTokensError, line: list[str]) -> list[str] | None:
    """The line with an option before every file, with the choice that a word names, or with numbers by commas."""
    unused = list(error.unused_tokens or ())
    known = _arguments(error)
    names = {name for argument in known for name in argument.names}
    for place, token in enumerate(line):
        numbers = list(_values(line, place)) if token.startswith("--") else []
        if len(numbers) > 1 and all(map(_NUMBER.fullmatch, numbers)):
            return [*line[:place], f"{token}={','.join(numbers)}", *line[place + 1 + len(numbers) :]]
    before = line[: len(line) - len(unused)] if line[-len(unused) :] == unused else None
    if before is None:
        return None
    pairs: list[str] = []
    for token in unused:
        choice = next((one.name for one in known if token in (one.get_choices() or ())), None)
        option = _option_of(Path(token), names) or choice
        if option is None and "--serial" in names and not Path(token).exists() and pairs:
            option = "--serial"
        if option is None or option in pairs:
            return before if token in {"list", "all"} else None
        pairs += [option, token]
    return [*before, *pairs]


def _option_of(path: Path, names: Collection[str]) -> str | None:
    if path.is_dir():  # of frames or of inspections
        return next((option for option in ("--frames", "--history") if option in names), None)
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


def _place_of(error: MissingArgumentError, line: Sequence[str]) -> int | None:
    assert error.argument is not None
    names = error.argument.names
    return next((k for k, token in enumerate(line) if token in names), None)


def _values(line: Sequence[str], place: int) -> Iterator[str]:
    for token in line[place + 1 :]:
        if token.startswith("-"):
            return
        yield token


def _completed(error: MissingArgumentError, line: list[str]) -> list[str] | None:
    """The line with what is missing: a file that it names already, else the value of the command's example."""
    assert error.argument is not None
    name, place = error.argument.name, _place_of(error, line)
    names = {one for argument in _arguments(error) for one in argument.names}
    if place is not None and place + 1 < len(line) and _NEGATIVE_VALUE.match(line[place + 1]):
        return [*line[:place], f"{line[place]}={line[place + 1]}", *line[place + 2 :]]
    for before, token in pairwise(line):
        if place is None and not before.startswith("--") and name == _option_of(Path(token), names):
            k = line.index(token)
            return [*line[:k], name, *line[k:]]
    own = examples(error.app) if error.app is not None else []
    shown = [shlex.split(one) for one in (*own, *FIRST_EXAMPLES)]
    for words in (shlex.split(one)[1:] for one in own):
        if name in words and words[: len(line)] == line and not any(one.startswith("-") for one in line):
            return words
    values = [list(_values(one, one.index(name))) for one in shown if name in one]
    if not values or not values[0] or not name.startswith("-"):
        return None
    value = values[0][: max(error.argument.token_count()[0], 1)]
    return [*line, name, *value] if place is None else [*line[: place + 1], *value, *line[place + 1 :]]


def file_advice(arguments: Sequence[str], message: str, app: App) -> str:
    """What was most likely meant where a command cannot use a file that its line names: "" or a line that works.

    Args:
        arguments: the command line, without the program.
        message: of the command, which names the file.
        app: the program.
    """
    chain, _, _ = app.parse_commands(list(arguments))
    if "are the two swapped" in message and {"--recipe", "--rig"} <= set(arguments):
        other = {"--recipe": "--rig", "--rig": "--recipe"}
        return _shown([other.get(token, token) for token in arguments])
    names = {name for one in _arguments_of(command_of(app, list(chain))) for name in one.names}
    for place, token in enumerate(arguments):
        option, _, word = token.rpartition("=") if token.startswith("--") else ("", "", token)
        if place < len(chain) or not word or word.startswith("-") or word not in message or "\0" in word:
            continue

        def line(*new: str, place: int = place, option: str = option) -> str:
            words = [f"{option}={new[0]}"] if option else list(new)
            return _shown([*arguments[:place], *words, *arguments[place + 1 :]])

        follows_option = place > 0 and arguments[place - 1].startswith("--")
        advice = _advice(
            Path(word), list(chain), names, message, line, bare=not option and not follows_option
        )
        if advice:
            return advice
    asks = message.startswith(("name ", "--recipe is missing")) or "unknown extension '.toml'" in message
    return (_example(command_of(app, list(chain))) or "") if asks else ""


def _advice(
    path: Path,
    chain: list[str],
    names: Collection[str],
    message: str,
    line: Callable[..., str],
    *,
    bare: bool,
) -> str:
    """Advice on one file; `line` writes the command line with other words in its place."""
    suffix, other, advice = path.suffix.lower(), None, ""
    if not path.exists():
        number = bare and _NUMBER.fullmatch(str(path)) and "--ridge-angle" in names
        return line("--ridge-angle", str(path)) if number else _near_file(path, line)
    if path.is_file() and any((path.parent / record).is_file() for record in RECORDS):
        other = path.parent
    elif path.is_dir() and any(word in message for word in (*RECORDS, "no inspection")):
        inside = sorted([*path.glob("*/job.json"), *path.glob("*/*/job.json")])
        other = inside[-1].parent if inside else None
    elif path.is_dir() and "directory" in message:
        other = _file_in(path, recipe=chain[:1] == ["recipe"])
        advice = "; a recipe is a file *.toml" if chain[:1] == ["recipe"] else ""
    elif "is needed here" in message:
        keys = {"product"} if "a recipe is needed" in message else {"stage"}
        other = next((one for one in sorted(path.parent.glob("*.toml")) if keys_of(one) & keys), None)
    elif path.is_file() and "frames.csv" in message:
        other = path.parent
    elif chain == ["compare"] and suffix in MAPS:
        advice = "; maps are compared by: anisoscope profile compare FIRST SECOND"
    elif bare and suffix in PHOTOGRAPHS and ("pixel size" in message or "a picture has none" in message):
        advice = "; photographs have no heights: anisoscope inspect --frames FOLDER --recipe recipe.toml judges them"
    elif bare and (option := _option_of(path, names)) is not None:
        advice = line(option, str(path))
    return line(str(other)) if other is not None else advice


def _file_in(folder: Path, *, recipe: bool) -> Path | None:
    """The first recipe or height map of a folder; one of an inspection has no maps."""
    if recipe:
        return next((one for one in sorted(folder.glob("*.toml")) if keys_of(one) & {"product"}), None)
    if any((folder / record).is_file() for record in RECORDS):
        return None
    return next((one for one in sorted(folder.iterdir()) if one.suffix.lower() in MAPS), None)


def _near_file(path: Path, line: Callable[..., str]) -> str:
    """A line with a file of the same folder that has nearly this name, else the names of files of its kind."""
    try:
        there = sorted(one.name for one in path.parent.iterdir())
    except OSError:
        return ""
    same = [one for one in there if one.lower() == path.name.lower() or Path(one).stem == path.name]
    near = same or get_close_matches(path.name, there, n=1, cutoff=0.75)
    if near:
        return line(str(path.with_name(near[0])))
    like = [one for one in there if path.suffix and Path(one).suffix == path.suffix]
    return f"; there are {', '.join(like[:4])}" if like else ""


FORMER_COMMANDS = {
    ("code",): ("read-code",),
    ("experiment", "ridges"): ("research", "experiment"),
    ("experiment", "findings"): ("research", "findings"),
    ("experiment",): ("research",),
    ("study",): ("research",),
    ("archive", "ls"): ("archive", "list"),
    ("bsdf", "fit"): ("fit", "brdf"),
    ("render", "beside"): ("render", "comparison"),
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
