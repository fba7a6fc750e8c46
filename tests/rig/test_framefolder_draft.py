"""A first table for pictures of other programs: what names tell, what they do not, and that the reader takes it."""

import cv2
import numpy as np
import pytest

from anisoscope.base.errors import RecordError, UsageError
from anisoscope.rig.framefolder import draft_table, frames_to_add, read_frame_folder, told_by_name


@pytest.mark.parametrize(
    ("name", "kind", "stage", "tilt", "exposure"),
    [
        ("dark_0", "dark", "0", "0", ""),
        ("s90_1", "sample", "90", "0", ""),
        ("part-180", "sample", "180", "0", ""),
        ("Angle 45.5deg tilt-10 6ms", "sample", "45.5", "-10", "0.006"),
        ("270°_exp_250us", "sample", "270", "0", "0.00025"),
        ("white tile 0,006s", "flat", "0", "0", "0.006"),
        ("004_sample_0090.00_tilt+05.00", "sample", "90", "5", ""),
        ("IMG_2041", "sample", "", "0", ""),
    ],
)
def test_what_a_name_tells(name, kind, stage, tilt, exposure):
    found = told_by_name(name)
    assert (found["kind"], found["stage_deg"], found["tilt_deg"], found["exposure_s"]) == (
        kind,
        stage,
        tilt,
        exposure,
    )


def pictures(folder, names, level=900):
    rng = np.random.default_rng(3)
    folder.mkdir()
    for name in names:
        mean = 64 if "dark" in name else level
        counts = rng.normal(mean, 3.0, (16, 16)).round().astype(np.uint16)
        cv2.imwrite(str(folder / name), counts)
    return folder


def test_the_reader_takes_a_draft_in_which_nothing_is_missing(tmp_path):
    names = ["dark_6ms.png", "part-90_6ms.png", "part-180_6ms.png", "part-0_6ms.png"]
    folder = pictures(tmp_path / "frames", names)
    draft = draft_table(folder)
    assert (draft.frames, draft.missing) == (4, {})
    entries = read_frame_folder(folder).entries
    assert [one.stage_deg for one in entries if one.kind == "sample"] == [0.0, 90.0, 180.0]
    assert {(one.bit_depth, one.black_level, one.exposure_s) for one in entries} == {(10, 64.0, 0.006)}
    with pytest.raises(UsageError, match="exists already"):
        draft_table(folder)


def test_what_nothing_tells_stays_empty_and_is_named(tmp_path):
    folder = pictures(tmp_path / "frames", ["IMG_1.png", "dark_1.png"], level=3000)
    draft = draft_table(folder)
    assert draft.missing == {"stage_deg": ("IMG_1.png",), "exposure_s": ("dark_1.png", "IMG_1.png")}
    with pytest.raises(RecordError, match=r"frames.csv, line 2: exposure_s"):
        read_frame_folder(folder)
    (tmp_path / "empty").mkdir()
    with pytest.raises(UsageError, match="no TIFF or PNG"):
        draft_table(tmp_path / "empty")


def test_pictures_that_a_table_lacks_are_named(tmp_path):
    names = ["dark_6ms.png", "part-0_6ms.png", "white tile 6ms.png", "dark_9ms.png"]
    folder = pictures(tmp_path / "frames", names)
    draft_table(folder)
    table = folder / "frames.csv"
    lines = table.read_text().splitlines(keepends=True)
    table.write_text("".join(line for line in lines if "tile" not in line and "9ms" not in line))
    read = read_frame_folder(folder)
    cells = "exposure_s 0.006, gain 1"
    assert frames_to_add(read, "flat", read.entries[-1]) == (
        f"white tile 6ms.png may be some: list them in frames.csv with kind flat, {cells}, if they were exposed so"
    )
    assert "dark_9ms.png may be some" in frames_to_add(read, "dark", read.entries[-1])
    assert frames_to_add(read, "stray", read.entries[-1]).startswith(
        "photograph some with a light trap in place of"
    )
