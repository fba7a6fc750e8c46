"""A whole control study: what it says, and that it says it honestly."""

import numpy as np
import pytest

from anisoscope.base.errors import UsageError
from anisoscope.base.json_fields import as_json
from anisoscope.quality.capability import Specification
from anisoscope.quality.control import Settings, control_study
from anisoscope.quality.limits import individuals

LABELS = tuple(f"SN-{k}" for k in range(1, 201))


def study(values, settings=None, limits=None):
    return control_study(
        "ln 0-90", individuals(values, LABELS[: len(values)]), settings or Settings(), limits
    )


def steady(count, seed=2):
    """Noise in which no rule is met."""
    for one in range(seed, seed + 200):
        values = np.random.default_rng(one).normal(size=count)
        if study(values).stable:
            return values
    raise AssertionError("no quiet noise")


def test_a_steady_process_is_stable_and_judged():
    found = study(steady(60), limits=Specification(-8.0, 8.0))
    assert found.stable
    assert found.verdict.startswith("stable: nothing unusual among 60 values; capable: Ppk ")
    assert "meaningless until" not in found.verdict
    assert "not capable" in study(steady(60), limits=Specification(-1.0, 1.0)).verdict


def test_a_shift_after_the_baseline_is_found_and_named():
    values = np.concatenate([steady(60), steady(60) + 2.0])
    found = study(values, Settings(baseline=60), Specification(-8.0, 8.0))
    assert not found.stable
    assert found.limits.baseline == 60
    assert abs(found.limits.center) < 0.5
    assert min(flag.seen_at for flag in found.flags) in range(60, 70)
    assert "meaningless until" in found.verdict
    assert f"first at {LABELS[found.flags[0].seen_at]}" in found.verdict


def test_a_slow_drift_shows_in_the_average():
    values = np.concatenate([steady(60), 1.1 + 0.5 * steady(40)])
    found = study(values, Settings(baseline=60))
    assert found.average.outside[60:].any()
    assert "moving average leaves its limits" in found.verdict


def test_json_says_the_same_and_counts_from_one():
    values = steady(40)
    values[19] = 9.0
    values[30] = np.nan
    found = study(values, limits=Specification(-50.0, None))
    content = as_json(found)
    assert (content["measured"], content["missing"], content["stable"]) == (39, 1, False)
    (first,) = [flag for flag in content["flags"] if flag["rule"] == 1]
    assert (first["rule"], first["first"], first["labels"]) == (1, 20, ["SN-20"])
    assert content["capability"]["cp"] is None
    assert (content["capability"]["lower"], content["capability"]["upper"]) == (-50.0, None)
    assert "1 value missing" in content["notes"][0]
    assert "SN-20" in content["wide_ranges"]


def test_what_weakens_the_chart_is_said(rng):
    assert "10 values only" in " ".join(study(steady(60), Settings(baseline=10)).notes)
    assert "were given" in " ".join(study(steady(60), Settings(center=0.0, sigma=1.0)).notes)
    assert "rounded too coarsely" in " ".join(study(np.round(0.6 * rng.normal(size=100))).notes)


@pytest.mark.parametrize(
    ("settings", "word"),
    [
        (Settings(center=1.0), "go together"),
        (Settings(center=1.0, sigma=1.0, baseline=10), "place of a baseline"),
        (Settings(baseline=300), "choose a smaller one"),
        (Settings(weight=2.0), "lambda"),
    ],
)
def test_settings_without_sense_are_refused(settings, word):
    with pytest.raises(UsageError, match=word):
        study(steady(60), settings)
