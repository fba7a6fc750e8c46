"""The recipe of a part with ridges."""

from typing import Self

from pydantic import model_validator

from anisoscope.recipe.surface import AreaPart, SurfaceRecipe


class RidgeRecipe(SurfaceRecipe):
    """The recipe of a plastic part with ridges, as read from its file; cells of its contrast map are judged too."""

    area: AreaPart | None = AreaPart()

    @model_validator(mode="after")
    def _spans_pitches(self) -> Self:
        self._check_span(2.0, "at least two pitches")
        return self
