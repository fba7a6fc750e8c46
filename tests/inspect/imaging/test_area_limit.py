"""The limit of the area that golden parts teach: how often good parts exceed it, and what has the word."""

import numpy as np
import pytest

from anisoscope.imaging.area_limit import LEAST_PARTS, MIN_PARTS, KnownShares, learnt_limit

CELLS, ALPHA = 2800, 0.01


def false_alarms(draw, rng, count, sets=200, parts=400):
    limits = [learnt_limit(draw(rng, count), CELLS, ALPHA) for _ in range(sets)]
    return float(np.mean([np.mean(draw(rng, parts) > limit) for limit in limits]))


@pytest.mark.parametrize("count", [MIN_PARTS, 25])
@pytest.mark.parametrize("shape", [1.0, 2.0, 5.0])
def test_good_parts_exceed_it_as_rarely_as_stated(shape, count, rng):
    rate = false_alarms(lambda r, n: r.gamma(shape, 0.02 / shape, n), rng, count)
    assert rate == pytest.approx(ALPHA, rel=0.5)


def test_heavier_tails_cost_no_more_than_three_times(rng):
    assert false_alarms(lambda r, n: 0.01 * np.exp(r.standard_normal(n)), rng, 25) < 3.0 * ALPHA


@pytest.mark.parametrize("mean", [0.0, 0.2, 4.0])
def test_single_cells_are_counted(mean, rng):
    def draw(r, n):
        return r.poisson(mean, n) / CELLS

    assert false_alarms(draw, rng, 25, sets=100) <= ALPHA
    limit = learnt_limit(draw(rng, 25), CELLS, ALPHA)
    assert 0.0 < limit < (mean + 5.0 * np.sqrt(mean) + 6.0) / CELLS


def test_the_excess_of_nothing_seen_is_that_of_its_prior():
    """Of 25 parts none showed a cell: the next one shows more than one with a chance of 0.1 %, one or more with 2 %."""
    assert learnt_limit([0.0] * 25, CELLS, 0.01) == pytest.approx(1.0 / CELLS)
    assert learnt_limit([0.0] * 25, CELLS, 0.03) == 0.0


def test_no_golden_part_exceeds_its_own_limit_and_few_parts_teach_nothing(rng):
    shares = np.append(rng.gamma(20.0, 1e-3, 24), 0.2)
    assert learnt_limit(shares, CELLS, ALPHA) >= 0.2
    assert learnt_limit(shares[: LEAST_PARTS - 1], CELLS, ALPHA) is None


@pytest.mark.parametrize("shape", [0.3, 2.0])
@pytest.mark.parametrize("alpha", [0.2, 0.01, 1e-4])
def test_the_chance_of_a_share_is_the_level_whose_limit_it_exceeds(rng, shape, alpha):
    known = KnownShares(tuple(rng.gamma(shape, 2e-3, 25)), CELLS)
    limit = known.limit(alpha)
    step = 1.5 / CELLS
    assert known.chance(limit + step) < alpha
    assert known.chance(limit - step) >= min(alpha, 1.0)


def test_a_share_that_a_golden_part_has_shown_is_no_surprise(rng):
    shares = rng.gamma(2.0, 2e-3, 25)
    assert KnownShares(tuple(shares), CELLS).chance(float(shares.max())) == 1.0
    assert KnownShares((0.0,) * 25, CELLS).chance(0.0) == 1.0
    assert 0.0 < KnownShares((0.0,) * 25, CELLS).chance(1.0 / CELLS) < 0.05
