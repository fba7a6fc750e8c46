"""The table of causes that ``anisoscope recipe check`` prints."""

from collections.abc import Iterable
from typing import Any

from anisoscope.diagnosis.separability import Separability
from anisoscope.kinds.kind import Table


def causes_table(causes: Iterable[Separability]) -> Table:
    """From which extent on every cause shows, and from which on no other looks the same."""
    causes = list(causes)
    titles = {cause.cause: cause.title for cause in causes}
    return Table(
        "causes",
        ["cause", "shows from", "told apart from", "never told from"],
        [
            [
                cause.title,
                _extent(cause.detection_extent, cause.unit),
                _extent(cause.separation_extent, cause.unit),
                "; ".join(titles.get(name, name) for name in cause.inseparable_causes),
            ]
            for cause in causes
        ],
        "from which extent on a cause shows (3 standard uncertainties) and no other looks the same",
    )


def causes_content(rows: list[dict[str, Any]], causes: Iterable[Separability]) -> None:
    """Give rows of JSON, one a cause, the keys of the command, and add what is computed of each."""
    for row, cause in zip(rows, causes, strict=True):
        row |= {"shows_from": row.pop("detection_extent"), "told_from": row.pop("separation_extents")}
        row |= {"told_apart_from": cause.separation_extent, "never_told_from": list(cause.inseparable_causes)}


def _extent(value: float | None, unit: str) -> str:
    return "–" if value is None else f"{abs(value):.3g} {unit}".strip()
