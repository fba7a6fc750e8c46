"""Grades of a code of ridges: parameters of ISO/IEC 29158 for direct part marks, and of ISO/IEC 15415.

Grades run from 4, the best, to 0, which fails; the overall grade is the least. Cells are the means over fields: the
threshold between light and dark is the one that splits them with the least sum of variances (29158). Where single cells
are weak, modulation is graded as the standard asks: at each level the cells that do not reach it count as erasures, and
the unused error correction that is left bounds the grade. Fixed pattern damage is graded by segments in the same way.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.kinds.plates.code_symbol import Mask, Symbol, unused_correction

CONTRAST_STEPS = 0.30, 0.25, 0.20, 0.15
MODULATION_STEPS = 0.50, 0.40, 0.30, 0.20
UNUSED_STEPS = 0.62, 0.50, 0.37, 0.25
LEAST_REFLECTANCE = 0.05
AXIAL_STEPS = 0.06, 0.08, 0.10, 0.12
GRID_STEPS = 0.38, 0.50, 0.63, 0.75
SIDE_STEPS = 0.0, 0.09, 0.13, 0.17
CLOCK_STEPS = 0.10, 0.15, 0.20, 0.25
FINDER_STEPS = 0, 1, 2, 3
TIMING_STEPS = 0.0, 0.07, 0.11, 0.14
ALIGNMENT_STEPS = 0.0, 0.10, 0.20, 0.30
AVERAGE_STEPS = 4.0, 3.5, 3.0, 2.5
"""Values from which, or up to which, the grades 4, 3, 2 and 1 are given."""
OVERALL = "overall grade"


@dataclass(frozen=True)
class Grade:
    """Value and grade of one parameter: 4 is the best, 0 fails."""

    parameter: str
    value: float
    grade: int


@dataclass(frozen=True)
class Cells:
    """Graded cells of a symbol.

    Attributes:
        radiance: (rows, cols) of the fields of the plan in 1/sr.
        light_cosine: of the angle of the light, for the reflectance.
        read: whether the picture was read.
        axial, grid: non-uniformity of the places of the fields; None where these were not measured.
    """

    radiance: FloatArray
    light_cosine: float
    read: bool
    axial: float | None = None
    grid: float | None = None


def graded(cells: Cells, symbol: Symbol) -> tuple[Grade, ...]:
    """Grades of all parameters, the overall one first."""
    light, dark, threshold = _lobes(cells.radiance)
    reversed_ = bool(np.mean(cells.radiance[symbol.dark]) > np.mean(cells.radiance[~symbol.dark]))
    due_dark = symbol.dark != reversed_
    depth = np.where(
        due_dark,
        (threshold - cells.radiance) / max(threshold - dark, 1e-12),
        (cells.radiance - threshold) / max(light - threshold, 1e-12),
    )
    depth = np.clip(depth, 0.0, 1.0)
    levels = at_least(depth, MODULATION_STEPS)
    contrast = (light - dark) / light if light > 0.0 else 0.0
    reflectance = float(np.pi * light / cells.light_cosine)
    modulation = float(depth[symbol.data].min())
    damage, damage_grade = _fixed_pattern(symbol, levels)
    found = [
        Grade("decode", float(cells.read), 4 if cells.read else 0),
        Grade("cell contrast", contrast, int(at_least(contrast, CONTRAST_STEPS))),
        Grade("minimum reflectance", reflectance, 4 if reflectance >= LEAST_REFLECTANCE else 0),
        Grade("cell modulation", modulation, _with_correction(symbol, levels)),
        Grade("fixed pattern damage", damage, damage_grade),
    ]
    for name, value, steps in (
        ("axial non-uniformity", cells.axial, AXIAL_STEPS),
        ("grid non-uniformity", cells.grid, GRID_STEPS),
    ):
        if value is not None:
            found.append(Grade(name, value, int(at_most(value, steps))))
    unused = unused_correction(symbol, levels == 0) or 0.0
    found.append(Grade("unused error correction", unused, int(at_least(unused, UNUSED_STEPS))))
    least = min(one.grade for one in found)
    return (Grade(OVERALL, float(least), least), *found)


def _lobes(radiance: FloatArray) -> tuple[float, float, float]:
    """Means of the light and of the dark cells, and the threshold between them."""
    ordered = np.sort(radiance.ravel())
    count = np.arange(1, ordered.size)
    below, squares = np.cumsum(ordered)[:-1], np.cumsum(ordered**2)[:-1]
    above, more = ordered.sum() - below, float((ordered**2).sum()) - squares
    rest = ordered.size - count
    spread = squares - below**2 / count + more - above**2 / rest
    cut = int(np.argmin(spread))
    dark, light = float(below[cut] / count[cut]), float(above[cut] / rest[cut])
    return light, dark, 0.5 * float(ordered[cut] + ordered[cut + 1])


def _with_correction(symbol: Symbol, levels: FloatArray) -> int:
    """Grade of the modulation: the highest level that the error correction allows."""
    best = 0
    for level in (4, 3, 2, 1):
        unused = unused_correction(symbol, symbol.data & (levels < level))
        # an erasure takes half as much of the correction as an error does, by which it is counted here
        left = 0.0 if unused is None else 0.5 * (1.0 + unused)
        best = max(best, min(level, int(at_least(left, UNUSED_STEPS))))
        if best >= level:
            break
    return best


def _fixed_pattern(symbol: Symbol, levels: FloatArray) -> tuple[float, int]:
    """Largest share of wrong modules in a segment, and the grade of fixed pattern damage."""
    grades, shares = [], []
    for name, mask in symbol.segments.items():
        notional = []
        for level in (4, 3, 2, 1, 0):
            wrong = levels[mask] < max(level, 1)
            notional.append(min(level, _segment(name, symbol.symbology, wrong)) if level else 0)
        grades.append(max(notional))
        shares.append(float(np.mean(levels[mask] == 0)))
    average = int(at_least(float(np.mean(grades)), AVERAGE_STEPS))
    return max(shares), min(*grades, average)


def _segment(name: str, symbology: str, wrong: Mask) -> int:
    """Grade of a segment by its wrong modules."""
    share = float(np.mean(wrong))
    if symbology == "datamatrix":
        return int(at_most(share, CLOCK_STEPS if name == "clock" else SIDE_STEPS))
    if name.startswith("A"):
        return int(at_most(float(np.count_nonzero(wrong)), FINDER_STEPS))
    return int(at_most(share, TIMING_STEPS if name.startswith("B") else ALIGNMENT_STEPS))


def at_least(value: FloatArray | float, steps: Sequence[float]) -> FloatArray:
    """Grades of values of which more is better."""
    return np.asarray(np.sum([np.asarray(value) >= step - 1e-12 for step in steps], axis=0))


def at_most(value: FloatArray | float, steps: Sequence[float]) -> FloatArray:
    """Grades of values of which less is better."""
    return np.asarray(np.sum([np.asarray(value) <= step + 1e-12 for step in steps], axis=0))
