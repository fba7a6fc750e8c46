"""The recipe of a plate: plan of its fields, ridges, plastic, limits of classes and fields, and the code it carries."""

from pathlib import Path
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, ValidationInfo, model_validator

from anisoscope.base.errors import HeightMapError, RecipeError
from anisoscope.base.regular_file import bounded_bytes
from anisoscope.base.toml_file import LocalPath, NotNegative, Part, Positive
from anisoscope.profiles.plates import Plan, read_rows
from anisoscope.recipe.base import DecisionBase, RecipeBase
from anisoscope.recipe.surface import MaterialPart, RigUncertainty, ScatterPart, SurfacePart, SurfaceRecipe

Symbology = Literal["datamatrix", "qr"]
RidgeAngle = Annotated[float, Field(gt=0.0, lt=45.0)]
IMAGE_LEVELS = 128
"""Grey level below which a pixel of an image is of the second class."""


def _quarter() -> dict[str, float]:
    """Two classes that exchange light and dark with a quarter turn."""
    return {"A": 0.0, "B": -90.0}


class PlanPart(Part):
    """Plan of the fields: ``rows`` of letters, or the ``file`` that holds it.

    A text file (CSV or plain) has a line a row, a letter a field, the first row at the top; an image has a pixel a
    field, light ones of the first class and dark ones of the second. ``.`` is a flat field. ``facet_azimuths_deg``
    gives the azimuth toward which the facets of each class fall at stage angle 0, counter-clockwise from +x;
    ``ridge_angles_deg`` the ridge angles of classes that differ from the design.
    """

    module_mm: Positive
    facet_azimuths_deg: Annotated[dict[str, float], Field(min_length=1, default_factory=_quarter)]
    ridge_angles_deg: Annotated[dict[str, RidgeAngle], Field(default_factory=dict)]
    rows: tuple[str, ...] = ()
    file: LocalPath | None = None

    @model_validator(mode="after")
    def _has_rows(self, info: ValidationInfo) -> Self:
        del info
        if bool(self.rows) == (self.file is not None):
            raise ValueError("give rows, or the file that holds the plan")
        for letter in self.facet_azimuths_deg:
            if len(letter) != 1 or letter in ",;. \t#":
                raise ValueError(f"facet_azimuths_deg: a class is called by one letter, not {letter!r}")
        if self.rows:
            self.plan()
        return self

    def plan(self) -> Plan:
        """The plan.

        Raises:
            ValueError: it is none, or its file cannot be read.
        """
        rows = self.rows if self.file is None else _rows_of(self.file, tuple(self.facet_azimuths_deg))
        try:
            return Plan(read_rows(rows), self.facet_azimuths_deg, self.module_mm, self.ridge_angles_deg)
        except HeightMapError as problem:
            raise ValueError(str(problem)) from None


def _rows_of(path: Path, letters: tuple[str, ...]) -> tuple[str, ...]:
    """Rows of a plan in a file."""
    if path.suffix.lower() in {".png", ".bmp", ".tif", ".tiff", ".pgm"}:
        if len(letters) < 2:
            raise ValueError(f"{path}: an image has two classes; name two in facet_azimuths_deg")
        content = np.fromfile(path, dtype=np.uint8) if path.is_file() else np.zeros(0, np.uint8)
        import cv2  # noqa: PLC0415 - slow to import

        found = cv2.imdecode(content, cv2.IMREAD_GRAYSCALE) if content.size else None
        if found is None:
            raise ValueError(f"{path}: there is no such image, or it cannot be read")
        dark = np.asarray(found) < IMAGE_LEVELS
        return tuple("".join(letters[1] if one else letters[0] for one in row) for row in dark)
    try:
        return tuple(bounded_bytes(path).decode("utf-8-sig").splitlines())
    except (OSError, UnicodeDecodeError) as problem:
        raise ValueError(f"{path}: cannot be read: {problem}") from None


class CodePart(Part):
    """The code that the plan is, and the stage angles at which it must be read."""

    text: Annotated[str, Field(min_length=1)]
    symbology: Symbology = "datamatrix"
    read_at_deg: Annotated[tuple[float, ...], Field(min_length=1)] = (0.0, 90.0)


class FieldsPart(Part):
    """Limits of single fields.

    ``tolerance`` is the largest |ln| by which a field may differ from the middle of its class in any pose; ``most`` how
    many fields may. ``interior`` is the share of the side of a field over which it is averaged. With a height map the
    field is compared with what the map predicts of it.
    """

    tolerance: Positive = 0.25
    most: Annotated[int, Field(ge=0)] = 0
    interior: Annotated[float, Field(gt=0.1, le=0.95)] = 0.7


class PlateDefects(Part):
    """Smallest interesting sizes of the defects of a single field; None tests for none.

    ``ridge_angle_deg`` either way; ``height_loss`` of ridges that are not filled, ``bare_share`` of the field without
    ridges; ``wear_um``: radius of its crests.
    """

    ridge_angle_deg: Annotated[float, Field(gt=0.0, lt=45.0)] | None = 2.0
    height_loss: Annotated[float, Field(gt=0.0, lt=1.0)] | None = 0.2
    bare_share: Annotated[float, Field(gt=0.0, le=1.0)] | None = 0.2
    wear_um: Positive | None = 15.0


class PlateDecision(DecisionBase):
    """Decision rule; ``tolerance`` is the largest deviation from the prediction of a ln ratio of classes or poses."""

    tolerance: Positive | None = None


class PlateRecipe(RecipeBase):
    """The recipe of a plate, as read from its TOML file."""

    surface: SurfacePart
    material: MaterialPart
    plan: PlanPart
    fields: FieldsPart = FieldsPart()
    defects: PlateDefects = PlateDefects()
    code: CodePart | None = None
    decision: PlateDecision = PlateDecision()
    uncertainty: RigUncertainty = RigUncertainty()
    scatter: ScatterPart | None = ScatterPart()
    u_place_um: NotNegative = 5.0
    """Standard uncertainty of the place of the fields in the picture."""

    @model_validator(mode="after")
    def _is_a_plate(self) -> Self:
        if self.surface.design is None:
            raise ValueError(
                "surface: a plate needs design, the ideal ridges of its fields, also with a height_map"
            )
        if self.surface.height_map is not None and self.surface.decides != "height_map":
            raise ValueError(
                'surface: the height_map of a plate decides: say compare = "height_map", or leave the map out'
            )
        if self.surface.roughness == "plastic":
            raise ValueError(
                'surface: plates know no roughness = "plastic": give the roughness that the map does not resolve'
            )
        if self.plan.rows:
            self._check_plan(self.plan.plan())
        if self.code is not None:
            missing = [one for one in self.code.read_at_deg if one not in self.poses.angles_deg]
            if missing:
                raise ValueError(f"code.read_at_deg: {missing[0]:g} is none of poses.angles_deg")
        return self

    def _check_plan(self, plan: Plan) -> None:
        try:
            plan.check_ridges(self.surface.pitch_um)
        except HeightMapError as problem:
            raise ValueError(f"plan: {problem}") from None
        if len(plan.letters) < 1:
            raise ValueError("plan: no field has ridges")
        for size, of_plan in zip(self.region.size_mm, plan.size_mm, strict=True):
            if of_plan > size * (1.0 + 1e-6):
                raise ValueError(
                    f"plan: {plan.size_mm[0]:g} mm × {plan.size_mm[1]:g} mm of fields are larger than "
                    f"region.size_mm = {list(self.region.size_mm)}: take smaller fields, or a larger region"
                )

    @property
    def interior(self) -> float:
        """Share of the side of a field over which it is averaged: one pitch where `FieldsPart.interior` is below two.

        A part of a second pitch would have more of the facet or more of the crest.
        """
        pitch = 1e-3 * self.surface.pitch_um / self.plan.module_mm
        return pitch if pitch <= self.fields.interior < 2.0 * pitch else self.fields.interior

    def check_named(self, path: Path) -> None:
        """Read the plan, and check that it fits the recipe."""
        try:
            self._check_plan(self.plan.plan())
        except ValueError as problem:
            raise RecipeError(f"{path}: plan: {problem}") from None

    def of_class(self, azimuth_deg: float, ridge_angle_deg: float | None = None) -> SurfaceRecipe:
        """The recipe of ridges alone, facets toward an azimuth at stage angle 0, with a ridge angle of their own."""
        poses = self.poses.model_copy(
            update={"facet_azimuth_deg": self.poses.facet_azimuth_deg + azimuth_deg}
        )
        common = (
            "product",
            "version",
            "acquisition",
            "region",
            "surface",
            "material",
            "uncertainty",
            "scatter",
        )
        tables = {name: getattr(self, name) for name in common}
        surface = self.surface.model_copy(update={"height_map": None, "compare": None})
        if ridge_angle_deg is not None and surface.design is not None:
            design = surface.design.model_copy(update={"ridge_angle_deg": ridge_angle_deg})
            surface = surface.model_copy(update={"design": design})
        tables["surface"] = surface
        return SurfaceRecipe.model_validate({"schema": 1, "poses": poses, **tables})
