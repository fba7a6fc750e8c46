"""Curves of detection over the size of a defect, and the trials that they are fitted to."""

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class SizeCurve:
    """Curve over the size of a defect.

    Attributes:
        size_scale: the curve is over the size or its logarithm.
        link: of hits: logistic or normal curve.
        confidence: confidence of intervals and of a90/95.
    """

    size_scale: Literal["linear", "log"] = "log"
    link: Literal["logit", "probit"] = "logit"
    confidence: float = 0.95


@dataclass(frozen=True)
class MasterSignals:
    """Signals of master parts.

    Attributes:
        threshold: of signals: a defect counts as found from this signal on.
        noise: noise: signals at or below this are known to be so only.
        saturation: saturation: signals at or above this are known to be so only.
        signal_scale: of signals: the signal or its logarithm.
    """

    threshold: float | None = None
    noise: float | None = None
    saturation: float | None = None
    signal_scale: Literal["linear", "log"] = "log"


@dataclass(frozen=True)
class PartTrials:
    """Simulated parts with a defect, each on a rig of its own.

    Attributes:
        parts: simulated parts with a defect.
        largest: largest simulated size; else found by a short series of trials.
        golden_parts: golden parts of every rig; with 0 the prediction is the reference.
        seed: seed of parts, rigs and errors.
    """

    parts: int = 400
    largest: float | None = None
    golden_parts: int = 3
    seed: int = 1
