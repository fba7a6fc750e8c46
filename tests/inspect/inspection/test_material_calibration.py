"""A coupon scanned on the virtual rig becomes a material file; wrong input is one line."""

import json

import numpy as np
import pytest
import tifffile
import tomli_w

from anisoscope.base.errors import UsageError
from anisoscope.calibration.pictures import take_flat
from anisoscope.fit.lobe import Scan, coupon_poses
from anisoscope.inspection.material_calibration import calibrate_material, plan_scan, scan_setup
from anisoscope.inspection.recompute import recompute
from anisoscope.inspection.reflectance_scan import read_scan
from anisoscope.parameters.geometry import Convention
from anisoscope.parameters.material import Material
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.recipe.material_file import read_material_file
from anisoscope.sim.light import corrected
from anisoscope.sim.light.geometry import directions, pose_grid
from anisoscope.sim.pathtracer.plastic import Plastic
from anisoscope.sim.pathtracer.tracer import PathTracer

SMALL = {
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
COUPON = {"sample": {"ridge_angle_deg": 0.0}}


@pytest.fixture
def plastic_rig(virtual_rig, tmp_path):
    """A small rig with a tilt axis and a flat coupon."""
    tile = virtual_rig("tile", rig=RIG, bench={**SMALL, "sample": {"kind": "white-tile"}})
    take_flat(tile.rig, tmp_path / "flat.tif", exposure_s=0.0015, frames=4)
    named = {**RIG, "calibration": {"flat": str(tmp_path / "flat.tif")}}
    recipe = {"region": {"size_mm": [0.8, 0.8]}, "material": {"alpha_along": 0.08, "alpha_across": 0.08}}
    return virtual_rig("coupon", rig=named, bench={**SMALL, **COUPON}, recipe=recipe)


def readings(path, material=None, poses=None, design=None):
    """A table of readings of a coupon, with 0.3 % noise."""
    poses, noise = poses or coupon_poses(), np.random.default_rng(2)
    design = design or scan_design(0.0)
    light = corrected.radiance(*directions(poses, Convention()), design, material or Material(tail=0.7))
    light = 7.0 * light * np.exp(0.003 * noise.standard_normal(len(poses)))
    rows = [f"{pose.stage_deg},{pose.tilt_deg},{value}" for pose, value in zip(poses, light, strict=True)]
    path.write_text("\n".join(["stage_deg,tilt_deg,value", *rows]) + "\n")
    return path


def scan_design(angle_deg):
    from anisoscope.parameters.ridges import RidgeDesign

    return RidgeDesign(100.0, angle_deg)


@pytest.fixture
def rig_file(tmp_path):
    table = {
        "schema": 1,
        "name": "bench 3",
        "stage": {"driver": "manual"},
        "camera": {"driver": "simulated", "pixel_um": 8.0, "half_angle_deg": 0.0},
        "light": {"angle_deg": 10.0, "wavelength_nm": 525.0},
    }
    path = tmp_path / "rig.toml"
    path.write_text(tomli_w.dumps(table))
    return path


def test_a_coupon_on_the_virtual_rig_becomes_a_material(plastic_rig, anisoscope, tmp_path):
    """Its plastic is α 0.06 and 0.10, albedo 0.2, without a tail; the recipe's guess is off by a third."""
    out = tmp_path / "abs.toml"
    done = anisoscope(
        *("calibrate", "material", "--coupon", "-g", plastic_rig.rig, "-r", plastic_rig.recipe, "--out", out),
        *("--max-tilt", 15, "--step", 5, "--lobe", "tail", "--operator", "ada", "--json"),
    )
    assert done.code == 0, done.err
    found = read_material_file(out)
    assert done.json["id"] == found.id
    assert found.scan.operator == "ada"
    assert len(found.scan.poses) == 14
    u, one = found.covariance.u(), found.material
    for value, truth, name in ((one.alpha_along, 0.06, "along"), (one.alpha_across, 0.10, "across")):
        assert abs(np.log(value / truth)) < 3.0 * u[f"ln_alpha_{name}"] < 0.2
    assert abs(np.log(one.albedo / 0.2)) < 3.0 * u["ln_albedo"]
    assert one.tail < 3.0 * u["tail"]
    assert found.test.residual_over_noise < 2.0


def test_readings_become_a_material_with_its_scan_its_lamp_and_its_test(rig_file, anisoscope, tmp_path):
    out = tmp_path / "abs.toml"
    table = readings(tmp_path / "readings.csv")
    done = anisoscope(
        "calibrate",
        "material",
        "--coupon",
        "-g",
        rig_file,
        "--readings",
        table,
        "--out",
        out,
        "--name",
        "ABS black",
    )
    assert done.code == 0, done.err
    for word in ("34 poses", "u of ln ratios", "roughness across", "5.0° to 20.6°", "known only together"):
        assert word in done.out
    found = read_material_file(out)
    assert (found.name, found.scan.rig, found.light.wavelength_nm) == ("ABS black", "bench 3", 525.0)
    assert found.id.startswith("material-")
    assert found.test.family == "tail"
    assert found.test.bic_advantage > 0.0
    assert abs(found.material.tail - 0.7) < 3.0 * found.covariance.u()["tail"]
    moved = directions(pose_grid((0.0, 90.0, 180.0)), Convention())
    truth, own = (
        np.log(corrected.radiance(*moved, scan_design(10.0), one))
        for one in (Material(tail=0.7), found.material.material())
    )
    np.testing.assert_allclose(own - own[0], truth - truth[0], atol=0.012)


def test_readings_need_no_devices_in_the_rig_file(anisoscope, tmp_path):
    rig, out = tmp_path / "rig.toml", tmp_path / "abs.toml"
    rig.write_text('schema = 1\nname = "sketch"\n[camera]\npixel_um = 8.0\n[light]\nangle_deg = 10.0\n')
    table = readings(tmp_path / "readings.csv")
    done = anisoscope(
        *("calibrate", "material", "--coupon", "-g", rig, "--readings", table, "--out", out, "--lobe", "tail")
    )
    assert done.code == 0, done.err
    assert abs(read_material_file(out).material.tail - 0.7) < 0.1


def test_frames_of_a_coupon_need_no_devices_either(anisoscope, tmp_path, judged_figure):
    """Frames of the path tracer's radiances with specks for the alignment, and dark and flat frames beside them."""
    poses = pose_grid((0.0, 90.0), tuple(np.arange(-10.0, 11.0, 2.5)))
    flat = PathTracer(HeightMap(np.zeros((3, 3)), 1.0, 1.0), Plastic(0.15, 0.2, 0.3))
    light = np.array([flat.direct(*one).mean() for one in zip(*directions(poses, Convention()), strict=True)])
    noise = np.random.default_rng(6)
    lines = ["file,kind,stage_deg,tilt_deg,exposure_s,gain,bit_depth,black_level"]

    specks = 1.0 + 0.3 * np.kron(noise.uniform(-1.0, 1.0, (48, 48)), np.ones((3, 3)))

    def frame(kind, pose, level):
        name, shown = f"{kind}{len(lines)}.tif", np.rot90(specks, round(pose.stage_deg / 90.0))
        counts = (
            noise.normal(64.0 + level * (shown if kind == "sample" else 1.0), 3.0, (144, 144))
            .round()
            .astype(np.uint16)
        )
        tifffile.imwrite(tmp_path / name, counts)
        lines.append(f"{name},{kind},{pose.stage_deg},{pose.tilt_deg},0.02,1.0,12,64")

    for pose, value in zip(poses, light, strict=True):
        for _ in range(2):
            frame("sample", pose, 2200.0 * value / light.max())
    for _ in range(3):
        frame("dark", poses[0], 0.0)
        frame("flat", poses[0], 3000.0)
    (tmp_path / "frames.csv").write_text("\n".join(lines) + "\n")
    rig, recipe, out = tmp_path / "rig.toml", tmp_path / "r.toml", tmp_path / "abs.toml"
    rig.write_text('schema = 1\nname = "sketch"\n[camera]\npixel_um = 10.0\n[light]\nangle_deg = 10.0\n')
    recipe.write_text(
        'schema = 1\nkind = "ridges"\nproduct = "coupon"\n[surface]\npitch_um = 100.0\n[surface.design]\n'
        "ridge_angle_deg = 10.0\n[material]\nalpha_along = 0.12\nalpha_across = 0.12\nalbedo = 0.2\n"
        "[poses]\nangles_deg = [0.0, 90.0, 180.0]\n[acquisition]\nexposure_s = 0.02\n[region]\nsize_mm = [0.4, 0.4]\n"
    )
    done = anisoscope(
        *("calibrate", "material", "--coupon", "-g", rig, "-r", recipe, "--frames", tmp_path, "--out", out),
        *("--lobe", "tail"),
    )
    assert done.code == 0, done.err
    found, u = read_material_file(out).material, read_material_file(out).covariance.u()
    assert abs(np.log(found.alpha_along / 0.15)) < 3.0 * u["ln_alpha_along"] < 1.5
    assert abs(np.log(found.alpha_across / 0.2)) < 3.0 * u["ln_alpha_across"] < 1.5
    shown = [
        f"{value:.3f} ± {value * u[f'ln_{name}']:.3f}"
        for name, value in (("alpha_along", found.alpha_along), ("alpha_across", found.alpha_across))
    ]
    what = "coupon of α .15 and .2 in frames, rig file without devices"
    judged_figure("Fits", what, "own path tracer", " and ".join(shown), "α within 3 u")


def test_a_plastic_of_another_family_is_warned_of_and_exit_code_3(rig_file, anisoscope, tmp_path):
    table = readings(tmp_path / "readings.csv", Material(second_lobe=(0.15, 2.5)))
    out = tmp_path / "abs.toml"
    arguments = ("calibrate", "material", "--coupon", "-g", rig_file, "--readings", table, "--out", out)
    done = anisoscope(*arguments, "--lobe", "tail")
    assert done.code == 3
    assert "the family of lobes does not fit" in done.out
    assert read_material_file(out).test.discrepancy_share == 0.015
    done = anisoscope(*arguments, "--json")
    assert done.code == 0, done.err
    assert done.json["test"]["family"] == "second lobe"
    assert read_material_file(out).material.second_lobe[1] == pytest.approx(2.5, rel=0.1)


def test_the_plan_says_poses_time_and_uncertainty_before_anything_moves(virtual_rig, anisoscope):
    part = virtual_rig(rig={"tilt": TILT}, bench={"tilt": SMALL["tilt"]})
    arguments = ("calibrate", "material", "--coupon", "-g", part.rig, "-r", part.recipe, "--dry-run")
    done = anisoscope(*arguments)
    assert done.code == 0, done.err
    assert "34 poses: 2 stage angles, 17 tilts from -20° to 20°, about 1.1 min" in done.out
    done = anisoscope(*arguments, "--json")
    assert len(json.loads(done.out)["poses"]) == 34
    plan = plan_scan(scan_setup(part.rig, part.recipe, "coupon"))
    assert plan.seconds == pytest.approx(34 * 2.003, abs=0.1)
    assert plan.u_log_ratios.max() < 0.006


def test_wrong_input_is_one_line(rig_file, anisoscope, tmp_path):
    base = ("calibrate", "material", "-g", rig_file)
    ridged = readings(tmp_path / "ridged.csv", design=scan_design(10.0))
    few = readings(tmp_path / "few.csv", poses=pose_grid((0.0, 90.0), (0.0, 10.0)))
    contrasts = tmp_path / "contrasts.csv"
    contrasts.write_text("from_deg,to_deg,tilt_deg,value\n0,90,0,0.1\n90,180,0,0.2\n")
    out = ("--out", tmp_path / "x.toml")
    cases = {
        ("--readings", few, *out): (64, "say what is scanned"),
        ("--coupon", "--part", "--readings", few, *out): (64, "say what is scanned"),
        ("--coupon", "--readings", few): (64, "--out FILE.toml"),
        ("--coupon", *out): (64, "--recipe FILE"),
        ("--part", "--readings", few, *out): (64, "at least 10"),
        ("--coupon", "--readings", few, *out): (64, "at least 10"),
        ("--coupon", "--readings", contrasts, *out): (64, "holds contrasts"),
        ("--coupon", "--readings", ridged, *out): (3, "not flat"),
        ("--coupon", "--readings", ridged, "--valid-days", -1, *out): (64, "--valid-days"),
    }
    for arguments, (code, words) in cases.items():
        done = anisoscope(*base, *arguments)
        assert (done.code, done.err.count("\n")) == (code, 1), (arguments, done.err)
        assert words in done.err
    assert not (tmp_path / "x.toml").exists()


def test_a_scan_on_a_part_needs_its_recipe(rig_file, tmp_path):
    poses, _, _ = read_scan(readings(tmp_path / "readings.csv"))
    with pytest.raises(UsageError, match="--part needs --recipe"):
        scan_setup(rig_file, None, "part", poses=poses)


def test_readings_with_their_uncertainty_count_by_it(rig_file, tmp_path):
    path = tmp_path / "readings.csv"
    rows = readings(path).read_text().splitlines()
    path.write_text(
        "\n".join([rows[0] + ",u", *(f"{row},{0.01 * float(row.split(',')[2])}" for row in rows[1:])])
    )
    poses, value, noise = read_scan(path)
    np.testing.assert_allclose(noise, 0.01)
    setup = scan_setup(rig_file, None, "coupon", poses=poses)
    scan = Scan(poses, setup.convention, value, noise)
    file, found = calibrate_material(setup, scan, tmp_path / "abs.toml", name="ABS", lobe="tail")
    assert found.residual_over_noise < 0.6
    assert file.test.birge_ratio == 1.0
    assert file.covariance.u()["tail"] == pytest.approx(0.015 * np.hypot(0.01, 0.003) / 0.003, rel=0.2)


def test_a_part_is_inspected_with_a_calibrated_material(virtual_rig, rig_file, anisoscope, tmp_path):
    """Its file goes along into the inspection folder, so that recompute finds the same."""
    table = readings(tmp_path / "readings.csv", Material())
    part = virtual_rig(recipe={"material": "../abs.toml"})
    out = tmp_path / "abs.toml"
    done = anisoscope(
        "calibrate", "material", "--coupon", "-g", rig_file, "--readings", table, "--out", out, "--json"
    )
    assert done.code == 0, done.err
    found = part.inspect()
    assert found.record.verdict == "PASS", found.record.reasons
    assert found.record.recipe["material"]["calibrated"]["id"] == done.json["id"]
    assert "calibrated material, direction 1" in [row.source for row in found.record.budget]
    out.unlink()
    again = recompute(found.folder)
    assert (again.verdict, again.differences) == ("PASS", ())
