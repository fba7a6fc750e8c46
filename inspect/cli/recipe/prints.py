"""``anisoscope recipe check`` of a print: what its recipe can tell."""

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from anisoscope.cli.json_output import print_json
from anisoscope.cli.progress import progress
from anisoscope.cli.recipe.causes import print_causes
from anisoscope.cli.tables import console, print_table

if TYPE_CHECKING:
    from anisoscope.kinds.prints.recipe_check import PrintRecipeCheck

LAMP = "led-white"


def check_print(file: Path, rig_path: Path | None, light_angle_deg: float, *, json_: bool) -> int:
    """Look at the recipe of a print; without a rig file the lamp and the camera are made-up ones."""
    from anisoscope.kinds.prints.expectation import expect_print
    from anisoscope.kinds.prints.lighting import SYNTHETIC, check_print_rig, expectation_of_print
    from anisoscope.kinds.prints.recipe import read_print_recipe
    from anisoscope.kinds.prints.recipe_check import check_print_recipe
    from anisoscope.rig.rigfile import read_rig
    from anisoscope.sim.materials.spectra import find_illuminant, find_sensitivities

    recipe = read_print_recipe(file)
    with progress(file.name, quiet=json_) as advance:
        advance("prediction", 0, 1)
        if rig_path is not None:
            rig = read_rig(rig_path)
            check_print_rig(rig, rig_path)
            expected = expectation_of_print(recipe, rig)
        else:
            lamp, camera = find_illuminant(LAMP), find_sensitivities(SYNTHETIC, "rggb")
            expected = expect_print(recipe, light_angle_deg, lamp, camera)
        advance("causes", 0, 1)
        found = check_print_recipe(recipe, expected)
    if json_:
        content = asdict(found)
        for row, one in zip(content["quantities"], found.quantities, strict=True):
            row["ratio"] = one.ratio
        for row, cause in zip(content["causes"], found.causes, strict=True):
            row |= {"told_apart_from": cause.told_apart_from, "never_told_from": list(cause.never_told_from)}
        print_json(content)
        return 0
    _print(found, recipe.product, made_up=rig_path is None)
    return 0


def _print(found: "PrintRecipeCheck", product: str, *, made_up: bool) -> None:
    print_table(
        product,
        ["stage [°]", "tilt [°]", "red [1/sr]", "green [1/sr]", "blue [1/sr]", "by the brightest"],
        [
            [
                f"{pose.stage_deg:g}",
                f"{pose.tilt_deg:g}",
                *(f"{value:.4f}" for value in pose.channels),
                f"{pose.brightness:.1%}",
            ]
            for pose in found.poses
        ],
    )
    print_table(
        "what is judged",
        ["quantity", "limit", "u", "T/U"],
        [
            [
                one.title,
                f"{one.limit:g} {one.unit}".strip(),
                f"{one.u:.2g}",
                "–" if one.ratio is None else f"{one.ratio:.1f}",
            ]
            for one in found.quantities
        ],
    )
    print_causes(found.causes)
    lines = [
        f"the matrix from the camera's channels to XYZ leaves ΔE {found.matrix_residual:.2f} on a good print"
    ]
    if made_up:
        lines.append("lamp and camera are made-up ones: name a rig file with --rig for its own")
    for line in (*lines, *found.complaints):
        console().print(line, markup=False, highlight=False, soft_wrap=True)
