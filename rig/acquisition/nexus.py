"""The frames of an acquisition as one NeXus file (HDF5), with the units of every axis, for viewers and archives.

``/entry`` is an NXentry: ``instrument/detector`` has the counts of all frames in the order of recording and their
exposure, ``instrument/tilt`` and ``sample`` the angles that were read back; ``data`` is the NXdata that a viewer opens,
``reflectance`` that of a scan. What the base classes do not know stands in NXcollections. Source: NeXus manual, base
classes NXentry, NXdetector, NXpositioner, NXsample, NXcollection, NXdata.
"""

import os
from collections.abc import Mapping
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import RecordError
from anisoscope.rig.acquisition.journal import FrameLine, read_journal
from anisoscope.rig.frame import read_frame

# Frames by NeXus' image_key: the object, a flat field, darkness.
IMAGE_KEYS = {"flat": 1, "dark": 2, "stray": 2}


def write_nexus(
    folder: Path | str, path: Path | str, reflectance: Mapping[str, FloatArray] | None = None
) -> int:
    """Write the frames of an inspection or a scan to a NeXus file; the file appears whole or not at all.

    Args:
        folder: folder of an acquisition, with its journal ``frames.jsonl``.
        path: the file.
        reflectance: columns of the table of a scan, (N,) each: ``value`` and ``u`` in 1/sr, ``theta_i_deg`` and others.

    Returns:
        Number of frames.

    Raises:
        RecordError: the folder has no journal or no frame, a frame is missing, damaged or of another size, or the file
            cannot be written.
    """
    import h5py  # noqa: PLC0415 - only what writes it needs it

    folder, path = Path(folder), Path(path)
    journal = read_journal(folder)
    if not journal.frames:
        raise RecordError(
            f"{folder}: there are no frames of an acquisition; name the folder of an inspection or a scan"
        )
    partial = path.with_name(f"{path.name}.{os.getpid()}")
    try:
        with h5py.File(partial, "w") as file:
            entry = _group(file, "entry", "NXentry")
            file.attrs["default"] = "entry"
            entry.attrs["default"] = "data"
            entry["title"] = folder.resolve().name
            entry["program_name"] = "anisoscope"
            entry["start_time"] = (
                journal.runs[0].started_at if journal.runs else journal.frames[0].captured_at
            )
            _fill(entry, folder, journal.frames)
            if reflectance is not None:
                _fill_reflectance(entry, reflectance)
        partial.replace(path)
    except OSError as problem:
        raise RecordError(f"{path}: cannot be written: {problem.strerror or problem}") from problem
    finally:
        partial.unlink(missing_ok=True)
    return len(journal.frames)


def _group(parent: Any, name: str, kind: str) -> Any:  # noqa: ANN401 - of a package without types
    group = parent.create_group(name)
    group.attrs["NX_class"] = kind
    return group


def _fill(entry: Any, folder: Path, lines: tuple[FrameLine, ...]) -> None:  # noqa: ANN401
    first = read_frame(folder / lines[0].name)
    shape = first.counts.shape
    instrument = _group(entry, "instrument", "NXinstrument")
    detector = _group(instrument, "detector", "NXdetector")
    detector["description"] = first.camera
    detector["bit_depth_readout"] = first.bit_depth
    detector["saturation_value"] = first.full_scale
    counts = detector.create_dataset(
        "data", (len(lines), *shape), np.uint16, chunks=(1, *shape), compression="gzip", compression_opts=1
    )
    counts.attrs["units"] = "counts"
    for number, line in enumerate(lines):
        frame = read_frame(folder / line.name)
        if frame.counts.shape != shape:
            raise RecordError(
                f"{folder / line.name}: has {frame.counts.shape} pixels, the frames before {shape}"
            )
        counts[number] = frame.counts
    _column(detector, "count_time", [line.exposure_s for line in lines], "s")
    detector["image_key"] = np.array([IMAGE_KEYS.get(line.kind, 0) for line in lines])
    settings = _group(detector, "settings", "NXcollection")
    _column(settings, "black_level", [first.black_level], "counts")
    _column(settings, "gain", [line.gain for line in lines], "")
    start = datetime.fromisoformat(lines[0].captured_at)
    times = [(datetime.fromisoformat(line.captured_at) - start).total_seconds() for line in lines]
    sample = _group(entry, "sample", "NXsample")
    _column(sample, "rotation_angle", [line.stage_deg for line in lines], "deg")
    _column(sample, "rotation_angle_set", [line.pose_deg[0] for line in lines], "deg")
    tilt = _group(instrument, "tilt", "NXpositioner")
    tilt["description"] = "angle of the camera's arm"
    _column(tilt, "value", [line.tilt_deg for line in lines], "deg")
    _column(tilt, "target_value", [line.pose_deg[1] for line in lines], "deg")
    frames = _group(entry, "frames", "NXcollection")
    frames.create_dataset("kind", data=[line.kind for line in lines])
    frames.create_dataset("after_return", data=np.array([line.again for line in lines]))
    data = _group(entry, "data", "NXdata")
    data.attrs["signal"] = "data"
    data.attrs["axes"] = ["time", ".", "."]
    _column(data, "time", times, "s").attrs["start"] = lines[0].captured_at
    data["data"] = counts
    data["rotation_angle"], data["tilt_angle"] = sample["rotation_angle"], tilt["value"]
    data["count_time"] = detector["count_time"]
    for name in ("time", "rotation_angle", "tilt_angle", "count_time"):
        data.attrs[f"{name}_indices"] = 0


def _fill_reflectance(entry: Any, columns: Mapping[str, FloatArray]) -> None:  # noqa: ANN401
    group = _group(entry, "reflectance", "NXdata")
    group.attrs["signal"], group.attrs["axes"] = "brdf", ["pose"]
    group["pose"] = np.arange(len(columns["value"]))
    for column, values in columns.items():
        unit = next((unit for unit in ("deg", "nm") if column.endswith(f"_{unit}")), "1/sr")
        name = {"value": "brdf", "u": "brdf_errors"}.get(column, column.removesuffix(f"_{unit}"))
        _column(group, name, list(values), unit)
        group.attrs[f"{name}_indices"] = 0


def _column(group: Any, name: str, values: list[float], unit: str) -> Any:  # noqa: ANN401
    column = group.create_dataset(name, data=np.asarray(values, dtype=float))
    column.attrs["units"] = unit
    return column
