import numpy as np
import pytest

from anisoscope.base.errors import UsageError
from anisoscope.bsdf.merl import RGB_NM, SHAPE, read_merl, write_merl
from anisoscope.bsdf.models import of_ridges
from anisoscope.parameters.material import Material
from anisoscope.parameters.ridges import RidgeDesign

COUNT = 90 * 90 * 180


def test_the_layout_is_that_of_the_data_base(tmp_path, surfaces):
    """Value of a cell by index (θh · 90 + θd) · 180 + φd, scaled by 1500; green by 1500/1.15."""
    write_merl(surfaces.surface(lambda i, o: np.sum(i * o, axis=1), isotropic=True), tmp_path / "x.binary")
    raw = (tmp_path / "x.binary").read_bytes()
    assert tuple(np.frombuffer(raw, "<i4", 3)) == SHAPE
    data = np.frombuffer(raw, "<f8", 3 * COUNT, 12).reshape(3, *SHAPE)
    half, diff = 0.5 * np.pi * (10.5 / 90) ** 2, np.radians(30.5)
    del half  # the angle between light and camera is twice the difference, wherever the half vector is
    np.testing.assert_allclose(data[0, 10, 30] / 1500.0, np.cos(2.0 * diff), rtol=1e-12)
    np.testing.assert_allclose(data[1] * 1.15, data[0], rtol=1e-12)


def test_cells_are_looked_up_where_they_stand(tmp_path):
    """A file by hand whose value is the index of θh: half vectors at 40° lie in the cell 60."""
    data = np.broadcast_to(np.arange(90.0)[:, None, None], SHAPE) * 1500.0
    table = np.stack([data, data / 1.15, data / 1.66])
    (tmp_path / "x.binary").write_bytes(np.array(SHAPE, "<i4").tobytes() + table.tobytes())
    tilt = np.radians([0.01, 40.0, 80.0])
    mirror = np.stack([np.sin(tilt), 0.0 * tilt, np.cos(tilt)], axis=-1)
    found = read_merl(tmp_path / "x.binary").evaluate(mirror, mirror)
    np.testing.assert_allclose(
        found[:, 0], np.maximum(90.0 * np.sqrt(tilt / (0.5 * np.pi)) - 0.5, 0.0), atol=1e-9
    )


def test_a_surface_survives(tmp_path, surfaces):
    flat = of_ridges(RidgeDesign(100.0, 0.0), Material(0.1, 0.1))
    write_merl(flat, tmp_path / "flat.binary")
    found = read_merl(tmp_path / "flat.binary")
    light, camera = surfaces.pairs(4000, 60.0)
    assert surfaces.rms(found.evaluate(light, camera), flat.evaluate(light, camera)) < 0.003
    assert found.wavelengths_nm == ()


def test_colours_survive(tmp_path, surfaces):
    three = surfaces.surface(
        lambda i, _: np.broadcast_to([0.1, 0.2, 0.3], (len(i), 3)), RGB_NM, isotropic=True, name="three"
    )
    write_merl(three, tmp_path / "x.binary")
    up = np.array([[0.0, 0.0, 1.0]])
    np.testing.assert_allclose(
        read_merl(tmp_path / "x.binary").evaluate(up, up), [[0.1, 0.2, 0.3]], rtol=1e-9
    )


def test_refusals(tmp_path, surfaces):
    with pytest.raises(UsageError, match="isotropic"):
        write_merl(surfaces.skew(), tmp_path / "x.binary")
    path = tmp_path / "x.binary"
    path.write_bytes(np.array(SHAPE, "<i4").tobytes() + bytes(100))
    with pytest.raises(UsageError, match="112 bytes, a MERL binary has 34992012"):
        read_merl(path)
    path.write_bytes(b"no")
    with pytest.raises(UsageError, match="no MERL binary"):
        read_merl(path)
