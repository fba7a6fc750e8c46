"""``anisoscope export``: past inspections in files for other programs, and signed bundles."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from anisoscope.base.errors import UsageError
from anisoscope.cli.history.history import write_line
from anisoscope.cli.history.options import ALL, Place, Selection, filters_of, meant, opened


def export(
    *,
    which: Selection = ALL,
    csv: Annotated[Path | None, Parameter(name="--csv-file", help="Write a table (CSV, UTF-8).")] = None,
    values: Annotated[Path | None, Parameter(name="--values-file")] = None,
    json: Annotated[Path | None, Parameter(name="--json-file", help="Write JSON.")] = None,
    junit: Path | None = None,
    aqdef: Path | None = None,
    bundle: Path | None = None,
    limit: Annotated[int, Parameter(help="At most so many, the latest ones; 0 for all.")] = 0,
    place: Place = None,
) -> int:
    """Export past inspections as CSV, JSON, JUnit or AQDEF; the filters are those of `history`.

    Rows are compared with the records in their folders, as far as those are here; where one was rewritten the command
    says which and ends with 1. A bundle is verified without anisoscope, by docs/verify_bundle.py.

    Args:
        junit: Write JUnit XML, for servers of continuous integration.
        aqdef: Write AQDEF of one product and recipe: *.dfq, or *.dfd with *.dfx next to it.
        bundle: Write the signed inspection that --serial names, with its place in the history (ZIP).
        values: Write a CSV of fixed columns: a line for each number, units in line 2.

    Examples:
        anisoscope export --csv-file week.csv --since 7d
        anisoscope export --aqdef week.dfq --product plate --since 7d
        anisoscope export --bundle A1.zip --serial A1
    """
    from anisoscope.operations.past import bundle as bundled
    from anisoscope.operations.past import export_aqdef, export_history, unlike_records

    files = [path for path in (csv, values, json, junit) if path is not None]
    if not files and bundle is None and aqdef is None:
        raise UsageError(
            "name a file: --csv-file, --values-file, --json-file, --junit, --aqdef or --bundle FILE"
        )
    if bundle is not None:
        if "serial" not in which:
            raise UsageError(
                "--bundle takes one inspection: name it with --serial, or its id as --serial id:7"
            )
        with opened(place) as found:
            row = bundled(found, which.values["serial"], bundle)
        write_line(f"inspection {row.id} of {row.serial}: {bundle}")
    filters = filters_of(which, limit)
    if aqdef is not None:
        write_line(f"{export_aqdef(meant(place), aqdef, filters)} inspections: {aqdef}")
    if not files and aqdef is None:
        return 0
    with opened(place) as found:
        count = export_history(found, filters, csv=csv, values=values, json=json, junit=junit) if files else 0
        wrong = unlike_records(found, filters)
    for path in files:
        write_line(f"{count} inspections: {path}")
    for line in wrong:
        write_line(line)
    return 1 if wrong else 0
