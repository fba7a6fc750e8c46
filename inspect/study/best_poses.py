"""Poses that show named defects best: chosen by the distance of the ideal observer between good and defective parts.

Of all allowed poses the change of ln L by each defect, by what differs between good parts, and by errors of camera and
stage are known to first order. The distance of a defect is d' = √(Δᵀ V⁻¹ Δ), with V the covariance of ln L of good
parts and a free level. Poses are chosen so that the smallest d' is largest: the best pair, then one pose after the
other, then exchanges until none helps. The chosen poses are judged to second order by simulation.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import TypeVar

import numpy as np
from pydantic import ValidationError

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import ModelError, UsageError
from anisoscope.base.progress import Advance, silent
from anisoscope.decision.consistency import contrast_scatter
from anisoscope.decision.predictive import separating_areas, separations
from anisoscope.imaging.facet_fit import poses_for_angles
from anisoscope.parameters.detection import PoseChoice
from anisoscope.parameters.geometry import Convention, Pose
from anisoscope.parameters.keywords import by_keywords
from anisoscope.prediction.expectation import PLASTIC, nominal_shape
from anisoscope.prediction.part_scatter import (
    PartScatter,
    defect_changes,
    part_scatter,
    scatter_of_inputs,
    with_design,
)
from anisoscope.prediction.propagation import propagate
from anisoscope.prediction.sensitivity import DARK, State, evaluate
from anisoscope.recipe.surface import SurfaceRecipe
from anisoscope.sim.light.geometry import directions, pose_grid

FREE_LEVEL = 25.0
"""Variance of ln L of a level that all poses share: the scale is never used."""
REPEATED_DEG = 0.03
"""Standard uncertainty of stage and tilt between two parts, degrees."""
MORE_PARTS = (1, 3, 10, 25)
MOST_FRAMES = 256
BRACKET, MOST_BRACKETS = 4, 4
ANGLE_POSES = 3
"""Poses that the angle map needs for lean across, lean along and roughness."""
_ROUNDS = 6
RecipeT = TypeVar("RecipeT", bound=SurfaceRecipe)


@dataclass(frozen=True)
class _Sized:
    """A defect of which a size can be given.

    Attributes:
        key: of ``[defects]`` in the recipe.
        units: how its size may end, the usual one first; "%" is a share.
        begins: first words of its names.
    """

    key: str
    units: tuple[str, ...]
    begins: str


_SIZED = {
    "ridge-angle": _Sized("ridge_angle_deg", ("°", "deg"), "ridge angle"),
    "roughness": _Sized("roughness_share", ("%",), "roughness"),
    "height-loss": _Sized("height_loss", ("%",), "height loss"),
    "wear": _Sized("wear_um", ("µm", "um"), "edges worn"),
}


def with_sizes(recipe: RecipeT, asked: Sequence[str]) -> tuple[RecipeT, tuple[str, ...]]:
    """A recipe with other sizes of its defects, and the first words of the names of these defects.

    Args:
        recipe: the recipe.
        asked: NAME=SIZE, such as ``ridge-angle=0.5``, ``roughness=20%`` or ``wear=5um``.

    Raises:
        UsageError: another form, an unknown name, a name twice, or a size that is none.
    """
    known = ", ".join(f"{name} ({one.units[0]})" for name, one in _SIZED.items())
    sizes: dict[str, float] = {}
    begins: list[str] = []
    for text in asked:
        name, separator, size = (part.strip() for part in text.partition("="))
        if not separator:
            raise UsageError(
                f"--defect takes NAME=SIZE, such as ridge-angle=0.5 or roughness=20%, not {text!r}"
            )
        if name not in _SIZED:
            raise UsageError(f"--defect {text}: there is no defect {name!r}; there are {known}")
        one = _SIZED[name]
        if one.key in sizes:
            raise UsageError(f"--defect {text}: {name} is asked for twice; leave one size out")
        sizes[one.key] = _size_of(text, size, one)
        begins.append(one.begins)
    try:
        part = type(recipe.defects).model_validate({**recipe.defects.model_dump(), **sizes})
    except ValidationError as problem:
        (error, *_), fields = problem.errors(), {one.key: name for name, one in _SIZED.items()}
        name, reason = fields.get(str(error["loc"][0]), "size"), error["msg"].removeprefix("Value error, ")
        raise UsageError(f"--defect {name}: {reason[:1].lower()}{reason[1:]}") from None
    return recipe.model_copy(update={"defects": part}), tuple(begins)


def _size_of(text: str, size: str, one: _Sized) -> float:
    """Size of a defect in the unit of its key."""
    usual = one.units[0]
    number, given = size, ""
    for unit in ("°", "deg", "%", "µm", "um"):
        if size.endswith(unit):
            number, given = size.removesuffix(unit).strip(), unit
            break
    if given and given not in one.units:
        raise UsageError(f"--defect {text}: its size is in {usual}, not in {given}")
    try:
        value = float(number)
    except ValueError:
        raise UsageError(f"--defect {text}: {size!r} is no size in {usual}") from None
    if not 0.0 < value < float("inf"):
        both = "; both signs of a ridge angle are looked for" if one.key == "ridge_angle_deg" else ""
        raise UsageError(f"--defect {text}: a size is above 0{both}")
    if given == "%":
        return 0.01 * value
    if usual == "%" and value > 1.0:
        name = text.partition("=")[0]
        raise UsageError(
            f"--defect {text}: {value:g} without a unit is {value:.0%}: write {name}={value:g}% or "
            f"{name}={value / 100:g}"
        )
    return value


def sizes_in_toml(asked: SurfaceRecipe, recipe: SurfaceRecipe) -> tuple[str, ...]:
    """Lines of ``[defects]`` by which one recipe differs from another one."""
    now, then = asked.defects.model_dump(), recipe.defects.model_dump()
    return tuple(f"{key} = {value:g}" for key, value in now.items() if value != then[key])


@dataclass(frozen=True)
class Shown:
    """How well poses show one defect.

    Attributes:
        defect: its name, with its smallest interesting size.
        distance: d' of the ideal observer, to first order.
        area: under the curve of the directed test, by simulation to second order.
        power: probability of finding it, by number of golden parts.
        detectable: multiple of its size that is found in 9 of 10 parts, by number of golden parts.
    """

    defect: str
    distance: float
    area: float
    power: dict[int, float]
    detectable: dict[int, float]


@dataclass(frozen=True)
class Suggestion:
    """Chosen poses.

    Attributes:
        poses: (stage angle, tilt) in degrees, in the order in which they are photographed.
        shown: one a defect, the one that is shown worst first.
        camera_share: relative standard uncertainty of a pose by camera and lamp that was assumed.
        power: required.
        golden: golden parts with which every defect is found with that power, or None where these poses never do.
        frames: frames per pose that reach that power, by number of golden parts; None where no number of them does,
            because parts differ as the defects do.
        brackets: further exposures with which the darkest pose is exposed as the brightest one, within a factor of 4.
        brightest: predicted radiance of the brightest pose in 1/sr.
    """

    poses: tuple[tuple[float, float], ...]
    shown: tuple[Shown, ...]
    camera_share: float
    power: float
    golden: int | None
    frames: dict[int, int | None]
    brackets: tuple[float, ...]
    brightest: float = 0.0


@by_keywords(choice=PoseChoice)
def best_poses(
    recipe: SurfaceRecipe,
    light_angle_deg: float,
    advance: Advance = silent,
    asked: Sequence[str] = (),
    *,
    choice: PoseChoice,
) -> Suggestion:
    """Choose poses for the defects of a recipe.

    Args:
        recipe: with the scatter of good parts and the sizes of the defects.
        light_angle_deg: the rig's angle between light and camera.
        advance: called at every step.
        asked: first words of names of the defects that must be shown; all if empty.
        choice: allowed poses, or its fields as keywords; its ``defects`` are in the recipe already (`with_sizes`).

    Raises:
        UsageError: too few poses are allowed, or no defect can be shown.
        HeightMapError: the height map has no ridges.
        RecipeError: as for a prediction.
    """
    count, camera_share = choice.poses, choice.u_pose
    ideal = with_design(recipe.deciding())
    convention = Convention(light_angle_deg, facet_azimuth_deg=recipe.poses.facet_azimuth_deg)
    allowed = _above_horizon(pose_grid(choice.angles_deg, choice.tilts_deg), convention)
    if not 3 <= count <= len(allowed):
        raise UsageError(
            f"{count} poses of {len(allowed)} that are allowed: choose 3 or more, and allow more than that"
        )
    advance("responses", 0, 2)
    allowed, radiance, scatter, changes = _first_order(ideal, allowed, convention, camera_share)
    for words in choice.ignore:
        if not any(name.startswith(words) for name in changes):
            raise UsageError(f"no defect begins with {words!r}; there are {', '.join(changes)}")
    for words in asked:
        if not any(name.startswith(words) for name in changes):
            raise UsageError(f"this surface shows no {words!r} of that size; it shows {', '.join(changes)}")
    wanted = {
        name: change
        for name, change in changes.items()
        if not name.startswith(choice.ignore) and (not asked or name.startswith(tuple(asked)))
    }
    if not wanted:
        raise UsageError("no defect is left that poses could show")
    advance("choice of poses", 1, 2)
    first = min(ANGLE_POSES, count - 1) if choice.angle_map else 0
    kept = poses_for_angles(ideal, allowed, convention, first)
    chosen = _chosen(allowed, scatter, np.array(list(wanted.values())), count, kept)
    poses = _in_order([allowed[k] for k in chosen])
    found = _judged(recipe, light_angle_deg, poses, scatter, changes, chosen, choice, tuple(wanted))
    return replace(found, brackets=_brackets(radiance[chosen]), brightest=float(radiance[chosen].max()))


def ideal_distances(
    recipe: SurfaceRecipe, light_angle_deg: float, camera_share: float = 0.003
) -> dict[str, float]:
    """Distance d' of each defect in the poses of a recipe, to first order.

    Args:
        recipe: with the scatter of good parts and the sizes of the defects.
        light_angle_deg: the rig's angle between light and camera.
        camera_share: relative standard uncertainty of a pose by camera and lamp.

    Raises:
        HeightMapError, RecipeError: as for a prediction.
    """
    ideal = with_design(recipe.deciding())
    convention = Convention(light_angle_deg, facet_azimuth_deg=recipe.poses.facet_azimuth_deg)
    poses, _, scatter, changes = _first_order(ideal, recipe.poses.poses(), convention, camera_share)
    found = _distances(scatter, np.array(list(changes.values())), range(len(poses)))
    return dict(zip(changes, found.tolist(), strict=True))


def _above_horizon(poses: tuple[Pose, ...], convention: Convention) -> tuple[Pose, ...]:
    found = []
    for pose in poses:
        try:
            to_light, to_camera = directions((pose,), convention)
        except ModelError:
            continue
        if min(to_light[0, 2], to_camera[0, 2]) > np.sin(np.radians(5.0)):
            found.append(pose)
    return tuple(found)


def _first_order(
    recipe: SurfaceRecipe, poses: tuple[Pose, ...], convention: Convention, camera_share: float
) -> tuple[tuple[Pose, ...], FloatArray, FloatArray, dict[str, FloatArray]]:
    """The poses with light, their (P,) radiances, (P, P) covariance of ln L of good parts, and (P,) changes."""
    models = PLASTIC.models(recipe, poses, convention)
    nominal = State(recipe.material.material(), convention.light_angle_deg, shape=nominal_shape(recipe))
    radiance = evaluate(models.sampled, [nominal], poses, convention)[0]
    lit = np.flatnonzero(radiance > max(DARK, 1e-4 * radiance.max()))
    poses, radiance = tuple(poses[k] for k in lit), radiance[lit]
    models = PLASTIC.models(recipe, poses, convention)
    inputs = replace(scatter_of_inputs(recipe), stage_deg=REPEATED_DEG, tilt_deg=REPEATED_DEG)
    budget = propagate(models.sampled, nominal, poses, convention, inputs, radiance=radiance)
    covariance = budget.covariance() / np.outer(radiance, radiance)
    covariance += FREE_LEVEL + camera_share**2 * np.eye(len(poses))
    changes = defect_changes(models.sampled, recipe, nominal, poses, convention, radiance)
    return poses, radiance, covariance, changes


def _distances(scatter: FloatArray, changes: FloatArray, chosen: Sequence[int]) -> FloatArray:
    """(C,) d' of (C, P) changes in the chosen poses."""
    part = changes[:, list(chosen)]
    inverse = np.linalg.inv(scatter[np.ix_(list(chosen), list(chosen))])
    return np.asarray(np.sqrt(np.einsum("ci,ij,cj->c", part, inverse, part)))


def _chosen(
    poses: tuple[Pose, ...], scatter: FloatArray, changes: FloatArray, count: int, kept: Sequence[int]
) -> list[int]:
    def worth(chosen: Sequence[int]) -> float:
        found = _distances(scatter, changes, chosen)
        return float(found.min() + 1e-3 * found.mean())  # of equal ones the better for the others

    pairs = [(i, j) for i, j in combinations(range(len(poses)), 2) if poses[i].tilt_deg == poses[j].tilt_deg]
    best = list(kept) or max(([i, j] for i, j in pairs), key=worth)  # a contrast needs two poses of one tilt
    while len(best) < count:
        more = [k for k in range(len(poses)) if k not in best]
        if len(best) + 1 == count:
            more = [k for k in more if _paired(poses, [*best, k])]
        best.append(max(more, key=lambda k: worth([*best, k])))
    for _ in range(_ROUNDS):
        before = worth(best)
        for place in range(len(kept), count):
            others = [k for n, k in enumerate(best) if n != place]
            options = [k for k in range(len(poses)) if k not in others and _paired(poses, [*others, k])]
            best[place] = max(options, key=lambda k: worth([*others[:place], k, *others[place:]]))
        if worth(best) <= before * (1.0 + 1e-9):
            break
    return best


def _paired(poses: tuple[Pose, ...], chosen: Sequence[int]) -> bool:
    tilts = [poses[k].tilt_deg for k in chosen]
    return len(set(tilts)) < len(tilts)


def _in_order(poses: list[Pose]) -> tuple[tuple[float, float], ...]:
    """By tilt, the smallest first, then by stage angle: the stage moves little, and contrasts are within a tilt."""
    ordered = sorted(poses, key=lambda pose: (abs(pose.tilt_deg), pose.tilt_deg, pose.stage_deg))
    return tuple((pose.stage_deg, pose.tilt_deg) for pose in ordered)


def _judged(
    recipe: SurfaceRecipe,
    light_angle_deg: float,
    poses: tuple[tuple[float, float], ...],
    scatter: FloatArray,
    changes: dict[str, FloatArray],
    chosen: list[int],
    choice: PoseChoice,
    wanted: tuple[str, ...],
) -> Suggestion:
    """The chosen poses with the power to second order."""
    camera_share, power = choice.u_pose, choice.power
    distances = dict(zip(changes, _distances(scatter, np.array(list(changes.values())), chosen), strict=True))
    table = recipe.poses.model_dump(exclude={"angles_deg", "tilts_deg", "stage_and_tilt_deg"})
    only = type(recipe.poses).model_validate({**table, "stage_and_tilt_deg": poses})
    decision = recipe.decision.model_copy(update={"tolerance": None})
    parts = part_scatter(recipe.model_copy(update={"poses": only, "decision": decision}), light_angle_deg)
    if parts is None:
        raise UsageError("ln L of the chosen poses has no response to second order: allow smaller tilts")
    simulated = contrast_scatter(parts, camera_share)
    areas = separating_areas(simulated)
    found = {
        n: {one.defect: one for one in separations(simulated, n, recipe.decision.alpha)} for n in MORE_PARTS
    }
    shown = [
        Shown(
            name,
            float(distances[name]),
            areas[name],
            {n: found[n][name].power for n in MORE_PARTS},
            {n: found[n][name].detectable for n in MORE_PARTS},
        )
        for name in changes
        if name in areas
    ]
    enough = [n for n in MORE_PARTS if all(one.power[n] >= power for one in shown if one.defect in wanted)]
    shown.sort(key=lambda one: one.distance)
    frames = _frames(parts, recipe, camera_share, power, wanted)
    return Suggestion(poses, tuple(shown), camera_share, power, enough[0] if enough else None, frames, ())


def _frames(
    parts: PartScatter, recipe: SurfaceRecipe, camera_share: float, power: float, wanted: tuple[str, ...]
) -> dict[int, int | None]:
    """Fewest frames per pose, by doubling, with which every wanted defect is found, by number of golden parts."""
    now, alpha = recipe.acquisition.frames_per_pose, recipe.decision.alpha
    counts = [now * 2**k for k in range(MOST_FRAMES.bit_length()) if now * 2**k <= MOST_FRAMES]

    def enough(share: float, golden: int) -> bool:
        found = separations(contrast_scatter(parts, share), golden, alpha)
        return all(one.power >= power for one in found if one.defect in wanted)

    found: dict[int, int | None] = dict.fromkeys(MORE_PARTS)
    for golden in reversed(MORE_PARTS):
        if not enough(camera_share * float(np.sqrt(now / counts[-1])), golden):
            break  # fewer golden parts find less
        found[golden] = next(n for n in counts if enough(camera_share * float(np.sqrt(now / n)), golden))
    return found


def _brackets(radiance: FloatArray) -> tuple[float, ...]:
    """Multiples of the exposure of the brightest pose, rising by 4, for the darkest one."""
    ratio = float(radiance.max() / radiance.min())
    return tuple(float(BRACKET**k) for k in range(1, MOST_BRACKETS + 1) if BRACKET**k <= ratio)
