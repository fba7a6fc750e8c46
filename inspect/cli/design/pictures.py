"""``anisoscope design picture`` and ``design hologram``: surfaces whose angular reflectance is a picture."""

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from anisoscope.base.errors import UsageError
from anisoscope.cli.design.image import check_target, draw_panels, read_image
from anisoscope.cli.design.output import check_seed
from anisoscope.cli.help_page import everyday
from anisoscope.cli.json_output import print_json
from anisoscope.cli.options import Json, parse_numbers
from anisoscope.cli.progress import progress
from anisoscope.cli.tables import print_table

if TYPE_CHECKING:
    from anisoscope.base.arrays import FloatArray
    from anisoscope.sim.design.gradient import Judged, PictureTask
    from anisoscope.sim.design.targets import TargetDesign
    from anisoscope.sim.light.colour.illuminant import Illuminant

POINTS = 121


def picture(
    targets: list[Path],
    /,
    *,
    weights: Annotated[
        str | None, Parameter(help="Weight of every target in their sum, comma-separated; 1 if not given.")
    ] = None,
    reach: Annotated[float, Parameter(help="Largest |h_x| and |h_y| of a target.")] = 0.2,
    wavelength: Annotated[float, Parameter(help="Wavelength, nm.")] = 500.0,
    coherence: Annotated[float, Parameter(help="Coherence length of the source, µm.")] = 16.0,
    etch_passes: Annotated[int, Parameter(help="Passes of a quarter wave and its halves: 1 to 4.")] = 1,
    min_width: Annotated[
        float, Parameter(help="Smallest feature, µm: 2 for optical lithography, less for electron beams.")
    ] = 2.0,
    max_width: Annotated[float, Parameter(help="Widest step, µm.")] = 20.0,
    grid: Annotated[float, Parameter(help="Grid that all edges lie on, µm.")] = 0.25,
    nearest: Annotated[
        bool, Parameter(negative="", help="Take the nearest reflectance if the wanted one is out of reach.")
    ] = False,
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
    import numpy as np

    from anisoscope.sim.design.designfile import DesignFile, write_design
    from anisoscope.sim.design.targets import TargetTask, design_target

    check_target(png, ".png", "--png")
    check_target(out, ".toml", "--out")
    if not 1 <= etch_passes <= 4:
        raise UsageError(f"--etch-passes takes 1 to 4, not {etch_passes}")
    factors = [1.0] * len(targets) if weights is None else list(parse_numbers(weights, "--weights"))
    if len(factors) != len(targets) or min(factors) < 0.0 or max(factors) <= 0.0:
        raise UsageError(f"--weights takes a weight of 0 or more for each of the {len(targets)} targets")
    each = [factor * _target(path, reach) for path, factor in zip(targets, factors, strict=True)]
    wanted = np.sum(each, axis=0)
    task = TargetTask(
        wanted, reach, 2**etch_passes, min_width, max_width, grid, 1e-3 * wavelength, coherence
    )  # fmt: skip
    found = design_target(task)
    if not nearest:
        found.check()
    # levels even over half a wave of height: λ/4, λ/8, … have a zero mean phase
    passes = tuple(sorted(wavelength / 4.0 / 2**number for number in range(etch_passes)))
    figures = {"rel_l2": found.rel_l2, "unreachable": found.unreachable_share, "asymmetric": found.asymmetric}
    design = DesignFile(
        name=targets[0].stem, model=found.model, passes_nm=passes, wavelength_nm=wavelength,
        band_nm=(wavelength, wavelength), coherence_um=coherence, min_width_um=min_width, grid_um=grid,
        figures=figures,
    )  # fmt: skip
    if out is not None:
        write_design(design, out)
    if png is not None:
        _draw(found, png)
    if json_:
        parts = [
            {"share": share, **model.model_dump(mode="json")}
            for share, model in zip(found.shares, found.models, strict=True)
        ]
        print_json({"name": design.name, **figures, "depths_nm": list(passes), "parts": parts})
        return 0
    _print(found)
    return _written(out, png)


def _target(path: Path, reach: float) -> "FloatArray":
    """(121, 121) target of one file, its largest value 1."""
    import cv2
    import numpy as np

    from anisoscope.base.csv_table import read_table
    from anisoscope.sim.design.targets import radial_target

    if path.suffix.lower() == ".csv":
        table = read_table(path, (("h", "density"),), not_negative=("h", "density"))
        found = radial_target(table.column("h"), table.column("density"), POINTS, reach)
    else:
        grey = read_image(path, others=", or a CSV h,density")
        side = min(grey.shape)
        top, left = (grey.shape[0] - side) // 2, (grey.shape[1] - side) // 2
        square = grey[top : top + side, left : left + side].astype(np.float64)
        how = cv2.INTER_AREA if side > POINTS else cv2.INTER_LINEAR
        small = cv2.resize(square, (POINTS, POINTS), interpolation=how)
        found = np.asarray(small[::-1], dtype=np.float64)
    if float(found.max()) <= 0.0:
        raise UsageError(f"{path}: wants no light at |h| up to {reach:g}")
    return np.asarray(found / found.max(), dtype=np.float64)


def _print(found: "TargetDesign") -> None:
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


def _draw(found: "TargetDesign", path: Path) -> None:
    import numpy as np

    reach = found.task.reach
    top = max(float(np.percentile(found.wanted, 99.7)), float(np.percentile(found.achieved, 99.7)))
    panels = (
        (found.wanted, "wanted", "inferno", 0.0),
        (found.achieved, "achieved", "inferno", 0.0),
        (found.unreachable, "wanted − achieved", "PuOr", -top),
    )
    draw_panels([(values, title, colours, low, top) for values, title, colours, low in panels], reach, path)


def _written(*paths: Path | None) -> int:
    sys.stdout.write("".join(f"written: {path}\n" for path in paths if path is not None))
    return 0


@everyday(
    *(
        "out",
        "picture_light",
        "wavelength",
        "passes_nm",
        "min_width",
        "coherence",
        "reach",
        "search_steps",
        "png",
        "json_",
    )
)
def hologram(
    image: Path,
    /,
    *,
    out: Annotated[Path | None, Parameter(help="Write the unit as a layout *.npz.")] = None,
    picture_light: Annotated[
        str | None, Parameter(help="Light of a picture in colour: d65, a, led-b3 … or CSV; else grey.")
    ] = None,
    line_width: Annotated[
        float, Parameter(help="Full width of the three lines at half of their height, nm.")
    ] = 10.0,
    wavelength: Annotated[float, Parameter(help="Wavelength of a grey picture, nm.")] = 550.0,
    passes_nm: Annotated[
        str | None,
        Parameter(help="Depths of 1 to 4 etch passes, nm; else parts of half a wave, in colour 40 to 320."),
    ] = None,
    cells: Annotated[int, Parameter(help="Cells of the unit along each axis, 64 to 1024.")] = 512,
    min_width: Annotated[
        float, Parameter(help="Smallest feature, µm: 2 for optical lithography, less for electron beams.")
    ] = 0.5,
    coherence: Annotated[
        float | None,
        Parameter(
            help="Coherence length of the source, µm; half of the unit's side if not given: 128 is 0.25°."
        ),
    ] = None,
    reach: Annotated[float, Parameter(help="Largest |h_x| and |h_y| of a target.")] = 0.06,
    picture_points: Annotated[int, Parameter(help="Directions of the picture along each axis.")] = 40,
    search_steps: Annotated[int, Parameter(help="Steps of the search by gradients.")] = 400,
    over_etch: Annotated[float, Parameter(help="Error of all depths to judge as well, %.")] = 2.0,
    seed: Annotated[int, Parameter(help="Seed of start and wavelengths.")] = 0,
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
    import numpy as np

    from anisoscope.sim.design.depths import Depths
    from anisoscope.sim.design.designfile import write_layout
    from anisoscope.sim.design.gradient import BAND_NM, PictureTask, design_picture, judged
    from anisoscope.sim.design.layout import Layout
    from anisoscope.sim.proof.separation import decode_srgb

    check_seed(seed)
    check_target(png, ".png", "--png")
    check_target(out, ".npz", "--out")
    if not 64 <= cells <= 1024 or not 16 <= picture_points <= 256:
        raise UsageError("--cells takes 64 to 1024, --picture-points 16 to 256")
    if not -20.0 <= over_etch <= 20.0:
        raise UsageError(f"--over-etch takes −20 to 20 %, not {over_etch:g}")
    lamp = None if picture_light is None else _lamp(picture_light, line_width)
    if passes_nm is not None:
        passes = tuple(sorted(parse_numbers(passes_nm, "--passes-nm")))
    elif lamp is not None:
        passes = (40.0, 80.0, 160.0, 320.0)
    else:
        passes = tuple(wavelength / 32.0 * 2**number for number in range(4))
    if not 1 <= len(passes) <= 4:
        raise UsageError(f"--passes-nm takes 1 to 4 etch passes, not {len(passes)}")
    band = BAND_NM if lamp is not None else (wavelength, wavelength)
    wanted = _wanted(image, picture_points, colour=lamp is not None)
    linear = np.asarray(decode_srgb()[np.rint(255.0 * wanted).astype(np.uint8)], dtype=np.float64)
    coherence = 0.5 * cells * min_width if coherence is None else coherence
    task = PictureTask(
        linear, Depths(passes, band).levels_um, lamp, 1e-3 * wavelength, cells, min_width, coherence, reach
    )
    light = HologramLight.of(task)
    with progress("hologram", quiet=json_) as advance:
        found = design_picture(task, np.random.default_rng(seed), search_steps, advance=advance)
    plain, deep = judged(found), judged(found, 1.0 + 0.01 * over_etch)
    if out is not None:
        layout = Layout(
            found.labels[None], np.zeros(1, dtype=np.int64), np.zeros((1, 1), dtype=np.uint16), passes, min_width,
            (image.stem,), wavelength if lamp is None else 550.0, coherence,
        )  # fmt: skip
        write_layout(layout, out)
    if png is not None:
        shown = [(wanted, "wanted"), (plain.srgb, "achieved"), (deep.srgb, f"depths {over_etch:+g} %")]
        draw_panels(
            [(one[..., 0] if one.shape[2] == 1 else one, title, "gray", 0.0, 1.0) for one, title in shown],
            reach, png,
        )  # fmt: skip
    if json_:
        print_json(
            {
                "depths_nm": list(passes), "unit_um": cells * min_width, "error": found.error, "seed": seed,
                "light": light,
                "history": list(found.history), "achieved": plain, "over_etch_percent": over_etch, "over_etched": deep,
            }
        )  # fmt: skip
        return 0
    _print_judged(plain, deep, over_etch, light)
    return _written(out, png)


@dataclass(frozen=True)
class HologramLight:
    """What a picture assumes of light and eye.

    Attributes:
        spectrum: name of the light, or its wavelength.
        lamp_deg: side of the square lamp, as seen from the unit.
        picture_deg: side of the picture from the middle, as seen from the unit.
        pupil_deg: most that the eye's or camera's pupil may subtend: a direction of the picture.
    """

    spectrum: str
    lamp_deg: float
    picture_deg: float
    pupil_deg: float

    @classmethod
    def of(cls, task: "PictureTask") -> "HologramLight":
        """Of a task, light and eye near the normal."""
        import numpy as np

        design = task.wavelength_um if task.illuminant is None else 0.55
        name = f"{1e3 * design:g} nm" if task.illuminant is None else task.illuminant.name
        reach, step = 2.0 * task.reach, 4.0 * task.reach / (task.wanted.shape[0] - 1)
        return cls(
            name, *(float(np.degrees(one)) for one in (design / task.coherence_um, np.arcsin(reach), step))
        )


def _lamp(text: str, width_nm: float) -> "Illuminant":
    """A light by name, or three lines balanced to the white of sRGB."""
    import numpy as np

    from anisoscope.sim.light.colour.illuminant import Illuminant
    from anisoscope.sim.light.colour.observer import matching_functions
    from anisoscope.sim.light.colour.spaces import SRGB_WHITE
    from anisoscope.sim.materials.spectra import find_illuminant

    if "," not in text:
        return find_illuminant(text)
    middles = parse_numbers(text, "--picture-light", "620,530,450")
    if len(middles) != 3 or not 1.0 <= width_nm <= 40.0 or min(middles) < 410.0 or max(middles) > 690.0:
        raise UsageError("--picture-light takes three lines of 410 to 690 nm, --line-width 1 to 40 nm")
    nm = np.arange(380.0, 731.0)
    lines = np.exp(-4.0 * np.log(2.0) * ((nm - np.array(middles)[:, None]) / width_nm) ** 2)
    fine, matching = matching_functions()
    each = np.stack([np.interp(fine, nm, one) @ matching for one in lines])
    share = np.linalg.solve(each.T, SRGB_WHITE)
    if float(share.min()) <= 0.0:
        raise UsageError(
            f"--picture-light {text}: white is no mixture of these lines: take a red, a green and a blue"
        )
    return Illuminant(
        f"lines of {text} nm, {width_nm:g} nm wide", tuple(nm.tolist()), tuple((share @ lines).tolist())
    )


def _wanted(path: Path, points: int, *, colour: bool) -> "FloatArray":
    """(points, points, 1 or 3) encoded sRGB, rows along rising h_y."""
    import cv2
    import numpy as np

    found = read_image(path, colour=colour)
    how = cv2.INTER_AREA if min(found.shape[:2]) > points else cv2.INTER_LINEAR
    small = cv2.resize(found, (points, points), interpolation=how)[::-1]
    if not small.any():
        raise UsageError(f"{path}: is black: there is no light to design")
    values = small[..., ::-1] if colour else small[..., None]
    return np.asarray(values / 255.0, dtype=np.float64)


def _print_judged(plain: "Judged", deep: "Judged", over_etch: float, light: HologramLight) -> None:
    rows = [
        [name, f"{one.ssim:.3f}", "–" if one.median_de2000 is None else f"{one.median_de2000:.2f}",
         f"{100.0 * one.light_share:.1f}"]
        for name, one in (("as designed", plain), (f"depths {over_etch:+g} %".replace("-", "−"), deep))
    ]  # fmt: skip
    print_table(
        "picture",
        ["etched", "SSIM [1]", "median ΔE2000", "light in the picture [%]"],
        rows,
        caption=f"{light.spectrum}, square lamp of {light.lamp_deg:.2f}°; picture to ±{light.picture_deg:.1f}°, for a "
        f"pupil of {light.pupil_deg:.2f}° at most (or a screen); light and eye near the normal, no shadows",
    )
