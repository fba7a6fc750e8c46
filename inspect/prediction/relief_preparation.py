"""Preparation of a height map for prediction: levelling, period, facets."""

from typing import Any, Literal

import numpy as np

from anisoscope.base.errors import HeightMapError
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.profiles.level import level
from anisoscope.profiles.period import Period, find_period
from anisoscope.sim.light.census import Facets
from anisoscope.sim.light.relief import MAX_MISSING_SHARE, Relief

Levelling = Literal["auto", "plane", "none"]

AXIS_TOLERANCE_DEG = 1.0
PITCH_TOLERANCE = 0.03
MIN_PIXELS_A_PITCH = 12.0


def prepare_relief(
    surface: HeightMap,
    pitch_um: float | None = None,
    levelling: Levelling = "auto",
    max_missing_share: float = MAX_MISSING_SHARE,
    facets: Facets = "symmetric",
) -> tuple[Relief, Period]:
    """Level a measured map and find its period, so that it can be predicted.

    Args:
        surface: the map as read.
        pitch_um: pitch along x, where it is known; for maps of fewer than four ridges it must be.
        levelling: "auto": by points whole pitches apart where ridges are known or found, else not at all,
            because a least-squares plane would turn a few ridges; "plane": by a least-squares plane; "none".
        max_missing_share: share of missing facets above which the map is refused.
        facets: how four points become facets (`sim.light.relief.Relief`).

    Returns:
        The relief and the period. Means run over whole pitches along x, unless the ridges run nearly along x; then over
        the whole map. The lobe's frame follows the ridges where they run more than 1° from y.

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
    width = (surface.shape[1] - 1) * surface.pixel_x_um
    if pitch_um is not None and pitch_um > width * (1.0 + 1e-6):
        raise HeightMapError(
            f"the height map is {width:g} µm wide, less than one pitch of {pitch_um:g} µm: "
            "a prediction needs at least one whole ridge"
        )
    if not period.is_periodic:
        return Relief(prepared, None, max_missing_share, facets), period
    direction = period.direction_deg if abs(period.direction_deg) > AXIS_TOLERANCE_DEG else 0.0
    stretch = float(np.cos(np.radians(direction)))  # along x ridges repeat after the pitch over this
    repeat = period.pitch_um / stretch if stretch > 0.1 else float("inf")
    pitch = min(repeat, width) if repeat <= width * (1.0 + 1e-6) else None
    return Relief(prepared, pitch, max_missing_share, facets, direction), period


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
        if abs(period.direction_deg) > AXIS_TOLERANCE_DEG:
            notes["warning"] = (
                f"the ridges run {period.direction_deg:+.1f}° from the map's y axis: alpha along and across are taken "
                "along and across the ridges, but the facet azimuth is that of the map's x axis"
            )
    else:
        notes["warning"] = (
            "no ridges found (at least four are needed): the mean runs over the whole map"
            + ("" if isinstance(done, dict) else ", heights are taken as level")
            + "; --pitch or --level plane say otherwise"
        )
    return notes
