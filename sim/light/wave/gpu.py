"""Array library of the wave models: NumPy and SciPy on the cores, or CuPy on a graphics card (extra ``[gpu]``).

The card is used where the environment variable ANISOSCOPE_GPU is 1; its numbers are those of the cores within 1e-5 of
the brightest direction. Heights are copied to it once per surface, and single precision is used as on the cores.
"""

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from importlib import import_module
from typing import Any, TypeVar, cast
from weakref import WeakKeyDictionary

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import UsageError
from anisoscope.sim.light import threads
from anisoscope.sim.light.wave.surface import Heights, WaveSurface

Scalar = TypeVar("Scalar", bound=np.generic)
ComplexArray = npt.NDArray[np.complex64]

VARIABLE = "ANISOSCOPE_GPU"


@dataclass(frozen=True, eq=False)
class Filter:
    """Low-pass and decimation along one axis; output o is at point (o − half // step)·step.

    Attributes:
        taps: (2·half + 1,) float32 filter, on the card.
        step: points between outputs.
        outputs: their number.
    """

    taps: Heights
    step: int
    outputs: int

    @property
    def arguments(self) -> tuple[Any, ...]:
        """As the kernels take them."""
        return self.taps, np.int32(self.taps.size // 2), np.int32(self.step), np.int32(self.outputs)


KERNELS = r"""
extern "C" __global__ void along_y(
    const float* height_um, int rows, int cols, float cycles_per_um, double turns_x, double turns_y,
    const float* taps, int half, int step, int outputs, float2* result)
{
    int column = blockIdx.x * blockDim.x + threadIdx.x;
    int output = blockIdx.y;
    if (column >= cols) return;
    int middle = (output - half / step) * step;
    int first = middle > half ? middle - half : 0;
    int last = middle + half < rows ? middle + half : rows - 1;
    double turn_x = turns_x * (column - 0.5 * (cols - 1));
    float real = 0.0f, imaginary = 0.0f, carrier_x = (float)(turn_x - rint(turn_x));
    for (int row = first; row <= last; ++row) {
        double turn_y = turns_y * (row - 0.5 * (rows - 1));
        float carrier = carrier_x + (float)(turn_y - rint(turn_y));
        float t = height_um[(size_t)row * cols + column] * cycles_per_um + carrier;
        float sine, cosine, weight = taps[row - middle + half];
        sincospif(2.0f * (t - rintf(t)), &sine, &cosine);
        real += weight * cosine;
        imaginary -= weight * sine;
    }
    result[(size_t)output * cols + column] = make_float2(real, imaginary);
}

extern "C" __global__ void along_x(
    const float2* wave, int cols, const float* taps, int half, int step, int outputs, float2* result)
{
    int output = blockIdx.x * blockDim.x + threadIdx.x;
    int row = blockIdx.y;
    if (output >= outputs) return;
    int middle = (output - half / step) * step;
    int first = middle > half ? middle - half : 0;
    int last = middle + half < cols ? middle + half : cols - 1;
    float real = 0.0f, imaginary = 0.0f;
    for (int column = first; column <= last; ++column) {
        float weight = taps[column - middle + half];
        float2 here = wave[(size_t)row * cols + column];
        real += weight * here.x;
        imaginary += weight * here.y;
    }
    result[(size_t)row * outputs + output] = make_float2(real, imaginary);
}
"""
"""CUDA C: exp(−2πi·(cycles·z + turns of the direction)), low-passed and decimated along y, then along x.

The wave is computed anew for each of the few outputs to which a row contributes, which costs less than storing it.
"""

THREADS = 128  # of a block, along a row


@dataclass(frozen=True, eq=False)
class ArrayLibrary:
    """Array library, and the device of its arrays.

    Attributes:
        xp: functions of arrays: numpy, or cupy.
        fft: Fourier transforms: scipy.fft, or cupyx.scipy.fft.
        fft_options: keywords of each transform.
        kernels: compiled for the card, by name; none on the cores.
    """

    xp: Any
    fft: Any
    fft_options: Mapping[str, Any]
    kernels: Mapping[str, Any] = field(default_factory=dict)
    _heights: "WeakKeyDictionary[WaveSurface, Any]" = field(default_factory=WeakKeyDictionary)

    @property
    def is_card(self) -> bool:
        """Whether arrays are on a graphics card."""
        return bool(self.kernels)

    def heights(self, surface: WaveSurface) -> Heights:
        """(rows, cols) float32 heights of a surface in µm, copied to the card once."""
        if not self.is_card:
            return surface.height_um
        if surface not in self._heights:
            self._heights[surface] = self.xp.asarray(surface.height_um)
        return cast("Heights", self._heights[surface])

    def host(self, array: npt.NDArray[Scalar]) -> npt.NDArray[Scalar]:
        """The same array in the memory of the processor."""
        return cast("npt.NDArray[Scalar]", cast("Any", array).get()) if self.is_card else array


def library() -> ArrayLibrary:
    """The graphics card where ANISOSCOPE_GPU=1 asks for it, else the cores.

    Raises:
        UsageError: the variable has another value than 0 or 1, CuPy is not installed, or there is no card.
    """
    chosen = os.environ.get(VARIABLE, "0")
    if chosen not in ("", "0", "1"):
        raise UsageError(
            f"{VARIABLE} must be 1 (waves on the graphics card) or 0 (on the cores), not {chosen!r}"
        )
    if chosen == "1":
        return _card()
    return _cores(threads.count())


@cache
def _cores(workers: int) -> ArrayLibrary:
    from scipy import fft  # noqa: PLC0415 - slow to import

    return ArrayLibrary(np, fft, {"workers": workers})


@cache
def _card() -> ArrayLibrary:
    problem = card_problem()
    if problem is not None:
        raise UsageError(problem)
    import cupy  # noqa: PLC0415 - optional
    from cupyx.scipy import fft  # noqa: PLC0415 - optional

    return ArrayLibrary(
        cupy, fft, {}, {name: cupy.RawKernel(KERNELS, name) for name in ("along_y", "along_x")}
    )


def card_problem() -> str | None:
    """Why no graphics card can be used, and what to do; None if one can."""
    try:
        import cupy  # noqa: PLC0415 - optional
    except ImportError as problem:
        return f"{VARIABLE}=1 needs CuPy ({problem}): pip install 'anisoscope[gpu]', or CuPy for your CUDA version"
    try:
        cupy.zeros(1)
    except cupy.cuda.runtime.CUDARuntimeError as problem:
        return f"{VARIABLE}=1, but CUDA finds no graphics card ({problem}): check nvidia-smi, or unset {VARIABLE}"
    return None


def bessel_j1(x: FloatArray) -> FloatArray:
    """J₁ where the array is."""
    here: object = x
    special = import_module("scipy.special" if isinstance(here, np.ndarray) else "cupyx.scipy.special")
    return cast("FloatArray", special.j1(x))


def fft_length(least: int) -> int:
    """Length at which Fourier transforms are fast, the same on the card and on the cores."""
    from scipy.fft import next_fast_len  # noqa: PLC0415 - slow to import

    return int(next_fast_len(least))


def low_pass(
    card: ArrayLibrary,
    surface: WaveSurface,
    turns: tuple[float, float, float],
    along_y: Filter,
    along_x: Filter,
) -> ComplexArray:
    """(outputs along y, outputs along x) complex64 wave on the card, low-passed and decimated.

    Args:
        card: the library of the graphics card.
        surface: the heights.
        turns: of the phase per µm of height, from column to column, and from row to row.
        along_y: filter along y.
        along_x: filter along x.
    """
    rows, cols = surface.shape
    per_um, per_column, per_row = turns
    wave = card.xp.empty((along_y.outputs, cols), dtype=np.complex64)
    steps = (np.float32(per_um), np.float64(per_column), np.float64(per_row))
    arguments = (card.heights(surface), np.int32(rows), np.int32(cols), *steps, *along_y.arguments, wave)
    card.kernels["along_y"]((-(-cols // THREADS), along_y.outputs), (THREADS,), arguments)
    if along_x.step > 1:
        result = card.xp.empty((along_y.outputs, along_x.outputs), dtype=np.complex64)
        arguments = (wave, np.int32(cols), *along_x.arguments, result)
        card.kernels["along_x"]((-(-along_x.outputs // THREADS), along_y.outputs), (THREADS,), arguments)
        wave = result
    return cast("ComplexArray", wave)
