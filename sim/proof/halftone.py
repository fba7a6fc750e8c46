"""Halftones of three or four inks that never overlap: one threshold mask for all of them, or vector error diffusion.

The mask is void and cluster (R. Ulichney, Proc. SPIE 1913, 332, 1993) on a torus. One mask serves all inks, so that no
two of them can meet on one dot. The mask in the package is written by ``python -m anisoscope.sim.proof.halftone``.

What a press makes of dots: screens that are not in register, dots that spread, and inks that overlap by that. Where
inks overlap, the print has further primaries (H. E. J. Neugebauer, 1937): every set of inks that lie on each other.
Their shares of every dot are counted on a finer grid. As the inks are opaque flakes on black paper, without light that
spreads in the paper, the light of a dot is the sum of the shares times the light of the primaries.
"""

import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from importlib.resources import as_file, files
from pathlib import Path
from threading import Lock
from typing import Literal

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import ModelError
from anisoscope.base.progress import Advance, silent
from anisoscope.sim.light import threads
from anisoscope.sim.proof.separation import CHANNELS, TOLERANCE, Separation, decode_srgb

Ranks = npt.NDArray[np.int64]
Thresholds = npt.NDArray[np.float32]

SIZE = 128
SEED = 1993
SIGMA_PX = 1.5
"""Width of the Gaussian that says how close dots are; Ulichney's value."""

_FIRST_SHARE = 0.1
_REACH_SIGMAS = 6.0
_NAME = f"void_and_cluster_{SIZE}.npy"


def void_and_cluster(size: int, rng: np.random.Generator, sigma_px: float = SIGMA_PX) -> Ranks:
    """(size, size) ranks 0 to size² − 1; the first n of them are n dots spread as evenly as they can be, at any n.

    Beyond half, the tightest cluster of gaps is also the gap with the least energy of dots: both are one rule, because
    on a torus all dots and all gaps together have the same energy everywhere.

    Args:
        size: side in dots, 8 or more.
        rng: of the points to begin with.
        sigma_px: width of the Gaussian in dots.

    Raises:
        ModelError: a size below 8, or a width that is not between 0.5 and size/8.
    """
    from anisoscope.sim.proof.kernels import rank  # noqa: PLC0415 - loads the compiler

    if size < 8 or not 0.5 <= sigma_px <= size / 8:
        raise ModelError(
            f"a mask needs 8 dots a side and a width of 0.5 to size/8, not {size} and {sigma_px:g}"
        )
    reach = min(int(np.ceil(_REACH_SIGMAS * sigma_px)), (size - 1) // 2)
    line = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma_px) ** 2)
    points = np.zeros(size * size, dtype=bool)
    points[rng.permutation(size * size)[: max(2, int(_FIRST_SHARE * size * size))]] = True
    ranks = np.full(size * size, -1, dtype=np.int64)
    rank(points, np.outer(line, line), size, np.zeros(size * size), ranks)
    return ranks.reshape(size, size)


@cache
def thresholds() -> Thresholds:
    """(128, 128) thresholds, evenly spread over (0, 1), read-only: dot where coverage exceeds them; tiles."""
    with as_file(files("anisoscope.sim.proof") / "data" / _NAME) as path:
        ranks = np.load(path, allow_pickle=False)
    found: Thresholds = ((ranks.astype(np.float64) + 0.5) / ranks.size).astype(np.float32)
    found.flags.writeable = False
    return found


def main(folder: Path) -> Path:
    """Write the mask of the package."""
    path = folder / _NAME
    np.save(path, void_and_cluster(SIZE, np.random.default_rng(SEED)).astype(np.uint16))
    return path


Float32 = npt.NDArray[np.float32]
Dots = npt.NDArray[np.uint8]
Method = Literal["mask", "diffusion"]

BLOCK = 64
ROWS = 128
MOST_DOTS = 400_000_000


@dataclass(frozen=True, eq=False)
class Halftone:
    """Map of the inks of a print.

    Attributes:
        dots: (rows, cols) 0 for no ink, 1 to K for the inks; one number a dot, so that inks cannot meet.
        method: how the dots were placed.
        aimed: (K,) mean coverages asked for, after sums above 1 were scaled down.
        printed: (K,) mean coverages of the dots.
        block_error: (B,) largest difference between both over the inks, in blocks of 64 × 64 dots; cut ones left out.
        outside: share of pixels whose colour the inks cannot mix.
        scaled: share of pixels whose coverages summed up to more than 1.
    """

    dots: Dots
    method: Method
    aimed: FloatArray
    printed: FloatArray
    block_error: FloatArray
    outside: float
    scaled: float

    def mask(self, ink: int) -> npt.NDArray[np.bool_]:
        """(rows, cols) dots of one ink, 0 to K − 1."""
        return np.asarray(self.dots == ink + 1)


@dataclass(frozen=True, eq=False)
class _Job:
    """Bands of an image on their way to dots."""

    image: npt.NDArray[np.uint8] | Float32
    levels: Float32
    colours: Float32
    solvers: Float32
    exact: int
    bare: Float32
    plan: Separation

    def cover(self, begin: int, stop: int, counts: npt.NDArray[np.int64]) -> Float32:
        """(stop − begin, cols, K) coverages of rows."""
        from anisoscope.sim.proof.kernels import limit_sum, separate  # noqa: PLC0415 - loads the compiler

        band = self.image[begin:stop]
        linear = self.levels[band] if band.dtype == np.uint8 else band * np.float32(self.plan.gain)
        if self.plan.way == "channels":
            if self.plan.inks > CHANNELS:
                common = linear.min(axis=-1, keepdims=True)
                linear = np.concatenate([linear - common, common], axis=-1)
            limit_sum(linear, counts)
            return np.asarray(linear)
        linear = linear - self.bare
        found = np.empty((*linear.shape[:2], self.plan.inks), dtype=np.float32)
        scratch = np.empty((2, self.plan.inks), dtype=np.float32)
        separate(linear, self.colours, self.solvers, self.exact, TOLERANCE, found, counts, scratch)
        return found


def _job(image: npt.NDArray[np.uint8] | Float32, plan: Separation) -> _Job:
    if image.ndim != 3 or image.shape[2] != CHANNELS or 0 in image.shape:
        raise ModelError(f"an image to halftone is (rows, cols, 3), not {image.shape}")
    if image.dtype not in (np.uint8, np.float32):
        raise ModelError(f"an image to halftone is 8-bit sRGB or linear float32, not {image.dtype}")
    if image.shape[0] * image.shape[1] > MOST_DOTS:
        raise ModelError(
            f"{image.shape[1]} × {image.shape[0]} dots are more than {MOST_DOTS:,}: lower the dpi or the size"
        )
    # the adaptation is taken into the inks, so that every pixel is spared a product
    backward = np.linalg.inv(plan.adaptation)
    levels = (plan.gain * decode_srgb()).astype(np.float32)
    solvers, exact = plan.solvers
    solvers = (solvers.astype(np.float64) @ plan.adaptation).astype(np.float32)
    added, bare = ((backward @ one).astype(np.float32) for one in (plan.added, plan.bare))
    return _Job(image, levels, added, solvers, exact, bare, plan)


def coverage(image: npt.NDArray[np.uint8] | Float32, plan: Separation) -> Float32:
    """(rows, cols, K) coverages of the inks, sums at most 1, for an image as :func:`halftone` takes it.

    Raises:
        ModelError: no such image.
    """
    return _job(image, plan).cover(0, len(image), np.zeros(2, dtype=np.int64))


def halftone(
    image: npt.NDArray[np.uint8] | Float32,
    plan: Separation,
    method: Method = "mask",
    *,
    advance: Advance = silent,
) -> Halftone:
    """Place the dots of an image, one a pixel.

    Args:
        image: (rows, cols, 3) 8-bit sRGB, or linear sRGB in float32.
        plan: how colours become coverages.
        method: "mask": void and cluster; "diffusion": vector error diffusion.
        advance: receives the progress.

    Raises:
        ModelError: no such image or method, or more dots than 400 million.
    """
    if method not in ("mask", "diffusion"):
        raise ModelError(f"no halftone is named {method!r}; known: mask, diffusion")
    job = _job(image, plan)
    rows, cols = image.shape[:2]
    dots = np.empty((rows, cols), dtype=np.uint8)
    shape = (-(-rows // BLOCK), -(-cols // BLOCK))
    aimed, printed = np.zeros((*shape, plan.inks)), np.zeros((*shape, plan.inks + 1), dtype=np.int64)
    starts = range(0, rows, ROWS)
    counts = np.zeros((len(starts), 2), dtype=np.int64)
    place = _placer(method, cols, plan.inks)
    lock, done = Lock(), [0]

    def work(number: int) -> Float32:
        from anisoscope.sim.proof.kernels import count_blocks  # noqa: PLC0415 - loads the compiler

        begin, stop = starts[number], min(starts[number] + ROWS, rows)
        cover = job.cover(begin, stop, counts[number])
        if place is not None:
            return cover
        _screened(cover, begin, dots[begin:stop])
        count_blocks(cover, dots[begin:stop], BLOCK, *_of_band(begin, stop, aimed, printed))
        with lock:
            done[0] += 1
            advance("rows", min(done[0] * ROWS, rows), rows)
        return cover[:0]

    if place is None:
        threads.each(work, range(len(starts)))
    else:
        _in_order(work, place, starts, dots, (aimed, printed), advance)
    return _result(dots, method, aimed, printed, counts.sum(axis=0))


Placer = Callable[[Float32, int, Dots], None]


def _placer(method: Method, cols: int, inks: int) -> Placer | None:
    """Placement of the dots of a band after the band above; None where bands do not depend on each other."""
    if method == "mask":
        return None
    from anisoscope.sim.proof.kernels import diffuse  # noqa: PLC0415 - loads the compiler

    error = np.zeros((2, cols + 2, inks), dtype=np.float32)
    return lambda cover, begin, dots: diffuse(cover, begin, error, dots)


def _screened(cover: Float32, begin: int, dots: Dots) -> None:
    from anisoscope.sim.proof.kernels import screen  # noqa: PLC0415 - loads the compiler

    screen(cover, thresholds(), begin, dots)


def _of_band(
    begin: int, stop: int, aimed: FloatArray, printed: npt.NDArray[np.int64]
) -> tuple[FloatArray, npt.NDArray[np.int64]]:
    part = slice(begin // BLOCK, -(-stop // BLOCK))
    return aimed[part], printed[part]


def _in_order(
    work: Callable[[int], Float32],
    place: Placer,
    starts: range,
    dots: Dots,
    blocks: tuple[FloatArray, npt.NDArray[np.int64]],
    advance: Advance,
) -> None:
    """Separate bands side by side, a few at a time, and diffuse their errors one after the other."""
    from anisoscope.sim.proof.kernels import count_blocks  # noqa: PLC0415 - loads the compiler

    rows, at_once = len(dots), 2 * threads.count()
    for first in range(0, len(starts), at_once):
        numbers = range(first, min(first + at_once, len(starts)))
        for number, cover in zip(numbers, threads.each(work, numbers), strict=True):
            begin, stop = starts[number], min(starts[number] + ROWS, rows)
            place(cover, begin, dots[begin:stop])
            count_blocks(cover, dots[begin:stop], BLOCK, *_of_band(begin, stop, *blocks))
            advance("rows", stop, rows)


def _result(
    dots: Dots,
    method: Method,
    aimed: FloatArray,
    printed: npt.NDArray[np.int64],
    counts: npt.NDArray[np.int64],
) -> Halftone:
    whole = printed.sum(axis=-1) == BLOCK * BLOCK
    error = np.abs(aimed - printed[..., 1:])[whole].max(axis=-1, initial=0.0) / BLOCK**2
    pixels = dots.size
    return Halftone(
        dots,
        method,
        aimed.sum(axis=(0, 1)) / pixels,
        printed[..., 1:].sum(axis=(0, 1)) / pixels,
        error,
        float(counts[0]) / pixels,
        float(counts[1]) / pixels,
    )


FINER = 4
"""Points along the side of a dot."""
LEAST_SHARE = 1e-4
"""Primaries that cover less of the print are left out; their area is that of the inks on top."""
MOST_MOVED = 64.0

Set = tuple[int, ...]


@dataclass(frozen=True)
class Press:
    """Errors of a press, in dots.

    Attributes:
        shifts: (x, y) of the screen of every ink, y upward.
        gain: by how much a dot spreads beyond each edge.
    """

    shifts: tuple[tuple[float, float], ...]
    gain: float = 0.0

    def __post_init__(self) -> None:
        if not all(np.hypot(*one) <= MOST_MOVED for one in self.shifts):
            raise ModelError(f"screens are moved by up to {MOST_MOVED:g} dots")
        if not 0.0 <= self.gain <= MOST_MOVED:
            raise ModelError(f"dots spread by 0 to {MOST_MOVED:g} dots, not {self.gain:g}")


@dataclass(frozen=True, eq=False)
class Pressed:
    """A print.

    Attributes:
        sets: P sets of inks, numbered from 0 in the order in which they are printed: single ones first.
        shares: (rows, cols, P) share of every dot that each set alone covers.
    """

    sets: tuple[Set, ...]
    shares: npt.NDArray[np.float32]

    @property
    def coverage(self) -> FloatArray:
        """(P,) share of the print."""
        return np.asarray(self.shares.mean(axis=(0, 1), dtype=np.float64))


def pressed(dots: npt.NDArray[np.uint8], inks: int, press: Press) -> Pressed:
    """Print dots.

    Args:
        dots: (rows, cols) 0 for no ink or 1 to ``inks``.
        inks: how many there are.
        press: its errors, one shift for each ink.

    Raises:
        ModelError: shifts of another number of inks.
    """
    if len(press.shifts) != inks:
        raise ModelError(f"{inks} inks need as many shifts, not {len(press.shifts)}")
    found: npt.NDArray[np.uint8] = np.zeros(tuple(FINER * n for n in dots.shape), dtype=np.uint8)
    for number, shift in enumerate(press.shifts):
        fine = np.repeat(np.repeat(dots == number + 1, FINER, axis=0), FINER, axis=1)
        fine = _moved(_spread(fine, FINER * press.gain), shift)
        found |= fine.astype(np.uint8) << number
    rows, cols = dots.shape
    counts = np.zeros((rows, cols, 1 << inks), dtype=np.float32)
    blocks = found.reshape(rows, FINER, cols, FINER)
    for mask in range(1, 1 << inks):
        counts[..., mask] = (blocks == mask).mean(axis=(1, 3), dtype=np.float32)
    return _kept(counts, inks)


def _moved(mask: npt.NDArray[np.bool_], shift: tuple[float, float]) -> npt.NDArray[np.bool_]:
    """A mask moved by dots, whole points of the finer grid; rows run downward, and nothing comes in at the border."""
    down, right = -round(FINER * shift[1]), round(FINER * shift[0])
    found = np.zeros_like(mask)
    rows, cols = mask.shape
    if abs(down) >= rows or abs(right) >= cols:
        return found
    to = np.s_[max(0, down) : rows + min(0, down), max(0, right) : cols + min(0, right)]
    of = np.s_[max(0, -down) : rows - max(0, down), max(0, -right) : cols - max(0, right)]
    found[to] = mask[of]
    return found


def _spread(mask: npt.NDArray[np.bool_], points: float) -> npt.NDArray[np.bool_]:
    if points < 0.5:
        return mask
    from scipy import ndimage  # noqa: PLC0415 - slow to import

    return np.asarray(ndimage.distance_transform_edt(~mask) <= points)


def _kept(counts: npt.NDArray[np.float32], inks: int) -> Pressed:
    """All single inks, and the sets that cover enough; of the others the ink printed last is taken."""
    shares = counts.mean(axis=(0, 1))
    single = [1 << number for number in range(inks)]
    others = [mask for mask in range(1, 1 << inks) if mask not in single]
    kept = single + [mask for mask in others if shares[mask] >= LEAST_SHARE]
    for mask in others:
        if mask not in kept:
            counts[..., 1 << (mask.bit_length() - 1)] += counts[..., mask]
    sets = tuple(tuple(k for k in range(inks) if mask >> k & 1) for mask in kept)
    return Pressed(sets, np.ascontiguousarray(counts[..., kept]))


if __name__ == "__main__":
    sys.stdout.write(f"{main(Path(__file__).parent / 'data')}\n")
