"""Greedy polish of a dot: one rectangle after the other gets another level, wherever that lowers the error.

Which rectangles to try comes from the gradient of the error with respect to the power spectrum: one matrix product
ranks all changes at once to first order; each is then tried exactly, by an update of rank 1.
"""

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from anisoscope.sim.design.dot import WIDE, Dot, DotState, DotTask

Floats = npt.NDArray[np.float32]
Integers = npt.NDArray[np.int64]

BATCH = 48


@dataclass(eq=False)
class Bench:
    """The wanted reflectance of a task and the work space to compare dots with it; one for every thread.

    Attributes:
        task: the task.
        wanted: (windows, windows) expected density in µm².
        scale: what turns sums over a window into a density.
        norm: Σ wanted².
        sizes: (fine, wide, first bin that is computed).
    """

    task: DotTask
    wanted: Floats = field(init=False)
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
        self.wanted = np.ascontiguousarray(expected, dtype=np.float32)
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
        return float(squared_error(self._along_x, self.wanted, WIDE, self.scale, self._column, self.rest))

    def attempt(self, state: DotState, cells: Integers, to: Integers, best: float) -> float:
        """Try changes one after the other, keep those that help; returns the squared error."""
        from anisoscope.sim.design.flipkernels import try_changes  # noqa: PLC0415 - numba

        phases = self.task.phases
        return float(
            try_changes(
                cells, to, state.levels, phases.real.astype(np.float32), phases.imag.astype(np.float32),
                *state.spectrum, state.factors_y, state.factors_x, self.sizes, self.scale, self.wanted, best,
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
    """A greedy search that can be taken step by step.

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
