"""Bias, linearity and stability: the AIAG examples."""

import numpy as np
import pytest

from anisoscope.base.errors import UsageError
from anisoscope.base.json_fields import as_json
from anisoscope.quality.bias import bias_study
from anisoscope.quality.control import Settings
from anisoscope.quality.linearity import gauge_linearity
from anisoscope.quality.stability import stability_study


def columns(levels):
    references = np.concatenate([[level] * len(found) for level, found in levels.items()])
    return references, np.concatenate(list(levels.values()))


def test_aiag_bias_example(published):
    """MSA 4th edition: 15 readings of a part of 6.00: bias 0.0067, t 0.12, interval -0.1107 to 0.1241: no bias."""
    found = bias_study(published.aiag_bias, 6.0)
    assert (found.count, found.bias, found.sigma) == (
        15,
        pytest.approx(0.0067, abs=5e-5),
        pytest.approx(0.212, abs=5e-4),
    )
    assert (found.t, found.p) == (pytest.approx(0.1218, abs=5e-5), pytest.approx(0.9048, abs=5e-5))
    assert (found.low, found.high) == (pytest.approx(-0.1107, abs=5e-5), pytest.approx(0.1241, abs=5e-5))
    assert not found.significant
    assert "no bias is seen" in found.verdict
    assert bias_study(published.aiag_bias, 5.5).significant
    assert "calibrate" in bias_study(published.aiag_bias, 5.5).verdict


def test_aiag_linearity_example(published):
    """MSA 4th edition: slope -0.131667 (t -12.043), intercept 0.736667 (t 10.158), s 0.23954, R² 71.4 %, biases."""
    study = gauge_linearity(*columns(published.aiag_linearity))
    assert (study.slope.value, study.slope.t) == (
        pytest.approx(-0.131667, abs=5e-7),
        pytest.approx(-12.043, abs=5e-4),
    )
    assert (study.intercept.value, study.intercept.t) == (
        pytest.approx(0.736667, abs=5e-7),
        pytest.approx(10.158, abs=5e-4),
    )
    assert (study.sigma, study.r2) == (pytest.approx(0.23954, abs=5e-6), pytest.approx(0.714, abs=5e-4))
    assert study.t_limit == pytest.approx(2.00172, abs=5e-6)
    biases = [level.bias for level in study.levels]
    assert biases == pytest.approx([0.491667, 0.125, 0.025, -0.29167, -0.61667], abs=5e-6)
    assert not study.fit
    assert "not linear" in study.verdict
    assert [level["bias"] for level in as_json(study)["levels"]] == biases


def test_an_offset_is_linear_but_biased_and_a_good_gauge_is_fit(rng):
    references = np.repeat([2.0, 4.0, 6.0, 8.0, 10.0], 12)
    noise = rng.normal(0.0, 0.1, 60)
    noise -= noise.reshape(5, 12).mean(axis=1).repeat(12)
    good = gauge_linearity(references, references + noise)
    assert good.fit
    assert "within the band" in good.verdict
    offset = gauge_linearity(references, references + noise + 0.5)
    assert not offset.fit
    assert "linear but biased" in offset.verdict


def test_the_band_holds_the_true_line_as_often_as_it_says(rng):
    references = np.repeat([1.0, 2.0, 4.0, 7.0], 5)
    hits = 0
    for _ in range(1500):
        study = gauge_linearity(references, references + 0.2 - 0.03 * references + rng.normal(0.0, 0.1, 20))
        _, low, high = study.band(np.array([6.0]))
        hits += low[0] <= 0.2 - 0.03 * 6.0 <= high[0]
    assert hits / 1500 == pytest.approx(0.95, abs=0.02)


def test_stability_of_a_check_standard(published):
    labels = tuple(f"day {k}" for k in range(15))
    steady = stability_study(published.aiag_bias, labels, Settings(), 6.0)
    assert steady.chart.stable
    assert steady.verdict.endswith(steady.bias.verdict)
    drifting = stability_study(published.aiag_bias + 0.3 * np.arange(15), labels, Settings(), 6.0)
    assert not drifting.chart.stable
    assert "says little" in drifting.verdict
    assert stability_study(published.aiag_bias, labels, Settings()).bias is None
    assert as_json(drifting)["bias"]["significant"] == drifting.bias.significant


@pytest.mark.parametrize(
    ("values", "reference", "alpha", "word"),
    [
        ([1.0, 2.0, np.nan], 1.0, 0.05, "3 or more"),
        ([1.0] * 5, 1.0, 0.05, "all values"),
        ([1.0, 2.0, 3.0], np.nan, 0.05, "reference"),
        ([1.0, 2.0, 3.0], 1.0, 0.7, "alpha"),
    ],
)
def test_what_carries_no_bias_study_is_refused(values, reference, alpha, word):
    with pytest.raises(UsageError, match=word):
        bias_study(np.array(values), reference, alpha)


@pytest.mark.parametrize(
    ("references", "word"),
    [([1.0, 1.0, 1.0, 2.0, 2.0, 2.0], "3 or more reference"), ([1.0, 1.0, 2.0, 2.0, 3.0, 3.0], "at 1")],
)
def test_what_carries_no_linearity_study_is_refused(references, word):
    with pytest.raises(UsageError, match=word):
        gauge_linearity(np.array(references), np.arange(6.0))
