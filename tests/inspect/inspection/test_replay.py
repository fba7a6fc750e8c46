"""Inspections of frames that exist already."""

import csv
import shutil
import tomllib
from dataclasses import replace

import numpy as np
import pytest
import tifffile
import tomli_w
from scipy.ndimage import map_coordinates

from anisoscope.base.errors import CalibrationError, RecordError, RigFileError, UsageError
from anisoscope.inspection.integrity import verify
from anisoscope.inspection.recompute import differences, recompute
from anisoscope.inspection.replay import inspect_frames
from anisoscope.inspection.run import resume_part
from anisoscope.kinds import surface as surface_kind
from anisoscope.profiles.files.load import write_height_map
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.record.schema import DiagnosisRecord, Record
from anisoscope.rig.frame import read_frame
from anisoscope.rig.framefolder import TABLE, HeldFile, write_frame_folder
from anisoscope.sim.bench.bench import Bench, build_surface
from anisoscope.sim.bench.benchfile import read_bench

COLUMNS = ["file", "kind", "stage_deg", "tilt_deg", "exposure_s", "gain", "bit_depth", "black_level"]


@pytest.fixture
def taken(inspected_part):
    """A finished inspection, and its frames as a folder of frames."""
    rig, inspected = inspected_part
    frames = [
        replace(read_frame(inspected.folder / entry.name), serial=None) for entry in inspected.record.frames
    ]
    folder = rig.out.parent / "frames"
    write_frame_folder(folder, frames, [entry.again for entry in inspected.record.frames])
    return rig, inspected, folder


@pytest.fixture
def replay(plain):
    """``replay(rig, folder)`` inspects a folder of frames."""

    def run(rig, folder, **options):
        options = {"rig_path": rig.rig, "methods": plain, **options}
        return inspect_frames(folder, rig.recipe, "R-1", rig.out, **options)

    return run


def test_the_same_frames_give_the_same_numbers_without_any_device(taken, replay):
    rig, live, folder = taken
    rig.rig.with_name("bench.toml").unlink()
    found = replay(rig, folder)
    assert (found.record.verdict, found.notes) == ("PASS", live.record.notes)
    numbers = {"poses", "details", "d2", "p_value", "budget", "drift", "reasons"}
    assert numbers <= set(Record.model_fields)  # pydantic passes over a name that is no field
    then, now = (one.record.model_dump(mode="json", include=numbers) for one in (live, found))
    assert list(differences(then, now)) == []  # sums may differ in the last digit, as arrays lie in memory
    shutil.rmtree(folder)  # what was inspected was copied
    shutil.rmtree(rig.rig.parent / "inspections" / live.folder.name)
    assert verify(found.folder).intact
    assert recompute(found.folder).differences == ()


def test_frames_of_another_part_are_refused_unless_a_reason_is_given(inspected_part, replay):
    rig, inspected = inspected_part
    frames = [read_frame(inspected.folder / entry.name) for entry in inspected.record.frames]
    folder = rig.out.parent / "frames"
    write_frame_folder(folder, frames, [entry.again for entry in inspected.record.frames])
    with pytest.raises(UsageError, match=f"shows a part of serial number {inspected.record.serial}, not R-1"):
        replay(rig, folder)
    assert {one.name for one in rig.out.iterdir() if one.name.startswith("R-1")} == set()
    found = replay(rig, folder, reuse="test of the gauge")
    assert (found.record.origin, found.record.reuse) == ("imported", "test of the gauge")
    assert (inspected.record.origin, inspected.record.reuse) == ("rig", "")
    assert [one.pixels for one in found.record.frames] == [one.pixels for one in inspected.record.frames]
    assert recompute(found.folder).differences == ()
    assert verify(found.folder).origin == "imported"


def test_frames_that_an_earlier_inspection_judged_are_refused(taken, replay):
    rig, live, folder = taken
    asked = []

    def used_before(pixels, serial):
        asked.append((set(pixels), serial))
        return "serial number A-1 on 2026-11-01"

    with pytest.raises(
        UsageError, match=r"judged as serial number A-1 on 2026-11-01, not as R-1.*--reuse REASON"
    ):
        replay(rig, folder, used_before=used_before)
    assert asked == [({one.pixels for one in live.record.frames if one.kind == "sample"}, "R-1")]


def rewrite(folder, change):
    """Change the lines of a table of frames; returns them."""
    with (folder / TABLE).open(encoding="utf-8") as stream:
        lines = list(csv.DictReader(stream))
    lines = change(lines)
    with (folder / TABLE).open("w", encoding="utf-8", newline="") as stream:
        writer = csv.DictWriter(stream, lines[0])
        writer.writeheader()
        writer.writerows(lines)
    return lines


def test_pictures_of_another_program_by_its_own_angles(taken, replay):
    rig, live, folder = taken
    for path in folder.glob("*.tif"):
        counts = tifffile.imread(path)
        tifffile.imwrite(path, counts)  # no metadata of ours
    rewrite(
        folder,
        lambda lines: [line | {"stage_deg": float(line["stage_deg"]) - 360.0 + 0.05} for line in lines],
    )
    found = replay(rig, folder)
    assert found.record.verdict == live.record.verdict
    assert [pose.stage_deg for pose in found.record.poses] == [0.0, 90.0, 180.0]
    assert found.record.camera == "unknown"


FAULTS = {
    "a pose": (
        lambda lines: [line for line in lines if not line["stage_deg"].startswith(("90", "89.9"))],
        r"asks for a picture at 90°, tilt 0°; sample frames there are at: 0° \(tilt 0°\), 180° \(tilt 0°\)",
    ),
    "dark frames": (
        lambda lines: [line for line in lines if line["kind"] != "dark"],
        r"no dark frame of 0\.0015 s at gain 1, as the sample frame",
    ),
    "dark of another exposure": (
        lambda lines: [line | {"exposure_s": "0.1"} if line["kind"] == "dark" else line for line in lines],
        r"no dark frame of 0\.0015 s",
    ),
    "exposures": (
        lambda lines: (
            [line | {"exposure_s": "0.1"} if n == 0 else line for n, line in enumerate(lines)]
            + [{**lines[0], "file": "more.tif"}]
        ),
        "no file more.tif",
    ),
    "bits": (
        lambda lines: [line | {"bit_depth": "14"} if n == 3 else line for n, line in enumerate(lines)],
        "frames of 12 and 14 bits",
    ),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_incomplete_folders_are_refused_before_anything_is_written(taken, fault, replay):
    rig, _, folder = taken
    change, message = FAULTS[fault]
    rewrite(folder, change)
    before = rig.folders
    with pytest.raises(RecordError, match=message) as caught:
        replay(rig, folder)
    assert "\n" not in str(caught.value)
    assert rig.folders == before


def test_one_gain_a_pose(taken, replay):
    rig, _, folder = taken
    lines = rewrite(folder, list)
    dark = {**lines[0], "gain": "2", "file": "dark.tif"}
    tifffile.imwrite(folder / dark["file"], tifffile.imread(folder / lines[0]["file"]))
    first = next(n for n, line in enumerate(lines) if line["kind"] == "sample")
    lines[first]["gain"] = "2"
    rewrite(folder, lambda _: [*lines, dark])
    with pytest.raises(RecordError, match="at 0°, tilt 0° differ in gain"):
        replay(rig, folder)


def test_the_rig_file_may_lie_beside_the_frames(taken, replay):
    rig, _, folder = taken
    with pytest.raises(UsageError, match=r"holds no rig\.toml: name a rig file with --rig; of it are needed"):
        replay(rig, folder, rig_path=None)
    shutil.copy(rig.rig, folder / "rig.toml")
    assert replay(rig, folder, rig_path=None).record.verdict == "PASS"


def test_a_flat_of_another_camera(taken, replay):
    rig, _, folder = taken
    for path in folder.glob("*.tif"):
        data = path.read_bytes()
        path.write_bytes(data.replace(b"SIM-8UM", b"SIM-9UM"))
    with pytest.raises(
        CalibrationError, match=r"flat was taken with camera SIM-8UM, the frames with .*SIM-9UM"
    ):
        replay(rig, folder)


def bare(rig):
    """A rig file with geometry alone, beside the usual one."""
    lines = rig.rig.read_text()
    keep = lines[lines.index("[fixture]") :] if "[fixture]" in lines else lines
    path = rig.rig.with_name("geometry.toml")
    fixture = keep.split("[calibration]")[0]
    path.write_text(f"schema = 1\n[camera]\npixel_um = 8.0\n[light]\nangle_deg = 10.0\n{fixture}")
    return path


def photographs(rig, kind, sample, count, exposure_s=0.0015):
    """Counts of the rig with something else on its stage."""
    text = rig.rig.with_name("bench.toml").read_text()
    path = rig.rig.with_name(f"{kind}.toml")
    path.write_text(text.replace('kind = "ridges"', sample))
    bench = Bench(read_bench(path))
    bench.light_on = True
    return [bench.photograph(exposure_s, 1.0) for _ in range(count)]


def add(folder, kind, pictures):
    def change(lines):
        for number, counts in enumerate(pictures):
            name = f"{kind}{number}.tif"
            tifffile.imwrite(folder / name, counts)
            lines.append({**lines[0], "file": name, "kind": kind, "again": "0"})
        return lines

    rewrite(folder, change)


def test_flats_in_the_folder_fix_the_scale(taken, replay):
    rig, live, folder = taken
    geometry = bare(rig)
    with pytest.raises(
        RigFileError, match=r"names no flat .* photograph some with the white tile in place of the part"
    ):
        replay(rig, folder, rig_path=geometry)
    add(folder, "flat", photographs(rig, "flat", 'kind = "white-tile"', 4))
    found = replay(rig, folder, rig_path=geometry)
    assert found.record.verdict == "PASS"
    assert found.record.white_reference["reflectance"] == 0.99
    for new, old in zip(found.record.poses, live.record.poses, strict=True):
        assert new.measured == pytest.approx(old.measured, rel=2e-3)
    assert recompute(found.folder).differences == ()
    half = replay(rig, folder, rig_path=geometry, reflectance=0.495)
    assert half.record.poses[0].measured == pytest.approx(0.5 * found.record.poses[0].measured, rel=1e-6)
    with pytest.raises(UsageError, match="reflectance of the tile"):
        replay(rig, folder, rig_path=geometry, reflectance=99.0)


def test_stray_light_is_taken_away_where_a_light_trap_shows_it(taken, replay):
    rig, live, folder = taken
    table = tomllib.loads(rig.recipe.read_text(encoding="utf-8")) | {"limits": {"black_share": 0.5}}
    rig.recipe.write_text(tomli_w.dumps(table), encoding="utf-8")
    lines = rewrite(folder, list)
    glare = 200
    for line in lines:
        if line["kind"] == "sample":
            path = folder / line["file"]
            tifffile.imwrite(path, np.minimum(tifffile.imread(path) + glare, 4095).astype(np.uint16))
    spoiled = replay(rig, folder).record
    dark = [tifffile.imread(folder / line["file"]) + glare for line in lines if line["kind"] == "dark"]
    add(folder, "stray", [counts.astype(np.uint16) for counts in dark])
    clean = replay(rig, folder).record
    for old, with_glare, without in zip(live.record.poses, spoiled.poses, clean.poses, strict=True):
        assert with_glare.measured > 1.02 * old.measured
        assert without.measured == pytest.approx(old.measured, rel=1e-3)


def test_what_is_not_known_is_said(taken, replay):
    rig, _, folder = taken
    lines = rewrite(folder, lambda lines: [{k: v for k, v in line.items() if k != "again"} for line in lines])
    dark = [line for line in lines if line["kind"] == "dark"]
    samples = {}
    for line in lines:
        if line["kind"] == "sample":
            samples.setdefault(round(float(line["stage_deg"])), line)
    extra = {**lines[-1], "stage_deg": "45"}
    rewrite(folder, lambda _: [*dark, *samples.values(), extra])
    notes = replay(rig, folder).notes
    assert any("1 sample frames at poses that the recipe does not ask for" in note for note in notes)
    assert any("drift of the lamp is not known" in note for note in notes)
    assert any("one frame only" in note for note in notes)


def test_a_replay_that_was_interrupted(taken, monkeypatch, replay):
    rig, _, folder = taken
    before = set(rig.folders)
    count = []

    def fail(_):
        count.append(1)
        if len(count) > 3:
            raise KeyboardInterrupt

    monkeypatch.setattr(HeldFile, "release", fail)  # after every copy
    with pytest.raises(KeyboardInterrupt):
        replay(rig, folder)
    (left,) = set(rig.folders) - before
    with pytest.raises(RecordError, match="not all frames were copied: inspect the folder of frames again"):
        resume_part(left)


def test_the_own_map_of_a_part_may_be_measured_at_any_rotation(virtual_rig, plain, undiagnosed, monkeypatch):
    """Facets of the map lean toward 217°: it is placed on the pictures to a pixel, and the part agrees with it."""
    rig = virtual_rig(bench={"sample": {"resolved_alpha": 0.03}})
    live = rig.inspect(methods=undiagnosed)
    frames, folder = (
        [read_frame(live.folder / entry.name) for entry in live.record.frames],
        rig.out.parent / "frames",
    )
    write_frame_folder(folder, frames, [entry.again for entry in live.record.frames])
    bench = rig.bench.file
    part = build_surface(bench.sample, np.random.default_rng(bench.seed).spawn(3)[0]).surface
    points, step, azimuth = 321, 2.5, np.radians(217.0)
    y, x = (np.mgrid[:points, :points] - (points - 1) / 2.0) * step
    places = [
        (np.cos(azimuth) * y - np.sin(azimuth) * x) / part.pixel_y_um + (part.shape[0] - 1) / 2.0,
        (np.cos(azimuth) * x + np.sin(azimuth) * y) / part.pixel_x_um + (part.shape[1] - 1) / 2.0,
    ]
    write_height_map(
        HeightMap(map_coordinates(part.height_um, places, order=1), step, step), folder.with_name("own.x3p")
    )
    table = tomllib.loads(rig.recipe.read_text(encoding="utf-8"))
    del table["surface"]["design"]
    table["surface"]["height_map"] = "own.x3p"
    recipe = rig.recipe.with_name("own.toml")
    recipe.write_text(tomli_w.dumps(table), encoding="utf-8")
    # causes of a map of its own take longer than all the rest
    monkeypatch.setattr(surface_kind, "explain", lambda *_, **__: (DiagnosisRecord(says=""), None))
    record = inspect_frames(
        folder, recipe, live.record.serial, rig.out, rig_path=rig.rig, methods=plain
    ).record
    assert record.verdict == "PASS", record.reasons
    np.testing.assert_allclose(
        [pose.predicted for pose in record.poses], [pose.measured for pose in record.poses], rtol=0.04
    )
    place = record.details.map_place
    assert place.resolved, place.says
    assert np.hypot(place.x_um, place.y_um) < 8.0
