"""Sections common to the pages of statistics: pictures with captions, and tables."""

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Mark:
    """A place of a picture that shows a text when it is pointed at, and may lead to a page.

    Attributes:
        x, y: from the upper left corner, in units of the picture's size.
        text: of the place.
        link: address, or None.
    """

    x: float
    y: float
    text: str
    link: str | None = None


@dataclass(frozen=True)
class Picture:
    """Picture as a data URI, with alternative text and caption, and marks on it; ``aspect`` is width over height."""

    uri: str
    alt: str
    caption: str
    marks: tuple[Mark, ...] = ()
    aspect: float = 1.0


@dataclass(frozen=True)
class Grid:
    """A table of texts.

    Attributes:
        heading: of the section.
        title: its caption, also read aloud.
        columns: headers; the first column names the rows.
        rows: texts.
        id: of the element, or "".
        words: columns that hold prose, from 0.
        note: below the table.
    """

    heading: str
    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    id: str = ""
    words: tuple[int, ...] = ()
    note: str = ""


def number(value: float | None, digits: int = 4) -> str:
    """Number as text: some digits, a true minus, a dash for None."""
    if value is None or not math.isfinite(value):
        return "–"
    whole = 10.0**digits <= abs(value) < 1e7
    return (f"{value:.0f}" if whole else f"{value:.{digits}g}").replace("-", "−")


def share(value: float | None) -> str:
    """A share in percent, a dash for none."""
    return "–" if value is None else f"{100.0 * value:.1f} %"


def chance(p: float | None) -> str:
    """A probability."""
    if p is None:
        return "–"
    return "below 0.001" if p < 0.001 else f"{p:.3f}"
