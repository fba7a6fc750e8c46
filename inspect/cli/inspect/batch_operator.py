"""The person in front of the terminal, as a batch sees them; and the serial number that a scanner types."""

import contextlib
import sys
from collections.abc import Iterator
from typing import TYPE_CHECKING, Literal

from anisoscope.base.errors import UsageError
from anisoscope.base.language import decimal, message, translated
from anisoscope.base.progress import Advance
from anisoscope.cli.progress import progress
from anisoscope.cli.tables import console

if TYPE_CHECKING:
    from rich.table import Table

    from anisoscope.inspection.batch.journal import BatchFile, SlotResult
    from anisoscope.inspection.batch.operator import Answer
    from anisoscope.inspection.batch.scan import Scan

COLOURS = {
    "PASS": "green",
    "FAIL": "red",
    "INCONCLUSIVE": "yellow",
    "INVALID": "magenta",
    "fault": "bold red",
}


class Terminal:
    """Prompts on standard error and reads standard input; with ``answers`` False it only prints."""

    def __init__(self, *, quiet: bool, answers: bool) -> None:
        self.quiet, self.interactive = quiet, answers

    def say(self, text: str) -> None:
        """Print a line, unless the output is JSON."""
        if not self.quiet:
            console(stderr=True).print(translated(text), markup=False, highlight=False, soft_wrap=True)

    def place(self, slot: "SlotResult", *, again: bool, needs_serial: bool) -> "Answer":
        """Have a part placed: Enter, s, q, or its code."""
        from anisoscope.inspection.batch.operator import Answer
        from anisoscope.inspection.batch.scan import read_scan

        if not self.interactive:
            return Answer()
        what = f"put back {_part(slot)}" if again else f"place {_part(slot)}"
        keys = (
            "scan its code or type its serial number" if needs_serial else "Enter goes on (or scan its code)"
        )
        while True:
            text = _line(f"slot {slot.slot}: {what}; {keys}, s skips, q stops: ")
            if text is None or text.strip() == "q":
                return Answer("stop")
            if text.strip() == "s":
                return Answer("skip")
            if not text.strip() and not needs_serial:
                return Answer()
            try:
                return Answer("go on", read_scan(text))
            except UsageError as error:
                _print_line(str(error))

    def place_all(self, parts: int) -> bool:
        """Have all parts put on the plate: Enter, or q."""
        if not self.interactive:
            return True
        asked = message("place {count} parts on the tray; Enter goes on, q stops", count=parts)
        text = _line(f"{asked}: ")
        return text is not None and text.strip() != "q"

    def serial_of(self, slot: "SlotResult", why: str) -> "Scan | None":
        """Ask for the serial number of a part whose code cannot be read; Enter gives up."""
        from anisoscope.inspection.batch.scan import read_scan

        if not self.interactive:
            return None
        _print_line(f"slot {slot.slot}: {why}")
        while True:
            text = _line("scan its code or type its serial number; Enter makes the part INVALID: ")
            if text is None or not text.strip():
                return None
            try:
                return read_scan(text)
            except UsageError as error:
                _print_line(str(error))

    def trouble(self, slot: "SlotResult", faults: int) -> Literal["again", "go on", "stop"]:
        """Ask what to do after faults in a row."""
        if not self.interactive:
            self.say(f"{faults} faults in a row: stopped; --resume goes on")
            return "stop"
        text = _line(f"{faults} faults in a row: r tries slot {slot.slot} again, Enter goes on, q stops: ")
        return "stop" if text is None or text.strip() == "q" else "again" if text.strip() == "r" else "go on"

    @contextlib.contextmanager
    def progress(self, batch: "BatchFile", number: int) -> Iterator[Advance]:
        """A bar for the part, with what is known of the batch in front."""
        from anisoscope.inspection.batch.operator import seconds_left

        left = seconds_left(batch)
        counts = [f"{count} {word}" for word, count in batch.counts.items() if count and word.isupper()]
        label = [f"{number + 1}/{len(batch.slots)} {_name(batch.slots[number])}", *counts]
        label += [] if left is None else [f"about {_duration(left)} left"]
        with progress(", ".join(label), quiet=self.quiet) as advance:
            yield advance

    def finished(self, batch: "BatchFile", number: int) -> None:
        """One line a slot."""
        slot = batch.slots[number]
        text = message(
            "{number}/{count} slot {slot}, {name}: {verdict}",
            number=number + 1,
            count=len(batch.slots),
            slot=slot.slot,
            name=_name(slot),
            verdict=slot.word,
        )
        self.say(f"{text}: {translated(slot.reason)}" if slot.reason and slot.word != "PASS" else text)


def ask_serial(lot: str | None) -> tuple[str, str | None]:
    """Serial number and lot for ``inspect``, typed or scanned; a lot that is known already stays.

    Raises:
        UsageError: there is no terminal to ask in, nobody answers, the code holds no serial number, or another lot.
    """
    from anisoscope.inspection.batch.scan import read_scan

    if sys.stdin is None or not sys.stdin.isatty():
        raise UsageError("name the part with --serial: there is no terminal in which to ask for it")
    scan = read_scan(_line("serial number (type it, or scan the code): ") or "")
    if scan.serial is None:
        raise UsageError(f"the code {scan.text} holds no serial number (GS1 identifier 21): give --serial")
    if lot is not None and scan.lot not in {None, lot}:
        raise UsageError(f"--lot says {lot}, the code reads lot {scan.lot}: which one is it?")
    return scan.serial, lot or scan.lot


def table_of(batch: "BatchFile") -> "Table":
    """The slots of a batch as a table; no text of the list becomes markup."""
    from rich.table import Table
    from rich.text import Text

    table = Table(title=message("Batch"), title_justify="left")
    for column in (message("slot"), message("serial"), message("verdict"), message("first reason")):
        table.add_column(column, overflow="fold")
    table.add_column(message("duration"), justify="right")
    for slot in batch.slots:
        table.add_row(
            Text(slot.slot),
            Text(_name(slot)),
            Text(translated(slot.word), style=COLOURS.get(slot.word, "")),
            Text(translated(slot.reason or "")),
            Text("" if slot.seconds is None else decimal(f"{slot.seconds:.1f} s")),
        )
    return table


def _part(slot: "SlotResult") -> str:
    parts = [f"part {slot.serial}" if slot.serial else "the part"]
    parts += [f"{what} {text}" for what, text in (("lot", slot.lot), ("cavity", slot.cavity)) if text]
    return ", ".join(parts)


def _name(slot: "SlotResult") -> str:
    return slot.serial or "–"


def _duration(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 90.0 else f"{seconds / 60.0:.0f} min"


def _line(prompt: str) -> str | None:
    """One line of standard input without its end; None where it is closed."""
    print(_prompt(prompt), end="", file=sys.stderr, flush=True)  # noqa: T201
    text = sys.stdin.readline() if sys.stdin is not None else ""
    if not text:
        print(file=sys.stderr)  # noqa: T201
        return None
    return text.rstrip("\r\n")


def _prompt(text: str) -> str:
    """A prompt in the present language; the space behind it is none of the message."""
    return translated(text.rstrip()) + text[len(text.rstrip()) :]


def _print_line(text: str) -> None:
    print(translated(text), file=sys.stderr, flush=True)  # noqa: T201
