"""Taking calibrations on the rig."""

from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from anisoscope.errors import UsageError
from anisoscope.linear import stack
from anisoscope.progress import Advance, silent
from anisoscope.rig.acquisition.runner import Rig, open_rig
from anisoscope.rig.frame import Frame, FrameKind
from anisoscope.rig.rigfile import read_rig
from anisoscope.sim.light.geometry import Convention, Pose, directions
from anisoscope.whitereference import make_reference, write_reference

_KINDS: tuple[FrameKind, ...] = ("dark", "flat")


def take_flat(
    rig_path: Path,
    out: Path,
    *,
    exposure_s: float,
    frames: int = 16,
    reflectance: float = 0.99,
    on_progress: Advance = silent,
) -> dict[str, Any]:
    """Photograph a white tile that fills the picture and write the white reference.

    The stage does not move. An arm with a tilt axis is set to 0°: camera and light tilt together, so one flat
    serves all tilts.

    Args:
        rig_path: rig file.
        out: file to write (TIFF).
        exposure_s: exposure in seconds.
        frames: frames to average, as many again with the light off.
        reflectance: reflectance of the tile, 0 to 1.
        on_progress: called with what is being done, steps done and steps in all.

    Returns:
        The metadata of the reference.

    Raises:
        UsageError: a reflectance outside 0 to 1, or fewer than two frames.
        RigFileError, RigError: the rig.
        CalibrationError: the tile is saturated or dark.
        RecordError: the file cannot be written.
    """
    if not 0.0 < reflectance <= 1.0:
        raise UsageError(f"the reflectance of the tile must lie between 0 and 1, not {reflectance}")
    if frames < 2:
        raise UsageError(f"a flat needs at least 2 frames, not {frames}")
    rig_file = read_rig(rig_path)
    with open_rig(rig_file) as rig:
        tilt_deg = _upright(rig, on_progress)
        settings = rig.camera.configure(exposure_s, 1.0)
        info = rig.camera.info
        stacks = {}
        for step, kind in enumerate(_KINDS):
            (rig.light.on if kind == "flat" else rig.light.off)()
            taken = []
            for k in range(frames):
                on_progress(f"{kind} frames", step * frames + k, 2 * frames)
                taken.append(_frame(rig, kind, settings.exposure_s, settings.gain, tilt_deg))
            stacks[kind] = stack(taken)
    convention = Convention(rig_file.light.angle_deg)
    to_light, _ = directions((Pose(0.0, tilt_deg),), convention)
    reference = make_reference(
        stacks["flat"],
        stacks["dark"],
        reflectance=reflectance,
        light_cosine=float(to_light[0, 2]),
        camera=info.serial,
        full_scale=2**info.bit_depth - 1,
    )
    write_reference(out, reference)
    meta: dict[str, Any] = reference["meta"]
    return meta


def _upright(rig: Rig, advance: Advance) -> float:
    """Set an arm that can be tilted to 0°; return the tilt in degrees as read back, or that of a fixed arm."""
    if rig.tilt is None or rig.file.tilt is None:
        return rig.file.geometry.tilt_deg
    if not rig.tilt.is_homed:
        advance(f"homing {rig.tilt.name}", 0, 1)
        rig.tilt.home()
    advance("tilting to 0°", 0, 1)
    return rig.file.tilt.angle_deg(rig.tilt.move_to(rig.file.tilt.reading_deg(0.0)))


def _frame(rig: Rig, kind: FrameKind, exposure_s: float, gain: float, tilt_deg: float) -> Frame:
    info = rig.camera.info
    return Frame(
        counts=rig.camera.grab(),
        kind=kind,
        bit_depth=info.bit_depth,
        black_level=info.black_level,
        exposure_s=exposure_s,
        gain=gain,
        stage_deg=0.0,
        commanded_deg=0.0,
        tilt_deg=tilt_deg,
        captured_at=datetime.now(UTC).isoformat(timespec="milliseconds"),
        camera=info.serial,
    )
