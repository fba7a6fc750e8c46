"""Recipe of a part with a surface: reference surface, material, light, and decision rule."""

import math
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import BeforeValidator, Field, ValidationInfo, model_validator

from anisoscope.base.errors import HeightMapError, ModelError, RecipeError, RigFileError
from anisoscope.base.toml_file import LocalPath, NotNegative, Part, Positive, Share, length
from anisoscope.parameters.geometry import Convention
from anisoscope.parameters.inputs import (
    SCATTER_ALBEDO,
    SCATTER_ALPHA,
    SCATTER_DEG,
    SCATTER_EDGE,
    UNMEASURED_SHARE,
    USUAL_EDGE_SHARE,
)
from anisoscope.parameters.material import LONGEST_TAIL, Material
from anisoscope.parameters.ridges import LIKELY_PITCH, STEEPEST_DRAFT_DEG, RidgeDesign
from anisoscope.recipe.base import CommonUncertainty, LotDecision, RecipeBase
from anisoscope.recipe.material_file import MaterialFile, MaterialLightPart, read_material_file
from anisoscope.rig.rigfile import RigFile
from anisoscope.sim.light.contrasts import consecutive_pairs

WIDEST = 0.4
"""Largest full width of a lamp's spectrum, by its wavelength: the bench's lamps are no wider."""


class LightPart(Part):
    """Lamp and lens as seen from the part, with standard uncertainties; diffraction depends on them.

    ``bandwidth_nm`` is the full width of the lamp's spectrum at half of its height; half angles are those of the cones
    of light that fall in and that the lens collects.
    """

    wavelength_nm: Annotated[float, Field(ge=200.0, le=2000.0)] = 550.0
    bandwidth_nm: Annotated[float, Field(ge=0.0, le=200.0)] = 0.0
    lamp_half_angle_deg: Annotated[float, Field(ge=0.0, le=30.0)] = 0.0
    aperture_half_angle_deg: Annotated[float, Field(ge=0.0, le=30.0)] = 0.0
    u_wavelength_nm: NotNegative = 0.5
    u_bandwidth_share: Share = 0.1
    u_lamp_share: Share = 0.05
    u_aperture_share: Share = 0.02

    @model_validator(mode="after")
    def _light_is_light(self) -> Self:
        if self.bandwidth_nm > WIDEST * self.wavelength_nm:
            raise ValueError(
                f"bandwidth_nm = {self.bandwidth_nm:g} is too wide for a lamp about {self.wavelength_nm:g} nm: at most "
                f"{WIDEST * self.wavelength_nm:.3g}"
            )
        return self


ContrastKind = Literal["log_ratio", "michelson", "difference"]
Surface = Literal["height_map", "design"]
AskedOptics = Literal["auto", "geometric", "wave"]
Reflections = Literal["all", "direct"] | Annotated[int, Field(strict=True, ge=2, le=30)]


class DesignPart(Part):
    """Ideal ridges; ``u_ridge_angle_deg`` is the standard deviation of the angle of good parts.

    ``edge_radius_um`` is the radius of the crests, 0 for sharp ones, known by ``u_edge_radius_share`` of it. Left out,
    it is unmeasured: sharp crests are predicted, and any radius up to 1 µm is in the budget. ``edge_form`` says
    whether rounded crests are known to be an "arc", or have "any" form, such as a few chords of one.
    ``foot_radius_um`` is the radius of the feet. ``wall`` may be the draft of the wall in degrees from the vertical.
    """

    ridge_angle_deg: Annotated[float, Field(ge=0.0, lt=45.0)]
    u_ridge_angle_deg: NotNegative = 0.0
    edge_radius_um: NotNegative | None = None
    u_edge_radius_share: Share = USUAL_EDGE_SHARE
    edge_form: Literal["any", "arc"] = "any"
    foot_radius_um: NotNegative = 0.0
    wall: Literal["perpendicular", "vertical"] | Annotated[float, Field(ge=0.0, le=STEEPEST_DRAFT_DEG)] = (
        "perpendicular"
    )


Pitch = Annotated[Positive, length(LIKELY_PITCH)]


class SurfacePart(Part):
    """Reference surface: a measured height map, an ideal design, or both.

    ``pitch_um`` is needed in all cases: means and the contrast map are taken over whole pitches. Of both surfaces,
    ``compare`` says which one decides; the other is compared with as well. ``optics`` says how light is predicted:
    "auto" takes rays or waves, whichever is right, "geometric" and "wave" insist. ``reflections`` says how often light
    is followed from facet to wall and back: "all", a number, or "direct" for light that reflects once. ``roughness``
    says of which the material's is with a height map: of the "lobe", what the map does not resolve, or of the whole
    "plastic", from which the slopes that the map resolves are taken off. With a design it is always that of the whole
    plastic. ``walls`` says whether walls and crests of a height map are "fitted" between its points, or taken as
    "sampled".
    """

    pitch_um: Pitch
    height_map: LocalPath | None = None
    pixel_um: tuple[Positive, Positive] | None = None
    role: Literal["part", "tool"] = "part"
    design: DesignPart | None = None
    compare: Surface | None = None
    optics: AskedOptics = "auto"
    reflections: Reflections = "all"
    roughness: Literal["lobe", "plastic"] = "lobe"
    walls: Literal["fitted", "sampled"] = "fitted"

    @model_validator(mode="after")
    def _something_decides(self) -> Self:
        if self.height_map is None and self.design is None:
            raise ValueError("give height_map (a file) or design (a table), or both of them with compare")
        if self.height_map is not None and self.design is not None and self.compare is None:
            raise ValueError(
                'of height_map and design, say with compare = "height_map" or "design" which one decides'
            )
        if self.compare is not None and getattr(self, self.compare) is None:
            raise ValueError(f'compare = "{self.compare}", but there is no {self.compare}')
        if self.roughness == "plastic" and (self.height_map is None or self.optics == "wave"):
            raise ValueError(
                'roughness = "plastic" takes the slopes of a height_map off, by rays: leave it out with a design alone '
                'and with optics = "wave"'
            )
        if self.compare == "height_map" and self.design is not None and self.design.u_ridge_angle_deg > 0.0:
            raise ValueError(
                "design.u_ridge_angle_deg is the spread of ideal ridges, and cannot be given to those of a height_map "
                'that decides: leave it out, or let the design decide (compare = "design")'
            )
        part = self.design
        if part is None:
            return self
        for what, radius in (
            ("design.foot_radius_um", 0.0),
            (
                "design.edge_radius_um with its uncertainty",
                (part.edge_radius_um or 0.0) * (1.0 + part.u_edge_radius_share),
            ),
        ):
            try:
                self.ridge_design(radius)
            except HeightMapError as problem:
                raise ValueError(f"{what}: {problem}") from None
        return self

    @property
    def decides(self) -> Surface:
        """The surface on which the verdict is based."""
        return self.compare or ("height_map" if self.design is None else "design")

    @property
    def bounces(self) -> int | None:
        """Largest number of reflections that is followed; None follows all."""
        return (
            {"all": None, "direct": 1}[self.reflections]
            if isinstance(self.reflections, str)
            else self.reflections
        )

    @property
    def both(self) -> bool:
        """Whether there is a second surface to compare with."""
        return self.height_map is not None and self.design is not None

    def ridge_design(self, edge_radius_um: float | None = None) -> RidgeDesign:
        """The ideal design of this table; only where ``design`` is given.

        Args:
            edge_radius_um: radius of the crests; that of the table by default.

        Raises:
            HeightMapError: the radius leaves no facet.
        """
        part = self.design
        assert part is not None
        return RidgeDesign(
            pitch_um=self.pitch_um,
            ridge_angle_deg=part.ridge_angle_deg,
            wall=part.wall,
            edge_radius_um=(part.edge_radius_um or 0.0) if edge_radius_um is None else edge_radius_um,
            foot_radius_um=part.foot_radius_um,
        )


class MaterialPart(Part):
    """The plastic, with standard uncertainties: relative for the roughness, absolute for the rest.

    ``tail`` is that of the lobe, 0 for Beckmann's to 1.6, ``second_lobe`` weight and width of a Beckmann lobe mixed in
    (`parameters.material.Material`). ``u_tail`` = 0 says that the lobe is known. Where neither it nor a second lobe is
    stated, the lobe is unmeasured: every tail from 0 to 1 is possible, and roughness and albedo are known to a
    tenth where nothing else is stated (to 5 % and 0.01 of a lobe with ``u_tail``).

    ``file`` names a material file in place of the values and of their uncertainties, but for that of the index:
    ``material = "abs.toml"`` is short for it. ``calibrated`` is then its content.
    """

    file: LocalPath | None = None
    calibrated: MaterialFile | None = None
    alpha_along: Positive
    alpha_across: Positive
    albedo: Share
    index: Annotated[float, Field(gt=1.0, le=4.0)] = 1.5
    internal_reflection: Literal["nonlinear", "linear"] = "nonlinear"
    tail: Annotated[float, Field(ge=0.0, le=LONGEST_TAIL)] = 0.0
    second_lobe: Annotated[
        tuple[Annotated[float, Field(gt=0.0, lt=1.0)], Positive] | None,
        BeforeValidator(
            lambda value: tuple(value) if isinstance(value, list) else value
        ),  # after `_unmeasured`
    ] = None
    u_tail: NotNegative | None = None
    u_alpha_share: Share = 0.05
    u_albedo: NotNegative = 0.01
    u_index: NotNegative = 0.01

    @model_validator(mode="before")
    @classmethod
    def _from_its_file(cls, table: Any, info: ValidationInfo) -> Any:  # noqa: ANN401
        found: Any = {"file": table} if isinstance(table, str) else table
        if not isinstance(found, dict) or found.get("file") is None or found.get("calibrated") is not None:
            return table
        own = set(found) - {"file", "u_index", "calibrated"}
        if own:
            raise ValueError(f"file holds the material: leave {', '.join(sorted(own))} out")
        folder = Path((info.context or {}).get("folder", "."))
        path = folder / str(found["file"])
        if not path.is_file() and (folder / path.name).is_file():
            path = folder / path.name  # the copy in an inspection folder
        file = read_material_file(path)
        known = {"u_alpha_share": 0.0, "u_albedo": 0.0, "u_tail": 0.0}
        return {**found, **dict(file.material), **known, "file": str(path), "calibrated": file}

    @model_validator(mode="before")
    @classmethod
    def _unmeasured(cls, table: Any) -> Any:  # noqa: ANN401
        """A lobe that was not measured leaves roughness and albedo in doubt too; a second lobe was measured."""
        if not isinstance(table, dict) or cls.model_fields["u_tail"].default is not None:
            return table
        if table.get("file") is not None or table.get("u_tail") is not None:
            return table
        if table.get("second_lobe") is not None:
            return {**table, "u_tail": 0.0}
        albedo = table.get("albedo")
        doubt = {"u_alpha_share": UNMEASURED_SHARE}
        if isinstance(albedo, int | float) and albedo >= 0.0:
            doubt["u_albedo"] = UNMEASURED_SHARE * albedo
        return {**doubt, **table}

    def material(self) -> Material:
        """The material of the reflectance model."""
        return Material(
            self.alpha_along,
            self.alpha_across,
            self.albedo,
            self.index,
            self.internal_reflection,
            self.tail,
            self.second_lobe,
        )


LARGEST_LN_RATIO = 3.0
"""Largest tolerance of a ln ratio: a factor of 20."""


class DecisionPart(LotDecision):
    """Decision rule for the contrasts.

    ``tolerance`` is the largest deviation |measured − predicted| of a good part, one number for all pairs or
    one a pair; without it a significant deviation at ``alpha`` fails the part. ``deviation`` says what a
    significant deviation within the tolerance does. INCONCLUSIVE parts are measured up to ``remeasure`` times
    more. With ``rig_faults`` a failing part is INVALID or INCONCLUSIVE where a fault of the rig explains it as well.
    """

    rig_faults: bool = True
    contrast: ContrastKind = "log_ratio"
    tolerance: Positive | tuple[Positive, ...] | None = None

    @model_validator(mode="after")
    def _tolerance_is_of_its_contrast(self) -> Self:
        values = self.tolerance if isinstance(self.tolerance, tuple) else (self.tolerance or 0.0,)
        largest = max(values, default=0.0)
        if self.contrast == "log_ratio" and largest > LARGEST_LN_RATIO:
            raise ValueError(
                f"tolerance {largest:g} of a ln ratio is a factor of {math.exp(min(largest, 700.0)):.2g}: a share of "
                f"25 % is 0.25, and more than {LARGEST_LN_RATIO:g} passes everything"
            )
        return self


MOST_DEVIATION = 0.3
"""Ln ratio by which a cell of a plain defect is off, where nothing is known of the texture of the part."""
NO_CELL_DEVIATION = (
    "area.cell_deviation has no effect any more: cells are judged by D² in all poses together, against the scatter of "
    "the part itself; leave it out"
)


class AreaPart(Part):
    """Decision rule for the deviation map (`anisoscope.imaging.deviation_map`): the largest share of deviating cells.

    ``max_length_um`` limits the longest mark, whatever its share of the region; ``max_lean_deg`` the lean of the facets
    over several ridges about a plane (`anisoscope.imaging.part_form`): sink marks and waves. None: not judged.
    ``cell_deviation`` was the ln ratio beyond which a cell deviates; recipes with it are read, and it has no effect.
    """

    cell_deviation: Annotated[
        Positive | Literal["auto"] | None, Field(exclude_if=lambda value: value is None)
    ] = None
    max_share: Annotated[float, Field(gt=0.0, lt=1.0)] = 0.02
    max_length_um: Positive | None = None
    max_lean_deg: Annotated[float | None, Field(gt=0.0, le=45.0)] = None


class RigUncertainty(CommonUncertainty):
    """Standard uncertainties of the rig that a single inspection cannot determine.

    ``tilt_deg`` is of the zero of the tilt; ``reflections_share`` is relative, of the amplitude of the light that
    reflects more than once.
    """

    height_map_share: NotNegative = 0.01
    reflections_share: NotNegative = 0.1
    tilt_deg: NotNegative = 0.0


class ScatterPart(Part):
    """How good parts differ from each other, as standard deviations.

    ``ridge_angle_deg`` is that of the design (``surface.design.u_ridge_angle_deg``) where it is not given, 0.1 without
    one; ``seating_tilt_deg`` that of ``[uncertainty]``. Relative: ``alpha_share`` of both roughnesses, ``albedo_share``
    of the albedo, ``edge_radius_share`` of the radius of the crests, 0.5 µm where that is unmeasured. ``in_prediction``
    = False leaves it to golden parts, as before it counted against the prediction too. ``prior_parts`` is the number of
    golden parts as which it counts against theirs (records of earlier versions: 30); without it golden parts scatter in
    its proportions, and by how much they show themselves.
    """

    ridge_angle_deg: NotNegative | None = None
    alpha_share: Share = SCATTER_ALPHA
    albedo_share: Share = SCATTER_ALBEDO
    edge_radius_share: Share = SCATTER_EDGE
    seating_tilt_deg: NotNegative | None = None
    in_prediction: bool = True
    prior_parts: Annotated[int | None, Field(ge=3, le=1000)] = None


class DefectsPart(Part):
    """Smallest interesting size of the defects for which a part is tested separately.

    ``wear_um`` is the radius to which crests are worn; None tests for none.
    ``power``: probability with which they must be found. Where it is given and the poses and golden parts do not reach
    it, a part that would pass is INCONCLUSIVE.
    """

    ridge_angle_deg: Positive = 0.5
    roughness_share: Annotated[float, Field(gt=0.0, le=2.0)] = 0.2
    height_loss: Annotated[float, Field(gt=0.0, lt=1.0)] = 0.1
    wear_um: Positive | None = 5.0
    power: Annotated[float, Field(gt=0.0, lt=1.0)] | None = None


class SurfaceRecipe(RecipeBase):
    """Recipe of a part with a surface whose contrasts are predicted; each kind of surface adds its own tables."""

    surface: SurfacePart
    material: MaterialPart
    decision: DecisionPart = DecisionPart()
    area: AreaPart | None = None
    uncertainty: RigUncertainty = RigUncertainty()
    scatter: ScatterPart | None = ScatterPart()
    defects: DefectsPart = DefectsPart()
    light: LightPart | None = None

    @property
    def stated_scatter(self) -> ScatterPart:
        """Scatter between good parts; the usual one where golden parts alone are to show it."""
        return self.scatter or ScatterPart()

    @property
    def scattered_ridge_angle_deg(self) -> float:
        """Standard deviation of the ridge angle of good parts."""
        if self.stated_scatter.ridge_angle_deg is not None:
            return self.stated_scatter.ridge_angle_deg
        design = self.surface.design
        return (
            design.u_ridge_angle_deg if design is not None and design.u_ridge_angle_deg > 0.0 else SCATTER_DEG
        )

    @property
    def scattered_seating_deg(self) -> float:
        """Standard deviation of the seating of parts about each axis."""
        given = self.stated_scatter.seating_tilt_deg
        return self.uncertainty.seating_tilt_deg if given is None else given

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        pairs = len(consecutive_pairs(self.poses.poses()))
        tolerance = self.decision.tolerance
        if isinstance(tolerance, tuple) and len(tolerance) != pairs:
            raise ValueError(f"decision.tolerance lists {len(tolerance)} values for {pairs} pairs of angles")
        return self

    def check_named(self, path: Path) -> None:
        """Check that the material can be computed with."""
        try:
            self.material.material()
        except ModelError as error:
            raise RecipeError(f"{path}: material: {error}") from None

    def _check_span(self, pitches: float, words: str) -> None:
        """Check that the region spans the minimum number of pitches both ways."""
        smallest_mm = pitches * self.surface.pitch_um / 1000.0
        if min(self.region.size_mm) < smallest_mm * (1.0 - 1e-9):
            raise ValueError(f"region.size_mm must span {words} ({smallest_mm:g} mm)")

    steps: ClassVar[str] = "pitches"
    described_in: ClassVar[str] = "are [material] and [surface]"

    @property
    def step_mm(self) -> float:
        """Increment of the size of a region: one pitch."""
        return self.surface.pitch_um / 1000.0

    def tolerances(self) -> tuple[float, ...] | None:
        """One tolerance a pair, or None."""
        tolerance = self.decision.tolerance
        if tolerance is None or isinstance(tolerance, tuple):
            return tolerance
        return (tolerance,) * len(consecutive_pairs(self.poses.poses()))

    def against(self, surface: Surface) -> Self:
        """The recipe reduced to one of its surfaces."""
        other = "design" if surface == "height_map" else "height_map"
        alone = self.surface.model_copy(update={other: None, "compare": None})
        return self.model_copy(update={"surface": alone})

    def deciding(self) -> Self:
        """The recipe reduced to the surface that decides."""
        return self.against(self.surface.decides) if self.surface.both else self


def check_material(
    recipe: SurfaceRecipe, rig: RigFile, path: Path, ridge_angle_deg: float | None = None
) -> None:
    """Compare the material file of a recipe with lamp, lens and half angles of its poses.

    Args:
        recipe: with a material file or without.
        rig: the rig.
        path: of the recipe file, for the message.
        ridge_angle_deg: of the facets; None: that of the design, and without one half angles are not compared.

    Raises:
        RecipeError: the material was measured with another lamp or lens, or not at such half angles.
    """
    file = recipe.material.calibrated
    if file is None:
        return
    lamp = recipe.light or LightPart()
    stated = recipe.light is not None
    light = MaterialLightPart(
        wavelength_nm=lamp.wavelength_nm if stated else rig.light.wavelength_nm,
        bandwidth_nm=lamp.bandwidth_nm if stated else rig.light.bandwidth_nm,
        lamp_half_angle_deg=lamp.lamp_half_angle_deg if stated else rig.light.half_angle_deg,
        aperture_half_angle_deg=lamp.aperture_half_angle_deg if stated else rig.camera.half_angle_deg,
    )
    reason = file.other_light(light)
    if ridge_angle_deg is None and recipe.surface.design is not None:
        ridge_angle_deg = recipe.surface.design.ridge_angle_deg
    if reason is None and ridge_angle_deg is not None:
        convention = Convention(rig.light.angle_deg, facet_azimuth_deg=recipe.poses.facet_azimuth_deg)
        reason = file.uncovered(recipe.poses.poses(), convention, (ridge_angle_deg,))
    if reason is not None:
        raise RecipeError(f"{path}: {reason}")


MAX_Z = 3.0
"""Standard uncertainties of the recipe by which the two may differ."""


def check_lamp(recipe: SurfaceRecipe, rig: RigFile, path: Path) -> None:
    """Compare the recipe's lamp and lens with those of the rig file, as far as both state them.

    Args:
        recipe: with ``[light]`` or without.
        rig: the rig.
        path: of the rig file, for the message.

    Raises:
        RigFileError: they differ by more than the recipe's uncertainties explain.
    """
    lamp = recipe.light
    if lamp is None:
        return
    pairs = (
        ("light.wavelength_nm", "nm", rig.light.wavelength_nm, lamp.wavelength_nm, lamp.u_wavelength_nm),
        (
            "light.bandwidth_nm",
            "nm",
            rig.light.bandwidth_nm,
            lamp.bandwidth_nm,
            lamp.u_bandwidth_share * lamp.bandwidth_nm,
        ),
        (
            "light.half_angle_deg",
            "°",
            rig.light.half_angle_deg,
            lamp.lamp_half_angle_deg,
            lamp.u_lamp_share * lamp.lamp_half_angle_deg,
        ),
        (
            "camera.half_angle_deg",
            "°",
            rig.camera.half_angle_deg,
            lamp.aperture_half_angle_deg,
            lamp.u_aperture_share * lamp.aperture_half_angle_deg,
        ),
    )
    for key, unit, has, meant, u in pairs:
        if has is not None and abs(has - meant) > MAX_Z * u + 1e-9 * abs(meant):
            space = "" if unit == "°" else " "
            raise RigFileError(
                f"{path}: {key} is {has:g}{space}{unit}, the recipe predicts for {meant:g} ± {u:g}{space}{unit} "
                "([light]): use the rig that the recipe is made for, or correct the one that is wrong"
            )
