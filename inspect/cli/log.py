"""What commands write besides their answer: options of every command, messages on stderr, the log file."""

import logging
import os
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

from anisoscope.base.csv_style import COMMA, STYLES, writing
from anisoscope.base.errors import UsageError
from anisoscope.base.language import LANGUAGES, of_locale, per_cent, speaking, translated, use

LOG = logging.getLogger("anisoscope")


@dataclass(frozen=True)
class LogOptions:
    """Options that every command takes, wherever they stand in the command line."""

    verbose: bool = False
    quiet: bool = False
    debug: bool = False
    file: Path | None = None
    lang: str | None = None
    csv_style: str | None = None
    arguments: tuple[str, ...] = ()


_present = LogOptions()


def verbose() -> bool:
    """Whether the present command prints the tables behind its answer."""
    return _present.verbose


def quiet() -> bool:
    """Whether the present command prints no progress: by --quiet, or by the environment variable ANISOSCOPE_QUIET."""
    return _present.quiet or bool(os.environ.get("ANISOSCOPE_QUIET"))


def options_of(arguments: Sequence[str]) -> tuple[list[str], LogOptions]:
    """Split a command line into what the command gets, and the options of every command.

    Args:
        arguments: the command line, without the program; what follows ``--`` is left as it is.

    Raises:
        UsageError: --log-file without a file, or --lang or --csv-style without one of ours.
    """
    end = list(arguments).index("--") if "--" in arguments else len(arguments)
    rest: list[str] = []
    found = LogOptions(arguments=tuple(arguments))
    waiting = ""
    for token in arguments[:end]:
        if waiting or token.partition("=")[0] in VALUED:
            name, equals, value = (waiting, "=", token) if waiting else token.partition("=")
            waiting = "" if equals else name
            found = _valued(found, name, value) if equals else found
        elif token in {"-v", "--verbose"}:
            found = replace(found, verbose=True)
        elif token in {"-q", "--quiet"}:
            found = replace(found, quiet=True)
        elif token == "--debug":
            found = replace(found, debug=True)
        else:
            rest.append(token)
    if waiting:
        raise UsageError(f"{waiting} needs {VALUED[waiting]} (see anisoscope --help)")
    return [*rest, *arguments[end:]], found


VALUED = {
    "--log-file": "the name of a file",
    "--lang": f"a language: {', '.join(LANGUAGES)}",
    "--csv-style": f"a style: {' or '.join(STYLES)}",
}
"""Options of every command that take a value, and what they take."""


def _valued(found: LogOptions, name: str, value: str) -> LogOptions:
    if name == "--log-file":
        return replace(found, file=Path(value))
    if name == "--csv-style":
        if value not in STYLES:
            raise UsageError(f"--csv-style {value}: there is no such style; name {' or '.join(STYLES)}")
        return replace(found, csv_style=value)
    if value not in LANGUAGES:
        raise UsageError(f"--lang {value}: there is no such language; name one of {', '.join(LANGUAGES)}")
    return replace(found, lang=value)


def chosen_csv_style() -> str | None:
    """The style of CSV files that the command line names, or None."""
    return _present.csv_style


def chosen_language() -> str | None:
    """The language that the command line or the project file names, or None."""
    return _present.lang


def choose_language(name: str) -> None:
    """Use the language of the project file; errors as of `anisoscope.base.language.use`."""
    global _present  # noqa: PLW0603 - as of `listening`
    use(name)
    _present = replace(_present, lang=name)


@contextmanager
def listening(options: LogOptions) -> Iterator[None]:
    """Send log messages where the options of every command want them, for the duration of one command.

    Compilation of kernels and long motions go to stderr always; with --verbose device messages too, with --debug all.

    Raises:
        UsageError: the log file cannot be written.
    """
    global _present  # noqa: PLW0603 - one command a process
    _present = options
    always = [logging.getLogger(f"anisoscope.{name}") for name in ("compiled", "waiting")]
    for log in (LOG, *always):
        log.handlers.clear()
    everything = options.debug or options.verbose
    handler = logging.StreamHandler()
    handler.setFormatter(logging.Formatter("anisoscope: %(message)s"))
    handler.setLevel(logging.DEBUG if options.debug else logging.INFO if options.verbose else logging.WARNING)
    handler.addFilter(lambda record: record.name != PROGRESS.name)
    for log in [LOG] if everything else always:
        log.addHandler(handler)
    if not everything:
        LOG.addHandler(logging.NullHandler())
    LOG.setLevel(
        logging.DEBUG if options.debug or options.file else logging.INFO if everything else logging.NOTSET
    )
    file = None if options.file is None else _log_file(options.file)
    if file is not None:
        LOG.addHandler(file)
        LOG.info("anisoscope %s", " ".join(options.arguments))
    began = time.monotonic()
    try:
        with speaking(options.lang or of_locale()), writing(options.csv_style or COMMA):
            yield
    finally:
        if file is not None:
            LOG.info("ended after %.1f s", time.monotonic() - began)
            LOG.removeHandler(file)
            file.close()
        _present = LogOptions()


PROGRESS = logging.getLogger("anisoscope.progress")


def _log_file(path: Path) -> logging.Handler:
    try:
        found = logging.FileHandler(path, encoding="utf-8")
    except OSError as error:
        raise UsageError(
            f"--log-file {path}: cannot be written ({error.strerror}); name another file"
        ) from None
    found.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(message)s"))
    return found


def report(message: str) -> None:
    """Print one line on stderr and write it into the log file.

    Args:
        message: any text; line breaks become spaces.
    """
    text = " ".join(message.split())
    print(f"anisoscope: {per_cent(translated(text))}", file=sys.stderr)  # noqa: T201
    for handler in LOG.handlers:
        if isinstance(handler, logging.FileHandler):
            handler.handle(LOG.makeRecord(LOG.name, logging.ERROR, "", 0, text, (), None))
