"""The folder of an inspection: its name, who works in it, and what is left when nothing came of it."""

import contextlib
import unicodedata
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path

from anisoscope.base.errors import RecordError
from anisoscope.base.lock import locked
from anisoscope.record.schema import RECORD_NAME
from anisoscope.rig.acquisition.interruptions import undisturbed
from anisoscope.rig.acquisition.journal import JOURNAL, read_journal
from anisoscope.rig.acquisition.writer import FRAMES

JOB = "job.json"
SCAN = "scan.json"  # of a reflectance scan, which is no inspection
INPUTS = "inputs"
LONGEST_NAME = 160
# Names of devices, which Windows takes for them with any ending.
_DEVICES = {
    "CON",
    "PRN",
    "AUX",
    "NUL",
    *(f"{kind}{number}" for kind in ("COM", "LPT") for number in range(1, 10)),
}


def make_folder(out: Path, serial: str) -> Path:
    """A new folder ``<serial>-<UTC time>`` below ``out``; signs of the serial number that paths cannot hold become _.

    Raises:
        RecordError: it cannot be made.
    """
    stamp = datetime.now(UTC).strftime("%Y%m%dT%H%M%SZ")
    base = f"{file_name_of(serial)}-{stamp}"
    try:
        out.mkdir(parents=True, exist_ok=True)
        for number in range(1000):
            folder = out / (base if number == 0 else f"{base}-{number}")
            try:
                folder.mkdir()
            except FileExistsError:
                continue
            return folder.resolve()
    except OSError as error:
        raise RecordError(f"cannot make an inspection folder in {out}: {error.strerror}") from error
    raise RecordError(f"{out} already holds a thousand inspections named {base}")


def file_name_of(serial: str) -> str:
    """The serial number in letters that every file system and shell takes, at most 160 bytes of UTF-8."""
    plain = unicodedata.normalize("NFC", serial).replace("#", "")
    safe = "".join(one if one.isalnum() or one in "._+-" else "_" for one in plain)
    if safe.partition(".")[0].upper() in _DEVICES:
        safe = f"_{safe}"
    return safe.encode()[:LONGEST_NAME].decode(errors="ignore")


@contextlib.contextmanager
def new_folder(out: Path, serial: str) -> Iterator[Path]:
    """Work in a new folder; an error removes it if it holds no frame, or else gets a note how to resume.

    Raises:
        RecordError: it cannot be made.
    """
    with contextlib.ExitStack() as stack:
        folder: Path | None = None
        try:
            with undisturbed():  # an interruption must find somebody who knows of the folder
                folder = make_folder(out, serial)
            stack.enter_context(working_in(folder))
            yield folder
        except BaseException as error:
            if folder is not None and not _has_frames(folder):
                _remove(folder)
            elif folder is not None:
                add_resume_hint(folder, error)
            raise


def add_resume_hint(folder: Path, error: BaseException) -> None:
    """Add a note to an error how to resume the inspection, unless it is finished."""
    if not (folder / RECORD_NAME).exists():
        error.add_note(f"`anisoscope resume {folder}` goes on from here")


@contextlib.contextmanager
def working_in(folder: Path) -> Iterator[None]:
    """Lock an inspection folder for exclusive work. The lock dies with its process.

    Raises:
        RecordError: somebody else works in it, or there is no such folder.
    """
    with contextlib.ExitStack() as stack:
        try:
            stack.enter_context(locked(folder))
        except BlockingIOError:
            raise RecordError(f"{folder}: another process is at work on this inspection") from None
        except OSError as error:
            raise RecordError(f"{folder}: cannot be opened: {error.strerror}") from error
        yield


def _has_frames(folder: Path) -> bool:
    try:
        return bool(read_journal(folder).frames)
    except RecordError:
        return True


def _remove(folder: Path) -> None:
    """Remove the files of an inspection without frames, and nothing else."""
    ours = [
        folder / JOB,
        folder / JOURNAL,
        *(folder / INPUTS).glob("*"),
        *(folder / FRAMES).glob(".*.partial"),
    ]
    for path in ours:
        with contextlib.suppress(OSError):
            path.unlink(missing_ok=True)
    for path in (folder / INPUTS, folder / FRAMES, folder):
        with contextlib.suppress(OSError):
            path.rmdir()


def sweep(folder: Path) -> None:
    """Remove what a killed program left half done: pictures that are not in the journal, partial files."""
    named = {line.name for line in read_journal(folder).frames}
    left = [
        path for path in (folder / FRAMES).glob("[0-9][0-9][0-9]*_*.tif") if _name(path, folder) not in named
    ]
    left += [*(folder / FRAMES).glob(".frame-*"), *folder.glob(".*.partial"), *folder.glob("*/.*.partial")]
    for path in left:
        with contextlib.suppress(OSError):
            path.unlink()


def files_in(folder: Path) -> set[str]:
    """Names of all files in a folder and below, relative to it, with forward slashes.

    Raises:
        RecordError: there is no such folder.
    """
    if not folder.is_dir():
        raise RecordError(f"{folder}: there is no such folder")
    return {_name(path, folder) for path in folder.rglob("*") if not path.is_dir() or path.is_symlink()}


def _name(path: Path, folder: Path) -> str:
    return path.relative_to(folder).as_posix()
