"""The golden parts of a surface as ``anisoscope golden show`` lists them."""

from typing import Any

import numpy as np

from anisoscope.decision.reference_parts import GoldenSet, limit_is_given
from anisoscope.kinds.golden_limit import limit_says
from anisoscope.kinds.kind import Shown, Table
from anisoscope.recipe.surface import SurfaceRecipe


def golden_shown(known: GoldenSet, recipe: SurfaceRecipe) -> Shown:
    """The golden parts, and how much they vary."""
    contrasts = known.contrasts()
    scatter = contrasts.std(axis=0, ddof=1) if len(contrasts) > 1 else np.full(contrasts.shape[1], np.nan)
    content: dict[str, Any] = {}
    content["parts"] = [part.model_dump() for part in known.parts]
    content["mean"] = [float(value) for value in contrasts.mean(axis=0)]
    content["scatter"] = [float(value) if np.isfinite(value) else None for value in scatter]
    content["area_limit"] = None if recipe.area is None else known.area_limit(recipe) or recipe.area.max_share
    content["area_limit_says"] = _limit_says(known, recipe)
    first, *others = known.poses
    names = [f"ln L{_at(pose)} − ln L{_at(first)}" for pose in others]
    rows = [
        [
            part.serial,
            part.inspected_at,
            part.verdict,
            _share(part.area_share),
            *(f"{value:+.4f}" for value in row),
        ]
        for part, row in zip(known.parts, contrasts, strict=True)
    ]
    rows.append(["mean", "", "", "", *(f"{value:+.4f}" for value in contrasts.mean(axis=0))])
    rows.append(
        ["scatter", "", "", "", *(f"{value:.4f}" if np.isfinite(value) else "–" for value in scatter)]
    )
    table = Table(
        f"golden parts: {known.product}",
        ["part", "inspected", "verdict", "area", *names],
        rows,
        known.lacking,
    )
    return Shown(content, (table,), (_limit_says(known, recipe),))


def _share(share: float | None) -> str:
    return "–" if share is None else f"{share:.2%}"


def _limit_says(known: GoldenSet, recipe: SurfaceRecipe) -> str:
    rule, alpha = recipe.area, recipe.decision.alpha
    return limit_says(
        None if rule is None else rule.max_share,
        None if rule is None else known.area_limit(recipe),
        0 if rule is None else len(known.area_shares(rule)),
        given=rule is not None and limit_is_given(rule),
        things="parts",
        exceeds=f"one good part in {2.0 / alpha:.0f} exceeds it; contrasts and area share the level {alpha:g}",
        judged="" if rule is None else f"at cell_deviation {rule.cell_deviation:g}",
    )


def _at(pose: tuple[float, float]) -> str:
    return f"({pose[0]:g}°" + (f", tilt {pose[1]:g}°)" if pose[1] else ")")
