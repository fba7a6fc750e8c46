"""The process in which other people's decoders run: ``python -m anisoscope.profiles.files.decoder_worker``.

It answers requests, one JSON line each on standard input, with one line each on what was standard output when it
began; what a decoder prints goes to the null device. Where the kernel can limit memory and time of a process it
does, so that a damaged file can stop this process only; elsewhere its parent stops it when it takes too long.
"""

import json
import logging
import os
import sys
import warnings
from pathlib import Path
from typing import Any

import numpy as np

from anisoscope.base.errors import HeightMapError
from anisoscope.profiles.files.units import chosen_channel

MAX_POINTS = 250_000_000
PARK_TAG = 50432
"""Of pictures of Park Systems, whose heights are in another tag."""
OF_ANOTHER_KIND = ("FileFormatMismatch", "UnsupportedFormatFeature", "CannotDetectFileFormat")
"""Errors of the library at files that may well be whole."""


class Unsuitable(Exception):
    """The file holds something else than one map of heights; the text is meant for the user."""


def _prepare(kind: str) -> str:
    """Import the decoder of a kind and return its name."""
    if kind == "library":
        import SurfaceTopography  # type: ignore[import-untyped]  # noqa: PLC0415 - only what the format needs
        import SurfaceTopography.IO  # type: ignore[import-untyped]  # noqa: PLC0415 - only what the format needs

        return f"SurfaceTopography {SurfaceTopography.__version__}"
    if kind == "tiff":
        import tifffile  # noqa: PLC0415 - only what the format needs

        return f"tifffile {tifffile.__version__}"
    if kind == "exr":
        import OpenEXR  # noqa: PLC0415 - an extra

        return f"OpenEXR {OpenEXR.__version__}"
    if kind == "datx-intensity":
        import h5py  # noqa: PLC0415 - only what the format needs

        return f"h5py {h5py.__version__}"
    if kind == "mesh":
        import pyvista  # noqa: PLC0415 - only what the format needs

        return f"VTK {'.'.join(map(str, pyvista.vtk_version_info))}"
    import cv2  # noqa: PLC0415 - only what the format needs

    return f"OpenCV {cv2.__version__}"


def _open_library(path: str, format_: str | None) -> Any:  # noqa: ANN401 - the library has no types
    """A reader of the library; without a format, of those that know the first bytes of the file."""
    from SurfaceTopography.IO import MAGIC_BUFFER_SIZE, MagicMatch, lookup_reader_by_format  # noqa: PLC0415 - only what the format needs

    if format_ is not None:
        return lookup_reader_by_format[format_](path)
    with Path(path).open("rb") as stream:
        head = stream.read(MAGIC_BUFFER_SIZE)
    for reader in lookup_reader_by_format.values():
        if reader.can_read(head) == MagicMatch.YES:
            return reader(path)
    raise Unsuitable("not recognised by its first bytes")


def _metadata(info: dict[str, Any]) -> dict[str, Any]:
    """Instrument and date that the file gives, as plain texts."""
    given = info.get("instrument")
    names = {"vendor": "manufacturer", "name": "model", "serial": "serial", "software": "version"}
    instrument = {
        names[key]: str(value)[:100]
        for key, value in (given if isinstance(given, dict) else {}).items()
        if key in names and value
    }
    metadata: dict[str, Any] = {"instrument": instrument} if instrument else {}
    if (when := info.get("acquisition_time")) is not None:
        metadata["date"] = when.isoformat() if hasattr(when, "isoformat") else str(when)[:40]
    return metadata


def _library(request: dict[str, Any]) -> tuple[dict[str, Any], np.ndarray[Any, Any]]:
    with _open_library(request["path"], request.get("format")) as reader:
        channel = reader.default_channel
        if (wanted := request.get("channel")) is not None:
            channel = reader.channels[chosen_channel("", wanted, [str(one.name) for one in reader.channels])]
        if channel.dim != 2:
            raise Unsuitable("a line scan, no height map")
        cols, rows = (int(count) for count in channel.nb_grid_pts)
        if rows * cols > min(MAX_POINTS, request["max_points"]):
            raise Unsuitable(f"claims {rows} × {cols} points")
        sizes = channel.physical_sizes
        unscaled = {} if sizes is not None else {"physical_sizes": (float(cols), float(rows))}
        surface = reader.topography(channel_index=channel.index, **unscaled)
        if not surface.is_uniform:
            raise Unsuitable("not on a regular grid")
        heights = np.ma.filled(np.ma.asarray(surface.heights(), dtype=np.float64), np.nan)
        stated = None if sizes is None else [float(surface.physical_sizes[1]) / rows,
                                             float(surface.physical_sizes[0]) / cols]  # fmt: skip
        answer = {
            "format": str(reader.format()),
            "unit": surface.unit if isinstance(surface.unit, str) else None,
            "pixel": stated,
            "channel": str(channel.name),
            "other_channels": [str(other.name) for other in reader.channels if other.index != channel.index],
            **_metadata(dict(surface.info)),
        }
    return answer, heights.T


def _datx_intensity(request: dict[str, Any]) -> tuple[dict[str, Any], np.ndarray[Any, Any]]:
    """The first intensity picture of a datx file, NaN where there is none."""
    import h5py  # noqa: PLC0415 - only what the format needs

    with h5py.File(request["path"], "r") as file:
        group = file.get("Data/Intensity")
        picture = next(iter(group.values()), None) if isinstance(group, h5py.Group) else None
        if picture is None:
            return {"none": True}, np.zeros((1, 1))
        if picture.ndim != 2 or picture.size > min(MAX_POINTS, request["max_points"]):
            raise Unsuitable(f"claims {picture.shape} points")
        values = picture[()].astype(np.float64)
        return {}, np.where(values == _no_data(picture), np.nan, values)


def _no_data(picture: Any) -> float:  # noqa: ANN401 - the library has no types
    """The number of points without intensity; NaN where none is stated."""
    stated = np.ravel(picture.attrs.get("No Data", np.nan))
    return float(stated[0]) if stated.size else float("nan")


def _exr(request: dict[str, Any]) -> tuple[dict[str, Any], np.ndarray[Any, Any]]:
    """Channels of an OpenEXR file next to each other, and the texts of its header."""
    import OpenEXR  # noqa: PLC0415 - an extra

    header = OpenEXR.File(request["path"], header_only=True).header()
    low, high = (np.array(corner, dtype=np.int64) for corner in header["dataWindow"])
    cols, rows = (int(count) for count in high - low + 1)
    if min(cols, rows) < 1 or rows * cols > min(MAX_POINTS, request["max_points"]):
        raise Unsuitable(f"claims {rows} × {cols} points")
    if isinstance(header.get("type"), OpenEXR.Storage) and header["type"] != OpenEXR.scanlineimage:
        raise Unsuitable("tiles or deep data; save plain scan lines")
    with OpenEXR.File(request["path"], separate_channels=True, num_threads=1) as file:
        channels = file.channels()
        names = request["channels"] or [one for one in ("Z", "Y") if one in channels][:1] or list(channels)
        if len(names) != 1 and not request["channels"]:
            raise Unsuitable(
                f"channels {', '.join(names)[:60]}; the heights are looked for in Z or Y, or a single one"
            )
        if any(name not in channels or channels[name].pixels.shape != (rows, cols) for name in names):
            raise Unsuitable(f"no channel {', '.join(names)} of {rows} × {cols} points")
        texts = {key: header[key] for key in ("comments", "heightMap") if isinstance(header.get(key), str)}
        raw, known = np.hstack([channels[name].pixels for name in names]), sorted(channels)
    kept = raw.astype(np.float32) if raw.dtype == np.float16 else raw
    return {**texts, "channels": known}, kept


def _tiff(request: dict[str, Any]) -> tuple[dict[str, Any], np.ndarray[Any, Any]]:
    import tifffile  # noqa: PLC0415 - only what the format needs

    size = Path(request["path"]).stat().st_size
    with tifffile.TiffFile(request["path"]) as file:
        if len(file.pages) != 1:
            raise Unsuitable(f"{len(file.pages)} pages; save the heights as a file of their own")
        page: Any = file.pages[0]
        if PARK_TAG in page.tags:
            return {"park": True}, np.zeros((1, 1))
        _check_page(page, size)
        description = str(getattr(page, "description", ""))
        return {"description": description}, page.asarray()


def _check_page(page: Any, size: int) -> None:  # noqa: ANN401 - tifffile's own type
    if page.dtype is None or page.dtype.kind not in "iuf" or page.dtype.itemsize < 2 or len(page.shape) != 2:
        raise Unsuitable(f"numbers of type {page.dtype}, shape {page.shape}; one channel of 16 bits or more")
    if page.shape[0] * page.shape[1] > MAX_POINTS:
        raise Unsuitable(f"claims {page.shape[0]} × {page.shape[1]} points")
    places = list(zip(page.dataoffsets, page.databytecounts, strict=True))
    if not places or any(start <= 0 or count <= 0 or start + count > size for start, count in places):
        raise Unsuitable("image data missing or beyond the end of the file; it is truncated or damaged")
    if page.compression == 1 and sum(count for _, count in places) < page.nbytes:
        raise Unsuitable("fewer image data than its dimensions need; it is truncated or damaged")


def _png(request: dict[str, Any]) -> tuple[dict[str, Any], np.ndarray[Any, Any]]:
    import cv2  # noqa: PLC0415 - only what the format needs

    raw = cv2.imdecode(np.fromfile(request["path"], np.uint8), cv2.IMREAD_UNCHANGED)
    if raw is None or raw.ndim != 2 or raw.dtype != np.uint16:
        raise Unsuitable("no grey picture of 16 bits")
    return {}, raw


def _colours(request: dict[str, Any]) -> tuple[dict[str, Any], np.ndarray[Any, Any]]:
    """Colours of a picture as numbers 0xRRGGBBAA."""
    import cv2  # noqa: PLC0415 - only what the format needs

    raw = cv2.imdecode(np.fromfile(request["path"], np.uint8), cv2.IMREAD_UNCHANGED)
    if raw is None or raw.dtype not in (np.uint8, np.uint16):
        raise Unsuitable("no picture of 8 or 16 bits")
    if raw.dtype == np.uint16:
        raw = raw // 256
    parts = raw[..., None] if raw.ndim == 2 else raw
    blue, green, red = (parts[..., min(k, parts.shape[2] - 1)].astype(np.uint32) for k in range(3))
    opaque = parts[..., 3].astype(np.uint32) if parts.shape[2] == 4 else np.uint32(255)
    return {}, red << 24 | green << 16 | blue << 8 | opaque


def _mesh(request: dict[str, Any]) -> tuple[dict[str, Any], np.ndarray[Any, Any]]:
    """Corners (n, 3) of a mesh, each once."""
    import pyvista  # noqa: PLC0415 - only what the format needs

    with Path(request["path"]).open("rb") as stream:
        is_ply = stream.read(3) == b"ply"
    mesh = (pyvista.PLYReader if is_ply else pyvista.STLReader)(request["path"]).read()
    points = np.asarray(getattr(mesh, "points", np.zeros((0, 3))), dtype=np.float64)
    if len(points) < 4:
        raise Unsuitable(f"{len(points)} corners, no mesh of a surface")
    return {"corners": len(points), "faces": int(mesh.n_cells)}, np.unique(points, axis=0)


DECODERS = {
    "mesh": _mesh,
    "datx-intensity": _datx_intensity,
    "exr": _exr,
    "colours": _colours,
    "library": _library,
    "tiff": _tiff,
    "png": _png,
}


def _limit(request: dict[str, Any]) -> None:
    """Memory above what is in use now, and seconds of processor time, after which the kernel stops this process."""
    if sys.platform != "linux":
        return
    import resource  # noqa: PLC0415 - not on Windows
    import signal  # noqa: PLC0415 - with resource

    pages = int(Path("/proc/self/statm").read_text().split()[0])
    limit = pages * resource.getpagesize() + int(request["memory_bytes"])
    hard = resource.getrlimit(resource.RLIMIT_AS)[1]
    resource.setrlimit(
        resource.RLIMIT_AS, (limit if hard == resource.RLIM_INFINITY else min(limit, hard), hard)
    )
    signal.setitimer(signal.ITIMER_PROF, float(request["seconds"]))


def _unlimit() -> None:
    if sys.platform != "linux":
        return
    import resource  # noqa: PLC0415 - not on Windows
    import signal  # noqa: PLC0415 - with resource

    signal.setitimer(signal.ITIMER_PROF, 0.0)
    hard = resource.getrlimit(resource.RLIMIT_AS)[1]
    resource.setrlimit(resource.RLIMIT_AS, (hard, hard))


def _serve(request: dict[str, Any]) -> dict[str, Any]:
    """Decode one file into the npy file that the request names; every failure becomes a text."""
    try:
        if request.get("prepare"):
            return {"reader": _prepare(request["kind"])}
        _limit(request)
        answer, raw = DECODERS[request["kind"]](request)
        np.save(request["out"], raw, allow_pickle=False)
    except Unsuitable as error:
        return {"error": str(error), "healthy": True}
    except HeightMapError as error:
        return {"refused": str(error)}
    except MemoryError:
        return {"error": "takes more memory than a file of its size should"}
    except BaseException as error:  # noqa: BLE001 - a decoder may raise anything on a damaged file
        text, kind = " ".join(str(error).split())[:160], type(error).__name__
        return {"error": f"{kind}: {text}" if text else kind, "healthy": kind in OF_ANOTHER_KIND}
    else:
        return answer
    finally:
        _unlimit()


def main() -> None:
    """Answer requests until standard input ends."""
    warnings.simplefilter("ignore")
    logging.disable(logging.CRITICAL)
    sys.stdout.flush()
    with os.fdopen(os.dup(1), "w", encoding="utf-8") as answers:
        nothing = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nothing, 1)
        os.close(nothing)
        for line in sys.stdin:
            answers.write(json.dumps(_serve(json.loads(line))) + "\n")
            answers.flush()


if __name__ == "__main__":
    main()
