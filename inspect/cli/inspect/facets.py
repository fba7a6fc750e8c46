"""``anisoscope angle-map``: how far the facets of an inspected part lean, cell by cell."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from anisoscope.base.notation import true_minus
from anisoscope.cli.json_output import fields_of, print_json
from anisoscope.cli.options import Html, Json, check_suffix
from anisoscope.cli.progress import progress
from anisoscope.cli.tables import print_lines, print_table
from anisoscope.views.options import quantity

LISTED = 12


def angle_map(
    folder: Path,
    /,
    *,
    cell: Annotated[float, Parameter(help="Side of the cells in µm."), quantity("cell_um")] = 48.0,
    out: Annotated[list[Path] | None, Parameter(name=["--out", "-o"])] = None,
    html: Html = None,
    json_: Json = False,
) -> int:
    """Measure the angle of the facets of an inspected part from its photographs, cell by cell.

    Args:
        folder: Inspection folder of a part with ridges.
        out: File: cells as .csv or .npz, or as .x3p the form of the part; repeat for several.

    docs/angle-map.md says how sure the angles are.

    Examples:
        anisoscope angle-map inspections/A17-20261101T101500Z --html angles.html
        anisoscope angle-map inspections/A17-20261101T101500Z --cell 100um --out angles.csv --out form.x3p
    """
    from anisoscope.operations.facets import angle_map as map_of
    from anisoscope.operations.facets import check_angle_file, write_angle_map, write_angle_page
    from anisoscope.record.schema import read_record

    check_suffix(html, "--html", ".html", ".htm")
    for path in out or []:
        check_angle_file(path)
    record = read_record(folder)
    with progress("angle map") as advance:
        found = map_of(folder, cell_um=cell, on_progress=advance)
    for path in out or []:
        write_angle_map(found, path)
    design = record.recipe["surface"].get("design")
    nominal = None if design is None else float(design["ridge_angle_deg"])
    if html is not None:
        write_angle_page(found, record, html)
    kept = found.record()
    if json_:
        return print_json({**kept.model_dump(), "ridges": [fields_of(one) for one in found.by_ridge]})
    print_table(
        f"{record.serial}: the ridges that lean most from the others",
        ["ridge", "x [mm]", "y [mm]", "lean [°]", "U (k = 2) [°]", "spread of its cells [°]"],
        [
            [
                true_minus(f"{one.ridge:+d}" if one.ridge else "0"),
                *(true_minus(f"{round(place, 2) + 0.0:+.2f}") for place in (one.x_mm, one.y_mm)),
                f"{one.angle_deg:.2f}",
                f"{2 * one.u_deg:.2f}",
                f"{one.spread_deg:.2f}",
            ]
            for one in found.farthest[:LISTED]
        ],
    )
    designed = "" if nominal is None else f", designed {nominal:g}°"
    along = "" if kept.along_deg is None else f"; along the ridges {true_minus(f'{kept.along_deg:+.2f}')}°"
    print_lines(
        f"facets lean {kept.mean_deg:.2f}° ± {2 * kept.u_mean_deg:.2f}° (k = 2) across the ridges{designed}{along}",
        f"{kept.cells} cells of {kept.cell_um[0]:.0f} × {kept.cell_um[1]:.0f} µm differ by {kept.spread_deg:.2f}°, "
        f"each ± {2 * kept.u_cell_deg:.2f}° (k = 2); no facet seen in {kept.unseen_share:.1%} of them",
        f"roughness {kept.alpha:.2f} ± {2 * kept.u_alpha:.2f} (k = 2) times that of the recipe",
        *(f"written: {path}" for path in [*(out or []), *([html] if html else [])]),
    )
    return 0
