"""A reader of height maps from a package of a third party, known by extension and by content."""

import numpy as np
import pytest

from anisoscope.base.errors import HeightMapError
from anisoscope.profiles.files.formats import all_formats, readable
from anisoscope.profiles.files.load import read_height_map

READER = """
import numpy as np

from anisoscope.profiles.files.format import Format
from anisoscope.profiles.heightmap import HeightMap


def read_steps(path, given):
    rows, cols, step_um = path.read_text().split()[1:]
    height = float(step_um) * np.arange(int(rows) * int(cols), dtype=float).reshape(int(rows), int(cols))
    return HeightMap(height, 2.0, 2.0, {"format": "steps", "first_row": "bottom"})


STEPS = Format("steps", "steps of a ramp", (".steps",), read_steps, ((0, b"STEPS "),))
"""


def test_a_reader_of_a_package_reads_its_files(install, tmp_path):
    before = len(all_formats())
    install("anisoscope.height_maps", "steps", "stepsformat:STEPS", READER)
    assert len(all_formats()) == before + 1
    assert ".steps" in readable()
    for name in ("ramp.steps", "ramp.unknown"):  # by extension, and by content alone
        (tmp_path / name).write_text("STEPS 20 30 0.01")
        found = read_height_map(tmp_path / name)
        assert (found.shape, found.pixel_x_um, found.origin["format"]) == ((20, 30), 2.0, "steps")
        assert np.ptp(found.height_um) == pytest.approx(5.99)
    (tmp_path / "false.steps").write_text("nothing of the kind")
    with pytest.raises(HeightMapError, match=r"does not look like \.steps \(steps of a ramp\)"):
        read_height_map(tmp_path / "false.steps")


def test_units_are_refused_for_a_format_that_states_its_own(install, tmp_path):
    install("anisoscope.height_maps", "steps", "stepsformat:STEPS", READER)
    (tmp_path / "ramp.steps").write_text("STEPS 20 30 0.01")
    with pytest.raises(HeightMapError, match="a file of format steps of a ramp states its own"):
        read_height_map(tmp_path / "ramp.steps", z_unit="nm")


def test_a_reader_that_does_not_load_is_one_line(install):
    install("anisoscope.height_maps", "steps", "stepsformat:STAIRS", READER)
    with pytest.raises(HeightMapError, match=r"^the format of height maps 'steps' does not load: .*STAIRS"):
        all_formats()
