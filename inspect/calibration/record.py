"""Record of a calibration: JSON next to its picture, sealed, with values, uncertainties and validity.

A calibration is one or two files of one name: ``stray.json`` with the results, and ``stray.tif`` if there is a
picture. The record holds the hash of the picture and ends with a seal, the hash of itself.
"""

import hashlib
import json
from datetime import UTC, datetime, timedelta
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

from pydantic import BaseModel, ConfigDict, Field

from anisoscope.base.atomic_write import write_text
from anisoscope.base.errors import CalibrationError, RecordError, UsageError
from anisoscope.base.json_file import parsed_json
from anisoscope.base.regular_file import bounded_bytes
from anisoscope.record.schema import UNSEALED, InputFile, sha256_of

Kind = Literal["flat", "dark", "stray", "linearity", "rotation", "focus", "check", "fixture"]
KINDS: tuple[Kind, ...] = get_args(Kind)
VALID_FOR_DAYS: dict[Kind, float] = {
    "flat": 30.0,
    "dark": 90.0,
    "stray": 90.0,
    "linearity": 365.0,
    "rotation": 30.0,
    "focus": 30.0,
    "check": 1.0,
    "fixture": 90.0,
}
MAX_DAYS = 3650.0


class _Part(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, defer_build=True)


class Value(_Part):
    """A calibrated value with its unit ("" for a pure number) and, where known, its standard uncertainty."""

    value: float
    u: float | None = None
    unit: str = ""


class CameraRecord(_Part):
    """The camera that was calibrated."""

    model: str
    serial: str
    rows: int
    cols: int
    bit_depth: int


class CalibrationRecord(_Part):
    """A calibration, complete.

    Attributes:
        kind: what was calibrated.
        id: kind, day and a short hash of the results; unique.
        taken_at: UTC time.
        valid_for_days: validity in days.
        valid_until: UTC time at which the validity ends.
        software: program and version that wrote it.
        rig: name of the rig.
        camera: the camera.
        stage: the stage, as far as it was used.
        exposure_s, gain: settings of the frames; of a series the longest exposure.
        frames: number of frames.
        operator: name of the operator.
        temperature_c: ambient temperature, if stated.
        values: results, by name.
        residuals: measurement minus fit, one number a step.
        details: further results of this kind, such as settings and a fitted response.
        in_limits: False if a result is outside its limits, so that the rig must not inspect.
        remarks: notes for the operator.
        picture: the file of pixels next to the record.
    """

    kind: Kind
    schema_version: Annotated[Literal[1], Field(alias="schema")] = 1
    id: str
    taken_at: datetime
    valid_for_days: float
    valid_until: datetime
    software: str
    rig: str
    camera: CameraRecord
    stage: str | None = None
    exposure_s: float
    gain: float
    frames: int
    operator: str | None = None
    temperature_c: float | None = None
    values: dict[str, Value]
    residuals: tuple[float, ...] = ()
    details: dict[str, Any] = {}
    in_limits: bool = True
    remarks: tuple[str, ...] = ()
    picture: InputFile | None = None

    def number(self, name: str) -> float:
        """A value by its name.

        Raises:
            CalibrationError: the record does not hold it.
        """
        return self._value(name).value

    def uncertainty(self, name: str) -> float:
        """The standard uncertainty of a value, 0 where it has none; errors as for `number`."""
        return self._value(name).u or 0.0

    def _value(self, name: str) -> Value:
        if name not in self.values:
            raise CalibrationError(
                f"the {self.kind} calibration {self.id} holds no {name}: {advice(self.kind)}"
            )
        return self.values[name]

    def invalid_reason(self, at: datetime) -> str | None:
        """Reason why this calibration makes a measurement at a time INVALID, or None."""
        if at >= self.valid_until:
            ended = self.valid_until.strftime("%Y-%m-%d %H:%M UTC")
            return f"the {self.kind} calibration {self.id} expired at {ended}: {advice(self.kind)}"
        if not self.in_limits:
            why = f" ({self.remarks[0]})" if self.remarks else ""
            return (
                f"the {self.kind} calibration {self.id} was out of its limits{why}: "
                f"put the rig right, then {advice(self.kind)}"
            )
        return None


def advice(kind: Kind) -> str:
    """The command that makes a calibration of a kind."""
    return f"take one with `anisoscope {'rig focus --map' if kind == 'focus' else f'calibrate {kind}'}`"


def days_of(kind: Kind, days: float | None) -> float:
    """Validity of a calibration, in days.

    Raises:
        UsageError: not between 0 and ten years.
    """
    found = VALID_FOR_DAYS[kind] if days is None else days
    if not 0.0 < found <= MAX_DAYS:
        raise UsageError(
            f"a calibration holds for more than 0 and at most {MAX_DAYS:g} days, not {found:g}: correct --valid-days"
        )
    return found


def dated(kind: Kind, content: dict[str, Any], *, valid_days: float | None) -> CalibrationRecord:
    """Record dated now, with its id and validity.

    Args:
        kind: kind of calibration.
        content: the fields that the caller supplies.
        valid_days: validity in days; None for the default.
    """
    now, days = datetime.now(UTC), days_of(kind, valid_days)
    found = content | {"kind": kind, "taken_at": now, "valid_for_days": days}
    found |= {"valid_until": now + timedelta(days=days), "software": f"anisoscope {version('anisoscope')}"}
    validated = CalibrationRecord.model_validate(found | {"id": ""})
    short = hashlib.sha256(validated.model_dump_json(by_alias=True).encode()).hexdigest()[:8]
    return validated.model_copy(update={"id": f"{kind}-{now:%Y%m%d}-{short}"})


def record_path(path: Path) -> Path:
    """The record of a calibration, whichever of its files is named."""
    return path.with_suffix(".json")


def picture_path(path: Path) -> Path:
    """The picture of a calibration, whichever of its files is named."""
    return path if path.suffix.lower() in {".tif", ".tiff"} else path.with_suffix(".tif")


def write_calibration(record: CalibrationRecord, path: Path) -> Path:
    """Write a record next to its picture, atomically; returns its path.

    Raises:
        RecordError: it cannot be written.
    """
    target = record_path(path)
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise RecordError(f"cannot write {target}: {error.strerror}") from error
    content = record.model_dump(mode="json", by_alias=True) | {"seal": UNSEALED}
    text = json.dumps(content, indent=2, allow_nan=False, ensure_ascii=False)
    before, _, after = text.rpartition(UNSEALED)
    write_text(target, before + hashlib.sha256(text.encode()).hexdigest() + after + "\n")
    return target


def read_calibration(path: Path, kind: Kind, picture: Path | None = None) -> CalibrationRecord:
    """Read a record, and check its seal and the hash of its picture.

    Args:
        path: either file of the calibration.
        kind: the required kind.
        picture: its picture, if it is not next to the record.

    Raises:
        CalibrationError: missing, damaged, changed, or of another kind.
    """
    target = record_path(path)
    try:
        text = bounded_bytes(target).decode().removesuffix("\n")
        content = parsed_json(text)
        seal = str(content.pop("seal")) if isinstance(content, dict) else ""
        before, _, after = text.rpartition(seal)
        if hashlib.sha256((before + UNSEALED + after).encode()).hexdigest() != seal:
            raise CalibrationError(f"{target} was changed after it had been written: {advice(kind)}")
        record = CalibrationRecord.model_validate_json(json.dumps(content))
    except FileNotFoundError:
        raise CalibrationError(f"the {kind} calibration {target} does not exist: {advice(kind)}") from None
    except OSError as error:
        raise CalibrationError(f"{target} cannot be read: {error.strerror}: {advice(kind)}") from error
    except (KeyError, ValueError) as error:
        reason = str(error).splitlines()[0]
        raise CalibrationError(
            f"{target} is no record of a calibration ({reason}): {advice(kind)}"
        ) from error
    if record.kind != kind:
        raise CalibrationError(f"{target} is a {record.kind} calibration, not a {kind} one: {advice(kind)}")
    if record.picture is not None:
        _check_picture(record.picture, picture or target.with_name(record.picture.name), kind)
    return record


def _check_picture(file: InputFile, path: Path, kind: Kind) -> None:
    try:
        found = sha256_of(path)
    except OSError as error:
        raise CalibrationError(
            f"{path}, the picture of the {kind} calibration, cannot be read ({error.strerror}): {advice(kind)}"
        ) from error
    if found != file.sha256:
        raise CalibrationError(
            f"{path} was changed since its calibration (its SHA-256 differs from the record): {advice(kind)}"
        )


def picture_of(path: Path) -> InputFile:
    """Name and hash of a picture that was just written.

    Raises:
        RecordError: it cannot be read.
    """
    try:
        return InputFile(name=path.name, sha256=sha256_of(path))
    except OSError as error:
        raise RecordError(f"cannot read {path}: {error.strerror}") from error
