"""Height maps whose angular reflectance is a picture, grey or in colour, found by gradients.

The reflected wave of a periodic unit of N × N cells is a Fourier transform of its phases, and the gradient of any error
of the picture with respect to all heights is one inverse transform for each wavelength. The search starts from random
steps and follows the gradient (Adam, Kingma and Ba 2015); heights are rounded to the etched levels in every step, and
the gradient is passed through the rounding. Wavelengths are drawn anew in every step, one of every part of the
spectrum that adds alike to the colours, so that the picture holds for the whole spectrum. The error of a picture
in colour follows ΔE2000: differences of lightness, chroma and hue in CIELAB over the S_L, S_C, S_H of the wanted
colour, large ones counting by their size instead of their square; a second term follows SSIM: squares over the local
contrast of the wanted picture. Half vectors with h_z = 1: light and camera near the normal.

What limits a picture is the count of unknowns. Every order within it that must be dark costs two numbers at every
wavelength that the depths tell apart, and a cell gives one: pictures of few orders for many cells come out best.
"""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import ModelError
from anisoscope.base.json_fields import LEFT_OUT
from anisoscope.base.progress import Advance, silent
from anisoscope.sim.light import threads
from anisoscope.sim.light.colour.illuminant import Illuminant
from anisoscope.sim.light.colour.observer import xyz_weights
from anisoscope.sim.light.colour.spaces import SRGB_TO_XYZ, SRGB_WHITE, XYZ_TO_SRGB, ciede2000, encode, lab
from anisoscope.sim.light.wave.correlation import angular_map
from anisoscope.sim.light.wave.surface import WaveSurface
from anisoscope.sim.light.wave.windows import Extent, Window

Floats = npt.NDArray[np.float32]
Labels = npt.NDArray[np.uint16]

FLOOR = 0.003
"""Linear light added before the square root that the error is measured in."""
DISPLAY = 1.0 / 2.2
DARKEST = 1e-3
"""Power of light that a display shows, and linear light added before it in a search."""

BETAS = (0.9, 0.99)
LARGE = 5.0
"""ΔE from which on differences count by their size."""

BAND_NM = (400.0, 700.0)
POINTS_A_BLUR = 1.25
"""Points of a blurred surface in the standard deviation of the blur."""


@dataclass(frozen=True, eq=False)
class PictureTask:
    """A wanted picture and what can be etched.

    Attributes:
        wanted: (M, M, 3) linear sRGB or (M, M, 1) grey over h from −reach to reach, rows along rising h_y.
        levels_um: heights of the etched levels.
        illuminant: of a picture in colour; None for one wavelength.
        wavelength_um: of a grey picture.
        cells: N, cells of the unit along each axis.
        cell_um: side of a cell, the smallest feature.
        coherence_um: Δc of the source at the wavelength of the design (in colour 550 nm).
        reach: largest |h|.
        bands: wavelengths in a step of a picture in colour.
        blur_um: standard deviation by which the process blurs the heights of the cells; 0 are sharp steps.
        displayed: of a picture in colour least squares of what a display shows count, in place of ΔE2000 and SSIM.

    Raises:
        ModelError: a picture that is none, or directions beyond what the cells diffract to.
    """

    wanted: FloatArray
    levels_um: tuple[float, ...]
    illuminant: Illuminant | None = None
    wavelength_um: float = 0.55
    cells: int = 512
    cell_um: float = 0.5
    coherence_um: float = 64.0
    reach: float = 0.12
    bands: int = 10
    blur_um: float = 0.0
    displayed: bool = False

    def __post_init__(self) -> None:
        shape = self.wanted.shape
        if len(shape) != 3 or shape[0] != shape[1] or shape[2] != (1 if self.illuminant is None else 3):
            raise ModelError(f"a picture to design is a square, grey or with a light in colour, not {shape}")
        if not np.isfinite(self.wanted).all() or self.wanted.min() < 0.0 or self.wanted.max() <= 0.0:
            raise ModelError("a picture to design has no negative light, and some above 0")
        shortest = self.wavelength_um if self.illuminant is None else 1e-3 * BAND_NM[0]
        widest = shortest / (4.0 * self.cell_um / self.points)
        if not 0.0 < self.reach <= widest:
            raise ModelError(
                f"cells of {self.cell_um:g} µm diffract {1e3 * shortest:g} nm to |h| = {widest:.3f}, not to "
                f"{self.reach:g}: take a smaller --reach, or smaller cells (--min-width)"
            )
        unit = self.cells * self.cell_um
        if len(self.levels_um) < 2 or not 0.0 < self.coherence_um <= unit:
            raise ModelError(
                f"a unit of {unit:g} µm must hold the coherence length of {self.coherence_um:g} µm along each axis, "
                "and steps need two levels"
            )

    @property
    def points(self) -> int:
        """Points of the surface along a cell."""
        return 1 if self.blur_um <= 0.0 else int(np.ceil(POINTS_A_BLUR * self.cell_um / self.blur_um))

    @cached_property
    def spread(self) -> Floats:
        """(N·points, N) heights along a line of the blurred, endless surface by those of its cells."""
        size, places = self.cells * self.points, np.arange(self.cells * self.points)
        kernel = np.exp(-0.5 * ((places - size // 2) * self.cell_um / self.points / self.blur_um) ** 2)
        steps = np.kron(np.eye(self.cells), np.ones((self.points, 1)))
        blur = np.fft.rfft(np.roll(kernel / kernel.sum(), -(size // 2)))
        return np.asarray(
            np.fft.irfft(np.fft.rfft(steps, axis=0) * blur[:, None], size, axis=0), dtype=np.float32
        )

    def surface(self, height_um: FloatArray | Floats) -> FloatArray | Floats:
        """(N·points, N·points) heights of the surface by the (N, N) of its cells."""
        return height_um if self.points == 1 else self.spread @ height_um @ self.spread.T

    @property
    def h(self) -> FloatArray:
        """(M,) half vectors of the picture."""
        return np.linspace(-self.reach, self.reach, self.wanted.shape[0])

    def source(self, wavelength_um: float) -> float:
        """Coherence length at a wavelength: the same source throughout."""
        design = self.wavelength_um if self.illuminant is None else 0.55
        return self.coherence_um * wavelength_um / design


@dataclass(frozen=True, eq=False)
class DesignedPicture:
    """The best unit that was found.

    Attributes:
        task: what was asked for.
        labels: (N, N) number of the level of every cell, rows along rising y.
        error: rms of the last step: ΔE near ΔE2000; in grey of the difference of the square roots of light.
        history: error at the last step of each tenth of the search.
    """

    task: PictureTask
    labels: Labels = field(repr=False)
    error: float
    history: tuple[float, ...]

    @property
    def height_um(self) -> FloatArray:
        """(N, N) heights in µm."""
        return np.asarray(self.task.levels_um, dtype=np.float64)[self.labels]


Waves = npt.NDArray[np.complex64]


class _Line:
    """One wavelength of a picture: from the wave to light over the half vectors, and the gradient back to heights."""

    def __init__(self, task: PictureTask, wavelength_um: float) -> None:
        self.cells = task.cells * task.points
        self.turns = 4.0 * np.pi / wavelength_um
        unit = task.cells * task.cell_um
        order = np.fft.fftfreq(self.cells, 1.0 / self.cells)
        # a rect of `box` orders, linear between orders: sampled as the difference of two running sums
        box = max(1.0, unit / task.source(wavelength_um))
        off = np.abs(order[None, :] - (2.0 * task.h / wavelength_um * unit)[:, None])
        inside = np.clip(0.5 * box + 0.5 - off, 0.0, 1.0) / box
        self.orders = np.flatnonzero(inside.any(axis=0))
        cell = np.sinc(order / self.cells) ** 2 if task.points == 1 else np.ones_like(order)
        self.matrix = np.asarray((inside * cell)[:, self.orders], dtype=np.float32)

    def wave(self, height_um: FloatArray | Floats) -> Waves:
        """Reflected wave of heights of any shape."""
        return np.asarray(np.exp(-1j * self.turns * height_um), dtype=np.complex64)

    def light(self, wave: Waves) -> tuple[Floats, Waves]:
        """(M, M) light over the half vectors of an (N, N) wave, and the orders within the picture."""
        from scipy import fft  # noqa: PLC0415 - slow to import

        rows = fft.fft(wave, axis=1, workers=threads.count())[:, self.orders]
        spectrum = fft.fft(rows, axis=0, workers=threads.count())[self.orders] / np.float32(wave.size)
        power = spectrum.real**2 + spectrum.imag**2
        return np.asarray(self.matrix @ power @ self.matrix.T), spectrum

    def gradient(self, by_light: Floats, wave: Waves, spectrum: Waves) -> Floats:
        """(N, N) derivative by the heights, of the derivative by the light."""
        from scipy import fft  # noqa: PLC0415 - slow to import

        some = np.zeros((self.cells, self.orders.size), dtype=np.complex64)
        some[self.orders] = (self.matrix.T @ by_light @ self.matrix) * spectrum
        back = np.zeros((self.cells, self.cells), dtype=np.complex64)
        back[:, self.orders] = fft.ifft(some, axis=0, workers=threads.count())
        back = fft.ifft(back, axis=1, workers=threads.count(), overwrite_x=True)
        return np.asarray(
            2.0 * self.turns * (back.real * wave.imag - back.imag * wave.real), dtype=np.float32
        )


def _lines(
    task: PictureTask, rng: np.random.Generator, fixed: dict[float, _Line]
) -> tuple[list[_Line], FloatArray]:
    """Wavelengths of a step and their (B, channels) weights: XYZ of the mean light, or 1."""
    if task.illuminant is None:
        if not fixed:
            fixed[task.wavelength_um] = _Line(task, task.wavelength_um)
        return list(fixed.values()), np.ones((1, 1))
    found, weights = [], []
    table = _weights(task.illuminant)
    each = table.sum(axis=1)
    # parts of the spectrum that add alike to the colours; whole steps of 5 nm, so that a line is made once
    up_to = np.cumsum(each) / each.sum()
    places = (np.arange(task.bands) + rng.random(task.bands)) / task.bands
    for number in np.minimum(np.searchsorted(up_to, places), each.size - 1):
        one = float(TABLE_NM[number])
        if one not in fixed:
            fixed[one] = _Line(task, 1e-3 * one)
        found.append(fixed[one])
        weights.append(table[number] * (each.sum() / task.bands / each[number]))
    return found, np.stack(weights)


TABLE_NM = np.arange(BAND_NM[0], BAND_NM[1] + 1.0, 5.0)


def _weights(illuminant: Illuminant) -> FloatArray:
    """(61, 3) XYZ of the mean power of orders in steps of 5 nm, with the γ² = 1/λ² of a surface."""
    return np.asarray(xyz_weights(illuminant, TABLE_NM) * (550.0 / TABLE_NM[:, None]) ** 2)


SIMILAR = 50.0
"""Weight of the term that follows SSIM, over that of half of ΔE²."""

LIKENESS = np.array([1.0, 0.25, 0.25]) * 1e-4
"""Squares of differences of L*, a*, b* as squares of encoded sRGB, about."""


class _Wanted:
    """A wanted picture: how far light is from it, and the derivative of that error."""

    def __init__(self, task: PictureTask) -> None:
        relative = task.wanted / task.wanted.max()
        self.colour = task.illuminant is not None
        self.light = relative @ SRGB_TO_XYZ.T if self.colour else relative
        if not self.colour:
            self.root = np.sqrt(relative + FLOOR)
            return
        self.shown = relative**DISPLAY if task.displayed else None
        from scipy.ndimage import gaussian_filter  # noqa: PLC0415 - slow to import

        shown, window = encode(relative).srgb, (1.5, 1.5, 0.0)
        contrast = (gaussian_filter(shown**2, window) - gaussian_filter(shown, window) ** 2).mean(axis=-1)
        # 1 − SSIM of small differences e with the contrast σ²: e²/(2·σ² + 0.03²)
        self.calm = gaussian_filter(1.0 / (2.0 * np.maximum(contrast, 0.0) + 9e-4), 1.5)
        self.lab = lab(self.light, SRGB_WHITE)
        chroma = np.hypot(self.lab[..., 1], self.lab[..., 2])
        # rows that turn a difference of L*, a*, b* into lightness, chroma and hue over their weights in ΔE2000
        middle = (self.lab[..., 0] - 50.0) ** 2
        to = np.stack([self.lab[..., 1], self.lab[..., 2]], axis=-1) / np.maximum(chroma, 1e-6)[..., None]
        self.turn = np.zeros((*chroma.shape, 3, 3))
        self.turn[..., 0, 0] = 1.0 / (1.0 + 0.015 * middle / np.sqrt(20.0 + middle))
        self.turn[..., 1, 1:] = to / (1.0 + 0.045 * chroma)[..., None]
        self.turn[..., 2, 1:] = (
            np.stack([-to[..., 1], to[..., 0]], axis=-1) / (1.0 + 0.015 * chroma)[..., None]
        )

    def scale(self, light: FloatArray) -> float:
        """Factor on the light that brings it closest to the wanted one."""
        if self.colour and self.shown is not None:
            shown = np.maximum(light @ XYZ_TO_SRGB.T, 0.0) ** DISPLAY
            best = float(np.sum(shown * self.shown)) / max(float(np.sum(shown**2)), 1e-30)
            return float(best ** (1.0 / DISPLAY))
        return float(np.sum(light * self.light) / max(float(np.sum(light * light)), 1e-30))

    def error(self, light: FloatArray, scale: float) -> tuple[float, FloatArray]:
        """Rms error of (M, M, C) light times a factor, and the (M, M, C) derivative of what is minimised."""
        count = light.shape[0] * light.shape[1]
        if not self.colour:
            shown = np.sqrt(scale * light + FLOOR)
            rest = shown - self.root
            return float(np.sqrt(np.mean(rest**2))), rest * scale / shown / count
        if self.shown is not None:
            linear_light = scale * (light @ XYZ_TO_SRGB.T)
            power = np.maximum(linear_light, 0.0) + DARKEST
            off = power**DISPLAY - self.shown
            slope = off * DISPLAY * power ** (DISPLAY - 1.0) * (linear_light > 0.0)
            return float(np.sqrt(np.mean(off**2))), slope @ XYZ_TO_SRGB * scale / count
        t = np.maximum(scale * light / SRGB_WHITE, 1e-9)
        linear = t < (6.0 / 29.0) ** 3
        f = np.where(linear, t * (841.0 / 108.0) + 4.0 / 29.0, np.cbrt(t))
        by_t = np.where(linear, 841.0 / 108.0, np.cbrt(t) / (3.0 * t))
        found = np.stack(
            [116.0 * f[..., 1] - 16.0, 500.0 * (f[..., 0] - f[..., 1]), 200.0 * (f[..., 1] - f[..., 2])],
            axis=-1,
        )
        off = found - self.lab
        parts = np.einsum("ijkl,ijl->ijk", self.turn, off)
        square = np.sum(parts**2, axis=-1)
        parts /= np.sqrt(1.0 + square / LARGE**2)[..., None]
        back = np.einsum("ijkl,ijk->ijl", self.turn, parts) + SIMILAR * self.calm[..., None] * off * LIKENESS
        by_f = np.stack(
            [500.0 * back[..., 1], 116.0 * back[..., 0] - 500.0 * back[..., 1] + 200.0 * back[..., 2],
             -200.0 * back[..., 2]], axis=-1,
        )  # fmt: skip
        return float(np.sqrt(np.mean(square))), by_f * by_t * scale / SRGB_WHITE / count


def design_picture(
    task: PictureTask,
    rng: np.random.Generator,
    steps: int = 1000,
    *,
    rate: float | None = None,
    advance: Advance = silent,
) -> DesignedPicture:
    """Find a unit whose angular reflectance comes close to a picture.

    Args:
        task: the picture.
        rng: of the start and the wavelengths.
        steps: of the search.
        rate: of a step, as a share of the range of heights; larger for few steps if it is not given.
        advance: receives the progress.

    Raises:
        ModelError: fewer than 10 steps.
    """
    if steps < 10:
        raise ModelError(f"a picture takes 10 steps or more, not {steps}")
    rate = max(0.005, 1.5 / steps) if rate is None else rate
    levels = np.sort(np.asarray(task.levels_um, dtype=np.float32))
    span = float(levels[-1] - levels[0])
    height = rng.uniform(levels[0], levels[-1], (task.cells, task.cells)).astype(np.float32)
    mean, square = np.zeros_like(height), np.zeros_like(height)
    wanted = _Wanted(task)
    fixed: dict[float, _Line] = {}
    scale, history, error = 0.0, [], float("nan")
    middles = 0.5 * (levels[1:] + levels[:-1])
    for step in range(steps):
        label = np.searchsorted(middles, height)
        lines, weights = _lines(task, rng, fixed)
        if task.points == 1:
            waves = [line.wave(levels)[label] for line in lines]
        else:
            surface = task.surface(levels[label])
            waves = [line.wave(surface) for line in lines]
        done = [line.light(wave) for line, wave in zip(lines, waves, strict=True)]
        light = np.einsum("bij,bc->ijc", np.stack([one[0] for one in done]), weights)
        best = wanted.scale(light)
        scale = best if scale == 0.0 else 0.9 * scale + 0.1 * best
        error, by_light = wanted.error(light, scale)
        total = np.zeros(waves[0].shape, dtype=np.float32)
        for line, wave, one, weight in zip(lines, waves, done, weights, strict=True):
            total += line.gradient((by_light @ weight).astype(np.float32), wave, one[1])
        if task.points > 1:
            total = np.asarray(task.spread.T @ total @ task.spread, dtype=np.float32)
        mean = BETAS[0] * mean + (1.0 - BETAS[0]) * total
        square = BETAS[1] * square + (1.0 - BETAS[1]) * total**2
        m = mean / (1.0 - BETAS[0] ** (step + 1))
        s = np.sqrt(square / (1.0 - BETAS[1] ** (step + 1)))
        cooled = rate * span * 0.5 * (1.0 + np.cos(np.pi * step / steps))
        height -= (cooled * m / (s + 1e-20)).astype(np.float32)
        np.clip(height, levels[0], levels[-1], out=height)
        advance(f"error {error:.4f}", step + 1, steps)
        if (step + 1) % max(1, steps // 10) == 0:
            history.append(error)
    label = np.searchsorted(middles, height)
    order = np.argsort(np.asarray(task.levels_um))
    return DesignedPicture(task, order[label].astype(np.uint16), error, tuple(history))


@dataclass(frozen=True, eq=False)
class Judged:
    """A unit, tiled endlessly, against its picture: by the correlation of 2 × 2 units, each height a whole cell.

    Attributes:
        ssim: structural similarity of encoded sRGB at the scale that fits best (Gaussian window, σ 1.5 points).
        median_de2000: median ΔE2000 over the picture; None in grey.
        light_share: share of all light that goes into the picture, mean over the wavelengths.
        srgb: (M, M, 1 or 3) encoded picture, rows along rising h_y.
    """

    ssim: float
    median_de2000: float | None
    light_share: float
    srgb: FloatArray = field(metadata=LEFT_OUT)


def judged(found: DesignedPicture, depth_factor: float = 1.0) -> Judged:
    """Compare a unit with its picture, in colour at 61 wavelengths.

    Args:
        found: the unit.
        depth_factor: all depths times this: over-etching above 1.
    """
    from skimage.metrics import structural_similarity  # noqa: PLC0415 - slow to import

    task = found.task
    heights = np.tile(np.asarray(task.surface(depth_factor * found.height_um), dtype=np.float64), (2, 2))
    surface = WaveSurface.of(heights, task.cell_um / task.points, cells=task.points == 1)
    lamp = task.illuminant
    nm = np.array([1e3 * task.wavelength_um]) if lamp is None else TABLE_NM
    weights = np.ones((1, 1)) if lamp is None else xyz_weights(lamp, nm) @ XYZ_TO_SRGB.T
    y, x = np.meshgrid(task.h, task.h, indexing="ij")
    light, share = np.zeros(task.wanted.shape), 0.0
    step = float(task.h[1] - task.h[0])
    for one, weight in zip(nm, weights, strict=True):
        um = 1e-3 * float(one)
        window = Window(Extent("rect", um / task.source(um)))
        density = np.maximum(angular_map(surface, um, window, padding=1.0).at(x, y), 0.0)
        share += float(density.sum()) * (2.0 * step / um) ** 2 / nm.size
        # γ² of a surface is 1/λ²
        light += density[..., None] / um**2 * weight
    wanted = task.wanted / task.wanted.max()
    light *= float(np.sum(light * wanted) / max(float(np.sum(light * light)), 1e-30))
    shown, aim = encode(light).srgb, encode(wanted).srgb
    similar = structural_similarity(  # type: ignore[no-untyped-call]
        shown,
        aim,
        channel_axis=-1,
        data_range=1.0,
        gaussian_weights=True,
        sigma=1.5,
        use_sample_covariance=False,
    )
    median = None
    if lamp is not None:
        pair = [lab(one @ SRGB_TO_XYZ.T, SRGB_WHITE) for one in (np.clip(light, 0.0, None), wanted)]
        median = float(np.median(ciede2000(*pair)))
    return Judged(float(similar), median, share, shown)
