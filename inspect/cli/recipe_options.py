"""Option ``--recipe`` of commands that predict: plastic and surface of a recipe in place of their own options."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

from anisoscope.base.errors import UsageError
from anisoscope.cli.log import LOG

if TYPE_CHECKING:
    from cyclopts import App, ArgumentCollection

    from anisoscope.recipe.surface import SurfaceRecipe

COMMANDS = (("render",),)
"""Commands whose options are filled here; the others take what `operations.stated` says."""


def apply_recipe(app: "App", commands: tuple[str, ...], arguments: "ArgumentCollection") -> None:
    """Give options that the command line leaves out the values of ``--recipe``; a configuration of cyclopts.

    Raises:
        UsageError: a recipe of another kind, or a lobe or surface that the options cannot state.
        RecipeError: the recipe.
    """
    del app
    if not any(commands[: len(one)] == one for one in COMMANDS):
        return
    named = next((one for one in arguments if "--recipe" in one.names), None)
    if named is None or not named.tokens:
        return
    from cyclopts.token import Token

    path = Path(named.tokens[-1].value)
    values = recipe_values(path)
    surface = values.pop("HEIGHT_MAP", None)
    if surface is not None and any(one.index == 0 for one in arguments):
        values = {name: value for name, value in values.items() if name not in {"--ridge-angle", "--wall"}}
        if any("--ridge-angle" in one.names and one.tokens for one in arguments):
            surface = None  # the command line names another surface
    for one in arguments:
        key = next((name for name in one.names if name in values), None)
        if one.tokens or (key is None and not (one.index == 0 and surface)):
            continue
        text = surface if key is None else values[key]
        LOG.info("%s: %s %s", path, key or "HEIGHT_MAP", text)
        one.append(Token(keyword=key, value=str(text), source=str(path)))


def recipe_values(path: Path) -> dict[str, Any]:
    """Values of options by their names, and the height map as ``HEIGHT_MAP`` where it decides.

    Raises:
        UsageError: a recipe of another kind, or a lobe or surface that the options cannot state.
        RecipeError: the recipe.
    """
    from anisoscope.kinds.registry import kind_of
    from anisoscope.kinds.surface import SurfaceKind

    kind = kind_of(path)
    if not isinstance(kind, SurfaceKind):
        raise UsageError(f"{path}: the recipe of {kind.one}; --recipe takes those of surfaces")
    recipe = kind.read_recipe(path)
    material = recipe.material.material()
    if material.tail or material.second_lobe:
        raise UsageError(
            f"{path}: the lobe of its material has a tail, which the options of this command cannot state: only "
            "`anisoscope predict --recipe` knows it"
        )
    found: dict[str, Any] = {
        "--alpha-along": material.alpha_along,
        "--alpha-across": material.alpha_across,
        "--albedo": material.albedo,
        "--index": material.index,
    }
    return found | _surface(recipe, path)


def _surface(recipe: "SurfaceRecipe", path: Path) -> dict[str, Any]:
    part = recipe.surface
    found: dict[str, Any] = {"--pitch": part.pitch_um}
    if part.design is not None and isinstance(part.design.wall, str):
        found |= {"--wall": part.design.wall}
    if part.design is not None:
        found |= {
            "--ridge-angle": part.design.ridge_angle_deg,
            "--edge-radius": part.design.edge_radius_um or 0.0,
        }
    if part.decides == "height_map":
        if part.role == "tool":
            raise UsageError(
                f"{path}: its height map is that of the tool; only `anisoscope predict --recipe` knows it"
            )
        found["HEIGHT_MAP"] = part.height_map
        if part.pixel_um is not None:
            found["--pixel"] = ",".join(str(size) for size in part.pixel_um)
    return found
