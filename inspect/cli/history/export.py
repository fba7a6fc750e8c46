"""``anisoscope export``: past inspections in files for other programs, and signed bundles."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from anisoscope.base.errors import UsageError
from anisoscope.cli.history.history import write_line
from anisoscope.cli.history.options import ALL, Place, Selection, filters_of, meant, opened
from anisoscope.parameters.exporting import ExportFiles
from anisoscope.views.options import Given, Options, with_options


@with_options(
    files=Options(
        ExportFiles,
        names={"csv": "--csv-file", "values": "--values-file", "json": "--json-file"},
        whole=True,
    )
)
def export(
    *,
    which: Selection = ALL,
    files: Given[ExportFiles],
    aqdef: Path | None = None,
    bundle: Path | None = None,
    limit: Annotated[int, Parameter(help="At most so many, the latest ones; 0 for all.")] = 0,
    place: Place = None,
) -> int:
    """Export past inspections as CSV, JSON, JUnit or AQDEF; the filters are those of `history`.

    Rows are compared with the records in their folders, as far as those are here; where one was rewritten the command
    says which and ends with 1. A bundle is verified without anisoscope, by docs/verify_bundle.py.

    Args:
        aqdef: Write AQDEF of one product and recipe: *.dfq, or *.dfd with *.dfx next to it.
        bundle: Write the signed inspection that --serial names, with its place in the history (ZIP).

    Examples:
        anisoscope export --csv-file week.csv --since 7d
        anisoscope export --aqdef week.dfq --product plate --since 7d
        anisoscope export --bundle A1.zip --serial A1
    """
    from anisoscope.operations.past import bundle as bundled
    from anisoscope.operations.past import export_aqdef, export_history, unlike_records

    asked = files.made()
    if not asked.named and bundle is None and aqdef is None:
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
    if not asked.named and aqdef is None:
        return 0
    with opened(place) as found:
        count = export_history(found, filters, files=asked) if asked.named else 0
        wrong = unlike_records(found, filters)
    for path in asked.named:
        write_line(f"{count} inspections: {path}")
    for line in wrong:
        write_line(line)
    return 1 if wrong else 0
