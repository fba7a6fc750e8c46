import numpy as np
import pytest


@pytest.fixture(scope="session")
def hemisphere():
    """Quadrature of the upper hemisphere: ``hemisphere(n_theta, n_phi)`` gives directions (N, 3), solid angles (N,)."""

    def build(n_theta=180, n_phi=360):
        node, weight = np.polynomial.legendre.leggauss(n_theta)
        mu, w = 0.5 * (node + 1), 0.5 * weight
        phi = (np.arange(n_phi) + 0.5) * 2 * np.pi / n_phi
        sine = np.sqrt(1 - mu**2)
        parts = np.outer(sine, np.cos(phi)), np.outer(sine, np.sin(phi)), np.outer(mu, np.ones(n_phi))
        return np.stack(parts, axis=-1).reshape(-1, 3), np.repeat(w * 2 * np.pi / n_phi, n_phi)

    return build
