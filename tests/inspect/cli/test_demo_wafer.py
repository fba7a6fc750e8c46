"""The files of the demo with wafers, and what its recipe refuses."""

import tomllib

import numpy as np
import pytest
import tomli_w

from anisoscope.base.errors import RecipeError, UsageError
from anisoscope.kinds.registry import read_recipe
from anisoscope.kinds.wafers.recipe import WaferRecipe
from anisoscope.operations.demo import wafers as demo_wafer
from anisoscope.rig.rigfile import read_rig
from anisoscope.sim.bench.benchfile import read_bench


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """The files that need no pictures, with a tile of 32 µm."""
    place = tmp_path_factory.mktemp("demo")
    with pytest.MonkeyPatch.context() as patch:
        for name, value in (("DOT_UM", 32.0), ("DOTS", 1), ("DRAWS", 2)):
            patch.setattr(demo_wafer, name, value)
        demo_wafer.write_tile(place, np.random.default_rng(0))
    return place


def test_the_design_is_anisotropic_and_has_no_spike():
    design = demo_wafer.design()
    assert design.passes_nm == pytest.approx((130.0,))
    assert design.depths.tau_at(demo_wafer.WAVELENGTH_NM) == pytest.approx(0.0, abs=1e-6)
    mean = [np.average(w, weights=p) for w, p in (
        (design.model.widths_x_um, design.model.p_a_x), (design.model.widths_y_um, design.model.p_a_y)
    )]  # fmt: skip
    assert mean[1] > 1.8 * mean[0]


def test_parts_differ_by_their_defect_and_by_what_the_recipe_allows():
    rng = np.random.default_rng(1)
    drawn = {name: [demo_wafer.sample(name, rng)["wafer"] for _ in range(200)] for name in demo_wafer.PARTS}
    for name, key, wrong, u in (
        ("over-etched", "over_etch_nm", demo_wafer.OVER_ETCH_NM, demo_wafer.ETCH_DEPTH_NM),
        ("wide", "width_bias_nm", demo_wafer.WIDTH_BIAS_NM, demo_wafer.ETCH_WIDTH_NM),
    ):
        for part in demo_wafer.PARTS:
            values = np.array([one[key] for one in drawn[part]])
            assert values.mean() == pytest.approx(wrong if part == name else 0.0, abs=5.0 * u / np.sqrt(200))
            assert values.std() == pytest.approx(u, rel=0.2)


def test_its_files_are_read_by_those_who_need_them(folder):
    (folder / "recipe.toml").write_text(tomli_w.dumps(demo_wafer.recipe()))
    recipe = read_recipe(folder / "recipe.toml")
    assert isinstance(recipe, WaferRecipe)
    assert (recipe.area, recipe.surface.optics) == (None, "auto")
    place = folder / "bench" / "good"
    place.mkdir(parents=True)
    sample = demo_wafer.sample("good", np.random.default_rng(0))
    (place / "bench.toml").write_text(tomli_w.dumps(demo_wafer.bench(sample, 1)))
    (place / "rig.toml").write_text(tomli_w.dumps(demo_wafer.rig("good")))
    bench, rig = read_bench(place / "bench.toml"), read_rig(place / "rig.toml")
    assert bench.sample.wafer.file.resolve() == (folder / "wafer.npz").resolve()
    assert bench.geometry.light_angle_deg == rig.light.angle_deg == 0.0
    assert bench.optics.pixel_um == rig.camera.pixel_um


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"area": {"max_share": 0.03}}, r"leave \[area\] out"),
        ({"scatter": {"alpha_share": 0.02}}, "scatter belongs to ridges"),
        ({"defects": {"power": 0.9}}, "defects.power belongs to ridges"),
        (
            {"poses": {"stage_and_tilt_deg": [[0.0, 3.0], [90.0, 3.0]]}},
            "poses.stage_and_tilt_deg belongs to ridges",
        ),
        ({"light": None}, "depends on lamp and lens"),
        ({"light": {"wavelength_nm": 520.0}}, "depends on lamp and lens"),
        ({"surface": {"pitch_um": 512.0, "design": {"ridge_angle_deg": 1.0}}}, "height_map of the tile"),
        (
            {"surface": {"pitch_um": 512.0, "height_map": "tile.npz", "optics": "geometric"}},
            "rays know nothing",
        ),
    ],
)
def test_a_recipe_that_makes_no_sense_for_a_wafer_is_refused(folder, tmp_path, change, match):
    table = {**demo_wafer.recipe(), **change}
    text = tomli_w.dumps({key: value for key, value in table.items() if value is not None})
    (tmp_path / "recipe.toml").write_text(text)
    assert tomllib.loads(text)["material"]["reflectance"] == demo_wafer.REFLECTANCE
    with pytest.raises(RecipeError, match=match):
        read_recipe(tmp_path / "recipe.toml")


def test_a_negative_seed_is_refused(tmp_path):
    with pytest.raises(UsageError, match="--seed"):
        demo_wafer.SCENE.lay_out(tmp_path, -1, lambda *_: None)


@pytest.mark.soak
@pytest.mark.parametrize("seed", range(1, 7))
def test_every_wafer_of_the_demo_gets_the_verdict_that_is_expected(anisoscope_afresh, tmp_path, seed):
    done = anisoscope_afresh("demo", "--kind", "wafer", "--out", tmp_path / "demo", "--seed", seed, "--json")
    assert done.code == 0, done.out + done.err
    found = {part["serial"]: part["verdict"] for part in done.json["parts"]}
    assert found == {f"DEMO-{name}": verdict for name, verdict in demo_wafer.PARTS.items()}
