"""Which rule gave a verdict, in one sentence."""

from anisoscope.base.language import message, translated
from anisoscope.record.schema import Record
from anisoscope.record.surface_details import surface_of

NAMES = {"log_ratio": "ln ratio", "michelson": "Michelson contrast", "difference": "difference of radiance"}
UNITS = {"log_ratio": "1", "michelson": "1", "difference": "1/sr"}
PRECEDENCE = "INVALID goes before FAIL, FAIL before INCONCLUSIVE, INCONCLUSIVE before PASS"

EXCLUDED_RULE = (
    "nothing deviates, and every defect of the smallest interesting size is excluded (one side, 95 %; the state of the "
    "part after ISO 14253-1)"
)
OPEN_CRITERION = "defects of the smallest interesting size are not excluded"
OPEN_RULE = f"no limit is broken for certain, but {OPEN_CRITERION}"


def deviation_decides(record: Record) -> bool:
    """Whether a significant deviation fails the part: by the recipe's rule, or for want of a tolerance."""
    contrasts = surface_of(record).contrasts
    without = bool(contrasts) and contrasts[0].tolerance is None
    return record.recipe["decision"]["deviation"] == "fail" or without


def level_of(record: Record) -> float:
    """Below which p all contrasts together deviate: alpha, of which a test of the area by golden parts takes its share.

    Holm (1979): the less likely one of the two is held against half of alpha, and then the other one against all of it.
    """
    level: float = record.recipe["decision"]["alpha"]
    area = surface_of(record).area
    other = None if area is None else area.p_value
    return level if other is None or other < min(0.5 * level, record.p_value or 0.0) else 0.5 * level


def rule_of(record: Record) -> str:
    """The rule that decided."""
    if record.verdict == "INVALID":
        return message(
            "what makes a measurement unfit goes before all that was measured, and never fails a part"
        )
    broken = _decisive(record, "FAIL")
    if record.verdict == "FAIL":
        return message("{criteria}; FAIL goes before every verdict but INVALID", criteria=_listed(broken))
    if record.verdict == "INCONCLUSIVE":
        near = _decisive(record, "INCONCLUSIVE")
        return message("no limit is broken for certain, but {criteria}", criteria=_listed(near))
    details = surface_of(record)
    if details.exclusions and all(one.excluded for one in details.exclusions):
        return message(EXCLUDED_RULE)
    if details.contrasts and details.contrasts[0].tolerance is None:
        return message("nothing deviates significantly; no tolerance is set")
    return message("every quantity lies within its limit by more than its guard band (ISO 14253-1)")


def _decisive(record: Record, verdict: str) -> list[str]:
    """Criteria that lead to this verdict."""
    level, found, details = level_of(record), [], surface_of(record)
    limited = [c for c in details.contrasts if c.verdict == verdict and c.tolerance is not None]
    outside = verdict == "FAIL"
    if limited:
        found.append(message(CONTRASTS[outside, len(limited) == 1], count=len(limited)))
    if details.area is not None and details.area.verdict == verdict:
        found.append(message(AREA_OUTSIDE if outside else AREA_NEAR))
    if outside and details.area is not None and details.area.too_long:
        found.append(message("a mark is longer than its limit"))
    if details.form is not None and details.form.verdict == verdict:
        found.append(message(FORM_OUTSIDE if outside else FORM_NEAR))
    if not outside and not found and any(not one.excluded for one in details.exclusions):
        found.append(message(OPEN_CRITERION))
    if outside and deviation_decides(record) and (record.p_value or 0.0) < level:
        found.append(
            message("all contrasts together deviate significantly (p below {level})", level=f"{level:g}")
        )
    return found


CONTRASTS = {
    (True, True): "1 contrast lies outside the tolerance by more than the guard band (ISO 14253-1)",
    (True, False): "{count} contrasts lie outside the tolerance by more than the guard band (ISO 14253-1)",
    (False, True): "1 contrast lies on one side or the other of the tolerance by less than the guard band "
    "(ISO 14253-1)",
    (
        False,
        False,
    ): "{count} contrasts lie on one side or the other of the tolerance by less than the guard band "
    "(ISO 14253-1)",
}
"""Messages by whether contrasts are outside, and whether it is a single one."""
AREA_OUTSIDE = "the deviating area lies outside its limit by more than the guard band (ISO 14253-1)"
FORM_OUTSIDE = "the facets lean from those around by more than their limit and its guard band (ISO 14253-1)"
FORM_NEAR = (
    "the lean of the facets lies on one side or the other of its limit by less than the guard band (ISO "
    "14253-1)"
)
AREA_NEAR = (
    "the deviating area lies on one side or the other of its limit by less than the guard band (ISO 14253-1)"
)


def _listed(found: list[str]) -> str:
    return "; ".join(found) if found else translated("see the reasons above")
