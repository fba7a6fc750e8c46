"""Certificate of false alarms: closed forms, order statistics by simulation, refusals."""

import numpy as np
import pytest

from anisoscope.base.errors import UsageError
from anisoscope.decision.certificate import certificate


def test_no_alarm_among_299_certifies_one_percent():
    """The rule of Wilks: 1 - 0.99^n reaches 95 % from n = 299 on, 1 - 0.95^n from 59 on."""
    assert not certificate(["PASS"] * 298, [None] * 298).certified
    found = certificate(["PASS"] * 299, [None] * 299, stated=0.01)
    assert found.certified
    assert (found.needed, found.stated, found.level) == (299, 0.01, None)
    assert found.highest == pytest.approx(1.0 - 0.05 ** (1.0 / 299))
    assert certificate(["PASS"] * 59, [None] * 59, 0.05).certified
    assert certificate(["PASS"] * 5, [None] * 5, 0.05).needed == 59


@pytest.mark.parametrize(("alarms", "count"), [(1, 40), (7, 300), (40, 40)])
def test_the_limit_is_that_of_an_independent_library(alarms, count):
    from statsmodels.stats.proportion import (
        proportion_confint,
    )  # a second, which no other test of this file needs

    verdicts = ["FAIL"] * alarms + ["INCONCLUSIVE"] * (count - alarms)
    found = certificate(verdicts, [None] * count, confidence=0.9)
    assert found.highest == pytest.approx(proportion_confint(alarms, count, 0.2, "beta")[1], abs=1e-9)
    assert (found.alarms, found.undecided) == (alarms, count - alarms)


def test_the_level_by_order_statistics_holds_whatever_the_distribution(rng):
    """P values far from uniform: the level of 120 good parts alarms in 5 % of parts at most, 95 times in 100."""
    held = 0
    for _ in range(400):
        p = rng.beta(0.3, 2.0, 120)
        level = certificate(["PASS"] * 120, p.tolist(), 0.05).level
        held += np.mean(rng.beta(0.3, 2.0, 20_000) < level) <= 0.05
    assert held / 400 > 0.92


def test_the_level_needs_enough_parts_and_all_p_values():
    assert certificate(["PASS"] * 58, [0.5] * 58, 0.05).level is None
    assert certificate(["PASS"] * 59, [0.5] * 58 + [0.2], 0.05).level == 0.2
    assert certificate(["PASS"] * 60, [0.5] * 59 + [None], 0.05).level is None


@pytest.mark.parametrize(
    ("verdicts", "wanted", "confidence", "word"),
    [
        ([], 0.01, 0.95, "nothing can be certified"),
        (["PASS"], 0.0, 0.95, "lies between"),
        (["PASS"], 0.1, 1.0, "lies between"),
    ],
)
def test_what_certifies_nothing_is_refused(verdicts, wanted, confidence, word):
    with pytest.raises(UsageError, match=word):
        certificate(verdicts, [None] * len(verdicts), wanted, confidence)
