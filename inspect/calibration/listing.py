"""What calibrations a rig has, until when they hold, and what is missing."""

from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal

from anisoscope.base.errors import CalibrationError
from anisoscope.calibration.record import (
    KINDS,
    CalibrationRecord,
    Kind,
    advice,
    picture_path,
    read_calibration,
    record_path,
)
from anisoscope.calibration.white_reference import read_reference
from anisoscope.rig.rigfile import CalibrationPart, read_rig

State = Literal["valid", "expired", "out of limits", "no record", "damaged", "missing"]
NEEDED: tuple[Kind, ...] = ("flat",)


@dataclass(frozen=True)
class Listed:
    """One kind of calibration of a rig.

    Attributes:
        kind: the kind.
        state: whether an inspection can use it; a flat of an earlier version has no record, and no end.
        file: what the rig file names, or None.
        id: of its record.
        taken_at, valid_until: UTC times.
        needed: whether inspections need one.
        advice: what to do, "" where nothing.
    """

    kind: Kind
    state: State
    file: str | None
    id: str | None
    taken_at: str | None
    valid_until: str | None
    needed: bool
    advice: str

    def to_json(self) -> dict[str, Any]:
        """All of it, for JSON."""
        return asdict(self)


def list_calibrations(rig_path: Path, at: datetime | None = None) -> tuple[Listed, ...]:
    """All kinds of calibrations of a rig, and how each of them stands.

    Args:
        rig_path: rig file.
        at: time at which they are to hold; now by default.

    Raises:
        RigFileError: the rig file.
    """
    part = read_rig(rig_path).calibration
    return tuple(_listed(kind, part, at or datetime.now(UTC)) for kind in KINDS)


def _listed(kind: Kind, part: CalibrationPart | None, at: datetime) -> Listed:
    path: Path | None = None if part is None else getattr(part, kind)
    needed = kind in NEEDED
    if path is None:
        return Listed(kind, "missing", None, None, None, None, needed, advice(kind))
    try:
        if kind == "flat":
            white = read_reference(path)
            if not record_path(path).is_file():
                return Listed(kind, "no record", str(path), None, white.taken_at, None, needed, advice(kind))
        record = read_calibration(path, kind, path if kind == "flat" else picture_path(path))
    except CalibrationError as error:
        state: State = "damaged" if path.exists() or record_path(path).exists() else "missing"
        return Listed(kind, state, str(path), None, None, None, needed, str(error))
    return Listed(
        kind,
        _state(record, at),
        str(path),
        record.id,
        record.taken_at.isoformat(timespec="seconds"),
        record.valid_until.isoformat(timespec="seconds"),
        needed,
        record.complaint(at) or "",
    )


def _state(record: CalibrationRecord, at: datetime) -> State:
    if at >= record.valid_until:
        return "expired"
    return "valid" if record.in_limits else "out of limits"
