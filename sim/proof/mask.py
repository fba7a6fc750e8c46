"""The threshold mask of the halftones: void and cluster (R. Ulichney, Proc. SPIE 1913, 332, 1993), on a torus.

One mask serves all inks, so that no two of them can meet on one dot. The mask that comes with the package is written by
``python -m anisoscope.sim.proof.mask``.
"""

import sys
from functools import cache
from importlib.resources import as_file, files
from pathlib import Path

import numpy as np
import numpy.typing as npt

from anisoscope.base.errors import ModelError

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
    from anisoscope.sim.proof.halftone_kernels import rank  # noqa: PLC0415 - loads the compiler

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


if __name__ == "__main__":
    sys.stdout.write(f"{main(Path(__file__).parent / 'data')}\n")
