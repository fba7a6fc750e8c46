"""Reflectances in closed form."""

from types import SimpleNamespace

import numpy as np
import pytest

from anisoscope.bsdf.reflectance import Reflectance, above_horizon


def _surface(function, wavelengths_nm=(), *, isotropic=False, name="test"):
    """A reflectance of (N, 3), (N, 3) -> (N,) or (N, W)."""
    return Reflectance(
        name,
        lambda light, camera: above_horizon(light, camera, function),
        wavelengths_nm,
        isotropic=isotropic,
    )


def _lambertian(rho=0.5):
    return _surface(lambda light, _: np.full(len(light), rho / np.pi), isotropic=True)


def _skew():
    """Anisotropic, not reciprocal, smooth: everything that a mistaken axis or sign would change."""
    return _surface(
        lambda i, o: (
            1 + 0.5 * i[:, 0] + 0.2 * i[:, 1] + 0.8 * o[:, 0] * o[:, 2] - 0.4 * o[:, 1] + i[:, 1] * o[:, 0]
        )
    )


def _pairs(count, highest_deg, seed=0):
    """(count, 3) directions to light and camera, uniform in solid angle."""
    rng = np.random.default_rng(seed)
    found = []
    for _ in range(2):
        z = 1.0 - rng.random(count) * (1.0 - np.cos(np.radians(highest_deg)))
        turn, across = 2.0 * np.pi * rng.random(count), np.sqrt(1.0 - z**2)
        found.append(np.stack([across * np.cos(turn), across * np.sin(turn), z], axis=-1))
    return found


def _rms(found, wanted):
    return float(np.sqrt(np.mean((found - wanted) ** 2) / np.mean(wanted**2)))


@pytest.fixture(scope="session")
def surfaces():
    return SimpleNamespace(surface=_surface, lambertian=_lambertian, skew=_skew, pairs=_pairs, rms=_rms)
