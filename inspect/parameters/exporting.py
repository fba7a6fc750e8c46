"""Files that past inspections are written to (`anisoscope.operations.past`)."""

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class ExportFiles:
    """Files of a selection of inspections.

    Attributes:
        csv: write a table (CSV, UTF-8), a line each.
        values: write a CSV of fixed columns: a line for each number, units in line 2.
        json: write JSON.
        junit: write JUnit XML, for servers of continuous integration.
    """

    csv: Path | None = None
    values: Path | None = None
    json: Path | None = None
    junit: Path | None = None

    @property
    def named(self) -> tuple[Path, ...]:
        """The files."""
        return tuple(path for path in (self.csv, self.values, self.json, self.junit) if path is not None)
