"""What a press makes of dots: screens that are not in register, dots that spread, and inks that overlap by that.

Where inks overlap, the print has further primaries (H. E. J. Neugebauer, 1937): every set of inks that lie on each
other. Their shares of every dot are counted on a finer grid. As the inks are opaque flakes on black paper, without
light that spreads in the paper, the light of a dot is the sum of the shares times the light of the primaries.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import ModelError

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


def named(sets: Sequence[Set], names: Sequence[str]) -> tuple[str, ...]:
    """Sets by the names of their inks, such as "red + green"."""
    return tuple(" + ".join(names[number] for number in one) for one in sets)
