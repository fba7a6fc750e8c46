import pytest

from anisoscope.base.errors import ModelError
from anisoscope.parameters.material import Material
from anisoscope.sim.materials.spectra import PlasticSpectrum


def test_every_wavelength_has_its_material():
    base = Material(0.04, 0.07, internal_reflection="linear")
    found = PlasticSpectrum((450.0, 650.0), (1.51, 1.49), (0.1, 0.3)).materials(base)
    assert found == (Material(0.04, 0.07, 0.1, 1.51, "linear"), Material(0.04, 0.07, 0.3, 1.49, "linear"))


@pytest.mark.parametrize(
    "values",
    [
        ((), (), ()),
        ((500.0,), (1.5, 1.5), (0.2,)),
        ((500.0, 500.0), (1.5, 1.5), (0.2, 0.2)),
        ((600.0, 500.0), (1.5, 1.5), (0.2, 0.2)),
        ((0.0,), (1.5,), (0.2,)),
        ((float("nan"),), (1.5,), (0.2,)),
        ((float("inf"),), (1.5,), (0.2,)),
    ],
)
def test_wavelengths_are_positive_and_rise(values):
    with pytest.raises(ModelError):
        PlasticSpectrum(*values)


def test_an_impossible_constant_is_told_with_its_wavelength():
    with pytest.raises(ModelError, match=r"at 450 nm: the albedo"):
        PlasticSpectrum((450.0,), (1.5,), (1.2,)).materials(Material())
