"""Rig files: the good one, and every mistake in one line."""

import pytest

from anisoscope.base.errors import RigFileError
from anisoscope.rig.rigfile import LightPart, StagePart, read_axes, read_replay_rig, read_rig

GOOD = """
schema = 1
name = "virtual rig"
[stage]
driver = "elliptec"
port = "sim://elliptec?bench=${here}/bench.toml"
zero_deg = 10.0
turns = "ccw"
approach_deg = 2.0
[stage.options]
address = "0"
[camera]
driver = "simulated"
pixel_um = 4.0
[camera.options]
bench = "${here}/bench.toml"
[light]
driver = "simulated"
angle_deg = 10.0
[geometry]
tilt_deg = 0
[fixture]
marker_mm = 0.5
markers = [{id = 0, x_mm = 1.56, y_mm = 0.0}, {id = 1, x_mm = 0.0, y_mm = 1.56}]
[calibration]
flat = "${here}/flat.tif"
"""


def read(tmp_path, text):
    path = tmp_path / "rig.toml"
    path.write_text(text, encoding="utf-8")
    return read_rig(path)


def test_a_good_rig_file(tmp_path):
    folder = tmp_path / "a b"
    folder.mkdir()
    rig = read(folder, GOOD)
    assert rig.stage.port == f"sim://elliptec?bench={folder}/bench.toml"
    assert rig.camera.options["bench"] == f"{folder}/bench.toml"
    assert rig.calibration.flat == folder / "flat.tif"
    assert rig.geometry.tilt_deg == 0.0
    assert rig.fixture.dictionary == "DICT_4X4_50"
    assert [marker.id for marker in rig.fixture.markers] == [0, 1]


@pytest.mark.parametrize("turns", ["ccw", "cw"])
def test_angles_and_readings(turns):
    stage = StagePart(driver="elliptec", port="COM3", zero_deg=200.0, turns=turns)
    assert stage.reading(0.0) == 200.0
    assert stage.reading(90.0) == (290.0 if turns == "ccw" else 110.0)
    assert stage.place(stage.reading(33.0)) == 33.0


def test_a_tilt_axis(tmp_path):
    text = GOOD.replace(
        "[camera]", '[tilt]\ndriver = "elliptec"\nport = "COM3"\nzero_deg = 30.0\nsign = -1\n[camera]', 1
    )
    tilt = read(tmp_path, text).tilt
    assert (tilt.reading(10.0), tilt.place(25.0), tilt.approach_deg) == (20.0, 5.0, 2.0)
    with pytest.raises(RigFileError, match=r"geometry\.tilt_deg is for an arm that stands fixed"):
        read(tmp_path, text.replace("tilt_deg = 0", "tilt_deg = 5"))
    with pytest.raises(RigFileError, match=r"tilt\.sign: input should be -1 or 1, not 2"):
        read(tmp_path, text.replace("sign = -1", "sign = 2"))


def test_what_colours_are_predicted_from_is_a_name_or_a_file_beside(tmp_path):
    assert (read(tmp_path, GOOD).camera.sensitivities, read(tmp_path, GOOD).light.spectrum) == (None, None)
    text = GOOD.replace("pixel_um = 4.0", 'pixel_um = 4.0\nsensitivities = "camera.csv"')
    rig = read(tmp_path, text.replace("angle_deg = 10.0", 'angle_deg = 10.0\nspectrum = "d65"'))
    assert rig.camera.sensitivities == str(tmp_path / "camera.csv")
    assert rig.light.spectrum == "d65"
    with pytest.raises(RigFileError, match=r"light\.spectrum: "):
        read(tmp_path, GOOD.replace("angle_deg = 10.0", 'angle_deg = 10.0\nspectrum = ""'))


def test_an_axis_set_by_hand_has_no_backlash(tmp_path):
    rig = read(tmp_path, GOOD.replace("[camera]", '[tilt]\ndriver = "manual"\n[camera]', 1))
    assert (rig.tilt.port, rig.tilt.approach_deg) == (None, 0.0)


def test_for_frames_that_exist_already_only_the_geometry_is_needed(tmp_path):
    text = "schema = 1\n[camera]\npixel_um = 4.0\n[light]\nangle_deg = 12.0\n"
    path = tmp_path / "rig.toml"
    path.write_text(text)
    with pytest.raises(RigFileError, match="missing"):
        read_rig(path)
    rig = read_replay_rig(path)
    assert (rig.camera.pixel_um, rig.light.angle_deg, rig.fixture) == (4.0, 12.0, None)
    path.write_text(GOOD)  # a whole rig file serves as well
    assert read_replay_rig(path).stage.driver == "elliptec"
    path.write_text(text.replace("pixel_um", "pixel_mm"))
    with pytest.raises(RigFileError, match=r"camera\.pixel_mm: unknown key"):
        read_replay_rig(path)


def test_a_copy_of_a_rig_file_still_means_the_folder_of_the_original(tmp_path):
    copy = tmp_path / "copy.toml"
    copy.write_text(GOOD, encoding="utf-8")
    rig = read_rig(copy, here=tmp_path / "original")
    assert rig.camera.options["bench"] == f"{tmp_path}/original/bench.toml"


@pytest.mark.parametrize(
    ("wrong", "right", "message"),
    [
        ("zero_deg", "zero_rad", "stage.zero_rad: unknown key; did you mean 'zero_deg'?"),
        ("pixel_um", "pixel_mm", "camera.pixel_mm: unknown key; did you mean 'pixel_um'? (and 1 more)"),
        ("pixel_um = 4.0", "", "camera.pixel_um: missing; expected a number"),
        ("zero_deg = 10.0", 'zero_deg = "10"', 'stage.zero_deg: input should be a valid number, not "10"'),
        ("pixel_um = 4.0", "pixel_um = -4.0", "camera.pixel_um: input should be greater than 0, not -4.0"),
        ('"ccw"', '"left"', "stage.turns: input should be 'ccw' or 'cw', not \"left\""),
        ("[light]", "[lamp]", "lamp: unknown key"),
        ("y_mm = 0.0", "z_mm = 0.0", "fixture.markers[0].z_mm: unknown key; did you mean"),
        ("id = 1", "id = 0", "fixture: marker 0 is listed twice"),
        ("${here}/flat", "${home}/flat", "calibration.flat: unknown placeholder ${home}; known: ${here}"),
        ("schema = 1", "schema = 2", "schema: input should be 1, not 2"),
        ("schema = 1", "", "schema: missing; expected 1"),
        ("[camera]", "[camera", "not valid TOML"),
        ("tilt_deg = 0", "tilt_deg = nan", "geometry.tilt_deg: input should be"),
        ("tilt_deg = 0", "tilt_deg = 1979-05-27", "geometry.tilt_deg: input should be a valid number"),
    ],
)
def test_mistakes(tmp_path, wrong, right, message):
    assert wrong in GOOD
    with pytest.raises(RigFileError) as caught:
        read(tmp_path, GOOD.replace(wrong, right, 1))
    text = str(caught.value)
    assert text.startswith(f"{tmp_path / 'rig.toml'}: ")
    assert message in text
    assert "\n" not in text


def test_the_port_of_a_light_stands_where_that_of_a_stage_does(tmp_path):
    lit = GOOD.replace('[light]\ndriver = "simulated"', '[light]\ndriver = "serial"\nport = "COM7"')
    assert read(tmp_path, lit).light.port == "COM7"
    assert read(tmp_path, GOOD).light.port is None


def test_the_port_of_a_light_among_its_options_is_still_read(tmp_path):
    old = GOOD.replace("[geometry]", '[light.options]\nport = "COM7"\nlevel_percent = 80\n[geometry]')
    light = read(tmp_path, old).light
    assert (light.port, light.options) == ("COM7", {"level_percent": 80})
    both = old.replace("[light]", '[light]\nport = "COM8"')
    with pytest.raises(RigFileError, match=r"light: .*port stands here and among the options"):
        read(tmp_path, both)


def test_linear_axes_count_in_millimetres(tmp_path):
    path = tmp_path / "rig.toml"
    z = '[z]\ndriver = "zaber"\nport = "COM4"\nzero_mm = 12.0\nsign = -1\n[z.options]\ncounts_per_mm = 20997.4\n'
    path.write_text(f'schema = 1\n[stage]\ndriver = "elliptec"\nport = "COM3"\n{z}')
    rig = read_axes(path)
    assert list(rig.axes) == ["stage", "z"]
    assert (rig.z.reading(2.0), rig.z.place(10.0), rig.z.unit) == (10.0, 2.0, "mm")
    assert rig.z.driver_options == {"unit": "mm", "counts_per_deg": 20997.4}
    path.write_text(path.read_text().replace("counts_per_mm = 20997.4", "velocity_deg_s = 1.0"))
    with pytest.raises(
        RigFileError, match=r"options\.velocity_deg_s: this axis is linear; write velocity_mm_s"
    ):
        read_axes(path)


@pytest.mark.parametrize(
    ("far_mm", "most_deg", "says"),
    [
        (None, 0.0, None),
        (80.0, 1.5, None),
        (4.0, 90.0, "light.distance_mm: the lamp stands at 4 mm, nearer than the region is wide (4 mm)"),
        (80.0, 1.4, "over a region of 4 mm the light of a lamp at 80 mm turns by ± 1.4°"),
    ],
)
def test_a_lamp_near_a_region(far_mm, most_deg, says):
    light = LightPart(distance_mm=far_mm)
    if says is None:
        light.check_distance((3.0, 4.0), most_deg)
        return
    with pytest.raises(RigFileError) as caught:
        light.check_distance((3.0, 4.0), most_deg)
    assert says in str(caught.value)
