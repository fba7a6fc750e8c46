"""Profile parameters of ISO 21920-2 on lines of a height map: along x or y, across or along its ridges.

F-operation on the map, then S- and L-filter along every line (ISO 16610-21 of order 0, -31 or -22). Parameters of the
evaluation length (Ra, Rq, Rt, Rsk, Rku, Rdq, Rsm) use a line as a whole, Rz, Rp and Rv are means over sections of
λc, or over five sections without an L-filter. Rz, Rp and Rv take the highest and lowest points of a section, as
ISO 4287 does; Rz_hills takes its hills and dales, as ISO 21920-2 does.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import HeightMapError, UsageError
from anisoscope.parameters.keywords import by_keywords
from anisoscope.parameters.texture import Filtering, Smoothing
from anisoscope.profiles.editing.steps import edit_map
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.profiles.period import find_period
from anisoscope.profiles.textures.filters import mean_surface, without_form

Direction = Literal["across", "along", "x", "y"]

SECTIONS = 5
LEAST_POINTS = 20
MOST_LINES = 256
DISCRIMINATION = 0.1
STRAIGHT_DEG = 0.02
SLOPE = np.array([-1.0, 9.0, -45.0, 0.0, 45.0, -9.0, 1.0]) / 60.0
"""Derivative on seven points (ISO 21920-2, as ISO 4287)."""


@dataclass(frozen=True)
class LineParameters:
    """Profile parameters, each the mean over the lines; NaN where no line has it.

    Attributes:
        direction: of the lines.
        angle_deg: of the lines, counter-clockwise from +x.
        lines: number of lines.
        length_um: length of a line.
        sections: sections of a line for Rz, Rp and Rv.
        s_filter_um: nesting index λs; None where not applied.
        l_filter_um: nesting index λc; None where not applied.
        s_filter: kind of the S-filter.
        l_filter: kind of the L-filter.
        values: Ra, Rq, Rz, Rz_hills, Rp, Rv, Rt, Rsm in µm, Rsk, Rku, Rdq.
        spread: standard deviation of each between the lines.
    """

    direction: Direction
    angle_deg: float
    lines: int
    length_um: float
    sections: int
    s_filter_um: float | None
    l_filter_um: float | None
    s_filter: Smoothing
    l_filter: Smoothing
    values: dict[str, float]
    spread: dict[str, float]


@by_keywords(filtering=Filtering)
def line_parameters(
    surface: HeightMap, direction: Direction = "across", *, filtering: Filtering
) -> LineParameters:
    """Profile parameters on parallel lines of a map, at most 256 of them, evenly spread.

    Args:
        surface: the map, (rows, cols) in µm; missing points stay out of everything.
        direction: "x" or "y", or "across" or "along" the ridges: the map is turned by linear interpolation then.
        filtering: form (:func:`.forms.fit_form`) and filters along the lines, or the fields as keywords.

    Raises:
        HeightMapError: no ridges for "across" or "along", a nesting index that a line cannot hold, or too few points.
        UsageError: an unknown direction or kind of filter.
    """
    if direction not in ("across", "along", "x", "y"):
        raise UsageError(f"lines run across, along, x or y, not {direction!r}")
    s_filter_um, l_filter_um = filtering.s_filter_um, filtering.l_filter_um
    surface = surface.measured()
    turn = _turn(surface, direction)
    flat = surface.with_height(without_form(surface, filtering.form))
    if abs(turn) > STRAIGHT_DEG:
        flat = edit_map(flat, [{"step": "rotate", "angle": -turn}])
    if s_filter_um is not None:
        flat = flat.with_height(mean_surface(flat, s_filter_um, filtering.s_filter, direction="x"))
    if l_filter_um is not None:
        if s_filter_um is not None and s_filter_um >= l_filter_um:
            raise HeightMapError(
                f"the S-filter ({s_filter_um:g} µm) must be below the L-filter ({l_filter_um:g} µm)"
            )
        flat = flat.with_height(
            flat.height_um - mean_surface(flat, l_filter_um, filtering.l_filter, direction="x")
        )
    rows = np.unique(
        np.linspace(0, flat.shape[0] - 1, min(flat.shape[0], MOST_LINES)).round().astype(np.intp)
    )
    length = flat.shape[1] * flat.pixel_x_um
    sections = SECTIONS if l_filter_um is None else max(1, int(length / l_filter_um + 1e-9))
    found = [profile_parameters(flat.height_um[row], flat.pixel_x_um, sections) for row in rows]
    found = [one for one in found if one]
    if not found:
        raise HeightMapError(
            f"no line has {LEAST_POINTS} measured points; fill gaps, or take another direction"
        )
    table = {name: np.array([one[name] for one in found]) for name in found[0]}
    values, spread = {}, {}
    for name, column in table.items():
        known = column[np.isfinite(column)]
        values[name] = float(known.mean()) if known.size else float("nan")
        spread[name] = float(known.std(ddof=1)) if known.size > 1 else float("nan")
    return LineParameters(
        direction, turn, len(found), length, sections, s_filter_um, l_filter_um, filtering.s_filter, filtering.l_filter,
        values, spread,
    )  # fmt: skip


def _turn(surface: HeightMap, direction: Direction) -> float:
    """Angle of the lines, counter-clockwise from +x, in degrees."""
    if direction in ("x", "y"):
        return 0.0 if direction == "x" else 90.0
    period = find_period(surface)
    if not period.is_periodic:
        raise HeightMapError(
            f"no ridges found (periodicity {period.score:.2f}): take lines along x or y instead of {direction}"
        )
    return period.direction_deg if direction == "across" else period.direction_deg + 90.0


def profile_parameters(height_um: FloatArray, pixel_um: float, sections: int = SECTIONS) -> dict[str, float]:
    """Profile parameters of one line about its mean; empty with fewer than 20 measured points.

    Args:
        height_um: (n,) heights at even distances, NaN where missing.
        pixel_um: distance of the points.
        sections: number of equal sections for Rz, Rp, Rv.
    """
    known = np.isfinite(height_um)
    if np.count_nonzero(known) < LEAST_POINTS:
        return {}
    z = height_um - float(np.mean(height_um[known]))
    values = z[known]
    rq = float(np.sqrt(np.mean(values**2)))
    peaks, pits = _sections(z, sections)
    rz = float(np.mean(peaks + pits)) if peaks.size else float("nan")
    slope = np.convolve(z, SLOPE[::-1], mode="valid") / pixel_um
    slope = slope[np.isfinite(slope)]
    flat = rq <= 1e-12 * max(float(np.max(np.abs(height_um[known]))), 1e-12)
    return {
        "Ra": float(np.mean(np.abs(values))),
        "Rq": rq,
        "Rz": rz,
        "Rz_hills": _by_hills(z, sections),
        "Rp": float(np.mean(peaks)) if peaks.size else float("nan"),
        "Rv": float(np.mean(pits)) if pits.size else float("nan"),
        "Rt": float(values.max() - values.min()),
        "Rsk": float("nan") if flat else float(np.mean(values**3)) / rq**3,
        "Rku": float("nan") if flat else float(np.mean(values**4)) / rq**4,
        "Rdq": float(np.sqrt(np.mean(slope**2))) if slope.size else float("nan"),
        "Rsm": float("nan") if flat else mean_spacing(z, pixel_um, DISCRIMINATION * rz),
    }


def _sections(z: FloatArray, count: int) -> tuple[FloatArray, FloatArray]:
    """Highest peak and deepest pit of every section that is at least half measured."""
    size = z.size // count
    if size < 2:
        return np.empty(0), np.empty(0)
    parts = z[: size * count].reshape(count, size)
    parts = parts[np.mean(np.isfinite(parts), axis=1) >= 0.5]
    if not len(parts):
        return np.empty(0), np.empty(0)
    return np.nanmax(parts, axis=1), -np.nanmin(parts, axis=1)


def _by_hills(z: FloatArray, count: int) -> float:
    """Mean over sections of the highest hill and the deepest dale whose extreme points lie there.

    A hill is a part of the line above its mean, a dale one below; gaps part them. A flank that reaches into the next
    section does not count there. Sections without a hill, or without a dale, stay out of the mean.
    """
    size = z.size // count
    if size < 2:
        return float("nan")
    side = np.sign(np.nan_to_num(z[: size * count]))
    starts = np.concatenate([[0], np.flatnonzero(np.diff(side)) + 1])
    height = np.abs(np.nan_to_num(z[: size * count]))
    most = np.maximum.reduceat(height, starts)
    part = np.repeat(np.arange(starts.size), np.diff(starts, append=side.size))
    at = np.flatnonzero(height == most[part])
    section = at[np.unique(part[at], return_index=True)[1]] // size
    total = 0.0
    for way in (1.0, -1.0):
        found, these = np.full(count, -np.inf), side[starts] == way
        np.maximum.at(found, section[these], most[these])
        known = found[np.isfinite(found)]
        total += float(np.mean(known)) if known.size else float("nan")
    return total


def mean_spacing(z: FloatArray, pixel_um: float, discrimination_um: float) -> float:
    """Rsm: mean width of the profile elements in µm; NaN with less than one whole element.

    An element is a peak and a pit that reach beyond the mean line by the vertical discrimination (10 % of Rz). Where
    the line crosses the mean line between them several times, the middle of first and last crossing counts. Gaps are
    bridged by straight lines.
    """
    known = np.isfinite(z)
    x = np.flatnonzero(known).astype(np.float64)
    values = z[known]
    side = np.where(values > discrimination_um, 1, np.where(values < -discrimination_um, -1, 0))
    clear = np.flatnonzero(side)
    turns = np.flatnonzero(np.diff(side[clear]))
    places, signs = [], []
    for k in turns:
        first, last = clear[k], clear[k + 1]
        part = values[first : last + 1]
        at = np.flatnonzero(np.signbit(part[1:]) != np.signbit(part[:-1]))
        crossing = [
            x[first + n] + (x[first + n + 1] - x[first + n]) * part[n] / (part[n] - part[n + 1])
            for n in (at[0], at[-1])
        ]
        places.append(0.5 * (crossing[0] + crossing[1]))
        signs.append(side[last])
    widths = [
        np.diff([place for place, sign in zip(places, signs, strict=True) if sign == wanted])
        for wanted in (1, -1)
    ]
    every = np.concatenate(widths) if places else np.empty(0)
    return float(every.mean()) * pixel_um if every.size else float("nan")
