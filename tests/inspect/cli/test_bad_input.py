"""Whatever is wrong: one clear line, the right exit code, no traceback, no half-written record."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from cyclopts import App

from anisoscope import cli
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.profiles.files.load import write_height_map
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.profiles.ideal import ridges


@pytest.fixture
def job(virtual_rig, flat):
    """``job(bench={...})``: a part on the small rig with a map as reference, whose files may be spoiled."""

    def laid_out(**bench):
        surface = {"design": None, "height_map": "reference.x3p"}
        recipe = {"surface": surface, "poses": {"angles_deg": [0.0, 90.0, 180.0]}}
        job = virtual_rig(recipe=recipe, bench=bench)
        ridged = ridges(RidgeDesign(pitch_um=100.0, ridge_angle_deg=10.0), (401, 401), (1.0, 1.0))
        write_height_map(ridged, job.recipe.with_name("reference.x3p"))
        shutil.copy(flat, job.rig.with_name("flat.tif"))
        edit(job.rig, str(flat), "flat.tif")
        return job

    return laid_out


def edit(path, old, new):
    text = path.read_text(encoding="utf-8")
    assert old in text
    path.write_text(text.replace(old, new), encoding="utf-8")


def inspect(anisoscope, job, *extra, serial="P-1"):
    files = (f"--recipe={job.recipe}", f"--rig={job.rig}", f"--out={job.out}")
    return anisoscope("inspect", *files, f"--serial={serial}", *extra)


def assert_one_line(done, code, *words):
    assert done.code == code, done.err
    lines = [line for line in done.err.splitlines() if line.startswith("anisoscope:")]
    assert len(lines) == 1, done.err
    assert "Traceback" not in done.err
    for word in words:
        assert word in lines[0]


def records(job):
    return list(job.out.rglob("record.json"))


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("exposure_s = 0.0015", 'exposure_s = "6 ms"', ("acquisition.exposure_s", "number")),
        ("exposure_s = 0.0015", "exposure_ms = 6", ("exposure_ms",)),
        ("tolerance = 0.25", "tolerence = 0.25", ("tolerence", "tolerance")),
        ("pitch_um = 100.0", "pitch_um = -100.0", ("surface.pitch_um",)),
        ("alpha_along = 0.06", "alpha_along = 5.5", ("alpha along",)),
        ("schema = 1", "schema = 7", ("schema",)),
        ("tolerance = 0.25", "tolerance = 25.0", ("ln ratio", "factor of 7.2e+10")),
        ("schema = 1", "schema = = 1", ("recipe.toml",)),
        ("reference.x3p", "nowhere.x3p", ("nowhere.x3p",)),
        ("pitch_um = 100.0", "pitch_um = 80.0", ("100", "80")),
        ("angles_deg", "tilts_deg = [0.0, 10.0]\nangles_deg", ("tilt", "10")),
    ],
)
def test_wrong_recipe(anisoscope, job, old, new, words):
    job = job()
    edit(job.recipe, old, new)
    done = inspect(anisoscope, job)
    assert_one_line(done, done.code, *words)
    assert 64 <= done.code < 128
    assert records(job) == []


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("port = ", "prot = ", ("stage", "port")),
        ('driver = "elliptec"', 'driver = "eliptec"', ("eliptec", "elliptec")),
        ('port = "sim://elliptec', 'port = "/dev/ttyNOTHING?', ("/dev/ttyNOTHING",)),
        ('driver = "simulated"', 'driver = "kodak"', ("kodak",)),
        ("zero_deg = 10.0", "zero_deg = 90000.0", ("zero_deg",)),
        ('name = "virtual rig"', 'name = "virtual rig"\ncolour = "red"', ("colour",)),
    ],
)
def test_wrong_rig_file(anisoscope, job, old, new, words):
    job = job()
    edit(job.rig, old, new)
    done = inspect(anisoscope, job)
    assert_one_line(done, done.code, *words)
    assert 64 <= done.code < 128
    assert records(job) == []


@pytest.mark.parametrize(
    "serial",
    ["<script>alert(1)</script>", "../../etc/passwd", "", " ", "a ", "x" * 65, "a\x1b[2J", "a\nb", "-rf"],
)
def test_serials_that_could_do_harm(anisoscope, job, serial):
    job = job()
    assert_one_line(inspect(anisoscope, job, serial=serial), 64, "serial")
    assert not job.out.exists()


@pytest.mark.parametrize(
    ("fault", "words"),
    [("silent", ("silent",)), ("stall:100", ("stage",)), ("wrong-address", ()), ("hangup", ())],
)
def test_stage_in_trouble(anisoscope, job, fault, words):
    job = job(stage={"faults": [fault]})
    done = inspect(anisoscope, job)
    assert_one_line(done, 69, *words)
    assert records(job) == []


def test_a_noisy_line_is_borne_in_silence(anisoscope, job):
    """All pictures are taken; a cap on the lens ends it there, since causes and report take longer than they do."""
    job = job(stage={"faults": ["garbage"]}, optics={"lens_cap": True})
    done = inspect(anisoscope, job, "--json")
    assert (done.code, done.json["verdict"]) == (3, "INVALID")
    assert "lens cap" in done.json["reasons"][0]
    assert "damaged" not in done.err


def test_saturated_frames_are_invalid_and_recorded(anisoscope, job):
    job = job()
    edit(job.recipe, "exposure_s = 0.0015", "exposure_s = 0.03")
    done = inspect(anisoscope, job, "--json")
    assert done.code == 3
    assert done.json["verdict"] == "INVALID"
    assert "saturated" in done.json["reasons"][0]
    assert "exposure_s" in done.json["reasons"][0]
    assert len(records(job)) == 1
    assert "INVALID" in (records(job)[0].parent / "report.html").read_text(encoding="utf-8")


def test_lens_cap_is_invalid(anisoscope, job):
    done = inspect(anisoscope, job(optics={"lens_cap": True}), "--json")
    assert done.code == 3
    assert "lens cap" in done.json["reasons"][0]


def test_a_damaged_flat_is_invalid_and_a_missing_one_a_wrong_rig_file_before_anything_moves(anisoscope, job):
    job = job()
    flat = job.rig.with_name("flat.tif")
    flat.write_bytes(flat.read_bytes()[:1000])
    assert_one_line(inspect(anisoscope, job), 3, "flat.tif", "calibrate flat")
    flat.unlink()
    assert_one_line(inspect(anisoscope, job), 78, "[calibration]", "flat.tif", "calibrate flat")
    assert records(job) == []


def test_truncated_x3p(anisoscope, job):
    job = job()
    reference = job.recipe.with_name("reference.x3p")
    reference.write_bytes(reference.read_bytes()[: reference.stat().st_size // 2])
    assert_one_line(inspect(anisoscope, job), 65, "reference.x3p")
    assert_one_line(anisoscope("profile", "info", reference), 65, "reference.x3p")
    assert_one_line(anisoscope("predict", reference), 65, "reference.x3p")


COMMANDS_WITH_MAPS = ("profile", "info"), ("predict",)


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("letter.txt", "Dear colleague,\nthe map is in the other mail.\n", ("letter.txt",)),
        ("empty.csv", "", ("empty.csv",)),
        ("photo.jpg", "\xff\xd8", ("photo.jpg",)),
        ("ragged.txt", "1 2 3 4\n1 2 3\n", ("ragged.txt",)),
    ],
)
def test_files_that_are_no_map(anisoscope, tmp_path, name, content, words):
    (tmp_path / name).write_text(content, encoding="latin-1")
    for command in COMMANDS_WITH_MAPS[
        : 1 if name == "photo.jpg" else None
    ]:  # a library of others reads it, in seconds
        assert_one_line(anisoscope(*command, tmp_path / name, "--pixel", 1), 65, *words)


def test_a_folder_that_cannot_be_written(anisoscope, job):
    job = job()
    job.out.write_text("a file where the folder should be")
    assert_one_line(inspect(anisoscope, job), 74, "inspections")


def test_debug_shows_the_traceback(anisoscope, tmp_path):
    done = anisoscope("--debug", "profile", "info", tmp_path / "nothing.x3p")
    assert "Traceback" in done.err


def test_profile_info_in_json(anisoscope, tmp_path):
    height = np.arange(12.0).reshape(3, 4)
    height[1, 1] = np.nan
    write_height_map(HeightMap(height, 0.5, 0.25), tmp_path / "map.x3p")
    found = anisoscope("profile", "info", tmp_path / "map.x3p", "--json").json
    assert (found["rows"], found["cols"], found["pixel_um"]) == (3, 4, [0.25, 0.5])
    known = height[np.isfinite(height)]
    assert found["missing_share"] == pytest.approx(1 / 12)
    assert found["sa_um"] == pytest.approx(np.mean(np.abs(known - known.mean())))
    assert found["sq_um"] == pytest.approx(np.std(known))
    assert found["sz_um"] == pytest.approx(np.ptp(known))


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (["predict", "--ridge-angle", "10", "--facet-azimuth", "nan"], 64, "azimuth"),
        (["predict", "MAP", "--pitch", "nan"], 64, "pitch"),
        (["predict", "MAP", "--pitch", "-5"], 65, "pitch"),
        (["predict", "--ridge-angle", "10", "--pitch", "inf"], 64, "pitch"),
        (["demo", "--seed", "-1"], 64, "--seed"),
        (["demo", "--out", "/proc/nowhere"], 74, "/proc/nowhere"),
        (["demo", "--out", "FILE"], 74, "cannot make"),
        (["rig", "sim", "elliptec", "--tcp", "0", "--time-scale", "nan"], 64, "--time-scale"),
        (["rig", "sim", "elliptec"], 64, "--pty"),
    ],
)
def test_numbers_that_are_none(anisoscope, tmp_path, arguments, code, words):
    (tmp_path / "file").write_text("")
    write_height_map(
        HeightMap(np.random.default_rng(1).normal(size=(40, 50)), 1.0, 1.0), tmp_path / "map.x3p"
    )
    places = {"MAP": str(tmp_path / "map.x3p"), "FILE": str(tmp_path / "file")}
    done = anisoscope(*[places.get(argument, argument) for argument in arguments])
    assert_one_line(done, code, words)
    assert done.err.count("\n") == 1


def test_an_error_that_no_command_foresaw_is_never_the_code_of_a_verdict(monkeypatch, capsys):
    def unforeseen():
        raise np.linalg.LinAlgError("Singular matrix")

    broken = App(name="anisoscope", result_action="return_value")
    broken.command(unforeseen, name="inspect")
    monkeypatch.setattr(cli, "app", broken)
    assert cli.run(["inspect"]) == 70
    message = capsys.readouterr().err
    assert message.count("\n") == 1
    assert "LinAlgError: Singular matrix" in message
    log = Path(message.split("details are in ")[1].split(";")[0])
    try:
        assert "in unforeseen" in log.read_text(encoding="utf-8")
    finally:
        log.unlink()
    with pytest.raises(np.linalg.LinAlgError):
        cli.run(["inspect", "--debug"])


@pytest.mark.parametrize(
    "command",
    [
        ["predict", "--ridge-angle", "10"],
        ["predict", "part.x3p"],
        ["render", "frame", "--ridge-angle", "10", "--out", "x.png"],
        ["bsdf", "export", "x.bsdf", "--ridge-angle", "10"],
        ["design", "code", "A17", "--out", "code"],
        ["profile", "make", "ridges", "--out", "x.x3p"],
        ["optimise"],
        ["init", "job", "--ridge-angle", "10"],
        ["recipe", "new", "--ridge-angle", "10", "--out", "recipe.toml"],
        ["rig", "commission", "--ridge-angle", "10", "--rig", "rig.toml", "--exposure", "0.01"],
    ],
    ids=lambda words: " ".join(words[:2]),
)
def test_a_pitch_below_what_light_shows_asks_whether_mm_were_meant(command, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert cli.run([*command, "--pitch", "0.1"]) == 64
    assert "0.1 µm? ridges of 0.1 mm are --pitch 100 (or write 0.1mm)" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_a_recipe_takes_a_pitch_with_its_unit_and_asks_about_one_in_mm(capsys, tmp_path):
    recipe = tmp_path / "recipe.toml"
    assert cli.run(["recipe", "new", "--ridge-angle", "10", "--out", str(recipe)]) == 0
    text = recipe.read_text(encoding="utf-8")
    for pitch, code in (("0.1", 78), ('"0.1 mm"', 0), ('"100"', 0), ('"100 kg"', 78)):
        recipe.write_text(text.replace("pitch_um = 100.0", f"pitch_um = {pitch}"), encoding="utf-8")
        capsys.readouterr()
        assert cli.run(["predict", "--recipe", str(recipe), "--json"]) == code
        assert code == 0 or "pitch_um" in capsys.readouterr().err
