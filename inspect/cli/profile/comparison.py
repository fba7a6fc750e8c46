"""``anisoscope profile compare``: two maps of one part, or a tool and its part."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from anisoscope.base.errors import UsageError
from anisoscope.cli.json_output import fields_of, print_json
from anisoscope.cli.options import Json, parse_numbers
from anisoscope.cli.profile.profile import AS_STATED, Scales
from anisoscope.cli.progress import progress
from anisoscope.cli.tables import print_table

if TYPE_CHECKING:
    from anisoscope.profiles.comparison import Comparison


def compare(
    first: Path,
    second: Path,
    /,
    *,
    mirrored: Annotated[
        bool,
        Parameter(
            negative="", help="A tool and its part: negate the second map and mirror it along x first."
        ),
    ] = False,
    out: Annotated[Path | None, Parameter(help="HTML page to write.")] = None,
    difference: Annotated[
        Path | None, Parameter(help="File for the difference map B − A, such as *.x3p.")
    ] = None,
    line: Annotated[
        str | None,
        Parameter(help="Line of the page: X0,Y0,X1,Y1 in µm from the first point of the first map."),
    ] = None,
    overwrite: Annotated[bool, Parameter(negative="", help="Replace files that exist.")] = False,
    json_: Json = False,
    scales: Annotated[Scales, Parameter(name="*")] = AS_STATED,
) -> int:
    """Register the second map on the first: difference, wear volume, ridges, degree of replication.

    Args:
        first: Map A: before wear, or the tool.
        second: Map B: after wear, or the part.
    """
    from anisoscope.profiles.comparison import compare_maps
    from anisoscope.profiles.files.load import WRITERS, write_height_map
    from anisoscope.report.comparison_page import write_comparison_page

    ends = None if line is None else parse_numbers(line, "--line", "0,50,400,50")
    if ends is not None and len(ends) != 4:
        raise UsageError(f"--line takes X0,Y0,X1,Y1 in µm, not {line!r}")
    if out is not None and out.suffix.lower() not in (".html", ".htm"):
        raise UsageError(f"--out {out}: a page is named *.html")
    if difference is not None and difference.suffix.lower() not in WRITERS:
        raise UsageError(f"--difference {difference}: unknown extension; written are {', '.join(WRITERS)}")
    for target in (out, difference):
        if target is not None and target.exists() and not overwrite:
            raise UsageError(f"{target} exists; give another name, or --overwrite")
    with progress(f"{first.name}, {second.name}") as advance:
        advance("reading", 0, 3)
        maps = scales.read(first), scales.read(second)
        advance("registering", 1, 3)
        found = compare_maps(*maps, mirrored=mirrored)
        advance("writing", 2, 3)
        if difference is not None:
            write_height_map(found.difference, difference)
        if out is not None:
            shown = None if ends is None else (ends[0], ends[1], ends[2], ends[3])
            write_comparison_page(found, (first.name, second.name), out, shown)
    if json_:
        print_json(_as_json(found, first, second))
    else:
        _print(found, first, second, out)
    return 0


def _as_json(found: "Comparison", first: Path, second: Path) -> dict[str, Any]:
    from anisoscope.report.comparison_page import comparison_notes

    return {
        "first": first,
        "second": second,
        "placed": {**fields_of(found.placed), "scale_agrees": found.placed.scale_agrees},
        "mirrored": found.mirrored,
        "lost": found.lost,
        "gained": found.gained,
        "net_um3": found.net_um3,
        "replication": found.replication,
        "ridges": found.ridges,
        "ridges_note": found.ridges_note,
        "notes": comparison_notes(found),
    }


def _print(found: "Comparison", first: Path, second: Path, out: Path | None) -> None:
    from anisoscope.profiles.metrology.quantity import as_text
    from anisoscope.report.comparison_page import RIDGE_COLUMNS, comparison_notes, comparison_numbers

    print_table(
        f"{second.name} against {first.name}",
        ["quantity", "value", "u (k = 1)", "unit"],
        comparison_numbers(found),
        caption="\n".join(comparison_notes(found)) or None,
    )
    if found.ridges:
        rows = [
            [
                str(one.number),
                f"{one.position_um:.1f}",
                *(as_text(getattr(one, key))[0] for _, key in RIDGE_COLUMNS),
            ]
            for one in found.ridges
        ]
        print_table("ridges", ["ridge", "position [µm]", *(text for text, _ in RIDGE_COLUMNS)], rows)
    if out is not None:
        sys.stdout.write(f"{out}\n")
