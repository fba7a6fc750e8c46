"""Small files of every format, made from known heights, and the folder of real ones."""

import importlib.util
import os
import struct
import zipfile
import zlib
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
import tifffile

from anisoscope.profiles.files.images import write_tiff
from anisoscope.profiles.files.load import write_height_map
from anisoscope.profiles.files.x3p import write_x3p
from anisoscope.profiles.heightmap import HeightMap

ROWS, COLS = 12, 17
PIXEL = (0.5, 0.25)  # (y, x) in µm
SQUARE = (0.5, 0.5)
COUNT = 2.0**-6  # µm; heights are whole numbers of it, so that every format holds them


@dataclass(frozen=True)
class Made:
    """How a made file of one format is written, read, and where its header lies."""

    suffix: str
    write: object
    header: int
    pixel: tuple = PIXEL
    missing: bool = True
    options: dict = field(default_factory=dict)
    tolerance: float = 1e-6
    first_row: str = "bottom"
    library: bool = False


def made_heights():
    """(rows, cols) heights in µm, two of them missing."""
    height = np.random.default_rng(3).integers(-500, 500, (ROWS, COLS)) * COUNT
    height[2, 3] = height[7, 11] = np.nan
    return height


def surface_of(height):
    return HeightMap(height, PIXEL[1], PIXEL[0], {"date": "2024-02-03T04:05:06"})


def counts(height, kind, missing):
    return np.where(np.isnan(height), missing, np.nan_to_num(height) / COUNT).astype(kind)


def sdf_text(path, height):
    body = "\n".join(" ".join(repr(z).replace("nan", "BAD") for z in row) for row in height.tolist())
    path.write_text(
        f"aISO-1.0\nManufacID = made\nCreateDate = 030220240405\nModDate = 030220240405\nNumPoints = {COLS}\n"
        f"NumProfiles = {ROWS}\nXscale = 0.25E-6\nYscale = 0.5E-6\nZscale = 1.0E-6\nZresolution = -1\n"
        f"Compression = 0\nDataType = 7\nCheckType = 0\n*\n{body}\n*\n"
    )


def sdf_binary(code, kind, missing):
    def write(path, height):
        scale = COUNT * 1e-6
        head = struct.pack("<8s10s12s12sHH4dBBB", b"bISO-1.0", b"made", b"030220240405", b"030220240405",
                           COLS, ROWS, 0.25e-6, 0.5e-6, scale, -1.0, 0, code, 0)  # fmt: skip
        path.write_bytes(head + counts(height, kind, missing).tobytes())

    return write


def plu(path, height):
    head = bytearray(500)
    head[:24] = b"Sat Feb 03 04:05:06 2024"
    struct.pack_into("<III7f", head, 388, ROWS, COLS, 9, 1.0, PIXEL[1], PIXEL[0], 0.0, 0.0, 0.0, 0.0)
    struct.pack_into("<5I", head, 428, 3, 3, 0, 14, 3)
    struct.pack_into("<5B", head, 488, 0, 1, 0xF9, 6, 0)
    data = np.where(np.isnan(height), 1000001.0, height).astype("<f4").tobytes()
    path.write_bytes(bytes(head) + struct.pack("<II", ROWS, COLS) + data + struct.pack("<2f", -8, 8))


def opd(path, height):
    array = np.where(np.isnan(height), 2e38, height / 0.5).T.astype("<f4").tobytes()
    blocks = [
        (b"Wavelength", 7, struct.pack("<f", 500.0)),
        (b"Aspect", 7, struct.pack("<f", 2.0)),
        (b"Pixel_size", 7, struct.pack("<f", PIXEL[1] * 1e-3)),
        (b"Whatever", 15, b"\x12\x01\x03Raw"),
        (b"Raw", 3, struct.pack("<HHH", COLS, ROWS, 4) + array),
        (b"Time", 5, b"04:05:06"),
        (b"Date", 5, b"2/3/2024"),
    ]
    entries = [struct.pack("<16shlH", name, kind, len(data), 8) for name, kind, data in blocks]
    head = struct.pack("<16shlH", b"Directory", 1, 24 * (len(blocks) + 1), 0xFFFF)
    path.write_bytes(b"\x01\x00" + head + b"".join(entries) + b"".join(data for _, _, data in blocks))


def metropro(path, height):
    head = bytearray(834)
    head[:4] = b"\x88\x1b\x03\x6f"
    struct.pack_into(">HI", head, 4, 1, 834)
    struct.pack_into(">hhHHHhI", head, 48, 0, 0, 3, 2, 1, 255, 12)
    struct.pack_into(">hhHHIi", head, 64, 0, 0, COLS, ROWS, 4 * ROWS * COLS, 1706933106)
    struct.pack_into(">6f", head, 164, 0.5, 2.0**-20, 0.0, 1.0, 0.0, SQUARE[0] * 1e-6)
    struct.pack_into(">h", head, 218, 1)
    step_um = 0.5 * 2.0**-20 * 1e6 / 32768
    phase = np.where(np.isnan(height), 2147483640, np.rint(np.nan_to_num(height) / step_um)).astype(">i4")
    path.write_bytes(bytes(head) + bytes(12) + phase.tobytes())


def nms(path, height):
    head = bytearray(3468)
    low, high = 1, 65535
    bottom, top = -32767 * COUNT, 32767 * COUNT
    struct.pack_into("<BxxxBxxxiidd", head, 0, 2, 1, low, high, bottom, top)
    head[32:41] = b"OM_MS_2.0"
    struct.pack_into("<iidd", head, 1368, COLS, ROWS, PIXEL[1] * 1e3, PIXEL[0] * 1e3)
    path.write_bytes(bytes(head) + counts(height + 32768 * COUNT, "<u2", 0).tobytes())


def xyz(path, height):
    rows, cols = np.nonzero(np.isfinite(height))
    lines = (f"{c * PIXEL[1]} {r * PIXEL[0]} {height[r, c]}" for r, c in zip(rows, cols, strict=True))
    path.write_text("\n".join(lines) + "\n")


def png(path, height):
    import cv2

    cv2.imwrite(str(path), counts(np.nan_to_num(height) + 1000 * COUNT, np.uint16, 0))


def tiff_counts(path, height):
    tifffile.imwrite(path, counts(np.nan_to_num(height), np.int16, 0), metadata=None)


def sur(path, height):
    units = struct.pack("<16s16s16s16s16s16s16s16s16s", b"X", b"Y", b"Z", *[b"um"] * 6)
    head = struct.pack("<12sHHHH30s30sHHHHHIIHiiiiIfff", b"DIGITAL SURF", 0, 1, 1, 2, b"made", b"made",
                       0, 0, 0, 1, 1, 0, 0, 32, -600, 600, COLS, ROWS, ROWS * COLS, *PIXEL[::-1], COUNT)  # fmt: skip
    tail = struct.pack("<fffHHHIIIHHHHHHHfIIHHH128sfff34s", 1, 1, 1, 0, 0, 0, 0, 0, 0, 6, 5, 4, 3, 2, 2024, 6,
                       1.0, 0, 0, 0, 0, 0, b"", 0, 0, 0, b"")  # fmt: skip
    path.write_bytes(head + units + tail + counts(height, "<i4", -602).tobytes())


def sur_packed(path, height):
    """The same with its heights in three zlib blocks of unequal size."""
    sur(path, height)
    plain = bytearray(path.read_bytes())
    plain[:12] = b"DSCOMPRESSED"
    parts = [bytes(plain[a:b]) for a, b in ((512, 700), (700, 1000), (1000, len(plain)))]
    packed = [zlib.compress(part) for part in parts]
    directory = b"".join(struct.pack("<II", len(a), len(b)) for a, b in zip(parts, packed, strict=True))
    path.write_bytes(bytes(plain[:512]) + struct.pack("<I", 3) + directory + b"".join(packed))


def al3d(path, height):
    padded = (COLS * 4 + 7) // 8 * 2
    tags = {"Cols": COLS, "Rows": ROWS, "PixelSizeXMeter": PIXEL[1] * 1e-6, "PixelSizeYMeter": PIXEL[0] * 1e-6,
            "InvalidPixelValue": "-1e9", "DepthImageOffset": 17 + 52 * 8 + 256}  # fmt: skip
    tags = {"Version": 1, "TagCount": len(tags), **tags}
    body = b"".join(
        struct.pack("<20s30s2s", key.encode(), str(value).encode(), b"\r\n") for key, value in tags.items()
    )
    data = np.zeros((ROWS, padded), "<f4")
    data[:, :COLS] = np.where(np.isnan(height), -1e9, height * 1e-6)
    path.write_bytes(b"AliconaImaging\0\r\n" + body + bytes(254) + b"\r\n" + data.tobytes())


def os3d(path, height):
    texts = b"".join(struct.pack("<I", len(text)) + text for text in (b"made", b"2024-02-03"))
    data = np.where(np.isnan(height), -3.4e38, height).astype("<f4").tobytes()
    head = struct.pack("<10sii", b"OmniSurf3D", 1, 1) + texts
    path.write_bytes(head + struct.pack("<iidddd", COLS, ROWS, PIXEL[1], PIXEL[0], 0, 0) + data)


def tmd(path, height):
    head = struct.pack("<32s24sIIffff", b"Binary TrueMap Data File v2.0\r\n", b"Created by TrueMap v6\r\n",
                       COLS, ROWS, COLS * PIXEL[1] * 1e-3, ROWS * PIXEL[0] * 1e-3, 0, 0)  # fmt: skip
    path.write_bytes(head + (np.nan_to_num(height) * 1e-3).astype("<f4").tobytes())


def gelsight(path, height):
    head = struct.pack("<32sBIIffff", b"Binary TrueMap Data File v2.0\r\n", 0, COLS, ROWS, COLS * PIXEL[1] * 1e-3,
                       ROWS * PIXEL[0] * 1e-3, 0, 0)  # fmt: skip
    path.write_bytes(head + (np.nan_to_num(height) * 1e-3).astype("<f4").tobytes())


def gwyddion_text(path, height):
    """As Gwyddion's text export with its header writes it, tabs between heights in metres."""
    head = (f"# Channel: Height\n# Width: {COLS * PIXEL[1]:.2f} µm\n# Height: {ROWS * PIXEL[0]:.2f} µm\n"
            "# Value units: m\n")  # fmt: skip
    rows = ("\t".join(f"{z:.9e}" for z in row) for row in (np.nan_to_num(height) * 1e-6).tolist())
    path.write_text(head + "\n".join(rows) + "\n", encoding="utf-8")


def bcr(path, height):
    head = (f"fileformat = bcrf\nxpixels = {COLS}\nypixels = {ROWS}\nxlength = {COLS * PIXEL[1] * 1e3}\n"
            f"ylength = {ROWS * PIXEL[0] * 1e3}\nxunit = nm\nyunit = nm\nzunit = nm\nintelmode = 1\n")  # fmt: skip
    data = np.where(np.isnan(height), 1.9e38, height * 1e3).astype("<f4").tobytes()
    path.write_bytes(head.encode().ljust(2048, b"%") + data)


def plux(path, height):
    index = (
        f"<xml><GENERAL><DATE>Sat Feb 3 04:05:06 2024</DATE><IMAGE_SIZE_X>{COLS}</IMAGE_SIZE_X>"
        f"<IMAGE_SIZE_Y>{ROWS}</IMAGE_SIZE_Y><FOV_X>{PIXEL[1]}</FOV_X><FOV_Y>{PIXEL[0]}</FOV_Y></GENERAL>"
        "<LAYER_0><FILENAME_Z>LAYER_0.raw</FILENAME_Z></LAYER_0><INFO><ITEM_0><NAME>Device</NAME>"
        "<VALUE>made</VALUE></ITEM_0></INFO></xml>"
    )
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("index.xml", index)
        archive.writestr("LAYER_0.raw", height.astype("<f4").tobytes())


def datx(path, height):
    import h5py

    text = h5py.string_dtype("ascii")
    meta = [("Root", "Measurement", "{m}"), ("{m}", "Surface", "{s}"), ("{s}", "Path", "/Data/Surface/1")]
    converter = np.dtype([("category", text), ("unit", text), ("values", "<f8", (4,))])
    with h5py.File(path, "w") as file:
        table = np.array([tuple(s.encode() for s in row) for row in meta],
                         dtype=[("a", "S40"), ("b", "S40"), ("c", "S40")])  # fmt: skip
        file["MetaData"] = table
        data = file.create_dataset("/Data/Surface/1", data=np.where(np.isnan(height), 1e9, height * 1e3))
        data.attrs["No Data"] = np.array([1e9])
        data.attrs.create("Unit", ["NanoMeters"], dtype=text)
        for axis, size in (("X", PIXEL[1]), ("Y", PIXEL[0])):
            value = np.array([(b"LateralCat", b"Pixels", (0, size * 1e-6, 0, 0))], dtype=converter)
            data.attrs.create(f"{axis} Converter", value)
        data.attrs.create(
            "Z Converter", np.array([(b"HeightCat", b"NanoMeters", (0, 1, 0, 0))], dtype=converter)
        )


def vk4(path, height):
    start = 12 + 17 * 4 + 4 + 80 * 4
    offsets = [84] + [0] * 5 + [start] + [0] * 10
    settings = [0] * 80
    settings[0:7] = [320, 2024, 2, 3, 4, 5, 6]
    settings[42:45] = [int(PIXEL[1] * 1e6), int(PIXEL[0] * 1e6), int(COUNT * 1e6)]
    image = struct.pack("<7I", COLS, ROWS, 32, 0, ROWS * COLS * 4, 0, 0) + bytes(768)
    body = b"VK4_" + bytes(8) + struct.pack("<17I", *offsets) + bytes(4) + struct.pack("<80I", *settings)
    path.write_bytes(body + image + counts(np.nan_to_num(height) + 500 * COUNT, "<u4", 0).tobytes())


def gwy(path, height):
    def item(key, code, data):
        return key.encode() + b"\0" + code.encode() + data

    def thing(kind, *items):
        joined = b"".join(items)
        return kind.encode() + b"\0" + struct.pack("<I", len(joined)) + joined

    metre = thing("GwySIUnit", item("unitstr", "s", b"m\0"))
    data = struct.pack("<I", height.size) + (np.nan_to_num(height) * 1e-6).astype("<f8").tobytes()
    area = thing(
        "GwyDataField",
        item("xres", "i", struct.pack("<i", COLS)), item("yres", "i", struct.pack("<i", ROWS)),
        item("xreal", "d", struct.pack("<d", COLS * PIXEL[1] * 1e-6)),
        item("yreal", "d", struct.pack("<d", ROWS * PIXEL[0] * 1e-6)),
        item("si_unit_xy", "o", metre), item("si_unit_z", "o", metre), item("data", "D", data),
    )  # fmt: skip
    path.write_bytes(
        b"GWYP" + thing("GwyContainer", item("/0/data", "o", area), item("/0/data/title", "s", b"made\0"))
    )


def zmg(path, height):
    head = struct.pack("<16s69sII4sfff8sI10s68s6s", b"Zeta-Instruments", b"", COLS, ROWS, b"", PIXEL[1], PIXEL[0],
                       COUNT, b"", 0, b"", b"made", b"")  # fmt: skip
    path.write_bytes(head + counts(np.nan_to_num(height) + 500 * COUNT, "<u2", 0).tobytes())


def by_suffix(path, height):
    write_height_map(surface_of(height), path)


def own(suffix, write, header, **more):
    return Made(suffix, write, header, **more)


def library(suffix, write, header, **more):
    return Made(suffix, write, header, first_row="top", library=True, **more)


def sxm(path, height):
    head = (
        f":NANONIS_VERSION:\n2\n:SCAN_PIXELS:\n{COLS} {ROWS}\n:SCAN_RANGE:\n{COLS * 0.25e-6} {ROWS * 0.5e-6}\n"
        ":SCAN_DIR:\ndown\n:DATA_INFO:\n\tChannel\tName\tUnit\tDirection\n\t14\tZ\tm\tfwd\n:SCANIT_END:\n\n"
    )
    path.write_bytes(head.encode() + b"\x1a\x04" + (height * 1e-6).astype(">f4").tobytes())


def zygo_text(path, height):
    head = ["Zygo XYZ Data File - Format 1", "0 9 2 0", "0 0 0 0 0 0", f"0 0 {COLS} {ROWS}", *['""'] * 3]
    head += ["0 0.5 6.328e-07 0.5 1 0 5e-07 1", *["0"] * 5, "#"]
    lines = [
        f"{j} {i} {'No Data' if np.isnan(z) else repr(z)}"
        for i, row in enumerate(height.tolist())
        for j, z in enumerate(row)
    ]
    path.write_text("\n".join([*head, *lines, "#", ""]), encoding="utf-8")


MADE = {
    "x3p": own(".x3p", by_suffix, 2000),
    "x3p-text": own(".x3p", lambda path, height: write_x3p(surface_of(height), path, text=True), 2000),
    "sdf-text": own(".sdf", sdf_text, 230),
    "sdf-int16": own(".sdf", sdf_binary(5, "<i2", -(2**15)), 81),
    "sdf-int32": own(".sdf", sdf_binary(6, "<i4", -(2**31)), 81),
    "sdf-float": own(".sdf", sdf_binary(3, "<f4", -3.402823e38), 81),
    "sdf-double": own(".sdf", sdf_binary(7, "<f8", -1.7976931348623157e308), 81),
    "gsf": own(".gsf", by_suffix, 120),
    "plu": own(".plu", plu, 508, first_row="top"),
    "opd": own(".opd", opd, 218),
    "metropro": own(".dat", metropro, 240, pixel=SQUARE, first_row="top"),
    "nms": own(".nms", nms, 1420, first_row="top"),
    "npy": own(".npy", by_suffix, 128, options={"pixel_um": PIXEL}),
    "npz": own(".npz", by_suffix, 400),
    "csv": own(".csv", by_suffix, 78),
    "xyz": own(".xyz", xyz, 400),
    "tiff": own(".tif", lambda path, height: write_tiff(surface_of(height), path), 240),
    "tiff-counts": own(".tif", tiff_counts, 224, missing=False, first_row="top",
                       options={"pixel_um": PIXEL, "height_per_count": COUNT}),
    "png": own(".png", png, 60, missing=False, first_row="top",
               options={"pixel_um": PIXEL, "height_per_count": COUNT}),
    "sur": own(".sur", sur, 512, first_row="top"),
    "sur-packed": own(".sur", sur_packed, 560, first_row="top"),
    "gwy": own(".gwy", gwy, 180, missing=False, first_row="top"),
    "tmd": own(".tmd", tmd, 80, missing=False, first_row="top"),
    "tmd-gelsight": own(".tmd", gelsight, 57, missing=False, first_row="top"),
    "gwyddion-text": own(".txt", gwyddion_text, 90, missing=False, first_row="top"),
    **({"exr": own(".exr", by_suffix, 340)} if importlib.util.find_spec("OpenEXR") else {}),
    "sxm": own(".sxm", sxm, 200, first_row="top"),
    "zygo-text": own(".txt", zygo_text, 150, pixel=SQUARE, first_row="top"),
    "al3d": library(".al3d", al3d, 450),
    "os3d": library(".os3d", os3d, 80),
    "bcr": library(".bcrf", bcr, 200),
    "plux": library(".plux", plux, 500),
    "datx": library(".datx", datx, 2408),
    "vk4": library(".vk4", vk4, 440, missing=False),
    "zmg": library(".zmg", zmg, 205, missing=False),
}  # fmt: skip

DEFAULT = Path(__file__).resolve().parents[2].parent / "shared" / "data" / "heightmaps"
REAL = Path(os.environ.get("ANISOSCOPE_TEST_DATA", DEFAULT))


def pytest_generate_tests(metafunc):
    for name, kinds in (("made", (False, True)), ("made_own", (False,)), ("made_library", (True,))):
        if name in metafunc.fixturenames:
            chosen = {key: value for key, value in MADE.items() if value.library in kinds}
            metafunc.parametrize(name, list(chosen.values()), ids=list(chosen))


@pytest.fixture
def made_files():
    return MADE


@pytest.fixture
def heights():
    return made_heights()


@pytest.fixture
def real_file():
    def find(name):
        if not (REAL / name).exists():
            pytest.skip(f"{REAL / name} is not there")
        return REAL / name

    return find
