"""Frames for calibrations, and the entries on camera and settings common to their records."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from anisoscope.base.atomic_write import write_bytes
from anisoscope.base.errors import CameraError, RecordError
from anisoscope.base.progress import Advance
from anisoscope.calibration.record import CameraRecord
from anisoscope.imaging.linearisation import Image, Stack, stack
from anisoscope.parameters.taking import Taking
from anisoscope.rig.acquisition.runner import Rig, open_rig
from anisoscope.rig.frame import Frame, FrameKind
from anisoscope.rig.rigfile import RigFile, read_rig


@dataclass(frozen=True, eq=False)
class Bed:
    """Opened rig for a calibration; the tilt is that of the arm, as read back."""

    rig: Rig
    tilt_deg: float
    advance: Advance

    @property
    def file(self) -> RigFile:
        """The rig file."""
        return self.rig.file

    @property
    def camera(self) -> CameraRecord:
        """The camera, as identified in records."""
        info = self.rig.camera.info
        return CameraRecord(
            model=info.model, serial=info.serial, rows=info.rows, cols=info.cols, bit_depth=info.bit_depth
        )

    @property
    def full_scale(self) -> int:
        """Largest count of the camera."""
        return int(2**self.rig.camera.info.bit_depth - 1)

    def frames(self, kind: FrameKind, exposure_s: float, gain: float, count: int) -> list[Frame]:
        """Frames with the light on, or off for dark ones."""
        settings = self.rig.camera.configure(exposure_s, gain)
        (self.rig.light.off if kind == "dark" else self.rig.light.on)()
        frames = []
        for number in range(count):
            self.advance(f"{kind} frames", number, count)
            frames.append(self._frame(kind, settings.exposure_s, settings.gain))
        return frames

    def stack(self, kind: FrameKind, taking: Taking) -> Stack:
        """Mean and noise of such frames."""
        return stack(self.frames(kind, taking.exposure_s, taking.gain, taking.frames))

    def _frame(self, kind: FrameKind, exposure_s: float, gain: float) -> Frame:
        info = self.rig.camera.info
        counts = self.rig.camera.grab()
        if counts.shape != (info.rows, info.cols):
            raise CameraError(
                f"{info.model} delivered a frame of {counts.shape} instead of {(info.rows, info.cols)}"
            )
        return Frame(
            counts=counts.copy(),
            kind=kind,
            bit_depth=info.bit_depth,
            black_level=info.black_level,
            exposure_s=exposure_s,
            gain=gain,
            stage_deg=0.0,
            commanded_deg=0.0,
            tilt_deg=self.tilt_deg,
            captured_at=datetime.now(UTC).isoformat(timespec="milliseconds"),
            camera=info.serial,
            filters=info.filters,
        )

    def content(self, taking: Taking, frames: int, sample: Stack | None = None) -> dict[str, Any]:
        """The fields common to records of all kinds; settings as the camera reported them, where known."""
        return {
            "rig": self.file.name,
            "camera": self.camera,
            "exposure_s": taking.exposure_s if sample is None else sample.exposure_s,
            "gain": taking.gain if sample is None else sample.gain,
            "frames": frames,
            "operator": taking.operator,
            "temperature_c": taking.temperature_c,
        }


@contextmanager
def calibration_bed(rig_path: Path, taking: Taking, advance: Advance) -> Iterator[Bed]:
    """Open a rig without moving its stage; an arm with a tilt axis is set to 0°.

    Camera and light tilt together, so that one calibration serves all tilts.

    Raises:
        RigFileError, RigError: the rig.
    """
    with open_rig(read_rig(rig_path, channel=taking.light_channel)) as rig:
        yield Bed(rig, _upright(rig, advance), advance)


def _upright(rig: Rig, advance: Advance) -> float:
    """Set an arm that can be tilted to 0°; return the tilt in degrees as read back, or that of a fixed arm."""
    if rig.tilt is None or rig.file.tilt is None:
        return rig.file.geometry.tilt_deg
    if not rig.tilt.is_homed:
        advance(f"homing {rig.tilt.name}", 0, 1)
        rig.tilt.home()
    advance("tilting to 0°", 0, 1)
    return rig.file.tilt.place(rig.tilt.move_to(rig.file.tilt.reading(0.0)))


def write_picture(path: Path, picture: Image) -> None:
    """Write a picture of 32-bit numbers as TIFF, atomically.

    Raises:
        RecordError: it cannot be written.
    """
    import io  # noqa: PLC0415 - start-up time

    import tifffile  # noqa: PLC0415 - start-up time

    buffer = io.BytesIO()
    tifffile.imwrite(buffer, np.asarray(picture, dtype=np.float32), photometric="minisblack", metadata=None)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise RecordError(f"cannot write {path}: {error.strerror}") from error
    write_bytes(path, buffer.getvalue())
