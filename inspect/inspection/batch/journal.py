"""``batch.json``: state of every slot of a tray, written before and after each part."""

import json
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from anisoscope.base.atomic_write import write_text
from anisoscope.base.errors import RecordError, UsageError
from anisoscope.base.regular_file import bounded_bytes
from anisoscope.inspection.batch.tray import Slot, Tray
from anisoscope.record.schema import sha256_of
from anisoscope.record.verdict import Verdict

BATCH_NAME = "batch.json"
State = Literal["waiting", "at work", "done", "skipped", "fault"]
VERDICTS = ("INVALID", "FAIL", "INCONCLUSIVE", "PASS")
"""The worst first; the order that decides the exit code."""
HARDWARE, NOT_ALL = 64, 75


class _Part(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class SlotResult(_Part):
    """State of a slot.

    Attributes:
        slot, serial, lot, cavity: as the list says; a serial number that it leaves open is filled in.
        state: "fault" is a part that could not be inspected; ``--resume`` tries it again.
        verdict: of a part that is done.
        reason: the first one of the verdict, or what the fault was.
        code: what the code on the part says, where one was read.
        folder: the inspection folder, relative to that of the batch, with forward slashes.
        seconds: how long the inspection took.
        exit_code: of a fault.
        finished_at: UTC time.
    """

    slot: str
    serial: str | None = None
    lot: str | None = None
    cavity: str | None = None
    state: State = "waiting"
    verdict: str | None = None
    reason: str | None = None
    code: str | None = None
    folder: str | None = None
    seconds: float | None = None
    exit_code: int | None = None
    finished_at: str | None = None

    @property
    def word(self) -> str:
        """State in one word: the verdict, or the state."""
        return self.verdict if self.state == "done" and self.verdict else self.state


class BatchFile(_Part):
    """``batch.json``."""

    schema_version: Annotated[Literal[1], Field(alias="schema")] = 1
    software: str
    created_at: str
    tray: str
    tray_sha256: str
    recipe: str
    recipe_sha256: str
    rig: str
    operator: str | None = None
    station: str | None = None
    slots: tuple[SlotResult, ...]

    @property
    def counts(self) -> dict[str, int]:
        """Number of parts by verdict, worst first; then by state: skipped, fault, waiting."""
        found = {word: sum(one.verdict == word for one in self.slots) for word in VERDICTS}
        for state in ("skipped", "fault", "at work", "waiting"):
            if number := sum(one.state == state for one in self.slots):
                found[state] = number
        return found

    @property
    def exit_code(self) -> int:
        """Exit code of the first hardware fault; else of the worst verdict; 75 where only slots were left out."""
        faults = [one.exit_code or 0 for one in self.slots if one.state == "fault"]
        hardware = next((code for code in faults if code >= HARDWARE), None)
        if hardware is not None:
            return hardware
        verdicts = {one.verdict for one in self.slots} | ({"INVALID"} if faults else set())
        worst = next((word for word in VERDICTS if word in verdicts), "PASS")
        all_done = all(one.state == "done" for one in self.slots)
        return Verdict(worst).exit_code or (0 if all_done else NOT_ALL)

    def with_slot(self, number: int, **changes: object) -> "BatchFile":
        """The same with changes to one slot."""
        changed = self.slots[number].model_copy(update=changes)
        return self.model_copy(update={"slots": (*self.slots[:number], changed, *self.slots[number + 1 :])})


def new_batch(tray: Tray, recipe: Path, rig: Path, operator: str | None, station: str | None) -> BatchFile:
    """Batch before its first part."""
    return BatchFile(
        software=f"anisoscope {version('anisoscope')}",
        created_at=now(),
        tray=str(tray.path.resolve()),
        tray_sha256=tray.sha256,
        recipe=str(recipe.resolve()),
        recipe_sha256=sha256_of(recipe),
        rig=str(rig.resolve()),
        operator=operator,
        station=station,
        slots=tuple(_waiting(slot) for slot in tray.slots),
    )


def _waiting(slot: Slot) -> SlotResult:
    return SlotResult(slot=slot.label, serial=slot.serial, lot=slot.lot, cavity=slot.cavity)


def now() -> str:
    """UTC time to the second."""
    return datetime.now(UTC).isoformat(timespec="seconds")


def write_batch(batch: BatchFile, folder: Path) -> None:
    """Write ``batch.json``, atomically.

    Raises:
        RecordError: the folder cannot be written.
    """
    content = batch.model_dump(mode="json", by_alias=True)
    write_text(folder / BATCH_NAME, json.dumps(content, indent=2, allow_nan=False) + "\n")


def read_batch(folder: Path) -> BatchFile:
    """Read ``batch.json``.

    Raises:
        RecordError: there is none, or it is damaged.
    """
    path = folder / BATCH_NAME
    try:
        return BatchFile.model_validate_json(bounded_bytes(path))
    except OSError as error:
        raise RecordError(f"cannot read {path}: {error.strerror}: no batch began here") from error
    except ValidationError as error:
        raise RecordError(f"{path} is damaged: {str(error).splitlines()[0]}") from error


def check_same(batch: BatchFile, tray: Tray, recipe: Path) -> None:
    """Check that the batch on disk is the ordered one.

    Raises:
        UsageError: tray list or recipe are not what they were.
    """
    for what, before, after in (
        ("tray list", batch.tray_sha256, tray.sha256),
        ("recipe", batch.recipe_sha256, sha256_of(recipe)),
    ):
        if before != after:
            raise UsageError(
                f"the {what} is not the one with which the batch began on {batch.created_at[:10]}: put it back, or "
                "name another --out to begin anew"
            )
