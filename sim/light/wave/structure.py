"""How wide the mirrors of a surface are: flat facets between edges, the pitch of what is curved, levels of steps."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.sim.light.wave.surface import WaveSurface

LINES = 48
"""Rows and columns that are looked at."""

FLAT = 1.0 / 32.0
"""How far a facet may leave its plane, in wavelengths: a phase of 0.8 rad there and back."""

SMALL_SHARE = 0.1
"""Facets narrower than the width that is stated cover less than this share."""

EDGE_SLOPE = 1.0
SHARP = 32.0
MAINLY = 0.8
LEVEL_SHARE = 0.8
STEP_SHARE = 0.9


@dataclass(frozen=True)
class Axis:
    """What a surface is made of along one axis.

    Attributes:
        width_um: smallest width of flat facets, or the pitch where it is curved; infinite where it does not change.
        flat: it is made of flat facets.
    """

    width_um: float
    flat: bool


@dataclass(frozen=True)
class Structure:
    """What a surface is made of.

    Attributes:
        along_x: along x.
        along_y: along y.
        stepped: level stretches with jumps between them.
    """

    along_x: Axis
    along_y: Axis
    stepped: bool


def structure_of(surface: WaveSurface, wavelength_um: float) -> Structure:
    """Look at up to 48 lines each way."""
    rows, cols = surface.shape
    z = surface.height_um
    across = [z[row] for row in np.unique(np.linspace(0, rows - 1, min(rows, LINES)).astype(int))]
    along_x = _axis(across, surface.pixel_x_um, wavelength_um)
    along_y, down = Axis(float("inf"), True), []
    if not surface.is_profile and rows > 1:
        down = [z[:, col] for col in np.unique(np.linspace(0, cols - 1, min(cols, LINES)).astype(int))]
        along_y = _axis(down, surface.pixel_y_um, wavelength_um)
    return Structure(along_x, along_y, is_stepped([*across, *down], wavelength_um))


def is_stepped(lines: list[npt.NDArray[np.float32]], wavelength_um: float) -> bool:
    """Whether most of the surface is level and nearly all of its relief stands in jumps from pixel to pixel."""
    change = np.concatenate([np.abs(np.diff(line)) for line in lines])
    jump = change > 0.02 * wavelength_um
    total = float(change.sum())
    if not jump.any() or total == 0.0:
        return False
    return bool(np.mean(~jump) > LEVEL_SHARE and float(change[jump].sum()) > STEP_SHARE * total) or bool(
        _few_levels(lines, wavelength_um)
    )


def _few_levels(lines: list[npt.NDArray[np.float32]], wavelength_um: float) -> bool:
    """Fine steps: fewer level stretches, but all heights lie on at most 32 levels that are clearly apart."""
    heights = np.sort(np.concatenate(lines))
    gaps = np.diff(heights)
    apart = gaps > 0.01 * wavelength_um
    spread = float(gaps[~apart].sum())
    few = bool(1 <= np.count_nonzero(apart) < 32 and spread < 0.1 * float(gaps.sum()))
    level = np.concatenate([np.abs(np.diff(line)) for line in lines]) < 0.01 * wavelength_um
    return few and bool(np.mean(level) > 0.5)


def _axis(lines: list[npt.NDArray[np.float32]], pixel_um: float, wavelength_um: float) -> Axis:
    found = [facet for line in lines for facet in facets_of(line, pixel_um, FLAT * wavelength_um)]
    length = lines[0].size * pixel_um
    if not found:
        return Axis(pixel_um, False)
    if all(flat and width >= length - 2.0 * pixel_um for width, flat in found):
        return Axis(float("inf"), True)
    found.sort()
    covered = np.cumsum([width for width, _ in found])
    at = int(np.searchsorted(covered, SMALL_SHARE * covered[-1]))
    return Axis(float(found[at][0]), found[at][1])


def facets_of(
    line: npt.NDArray[np.float32], pixel_um: float, tolerance_um: float
) -> list[tuple[float, bool]]:
    """Facets of a profile: (width in µm, flat) each; of a curved stretch its pitch.

    The profile is split where it leaves straight lines (Douglas and Peucker 1973). Where two of them meet at an angle
    that a curve within the tolerance would not make, there is an edge; the rest of the joints belong to curves. Walls
    steeper than 45° are no facets. The outermost facets of a line are cut off by its ends and left out where others
    remain.
    """
    from cv2 import approxPolyDP  # noqa: PLC0415 - slow to import

    flatten = 1e-3 * tolerance_um / max(float(np.ptp(line)), tolerance_um)  # distances become vertical ones
    points = np.stack([np.arange(line.size, dtype=np.float32) * 1e-3, line * flatten], axis=-1).astype(
        np.float32
    )
    kept = approxPolyDP(points[:, None], tolerance_um * flatten, closed=False)[:, 0, 0]
    where = np.unique(np.rint(kept / 1e-3).astype(int))
    width, rise = np.diff(where) * pixel_um, np.diff(line[where].astype(np.float64))
    slope = rise / width
    wall = np.abs(slope) > EDGE_SLOPE
    wall |= (np.diff(where) <= 2) & (np.abs(rise) > 4.0 * tolerance_um)
    groups: list[list[int]] = []
    for number in range(width.size):
        if wall[number]:
            groups.append([])
        elif groups and groups[-1] and not _sharp(slope, width, number, tolerance_um):
            groups[-1].append(number)
        else:
            groups.append([number])
    whole = [group for group in groups if group]
    inner = whole[1:-1] if len(whole) > 2 else whole
    return [_facet(group, width, slope) for group in inner]


def _sharp(slope: FloatArray, width: FloatArray, number: int, tolerance_um: float) -> bool:
    bend = abs(slope[number] - slope[number - 1]) * min(width[number], width[number - 1])
    return bool(bend > SHARP * tolerance_um)


def _facet(group: list[int], width: FloatArray, slope: FloatArray) -> tuple[float, bool]:
    total = float(width[group].sum())
    if width[group].max() > MAINLY * total:  # the rest is a pixel at an edge
        return total, True
    falling = np.signbit(slope[group])
    turns = int(np.count_nonzero(falling[1:] != falling[:-1]))
    return total / max(1.0, 0.5 * turns), False
