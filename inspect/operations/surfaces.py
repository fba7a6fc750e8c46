"""Ideal surfaces, smooth or with Gaussian roughness."""

from typing import Literal

import numpy as np

from anisoscope.base.errors import UsageError
from anisoscope.parameters.keywords import by_keywords
from anisoscope.parameters.patterns import Grid, Lines, Rough, Stairs
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.profiles import patterns
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.profiles.ideal import add_facet_roughness

Pattern = Literal["ridges", "v-grooves", "checkerboard", "flat", "staircase"]
USUAL = RidgeDesign(100.0, 10.0)


@by_keywords(grid=Grid, lines=Lines, stairs=Stairs, rough=Rough)
def make_surface(
    pattern: Pattern,
    design: RidgeDesign = USUAL,
    *,
    grid: Grid,
    lines: Lines,
    stairs: Stairs,
    rough: Rough,
    seed: int = 0,
) -> HeightMap:
    """Make an ideal surface, smooth or with Gaussian roughness.

    Args:
        pattern: "ridges", "v-grooves", "checkerboard", "flat" or "staircase".
        design: shape of ridges; pitch of grooves.
        grid: field and pixel, or its fields as keywords.
        lines: place and direction of ridges and grooves, or its fields as keywords.
        stairs: of a staircase, or its fields as keywords.
        rough: roughness along and across the ridges, or its fields as keywords.
        seed: of everything random.

    Returns:
        The map; design and seed are ``made`` of its origin.

    Raises:
        UsageError: a negative seed, or too many points.
        HeightMapError: a number outside its range.
    """
    if seed < 0:
        raise UsageError(f"--seed takes a whole number from 0, not {seed}")
    rng = np.random.default_rng(seed)
    surface = _pattern(pattern, design, grid, lines, stairs, rng)
    roughness = rough.alpha_along, rough.alpha_across, rough.correlation_um, rng
    found = add_facet_roughness(surface, *roughness, 0.0 if pattern == "flat" else lines.lay_deg)
    if pattern == "checkerboard":  # each field along its own ridges
        second = add_facet_roughness(surface, *roughness, lines.second_lay_deg)
        fields = patterns.second_fields(grid.shape, grid.pixel_um, lines.square_um)
        found = found.with_height(np.where(fields, second.height_um, found.height_um))
    return found.with_height(found.height_um, made={**found.origin, "seed": seed})


def _pattern(
    pattern: Pattern, design: RidgeDesign, grid: Grid, lines: Lines, stairs: Stairs, rng: np.random.Generator
) -> HeightMap:
    field = grid.shape, grid.pixel_um
    if pattern == "flat":
        return patterns.flat(*field)
    if pattern == "staircase":
        if stairs.passes_nm is None:
            levels = patterns.even_levels(stairs.levels, 1e-3 * stairs.step_height_nm)
        else:
            levels = patterns.etched_levels([1e-3 * depth for depth in stairs.passes_nm])
        if stairs.random:
            both = (stairs.width_um, stairs.width_um)
            return patterns.random_steps(levels, *field, both, rng, spread=stairs.spread)
        return patterns.staircase(levels, *field, stairs.width_um, direction_deg=lines.lay_deg)
    if pattern == "checkerboard":
        both = (lines.lay_deg, lines.second_lay_deg)
        return patterns.checkerboard(design, *field, lines.square_um, directions_deg=both)
    if pattern == "v-grooves":
        grooves = patterns.GrooveDesign(design.pitch_um, lines.flank_deg, lines.land_um)
        return patterns.v_grooves(grooves, *field, direction_deg=lines.lay_deg, phase=lines.phase)
    return patterns.turned_ridges(design, *field, direction_deg=lines.lay_deg, phase=lines.phase)
