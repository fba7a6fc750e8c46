"""The lamps of the live picture: of a sound rig and of rigs with faults, with and without a reference."""

import numpy as np
import pytest

from anisoscope.calibration.fixture import calibrate_fixture
from anisoscope.calibration.record import read_calibration, write_calibration
from anisoscope.live_view.lamps import Lamp, RigLamps, in_words
from anisoscope.parameters.taking import Taking
from anisoscope.rig.acquisition.opening import open_devices
from anisoscope.rig.rigfile import read_rig

EXPOSURE_S = 0.004
EMPTY = {"sample": {"kind": "none"}}


@pytest.fixture(scope="module")
def taught(virtual_rigs, tmp_path_factory):
    """The reference of the sound small rig."""
    path = tmp_path_factory.mktemp("taught") / "fixture.json"
    calibrate_fixture(virtual_rigs("taught", bench=EMPTY).rig, path, Taking(EXPOSURE_S, frames=2), angles=6)
    return path


def picture(rig):
    """A lit frame of a rig, and its camera."""
    file = read_rig(rig)
    with open_devices({}, file.camera, file.light) as devices:
        devices.camera.configure(EXPOSURE_S, 1.0)
        devices.light.on()
        return devices.camera.grab().copy(), devices.camera.info


def lamps_of(rig, frame=None):
    counts, info = frame or picture(rig)
    return {one.name: one for one in RigLamps(rig).read(counts, info, (EXPOSURE_S, 1.0), 0.0)}


def named(path):
    return {"calibration": {"fixture": str(path)}}


def test_a_sound_rig_is_green(virtual_rig, taught):
    found = lamps_of(virtual_rig(rig=named(taught)).rig)
    assert [one.colour for one in found.values()] == ["green"] * 4
    assert found["lamp level"].value == pytest.approx(100.0, abs=0.5)
    assert found["stray light"].value == pytest.approx(0.0, abs=0.4)
    assert found["focus"].value == pytest.approx(
        read_calibration(taught, "fixture", None).number("edge"), rel=0.05
    )
    assert in_words(found["lamp level"]).startswith("good, ")


def test_words_of_a_lamp_have_a_minus_and_a_degree_as_print_has_them():
    assert in_words(Lamp("angle", "green", -10.0, "°")) == "good, −10.0°"
    assert in_words(Lamp("lamp level", "red", 81.24, "%")) == "not good, 81.2 %"


@pytest.mark.parametrize(
    ("optics", "colours"),
    [
        ({"electrons": 1.8e7, "stray_radiance": 0.03}, ("red", "red", "green", "green")),
        ({"electrons": 2.28e7, "stray_radiance": 0.002}, ("yellow", "yellow", "green", "green")),
        ({"blur_um": 16.0}, ("grey", "grey", "red", "green")),
    ],
)
def test_a_fault_colours_its_lamp(virtual_rig, taught, optics, colours):
    found = lamps_of(virtual_rig(rig=named(taught), bench={"optics": optics}).rig)
    assert tuple(one.colour for one in found.values()) == colours


def test_without_a_reference_focus_and_angle_are_shown(virtual_rig, taught, tmp_path):
    rig = virtual_rig().rig
    frame = picture(rig)
    found = lamps_of(rig, frame)
    assert [one.colour for one in found.values()] == ["grey", "grey", "green", "green"]
    assert in_words(found["lamp level"]) == "not taught (anisoscope calibrate fixture)"
    record = read_calibration(taught, "fixture", None)
    write_calibration(
        record.model_copy(update={"details": record.details | {"channel": "red"}}), tmp_path / "red.json"
    )
    other = lamps_of(virtual_rig("red", rig=named(tmp_path / "red.json")).rig, frame)
    assert [one.colour for one in other.values()] == ["grey", "grey", "green", "green"]
    assert "in light channel red" in other["stray light"].why


def test_dark_and_saturated_pictures_have_no_level(virtual_rig, taught):
    rig = virtual_rig(rig=named(taught)).rig
    counts, info = picture(rig)
    unlit = lamps_of(rig, (np.full_like(counts, 64), info))
    assert [one.colour for one in unlit.values()] == ["grey", "grey", "grey", "red"]
    assert "markers are seen" in unlit["angle"].why
    bright = np.minimum(counts.astype(np.uint32) * 4, 4095).astype(np.uint16)
    full = lamps_of(rig, (np.where(counts > np.median(counts) * 0.6, np.uint16(4095), bright), info))
    assert full["lamp level"].colour == "grey"


def test_readings_are_taken_a_few_times_a_second(virtual_rig):
    rig = virtual_rig().rig
    counts, info = picture(rig)
    lamps = RigLamps(rig, gap_s=0.4)
    first = lamps.read(counts, info, (EXPOSURE_S, 1.0), 10.0)
    dark = np.full_like(counts, 64)
    assert lamps.read(dark, info, (EXPOSURE_S, 1.0), 10.3) is first
    assert lamps.read(dark, info, (EXPOSURE_S, 1.0), 10.5)[3].colour == "red"
    rig.write_text(rig.read_text().split("[fixture]")[0])
    lamps.forget()
    assert lamps.read(counts, info, (EXPOSURE_S, 1.0), 10.6) == ()
