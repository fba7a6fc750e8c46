"""The golden prints as ``anisoscope golden show`` lists them."""

from typing import Any

import numpy as np

from anisoscope.decision.reference_parts import limit_is_given
from anisoscope.kinds.golden_limit import limit_says
from anisoscope.kinds.kind import Shown, Table
from anisoscope.kinds.prints.recipe import PrintRecipe
from anisoscope.kinds.prints.reference_prints import TESTS, GoldenPrints


def prints_shown(known: GoldenPrints, recipe: PrintRecipe) -> Shown:
    """Golden prints: how bright each is from their mean, and how far it is off besides."""
    logs = known.logs()
    off = (logs - logs.mean(axis=0)).reshape(len(logs), -1, 3)
    level = off.mean(axis=1)
    rest = np.sqrt(np.mean((off - level[:, None]) ** 2, axis=(1, 2)))
    mean = logs.mean(axis=0).reshape(-1, 3)
    scatter = off.std(axis=0, ddof=1) if len(off) > 1 else None
    content: dict[str, Any] = {"seen": known.seen.model_dump(), "poses": [list(pose) for pose in known.poses]}
    content["parts"] = [part.model_dump() for part in known.parts]
    content["area_limit"] = None if recipe.area is None else known.area_limit(recipe) or recipe.area.max_share
    content["area_limit_says"] = _limit_says(known, recipe)
    content |= {"mean": mean.tolist(), "scatter": None if scatter is None else scatter.tolist()}
    rows = [
        [part.serial, part.inspected_at, part.verdict, _share(part.area_share)]
        + [f"{value:+.4f}" for value in brightness]
        + [f"{more:.4f}"]
        for part, brightness, more in zip(known.parts, level, rest, strict=True)
    ]
    if len(level) > 1:
        spread = level.std(axis=0, ddof=1)
        rows.append(["scatter", "", "", "", *(f"{value:.4f}" for value in spread), ""])
    table = Table(
        f"golden prints: {known.product}",
        ["print", "inspected", "verdict", "area", "ln red", "ln green", "ln blue", "besides, rms"],
        rows,
        known.lacking,
    )
    seen = known.seen
    line = (
        f"ln of the channels from the mean of these prints, over all {len(known.poses)} poses; seen: ink {seen.ink}, "
        f"lamp {seen.lamp}, camera {seen.sensitivities} ({seen.filters})"
    )
    return Shown(content, (table,), (line, _limit_says(known, recipe)))


def _limit_says(known: GoldenPrints, recipe: PrintRecipe) -> str:
    rule, alpha = recipe.area, recipe.decision.alpha
    often = f"one good print in {TESTS / alpha:.0f} exceeds it"
    return limit_says(
        None if rule is None else rule.max_share,
        None if rule is None else known.area_limit(recipe),
        0 if rule is None else len(known.area_shares(rule)),
        given=rule is not None and limit_is_given(rule),
        things="prints",
        exceeds=f"{often}; lobe, colours and area share the level {alpha:g}",
        judged=""
        if rule is None
        else f"in cells of {rule.cell_mm:g} mm at cell_delta_e {rule.cell_delta_e:g}",
    )


def _share(share: float | None) -> str:
    return "–" if share is None else f"{share:.2%}"
