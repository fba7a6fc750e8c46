"""Reflectance of surfaces as files and textures for renderers and instruments."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import PIL.Image

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import UsageError
from anisoscope.base.json_fields import LEFT_OUT, json_field
from anisoscope.base.progress import Advance, silent
from anisoscope.base.regular_file import regular_file
from anisoscope.bsdf.directions_table import interpolated, read_mapped
from anisoscope.bsdf.formats import Exported, FormatName, export, format_of, read_reflectance
from anisoscope.bsdf.mitsuba_scene import Shape, write_classes_scene, write_normals_scene
from anisoscope.bsdf.models import WAVE_NM, of_design, of_heights, of_heights_by_waves, of_ink, of_ridges
from anisoscope.bsdf.reflectance import Reflectance
from anisoscope.bsdf.rgl import Resolution
from anisoscope.bsdf.textures import write_height_textures
from anisoscope.kinds.plates.recipe import PlateRecipe
from anisoscope.kinds.recipes import read_any_recipe
from anisoscope.parameters.keywords import by_keywords
from anisoscope.parameters.material import Material
from anisoscope.parameters.reflecting import Reflecting
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.prediction.height_map_uncertainty import best_band
from anisoscope.prediction.relief_preparation import prepare_relief
from anisoscope.profiles.files.load import read_height_map
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.profiles.plates import plate_map
from anisoscope.sim.design.designfile import DesignFile, read_layout
from anisoscope.sim.design.models import AntiMirrorModel, AnyModel, LobeModel, MixtureModel, model_density
from anisoscope.sim.light.ink.ink import Ink
from anisoscope.sim.light.wave.surface import WaveSurface, on_plateaus
from anisoscope.sim.materials.inks import SYNTHETIC, find_ink

Classes = npt.NDArray[np.integer[Any]]
Surface = RidgeDesign | Ink | DesignFile | HeightMap | Reflectance
DOT_UM = 112.0
"""Side of the dots of a design, which gives its mirror-like share a width."""
MOST_CLASSES = 64
SCENE = "scene.xml"


@by_keywords(how=Reflecting)
def reflectance_of(
    surface: Surface,
    *,
    material: Material | None = None,
    how: Reflecting,
    on_progress: Advance = silent,
) -> Reflectance:
    """Reflectance of a surface as a function of two directions.

    Args:
        surface: ridges (0° is a flat surface), an ink, etched steps, a height map, or a reflectance.
        material: plastic of ridges and height maps; the default one where it is not given.
        how: the computation, or its fields as keywords. A pair of directions takes a tenth of a millisecond with one
            reflection of ridges, 10 ms with "all".
        on_progress: called along the way.

    Raises:
        UsageError: fewer than one reflection.
        HeightMapError, ModelError: the map or the design cannot be used.
    """
    plastic, bounces = material or Material(), how.bounces
    if isinstance(surface, Reflectance):
        return surface
    if isinstance(surface, RidgeDesign):
        if bounces != "all" and bounces < 1:
            raise UsageError(f"--bounces must be 1 or more, or all, not {bounces}")
        angle = surface.ridge_angle_deg
        words = "flat plastic" if angle == 0.0 else f"ridges of {angle:g}°"
        depth = None if bounces == "all" else bounces
        return of_ridges(surface, plastic, depth, words, neglected=True)
    if isinstance(surface, Ink):
        return of_ink(surface)
    if isinstance(surface, DesignFile):
        return design_reflectance(surface)
    if how.optics == "waves":
        heights = WaveSurface.of(surface)
        return of_heights_by_waves(
            on_plateaus(heights, 1e-3 * min(WAVE_NM), how.steps),
            how.lamp_half_angle_deg,
            how.name,
            on_progress=on_progress,
        )
    relief, _ = prepare_relief(surface, how.pitch_um)
    return of_heights(best_band(relief), plastic, how.name)


def reflectance_file(path: Path) -> Reflectance:
    """Reflectance in a file: RGL, MERL, Klems, tensor tree, Zemax, or a table of directions in CSV.

    Raises:
        UsageError: it cannot be used.
    """
    if path.suffix.lower() == ".csv":
        return interpolated(read_mapped(path, {}), path.stem)
    return read_reflectance(path)


def _keys_of(done: Exported) -> dict[str, Any]:
    return {"format": done.format, "bytes": done.size, "rms": done.rms, "losses": done.losses}


@dataclass(frozen=True)
class ExportedBsdf:
    """A written reflectance.

    Attributes:
        file: where.
        name: of the surface.
        written: format, size, deviation when it is read back, and what is lost.
        scene: scene for Mitsuba, where one was written.
    """

    file: Path
    name: str = field(metadata=LEFT_OUT)
    written: Exported = field(metadata=json_field(merged=True, by=_keys_of))
    scene: Path | None


def export_bsdf(
    reflectance: Reflectance,
    target: Path,
    *,
    file_format: FormatName | None = None,
    wavelength_nm: float | None = None,
    resolution: Resolution | None = None,
    scene: tuple[Path, Shape] | None = None,
    coarse: bool = False,
    on_progress: Advance = silent,
) -> ExportedBsdf:
    """Write the reflectance of a surface for renderers, read it back and compare: ``anisoscope bsdf export``.

    Args:
        reflectance: of a surface (`reflectance_of`), or in a file (`reflectance_file`).
        target: file.
        file_format: by the extension .bsdf (RGL), .binary (MERL) or .xml (Klems) where it is left out.
        wavelength_nm: keep one wavelength.
        resolution: of an RGL file.
        scene: of an RGL file: scene (.xml) for Mitsuba, and the shape in it.
        coarse: write ridges as a Klems matrix or a tensor tree, too.
        on_progress: called along the way.

    Raises:
        UsageError: the format cannot hold it, or the file would be huge.
        RecordError: a file cannot be written.
    """
    found = reflectance if wavelength_nm is None else reflectance.at(wavelength_nm)
    name = file_format or format_of(target)
    done = export(found, target, name, resolution, on_progress, scene, coarse=coarse)
    return ExportedBsdf(target, found.name, done, None if scene is None else scene[0])


def design_reflectance(design: DesignFile, dot_um: float = DOT_UM) -> Reflectance:
    """Reflectance of a design of etched steps, in dots of a size."""

    def density(frequency: FloatArray, nm: float, tau: float) -> FloatArray:
        coherence = design.coherence_um * nm / design.wavelength_nm
        return model_density(design.model, frequency, frequency, coherence, dot_um, tau)

    levels = design.depths.levels_um if design.passes_nm else (0.0,)
    return of_design(design.name, density, levels, (dot_um, _widest_um(design.model), design.coherence_um))


def _widest_um(model: AnyModel) -> float:
    """The widest step, or block of steps, whose ripples the spectrum has."""
    if isinstance(model, MixtureModel):
        return max(_widest_um(one) for one in model.models)
    if isinstance(model, LobeModel):
        return max(*model.widths_x_um, *model.widths_y_um)
    if isinstance(model, AntiMirrorModel):
        return max(many * wide for many, wide in zip(model.arrangement, model.widths_um, strict=True))
    return 1.0


@dataclass(frozen=True)
class Textures:
    """Textures of a surface in a folder.

    Attributes:
        folder: where.
        files: written files.
        notes: what they hold, and what is lost.
        classes: kinds of fields or dots; None of a height map.
        lowest_um: height that is black; None where no heights were written.
        highest_um: height that is white.
    """

    folder: Path
    files: tuple[str, ...]
    notes: tuple[str, ...]
    classes: int | None = None
    lowest_um: float | None = None
    highest_um: float | None = None

    def as_json(self) -> dict[str, Any]:
        """The fields that there are."""
        return {name: value for name, value in vars(self).items() if value is not None}

    def with_heights(self, heights: "Textures") -> "Textures":
        """These, and those of the heights."""
        return replace(
            heights,
            files=(*self.files, *heights.files),
            notes=(*self.notes, *heights.notes),
            classes=self.classes,
        )


def bsdf_textures(
    source: Path,
    out: Path,
    *,
    pixel_um: tuple[float, float] | None = None,
    inks: Sequence[Ink] | None = None,
    wavelength_nm: float | None = None,
    resolution: Resolution | None = None,
    light_angle_deg: float = 10.0,
    material: Material | None = None,
    on_progress: Advance = silent,
) -> Textures:
    """Write what varies over a surface as textures, with a scene for Mitsuba: ``anisoscope bsdf textures``.

    Args:
        source: recipe of a plate (.toml), layout of dots (.npz), PNG of a halftone, or height map.
        out: new folder.
        pixel_um: (y, x) pixel size of a plate's heights (2 µm), or of a map that states none.
        inks: of a halftone; the synthetic ones where they are left out.
        wavelength_nm: of dots: keep one wavelength.
        resolution: of the reflectance files.
        light_angle_deg: between light and camera in the scene, 0 to 85.
        material: plastic of a height map.
        on_progress: called along the way.

    Raises:
        UsageError: a folder that holds files, or a source that cannot be used.
        HeightMapError: a map that cannot be read.
    """
    if not 0.0 <= light_angle_deg < 85.0:
        raise UsageError(f"--light-angle takes 0 to 85°, not {light_angle_deg:g}")
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise UsageError(f"{out} holds files: name a new folder")
    made, suffix = _Folder(out, light_angle_deg, wavelength_nm, resolution), source.suffix.lower()
    if suffix == ".toml" or (suffix == ".npz" and _is_layout(source)):
        heights, classes, surfaces = (
            _of_plate(source, 2.0 if pixel_um is None else pixel_um[0])
            if suffix == ".toml"
            else _of_layout(source, wavelength_nm)
        )
        done = _fields(made, classes, surfaces, on_progress)
        return done.with_heights(_heights(made, heights, None))
    if suffix == ".png" and (inks is not None or _is_dots(source)):
        return _fields(made, *_of_halftone(source, inks, wavelength_nm), on_progress)
    return _heights(made, read_height_map(source, pixel_um=pixel_um), material or Material())


@dataclass(frozen=True)
class _Folder:
    """Where textures go, and how they are made."""

    path: Path
    light_angle: float
    wavelength: float | None
    resolution: Resolution | None

    def make(self) -> Path:
        """The folder, once all that goes into it is known."""
        try:
            self.path.mkdir(parents=True, exist_ok=True)
        except OSError as problem:
            raise UsageError(f"cannot make {self.path}: {problem.strerror or problem}") from problem
        return self.path


def _of_plate(path: Path, step_um: float) -> tuple[HeightMap, Classes, list[Reflectance | None]]:
    recipe = read_any_recipe(path)
    if not isinstance(recipe, PlateRecipe):
        raise UsageError(f"{path}: a recipe of plates is expected; other parts are given by their height map")
    plan, design = recipe.plan.plan(), recipe.surface.ridge_design()
    material = recipe.material.material()
    surfaces: list[Reflectance | None] = [of_ridges(RidgeDesign(design.pitch_um, 0.0), material, name="flat")]
    for letter in plan.letters:
        ridges = of_ridges(plan.design_of(letter, design), material, name=f"class {letter}")
        surfaces.append(ridges.turned(plan.azimuths_deg[letter]))
    return plate_map(plan, design, step_um), plan.classes() + 1, surfaces


def _is_layout(path: Path) -> bool:
    try:
        with np.load(path, allow_pickle=False) as file:
            return "tile_class" in file
    except (OSError, ValueError, EOFError):
        return False


def _of_layout(path: Path, wavelength: float | None) -> tuple[HeightMap, Classes, list[Reflectance | None]]:
    layout, designs = read_layout(path)
    if not designs:
        raise UsageError(
            f"{path}: names no designs of its dots: make it again with `anisoscope design pattern`"
        )
    found = [design_reflectance(design, layout.dot_um) for design in designs]
    kept = [one if wavelength is None else one.at(wavelength) for one in found]
    return layout.window(), layout.classes[::-1], list(kept)


def _is_dots(path: Path) -> bool:
    try:
        with regular_file(path) as file, PIL.Image.open(file) as opened:
            return opened.mode == "P"
    except OSError:
        return False


def _of_halftone(
    path: Path, inks: Sequence[Ink] | None, wavelength: float | None
) -> tuple[Classes, list[Reflectance | None]]:
    import numpy as np

    from anisoscope.bsdf.models import of_ink

    try:
        with regular_file(path) as file, PIL.Image.open(file) as opened:
            mode, dots = opened.mode, np.asarray(opened)
    except OSError as problem:
        raise UsageError(f"cannot read {path}: {problem}") from problem
    chosen = [find_ink(name) for name in SYNTHETIC] if inks is None else inks
    if mode != "P" or int(dots.max()) > len(chosen):
        raise UsageError(f"{path}: no picture of dots: take the PNG of `anisoscope ink halftone`, not a film")
    found = [of_ink(ink) for ink in chosen]
    kept = [one if wavelength is None else one.at(wavelength) for one in found]
    return dots.astype(np.int64), [None, *kept]


def _fields(
    made: _Folder, classes: Classes, surfaces: Sequence[Reflectance | None], advance: Advance
) -> Textures:
    """Masks, a reflectance a class, and the scene; only classes that occur."""
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
    return Textures(out, (SCENE, *masks, *files), tuple(notes), int(used.size))


def _heights(made: _Folder, surface: HeightMap, material: Material | None) -> Textures:
    """Heights and normals; with a plastic also the scene of the normal map."""
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
    if material is not None:
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
    return Textures(out, tuple(files), tuple(notes), None, done.lowest_um, done.highest_um)
