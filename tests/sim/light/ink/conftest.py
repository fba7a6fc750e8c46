import numpy as np
import pytest

from anisoscope.sim.light.ink.ink import Ink

NM = np.arange(380.0, 781.0, 10.0)


def made(name, peak, width, **changes):
    u = (NM - peak) / width
    rho = 0.04 + 0.30 * np.exp(-0.5 * u**2)
    c = 0.8 - 1.4 * u * np.exp(-0.25 * u**2)
    given = {"name": name, "alpha": 0.19, "wavelengths_nm": tuple(NM), "rho": tuple(rho), "c": tuple(c)}
    return Ink(**(given | changes))


@pytest.fixture
def make_ink():
    return lambda **changes: made("green", 535.0, 40.0, **changes)


@pytest.fixture
def inks():
    return [made("red", 640.0, 55.0), made("green", 535.0, 40.0), made("blue", 455.0, 35.0)]


@pytest.fixture
def rng():
    return np.random.default_rng(5)


@pytest.fixture
def upward(rng):
    """Draws (N, 3) unit vectors above the surface."""

    def draw(count):
        found = rng.standard_normal((count, 3))
        found[:, 2] = np.abs(found[:, 2])
        return found / np.linalg.norm(found, axis=1, keepdims=True)

    return draw
