"""Random dots against the expectation over the size of dot and source."""

import numpy as np
import pytest

from anisoscope.base.errors import ModelError
from anisoscope.sim.design.designfile import DesignFile
from anisoscope.sim.design.models import LobeModel, MirrorModel
from anisoscope.sim.design.resolution import tradeoff

MODEL = LobeModel(widths_x_um=(4.0,), p_a_x=(1.0,), widths_y_um=(4.0,), p_a_y=(1.0,))


def design(model=MODEL, **more):
    passes = () if model.kind == "mirror" else (125.0,)
    return DesignFile(name="one", model=model, passes_nm=passes, band_nm=(500.0, 500.0), grid_um=0.5, **more)


def test_the_error_falls_as_one_over_root_n():
    """Speckles of independent windows: four times as many windows halve the error, less what the steps share."""
    pairs = ((32.0, 16.0), (64.0, 16.0), (128.0, 32.0))
    few, many, same = tradeoff(design(), pairs, 6, np.random.default_rng(1))
    assert few.windows == pytest.approx(4.0)
    assert few.error / many.error == pytest.approx(2.0, rel=0.25)
    assert same.error == pytest.approx(many.error, rel=0.35)  # n alone counts
    assert many.source_deg == pytest.approx(1.79, abs=0.01)


@pytest.mark.parametrize(
    ("pair", "model", "words"),
    [
        ((8.0, 16.0), MODEL, "must hold one window"),
        ((4000.0, 16.0), MODEL, "GB"),
        ((16.0, 16.0), MirrorModel(), "takes a lobe or an anti-mirror"),
    ],
)
def test_dots_that_cannot_be_compared_are_refused(pair, model, words):
    with pytest.raises(ModelError, match=words):
        tradeoff(design(model), (pair,), 1, np.random.default_rng(1))
