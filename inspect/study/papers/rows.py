"""One row of the page of the papers: a figure or table as printed, and as computed here."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Literal

import cv2
import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.json_fields import LEFT_OUT
from anisoscope.report.figures import png_uri

Comparison = Literal["number", "order", "shape", "none"]


@dataclass(frozen=True, eq=False)
class Row:
    """A figure, table or statement of a paper.

    Attributes:
        label: as the paper names it.
        shows: what it shows.
        printed: what the paper prints; numbers where it has them.
        ours: the same as computed here.
        compared: by numbers, by the order of values, by shape, or not at all.
        holds: whether both agree; None where nothing can be compared.
        command: command of this package that makes it, or empty.
        note: why it cannot be reproduced, or where it differs.
        pictures: (data URI, caption).
    """

    label: str
    shows: str
    printed: str
    ours: str
    compared: Comparison
    holds: bool | None
    command: str = ""
    note: str = ""
    pictures: Sequence[tuple[str, str]] = field(default=(), metadata=LEFT_OUT)


Make = Callable[[], Row]


@dataclass(frozen=True)
class Paper:
    """A paper and what makes its rows.

    Attributes:
        key: short name.
        title: of the paper.
        source: where it was published.
        makers: functions that make the rows, in the order of the paper.
    """

    key: str
    title: str
    source: str
    makers: tuple[Make, ...]


def picture(pixels: FloatArray, caption: str) -> tuple[str, str]:
    """(rows, cols, 3) or (rows, cols) values of 0 to 1, first row at the top, as a PNG with its caption."""
    values = np.asarray(np.rint(255.0 * np.clip(pixels, 0.0, 1.0)), dtype=np.uint8)
    if values.ndim == 3:
        values = np.ascontiguousarray(values[..., ::-1])
    done, data = cv2.imencode(".png", values)
    assert done
    return png_uri(data.tobytes()), caption


def density_picture(density: FloatArray, caption: str, gamma: float = 1.0) -> tuple[str, str]:
    """A density, rows along rising h_y, scaled to its 99.7 % quantile; ``gamma`` below 1 raises weak light."""
    scale = max(float(np.percentile(density, 99.7)), 1e-12)
    return picture(np.clip(density[::-1] / scale, 0.0, 1.0) ** gamma, caption)
