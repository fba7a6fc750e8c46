"""One dot of a design as the polish sees it: its spectrum on a grid, and how far that is from the expected one."""

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import ModelError
from anisoscope.sim.light.wave.claims import blurred_sinc2, lobe, mean_phase, with_spike
from anisoscope.sim.light.wave.sampling import Widths

Floats = npt.NDArray[np.float32]
ComplexArray = npt.NDArray[np.complex64]
Levels = npt.NDArray[np.int64]

WIDE = 8
"""Bins that the window of the source covers; the reflectance is compared at every one of them."""

MOST_SAMPLES = 8192
"""Frequencies of the spectrum along each axis, at most: 1 GB."""


@dataclass(frozen=True, eq=False)
class Dot:
    """A dot of rectangles.

    Attributes:
        edges_x_um: (cols + 1,) edges of the columns from 0 to the size of the dot.
        edges_y_um: (rows + 1,) edges of the rows.
        levels: (rows, cols) number of the level of every rectangle.
    """

    edges_x_um: FloatArray
    edges_y_um: FloatArray
    levels: Levels


@dataclass(frozen=True)
class DotTask:
    """Drawing task of dots: their source, and the reflectance that they are to have.

    Attributes:
        widths_x: distribution of widths along x.
        widths_y: distribution of widths along y.
        levels_um: heights, equally likely.
        dot_um: Δd, side of the dot.
        coherence_um: Δc.
        wavelength_um: of the light.
        reach: largest |h_x| and |h_y| that counts.

    Raises:
        ModelError: fewer than two levels, a dot below the coherence length or two steps, or one too large to refine.
    """

    widths_x: Widths
    widths_y: Widths
    levels_um: tuple[float, ...]
    dot_um: float = 112.0
    coherence_um: float = 16.0
    wavelength_um: float = 0.5
    reach: float = 0.2

    def __post_init__(self) -> None:
        if len(self.levels_um) < 2:
            raise ModelError("steps need two levels or more: give the depths of one etch pass at least")
        widest = max(*self.widths_x.widths_um, *self.widths_y.widths_um)
        if self.dot_um < max(self.coherence_um, 2.0 * widest):
            raise ModelError(
                f"a dot of {self.dot_um:g} µm is too small for a coherence length of {self.coherence_um:g} µm and "
                f"steps of up to {widest:g} µm: take a dot of {max(self.coherence_um, 2.0 * widest):g} µm or more"
            )

        if not self.dot_um < MOST_SAMPLES * self.coherence_um or self.samples > MOST_SAMPLES:
            raise ModelError(
                f"a dot of {self.dot_um:g} µm under a coherence length of {self.coherence_um:g} µm needs more than "
                f"{MOST_SAMPLES} frequencies along each axis: take a smaller dot, or a shorter coherence length"
            )

    @property
    def samples(self) -> int:
        """Frequencies of the spectrum along each axis."""
        count = int(np.floor(2.0 * self.reach / self.wavelength_um * WIDE * self.coherence_um))
        return (2 * count + WIDE) * self.fine

    @property
    def fine(self) -> int:
        """Frequencies in a bin: enough that the power of the dot, of twice its extent, is sampled."""
        return int(np.ceil(2.0 * self.dot_um / self.coherence_um / WIDE))

    @property
    def windows(self) -> FloatArray:
        """(windows,) frequencies at which the reflectance is compared, in cycles per µm, symmetric about 0."""
        step = 1.0 / (WIDE * self.coherence_um)
        count = int(np.floor(2.0 * self.reach / self.wavelength_um / step))
        return np.asarray(np.arange(-count, count + 1) * step, dtype=np.float64)

    @property
    def frequencies(self) -> FloatArray:
        """(bins·fine,) frequencies of the spectrum."""
        many = self.samples // self.fine
        step = 1.0 / (WIDE * self.coherence_um)
        return ((np.arange(many * self.fine) + 0.5) / self.fine - 0.5 * many) * step

    @property
    def phases(self) -> npt.NDArray[np.complex128]:
        """(levels,) of the wave, turned so that they are real where two levels are a quarter wave apart."""
        turns = 2.0 / self.wavelength_um * (np.asarray(self.levels_um) - self.levels_um[0])
        return np.asarray(np.exp(-2j * np.pi * turns))

    def expected(self) -> FloatArray:
        """(windows, windows) density in µm² that sampling process 1 gives on average; corrected claim 1 in 2-D."""
        f = self.windows
        lobes = [
            lobe(f, np.array(w.widths_um), np.array(w.probabilities), self.coherence_um)
            for w in (self.widths_y, self.widths_x)
        ]
        line = blurred_sinc2(f, self.dot_um, self.coherence_um)
        tau = mean_phase(self.levels_um, self.wavelength_um)
        return with_spike(tau, np.outer(*lobes), np.outer(line, line))

    def factors(self, edges_um: FloatArray) -> ComplexArray:
        """(steps, frequencies) spectrum of every step along one axis."""
        width, middle = np.diff(edges_um), 0.5 * (edges_um[1:] + edges_um[:-1])
        f = self.frequencies
        found = width[:, None] * np.sinc(np.outer(width, f)) * np.exp(-2j * np.pi * np.outer(middle, f))
        return np.asarray(found, dtype=np.complex64)

    def draw(self, rng: np.random.Generator) -> Dot:
        """A dot of sampling process 1; its last steps are cut or merged so that none is below the least width."""
        x, y = (self.draw_edges(widths, rng) for widths in (self.widths_x, self.widths_y))
        return Dot(x, y, rng.integers(0, len(self.levels_um), (y.size - 1, x.size - 1)))

    def draw_edges(self, widths: Widths, rng: np.random.Generator) -> FloatArray:
        """Edges from 0 to the size of the dot."""
        shares = np.asarray(widths.probabilities) / sum(widths.probabilities)
        edges = np.concatenate(
            [
                [0.0],
                np.cumsum(
                    rng.choice(widths.widths_um, int(self.dot_um / min(widths.widths_um)) + 1, p=shares)
                ),
            ]
        )
        inside = edges[edges <= self.dot_um - widths.min_width_um + 1e-9]
        return np.append(inside, self.dot_um)


@dataclass(eq=False)
class DotState:
    """A dot with its spectrum, which changes of levels keep up to date.

    Attributes:
        task: what it belongs to.
        dot: edges; its levels are those of the start.
        levels: (rows, cols) levels now.
        spectrum: real and imaginary part, (frequencies, frequencies) float32.
        factors_x: real and imaginary part, (cols, frequencies).
        factors_y: the same along y.
    """

    task: DotTask
    dot: Dot
    levels: Levels = field(init=False)
    spectrum: tuple[Floats, Floats] = field(init=False)
    factors_x: tuple[Floats, Floats] = field(init=False)
    factors_y: tuple[Floats, Floats] = field(init=False)

    def __post_init__(self) -> None:
        x, y = self.task.factors(self.dot.edges_x_um), self.task.factors(self.dot.edges_y_um)
        self.levels = np.array(self.dot.levels, dtype=np.int64)
        waves = self.task.phases.astype(np.complex64)[self.levels]
        self.spectrum = _parts(y.T @ waves @ x)
        self.factors_x, self.factors_y = _parts(x), _parts(y)

    def frozen(self) -> Dot:
        """The dot as it is now."""
        return Dot(self.dot.edges_x_um, self.dot.edges_y_um, self.levels.copy())


def _parts(values: npt.NDArray[np.complexfloating]) -> tuple[Floats, Floats]:
    return (
        np.ascontiguousarray(values.real, dtype=np.float32),
        np.ascontiguousarray(values.imag, dtype=np.float32),
    )
