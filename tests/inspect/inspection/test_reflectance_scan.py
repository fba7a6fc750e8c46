"""A coupon with a known lobe on the virtual rig, scanned as by a goniometer."""

import json
import shutil
import tomllib

import numpy as np
import pytest
import tomli_w

from anisoscope.base.errors import UsageError
from anisoscope.calibration.pictures import take_flat
from anisoscope.fit.table import read_brdf
from anisoscope.inspection.reflectance_scan import (
    ScanSettings,
    log_slopes,
    planned_poses,
    read_scan,
    resume_scan,
)
from anisoscope.profiles.ideal import RidgeDesign
from anisoscope.sim.light import corrected
from anisoscope.sim.light.geometry import Convention, directions, pose_grid
from anisoscope.sim.light.material import Material

BENCH = {
    "sensor": {"rows": 288, "cols": 320, "hot_pixel_share": 0.0},
    "optics": {"pixel_um": 14.0, "blur_um": 8.0, "electrons": 2.4e7, "lamp_noise": 0.0},
    "tilt": {"address": "1", "zero_deg": 30.0},
}
TILT = {
    "driver": "elliptec",
    "port": "sim://elliptec?bench=${here}/bench.toml",
    "zero_deg": 30.0,
    "options": {"address": "1", "move_gap_s": 0.0, "timeout_s": 0.2},
}
RIG = {"camera": {"pixel_um": 14.0}, "tilt": TILT}
ANGLES = {"stage_deg": 0.02, "seating_tilt_deg": 0.02, "light_angle_deg": 0.02, "scale_share": 0.01}
FEW = ("--max-tilt", 12, "--stages", 4, "--tilts", 5)


@pytest.fixture(scope="module")
def coupon_rig(virtual_rigs, tmp_path_factory):
    """A rig whose angles and white tile are known well, with a flat coupon on it."""
    folder = tmp_path_factory.mktemp("scan")
    tile = virtual_rigs("tile", rig=RIG, bench={**BENCH, "sample": {"kind": "white-tile"}})
    take_flat(tile.rig, folder / "flat.tif", exposure_s=0.0015, frames=4)
    named = {**RIG, "calibration": {"flat": str(folder / "flat.tif")}}
    recipe = {"region": {"size_mm": [0.8, 0.8]}, "uncertainty": ANGLES}
    return virtual_rigs(
        "coupon", rig=named, bench={**BENCH, "sample": {"ridge_angle_deg": 0.0}}, recipe=recipe
    )


@pytest.fixture(scope="module")
def scanned(coupon_rig, anisoscope, tmp_path_factory):
    out = tmp_path_factory.mktemp("scanned") / "scan"
    done = anisoscope(
        "rig", "scan", "--coupon", "-g", coupon_rig.rig, "-r", coupon_rig.recipe, "--out", out, *FEW, "--json"
    )
    assert done.code == 0, done.err
    return out, done.json


def truth(poses):
    light, camera = directions(poses, Convention())
    return corrected.radiance(light, camera, RidgeDesign(100.0, 0.0), Material()) / light[:, 2]


def test_every_value_lies_within_its_uncertainty(scanned):
    """u ≤ 3 % (k = 1) of every value, and the lobe of the virtual coupon within it."""
    out, printed = scanned
    table = read_brdf(out / "brdf.csv")
    value, u = table.readings.value, np.sqrt(np.diag(table.readings.covariance))
    poses, _, _ = read_scan(out / "readings.csv")
    assert len(poses) == printed["poses"] == len(value) == 20
    light, camera = directions(poses, Convention())
    np.testing.assert_allclose(table.to_light, light, atol=1e-7)
    np.testing.assert_allclose(table.to_camera, camera, atol=1e-7)
    assert np.max(u / value) == pytest.approx(printed["u_largest"], rel=1e-6)
    assert np.max(u / value) < 0.03
    bias = value / truth(poses) - 1.0
    assert np.max(np.abs(bias) / (u / value)) < 2.0
    assert abs(np.mean(bias)) < 0.01


def test_the_budget_names_what_the_uncertainty_is_made_of(scanned):
    out, printed = scanned
    budget = json.loads((out / "budget.json").read_text(encoding="utf-8"))
    parts = np.array(list(budget["sources"].values()))
    np.testing.assert_allclose(np.sqrt(np.sum(parts**2, axis=0)), budget["combined"], rtol=1e-9)
    assert {"scale of the white tile", "tilt and seating", "stage angle", "light angle", "stray light",
            "linearity of the camera", "registration"} <= set(budget["sources"])  # fmt: skip
    assert set(printed["u_rms"]) == set(budget["sources"])


def test_the_scan_feeds_the_fit(scanned, anisoscope):
    out, _ = scanned
    done = anisoscope("bsdf", "fit", out / "brdf.csv", "--ridge-angle", 0, "--fit", "--json")
    assert done.code == 0, done.err
    found = {one["name"]: one["value"] for one in done.json["parameters"]}
    assert found["alpha_along"] == pytest.approx(0.06, rel=0.02)
    assert found["alpha_across"] == pytest.approx(0.10, rel=0.02)


def test_a_scan_goes_on_where_it_was_interrupted(scanned, anisoscope, tmp_path):
    """The table is made anew from the frames of the folder; frames are not taken again where none is missing."""
    out, _ = scanned
    folder = tmp_path / "scan"
    shutil.copytree(out, folder)
    for name in ("brdf.csv", "readings.csv", "budget.json"):
        (folder / name).unlink()
    frames = sorted(path.name for path in (folder / "frames").iterdir())
    done = anisoscope("rig", "scan", "--continue", folder)
    assert done.code == 0, done.err
    assert (folder / "brdf.csv").read_text() == (out / "brdf.csv").read_text()
    assert sorted(path.name for path in (folder / "frames").iterdir()) == frames
    (folder / "scan.json").write_text("{}")
    assert anisoscope("rig", "scan", "--continue", folder).code == 74


def test_frames_that_a_scan_lacks_are_taken(scanned, anisoscope, tmp_path):
    out, _ = scanned
    folder = tmp_path / "scan"
    shutil.copytree(out, folder)
    for name in ("brdf.csv", "readings.csv", "budget.json"):
        (folder / name).unlink()
    journal = folder / "frames.jsonl"
    lines = journal.read_text().splitlines(keepends=True)
    journal.write_text("".join(lines[: len(lines) // 2]))
    refused = anisoscope("resume", folder)
    assert (refused.code, "rig scan --continue" in refused.err) == (74, True)
    done = anisoscope("rig", "scan", "--continue", folder)
    assert done.code == 0, done.err
    found, before = (read_brdf(place / "brdf.csv").readings.value for place in (folder, out))
    np.testing.assert_allclose(found, before, rtol=0.02)


def test_a_rig_without_a_tilt_is_refused_before_a_folder_is_made(coupon_rig, anisoscope, tmp_path):
    text = coupon_rig.rig.read_text(encoding="utf-8")
    fixed = coupon_rig.rig.with_name("fixed.toml")
    table = tomllib.loads(text)
    del table["tilt"]
    fixed.write_text(tomli_w.dumps(table), encoding="utf-8")
    arguments = ("--coupon", "-g", fixed, "-r", coupon_rig.recipe, "--out", tmp_path / "scan", *FEW)
    done = anisoscope("rig", "scan", *arguments)
    assert (done.code, "is fixed at 0°" in done.err, "--continue" in done.err) == (69, True, False)
    assert not (tmp_path / "scan").exists()


def test_poses_are_dense_where_the_coupon_mirrors():
    """The half vector comes as near as 5° to the normal at tilt 0: most tilts stand there."""
    angles, tilts = planned_poses(Convention(), 0.0, 0.06, tilt_deg=20.0, stages=12, tilts=13)
    assert len(tilts) == 13
    assert (tilts[0], tilts[-1]) == (-20.0, 20.0)
    assert sum(abs(tilt) <= 5.0 for tilt in tilts) >= 7
    np.testing.assert_allclose(np.diff(angles), 30.0)


def test_poses_are_dense_where_facets_mirror():
    """Facets of 5° lean toward the light at stage angle 0 and mirror it into the camera at tilt 0."""
    angles, tilts = planned_poses(Convention(), 5.0, 0.06, tilt_deg=20.0, stages=16, tilts=11)
    near = [abs((angle + 180.0) % 360.0 - 180.0) for angle in angles]
    assert sum(one <= 45.0 for one in near) > sum(one >= 135.0 for one in near)
    assert 0.0 in tilts


def test_slopes_come_from_the_scan():
    poses = pose_grid(tuple(np.arange(0.0, 360.0, 10.0)), (-2.0, 0.0, 1.0, 2.0))
    stage, tilt = np.array([(pose.stage_deg, pose.tilt_deg) for pose in poses]).T
    by_stage, by_tilt = log_slopes(poses, np.exp(0.3 * np.cos(np.radians(stage)) - 0.2 * tilt))
    np.testing.assert_allclose(by_stage, -0.3 * np.sin(np.radians(stage)) * np.pi / 180.0, atol=4e-5)
    np.testing.assert_allclose(by_tilt, -0.2, rtol=1e-9)


@pytest.mark.parametrize(
    ("changes", "words", "code"),
    [
        (("--coupon", "--part"), "say what is scanned", 64),
        (("--coupon", "--stages", 2), "4 to 144 stage angles", 64),
        (("--coupon", "--max-tilt", 58, "--stages", 4, "--tilts", 3), "reaches", 78),
        (("--coupon", "--exposure", -1), "positive number of seconds", 64),
        (("--continue", "nothing"), "leave the other options out", 64),
    ],
)
def test_bad_input(coupon_rig, anisoscope, tmp_path, changes, words, code):
    out = tmp_path / "scan"
    arguments = ("-g", coupon_rig.rig, "-r", coupon_rig.recipe, "--out", out)
    done = anisoscope("rig", "scan", *arguments, *changes)
    assert words in done.err
    assert done.code == code


def test_a_folder_with_files_is_not_touched(coupon_rig, anisoscope, tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    done = anisoscope(
        "rig", "scan", "--coupon", "-g", coupon_rig.rig, "-r", coupon_rig.recipe, "--out", tmp_path
    )
    assert done.code == 64
    assert "holds files" in done.err
    assert [path.name for path in tmp_path.iterdir()] == ["notes.txt"]


def test_the_plan_is_printed_without_a_move(coupon_rig, anisoscope):
    arguments = ("rig", "scan", "--coupon", "-g", coupon_rig.rig, "-r", coupon_rig.recipe, "--dry-run")
    assert anisoscope(*arguments, "--json").json["poses"] == 24 * 13
    assert "312 poses, exposures" in anisoscope(*arguments).out


def test_settings_need_poses():
    with pytest.raises(ValueError, match="no poses"):
        ScanSettings(
            schema=1, specimen="coupon", angles_deg=(), tilts_deg=(0.0,), exposure_s=1.0, brackets=()
        )


def test_nothing_to_resume(tmp_path):
    with pytest.raises(Exception, match="no scan began here"):
        resume_scan(tmp_path)
    assert UsageError.exit_code == 64
