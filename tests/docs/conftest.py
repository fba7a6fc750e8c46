import importlib.util
import sys
from pathlib import Path

import numpy as np
import pytest


@pytest.fixture
def rng():
    return np.random.default_rng(4)


@pytest.fixture(scope="session")
def pixel_bias_script():
    """The script that draws the figure of docs/uncertainty.md, as a module."""
    path = Path(__file__).resolve().parents[2] / "docs" / "pixel_bias.py"
    spec = importlib.util.spec_from_file_location("docs_pixel_bias", path)
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module
