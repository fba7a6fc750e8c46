"""The contrasts between tilts as pages and the command line show them: few enough to read, in the recipe's order."""

from dataclasses import dataclass
from typing import Any

from anisoscope.record.schema import Record, TiltContrastRecord
from anisoscope.record.surface_details import surface_of
from anisoscope.report import figures
from anisoscope.report.rule import NAMES
from anisoscope.report.wording import U_LEGEND, signed

MOST = 12
"""Rows that are shown; of more the least likely ones, and the rest is folded away."""
COVERAGE = 2.0


@dataclass(frozen=True)
class TiltRow:
    """One contrast between tilts, in words.

    Attributes:
        kind: of contrast, as the record has it.
        label: its name, such as ``0°, tilt 0° / 3°``.
        stage: stage angle in degrees.
        tilts: both tilts in degrees.
        numbers: measured, U, predicted, U, deviation, U.
        chance: p of the deviation.
        deviates: whether it deviates by itself, at the recipe's level.
    """

    kind: str
    label: str
    stage: str
    tilts: str
    numbers: tuple[str, ...]
    chance: str
    deviates: bool = False


def tilt_row(one: TiltContrastRecord, alpha: float = 0.0) -> TiltRow:
    """A contrast between tilts in words."""
    pairs = (
        (one.measured, one.u_measured),
        (one.predicted, one.u_predicted),
        (one.measured - one.predicted, one.u),
    )
    numbers = tuple(text for value, u in pairs for text in (signed(value), f"{COVERAGE * u:.3f}"))
    chance = f"{one.p_value:.2g}" if one.p_value >= 1e-4 else "< 0.0001"
    stage, tilts = f"{one.stage_deg:g}", f"{one.from_tilt_deg:g} / {one.to_tilt_deg:g}"
    return TiltRow(one.kind, _label(one), _minus(stage), _minus(tilts), numbers, chance, one.p_value < alpha)


def listed_tilt_contrasts(
    record: Record,
) -> tuple[tuple[TiltContrastRecord, ...], tuple[TiltContrastRecord, ...]]:
    """Listed and folded contrasts between tilts, both in the order of the record."""
    found = surface_of(record).between_tilts
    likely = sorted(range(len(found)), key=lambda k: (found[k].p_value, k))
    listed = set(likely[:MOST])
    return (
        tuple(one for k, one in enumerate(found) if k in listed),
        tuple(one for k, one in enumerate(found) if k not in listed),
    )


def tilt_parts(record: Record) -> dict[str, Any]:
    """Template context of the contrasts between tilts."""
    listed_rows, folded = listed_tilt_contrasts(record)
    if not listed_rows:
        return {"tilt_rows": (), "tilt_folded": (), "tilt_chart": None, "u_said": U_LEGEND}
    kind, alpha = listed_rows[0].kind, record.recipe["decision"]["alpha"]
    chart = figures.contrast_chart(
        [_label(one) for one in listed_rows],
        [one.measured - one.predicted for one in listed_rows],
        [one.u for one in listed_rows],
        [None] * len(listed_rows),
        NAMES[kind],
    )
    return {
        "tilt_rows": tuple(tilt_row(one, alpha) for one in listed_rows),
        "tilt_folded": tuple(tilt_row(one, alpha) for one in folded),
        "tilt_chart": chart,
        "u_said": U_LEGEND,
    }


def _label(one: TiltContrastRecord) -> str:
    return _minus(f"{one.stage_deg:g}°, tilt {one.from_tilt_deg:g}° / {one.to_tilt_deg:g}°")


def _minus(text: str) -> str:
    return text.replace("-", "−")
