"""``anisoscope profile step`` as a user calls it."""

import numpy as np
import pytest

from anisoscope.profiles.files.load import write_height_map
from anisoscope.profiles.heightmap import HeightMap


@pytest.fixture
def groove(tmp_path):
    line = np.where(np.abs(np.arange(120) - 60) < 10, -0.5, 0.0)
    height = np.tile(line, (30, 1)) + 0.001 * np.random.default_rng(1).standard_normal((30, 120))
    write_height_map(HeightMap(height, 1.0, 1.0), tmp_path / "groove.x3p")
    return tmp_path / "groove.x3p"


def test_depth_with_its_uncertainty(anisoscope, groove):
    done = anisoscope("profile", "step", groove)
    assert done.code == 0, done.err
    assert "height of the groove -0." in done.out
    assert "(k = 2, scatter of 30 lines; that of the height scale is not in it)" in done.out
    found = anisoscope("profile", "step", groove, "--json").json
    assert (found["kind"], found["lines"]) == ("groove", 30)
    assert abs(found["height_um"] + 0.5) < 3.0 * found["u_um"]


def test_a_lot_and_a_map_without_a_step(anisoscope, groove, tmp_path):
    write_height_map(HeightMap(np.zeros((20, 30)), 1.0, 1.0), tmp_path / "plane.x3p")
    table = tmp_path / "steps.csv"
    done = anisoscope("profile", "step", groove, tmp_path / "plane.x3p", "--table", table)
    assert done.code == 65
    assert "the surface is flat" in done.out + done.err
    assert "step height" in table.read_text(encoding="utf-8")
    done = anisoscope("profile", "step", groove, "--edges", "50,500")
    assert done.code == 65
    assert "one edge of a step or two of a groove" in done.err
