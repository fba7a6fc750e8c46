"""``anisoscope profile make`` and ``profile spoil``: ideal surfaces, and defects of known extent."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Group, Parameter

from anisoscope.base.errors import UsageError
from anisoscope.base.quantity import unit_of
from anisoscope.cli.options import LENGTH, OF_RIDGES, Json, check_map, check_new, number, parse_pixel
from anisoscope.cli.profile.profile import AS_STATED, Scales, reader
from anisoscope.cli.profile.surfaces_output import deliver, list_defects
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.views.options import Given, parse_numbers, quantity, with_options

if TYPE_CHECKING:
    from anisoscope.profiles.heightmap import HeightMap

Pattern = Literal["ridges", "v-grooves", "checkerboard", "flat", "staircase"]
MAX_POINTS = 100_000_000
USUAL = RidgeDesign(100.0, 10.0)


@Parameter(name="*")
@dataclass(frozen=True)
class LineOptions:
    """Where ridges, alone or on a checkerboard, and V-grooves lie, and the shape of grooves."""

    lay: Annotated[
        float, Parameter(help="Direction of ridges or grooves in degrees, counter-clockwise from +y.")
    ] = 0.0
    phase: Annotated[float, Parameter(help="Place of the first crest or groove as a share of the pitch.")] = (
        0.0
    )
    second_lay: Annotated[
        float, Parameter(help="Direction of the ridges in every second square of a checkerboard.")
    ] = -90.0
    square: Annotated[float, LENGTH, Parameter(help="Side of a square of a checkerboard in µm.")] = 250.0
    flank: Annotated[float, Parameter(help="Slope of both flanks of V-grooves in degrees.")] = 45.0
    land: Annotated[float, LENGTH, Parameter(help="Flat land between V-grooves in µm.")] = 0.0


@Parameter(name="*")
@dataclass(frozen=True)
class StairOptions:
    """Staircases.

    Attributes:
        step_height: Height between two levels in nm.
        passes: Depths of etch passes in nm, comma-separated: 2ⁿ levels instead of --levels.
        width: Width of a step in µm, the least width if --random.
        random: Rectangles of random width and level instead of stairs.
    """

    levels: Annotated[int, Parameter(help="Number of levels, evenly spaced.")] = 2
    step_height: Annotated[float, quantity("step_height_nm")] = 127.3
    passes: str | None = None
    width: Annotated[float, LENGTH] = 2.0
    random: Annotated[bool, Parameter(negative="")] = False
    spread: Annotated[float, Parameter(help="Widths of --random exceed the least by up to this share.")] = 1.0


@Parameter(name="*")
@dataclass(frozen=True)
class RoughOptions:
    """Gaussian roughness added along z."""

    alpha_along: Annotated[
        float,
        Parameter(help="Beckmann roughness along the ridges or grooves (along +y where there are none)."),
    ] = 0.0
    alpha_across: Annotated[float, Parameter(help="Beckmann roughness across the ridges or grooves.")] = 0.0
    correlation: Annotated[float, LENGTH, Parameter(help="Mean correlation length in µm.")] = 8.0


LINES, STAIRS, SMOOTH = LineOptions(), StairOptions(), RoughOptions()
OF_LINES = replace(
    OF_RIDGES,
    group=Group("Ridges and grooves"),
    help={"pitch_um": "Pitch of ridges or grooves in µm."},
)


@with_options(ridges=OF_LINES)
def make(
    pattern: Pattern,
    /,
    *,
    out: Path,
    size: Annotated[str, Parameter(help="Size of the field in µm: SIZE or Y,X.")] = "1000",
    pixel: Annotated[str, Parameter(help="Pixel size in µm: SIZE or Y,X.")] = "1",
    ridges: Given[RidgeDesign],
    lines: Annotated[LineOptions, Parameter(group="Ridges and grooves")] = LINES,
    stairs: Annotated[StairOptions, Parameter(group="Staircases")] = STAIRS,
    rough: Annotated[RoughOptions, Parameter(group="Roughness")] = SMOOTH,
    seed: Annotated[int, Parameter(help="Seed of everything random.")] = 0,
    overwrite: Annotated[bool, Parameter(negative="", help="Replace the file if it exists.")] = False,
    json_: Json = False,
) -> int:
    """Make an ideal surface, smooth or with Gaussian roughness.

    Args:
        pattern: What to make.
        out: File to write: x3p or npz (they keep design and seed), or another format.

    Examples:
        anisoscope profile make ridges --pitch 100 --ridge-angle 10 --out part.x3p
        anisoscope profile make ridges --size 300,600 --pitch 50 --alpha-along 0.04 --alpha-across 0.05 --out rough.x3p
    """
    import numpy as np

    from anisoscope.profiles.ideal import add_facet_roughness
    from anisoscope.profiles.patterns import second_fields

    check_map(out, "--out")
    check_new((out,), overwrite=overwrite)
    _check_seed(seed)
    rng = np.random.default_rng(seed)
    design = ridges.over(USUAL)
    surface = _pattern(pattern, *_grid(size, pixel), design, lines, stairs, rng)
    roughness = rough.alpha_along, rough.alpha_across, rough.correlation, rng
    first = add_facet_roughness(surface, *roughness, 0.0 if pattern == "flat" else lines.lay)
    if pattern == "checkerboard":  # each field along its own ridges
        second = add_facet_roughness(surface, *roughness, lines.second_lay)
        fields = second_fields(surface.shape, (surface.pixel_y_um, surface.pixel_x_um), lines.square)
        first = first.with_height(np.where(fields, second.height_um, first.height_um))
    surface = first
    origin = {**surface.origin, "seed": seed}
    return deliver(surface.with_height(surface.height_um, made=origin), out, as_json=json_)


def _grid(size: str, pixel: str) -> tuple[tuple[int, int], tuple[float, float]]:
    pixel_um = parse_pixel(pixel)
    field = parse_numbers(size, "--size", "300,600", "um")
    if len(field) not in (1, 2) or min(field) <= 0:
        raise UsageError(f"--size takes one or two positive numbers of µm, SIZE or Y,X, not {size!r}")
    rows, cols = (round(length / step) for length, step in zip((field[0], field[-1]), pixel_um, strict=True))
    if rows * cols > MAX_POINTS:
        raise UsageError(
            f"--size and --pixel give {rows} × {cols} points; at most {MAX_POINTS // 10**6} million"
        )
    return (rows, cols), pixel_um


def _pattern(
    pattern: Pattern,
    shape: tuple[int, int],
    pixel_um: tuple[float, float],
    design: RidgeDesign,
    lines: LineOptions,
    stairs: StairOptions,
    rng: Any,  # noqa: ANN401 - numpy is imported where it is needed
) -> "HeightMap":
    from anisoscope.profiles import patterns

    if pattern == "flat":
        return patterns.flat(shape, pixel_um)
    if pattern == "staircase":
        return _staircase(shape, pixel_um, stairs, lines.lay, rng)
    if pattern == "v-grooves":
        grooves = patterns.GrooveDesign(design.pitch_um, lines.flank, lines.land)
        return patterns.v_grooves(grooves, shape, pixel_um, direction_deg=lines.lay, phase=lines.phase)
    if pattern == "checkerboard":
        both = (lines.lay, lines.second_lay)
        return patterns.checkerboard(design, shape, pixel_um, lines.square, directions_deg=both)
    return patterns.turned_ridges(design, shape, pixel_um, direction_deg=lines.lay, phase=lines.phase)


def _staircase(
    shape: tuple[int, int],
    pixel_um: tuple[float, float],
    stairs: StairOptions,
    direction: float,
    rng: Any,  # noqa: ANN401 - numpy is imported where it is needed
) -> "HeightMap":
    from anisoscope.profiles import patterns

    if stairs.passes is None:
        levels = patterns.even_levels(stairs.levels, 1e-3 * stairs.step_height)
    else:
        levels = patterns.etched_levels(
            [1e-3 * depth for depth in parse_numbers(stairs.passes, "--passes", "127,254", "nm")]
        )
    if stairs.random:
        both = (stairs.width, stairs.width)
        return patterns.random_steps(levels, shape, pixel_um, both, rng, spread=stairs.spread)
    return patterns.staircase(levels, shape, pixel_um, stairs.width, direction_deg=direction)


def spoil(
    file: Path | None = None,
    defect: str | None = None,
    /,
    *,
    out: Path | None = None,
    severity: Annotated[float | None, Parameter(help="0 (none) to 1 (gross).")] = None,
    seed: Annotated[int, Parameter(help="Seed of everything random.")] = 0,
    list_: Annotated[bool, Parameter(name="--list", negative="", help="List the defects.")] = False,
    overwrite: Annotated[bool, Parameter(negative="", help="Replace the file if it exists.")] = False,
    json_: Json = False,
    scales: Scales = AS_STATED,
    **parameters: str,
) -> int:
    """Add a defect to a height map: by its severity, or by its dimensions.

    Args:
        file: Height map to spoil.
        defect: Name of the defect; see --list.
        parameters: Dimensions of the defect by name, such as --radius-um 5; see --list.
        out: File to write: x3p or npz (they keep what was done), ...

    Examples:
        anisoscope profile spoil part.x3p wear --severity 0.5 --out worn.x3p
        anisoscope profile spoil --list
    """
    import numpy as np

    from anisoscope.profiles import defect_injection

    if list_:
        return list_defects(as_json=json_)
    if file is None or defect is None or out is None:
        raise UsageError("spoil needs a height map, a defect and --out FILE; --list shows the defects")
    check_map(out, "--out")
    check_new((out,), overwrite=overwrite)
    _check_seed(seed)
    surface = reader(scales)(file)
    given = {
        (key := name.replace("-", "_")): number(text, f"--{name}", unit_of(key))
        for name, text in parameters.items()
    }
    spoiled = defect_injection.inject_defect(
        surface, defect, np.random.default_rng(seed), severity=severity, values=given, seed=seed
    )
    changed = spoiled.height_um - surface.height_um
    changed = changed[np.isfinite(changed)]
    deviation = {
        "rms_um": float(np.sqrt(np.mean(changed**2))),
        "highest_um": float(changed.max()),
        "lowest_um": float(changed.min()),
        "share_changed": float(np.mean(changed != 0.0)),
    }
    return deliver(spoiled, out, as_json=json_, deviation=deviation)


def _check_seed(seed: int) -> None:
    if seed < 0:
        raise UsageError(f"--seed takes a whole number from 0, not {seed}")
