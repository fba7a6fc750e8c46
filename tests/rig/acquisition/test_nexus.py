"""NeXus files of acquisitions, read with h5py as any program would."""

import h5py
import numpy as np
import pytest
from nexusformat.nexus.validate import validate_file

from anisoscope.base.errors import RecordError
from anisoscope.cli import run
from anisoscope.rig.acquisition.journal import read_journal
from anisoscope.rig.acquisition.nexus import write_nexus
from anisoscope.rig.acquisition.opening import open_rig
from anisoscope.rig.acquisition.plan import Plan, Pose
from anisoscope.rig.acquisition.runner import run_plan
from anisoscope.rig.frame import read_frame
from anisoscope.rig.rigfile import read_rig

BENCH = """schema = 1
sample = { kind = "white-tile" }
sensor = { rows = 64, cols = 80 }
stage = { time_scale = 0.0 }
[tilt]
"""
RIG = """schema = 1
name = "bench"
[stage]
driver = "elliptec"
port = "sim://elliptec?bench=${here}/bench.toml"
zero_deg = 10.0
[tilt]
driver = "elliptec"
port = "sim://elliptec?bench=${here}/bench.toml"
zero_deg = 30.0
options = { address = "1" }
[camera]
driver = "simulated"
pixel_um = 4.0
options = { bench = "${here}/bench.toml" }
[light]
driver = "simulated"
options = { bench = "${here}/bench.toml" }
"""


@pytest.fixture(scope="module")
def scan(tmp_path_factory):
    """The folder of an acquisition of three poses in two tilts."""
    folder = tmp_path_factory.mktemp("scan")
    (folder / "bench.toml").write_text(BENCH)
    (folder / "rig.toml").write_text(RIG)
    poses = (Pose(0.0, 0.0), Pose(90.0, 0.0), Pose(90.0, 15.0))
    plan = Plan(poses, exposure_s=0.002, gain=1.0, frames_per_pose=1, dark_frames=1, settle_s=0.0)
    with open_rig(read_rig(folder / "rig.toml")) as rig:
        run_plan(plan, rig, folder / "T-1")
    return folder / "T-1"


def test_every_frame_has_its_counts_angles_and_units(scan, tmp_path, capsys):
    path = tmp_path / "T-1.nxs"
    assert run(["rig", "export", str(scan), "--out", str(path)]) == 0
    lines = read_journal(scan).frames
    assert capsys.readouterr().out == f"{len(lines)} frames in {path}\n"
    with h5py.File(path) as file:
        data = file[file.attrs["default"]][file["entry"].attrs["default"]]
        assert (data.attrs["NX_class"], data.attrs["signal"], list(data.attrs["axes"])) == (
            "NXdata",
            "data",
            ["time", ".", "."],
        )
        counts = data[data.attrs["signal"]]
        assert (counts.shape, counts.dtype, counts.attrs["units"]) == (
            (len(lines), 64, 80),
            np.uint16,
            "counts",
        )
        for number, line in enumerate(lines):
            np.testing.assert_array_equal(counts[number], read_frame(scan / line.name).counts)
        units = {
            name: data[name].attrs["units"] for name in ("rotation_angle", "tilt_angle", "count_time", "time")
        }
        assert units == {"rotation_angle": "deg", "tilt_angle": "deg", "count_time": "s", "time": "s"}
        np.testing.assert_array_equal(data["rotation_angle"], [line.stage_deg for line in lines])
        np.testing.assert_array_equal(data["tilt_angle"], [line.tilt_deg for line in lines])
        kinds = [kind.decode() for kind in file["entry/frames/kind"]]
        assert kinds == [line.kind for line in lines]
        assert {"dark", "sample"} == set(kinds)
        keys = file["entry/instrument/detector/image_key"][:]
        assert [{"dark": 2, "sample": 0}[kind] for kind in kinds] == list(keys)


def test_the_definitions_of_nexus_are_kept(scan, tmp_path):
    """By the validator of the nexusformat package (NeXpy), with the definitions that it brings."""
    table = {name: np.linspace(0.1, 1.0, 5) for name in ("theta_i_deg", "wavelength_nm", "value", "u")}
    write_nexus(scan, tmp_path / "a.nxs", table)
    assert validate_file(str(tmp_path / "a.nxs")) == (0, 0)
    with h5py.File(tmp_path / "a.nxs", "a") as file:
        group = file["entry/reflectance"]
        units = {
            name: group[name].attrs["units"] for name in ("brdf", "brdf_errors", "theta_i", "wavelength")
        }
        assert units == {"brdf": "1/sr", "brdf_errors": "1/sr", "theta_i": "deg", "wavelength": "nm"}
        file["entry/sample"]["tilt_angle"] = 3.0
        file["entry/instrument/detector/count_time"].attrs["units"] = "K"
    assert validate_file(str(tmp_path / "a.nxs")) != (0, 0), "it finds what is wrong"


def test_what_cannot_be_exported_is_one_line_and_leaves_no_file(scan, tmp_path, capsys):
    for arguments, code, text in [
        ([str(tmp_path), "--out", str(tmp_path / "a.nxs")], 74, "there are no frames of an acquisition"),
        ([str(scan), "--out", str(tmp_path / "a.tif")], 64, "name it .nxs"),
        ([str(scan), "--out", str(tmp_path / "no" / "a.nxs")], 74, "cannot be written"),
    ]:
        found = run(["rig", "export", *arguments])
        assert (found, text in (said := capsys.readouterr().err), said.count("\n")) == (code, True, 1), said
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "old.nxs").touch()
    assert run(["rig", "export", str(scan), "--out", str(tmp_path / "old.nxs")]) == 64
    assert "exists; give another name, or --overwrite" in capsys.readouterr().err


def test_a_frame_that_is_missing_is_named(scan, tmp_path):
    lines = read_journal(scan).frames
    hidden = scan / lines[-1].name
    hidden.rename(tmp_path / "hidden.tif")
    try:
        with pytest.raises(RecordError, match="there is no such file"):
            write_nexus(scan, tmp_path / "a.nxs")
    finally:
        (tmp_path / "hidden.tif").rename(hidden)
    assert list(tmp_path.iterdir()) == []
