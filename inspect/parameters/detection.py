"""Curves of detection over the size of a defect, and the trials that they are fitted to."""

from dataclasses import dataclass
from typing import Literal

from anisoscope.base.errors import UsageError


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
        defect: defect of simulated parts: height_loss, edge_radius [µm], ridge_angle [°], alpha, albedo.
        parts: simulated parts with a defect.
        largest: largest simulated size; else found by a short series of trials.
        golden_parts: golden parts of every rig; with 0 the prediction is the reference.
        seed: seed of parts, rigs and errors.
    """

    defect: str = "height_loss"
    parts: int = 400
    largest: float | None = None
    golden_parts: int = 3
    seed: int = 1


@dataclass(frozen=True)
class LotSize:
    """Parts of a lot, and how they are inspected.

    Attributes:
        parts: parts of the lot.
        golden_parts: golden parts of every rig, good parts all; with 0 the prediction is the reference.
        rigs: rigs, each with a plastic of its own, among which the parts are divided.
        u_pose: relative standard uncertainty of a pose by camera and lamp, with the recipe's frames.
        seed: seed of parts, rigs and errors.
    """

    parts: int = 1000
    golden_parts: int = 0
    rigs: int = 25
    u_pose: float = 0.003
    seed: int = 1


@dataclass(frozen=True)
class PoseChoice:
    """Poses that are allowed, and what they must show.

    Attributes:
        defects: smallest defect to be found, NAME=SIZE, in place of [defects]: ridge-angle=0.5, roughness=20%,
            height-loss=10% or wear=5um; repeat the option for several, others are then ignored.
        poses: number of poses, 3 or more.
        angles_deg: allowed stage angles: from:to:step, or a list; degrees.
        tilts_deg: allowed tilts: from:to:step, or a list; degrees.
        ignore: first words of a defect to ignore; repeat the option for several.
        u_pose: relative standard uncertainty of a pose by camera and lamp, with the recipe's frames.
        power: required probability of finding each defect.
        angle_map: begin with the three poses that show the angle of the facets best, across and along the ridges.

    Raises:
        UsageError: an uncertainty or a probability outside 0 to 1.
    """

    defects: tuple[str, ...] = ()
    poses: int = 6
    angles_deg: tuple[float, ...] = tuple(15.0 * step for step in range(24))
    tilts_deg: tuple[float, ...] = tuple(5.0 * step for step in range(-4, 5))
    ignore: tuple[str, ...] = ("roughness along",)
    u_pose: float = 0.003
    power: float = 0.9
    angle_map: bool = False

    def __post_init__(self) -> None:
        if not 0.0 < self.u_pose < 1.0:
            raise UsageError(
                f"the uncertainty of a pose by camera and lamp is a share between 0 and 1, not {self.u_pose:g}"
            )
        if not 0.0 < self.power < 1.0:
            raise UsageError(f"the required probability lies between 0 and 1, not at {self.power:g}")
