"""``anisoscope golden`` of prints: the same words for another kind of set."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

from anisoscope.cli.json_output import print_json
from anisoscope.cli.recipe.golden_limit import limit_says
from anisoscope.cli.tables import console, print_table

if TYPE_CHECKING:
    from anisoscope.decision.reference_parts import GoldenSet
    from anisoscope.kinds.prints.recipe import AnyRecipe, PrintRecipe
    from anisoscope.kinds.prints.reference_prints import GoldenPrints
    from anisoscope.record.schema import Record

    AnySet = GoldenSet | GoldenPrints


def read_set(path: Path, recipe: "AnyRecipe") -> "AnySet | None":
    """The golden parts or prints of a recipe; errors as for `read_golden` and `read_golden_prints`."""
    from anisoscope.decision.reference_parts import read_golden
    from anisoscope.kinds.prints.recipe import PrintRecipe
    from anisoscope.kinds.prints.reference_prints import read_golden_prints

    return read_golden_prints(path, recipe) if isinstance(recipe, PrintRecipe) else read_golden(path, recipe)


def with_one_more(known: "AnySet | None", recipe: "AnyRecipe", record: "Record") -> "AnySet":
    """A set with one part or print more; errors as for `add_part` and `add_print`."""
    from anisoscope.decision.reference_parts import GoldenSet, add_part
    from anisoscope.kinds.prints.recipe import PrintRecipe
    from anisoscope.kinds.prints.reference_prints import GoldenPrints, add_print

    if isinstance(recipe, PrintRecipe):
        assert not isinstance(known, GoldenSet)
        return add_print(known, recipe, record)
    assert not isinstance(known, GoldenPrints)
    return add_part(known, recipe, record)


def without_one(known: "AnySet", serial: str) -> "AnySet":
    """A set without a serial number; errors as for `without_part`."""
    from anisoscope.decision.reference_parts import GoldenSet, without_part
    from anisoscope.kinds.prints.reference_prints import without_print

    return without_part(known, serial) if isinstance(known, GoldenSet) else without_print(known, serial)


def show_prints(known: "GoldenPrints", recipe: "PrintRecipe", content: dict[str, Any], *, json_: bool) -> int:
    """List golden prints: how bright each is from their mean, and how far it is off besides."""
    import numpy as np

    logs = known.logs()
    off = (logs - logs.mean(axis=0)).reshape(len(logs), -1, 3)
    level = off.mean(axis=1)
    rest = np.sqrt(np.mean((off - level[:, None]) ** 2, axis=(1, 2)))
    if json_:
        mean = logs.mean(axis=0).reshape(-1, 3)
        scatter = off.std(axis=0, ddof=1) if len(off) > 1 else None
        content |= {"seen": known.seen.model_dump(), "poses": [list(pose) for pose in known.poses]}
        content["parts"] = [part.model_dump() for part in known.parts]
        content["area_limit"] = (
            None if recipe.area is None else known.area_limit(recipe) or recipe.area.max_share
        )
        content["area_limit_says"] = _limit_says(known, recipe)
        content |= {"mean": mean.tolist(), "scatter": None if scatter is None else scatter.tolist()}
        print_json(content)
        return 0
    rows = [
        [part.serial, part.inspected_at, part.verdict, _share(part.area_share)]
        + [f"{value:+.4f}" for value in brightness]
        + [f"{more:.4f}"]
        for part, brightness, more in zip(known.parts, level, rest, strict=True)
    ]
    if len(level) > 1:
        scatter = level.std(axis=0, ddof=1)
        rows.append(["scatter", "", "", "", *(f"{value:.4f}" for value in scatter), ""])
    print_table(
        f"golden prints: {known.product}",
        ["print", "inspected", "verdict", "area", "ln red", "ln green", "ln blue", "besides, rms"],
        rows,
        known.lacking,
    )
    seen = known.seen
    console().print(
        f"ln of the channels from the mean of these prints, over all {len(known.poses)} poses; seen: ink {seen.ink}, "
        f"lamp {seen.lamp}, camera {seen.sensitivities} ({seen.filters})",
        markup=False,
        highlight=False,
        soft_wrap=True,
    )
    console().print(_limit_says(known, recipe), markup=False, highlight=False, soft_wrap=True)
    return 0


def _limit_says(known: "GoldenPrints", recipe: "PrintRecipe") -> str:
    from anisoscope.decision.reference_parts import limit_is_given
    from anisoscope.kinds.prints.reference_prints import TESTS

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
