import json

import numpy as np
import pytest
import tifffile

from anisoscope.base.errors import CalibrationError, RecordError, RigError, RigFileError, UsageError
from anisoscope.calibration.white_reference import (
    exposure_for,
    make_reference,
    read_reference,
    write_reference,
)
from anisoscope.imaging.linearisation import Stack

SHAPE = (30, 40)


def level(counts, *, saturated=0, exposure_s=0.5, gain=2.0):
    mask = np.zeros(SHAPE, bool)
    mask.flat[:saturated] = True
    mean = np.broadcast_to(np.asarray(counts, np.float32), SHAPE).copy()
    return Stack(mean, 8, np.zeros(SHAPE, np.float32), mask, exposure_s, gain)


def make(flat, dark=None, **options):
    defaults = {"reflectance": 0.9, "light_cosine": 0.94, "camera": "CAM-7", "full_scale": 4095}
    return make_reference(flat, dark or level(64.0), **(defaults | options))


def test_round_trip(tmp_path):
    shade = np.linspace(1000.0, 2000.0, SHAPE[1], dtype=np.float32)
    reference = make(level(64.0 + shade))
    write_reference(tmp_path / "new" / "flat.tif", reference)
    found = read_reference(tmp_path / "new" / "flat.tif")
    np.testing.assert_allclose(found.signal, np.broadcast_to(shade, SHAPE), rtol=1e-6)  # 0.5 s at gain 2
    assert found.radiance == pytest.approx(0.9 * 0.94 / np.pi)
    assert (found.camera, found.reflectance) == ("CAM-7", 0.9)
    assert [path.name for path in (tmp_path / "new").iterdir()] == ["flat.tif"]


def test_the_exposure_of_a_radiance_follows_from_the_tile(tmp_path):
    """2000 of 4095 counts above black, in 0.5 s at gain 2."""
    path = tmp_path / "flat.tif"
    write_reference(path, make(level(2064.0)))
    tile = 0.9 * 0.94 / np.pi
    assert exposure_for(path, tile, 2000.0 / 4095.0, gain=2.0) == pytest.approx(0.5)
    assert exposure_for(path, 4.0 * tile, 1000.0 / 4095.0) == pytest.approx(0.125)
    old = make(level(2064.0))
    del old["meta"]["level"]
    write_reference(path, old)
    with pytest.raises(CalibrationError, match="does not state how bright"):
        exposure_for(path, tile, 0.7)


def test_a_hot_pixel_of_the_flat_is_filled_with_a_plausible_signal():
    dark = level(64.0)
    dark.mean[3, 3] = 4000.0
    assert make(level(1064.0), dark)["signal"][3, 3] == pytest.approx(1000.0)


def test_a_stuck_column_is_filled_and_does_not_ask_for_a_shorter_exposure():
    flat, dark = level(1064.0), level(64.0)
    for one in (flat, dark):
        one.mean[:, 7] = 4095.0
    flat.saturated[:, 7] = True
    assert make(flat, dark)["signal"] == pytest.approx(np.full(SHAPE, 1000.0))


@pytest.mark.parametrize(
    ("flat", "message"),
    [(level(3000.0, saturated=5), "saturated: shorten"), (level(200.0), "full scale: lengthen")],
)
def test_a_flat_too_bright_or_too_dark_is_refused(flat, message):
    with pytest.raises(CalibrationError, match=message):
        make(flat)


def other_tiff(path):
    tifffile.imwrite(path, np.zeros((8, 8), np.uint16))


def other_kind(path):
    tifffile.imwrite(path, np.zeros((8, 8), np.float32), description=json.dumps({"kind": "x"}), metadata=None)


def not_an_object(path):
    tifffile.imwrite(path, np.zeros((8, 8), np.float32), description="[1]", metadata=None)


def truncated(path):
    write_reference(path, make(level(1064.0)))
    path.write_bytes(path.read_bytes()[:2000])


def short_of_keys(path):
    reference = make(level(1064.0))
    del reference["meta"]["radiance"]
    write_reference(path, reference)


def of_three_dimensions(path):
    reference = make(level(1064.0))
    write_reference(path, reference | {"signal": np.stack([reference["signal"]] * 3)})


def without_sense(path):
    reference = make(level(1064.0))
    reference["signal"][:] = np.nan
    write_reference(path, reference)


DAMAGE = [
    other_tiff,
    other_kind,
    not_an_object,
    truncated,
    short_of_keys,
    of_three_dimensions,
    without_sense,
    lambda path: path.write_bytes(b""),
    lambda path: path.write_text("hello"),
    lambda path: path.mkdir(),
    lambda path: None,
]


@pytest.mark.filterwarnings("ignore")  # tifffile's own words on damaged files
@pytest.mark.parametrize("damage", DAMAGE)
def test_a_damaged_file_is_one_line_that_names_it_and_the_remedy(tmp_path, damage):
    path = tmp_path / "flat.tif"
    damage(path)
    with pytest.raises((CalibrationError, RigFileError)) as caught:
        read_reference(path)
    text = str(caught.value)
    assert "flat.tif" in text
    assert "anisoscope calibrate flat" in text
    assert "\n" not in text


def test_a_place_that_cannot_be_written_is_named(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(RecordError, match="cannot write"):
        write_reference(tmp_path / "file" / "flat.tif", make(level(1064.0)))
    (tmp_path / "flat.tif").mkdir()
    with pytest.raises(RecordError, match="cannot write"):
        write_reference(tmp_path / "flat.tif", make(level(1064.0)))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file", "flat.tif"]


@pytest.mark.parametrize(
    ("options", "message"), [({"reflectance": 0.0}, "reflectance"), ({"frames": 1}, "2 frames")]
)
def test_senseless_options_of_a_flat_are_refused_before_the_rig_is_opened(tmp_path, options, message):
    from anisoscope.calibration.pictures import take_flat

    with pytest.raises(UsageError, match=message):
        take_flat(tmp_path / "none.toml", tmp_path / "flat.tif", exposure_s=0.1, **options)


def test_taking_a_flat_leaves_the_light_off_also_when_it_fails(virtual_rig, tmp_path):
    from anisoscope.calibration.pictures import take_flat

    rig = virtual_rig(bench={"sample": {"kind": "white-tile"}})
    for exposure_s, error in ((0.02, CalibrationError), (1e-5, CalibrationError), (1e3, RigError)):
        with pytest.raises(error):
            take_flat(rig.rig, tmp_path / "flat.tif", exposure_s=exposure_s, frames=2)
        assert not rig.bench.light_on
    assert not (tmp_path / "flat.tif").exists()
