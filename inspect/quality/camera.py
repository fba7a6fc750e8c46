"""A camera as EMVA 1288 (release 4, linear) describes it, from the record of its linearity calibration."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import CalibrationError
from anisoscope.base.json_fields import in_json, json_field
from anisoscope.calibration.linearity import LINEARITY_RANGE, TransferCurve, linearity_deviations
from anisoscope.calibration.record import CalibrationRecord, Value, advice, read_calibration
from anisoscope.rig.rigfile import read_rig

NAMES = {
    "gain": "system gain K",
    "read_noise": "temporal dark noise (read noise)",
    "dark_current": "dark current",
    "dark_level": "dark level",
    "dsnu": "dark signal nonuniformity (DSNU1288)",
    "prnu": "photo response nonuniformity (PRNU1288)",
    "saturation": "saturation capacity (full well)",
    "snr_max": "largest signal-to-noise ratio",
    "dynamic_range": "dynamic range",
    "raw_error": "linearity error, as the camera delivers",
    "linearity_error": "linearity error that remains after correction",
}
COLUMNS = ("exposure_s", "amount", "light", "dark", "light_variance", "dark_variance")


def _described(record: CalibrationRecord) -> dict[str, Any]:
    """What the sheet says of its calibration."""
    names = ("id", "camera", "taken_at", "valid_until", "in_limits", "values")
    return {"gain_setting": record.gain} | {name: getattr(record, name) for name in names}


@dataclass(frozen=True, eq=False)
class CameraSheet:
    """Data sheet of a camera.

    Attributes:
        record: the calibration.
        path: its file.
        curve: means and variances over exposure; None in records of earlier versions.
    """

    record: CalibrationRecord = field(metadata=json_field(by=_described, merged=True))
    path: Path = field(metadata=json_field("file"))
    curve: TransferCurve | None

    @property
    def saturation_dn(self) -> float:
        """Signal at saturation, in counts."""
        return self.record.number("saturation") * self.record.number("gain")

    def deviations(self) -> tuple[FloatArray, FloatArray] | None:
        """Signals in counts between 5 and 95 % of saturation, and their relative deviations from a straight line."""
        if self.curve is None:
            return None
        low, high = (share * self.saturation_dn for share in LINEARITY_RANGE)
        signal = self.curve.signal
        used = (signal >= low) & (signal <= high)
        return signal[used], linearity_deviations(self.curve, self.saturation_dn)

    def snr(self) -> tuple[FloatArray, FloatArray] | None:
        """Signals above 0 in electrons, below saturation, and their temporal signal-to-noise ratios."""
        if self.curve is None:
            return None
        signal = self.curve.signal
        used = (signal > 0.0) & (signal <= 1.0001 * self.saturation_dn) & (self.curve.light_variance > 0.0)
        electrons = signal[used] / self.record.number("gain")
        return electrons, signal[used] / np.sqrt(self.curve.light_variance[used])

    @property
    def rows(self) -> tuple[tuple[str, Value], ...]:
        """Results in the order of the standard, ratios also in decibels and stops."""
        values = self.record.values
        return tuple((NAMES[name], values[name]) for name in NAMES if name in values)

    @property
    @in_json()
    def verdict(self) -> str:
        """The outcome in plain words."""
        record = self.record
        error = record.number("linearity_error")
        word = "fit for measuring" if record.in_limits else "not fit for measuring"
        return (
            f"{word}: linear within {error:.2%}, {20 * np.log10(record.number('dynamic_range')):.0f} dB of dynamic "
            f"range, at best {record.number('snr_max'):.0f} : 1 in one frame"
        )

    @property
    @in_json()
    def notes(self) -> tuple[str, ...]:
        """Notes for the reader."""
        found = list(self.record.remarks)
        found.append(
            "quantum efficiency and absolute sensitivity are not given: they need a lamp of known power, and light "
            "counts in electrons here"
        )
        if self.curve is None:
            found.append(
                f"this record holds no transfer curve, so that there is nothing to draw: {advice('linearity')}"
            )
        return tuple(found)


def read_camera(path: Path) -> CameraSheet:
    """The sheet of a camera, from a rig file (TOML) or from the record of a linearity calibration.

    Raises:
        RigFileError: the rig file.
        CalibrationError: there is no such calibration, or it cannot be read.
    """
    if path.suffix.lower() == ".toml":
        part = read_rig(path).calibration
        if part is None or part.linearity is None:
            raise CalibrationError(
                f"{path} names no linearity calibration: {advice('linearity')}, then name it under [calibration]"
            )
        path = part.linearity
    record = read_calibration(path, "linearity")
    return CameraSheet(record, path, _curve_of(record.details.get("curve"), path))


def _curve_of(content: object, path: Path) -> TransferCurve | None:
    if content is None:
        return None
    damaged = CalibrationError(f"{path}: the transfer curve of the record is damaged: {advice('linearity')}")
    if not isinstance(content, dict) or set(content) != {*COLUMNS, "pixels"}:
        raise damaged
    try:
        columns = {name: np.asarray(content[name], dtype=np.float64) for name in COLUMNS}
        curve = TransferCurve(**columns, pixels=int(content["pixels"]))
    except (TypeError, ValueError):
        raise damaged from None
    if {column.shape for column in columns.values()} != {(len(curve.light),)}:
        raise damaged
    return curve
