import numpy as np
import pytest


def unit(x, y=0.0):
    """Unit vector with the direction cosines x and y."""
    return np.array([x, y, np.sqrt(1.0 - x * x - y * y)])


@pytest.fixture
def direction():
    return unit


@pytest.fixture(scope="session")
def rough_steps():
    """(rows, cols) steps of 2 µm in two levels with some roughness, pixels of 0.25 µm."""
    rng = np.random.default_rng(0)
    return np.kron(rng.choice([0.0, 0.125], (5, 6)), np.ones((8, 8))) + 0.03 * rng.normal(size=(40, 48))
