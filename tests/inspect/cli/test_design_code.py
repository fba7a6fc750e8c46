"""``anisoscope design code``: files that fit each other, the predicted code, and what it refuses."""

import numpy as np
import pytest

from anisoscope.kinds.plates.kind import PLATES
from anisoscope.profiles.files.load import read_height_map
from anisoscope.profiles.metrology.regions import direction_regions
from anisoscope.record.schema import read_record
from anisoscope.sim.design.plates import modules_of_code


def test_a_data_matrix_becomes_part_insert_and_recipe(anisoscope, tmp_path):
    import pyvista

    out = tmp_path / "code"
    done = anisoscope("design", "code", "A17", "--out", out, "--pixel", "4", "--stl", "--json")
    assert done.code == 0, done.err
    found = done.json
    assert found["modules"] == [12, 12]
    assert found["size_mm"] == pytest.approx([2.4, 2.4])
    assert [one["reads"] for one in found["poses"]] == ["A17", "A17"]
    assert [one["inverted"] for one in found["poses"]] == [False, True]
    assert {one["grades"][0]["grade"] for one in found["poses"]} == {4}
    part, insert = (read_height_map(out / f"{name}.x3p") for name in ("part", "insert"))
    assert part.shape == (600, 600)
    # the part is what a mould of the insert leaves
    tool = read_height_map(out / "insert.x3p", role="tool")
    np.testing.assert_allclose(tool.height_um, part.height_um, atol=1e-6)
    assert not np.allclose(insert.height_um, part.height_um)
    meshes = [pyvista.read(out / f"{name}.stl").clean() for name in ("part", "insert")]
    assert all(one.is_manifold and one.n_open_edges == 0 for one in meshes)
    assert meshes[0].volume + meshes[1].volume == pytest.approx(2.4 * 2.4 * (2.0 + 8.5e-3), rel=1e-4)
    assert "<title>datamatrix A17, made of ridges" in (out / "appearance.html").read_text(encoding="utf-8")
    # the map shows the modules where the code has them
    regions = direction_regions(part)
    light = int(np.argmin(np.abs(np.array(regions.azimuths_deg))))
    classes = np.array([-1, *(one.direction_class for one in regions.regions)])[regions.labels]
    middle = classes[25::50, 25::50][::-1]
    assert np.mean((middle == light) == ~modules_of_code("A17", "datamatrix")) > 0.97
    recipe = PLATES.read_recipe(out / "recipe.toml")
    assert recipe.code.text == "A17"
    assert recipe.poses.angles_deg == (0.0, 90.0, 180.0)  # at 180° worn ridges shine
    assert recipe.plan.plan().shape == (12, 12)
    checked = anisoscope("recipe", "check", out / "recipe.toml")
    assert "good parts can PASS" in checked.out
    assert "undecided" not in checked.out
    again = anisoscope("design", "code", "A17", "--out", out)
    assert again.code == 64
    assert "exists; give another folder, or --overwrite" in again.err


def test_a_trial_reads_the_code_on_the_virtual_rig(anisoscope, tmp_path):
    done = anisoscope(
        "design",
        "code",
        "A17",
        "--pixel",
        "10",
        "--draft",
        "10",
        "--trial",
        "--out",
        tmp_path / "code",
        "--json",
    )
    assert done.code == 0, done.err
    assert done.json["trial"]["verdict"] == "PASS"
    (record,) = (tmp_path / "code" / "trial" / "inspections").glob("TRIAL-*")
    assert read_record(record).details.code.readings[:2] == ("A17", "A17")
    again = anisoscope("recompute", record)  # its recipe names the plan of another folder
    assert again.code == 0, again.out + again.err


def test_a_qr_code_with_draft_is_read_in_its_predicted_picture(anisoscope, tmp_path):
    done = anisoscope(
        "design", "code", "RIDGE", "--symbology", "qr", "--module-mm", "0.12", "--pixel", "12", "--draft", "5",
        "--out", tmp_path / "qr",
    )  # fmt: skip
    assert done.code == 0, done.err
    assert done.out.count("'RIDGE'") >= 3
    recipe = PLATES.read_recipe(tmp_path / "qr" / "recipe.toml")
    assert recipe.surface.ridge_design().wall == 5.0


@pytest.mark.parametrize(
    ("options", "code", "match"),
    [
        (("--plate-mm", "2"), 64, "make modules of at most 0.167 mm"),
        (("--module-mm", "0.09"), 65, "hold 1.8 ridges of 50 µm, 2 are needed"),
        (("--facet-azimuths", "0"), 64, "--facet-azimuths takes two azimuths"),
        (("--pixel", "3"), 65, "no whole number of pixels of 3 µm"),
        (("--pixel", "0.1"), 64, "a larger --pixel"),
        (("--draft", "0"), 64, "hold the part in its mould"),
        (("--path",), 64, "give --tool-radius"),
        (("--ridge-angle", "95"), 64, "--ridge-angle: the ridge angle"),
    ],
)
def test_what_cannot_be_made_is_one_line_and_leaves_nothing(anisoscope, tmp_path, options, code, match):
    done = anisoscope("design", "code", "A17", "--out", tmp_path / "code", *options)
    assert done.code == code
    assert match in done.err
    assert done.err.strip().count("\n") == 0
    assert not (tmp_path / "code").exists()


def test_a_text_that_no_code_holds_is_refused(anisoscope, tmp_path):
    done = anisoscope("design", "code", "x" * 4000, "--out", tmp_path / "code")
    assert done.code == 64
    assert "(4000 characters) cannot be written as datamatrix" in done.err
    assert len(done.err) < 300
