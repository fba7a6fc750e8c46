"""The whole line on the virtual rig: files in, verdict, record and report out."""

import re
import subprocess
from types import SimpleNamespace

import numpy as np
import pytest

from anisoscope.base.errors import (
    CalibrationError,
    NotConnected,
    RecordError,
    RigError,
    RigFileError,
    Stalled,
    UsageError,
)
from anisoscope.calibration.pictures import take_flat
from anisoscope.calibration.white_reference import read_reference
from anisoscope.imaging.linearisation import linearise, stack
from anisoscope.imaging.pose_radiance import region_grid
from anisoscope.imaging.registration.placement import locate, resample
from anisoscope.inspection import run as inspection
from anisoscope.inspection.job import check_serial
from anisoscope.inspection.recompute import recompute
from anisoscope.inspection.run import Methods
from anisoscope.kinds.registry import read_recipe
from anisoscope.parameters.geometry import Pose
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.profiles.files.load import write_height_map
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.profiles.ideal import add_facet_roughness, ridges
from anisoscope.record.schema import read_record, sha256_of
from anisoscope.rig.acquisition.journal import read_journal
from anisoscope.rig.frame import read_frame
from anisoscope.rig.rigfile import read_rig
from anisoscope.rig.stages import manual
from anisoscope.sim.light.contrasts import contrasts


@pytest.fixture(scope="module")
def reference_map(tmp_path_factory):
    """A part measured by a profilometer; its roughness is resolved."""
    surface = ridges(RidgeDesign(100.0, 10.0), (401, 501), (1.0, 1.0))
    surface = add_facet_roughness(surface, 0.03, 0.03, 8.0, np.random.default_rng(3))
    path = tmp_path_factory.mktemp("map") / "reference.x3p"
    write_height_map(surface, path)
    return path


def from_map(path):
    return {"surface": {"height_map": str(path), "design": None}}


REFLECTING = {"surface": {"reflections": "all"}}


def same_record(record):
    """All of a record but what the clock says."""
    return record.model_dump(exclude={"created_at", "files", "frames", "inputs", "rig"})


def test_a_good_part_passes_and_the_frames_on_disk_prove_it(virtual_rig, reference_map, plain):
    recipe = {"surface": from_map(reference_map)["surface"] | REFLECTING["surface"]}
    rig = virtual_rig(recipe=recipe, bench={"sample": {"resolved_alpha": 0.03, "reflections": True}})
    inspected = rig.inspect("A 1", Methods(start_renderer=plain.start_renderer))
    record = inspected.record
    assert record.verdict == "PASS"
    assert read_record(inspected.folder) == record
    assert inspected.report.read_text(encoding="utf-8").count("PASS") > 0
    assert (record.model, record.drift is not None, len(record.frames)) == ("relief", True, 2 + 4 * 2)

    inputs = {path.name: path for path in (rig.recipe, rig.rig, reference_map)}
    inputs["flat.tif"] = read_rig(rig.rig).calibration.flat
    inputs["flat.json"] = inputs["flat.tif"].with_suffix(".json")
    assert {entry.name: entry.sha256 for entry in record.inputs} == {
        f"inputs/{n}": sha256_of(p) for n, p in inputs.items()
    }
    for entry in (*record.inputs, *record.frames, *record.files):
        assert entry.sha256 == sha256_of(inspected.folder / entry.name)
    own = {"frames", "frames.jsonl", "inputs", "job.json", "measured.npz", "record.json"}
    own |= {"report.html", "report.sha256"}
    assert {p.name for p in inspected.folder.iterdir()} == own

    frames = [read_frame(inspected.folder / entry.name) for entry in record.frames]
    white = read_reference(inputs["flat.tif"])
    dark = stack(f for f in frames if f.kind == "dark")
    fixture, (grid, _) = read_rig(rig.rig).fixture, region_grid(read_recipe(rig.recipe), 8.0)
    for pose in record.poses:
        taken = [f for f in frames if f.kind == "sample" and f.commanded_deg == pose.stage_deg][:2]
        image = linearise(stack(taken), dark, white, taken[0].full_scale)
        again = np.nanmean(resample(image.value, locate(image.value, fixture), grid), dtype=float)
        assert again == pytest.approx(pose.measured, rel=1e-6)


def test_contrasts_of_the_record_follow_from_its_poses(virtual_rig):
    for kind, tolerance in (("log_ratio", 0.25), ("michelson", 0.1), ("difference", 0.04)):
        record = (
            virtual_rig(kind, recipe={"decision": {"contrast": kind, "tolerance": tolerance}})
            .inspect()
            .record
        )
        assert record.verdict == "PASS", record.reasons
        poses = tuple(Pose(pose.stage_deg, pose.tilt_deg) for pose in record.poses)
        for name in ("measured", "predicted"):
            found = contrasts(poses, np.array([getattr(pose, name) for pose in record.poses]))
            assert [getattr(c, name) for c in record.details.contrasts] == pytest.approx(
                [getattr(c, kind) for c in found]
            )
        squares = np.sum([np.square(row.contributions) for row in record.budget], axis=0)
        assert [c.u**2 for c in record.details.contrasts] == pytest.approx(squares)
        assert record.d2 < 20


@pytest.mark.parametrize("replays", [True, False])
def test_pictures_of_another_part_are_noticed_live_and_a_simulation_may_repeat_them(
    virtual_rig, plain, replays
):
    rig = virtual_rig(bench={"faults": {"replays": replays}})
    asked = []

    def used_before(pixels, serial):
        asked.append((set(pixels), serial))
        return "serial number A-1 on 2026-11-01"

    found = inspection.inspect_part(
        rig.recipe, rig.rig, "B-1", rig.out, methods=plain, used_before=used_before
    )
    if not replays:
        assert (asked, found.record.verdict) == ([], "PASS")
        return
    assert asked == [({one.pixels for one in found.record.frames if one.kind == "sample"}, "B-1")]
    assert found.record.verdict == "INVALID"
    assert found.record.reasons == (inspection.old_pictures("serial number A-1 on 2026-11-01"),)
    assert recompute(found.folder).differences == ()


def test_the_same_files_give_the_same_numbers(virtual_rig):
    first, second = (virtual_rig(name).inspect().record for name in ("one", "two"))
    assert same_record(first) == same_record(second)
    assert [f.sha256 for f in first.frames] != [f.sha256 for f in second.frames]  # they hold the time


DEFECTS = {
    "angle": ({"ridge_angle_deg": 12.0}, "ln ratio 0° / 90°, tilt 0°"),
    "burrs": ({"burr_coverage": 0.1, "resolved_alpha": 0.0}, "of the area deviate"),
    "rough": ({"material": {"alpha_across": 0.2}}, "ln ratio"),
}


@pytest.mark.parametrize("defect", DEFECTS)
def test_a_defective_part_fails_for_its_reason(virtual_rig, undiagnosed, defect):
    sample, reason = DEFECTS[defect]
    # burrs are seen by cells, which reflections hardly change
    changes = {"bench": {"sample": sample | {"reflections": defect != "burrs"}}}
    changes |= {} if defect == "burrs" else {"recipe": REFLECTING}
    record = virtual_rig(**changes).inspect(methods=undiagnosed).record
    assert record.verdict == "FAIL"
    assert reason in record.reasons[0]


INVALID = {
    "saturated": (
        {"recipe": {"acquisition": {"exposure_s": 0.01}}},
        "saturated.*shorten acquisition.exposure_s",
    ),
    "too short": ({"recipe": {"acquisition": {"exposure_s": 2e-5}}}, "the exposure too short"),
    "lens cap": ({"bench": {"optics": {"lens_cap": True}}}, "is the lens cap on"),
    "drift": (
        {"bench": {"optics": {"lamp_drift_per_frame": 0.01}}},
        r"\d\.\d% (brighter|darker).*let the lamp warm up",
    ),
    "quarter turn": ({"bench": {"stage": {"zero_deg": 100.0}}}, "stands -90.00° from.*stage.zero_deg"),
    "three degrees": ({"bench": {"stage": {"zero_deg": 13.0}}}, "stands -3.00° from.*stage.zero_deg"),
    "sense": ({"bench": {"stage": {"turns": "cw"}}}, "check the rotation sense"),
    "scale": ({"rig": {"camera": {"pixel_um": 8.3}}}, "8.0.. µm a pixel, the rig file 8.3 µm"),
    "region": (
        {"recipe": {"region": {"size_mm": [0.4, 4.4], "center_mm": [0.85, 0.0]}}},
        "outside the picture",
    ),
}


DRAWN = ("drift", "lens cap")  # with and without contrasts


@pytest.mark.parametrize("case", INVALID)
def test_an_unfit_measurement_is_invalid_and_says_why(virtual_rig, case):
    changes, message = INVALID[case]
    rig = virtual_rig(**changes)
    inspected = rig.inspect(methods=Methods()) if case in DRAWN else rig.inspect()
    record = read_record(inspected.folder)
    assert record.verdict == "INVALID"
    (reason,) = record.reasons
    assert re.search(message, reason), reason
    assert bool(record.details.contrasts) == (case == "drift")  # what could be measured is kept
    assert (inspected.report.stat().st_size > 10_000) == (case in DRAWN)
    assert not rig.bench.light_on


@pytest.mark.parametrize(
    ("turns", "backlash"),
    [
        ("ccw", 1.0),
        ("cw", 1.0),
        *(pytest.param(turns, 0.0, marks=pytest.mark.soak) for turns in ("ccw", "cw")),
    ],
)
def test_neither_the_sense_of_the_stage_nor_backlash_matters_where_the_rig_file_is_right(
    virtual_rig, turns, backlash
):
    stage = {"turns": turns, "zero_deg": 10.0 if turns == "ccw" else 200.0}
    rig = virtual_rig(rig={"stage": stage}, bench={"stage": {**stage, "backlash_deg": backlash}})
    record = rig.inspect().record
    assert record.verdict == "PASS"
    assert [pose.marker_angle_deg % 360 for pose in record.poses[1:]] == pytest.approx([90.0, 180.0], abs=0.1)


def lying(azimuth_deg):
    """Ridges whose facets lean toward an azimuth: z as a function of the coordinate along it."""
    at = np.arange(-600.0, 601.0, 2.0)
    x, y = np.meshgrid(at, at)
    along = {0: x, 90: y, 180: -x, 270: -y}[azimuth_deg]
    return HeightMap(RidgeDesign(100.0, 10.0).profile(along + 600.0), 2.0, 2.0)


@pytest.mark.parametrize(
    "azimuth",  # two of them, and what is said wrongly, are all that can be said
    [90, *(pytest.param(azimuth, marks=pytest.mark.soak) for azimuth in (0, 180, 270))],
)
def test_a_part_that_lies_turned_in_the_fixture_passes_where_the_recipe_says_so(
    virtual_rig, undiagnosed, tmp_path, azimuth
):
    write_height_map(lying(azimuth), tmp_path / "part.x3p")
    lobe = {
        "alpha_along": 0.08,
        "alpha_across": 0.08,
    }  # the bench counts a map's roughness along the map's axes
    sample = {"kind": "height-map", "file": str(tmp_path / "part.x3p"), "material": lobe}
    region = {"size_mm": [1.0, 0.8]}
    verdicts = {}
    for name, said in (
        ("right", azimuth),
        ("wrong", (azimuth + 90) % 360),
        ("opposite", (azimuth + 180) % 360),
    ):
        recipe = {"poses": {"facet_azimuth_deg": float(said)}, "region": region, "material": lobe}
        part = virtual_rig(name, recipe=recipe, bench={"sample": sample})
        verdicts[name] = part.inspect(methods=undiagnosed).record.verdict
    assert verdicts == {"right": "PASS", "wrong": "INVALID", "opposite": "FAIL"}


def test_the_height_map_of_the_part_itself_is_a_match_whichever_way_it_was_measured(virtual_rig, tmp_path):
    """The part leans toward 180° in the fixture; its map was measured with the part turned by a quarter."""
    write_height_map(lying(180), tmp_path / "part.x3p")
    write_height_map(lying(270), tmp_path / "measured.x3p")
    sample = {"kind": "height-map", "file": str(tmp_path / "part.x3p")}
    recipe = from_map(tmp_path / "measured.x3p") | {"poses": {"facet_azimuth_deg": 180.0}}
    rig = virtual_rig(recipe=recipe, bench={"sample": sample})
    assert rig.inspect().record.verdict == "PASS"


BEFORE = {
    "tilt": ({"recipe": {"poses": {"tilts_deg": [5.0]}}}, RigError, "a tilt of 5°"),
    "out of reach": (
        {"rig": {"stage": {"zero_deg": 90000.0}}},
        RigFileError,
        "a sample angle of 0°",
    ),
    "other camera": (
        {"bench": {"optics": {"pixel_um": 8.2}}},
        CalibrationError,
        "flat was taken with camera SIM-8UM",
    ),
    "other size": (
        {"bench": {"sensor": {"rows": 500}}},
        CalibrationError,
        "512 × 512 pixels, the frames 512 × 500",
    ),
    "no flat": ({"rig": {"calibration": None}}, RigFileError, "names no flat"),
    "missing flat": (
        {"rig": {"calibration": {"flat": "/none.tif"}}},
        RigFileError,
        "flat = /none.tif",
    ),
    "dictionary": ({"rig": {"fixture": {"dictionary": "DICT_NONE"}}}, RigFileError, "fixture.dictionary"),
    "silent": ({"bench": {"stage": {"faults": ["silent"]}}}, NotConnected, "is silent"),
    "bench": ({"bench": {"stage": {"faults": ["nonsense"]}}}, NotConnected, "no fault 'nonsense'"),
}


@pytest.mark.parametrize("case", BEFORE)
def test_what_can_be_known_before_the_first_picture_leaves_no_folder(virtual_rig, case):
    changes, error, message = BEFORE[case]
    rig = virtual_rig(**changes)
    with pytest.raises(error, match=message) as caught:
        rig.inspect()
    assert "\n" not in str(caught.value)
    assert not rig.folders


def test_a_cable_that_is_not_plugged_in_shows_before_the_prediction(virtual_rig):
    fail = lambda *_: pytest.fail("predicted for nothing")  # noqa: E731
    methods = Methods(predict=fail)
    for stage, error in (({"port": "/dev/ttyNOTHERE"}, NotConnected), ({"driver": "eliptec"}, RigFileError)):
        rig = virtual_rig(rig={"stage": stage})
        with pytest.raises(error, match="there is no"):
            rig.inspect(methods=methods)
        assert not rig.folders


@pytest.mark.parametrize(
    ("fault", "error"), [("stall:60", Stalled), ("silent:12", NotConnected), ("hangup:2", NotConnected)]
)
def test_hardware_that_fails_midway_leaves_frames_but_no_record_and_a_safe_rig(virtual_rig, fault, error):
    rig = virtual_rig(bench={"stage": {"faults": [fault]}}, rig={"stage": {"options": {"margin_s": 0.3}}})
    with pytest.raises(error) as caught:
        rig.inspect()
    assert "\n" not in str(caught.value)
    (folder,) = rig.folders
    assert {p.name for p in folder.iterdir()} == {"frames", "frames.jsonl", "inputs", "job.json"}
    assert len(read_journal(folder).frames) == len(list((folder / "frames").iterdir())) >= 2
    assert caught.value.__notes__[-1] == f"`anisoscope resume {folder}` goes on from here"
    assert not rig.bench.light_on
    assert not rig.bench.axis.busy()


@pytest.mark.parametrize(
    "serial",
    [
        "",
        " ",
        "<script>alert(1)</script>",
        "../up",
        ".hidden",
        "-x",
        "x" * 65,
        "x\n",
        "x ",
    ],
)
def test_serials_that_cannot_name_a_folder_are_refused_before_anything_is_touched(tmp_path, serial):
    with pytest.raises(UsageError, match="serial number"):
        inspection.inspect_part(tmp_path / "none.toml", tmp_path / "none.toml", serial, tmp_path / "out")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("serial", ["7", "x" * 64, "Lot 3 #12", "a..b", "A+b_c-d.e", "a/b", "a\\b", "ä"])
def test_serials_with_which_a_folder_can_be_named(serial):
    assert check_serial(serial) == serial


def test_two_inspections_in_one_second_have_two_folders(virtual_rig, monkeypatch):
    report = SimpleNamespace(write=lambda: ())
    monkeypatch.setattr(
        inspection, "conclude", lambda folder, *_: (inspection.Inspected(None, folder, folder), report)
    )
    rig = virtual_rig()
    assert rig.inspect().folder != rig.inspect().folder
    assert len(rig.folders) == 2


def test_an_output_folder_that_cannot_be_made_is_named(virtual_rig):
    rig = virtual_rig()
    rig.out.write_text("a file")
    with pytest.raises(RecordError, match="cannot make an inspection folder"):
        rig.inspect()


class Drawing:
    """Stands for the 3-D renderer: did somebody end it?"""

    def __init__(self):
        self.discarded = False

    def discard(self):
        self.discarded = True

    def result(self):
        return None


@pytest.mark.parametrize("step", ["_photograph", "judge", "write_record"])
@pytest.mark.parametrize("error", [RecordError("full"), KeyboardInterrupt()])
def test_the_renderer_is_ended_whatever_fails(virtual_rig, monkeypatch, step, error):
    drawing = Drawing()

    def fail(*_, **__):
        raise error

    monkeypatch.setattr(inspection, step, fail)
    with pytest.raises(type(error)):
        virtual_rig().inspect(methods=Methods(start_renderer=lambda _: drawing))
    assert drawing.discarded


def test_no_process_outlives_a_failed_inspection(virtual_rig, reference_map, monkeypatch, tmp_path):
    monkeypatch.setenv("ANISOSCOPE_CACHE", str(tmp_path / "cache"))  # nothing drawn yet
    started = []
    popen = subprocess.Popen

    def remember(*arguments, **options):
        started.append(popen(*arguments, **options))
        return started[-1]

    monkeypatch.setattr(subprocess, "Popen", remember)
    rig = virtual_rig(recipe=from_map(reference_map), bench={"stage": {"faults": ["silent:12"]}})
    with pytest.raises(NotConnected):
        rig.inspect(methods=Methods())
    assert len(started) == 1
    assert started[0].poll() is not None


@pytest.mark.parametrize("tilt", [pytest.param(-15.0, marks=pytest.mark.soak), 15.0])
def test_a_tilted_arm_sees_the_part_foreshortened_and_judges_it_all_the_same(virtual_rig, tmp_path, tilt):
    geometry = {"tilt_deg": tilt}
    tile = virtual_rig(
        "tile", rig={"geometry": geometry}, bench={"geometry": geometry, "sample": {"kind": "white-tile"}}
    )
    take_flat(tile.rig, tmp_path / "flat.tif", exposure_s=0.0015, frames=4)
    rig = {"geometry": geometry, "calibration": {"flat": str(tmp_path / "flat.tif")}}
    recipe = {
        "poses": {"tilts_deg": [tilt]},
        "region": {"size_mm": [0.9, 0.9]},
        "material": {"u_alpha_share": 0.01},
    }
    part = virtual_rig("part", rig=rig, bench={"geometry": geometry}, recipe=recipe)
    record = part.inspect().record
    assert record.verdict == "PASS", record.reasons
    assert all(pose.residual_px < 0.1 for pose in record.poses)
    for pose in record.poses:  # 180° shows light of several reflections, which corners of the mesh cut
        assert pose.measured == pytest.approx(pose.predicted, rel=0.03)
    upright = virtual_rig("upright", bench={"geometry": geometry}, recipe=merged_poses(recipe))
    assert upright.inspect().record.verdict == "INVALID"


def merged_poses(recipe):
    """The same recipe for an arm that the rig file takes for upright."""
    return {**recipe, "poses": {"tilts_deg": [0.0]}}


TILTED_BENCH = {"tilt": {"address": "1", "zero_deg": 30.0}}
TILT = {
    "driver": "elliptec",
    "port": "sim://elliptec?bench=${here}/bench.toml",
    "zero_deg": 30.0,
    "options": {"address": "1", "move_gap_s": 0.0, "timeout_s": 0.2},
}
TILTS = {
    "poses": {"angles_deg": [0.0, 90.0, 180.0], "tilts_deg": [0.0, 10.0]},
    "region": {"size_mm": [0.9, 0.9]},
    "material": {"u_alpha_share": 0.01},
}


def test_a_recipe_with_several_tilts_on_a_second_axis_of_the_same_cable(virtual_rig, undiagnosed, tmp_path):
    tile = virtual_rig("tile", rig={"tilt": TILT}, bench={**TILTED_BENCH, "sample": {"kind": "white-tile"}})
    take_flat(tile.rig, tmp_path / "flat.tif", exposure_s=0.0015, frames=4)
    rig = {"tilt": TILT, "calibration": {"flat": str(tmp_path / "flat.tif")}}
    part = virtual_rig("part", recipe=TILTS, bench=TILTED_BENCH, rig=rig)
    record = part.inspect(methods=undiagnosed).record
    assert record.verdict == "PASS", record.reasons
    assert [(pose.stage_deg, pose.tilt_deg) for pose in record.poses] == [
        (stage, tilt) for tilt in (0.0, 10.0) for stage in (0.0, 90.0, 180.0)
    ]
    for pose in record.poses:  # 180° shows light of several reflections, which corners of the mesh cut
        assert pose.measured == pytest.approx(pose.predicted, rel=0.03)
    lit = [frame for frame in record.frames if frame.kind == "sample"]
    assert [round(frame.tilt_deg, 1) for frame in lit] == [0.0] * 6 + [10.0] * 6 + [0.0] * 2
    assert ", " in record.stage


def test_a_tilt_set_by_hand(virtual_rig, undiagnosed, monkeypatch):
    rig = virtual_rig(recipe=TILTS, rig={"tilt": {"driver": "manual"}})
    asked = []

    def ask(request):
        asked.append(request)
        (tilt,) = (float(word[:-1]) for word in request.split() if word.endswith("°"))
        bench = rig.bench
        geometry = bench.file.geometry.model_copy(update={"tilt_deg": tilt})
        bench.file = bench.file.model_copy(update={"geometry": geometry})

    monkeypatch.setattr(manual, "_need_a_terminal", lambda _: None)
    monkeypatch.setattr(manual, "prompt_in_terminal", ask)
    record = rig.inspect(methods=undiagnosed).record
    assert record.verdict == "PASS", record.reasons
    assert asked == [f"set the tilt to {tilt}°" for tilt in (0, 10, 0)]


def test_eight_bits_do_as_well_as_twelve(virtual_rig, inspected_part, tmp_path):
    coarse = {"sensor": {"bit_depth": 8, "gain_e_per_dn": 120.0, "black_level": 4.0}}
    tile = virtual_rig("tile", bench={**coarse, "sample": {"kind": "white-tile"}}, rig={"calibration": None})
    take_flat(tile.rig, tmp_path / "flat.tif", exposure_s=0.0015, frames=8)
    own = {"calibration": {"flat": str(tmp_path / "flat.tif")}}
    fine, rough = inspected_part[1].record, virtual_rig("8", bench=coarse, rig=own).inspect().record
    assert (fine.verdict, rough.verdict) == ("PASS", "PASS")
    for one, other in zip(fine.details.contrasts, rough.details.contrasts, strict=True):
        assert other.measured == pytest.approx(one.measured, abs=0.1 * one.u)
        assert other.u == pytest.approx(one.u, rel=0.01)
