import numpy as np
import pytest

from anisoscope.base.errors import UsageError
from anisoscope.bsdf.reflectance import (
    albedo,
    must_be_isotropic,
    physics_of,
    refuse_huge,
)


def test_a_lambertian_surface_returns_its_albedo(surfaces):
    assert albedo(surfaces.lambertian(0.37), 50.0)[0] == pytest.approx(0.37, rel=1e-3)
    found = physics_of(surfaces.lambertian(0.37))
    assert found.reciprocity_rms == found.negative_share == found.anisotropy == 0.0
    assert found.warnings() == ()


def test_what_is_not_physical_is_measured(surfaces):
    bad = surfaces.surface(lambda i, o: 0.5 + 0.7 * o[:, 0] + 0.0 * i[:, 0])
    found = physics_of(bad)
    light, camera = surfaces.pairs(200_000, 75.0)
    wanted = np.sqrt(
        np.mean(0.49 * (light[:, 0] - camera[:, 0]) ** 2) / np.mean((0.5 + 0.7 * camera[:, 0]) ** 2)
    )
    assert found.reciprocity_rms == pytest.approx(wanted, rel=0.05)
    assert found.negative_share == pytest.approx(np.mean(0.5 + 0.7 * camera[:, 0] < 0), abs=0.01)
    assert max(found.albedo) == pytest.approx(0.5 * np.pi, rel=0.01)
    assert [text.split()[0] for text in found.warnings()] == ["the", "not", f"{found.negative_share:.2%}"]


def test_one_of_several_wavelengths(surfaces):
    two = surfaces.surface(lambda i, _: np.stack([i[:, 2], 3.0 * i[:, 2]], axis=-1), (500.0, 600.0))
    up = np.array([[0.0, 0.0, 1.0]])
    assert two.at(525.0).evaluate(up, up) == pytest.approx(np.array([[1.5]]))
    with pytest.raises(UsageError, match="500 to 600 nm, not at 700 nm"):
        two.at(700.0)


def test_a_turned_surface(surfaces):
    turned = surfaces.skew().turned(90.0)
    light, camera = surfaces.pairs(20, 70.0)
    back = [one[:, [1, 0, 2]] * [1.0, -1.0, 1.0] for one in (light, camera)]  # by −90°
    np.testing.assert_allclose(turned.evaluate(light, camera), surfaces.skew().evaluate(*back), atol=1e-12)


def test_refusals(surfaces):
    with pytest.raises(UsageError, match="isotropic surfaces only"):
        must_be_isotropic(surfaces.skew(), "MERL")
    with pytest.raises(UsageError, match=r"4\.0 GiB, at most 2"):
        refuse_huge(4 * 2**30, "x.bsdf")
