"""Further measurements that separate tied causes, computed by the model of the kind of part.

Those of a kind with options depend on the recipe and the rig's light angle, not on a part, and are cached. Otherwise
the causes are compared in further poses at the severities that were fitted to a part.
"""

import hashlib
import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.cache import Cache
from anisoscope.base.covariance import whitening
from anisoscope.base.progress import Advance, silent
from anisoscope.base.regular_file import MOST_PICTURE_BYTES, bounded_bytes
from anisoscope.diagnosis.cause_model import PLASTIC_CAUSES, CauseModel, Option
from anisoscope.diagnosis.ranking import NOTHING, Diagnosis, bare_title
from anisoscope.diagnosis.separability import SIGMAS, planned_covariance
from anisoscope.diagnosis.signature_cache import cached_changes
from anisoscope.parameters.geometry import Pose
from anisoscope.prediction.cache import cached_expectation
from anisoscope.recipe.surface import SurfaceRecipe
from anisoscope.record.schema import CauseRecord

KINDS = ("angles", "tilt", "lamp")


def cached_options(
    recipe: SurfaceRecipe, light_angle_deg: float, names: Sequence[str], advance: Advance, causes: CauseModel
) -> tuple[Option, ...]:
    """Cached options for separating causes; none where the cause model does not compute them.

    Args:
        recipe: the recipe.
        light_angle_deg: of the rig.
        names: the causes.
        advance: progress.
        causes: of the kind of part.

    Raises:
        HeightMapError, RecipeError: the recipe's surface cannot be read or used.
    """
    options = causes.options
    if options is None:
        return ()
    key_fields = _key_fields(recipe, light_angle_deg, names)
    return (
        Cache()
        .entry("advice", key_fields, __name__, options.__module__)
        .result(
            lambda: options(recipe, light_angle_deg, names, advance),
            lambda found: json.dumps([vars(one) for one in found]).encode(),
            lambda content: tuple(Option(**one) for one in json.loads(content)),
        )
    )


def _key_fields(recipe: SurfaceRecipe, light_angle_deg: float, names: Sequence[str]) -> dict[str, Any]:
    """Every input of the options, for the cache key."""
    surface = recipe.surface.height_map
    return {
        "recipe": recipe.model_dump(mode="json", exclude={"surface": {"height_map"}}),
        "map": ""
        if surface is None
        else hashlib.sha256(bounded_bytes(surface, MOST_PICTURE_BYTES)).hexdigest(),
        "light_angle_deg": light_angle_deg,
        "names": sorted(names),
    }


def advice_for(
    recipe: SurfaceRecipe,
    light_angle_deg: float,
    found: Diagnosis,
    advance: Advance = silent,
    causes: CauseModel = PLASTIC_CAUSES,
) -> str | None:
    """Measurements that would separate the tied causes from the best one; None without ties, or if not computed.

    Args:
        recipe: the recipe.
        light_angle_deg: of the rig.
        found: the diagnosis.
        advance: progress.
        causes: of the kind of part.

    Raises:
        HeightMapError, RecipeError: the recipe's surface cannot be read or used.
    """
    tied = [one for one in found.ties if one.cause != NOTHING and not one.components]
    if len(tied) < 2 or found.unexplained_p < recipe.decision.alpha:
        return None
    if causes.changes is not None:
        return further_pose(recipe, light_angle_deg, tied, causes)
    if causes.options is None:
        return None
    best, *others = tied
    options = cached_options(recipe, light_angle_deg, [one.cause for one in tied], advance, causes)
    tried = ", ".join(option.says for option in options)
    nothing = f"nothing that was tried ({tried}): at this size optics cannot"
    by_words: dict[str, list[str]] = {}
    for one in others:
        pair = (best.cause, best.severity), (one.cause, one.severity)
        words = discriminating_options(tuple(option for option in options if option.separates(*pair)))
        by_words.setdefault(words or nothing, []).append(bare_title(one.title))
    if len(by_words) == 1:
        return next(iter(by_words))
    return "; ".join(f"{', '.join(titles)}: {words}" for words, titles in by_words.items())


def discriminating_options(options: Sequence[Option]) -> str:
    """The first option of every kind in words; empty if there is none."""
    first = [next((one.says for one in options if one.kind == kind), None) for kind in KINDS]
    return ", or ".join(words for words in first if words is not None)


TILTS_DEG = (-10.0, 10.0)
STEP_DEG = 45
MOST_TIES = 5
"""Tied causes of which a further pose is looked for, the likeliest ones."""


def further_pose(
    recipe: SurfaceRecipe, light_angle_deg: float, tied: Sequence[CauseRecord], causes: CauseModel
) -> str:
    """Further pose, not in the recipe, in which tied causes of the fitted severities differ most.

    In a further pose the causes predict ln L that differ, beyond the difference that follows from the recipe's poses.
    Those leave a variance of ln L there (given them, in the covariance of the prediction and a planned measurement),
    and of each cause its doubt and what is left open of its severity. Beyond 3σ of the sum the picture separates them.

    Args:
        recipe: the recipe.
        light_angle_deg: of the rig.
        tied: the causes that tie, the best first.
        causes: of the kind of part.

    Raises:
        HeightMapError, RecipeError: the recipe's surface cannot be read or used.
    """
    recipe = recipe.deciding()
    own, new = recipe.poses.poses(), _further_poses(recipe)
    single = tuple((pose.stage_deg, pose.tilt_deg) for pose in (*own, *new))
    poses = recipe.poses.model_copy(update={"stage_and_tilt_deg": single})
    wide = recipe.model_copy(
        update={"poses": poses, "decision": recipe.decision.model_copy(update={"tolerance": None})}
    )
    covariance = planned_covariance(wide, cached_expectation(wide, light_angle_deg))
    given = _given_own(covariance, len(own))
    best, *others = tied[:MOST_TIES]
    extents = {one.cause: one.severity for one in (best, *others)}
    changes = cached_changes(wide, light_angle_deg, extents, causes)
    doubts = {cause.name: cause.doubt for cause in causes.causes(recipe)}
    apart = {one.cause: _separated(best, one, changes, doubts, given) for one in others}
    by_words: dict[str, list[str]] = {}
    remaining = list(others)
    while remaining:
        distances = np.array([apart[one.cause] for one in remaining])
        # as many causes as possible beyond 3σ, and those far beyond it
        q = int(np.argmax(np.sum(np.minimum(distances, SIGMAS), axis=0) + 1e-3 * distances.min(axis=0)))
        resolved = [one for one in remaining if apart[one.cause][q] >= SIGMAS]
        words = f"a picture at stage angle {new[q].stage_deg:g}°, tilt {new[q].tilt_deg:g}°"
        if not resolved:
            resolved, words = remaining, _nothing()
        by_words[words] = [bare_title(one.title) for one in resolved]
        remaining = [one for one in remaining if one not in resolved]
    if len(by_words) == 1:
        return next(iter(by_words))
    return "; ".join(f"{', '.join(titles)}: {words}" for words, titles in by_words.items())


def _nothing() -> str:
    tilts = " and ".join(f"{tilt:g}°" for tilt in TILTS_DEG)
    return (
        f"no single further picture (stage angles in steps of {STEP_DEG}°, tilts of {tilts}): at this severity several "
        "poses are needed (`anisoscope recipe suggest`), or optics cannot"
    )


def _further_poses(recipe: SurfaceRecipe) -> tuple[Pose, ...]:
    """The recipe's stage angles at other tilts, and further stage angles at its first tilt."""
    poses = recipe.poses
    taken = {(pose.stage_deg % 360.0, pose.tilt_deg) for pose in poses.poses()}
    tilted = [(stage % 360.0, tilt) for tilt in TILTS_DEG for stage in poses.angles_deg]
    turned = [(float(stage), poses.tilts_deg[0]) for stage in range(0, 360, STEP_DEG)]
    return tuple(Pose(*one) for one in dict.fromkeys((*tilted, *turned)) if one not in taken)


def _given_own(covariance: FloatArray, own: int) -> tuple[FloatArray, FloatArray]:
    """(Q, own) weights that predict ln L in further poses from the first ``own`` ones, and (Q,) variances about it."""
    white = whitening(covariance[:own, :own])
    weights = covariance[own:, :own] @ white @ white
    return weights, np.asarray(np.diag(covariance)[own:] - np.sum(weights * covariance[own:, :own], axis=1))


def _separated(
    best: CauseRecord,
    other: CauseRecord,
    changes: Mapping[str, FloatArray],
    doubts: Mapping[str, float],
    given: tuple[FloatArray, FloatArray],
) -> FloatArray:
    """(Q,) distance of two causes in every further pose, in standard deviations; 0 where a severity is undetermined."""
    weights, variance = given
    if best.cause not in changes or other.cause not in changes:
        return np.zeros_like(variance)

    def beyond(change: FloatArray) -> FloatArray:
        """Change in the further poses beyond what the recipe's poses already show."""
        own = weights.shape[1]
        return np.asarray(change[own:] - weights @ change[:own])

    for one in (best, other):
        if one.u is None or one.severity == 0.0:
            return np.zeros_like(variance)
        open_share = float(np.hypot(doubts[one.cause], one.u / one.severity))
        variance = variance + (open_share * beyond(changes[one.cause])) ** 2
    return np.asarray(np.abs(beyond(changes[best.cause] - changes[other.cause])) / np.sqrt(variance))
