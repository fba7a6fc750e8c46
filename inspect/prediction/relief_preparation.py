"""Preparation of a height map for prediction: levelling, period, facets."""

from typing import Any, Literal

import numpy as np

from anisoscope.base.errors import HeightMapError
from anisoscope.profiles.heightmap import HeightMap, sealed
from anisoscope.profiles.level import level
from anisoscope.profiles.period import Period, find_period, take_over_period
from anisoscope.sim.light.census import Facets
from anisoscope.sim.light.relief import MAX_MISSING_SHARE, Relief

Levelling = Literal["auto", "plane", "none"]

ALONG_GRID_DEG = 0.1  # directions of ridges are not measured better on small maps
ONE_SIDED = 0.1  # share of points by which more must fall than rise, for facets that lean to one side
LEAN_LAG = 0.125  # of the pitch
PITCH_TOLERANCE = 0.03
MIN_PIXELS_A_PITCH = 12.0


def prepare_relief(
    surface: HeightMap,
    pitch_um: float | None = None,
    levelling: Levelling = "auto",
    max_missing_share: float = MAX_MISSING_SHARE,
    facets: Facets = "symmetric",
    *,
    placed: bool = True,
) -> tuple[Relief, Period]:
    """Level a measured map, find its period and place it in the sample frame, so that it can be predicted.

    In the sample frame the large facets lean toward +x, wherever they lean on the grid of the map: their azimuth is
    measured, the map turned by whole quarter turns, and directions to light and camera by what is left.

    Args:
        surface: the map as read.
        pitch_um: pitch along x, where it is known; for maps of fewer than four ridges it must be.
        levelling: "auto": by points whole pitches apart where ridges are known or found, else not at all,
            because a least-squares plane would turn a few ridges; "plane": by a least-squares plane; "none".
        max_missing_share: share of missing facets above which the map is refused.
        facets: how four points become facets (`sim.light.relief.Relief`).
        placed: False takes the axes of the map for those of the sample, as pictures of the map do.

    Returns:
        The relief, and the period on the grid of the map as read. Means run over whole pitches along x, unless ridges
        of a map that is not placed run nearly along x; then over the whole map. The lobe's frame follows the ridges.

    Raises:
        HeightMapError: too much of the map is missing, it is narrower than ``pitch_um``, or the ridges found are
            not those of ``pitch_um``.
    """
    if pitch_um is not None and not 0.0 < pitch_um < float("inf"):
        raise HeightMapError(f"the pitch must be a positive number of µm, not {pitch_um:g}")
    period = find_period(surface)
    if pitch_um is not None:
        if not period.is_periodic:
            period = Period(pitch_um, 0.0, period.score, True)
        elif abs(period.pitch_um / pitch_um - 1.0) > PITCH_TOLERANCE:
            raise HeightMapError(
                f"the ridges of this height map are {period.pitch_um:.2f} µm apart, not {pitch_um:g} µm: "
                "is this the map of another product, or its pixel size wrong?"
            )
    if levelling == "none" or (levelling == "auto" and not period.is_periodic):
        prepared = surface.with_height(surface.height_um - np.nanmean(surface.height_um))
    else:
        none = Period(float("nan"), float("nan"), 0.0, False)
        prepared = level(surface, none if levelling == "plane" else period).map
    lean = facet_azimuth(prepared, period) if period.is_periodic else 0.0
    quarters = round(lean / 90.0) if placed else 0
    prepared, lean = turned_clockwise(prepared, quarters), lean - 90.0 * quarters
    take_over_period(prepared, surface, quarters)
    width = (prepared.shape[1] - 1) * prepared.pixel_x_um
    if pitch_um is not None and pitch_um > width * (1.0 + 1e-6):
        raise HeightMapError(
            f"the height map is {width:g} µm wide, less than one pitch of {pitch_um:g} µm: "
            "a prediction needs at least one whole ridge"
        )
    if not period.is_periodic:
        return Relief(prepared, None, max_missing_share, facets), period
    stretch = abs(float(np.cos(np.radians(lean))))  # along x ridges repeat after the pitch over this
    repeat = period.pitch_um / stretch if stretch > 0.1 else float("inf")
    pitch = min(repeat, width) if repeat <= width * (1.0 + 1e-6) else None
    direction = (lean + 90.0) % 180.0 - 90.0
    return Relief(prepared, pitch, max_missing_share, facets, direction, lean if placed else 0.0), period


def facet_azimuth(surface: HeightMap, period: Period) -> float:
    """Azimuth on the map toward which the large facets fall, counter-clockwise from +x, within (−180, 180].

    Where neither flank of the ridges is clearly the larger one it is the one within 90° of +x. Ridges within 0.1° of an
    axis of the grid run along it.
    """
    across = period.direction_deg
    quarter = 90.0 * round(across / 90.0)
    if abs(across - quarter) < ALONG_GRID_DEG:
        across = quarter
    ex, ey = period.across()
    lag = LEAN_LAG * period.pitch_um
    right, up = round(lag * ex / surface.pixel_x_um), round(lag * ey / surface.pixel_y_um)
    height, (rows, cols) = surface.height_um, surface.shape
    if right == up == 0 or abs(right) >= cols or abs(up) >= rows:
        return across
    here, there = (
        height[
            max(sign * up, 0) : rows + min(sign * up, 0), max(sign * right, 0) : cols + min(sign * right, 0)
        ]
        for sign in (-1, 1)
    )
    falling, rising = float(np.mean(there < here)), float(np.mean(there > here))  # false where NaN
    if rising - falling <= ONE_SIDED * (rising + falling):
        return across
    return across - 180.0 if across > 0.0 else across + 180.0


def turned_clockwise(surface: HeightMap, quarters: int) -> HeightMap:
    """The map turned clockwise by quarter turns, as seen with y up."""
    if quarters % 4 == 0:
        return surface
    turned = sealed(np.ascontiguousarray(np.rot90(surface.height_um, quarters)))  # rows rise with y
    pixels = surface.pixel_x_um, surface.pixel_y_um
    x, y = pixels if quarters % 2 == 0 else pixels[::-1]
    return HeightMap(turned, x, y, surface.origin | {"turned_deg": -90.0 * quarters})


def azimuth_on_map(relief: Relief) -> float:
    """Azimuth on the map as read toward which its facets lean, by which a placed map is turned; within (−180, 180]."""
    turned = float(relief.surface.origin.get("turned_deg", 0.0))
    return 180.0 - (180.0 - relief.turn_deg + turned) % 360.0


def map_notes(relief: Relief, period: Period) -> dict[str, Any]:
    """Notes on the map of a prediction."""
    notes: dict[str, Any] = {"missing_share": relief.missing_share}
    done = relief.surface.origin.get("levelling")
    notes["levelling"] = done["method"] if isinstance(done, dict) else "none"
    if relief.pitch_um is not None and relief.pitch_um < MIN_PIXELS_A_PITCH * relief.surface.pixel_x_um:
        notes["pixel_warning"] = (
            f"{relief.pitch_um / relief.surface.pixel_x_um:.1f} pixels a pitch; with fewer than "
            f"{MIN_PIXELS_A_PITCH:g} the prediction may be off by more than its uncertainty"
        )
    if period.is_periodic:
        notes["pitch_um"] = period.pitch_um
        notes["ridge_direction_deg"] = period.direction_deg
        notes["facet_azimuth_on_map_deg"] = azimuth_on_map(relief)
    else:
        notes["warning"] = (
            "no ridges found (at least four are needed): the mean runs over the whole map"
            + ("" if isinstance(done, dict) else ", heights are taken as level")
            + "; --pitch or --level plane say otherwise"
        )
    return notes
