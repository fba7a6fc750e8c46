"""Export, show, import and fit from the command line; the formats themselves are tested in tests/inspect/bsdf."""

import csv
import re

import cv2
import numpy as np
import pytest

from anisoscope.base.errors import UsageError
from anisoscope.bsdf.reflectance import hemisphere, shuffled
from anisoscope.operations.reflectance import reflectance_of
from anisoscope.parameters.material import Material
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.profiles.files.load import write_height_map
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.sim.light import corrected

FLAT = ("--ridge-angle", "0", "--alpha-along", "0.1", "--alpha-across", "0.1")


@pytest.fixture(scope="module")
def flat(anisoscope, tmp_path_factory):
    path = tmp_path_factory.mktemp("bsdf") / "flat.bsdf"
    done = anisoscope("bsdf", "export", path, *FLAT, "--scene", path.with_suffix(".xml"), "--json")
    assert done.code == 0, done.err
    assert done.json["rms"] < 0.005
    return path


def test_show(anisoscope, flat):
    found = anisoscope("bsdf", "show", flat, "--json").json
    assert found["isotropic"]
    assert found["name"] == "flat plastic"
    assert found["reciprocity_rms"] < 0.01
    assert found["warnings"] == []
    assert 0.1 < found["albedo"]["0"] < found["albedo"]["60"] < 0.25
    assert "albedo, light at 60°" in anisoscope("bsdf", "show", flat).out


def test_what_goes_out_comes_in(anisoscope, flat, tmp_path):
    """Roughness of an exported surface, fitted to the table made of it; the file itself is that surface."""
    table = tmp_path / "table.csv"
    done = anisoscope("bsdf", "import", flat, "--out", table, "--pairs", "300", "--json")
    assert (done.code, done.json["negative"]) == (0, 0)
    with table.open(encoding="utf-8", newline="") as stream:
        assert len(list(csv.DictReader(stream))) == done.json["rows"]
    fitted = anisoscope("fit", "brdf", table, "--ridge-angle", "0", "--fit", "--json")
    assert fitted.code == 0, fitted.err
    for one in fitted.json["parameters"]:
        assert one["value"] == pytest.approx(0.1, rel=0.01), one["name"]
    right, wrong = (
        anisoscope("fit", "brdf", file, "--ridge-angle", "0", "--alpha-along", alpha, "--json").json
        for file, alpha in ((flat, "0.1"), (table, "0.11"))
    )
    assert right["rms_residual"] < 0.1 * wrong["rms_residual"]


def test_what_a_format_loses_is_printed(anisoscope, tmp_path):
    done = anisoscope("bsdf", "export", tmp_path / "flat.xml", *FLAT)
    assert "lost: lobes narrower than the patches" in done.out
    done = anisoscope("bsdf", "export", tmp_path / "ridges.xml", "--ridge-angle", "10", "--coarse")
    assert "lost: light that reflects more than 1 time" in done.out
    lost = [line for line in done.out.splitlines() if line.startswith("lost:")]
    assert all(re.search(r"[0-9]", line) for line in lost)


@pytest.mark.parametrize(
    "source",
    [
        ("--design", "lobe.toml", "--wavelength", "500"),
        ("--height-map", "steps.npz", "--optics", "waves", "--lamp-half-angle", "2", "--wavelength", "500"),
        pytest.param(
            ("--height-map", "steps.npz"), marks=pytest.mark.soak
        ),  # 135,000 pairs of directions by rays
    ],
)
def test_every_model_leaves(anisoscope, tmp_path, source):
    """Etched steps, and a height map by rays and by waves; ridges, inks and files are exported by other tests."""
    made = anisoscope("design", "antimirror", "--arrangement", "2,2", "--out", "lobe.toml", cwd=tmp_path)
    assert made.code == 0, made.err
    rng = np.random.default_rng(1)
    heights = np.kron(rng.integers(0, 2, (8, 8)) * 0.1, np.ones((4, 4)))
    write_height_map(HeightMap(heights, 0.5, 0.5), tmp_path / "steps.npz")
    done = anisoscope("bsdf", "export", "made.bsdf", *source, "--nodes", "4,5,8", "--json", cwd=tmp_path)
    assert done.code == 0, done.err
    assert done.json["losses"]
    shown = anisoscope("bsdf", "show", tmp_path / "made.bsdf", "--json").json
    assert 0.02 < shown["albedo"]["0"] < 2.0  # on so coarse a grid


def test_draft_crest_tail_and_reflections_are_those_of_the_surface():
    design, plastic = RidgeDesign(100.0, 10.0, 8.0, edge_radius_um=5.0), Material(tail=0.5)
    light, camera = hemisphere(6, 60.0), shuffled(hemisphere(6, 60.0, 0.5))
    for bounces, depth in ((1, 1), ("all", None)):
        found = reflectance_of(design, material=plastic, bounces=bounces).evaluate(light, camera)
        wanted = corrected.radiance(light, camera, design, plastic, depth) / light[:, 2]
        np.testing.assert_allclose(np.squeeze(found), wanted, rtol=1e-9)
    with pytest.raises(UsageError, match="--bounces must be 1 or more, or all, not 0"):
        reflectance_of(design, bounces=0)


def test_options_of_the_plastic_and_of_ridges_are_refused_by_name(anisoscope, tmp_path):
    nodes = ("--ridge-angle", "0", "--nodes", "4,5,8")
    refused = anisoscope("bsdf", "export", "a.bsdf", *nodes, "--material", "none.toml", cwd=tmp_path)
    assert (refused.code, "none.toml" in refused.err) == (78, True)
    refused = anisoscope("bsdf", "export", "a.bsdf", *nodes, "--tail", "3", cwd=tmp_path)
    assert "--tail: the tail of the lobe must lie between 0 and 1.6" in refused.err
    refused = anisoscope("bsdf", "export", "a.bsdf", "--height-map", "m.npz", "--wall", "5", cwd=tmp_path)
    assert "--wall belongs to ridges (--ridge-angle)" in refused.err


PLATE = """
schema = 1
kind = "plates"
product = "small"
surface = { pitch_um = 50.0, design = { ridge_angle_deg = 10.0 } }
material = { alpha_along = 0.08, alpha_across = 0.12, albedo = 0.2, index = 1.5 }
poses = { angles_deg = [0.0, 90.0] }
plan = { module_mm = 0.1, facet_azimuths_deg = { A = 0.0, B = 90.0 }, rows = ["AB.", "BAA"] }
acquisition = { exposure_s = 0.004 }
region = { size_mm = [0.4, 0.3] }
"""


def test_textures_of_a_plate_and_of_dots(anisoscope, tmp_path):
    """Masks, a reflectance a class, heights and normals; the classes are those of the plan."""
    (tmp_path / "plate.toml").write_text(PLATE, encoding="utf-8")
    ramp = np.linspace(0, 255, 16 * 3, dtype=np.uint8).reshape(4, 12)
    cv2.imwrite(str(tmp_path / "ramp.png"), np.stack([ramp, ramp[::-1], ramp[:, ::-1]], axis=-1))
    made = anisoscope("ink", "halftone", tmp_path / "ramp.png", "--out", tmp_path / "dots.png")
    assert made.code == 0, made.err
    for source, more in (("plate.toml", ()), ("dots.png", ("--wavelength", "550"))):
        out = tmp_path / source.partition(".")[0]
        arguments = (tmp_path / source, "--out", out, "--nodes", "3,5,4", *more)
        done = anisoscope("bsdf", "textures", *arguments, "--json")
        assert done.code == 0, done.err
        assert {path.name for path in out.iterdir()} == set(done.json["files"])
        assert any("rms off when read back" in note for note in done.json["notes"])
    plate = {path.name for path in (tmp_path / "plate").iterdir()}
    assert {"scene.xml", "class-0.bsdf", "class-1.bsdf", "class-2.bsdf", "height.png", "normals.exr"} <= plate
    mask = cv2.imread(str(tmp_path / "plate" / "mask-1.png"), cv2.IMREAD_UNCHANGED)
    assert np.array_equal(mask == 255, [[1, 0, 0], [0, 1, 1]])
    again = anisoscope("bsdf", "textures", tmp_path / "plate.toml", "--out", tmp_path / "plate")
    assert (again.code, "holds files" in again.err) == (64, True)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("export", "x.bsdf"), "one of --ridge-angle, --ink, --design, --height-map"),
        (("export", "x.bsdf", "--ridge-angle", "10", "--ink", "synthetic-red"), "one of --ridge-angle"),
        (("export", "x.binary", "--ridge-angle", "10"), "isotropic surfaces only"),
        (("export", "x.txt", "--ridge-angle", "10"), "name the format of another extension"),
        (("export", "x.xml", "--ridge-angle", "10", "--scene", "s.xml"), "belongs to RGL"),
        (("export", "x.bsdf", "--ridge-angle", "10", "--nodes", "24"), "three whole numbers"),
        (("export", "x.bsdf", "--ridge-angle", "10", "--nodes", "240,720,512"), "GiB"),
        (
            ("export", "x.bsdf", "--ink", "synthetic-red", "--wavelength", "900"),
            "380 to 780 nm, not at 900 nm",
        ),
        (("show", "missing.bsdf"), "cannot read missing.bsdf"),
        (("import", "missing.csv", "--out", "t.csv"), "cannot read missing.csv"),
        (("import", "missing.csv", "--out", "t.csv", "--columns", "value"), "NAME=COLUMN"),
    ],
)
def test_bad_input(anisoscope, tmp_path, arguments, words):
    done = anisoscope("bsdf", *arguments, cwd=tmp_path)
    assert done.code == 64
    assert words in done.err
    assert list(tmp_path.iterdir()) == []
