import numpy as np
import pytest

from anisoscope.base.errors import UsageError
from anisoscope.bsdf.models import of_ridges
from anisoscope.bsdf.reflectance import albedo
from anisoscope.bsdf.rgl import Resolution, read_rgl, read_tensors, write_rgl, write_tensors
from anisoscope.parameters.material import Material
from anisoscope.parameters.ridges import RidgeDesign


def fields(**changes):
    """A file whose values are known by hand: even density, S = 2, D = 3, σ = 1."""
    ones = np.ones
    found = {
        "description": np.frombuffer(b"by hand", np.uint8),
        "jacobian": np.array([1], np.uint8),
        "phi_i": np.zeros(1),
        "theta_i": np.radians([0.0, 80.0]),
        "wavelengths": np.array([500.0, 600.0]),
        "ndf": 3.0 * ones((2, 2)),
        "sigma": ones((2, 2)),
        "vndf": ones((1, 2, 2, 2)),
        "luminance": ones((1, 2, 2, 2)),
        "spectra": 2.0 * ones((1, 2, 2, 2, 2)),
    } | changes
    return {name: a if a.dtype == np.uint8 else a.astype(np.float32) for name, a in found.items()}


@pytest.fixture
def by_hand(tmp_path):
    def write(**changes):
        write_tensors(fields(**changes), tmp_path / "hand.bsdf")
        return read_rgl(tmp_path / "hand.bsdf")

    return write


def test_a_file_known_by_hand(by_hand, surfaces):
    light, camera = surfaces.pairs(30, 75.0)
    found = by_hand().evaluate(light, camera)
    np.testing.assert_allclose(found, 2.0 * 3.0 / 4.0 / camera[:, 2:], rtol=1e-6)
    assert by_hand().name == "by hand"


def test_values_without_the_jacobian(by_hand, surfaces):
    light, camera = surfaces.pairs(5, 75.0)
    found = by_hand(jacobian=np.array([0], np.uint8)).evaluate(light, camera)
    np.testing.assert_allclose(found, 2.0 / camera[:, 2:], rtol=1e-6)


def test_the_warp_is_the_cumulative_distribution(by_hand):
    """A density that grows with u = √(2θ/π) has its distribution u² = 2θ/π; S is the sample itself."""
    rising = np.broadcast_to([0.0, 1.0], (1, 2, 2, 2))
    spectra = np.broadcast_to([0.0, 1.0], (1, 2, 2, 2, 2))
    surface = by_hand(vndf=rising, spectra=spectra)
    light = np.array([[0.0, 0.0, 1.0]])
    for theta_m in np.radians([5.0, 20.0, 35.0]):
        camera = np.array([[np.sin(2 * theta_m), 0.0, np.cos(2 * theta_m)]])
        wanted = 2.0 * theta_m / np.pi * 3.0 / 4.0 / camera[0, 2]
        np.testing.assert_allclose(surface.evaluate(light, camera), wanted, rtol=1e-5)


def test_wavelengths_stay_apart(by_hand):
    spectra = np.stack([np.ones((1, 2, 2, 2)), 5.0 * np.ones((1, 2, 2, 2))], axis=2)
    up = np.array([[0.0, 0.0, 1.0]])
    surface = by_hand(spectra=spectra)
    assert surface.wavelengths_nm == (500.0, 600.0)
    np.testing.assert_allclose(surface.evaluate(up, up), [[0.75, 3.75]], rtol=1e-6)


def test_a_file_of_a_symmetric_surface_is_unfolded(by_hand):
    """Azimuths from −180° to −90° only: two planes of symmetry. S grows with the azimuth of the light."""
    phi = np.radians([-180.0, -135.0, -90.0])
    spectra = np.broadcast_to(np.array([1.0, 2.0, 3.0])[:, None, None, None, None], (3, 2, 2, 2, 2))
    surface = by_hand(phi_i=phi, spectra=spectra, vndf=np.ones((3, 2, 2, 2)), luminance=np.ones((3, 2, 2, 2)))
    for turn, wanted in (
        (0.0, 1.0),
        (30.0, 1.0 + 30 / 45),
        (45.0, 2.0),
        (90.0, 3.0),
        (135.0, 2.0),
        (-60.0, 1 + 60 / 45),
    ):
        light = np.array([[0.5 * np.cos(np.radians(turn)), 0.5 * np.sin(np.radians(turn)), np.sqrt(0.75)]])
        found = surface.evaluate(light, np.array([[0.0, 0.0, 1.0]]))
        np.testing.assert_allclose(found, 0.75 * wanted, rtol=1e-5)


def test_lobe_and_base_survive(tmp_path, surfaces):
    flat = of_ridges(RidgeDesign(100.0, 0.0), Material(0.1, 0.1))
    write_rgl(flat, tmp_path / "flat.bsdf")
    found = read_rgl(tmp_path / "flat.bsdf")
    assert found.isotropic
    assert found.wavelengths_nm == ()
    light, camera = surfaces.pairs(4000, 60.0)
    assert surfaces.rms(found.evaluate(light, camera), flat.evaluate(light, camera)) < 0.006


def test_ridges_survive(tmp_path, surfaces):
    """The lobe of a facet that leans toward +x: an axis or a sign mistaken would put it elsewhere."""
    ridges = of_ridges(RidgeDesign(100.0, 10.0), Material(0.15, 0.15))
    write_rgl(ridges, tmp_path / "ridges.bsdf", Resolution(12, 25, 24))
    found = read_rgl(tmp_path / "ridges.bsdf")
    light, camera = surfaces.pairs(4000, 50.0)
    assert surfaces.rms(found.evaluate(light, camera), ridges.evaluate(light, camera)) < 0.03


def test_tensors_survive(tmp_path):
    arrays = {"a": np.arange(6, dtype=np.float32).reshape(2, 3), "text": np.frombuffer(b"abc", np.uint8)}
    write_tensors(arrays, tmp_path / "x.bsdf")
    data = (tmp_path / "x.bsdf").read_bytes()
    assert data[:18] == b"tensor_file\0\x01\x00\x02\x00\x00\x00"
    assert data[18:29] == b"\x01\x00a\x02\x00\x0a" + (80).to_bytes(8, "little")[:5]
    for name, array in read_tensors(tmp_path / "x.bsdf").items():
        np.testing.assert_array_equal(array, arrays[name])


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"vndf": np.ones((1, 3, 2, 2))}, "do not match the shape"),
        ({"spectra": np.ones((1, 2, 2, 2))}, "'spectra' has the shape"),
        ({"ndf": np.full((2, 2), np.nan)}, "no numbers"),
        ({"vndf": np.zeros((1, 2, 2, 2))}, "0 everywhere"),
    ],
)
def test_fields_that_cannot_be(by_hand, change, words):
    with pytest.raises(UsageError, match=words):
        by_hand(**change)


def test_damaged_files(tmp_path):
    path = tmp_path / "x.bsdf"
    write_tensors({name: array for name, array in fields().items() if name != "spectra"}, path)
    with pytest.raises(UsageError, match=r"'spectra' of a \.bsdf file is missing"):
        read_rgl(path)
    write_tensors(fields(), path)
    whole = path.read_bytes()
    for end in (0, 5, 13, 20, 60, 200, len(whole) - 1):
        path.write_bytes(whole[:end])
        with pytest.raises(UsageError, match=r"tensor_file|damaged or cut off"):
            read_rgl(path)
    path.write_bytes(whole[:12] + b"\x07" + whole[13:])
    with pytest.raises(UsageError, match="version 7"):
        read_rgl(path)


def test_refused_before_the_work(tmp_path, surfaces):
    with pytest.raises(UsageError, match="GiB"):
        write_rgl(surfaces.skew(), tmp_path / "x.bsdf", Resolution(200, 400, 300))
    with pytest.raises(UsageError, match="at least 2 inclinations"):
        Resolution(1, 37, 32)
    with pytest.raises(UsageError, match="nothing is reflected"):
        write_rgl(surfaces.lambertian(0.0), tmp_path / "x.bsdf")


def test_the_horizon_stays_dark(tmp_path, surfaces):
    """Normals that would mirror light below the horizon must not bring the lobe back: the albedo shows it."""
    flat = of_ridges(RidgeDesign(100.0, 0.0), Material(0.1, 0.1))
    write_rgl(flat, tmp_path / "flat.bsdf", Resolution(16, 5, 32))
    found = read_rgl(tmp_path / "flat.bsdf")
    for theta in (0.0, 1.0, 40.0):
        assert albedo(found, theta)[0] == pytest.approx(albedo(flat, theta)[0], rel=0.02)
