"""``anisoscope recipe check`` of a print: what its recipe can tell."""

from dataclasses import asdict
from pathlib import Path

from anisoscope.base.progress import Advance
from anisoscope.kinds.causes_table import causes_content, causes_table
from anisoscope.kinds.kind import Shown, Table
from anisoscope.kinds.prints.expectation import expect_print
from anisoscope.kinds.prints.lighting import SYNTHETIC, check_print_rig, expectation_of_print
from anisoscope.kinds.prints.recipe import read_print_recipe
from anisoscope.kinds.prints.recipe_check import check_print_recipe
from anisoscope.rig.rigfile import read_rig
from anisoscope.sim.materials.spectra import find_illuminant, find_sensitivities

LAMP = "led-white"


def checked_print(file: Path, rig_path: Path | None, light_angle_deg: float, advance: Advance) -> Shown:
    """Look at the recipe of a print; without a rig file the lamp and the camera are made-up ones."""
    recipe = read_print_recipe(file)
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
    content = asdict(found)
    for row, one in zip(content["quantities"], found.quantities, strict=True):
        row["ratio"] = one.ratio
    causes_content(content["causes"], found.causes)
    first = Table(
        recipe.product,
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
    second = Table(
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
    lines = [
        f"the matrix from the camera's channels to XYZ leaves ΔE {found.matrix_residual:.2f} on a good print"
    ]
    if rig_path is None:
        lines.append("lamp and camera are made-up ones: name a rig file with --rig for its own")
    tables = (first, second, causes_table(found.causes))
    return Shown(content, tables, (*lines, *found.complaints))
