"""Attribute agreement: decisions good or bad on parts of known quality (AIAG MSA, 4th edition, III-C).

Agreement beyond chance is Cohen's kappa between two appraisers, or of one with the reference, over all decisions (J.
Cohen, Educational and Psychological Measurement 20 (1960) 37), and Fleiss' kappa within and among appraisers (J. L.
Fleiss, Psychological Bulletin 76 (1971) 378). Trials of one part are not independent, so that the intervals of the
kappas are those of a delete-one jackknife over parts (R. G. Miller, Biometrika 61 (1974) 1).

Where the reference is measured, the signal-detection method takes the width of the zones in which decisions disagree
as the spread of the measurement process (AIAG III-C; ISO 22514-7:2012, 12.3: U = d/2, Q = d over the tolerance).
"""

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from itertools import combinations
from pathlib import Path

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.csv_style import CsvReader
from anisoscope.base.csv_table import read_text
from anisoscope.base.errors import UsageError
from anisoscope.base.json_fields import LEFT_OUT, in_json
from anisoscope.base.significance import proportion_interval
from anisoscope.quality.readings import INVALID, Readings

CONFIDENCE = 0.95
IntArray = npt.NDArray[np.int_]
WORDS = {
    **dict.fromkeys(("1", "good", "pass", "ok", "accept", "go"), 1),
    **dict.fromkeys(("0", "bad", "fail", "nok", "ng", "reject", "no-go", "nogo"), 0),
}
"""Words of a decision; in the history INCONCLUSIVE rejects a part as FAIL does."""
REJECTING = {"FAIL", "INCONCLUSIVE"}
GOOD_KAPPA, POOR_KAPPA = 0.75, 0.40
LIMITS = {"effectiveness": (0.90, 0.80), "miss": (0.02, 0.05), "false alarm": (0.05, 0.10)}
"""Acceptable and marginal, as AIAG prints them."""


@dataclass(frozen=True, eq=False)
class AttributeData:
    """Decisions of a crossed study.

    Attributes:
        parts: P names.
        appraisers: O names.
        decisions: (P, O, R) 1 for good, 0 for bad.
        reference: (P,) what the parts are, in the same way.
        values: (P,) measured reference values, or None.
        notes: what the reader should know about the data.
    """

    parts: tuple[str, ...]
    appraisers: tuple[str, ...]
    decisions: IntArray
    reference: IntArray
    values: FloatArray | None = None
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Share:
    """A share of parts or decisions with its interval after Clopper and Pearson."""

    count: int
    of: int
    low: float
    high: float

    @property
    @in_json()
    def value(self) -> float | None:
        """Count over number; None for an empty sample."""
        return self.count / self.of if self.of else None


def share(count: int, of: int, confidence: float = CONFIDENCE) -> Share:
    """A share with its interval."""
    return Share(count, of, *proportion_interval(count, of, confidence))


@dataclass(frozen=True)
class Kappa:
    """Agreement beyond chance and its interval; NaN where chance alone agrees always."""

    value: float
    low: float
    high: float


@dataclass(frozen=True)
class Pair:
    """Two appraisers, or one and the reference: decisions in a table, and Cohen's kappa.

    Attributes:
        first, second: names.
        table: decisions: both bad, only the second good, only the first good, both good.
        kappa: Cohen's.
    """

    first: str
    second: str
    table: tuple[int, int, int, int]
    kappa: Kappa


@dataclass(frozen=True)
class Appraiser:
    """What one appraiser did.

    Attributes:
        name: of the appraiser.
        consistent: parts on which all own trials agree.
        effectiveness: parts on which all own trials agree with the reference.
        miss: decisions "good" on bad parts.
        false_alarm: decisions "bad" on good parts.
        with_reference: kappa of Cohen with the reference.
        within: kappa of Fleiss among the own trials; None for one trial.
    """

    name: str
    consistent: Share
    effectiveness: Share
    miss: Share
    false_alarm: Share
    with_reference: Pair
    within: Kappa | None

    @property
    @in_json()
    def rating(self) -> str:
        """The worst of the three rates by AIAG's table: acceptable, marginal or unacceptable."""
        found = (
            ("effectiveness", -1.0, self.effectiveness),
            ("miss", 1.0, self.miss),
            ("false alarm", 1.0, self.false_alarm),
        )
        worst = 0
        for name, sign, one in found:
            if one.value is not None:
                good, marginal = LIMITS[name]
                worst = max(worst, sum(sign * one.value > sign * end + 1e-12 for end in (good, marginal)))
        return ("acceptable", "marginal", "unacceptable")[worst]


@dataclass(frozen=True)
class Zone:
    """Signal detection: the ranges of the reference value in which decisions disagree.

    Attributes:
        upper: (last value rejected by all, first value accepted by all) from above; None without such parts.
        lower: (last value accepted by all, first value rejected by all) further down.
        width: d, mean width of the zones.
        uncertainty: d/2, expanded uncertainty of the decisions.
        tolerance: width between the limits, or None.
        share: d over the tolerance (%GRR of AIAG, Q_attr of ISO 22514-7) as a share.
    """

    upper: tuple[float, float] | None
    lower: tuple[float, float] | None
    width: float
    uncertainty: float
    tolerance: float | None
    share: float | None


@dataclass(frozen=True, eq=False)
class AttributeStudy:
    """Result of an attribute study.

    Attributes:
        data: the decisions.
        appraisers: one each.
        pairs: of appraisers.
        among: kappa of Fleiss among all decisions of all appraisers; None for one decision a part.
        all_agree: parts on which all decisions agree.
        all_right: parts on which all agree with the reference.
        zone: signal detection; None without measured reference values.
        confidence: of the intervals.
        notes: what the reader should know.
    """

    data: AttributeData = field(metadata=LEFT_OUT)
    appraisers: tuple[Appraiser, ...]
    pairs: tuple[Pair, ...]
    among: Kappa | None
    all_agree: Share
    all_right: Share
    zone: Zone | None
    confidence: float
    notes: tuple[str, ...]

    @property
    @in_json()
    def parts(self) -> int:
        """Parts of the study."""
        return len(self.data.parts)

    @property
    @in_json()
    def trials(self) -> int:
        """Decisions of every appraiser on every part."""
        return int(self.data.decisions.shape[2])

    @property
    @in_json()
    def acceptable(self) -> bool:
        """No appraiser is unacceptable, and every kappa with the reference is above 0.75."""
        good = all(one.with_reference.kappa.value > GOOD_KAPPA for one in self.appraisers)
        return good and all(one.rating != "unacceptable" for one in self.appraisers)

    @property
    @in_json()
    def verdict(self) -> str:
        """The outcome in plain words."""
        least = min(self.appraisers, key=lambda one: one.with_reference.kappa.value)
        value = least.with_reference.kappa.value
        word = "good" if value > GOOD_KAPPA else "poor" if value < POOR_KAPPA else "moderate"
        bad = [one.name for one in self.appraisers if one.rating == "unacceptable"]
        text = f"{word} agreement with the reference: kappa {value:.2f} at least ({least.name})"
        return text + (f"; unacceptable rates: {', '.join(bad)}" if bad else "; no unacceptable rate")


def attribute_study(
    data: AttributeData, tolerance: float | None = None, confidence: float = CONFIDENCE
) -> AttributeStudy:
    """Analyse a crossed attribute study.

    Args:
        data: at least two parts.
        tolerance: width between the limits of good parts, for the share of signal detection.
        confidence: of the intervals.

    Raises:
        UsageError: fewer than two parts, parts of one kind only, or a tolerance that is none.
    """
    if len(data.parts) < 2 or len(set(data.reference.tolist())) < 2:
        raise UsageError(
            "an attribute study needs good and bad parts: the reference says the same of all parts"
        )
    if tolerance is not None and not 0.0 < tolerance < math.inf:
        raise UsageError(f"the tolerance must be a finite width above 0, not {tolerance:g}")
    if not 0.5 < confidence < 1.0:
        raise UsageError(f"the confidence of the intervals lies between 0.5 and 1, not at {confidence:g}")
    count, _, trials = data.decisions.shape
    repeated = np.repeat(data.reference[:, None], trials, axis=1)

    def pair(first: tuple[str, IntArray], second: tuple[str, IntArray]) -> Pair:
        tables = _tables(first[1], second[1])
        whole = tables.sum(axis=0)
        found = _jackknife(lambda keep: cohen(tables[keep].sum(axis=0)), count, confidence)
        return Pair(first[0], second[0], (*map(int, whole.ravel().tolist()),), found)  # type: ignore[arg-type]

    def agreement(decisions: IntArray) -> Kappa | None:
        if decisions.shape[1] < 2:
            return None
        return _jackknife(lambda keep: fleiss(decisions[keep]), count, confidence)

    def one_share(hits: npt.NDArray[np.bool_]) -> Share:
        return share(int(np.count_nonzero(hits)), hits.size, confidence)

    own = [(name, data.decisions[:, k, :]) for k, name in enumerate(data.appraisers)]
    good = data.reference == 1
    appraisers = tuple(
        Appraiser(
            name,
            one_share((made == made[:, :1]).all(axis=1)),
            one_share((made == repeated).all(axis=1)),
            one_share(made[~good] == 1),
            one_share(made[good] == 0),
            pair((name, made), ("reference", repeated)),
            agreement(made),
        )
        for name, made in own
    )
    everything = data.decisions.reshape(count, -1)
    return AttributeStudy(
        data,
        appraisers,
        tuple(pair(one, other) for one, other in combinations(own, 2)),
        agreement(everything),
        one_share((everything == everything[:, :1]).all(axis=1)),
        one_share((everything == data.reference[:, None]).all(axis=1)),
        None if data.values is None else detection_zone(data.values, everything, tolerance),
        confidence,
        (*data.notes, *_notes(data)),
    )


def cohen(table: IntArray) -> float:
    """Cohen's kappa of a (K, K) table of decisions; NaN where chance alone agrees always."""
    whole = table.sum()
    seen = np.trace(table) / whole
    chance = float(table.sum(axis=0) @ table.sum(axis=1)) / float(whole) ** 2
    return float((seen - chance) / (1.0 - chance)) if chance < 1.0 else math.nan


def fleiss(decisions: IntArray) -> float:
    """Fleiss' kappa of (P, n) decisions 0 or 1, n on every part; NaN where all are the same."""
    parts, raters = decisions.shape
    good = decisions.sum(axis=1)
    pairs = good * (good - 1) + (raters - good) * (raters - good - 1)
    seen = float(pairs.mean()) / (raters * (raters - 1))
    p = float(good.sum()) / (parts * raters)
    chance = p**2 + (1.0 - p) ** 2
    return (seen - chance) / (1.0 - chance) if chance < 1.0 else math.nan


def _tables(first: IntArray, second: IntArray) -> IntArray:
    """(P, 2, 2) decisions of every part by what both said."""
    cells = [[((first == i) & (second == j)).sum(axis=1) for j in (0, 1)] for i in (0, 1)]
    return np.moveaxis(np.array(cells), -1, 0)


def _jackknife(statistic: Callable[[npt.NDArray[np.bool_]], float], count: int, confidence: float) -> Kappa:
    """A kappa with its interval from the parts left out one by one, by Student's t."""
    from scipy.special import stdtrit  # noqa: PLC0415 - heavy

    whole = statistic(np.ones(count, dtype=np.bool_))
    without = np.array([statistic(np.arange(count) != k) for k in range(count)])
    if math.isnan(whole) or np.isnan(without).any():
        return Kappa(whole, math.nan, math.nan)
    u = math.sqrt((count - 1) / count * float(np.sum((without - without.mean()) ** 2)))
    reach = u * float(stdtrit(count - 1, 0.5 + confidence / 2.0))
    return Kappa(whole, max(whole - reach, -1.0), min(whole + reach, 1.0))


def detection_zone(values: FloatArray, decisions: IntArray, tolerance: float | None) -> Zone | None:
    """Zones of disagreement along the measured reference.

    Args:
        values: (P,) reference values.
        decisions: (P, n) of all appraisers and trials.
        tolerance: width between the limits, or None.

    Returns:
        None where no part is accepted by all, or none beyond the accepted ones is rejected by all.
    """
    order = np.argsort(-values)
    value, made = values[order], decisions[order]
    accepted = np.flatnonzero((made == 1).all(axis=1))
    rejected = np.flatnonzero((made == 0).all(axis=1))
    if not accepted.size or not rejected.size:
        return None
    above, below = rejected[rejected < accepted[0]], rejected[rejected > accepted[-1]]
    upper = (float(value[above[-1]]), float(value[accepted[0]])) if above.size else None
    lower = (float(value[accepted[-1]]), float(value[below[0]])) if below.size else None
    widths = [high - low for high, low in (zone for zone in (upper, lower) if zone is not None)]
    if not widths:
        return None
    d = float(np.mean(widths))
    return Zone(upper, lower, d, d / 2.0, tolerance, None if tolerance is None else d / tolerance)


def _notes(data: AttributeData) -> Iterable[str]:
    parts, appraisers, trials = data.decisions.shape
    if parts < 50:
        yield f"only {parts} parts: AIAG advises 50 or more, with a quarter near each limit"
    if trials < 3:
        yield f"{trials} trial(s): AIAG advises 3"
    if appraisers == 1:
        yield "one appraiser: nothing is known about agreement between appraisers"
    bad = int(np.count_nonzero(data.reference == 0))
    if min(bad, parts - bad) < 10:
        yield f"{bad} bad and {parts - bad} good parts: rates of the rarer kind are hardly known"


def read_decisions(path: Path) -> AttributeData:
    """Read a CSV file: part, appraiser, decision, reference, and perhaps value and trial; one decision a line.

    Raises:
        UsageError: the file cannot be read, a line cannot be used, or the study is not crossed.
    """
    needed, columns, rows = {"part", "decision", "reference"}, *_rows(path)
    if not needed <= set(columns):
        raise UsageError(
            f"{path}, line 1: an attribute study needs the columns part, appraiser, decision and reference (and value, "
            f"where it is measured), not {','.join(columns)}"
        )
    made: dict[tuple[str, str], list[int]] = {}
    reference: dict[str, int] = {}
    values: dict[str, float] = {}
    for place, row in rows:
        part = row["part"]
        made.setdefault((part, row.get("appraiser", "") or "one"), []).append(_word(row["decision"], place))
        known = _word(row["reference"], place)
        if reference.setdefault(part, known) != known:
            raise UsageError(
                f"{place}: part {part} is good in one line and bad in another: correct the reference"
            )
        if "value" in columns:
            value = _number(row["value"], place)
            if values.setdefault(part, value) != value:
                raise UsageError(
                    f"{place}: part {part} has two reference values, {values[part]:g} and {value:g}"
                )
    return _crossed(str(path), made, reference, values)


def decisions_of_history(readings: Readings, masters: Path) -> AttributeData:
    """Decisions of past inspections of master parts; the serial number is the part, the operator the appraiser.

    INVALID inspections made no decision and are left out; INCONCLUSIVE rejects.

    Args:
        readings: of the history.
        masters: CSV file with the columns part, reference, and perhaps value.

    Raises:
        UsageError: the file cannot be used, a master part was not inspected, or not as often as the others.
    """
    columns, rows = _rows(masters)
    if not {"part", "reference"} <= set(columns):
        raise UsageError(
            f"{masters}, line 1: master parts need the columns part and reference, not {','.join(columns)}"
        )
    reference = {row["part"]: _word(row["reference"], place) for place, row in rows}
    values = {row["part"]: _number(row["value"], place) for place, row in rows} if "value" in columns else {}
    made: dict[tuple[str, str], list[int]] = {}
    left = 0
    columns_of = (readings.column(name) for name in ("serial", "operator", "verdict"))
    for serial, operator, verdict in zip(*columns_of, strict=True):
        if serial in reference and verdict != INVALID:
            made.setdefault((serial, operator or "rig"), []).append(int(verdict not in REJECTING))
        left += serial in reference and verdict == INVALID
    seen = {part for part, _ in made}
    missing = [part for part in reference if part not in seen]
    if missing:
        raise UsageError(
            f"{masters}: part {missing[0]} was never inspected with a decision ({readings.source})"
        )
    notes = (f"{left} INVALID inspections made no decision and are left out",) if left else ()
    return _crossed(readings.source, made, reference, values, notes)


def _rows(path: Path) -> tuple[list[str], list[tuple[str, dict[str, str]]]]:
    """Header, and every line by column with its place."""
    reader = CsvReader(read_text(path), path)
    columns = [name.strip() for name in next(reader, [])]
    lines = [(reader.line_num, row) for row in reader if any(text.strip() for text in row)]
    if not lines:
        raise UsageError(f"{path}, line 2: no decisions follow the header")
    found = []
    for number, row in lines:
        if len(row) != len(columns):
            raise UsageError(f"{path}, line {number}: {len(columns)} values expected, {len(row)} found")
        fields = {name: text.strip() for name, text in zip(columns, row, strict=True)}
        if "value" in fields:
            fields["value"] = reader.with_point(fields["value"])
        found.append((f"{path}, line {number}", fields))
    return columns, found


def _word(text: str, place: str) -> int:
    if text.lower() not in WORDS:
        raise UsageError(f"{place}: {text!r} is no decision: write 1 or good, 0 or bad")
    return WORDS[text.lower()]


def _number(text: str, place: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise UsageError(f"{place}: the reference value must be a finite number, not {text!r}")
    return value


def _crossed(
    source: str,
    made: Mapping[tuple[str, str], list[int]],
    reference: Mapping[str, int],
    values: Mapping[str, float],
    notes: tuple[str, ...] = (),
) -> AttributeData:
    appraisers = tuple(dict.fromkeys(by for _, by in made))
    trials = max(len(cell) for cell in made.values())
    for part in reference:
        for by in appraisers:
            found = len(made.get((part, by), ()))
            if found != trials:
                raise UsageError(
                    f"{source}: part {part} was judged {found} times by {by}, others {trials} times: an attribute "
                    "study needs every part judged equally often by everybody"
                )
    return AttributeData(
        tuple(reference),
        appraisers,
        np.array([[made[part, by] for by in appraisers] for part in reference]),
        np.array(list(reference.values())),
        np.array([values[part] for part in reference]) if values else None,
        notes,
    )
