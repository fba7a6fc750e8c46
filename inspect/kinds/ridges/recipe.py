"""The recipe of a part with ridges, and a new one to begin with."""

import math
import os
from pathlib import Path
from typing import Annotated, Self

from pydantic import Field, model_validator

from anisoscope.base.atomic_write import write_text
from anisoscope.base.errors import UsageError
from anisoscope.base.toml_edits import toml_literal
from anisoscope.base.toml_file import Positive
from anisoscope.parameters.new_recipe import NewRecipe
from anisoscope.recipe.surface import AreaPart, SurfaceRecipe


class RidgeAreaPart(AreaPart):
    """Decision rule for the deviation map of ridges; marks and form are judged by default."""

    max_length_um: Positive | None = 200.0
    max_lean_deg: Annotated[float | None, Field(gt=0.0, le=45.0)] = 0.5


class RidgeRecipe(SurfaceRecipe):
    """The recipe of a plastic part with ridges, as read from its file; cells of its contrast map are judged as well."""

    area: RidgeAreaPart | None = RidgeAreaPart()

    @model_validator(mode="after")
    def _spans_pitches(self) -> Self:
        self._check_span(2.0, "at least two pitches")
        return self


PRODUCT = "ridged part"
RIDGE_ANGLE_DEG = 10.0
_TEMPLATE = """\
# What a part should look like, how it is photographed, and how it is judged. Angles in degrees.
# `anisoscope recipe check` says what this recipe can tell; `anisoscope recipe teach` sets exposure, region, tolerances.
schema = 1
kind = "ridges"
product = {product}
version = 1

[surface]
pitch_um = {pitch}  # of the ridges
{surface}
[material]  # of the plastic; `anisoscope fit` finds it from measured contrasts
# The lobe of this plastic is unmeasured: without u_tail every tail of it from 0 (Beckmann) to 1 (GGX) is
# possible, so that small defects are not excluded; golden parts make up for much of it.
# `anisoscope calibrate material` measures the lobe: in place of this table, name its file above the first table,
# material = "abs.toml".
alpha_along = 0.06  # roughness of the facets along the ridges
alpha_across = 0.10  # and across them
albedo = 0.2  # share of the light that the plastic below the surface sends back
index = 1.5  # refractive index
u_alpha_share = 0.1  # standard uncertainties: relative of the roughness,
u_albedo = 0.02  # absolute of the others
u_index = 0.01

[poses]
angles_deg = [0.0, 90.0, 180.0]  # in the order in which they are photographed
tilts_deg = [0.0]  # several need a tilt axis; they tell more causes apart
facet_azimuth_deg = 0.0  # direction toward which the facets face at stage angle 0

[acquisition]
exposure_s = 0.005
# brackets = [4.0]  # every pose also with so many times the exposure: for dark poses beside bright ones
gain = 1.0
frames_per_pose = 4
dark_frames = 8
settle_s = 0.1

[region]  # what is judged, in mm: across the ridges, along them
center_mm = [0.0, 0.0]  # from the rotation axis
size_mm = [{side}, {side}]

[decision]
contrast = "log_ratio"
# tolerance = 0.25  # largest deviation of a good part, one number or one a pair; without it any significant one fails
alpha = 0.01  # level of significance
deviation = "warn"  # "fail": a significant deviation within the tolerance fails the part
unexcluded = "inconclusive"  # a part that may have a defect of [defects] does not pass; "note": it passes, with a note
compare_with_lot = true  # without golden parts: with the other parts of its lot (inspect --lot), from the third one on
remeasure = 1  # how often an INCONCLUSIVE part is photographed again

[defects]  # smallest interesting sizes: `anisoscope recipe check` says which ones these poses exclude
ridge_angle_deg = 1.0  # either way
roughness_share = 0.5  # along the ridges, and across them
height_loss = 0.1  # share of the height
wear_um = 10.0  # radius of worn edges

[area]
max_share = 0.02  # share of the area that may deviate from the other ridges of the part
max_length_um = 200.0  # longest mark
max_lean_deg = 0.5  # lean of the facets over 0.3 mm about that of the part: sink marks, waves

[uncertainty]  # standard uncertainties of the rig that one inspection cannot see
light_angle_deg = 0.1
stage_deg = 0.05
seating_tilt_deg = 0.1
flat_share = 0.002
scale_share = 0.02
linearity_share = 0.001
stray_radiance = 0.0003
"""


def new_recipe(
    product: str,
    pitch_um: float,
    *,
    ridge_angle_deg: float | None,
    height_map: str | None,
    u_ridge_angle_deg: float | None = None,
    largest_mm: float | None = None,
) -> str:
    """Text of a new recipe with comments; of two surfaces the height map decides, unless a spread is given.

    Args:
        product: name of the product.
        pitch_um: pitch of the ridges.
        ridge_angle_deg: of the ideal design, or None.
        height_map: path of a height map as written into the recipe, or None.
        u_ridge_angle_deg: spread of the ridge angle of good parts; with a height map None, unless the design is to
            decide.
        largest_mm: side of the largest region, as the markers leave it free; None: any.
    """
    lines = []
    if height_map is not None:
        lines.append(f"height_map = {toml_literal(height_map)}  # measured on a good part, or on the tool")
        lines.append('role = "part"  # or "tool": the map is turned over')
    if ridge_angle_deg is not None:
        angle = f'ridge_angle_deg = {toml_literal(float(ridge_angle_deg))}, wall = "perpendicular"'
        decides = "height_map" if u_ridge_angle_deg is None else "design"
        if height_map is None or decides == "design":
            spread = f"u_ridge_angle_deg = {toml_literal(float(u_ridge_angle_deg or 0.0))}"
            lines.append(f"design = {{ {angle}, {spread} }}  # u_...: how much good parts spread")
        else:
            lines.append(f"design = {{ {angle} }}")
        if height_map is not None:
            lines.append(
                f'compare = "{decides}"  # which of the two decides; the other one is compared with as well'
            )
    side = min(max(1.0, round(20.0 * pitch_um / 1000.0, 3)), largest_mm or math.inf)
    return _TEMPLATE.format(
        product=toml_literal(product),
        pitch=toml_literal(float(pitch_um)),
        surface="".join(f"{line}\n" for line in lines),
        side=toml_literal(side),
    )


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
        largest_mm=requested.largest_mm,
    )
    write_text(out, text)
    try:
        RidgeRecipe.read(out)
    except BaseException:
        out.unlink()
        raise
