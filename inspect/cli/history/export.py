"""``anisoscope export``: past inspections in files for other programs, and signed bundles."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from anisoscope.base.errors import UsageError
from anisoscope.cli.history.history import write_line
from anisoscope.cli.history.options import ALL, DEFAULT_OUT, Place, Selection, Which, opened


def export(
    *,
    which: Selection = ALL,
    csv: Annotated[Path | None, Parameter(name="--csv-file", help="Write a table (CSV, UTF-8).")] = None,
    values: Annotated[
        Path | None,
        Parameter(
            name="--values-file",
            help="Write a CSV of fixed columns: a line for each number, units in line 2.",
        ),
    ] = None,
    json: Annotated[Path | None, Parameter(name="--json-file", help="Write JSON.")] = None,
    junit: Annotated[
        Path | None, Parameter(help="Write JUnit XML, for servers of continuous integration.")
    ] = None,
    aqdef: Annotated[
        Path | None,
        Parameter(help="Write AQDEF of one product and recipe: *.dfq, or *.dfd with *.dfx next to it."),
    ] = None,
    bundle: Annotated[
        Path | None,
        Parameter(
            help="Write the signed inspection that --serial names, with its place in the history (ZIP)."
        ),
    ] = None,
    limit: Annotated[int, Parameter(help="At most so many, the latest ones; 0 for all.")] = 0,
    place: Place = None,
) -> int:
    """Export past inspections as CSV, JSON, JUnit or AQDEF; the filters are those of `history`.

    A bundle is verified without anisoscope, by docs/verify_bundle.py.

    Examples:
        anisoscope export --csv-file week.csv --since 7d
        anisoscope export --aqdef week.dfq --product plate --since 7d
        anisoscope export --bundle A1.zip --serial A1
    """
    from anisoscope.history.export import csv_lines, json_lines, junit_lines, value_lines, write_lines

    files = [path for path in (csv, values, json, junit) if path is not None]
    if bundle is not None:
        _bundled(bundle, which.serial, place)
    if aqdef is not None:
        _aqdef(aqdef, which, limit, place)
    if not files and bundle is None and aqdef is None:
        raise UsageError(
            "name a file: --csv-file, --values-file, --json-file, --junit, --aqdef or --bundle FILE"
        )
    if not files:
        return 0
    with opened(place) as found, found.selection(which.filters(limit)) as selected:
        if csv is not None:
            write_lines(csv, csv_lines(selected.decided(), selected.labels()))
        if values is not None:
            write_lines(values, value_lines(selected.decided()))
        if json is not None:
            write_lines(json, json_lines(selected.decided()))
        verdicts = selected.verdicts()
        if junit is not None:
            write_lines(junit, junit_lines(verdicts, selected.decided))
    count = sum(sum(one.values()) for one in verdicts.values())
    for path in files:
        write_line(f"{count} inspections: {path}")
    return 0


def _aqdef(path: Path, which: Which, limit: int, place: str | None) -> None:
    """Write measured values, limits and catalogues of one product and recipe; the oldest first."""
    from datetime import UTC, datetime

    from anisoscope.base.atomic_write import write_bytes
    from anisoscope.history.address import chosen
    from anisoscope.history.aqdef import TIME, AqdefFile, description_lines, encoded, value_lines
    from anisoscope.quality.capability import specification
    from anisoscope.quality.readings import history_readings

    if path.suffix.lower() not in (".dfq", ".dfd"):
        raise UsageError(f"--aqdef {path}: name a file *.dfq, or *.dfd for a description and values apart")
    where = chosen(place, DEFAULT_OUT)
    if where is None:
        raise UsageError("name the history: --history PLACE")
    readings = history_readings(where, which.filters(limit))
    kinds = sorted(set(readings.column("recipe")))
    if len(kinds) > 1:
        raise UsageError(
            f"{readings.source}: {len(kinds)} recipes ({', '.join(kinds[:3])} …): an AQDEF file holds one, choose it "
            "with --recipe"
        )
    times = [datetime.fromisoformat(one).replace(tzinfo=UTC).astimezone() for one in readings.column("time")]
    texts = dict(readings.texts) | {"time": tuple(f"{one:{TIME}}" for one in times)}
    pairs = {}
    for name in readings.numbers:
        try:
            found = specification(readings, name)
        except UsageError:  # predicted or tolerated differently: no one pair of limits holds
            found = None
        if found is not None:
            pairs[name] = (found.lower, found.upper)
    middle = {
        name: 0.5 * (low + high)
        for name, (low, high) in pairs.items()
        if low is not None and high is not None
    }
    content = AqdefFile(readings.column("product")[0], texts, readings.numbers, pairs, middle)
    values = path.with_suffix(".DFX" if path.suffix.isupper() else ".dfx")
    if path.suffix.lower() == ".dfq":
        write_bytes(path, encoded((*description_lines(content), *value_lines(content))))
    else:
        write_bytes(values, encoded(value_lines(content)))
        write_bytes(path, encoded(description_lines(content)))
    write_line(f"{len(readings)} inspections: {path}")


def _bundled(path: Path, name: str | None, place: str | None) -> None:
    """Write the files of an inspection, and the rows from it to a signed head, into a ZIP file."""
    import json
    import zipfile

    from anisoscope.base.atomic_write import appearing
    from anisoscope.base.errors import RecordError
    from anisoscope.history.heads import rows_to_head
    from anisoscope.history.rows import seal_of
    from anisoscope.history.store import find
    from anisoscope.inspection.folder import files_in
    from anisoscope.inspection.integrity import verify as hashed

    if name is None:
        raise UsageError("--bundle takes one inspection: name it with --serial, or its id as --serial id:7")
    with opened(place) as found:
        row = find(found, name)
        folder = Path(row.folder)
        state = hashed(folder)
        if not state.intact or state.signed_by is None or seal_of(folder) != row.seal:
            wrong = "its record is not signed" if state.intact and state.signed_by is None else "was changed"
            raise RecordError(
                f"{folder}: {wrong}: a bundle would prove nothing; `anisoscope verify {folder}` says more"
            )
        rows, head = rows_to_head(found, row.id)
    with (
        appearing(path) as stream,
        zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as bundle,
    ):
        for file in sorted(files_in(folder)):
            bundle.write(folder / file, file)
        bundle.writestr("history.json", json.dumps({"rows": rows, "head": head}, indent=1))
    write_line(f"inspection {row.id} of {row.serial}: {path}")
