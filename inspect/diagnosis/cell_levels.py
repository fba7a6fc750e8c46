"""Levels of the cells of a predicted contrast map: the share that deviates follows for the thresholds of any part.

With ``area.cell_deviation = "auto"`` the thresholds are those of the part, and its good cells scatter more than those
of a smooth predicted surface. Signatures therefore state by how much their cells deviate, in levels.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.imaging.deviation_map import cell_deviations

STEP = 0.025
"""Ln ratio between two levels; thresholds are rounded to it."""
HIGHEST = 80
"""A ln ratio of 2: what deviates by more counts as this."""


@dataclass(frozen=True, eq=False)
class CellLevels:
    """To which levels the cells of a contrast map deviate.

    Attributes:
        levels: (U, 3, pairs) of cells that are alike: deviation of the cell from its line, of the line from the same
            flank of other ridges, and of the cell from these; in `STEP`, rounded down, at most `HIGHEST`.
        places: (cell rows, cell cols) which of them every cell is.
    """

    levels: npt.NDArray[np.uint8]
    places: npt.NDArray[np.uint16]

    @classmethod
    def of(cls, ratios: FloatArray) -> "CellLevels":
        """Levels of a contrast map: (pairs, cell rows, cell cols) ln ratios."""
        alone, whole = cell_deviations(ratios, np.inf), cell_deviations(ratios, 0.0)
        each = np.stack([alone, np.broadcast_to(whole - alone, alone.shape), whole])
        levels = np.minimum(np.abs(each) / STEP, HIGHEST).astype(np.uint8)
        pairs = len(ratios)
        found, places = np.unique(levels.reshape(3 * pairs, -1).T, axis=0, return_inverse=True)
        return cls(found.reshape(-1, 3, pairs), places.reshape(ratios.shape[1:]).astype(np.uint16))

    def deviating(self, thresholds: Sequence[float] | FloatArray) -> npt.NDArray[np.bool_]:
        """(cell rows, cell cols) True where a cell deviates in some pair, by (pairs,) thresholds."""
        least = np.clip(np.rint(np.asarray(thresholds) / STEP), 1, HIGHEST)
        alone, line, whole = (self.levels[:, k] >= least for k in range(3))
        return np.asarray(np.any(np.where(line, whole, alone), axis=1)[self.places])

    def share(self, thresholds: Sequence[float] | FloatArray) -> float:
        """Share of the cells that deviate in some pair, by (pairs,) thresholds."""
        return float(self.deviating(thresholds).mean())
