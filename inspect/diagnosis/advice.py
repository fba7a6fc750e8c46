"""In words, what would tell causes apart that look alike; of wafers, as it is computed (`telling`) and kept.

What is computed belongs to the recipe and the rig's light angle, not to a part: it lies in the folder of `remembering`.
"""

import contextlib
import hashlib
import json
from collections.abc import Sequence
from importlib.metadata import version

from anisoscope.atomicfile import write_text
from anisoscope.diagnosis.diagnosing import NOTHING, Diagnosis
from anisoscope.diagnosis.remembering import cache_folder, sources_digest
from anisoscope.diagnosis.telling import Option, wafer_options
from anisoscope.errors import RecordError
from anisoscope.progress import Advance, silent
from anisoscope.recipe import Recipe

_FORMAT = 1
_SOURCES = (
    "anisoscope.diagnosis",
    "anisoscope.expectation",
    "anisoscope.models",
    "anisoscope.prediction",
    "anisoscope.profiles",
    "anisoscope.sim.light",
)
KINDS = ("angles", "tilt", "lamp")


def remembered_options(
    recipe: Recipe, light_angle_deg: float, names: Sequence[str], advance: Advance = silent
) -> tuple[Option, ...]:
    """What would tell causes of a wafer apart, computed once; arguments and errors as for `telling.wafer_options`."""
    path = cache_folder() / "options" / f"{_key(recipe, light_angle_deg, names)}.json"
    with contextlib.suppress(OSError, KeyError, ValueError, TypeError):  # missing or damaged: computed again
        return tuple(Option(**one) for one in json.loads(path.read_text(encoding="utf-8")))
    found = wafer_options(recipe, light_angle_deg, names, advance)
    with contextlib.suppress(OSError, RecordError):  # no place to keep them: the next one computes them again
        path.parent.mkdir(parents=True, exist_ok=True)
        write_text(path, json.dumps([vars(one) for one in found]))
    return found


def _key(recipe: Recipe, light_angle_deg: float, names: Sequence[str]) -> str:
    surface = recipe.surface.height_map
    told = {
        "format": _FORMAT,
        "software": [version("anisoscope"), sources_digest(*_SOURCES)],
        "recipe": recipe.model_dump(mode="json", exclude={"surface": {"height_map"}}),
        "map": "" if surface is None else hashlib.sha256(surface.read_bytes()).hexdigest(),
        "light_angle_deg": light_angle_deg,
        "names": sorted(names),
    }
    return hashlib.sha256(json.dumps(told, sort_keys=True).encode()).hexdigest()[:32]


def advice_for(
    recipe: Recipe, light_angle_deg: float, found: Diagnosis, advance: Advance = silent
) -> str | None:
    """What would tell the tied causes of a wafer from the best one; None where that is no question, or of plastic.

    Args:
        recipe: the recipe.
        light_angle_deg: of the rig.
        found: the diagnosis.
        advance: progress.

    Raises:
        HeightMapError, RecipeError: the recipe's tile cannot be read or used.
    """
    tied = [one for one in found.ties if one.cause != NOTHING]
    if not recipe.is_wafer or len(tied) < 2 or found.unexplained_p < recipe.decision.alpha:
        return None
    best, *others = tied
    options = remembered_options(recipe, light_angle_deg, [one.cause for one in tied], advance)
    tried = ", ".join(option.says for option in options)
    nothing = f"nothing that was tried ({tried}): at this size optics cannot"
    by_words: dict[str, list[str]] = {}
    for one in others:
        pair = (best.cause, best.extent), (one.cause, one.extent)
        words = telling(tuple(option for option in options if option.tells(*pair)))
        by_words.setdefault(words or nothing, []).append(bare_title(one.title))
    if len(by_words) == 1:
        return next(iter(by_words))
    return "; ".join(f"{', '.join(titles)}: {words}" for words, titles in by_words.items())


def telling(options: Sequence[Option]) -> str:
    """What tells two causes apart, the first of every kind; empty where nothing does."""
    first = [next((one.says for one in options if one.kind == kind), None) for kind in KINDS]
    return ", or ".join(words for words in first if words is not None)


def bare_title(title: str) -> str:
    """The title of a cause to stand without its severity."""
    return title.removesuffix(" by").removesuffix(",")
