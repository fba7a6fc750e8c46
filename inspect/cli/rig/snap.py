"""``anisoscope rig snap``: one frame to a file, with its quality figures."""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from anisoscope.base.errors import UsageError
from anisoscope.base.language import decimal, message
from anisoscope.cli.json_output import print_json
from anisoscope.cli.options import Json
from anisoscope.cli.rig.options import Channel, Exposure, Gain, LightState, RigPath, write_line

if TYPE_CHECKING:
    from anisoscope.rig.acquisition.opening import Devices
    from anisoscope.rig.frame import Frame
    from anisoscope.rig.rigfile import RigFile

SATURATED_SHARE = 0.001


def snap(
    *,
    rig: RigPath,
    out: Annotated[Path, Parameter(help="File to write (.tif): 16 bits, with our metadata.")],
    exposure: Exposure,
    gain: Gain = 1.0,
    frames: Annotated[int, Parameter(name="--count", help="Frames to average, rounded to counts.")] = 1,
    light: LightState = "on",
    channel: Channel = None,
    preview: Annotated[bool, Parameter(negative="", help="Also write a PNG preview next to it.")] = False,
    stage: Annotated[
        bool,
        Parameter(
            name="--read-axes",
            negative="--no-read-axes",
            help="Read the axes and write their angles into the file.",
        ),
    ] = True,
    overwrite: Annotated[bool, Parameter(negative="", help="Replace files that exist.")] = False,
    json_: Json = False,
) -> int:
    """Take a picture and write it to a file; nothing moves.

    Prints mean, saturated share and sharpness (Tenengrad; larger is sharper, for the same object). The file of a colour
    camera holds the unchanged mosaic; the preview is in colour.

    Examples:
        anisoscope rig snap --rig rig.toml --exposure 0.005 --out picture.tif
    """
    from anisoscope.rig.acquisition.opening import open_devices
    from anisoscope.rig.frame import write_frame
    from anisoscope.rig.rigfile import read_rig

    picture = out.with_suffix(".png") if preview else None
    _check_files(out, picture, overwrite=overwrite)
    if not 1 <= frames <= 10_000:
        raise UsageError(f"--count must lie between 1 and 10000, not {frames}")
    file = read_rig(rig, channel=channel)
    axes = {"stage": file.stage} | ({} if file.tilt is None else {"tilt": file.tilt})
    lamp = None if light == "as-is" else file.light
    with open_devices(axes if stage else {}, file.camera, lamp) as devices:
        frame, saturated = _take(devices, file, exposure, gain, frames, light=light)
        assert devices.camera is not None
        info = devices.camera.info
        unsure = [axis.name for axis in devices.axes.values() if not axis.is_homed]
    write_frame(frame, out)
    found = _judge(frame, info, saturated, picture)
    if unsure:
        write_line(
            f"{' and '.join(unsure)}: not homed since connected; the angle in the file is what was read"
        )
    if json_:
        print_json({"file": str(out), "preview": None if picture is None else str(picture), **found})
    else:
        _print(out, picture, found)
    return 0


def _check_files(out: Path, picture: Path | None, *, overwrite: bool) -> None:
    if out.suffix.lower() not in {".tif", ".tiff"}:
        raise UsageError(f"--out {out}: frames are TIFF files; name it .tif")
    for path in (out, picture):
        if path is not None and path.exists() and not overwrite:
            raise UsageError(f"{path} exists; name another file, or say --overwrite")


def _take(
    devices: "Devices", file: "RigFile", exposure: float, gain: float, frames: int, *, light: str
) -> "tuple[Frame, float]":
    """The mean of some frames, and the largest saturated share among them."""
    from datetime import UTC, datetime

    import numpy as np

    from anisoscope.live_view.view import saturated_share
    from anisoscope.rig.frame import Frame

    camera, lamp = devices.camera, devices.light
    assert camera is not None
    settings = camera.configure(exposure, gain)
    if lamp is not None:
        (lamp.on if light == "on" else lamp.off)()
    info = camera.info
    captured = [camera.grab().copy() for _ in range(frames)]
    mean = np.rint(np.mean(captured, axis=0)).astype(np.uint16) if frames > 1 else captured[0]
    stage_deg, tilt_deg = _angles(devices, file)
    frame = Frame(
        counts=mean,
        kind="dark" if light == "off" else "sample",
        bit_depth=info.bit_depth,
        black_level=info.black_level,
        exposure_s=settings.exposure_s,
        gain=settings.gain,
        stage_deg=stage_deg,
        commanded_deg=stage_deg,
        tilt_deg=tilt_deg,
        captured_at=datetime.now(UTC).isoformat(timespec="milliseconds"),
        camera=f"{info.model} {info.serial}",
        filters=info.filters,
    )
    return frame, max(saturated_share(counts, info.bit_depth) for counts in captured)


def _angles(devices: "Devices", file: "RigFile") -> tuple[float, float]:
    """Angles of sample and arm in degrees; NaN for an axis that was not read."""
    stage, tilt = devices.axes.get("stage"), devices.axes.get("tilt")
    stage_deg = math.nan if stage is None else file.stage.place(stage.position_deg())
    if file.tilt is None:
        return stage_deg, file.geometry.tilt_deg
    return stage_deg, math.nan if tilt is None else file.tilt.place(tilt.position_deg())


def _judge(frame: "Frame", info: Any, saturated: float, picture: Path | None) -> dict[str, Any]:  # noqa: ANN401
    from anisoscope.base.atomic_write import write_bytes
    from anisoscope.live_view.picture import as_png, to_show
    from anisoscope.live_view.view import look_at

    view = look_at(frame.counts, info)
    if picture is not None:
        write_bytes(picture, as_png(to_show(frame.counts, info)))
    return {
        "rows": frame.counts.shape[0],
        "cols": frame.counts.shape[1],
        "exposure_s": frame.exposure_s,
        "gain": frame.gain,
        "angle_deg": frame.stage_deg,
        "tilt_deg": frame.tilt_deg,
        "mean_counts": float(frame.counts.mean()),
        "mean": view.mean,
        "saturated_share": saturated,
        "filters": frame.filters,
        "sharpness": view.focus,
        "ridge_deg": view.ridge_deg,
    }


def _print(out: Path, picture: Path | None, found: dict[str, Any]) -> None:
    dark = math.isnan(found["sharpness"])
    sharp = message("not measurable, too dark") if dark else f"{found['sharpness']:.3g}"
    at = "" if math.isnan(found["angle_deg"]) else decimal(f", {found['angle_deg']:.3f}°")
    print(  # noqa: T201
        message(
            "{path}: {size}, {exposure} s, gain {gain}; mean {mean} counts ({level} of full scale), saturated {share}, "
            "sharpness {sharpness}",
            path=out,
            size=f"{found['rows']} × {found['cols']}{at}",
            exposure=f"{found['exposure_s']:g}",
            gain=f"{found['gain']:g}",
            mean=f"{found['mean_counts']:.1f}",
            level=f"{found['mean']:.1%}",
            share=f"{found['saturated_share']:.3%}",
            sharpness=sharp,
        )
    )
    if found["filters"] != "mono":
        print(message("{path}: raw mosaic, filters {name}", path=out, name=found["filters"]))  # noqa: T201
    if picture is not None:
        print(message("{path}: preview", path=picture))  # noqa: T201
    if found["saturated_share"] > SATURATED_SHARE:
        write_line(message("too many saturated pixels to measure anything: expose shorter"))
