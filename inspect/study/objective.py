"""Objective of a ridge design: its contrast, nominal or under tolerances.

The contrast of a design is the mean, or the smallest, of |C| over the tilts and pairs asked for. Under tolerances
it becomes a sample: every design meets the same quasi-random errors (common random numbers), so that the score is a
smooth function of the design and can be repeated.
"""

from dataclasses import dataclass, field, fields, replace
from typing import Literal

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import UsageError
from anisoscope.profiles.ideal import RidgeDesign, Wall
from anisoscope.sim.light.geometry import Convention, Pose, directions, seating_rotation
from anisoscope.sim.light.material import Material
from anisoscope.study.ridges import ridge_radiance

Kind = Literal["difference", "michelson", "log_ratio"]
Over = Literal["mean", "worst"]

_ALPHA_RANGE = (0.001, 1.0)
_ANGLE_RANGE = (0.05, 44.9)
_LARGEST_LOSS = 0.99
_DARK = 1e-12  # 1/sr


@dataclass(frozen=True)
class Part:
    """Ridged part: varied and fixed parameters.

    Attributes:
        ridge_angle: slope of the facets in degrees.
        pitch: distance of the crests in µm.
        alpha_along: Beckmann roughness along the ridges.
        alpha_across: Beckmann roughness across.
        edge_radius: radius of the crests in µm.
        height_loss: share of the height missing at the crests.
        albedo: diffuse albedo.
        index: refractive index.
        wall: of the ridges.
    """

    ridge_angle: float = 10.0
    pitch: float = 100.0
    alpha_along: float = 0.06
    alpha_across: float = 0.10
    edge_radius: float = 0.0
    height_loss: float = 0.0
    albedo: float = 0.2
    index: float = 1.5
    wall: Wall = "perpendicular"


@dataclass(frozen=True)
class Tolerances:
    """Standard deviations of the variation from part to part and from seating to seating.

    Attributes:
        ridge_angle: of the ridge angle in degrees.
        alpha: of the roughness along and, independently, across, as a share of it.
        height_loss: of the height loss, which is the absolute value of nominal + error.
        edge_radius: of the edge radius in µm, likewise absolute.
        seating: of the tilt of the seated part about its x and its y axis, in degrees.
        stage: of every stage angle, in degrees.
        light: of the angle between light and camera, in degrees.
    """

    ridge_angle: float = 0.0
    alpha: float = 0.0
    height_loss: float = 0.0
    edge_radius: float = 0.0
    seating: float = 0.0
    stage: float = 0.0
    light: float = 0.0

    def __post_init__(self) -> None:
        for one in fields(self):
            if not 0.0 <= getattr(self, one.name) < float("inf"):
                raise UsageError(
                    f"the tolerance of {one.name} must be 0 or more, not {getattr(self, one.name):g}"
                )


@dataclass(frozen=True)
class Noise:
    """Standard uncertainty of a measured radiance: √(floor² + (share·L)²), independent in every pose.

    Attributes:
        floor: in 1/sr.
        share: of the radiance.
    """

    floor: float = 0.0
    share: float = 0.0

    def __post_init__(self) -> None:
        if not (0.0 <= self.floor < float("inf") and 0.0 <= self.share < float("inf")):
            raise UsageError(f"noise must be 0 or more, not floor={self.floor:g}, share={self.share:g}")

    @property
    def present(self) -> bool:
        """Something is uncertain."""
        return self.floor > 0.0 or self.share > 0.0


@dataclass(frozen=True)
class Scoring:
    """Objective function and its settings.

    Attributes:
        contrast: which contrast; its absolute value counts.
        pairs_deg: pairs of stage angles.
        tilts_deg: tilts of camera and light.
        over: mean over pairs and tilts, or the worst of them.
        convention: how angles are counted.
        score: "contrast", or "snr": the contrast as a multiple of its standard deviation.
        noise: of the measurement.
        tolerances: None scores the nominal design.
        z: with tolerances, the score is mean − z·standard deviation.
        quantile: score this quantile of the sample instead, 0 to 0.5.
        samples: size of the sample, a power of two.
        seed: of the sample's scrambling.
    """

    contrast: Kind = "difference"
    pairs_deg: tuple[tuple[float, float], ...] = ((0.0, 90.0),)
    tilts_deg: tuple[float, ...] = (0.0,)
    over: Over = "mean"
    convention: Convention = field(default_factory=Convention)
    score: Literal["contrast", "snr"] = "contrast"
    noise: Noise = field(default_factory=Noise)
    tolerances: Tolerances | None = None
    z: float = 2.0
    quantile: float | None = None
    samples: int = 64
    seed: int = 1

    def __post_init__(self) -> None:
        if self.samples < 8 or self.samples & (self.samples - 1):
            raise UsageError(f"the sample must be a power of two from 8 on, not {self.samples}")
        if self.quantile is not None and not 0.0 < self.quantile <= 0.5:
            raise UsageError(f"the quantile must lie above 0 and up to 0.5, not {self.quantile:g}")
        if not 0.0 <= self.z < float("inf"):
            raise UsageError(f"z must be 0 or more, not {self.z:g}")
        if self.score == "snr" and self.tolerances is None and not self.noise.present:
            raise UsageError("a signal-to-noise ratio needs noise (--noise) or tolerances (--robust)")
        if self.score == "snr" and self.quantile is not None:
            raise UsageError("a signal-to-noise ratio has no quantile: leave one of the two out")

    @property
    def poses(self) -> tuple[Pose, ...]:
        """The photographs: every stage angle of the pairs at every tilt, once."""
        angles = dict.fromkeys(angle for pair in self.pairs_deg for angle in pair)
        return tuple(Pose(angle, tilt) for tilt in self.tilts_deg for angle in angles)

    @property
    def pair_indices(self) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
        """Of every pair at every tilt, the places of its two photographs."""
        place = {pose: number for number, pose in enumerate(self.poses)}
        found = [
            [place[Pose(angle, tilt)] for angle in pair] for tilt in self.tilts_deg for pair in self.pairs_deg
        ]
        first, second = np.array(found, dtype=np.intp).T
        return first, second

    @property
    def nominal(self) -> "Scoring":
        """The same without tolerances; a signal-to-noise ratio without noise becomes the contrast."""
        return replace(
            self, tolerances=None, quantile=None, score=self.score if self.noise.present else "contrast"
        )


@dataclass(frozen=True)
class Scored:
    """The score of one part.

    Attributes:
        score: what is maximised.
        mean: mean contrast over the sample; of a nominal design its contrast.
        sd: standard deviation of the contrast from tolerances and noise.
    """

    score: float
    mean: float
    sd: float


def contrast_values(first: FloatArray, second: FloatArray, kind: Kind) -> FloatArray:
    """Signed contrasts of two radiances; of two dark ones 0."""
    if kind == "difference":
        return first - second
    if kind == "michelson":
        return (first - second) / np.maximum(first + second, _DARK)
    return np.asarray(np.log(np.maximum(first, _DARK) / np.maximum(second, _DARK)), dtype=np.float64)


def contrast_slopes(first: FloatArray, second: FloatArray, kind: Kind) -> tuple[FloatArray, FloatArray]:
    """Derivatives of those contrasts by the two radiances."""
    if kind == "difference":
        return np.ones_like(first), -np.ones_like(second)
    if kind == "michelson":
        square = np.maximum(first + second, _DARK) ** 2
        return 2.0 * second / square, -2.0 * first / square
    return 1.0 / np.maximum(first, _DARK), -1.0 / np.maximum(second, _DARK)


def errors_sample(tolerances: Tolerances, poses: int, samples: int, seed: int) -> dict[str, FloatArray]:
    """Errors in units of their standard deviation, (samples, how many), from a scrambled Sobol sequence.

    Tolerances of 0 take no dimension. The scrambled points keep away from 0 and 1, so that the errors are finite.
    """
    from scipy.special import ndtri  # noqa: PLC0415 - slow to import
    from scipy.stats import qmc  # noqa: PLC0415 - start-up time

    width = {"alpha": 2, "seating": 2, "stage": poses}
    used = [(one.name, width.get(one.name, 1)) for one in fields(tolerances) if getattr(tolerances, one.name)]
    if not used:
        return {}
    total = sum(count for _, count in used)
    sobol = qmc.Sobol(total, rng=np.random.default_rng(seed)).random(samples)
    normal = ndtri(np.clip(sobol, 1e-6, 1.0 - 1e-6))
    ends = np.cumsum([count for _, count in used])
    return {
        name: normal[:, end - count : end] * getattr(tolerances, name)
        for (name, count), end in zip(used, ends, strict=True)
    }


def score(part: Part, scoring: Scoring) -> Scored:
    """Score one part.

    Raises:
        AnisoscopeError: the part is outside what the model means.
    """
    if scoring.tolerances is None:
        errors: dict[str, FloatArray] = {}
        radiance = _radiance(part, scoring, {}, 0)[None, :]
    else:
        errors = errors_sample(scoring.tolerances, len(scoring.poses), scoring.samples, scoring.seed)
        count = scoring.samples if errors else 1
        radiance = np.stack([_radiance(part, scoring, errors, number) for number in range(count)])
    return _summary(radiance, scoring)


def _summary(radiance: FloatArray, scoring: Scoring) -> Scored:
    i, j = scoring.pair_indices
    first, second = radiance[:, i], radiance[:, j]
    signed = contrast_values(first, second, scoring.contrast)
    contrast = np.abs(signed)
    if scoring.over == "mean":
        weight = np.full_like(contrast, 1.0 / contrast.shape[1])
    else:
        weight = (contrast == contrast.min(axis=1, keepdims=True)).astype(np.float64)
        weight /= weight.sum(axis=1, keepdims=True)
    sample = (weight * contrast).sum(axis=1)
    by_first, by_second = contrast_slopes(first, second, scoring.contrast)
    slope = np.zeros_like(radiance)
    for pair, (one, other) in enumerate(zip(i, j, strict=True)):
        turned = np.sign(signed[:, pair]) * weight[:, pair]
        slope[:, one] += turned * by_first[:, pair]
        slope[:, other] += turned * by_second[:, pair]
    noise = scoring.noise
    by_noise = (slope**2 * (noise.floor**2 + (noise.share * radiance) ** 2)).sum(axis=1)
    mean = float(sample.mean())
    spread = float(sample.var(ddof=1)) if sample.size > 1 else 0.0
    sd = float(np.sqrt(spread + by_noise.mean()))
    if scoring.score == "snr":
        value = mean / max(sd, 1e-12)
    elif scoring.quantile is not None and scoring.tolerances is not None:
        value = float(np.quantile(sample, scoring.quantile))
    elif scoring.tolerances is not None:
        value = mean - scoring.z * sd
    else:
        value = mean
    return Scored(value, mean, sd)


def _radiance(part: Part, scoring: Scoring, errors: dict[str, FloatArray], number: int) -> FloatArray:
    """(P,) radiances of one part out of the sample."""

    def error(name: str, place: int = 0) -> float:
        return float(errors[name][number, place]) if name in errors else 0.0

    angle = float(np.clip(part.ridge_angle + error("ridge_angle"), *_ANGLE_RANGE))
    loss = min(abs(part.height_loss + error("height_loss")), _LARGEST_LOSS)
    along, across = (
        float(np.clip(alpha * np.exp(error("alpha", place)), *_ALPHA_RANGE))
        for place, alpha in enumerate((part.alpha_along, part.alpha_across))
    )
    poses = scoring.poses
    if "stage" in errors:
        turned = zip(poses, errors["stage"][number], strict=True)
        poses = tuple(Pose(pose.stage_deg + float(turn), pose.tilt_deg) for pose, turn in turned)
    convention = scoring.convention
    if "light" in errors:
        convention = replace(convention, light_angle_deg=convention.light_angle_deg + error("light"))
    to_light, to_camera = directions(poses, convention)
    if "seating" in errors:
        seat = seating_rotation(error("seating", 0), error("seating", 1))
        to_light, to_camera = to_light @ seat, to_camera @ seat
    design = RidgeDesign(part.pitch, angle, part.wall, loss)
    radius = abs(part.edge_radius + error("edge_radius"))
    material = Material(along, across, part.albedo, part.index)
    return ridge_radiance(to_light, to_camera, design, radius, material)
