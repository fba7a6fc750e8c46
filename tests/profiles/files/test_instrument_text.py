"""Texts of Zygo, Wyko, Keyence and ESRI, written here by the published layouts, and encodings of text files."""

import codecs

import numpy as np
import pytest

from anisoscope.base.errors import HeightMapError
from anisoscope.profiles.files.load import read_height_map

HEIGHTS = np.array([[1.0, 2.0, 3.5], [4.0, np.nan, 6.25]])
"""In µm, the first row at the top."""
UPRIGHT = HEIGHTS[::-1]


def words(rows, missing, factor=1.0):
    return [[missing if np.isnan(z) else f"{factor * z:.10g}" for z in row] for row in rows]


def zygo_header(kind, number, phase=1):
    lines = [
        f"Zygo {kind} Data File - Format {number}",
        '0 9 2 0 "Mon Mar 02 10:11:12 2020"',
        "0 0 0 0 0 0",
        "10 20 3 2",
        *['""'] * 3,
        "0 0.5 6.328e-07 0.5 1 0 4e-06 1583143872",
        '1200 1200 0 0 1 0 ""',
        "0 0 1 36 0 1 0 0 0 0",
        f"{phase} 1 100 0 0 0 0 0 0",
        '0 ""',
        "1 0.01",
    ]
    return [*lines, *(['""'] if number == 2 else []), "#"]


def zygo_points():
    lines = [
        f"{10 + j} {20 + i} {text}"
        for i, row in enumerate(words(HEIGHTS, "No Data"))
        for j, text in enumerate(row)
    ]
    return "\n".join([*zygo_header("XYZ", 1), *lines, "#", ""])


def zygo_phases(resolution=1):
    steps = {0: 4096, 1: 32768, 2: 131072}[resolution]
    phase = np.where(np.isnan(HEIGHTS), 2147483640, np.rint(HEIGHTS / (0.5 * 0.6328) * steps)).ravel()
    text = " ".join(str(int(one)) for one in phase[:4]) + "\n" + " ".join(str(int(one)) for one in phase[4:])
    return "\n".join([*zygo_header("ASCII", 2, resolution), "#", text, "#", ""])


def wyko(nanometres):
    factor = 1e3 if nanometres else 1e3 * 2.0 / 632.8
    rows = ["\t".join(row) for row in words(UPRIGHT.T, "Bad", factor)]
    head = [
        f"Wyko ASCII Data File Format 0\t{nanometres}\t1",
        "X Size\t3",
        "Y Size\t2",
        "Block Name\tType\tLength\tValue",
        "Pixel_size\t7\t4\t0.004",
        "Aspect\t7\t4\t0.5",
        "Wavelength\t7\t4\t632.8",
        "Mult\t7\t4\t2",
        "RAW_DATA\t3\t24\t",
    ]
    return "\n".join([*head, *rows, ""])


def keyence(german=False, title=None):
    width, height, pixel, unit, block = (
        ("Horizont.", "Vertikal", "XY-Justierung", "Einheit", "Höhe")
        if german
        else ("Horizontal", "Vertical", "XY Calibration", "Unit", "Height")
    )
    lines = [
        '"Measured date","2020-03-02 10:11:12"',
        '"Model","VK-X3000 Series"',
        f'"{pixel}","4000.000","nm"',
        f'"{width}","3"',
        f'"{height}","2"',
        f'"{unit}","um"',
        '"Reference data name",""',
        "",
        f'"{title or block}"',
        *(",".join(f'"{text}"' for text in row) for row in words(HEIGHTS, "")),
    ]
    return "\r\n".join([*lines, ""])


def esri():
    rows = [" ".join(row) for row in words(HEIGHTS, "-9999", 1e-3)]
    head = ["ncols 3", "nrows 2", "xllcorner 0.0", "yllcorner 0.0", "cellsize 0.004", "NODATA_value -9999"]
    return "\n".join([*head, *rows, ""])


@pytest.mark.parametrize(
    ("name", "text", "options", "pixel", "tolerance"),
    [
        ("a.xyz", zygo_points(), {}, (4.0, 4.0), 1e-9),
        ("a.asc", zygo_phases(), {}, (4.0, 4.0), 1e-5),
        ("b.asc", zygo_phases(0), {}, (4.0, 4.0), 1e-4),
        ("w.asc", wyko(0), {}, (2.0, 4.0), 1e-6),
        ("n.txt", wyko(1), {}, (2.0, 4.0), 1e-6),
        ("k.csv", keyence(), {}, (4.0, 4.0), 1e-9),
        ("d.csv", keyence(german=True), {}, (4.0, 4.0), 1e-9),
        ("e.asc", esri(), {"xy_unit": "mm"}, (4.0, 4.0), 1e-9),
        ("f.asc", esri(), {"xy_unit": "mm", "z_unit": "mm"}, (4.0, 4.0), 1e-9),
    ],
)
def test_texts_of_instruments(tmp_path, name, text, options, pixel, tolerance):
    path = tmp_path / name
    path.write_text(text, encoding="utf-8", newline="")
    surface = read_height_map(path, **options)
    np.testing.assert_allclose(surface.height_um, UPRIGHT, rtol=0, atol=tolerance)
    assert (surface.pixel_y_um, surface.pixel_x_um) == pytest.approx(pixel)
    with pytest.raises(HeightMapError, match="pixel"):
        read_height_map(path, pixel_um=(1.0, 1.0), **options)


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("a.asc", esri(), r"a\.asc: units: an ESRI grid states none; say that of cellsize with --xy-unit"),
        ("a.asc", esri().replace("nrows 2", "nrows 3"), "units"),
        ("k.csv", keyence(title="Laser intensity"), r"k\.csv: block: 'Laser intensity'; a block of heights"),
        ("k.csv", keyence().replace('"Unit","um"', '"Unit","counts"'), "'counts' is no length"),
        ("z.xyz", zygo_points().replace("\n#", "\n"), "no line # after it"),
        ("z.xyz", zygo_points().replace("10 20 1", "9 20 1"), r"line 15: point 9, 20; beyond 3 × 2 points"),
        ("z.asc", zygo_phases()[:-30], "numbers for 2 × 3 points"),
        ("z.asc", zygo_phases().replace("1 1 100 0", "7 1 100 0"), "phase resolution: 7"),
        ("w.asc", wyko(0).replace("RAW_DATA", "Intensity"), "no RAW_DATA"),
        ("w.asc", wyko(0).replace("0.004", "zero"), "'zero' is no number"),
    ],
)
def test_texts_that_do_not_fit_their_headers(tmp_path, name, text, message):
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    with pytest.raises(HeightMapError, match=message) as caught:
        read_height_map(path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("mark", [codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE])
def test_utf_16(tmp_path, mark):
    order = "utf-16-le" if mark == codecs.BOM_UTF16_LE else "utf-16-be"
    path = tmp_path / "a.txt"
    path.write_bytes(mark + "X (mm)\tY (mm)\tZ (µm)\r\n0\t0\t1\r\n0.001\t0\t2\r\n".encode(order))
    with path.open("ab") as stream:
        stream.write("0\t0.001\t3\r\n0.001\t0.001\t5\r\n".encode(order))
    surface = read_height_map(path)
    np.testing.assert_allclose(surface.height_um, [[1.0, 2.0], [3.0, 5.0]])
    assert surface.pixel_x_um == pytest.approx(1.0)


def test_exponents_of_fortran(tmp_path):
    path = tmp_path / "a.txt"
    path.write_text("1.5D-01 2.5d+00\n-3.0D0 4\n", encoding="utf-8")
    found = read_height_map(path, pixel_um=(1.0, 1.0)).height_um
    np.testing.assert_allclose(found, [[0.15, 2.5], [-3.0, 4.0]])
    path.write_text("1.5D-01 2.5.1d+00\n-3.0D0 4\n", encoding="utf-8")
    with pytest.raises(HeightMapError, match=r"line 1: '2\.5\.1d\+00' is no number"):
        read_height_map(path, pixel_um=(1.0, 1.0))
