"""Further measurements that separate tied causes, computed by the model of the kind of part, and cached.

They depend on the recipe and the rig's light angle, not on a part.
"""

import hashlib
import json
from collections.abc import Sequence
from typing import Any

from anisoscope.base.cache import Cache
from anisoscope.base.progress import Advance, silent
from anisoscope.diagnosis.cause_model import PLASTIC_CAUSES, CauseModel, Option
from anisoscope.diagnosis.ranking import NOTHING, Diagnosis, bare_title
from anisoscope.recipe.surface import SurfaceRecipe

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
        "map": "" if surface is None else hashlib.sha256(surface.read_bytes()).hexdigest(),
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
    if causes.options is None or len(tied) < 2 or found.unexplained_p < recipe.decision.alpha:
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
