"""Numbers, contrasts and causes as the report of an inspection words them."""

import re

from anisoscope.base.language import decimal, message, translated
from anisoscope.base.notation import contrast_name, p_value_text, percent_text, ratio_text, true_minus
from anisoscope.diagnosis.ranking import NOTHING, OTHER, PLASTIC
from anisoscope.record.schema import CauseRecord, ComponentRecord, Record
from anisoscope.record.surface_details import surface_of
from anisoscope.report.page import Filters, css_string
from anisoscope.report.provenance import when

MOST_WEIGHT = 0.99
_UNIT = re.compile(r"(?<=±) (?=\d)|(?<=\d) (?=(?:%|[µn]?m)(?!\w))")
"""Spaces between a number and its sign or unit, where no line breaks."""
_SHARE = re.compile(r"\bshare\b|relative change")
"""In the title of a cause whose severity is said in per cent."""
U_LEGEND = "U = 2u: expanded uncertainty"


def filters() -> Filters:
    """Filters of templates: numbers with a true minus sign, chances, times."""
    return {
        "short": lambda value: f"{value:.4f}" if value >= 5e-5 else "< 0.0001",
        "signed": signed,
        "number": lambda value, digits=3: f"{value:.{digits}g}".replace("-", "−"),
        "chance": lambda value: f"{value:.2g}" if value >= 1e-4 else "< 0.0001",
        "p_said": p_value_text,
        "percent": percent_text,
        "ratio": ratio_text,
        "typeset": lambda text: _UNIT.sub("\N{NO-BREAK SPACE}", true_minus(text)),
        "when": when,
        "css_string": css_string,
    }


def signed(value: float, digits: int = 3) -> str:
    """A number with its sign, a true minus; what rounds to nothing has none."""
    text = f"{value:+.{digits}f}"
    return text[1:] if float(text) == 0.0 else text.replace("-", "−")


def labels_of(record: Record) -> list[str]:
    """Names of the contrasts for pages, such as ``0° / 90°, tilt −10°``."""
    return [true_minus(contrast_name(c.from_deg, c.to_deg, c.tilt_deg)) for c in surface_of(record).contrasts]


def cause_text(cause: CauseRecord) -> str:
    """A cause with its severity, such as ``ridge angle, off by −2.1° (95 %: −2.5° to −1.7°)``."""
    if cause.components:
        together = message("{one} and {other}", **_both(cause.components))
        title = translated(cause.title) if cause.cause == PLASTIC else message("two causes together")
        return f"{title}: {together}"
    if cause.cause in {NOTHING, OTHER}:
        return translated(cause.title)
    return _sized(cause)


def _both(components: tuple[ComponentRecord, ...]) -> dict[str, str]:
    *first, last = (_sized(one) for one in components)
    return {"one": ", ".join(first), "other": last}


def _sized(cause: CauseRecord | ComponentRecord) -> str:
    return f"{translated(cause.title)} {severity_text(cause)} ({cause_range(cause)})".replace("-", "−")


def severity_text(cause: CauseRecord | ComponentRecord) -> str:
    """The severity with its unit, such as ``−2.1°``, ``5 µm``, or ``6.1 %`` of a share."""
    scale, unit = _scale(cause)
    return decimal(f"{scale * cause.severity:.3g}{unit}").replace("-", "−")


def _scale(cause: CauseRecord | ComponentRecord) -> tuple[float, str]:
    """Factor and unit of a severity for people: records hold shares and relative changes without a unit."""
    if not cause.unit and _SHARE.search(cause.title):
        return 100.0, " %"
    return 1.0, cause.unit if cause.unit in {"", "°"} else f" {cause.unit}"


def weight_text(weight: float) -> str:
    """A share of the belief; it is never all of it, nor nothing."""
    if weight > MOST_WEIGHT:
        return message("over 99 %")
    return message("below 1 %") if weight < 0.01 else f"{100.0 * weight:.0f} %"


def cause_range(cause: CauseRecord | ComponentRecord) -> str:
    """95 % interval of a severity, such as ``95 %: −2.5° to −1.7°``."""
    scale, unit = _scale(cause)
    if cause.interval is None:  # records of earlier versions
        return message("not determined") if cause.u is None else decimal(f"± {scale * cause.u:.2g}{unit}")
    low, high = (None if end is None else f"{scale * end:.3g}{unit}" for end in cause.interval)
    if low is None and high is None:
        return message("not determined")
    if high is None:
        return message("95 %: {low} or more", low=low).replace("-", "−")
    if low is None:
        return message("95 %: {high} or less", high=high).replace("-", "−")
    return message("95 %: {low} to {high}", low=low, high=high).replace("-", "−")
