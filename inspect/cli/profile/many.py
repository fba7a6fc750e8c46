"""Several files in one command: one table, in which a file that cannot be read, measured or written is a row too."""

import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

from cyclopts import Parameter

from anisoscope.base.errors import UsageError
from anisoscope.cli.json_output import fields_of, print_json
from anisoscope.cli.options import Overwrite, check_new
from anisoscope.cli.progress import progress
from anisoscope.cli.tables import print_table

if TYPE_CHECKING:
    from anisoscope.operations.map_series import MapRow
    from anisoscope.profiles.limits import Judged, Limit

T = TypeVar("T")
Values = Mapping[str, tuple[float, str]]
FAILED, BROKEN = 1, 65
SHOWN_COLUMNS = 8
FORMATS = (".csv", ".json", ".html", ".htm")


@dataclass(frozen=True)
class TableOptions:
    """Several files and their table."""

    table: Annotated[
        Path | None, Parameter(help="File for one table of all maps: *.csv, *.json or *.html.")
    ] = None
    jobs: Annotated[int, Parameter(help="Number of processes.")] = 2
    overwrite: Overwrite = False

    def read_limits(self) -> "dict[str, Limit] | None":
        """Limits by which every map is judged, if there are some."""
        return None


@dataclass(frozen=True)
class ManyOptions(TableOptions):
    """Several files that are measured.

    Attributes:
        limits: TOML file of limits, such as [Sa] max = 0.4: a PASS/FAIL sheet; exit code 1 for FAIL.
    """

    limits: Path | None = None

    def read_limits(self) -> "dict[str, Limit] | None":
        """The limits of the file."""
        from anisoscope.profiles.limits import read_limits

        return None if self.limits is None else read_limits(self.limits)


@dataclass(frozen=True)
class OutOptions(TableOptions):
    """Several files, each of which gives a new one.

    Attributes:
        out_dir: Folder for the new files, each named like the map that it is made of; made if missing.
    """

    out_dir: Path | None = None

    def targets(self, files: Sequence[Path], suffix: str) -> dict[Path, Path]:
        """The new file of every map: the name of the map with another end, in the folder or, without one, with the map.

        Raises:
            UsageError: two maps would give one file, a map would be replaced, or a file exists.
        """
        found: dict[Path, Path] = {}
        sources = {path.resolve() for path in files}
        for path in files:
            target = (self.out_dir or path.parent) / (path.stem + suffix)
            if target in found.values():
                other = next(one for one, its in found.items() if its == target)
                raise UsageError(
                    f"{other} and {path} would both become {target}; rename one, or run them apart"
                )
            if target.resolve() in sources:
                raise UsageError(f"{target} is a file that is read; give another --out-dir")
            if target.exists() and not self.overwrite:
                raise UsageError(f"{target} exists; give another --out-dir, or --overwrite")
            found[path] = target
        if self.out_dir is not None:
            self.out_dir.mkdir(parents=True, exist_ok=True)
        return found


NONE = ManyOptions()
NO_TABLE = OutOptions()


def measure_maps(
    files: Sequence[Path],
    many: ManyOptions,
    measure: Callable[[Path], T],
    values: Callable[[T], Values],
    show: Callable[[str, T], None],
    *,
    to_json: bool,
    content: Callable[[Any], Mapping[str, object]] = fields_of,
) -> int:
    """Measure one map and show it in full, or every one of several as a row of a table; errors as of `measure_each`.

    Args:
        files: maps, or patterns.
        many: table, jobs, limits.
        measure: result of a file.
        values: its values and units by name, for tables and limits.
        show: prints the result of one map, by its name.
        to_json: print JSON instead.
        content: of the JSON of one map.
    """
    from anisoscope.operations.map_series import expanded
    from anisoscope.profiles.limits import sheet_of

    chosen = expanded(files)
    if len(chosen) > 1 or many.table is not None:
        return measure_each(chosen, lambda path: values(measure(path)), many, to_json=to_json)
    check_table(many)
    found = measure(chosen[0])
    sheet = sheet_of(many.limits, values(found))
    if to_json:
        print_json({**content(found), **({"sheet": sheet} if sheet else {})})
    else:
        show(chosen[0].name, found)
    return print_sheet(sheet, silent=to_json)


def measure_each(
    files: Sequence[Path],
    measure: Callable[[Path], Values],
    options: TableOptions,
    *,
    to_json: bool,
    targets: Mapping[Path, Path] | None = None,
) -> int:
    """Measure every file, print one table and write it; a file that cannot be measured is a row with its reason.

    Args:
        files: at least one.
        measure: values and units by name; it writes the new file of the map, where there is one.
        options: table, jobs, limits.
        to_json: print JSON instead of a table.
        targets: the new file of every map, where one is written.

    Returns:
        1 where a limit is not kept, else 65 where a file could not be measured or written, else 0.

    Raises:
        UsageError: a table that exists or of an unknown format, or fewer than one job.
    """
    from anisoscope.operations.map_series import measure_maps, write_map_table

    check_table(options)
    limits = options.read_limits()
    with progress(f"{len(files)} maps") as advance:
        rows = measure_maps(files, measure, limits, jobs=options.jobs, written=targets, on_progress=advance)
    if options.table is not None:
        write_map_table(rows, options.table)
    if to_json:
        print_json(rows)
    else:
        _print(rows, options.table)
    if any(row.verdict == "FAIL" for row in rows):
        return FAILED
    return BROKEN if any(row.error for row in rows) else 0


def write_each(
    files: Sequence[Path],
    work: Callable[[Path, Path], Values],
    options: OutOptions,
    suffix: str,
    *,
    to_json: bool,
) -> int:
    """Make a new file of every map in the folder of the options, with one table of them all.

    Args:
        files: at least one.
        work: makes the second file of the first; what it returns are the columns of the table.
        options: folder, table, jobs.
        suffix: extension of the new files.
        to_json: print JSON instead of a table.

    Returns:
        65 where a file could not be read or written, else 0.

    Raises:
        UsageError: the table or one of the new files cannot be written (see ``OutOptions.targets``).
    """
    check_table(options)
    targets = options.targets(files, suffix)
    return measure_each(
        files, lambda path: work(path, targets[path]), options, to_json=to_json, targets=targets
    )


def written_suffix(name: str, known: Sequence[str]) -> str:
    """The extension of a format of an option.

    Raises:
        UsageError: maps are not written in this format.
    """
    suffix = "." + name.lower().removeprefix(".")
    if suffix not in known:
        raise UsageError(f"--format {name}: written are {', '.join(one[1:] for one in known)}")
    return suffix


def check_table(options: TableOptions, alone: str = "") -> None:
    """Refuse a table that cannot be written.

    Args:
        options: of the command.
        alone: option without which there is no table.

    Raises:
        UsageError: it exists, has an unknown format, there is less than one job, or it needs another option.
    """
    if alone and options.table is not None:
        raise UsageError(f"--table lists the files of {alone}; give that too")
    if options.jobs < 1:
        raise UsageError(f"--jobs takes a whole number from 1, not {options.jobs}")
    if options.table is None:
        return
    if options.table.suffix.lower() not in FORMATS:
        raise UsageError(f"--table {options.table}: a table is {', '.join(FORMATS)}")
    check_new((options.table,), overwrite=options.overwrite)


def _print(rows: "Sequence[MapRow]", table: Path | None) -> None:
    from anisoscope.operations.map_series import columns_of

    every = columns_of(rows)
    columns = every[:SHOWN_COLUMNS]
    heads = [f"{name} [{unit}]" if unit else name for name, unit in columns]
    limited = any(row.sheet for row in rows)
    body = [
        [row.file.name, *([row.verdict] if limited else []), *row.cells(columns, 5)]
        for row in rows
        if not row.error
    ]
    if body:
        more = len(every) - len(columns)
        caption = f"{more} further columns with --table or --json" if more > 0 else None
        print_table(f"{len(rows)} maps", ["file", *(["verdict"] if limited else []), *heads], body, caption)
    for row in rows:
        if row.error:
            sys.stdout.write(f"{row.file}: not measured: {row.error}\n")
    for row in rows:
        for one in row.sheet:
            if one.verdict == "FAIL":
                sys.stdout.write(f"{row.file}: FAIL {sheet_line(one)}\n")
    if table is not None:
        sys.stdout.write(f"{table}\n")


def sheet_line(one: "Judged") -> str:
    """A line of the sheet: the parameter, its value and its limits."""
    bounds = [f"min {one.low:g}"] if one.low is not None else []
    bounds += [f"max {one.high:g}"] if one.high is not None else []
    return f"{one.name} = {one.value:.6g} {one.unit}".rstrip() + f" ({', '.join(bounds)})"


def print_sheet(sheet: "tuple[Judged, ...]", *, silent: bool = False) -> int:
    """Print the PASS/FAIL sheet of one map, unless silent or empty; 1 for FAIL."""
    if not sheet:
        return 0
    rows = [
        [
            one.name,
            f"{one.value:.6g}",
            one.unit,
            *("–" if bound is None else f"{bound:g}" for bound in (one.low, one.high)),
            one.verdict,
        ]
        for one in sheet
    ]
    verdict = "FAIL" if any(one.verdict == "FAIL" for one in sheet) else "PASS"
    if not silent:
        print_table(f"limits: {verdict}", ["parameter", "value", "unit", "min", "max", "verdict"], rows)
    return FAILED if verdict == "FAIL" else 0
