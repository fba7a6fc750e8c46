"""Recipes that may be inspected at a station: a folder of them, by the names of their files."""

from pathlib import Path

from pydantic import BaseModel

from anisoscope.base.errors import AnisoscopeError, UsageError

OTHERS = frozenset({"rig.toml", "bench.toml", "anisoscope.toml"})
"""Files of other sorts that may be in the folder of a job."""


class RecipeEntry(BaseModel):
    """A recipe that may be inspected here."""

    name: str
    product: str
    exposure_s: float
    gain: float
    poses: int
    channel: str | None = None
    picture: str | None = None
    problem: str | None = None


def recipe_paths(folder: Path) -> dict[str, Path]:
    """Paths of the recipes of a folder by their names, in their order."""
    return {path.stem: path for path in sorted(folder.glob("*.toml")) if path.name not in OTHERS}


def recipe_path(folder: Path, name: str) -> Path:
    """Path of a recipe by its name.

    Raises:
        UsageError: there is none.
    """
    path = recipe_paths(folder).get(name)
    if path is None:
        raise UsageError(f"there is no recipe {name[:80]!r} in {folder}")
    return path


def recipe_entry(path: Path) -> RecipeEntry:
    """Name and product of a recipe; an unreadable one gives the reason."""
    from anisoscope.kinds.recipes import read_any_recipe  # noqa: PLC0415 - loads the kinds
    from anisoscope.recipe.logo import logo_uri  # noqa: PLC0415

    try:
        found = read_any_recipe(path)
        return RecipeEntry(
            name=path.stem,
            product=found.product,
            exposure_s=found.acquisition.exposure_s,
            gain=found.acquisition.gain,
            poses=len(found.poses.poses()),
            channel=found.acquisition.light_channel,
            picture=logo_uri(found),
        )
    except AnisoscopeError as problem:
        text = " ".join(str(problem).split())
        return RecipeEntry(name=path.stem, product=path.stem, exposure_s=0.0, gain=0.0, poses=0, problem=text)
