"""Crossed gauge R&R: the AIAG example, Montgomery's with its negative component, and intervals that hold."""

import numpy as np
import pytest
from scipy.special import fdtri

from anisoscope.base.errors import UsageError
from anisoscope.base.json_fields import as_json
from anisoscope.quality import gauge as gauge_module
from anisoscope.quality.gauge import (
    GaugeData,
    MeanSquare,
    categories_of,
    component,
    gauge_data,
    gauge_study,
    share_interval,
    squares_of,
)
from anisoscope.quality.readings import Readings


def data_of(values):
    """(parts, appraisers, trials) with names."""
    parts, appraisers, _ = values.shape
    return GaugeData(tuple(f"P{k}" for k in range(parts)), tuple(f"A{k}" for k in range(appraisers)), values)


def random_data(rng, shape=(10, 3, 3), part=1.0, appraiser=0.3, interaction=0.2, noise=0.25):
    p, o, r = shape
    values = part * rng.normal(size=(p, 1, 1)) + appraiser * rng.normal(size=(1, o, 1))
    return data_of(values + interaction * rng.normal(size=(p, o, 1)) + noise * rng.normal(size=(p, o, r)))


@pytest.fixture
def few_draws(monkeypatch):
    """For tests of hundreds of studies."""
    monkeypatch.setattr(gauge_module, "DRAWS", 2000)


def test_aiag_example(published):
    """MSA 4th edition: ANOVA table, components, %GRR 27.9, and ndc 4.861, which counts as 4."""
    study = gauge_study(data_of(published.aiag_gauge.transpose(2, 0, 1)))
    part, appraiser, interaction, repeat, _ = study.table
    assert [line.sum_squares for line in (part, appraiser, interaction, repeat)] == pytest.approx(
        [88.3619, 3.1673, 0.3590, 2.7589], abs=6e-5
    )
    assert [line.freedom for line in study.table] == [9, 2, 18, 60, 78]
    assert interaction.f == pytest.approx(0.434, abs=5e-4)
    assert study.pooled
    sigmas = [study.repeatability, study.reproducibility, study.gauge, study.part, study.total]
    assert [one.sigma for one in sigmas] == pytest.approx(
        [0.199933, 0.226838, 0.302373, 1.042327, 1.085300], abs=2e-6
    )
    shares = [100.0 * study.share_of_study(one) for one in sigmas]
    assert shares == pytest.approx([18.4, 20.9, 27.9, 96.0, 100.0], abs=0.05)
    assert 1.41 * study.part.sigma / study.gauge.sigma == pytest.approx(4.861, abs=5e-4)
    assert study.categories == 4
    assert "usable for some purposes" in study.verdict
    assert "tells only 4 classes" in study.verdict


def test_montgomery_example_with_a_negative_interaction(published):
    """Design and Analysis of Experiments, example 13.1: table and components, full and reduced model."""
    study = gauge_study(data_of(published.montgomery_gauge), tolerance=52.0)
    part, appraiser, interaction, repeat, rest = study.table
    assert [line.sum_squares for line in study.table] == pytest.approx(
        [1185.425, 2.617, 27.050, 59.500, 86.550], abs=5e-4
    )
    assert [part.value, appraiser.value, interaction.value, repeat.value] == pytest.approx(
        [62.391, 1.308, 0.712, 0.992], abs=5e-4
    )
    full = component("interaction", [(0.5, interaction), (-0.5, repeat)])
    assert full.raw == pytest.approx(-0.1399, abs=5e-5)
    assert (full.negative, full.variance, full.low) == (True, 0.0, 0.0)
    assert rest.value == pytest.approx(0.8832, abs=5e-5)
    assert study.part.variance == pytest.approx(10.2513, abs=5e-5)
    assert study.appraiser.variance == pytest.approx(0.0106, abs=5e-5)
    assert study.share_of_tolerance(study.gauge) == pytest.approx(6.0 * np.sqrt(0.8938) / 52.0, abs=1e-4)


def test_an_interaction_that_is_there_stays(rng):
    study = gauge_study(random_data(rng, (20, 4, 3), interaction=1.0, noise=0.1))
    assert not study.pooled
    assert study.interaction.variance == pytest.approx(1.0, rel=0.5)
    both = study.appraiser.variance + study.interaction.variance
    assert study.reproducibility.variance == pytest.approx(both)
    assert study.gauge.variance == pytest.approx(both + study.repeatability.variance)
    assert study.total.variance == pytest.approx(study.gauge.variance + study.part.variance)


@pytest.mark.usefixtures("few_draws")
def test_components_come_back(rng):
    """Means of 300 studies; what came out negative is counted as it came out, so that nothing is biased."""
    found = [gauge_study(random_data(rng, (10, 5, 2), interaction=0.5)) for _ in range(300)]
    for name, truth in (("part", 1.0), ("appraiser", 0.09)):
        mean = np.mean([getattr(one, name).raw for one in found])
        assert mean == pytest.approx(truth, rel=0.17)  # of appraisers: 3.2 standard deviations


@pytest.mark.usefixtures("few_draws")
@pytest.mark.parametrize(
    ("studies", "low", "high"),
    [(150, 0.88, 1.0), pytest.param(1500, 0.93, 0.99, marks=pytest.mark.statistics)],
)
@pytest.mark.parametrize("interaction", [0.0, 0.6])
def test_intervals_hold_as_often_as_they_say(rng, interaction, studies, low, high):
    """95 % intervals of all components; modified large-sample ones hold a little more often."""
    truth = {
        "repeatability": 0.0625,
        "part": 1.0,
        "appraiser": 0.09,
        "interaction": interaction**2,
        "gauge": 0.0625 + 0.09 + interaction**2,
        "reproducibility": 0.09 + interaction**2,
        "total": 1.0625 + 0.09 + interaction**2,
    }
    hits, tries = dict.fromkeys(truth, 0), dict.fromkeys(truth, 0)
    for _ in range(studies):
        study = gauge_study(random_data(rng, (8, 4, 2), interaction=interaction))
        for name, value in truth.items():
            one = getattr(study, name)
            if one is not None and (interaction or study.pooled):
                tries[name] += 1
                hits[name] += one.low <= value <= one.high
    for name, number in tries.items():
        if number > studies / 3:
            assert low < hits[name] / number <= high, name


def test_one_mean_square_has_its_exact_chi_square_interval():
    found = component("x", [(1.0, MeanSquare("x", 10, 20.0))])
    assert (found.raw, found.low, found.high) == pytest.approx(
        (2.0, 20.0 / 20.4832, 20.0 / 3.24697), rel=1e-5
    )


def test_one_appraiser_is_a_one_way_study(published):
    values = published.aiag_gauge[:1].transpose(2, 0, 1)
    study = gauge_study(data_of(values))
    assert study.reproducibility is None
    assert study.gauge.variance == pytest.approx(values[:, 0].var(axis=1, ddof=1).mean())
    between = values[:, 0].mean(axis=1).var(ddof=1)
    assert study.part.variance == pytest.approx(between - study.gauge.variance / 3.0)
    assert "reproducibility was not studied" in " ".join(study.notes)


@pytest.mark.usefixtures("few_draws")
def test_parts_that_do_not_differ_are_a_negative_component_that_is_said(rng):
    for _ in range(50):
        study = gauge_study(random_data(rng, part=0.0))
        if study.part.negative:
            break
    assert (study.part.variance, study.categories) == (0.0, 0)
    assert "part came out negative" in " ".join(study.notes)
    assert "not good enough" in study.verdict


def test_a_gauge_without_noise_is_good():
    values = np.arange(5.0)[:, None, None] + np.zeros((5, 2, 2))
    study = gauge_study(data_of(values))
    assert (study.gauge.sigma, study.categories) == (0.0, None)
    assert study.verdict.startswith("good")
    assert as_json(study)["ndc"] is None


@pytest.mark.parametrize(
    ("values", "tolerance", "word"),
    [
        (np.zeros((1, 2, 2)), None, "2 parts"),
        (np.zeros((3, 2, 1)), None, "2 trials"),
        (np.ones((3, 2, 2)), None, "nothing varies"),
        (np.full((3, 2, 2), np.nan), None, "2 parts"),
        (np.dstack([np.arange(4.0).reshape(2, 2), np.full((2, 2), np.nan)]), None, "measured twice"),
        (np.array([[[1.0, 2.0], [np.nan, np.nan]], [[np.nan, np.nan], [4.0, 3.0]]]), None, "several parts"),
        (np.arange(12.0).reshape(3, 2, 2), -1.0, "width above 0"),
    ],
)
def test_what_carries_no_study_is_refused(values, tolerance, word):
    with pytest.raises(UsageError, match=word):
        gauge_study(data_of(values), tolerance)


@pytest.mark.parametrize(("f", "parts", "trials"), [(1.5, 5, 2), (8.0, 10, 3), (60.0, 20, 2)])
def test_with_one_appraiser_the_interval_is_the_exact_one_of_the_intraclass_correlation(f, parts, trials):
    """Part over repeatability: (F/F_upper - 1)/r to (F/F_lower - 1)/r; S. R. Searle, Linear Models (1971)."""
    part = MeanSquare("part", parts - 1, f * (parts - 1))
    repeat = MeanSquare("repeatability", parts * (trials - 1), float(parts * (trials - 1)))
    low, high = share_interval([(1.0, repeat)], [(1.0 / trials, part), (-1.0 / trials, repeat)])
    points = [fdtri(part.freedom, repeat.freedom, tail) for tail in (0.025, 0.975)]
    ratios = [max((f / point - 1.0) / trials, 0.0) for point in points]
    assert (low, high) == pytest.approx([1.0 / np.sqrt(1.0 + ratio) for ratio in ratios], rel=5e-3)


@pytest.mark.usefixtures("few_draws")
@pytest.mark.parametrize(
    ("studies", "least", "most"),
    [(60, 0.85, 1.0), pytest.param(500, 0.92, 0.985, marks=pytest.mark.statistics)],
)
@pytest.mark.parametrize("interaction", [0.0, 0.6])
def test_the_interval_of_the_share_holds_as_often_as_it_says(rng, interaction, studies, least, most):
    """Studies with 4 appraisers; 95 % intervals of %GRR and of ndc."""
    noise = 0.0625 + 0.09 + interaction**2
    truth, ndc = np.sqrt(noise / (1.0 + noise)), int(1.41 / np.sqrt(noise))
    hits = ndc_hits = 0
    for _ in range(studies):
        study = gauge_study(random_data(rng, (8, 4, 2), interaction=interaction))
        hits += study.share[0] <= truth <= study.share[1]
        few, many = study.categories_interval
        ndc_hits += few <= ndc <= many
    assert least < hits / studies <= most
    assert hits <= ndc_hits


def test_the_interval_does_not_depend_on_when_it_is_asked_for_and_bears_its_estimate(published):
    data = data_of(published.aiag_gauge.transpose(2, 0, 1))
    study = gauge_study(data, tolerance=8.0)
    assert study.share == gauge_study(data).share
    low, high = study.share
    assert low < study.share_of_study(study.gauge) < high
    few, many = study.categories_interval
    assert few <= study.categories <= many
    assert as_json(study)["ndc_interval"] == [few, many]
    least, most = study.tolerance_interval
    assert least < study.share_of_tolerance(study.gauge) < most
    assert "on both sides of 30%" in " ".join(study.notes)  # three appraisers tell little


def test_categories_go_with_the_share():
    assert categories_of(0.0) is None
    assert categories_of(1.0) == 0
    gauge, part = 0.302373, 1.042327
    assert categories_of(gauge / np.hypot(gauge, part)) == 4


def test_nested_casks_of_paste(published):
    """Three casks of ten batches each: R's lme4 prints the variances 8.434 (cask), 1.657 (batch) and 0.678."""
    rows = [
        (f"cask {cask}", f"batch {batch}", value)
        for batch, casks in enumerate(published.pastes)
        for cask, values in enumerate(casks)
        for value in values
    ]
    part, whom, values = zip(*rows, strict=True)
    readings = Readings("pastes", {"part": part, "appraiser": whom}, {"strength": np.array(values)})
    study = gauge_study(gauge_data(readings, nested=True))
    assert (study.design, study.parts, study.appraisers) == ("nested", 30, 10)
    assert [one.variance for one in (study.part, study.appraiser, study.repeatability)] == pytest.approx(
        [8.434, 1.657, 0.678], abs=5e-4
    )
    assert [line.freedom for line in study.table] == [9, 20, 30]
    casks = 2.0 * study.part.raw + study.repeatability.raw
    assert study.table[0].f == pytest.approx(1.0 + 6.0 * study.appraiser.raw / casks)  # batches against casks
    assert study.gauge.variance == pytest.approx(1.657 + 0.678, abs=1e-3)
    assert study.interaction is None
    assert "measured by one appraiser" in " ".join(study.notes)


@pytest.fixture
def holes(published):
    """AIAG's study without six of its 90 measurements, one cell among them."""
    values = published.aiag_gauge.transpose(2, 0, 1).copy()
    values[2, 1, :], values[4, 0, 2], values[7, 2, 1:] = np.nan, np.nan, np.nan
    return values


def test_squares_of_a_study_with_holes_are_those_of_statsmodels(holes):
    """statsmodels 0.15.0: anova_lm(ols("y ~ C(part) + C(appraiser)"), typ=2), and the residual with interaction."""
    study = gauge_study(data_of(holes))
    assert (study.design, study.pooled) == ("unbalanced", True)
    part, appraiser, *_ = study.table
    assert [line.sum_squares for line in study.table] == pytest.approx(
        [83.175031, 3.026170, 0.345558, 2.671733, 3.017291], abs=1e-6
    )
    assert [line.freedom for line in study.table] == [9, 2, 17, 55, 72]
    assert (part.f, appraiser.f) == pytest.approx((220.528996, 36.105929), abs=1e-5)
    # its REML (mixedlm) has 1.0899, 0.0529 and 0.04191, which is another estimate of the same
    found = [one.variance for one in (study.part, study.appraiser, study.repeatability)]
    assert found == pytest.approx([1.0899, 0.0529, 0.04191], rel=0.03)
    assert "6 of 90 measurements are missing" in " ".join(study.notes)


def test_variances_of_factors_in_mean_squares_are_those_that_are_drawn(rng, holes):
    """Means of many draws of one factor at a time, over the same holes."""
    missing, shapes = np.isnan(holes), [(10, 1, 1), (1, 3, 1), (10, 3, 1)]
    _, _, expected, names = squares_of(data_of(holes))
    assert names == ("part", "appraiser", "interaction")
    for factor, shape in enumerate(shapes):
        drawn = [
            [line.value for line in squares_of(data_of(np.where(missing, np.nan, rng.normal(size=shape))))[0]]
            for _ in range(60)
        ]
        means, doubt = np.mean(drawn, axis=0), np.std(drawn, axis=0) / np.sqrt(60)
        assert np.all(np.abs(means - expected[:, factor]) <= 4.0 * doubt + 1e-9)


@pytest.mark.usefixtures("few_draws")
@pytest.mark.parametrize(
    ("studies", "least"), [(60, 0.82), pytest.param(600, 0.9, marks=pytest.mark.statistics)]
)
@pytest.mark.parametrize(("interaction", "nested"), [(0.6, False), (0.0, True)])
def test_intervals_of_unbalanced_and_nested_studies_hold(rng, interaction, nested, studies, least):
    """A fifth of the measurements is missing, or each appraiser has five parts; 95 % intervals, and that of %GRR."""
    truth = {"repeatability": 0.0625, "part": 1.0, "appraiser": 0.09, "gauge": 0.1525 + interaction**2}
    hits, share = dict.fromkeys(truth, 0), 0
    for _ in range(studies):
        values = random_data(rng, (20 if nested else 8, 4, 2), interaction=interaction).values
        gone = np.arange(20)[:, None] // 5 != np.arange(4) if nested else rng.random(values.shape) < 0.2
        values[gone] = np.nan
        study = gauge_study(data_of(values[~np.isnan(values).all(axis=(1, 2))]))
        for name, value in truth.items():
            one = getattr(study, name)
            hits[name] += one.low <= value <= one.high
        share += study.share[0] <= np.sqrt(truth["gauge"] / (1.0 + truth["gauge"])) <= study.share[1]
    assert {name: number / studies for name, number in hits.items() if number / studies < least} == {}
    assert share / studies >= least


def test_one_appraiser_who_measured_some_parts_more_often():
    """Closed forms of the one-way analysis with unequal counts; S. R. Searle, Linear Models (1971), 11.4."""
    values = np.array([[[1.0, 1.2, np.nan]], [[2.0, 2.1, 2.4]], [[3.3, 3.2, np.nan]]])
    study = gauge_study(data_of(values))
    groups = [one[0][~np.isnan(one[0])] for one in values]
    counts = np.array([len(one) for one in groups])
    every = np.concatenate(groups)
    within = sum(((one - one.mean()) ** 2).sum() for one in groups) / (len(every) - 3)
    between = sum(len(one) * (one.mean() - every.mean()) ** 2 for one in groups) / 2.0
    size = (len(every) - (counts**2).sum() / len(every)) / 2.0
    assert study.part.variance == pytest.approx((between - within) / size)
    assert study.gauge.variance == pytest.approx(within)
