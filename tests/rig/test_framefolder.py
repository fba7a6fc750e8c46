"""Folders of frames: what other programs write gets in, what cannot be trusted is told with its line."""

import struct
import zlib
from dataclasses import replace

import cv2
import numpy as np
import pytest
import tifffile

from anisoscope.base.errors import RecordError, UsageError
from anisoscope.rig.frame import Frame
from anisoscope.rig.framefolder import read_frame_folder, write_frame_folder

HEADER = "file,kind,stage_deg,tilt_deg,exposure_s,gain,bit_depth,black_level"


def picture(seed=0, full_scale=4095, shape=(6, 8), dtype=np.uint16):
    return np.random.default_rng(seed).integers(0, full_scale, shape, endpoint=True).astype(dtype)


def line(name, kind="sample", stage=0, rest="0,0.01,1,12,64"):
    return f"{name},{kind},{stage},{rest}"


def make(folder, *lines, header=HEADER, files=True):
    """A folder with a table; every file that is named is there."""
    for number, text in enumerate(lines):
        if files:
            path = folder / text.split(",")[0].strip().strip('"')
            path.parent.mkdir(exist_ok=True)
            tifffile.imwrite(path, picture(number))
    (folder / "frames.csv").write_text("\n".join([header, *lines, ""]), encoding="utf-8")
    return folder


def refused(folder):
    with pytest.raises(RecordError) as caught:
        read_frame_folder(folder)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def frame(stage_deg=0.0, kind="sample", seed=0, **changes):
    counts = picture(seed)
    made = Frame(
        counts, kind, 12, 64.0, 0.02, 1.5, stage_deg, round(stage_deg), 0.0, "2025-01-02T03:04", "C 7"
    )
    return replace(made, **changes)


# -- reading ---------------------------------------------------------------------------------------------------


def test_entries_come_in_the_order_of_the_table_with_their_numbers(tmp_path):
    make(
        tmp_path, line("b.tif", "dark"), line("a.tif", "stray"), "c.tif,reference,90.5,-20,2.5e-3,1.25,16,0.5"
    )
    read = read_frame_folder(tmp_path)
    assert [(entry.path.name, entry.kind) for entry in read.entries] == [
        ("b.tif", "dark"),
        ("a.tif", "stray"),
        ("c.tif", "reference"),
    ]
    assert (read.rows, read.cols, read.notes) == (6, 8, ())
    loaded = read.entries[2].load()
    assert (loaded.stage_deg, loaded.tilt_deg, loaded.exposure_s, loaded.gain) == (90.5, -20.0, 0.0025, 1.25)
    assert (loaded.bit_depth, loaded.black_level, loaded.kind) == (16, 0.5, "reference")
    np.testing.assert_array_equal(loaded.counts, picture(2))
    assert loaded.counts.dtype == np.uint16
    assert [entry.path.name for entry in read.of_kind("dark")] == ["b.tif"]


def test_what_a_spreadsheet_makes_of_a_table(tmp_path):
    (tmp_path / "in here").mkdir()
    for number, name in enumerate(("in here/my frame, one.tif", "Grün.tif", "in here/back.tif")):
        tifffile.imwrite(tmp_path / name, picture(number))
    lines = (
        "Kind , file,stage_deg,tilt_deg,exposure_s,gain,bit_depth,black_level,operator",
        '"sample", "in here/my frame, one.tif" , 0.0 ,0,0.01,1,12.0,64,"Ann ""B"""',
        ' DARK ,Grün.tif,0,0,1e-2,1,12,64,"two\r\nlines"',
        "",
        ",,,,,,,,",
        "sample,in here\\back.tif,90,0,0.01,1,12,64,",
    )
    (tmp_path / "frames.csv").write_bytes("\r\n".join(lines).encode("utf-8-sig"))
    read = read_frame_folder(tmp_path)
    assert [entry.path.name for entry in read.entries] == ["my frame, one.tif", "Grün.tif", "back.tif"]
    assert [entry.kind for entry in read.entries] == ["sample", "dark", "sample"]
    assert read.notes == (f"{tmp_path / 'frames.csv'}: columns passed over: operator",)


@pytest.mark.parametrize("byteorder", ["<", ">"])
@pytest.mark.parametrize("options", [{}, {"compression": "zlib", "predictor": True}, {"tile": (16, 16)}])
def test_tiff_files_of_all_sorts(tmp_path, byteorder, options):
    counts = picture(3, shape=(40, 24))
    odd = {"description": "\x00ü" * 3, "extratags": [(65000, 2, None, "x" * 99, True)], "metadata": None}
    odd["description"] = "käm".encode()
    tifffile.imwrite(tmp_path / "a.dat", counts, byteorder=byteorder, resolution=(0, 0), **odd, **options)
    make(tmp_path, line("a.dat"), files=False)
    (entry,) = read_frame_folder(tmp_path).entries
    np.testing.assert_array_equal(entry.load().counts, counts)


def test_tiff_compressed_by_other_programs(tmp_path):
    counts = picture(3, shape=(40, 24))
    assert cv2.imwrite(str(tmp_path / "a.tif"), counts, [cv2.IMWRITE_TIFF_COMPRESSION, 5])  # LZW
    make(tmp_path, line("a.tif"), files=False)
    np.testing.assert_array_equal(read_frame_folder(tmp_path).entries[0].load().counts, counts)


def chunk(kind, data):
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def png(counts, *chunks, bits=16, colour=0):
    rows, cols = counts.shape[:2]
    raw = b"".join(b"\0" + row.astype(">u2" if bits == 16 else "u1").tobytes() for row in counts)
    head = chunk(b"IHDR", struct.pack(">IIBBBBB", cols, rows, bits, colour, 0, 0, 0))
    return (
        b"\x89PNG\r\n\x1a\n"
        + head
        + b"".join(chunks)
        + chunk(b"IDAT", zlib.compress(raw))
        + chunk(b"IEND", b"")
    )


@pytest.mark.parametrize(
    "extra",
    [
        (),
        (chunk(b"gAMA", struct.pack(">I", 45455)),),
        (chunk(b"sRGB", b"\0"),),
        (chunk(b"sBIT", b"\x0c"),),
        (chunk(b"tIME", b"\0" * 7), chunk(b"pHYs", b"\0" * 9), chunk(b"tEXt", b"Title\0M\xfcll")),
        (chunk(b"bKGD", b"\0\7"),),
    ],
)
@pytest.mark.parametrize("bits", [8, 16])
def test_png_counts_are_what_was_stored_whatever_the_metadata_say(tmp_path, extra, bits):
    counts = picture(5, full_scale=(1 << bits) - 1)
    (tmp_path / "a.png").write_bytes(png(counts, *extra, bits=bits))
    make(tmp_path, f"a.png,sample,0,0,0.01,1,{bits},2", files=False)
    np.testing.assert_array_equal(read_frame_folder(tmp_path).entries[0].load().counts, counts)


# -- the return to the first pose ------------------------------------------------------------------------------


def marks(folder):
    return "".join(str(int(entry.again)) for entry in read_frame_folder(folder).entries)


@pytest.mark.parametrize(
    ("poses", "expected"),
    [
        ("0 0 90 90 180 0 0", "0000011"),
        ("0 90 180 360", "0001"),  # a full turn
        ("0 90 180 0.3", "0001"),  # what the stage reads back
        ("0 90 180 1.5", "0000"),
        ("0 90 0 180", "0000"),  # in the middle is no return at the end
        ("0 0 0", "000"),  # never left
        ("0", "0"),
    ],
)
def test_a_return_is_seen_without_a_column(tmp_path, poses, expected):
    make(tmp_path, *(line(f"{k}.tif", stage=deg) for k, deg in enumerate(poses.split())))
    assert marks(tmp_path) == expected


def test_only_sample_frames_return_and_tilt_counts(tmp_path):
    tilted = "20,0.01,1,12,64"
    make(
        tmp_path,
        line("0.tif", "dark"),
        line("1.tif"),
        line("2.tif", stage=90),
        line("3.tif", rest=tilted),
        line("4.tif", "flat"),
    )
    assert marks(tmp_path) == "00000"
    make(tmp_path, line("0.tif"), line("1.tif", stage=90), line("2.tif"), line("3.tif", "dark"))
    assert marks(tmp_path) == "0010"
    assert len(read_frame_folder(tmp_path).of_kind("sample", again=False)) == 2


def test_the_column_decides_where_there_is_one(tmp_path):
    header = HEADER + ",again"
    make(tmp_path, line("0.tif") + ",0", line("1.tif", stage=90) + ",0", line("2.tif") + ",0", header=header)
    assert marks(tmp_path) == "000"
    make(tmp_path, line("0.tif") + ",", line("1.tif") + ",1", header=header)
    assert marks(tmp_path) == "01"


@pytest.mark.parametrize(
    "lines",
    [
        [line("0.tif") + ",0", line("1.tif", stage=90) + ",1"],
        [line("0.tif") + ",1"],
        [line("0.tif", "dark") + ",0", line("1.tif", "dark") + ",1"],
    ],
)
def test_a_mark_that_cannot_be_true(tmp_path, lines):
    message = refused(make(tmp_path, *lines, header=HEADER + ",again"))
    assert f"line {len(lines) + 1}: again marks a later frame at the first pose" in message


# -- mistakes --------------------------------------------------------------------------------------------------


def test_no_folder_and_no_table(tmp_path):
    assert "there is no such folder" in refused(tmp_path / "no")
    assert "there is no frames.csv" in refused(tmp_path)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (b"", "line 1: the column file is missing"),
        (HEADER.replace("gain", "gian").encode(), "line 1: the column gain is missing; is 'gian' meant"),
        (HEADER.replace(",", ";").encode(), "line 1: columns are separated by commas"),
        ((HEADER + ",gain").encode(), "line 1: the column gain stands twice"),
        (HEADER.encode(), "line 1: no frames follow"),
        (HEADER.encode("utf-16"), "not a text file in UTF-8"),
        ((HEADER + "\n" + line("\0.tif")).encode(), "frames.csv, line"),
    ],
)
def test_tables_that_are_none(tmp_path, text, expected):
    (tmp_path / "frames.csv").write_bytes(text)
    assert expected in refused(tmp_path)


@pytest.mark.parametrize(
    ("bad", "expected"),
    [
        ("a.tif,sample,0,0,0.01,1,12", "8 values expected, 7 found"),
        ('a.tif,sample,"0,5",0,0.01,1,12,64', "stage_deg must be a number (with a point), not '0,5'"),
        ("a.tif,sample,0,nan,0.01,1,12,64", "tilt_deg must be a number"),
        ("a.tif,sample,0,0,,1,12,64", "exposure_s must be a number (with a point), not ''"),
        ("a.tif,sample,0,0,0,1,12,64", "exposure_s must be above 0, not '0'"),
        ("a.tif,sample,0,0,0.01,-1,12,64", "gain must be above 0"),
        ("a.tif,sample,0,0,0.01,1,12.5,64", "bit_depth must be a whole number from 1 to 16"),
        ("a.tif,sample,0,0,0.01,1,17,64", "bit_depth must be a whole number from 1 to 16"),
        ("a.tif,sample,0,0,0.01,1,12,4096", "black_level must lie from 0 to 4095"),
        ("a.tif,sampel,0,0,0.01,1,12,64", "unknown kind 'sampel'; it is one of sample, dark, flat"),
        (",sample,0,0,0.01,1,12,64", "the file has no name"),
        ("b.tif,sample,0,0,0.01,1,12,64", "there is no file b.tif"),
        ("../a.tif,sample,0,0,0.01,1,12,64", "../a.tif lies outside of"),
        ("/etc/hosts,sample,0,0,0.01,1,12,64", "/etc/hosts lies outside of"),
        ("C:\\data\\a.tif,sample,0,0,0.01,1,12,64", "lies outside of"),
        ("a.tif,dark,0,0,0.01,1,12,64", "a.tif stands already in line 2"),
        ("./a.tif,dark,0,0,0.01,1,12,64", "./a.tif stands already in line 2"),
    ],
)
def test_a_bad_line_is_told_with_its_number(tmp_path, bad, expected):
    folder = tmp_path / "frames"
    folder.mkdir()
    tifffile.imwrite(tmp_path / "a.tif", picture())
    tifffile.imwrite(folder / "a.tif", picture())
    (folder / "frames.csv").write_text(f"{HEADER}\n{line('a.tif')}\n\n{bad}\n")
    message = refused(folder)
    assert f"{folder / 'frames.csv'}, line 4: " in message
    assert expected in message


def test_a_link_that_leads_out(tmp_path):
    tifffile.imwrite(tmp_path / "a.tif", picture())
    folder = tmp_path / "frames"
    folder.mkdir()
    (folder / "a.tif").symlink_to(tmp_path / "a.tif")
    make(folder, line("a.tif"), files=False)
    assert "a.tif lies outside of" in refused(folder)


def spoil_shape(path):
    tifffile.imwrite(path, picture(shape=(6, 9)))


def spoil_left_justified(path):
    tifffile.imwrite(path, picture() << 4)


def spoil_too_bright(path):
    tifffile.imwrite(path, picture() + np.uint16(1001))


def spoil_eight_bits(path):
    tifffile.imwrite(path, picture(full_scale=255, dtype=np.uint8))


def spoil_float(path):
    tifffile.imwrite(path, picture().astype(np.float32))


def spoil_signed(path):
    tifffile.imwrite(path, picture().astype(np.int16))


def spoil_colour(path):
    tifffile.imwrite(path, np.zeros((6, 8, 3), np.uint16), photometric="rgb")


def spoil_two(path):
    tifffile.imwrite(path, np.zeros((2, 6, 8), np.uint16))


def spoil_inverted(path):
    tifffile.imwrite(path, picture(), photometric="miniswhite")


def spoil_cut(path):
    tifffile.imwrite(path, picture(shape=(64, 64)))
    path.write_bytes(path.read_bytes()[:300])


def spoil_text(path):
    path.write_bytes(b"P5 8 6 255 ")


def spoil_jpeg(path):
    path.write_bytes(cv2.imencode(".jpg", np.zeros((6, 8), np.uint8))[1].tobytes())


def spoil_png_colour(path):
    path.write_bytes(cv2.imencode(".png", np.zeros((6, 8, 3), np.uint16))[1].tobytes())


def spoil_png_alpha(path):
    path.write_bytes(png(np.zeros((6, 16)), colour=4))


def spoil_png_palette(path):
    path.write_bytes(png(np.zeros((6, 8)), chunk(b"PLTE", b"\1\2\3"), bits=8, colour=3))


def spoil_png_packed(path):
    path.write_bytes(png(np.zeros((6, 1)), bits=1))


def spoil_png_cut(path):
    path.write_bytes(png(picture())[:90])


@pytest.mark.parametrize(
    ("spoil", "expected"),
    [
        (spoil_shape, "a.tif has 6 x 9 pixels (rows x cols), the frames before have 6 x 8"),
        (spoil_left_justified, "left-justified (all are multiples of 16): shift them right by 4 bits"),
        (spoil_too_bright, "above the 4095 of 12 bits: they are left-justified, or the bit depth is wrong"),
        (spoil_eight_bits, "an 8-bit file cannot hold counts of 12 bits"),
        (spoil_float, "32"),
        (spoil_signed, "not int16"),
        (spoil_colour, "this TIFF holds colour"),
        (spoil_two, "this TIFF holds 2"),
        (spoil_inverted, "0 is white"),
        (spoil_cut, "not a readable TIFF file"),
        (spoil_jpeg, "JPEG is lossy"),
        (spoil_text, "neither a TIFF nor a PNG"),
        (spoil_png_colour, "this PNG holds colour"),
        (spoil_png_alpha, "grey with transparency"),
        (spoil_png_palette, "a palette of colours"),
        (spoil_png_packed, "this PNG has 1"),
        (spoil_png_cut, "damaged or cut short"),
    ],
)
def test_a_picture_that_is_no_frame_is_told_with_its_line(tmp_path, spoil, expected):
    make(tmp_path, line("0.tif"), line("a.tif"))
    spoil(tmp_path / "a.tif")
    message = refused(tmp_path)
    assert f"{tmp_path / 'frames.csv'}, line 3: " in message
    assert "a.tif" in message
    assert expected in message


def test_a_file_that_goes_away_after_reading(tmp_path):
    (entry,) = read_frame_folder(make(tmp_path, line("a.tif"))).entries
    entry.path.unlink()
    with pytest.raises(RecordError, match="there is no such file"):
        entry.load()


# -- writing ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("again", [None, [False, False, False, False, True]])
def test_what_we_write_we_read(tmp_path, again):
    taken = [
        frame(kind="dark"),
        frame(0.02, seed=1),
        frame(89.9987, seed=2, exposure_s=1 / 3, gain=10 ** (1 / 20)),
        frame(180.0, seed=3, kind="flat", black_level=63.7),
        frame(-0.013, seed=4),
    ]
    written = write_frame_folder(tmp_path / "new", taken, again)
    assert written == read_frame_folder(tmp_path / "new")
    for entry, original in zip(written.entries, taken, strict=True):
        loaded = entry.load()
        np.testing.assert_array_equal(loaded.counts, original.counts)
        for name in vars(original).keys() - {"counts"}:
            assert getattr(loaded, name) == getattr(original, name), name
    assert [entry.again for entry in written.entries] == [False] * 4 + [True]


def test_the_table_holds_against_what_the_picture_says(tmp_path):
    write_frame_folder(tmp_path, [frame(10.0)])
    table = tmp_path / "frames.csv"
    table.write_text(table.read_text().replace("sample,10.0", "sample,12.0"))
    loaded = read_frame_folder(tmp_path).entries[0].load()
    assert (loaded.stage_deg, loaded.commanded_deg, loaded.camera) == (12.0, 12.0, "C 7")


def test_what_cannot_be_written(tmp_path):
    with pytest.raises(UsageError, match="0 frames"):
        write_frame_folder(tmp_path, [])
    with pytest.raises(UsageError, match="1 frames and 2 marks"):
        write_frame_folder(tmp_path, [frame()], [True, False])
    with pytest.raises(RecordError, match="above the 1023 of 10 bits"):
        write_frame_folder(tmp_path, [frame(bit_depth=10)])
    assert not (tmp_path / "frames.csv").exists()
    write_frame_folder(tmp_path, [frame()])
    with pytest.raises(RecordError, match="is there already"):
        write_frame_folder(tmp_path, [frame()])
    (tmp_path / "file").touch()
    with pytest.raises(RecordError, match="cannot be made"):
        write_frame_folder(tmp_path / "file", [frame()])


# -- colour cameras --------------------------------------------------------------------------------------------


def test_the_table_names_the_filters_of_other_peoples_pictures(tmp_path):
    lines = [line("a.tif") + ",RGGB", line("b.tif", stage=90) + ",rggb"]
    read = read_frame_folder(make(tmp_path, *lines, header=HEADER + ",filters"))
    assert (read.filters, read.notes) == ("rggb", ())
    assert [entry.load().filters for entry in read.entries] == ["rggb", "rggb"]


def test_pictures_of_ours_name_their_filters_themselves_unless_the_table_does(tmp_path):
    write_frame_folder(tmp_path, [frame(filters="grbg"), frame(1.0, filters="grbg")])
    table = tmp_path / "frames.csv"
    text = table.read_text()
    assert text.splitlines()[0].endswith(",filters")
    assert read_frame_folder(tmp_path).filters == "grbg"
    table.write_text(text.replace(",filters", "").replace(",grbg", ""))
    assert read_frame_folder(tmp_path).filters == "grbg"
    table.write_text(text.replace(",grbg", ",bggr"))
    assert read_frame_folder(tmp_path).entries[0].load().filters == "bggr"


def test_grey_cameras_have_no_such_column(tmp_path):
    assert write_frame_folder(tmp_path, [frame()]).filters == "mono"
    assert "filters" not in (tmp_path / "frames.csv").read_text()


def test_filters_that_change_or_that_nobody_knows_are_told_with_their_line(tmp_path):
    lines = [line("a.tif") + ",rggb", line("b.tif", stage=90) + ",bggr"]
    message = refused(make(tmp_path, *lines, header=HEADER + ",filters"))
    assert "line 3: b.tif was taken through filters bggr, the frames before through rggb" in message
    (tmp_path / "other").mkdir()
    message = refused(make(tmp_path / "other", line("a.tif") + ",xyz", header=HEADER + ",filters"))
    assert "line 2: filters must be one of mono, rggb, bggr, grbg, gbrg, not 'xyz'" in message
