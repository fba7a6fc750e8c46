"""Export, show, import and fit from the command line; the formats themselves are tested in tests/inspect/bsdf."""

import csv

import pytest

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
    fitted = anisoscope("bsdf", "fit", table, "--ridge-angle", "0", "--fit", "--json")
    assert fitted.code == 0, fitted.err
    for one in fitted.json["parameters"]:
        assert one["value"] == pytest.approx(0.1, rel=0.01), one["name"]
    right, wrong = (
        anisoscope("bsdf", "fit", flat, "--ridge-angle", "0", "--alpha-along", alpha, "--json").json
        for alpha in ("0.1", "0.11")
    )
    assert right["rms_residual"] < 0.1 * wrong["rms_residual"]


def test_what_a_format_loses_is_printed(anisoscope, tmp_path):
    done = anisoscope("bsdf", "export", tmp_path / "flat.xml", *FLAT)
    assert "lost: lobes narrower than the patches" in done.out
    done = anisoscope("bsdf", "export", tmp_path / "ridges.xml", "--ridge-angle", "10")
    assert "lost: light that reflects more than 1 time" in done.out


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("export", "x.bsdf"), "one of --ridge-angle, --ink and --from-file"),
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
