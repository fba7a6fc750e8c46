"""``anisoscope profile texture`` as a user calls it."""

import json

import numpy as np
import pytest

from anisoscope.profiles.files.load import write_height_map
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.profiles.ideal import add_facet_roughness

FUNCTIONAL = ("Smr", "Smc", "Sk", "Spk", "Svk", "Vmp", "Vmc", "Vvc", "Vvv")


@pytest.fixture(scope="module")
def rough(tmp_path_factory):
    path = tmp_path_factory.mktemp("texture") / "rough.npz"
    flat = HeightMap(np.zeros((300, 400)), 1.0, 1.5)
    surface = add_facet_roughness(flat, 0.1, 0.1, 8.0, np.random.default_rng(0))
    z = surface.height_um.copy()
    z[50:60, 70:90] = np.nan
    write_height_map(surface.with_height(z), path)
    return path


def test_the_table_names_units_filters_and_all_parameters(anisoscope, rough):
    done = anisoscope("profile", "texture", rough, "--s-filter", 4, "--l-filter", 200)
    assert done.code == 0, done.err
    for word in [
        "Sa",
        "Sq",
        "Sz",
        "Sp",
        "Sv",
        "Ssk",
        "Sku",
        "Sal",
        "Str",
        "Std",
        "Sdq",
        "Sdr",
        *FUNCTIONAL,
        "µm",
        "%",
        "°",
        "16610-61",
    ]:
        assert word in done.out
    for phrase in (
        "S-L surface",
        "plane removed",
        "nesting index 4 µm",
        "nesting index 200 µm",
        "instead of 50 %",
    ):
        assert phrase in " ".join(done.out.split())


def test_json_and_picture(anisoscope, rough, tmp_path):
    done = anisoscope("profile", "texture", rough, "--form", "poly2", "--json", "--plot", tmp_path / "t.png")
    assert done.code == 0, done.err
    found = done.json
    assert (found["form"], found["s_filter_um"], found["l_filter_um"]) == ("poly2", None, None)
    assert found["spatial"]["sal_um"] == pytest.approx(8.0 * np.sqrt(np.log(5.0)), rel=0.15)
    assert found["spatial"]["str_is_bound"] is False
    assert found["heights"]["sku"] == pytest.approx(3.0, abs=0.3)
    assert found["missing_share"] == pytest.approx(200 / 120_000)
    assert (tmp_path / "t.png").read_bytes().startswith(b"\x89PNG")


def test_filters_change_what_they_should(anisoscope, rough):
    plain, filtered = (
        anisoscope("profile", "texture", rough, "--json", *options).json
        for options in ((), ("--s-filter", 10, "--l-filter", 60))
    )
    assert filtered["heights"]["sq_um"] < plain["heights"]["sq_um"]
    assert filtered["hybrid"]["sdq"] < plain["hybrid"]["sdq"]


def test_a_flat_map_is_no_accident(anisoscope, tmp_path):
    write_height_map(HeightMap(np.zeros((50, 60)), 1.0, 1.0), tmp_path / "flat.npz")
    done = anisoscope("profile", "texture", tmp_path / "flat.npz", "--json", "--plot", tmp_path / "flat.svg")
    assert done.code == 0, done.err
    assert done.json["heights"]["ssk"] is None
    assert anisoscope("profile", "texture", tmp_path / "flat.npz").code == 0


@pytest.mark.parametrize(
    ("options", "word"),
    [
        (("--s-filter", 2.5), "two pixels"),
        (("--l-filter", 1000), "beyond the field"),
        (("--s-filter", 50, "--l-filter", 20), "below the L-filter"),
        (("--plot", "t.txt"), "*.png"),
        (("--form", "torus"), "torus"),
        (("--no-border-features",), "ask for them with --features"),
        (("--u-pixel-size", 0.01), "--draws NUMBER"),
        (("--draws", 9), "--u-height-noise"),
        (("--draws", 1, "--u-pixel-size", 0.01), "two draws"),
        (("--draws", 9, "--u-pixel-size", 0.5), "from 0 to 0.2"),
    ],
)
def test_bad_options_give_one_line(anisoscope, rough, options, word):
    done = anisoscope("profile", "texture", rough, *options)
    assert done.code in (64, 65)
    assert word in done.err
    assert done.err.count("\n") == 1
    assert not done.out


def test_uncertainty_of_every_value(anisoscope, tmp_path):
    heights = np.random.default_rng(2).normal(size=(40, 50))
    write_height_map(HeightMap(heights, 1.0, 1.0), tmp_path / "small.npz")
    call = ("profile", "texture", tmp_path / "small.npz", "--draws", 4, "--u-height-scale", 0.01)
    done = anisoscope(*call, "--json")
    assert done.code == 0, done.err
    found = done.json
    share = found["u"]["Sa"] / found["heights"]["sa_um"]
    assert 0.001 < share < 0.03
    assert found["u"]["Sz"] / found["heights"]["sz_um"] == pytest.approx(share)
    assert found["u"]["Sal"] < 1e-6 * found["spatial"]["sal_um"]
    assert found["uncertainty"] == {
        "height_noise_um": 0.0,
        "height_scale": 0.01,
        "pixel_size": 0.0,
        "draws": 4,
        "seed": 0,
    }
    assert anisoscope(*call, "--json", "--seed", 1).json["u"]["Sa"] != found["u"]["Sa"]
    assert " shift " in anisoscope(*call).out
    anisoscope(*call, "--table", tmp_path / "t.json")
    (row,) = json.loads((tmp_path / "t.json").read_text(encoding="utf-8"))
    assert row["u(Sa)"] == {"value": pytest.approx(found["u"]["Sa"]), "unit": "µm"}
