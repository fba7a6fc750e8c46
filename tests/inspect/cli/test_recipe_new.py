"""``anisoscope recipe new`` with a spread of the ridge angle, and ``recipe check`` of poses that cannot be."""

import numpy as np
import pytest

from anisoscope.kinds.registry import kind_of, read_recipe
from anisoscope.profiles.files.load import write_height_map
from anisoscope.profiles.heightmap import HeightMap


def test_a_spread_of_the_ridge_angle_goes_into_the_design(anisoscope, tmp_path):
    done = anisoscope(
        "recipe", "new", "--out", tmp_path / "a.toml", "--ridge-angle", 12, "--u-ridge-angle", 0.15
    )
    assert done.code == 0, done.err
    design = read_recipe(tmp_path / "a.toml").surface.design
    assert (design.ridge_angle_deg, design.u_ridge_angle_deg) == (12.0, 0.15)
    assert anisoscope("recipe", "new", "--out", tmp_path / "d.toml", "--u-ridge-angle", 0.1).code == 0
    assert read_recipe(tmp_path / "d.toml").surface.design.u_ridge_angle_deg == 0.1
    (tmp_path / "map.npz").write_bytes(b"")
    both = "--height-map", tmp_path / "map.npz", "--ridge-angle", 12
    for name, more, decides in (("b", (), "height_map"), ("c", ("--u-ridge-angle", 0.2), "design")):
        path = tmp_path / f"{name}.toml"
        assert anisoscope("recipe", "new", "--out", path, *both, *more).code == 0
        assert read_recipe(path).surface.decides == decides


@pytest.mark.parametrize(
    ("options", "code", "says"),
    [
        (("--u-ridge-angle", 0.1, "--height-map", __file__), 64, "give --ridge-angle as well"),
        (("--u-ridge-angle", 0.1, "--ink", "synthetic-red"), 64, "leave --ridge-angle, --u-ridge-angle"),
        (("--u-ridge-angle", -0.1, "--ridge-angle", 10), 78, "surface.design.u_ridge_angle_deg"),
    ],
)
def test_a_spread_of_nothing_is_refused(anisoscope, tmp_path, options, code, says):
    done = anisoscope("recipe", "new", "--out", tmp_path / "a.toml", *options)
    assert done.code == code
    assert says in done.err
    assert done.err.count("\n") == 1
    assert not (tmp_path / "a.toml").exists()


def test_a_pose_below_the_horizon_names_recipe_and_key(anisoscope, tmp_path):
    path = tmp_path / "a.toml"
    assert anisoscope("recipe", "new", "--out", path).code == 0
    path.write_text(path.read_text().replace("tilts_deg = [0.0]", "tilts_deg = [0.0, 95.0]"))
    done = anisoscope("recipe", "check", path)
    assert done.code == 78
    assert f"{path}: poses.tilts_deg: at tilt 95° the light stands" in done.err
    assert done.err.count("\n") == 1


def test_a_kind_is_picked_by_its_name(anisoscope, tmp_path):
    for name, options in (("ridges", ()), ("prints", ("--ink", "synthetic-red"))):
        path = tmp_path / f"{name}.toml"
        done = anisoscope("recipe", "new", "--kind", name, "--out", path, *options)
        assert done.code == 0, done.err
        assert kind_of(path).name == name


def test_the_recipe_of_a_wafer_is_about_its_tile(anisoscope, tmp_path):
    """Of whole tiles, as many as two millimetres hold; a mask is answered with the command that makes a tile."""
    height = np.kron([[0.0, -0.13], [-0.13, 0.0]], np.ones((64, 64)))
    write_height_map(HeightMap(height, 4.0, 4.0), tmp_path / "tile.npz")
    options = ("recipe", "new", "--kind", "wafers", "--height-map")
    assert anisoscope(*options, tmp_path / "tile.npz", "--out", tmp_path / "wafer.toml").code == 0
    recipe = read_recipe(tmp_path / "wafer.toml")
    assert (recipe.surface.pitch_um, recipe.region.size_mm) == (512.0, (1.536, 1.536))
    (tmp_path / "mask.gds").write_bytes(bytes(6))
    done = anisoscope(*options, tmp_path / "mask.gds", "--out", tmp_path / "other.toml")
    assert done.code != 0
    assert "`anisoscope design height mask.gds --out tile.npz`" in done.err


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (("--kind", "cards"), "there is no kind of part 'cards'; installed: plates, prints, ridges, wafers"),
        (("--kind", "ridges", "--ink", "synthetic-red"), "the other options are for the recipe of a print"),
        (("--kind", "prints"), "needs its ink: give --ink"),
        (("--kind", "wafers"), "the recipe of a wafer needs its tile: give --height-map"),
    ],
)
def test_a_kind_that_is_not_there_or_does_not_fit_the_options_is_refused(anisoscope, tmp_path, options, says):
    done = anisoscope("recipe", "new", "--out", tmp_path / "a.toml", *options)
    assert (done.code, done.err.count("\n")) == (64, 1)
    assert says in done.err
    assert not (tmp_path / "a.toml").exists()
