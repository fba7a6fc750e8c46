"""``anisoscope ink`` as its users run it, on the examples of its page."""

import re
import shlex
from pathlib import Path

import numpy as np
import pytest

from anisoscope.sim.light.ink.model import brdf_at_angles
from anisoscope.sim.materials.inks import read_ink, synthetic_ink

DOCS = Path(__file__).resolve().parents[3] / "docs" / "inks.md"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Readings of a synthetic ink at 2 % noise, as ratios to a white of 99 %, and the files that the page shows."""
    here = tmp_path_factory.mktemp("ink")
    ink, rng = synthetic_ink("synthetic-red"), np.random.default_rng(6)
    rows = ["theta_i_deg,theta_o_deg,wavelength_nm,value"]
    for i in (20, 35, 50, 65):
        for o in sorted({*range(0, 76, 15), i}):
            values = brdf_at_angles(ink, i, o) * np.pi / 0.99 * (1 + 0.02 * rng.standard_normal(41))
            rows += [f"{i},{o},{nm:g},{value:.6g}" for nm, value in zip(ink.nm, values, strict=True)]
    (here / "red.csv").write_text("\n".join(rows) + "\n")
    text = DOCS.read_text(encoding="utf-8")
    (here / "mine.toml").write_text(re.search(r"```toml\n(.*?)```", text, re.DOTALL).group(1))
    (here / "lamp.csv").write_text(
        re.search(r"```csv\n(wavelength_nm,power.*?)```", text, re.DOTALL).group(1)
    )
    return here


def test_every_command_of_the_page_runs(anisoscope, folder):
    commands = re.findall(r"^anisoscope (ink .*)$", DOCS.read_text(encoding="utf-8"), re.MULTILINE)
    assert len(commands) >= 5
    for command in commands:
        done = anisoscope(*shlex.split(command.partition("#")[0]), cwd=folder)
        assert done.code == 0, (command, done.err)
    for name in ("red-fit.html", "inks.html"):
        page = (folder / name).read_text(encoding="utf-8")
        assert "default-src 'none'" in page
        assert not re.search(r"(src|href)=[\"']?https?:", page)
    assert (folder / "inks.png").read_bytes().startswith(b"\x89PNG")
    assert read_ink(folder / "red.toml").alpha == pytest.approx(0.19, rel=0.01)


def test_json_of_a_fit(anisoscope, folder):
    done = anisoscope("ink", "fit", folder / "red.csv", "--json")
    assert done.code == 0, done.err
    found, ink = done.json, synthetic_ink("synthetic-red")
    assert abs(found["alpha"]["value"] - 0.19) < 4 * found["alpha"]["u"]
    assert found["wavelengths_nm"] == ink.nm.tolist()
    for name, true in (("rho", ink.rho), ("c", ink.c)):
        value, u = np.array(found[name]["value"]), np.array(found[name]["u"])
        assert np.mean(np.abs(value - true) < 2 * u) > 0.8
    assert (found["dropped"], found["warnings"], found["method"]) == ([], [], "joint")
    brdf = anisoscope("ink", "fit", folder / "red.csv", "--values", "brdf", "--json").json
    np.testing.assert_allclose(np.divide(brdf["rho"]["value"], found["rho"]["value"]), np.pi / 0.99)


def test_the_table_of_a_fit_says_scale_and_warnings(anisoscope, folder):
    done = anisoscope("ink", "fit", folder / "red.csv", "--floor", "0.01", "--reflectance", "0.95")
    assert done.code == 0, done.err
    assert "BRDF = 0.95/π × ratio" in done.out
    assert "one plane was read: taken as isotropic" in done.out
    assert re.search(r"warning: \d+ readings dropped: \d+ near the noise floor", done.out)


def test_colours_against_angle(anisoscope):
    done = anisoscope("ink", "show", "synthetic-red", "synthetic-blue", "--light-angles", "0,60", "--json")
    found = done.json
    assert [one["name"] for one in found["inks"]] == ["synthetic red", "synthetic blue"]
    for one in found["inks"]:
        assert one["delta_e2000"][0] == 0.0
        assert one["delta_e2000"][1] > 5.0
    red, blue = (np.array(one["xyz"]) for one in found["inks"])
    assert red[0, 0] > red[0, 2]
    assert blue[0, 2] > blue[0, 0]
    brightest = max(
        int(code[i : i + 2], 16) for one in found["inks"] for code in one["srgb"] for i in (1, 3, 5)
    )
    assert brightest == 255
    plain = anisoscope(
        "ink", "show", "synthetic-red", "--light-angles", "0,60", "--illuminant", "a", "--adapt"
    ).out
    assert "Bradford" in plain
    assert "not measured" in plain


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (("show",), 64, "needs an ink"),
        (("show", "crimson"), 64, "known: synthetic-red"),
        (("show", "none.toml"), 78, "no such file"),
        (("show", "synthetic-red", "--illuminant", "d50"), 64, "known: d65"),
        (("show", "synthetic-red", "--light-angles", "0,95"), 64, "between 0 and 90"),
        (("show", "synthetic-red", "--brightness", "-1"), 64, "above 0"),
        (("show", "synthetic-red", "--png", "x.gif"), 64, "*.png or *.svg"),
        (("show", "synthetic-red", "--light-angles", "30", "--off-mirror", "nan"), 64, "--off-mirror takes"),
        (("show", "synthetic-red", "--off-mirror", "95"), 64, "--off-mirror takes"),
        (("show", "synthetic-red", "--html", "x.png"), 64, "--html writes *.html"),
        (("fit", "red.csv", "--out", "red.csv"), 64, "--out writes *.toml"),
        (("fit", "red.csv", "--html", "red.csv"), 64, "--html writes *.html"),
        (("fit", "none.csv"), 64, "cannot read none.csv"),
        (("fit", "red.csv", "--values", "brdf", "--reflectance", "0.9"), 64, "--values factor"),
        (("fit", "red.csv", "--white-table", "red.csv"), 64, "the header must read"),
    ],
)
def test_bad_input_is_one_line(anisoscope, folder, arguments, code, words):
    done = anisoscope("ink", *arguments, cwd=folder)
    assert done.code == code, done.err
    assert words in done.err
    assert done.err.count("\n") == 1


@pytest.mark.parametrize(
    ("arguments", "name", "again"),
    [
        (("fit", "red.csv", "--fit-method", "paper", "--out"), "kept.toml", True),
        (("fit", "red.csv", "--html"), "kept.html", False),
        (("show", "synthetic-red", "--html"), "kept.html", False),
        (("show", "synthetic-red", "--png"), "kept.svg", False),  # with --overwrite: on the page
        (("compare", "--synthetic", "--picture-size", "32", "--png"), "kept.png", True),
    ],
)
def test_files_are_replaced_only_on_demand(anisoscope, folder, tmp_path, arguments, name, again):
    kept = tmp_path / name
    kept.write_text("mine")
    refused = anisoscope("ink", *arguments, kept, cwd=folder)
    assert (refused.code, refused.out) == (64, "")
    page = f"(see anisoscope ink {arguments[0]} --help)"
    assert refused.err == f"anisoscope: {kept} exists; give another name, or --overwrite {page}\n"
    assert kept.read_text() == "mine"
    if again:
        done = anisoscope("ink", *arguments, kept, "--overwrite", cwd=folder)
        assert done.code == 0, done.err
        assert kept.read_bytes() != b"mine"


def test_a_table_of_spectral_parameters_becomes_an_ink(anisoscope, tmp_path):
    """The synthetic red ink, written as a table and imported, has the BRDF it had."""
    ink = synthetic_ink("synthetic-red")
    table, out = tmp_path / "red.csv", tmp_path / "red.toml"
    rows = [f"{nm:g},{rho},{c}" for nm, rho, c in zip(ink.nm, ink.rho_brdf, ink.c_values, strict=True)]
    table.write_text("wavelength_nm,rho,c\n" + "\n".join(rows) + "\n", encoding="utf-8")
    done = anisoscope("ink", "import", table, "--alpha", ink.alpha, "--out", out, "--json")
    assert done.code == 0, done.err
    assert done.json["wavelengths"] == ink.nm.size
    np.testing.assert_allclose(
        brdf_at_angles(read_ink(out), 30.0, 35.0), brdf_at_angles(ink, 30.0, 35.0), rtol=1e-5
    )
    short = tmp_path / "short.csv"
    short.write_text("wavelength_nm,rho,c\n450,0.1,1\n650,0.2,1\n", encoding="utf-8")
    for arguments, words in (
        ([table, "--alpha", 0.2, "--out", out], "--overwrite"),
        ([table, "--alpha", 0.2, "--out", tmp_path / "x.csv"], "--out writes *.toml"),
        ([short, "--alpha", 0.2, "--out", tmp_path / "y.toml"], "400 to 700 nm are needed"),
        ([table, "--alpha", 2, "--out", tmp_path / "z.toml"], "alpha"),
        ([table, "--alpha", 0.2, "--reflectance", 0.9, "--out", tmp_path / "z.toml"], "--scale factor"),
    ):
        wrong = anisoscope("ink", "import", *arguments)
        assert wrong.code not in (0, 1)
        assert words in wrong.err
        assert wrong.err.count("\n") == 1
