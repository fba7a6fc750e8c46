"""``anisoscope design picture``, ``hologram`` and ``compare-lobe``: angular reflectance that is a picture."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Group, Parameter

from anisoscope.cli.help_page import MORE
from anisoscope.cli.json_output import print_json
from anisoscope.cli.options import Json
from anisoscope.cli.progress import progress
from anisoscope.cli.tables import print_table
from anisoscope.parameters.etching import LobePhoto, StepMixture, check_seed
from anisoscope.parameters.fabrication import Fabrication, HologramSearch, WantedPicture
from anisoscope.views.options import Given, Options, parse_numbers, with_options

if TYPE_CHECKING:
    from anisoscope.operations.design.pictures import Hologram
    from anisoscope.sim.design.appearance import LobeComparison
    from anisoscope.sim.design.targets import TargetDesign

STEPS = Group("Light and fabrication")
OF_TARGET = Options(
    Fabrication,
    STEPS,
    without=dict.fromkeys(("depths_nm", "band_nm"), "a quarter wave and its halves: --etch-passes"),
)
OF_HOLOGRAM = Options(
    Fabrication,
    STEPS,
    help={
        "wavelength_nm": "Wavelength of a grey picture, nm.",
    },
    default=Fabrication(550.0, min_width_um=0.5, grid_um=0.001),
    without={
        "depths_nm": "--passes-nm",
        "band_nm": "that of the picture's light",
        "grid_um": "cells are the grid",
        "coherence_um": "its default is that of the unit",
    },
)
OF_SEARCH = Options(
    HologramSearch,
    Group("Unit and search"),
    flags=True,
    names={"over_etch_percent": "--over-etch"},
    help={"reach": "Largest |h_x| and |h_y| of a target."},
)


@with_options(options=Options(StepMixture, whole=True, flags=True), fabrication=OF_TARGET)
def picture(
    targets: list[Path],
    /,
    *,
    options: Given[StepMixture],
    fabrication: Given[Fabrication],
    out: Annotated[Path | None, Parameter(help="Write the design *.toml.")] = None,
    png: Annotated[Path | None, Parameter(help="Picture of wanted, achieved and unreachable light.")] = None,
    json_: Json = False,
) -> int:
    """Find the mixture of step structures whose reflectance comes closest to any picture or radial profile.

    A target of which more than half of the light is out of reach is refused.

    Args:
        targets: Grey pictures over h (value = light), or CSV h,density of radial profiles; several add up.

    Examples:
        anisoscope design picture ring.csv --out ring.toml --png ring.png
        anisoscope design picture box.png ring.csv --weights 1,0.5 --nearest --png sum.png
    """
    from anisoscope.operations.design.pictures import check_target, draw_target, etched_picture, read_target
    from anisoscope.sim.design.designfile import write_design

    check_target(png, ".png", "--png")
    check_target(out, ".toml", "--out")
    mixture = options.made()
    found = etched_picture(
        [read_target(path, mixture.reach) for path in targets],
        mixture=mixture,
        fabrication=fabrication.over(Fabrication()),
        name=targets[0].stem,
    )
    if out is not None:
        write_design(found.design, out)
    if png is not None:
        draw_target(found.found, png)
    if json_:
        return print_json(found)
    _print_target(found.found)
    return _written(out, png)


def _print_target(found: "TargetDesign") -> None:
    print_table(
        "closest reflectance",
        ["quantity", "value", "unit"],
        [
            ["missed, relative L2", f"{found.rel_l2:.4f}", "1"],
            ["wanted light that is out of reach", f"{100.0 * found.unreachable_share:.1f}", "%"],
            ["of the target not mirror-symmetric, L2", f"{100.0 * found.asymmetric:.1f}", "%"],
        ],
    )
    rows = []
    for share, model in zip(found.shares, found.models, strict=True):
        if model.kind == "lobe":
            what = f"rectangles {model.widths_x_um[0]:g} × {model.widths_y_um[0]:g} µm"
        elif model.kind == "antimirror":
            many, wide = model.arrangement, model.widths_um
            what = f"anti-mirror {many[0]} × {many[1]} of {wide[0]:g} × {wide[1]:g} µm"
        else:
            what = "mirror"
        rows.append([f"{100.0 * share:.1f}", what])
    print_table("shares of the area", ["%", "dots of"], rows)


def _written(*paths: Path | None) -> int:
    sys.stdout.write("".join(f"written: {path}\n" for path in paths if path is not None))
    return 0


@with_options(
    seen=Options(WantedPicture, groups=dict.fromkeys(("line_width_nm", "picture_points"), MORE), whole=True),
    fabrication=OF_HOLOGRAM,
    search=OF_SEARCH,
)
def hologram(
    image: Path,
    /,
    *,
    out: Annotated[Path | None, Parameter(help="Write the unit as a layout *.npz.")] = None,
    seen: Given[WantedPicture],
    fabrication: Given[Fabrication],
    passes_nm: Annotated[
        str | None,
        Parameter(help="Depths of 1 to 8 etch passes, nm; else parts of half a wave, in colour 40 to 320."),
    ] = None,
    search: Given[HologramSearch],
    png: Annotated[Path | None, Parameter(help="Picture of wanted, achieved and over-etched light.")] = None,
    json_: Json = False,
) -> int:
    """Find a periodic unit of etched cells whose angular reflectance is a picture, grey or in colour.

    Random steps are refined by gradients. The unit is judged by another computation, at 61 wavelengths in colour:
    SSIM and ΔE2000, also with all depths etched too deep.

    Args:
        image: Picture; it is scaled to a square.

    Examples:
        anisoscope design hologram picture.png --out unit.npz --png unit.png
        anisoscope design hologram picture.png --picture-light d65 --out unit.npz --png unit.png
    """
    from anisoscope.operations.design.pictures import (
        HOLOGRAM,
        check_target,
        draw_hologram,
        etched_hologram,
        picture_lamp,
        read_wanted,
    )
    from anisoscope.sim.design.designfile import write_layout

    sought = search.over(HologramSearch())
    check_seed(sought.seed)
    check_target(png, ".png", "--png")
    check_target(out, ".npz", "--out")
    asked = seen.made()
    lamp = None if asked.picture_light is None else picture_lamp(asked.picture_light, asked.line_width_nm)
    with progress("hologram", quiet=json_) as advance:
        found = etched_hologram(
            read_wanted(image, asked.picture_points, colour=lamp is not None),
            lamp=lamp,
            passes_nm=None if passes_nm is None else parse_numbers(passes_nm, "--passes-nm"),
            fabrication=fabrication.over(HOLOGRAM),
            search=sought,
            name=image.stem,
            on_progress=advance,
        )
    if out is not None:
        write_layout(found.layout, out)
    if png is not None:
        draw_hologram(found, sought.reach, png)
    if json_:
        return print_json(found)
    _print_judged(found)
    return _written(out, png)


def _print_judged(found: "Hologram") -> None:
    light, plain, deep = found.light, found.achieved, found.over_etched
    rows = [
        [name, f"{one.ssim:.3f}", "–" if one.median_de2000 is None else f"{one.median_de2000:.2f}",
         f"{100.0 * one.light_share:.1f}"]
        for name, one in (("as designed", plain), (f"depths {found.over_etch_percent:+g} %".replace("-", "−"), deep))
    ]  # fmt: skip
    print_table(
        "picture",
        ["etched", "SSIM [1]", "median ΔE2000", "light in the picture [%]"],
        rows,
        caption=f"{light.spectrum}, square lamp of {light.lamp_deg:.2f}°; picture to ±{light.picture_deg:.1f}°, for a "
        f"pupil of {light.pupil_deg:.2f}° at most (or a screen); light and eye near the normal, no shadows",
    )


OF_PHOTO = Options(
    LobePhoto,
    names={"pixel_mm": "--pixel-mm"},
    groups=dict.fromkeys(("center", "from_behind", "tone", "lamp_half_angle_deg", "points"), MORE),
    whole=True,
    flags=True,
)


@with_options(taken=OF_PHOTO)
def compare_lobe(
    photo: Path,
    /,
    *,
    design: Annotated[Path, Parameter(help="Design *.toml or layout *.npz that the sample was made of.")],
    taken: Given[LobePhoto],
    png: Annotated[Path | None, Parameter(help="Picture of photograph, design and their difference.")] = None,
    json_: Json = False,
) -> int:
    """Read a lobe back from a photograph of the screen it falls on, and compare it with the design.

    Lamp, sample and screen are known; four marks on the screen, or the scale of the picture, fix the camera.
    Prints SSIM, correlation and the light of sixteen areas. Clipped pixels count for nothing.

    Args:
        photo: Grey or colour photograph, 8 or 16 bits.

    Examples:
        anisoscope design compare-lobe lobe.png --design unit.npz --wavelength 532 --distance 500 --pixel-mm 0.5
    """
    from anisoscope.operations.design import pictures

    pictures.check_target(png, ".png", "--png")
    seen = taken.made()
    found = pictures.compare_lobe(photo, design, seen)
    if png is not None:
        pictures.draw_comparison(found, seen.reach, png)
    if json_:
        return print_json(found)
    _print_compared(found, png)
    return 0


def _print_compared(found: "LobeComparison", png: Path | None) -> None:
    h_x, h_y = found.shift_h
    print_table(
        "photographed lobe against its design",
        ["quantity", "value", "unit"],
        [
            ["SSIM", f"{found.ssim:.3f}", "1"],
            ["correlation", f"{found.correlation:.4f}", "1"],
            ["difference, relative L2", f"{found.rel_l2:.3f}", "1"],
            ["displaced along h_x, h_y", f"{h_x:+.4f}, {h_y:+.4f}".replace("-", "−"), "1"],
            ["directions that the camera clipped", f"{100.0 * found.clipped:.1f}", "%"],
        ],
    )
    many = len(found.areas)
    print_table(
        "light of each area over that of the design (share of the designed light), top: largest h_y",
        [f"column {number + 1}" for number in range(many)],
        [
            [
                f"{ratio:.2f} ({100.0 * share:.1f} %)" if share > 1e-4 else "–"
                for ratio, share in zip(ratios, shares, strict=True)
            ]
            for ratios, shares in zip(found.areas[::-1], found.designed_areas[::-1], strict=True)
        ],
        caption="" if png is None else f"written: {png}",
    )
