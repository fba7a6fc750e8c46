"""The recipe of a print: its ink instead of a surface and a plastic; poses, exposure and region as of ridged parts."""

import os
from dataclasses import replace
from importlib.resources import as_file, files
from pathlib import Path
from typing import Annotated, ClassVar, Self

import tomli_w
from pydantic import AfterValidator, Field, model_validator

from anisoscope.base.atomic_write import write_text
from anisoscope.base.errors import ModelError, RecipeError, UsageError
from anisoscope.base.quantity import Likely
from anisoscope.base.toml_file import NameOrFile, NotNegative, Part, Positive, Share, length
from anisoscope.parameters.new_recipe import NewRecipe
from anisoscope.recipe.base import CommonUncertainty, LotDecision, RecipeBase
from anisoscope.recipe.poses import PosesPart
from anisoscope.sim.light.colour.observer import shares_of_points
from anisoscope.sim.light.ink.ink import UNKNOWN, Ink, InkUncertainty
from anisoscope.sim.materials.inks import SYNTHETIC, InkFileError, find_ink, read_ink

TILTS_DEG = (0.0, 7.0, 14.0, 20.0, -20.0, -14.0, -7.0)
ANGLES_DEG = (0.0, 90.0, 180.0)
SIDES = 2
"""Cells of the map along each side, at least."""


def _known(text: str) -> str:
    if text in SYNTHETIC or text.endswith(".toml"):
        return text
    raise ValueError(f"no ink is named {text!r}; known: {', '.join(SYNTHETIC)}, or a file *.toml")


Dot = Annotated[Positive, length(Likely(1.0, 10000.0, "dots", firm=True))]
Flake = Annotated[Positive, length(Likely(0.5, 1000.0, "flakes", firm=True))]
Cell = Annotated[Positive, length(Likely(0.001, 50.0, "cells", firm=True))]
Shift = Annotated[Positive, length(Likely(0.01, 300.0, "shifts of a spectrum", firm=True))]
InkName = Annotated[NameOrFile, AfterValidator(_known)]


def ink_file(name: str) -> Path:
    """The file of an ink, also of one that comes with the package."""
    if name not in SYNTHETIC:
        return Path(name)
    with as_file(files("anisoscope.sim.materials") / "data" / f"{name}.toml") as path:
        return path


UNSTATED = (
    "the ink file states no uncertainty, so that large ones are taken: fit the ink anew (anisoscope ink fit), or write "
    "[uncertainty] into its file"
)
OF_INK = ("alpha_share", "rho_share", "colour_share", "c", "lobe")


class PrintPart(Part):
    """Ink of the print, and its inks by mistake.

    ``ink`` is an ink file, or an ink that comes with the package; ``coverage`` the share of the area that carries it;
    ``substrate`` the diffuse reflectance of what lies below and between. ``lobe`` says what the distribution of the
    flakes' normals is: 0 that of the ink file, 1 the other one of GGX and Beckmann, between them a geometric mean;
    an inspection of a good print finds it. ``wrong_inks`` are other inks of the house, which the diagnosis looks for.
    ``dot_um`` is the side of a dot of a halftone, ``flake_um`` the diameter of a flake: `recipe check` says how many
    dots, and how many flakes that shine, a cell holds.

    The ``u_…`` are standard uncertainties: relative of roughness, of level (``u_rho_share``, all wavelengths alike) and
    of colour (``u_colour_share``, between the colour channels); absolute of c, of the lobe and of the substrate. Those
    of the ink that are left out are the ink file's.
    """

    ink: InkName
    coverage: Annotated[float, Field(gt=0.0, le=1.0)] = 1.0
    substrate: Share = 0.04
    dot_um: Annotated[Dot | None, Field(exclude_if=lambda value: value is None)] = None
    flake_um: Annotated[Flake | None, Field(exclude_if=lambda value: value is None)] = None
    lobe: Annotated[float, Field(ge=-1.0, le=2.0)] = 0.0
    wrong_inks: Annotated[tuple[InkName, ...], Field(max_length=4)] = ()
    u_alpha_share: Share | None = None
    u_rho_share: Share | None = None
    u_colour_share: Share | None = None
    u_c: NotNegative | None = None
    u_lobe: NotNegative | None = None
    u_substrate: Share = 0.01

    @model_validator(mode="after")
    def _inks_differ(self) -> Self:
        if len({self.ink, *self.wrong_inks}) <= len(self.wrong_inks):
            raise ValueError("wrong_inks names an ink twice, or the print's own: leave it out")
        return self

    def read_ink(self) -> Ink:
        """The ink.

        Raises:
            InkFileError: its file is missing or wrong.
        """
        return read_ink(ink_file(self.ink))

    def of_ink(self, ink: Ink) -> InkUncertainty:
        """Uncertainties of the ink as stated here, else in its file, else large ones."""
        stated = {name: getattr(self, f"u_{name}") for name in OF_INK}
        return replace(
            ink.uncertainty or UNKNOWN, **{name: value for name, value in stated.items() if value is not None}
        )

    def lacks_uncertainty(self, ink: Ink) -> bool:
        """Whether neither the ink file nor the recipe says how well the ink is known."""
        return ink.uncertainty is None and any(getattr(self, f"u_{name}") is None for name in OF_INK)

    def read_wrong_inks(self) -> tuple[Ink, ...]:
        """The inks that may have got into this one; errors as for `read_ink`."""
        return tuple(read_ink(ink_file(name)) for name in self.wrong_inks)


class PrintPoses(PosesPart):
    """Stage angles and tilts; `docs/prints.md` lists the causes that the default ones separate."""

    angles_deg: Annotated[tuple[float, ...], Field(min_length=2)] = ANGLES_DEG
    tilts_deg: Annotated[tuple[float, ...], Field(min_length=1)] = TILTS_DEG

    @model_validator(mode="after")
    def _reaches_across_the_lobe(self) -> Self:
        if self.facet_azimuth_deg != 0.0:
            raise ValueError("facet_azimuth_deg belongs to ridges: leave it out for a print")
        if self.stage_and_tilt_deg is not None:
            raise ValueError(
                "stage_and_tilt_deg belongs to ridges: give angles_deg and tilts_deg for a print"
            )
        if len({abs(tilt) for tilt in self.tilts_deg}) < 3:
            raise ValueError(
                "tilts_deg needs three different tilts or more, such as [0.0, 10.0, 20.0], so that the width of the "
                "lobe is told from its height and its form"
            )
        if not any(abs((b - a) % 180.0 - 90.0) <= 45.0 for a in self.angles_deg for b in self.angles_deg):
            raise ValueError(
                "angles_deg needs two angles 45 to 135 degrees apart, such as [0.0, 90.0, 180.0], so that both "
                "roughnesses show"
            )
        return self


class PrintTolerances(Part):
    """The largest deviations of a good print.

    ``delta_e``: CIEDE2000 of a pose. ``alpha_share``, ``gain_share``: relative, of the roughness along x and along y,
    and of the level. ``ln_ratio``: of the roughness at 0°/90° and at 45°/135°. ``chromaticity``: shift of u'v'.
    ``tilt_deg``: mean tilt of the flakes; ``curl_deg``: by how much it changes across the region. They are starting
    values, to be set by parts.
    """

    delta_e: Positive = 2.0
    alpha_share: Positive = 0.05
    gain_share: Positive = 0.05
    ln_ratio: Positive = 0.05
    chromaticity: Positive = 5e-3
    tilt_deg: Positive = 0.5
    curl_deg: Positive = 0.5


class PrintArea(Part):
    """The map of local colour differences: square cells, each against the whole region.

    A cell deviates where its CIEDE2000 exceeds ``cell_delta_e`` in some pose, and ``scatters`` times what neighbouring
    cells differ by (median over √2): cells of a halftone hold few dots. The print fails where more than ``max_share``
    of the area does. Left out, golden prints teach it.
    """

    cell_mm: Cell = 0.1
    cell_delta_e: Positive = 3.0
    scatters: NotNegative = 5.0
    max_share: Annotated[float, Field(gt=0.0, lt=1.0)] = 0.01


class PrintDefects(Part):
    """Smallest interesting sizes of the defects of a print; None tests for none.

    ``roughness_share``: flakes less flat or flatter, relative, ``brushed_share`` between two directions, ``lean_deg``
    toward any; ``missing_share`` of the ink, ``wrong_ink_share`` of each of ``print.wrong_inks`` in it; ``film_nm``:
    shift of the spectra either way, by a thicker or thinner film.
    """

    roughness_share: Annotated[float, Field(gt=0.0, le=1.0)] | None = 0.1
    brushed_share: Annotated[float, Field(gt=0.0, le=1.0)] | None = 0.05
    lean_deg: Annotated[float, Field(gt=0.0, le=5.0)] | None = 1.0
    missing_share: Annotated[float, Field(gt=0.0, lt=1.0)] | None = 0.1
    wrong_ink_share: Annotated[float, Field(gt=0.0, lt=1.0)] | None = 0.05
    film_nm: Shift | None = 3.0


class PrintUncertainty(CommonUncertainty):
    """Standard uncertainties of the rig that one inspection cannot see.

    ``scale_share``: of the white tile's reflectance. ``channel_share``: of a colour channel against the others, from
    its sensitivity and the spectrum of the lamp. ``model_share``: of every channel of every pose, of ink model and
    sums over wavelengths.
    """

    tilt_deg: NotNegative = 0.03
    tilt_zero_deg: NotNegative = 0.05
    scale_share: NotNegative = 0.005
    channel_share: NotNegative = 0.002
    model_share: NotNegative = 0.003


class PrintRecipe(RecipeBase):
    """The recipe of a print, as read from its TOML file."""

    print: PrintPart
    poses: PrintPoses = PrintPoses()
    tolerances: PrintTolerances = PrintTolerances()
    area: PrintArea | None = PrintArea()
    uncertainty: PrintUncertainty = PrintUncertainty()
    defects: PrintDefects = PrintDefects()
    decision: LotDecision = LotDecision()

    margin_at_markers: ClassVar[bool] = True
    described_in: ClassVar[str] = "is [print]"

    @property
    def step_mm(self) -> float:
        """By what a region grows: a cell of the map."""
        return super().step_mm if self.area is None else self.area.cell_mm

    def check_named(self, path: Path) -> None:
        """Read the inks, which differ in name.

        Raises:
            RecipeError: two of them have one name.
            InkFileError: one of them cannot be read; the message names the key as well.
        """
        inks = [("print.ink", self.print.ink)]
        inks += [(f"print.wrong_inks[{k}]", name) for k, name in enumerate(self.print.wrong_inks)]
        names = [_named(path, key, name) for key, name in inks]
        for name in names:
            if names.count(name) > 1:
                raise RecipeError(
                    f"{path}: print: two of its inks are called {name!r}, which the diagnosis could not tell apart: "
                    "name each ink once, or give the ink files different names"
                )

    @model_validator(mode="after")
    def _cells_fit(self) -> Self:
        if self.area is not None and min(self.region.size_mm) < SIDES * self.area.cell_mm:
            raise ValueError(
                f"region.size_mm must span at least {SIDES} cells of area.cell_mm ({self.area.cell_mm:g} mm) each way"
            )
        return self


def _named(path: Path, key: str, ink: str) -> str:
    """The name of one of a recipe's inks.

    Raises:
        InkFileError: it cannot be read, or has no colour; the message names the recipe and its key as well.
    """
    try:
        found = read_ink(ink_file(ink))
    except InkFileError as problem:
        raise InkFileError(f"{path}: {key}: {problem}") from None
    try:
        shares_of_points(found.nm, found.nm)
    except ModelError as problem:
        raise InkFileError(f"{path}: {key}: {ink}: {problem}") from None
    return found.name


_TEMPLATE = """\
# What a print should look like, how it is photographed, and how it is judged. Angles in degrees.
# `anisoscope recipe check` says what this recipe can tell.
schema = 1
kind = "prints"
product = {product}
version = 1

[print]
ink = {ink}  # an ink file, or an ink that comes with the package
wrong_inks = {wrong}  # other inks of the house, which the diagnosis looks for
coverage = 1.0  # share of the area that carries ink
substrate = 0.04  # diffuse reflectance of what lies below and between
lobe = 0.0  # 0: normals are distributed as the ink file says, 1: the other one of GGX and Beckmann; from a good print
u_substrate = 0.01  # standard uncertainty; those of the ink are in its file

[poses]  # tilts of both signs and angles 0, 90 and 180 tell lobe, tilt and brushing apart
angles_deg = [0.0, 90.0, 180.0]
tilts_deg = [0.0, 7.0, 14.0, 20.0, -20.0, -14.0, -7.0]

[acquisition]
exposure_s = 0.005
brackets = [8.0]  # every pose also with so many times the exposure: the print is dim at 20 degrees
gain = 1.0
frames_per_pose = 4
dark_frames = 8
settle_s = 0.1

[region]  # what is judged, in mm
center_mm = [0.0, 0.0]  # from the rotation axis
size_mm = [{side}, {side}]

[tolerances]  # largest deviations of a good print; starting values, to be set by parts
delta_e = 2.0  # CIEDE2000 of a pose
alpha_share = 0.05  # roughness along x and along y
gain_share = 0.05  # level of the ink
ln_ratio = 0.05  # ratios of roughness, 0/90 and 45/135
chromaticity = 0.005  # shift of u'v'
tilt_deg = 0.5  # mean tilt of the flakes, seat included
curl_deg = 0.5  # how much it changes across the region

[decision]
alpha = 0.01  # level of significance of all channels together
# deviation = "warn"  # a significant deviation within the limits: "warn" or "fail"; left out "fail" with golden prints
remeasure = 1  # how often an INCONCLUSIVE print is photographed again
compare_with_lot = true  # without golden prints: with others of its lot (inspect --lot), from the fourth print on
unexcluded = "inconclusive"  # a print that may have a defect of [defects] does not pass; "note": it passes, with a note

[defects]  # smallest interesting sizes
roughness_share = 0.1  # flakes less flat, or flatter
brushed_share = 0.05  # roughness between two directions
lean_deg = 1.0
missing_share = 0.1  # of the ink
wrong_ink_share = 0.05  # of each of wrong_inks
film_nm = 3.0  # shift of the colour by a thicker or thinner film

[area]
cell_mm = 0.1
cell_delta_e = 3.0  # a cell deviates beyond this CIEDE2000 from the rest of the region
# max_share = 0.01  # share of the area that may deviate; left out it is learnt from golden prints, 0.01 without

[uncertainty]  # standard uncertainties of the rig that one inspection cannot see
light_angle_deg = 0.1
stage_deg = 0.05
tilt_deg = 0.03
tilt_zero_deg = 0.05
seating_tilt_deg = 0.1
flat_share = 0.002
scale_share = 0.005
channel_share = 0.002
linearity_share = 0.001
stray_radiance = 0.0003
model_share = 0.003
"""


def new_print_recipe(
    product: str, ink: str, wrong_inks: tuple[str, ...] = (), largest_mm: float | None = None
) -> str:
    """The text of a recipe with comments.

    Args:
        product: name of the product.
        ink: name or path of the ink, as it shall stand there.
        wrong_inks: of other inks, likewise.
        largest_mm: side of the largest region, as the markers leave it free; None: any.
    """

    def literal(value: object) -> str:
        return tomli_w.dumps({"x": value}, multiline_strings=False).removeprefix("x = ").strip()

    wrong = "[" + ", ".join(literal(name) for name in wrong_inks) + "]"
    side = min(2.0, largest_mm or 2.0)
    return _TEMPLATE.format(product=literal(product), ink=literal(ink), wrong=wrong, side=side)


def write_new_recipe(out: Path, requested: NewRecipe) -> None:
    """Write the recipe of a print, valid as written; the path of an ink file is relative to the recipe.

    Raises:
        UsageError: options of ridges were given as well, no ink was named, or there is no such ink.
    """
    if (requested.ridge_angle_deg, requested.u_ridge_angle_deg, requested.height_map) != (None, None, None):
        raise UsageError(
            "--ink makes the recipe of a print: leave --ridge-angle, --u-ridge-angle and --height-map out"
        )
    ink = requested.ink
    if ink is None:
        raise UsageError("the recipe of a print needs its ink: give --ink")
    find_ink(ink)
    if ink not in SYNTHETIC:
        ink = Path(os.path.relpath(Path(ink).resolve(), out.resolve().parent)).as_posix()
    others = tuple(name for name in SYNTHETIC if name != ink) if ink in SYNTHETIC else ()
    write_text(out, new_print_recipe(requested.product or "print", ink, others, requested.largest_mm))
    try:
        PrintRecipe.read(out)
    except BaseException:
        out.unlink()
        raise
