"""The verdict in plain words: one sentence that names the finding with its size, and one line on what to do next.

Both follow from the record and from the words that a kind of part has for its causes. A recipe may override the line on
what to do in the shop's own words, by the name of the cause or outcome.
"""

import math
from collections.abc import Mapping
from typing import NamedTuple

from anisoscope.base.cause_words import CauseWords
from anisoscope.base.notation import p_value_text, quantity_name
from anisoscope.diagnosis.cause_words import words_of
from anisoscope.diagnosis.ranking import NOTHING, OTHER, bare_title
from anisoscope.record.schema import (
    CauseRecord,
    ComponentRecord,
    ConclusionRecord,
    ContrastRecord,
    FormRecord,
    Record,
    RegionRecord,
)
from anisoscope.record.surface_details import surface_of
from anisoscope.record.verdict import Verdict

OUTCOMES: Mapping[str, str] = {
    "pass": "Accept the part",
    "warning": "Accept the part; if the next parts deviate alike, check mould, material and lamp",
    "inconclusive": "Inspect it again; if it stays undecided, have a reviewer decide (anisoscope history dispose)",
    "uncertain": "Reduce the largest uncertainty of the budget (that of the plastic: anisoscope calibrate material) or "
    "widen the tolerance; until then have a reviewer decide (anisoscope history dispose)",
    "open": "Compare it with golden parts or with more parts of its lot, or photograph more poses; until then have "
    "a reviewer decide (anisoscope history dispose)",
    "misfit": "Teach golden prints (anisoscope golden add) or measure the ink (anisoscope ink fit); until then have a "
    "reviewer decide (anisoscope history dispose)",
    "invalid": "Put right what the reason names and inspect the part again; nothing is known about the part",
    "unexplained": "Seat it again once; if it fails again, set it aside for a reviewer: no known cause explains it",
    "undiagnosed": "Seat it again once; if it fails again, reject it or have a reviewer decide",
    "tied": "Seat it again once; if it fails again, set it aside for a reviewer: several causes explain it alike",
}
"""What to do next without one known cause; keys of the recipe's ``[actions]`` besides the names of causes."""


def concluded(
    record: Record, words: Mapping[str, CauseWords], measured: str, nominal: Mapping[str, float]
) -> ConclusionRecord:
    """Finding and action of an inspection.

    Args:
        record: the inspection.
        words: of the causes of its kind.
        measured: the finding by numbers alone, without a cause, as a sentence without full stop.
        nominal: what the extent of a cause is added to, by cause, such as the ridge angle of the design.
    """
    key, finding = _of_verdict(record, words, measured, nominal)
    shop = record.recipe.get("actions") or {}
    general = OUTCOMES.get(key) or words[key].action
    return ConclusionRecord(
        finding=_sentence(finding), action=_sentence(str(shop.get(key, general))), follows_from=key
    )


RIVAL = 0.1
"""Weight, in that of the best cause, from which on a cause that ties with it is named in the same sentence."""
LIKELY = 0.05
"""Probability on a good part from which on a region of a single cell is no finding."""


SINK, BULGE = "sink mark", "bulge"
FORM_MM = 0.5
"""Distance of a region from the middle of a hollow or bulge within which it is its flank."""
SECOND_KIND = 0.15
"""Weight from which on a kind of a region is shown besides the likeliest."""
POSSIBLE = 0.05
"""Weight from which on a region may be of the kind that the diagnosis, which sees the whole part, names."""
Kinds = tuple[tuple[str, float | None], ...]
"""Kinds that a region may be of with their weights; None for one that the diagnosis or the shape names."""


def named_regions(record: Record, words: Mapping[str, CauseWords]) -> tuple[tuple[RegionRecord, Kinds], ...]:
    """Regions of the deviation map worth a line, with their kinds.

    Single cells that good parts show as well are left out. Where the area fails, the largest come first. A region is
    called by the cause that the diagnosis names, where that leaves regions and is among its own kinds.
    """
    details = surface_of(record)
    found = [one for one in details.regions if one.cells > 1 or one.p_value < LIKELY]
    if details.area is not None and details.area.verdict == Verdict.FAIL:
        found.sort(key=lambda one: -one.cells)
    named, form = _named(record, words), _form_of(record)
    word = named[0].words.region if len(named) == 1 else ""
    if form is None:
        return tuple((one, _kinds(one, word)) for one in found)
    hollow: Kinds = ((SINK if form.depth_um > 0.0 else BULGE, None),)
    return tuple(
        (one, hollow if math.hypot(one.x - form.x, one.y - form.y) < FORM_MM else _kinds(one, word))
        for one in found
    )


def _kinds(region: RegionRecord, word: str) -> Kinds:
    if not region.weights or region.weights.get(word, 0.0) >= POSSIBLE:
        return ((word or region.kind, None),)
    most = max(region.weights.values())
    return tuple((name, one) for name, one in region.weights.items() if one >= min(SECOND_KIND, most))


def surface_finding(record: Record) -> str:
    """The contrast or the area of a surface that is most off, by its limit or its uncertainty; no full stop."""
    found = surface_of(record)
    if not found.contrasts:
        return record.reasons[0] if record.reasons else ""
    worst = max(found.contrasts, key=_by_limit)
    if found.area is not None and found.area.share / found.area.max_share > min(_by_limit(worst), 1.0):
        area = found.area
        return f"{100.0 * area.share:.1f} % of the area deviates (limit {100.0 * area.max_share:g} %)"
    if found.area is not None and found.area.too_long:
        return f"A mark is {found.area.longest_um:.0f} µm long (limit {found.area.max_length_um:g} µm)"
    if found.form is not None and found.form.verdict != Verdict.PASS:
        return _form_finding(found.form)
    tilts = [one for one in found.between_tilts if one.p_value < record.recipe["decision"]["alpha"]]
    if tilts and worst.tolerance is None and record.verdict != "PASS":
        most = min(
            tilts, key=lambda one: (one.p_value, -abs(one.measured - one.predicted) / max(one.u, 1e-12))
        )
        off = most.measured - most.predicted
        return (
            f"Between tilt {most.from_tilt_deg:g}° and {most.to_tilt_deg:g}° at {most.stage_deg:g}° the brightness "
            f"is off by a factor of {math.exp(abs(off)):.2g} (p {p_value_text(most.p_value)})"
        )
    return _contrast_finding(worst)


def _form_of(record: Record) -> FormRecord | None:
    """The hollow or bulge that fails a part; it is measured, where the cells alone would have a cause of their own."""
    form = surface_of(record).form if record.verdict == "FAIL" else None
    return form if form is not None and form.verdict == Verdict.FAIL and form.depth_um != 0.0 else None


def _form_finding(form: FormRecord) -> str:
    lean, limit, depth = f"{form.lean_deg:.2g}", f"{form.max_lean_deg:g}", f"{abs(form.depth_um):.1f}"
    if form.depth_um == 0.0:
        return f"Several ridges lean by {lean}° from those around (limit {limit}°)"
    if form.depth_um > 0.0:
        return f"Several ridges lean by {lean}° from those around (limit {limit}°): a sink mark of {depth} µm"
    return f"Several ridges lean by {lean}° from those around (limit {limit}°): a bulge of {depth} µm"


def _by_limit(contrast: ContrastRecord) -> float:
    if contrast.tolerance is not None:
        return abs(contrast.deviation) / contrast.tolerance
    return abs(contrast.deviation) / (6.0 * contrast.u) if contrast.u > 0.0 else 0.0


def _contrast_finding(worst: ContrastRecord) -> str:
    unit = {"log_ratio": "", "michelson": "", "difference": "/sr"}.get(worst.kind, "")
    tolerance = "" if worst.tolerance is None else f"{worst.tolerance:g}{unit}"
    limit = f"tolerance ±{tolerance}" if tolerance else "no tolerance set"
    contrast = quantity_name(worst.kind, worst.from_deg, worst.to_deg, worst.tilt_deg)
    extent = "".join((f"{worst.deviation:+.2g}", " ± ", f"{2.0 * worst.u:.1g}", unit))
    return f"Largest deviation: {contrast} is off by {extent} ({limit})"


def _of_verdict(
    record: Record, words: Mapping[str, CauseWords], measured: str, nominal: Mapping[str, float]
) -> tuple[str, str]:
    """Key of the action, and the finding."""
    reason = record.reasons[0] if record.reasons else "no reason is recorded"
    fault = None if record.diagnosis is None else record.diagnosis.rig_fault
    if record.verdict == "INVALID":
        return fault or "invalid", f"The part was not judged: {reason}"
    if record.verdict == "INCONCLUSIVE":
        return (fault, reason) if fault else _undecided(record, measured)
    named = _named(record, words)
    finding = _finding(named, nominal, _sign_unknown(record, named))
    rivals = _rivals(record, named)
    if rivals:
        others = ", ".join(rivals)
        finding = f"{finding}; cannot be distinguished from: {others}"
    if record.verdict == "FAIL":
        return _failed(record, named, finding, measured, tied=bool(rivals))
    if reason.startswith("warning") or _apart(record):
        return "warning", f"The part is within its limits, but deviates. {finding or measured}"
    return "pass", _passed(record, measured)


def _undecided(record: Record, measured: str) -> tuple[str, str]:
    """Key of the action, and the finding, of an INCONCLUSIVE part."""
    if record.details is not None and record.details.not_described:
        return "misfit", record.details.not_described[0].upper() + record.details.not_described[1:]
    if left_open(record):
        blind = blind_to(record)
        if any(one.startswith("warning") for one in record.reasons):
            return "open", f"The part is within its limits, but not excluded: {blind}"
        return "open", f"No deviation was found, but not excluded: {blind}"
    unsure = _too_uncertain(record)
    return (
        ("uncertain", unsure) if unsure else ("inconclusive", f"Too close to a limit to decide. {measured}")
    )


def _too_uncertain(record: Record) -> str:
    """The contrast that no part can pass, since its guard band takes its whole tolerance; empty where there is none."""
    for one in surface_of(record).contrasts:
        if one.guard is not None and one.tolerance is not None and one.guard >= one.tolerance:
            contrast = quantity_name(one.kind, one.from_deg, one.to_deg, one.tilt_deg)
            known, limit = f"{2.0 * one.u:.2g}", f"{one.tolerance:g}"
            return (
                f"Too uncertain to decide: {contrast} is known to ± {known} only, so that no part passes its "
                f"tolerance ±{limit}"
            )
    return ""


def _apart(record: Record) -> bool:
    """Whether a single contrast is further off than chance takes it, though all together are not."""
    alpha = record.recipe["decision"]["alpha"]
    return any(one.p_value is not None and one.p_value < alpha for one in surface_of(record).contrasts)


def _passed(record: Record, measured: str) -> str:
    if blind := blind_to(record):
        return (
            f"The part is as it should be, as far as these poses show it. Not excluded: {blind}. {measured}"
        )
    if limits := beyond(record):
        return f"The part is as it should be. Excluded with 95% confidence: {limits}. {measured}"
    return f"The part is as it should be. {measured}"


def left_open(record: Record) -> bool:
    """Whether defects that are not excluded, and no limit, leave a part undecided."""
    near = record.details is not None and record.details.near_limit
    return not near and any(not one.excluded for one in record.exclusions)


def blind_to(record: Record) -> str:
    """The defects that are not excluded, in words; empty where there are none."""
    named = [
        one.name if one.limit is None else f"{one.name} (up to {one.text(one.limit).strip()}{one.place})"
        for one in record.exclusions
        if not one.excluded
    ]
    return ", ".join(named)


def beyond(record: Record) -> str:
    """The sizes beyond which defects are excluded, in words."""
    return ", ".join(f"{one.words}{one.text(one.limit)}" for one in record.exclusions if one.excluded)


class _Named(NamedTuple):
    """A cause with its words."""

    cause: CauseRecord | ComponentRecord
    key: str
    words: CauseWords

    @property
    def opposite(self) -> str:
        """Cause of the opposite sign, or ""."""
        return self.words.opposite and self.words.opposite + self.cause.cause.removeprefix(self.key)


def _failed(
    record: Record, named: tuple[_Named, ...], finding: str, measured: str, *, tied: bool
) -> tuple[str, str]:
    """Key of the action, and the finding, of a part that fails."""
    form = _form_of(record)
    if form is not None:
        return "undiagnosed", _form_finding(form)
    if not named:
        return "undiagnosed" if record.diagnosis is None else "unexplained", measured
    return "tied" if tied else named[0].key, finding


def _named(record: Record, words: Mapping[str, CauseWords]) -> tuple[_Named, ...]:
    """The best cause, or the two that act together, if the kind has words for them and their size is not zero."""
    diagnosis = record.diagnosis
    if diagnosis is None or not diagnosis.causes or diagnosis.causes[0].cause in {NOTHING, OTHER}:
        return ()
    left = diagnosis.unexplained_p
    if left is not None and left < record.recipe["decision"]["alpha"]:
        return ()
    best = diagnosis.causes[0]
    causes = best.components if best.components and words_of(best.cause, words) is None else (best,)
    found = tuple(_Named(one, *known) for one in causes if (known := words_of(one.cause, words)))
    return found if len(found) == len(causes) and not any(_may_be_zero(one.cause) for one in found) else ()


def _may_be_zero(cause: CauseRecord | ComponentRecord) -> bool:
    """Whether the 95 % interval of an extent holds zero, so that it is no finding."""
    low, high = cause.interval or (None, None)
    return low is not None and high is not None and low <= 0.0 <= high


def _rivals(record: Record, named: tuple[_Named, ...]) -> tuple[str, ...]:
    """Titles of the causes that explain the part as well as the best one and are nearly as probable."""
    if not named or record.diagnosis is None:
        return ()
    best, *others = record.diagnosis.causes
    no_finding = {NOTHING, OTHER, named[0].opposite}
    return tuple(
        bare_title(one.title)
        for one in others
        if one.tie and one.cause not in no_finding and one.weight >= RIVAL * best.weight
    )


def _sign_unknown(record: Record, named: tuple[_Named, ...]) -> bool:
    """Whether the cause of the opposite sign explains the part as well."""
    if not named or record.diagnosis is None:
        return False
    return any(one.tie and one.cause == named[0].opposite for one in record.diagnosis.causes)


def _finding(named: tuple[_Named, ...], nominal: Mapping[str, float], sign_unknown: bool) -> str:
    if not named:
        return ""
    if sign_unknown:
        return _one(named[0], named[0].words.either, None)
    first, *more = (
        _one(one, one.words.finding(one.cause.severity), nominal.get(one.cause.cause)) for one in named
    )
    return first if not more else f"Two findings together. {first}. {more[0]}"


def _one(one: _Named, sentence: str, nominal: float | None) -> str:
    cause = one.cause
    if "{size}" not in sentence:
        return sentence
    scale, unit = (100.0, " %") if cause.unit == "" and one.words.percent else (1.0, cause.unit)
    unit = unit if unit in {"", "°", " %"} else f" {unit}"
    half = _half(cause, scale)
    size = _rounded(abs(scale * cause.severity), half)
    text = sentence.format(size=f"{size}{unit}", name=cause.cause.removeprefix(f"{one.key}-"))
    total = "" if nominal is None else f"{_rounded(nominal + scale * cause.severity, half)}{unit}"
    known = "" if half is None else f"± {_rounded(half, half)}{unit}"
    if half is None and not total:
        known = _one_end(cause, scale, unit)
    bracket = f" ({f'{total} {known}'.strip()})" if total or known else ""
    place = len(text) if ";" not in text else text.index(";")
    return text[:place] + bracket + text[place:]


def _half(cause: CauseRecord | ComponentRecord, scale: float) -> float | None:
    """Half of the 95 % interval of an extent; None where an end of it is unknown."""
    low, high = cause.interval or (None, None)
    return None if low is None or high is None or not high > low else 0.5 * scale * (high - low)


def _one_end(cause: CauseRecord | ComponentRecord, scale: float, unit: str) -> str:
    """Single known end of a 95 % interval, as where marks cover more than the predicted signatures reach."""
    low, high = cause.interval or (None, None)
    if (low is None) == (high is None) or cause.severity == 0.0:
        return ""
    end = high if low is None else low
    word = "at least" if (low is None) == (cause.severity < 0.0) else "at most"
    assert end is not None
    return f"{word} {_rounded(abs(scale * end), None)}{unit}" if end * cause.severity > 0.0 else ""


def _rounded(value: float, half: float | None) -> str:
    """A value with the decimals that its 95 % interval deserves: the first figure of its half."""
    if half is None:
        return f"{value:.2g}" if value < 100.0 else f"{value:.0f}"
    return f"{value:.{max(0, -math.floor(math.log10(half)))}f}"


def _sentence(text: str) -> str:
    text = text.strip()
    return text if text.endswith((".", "!", "?")) else f"{text}."
