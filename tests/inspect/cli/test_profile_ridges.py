import numpy as np
import pytest

from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.profiles.editing.steps import Step
from anisoscope.profiles.files.load import read_height_map, write_height_map
from anisoscope.profiles.ideal import add_facet_roughness, ridges

KEYS = (
    "pitch_um", "direction_deg", "ridge_angle_deg", "wall_angle_deg", "height_um", "height_loss", "edge_radius_um",
    "alpha_along", "alpha_across",
)  # fmt: skip


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    rng = np.random.default_rng(1)
    surface = add_facet_roughness(ridges(RidgeDesign(60.0, 10.0), (400, 500), 1.0, 0.3), 0.05, 0.08, 6.0, rng)
    z = surface.height_um + 0.02 * rng.standard_normal(surface.shape)
    z[:20, :30] = np.nan
    y, x = np.indices(z.shape)
    z += 6.0 * np.maximum(0.0, 1.0 - ((x - 213) / 8) ** 2 - ((y - 200) / 12) ** 2)
    where = tmp_path_factory.mktemp("maps")
    write_height_map(surface.with_height(z), where / "ridged.x3p")
    write_height_map(surface.with_height(rng.standard_normal(z.shape)), where / "random.x3p")
    return where


def test_json(anisoscope, folder):
    done = anisoscope("profile", "ridges", folder / "ridged.x3p", "--json")
    assert done.code == 0, done.err
    found = done.json
    for key in KEYS:
        assert {"value", "u"} <= set(found[key])
    assert found["pitch_um"]["value"] == pytest.approx(60.0, abs=0.05)
    assert found["ridge_angle_deg"]["value"] == pytest.approx(10.0, abs=0.1)
    assert found["wall_angle_deg"]["value"] is None  # 1.8 µm wide, less than two pixels
    assert found["wall_angle_deg"]["at_least"] > 60.0
    assert found["alpha_across"]["value"] == pytest.approx(0.08, rel=0.05)
    assert found["bandwidth_um"][0] == 1.0
    assert found["missing_share"] == pytest.approx(600 / 200_000)
    assert len(found["ridges"]) >= 7
    assert set(found["ridges"][2]) >= {"number", "position_um", "angle_deg", "height_um"}
    (burr,) = [one for one in found["burrs"] if one["kind"] == "burr"]
    assert (burr["x_um"], burr["y_um"]) == pytest.approx((213, 200), abs=2.0)
    assert burr["height_um"] == pytest.approx(6.0, abs=1.0)


def test_lengths_may_have_a_unit(anisoscope, folder, tmp_path):
    done = anisoscope("profile", "ridges", folder / "ridged.x3p", "--json", "--tip-radius", "0.5um")
    assert done.json["tip_radius_um"] == 0.5
    done = anisoscope("profile", "ridges", folder / "ridged.x3p", "--period-limit", "10kg")
    assert (done.code, done.err.count("\n")) == (64, 1)
    assert "--period-limit 10kg: 'kg' is no unit of it; it takes nm, um" in done.err
    done = anisoscope("profile", "ridges", folder / "ridged.x3p", "--tip-radius", "12")
    assert (done.code, done.err.count("\n")) == (64, 1)
    assert "no tip shows a crest sharper than itself" in done.err
    cut = tmp_path / "cut.npz"
    done = anisoscope("profile", "crop", folder / "ridged.x3p", "0.1mm", "--x1", "200um", "--out", cut)
    assert done.code == 0, done.err
    assert read_height_map(cut).shape == (400, 101)
    assert Step.parse("crop=0.1mm,0,200um").values["x1"] == 200.0
    done = anisoscope("profile", "crop", folder / "ridged.x3p", "far", "--out", cut)
    assert "x0 takes a number of µm, not 'far'" in done.err


def test_table_has_units_and_uncertainties(anisoscope, folder):
    done = anisoscope("profile", "ridges", folder / "ridged.x3p")
    assert done.code == 0, done.err
    for word in (
        "pitch",
        "ridge angle",
        "alpha across",
        "µm",
        "u (k = 1)",
        "≥",
        "burr",
        "periodicity",
        "height [µm]",
    ):
        assert word in done.out


def test_a_map_without_ridges_is_refused_in_one_line(anisoscope, folder):
    done = anisoscope("profile", "ridges", folder / "random.x3p", "--json")
    assert done.code == 65
    assert done.out == ""
    assert done.err.count("\n") == 1
    assert "no ridges found" in done.err
    assert "0.5" in done.err


def test_report_of_a_ridged_map(anisoscope, folder):
    page = folder / "page.html"
    done = anisoscope("profile", "report", folder / "ridged.x3p", "--out", page)
    assert done.code == 0, done.err
    text = page.read_text(encoding="utf-8")
    for part in (
        'id="map"',
        'id="numbers"',
        'id="ridges"',
        'id="burrs"',
        'id="amplitude"',
        "α across",
        "x3p",
    ):
        assert part in text
    assert ('id="view"' in text) != ('id="no-view"' in text)
    assert "http://" not in text.replace("http://www.w3.org", "")
    assert 'src="data:image' in text
    again = anisoscope("profile", "report", folder / "ridged.x3p", "--out", page)
    assert again.code == 64
    assert "--overwrite" in again.err


def test_report_of_a_map_without_ridges_says_why(anisoscope, folder):
    page = folder / "random.html"
    assert anisoscope("profile", "report", folder / "random.x3p", "--out", page).code == 0
    text = page.read_text(encoding="utf-8")
    assert "no ridges found" in text
    assert 'id="reason"' in text
    assert 'id="numbers"' not in text
    assert 'id="amplitude"' in text


def test_a_report_is_html(anisoscope, folder):
    done = anisoscope("profile", "report", folder / "ridged.x3p", "--out", folder / "page.pdf")
    assert done.code == 64
    assert "*.html" in done.err


def test_a_map_of_several_directions_is_listed_and_drawn_by_regions(anisoscope, tmp_path):
    board, picture = tmp_path / "board.npz", tmp_path / "regions.png"
    made = anisoscope(
        "profile", "make", "checkerboard", "--size", "1200", "--pixel", "4", "--square", "600", "--out", board
    )
    assert made.code == 0, made.err
    done = anisoscope("profile", "ridges", board, "--json", "--picture", picture)
    assert done.code == 0, done.err
    assert sorted(done.json["facet_azimuths_deg"]) == pytest.approx([-90.0, 0.0], abs=0.1)
    assert len(done.json["regions"]) == 4
    for one in done.json["regions"]:
        assert one["ridge_angle_deg"]["value"] == pytest.approx(10.0, abs=0.05)
        assert one["pitch_um"] == pytest.approx(100.0, rel=0.01)
    assert picture.read_bytes().startswith(b"\x89PNG")
    table = anisoscope("profile", "ridges", board)
    assert "regions of one direction" in table.out


def test_a_picture_of_regions_needs_several_of_them(anisoscope, folder, tmp_path):
    done = anisoscope("profile", "ridges", folder / "ridged.x3p", "--picture", tmp_path / "one.png")
    assert done.code == 64
    assert "--picture shows the regions of a map with several directions" in done.err
    assert not (tmp_path / "one.png").exists()
