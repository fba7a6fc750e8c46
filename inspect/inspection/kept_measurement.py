"""``measured.npz``: what a verdict was decided from, so that another recipe can decide anew without the frames.

Radiances of the poses, means of cells and the uncertainties of both, as numbers without loss. The record lists and
hashes the file like every other one.
"""

import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from anisoscope.base.atomic_write import write_bytes
from anisoscope.base.errors import RecordError
from anisoscope.inspection.manifest import checked_content
from anisoscope.record.schema import Record

KEPT_NAME = "measured.npz"
Kept = Mapping[str, Any]
"""Arrays, numbers and texts by name, as a kind of part gives them."""
CHANGE = "change on resuming"


def write_kept(kept: Kept, folder: Path) -> None:
    """Write the measurement into an inspection folder.

    Raises:
        RecordError: it cannot be written.
    """
    stream = io.BytesIO()
    np.savez_compressed(stream, allow_pickle=False, **{name: _narrow(value) for name, value in kept.items()})
    write_bytes(folder / KEPT_NAME, stream.getvalue())


def _narrow(value: Any) -> Any:  # noqa: ANN401 - what numpy takes
    """Numbers in single precision where that loses nothing."""
    array = np.asarray(value)
    if array.dtype != np.float64 or array.size < 64:
        return array
    single = array.astype(np.float32)
    return single if np.array_equal(single.astype(np.float64), array, equal_nan=True) else array


def read_kept(folder: Path, record: Record) -> Kept | None:
    """The measurement of an inspection, or None where none was written, as by earlier versions.

    Raises:
        RecordError: it is missing, was changed, or is damaged.
    """
    file = next((one for one in record.files if one.name == KEPT_NAME), None)
    if file is None:
        return None
    content = checked_content(file, folder)
    try:
        with np.load(io.BytesIO(content), allow_pickle=False) as data:
            return {name: _wide(data[name]) for name in data.files}
    except (OSError, ValueError) as error:
        raise RecordError(f"{folder / KEPT_NAME} is damaged: {error}") from error


def _wide(array: Any) -> Any:  # noqa: ANN401
    return array.astype(np.float64) if array.dtype == np.float32 else array
