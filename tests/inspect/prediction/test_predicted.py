"""Cached predictions are those that were computed, to the last digit."""

from dataclasses import fields, is_dataclass

import numpy as np
import pytest

from anisoscope import cli
from anisoscope.parameters.geometry import Convention
from anisoscope.parameters.inputs import InputUncertainty
from anisoscope.parameters.material import Material
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.prediction import predicted
from anisoscope.prediction.monte_carlo import MonteCarlo
from anisoscope.prediction.predict import predict_design, predict_height_map
from anisoscope.prediction.predicted import packed, unpacked
from anisoscope.profiles.files.load import write_height_map
from anisoscope.profiles.ideal import ridges
from anisoscope.sim.light.geometry import pose_grid

POSES = pose_grid((0.0, 90.0, 180.0), (0.0, 10.0))
RIDGES = RidgeDesign(100.0, 10.0)


def assert_equal(one, other):
    """Equal in all fields, arrays in every bit."""
    assert type(one) is type(other)
    if is_dataclass(one):
        for field in fields(one):
            assert_equal(getattr(one, field.name), getattr(other, field.name))
    elif isinstance(one, tuple):
        assert len(one) == len(other)
        for pair in zip(one, other, strict=True):
            assert_equal(*pair)
    elif isinstance(one, np.ndarray):
        assert one.dtype == other.dtype
        np.testing.assert_array_equal(one, other)
    else:
        assert one == other


@pytest.mark.parametrize("case", ["design", "draws", "bare", "map"])
def test_what_is_unpacked_is_what_was_packed(case):
    inputs, draws = InputUncertainty(height_noise_um=0.05), None
    if case == "map":
        surface = ridges(RIDGES, (40, 501), 2.0)
        found = predict_height_map(surface, Material(), POSES, Convention(), 100.0, inputs=inputs)
    else:
        inputs = None if case == "bare" else InputUncertainty(ridge_angle_deg=0.1)
        draws = MonteCarlo(12) if case == "draws" else None
        found = predict_design(RIDGES, Material(), POSES, Convention(), inputs=inputs, monte_carlo=draws)
    assert (found.budget is None, found.drawn is None) == (case == "bare", case != "draws")
    assert_equal(unpacked(packed([found, found])), (found, found))


def test_the_command_answers_a_second_time_with_the_same_output_and_follows_the_file(
    monkeypatch, tmp_path, capsys
):
    packings = []
    monkeypatch.setattr(predicted, "packed", lambda found: packings.append(found) or packed(found))
    monkeypatch.setenv("ANISOSCOPE_CACHE", str(tmp_path / "cache"))
    path, said = tmp_path / "map.npy", []
    for angle in (10.0, 10.0, 12.0):
        write_height_map(ridges(RidgeDesign(100.0, angle), (40, 501), 2.0), path)
        assert cli.run(["predict", str(path), "--pixel", "2", "--pitch", "100", "--json"]) == 0
        said.append(capsys.readouterr().out)
    assert said[0] == said[1] != said[2]
    assert len(packings) == 2  # the second one was not computed
    assert len(list((tmp_path / "cache" / "printed-predictions").iterdir())) == 2
