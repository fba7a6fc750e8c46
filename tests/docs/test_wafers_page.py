"""The page about wafers: its recipe and its bench are read, the defaults that it shows are the defaults."""

import re
import tomllib
from pathlib import Path

import pytest

from anisoscope.cli import app
from anisoscope.kinds.wafers.recipe import WaferRecipe, WaferUncertainty, recognises
from anisoscope.recipe.surface import LightPart
from anisoscope.sim.bench.benchfile import SamplePart

PAGE = (Path(__file__).resolve().parents[2] / "docs" / "wafers.md").read_text(encoding="utf-8")


def blocks(language):
    return re.findall(rf"```{language}\n(.*?)```", PAGE, re.DOTALL)


def test_the_recipe_is_one_of_a_wafer_and_shows_the_defaults():
    table = tomllib.loads(blocks("toml")[0])
    recipe = WaferRecipe.model_validate(table)
    assert recognises(table)
    assert recipe.material.reflectance == table["material"]["reflectance"]
    light = LightPart()
    for key in ("u_wavelength_nm", "u_bandwidth_share", "u_lamp_share", "u_aperture_share"):
        assert table["light"][key] == getattr(light, key)
    for key in ("etch_depth_nm", "etch_width_nm"):
        assert table["uncertainty"][key] == getattr(WaferUncertainty(), key)
    assert WaferUncertainty().tilt_deg == 0.0


def test_the_sample_is_understood():
    table = tomllib.loads(blocks("toml")[1])["sample"]
    sample = SamplePart.model_validate(table)
    assert sample.kind == "wafer"
    assert sample.wafer.over_etch_nm == 20.0


@pytest.mark.parametrize("line", [line for block in blocks("sh") for line in block.splitlines()])
def test_the_commands_are_understood(line):
    words = line.split("#")[0].split()
    assert words[0] == "anisoscope"
    _, bound, _ = app.parse_args(words[1:], exit_on_error=False, print_error=False)
    assert bound.arguments
