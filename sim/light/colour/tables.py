"""Tables of numbers that come with the package: comma-separated, one header line, rising wavelengths."""

from functools import cache
from importlib.resources import files

import numpy as np

from anisoscope.base.arrays import FloatArray


@cache
def package_table(package: str, name: str) -> tuple[tuple[str, ...], FloatArray]:
    """Column names and (N, columns) numbers, read-only, of ``data/<name>`` in a package."""
    text = (files(package) / "data" / name).read_text(encoding="utf-8")
    header, *lines = text.splitlines()
    numbers = np.array([[float(field) for field in line.split(",")] for line in lines])
    numbers.flags.writeable = False
    return tuple(header.split(",")), numbers
