"""The table of causes that ``anisoscope recipe check`` prints, for ridged parts, wafers and prints."""

from collections.abc import Iterable
from typing import TYPE_CHECKING

from anisoscope.cli.tables import print_table

if TYPE_CHECKING:
    from anisoscope.diagnosis.separability import Separability


def print_causes(causes: "Iterable[Separability]") -> None:
    """From which extent on every cause shows, and from which on no other looks the same."""
    causes = list(causes)
    titles = {cause.cause: cause.title for cause in causes}
    print_table(
        "causes",
        ["cause", "shows from", "told apart from", "never told from"],
        [
            [
                cause.title,
                _extent(cause.shows_from, cause.unit),
                _extent(cause.told_apart_from, cause.unit),
                "; ".join(titles.get(name, name) for name in cause.never_told_from),
            ]
            for cause in causes
        ],
        "from which extent on a cause shows (3 standard uncertainties) and no other looks the same",
    )


def _extent(value: float | None, unit: str) -> str:
    return "–" if value is None else f"{abs(value):.3g} {unit}".strip()
