"""Lamp and lens of recipe and rig file compared, as far as both tell them."""

from pathlib import Path

import pytest

from anisoscope.base.errors import RigFileError
from anisoscope.recipe.surface import check_lamp
from anisoscope.rig.rigfile import RigFile

LIGHT = {
    "wavelength_nm": 520.0,
    "bandwidth_nm": 10.0,
    "lamp_half_angle_deg": 0.3,
    "aperture_half_angle_deg": 0.7,
}


def rig_with(camera=None, light=None):
    return RigFile.model_validate(
        {
            "schema": 1,
            "name": "a rig",
            "stage": {"driver": "elliptec"},
            "camera": {"driver": "simulated", "pixel_um": 8.0, **(camera or {})},
            "light": light or {},
        }
    )


@pytest.mark.parametrize(
    ("camera", "light", "words"),
    [
        (
            {},
            {"wavelength_nm": 635.0},
            r"rig.toml: light.wavelength_nm is 635 nm, the recipe predicts for 520 ± 0.5 nm",
        ),
        ({}, {"bandwidth_nm": 14.0}, r"light.bandwidth_nm is 14 nm, the recipe predicts for 10 ± 1 nm"),
        ({}, {"half_angle_deg": 0.5}, r"light.half_angle_deg is 0.5°, the recipe predicts for 0.3 ± 0.015°"),
        (
            {"half_angle_deg": 0.75},
            {},
            r"camera.half_angle_deg is 0.75°, the recipe predicts for 0.7 ± 0.014°",
        ),
    ],
)
def test_another_lamp_or_lens_is_refused_in_one_line(make_recipe, camera, light, words):
    with pytest.raises(RigFileError, match=words) as refused:
        check_lamp(make_recipe(light=LIGHT), rig_with(camera, light), Path("rig.toml"))
    assert "\n" not in str(refused.value)


def test_what_agrees_or_is_not_told_is_taken(make_recipe):
    close = rig_with(
        {"half_angle_deg": 0.73}, {"wavelength_nm": 521.0, "bandwidth_nm": 12.0, "half_angle_deg": 0.27}
    )
    check_lamp(make_recipe(light=LIGHT), close, Path("rig.toml"))
    check_lamp(make_recipe(light=LIGHT), rig_with(), Path("rig.toml"))
    check_lamp(make_recipe(), rig_with({"half_angle_deg": 5.0}, {"wavelength_nm": 635.0}), Path("rig.toml"))
