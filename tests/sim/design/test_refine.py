"""Refinement: the fast error is the exact one, the ranking is its gradient, and the search gets where it must."""

import numpy as np
import pytest

from anisoscope.base.errors import ModelError
from anisoscope.sim.design.dot import Dot, DotState, DotTask
from anisoscope.sim.design.refine import Bench, Limits, Polish, mutated, refine
from anisoscope.sim.light.wave.sampling import Widths

STEPS = Widths((2.0, 2.75, 3.5), (0.75, 0.2, 0.05))
WHITE = DotTask(STEPS, STEPS, (0.0, -0.1073, -0.1575, -0.2648), 32.0, 8.0)
GREEN = DotTask(STEPS, STEPS, (0.0, -0.125), 40.0, 10.0)
PIXEL = 0.25


def exact(task, dot):
    """Relative error of a dot by the correlation of its wave on the pixels, times the coherence: no binning."""
    y, x = (np.rint(np.diff(edges) / PIXEL).astype(int) for edges in (dot.edges_y_um, dot.edges_x_um))
    wave = np.repeat(np.repeat(task.phases[dot.levels], y, axis=0), x, axis=1)
    n = wave.shape[0]
    correlation = np.fft.ifft2(np.abs(np.fft.fft2(wave, s=(2 * n, 2 * n))) ** 2)
    lag = np.fft.fftfreq(2 * n, 1.0 / (2 * n)) * PIXEL
    blur = np.sinc(lag / task.coherence_um)
    kept = np.exp(-2j * np.pi * np.outer(task.windows, lag)) * np.sinc(task.windows * PIXEL)[:, None] * blur
    seen = (kept @ correlation @ kept.T).real * PIXEL**4 / task.dot_um**2
    wanted = task.expected()
    return np.linalg.norm(seen - wanted) / np.linalg.norm(wanted)


@pytest.fixture(scope="module", params=[GREEN, WHITE], ids=["two levels", "four levels"])
def bench(request):
    return Bench(request.param)


def test_the_binned_error_is_the_exact_one(bench):
    for seed in (0, 1):
        dot = bench.task.draw(np.random.default_rng(seed))
        fast = bench.relative(bench.measure(DotState(bench.task, dot)))
        assert fast == pytest.approx(exact(bench.task, dot), rel=0.02)


def test_a_polish_ends_where_the_exact_error_says_and_its_spectrum_stays_true(bench):
    polish = Polish(bench, bench.task.draw(np.random.default_rng(2)))
    start = bench.relative(polish.error)
    for _ in range(12):
        polish.step(96)
    found = bench.relative(polish.error)
    assert found < 0.6 * start
    assert found == pytest.approx(exact(bench.task, polish.state.frozen()), rel=0.1)
    fresh = DotState(bench.task, polish.state.frozen())
    for kept, again in zip(polish.state.spectrum, fresh.spectrum, strict=True):
        np.testing.assert_allclose(kept, again, atol=2e-4 * np.abs(again).max())


def test_the_ranking_is_the_change_of_the_error_to_first_order(bench):
    state = DotState(bench.task, bench.task.draw(np.random.default_rng(3)))
    before = bench.measure(state)
    cells, to, predicted = bench.ranked(state)
    # what the exact change exceeds the prediction by is a square, so never negative
    for n in (0, 1, cells.size // 2, cells.size - 1):
        levels = state.levels.copy()
        levels.flat[cells[n]] = to[n]
        after = bench.measure(DotState(bench.task, Dot(state.dot.edges_x_um, state.dot.edges_y_um, levels)))
        assert after - before >= predicted[n] - 1e-4 * before
        assert after - before - predicted[n] < 0.5 * before
    assert (np.diff(predicted) >= 0.0).all()


def test_a_polish_that_is_done_cannot_be_bettered_by_any_single_change():
    bench = Bench(DotTask(STEPS, STEPS, (0.0, -0.125), 24.0, 8.0))
    polish = Polish(bench, bench.task.draw(np.random.default_rng(4)))
    while polish.step():
        pass
    dot = polish.state.frozen()
    for cell in range(0, dot.levels.size, 3):
        levels = dot.levels.copy()
        levels.flat[cell] = 1 - levels.flat[cell]
        other = bench.measure(DotState(bench.task, Dot(dot.edges_x_um, dot.edges_y_um, levels)))
        assert other >= polish.error * (1.0 - 1e-4)


def test_genetic_search_with_polish_beats_each_alone_and_repeats_itself():
    found = {
        method: refine(
            GREEN, np.random.default_rng(7), Limits(None, generations), method=method, population=3
        )
        for method, generations in (("both", 8), ("genetic", 20), ("polish", 1000))
    }
    assert found["polish"].stopped == "stuck"
    assert found["both"].error < found["polish"].error < found["genetic"].error
    assert found["genetic"].error < found["genetic"].start_error
    assert found["both"].error == pytest.approx(exact(GREEN, found["both"].dot), rel=0.1)
    again = refine(GREEN, np.random.default_rng(7), Limits(None, 8), population=3)
    assert again.error == found["both"].error
    np.testing.assert_array_equal(again.dot.levels, found["both"].dot.levels)


def test_the_full_dot_gets_from_0_12_below_0_04_within_a_bounded_number_of_changes():
    """112 µm, Δc 16 µm, σ_h .04: 25 batches of the polish, which take less than a second on an idle machine."""
    task = DotTask(Widths((2.0, 2.75, 3.0, 3.5), (0.74, 0.17, 0.03, 0.06)), STEPS, (0.0, -0.125))
    bench = Bench(task)
    polish = Polish(bench, task.draw(np.random.default_rng(0)))
    assert 0.1 < bench.relative(polish.error) < 0.2
    for _ in range(40):
        polish.step(96)
    assert bench.relative(polish.error) <= 0.04


def test_an_interruption_keeps_the_best():
    def advance(doing, done, total):
        del done, total
        advance.calls += 1
        if advance.calls == 5:
            raise KeyboardInterrupt(doing)

    advance.calls = 0
    found = refine(GREEN, np.random.default_rng(1), Limits(None, 50), population=2, on_progress=advance)
    assert found.stopped == "interrupted"
    assert found.error == min(error for _, error in found.history)
    assert np.isfinite(found.error)


def test_time_and_quality_end_the_search():
    ticks = iter(np.arange(0.0, 1e4, 0.01))
    timed = refine(GREEN, np.random.default_rng(1), Limits(0.3), clock=lambda: float(next(ticks)))
    assert timed.stopped == "time"
    good = refine(GREEN, np.random.default_rng(1), Limits(None, 50, error=0.2), population=2)
    assert good.stopped == "good enough"
    assert good.error <= 0.2


@pytest.mark.parametrize("seed", range(4))
def test_mutants_keep_to_the_least_width_and_the_size_of_the_dot(seed):
    rng = np.random.default_rng(seed)
    dot = GREEN.draw(rng)
    for _ in range(20):
        dot = mutated(GREEN, dot, 0.05, rng)
        for edges, count in ((dot.edges_x_um, dot.levels.shape[1]), (dot.edges_y_um, dot.levels.shape[0])):
            assert edges[0] == 0.0
            assert edges[-1] == GREEN.dot_um
            assert np.diff(edges).min() >= 2.0 - 1e-9
            assert edges.size == count + 1


def test_what_cannot_be_refined_is_refused():
    with pytest.raises(ModelError, match="needs an end"):
        Limits(None, None)
    with pytest.raises(ModelError, match="more than 0 seconds"):
        Limits(0.0)
    with pytest.raises(ModelError, match="population of 2"):
        refine(GREEN, np.random.default_rng(0), Limits(1.0), population=1)
    with pytest.raises(ModelError, match="two levels"):
        DotTask(STEPS, STEPS, (0.0,))
    with pytest.raises(ModelError, match="too small"):
        DotTask(STEPS, STEPS, (0.0, 0.125), 10.0)
