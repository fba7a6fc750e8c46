"""``anisoscope watch``: inspect folders of frames as they arrive."""

import contextlib
import os
import signal
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from anisoscope.base.progress import Advance
from anisoscope.cli.json_output import print_json_line
from anisoscope.cli.options import INTO, Into, Json, RecipeFile
from anisoscope.cli.progress import progress
from anisoscope.cli.tables import print_lines, print_table
from anisoscope.parameters.inspecting import FramesWatch
from anisoscope.rig.acquisition.interruptions import INTERRUPTIONS
from anisoscope.views.options import Given, Options, with_options

if TYPE_CHECKING:
    from anisoscope.inspection.batch.watch import Watch
    from anisoscope.inspection.run import Inspected


@with_options(
    how=Options(
        FramesWatch,
        names={"stable_s": "--stable-for"},
        help={"read_code": "Read the code on every part from its first frame; it identifies the part."},
        flags=True,
        whole=True,
    )
)
def watch(
    folder: Annotated[Path, Parameter(help="Folder in which folders of frames (with frames.csv) arrive.")],
    /,
    *,
    recipe: RecipeFile,
    rig: Annotated[Path | None, Parameter(name=["--rig", "-g"])] = None,
    into: Into = INTO,
    how: Given[FramesWatch],
    json_: Json = False,
) -> int:
    """Inspect every folder of frames that another program writes; Ctrl-C stops after the current one.

    Serial number and lot come from part.toml next to the frames, from columns of frames.csv, or with --read-code from
    the code on the part; otherwise the folder's name is the serial number.

    --json prints one line an event.

    Exit codes: 0 stopped by Ctrl-C; with --once that of the worst verdict (3, 1, 2, 0), 74 for damaged folders.

    Args:
        rig: Rig file (TOML); by default rig.toml in the folder of frames.

    Examples:
        anisoscope watch incoming --recipe recipe.toml
        anisoscope watch incoming --recipe recipe.toml --once --json
    """
    from anisoscope.operations.series import watch as watched
    from anisoscope.operations.series import watch_exit_code

    teller, asked = Teller(json_=json_), how.made()
    with _until_signalled() as stop:
        watching = watched(
            folder,
            recipe,
            rig,
            how=asked,
            listener=teller,
            stop=stop,
            out=into.out,
            history=into.history,
        )
    teller.end(watching)
    return watch_exit_code(watching) if asked.once else 0


class Teller:
    """Prints events as lines of text or as JSON."""

    def __init__(self, *, json_: bool) -> None:
        self._json = json_

    def say(self, event: dict[str, Any], text: str) -> None:
        """Print an event as JSON or as text."""
        if self._json:
            print_json_line(event)
        else:
            print_lines(text)
            sys.stdout.flush()

    def begun(self, root: Path) -> None:
        """Which folder is watched."""
        self.say({"event": "watching", "folder": str(root)}, f"watching {root}; Ctrl-C ends")

    def inspected(self, name: str, inspected: "Inspected") -> None:
        """The verdict in a line."""
        record = inspected.record
        why = f": {record.reasons[0]}" if record.reasons and record.verdict != "PASS" else ""
        self.say(
            {
                "event": "inspected",
                "folder": name,
                "serial": record.serial,
                "verdict": record.verdict,
                "reasons": list(record.reasons),
                "inspection": str(inspected.folder),
            },
            f"{name}: {record.verdict}{why}",
        )

    def note(self, text: str) -> None:
        """What a report lacks, or why there is none."""
        self.say({"event": "note", "text": text}, f"note: {text}")

    def same(self, name: str, other: str) -> None:
        """The same frames again."""
        self.say(
            {"event": "same", "folder": name, "as": other}, f"{name}: the same frames as {other}; passed over"
        )

    def bad(self, name: str, reason: str) -> None:
        """Why a folder cannot be inspected."""
        self.say({"event": "bad", "folder": name, "reason": reason}, f"{name}: not inspected: {reason}")

    @contextlib.contextmanager
    def progress(self, name: str) -> Iterator[Advance]:
        """A bar for the folder at work."""
        with progress(name, quiet=self._json) as advance:
            yield advance

    def end(self, watching: "Watch") -> None:
        """What was done, and what is left."""
        bad = {name: one.reason for name, one in sorted(watching.bad.items())}
        counts = {word: watching.verdicts.count(word) for word in dict.fromkeys(watching.verdicts)}
        if bad and not self._json:
            print_table("Not inspected", ["folder", "why"], [[name, why] for name, why in bad.items()])
        summary = ", ".join(f"{count} {word}" for word, count in counts.items()) or "nothing new"
        left = f"; still arriving: {', '.join(sorted(watching.arriving))}" if watching.arriving else ""
        self.say(
            {"event": "end", "counts": counts, "bad": bad, "arriving": sorted(watching.arriving)},
            f"{summary}{left}",
        )


@contextlib.contextmanager
def _until_signalled() -> Iterator[threading.Event]:
    """An event that the first Ctrl-C or SIGTERM sets; a second one interrupts at once."""
    stop = threading.Event()
    before: dict[int, Any] = {}

    def on_signal(number: int, _frame: FrameType | None) -> None:
        if stop.is_set():
            raise KeyboardInterrupt
        stop.set()
        with contextlib.suppress(
            OSError, ValueError
        ):  # not print: the signal may come while something is printed
            os.write(
                sys.stderr.fileno(), b"anisoscope: ending after the folder at work; once more ends at once\n"
            )
        del number

    for number in INTERRUPTIONS:
        if signal.getsignal(number) is not signal.SIG_IGN:
            before[number] = signal.signal(number, on_signal)
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
