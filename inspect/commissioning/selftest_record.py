"""Result of a self test of the rig: its checks with their limits, and the file it is written to."""

import hashlib
import json
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from anisoscope.base.atomic_write import write_text
from anisoscope.base.errors import RecordError, UsageError
from anisoscope.calibration.warm_up import MIN_FRAMES
from anisoscope.recipe.base import LimitsPart
from anisoscope.record.verdict import Verdict

Outcome = Literal["PASS", "FAIL", "WARN", "SKIPPED"]
_LIMITS = LimitsPart()


@dataclass(frozen=True)
class Settings:
    """Settings of the self test, and its limits.

    Attributes:
        exposure_s, gain: how the camera exposes.
        frames: lit frames over which the lamp is watched.
        dark_frames: frames with the light off.
        tile: whether the white tile lies on the stage; then no markers are looked for.
        readback_deg: largest distance of a reading from what was commanded; twice the stage's resolution if larger.
        repeat_deg: largest difference of pictures taken at the same angle.
        angle_deg: largest distance of the markers' angle from the stage's.
        centre_px: largest distance of the rotation centre from the commissioned one.
        residual_px: largest misfit of the markers.
        scale_share: largest relative distance of the pixel size from the rig file's.
        blur_ratio: largest blur of marker edges, over the commissioned one and over that of the fixture's reference.
        black_share: largest distance of the dark level from the camera's black level, of full scale.
        noise_share: largest noise of a dark frame, of full scale.
        noise_ratio: the same over the commissioned one.
        signal_share: signal that the light has to make at least, of full scale.
        saturated_share: largest share of saturated pixels.
        drift_share: largest change of the light over the frames.
        flicker_share: largest scatter of the light from frame to frame.
        white_days: age of the white reference.
        shading_share: largest change of the shading since the white reference.
        level_share: largest change of the light since the white reference, and since the fixture's reference.
        stray_share: largest stray light at the markers since the fixture's reference, relative to their white.
        gradient_share: largest deviation of a marker from the level of the others.
        grey_share: largest deviation of a grey from a straight line through black and white, relative to white.
        light_channel: of the rig file; None for the one that it uses by default.
    """

    exposure_s: float
    gain: float = 1.0
    frames: int = 20
    dark_frames: int = 4
    tile: bool = False
    readback_deg: float = 0.05
    repeat_deg: float = 0.05
    angle_deg: float = 0.2
    centre_px: float = 5.0
    residual_px: float = 0.5
    scale_share: float = 0.02
    blur_ratio: float = 1.3
    black_share: float = 0.002
    noise_share: float = 0.005
    noise_ratio: float = 1.5
    signal_share: float = 0.02
    saturated_share: float = 0.001
    drift_share: float = 0.005
    flicker_share: float = 0.01
    white_days: float = 30.0
    shading_share: float = 0.02
    level_share: float = _LIMITS.level_share
    stray_share: float = _LIMITS.stray_share
    gradient_share: float = _LIMITS.gradient_share
    grey_share: float = _LIMITS.grey_share
    light_channel: str | None = None

    def __post_init__(self) -> None:
        if not (0.0 < self.exposure_s < float("inf") and 0.0 < self.gain < float("inf")):
            raise UsageError(
                f"exposure and gain must be more than 0, not {self.exposure_s:g} s and {self.gain:g}"
            )
        if self.frames < MIN_FRAMES or self.dark_frames < 2:
            raise UsageError(f"the self test takes at least {MIN_FRAMES} lit and 2 dark frames")


class _Part(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Check(_Part):
    """One check: outcome, value and limit in `unit`, and advice; WARN leaves the rig fit."""

    key: str
    words: str
    outcome: Outcome
    value: float | None = None
    limit: float | None = None
    unit: str = ""
    remark: str = ""


def limit_check(
    key: str,
    words: str,
    value: float,
    limit: float,
    unit: str,
    advice: str,
    *,
    at_least: bool = False,
    remark: str = "",
) -> Check:
    """Check of a number against a limit; `advice` is added on failure, `remark` always."""
    good = bool(np.isfinite(value)) and (value >= limit if at_least else value <= limit)
    text = "; ".join(text for text in (remark, "" if good else advice) if text)
    finite = float(value) if np.isfinite(value) else None
    return Check(
        key=key,
        words=words,
        outcome="PASS" if good else "FAIL",
        value=finite,
        limit=limit,
        unit=unit,
        remark=text,
    )


def skipped_check(key: str, words: str, why: str) -> Check:
    """Check that was not done, with the reason."""
    return Check(key=key, words=words, outcome="SKIPPED", remark=why)


class SelfTest(_Part):
    """Complete self test; `fit` where no check failed."""

    kind: Literal["anisoscope self test"] = "anisoscope self test"
    schema_version: Annotated[Literal[1], Field(alias="schema")] = 1
    id: str
    created_at: str
    software: str
    rig: str
    rig_file_sha256: str
    commissioning: str | None
    devices: dict[str, str]
    settings: dict[str, Any]
    checks: tuple[Check, ...]
    fit: bool

    @property
    def exit_code(self) -> int:
        """0 where the rig is fit, else that of INVALID."""
        return (Verdict.PASS if self.fit else Verdict.INVALID).exit_code

    def __getitem__(self, key: str) -> Check:
        for check in self.checks:
            if check.key == key:
                return check
        raise KeyError(key)


def write_self_test(result: SelfTest, folder: Path) -> Path:
    """Write the result to a file in a folder, with the hash of its content; return its path.

    Raises:
        RecordError: the folder cannot be made or written.
    """
    content = result.model_dump(mode="json", by_alias=True)
    seal = hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()
    stamp = datetime.fromisoformat(result.created_at).strftime("%Y%m%dT%H%M%SZ")
    path = folder / f"selftest-{stamp}-{result.id[:8]}.json"
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise RecordError(f"cannot make the folder {folder}: {error.strerror}") from error
    write_text(path, json.dumps(content | {"sha256": seal}, indent=2, ensure_ascii=False, allow_nan=False))
    return path
