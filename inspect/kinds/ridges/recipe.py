"""The recipe of a part with ridges, and a new one to begin with."""

import os
from pathlib import Path
from typing import Self

from pydantic import model_validator

from anisoscope.base.atomic_write import write_text
from anisoscope.base.errors import UsageError
from anisoscope.kinds.kind import NewRecipe
from anisoscope.kinds.ridges.template import new_recipe
from anisoscope.recipe.surface import AreaPart, SurfaceRecipe, read_surface_recipe


class RidgeRecipe(SurfaceRecipe):
    """The recipe of a plastic part with ridges, as read from its file; cells of its contrast map are judged as well."""

    area: AreaPart | None = AreaPart()

    @model_validator(mode="after")
    def _spans_pitches(self) -> Self:
        self._check_span(2.0, "at least two pitches")
        return self


PRODUCT = "ridged part"
RIDGE_ANGLE_DEG = 10.0


def write_new_recipe(out: Path, requested: NewRecipe) -> None:
    """Write a recipe that is valid as written.

    Raises:
        UsageError: a spread without a design, or a height map that is not there.
    """
    ridge_angle, height_map = requested.ridge_angle_deg, requested.height_map
    if ridge_angle is None and height_map is None:
        ridge_angle = RIDGE_ANGLE_DEG
    if requested.u_ridge_angle_deg is not None and ridge_angle is None:
        raise UsageError(
            "--u-ridge-angle is the spread of a design's ridges: give --ridge-angle as well, or leave it out"
        )
    if height_map is not None and not height_map.is_file():
        raise UsageError(f"{height_map}: there is no such file")
    relative_path = (
        None if height_map is None else os.path.relpath(height_map.resolve(), out.resolve().parent)
    )
    text = new_recipe(
        requested.product or PRODUCT,
        requested.pitch_um,
        ridge_angle_deg=ridge_angle,
        u_ridge_angle_deg=requested.u_ridge_angle_deg,
        height_map=relative_path and Path(relative_path).as_posix(),
    )
    write_text(out, text)
    try:
        read_surface_recipe(out, RidgeRecipe)
    except BaseException:
        out.unlink()
        raise
