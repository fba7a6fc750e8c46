"""Notation of contrasts, probabilities and minus signs in text.

Text that is pasted elsewhere (terminal, JSON, CSV) has ASCII minus signs; pages and drawings have true ones.
"""

import re

LEAST_P = 1e-9
"""Probabilities below are not stated: no model of a part is that exact."""
_MINUS = re.compile(r"(?<![\w)\]°])-(?=[\d.])")
_OLD_CONTRAST = re.compile(r"(-?[\d.]+)°/(-?[\d.]+)° at tilt (-?[\d.]+)°(, (?=-?[\d.]+°/))?")
_NUMBER = re.compile(r"(ln|Michelson|difference) (-?[\d.]+)-(-?[\d.]+)(?: @(-?[\d.]+))?$")
_OF_CLASSES = re.compile(r"ln (\S)(?:/(\S) at (-?[\d.]+)| (-?[\d.]+)-(-?[\d.]+))(?: @(-?[\d.]+))?$")
_NUMBER_KINDS = {"ln": "ln ratio", "Michelson": "Michelson contrast", "difference": "difference [1/sr]"}
NUMBER_WORDS = {
    "d2": "squared distance D²",
    "p": "p of the squared distance",
    "area share": "share of the area that deviates",
    "conformance probability": "probability of conformance",
    "drift": "drift of the lamp",
    "facet angle": "facet angle [°]",
    "facet angle spread": "facet angle spread [°]",
    "facet angle of the worst ridge": "facet angle of the outlying ridge [°]",
    "print tilt": "print tilt [°]",
    "print curl": "print curl [°]",
}
"""Numbers of the history that are no contrasts -> what they are called for people."""
_OLD_TIE = "; or, not to be told apart: "
_EXACT_P = re.compile(r"\bp (?:= (\d(?:\.\d+)?e-\d+)|< 1e-300)")


def contrast_name(from_deg: float, to_deg: float, tilt_deg: float) -> str:
    """A contrast by its stage angles and its tilt in degrees, such as ``0° / 90°, tilt 0°``."""
    return f"{from_deg:g}° / {to_deg:g}°, tilt {tilt_deg:g}°"


def quantity_name(kind: str, from_deg: float, to_deg: float, tilt_deg: float) -> str:
    """A contrast with its quantity, such as ``ln ratio 0° / 90°, tilt 0°``."""
    names = {"log_ratio": "ln ratio", "michelson": "Michelson contrast", "difference": "difference"}
    return " ".join((names.get(kind, kind), contrast_name(from_deg, to_deg, tilt_deg)))


def number_name(label: str) -> str:
    """A number of the history for people: ``ln 0-90 @10`` becomes ``ln ratio 0° / 90°, tilt 10°``.

    Classes of fields: ``ln A/B at 0`` becomes ``ln ratio A / B at 0°, tilt 0°``.
    """
    of_classes = _OF_CLASSES.match(label)
    if of_classes is not None:
        one, other, at, *between, tilt = of_classes.groups()
        tilt_deg = float(tilt or 0.0)
        if other is None:
            return f"ln ratio of {one} {contrast_name(float(between[0]), float(between[1]), tilt_deg)}"
        return f"ln ratio {one} / {other} at {at}°, tilt {tilt_deg:g}°"
    found = _NUMBER.match(label)
    if found is None:
        return NUMBER_WORDS.get(label, label)
    name = contrast_name(float(found[2]), float(found[3]), float(found[4] or 0.0))
    return f"{_NUMBER_KINDS[found[1]]} {name}"


def number_text(label: str, value: float) -> str:
    """A number of the history in four digits; of a probability no more than is meant."""
    return f"< {LEAST_P:g}".replace("e-09", "e-9") if label == "p" and value < LEAST_P else f"{value:.4g}"


def p_value_text(p_value: float) -> str:
    """A probability after the word p, such as ``= 0.012``; one too small to be meant literally: ``< 1e-9``."""
    return f"= {p_value:.2g}" if p_value >= LEAST_P else f"< {LEAST_P:g}".replace("e-09", "e-9")


def percent_text(probability: float) -> str:
    """A probability in per cent; never all or nothing: ``> 99.9 %``, ``< 0.1 %``."""
    if probability > 0.999:
        return "> 99.9 %"
    return "< 0.1 %" if probability < 0.001 else f"{100.0 * probability:.1f} %"


def ratio_text(ratio: float) -> str:
    """T/U to one decimal; beyond 20 the number says nothing more."""
    return f"{ratio:.1f}" if ratio < 20.0 else "> 20"


def true_minus(text: str) -> str:
    """Text for a page: minus signs of numbers are true ones; hyphens and dates stay."""
    return _MINUS.sub("−", text)


def present_notation(text: str) -> str:
    """Text of a record of an earlier version with contrasts and probabilities as they are written now."""

    def probability(found: re.Match[str]) -> str:
        if found[1] is not None and float(found[1]) >= LEAST_P:
            return found[0]
        return f"p {p_value_text(0.0)}"

    def contrast(found: re.Match[str]) -> str:
        return f"{found[1]}° / {found[2]}°, tilt {found[3]}°" + ("; " if found[4] else "")

    text = text.replace(_OLD_TIE, "; cannot be distinguished from: ")
    return _EXACT_P.sub(probability, _OLD_CONTRAST.sub(contrast, text))
