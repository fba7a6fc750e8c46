"""A reader of reflectance files from a package of a third party."""

import numpy as np
import pytest

from anisoscope.base.errors import UsageError
from anisoscope.bsdf.formats import BSDF_FILES, is_reflectance_file, read_reflectance

READER = """
import numpy as np

from anisoscope.bsdf.file_format import BsdfFile
from anisoscope.bsdf.reflectance import Reflectance


def read_matt(path):
    albedo = float(path.read_text().split()[1])
    return Reflectance(path.name, lambda light, camera: np.full((len(light), 1), albedo / np.pi), isotropic=True)


MATT = BsdfFile("matt", "matt white", lambda head: head.startswith(b"MATT "), read_matt)
"""


def test_a_reader_of_a_package_reads_its_files(install, tmp_path):
    path = tmp_path / "tile.txt"
    path.write_text("MATT 0.8")
    assert list(BSDF_FILES) == ["rgl", "merl", "tensor-tree", "klems", "zemax"]
    assert not is_reflectance_file(path)
    with pytest.raises(UsageError, match=r"none of the formats that are read: RGL \.bsdf, MERL binary, "):
        read_reflectance(path)
    install("anisoscope.bsdf_files", "matt", "mattformat:MATT", READER)
    assert is_reflectance_file(path)
    up = np.array([[0.0, 0.0, 1.0]])
    assert read_reflectance(path).evaluate(up, up)[0, 0] == pytest.approx(0.8 / np.pi)
