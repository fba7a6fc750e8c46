"""The kernel of the graphics card, its source compiled for the processor, and with a card the real one."""

import ctypes
import shutil
import subprocess
import sys

import numpy as np
import pytest
from scipy import fft

from anisoscope.base.errors import UsageError
from anisoscope.sim.light.wave import fused, gpu
from anisoscope.sim.light.wave.correlation import angular_map, correlation_of
from anisoscope.sim.light.wave.halfvectors import half_vector
from anisoscope.sim.light.wave.surface import WaveSurface
from anisoscope.sim.light.wave.windows import POINT, Extent, Window

WINDOWS = {
    "square": Window(Extent("rect", 0.05)),
    "discs": Window(Extent("disc", 0.08), Extent("disc", 0.06, np.array([[0.9, 0.0], [0.0, 1.0]]))),
    "rough": Window(Extent("rect", 0.03), POINT, np.array([[1.5e-3, 2e-4], [2e-4, 8e-4]])),
}

SHIM = r"""
#include <cmath>
#include <cstddef>
#define __global__
struct float2 { float x, y; };
struct Place { int x, y; };
static Place blockIdx, blockDim, threadIdx;
static float2 make_float2(float x, float y) { return {x, y}; }
static void sincospif(float t, float* s, float* c) {
    *s = (float)std::sin(M_PI * (double)t); *c = (float)std::cos(M_PI * (double)t);
}
static void over(int blocks_x, int blocks_y, int threads, void (*call)(void*), void* given) {
    blockDim = {threads, 1};
    for (blockIdx.x = 0; blockIdx.x < blocks_x; ++blockIdx.x)
        for (blockIdx.y = 0; blockIdx.y < blocks_y; ++blockIdx.y)
            for (threadIdx.x = 0; threadIdx.x < threads; ++threadIdx.x) call(given);
}
%s
struct AlongY {
    const float* z; int rows, cols; float um; double x, y; const float* taps; int half, step, n; float2* to;
};
struct AlongX { const float2* wave; int cols; const float* taps; int half, step, n; float2* to; };
extern "C" void run_along_y(int bx, int by, int threads, AlongY a) {
    over(bx, by, threads, [](void* p) { AlongY& a = *(AlongY*)p;
        along_y(a.z, a.rows, a.cols, a.um, a.x, a.y, a.taps, a.half, a.step, a.n, a.to); }, &a);
}
extern "C" void run_along_x(int bx, int by, int threads, AlongX a) {
    over(bx, by, threads, [](void* p) { AlongX& a = *(AlongX*)p;
        along_x(a.wave, a.cols, a.taps, a.half, a.step, a.n, a.to); }, &a);
}
"""

KINDS = {
    np.int32: ctypes.c_int,
    np.float32: ctypes.c_float,
    np.float64: ctypes.c_double,
    np.ndarray: ctypes.c_void_p,
}


@pytest.fixture(scope="module")
def processor_as_card(tmp_path_factory):
    """The library of the card, with NumPy's arrays and the CUDA C source compiled for the processor."""
    compiler = shutil.which("g++") or pytest.skip(
        "g++ is not installed: it compiles the kernels of the graphics card"
    )
    folder = tmp_path_factory.mktemp("kernels")
    (folder / "kernels.cpp").write_text(SHIM % gpu.KERNELS)
    command = [compiler, "-O2", "-shared", "-fPIC", "-o", folder / "kernels.so", folder / "kernels.cpp"]
    subprocess.run(command, check=True)
    compiled = ctypes.CDLL(str(folder / "kernels.so"))

    def launched(name):
        def launch(grid, block, arguments):
            fields = [(f"given_{n}", KINDS[type(one)]) for n, one in enumerate(arguments)]
            given = type("Given", (ctypes.Structure,), {"_fields_": fields})
            plain = [one.ctypes.data if isinstance(one, np.ndarray) else one.item() for one in arguments]
            getattr(compiled, f"run_{name}")(*map(ctypes.c_int, (*grid, *block)), given(*plain))

        return launch

    return gpu.ArrayLibrary(np, fft, {}, {name: launched(name) for name in ("along_y", "along_x")})


@pytest.mark.parametrize("window", WINDOWS.values(), ids=WINDOWS)
@pytest.mark.parametrize("shape", [(1, 3000), (700, 900)], ids=["profile", "map"])
def test_the_kernel_of_the_card_gives_what_the_cores_give(direction, processor_as_card, window, shape):
    """Several blocks of threads, decimated and not; within 1e-5 of the brightest direction."""
    rng = np.random.default_rng(3)
    heights = np.kron(rng.choice([0.0, 0.07, 0.125], (1, shape[1] // 10)), np.ones((shape[0], 10)))
    heights = heights + 0.01 * rng.normal(size=shape)
    surface = WaveSurface.of(heights[0] if shape[0] == 1 else heights, 0.25)
    found = []
    for light in ((0.0, 0.0), (0.2, 0.0), (0.3, 0.1)):
        half = half_vector(direction(*light), direction(0.0, 0.05))
        cores = fused.density(surface, half, 0.55, window)
        found.append((cores, fused.density(surface, half, 0.55, window, processor_as_card)))
    cores, card = np.transpose(found)
    np.testing.assert_allclose(card, cores, rtol=0.0, atol=1e-5 * cores.max())


def test_a_card_is_asked_for_by_0_or_1(monkeypatch):
    monkeypatch.setenv("ANISOSCOPE_GPU", "yes")
    with pytest.raises(UsageError, match="ANISOSCOPE_GPU must be 1"):
        gpu.library()
    monkeypatch.setenv("ANISOSCOPE_GPU", "0")
    assert not gpu.library().is_card


def test_without_cupy_the_message_says_so(monkeypatch):
    monkeypatch.setitem(sys.modules, "cupy", None)
    assert "ANISOSCOPE_GPU=1 needs CuPy" in gpu.card_problem()


@pytest.mark.gpu
@pytest.mark.parametrize("window", WINDOWS.values(), ids=WINDOWS)
def test_a_graphics_card_gives_what_the_cores_give(direction, monkeypatch, window):
    """All three ways, on a map of a million points; within 1e-5 of the brightest direction."""
    problem = gpu.card_problem()
    if problem is not None:
        pytest.skip(f"no graphics card: {problem}")
    rng = np.random.default_rng(4)
    surface = WaveSurface.of(np.kron(rng.choice([0.0, 0.07, 0.125], (128, 128)), np.ones((8, 8))), 0.25)
    halves = [half_vector(direction(x, y), direction(0.0)) for x in (0.0, 0.1, 0.3) for y in (0.0, 0.05)]

    def ways():
        dense = [fused.density(surface, half, 0.55, window) for half in halves]
        return {
            "fused": np.array(dense),
            "all directions": angular_map(surface, 0.55, window, 0.98).density,
            "correlation": correlation_of(surface, 0.55, 0.98, (20.0, 20.0), endless=True).values,
        }

    cores = ways()
    monkeypatch.setenv("ANISOSCOPE_GPU", "1")
    for name, card in ways().items():
        assert isinstance(card, np.ndarray)
        np.testing.assert_allclose(
            card, cores[name], rtol=0.0, atol=1e-5 * np.abs(cores[name]).max(), err_msg=name
        )
