"""Record of a commissioning: findings, uncertainties and data, sealed like the record of an inspection."""

import hashlib
import json
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from anisoscope.base.atomic_write import write_text
from anisoscope.base.errors import CalibrationError
from anisoscope.base.json_file import parsed_json
from anisoscope.base.regular_file import bounded_bytes

_UNSEALED = "0" * 64

Status = Literal["found", "not identifiable", "not measured"]
Value = float | int | str


class _Part(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Finding(_Part):
    """One quantity that commissioning determines.

    Attributes:
        key: key of the rig file, or a name of our own where it has none.
        words: what it is.
        unit: its unit.
        old: what the rig file says.
        value: what was found.
        u: its standard uncertainty.
        status: whether it was found.
        remark: what to know about it.
        goes_to_rig_file: whether ``--write`` puts it there.
    """

    key: str
    words: str
    unit: str = ""
    old: Value | None = None
    value: Value | None = None
    u: float | None = None
    status: Status = "found"
    remark: str = ""
    goes_to_rig_file: bool = False


def missing(key: str, words: str, unit: str, why: str) -> Finding:
    """Finding that was not measured, with the reason."""
    return Finding(key=key, words=words, unit=unit, status="not measured", remark=why)


def status_of(found: bool) -> Status:
    """Status of a finding: determined or not."""
    return "found" if found else "not identifiable"


class PoseRecord(_Part):
    """One picture: readings in degrees, measured quantities, and fitted values."""

    reading_deg: float
    tilt_reading_deg: float
    marker_deg: float | None
    marker_residual_px: float | None
    squeeze: float | None
    ridge_deg: float | None
    radiance: float | None
    u_relative: float | None
    fitted: float | None = None
    z: float | None = None


class ParameterRecord(_Part):
    """Parameter of the radiance fit: before, after, and from the pictures alone (None: not determined by them)."""

    name: str
    words: str
    prior: float | None
    u_prior: float | None
    value: float
    u: float
    u_alone: float | None


class FitRecord(_Part):
    """The radiance fit."""

    parameters: tuple[ParameterRecord, ...]
    correlation: tuple[tuple[float, ...], ...]
    chi2: float
    dof: int
    widened: float
    side_chi2: float
    sign_chi2: float | None


class Commissioning(_Part):
    """Complete record of a commissioning.

    ``dark_level`` and ``dark_noise`` are counts, ``blur_px`` the rms width of marker edges, ``drift`` the relative
    change of the first pose from start to end.
    """

    kind: Literal["anisoscope commissioning"] = "anisoscope commissioning"
    schema_version: Annotated[Literal[1], Field(alias="schema")] = 1
    id: str
    created_at: str
    software: str
    rig: str
    rig_file: str
    rig_file_sha256: str
    devices: dict[str, str]
    part: dict[str, Any]
    series: dict[str, Any]
    findings: tuple[Finding, ...]
    poses: tuple[PoseRecord, ...]
    fit: FitRecord | None
    drift: float | None
    dark_level: float
    dark_noise: float
    blur_px: float | None
    notes: tuple[str, ...]
    frames_sha256: tuple[str, ...]

    def __getitem__(self, key: str) -> Finding:
        for finding in self.findings:
            if finding.key == key:
                return finding
        raise KeyError(key)

    def number(self, key: str) -> float | None:
        """Value of a finding, None where it was not determined."""
        for finding in self.findings:
            if finding.key == key and finding.status == "found" and isinstance(finding.value, int | float):
                return float(finding.value)
        return None


def default_record_path(rig_path: Path) -> Path:
    """Default path of a rig's commissioning record: next to the rig file."""
    return rig_path.with_suffix(".commissioning.json")


def write_commissioning(record: Commissioning, path: Path) -> None:
    """Write a record atomically; it ends with its seal, the SHA-256 of itself with zeros for the seal.

    Raises:
        RecordError: the file cannot be written.
    """
    content = record.model_dump(mode="json", by_alias=True) | {"seal": _UNSEALED}
    text = json.dumps(content, indent=2, allow_nan=False, ensure_ascii=False)
    before, _, after = text.rpartition(_UNSEALED)
    write_text(path, before + hashlib.sha256(text.encode()).hexdigest() + after)


def read_commissioning(path: Path) -> Commissioning:
    """Read a record and check its seal.

    Raises:
        CalibrationError: missing, damaged, changed, or something else.
    """
    advice = "make one with `anisoscope rig commission`"
    try:
        text = bounded_bytes(path).decode()
        content = parsed_json(text)
        seal = str(content.pop("seal")) if isinstance(content, dict) else ""
        before, _, after = text.rpartition(seal)
        if hashlib.sha256((before + _UNSEALED + after).encode()).hexdigest() != seal:
            raise CalibrationError(f"{path} was changed after it had been written: {advice}")
        return Commissioning.model_validate(content)
    except FileNotFoundError:
        raise CalibrationError(f"{path}: there is no such file: {advice}") from None
    except OSError as error:
        raise CalibrationError(f"{path} cannot be read: {error.strerror}") from error
    except (KeyError, ValueError) as error:
        reason = str(error).splitlines()[0]
        raise CalibrationError(f"{path} is no record of a commissioning ({reason}): {advice}") from error
