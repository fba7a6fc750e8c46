import numpy as np
import pytest

from anisoscope.sim.light.colour.illuminant import standard
from anisoscope.sim.materials.inks import SYNTHETIC, synthetic_ink
from anisoscope.sim.proof.separation import separation


@pytest.fixture(scope="session")
def inks():
    return tuple(synthetic_ink(name) for name in SYNTHETIC)


@pytest.fixture(scope="session")
def plan(inks):
    return separation(inks, standard("d65"))


@pytest.fixture
def d65():
    return standard("d65")


@pytest.fixture
def rng():
    return np.random.default_rng(7)
