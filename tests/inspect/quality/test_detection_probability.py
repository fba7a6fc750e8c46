"""Probability of detection: data of MIL-HDBK-1823A against an independent library, limits that hold, refusals."""

import math

import numpy as np
import pytest
from scipy.special import expit

from anisoscope.base.errors import UsageError
from anisoscope.base.json_fields import as_json
from anisoscope.quality.detection_probability import Trials, hit_miss, read_trials, signal_over_size


@pytest.fixture(scope="module")
def sm():
    """An independent library of regressions; importing it takes a second, which other tests need not wait for."""
    import statsmodels.api

    return statsmodels.api


@pytest.fixture(scope="module")
def example(published):
    """Example 3 of MIL-HDBK-1823A: 134 cracks, length in inches, found or not."""
    return Trials(*published.mil_hit_miss)


@pytest.mark.parametrize("link", ["logit", "probit"])
@pytest.mark.parametrize("scale", ["log", "linear"])
def test_hits_and_misses_of_the_handbook_are_fitted_as_by_an_independent_library(example, sm, link, scale):
    links = {"logit": sm.families.links.Logit(), "probit": sm.families.links.Probit()}
    found = hit_miss(example, scale, link)
    x = np.log(example.size) if scale == "log" else example.size
    other = sm.GLM(example.hit.astype(float), sm.add_constant(x), sm.families.Binomial(links[link])).fit()
    assert [found.parameters[name] for name in ("intercept", "slope")] == pytest.approx(
        other.params, rel=1e-5
    )
    assert found.deviance == pytest.approx(-2.0 * other.llf, abs=1e-8)
    curve = other.predict(sm.add_constant(np.log(found.grid) if scale == "log" else found.grid))
    assert found.probability == pytest.approx(curve, abs=1e-6)
    assert (found.count, found.found, found.false_calls) == (134, 92, None)
    for one, quantile in zip(found.sizes, (0.5, 0.9), strict=True):
        at = math.log(one.size) if scale == "log" else one.size
        assert other.predict([1.0, at])[0] == pytest.approx(quantile, abs=1e-6)


def test_limits_are_those_of_the_profile_likelihood(example, sm):
    """At the ends of an interval an independent fit with the curve fixed there is worse by χ² of 95 or 90 %."""
    found = hit_miss(example)
    top = found.deviance
    for one in found.sizes:
        for at, drop in ((one.low, 3.841459), (one.high, 3.841459), (one.bound, 2.705543)):
            x = np.log(example.size / at)
            offset = np.full(len(x), math.log(one.probability / (1.0 - one.probability)))
            fixed = sm.GLM(example.hit.astype(float), x, sm.families.Binomial(), offset=offset).fit()
            assert -2.0 * fixed.llf - top == pytest.approx(drop, abs=1e-4)
    assert found.sizes[1].size < found.sizes[1].bound < found.sizes[1].high


def signals(rng, count=80):
    size = rng.uniform(0.5, 5.0, count)
    return size, np.exp(0.3 + 1.2 * np.log(size) + 0.25 * rng.normal(size=count))


def test_signals_are_fitted_as_by_an_independent_library(rng, sm):
    size, signal = signals(rng)
    found = signal_over_size(size, signal, 2.0)
    other = sm.OLS(np.log(signal), sm.add_constant(np.log(size))).fit()
    assert [found.parameters[name] for name in ("intercept", "slope")] == pytest.approx(
        other.params, rel=1e-7
    )
    assert found.parameters["sigma"] == pytest.approx(math.sqrt(other.ssr / 80), rel=1e-7)
    assert found.deviance == pytest.approx(-2.0 * other.llf, abs=1e-7)
    a50, a90 = found.sizes
    line = found.parameters["intercept"] + found.parameters["slope"] * math.log(a50.size)
    assert line == pytest.approx(math.log(2.0))
    reach = 1.2815515655 * found.parameters["sigma"] / found.parameters["slope"]
    assert math.log(a90.size / a50.size) == pytest.approx(reach)


def test_limits_of_many_signals_are_those_of_normal_theory(rng):
    """The handbook's limit of a90 for â against a, by the covariance of the line and its scatter."""
    size, signal = signals(rng, 2000)
    found = signal_over_size(size, signal, 2.0, points=2)
    x, slope, sigma = np.log(size), found.parameters["slope"], found.parameters["sigma"]
    design = np.column_stack([np.ones(len(x)), x])
    v = np.linalg.inv(design.T @ design) * sigma**2
    at = math.log(found.sizes[1].size)
    gradient = np.array([1.0, at]) / slope
    u = math.sqrt(gradient @ v @ gradient + (1.2815515655 / slope) ** 2 * sigma**2 / (2 * len(x)))
    assert math.log(found.sizes[1].bound) - at == pytest.approx(1.644854 * u, rel=0.02)


def test_censored_signals_leave_the_line_where_it_is(rng):
    """Below the noise and in saturation signals are cut: the fit of what is left does not follow the cut."""
    size, signal = signals(rng, 800)
    cut = np.clip(signal, 1.2, 6.0)
    found = signal_over_size(size, cut, 2.0, noise=1.2, saturation=6.0, points=2)
    plain = signal_over_size(size, signal, 2.0, points=2)
    for name, value in plain.parameters.items():
        assert found.parameters[name] == pytest.approx(value, rel=0.08)
    careless = signal_over_size(size, cut, 2.0, points=2)
    assert abs(careless.parameters["slope"] / plain.parameters["slope"] - 1.0) > 0.05


@pytest.mark.parametrize(
    ("studies", "low", "high"),
    [(30, 0.8, 1.0), pytest.param(1000, 0.929, 0.971, marks=pytest.mark.statistics)],
)
def test_a_90_95_is_above_the_true_a90_as_often_as_it_says(rng, studies, low, high):
    held = 0
    true = math.exp(math.log(9.0) / 4.0)
    for _ in range(studies):
        size = rng.uniform(0.3, 3.0, 100)
        hit = rng.random(100) < expit(4.0 * np.log(size))
        held += hit_miss(Trials(size, hit), points=2).sizes[1].bound >= true
    assert low <= held / studies <= high


def test_parts_without_a_defect_are_false_calls_and_not_in_the_curve(example, rng):
    size = np.concatenate([np.zeros(50), example.size])
    hit = np.concatenate([np.arange(50) < 1, example.hit])
    found = hit_miss(Trials(size, hit))
    assert found.false_calls[:2] == (1, 50)
    assert found.false_calls[3] == pytest.approx(0.1065, abs=5e-4)
    assert found.parameters == hit_miss(example).parameters
    assert as_json(found)["verdict"].startswith("a50 0.1085, a90 0.1734, a90/95 0.2032")
    size, signal = signals(rng)
    noise = np.concatenate([signal, 2.5 * rng.random(20)])
    with_none = signal_over_size(np.concatenate([size, np.zeros(20)]), noise, 2.0)
    assert with_none.false_calls[1] == 20


def test_a_curve_that_hardly_grows_has_a_bound_beyond_every_size():
    """Hits that hardly grow with the size leave a90 open upward, which is said."""
    place = np.arange(40)
    found = hit_miss(Trials(1.0 + 0.01 * place, (place % 2 == 0) | (place > 35)), points=2)
    assert math.isinf(found.sizes[1].bound)
    assert "beyond every size" in found.verdict


@pytest.mark.parametrize(
    ("size", "hit", "word"),
    [
        (np.arange(1.0, 11.0), np.arange(10) > 4, "20 parts with a defect or more"),
        (np.arange(1.0, 41.0), np.ones(40, dtype=bool), "all of the defects were found"),
        (np.arange(1.0, 41.0), np.zeros(40, dtype=bool), "none of the defects were found"),
        (np.arange(1.0, 41.0), np.arange(40) > 20, "one size separates"),
        (np.arange(1.0, 41.0), np.arange(40) % 20 < 10, "not found more often"),
    ],
)
def test_what_carries_no_curve_is_refused(size, hit, word):
    with pytest.raises(UsageError, match=word):
        hit_miss(Trials(size, hit))


def test_signals_that_carry_no_curve_are_refused(rng):
    size, signal = signals(rng)
    with pytest.raises(UsageError, match="no larger signals"):
        signal_over_size(size, 1.0 / signal, 2.0)
    with pytest.raises(UsageError, match="has no logarithm"):
        signal_over_size(size, signal - 5.0, 2.0)
    with pytest.raises(UsageError, match="too few signals"):
        signal_over_size(size, signal, 2.0, noise=100.0)
    with pytest.raises(UsageError, match="confidence lies between"):
        signal_over_size(size, signal, 2.0, confidence=0.2)


def test_a_file_of_trials_is_read(tmp_path):
    path = tmp_path / "p.csv"
    path.write_text("size;hit\n0,5;1\n0;0\n")
    size, signal, hit = read_trials(path)
    assert (size.tolist(), signal, hit.tolist()) == ([0.5, 0.0], None, [True, False])
    path.write_text("size,signal\n1,2.5\n")
    assert read_trials(path)[1].tolist() == [2.5]
    for text, word in (
        ("size,hit\n1,2\n", "line 2: hit is 1 or 0"),
        ("size,hit\n-1,1\n", "size must be"),
        ("a\n1\n", "header"),
    ):
        path.write_text(text)
        with pytest.raises(UsageError, match=word):
            read_trials(path)
