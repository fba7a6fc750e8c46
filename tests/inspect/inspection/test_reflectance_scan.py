"""A coupon with a known lobe on the virtual rig, scanned as by a goniometer."""

import json
import shutil
import tomllib
from dataclasses import replace
from types import SimpleNamespace

import h5py
import numpy as np
import pytest
import tomli_w
from nexusformat.nexus.validate import validate_file

from anisoscope.base.errors import CalibrationError, UsageError
from anisoscope.bsdf.models import of_ink
from anisoscope.calibration.pictures import take_flat
from anisoscope.fit.table import read_brdf
from anisoscope.inspection.material_calibration import setup_of
from anisoscope.inspection.reflectance_scan import (
    ScanResult,
    ScanSettings,
    coupon_seat,
    flatness,
    log_slopes,
    planned_poses,
    read_scan,
    resume_scan,
    seating_slopes,
)
from anisoscope.parameters.geometry import Convention
from anisoscope.parameters.material import Material
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.record.schema import read_record
from anisoscope.rig.rigfile import RigFile
from anisoscope.sim.light import corrected
from anisoscope.sim.light.geometry import directions, pose_grid, seating_rotation
from anisoscope.sim.materials.inks import find_ink

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
ANGLES = {"light_angle_deg": 0.02, "scale_share": 0.01}
SEATING = (0.15, -0.1)
FEW = ("--max-tilt", 12, "--stages", 4, "--tilts", 5)


@pytest.fixture(scope="module")
def coupon_rig(virtual_rigs, tmp_path_factory):
    """A rig whose white tile is known well, with a flat coupon on it."""
    folder = tmp_path_factory.mktemp("scan")
    tile = virtual_rigs("tile", rig=RIG, bench={**BENCH, "sample": {"kind": "white-tile"}})
    take_flat(tile.rig, folder / "flat.tif", exposure_s=0.0015, frames=4)
    named = {**RIG, "calibration": {"flat": str(folder / "flat.tif")}}
    recipe = {
        "region": {"size_mm": [0.8, 0.8]},
        "uncertainty": {"scale_share": 0.01},
    }  # light angle: 0.1° by default
    return virtual_rigs(
        "coupon",
        rig=named,
        bench={**BENCH, "sample": {"ridge_angle_deg": 0.0, "seating_tilt_deg": list(SEATING)}},
        recipe=recipe,
    )


@pytest.fixture(scope="module")
def scanned(coupon_rig, anisoscope, tmp_path_factory):
    out = tmp_path_factory.mktemp("scanned") / "scan"
    done = anisoscope(
        "rig", "scan", "--coupon", "-g", coupon_rig.rig, "-r", coupon_rig.recipe, "--out", out, *FEW, "--json"
    )
    assert done.code == 0, done.err
    return out, done.json


def seated(poses):
    """Directions that the coupon truly sees."""
    return [side @ seating_rotation(*SEATING) for side in directions(poses, Convention())]


def truth(poses):
    light, camera = seated(poses)
    return corrected.radiance(light, camera, RidgeDesign(100.0, 0.0), Material()) / light[:, 2]


def test_every_value_lies_within_its_uncertainty(scanned):
    """u ≤ 3 % (k = 1) of every value, and the lobe of the virtual coupon within it."""
    out, printed = scanned
    table = read_brdf(out / "brdf.csv")
    value, u = table.readings.value, np.sqrt(np.diag(table.readings.covariance))
    poses, _, _ = read_scan(out / "readings.csv")
    assert len(poses) == printed["poses"] == len(value) == 20
    light, camera = seated(poses)
    np.testing.assert_allclose(table.to_light, light, atol=np.radians(0.02))
    np.testing.assert_allclose(table.to_camera, camera, atol=np.radians(0.02))
    for found, true, u_deg in zip(printed["seating_deg"], SEATING, printed["u_seating_deg"], strict=True):
        assert u_deg < 0.02
        assert abs(found - true) < 3.0 * u_deg
    assert printed["flatness_deg"] < 0.1
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
    assert {"scale of the white tile", "seating, found from the scan", "stage angle", "light angle", "stray light",
            "linearity of the camera", "registration"} <= set(budget["sources"])  # fmt: skip
    assert set(printed["u_rms"]) == set(budget["sources"])


def test_a_scan_is_one_nexus_file_with_its_reflectances(scanned, anisoscope, tmp_path):
    out, path = scanned[0], tmp_path / "scan.nxs"
    done = anisoscope("rig", "export", out, "--out", path, "--json")
    assert done.code == 0, done.err
    readings = read_brdf(out / "brdf.csv").readings
    assert validate_file(str(path)) == (0, 0)
    with h5py.File(path) as file:
        group = file["entry/reflectance"]
        np.testing.assert_allclose(group["brdf"], readings.value, rtol=1e-8)
        np.testing.assert_allclose(group["brdf_errors"], np.sqrt(np.diag(readings.covariance)), rtol=1e-8)
        assert len(file["entry/data/data"]) == done.json["frames"]


def test_the_scan_feeds_the_fit(scanned, anisoscope):
    out, _ = scanned
    done = anisoscope("fit", "brdf", out / "brdf.csv", "--ridge-angle", 0, "--fit", "--json")
    assert done.code == 0, done.err
    found = {one["name"]: one["value"] for one in done.json["parameters"]}
    assert found["alpha_along"] == pytest.approx(0.06, rel=0.02)
    assert found["alpha_across"] == pytest.approx(0.10, rel=0.02)


def test_the_scan_feeds_a_material(scanned, coupon_rig, anisoscope, tmp_path):
    """What an inspection then makes of it: test_a_part_is_inspected_with_a_calibrated_material."""
    out, _ = scanned
    arguments = ("--coupon", "-g", coupon_rig.rig, "--readings", out / "readings.csv")
    done = anisoscope("calibrate", "material", *arguments, "--out", tmp_path / "abs.toml", "--json")
    assert done.code == 0, done.err
    assert done.json["material"]["alpha_across"] == pytest.approx(0.10, rel=0.05)


@pytest.mark.soak
@pytest.mark.parametrize("angle_deg", [10.0, 14.0])
def test_from_a_scan_to_a_verdict(coupon_rig, virtual_rigs, anisoscope, tmp_path, angle_deg):
    """Scan, fit, material, recipe and inspection by their commands: a part of the scanned plastic passes, 14° fails."""
    scan, plastic = tmp_path / "scan", tmp_path / "abs.toml"
    more = ("--stages", 8, "--tilts", 9, "--max-tilt", 20)
    named = {**RIG, "calibration": tomllib.loads(coupon_rig.rig.read_text())["calibration"]}
    part = virtual_rigs(
        f"part-{angle_deg:g}",
        rig=named,
        bench={**BENCH, "sample": {"ridge_angle_deg": angle_deg}},
        recipe={"region": {"size_mm": [0.8, 0.8]}, "uncertainty": ANGLES, "material": str(plastic)},
    )
    on = ("--coupon", "-g", coupon_rig.rig)
    for command in (
        ("rig", "scan", *on, "-r", coupon_rig.recipe, "--out", scan, *more),
        ("fit", "brdf", scan / "brdf.csv", "--ridge-angle", 0, "--fit"),
        ("calibrate", "material", *on, "--readings", scan / "readings.csv", "--out", plastic),
        ("recipe", "check", part.recipe),
    ):
        done = anisoscope(*command)
        assert done.code == 0, (command, done.err)
    arguments = ("-r", part.recipe, "-g", part.rig, "--serial", "T-1", "--out", part.out)
    done = anisoscope("inspect", *arguments, "--history", "none", "--json")
    assert done.json["verdict"] == ("PASS" if angle_deg == 10.0 else "FAIL"), done.json["reasons"]
    assert done.code == (0 if angle_deg == 10.0 else 1)
    (folder,) = part.folders
    assert read_record(folder).recipe["material"]["calibrated"]["id"]


@pytest.mark.soak
def test_a_part_is_scanned(coupon_rig, virtual_rigs, anisoscope, tmp_path):
    """Ridges on the virtual rig, all reflections counted, within the uncertainty of an unknown seating."""
    named = {**RIG, "calibration": tomllib.loads(coupon_rig.rig.read_text())["calibration"]}
    sample = {"ridge_angle_deg": 10.0, "resolved_alpha": 0.0, "reflections": True}
    recipe = {"region": {"size_mm": [0.8, 0.8]}, "uncertainty": ANGLES}
    rig = virtual_rigs("ridges", rig=named, bench={**BENCH, "sample": sample}, recipe=recipe)
    out = tmp_path / "scan"
    done = anisoscope("rig", "scan", "--part", "-g", rig.rig, "-r", rig.recipe, "--out", out, *FEW, "--json")
    assert done.code == 0, done.err
    assert done.json["seating_deg"] is None
    table = read_brdf(out / "brdf.csv")
    value, u = table.readings.value, np.sqrt(np.diag(table.readings.covariance))
    wanted = corrected.radiance(table.to_light, table.to_camera, RidgeDesign(100.0, 10.0), Material(), None)
    off = value / (wanted / table.to_light[:, 2]) - 1.0
    # most of the light of the darkest poses is reflected twice, by the tracer in a groove of three cells
    assert np.max(np.abs(off) / np.hypot(u / value, 0.02)) < 2.0
    assert np.max(u / value) < 0.04


def ink_scan(ink, nm, poses):
    """A scan of an ink at one wavelength, without noise."""
    light, camera = directions(poses, Convention())
    value = of_ink(ink).at(nm).evaluate(light, camera)[:, 0]
    return ScanResult(poses, light, camera, value, {"none": np.full(len(poses), 0.01)}, nm)


def test_scans_of_several_lamps_feed_the_fit_of_an_ink(anisoscope, tmp_path):
    """The rig reaches the lobe and the level, and a little of the goniochromatism."""
    ink = find_ink("synthetic-red")
    angles, tilts = planned_poses(Convention(), 0.0, 0.19, tilt_deg=30.0, stages=8, tilts=9)
    poses = pose_grid(angles, tilts)
    tables = [ink_scan(ink, nm, poses).goniometer_csv() for nm in (530.0, 630.0, 650.0)]
    (tmp_path / "ink.csv").write_text(tables[0] + "".join(one.partition("\n")[2] for one in tables[1:]))
    arguments = (
        "ink",
        "fit",
        tmp_path / "ink.csv",
        "--values",
        "brdf",
        "--out",
        tmp_path / "ink.toml",
        "--json",
    )
    done = anisoscope(*arguments)
    assert done.code == 0, done.err
    found = find_ink(str(tmp_path / "ink.toml"))
    assert found.alpha == pytest.approx(ink.alpha, rel=0.001)
    at = [list(ink.nm).index(nm) for nm in (530.0, 630.0, 650.0)]
    np.testing.assert_allclose(found.rho_brdf, np.asarray(ink.rho_brdf)[at], rtol=0.01)


@pytest.mark.soak
def test_an_ink_is_scanned_under_three_lamps(virtual_rigs, anisoscope, tmp_path):
    """A solid print on the virtual rig, narrow lamps one after the other in one scan, then `ink fit`."""
    lamps = (530.0, 630.0, 650.0)
    ink = find_ink("synthetic-red")
    rigs = []
    for nm in lamps:
        (tmp_path / f"{nm:g}.csv").write_text(
            f"wavelength_nm,power\n380,0\n{nm - 4},0\n{nm},1\n{nm + 4},0\n780,0\n"
        )
        bench = {
            **BENCH,
            "optics": {**BENCH["optics"], "spectrum": str(tmp_path / f"{nm:g}.csv"), "electrons": 6e6},
        }
        table = {**RIG, "light": {"wavelength_nm": nm}}
        tile = virtual_rigs(f"tile-{nm:g}", rig=table, bench={**bench, "sample": {"kind": "white-tile"}})
        flat = tmp_path / f"flat-{nm:g}.tif"
        take_flat(tile.rig, flat, exposure_s=0.004, frames=4)
        solid = {
            "kind": "print",
            "print": {"substrate": 0.0, "grain_share": 0.0},
            "seating_tilt_deg": list(SEATING),
        }
        rigs.append(
            virtual_rigs(
                f"print-{nm:g}",
                rig={**table, "calibration": {"flat": str(flat)}},
                bench={**bench, "sample": solid},
                recipe={"region": {"size_mm": [0.8, 0.8]}, "uncertainty": ANGLES,
                        "material": {"alpha_along": 0.19, "alpha_across": 0.19, "albedo": 0.02}},
            )
        )  # fmt: skip
    out = tmp_path / "scan"
    named = [word for one in rigs for word in ("-g", one.rig)]
    arguments = ("rig", "scan", "--coupon", *named, "-r", rigs[0].recipe, "--out", out)
    done = anisoscope(*arguments, "--max-tilt", 20, "--stages", 4, "--tilts", 7, "--json")
    assert done.code == 0, done.err
    assert [one["wavelength_nm"] for one in done.json["lamps"]] == list(lamps)
    assert read_brdf(out / "brdf.csv", 630.0).wavelength_nm == 630.0
    before = (out / "goniometer.csv").read_text()
    (out / "goniometer.csv").unlink()
    assert anisoscope("rig", "scan", "--continue", out).code == 0
    assert (out / "goniometer.csv").read_text() == before
    done = anisoscope(
        "ink", "fit", out / "goniometer.csv", "--values", "brdf", "--out", tmp_path / "ink.toml"
    )
    assert done.code == 0, done.err
    found = find_ink(str(tmp_path / "ink.toml"))
    assert found.alpha == pytest.approx(ink.alpha, rel=0.01)
    at = [list(ink.nm).index(nm) for nm in lamps]
    np.testing.assert_allclose(found.rho_brdf, np.asarray(ink.rho_brdf)[at], rtol=0.03)


def test_lamps_of_one_scan_need_their_wavelengths(coupon_rig, anisoscope, tmp_path):
    rig = coupon_rig.rig
    arguments = (
        "rig",
        "scan",
        "--coupon",
        "-g",
        rig,
        "-g",
        rig,
        "-r",
        coupon_rig.recipe,
        "--out",
        tmp_path / "scan",
    )
    done = anisoscope(*arguments, *FEW)
    assert (done.code, "states no light.wavelength_nm" in done.err) == (64, True)
    assert not (tmp_path / "scan").exists()
    table = tomllib.loads(rig.read_text(encoding="utf-8"))
    table["light"]["wavelength_nm"] = 630.0
    named = rig.with_name("red.toml")
    named.write_text(tomli_w.dumps(table), encoding="utf-8")
    done = anisoscope(*(named if word == rig else word for word in arguments), *FEW)
    assert (done.code, "is a second one of 630 nm" in done.err) == (64, True)


def test_a_scan_with_a_known_lamp_has_its_wavelength(tmp_path):
    poses = pose_grid((0.0, 90.0), (-5.0, 0.0, 5.0))
    found = ink_scan(find_ink("synthetic-red"), 630.0, poses)
    (tmp_path / "t.csv").write_text(found.table().csv())
    assert read_brdf(tmp_path / "t.csv").wavelength_nm == 630.0


def test_a_coupon_that_is_not_flat_is_found():
    """Cells of a coupon bent about y: normals lean by ±0.6°, and albedo varies besides."""
    setup = setup_of(
        read_rig_table(), None, "coupon", poses=pose_grid((0.0, 90.0, 180.0, 270.0), (-8.0, -3.0, 3.0, 8.0))
    )
    slopes = seating_slopes(setup, Material(), (0.0, 0.0, 0.0))
    lean = np.linspace(-0.6, 0.6, 9)[None, :] * np.ones((9, 1))
    gain = np.random.default_rng(0).normal(0.0, 0.05, (9, 9))
    cells = slopes[:, 1, None, None] * lean + gain
    found, u = flatness(cells, slopes[:, :2])
    assert found == pytest.approx(0.45, abs=0.01)  # the mean of the outer third
    assert u < 0.01
    measured = SimpleNamespace(
        radiance=np.exp(1.0 + slopes[:, 0] * 0.0) * truth_of(setup), cells=np.exp(2.0 * cells), components=()
    )
    with pytest.raises(CalibrationError, match=r"lean by up to 0\.[89]\d° from their mean .* limit 0\.5°"):
        coupon_seat(setup, measured)


def truth_of(setup):
    return corrected.radiance(*directions(setup.poses, setup.convention), RidgeDesign(100.0, 0.0), Material())


def read_rig_table():
    table = {
        "schema": 1,
        "name": "bench",
        "stage": {"driver": "manual"},
        "camera": {"driver": "simulated", "pixel_um": 8.0},
        "light": {"angle_deg": 10.0},
    }
    return RigFile.model_validate(table)


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


def test_the_light_angle_is_found_from_a_coupon_of_uneven_roughness():
    """The rig file says 10°, the light stands at 10.13°; noise of 0.3 %. Of an even one nothing tells it."""
    poses = pose_grid((0.0, 45.0, 90.0, 135.0), tuple(np.linspace(-12.0, 12.0, 9)))
    setup = setup_of(read_rig_table(), None, "coupon", poses=poses)
    rng = np.random.default_rng(4)
    found = []
    for material in (Material(), Material(alpha_along=0.1, alpha_across=0.1)):
        light, camera = directions(poses, Convention(10.13))
        turn = seating_rotation(*SEATING)
        radiance = corrected.radiance(light @ turn, camera @ turn, RidgeDesign(100.0, 0.0), material)
        radiance *= np.exp(0.003 * rng.standard_normal(len(poses)))
        measured = SimpleNamespace(radiance=radiance, cells=np.ones((len(poses), 3, 3)), components=())
        found.append(coupon_seat(replace(setup, material=material), measured))
    uneven, even = found
    assert uneven.light_angle_deg == pytest.approx(10.13, abs=3.0 * uneven.u_light_angle_deg)
    assert uneven.u_light_angle_deg < 0.03
    assert even.u_light_angle_deg > 0.08
    for seat in found:
        assert (seat.about_x_deg, seat.about_y_deg) == pytest.approx(SEATING, abs=0.04)
