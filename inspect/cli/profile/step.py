"""``anisoscope profile step``: height of a step or depth of a groove after ISO 5436-1."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from anisoscope.cli.json_output import fields_of, print_json
from anisoscope.cli.options import Json, parse_numbers
from anisoscope.cli.profile.many import NONE, ManyOptions, Values, check_table, measure_each, print_sheet
from anisoscope.cli.profile.profile import AS_STATED, Scales
from anisoscope.cli.tables import print_lines

if TYPE_CHECKING:
    from anisoscope.profiles.metrology.stepheight import StepHeight


def step(
    *files: Path,
    along: Annotated[Literal["x", "y"], Parameter(help="Axis of the lines, across the step.")] = "x",
    edges: Annotated[
        str | None,
        Parameter(help="Edge of a step, or both of a groove, in µm from the first point; else found."),
    ] = None,
    json_: Json = False,
    many: Annotated[ManyOptions, Parameter(name="*", group="Several files")] = NONE,
    scales: Annotated[Scales, Parameter(name="*")] = AS_STATED,
) -> int:
    """Height of a step, or depth of a groove, on every line of height maps (ISO 5436-1, types A1 and A2).

    Args:
        files: Height maps in a format of docs/height-maps.md, or patterns.

    Examples:
        anisoscope profile step groove.x3p
        anisoscope profile step 'lot/*.x3p' --along y --edges 40,90 --table depths.csv
    """
    from anisoscope.operations.map_series import expanded
    from anisoscope.profiles.limits import sheet_of
    from anisoscope.profiles.metrology.stepheight import step_height

    places = () if edges is None else parse_numbers(edges, "--edges", "40,90", "um")

    def measure(path: Path) -> "StepHeight":
        return step_height(scales.read(path), along, places)

    chosen = expanded(files)
    if len(chosen) > 1 or many.table is not None:
        return measure_each(chosen, lambda path: _values(measure(path)), many, to_json=json_)
    check_table(many)
    found = measure(chosen[0])
    sheet = sheet_of(many.limits, _values(found))
    if json_:
        print_json({**fields_of(found), "sheet": sheet} if sheet else found)
    else:
        at = " and ".join(f"{one:.4g}" for one in found.edges_um)
        print_lines(
            f"{chosen[0].name}: height of the {found.kind} {found.height_um:.5g} ± {2.0 * found.u_um:.2g} µm (k = 2, "
            f"scatter of {found.lines} lines; that of the height scale is not in it)",
            f"edges at {at} µm along {along}, width {found.width_um:.4g} µm, tilt {found.slope_deg:+.3f}°",
        )
    return print_sheet(sheet, silent=json_)


def _values(found: "StepHeight") -> Values:
    return {
        "step height": (found.height_um, "µm"),
        "u of the step height": (found.u_um, "µm"),
        "width": (found.width_um, "µm"),
    }
