"""``anisoscope bsdf textures``: fields of a plate, dots of a design or of a halftone, or heights, for renderers."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from anisoscope.base.errors import UsageError
from anisoscope.cli.bsdf.sources import NodesOption, PlasticOptions, design_reflectance, resolution_of
from anisoscope.cli.ink.options import InksOption
from anisoscope.cli.json_output import print_json
from anisoscope.cli.options import Json
from anisoscope.cli.progress import progress
from anisoscope.cli.tables import console

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    from anisoscope.base.progress import Advance
    from anisoscope.bsdf.reflectance import Reflectance
    from anisoscope.bsdf.rgl import Resolution
    from anisoscope.profiles.heightmap import HeightMap

    Classes = npt.NDArray[np.integer[Any]]

MOST_CLASSES = 64
SCENE = "scene.xml"


def textures(
    source: Path,
    /,
    *,
    out: Annotated[Path, Parameter(help="New folder for textures, reflectances and scene.")],
    pixel: Annotated[
        str | None, Parameter(help="Pixel size in µm: of a plate's heights (2), of a map that states none.")
    ] = None,
    inks: InksOption = None,
    wavelength: Annotated[
        float | None, Parameter(help="Dots: keep one wavelength in nm; spectral files are large.")
    ] = None,
    nodes: NodesOption = None,
    light_angle: Annotated[float, Parameter(help="Scene: angle between light and camera in degrees.")] = 10.0,
    plastic: Annotated[PlasticOptions | None, Parameter(name="*")] = None,
    json_: Json = False,
) -> int:
    """Write heights, normals, masks and reflectances of a surface as textures, with a scene for Mitsuba.

    A plate is given by its recipe *.toml, dots by a layout *.npz of design pattern or by the PNG of ink halftone, all
    else is a height map. Fields and dots become masks and a .bsdf each class; heights become EXR and 16-bit PNG.

    Args:
        source: Recipe of a plate, layout of dots, PNG of a halftone, or height map.

    Examples:
        anisoscope bsdf textures plate/recipe.toml --out textures
        anisoscope bsdf textures dots.png --inks synthetic-red,synthetic-green,synthetic-blue --out textures
        anisoscope bsdf textures part.x3p --out textures
    """
    if not 0.0 <= light_angle < 85.0:
        raise UsageError(f"--light-angle takes 0 to 85°, not {light_angle:g}")
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise UsageError(f"{out} holds files: name a new folder")
    made = _Folder(out, light_angle, wavelength, resolution_of(nodes))
    with progress(str(source), quiet=json_) as advance:
        done = _written(source, made, pixel, inks, plastic or PlasticOptions(), advance)
    if json_:
        print_json({"folder": str(out), **done})
        return 0
    for line in (
        f"{out}: {', '.join(done['files'])}",
        *done["notes"],
        f"mitsuba -m scalar_spectral {out / SCENE}",
    ):
        console().print(line, markup=False, highlight=False, soft_wrap=True)
    return 0


@dataclass(frozen=True)
class _Folder:
    """Where textures go, and how they are made."""

    path: Path
    light_angle: float
    wavelength: float | None
    resolution: "Resolution | None"

    def make(self) -> Path:
        """The folder, once all that goes into it is known."""
        try:
            self.path.mkdir(parents=True, exist_ok=True)
        except OSError as problem:
            raise UsageError(f"cannot make {self.path}: {problem.strerror or problem}") from problem
        return self.path


def _written(
    source: Path,
    made: _Folder,
    pixel: str | None,
    inks: str | None,
    plastic: PlasticOptions,
    advance: "Advance",
) -> dict[str, Any]:
    from anisoscope.cli.profile.profile import parse_pixel

    suffix = source.suffix.lower()
    if suffix == ".toml":
        heights, classes, surfaces = _of_plate(source, pixel)
        done = _fields(made, classes, surfaces, advance)
        return _merged(done, _heights(made, heights, None))
    if suffix == ".npz" and _is_layout(source):
        heights, classes, surfaces = _of_layout(source, made.wavelength)
        done = _fields(made, classes, surfaces, advance)
        return _merged(done, _heights(made, heights, None))
    if suffix == ".png" and (inks is not None or _is_dots(source)):
        return _fields(made, *_of_halftone(source, inks, made.wavelength), advance)
    from anisoscope.profiles.files.load import read_height_map

    surface = read_height_map(source, pixel_um=parse_pixel(pixel))
    return _heights(made, surface, plastic)


def _merged(first: dict[str, Any], second: dict[str, Any]) -> dict[str, Any]:
    return first | second | {key: [*first[key], *second[key]] for key in ("files", "notes")}


def _of_plate(path: Path, pixel: str | None) -> "tuple[HeightMap, Classes, list[Reflectance | None]]":
    from anisoscope.bsdf.models import of_ridges
    from anisoscope.cli.options import parse_numbers
    from anisoscope.kinds.plates.recipe import PlateRecipe
    from anisoscope.kinds.registry import read_any_recipe
    from anisoscope.parameters.ridges import RidgeDesign
    from anisoscope.profiles.plates import plate_map

    recipe = read_any_recipe(path)
    if not isinstance(recipe, PlateRecipe):
        raise UsageError(f"{path}: a recipe of plates is expected; other parts are given by their height map")
    plan, design = recipe.plan.plan(), recipe.surface.ridge_design()
    step = 2.0 if pixel is None else parse_numbers(pixel, "--pixel")[0]
    material = recipe.material.material()
    surfaces: list[Reflectance | None] = [of_ridges(RidgeDesign(design.pitch_um, 0.0), material, name="flat")]
    for letter in plan.letters:
        ridges = of_ridges(plan.design_of(letter, design), material, name=f"class {letter}")
        surfaces.append(ridges.turned(plan.azimuths_deg[letter]))
    return plate_map(plan, design, step), plan.classes() + 1, surfaces


def _is_layout(path: Path) -> bool:
    import numpy as np

    try:
        with np.load(path, allow_pickle=False) as file:
            return "tile_class" in file
    except (OSError, ValueError, EOFError):
        return False


def _of_layout(path: Path, wavelength: float | None) -> "tuple[HeightMap, Classes, list[Reflectance | None]]":
    from anisoscope.sim.design.designfile import read_layout

    layout, designs = read_layout(path)
    if not designs:
        raise UsageError(
            f"{path}: names no designs of its dots: make it again with `anisoscope design pattern`"
        )
    found = [design_reflectance(design, layout.dot_um) for design in designs]
    kept = [one if wavelength is None else one.at(wavelength) for one in found]
    return layout.window(), layout.classes[::-1], list(kept)


def _is_dots(path: Path) -> bool:
    import PIL.Image

    try:
        with PIL.Image.open(path) as opened:
            return opened.mode == "P"
    except OSError:
        return False


def _of_halftone(
    path: Path, inks: str | None, wavelength: float | None
) -> "tuple[Classes, list[Reflectance | None]]":
    import numpy as np
    import PIL.Image

    from anisoscope.bsdf.models import of_ink
    from anisoscope.cli.ink.options import printed_inks

    try:
        with PIL.Image.open(path) as opened:
            mode, dots = opened.mode, np.asarray(opened)
    except OSError as problem:
        raise UsageError(f"cannot read {path}: {problem}") from problem
    chosen = printed_inks(inks)
    if mode != "P" or int(dots.max()) > len(chosen):
        raise UsageError(f"{path}: no picture of dots: take the PNG of `anisoscope ink halftone`, not a film")
    found = [of_ink(ink) for ink in chosen]
    kept = [one if wavelength is None else one.at(wavelength) for one in found]
    return dots.astype(np.int64), [None, *kept]


def _fields(
    made: _Folder, classes: "Classes", surfaces: "Sequence[Reflectance | None]", advance: "Advance"
) -> dict[str, Any]:
    """Masks, a reflectance a class, and the scene; only classes that occur."""
    import numpy as np

    from anisoscope.bsdf.formats import export
    from anisoscope.bsdf.mitsuba_scene import write_classes_scene

    out = made.make()
    used, number = np.unique(classes, return_inverse=True)
    if used.size > MOST_CLASSES:
        raise UsageError(f"{used.size} classes, each with a file of its own, are more than {MOST_CLASSES}")
    files: list[str] = []
    names: list[str | None] = []
    notes = []
    for at in used.tolist():
        surface = surfaces[at]
        names.append(None if surface is None else f"class-{at}.bsdf")
        if surface is not None:
            done = export(surface, out / f"class-{at}.bsdf", "rgl", made.resolution, advance)
            notes.append(f"class-{at}.bsdf: {surface.name}, {done.rms:.2%} rms off when read back")
            notes += [f"lost: {loss}" for loss in done.losses if f"lost: {loss}" not in notes]
            files.append(f"class-{at}.bsdf")
    masks = write_classes_scene(out / SCENE, number.reshape(classes.shape), names, made.light_angle)
    return {"files": [SCENE, *masks, *files], "classes": int(used.size), "notes": notes}


def _heights(made: _Folder, surface: "HeightMap", plastic: PlasticOptions | None) -> dict[str, Any]:
    """Heights and normals; with a plastic also the scene of the normal map."""
    import numpy as np

    from anisoscope.bsdf.mitsuba_scene import write_normals_scene
    from anisoscope.bsdf.textures import write_height_textures

    out = made.make()
    done = write_height_textures(surface, out)
    text = (
        f"height.png: black is {done.lowest_um:.6g} µm, white {done.highest_um:.6g} µm, a level {done.step_nm:.3g} nm; "
        f"normals.png: to {done.normal_step_deg:.1g}°"
    )
    notes = [text]
    if done.without_exr:
        notes.append("no EXR files: OpenEXR is not installed: pip install 'anisoscope[exr]'")
    files = [*done.files]
    if plastic is not None:
        material = plastic.plastic()
        alpha = float((material.alpha_along * material.alpha_across) ** 0.5)
        if material.alpha_along != material.alpha_across:
            notes.append(
                f"lost: Mitsuba's rough plastic has one roughness: {material.alpha_along:g} and "
                f"{material.alpha_across:g} become {alpha:.3g}"
            )
        slope = float(
            np.median(np.hypot(*np.gradient(surface.height_um, surface.pixel_y_um, surface.pixel_x_um)))
        )
        notes.append(
            f"lost: a normal map casts no shadows, and shows facets as seen from above: at 30° facets of "
            f"{np.degrees(np.arctan(slope)):.1f}°, the median, are off by up to {slope * np.tan(np.radians(30.0)):.0%}"
        )
        rows, cols = surface.shape
        lobe = {"alpha": alpha, "albedo": material.albedo, "index": material.index}
        write_normals_scene(out / SCENE, "normals.png", (rows - 1, cols - 1), lobe, made.light_angle)
        files.append(SCENE)
    keys = {"lowest_um": done.lowest_um, "highest_um": done.highest_um}
    return {"files": files, "notes": notes, **keys}
