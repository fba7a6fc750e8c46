"""Measured contrasts of the ridge experiment, read from a CSV file."""

from pathlib import Path

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.csv_table import read_table
from anisoscope.base.errors import UsageError
from anisoscope.experiment.experiment import COLUMNS, SHAPE, combinations


def read_measured(path: Path) -> FloatArray:
    """Measured contrasts from a CSV file with the columns ``COLUMNS``; rows may be missing, none twice.

    Returns:
        Contrasts in the unit of the file, NaN where not measured.

    Raises:
        UsageError: the file cannot be read, or a line of it cannot be used.
    """
    table = read_table(path, (COLUMNS,), not_negative=("contrast",), what="contrasts")
    where = {row: index for index, row in combinations()}
    measured = np.full(SHAPE, np.nan)
    for number, (*row, contrast) in enumerate(table.rows.tolist()):
        index = where.get((row[0], row[1], row[2], row[3]))
        if index is None:
            raise UsageError(
                f"{table.place(number)}: the experiment has no ridge angle {row[0]:g}°, tilt {row[1]:g}°, "
                f"pair {row[2]:g}°/{row[3]:g}°"
            )
        if not np.isnan(measured[index]):
            raise UsageError(f"{table.place(number)}: this combination is given twice")
        measured[index] = contrast
    return measured
