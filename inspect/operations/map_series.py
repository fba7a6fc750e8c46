"""Several height maps: one table, in which a file that cannot be read, measured or written is a row too."""

import json
import math
import os
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass, field
from pathlib import Path

from anisoscope.base.atomic_write import write_text
from anisoscope.base.csv_style import csv_text, number_text
from anisoscope.base.errors import AnisoscopeError, UsageError
from anisoscope.base.json_fields import as_json, in_json, json_field
from anisoscope.base.progress import Advance, silent
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.profiles.limits import Judged, Limit, judge
from anisoscope.profiles.textures.amplitude import amplitude
from anisoscope.report.page import write_page

Values = Mapping[str, tuple[float, str]]
"""Value and unit by name."""


def _by_name(values: Values) -> dict[str, dict[str, float | str]]:
    return {name: {"value": value, "unit": unit} for name, (value, unit) in values.items()}


@dataclass(frozen=True)
class MapRow:
    """One file: what was measured, or why not.

    Attributes:
        file: the map.
        values: value and unit by name.
        error: why it was not measured; empty where it was.
        sheet: limits against their parameters.
        written: file that was made of it.
    """

    file: Path
    values: Values = field(default_factory=dict, metadata=json_field(by=_by_name, merged=True))
    error: str = field(default="", metadata=json_field(only_given=True))
    sheet: tuple[Judged, ...] = field(default=(), metadata=json_field(only_given=True))
    written: Path | None = field(default=None, metadata=json_field(only_given=True))

    @property
    def verdict(self) -> str:
        """PASS or FAIL by the limits; ERROR where it was not measured, empty without limits."""
        return "ERROR" if self.error else self.judged or ""

    @property
    @in_json("verdict", only_given=True)
    def judged(self) -> str | None:
        """PASS or FAIL by the limits; None without any."""
        if not self.sheet:
            return None
        return "FAIL" if any(one.verdict == "FAIL" for one in self.sheet) else "PASS"

    def cells(self, columns: Sequence[tuple[str, str]], places: int) -> list[str]:
        """Values of columns with so many digits, empty where there is none."""
        values = (self.values.get(name, (math.nan, ""))[0] for name, _ in columns)
        return ["" if math.isnan(value) else f"{value:.{places}g}" for value in values]


def expanded(files: Sequence[Path | str]) -> list[Path]:
    """Files, patterns such as ``parts/*.x3p`` replaced by what they match, sorted.

    Raises:
        UsageError: no file, or a pattern that matches none.
    """
    found: list[Path] = []
    for path in map(Path, files):
        if path.exists() or not any(letter in str(path) for letter in "*?["):
            found.append(path)
            continue
        base = Path(path.anchor) if path.anchor else Path()
        matches = sorted(base.glob(str(path.relative_to(path.anchor) if path.anchor else path)))
        if not matches:
            raise UsageError(f"{path} matches no file")
        found += matches
    if not found:
        raise UsageError("give at least one height map")
    return list(dict.fromkeys(found))


def map_values(surface: HeightMap) -> Values:
    """Size, pixel, missing share and height parameters of a map by name, as ``profile info`` prints them."""
    found = amplitude(surface)
    return {
        "rows": (surface.shape[0], ""),
        "columns": (surface.shape[1], ""),
        "pixel y": (surface.pixel_y_um, "µm"),
        "pixel x": (surface.pixel_x_um, "µm"),
        "missing": (100.0 * surface.missing_share, "%"),
        "Sa": (found.sa_um, "µm"),
        "Sq": (found.sq_um, "µm"),
        "Sz": (found.sz_um, "µm"),
    }


def measure_maps(
    files: Sequence[Path | str],
    measure: Callable[[Path], Values],
    limits: Mapping[str, Limit] | None = None,
    *,
    jobs: int = 2,
    written: Mapping[Path, Path] | None = None,
    on_progress: Advance = silent,
) -> tuple[MapRow, ...]:
    """Measure every file; one that cannot be measured is a row with its reason.

    Args:
        files: height maps, or patterns such as ``parts/*.x3p``.
        measure: values and units by name, of the path; it writes the new file of the map, where there is one.
        limits: by which every map is judged.
        jobs: threads.
        written: the new file of every map, where one is written.
        on_progress: called with the file, files done and files in all.

    Raises:
        UsageError: no file, or a pattern that matches none.
    """
    chosen, rows = expanded(files), {}
    with ThreadPoolExecutor(jobs) as pool:
        waiting = {
            pool.submit(_row, path, measure, limits, (written or {}).get(path)): path for path in chosen
        }
        for done, future in enumerate(as_completed(waiting), start=1):
            rows[waiting[future]] = future.result()
            on_progress(waiting[future].name, done, len(chosen))
    return tuple(rows[path] for path in chosen)


def _row(
    path: Path, measure: Callable[[Path], Values], limits: Mapping[str, Limit] | None, target: Path | None
) -> MapRow:
    try:
        values = measure(path)
        return MapRow(path, values, "", () if limits is None else judge(limits, values), target)
    except AnisoscopeError as error:
        return MapRow(path, error=str(error))
    except OSError as error:  # a folder that takes no files
        return MapRow(path, error=f"{error.filename or path}: {error.strerror or error}")


def columns_of(rows: Sequence[MapRow]) -> list[tuple[str, str]]:
    """Names and units of all values, in the order in which they come."""
    return list(dict.fromkeys((name, unit) for row in rows for name, (_, unit) in row.values.items()))


def write_map_table(rows: Sequence[MapRow], path: Path | str) -> None:
    """Write the table as CSV, JSON or HTML, by the extension.

    Raises:
        RecordError: the file cannot be written.
    """
    path, columns = Path(path), columns_of(rows)
    heads = [f"{name} [{unit}]" if unit else name for name, unit in columns]
    if path.suffix.lower() == ".json":
        write_text(path, json.dumps(as_json(rows), indent=2, allow_nan=False) + "\n")
        return
    if path.suffix.lower() == ".csv":
        # "written" only where files are
        new = ["written"] if any(row.written for row in rows) else []
        table = [["file", "verdict", "error", *new, *heads]]
        table += [
            [
                str(row.file),
                row.verdict,
                row.error,
                *[str(row.written or "")][: len(new)],
                *map(number_text, row.cells(columns, 12)),
            ]
            for row in rows
        ]
        write_text(path, csv_text(table))
        return

    def link(target: Path | None) -> str:
        return "" if target is None else Path(os.path.relpath(target, path.parent)).as_posix()

    body = [
        (row.file.name, row.verdict, row.error, row.cells(columns, 5), row.sheet, link(row.written))
        for row in rows
    ]
    write_page(path, "table.html", {"heads": heads, "rows": body})
