"""Reflectance of a tile of level steps that repeats: its diffraction orders, from one spectrum for every level.

The wave of a stepped surface is one number for every level, exp(−ik·2h_z·z). Its Fourier coefficients over the tile are
therefore sums of those of the levels' areas, which depend neither on wavelength nor on direction: they are taken once,
and every further direction, wavelength or depth costs a few multiplications. An order at ω_q with the energy |â_q|²
shines into the directions that source and aperture allow, so that the blurred power spectrum is Σ|â_q|²·W(ω − ω_q).
For tiles that repeat this is exact; of a tile that is a window of something larger, the seams count as steps.

The orders of a tile whose features are a little wider or narrower follow without drawing them anew. Where an edge
moves by δ, the Fourier coefficients of its level's area change by the integral of exp(−2πi·f·x) over δ: smooth, and
next to a parabola as long as 2π·f·δ is small. Corners that touch or part make it another parabola for wider features
than for narrower ones. Of three widths each parabola is known, and a direction costs as little as at the width of the
design.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import ModelError
from anisoscope.profiles.etching import Etched
from anisoscope.sim.light import threads
from anisoscope.sim.light.wave.halfvectors import HalfVector, across_beam, half_vector
from anisoscope.sim.light.wave.windows import Extent, Window

ComplexArray = npt.NDArray[np.complexfloating]
Bands = npt.NDArray[np.complex64]

REACH = 1.25
"""Largest frequency of the stored orders, in cycles per µm: half vectors to 0.3 at 500 nm, mirrors tilted by 18°."""

CHORDS = 64
ROUND = 1.02
"""Ratio of the axes up to which the smaller of two ellipses, seen as the larger is a circle, counts as a circle."""
_ALONE = np.ones(1, dtype=np.complex128)


@dataclass(frozen=True, eq=False)
class Orders:
    """Fourier coefficients of the areas of the levels of a tile.

    Attributes:
        spectra: (K, Y, X) complex64, one for every level; at frequency 0 the share of its area.
        frequency_x: (X,) rising frequencies in cycles per µm, 0 in the middle.
        frequency_y: (Y,) likewise.
    """

    spectra: npt.NDArray[np.complex64]
    frequency_x: FloatArray
    frequency_y: FloatArray

    @classmethod
    def of(cls, tile: Etched, reach: float = REACH, band_cache: dict[str, Bands] | None = None) -> "Orders":
        """From an etched tile, its moved edges drawn exactly.

        Args:
            tile: the tile.
            reach: largest frequency that is kept, in cycles per µm.
            band_cache: spectra of pieces of this tile with this reach; new ones are added, so that other widths
                of it cost little.
        """
        rows, cols = tile.labels.shape
        pixel, levels = tile.pixel_um, len(tile.levels_um)
        half = [min(int(reach * n * pixel), (n - 1) // 2) for n in (rows, cols)]
        fy, fx = (np.arange(-m, m + 1) / (n * pixel) for m, n in zip(half, (rows, cols), strict=True))
        found = np.zeros((levels, fy.size, fx.size), dtype=np.complex64)
        store = {} if band_cache is None else band_cache
        for piece in tile.pieces():
            if piece.key not in store:
                store[piece.key] = _bands(piece.labels, levels, half)
            form = [
                size * np.sinc(size * pixel * f) * np.exp(-2j * np.pi * pixel * at * f)
                for size, at, f in zip(piece.size, piece.middle, (fy, fx), strict=True)
            ]
            found[1:] += store[piece.key] * np.outer(*form).astype(np.complex64)
        found[0] = -found[1:].sum(axis=0)  # all levels together fill the tile: nothing but order 0
        found[0, half[0], half[1]] += 1.0
        return cls(found, np.asarray(fx, dtype=np.float64), np.asarray(fy, dtype=np.float64))

    @property
    def size_um(self) -> tuple[float, float]:
        """(along y, along x) of the tile."""
        return 1.0 / float(self.frequency_y[1] - self.frequency_y[0]), 1.0 / float(
            self.frequency_x[1] - self.frequency_x[0]
        )

    def around(
        self, middle: tuple[float, float], half_width: tuple[float, float], phases: ComplexArray
    ) -> tuple[ComplexArray, FloatArray, FloatArray]:
        """Amplitudes of the orders near a direction.

        Args:
            middle: (x, y) frequency in cycles per µm.
            half_width: how far to go along x and y.
            phases: (K,) wave of every level.

        Returns:
            (Y, X) amplitudes, and their frequencies (X,) and (Y,).

        Raises:
            ModelError: frequencies that were not kept.
        """
        cols, rows = self._window(middle, half_width)
        part = self.spectra[:, rows, cols]
        waves = np.einsum("k,kyx->yx", phases, part)  # no BLAS: its threads cost more than so small a product
        return waves, self.frequency_x[cols], self.frequency_y[rows]

    def _window(self, middle: tuple[float, float], half_width: tuple[float, float]) -> tuple[slice, slice]:
        """Columns and rows of the orders near a direction; arguments and errors as of `around`."""
        cut = []
        for f, at, wide in zip((self.frequency_x, self.frequency_y), middle, half_width, strict=True):
            if abs(at) + wide > -f[0]:
                raise ModelError(
                    f"a direction at {abs(at) + wide:.2g} cycles per µm lies beyond the {-f[0]:.2g} that this tile is "
                    "sampled for: tilt less, or take a longer wavelength"
                )
            cut.append(
                slice(int(np.searchsorted(f, at - wide)), int(np.searchsorted(f, at + wide, side="right")))
            )
        return cut[0], cut[1]

    def density(self, levels_um: FloatArray, half: HalfVector, wavelength_um: float, window: Window) -> float:
        """Blurred mean power spectrum in one direction as `fused.density`, in µm², of (K,) heights."""
        return float(self.densities(levels_um, half, np.array([wavelength_um]), window)[0])

    def densities(
        self, levels_um: FloatArray, half: HalfVector, wavelengths_um: FloatArray, window: Window
    ) -> FloatArray:
        """(L,) densities at (L,) wavelengths."""
        return self.blurred(level_phases(levels_um, wavelengths_um, half.z), half, wavelengths_um, window)

    def blurred(
        self, phases: ComplexArray, half: HalfVector, wavelengths_um: FloatArray, window: Window
    ) -> FloatArray:
        """The same of (L, K) waves of the levels."""
        found = []
        for waves_of, wavelength in zip(phases, wavelengths_um.tolist(), strict=True):
            middle = half.frequency(wavelength)
            waves, fx, fy = self.around(middle, window.half_width(wavelength, half.z), waves_of)
            power = waves.real.astype(np.float64) ** 2 + waves.imag.astype(np.float64) ** 2
            off = fx[None, :] - middle[0], fy[:, None] - middle[1]
            found.append(float(np.sum(power * window_density(window, *off, wavelength))))
        return np.array(found)

    def seen(
        self,
        levels_um: FloatArray,
        to_light: FloatArray,
        to_camera: FloatArray,
        wavelengths_um: FloatArray,
        discs: tuple[float, float],
        powers: ComplexArray = _ALONE,
    ) -> FloatArray:
        """(P, L) `densities` in µm² of many directions at once, where lamp and lens are discs about them.

        Args:
            levels_um: (K,) heights.
            to_light: (P, 3) unit vectors.
            to_camera: (P, 3) unit vectors.
            wavelengths_um: (L,).
            discs: diameters of lamp and lens, in direction cosines.
            powers: (T,) factors, where the spectra are those of T terms one after the other.

        Raises:
            ModelError: light or camera at or below the horizon, frequencies that were not kept, or two points.
        """
        from anisoscope.sim.light.wave.order_kernels import densities_seen  # noqa: PLC0415 - numba when first needed

        light, camera = (np.ascontiguousarray(one, dtype=np.float64) for one in (to_light, to_camera))
        found = np.empty((len(light), wavelengths_um.size))
        densities_seen(
            self._by_order,
            powers.astype(np.complex128),
            levels_um,
            (float(self.frequency_x[0]), 1.0 / self.size_um[1]),
            (float(self.frequency_y[0]), 1.0 / self.size_um[0]),
            wavelengths_um,
            light,
            camera,
            discs,
            ROUND,
            np.empty(len(self.spectra), dtype=np.complex128),
            found,
        )
        for p in np.flatnonzero(np.isnan(found[:, 0])):
            half = half_vector(light[p], camera[p])
            window = Window(
                Extent("disc", discs[0], across_beam(light[p])),
                Extent("disc", discs[1], across_beam(camera[p])),
            )
            phases = level_phases(levels_um, wavelengths_um, half.z)
            found[p] = self.blurred(np.kron(powers, phases), half, wavelengths_um, window)
        return found

    @cached_property
    def _by_order(self) -> npt.NDArray[np.complex64]:
        """(Y, X, K) spectra, those of an order side by side."""
        return np.ascontiguousarray(np.moveaxis(self.spectra, 0, -1))


def _bands(labels: npt.NDArray[np.uint8], levels: int, half: list[int]) -> Bands:
    """(K − 1, Y, X) Fourier coefficients, to ± half, of the areas of all levels but the first; pixels as points."""
    from scipy import fft  # noqa: PLC0415 - slow to import

    found = np.zeros((levels - 1, 2 * half[0] + 1, 2 * half[1] + 1), dtype=np.complex64)
    for number in range(1, levels):
        area = labels == number
        if not area.any():
            continue
        right = fft.rfft2(area.astype(np.float32), workers=threads.count())[:, : half[1] + 1]
        right = right[np.arange(-half[0], half[0] + 1)] / np.float32(labels.size)
        found[number - 1, :, half[1] :] = right
        found[number - 1, :, : half[1]] = right[::-1, :0:-1].conj()  # of a real picture
    return found


def level_phases(
    levels_um: FloatArray, wavelength_um: FloatArray | float, h_z: float
) -> npt.NDArray[np.complex128]:
    """(…, K) wave exp(−ik·2h_z·z) of every level, at (…) wavelengths."""
    turns = np.multiply.outer(2.0 * h_z / np.asarray(wavelength_um), np.asarray(levels_um, dtype=np.float64))
    return np.asarray(np.exp(-2j * np.pi * turns))


def window_density(window: Window, x: FloatArray, y: FloatArray, wavelength_um: float) -> FloatArray:
    """W in µm²: density of the directions that source and aperture spread a line over; its integral is 1.

    The overlap of two ellipses: a closed form where they are alike, as where lamp and lens stand within 11° of each
    other, else by chords of the smaller one. Off by less than 0.4 % of the top, in the sum over orders far less, and
    continuous.

    Args:
        window: two discs, of which one may be a point.
        x: frequencies from the line, in cycles per µm.
        y: likewise; broadcast with ``x``.
        wavelength_um: of the light.

    Raises:
        ModelError: a window that is a point, a rectangle, or has roughness.
    """
    return _Overlap.of(window, wavelength_um).density(x, y)


@dataclass(frozen=True, eq=False)
class _Overlap:
    """The two ellipses of a window among the frequencies, seen so that the larger one is the unit circle.

    Attributes:
        into: matrix, row by row, from frequencies to there.
        small: (2, 2) map from the unit circle to the smaller ellipse there.
        area: of the larger one, in cycles² per µm².
        radius: of the smaller one, or of the circle of its area.
        round: whether the smaller one is a circle, and no point.
    """

    into: tuple[float, float, float, float]
    small: FloatArray
    area: float
    radius: float
    round: bool

    @classmethod
    def of(cls, window: Window, wavelength_um: float) -> Self:
        """Of a window; errors as of `window_density`."""
        extents = sorted((window.source, window.aperture), key=lambda one: one.size)
        if (
            extents[1].size == 0.0
            or window.slope_variance is not None
            or any(e.shape != "disc" for e in extents)
        ):
            raise ModelError(
                "diffraction orders need a lamp or a lens of some size, as discs, and nothing else that blurs"
            )
        small, large = (_ellipse(extent, wavelength_um) for extent in extents)
        (xx, xy), (yx, yy) = large.tolist()
        turned = xx * yy - xy * yx
        into = yy / turned, -xy / turned, -yx / turned, xx / turned
        inside = np.array(into).reshape(2, 2) @ small
        (xx, xy), (yx, yy) = inside.tolist()
        # half the sum and half the difference of the singular values
        mean, half = (0.5 * math.hypot(xx + sign * yy, yx - sign * xy) for sign in (1.0, -1.0))
        long, short = mean + half, abs(mean - half)
        alike = extents[0].size > 0.0 and long <= ROUND * short
        return cls(into, inside, math.pi * abs(turned), math.sqrt(long * short), alike)

    def density(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """`window_density`."""
        e = [self.into[k] * x + self.into[k + 1] * y for k in (0, 2)]
        if self.round:
            return _lens(np.hypot(*e), self.radius) / self.area
        if self.radius == 0.0:
            return np.asarray((e[0] ** 2 + e[1] ** 2 <= 1.0) / self.area)
        return _chords(e, self.small) / self.area


def _lens(apart: FloatArray, radius: float) -> FloatArray:
    """Share of a circle inside the unit circle, at a distance of their centres."""
    from anisoscope.sim.light.wave.order_kernels import shares_inside  # noqa: PLC0415 - numba when first needed

    found = np.empty(np.shape(apart))
    shares_inside(np.ascontiguousarray(apart).ravel(), radius, found.reshape(-1))
    return found


def _chords(e: list[FloatArray], b: FloatArray) -> FloatArray:
    """Share of an ellipse, that the matrix b makes of the unit disc, within the unit disc about e."""
    turn = ((np.arange(CHORDS) + 0.5) * np.pi / CHORDS).reshape(-1, *(1,) * max(np.ndim(one) for one in e))
    reach, square = np.sin(turn), float(b[:, 1] @ b[:, 1])
    gx, gy = (e[k] - b[k, 0] * np.cos(turn) for k in (0, 1))
    middle = (gx * b[0, 1] + gy * b[1, 1]) / square
    half = np.sqrt(np.maximum(middle**2 - (gx**2 + gy**2 - 1.0) / square, 0.0))
    chord = np.minimum(middle + half, reach) - np.maximum(middle - half, -reach)
    return np.asarray(np.sum(np.maximum(chord, 0.0) * reach, axis=0) / CHORDS)


def _ellipse(extent: Extent, wavelength_um: float) -> FloatArray:
    """(2, 2) map from the unit disc to the frequencies that an extent covers."""
    axes = np.eye(2) if extent.axes is None else extent.axes
    return np.asarray(0.5 * extent.size / wavelength_um * axes.T)


@dataclass(frozen=True, eq=False)
class WidthOrders:
    """Orders of a tile at any width near the one it was designed with.

    Attributes:
        narrower: orders with (3K, Y, X) spectra: those of the design, and their change with the first and the second
            power of the share, for shares below 0.
        wider: likewise for shares above 0.
        share: of the step between widths that were drawn: the width that is set.
        edges: complex widening, in such steps, by which the waves of edges differ from scalar ones; to first order.
    """

    narrower: Orders
    wider: Orders
    share: float = 0.0
    edges: complex = 0.0

    @classmethod
    def of(cls, at: Callable[[float], Orders]) -> Self:
        """From the orders at the shares −1, −½, 0, ½ and 1, of one tile with one reach."""
        middle = at(0.0)
        below, above = (_parabola(middle, at(0.5 * side), at(side), side) for side in (-1.0, 1.0))
        return cls(below, above)

    def at(self, share: float, edges: complex = 0.0) -> Self:
        """At another width, and with waves of the edges."""
        return replace(self, share=share, edges=edges)

    def densities(
        self, levels_um: FloatArray, half: HalfVector, wavelengths_um: FloatArray, window: Window
    ) -> FloatArray:
        """As `Orders.densities`, of the width that is set."""
        waves = np.kron(self._powers, level_phases(levels_um, wavelengths_um, half.z))
        return self._terms.blurred(waves, half, wavelengths_um, window)

    def seen(
        self,
        levels_um: FloatArray,
        to_light: FloatArray,
        to_camera: FloatArray,
        wavelengths_um: FloatArray,
        discs: tuple[float, float],
    ) -> FloatArray:
        """As `Orders.seen`, of the width that is set."""
        return self._terms.seen(levels_um, to_light, to_camera, wavelengths_um, discs, self._powers)

    @property
    def _powers(self) -> ComplexArray:
        return np.array([1.0, self.share + self.edges, self.share**2], dtype=np.complex128)

    @property
    def _terms(self) -> Orders:
        return self.narrower if self.share < 0.0 else self.wider


def _parabola(middle: Orders, near: Orders, far: Orders, side: float) -> Orders:
    """Terms in powers of the share, through the shares 0, half of ``side`` and ``side``."""
    half, whole = near.spectra - middle.spectra, far.spectra - middle.spectra
    first, second = (4.0 * half - whole) * side, 2.0 * whole - 4.0 * half
    terms = np.concatenate([middle.spectra, first, second]).astype(np.complex64)
    return replace(middle, spectra=terms)
