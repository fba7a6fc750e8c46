"""``anisoscope profile step``: height of a step or depth of a groove after ISO 5436-1."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from anisoscope.cli.options import HeightMaps, Json
from anisoscope.cli.profile.many import NONE, ManyOptions, Values, measure_maps
from anisoscope.cli.profile.profile import AS_STATED, Scales, reader
from anisoscope.cli.tables import print_lines
from anisoscope.views.options import parse_numbers

if TYPE_CHECKING:
    from anisoscope.profiles.metrology.stepheight import StepHeight


def step(
    *files: HeightMaps,
    along: Annotated[Literal["x", "y"], Parameter(help="Axis of the lines, across the step.")] = "x",
    edges: str | None = None,
    json_: Json = False,
    many: Annotated[ManyOptions, Parameter(name="*", group="Several files")] = NONE,
    scales: Scales = AS_STATED,
) -> int:
    """Height of a step, or depth of a groove, on every line of height maps (ISO 5436-1, types A1 and A2).

    Args:
        edges: Edge of a step, or both of a groove, in µm from the first point; else found.

    Examples:
        anisoscope profile step groove.x3p
        anisoscope profile step 'lot/*.x3p' --along y --edges 40,90 --table depths.csv
    """
    from anisoscope.profiles.metrology.stepheight import step_height

    places = () if edges is None else parse_numbers(edges, "--edges", "40,90", "um")

    def measure(path: Path) -> "StepHeight":
        return step_height(reader(scales)(path), along, places)

    def show(name: str, found: "StepHeight") -> None:
        at = " and ".join(f"{one:.4g}" for one in found.edges_um)
        print_lines(
            f"{name}: height of the {found.kind} {found.height_um:.5g} ± {2.0 * found.u_um:.2g} µm (k = 2, "
            f"scatter of {found.lines} lines; that of the height scale is not in it)",
            f"edges at {at} µm along {along}, width {found.width_um:.4g} µm, tilt {found.slope_deg:+.3f}°",
        )

    return measure_maps(files, many, measure, _values, show, to_json=json_)


def _values(found: "StepHeight") -> Values:
    return {
        "step height": (found.height_um, "µm"),
        "u of the step height": (found.u_um, "µm"),
        "width": (found.width_um, "µm"),
    }
