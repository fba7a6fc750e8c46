"""Capability of a measuring system and a measurement process: type-1 study, ISO 22514-7:2012 and VDA volume 5.

The type-1 study compares repeated measurements of one standard with a share of the tolerance (Cg, Cgk). ISO 22514-7
and VDA 5 combine what makes a measurement uncertain: of the measuring system, measured on standards (calibration,
resolution, repeatability, bias, linearity), and of the process, measured on parts (repeatability on parts, appraisers,
their interaction, and what is stated). Q is twice the expanded uncertainty over the tolerance.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import UsageError
from anisoscope.base.json_fields import in_json, json_field
from anisoscope.parameters.measurement_process import ProcessInputs
from anisoscope.quality.bias import Bias, bias_study
from anisoscope.quality.capability import Index, nearer_index, spread_index
from anisoscope.quality.gauge import GaugeStudy

SHARE, CAPABLE = 0.20, 1.33
"""Share of the tolerance that 6 sigma of a type-1 study may fill, and the least Cg and Cgk."""
RESOLUTION_SHARE = 0.05
COVERAGE = 2.0
SYSTEM_LIMIT, PROCESS_LIMIT = ProcessInputs.system_limit, ProcessInputs.process_limit
"""Largest Q of the measuring system and of the measurement process that VDA 5 recommends."""
MIN_STANDARD = 25
ALPHA = 0.05


def _width(tolerance: float) -> float:
    if not 0.0 < tolerance < math.inf:
        raise UsageError(f"the tolerance must be a finite width above 0, not {tolerance:g}")
    return tolerance


@dataclass(frozen=True)
class TypeOne:
    """Result of a type-1 study.

    Attributes:
        bias: of the measurements, with its t test.
        tolerance: width between the limits.
        cg: 0.2 tolerance over 6 sigma, with its interval.
        cgk: distance of the mean from the nearer end of ±0.1 tolerance about the reference, over 3 sigma.
        resolution: of the gauge, or None.
        smallest_tolerance: for which Cg and Cgk reach 1.33.
        notes: what the reader should know.
    """

    bias: Bias = field(metadata=json_field(merged=True))
    tolerance: float
    cg: Index
    cgk: Index
    resolution: float | None
    smallest_tolerance: float
    notes: tuple[str, ...]

    @property
    @in_json()
    def capable(self) -> bool:
        """Cg and Cgk reach 1.33, and the resolution is 5 % of the tolerance or finer."""
        fine = self.resolution is None or self.resolution <= RESOLUTION_SHARE * self.tolerance
        return fine and min(self.cg.value, self.cgk.value) >= CAPABLE

    @property
    @in_json()
    def repeatability_share(self) -> float:
        """6 sigma over the tolerance (%Var repeatability as a share)."""
        return SHARE / self.cg.value

    @property
    @in_json()
    def verdict(self) -> str:
        """The outcome in plain words."""
        where = f"Cg {self.cg.value:.2f}, Cgk {self.cgk.value:.2f} (1.33 wanted)"
        if self.capable:
            return f"capable: {where}"
        return f"not capable: {where}; capable for a tolerance of {self.smallest_tolerance:.3g} or wider"


def type_one(
    values: FloatArray, reference: float, tolerance: float, resolution: float | None = None
) -> TypeOne:
    """Cg and Cgk of repeated measurements of one standard.

    Cg = 0.2 T/(6 s) and Cgk = (0.1 T - |bias|)/(3 s).

    Args:
        values: (N,), NaN is missing.
        reference: value of the standard.
        tolerance: T, width between the limits of good parts.
        resolution: of the gauge, or None.

    Raises:
        UsageError: as for `bias_study`, or a tolerance that is none.
    """
    bias = bias_study(values, reference)
    half = SHARE / 2.0 * _width(tolerance)
    free = bias.count - 1.0
    cg = spread_index(2.0 * half, bias.sigma, free)
    cgk = nearer_index((half - abs(bias.bias)) / (3.0 * bias.sigma), bias.count, free)
    smallest = (abs(bias.bias) + 3.0 * CAPABLE * bias.sigma) / (SHARE / 2.0)
    if resolution is not None:
        smallest = max(smallest, resolution / RESOLUTION_SHARE)
    notes = (
        (f"only {bias.count} measurements: 50 are usual, {MIN_STANDARD} the least",)
        if bias.count < MIN_STANDARD
        else ()
    )
    return TypeOne(bias, tolerance, cg, cgk, resolution, smallest, notes)


@dataclass(frozen=True)
class Standards:
    """Standard uncertainties of a measuring system from measurements of standards.

    Attributes:
        repeatability: u_EVR.
        bias: u_BI; 0 where readings are corrected by the line.
        linearity: u_LIN; 0 where it is contained in the bias.
        intercept, slope: of the line of readings over references; None with fewer than three standards.
        lack_of_fit: F of the deviation of the means from the line and its p; None without a line.
        count: measurements.
    """

    repeatability: float
    bias: float
    linearity: float
    intercept: float | None
    slope: float | None
    lack_of_fit: tuple[float, float] | None
    count: int


def standards_study(references: FloatArray, values: FloatArray, *, corrected: bool = False) -> Standards:
    """Repeatability, bias and linearity on one or more standards.

    Not corrected: u_EVR² is the mean variance of repeated measurements, and u_BI the largest |bias| over √3, in which
    linearity is contained. Corrected, by the line of all readings: u_BI is 0, u_EVR² and u_LIN² are the mean squares
    within the standards and of their means about the line (ISO 22514-7:2012, 7.1.3 and A.1).

    Args:
        references: (N,) values of the standards.
        values: (N,) readings, NaN is missing.
        corrected: readings are corrected by the line.

    Raises:
        UsageError: a standard measured once, too few standards for a line, or no scatter.
    """
    from scipy.special import fdtrc  # noqa: PLC0415 - heavy

    valid = ~(np.isnan(values) | np.isnan(references))
    x, y = references[valid], values[valid]
    levels = [y[x == level] for level in np.unique(x)]
    if not levels or min(map(len, levels)) < 2:
        raise UsageError("every standard must be measured twice or more")
    within = float(sum(np.sum((one - one.mean()) ** 2) for one in levels))
    free = len(x) - len(levels)
    if within == 0.0:
        raise UsageError("all readings of a standard are the same: is the number rounded?")
    if len(levels) < 3:
        if corrected:
            raise UsageError(f"a correction by the line needs 3 or more standards, not {len(levels)}")
        intercept = slope = None
        about, lack = 0.0, None
    else:
        center = float(x.mean())
        slope = float(np.sum((x - center) * y) / np.sum((x - center) ** 2))
        intercept = float(y.mean()) - slope * center
        about = max(float(np.sum((y - intercept - slope * x) ** 2)) - within, 0.0)
        ratio = about / (len(levels) - 2) / (within / free)
        lack = ratio, float(fdtrc(len(levels) - 2, free, ratio))
    if corrected:
        line = math.sqrt(about / (len(levels) - 2))
        return Standards(math.sqrt(within / free), 0.0, line, intercept, slope, lack, len(x))
    off = max(abs(float(one.mean()) - float(at)) for at, one in zip(np.unique(x), levels, strict=True))
    spread = math.sqrt(float(np.mean([one.var(ddof=1) for one in levels])))
    return Standards(spread, off / math.sqrt(3.0), 0.0, intercept, slope, lack, len(x))


SYSTEM = ("CAL", "EV", "BI", "LIN", "MS-rest")
OF_PARTS = ("AV", "IA", "GV", "STAB", "OBJ", "T", "rest")
STATED = ("CAL", "LIN", "MS-rest", "GV", "STAB", "OBJ", "T", "rest")
"""Components that are stated as standard uncertainties: calibration, linearity, other of the system, gauges, stability,
object, temperature, other of the process."""


@dataclass(frozen=True)
class Uncertainty:
    """Combined uncertainty and what it means for a tolerance.

    Attributes:
        components: standard uncertainties by their names in VDA 5; EV is the largest of repeatability on the standard
            (EVR), on parts (EVO, of the process only) and resolution (RE).
        standard: combined.
        expanded: U, twice that.
        share: Q = 2U over the tolerance, as a share.
        limit: largest Q.
        smallest_tolerance: for which Q reaches the limit.
        capability: C = 0.3 tolerance over 3 or 6 standard uncertainties (ISO 22514-7, 9.2).
    """

    components: Mapping[str, float]
    standard: float
    expanded: float
    share: float
    limit: float
    smallest_tolerance: float
    capability: float

    @property
    @in_json()
    def capable(self) -> bool:
        """Q does not exceed its limit."""
        return self.share <= self.limit


@dataclass(frozen=True)
class MeasurementProcess:
    """Capability of a measuring system and of the process that uses it.

    Attributes:
        tolerance: width between the limits.
        system: of the measuring system.
        process: of the measurement process; None without measurements of parts.
        standards: what was found on the standards.
        resolution_share: resolution over the tolerance, or None.
        notes: what the reader should know.
    """

    tolerance: float
    system: Uncertainty
    process: Uncertainty | None
    standards: Standards
    resolution_share: float | None
    notes: tuple[str, ...]

    @property
    @in_json()
    def capable(self) -> bool:
        """System and process are, and the resolution is 5 % of the tolerance or finer."""
        fine = self.resolution_share is None or self.resolution_share <= RESOLUTION_SHARE
        return fine and self.system.capable and (self.process is None or self.process.capable)

    @property
    @in_json()
    def verdict(self) -> str:
        """The outcome in plain words."""
        found = [("measuring system", "Q_MS", self.system), ("measurement process", "Q_MP", self.process)]
        texts = [
            f"{name} {'capable' if one.capable else 'not capable'}: {q} {one.share:.1%} (limit {one.limit:.0%}), "
            f"smallest tolerance {one.smallest_tolerance:.3g}"
            for name, q, one in found
            if one is not None
        ]
        coarse = self.resolution_share is not None and self.resolution_share > RESOLUTION_SHARE
        return "; ".join(
            [*texts, *(["the resolution is coarser than 5 % of the tolerance"] if coarse else [])]
        )


def measurement_process(
    tolerance: float,
    standards: Standards,
    gauge: GaugeStudy | None = None,
    stated: Mapping[str, float] | None = None,
    *,
    resolution: float | None = None,
    largest_error: float | None = None,
    limits: tuple[float, float] = (SYSTEM_LIMIT, PROCESS_LIMIT),
) -> MeasurementProcess:
    """Combine the uncertainties of a measuring system and of the process that uses it.

    Args:
        tolerance: width between the limits of good parts.
        standards: from measurements of standards.
        gauge: crossed study of parts and appraisers, or None for the measuring system alone.
        stated: further standard uncertainties by the names in `STATED`.
        resolution: of the gauge; u_RE is this over √12.
        largest_error: maximum permissible error of the gauge: this over √3 in place of calibration, bias, linearity
            and repeatability on standards.
        limits: largest Q of system and process.

    Raises:
        UsageError: a number that makes no sense, or an unknown component.
    """
    width, more = _width(tolerance), dict(stated or {})
    for name, value in more.items():
        if name not in STATED:
            raise UsageError(f"there is no component {name!r}; state {', '.join(STATED)}")
        if not 0.0 <= value < math.inf:
            raise UsageError(f"the standard uncertainty {name} must be 0 or more, not {value:g}")
    coarse = 0.0 if resolution is None else resolution / math.sqrt(12.0)
    rest = {name: more[name] for name in ("MS-rest",) if name in more}
    if largest_error is not None:
        own = {"MPE": largest_error / math.sqrt(3.0), "RE": coarse} | rest
        base = {"MPE": own["MPE"]} | rest
    else:
        line = math.hypot(standards.linearity, more.get("LIN", 0.0))
        base = {"CAL": more.get("CAL", 0.0), "BI": standards.bias, "LIN": line} | rest
        own = base | {"EV": max(standards.repeatability, coarse)}
    system = _combined(own, width, limits[0], 6.0)
    process, notes = None, []
    if gauge is not None:
        on_parts = {
            "EV": max(gauge.repeatability.sigma, coarse, 0.0 if largest_error else standards.repeatability),
            "AV": 0.0 if gauge.appraiser is None else gauge.appraiser.sigma,
            "IA": 0.0 if gauge.interaction is None else gauge.interaction.sigma,
        }
        others = {name: more[name] for name in OF_PARTS if name in more}
        process = _combined(base | on_parts | others, width, limits[1], 3.0)
        if gauge.appraiser is None:
            notes.append("one appraiser: the influence of appraisers is taken as none")
    elif any(name in more for name in OF_PARTS):
        raise UsageError(
            "uncertainties of the process need measurements of parts: name them with --gauge-study"
        )
    if standards.count < 30:
        notes.append(f"{standards.count} measurements of standards: ISO 22514-7 asks for 30")
    if standards.lack_of_fit is not None and standards.lack_of_fit[1] < ALPHA:
        notes.append(f"the standards do not lie on a line (p {standards.lack_of_fit[1]:.2g})")
    share = None if resolution is None else resolution / width
    return MeasurementProcess(tolerance, system, process, standards, share, tuple(notes))


def _combined(components: Mapping[str, float], tolerance: float, limit: float, reach: float) -> Uncertainty:
    u = math.sqrt(sum(value**2 for value in components.values()))
    expanded = COVERAGE * u
    return Uncertainty(
        dict(components), u, expanded, 2.0 * expanded / tolerance, limit, 2.0 * expanded / limit,
        0.3 * tolerance / (reach * u) if u else math.inf,
    )  # fmt: skip
