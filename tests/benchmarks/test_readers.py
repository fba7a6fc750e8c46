"""Our readers against the bare work (bytes to float64 array) and SurfaceTopography: `make benchmark` prints both.

The bare work reads the file and makes a scaled float64 array of its numbers, with no checks; for x3p it also
unpacks. SurfaceTopography is timed in this process, imported, from path to array; what the guarded process adds
to it is timed apart.
"""

import struct
import warnings
import zipfile

import numpy as np
import pytest

from anisoscope.profiles.files.arrays import read_array
from anisoscope.profiles.files.gsf import read_gsf
from anisoscope.profiles.files.library import read_library
from anisoscope.profiles.files.load import read_height_map, write_height_map
from anisoscope.profiles.files.metropro import read_metropro
from anisoscope.profiles.files.opd import read_opd
from anisoscope.profiles.files.plu import read_plu
from anisoscope.profiles.files.sdf import read_sdf
from anisoscope.profiles.files.x3p import read_x3p
from anisoscope.profiles.heightmap import HeightMap

pytestmark = pytest.mark.benchmark
ROWS, COLS = 1500, 2000
PIXEL = (0.5, 0.5)
RATIO = 3.0  # beyond the bare numbers: what was not measured is marked, the range is checked


def heights():
    return np.round(np.random.default_rng(1).normal(0.0, 3.0, (ROWS, COLS)), 3)


def sdf(path, height):
    head = struct.pack(
        "<8s10s12s12sHH4dBBB", b"bISO-1.0", b"", b"", b"", COLS, ROWS, 5e-7, 5e-7, 1e-6, -1, 0, 7, 0
    )
    path.write_bytes(head + height.astype("<f8").tobytes())


def plu(path, height):
    head = bytearray(500)
    head[:24] = b"Sat Feb 03 04:05:06 2024"
    struct.pack_into("<III7f", head, 388, ROWS, COLS, 9, 1.0, 0.5, 0.5, 0, 0, 0, 0)
    struct.pack_into("<I", head, 428, 3)
    head[489] = 1
    path.write_bytes(bytes(head) + struct.pack("<II", ROWS, COLS) + height.astype("<f4").tobytes() + bytes(8))


def opd(path, height):
    blocks = [
        (b"Wavelength", 7, struct.pack("<f", 500.0)),
        (b"Pixel_size", 7, struct.pack("<f", 5e-4)),
        (b"Raw", 3, struct.pack("<HHH", COLS, ROWS, 4) + height.T.astype("<f4").tobytes()),
    ]
    entries = [struct.pack("<16shlH", name, kind, len(data), 8) for name, kind, data in blocks]
    head = struct.pack("<16shlH", b"Directory", 1, 24 * (len(blocks) + 1), 0xFFFF)
    path.write_bytes(b"\x01\x00" + head + b"".join(entries) + b"".join(data for _, _, data in blocks))


def metropro(path, height):
    head = bytearray(834)
    head[:4] = b"\x88\x1b\x03\x6f"
    struct.pack_into(">HI", head, 4, 1, 834)
    struct.pack_into(">hhHHI", head, 64, 0, 0, COLS, ROWS, 4 * ROWS * COLS)
    struct.pack_into(">6f", head, 164, 0.5, 6e-7, 0.0, 1.0, 0.0, 5e-7)
    path.write_bytes(bytes(head) + (height * 1e4).astype(">i4").tobytes())


def numbers(kind, offset, factor):
    def bare(path):
        raw = np.frombuffer(path.read_bytes(), kind, ROWS * COLS, offset).reshape(ROWS, COLS)
        return raw.astype(np.float64) * factor

    return bare


def columns(path):
    raw = np.frombuffer(path.read_bytes(), "<f4", ROWS * COLS, 2 + 24 * 4 + 8 + 6).reshape(COLS, ROWS).T
    return np.ascontiguousarray(raw, dtype=np.float64) * 0.5


def unpacked(path):
    with zipfile.ZipFile(path) as archive:
        raw = np.frombuffer(archive.read("bindata/data.bin"), "<f8", ROWS * COLS).reshape(ROWS, COLS)
    return raw.astype(np.float64) * 1e6


CASES = {
    "x3p": (".x3p", write_height_map, read_x3p, unpacked),
    "sdf": (".sdf", sdf, read_sdf, numbers("<f8", 81, 1.0)),
    "gsf": (".gsf", write_height_map, read_gsf, numbers("<f4", 120, 1e6)),
    "plu": (".plu", plu, read_plu, numbers("<f4", 508, 1.0)),
    "opd": (".opd", opd, read_opd, columns),
    "metropro": (".dat", metropro, read_metropro, numbers(">i4", 834, 0.5e-6)),
    "npy": (
        ".npy",
        write_height_map,
        lambda path: read_array(path, pixel_um=PIXEL),
        numbers("<f8", 128, 1.0),
    ),
}


def by_library(path, key):
    """What SurfaceTopography does from path to array."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from SurfaceTopography.IO import lookup_reader_by_format

    def work():
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            with lookup_reader_by_format[key](path) as reader:
                return np.ma.filled(np.ma.asarray(reader.topography().heights()), np.nan)

    return work


@pytest.mark.parametrize("case", CASES)
def test_own_readers_against_the_bare_work_and_the_library(bench, case, tmp_path):
    suffix, write, read, bare = CASES[case]
    path = tmp_path / f"a{suffix}"
    height = heights()
    write(HeightMap(height, *PIXEL) if write is write_height_map else path, *(
        [path] if write is write_height_map else [height]))  # fmt: skip
    options = {"pixel_um": PIXEL} if case == "npy" else {}
    works = {
        "reader": lambda: read(path),
        "bare": lambda: bare(path),
        "with sha256 and rows turned": lambda: read_height_map(path, **options),
    }
    if case not in ("gsf", "npy"):
        works["SurfaceTopography"] = by_library(path, case)
    found = bench.compare(f"{case}, {ROWS} × {COLS}", works, rounds=10)
    assert found.wall_ratio("reader", "bare") < RATIO


def test_what_the_guarded_process_costs(bench, tmp_path):
    path = tmp_path / "a.plu"
    plu(path, heights())
    bench.compare(
        f"plu, {ROWS} × {COLS}, read by SurfaceTopography",
        {"guarded process": lambda: read_library(path, key="plu"), "this process": by_library(path, "plu")},
    )


def test_x3p_of_ten_million_points(bench, tmp_path):
    rng, path = np.random.default_rng(1), tmp_path / "a.x3p"

    def surface(side):
        return HeightMap(np.round(rng.normal(0.0, 3.0, (side, side)), 3), *PIXEL)

    maps = {side**2: surface(side) for side in (1000, 3163)}
    bench.growth(
        "writing x3p",
        "points",
        {size: lambda one=one: write_height_map(one, path) for size, one in maps.items()},
    )
    paths = {size: tmp_path / f"{size}.x3p" for size in maps}
    for size, one in maps.items():
        write_height_map(one, paths[size])
    bench.growth(
        "reading x3p", "points", {size: lambda one=one: read_height_map(one) for size, one in paths.items()}
    )
