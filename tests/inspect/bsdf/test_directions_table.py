from dataclasses import replace

import numpy as np
import pytest

from anisoscope.base.errors import UsageError
from anisoscope.bsdf.directions_table import (
    COLUMNS,
    DirectionsTable,
    hemispherical,
    imported,
    interpolated,
    read_astm,
    read_mapped,
    sampled,
)
from anisoscope.bsdf.formats import compared_directions
from anisoscope.bsdf.models import of_ridges
from anisoscope.bsdf.reflectance import hemisphere
from anisoscope.fit.table import read_brdf
from anisoscope.parameters.material import Material
from anisoscope.parameters.ridges import RidgeDesign

PLASTIC = of_ridges(RidgeDesign(100.0, 0.0), Material(alpha_along=0.2, alpha_across=0.25))
GONIO = "AOI,Det,CCBRDF\n20,-20,0.1\n20,30,0.2\n20,89.5,0.3\n"
MAPPING = {
    "theta_i_deg": "AOI",
    "phi_i_deg": "0",
    "theta_o_deg": "Det",
    "phi_o_deg": "180",
    "value": "CCBRDF",
}
ASTM = """Cornell-style
NUM_POINTS 2
VARS theta_i,phi_i,theta_s,phi_s,R,G,B
0.5,0,0.25,3.1415926536,1,2,3
0.5 0 0.50 3.1415926536 4 5 6
"""


def written(tmp_path, text):
    path = tmp_path / "t.csv"
    path.write_text(text, encoding="utf-8")
    return path


def test_columns_are_named(tmp_path):
    found = read_mapped(written(tmp_path, GONIO), MAPPING, quantity="radiance")
    np.testing.assert_allclose(found.column("theta_o_deg"), [20.0, 30.0])
    np.testing.assert_allclose(found.column("phi_o_deg"), [360.0, 180.0])
    np.testing.assert_allclose(found.column("value"), np.array([0.1, 0.2]) / np.cos(np.radians(20.0)))
    assert [remark.split()[0] for remark in found.remarks] == ["1", "1", "values"]


def test_the_table_is_one_that_a_fit_reads(tmp_path):
    found = read_mapped(written(tmp_path, GONIO), MAPPING, quantity="factor")
    (tmp_path / "out.csv").write_text(found.csv(), encoding="utf-8")
    table = read_brdf(tmp_path / "out.csv")
    np.testing.assert_allclose(table.readings.value, np.array([0.1, 0.2]) / np.pi, rtol=1e-8)


def test_astm_ascii(tmp_path):
    found = read_astm(written(tmp_path, ASTM))
    np.testing.assert_allclose(found.column("theta_o_deg"), np.tile(np.degrees([0.25, 0.5]), 3))
    np.testing.assert_allclose(found.column("wavelength_nm"), np.repeat([650.0, 550.0, 450.0], 2))
    np.testing.assert_allclose(found.column("value"), [1, 4, 2, 5, 3, 6])


@pytest.mark.parametrize("pairs", [1, 777, 30_000])
def test_as_many_pairs_are_sampled_as_asked_for_a_block_at_a_time(surfaces, pairs):
    asked = []

    def evaluate(light, camera):
        asked.append(len(light))
        return surfaces.skew().evaluate(light, camera)

    found = sampled(replace(surfaces.skew(), evaluate=evaluate), pairs)
    assert len(np.unique(found.rows[:, :4], axis=0)) == pairs == sum(asked)
    assert max(asked) <= 20_000


def test_a_grid_is_sampled(surfaces):
    found = sampled(surfaces.skew(), 200)
    theta, phi = np.radians(found.column("theta_i_deg")), np.radians(found.column("phi_i_deg"))
    light = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1)
    theta, phi = np.radians(found.column("theta_o_deg")), np.radians(found.column("phi_o_deg"))
    camera = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1)
    np.testing.assert_allclose(found.column("value"), surfaces.skew().evaluate(light, camera)[:, 0])


@pytest.mark.parametrize(
    ("text", "changes", "words"),
    [
        (GONIO, {"value": "BRDF"}, "no column 'BRDF' .there are AOI, Det, CCBRDF"),
        (GONIO, {"gloss": "Det"}, "'gloss' is none of"),
        (GONIO.replace("0.2", "x"), {}, "line 3: value is not a number: 'x'"),
        (GONIO.replace("30,0.2", "0.2"), {}, "line 3: 3 values expected, 2 found"),
        (GONIO.replace("30,", "200,"), {}, "reaches 200°"),
        ("AOI,Det,CCBRDF\n0.3,0.2,1\n0.3,0.4,1\n", {"phi_o_deg": "3.14"}, "look like radians"),
        (GONIO.replace("0.2", "40000000"), {}, "is no reflectance: are these counts"),
        ("AOI,Det,CCBRDF\n", {}, "no values follow"),
        (GONIO, {"wavelength_nm": "0.55"}, "looks like µm"),
    ],
)
def test_csv_that_cannot_be(tmp_path, text, changes, words):
    with pytest.raises(UsageError, match=words):
        read_mapped(written(tmp_path, text), MAPPING | changes)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("NUM_POINTS 2", "NUM_POINTS 3", "2 points, NUM_POINTS says 3"),
        ("theta_s", "gamma", "VARS must name"),
        (",R,G,B", "", "names no value"),
        ("R,G,B", "R,G,gloss", "must be a wavelength"),
        ("1,2,3", "1,2", "line 4: 7 values expected, 6 found"),
    ],
)
def test_astm_that_cannot_be(tmp_path, old, new, words):
    with pytest.raises(UsageError, match=words):
        read_astm(written(tmp_path, ASTM.replace(old, new)))


def test_a_table_of_scattered_directions_becomes_a_reflectance():
    """Rows of a known lobe: values between them, the exchanged pairs, and the share that is beyond them."""
    rows = sampled(PLASTIC, 4000)
    found = interpolated(rows, "table")
    light, camera = compared_directions(8192)
    expected = PLASTIC.evaluate(light, camera)[:, 0]
    value = found.evaluate(light, camera)[:, 0]
    assert np.sqrt(np.mean((value - expected) ** 2) / np.mean(expected**2)) < 0.05
    assert np.sqrt(np.mean(np.log(value / expected) ** 2)) < 0.05
    np.testing.assert_allclose(found.evaluate(camera, light)[:, 0], value, rtol=1e-6)
    assert found.notes == ()
    narrow = rows.rows[rows.column("theta_i_deg") < 20.0]
    (note,) = interpolated(DirectionsTable(rows.columns, narrow), "table").notes
    assert "of the directions to 60° lie beyond the rows" in note


def test_what_cannot_be_interpolated_is_refused():
    rows = sampled(PLASTIC, 30)
    with pytest.raises(UsageError, match="5 rows are too few"):
        interpolated(DirectionsTable(rows.columns, rows.rows[:5]), "table")
    dark = rows.rows.copy()
    dark[3, 4] = -0.1
    with pytest.raises(UsageError, match="1 values are 0 or less"):
        interpolated(DirectionsTable(rows.columns, dark), "table")


@pytest.mark.parametrize(("albedo", "said"), [(0.9, False), (1.2, True)])
def test_more_light_than_fell_in_is_said(tmp_path, surfaces, albedo, said):
    out = hemisphere(400, 90.0)
    angles = np.column_stack(
        [np.degrees(np.arccos(out[:, 2])), np.degrees(np.arctan2(out[:, 1], out[:, 0])) % 360.0]
    )
    lines = [f"30,0,{theta:.3f},{phi:.3f},{albedo / np.pi:.6f}" for theta, phi in angles if theta < 89.0]
    table = read_mapped(written(tmp_path, "\n".join([",".join(COLUMNS), *lines]) + "\n"), {})
    share, light_deg = hemispherical(table)
    assert (share, light_deg) == (pytest.approx(albedo, rel=0.02), 30.0)
    assert any(f"reflectance is {share:.3g} for light at 30°" in one for one in table.remarks) == said
    plane = DirectionsTable(COLUMNS, table.rows[np.abs(table.rows[:, 3] - 90.0) < 4.0])
    assert hemispherical(plane)[0] < 0.3
    gridded = imported(surfaces.lambertian(albedo), 64)
    assert any("more than fell in" in one for one in gridded.remarks) == said
