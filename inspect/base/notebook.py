"""Results in a notebook: tables and pictures as HTML, data frames, axes to draw into."""

import base64
import io
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from typing import TYPE_CHECKING, Any

from anisoscope.base.errors import UsageError

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MOST_ROWS = 60


def html_table(title: str, columns: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """A small table; everything in it is escaped, and rows beyond 60 are only counted."""
    lines = [tuple(str(cell) for cell in row) for row in rows]
    head = "".join(f"<th>{escape(column)}</th>" for column in columns)
    body = "".join(
        "<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in line) + "</tr>" for line in lines[:MOST_ROWS]
    )
    more = f"<p>and {len(lines) - MOST_ROWS} more</p>" if len(lines) > MOST_ROWS else ""
    caption = f'<caption style="text-align:left"><b>{escape(title)}</b></caption>'
    return f"<table>{caption}<thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>{more}"


def html_picture(figure: "Figure", title: str) -> str:
    """Figure as an image within the page, its title as the alternative text."""
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=80)
    data = base64.b64encode(stream.getvalue()).decode()
    return f'<img alt="{escape(title, quote=True)}" src="data:image/png;base64,{data}">'


def data_frame(columns: Mapping[str, Iterable[object]]) -> Any:  # noqa: ANN401 - pandas need not be installed
    """A pandas data frame of named columns.

    Raises:
        UsageError: pandas is not installed.
    """
    try:
        import pandas as pd  # noqa: PLC0415 - slow to import, and not required
    except ImportError:
        raise UsageError("a data frame needs pandas, which is not installed: pip install pandas") from None
    return pd.DataFrame(dict(columns))


def axes_or_new(axes: "Axes | None") -> "Axes":
    """The axes given, or those of a new figure of pyplot, which a notebook shows."""
    if axes is not None:
        return axes
    from matplotlib import pyplot as plt  # noqa: PLC0415 - slow to import

    return plt.subplots(layout="constrained")[1]
