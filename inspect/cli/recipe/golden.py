"""``anisoscope golden``: parts that are known to be good, against which others are compared."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import App, Parameter

from anisoscope.base.errors import CalibrationError, UsageError
from anisoscope.cli.json_output import print_json
from anisoscope.cli.options import Json
from anisoscope.cli.recipe.golden_limit import limit_says
from anisoscope.cli.tables import console, print_table

if TYPE_CHECKING:
    from anisoscope.cli.recipe.golden_prints import AnySet
    from anisoscope.decision.reference_parts import GoldenSet
    from anisoscope.recipe.surface import SurfaceRecipe

app = App(name="golden", help="Parts or prints that are known to be good, kept beside their recipe.")

RecipeFile = Annotated[Path, Parameter(name=["--recipe", "-r"], help="Recipe file (TOML).")]


@contextmanager
def _as_usage() -> Iterator[None]:
    """No part is judged here, so no exit code may look like a verdict."""
    try:
        yield
    except CalibrationError as error:
        raise UsageError(str(error)) from error


@app.command
def add(
    *folders: Annotated[Path, Parameter(help="Folders of finished inspections of good parts.")],
    recipe: RecipeFile,
    json_: Json = False,
) -> int:
    """Add inspected parts that are known to be good; all of them or none."""
    from anisoscope.cli.recipe.golden_prints import read_set, with_one_more
    from anisoscope.decision.reference_parts import golden_path, write_golden
    from anisoscope.inspection.recipe_file import read_any_recipe
    from anisoscope.record.schema import read_record

    if not folders:
        raise UsageError("name the folders of one or more finished inspections")
    rules, path = read_any_recipe(recipe), golden_path(recipe)
    with _as_usage():
        known = read_set(path, rules)
        for folder in folders:
            known = with_one_more(known, rules, read_record(folder))
    assert known is not None
    write_golden(path, known)
    return _say(path, len(folders), "added", known, json_=json_)


@app.command
def remove(*serials: str, recipe: RecipeFile, json_: Json = False) -> int:
    """Take parts out of the set, by serial number; an empty set is deleted."""
    from anisoscope.cli.recipe.golden_prints import read_set, without_one
    from anisoscope.decision.reference_parts import golden_path, write_golden
    from anisoscope.inspection.recipe_file import read_any_recipe

    if not serials:
        raise UsageError("name the serial numbers of one or more golden parts")
    path = golden_path(recipe)
    with _as_usage():
        known = read_set(path, read_any_recipe(recipe))
        if known is None:
            raise CalibrationError(f"{path}: there are no golden parts of this recipe")
        before = len(known.parts)
        for serial in serials:
            known = without_one(known, serial)
    if known.parts:
        write_golden(path, known)
    else:
        path.unlink()
    return _say(path, before - len(known.parts), "removed", known, json_=json_)


@app.command
def show(*, recipe: RecipeFile, json_: Json = False) -> int:
    """List the golden parts, and how much they vary."""
    import numpy as np

    from anisoscope.cli.recipe.golden_prints import read_set, show_prints
    from anisoscope.decision.reference_parts import GoldenSet, golden_path
    from anisoscope.inspection.recipe_file import read_any_recipe
    from anisoscope.kinds.prints.recipe import PrintRecipe

    path, rules = golden_path(recipe), read_any_recipe(recipe)
    with _as_usage():
        known = read_set(path, rules)
        if known is None:
            raise CalibrationError(
                f"{path}: there are no golden parts of this recipe: add some with `anisoscope golden add`"
            )
    content = _content(path, known.lacking, len(known.parts))
    if not isinstance(known, GoldenSet):
        assert isinstance(rules, PrintRecipe)
        return show_prints(known, rules, content, json_=json_)
    assert not isinstance(rules, PrintRecipe)
    contrasts = known.contrasts()
    scatter = contrasts.std(axis=0, ddof=1) if len(contrasts) > 1 else np.full(contrasts.shape[1], np.nan)
    if json_:
        content["parts"] = [part.model_dump() for part in known.parts]
        content["mean"] = [float(value) for value in contrasts.mean(axis=0)]
        content["scatter"] = [float(value) if np.isfinite(value) else None for value in scatter]
        content["area_limit"] = (
            None if rules.area is None else known.area_limit(rules) or rules.area.max_share
        )
        content["area_limit_says"] = _limit_says(known, rules)
        print_json(content)
        return 0
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
    print_table(
        f"golden parts: {known.product}",
        ["part", "inspected", "verdict", "area", *names],
        rows,
        known.lacking,
    )
    console().print(_limit_says(known, rules), markup=False, highlight=False, soft_wrap=True)
    return 0


def _share(share: float | None) -> str:
    return "–" if share is None else f"{share:.2%}"


def _limit_says(known: "GoldenSet", recipe: "SurfaceRecipe") -> str:
    from anisoscope.decision.reference_parts import limit_is_given

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


def _content(path: Path, lacking: str | None, count: int) -> dict[str, Any]:
    return {
        "file": str(path),
        "count": count,
        "compared_with": lacking is None and count > 0,
        "lacking": lacking,
    }


def _say(path: Path, number: int, what: str, known: "AnySet", *, json_: bool) -> int:
    from anisoscope.decision.reference_parts import GoldenSet, counted

    lacking, count = known.lacking, len(known.parts)
    kind = "golden part" if isinstance(known, GoldenSet) else "golden print"
    if json_:
        print_json(_content(path, lacking if count else None, count) | {what: number})
        return 0
    out = console()
    out.print(
        f"{path}: {number} {what}, {counted(count, kind)}", markup=False, highlight=False, soft_wrap=True
    )
    if lacking and count:
        out.print(lacking, markup=False, highlight=False, soft_wrap=True)
    return 0
