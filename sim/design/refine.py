"""Refinement of one dot: a genetic search (Levin et al. 2013, Appendix B), a greedy polish, or both.

The genetic search resamples a share of a dot's parameters and selects the best of parents and children. In combination
with the polish, every child is first polished until single changes of levels give little improvement. The genetic
search then proceeds between such dots, and leaves local minima of the polish.

The greedy polish changes the level of one rectangle after the other if that reduces the error. The order follows the
gradient of the error with respect to the power spectrum: one matrix product ranks all changes at once to first order;
each is then evaluated exactly, by an update of rank 1.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
import numpy.typing as npt

from anisoscope.base.errors import ModelError
from anisoscope.base.json_fields import LEFT_OUT
from anisoscope.base.progress import Advance, silent
from anisoscope.sim.design.dot import WIDE, Dot, DotState, DotTask, Levels
from anisoscope.sim.light.wave.sampling import Widths

Floats = npt.NDArray[np.float32]
Integers = npt.NDArray[np.int64]

BATCH = 48


@dataclass(eq=False)
class Bench:
    """Target reflectance of a task and the work space to compare dots with it; one per thread.

    Attributes:
        task: the task.
        target: (windows, windows) expected density in µm².
        scale: what turns sums over a window into a density.
        norm: Σ wanted².
        sizes: (fine, wide, first bin that is computed).
    """

    task: DotTask
    target: Floats = field(init=False)
    scale: float = field(init=False)
    norm: float = field(init=False)
    sizes: tuple[int, int, int] = field(init=False)
    _along_x: Floats = field(init=False)
    _power: Floats = field(init=False)
    _column: Floats = field(init=False)
    rest: Floats = field(init=False)

    def __post_init__(self) -> None:
        task = self.task
        expected = task.expected()
        self.target = np.ascontiguousarray(expected, dtype=np.float32)
        self.norm = float(np.sum(expected**2))
        self.scale = 1.0 / (task.dot_um * WIDE * task.fine) ** 2
        many = task.windows.size
        bins = many - 1 + WIDE
        real = bool(np.abs(task.phases.imag).max() < 1e-6)
        self.sizes = task.fine, WIDE, bins // 2 if real else 0
        self._along_x = np.empty((bins, many), dtype=np.float32)
        self._power = np.empty(bins * task.fine, dtype=np.float32)
        self._column = np.empty(many, dtype=np.float32)
        self.rest = np.empty((many, many), dtype=np.float32)

    def relative(self, squared: float) -> float:
        """‖R_o − R_E‖/‖R_E‖ of a squared error."""
        return float(np.sqrt(squared / self.norm))

    def measure(self, state: DotState) -> float:
        """Squared error of a dot; leaves the differences in ``rest``."""
        from anisoscope.sim.design.flipkernels import squared_error, windows_along_x  # noqa: PLC0415 - numba

        y, x = ((f[0][0], f[1][0]) for f in (state.factors_y, state.factors_x))
        windows_along_x(*state.spectrum, (0.0, 0.0), y, x, self.sizes, self._along_x, self._power)
        return float(squared_error(self._along_x, self.target, WIDE, self.scale, self._column, self.rest))

    def attempt(self, state: DotState, cells: Integers, to: Integers, best: float) -> float:
        """Try changes one after the other, keep those that help; returns the squared error."""
        from anisoscope.sim.design.flipkernels import try_changes  # noqa: PLC0415 - numba

        phases = self.task.phases
        return float(
            try_changes(
                cells, to, state.levels, phases.real.astype(np.float32), phases.imag.astype(np.float32),
                *state.spectrum, state.factors_y, state.factors_x, self.sizes, self.scale, self.target, best,
                self._along_x, self._power, self._column, self.rest,
            )
        )  # fmt: skip

    def ranked(self, state: DotState) -> tuple[Integers, Integers, npt.NDArray[np.float64]]:
        """Changes of all rectangles, the most promising first: cells, levels, and predicted change of the error.

        To first order in the power spectrum; of every rectangle the best of its other levels.
        """
        self.measure(state)
        gradient = 2.0 * self.scale * _spread(_spread(self.rest, 0), 1)
        fine = np.repeat(np.repeat(gradient, self.task.fine, axis=0), self.task.fine, axis=1)
        y, x = (f[0] + 1j * f[1] for f in (state.factors_y, state.factors_x))
        inner = y @ (fine * (state.spectrum[0] - 1j * state.spectrum[1])) @ x.T
        own = np.abs(y) ** 2 @ fine @ (np.abs(x) ** 2).T
        phases = self.task.phases
        best = np.full(state.levels.shape, np.inf)
        to = state.levels.copy()
        for level, phase in enumerate(phases):
            step = phase - phases[state.levels]
            found = 2.0 * (step * inner).real + np.abs(step) ** 2 * own
            better = (found < best) & (state.levels != level)
            best[better], to[better] = found[better], level
        order = np.argsort(best, axis=None, kind="stable")
        return order, to.ravel()[order], best.ravel()[order]


def _spread(rest: Floats, axis: int) -> Floats:
    """Sum of the differences of all windows that a bin belongs to."""
    pad = [(0, 0), (0, 0)]
    pad[axis] = (WIDE, WIDE - 1)
    total = np.cumsum(np.pad(rest, pad), axis=axis, dtype=np.float64)
    low, high = (np.moveaxis(total, axis, 0)[part] for part in (slice(None, -WIDE), slice(WIDE, None)))
    return np.moveaxis(high - low, 0, axis).astype(np.float32)


class Polish:
    """A greedy search, step by step.

    Attributes:
        state: the dot.
        error: its squared error.
        done: no single change helps any more.
    """

    def __init__(self, bench: Bench, dot: Dot) -> None:
        self.bench = bench
        self.state = DotState(bench.task, dot)
        self.error = bench.measure(self.state)
        self.done = False

    def step(self, most: int | None = None) -> bool:
        """Rank, then try changes in batches until one batch helps; False where none of the first ``most`` did."""
        order, to, _ = self.bench.ranked(self.state)
        start = self.error
        for first in range(0, order.size if most is None else min(most, order.size), BATCH):
            part = slice(first, first + BATCH)
            self.error = self.bench.attempt(self.state, order[part], to[part], self.error)
            if self.error < start:
                return True
        self.done = most is None
        return False


Method = Literal["both", "genetic", "polish"]

MUTATED = 0.02
"""Share of the parameters that the genetic search resamples."""

KICKED = 0.01
"""The same where a polish follows."""

TRIED = 6 * BATCH
"""Changes that are tried before a child counts as polished."""


@dataclass(frozen=True)
class Limits:
    """When to stop.

    Attributes:
        seconds: of wall-clock time, or None.
        generations: of the search (of the polish: its steps), or None.
        error: relative error that is good enough, or None.

    Raises:
        ModelError: no limit at all in time or generations, or one that is not positive.
    """

    seconds: float | None = 30.0
    generations: int | None = None
    error: float | None = None

    def __post_init__(self) -> None:
        if self.seconds is None and self.generations is None:
            raise ModelError("a refinement needs an end: give it seconds or generations")
        if (self.seconds is not None and not 0.0 < self.seconds < float("inf")) or (
            self.generations is not None and self.generations < 1
        ):
            raise ModelError(
                "a refinement needs a finite time of more than 0 seconds, and 1 generation or more"
            )
        if self.error is not None and not self.error > 0.0:
            raise ModelError(f"a relative error that is good enough must be above 0, not {self.error:g}")


@dataclass(frozen=True, eq=False)
class Refined:
    """The best dot that was found.

    Attributes:
        dot: the dot.
        error: ‖R_o − R_E‖/‖R_E‖ of it.
        start_error: of the best dot of the first random ones.
        history: (seconds, error) at every improvement.
        generations: that were run.
        stopped: why: "time", "generations", "good enough", "stuck" (polish alone), or "interrupted".
    """

    dot: Dot = field(metadata=LEFT_OUT)
    error: float
    start_error: float
    history: tuple[tuple[float, float], ...]
    generations: int
    stopped: str


@dataclass(eq=False)
class _Search:
    bench: Bench
    limits: Limits
    advance: Advance
    clock: Callable[[], float]
    began: float = field(init=False)
    best: Dot | None = None
    error: float = float("inf")
    start: float = float("inf")
    history: list[tuple[float, float]] = field(default_factory=list)
    generation: int = 0

    def __post_init__(self) -> None:
        self.began = self.clock()

    def seen(self, state: DotState, squared: float) -> None:
        """Remember a dot if it is the best so far."""
        relative = self.bench.relative(squared)
        if relative < self.error:
            self.best, self.error = state.frozen(), relative
            self.history.append((self.clock() - self.began, relative))
        spent = self.clock() - self.began
        whole = self.limits.seconds or 0.0
        self.advance(f"error {self.error:.4f}", int(min(spent, whole) * 1000), int(whole * 1000))

    def over(self) -> str | None:
        """Why to stop now, or None."""
        if self.limits.error is not None and self.error <= self.limits.error:
            return "good enough"
        if self.limits.generations is not None and self.generation >= self.limits.generations:
            return "generations"
        if self.limits.seconds is not None and self.clock() - self.began >= self.limits.seconds:
            return "time"
        return None


def refine(
    task: DotTask,
    rng: np.random.Generator,
    limits: Limits | None = None,
    *,
    method: Method = "both",
    population: int = 6,
    on_progress: Advance = silent,
    clock: Callable[[], float] = time.monotonic,
) -> Refined:
    """Find a dot whose reflectance is close to the expected one.

    An interruption from the keyboard ends the search; the best dot so far is returned.

    Args:
        task: what dots are drawn from, and what they are to reflect.
        rng: source of randomness; with a limit of generations only, the result depends on nothing else.
        limits: when to stop; 30 s by default.
        method: genetic search, polish of one dot, or both.
        population: m, dots that the genetic search keeps; 2 or more.
        on_progress: called along the way.
        clock: seconds that pass.

    Raises:
        ModelError: a population below 2.
    """
    if population < 2:
        raise ModelError(f"a genetic search needs a population of 2 dots or more, not {population}")
    search = _Search(Bench(task), Limits() if limits is None else limits, on_progress, clock)
    run = {"both": _both, "genetic": _genetic, "polish": _polish}[method]
    try:
        stopped = run(search, rng, population)
    except KeyboardInterrupt:
        stopped = "interrupted"
        if search.best is None:
            raise
    assert search.best is not None
    return Refined(search.best, search.error, search.start, tuple(search.history), search.generation, stopped)


def _first(search: _Search, rng: np.random.Generator, population: int) -> list[tuple[float, Dot]]:
    """Random dots, best first."""
    found = []
    for _ in range(population):
        state = DotState(search.bench.task, search.bench.task.draw(rng))
        squared = search.bench.measure(state)
        search.seen(state, squared)
        found.append((squared, state.frozen()))
    search.start = search.error
    return sorted(found, key=lambda one: one[0])


def _genetic(search: _Search, rng: np.random.Generator, population: int) -> str:
    """Appendix B: every dot gets a child by resampling; the best m of 2m stay."""
    survivors = _first(search, rng, population)
    while (why := search.over()) is None:
        children = []
        for _, parent in survivors:
            state = DotState(search.bench.task, mutated(search.bench.task, parent, MUTATED, rng))
            squared = search.bench.measure(state)
            search.seen(state, squared)
            children.append((squared, state.frozen()))
            if search.over() == "time":
                break
        survivors = sorted(survivors + children, key=lambda one: one[0])[:population]
        search.generation += 1
    return why


def _polish(search: _Search, rng: np.random.Generator, population: int) -> str:
    """The best of the first random dots, polished until it is stuck."""
    polish = Polish(search.bench, _first(search, rng, population)[0][1])
    while (why := search.over()) is None:
        if not polish.step():
            return "stuck"
        search.seen(polish.state, polish.error)
        search.generation += 1
    return why


def _both(search: _Search, rng: np.random.Generator, population: int) -> str:
    """Genetic search among polished dots; a child of the best so far first, of the others in turn."""
    first = _first(search, rng, population)
    survivors: list[tuple[float, Dot]] = [_polished(search, first[0][1])]
    while (why := search.over()) is None:
        number = search.generation % 4
        parent = survivors[0 if number else int(rng.integers(len(survivors)))]
        child = mutated(search.bench.task, parent[1], KICKED, rng)
        survivors = sorted([*survivors, _polished(search, child)], key=lambda one: one[0])[:population]
        search.generation += 1
    return why


def _polished(search: _Search, dot: Dot) -> tuple[float, Dot]:
    polish = Polish(search.bench, dot)
    while search.over() is None and polish.step(TRIED):
        search.seen(polish.state, polish.error)
    return polish.error, polish.state.frozen()


def mutated(task: DotTask, dot: Dot, share: float, rng: np.random.Generator) -> Dot:
    """A copy with a share of its parameters resampled: levels of rectangles, or (as often) widths along one axis."""
    levels, x, y = dot.levels.copy(), dot.edges_x_um, dot.edges_y_um
    if rng.random() < 0.5:
        cells = rng.random(levels.shape) < max(share, 1.0 / levels.size)
        levels[cells] = rng.integers(0, len(task.levels_um), int(cells.sum()))
    elif rng.random() < 0.5:
        x, levels = _rewidened(task, task.widths_x, x, levels, share, rng)
    else:
        y, turned = _rewidened(task, task.widths_y, y, levels.T, share, rng)
        levels = np.ascontiguousarray(turned.T)
    return Dot(x, y, levels)


def _rewidened(
    task: DotTask,
    widths: Widths,
    edges_um: np.ndarray,
    levels: Levels,
    share: float,
    rng: np.random.Generator,
) -> tuple[np.ndarray, Levels]:
    """Widths of a share of the columns drawn again; what no longer fits falls off, new columns get random levels."""
    width = np.diff(edges_um)[:-1]  # the last one was cut to fit
    redrawn = rng.random(width.size) < max(share, 1.0 / width.size)
    shares = np.asarray(widths.probabilities) / sum(widths.probabilities)
    width[redrawn] = rng.choice(widths.widths_um, int(redrawn.sum()), p=shares)
    more = rng.choice(widths.widths_um, int(task.dot_um / min(widths.widths_um)) + 1, p=shares)
    edges = np.concatenate([[0.0], np.cumsum(np.concatenate([width, more]))])
    fitted = np.append(edges[edges <= task.dot_um - widths.min_width_um + 1e-9], task.dot_um)
    many = fitted.size - 1
    fresh = rng.integers(0, len(task.levels_um), (levels.shape[0], max(0, many - levels.shape[1])))
    return fitted, np.ascontiguousarray(np.concatenate([levels, fresh], axis=1)[:, :many])
