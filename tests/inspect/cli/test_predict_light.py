"""How light travels, as options of predict: reflections, sizes of lamp and lens, facets, roughness of the plastic."""

import json

import numpy as np
import pytest

from anisoscope.cli import run
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.profiles.files.load import write_height_map
from anisoscope.profiles.ideal import add_facet_roughness, ridges


@pytest.fixture(scope="module")
def rough_map(tmp_path_factory):
    surface = ridges(RidgeDesign(100.0, 10.0), (120, 601), 1.0)
    surface = add_facet_roughness(surface, 0.05, 0.05, 6.0, np.random.default_rng(1))
    path = tmp_path_factory.mktemp("maps") / "rough.x3p"
    write_height_map(surface, path)
    return str(path)


def predicted(capsys, *arguments):
    assert run(["predict", *arguments, "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def radiances(found):
    return np.array([pose["radiance"] for pose in found["poses"]])


def test_reflections_brighten_a_height_map_alike_by_its_groove_and_by_paths(capsys, rough_map):
    direct = predicted(capsys, rough_map, "--bounces", "1")
    groove = predicted(capsys, rough_map)
    paths = predicted(capsys, rough_map, "--reflect", "paths")
    assert direct["second_reflection_would_add"] > 0.05
    assert (groove["bounces"], paths["bounces"]) == ("all", "all")
    assert (groove["reflections_from"], paths["reflections_from"]) == ("groove", "paths on the height map")
    assert groove["groove_angle_deg"] == pytest.approx(10.0, abs=0.1)
    added = [radiances(one) - radiances(direct) for one in (groove, paths)]
    assert np.all(added[0] > 0.0)
    np.testing.assert_allclose(added[0], added[1], atol=0.03 * radiances(paths).min())
    for one in (groove, paths):
        assert "amplitude of the reflections" in [row["source"] for row in one["budget"]]


def test_roughness_of_the_plastic_is_counted_once(capsys, rough_map):
    smooth = radiances(predicted(capsys, "--ridge-angle", "10", "--no-uncertainty"))
    found = predicted(capsys, rough_map, "--roughness", "plastic", "--no-uncertainty")
    assert found["lobe_alpha_along"] == pytest.approx(np.sqrt(0.06**2 - found["resolved_alpha_along"] ** 2))
    np.testing.assert_allclose(radiances(found), smooth, rtol=0.05)


def test_a_plastic_smoother_than_its_map_is_warned_of(capsys, rough_map):
    arguments = ("--roughness", "plastic", "--alpha-along", "0.02", "--no-uncertainty")
    assert "rougher" in predicted(capsys, rough_map, *arguments)["roughness_warning"]


@pytest.mark.parametrize("diagonal", ["diagonal", "antidiagonal"])
def test_triangles_change_a_rough_map_by_about_a_percent(capsys, rough_map, diagonal):
    cells = radiances(predicted(capsys, rough_map, "--no-uncertainty"))
    halves = radiances(predicted(capsys, rough_map, "--no-uncertainty", "--facets", diagonal))
    assert 1e-4 < np.max(np.abs(halves / cells - 1.0)) < 0.05


def test_a_wide_lens_dims_the_lobe_of_design_and_map_alike(capsys, rough_map):
    wide = ("--aperture", "0.1", "--lamp-half-angle", "3", "--no-uncertainty")
    for surface in (("--ridge-angle", "10"), (rough_map,)):
        sharp = radiances(predicted(capsys, *surface, "--no-uncertainty"))
        blurred = radiances(predicted(capsys, *surface, *wide))
        assert blurred[0] < 0.97 * sharp[0]
        assert blurred[1] > 1.03 * sharp[1]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--aperture", "1.2"], "numerical aperture"),
        (["--lamp-distance", "100"], "belong together"),
        (["--lamp-distance", "5", "--field", "10"], "further away"),
        (["--lamp-distance", "50", "--field", "0"], "positive numbers of mm"),
        (["--facets", "diagonal"], "belongs to a height map"),
        (["--roughness", "plastic"], "belongs to a height map"),
        (["--disc-rings", "0", "--aperture", "0.1"], "ring"),
        (["--bounces", "0"], "1 or more"),
        (["--bounces", "2", "--model", "printed"], "direct light only"),
    ],
)
def test_wrong_options_are_one_line(capsys, arguments, message):
    assert run(["predict", "--ridge-angle", "10", *arguments]) == 64
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
