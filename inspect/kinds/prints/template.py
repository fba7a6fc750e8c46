"""The text of a new recipe of a print."""

import os
from pathlib import Path

import tomli_w

from anisoscope.base.atomic_write import write_text
from anisoscope.base.errors import UsageError
from anisoscope.kinds.kind import NewRecipe
from anisoscope.kinds.prints.recipe import read_print_recipe
from anisoscope.sim.materials.inks import SYNTHETIC, find_ink

_TEMPLATE = """\
# What a print should look like, how it is photographed, and how it is judged. Angles in degrees.
# `anisoscope recipe check` says what this recipe can tell.
schema = 1
product = {product}
version = 1

[print]
ink = {ink}  # an ink file, or an ink that comes with the package
wrong_inks = {wrong}  # other inks of the house, which the diagnosis looks for
coverage = 1.0  # share of the area that carries ink
substrate = 0.04  # diffuse reflectance of what lies below and between
lobe = 0.0  # 0: normals are distributed as the ink file says, 1: the other one of GGX and Beckmann; from a good print
u_alpha_share = 0.01  # standard uncertainties: relative of the roughness,
u_rho_share = 0.01  # of the level,
u_colour_share = 0.003  # and between the colours;
u_c = 0.1  # absolute of the others
u_lobe = 0.05
u_substrate = 0.01

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
size_mm = [2.0, 2.0]

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
deviation = "warn"  # "fail": a significant deviation within the limits fails the print
remeasure = 1  # how often an INCONCLUSIVE print is photographed again

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


def new_print_recipe(product: str, ink: str, wrong_inks: tuple[str, ...] = ()) -> str:
    """The text of a recipe with comments.

    Args:
        product: name of the product.
        ink: name or path of the ink, as it shall stand there.
        wrong_inks: of other inks, likewise.
    """

    def literal(value: object) -> str:
        return tomli_w.dumps({"x": value}, multiline_strings=False).removeprefix("x = ").strip()

    wrong = "[" + ", ".join(literal(name) for name in wrong_inks) + "]"
    return _TEMPLATE.format(product=literal(product), ink=literal(ink), wrong=wrong)


def write_new_recipe(out: Path, asked: NewRecipe) -> None:
    """Write the recipe of a print, valid as written; a file of an ink is named as seen from the recipe.

    Raises:
        UsageError: ridges were asked for as well, or there is no such ink.
    """
    if (asked.ridge_angle_deg, asked.u_ridge_angle_deg, asked.height_map) != (None, None, None):
        raise UsageError(
            "--ink makes the recipe of a print: leave --ridge-angle, --u-ridge-angle and --height-map out"
        )
    assert asked.ink is not None
    ink = asked.ink
    find_ink(ink)
    if ink not in SYNTHETIC:
        ink = Path(os.path.relpath(Path(ink).resolve(), out.resolve().parent)).as_posix()
    others = tuple(name for name in SYNTHETIC if name != ink) if ink in SYNTHETIC else ()
    write_text(out, new_print_recipe(asked.product or "print", ink, others))
    try:
        read_print_recipe(out)
    except BaseException:
        out.unlink()
        raise
