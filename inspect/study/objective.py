"""Objective of a ridge design: its contrast, nominal or under tolerances.

The contrast of a design is the mean, or the smallest, of |C| over the tilts and pairs asked for. Under tolerances
it becomes a sample: every design meets the same quasi-random errors (common random numbers), so that the score is a
smooth function of the design and can be repeated.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.cache import Cache
from anisoscope.base.errors import AnisoscopeError, UsageError
from anisoscope.parameters.geometry import Convention, Pose
from anisoscope.parameters.goal import Goal, Kind
from anisoscope.parameters.material import InternalReflection, Material
from anisoscope.parameters.ridges import RidgeDesign, Wall
from anisoscope.prediction.reflections import Groove
from anisoscope.sim.light.geometry import directions, seating_rotation
from anisoscope.study.ridges import RidgedParts, ridge_radiances

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
        foot_radius: radius of the feet in µm.
        height_loss: share of the height missing at the crests.
        albedo: diffuse albedo.
        index: refractive index.
        wall: of the ridges.
        internal_reflection: of the plastic, as in `Material`.
        tail: of the lobe, as in `Material`.
        second_lobe: weight and width, as in `Material`.
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
    internal_reflection: InternalReflection = "nonlinear"
    tail: float = 0.0
    second_lobe: tuple[float, float] | None = None
    foot_radius: float = 0.0

    @classmethod
    def of(cls, design: RidgeDesign, material: Material) -> "Part":
        """The part of a design and its plastic."""
        return cls(
            ridge_angle=design.ridge_angle_deg,
            pitch=design.pitch_um,
            edge_radius=design.edge_radius_um,
            foot_radius=design.foot_radius_um,
            height_loss=design.height_loss,
            wall=design.wall,
            **asdict(material),
        )

    @property
    def design(self) -> RidgeDesign:
        """Its ridges.

        Raises:
            HeightMapError: ridges that are none.
        """
        return RidgeDesign(
            self.pitch, self.ridge_angle, self.wall, self.height_loss, self.edge_radius, self.foot_radius
        )

    @property
    def material(self) -> Material:
        """Its plastic.

        Raises:
            ModelError: a value outside the range of the model.
        """
        return Material(**{one.name: getattr(self, one.name) for one in fields(Material)})


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
class Scoring(Goal):
    """Objective function and its settings: those of `Goal`, and what they score.

    Light that reflects more often than once is that of the nominal part in the nominal poses: its scatter is small.

    Attributes:
        pairs_deg: pairs of stage angles.
        convention: how angles are counted.
        noise: of the measurement.
        tolerances: None scores the nominal design.
    """

    pairs_deg: tuple[tuple[float, float], ...] = ((0.0, 90.0),)
    convention: Convention = field(default_factory=Convention)
    noise: Noise = field(default_factory=Noise)
    tolerances: Tolerances | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.score == "snr" and self.tolerances is None and not self.noise.present:
            raise UsageError("a signal-to-noise ratio needs noise (--noise) or tolerances (--robust)")

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
    def unit(self) -> str:
        """Unit of the contrast."""
        return "1/sr" if self.contrast == "difference" else "1"

    @property
    def text(self) -> str:
        """The objective in words."""
        pairs = ", ".join(f"{a:g}° / {b:g}°" for a, b in self.pairs_deg)
        tilts = ", ".join(f"{t:g}°" for t in self.tilts_deg)
        text = f"{self.over} |{self.contrast}| [{self.unit}], pairs {pairs}, tilts {tilts}"
        text += ", direct light" if self.bounces == 1 else f", {self.bounces} reflections"
        if self.score == "snr":
            text += ", over its standard deviation"
        if self.tolerances is not None:
            sizes = ", ".join(
                f"{name.replace('_', ' ')} {value:g}"
                for name, value in asdict(self.tolerances).items()
                if value
            )
            rule = "" if self.score == "snr" else f", mean − {self.z:g} sd"
            if self.quantile is not None:
                rule = f", quantile {self.quantile:g}"
            text += f"{rule}; sd: {sizes or 'none'}; {self.samples} parts"
        return text

    @property
    def nominal(self) -> "Scoring":
        """The same without tolerances; a signal-to-noise ratio without noise becomes the contrast."""
        return replace(
            self, tolerances=None, quantile=None, score=self.score if self.noise.present else "contrast"
        )

    def reflections(self, part: Part) -> FloatArray:
        """(P,) light of the nominal part in 1/sr that reflects more than once; 0 where it cannot be manufactured."""
        return self.light_after(None if self.bounces == "all" else self.bounces, part)

    def light_after(self, bounces: int | None, part: Part) -> FloatArray:
        """The same up to another number of reflections; None follows all."""
        try:
            return Groove(part.design, bounces).light(*directions(self.poses, self.convention), part.material)
        except AnisoscopeError:
            return np.zeros(len(self.poses))


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


def _sobol_points(dimensions: int, samples: int, seed: int) -> FloatArray:
    """(samples, dimensions) points of a scrambled Sobol sequence within 0 and 1, cached.

    They follow from numpy and scipy alone; importing `scipy.stats` takes longer than scoring a whole grid.
    """

    def compute() -> FloatArray:
        from scipy.stats import qmc  # noqa: PLC0415 - start-up time

        return np.asarray(qmc.Sobol(dimensions, rng=np.random.default_rng(seed)).random(samples), dtype="<f8")

    entry = Cache().entry("sobol-points", [dimensions, samples, seed], libraries=("numpy", "scipy"))
    found = entry.result(compute, np.ndarray.tobytes, lambda content: np.frombuffer(content, dtype="<f8"))
    return np.asarray(found, dtype=np.float64).reshape(samples, dimensions)


def errors_sample(tolerances: Tolerances, poses: int, samples: int, seed: int) -> dict[str, FloatArray]:
    """Errors in units of their standard deviation, (samples, how many), from a scrambled Sobol sequence.

    Tolerances of 0 take no dimension. The scrambled points keep away from 0 and 1, so that the errors are finite.
    """
    from scipy.special import ndtri  # noqa: PLC0415 - slow to import

    width = {"alpha": 2, "seating": 2, "stage": poses}
    used = [(one.name, width.get(one.name, 1)) for one in fields(tolerances) if getattr(tolerances, one.name)]
    if not used:
        return {}
    total = sum(count for _, count in used)
    normal = ndtri(np.clip(_sobol_points(total, samples, seed), 1e-6, 1.0 - 1e-6))
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
    value, mean, sd = _scored((part,), scoring)
    if np.isnan(value[0]):
        _explain(part, scoring)
    return Scored(float(value[0]), float(mean[0]), float(sd[0]))


def scores(parts: Sequence[Part], scoring: Scoring) -> FloatArray:
    """(D,) scores of parts that differ in numbers only; −inf for one that cannot be manufactured.

    Raises:
        AnisoscopeError: a part is outside what the model means.
    """
    value, _, _ = _scored(parts, scoring)
    return np.where(np.isnan(value), -np.inf, value)


@lru_cache(maxsize=8)
def _sample(scoring: Scoring) -> tuple[dict[str, FloatArray], FloatArray, FloatArray]:
    """Errors of the sample, and directions to light and camera, (S, P, 3); without tolerances S is 1."""
    errors: dict[str, FloatArray] = {}
    if scoring.tolerances is not None:
        errors = errors_sample(scoring.tolerances, len(scoring.poses), scoring.samples, scoring.seed)
    aimed = [_aimed(scoring, errors, number) for number in range(scoring.samples if errors else 1)]
    to_light, to_camera = (np.array(ways) for ways in zip(*aimed, strict=True))
    return errors, to_light, to_camera


def _aimed(scoring: Scoring, errors: dict[str, FloatArray], number: int) -> tuple[FloatArray, FloatArray]:
    """Directions to light and camera, (P, 3), with the errors of stage, rig and seating of one of the sample."""
    poses, convention = scoring.poses, scoring.convention
    if "stage" in errors:
        turned = zip(poses, errors["stage"][number], strict=True)
        poses = tuple(Pose(pose.stage_deg + float(turn), pose.tilt_deg) for pose, turn in turned)
    if "light" in errors:
        light = convention.light_angle_deg + float(errors["light"][number, 0])
        convention = replace(convention, light_angle_deg=light)
    to_light, to_camera = directions(poses, convention)
    if "seating" in errors:
        seat = seating_rotation(*map(float, errors["seating"][number]))
        to_light, to_camera = to_light @ seat, to_camera @ seat
    return to_light, to_camera


def _scored(parts: Sequence[Part], scoring: Scoring) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Score, mean contrast and standard deviation of D parts, (D,) each; NaN where no part can be manufactured."""
    radiance = _radiance(parts, *_sample(scoring))
    if scoring.bounces != 1:
        radiance = radiance + np.array([scoring.reflections(one) for one in parts])[:, None]
    return _summary(radiance, scoring)


def _summary(radiance: FloatArray, scoring: Scoring) -> tuple[FloatArray, FloatArray, FloatArray]:
    """The same from (D, S, P) radiances."""
    i, j = scoring.pair_indices
    first, second = radiance[..., i], radiance[..., j]
    signed = contrast_values(first, second, scoring.contrast)
    contrast = np.abs(signed)
    if scoring.over == "mean":
        weight = np.full_like(contrast, 1.0 / contrast.shape[-1])
    else:
        weight = (contrast == contrast.min(axis=-1, keepdims=True)).astype(np.float64)
        weight /= np.maximum(weight.sum(axis=-1, keepdims=True), 1.0)
    sample = (weight * contrast).sum(axis=-1)
    by_first, by_second = contrast_slopes(first, second, scoring.contrast)
    slope = np.zeros_like(radiance)
    for pair, (one, other) in enumerate(zip(i, j, strict=True)):
        turned = np.sign(signed[..., pair]) * weight[..., pair]
        slope[..., one] += turned * by_first[..., pair]
        slope[..., other] += turned * by_second[..., pair]
    noise = scoring.noise
    by_noise = (slope**2 * (noise.floor**2 + (noise.share * radiance) ** 2)).sum(axis=-1)
    mean = sample.mean(axis=-1)
    spread = sample.var(axis=-1, ddof=1) if sample.shape[-1] > 1 else np.zeros_like(mean)
    sd = np.sqrt(spread + by_noise.mean(axis=-1))
    if scoring.score == "snr":
        value = mean / np.maximum(sd, 1e-12)
    elif scoring.quantile is not None and scoring.tolerances is not None:
        value = np.quantile(sample, scoring.quantile, axis=-1)
    elif scoring.tolerances is not None:
        value = mean - scoring.z * sd
    else:
        value = mean
    return value, mean, sd


def _spoiled(parts: Sequence[Part], errors: dict[str, FloatArray], sample: int) -> RidgedParts:
    """Every part with every error of the sample: D·S parts, the sample runs fastest.

    Raises:
        AnisoscopeError: a nominal part is outside what the model means.
    """
    plastic = {replace(one.material, alpha_along=0.1, alpha_across=0.1) for one in parts}
    wall = {one.wall for one in parts}
    if len(plastic) > 1 or len(wall) > 1:
        raise UsageError("parts that are scored together share albedo, index, lobe and wall")

    def nominal(name: str) -> FloatArray:
        return np.array([getattr(part, name) for part in parts], dtype=np.float64)[:, None]

    def error(name: str, place: int = 0) -> FloatArray | float:
        return errors[name][:, place] if name in errors else 0.0

    def column(values: FloatArray) -> FloatArray:
        return np.broadcast_to(values, (len(parts), sample)).ravel()

    def alpha(name: str, place: int) -> FloatArray:
        return column(np.clip(nominal(name) * np.exp(error("alpha", place)), *_ALPHA_RANGE))

    for pitch in {one.pitch for one in parts}:
        RidgeDesign(pitch, 1.0)  # refuses a pitch that is none
    return RidgedParts(
        pitch_um=column(nominal("pitch")),
        ridge_angle_deg=column(np.clip(nominal("ridge_angle") + error("ridge_angle"), *_ANGLE_RANGE)),
        height_loss=column(np.minimum(np.abs(nominal("height_loss") + error("height_loss")), _LARGEST_LOSS)),
        edge_radius_um=column(np.abs(nominal("edge_radius") + error("edge_radius"))),
        foot_radius_um=column(nominal("foot_radius")),
        alpha_along=alpha("alpha_along", 0),
        alpha_across=alpha("alpha_across", 1),
        wall=wall.pop(),
        plastic=plastic.pop(),
    )


def _radiance(
    parts: Sequence[Part], errors: dict[str, FloatArray], to_light: FloatArray, to_camera: FloatArray
) -> FloatArray:
    """(D, S, P) radiances of every part with every error of the sample."""
    sample, poses, _ = to_light.shape
    light, camera = (np.tile(one, (len(parts), 1, 1)) for one in (to_light, to_camera))
    return ridge_radiances(light, camera, _spoiled(parts, errors, sample)).reshape(len(parts), sample, poses)


def _explain(part: Part, scoring: Scoring) -> None:
    """Raise the error of the first one of a part's sample that cannot be manufactured."""
    errors, to_light, _ = _sample(scoring)
    all_ = _spoiled((part,), errors, len(to_light))
    for angle, loss, radius in zip(all_.ridge_angle_deg, all_.height_loss, all_.edge_radius_um, strict=True):
        RidgeDesign(part.pitch, float(angle), part.wall, float(loss), float(radius), part.foot_radius)
