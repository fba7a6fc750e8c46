"""``anisoscope render``: pictures of ridged plates and of height maps under the rig's light."""

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
import numpy.typing as npt
from cyclopts import App, Group, Parameter

from anisoscope.base.arrays import FloatArray
from anisoscope.base.atomic_write import write_bytes
from anisoscope.base.errors import RecordError, UsageError
from anisoscope.cli.help_page import MORE, everyday
from anisoscope.cli.json_output import fields_of, print_json
from anisoscope.cli.options import (
    LIGHT,
    OF_LIGHT,
    OF_PLASTIC,
    OF_RIDGES,
    RIDGES,
    Json,
    RecipeOption,
)
from anisoscope.cli.progress import progress
from anisoscope.parameters.geometry import Convention
from anisoscope.parameters.material import Material
from anisoscope.parameters.microscope import Microscope
from anisoscope.parameters.rendering import MapSample, MapView, PlateFields, PlateView
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.views.options import Given, Options, parse_numbers, with_options

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

    from anisoscope.operations.render import Frames, PlatePictures
    from anisoscope.operations.stated import Stated
    from anisoscope.profiles.heightmap import HeightMap
    from anisoscope.report.renderings import Heights, Rgb

OF_SURFACE = Options(
    RidgeDesign,
    RIDGES,
    help={
        "pitch_um": "Pitch in µm, of ideal ridges (100) or of the map.",
        "ridge_angle_deg": "Ridge angle in degrees, 0 to 45: ideal ridges in place of a height map.",
    },
)
OF_MICROSCOPE = Options(Microscope, Group("Microscope", sort_key=22))
MAX_PANELS = 8
RAW_SUFFIXES = (".npy", ".tif", ".tiff")
USUAL_PITCH_UM = 100.0
FIELD_COLUMNS = ["stage [°]", "first [1/sr]", "second [1/sr]", "difference [1/sr]", "Michelson", "ln ratio"]


@Parameter(name="*")
@dataclass(frozen=True)
@everyday("out", "json_")
class PictureOptions:
    """The files, and how radiance is shown."""

    out: Annotated[Path, Parameter(help="PNG file to write.")]
    raw: Annotated[
        Path | None, Parameter(help="Also write the radiances [1/sr], float32: npy, tif or tiff.")
    ] = None
    white: Annotated[
        float | None, Parameter(help="Radiance [1/sr] shown as full brightness; default: from the pictures.")
    ] = None
    transfer: Annotated[Literal["srgb", "linear"], Parameter(help="Coding of brightness in the PNG.")] = (
        "srgb"
    )
    panel: Annotated[int, Parameter(help="Longest side of a panel in pixels, 64 to 2000.")] = 420
    json_: Json = False

    def check(self, source: Path | None) -> None:
        """Refuse impossible outputs before the work.

        Raises:
            UsageError: an extension, a size or a combination of files that makes no sense.
            RecordError: a folder that is none, or cannot be written.
        """
        if self.out.suffix.lower() != ".png":
            raise UsageError(f"--out {self.out}: pictures are written as .png, not {self.out.suffix!r}")
        if self.raw is not None and self.raw.suffix.lower() not in RAW_SUFFIXES:
            raise UsageError(f"--raw {self.raw}: radiances are written as .npy, .tif or .tiff")
        if not 64 <= self.panel <= 2000:
            raise UsageError(f"--panel takes 64 to 2000 pixels, not {self.panel}")
        if self.white is not None and not 0.0 < self.white < float("inf"):
            raise UsageError(f"--white takes a positive radiance in 1/sr, not {self.white:g}")
        for path in (self.out, self.raw):
            if path is not None:
                _check_target(path, source)

    def brightest(self, pictures: Sequence[FloatArray], percentile: float) -> float:
        """Radiance shown as white: the given one, or a percentile over all pictures."""
        if self.white is not None:
            return self.white
        values = np.concatenate([picture[np.isfinite(picture)] for picture in pictures])
        found = float(np.percentile(values, percentile)) if values.size else 0.0
        return found if found > 0.0 else 1.0

    def exposure_sentence(self, pictures: Sequence[FloatArray], white: float) -> str:
        """Mapping of radiance to brightness, in words."""
        code = "sRGB transfer (IEC 61966-2-1)" if self.transfer == "srgb" else "no transfer curve"
        clipped = _share_above(pictures, white)
        return (
            f"Full brightness = {white:.4g} 1/sr per unit irradiance perpendicular to the beam, the same in all "
            f"panels; {code}; {100 * clipped:.2g} % of the pixels are brighter."
        )

    def exposure(self, pictures: Sequence[FloatArray], white: float) -> dict[str, Any]:
        """The exposure, for the JSON."""
        return {"white": white, "transfer": self.transfer, "share_above_white": _share_above(pictures, white)}

    def write(self, png: bytes, pictures: Sequence[FloatArray]) -> None:
        """Write the picture and, on request, the radiances (panels, rows, cols).

        Raises:
            RecordError: a file cannot be written.
        """
        write_bytes(self.out, png)
        if self.raw is None:
            return
        import io

        stack = np.stack(pictures).astype(np.float32)
        stream = io.BytesIO()
        if self.raw.suffix.lower() == ".npy":
            np.save(stream, stack)
        else:
            import tifffile

            tifffile.imwrite(stream, stack, photometric="minisblack", metadata={"axes": "ZYX"})
        write_bytes(self.raw, stream.getvalue())


def _check_target(path: Path, source: Path | None) -> None:
    if source is not None and path.resolve() == source.resolve():
        raise UsageError(f"{path} is the input: write to another file")
    if path.is_dir():
        raise RecordError(f"cannot write {path}: it is a folder")
    if not path.parent.is_dir():
        raise RecordError(f"cannot write {path}: there is no folder {path.parent}")
    if not os.access(path.parent, os.W_OK):
        raise RecordError(f"cannot write {path}: the folder {path.parent} is not writable")


def _share_above(pictures: Sequence[FloatArray], white: float) -> float:
    known = sum(int(np.isfinite(picture).sum()) for picture in pictures)
    above = sum(int((picture > white * (1 + 1e-6)).sum()) for picture in pictures)
    return above / max(known, 1)


def parse_angles(text: str, option: str) -> tuple[float, ...]:
    """Stage angles, one panel each.

    Raises:
        UsageError: no list of numbers, or too many.
    """
    from anisoscope.views.options import parse_numbers

    angles = parse_numbers(text, option)
    if len(angles) > MAX_PANELS:
        raise UsageError(f"{option}: at most {MAX_PANELS} panels, not {len(angles)}")
    return angles


def painted(
    radiance: FloatArray | npt.NDArray[np.float32],
    white: float,
    transfer: Literal["srgb", "linear"],
    beyond: npt.NDArray[np.bool_],
    missing: npt.NDArray[np.bool_] | None = None,
) -> "Rgb":
    """Radiance picture in grey; missing points and the region beyond the sample in their own colours."""
    from anisoscope.report.renderings import BEYOND_RGB, MISSING_RGB, grey
    from anisoscope.sim.light.picture import displayed

    pixels = grey(displayed(radiance, white, transfer))
    pixels[beyond] = BEYOND_RGB
    if missing is not None:
        pixels[missing] = MISSING_RGB
    return pixels


def signed(value: float | None) -> str:
    """A number with its sign, four decimals."""
    return "–" if value is None else f"{value:+.4f}".replace("-", "−")


def degrees(value: float) -> str:
    """An angle with a typographic minus."""
    return f"{value:g}°".replace("-", "−")


def answer(
    picture: PictureOptions,
    found: "DataclassInstance",
    shown: Sequence[FloatArray],
    white: float,
    table: tuple[str, list[str], list[list[str]]],
) -> None:
    """Print JSON, or a table (title, columns, rows) and the written files."""
    from anisoscope.cli.tables import console, print_table

    if picture.json_:
        print_json(fields_of(found) | {"exposure": picture.exposure(shown, white)})
        return
    print_table(*table)
    files = [str(path) for path in (picture.out, picture.raw) if path is not None]
    console().print(f"written: {', '.join(files)}", markup=False, highlight=False, soft_wrap=True)


app = App(name="render", help="Render pictures of ridged plates and of height maps under the rig's light.")


@Parameter(name="*")
@dataclass(frozen=True)
@everyday("recipe", "pixel", "region")
class SurfaceOptions:
    """How a map is taken, and what is added to ideal ridges."""

    recipe: RecipeOption = None
    rough: Annotated[
        float, Parameter(help="Roughness α modelled as heights on ideal ridges (length 8 µm).")
    ] = 0.0
    burrs: Annotated[float, Parameter(help="Share of ideal ridges that burrs cover, 0 to 0.5.")] = 0.0
    seed: Annotated[int, Parameter(help="Seed of roughness and burrs.")] = 1
    pixel: Annotated[str | None, Parameter(help="Pixel size in µm of a map without one: SIZE or Y,X.")] = None
    level: Annotated[Literal["auto", "plane", "none"], Parameter(help="How a height map is levelled.")] = (
        "auto"
    )
    region: Annotated[
        str | None, Parameter(help="Part of the map in µm from its first point: X0,Y0,X1,Y1.")
    ] = None

    def region_um(self) -> tuple[float, float, float, float] | None:
        """The part of the map.

        Raises:
            UsageError: not four numbers, or none between them.
        """
        if self.region is None:
            return None
        corners = parse_numbers(self.region, "--region")
        if len(corners) != 4 or corners[0] >= corners[2] or corners[1] >= corners[3]:
            raise UsageError(
                "--region takes X0,Y0,X1,Y1 in µm with X0 < X1 and Y0 < Y1, such as 0,0,300,200, "
                f"not {self.region!r}"
            )
        return corners[0], corners[1], corners[2], corners[3]

    def read(
        self, height_map: Path | None, ridges: Given[RidgeDesign], base: "Stated"
    ) -> "tuple[HeightMap, MapSample]":
        """The surface of the command line, else of the recipe, and how it is rendered."""
        from anisoscope.cli.options import parse_pixel
        from anisoscope.operations.render import ridge_sample
        from anisoscope.profiles.files.load import read_height_map

        asked = "ridge_angle_deg" in ridges
        if height_map is not None and asked:
            raise UsageError("give either a height map file or --ridge-angle of ideal ridges")
        of_recipe = height_map is None and not asked
        file = base.height_map if of_recipe else height_map
        if file is None and not asked and base.design is None:
            raise UsageError("give either a height map file or --ridge-angle of ideal ridges")
        if file is None:
            usual = RidgeDesign(base.pitch_um or USUAL_PITCH_UM, 0.0)
            design = ridges.over(base.design or usual)
            words = _words(design)
            words += f", heights of roughness α = {self.rough:g}" if self.rough else ""
            words += f", burrs on {100 * self.burrs:g} %" if self.burrs else ""
            surface = ridge_sample(design, self.rough, self.burrs, self.seed)
            return surface, MapSample(design.pitch_um, "none", name=words)
        why = "belongs to ideal ridges (--ridge-angle), not to a height map"
        ridges.refuse(["wall", "height_loss", "edge_radius_um", "foot_radius_um"], why)
        if self.rough or self.burrs:
            raise UsageError(f"--rough and --burrs {why.replace('belongs', 'belong')}")
        pixel, role = parse_pixel(self.pixel), base.role if of_recipe else "part"
        if of_recipe and pixel is None:
            pixel = base.pixel_um
        pitch = ridges.values.get("pitch_um", base.pitch_um)
        surface = read_height_map(file, pixel_um=pixel, role=role)
        return surface, MapSample(pitch, self.level, name=file.name)


def _words(design: RidgeDesign) -> str:
    wall = f"{design.wall} wall" if isinstance(design.wall, str) else f"wall of {design.wall:g}° draft"
    words = f"Ideal ridges, {design.ridge_angle_deg:g}°, pitch {design.pitch_um:g} µm, {wall}"
    if design.height_loss:
        words += f", {100 * design.height_loss:g} % of the height missing"
    words += f", crest radius {design.edge_radius_um:g} µm" if design.edge_radius_um else ""
    return words + (f", foot radius {design.foot_radius_um:g} µm" if design.foot_radius_um else "")


def rig_sentence(rig: Convention, tilt: float) -> str:
    """Light, camera and tilt in words."""
    side = "right" if rig.light_angle_deg >= 0 else "left"
    azimuth = f", facets toward {rig.facet_azimuth_deg:g}° at stage 0°" if rig.facet_azimuth_deg else ""
    sense = "counter-clockwise" if rig.rotation_sense == "ccw" else "clockwise"
    return (
        f"Light {abs(rig.light_angle_deg):g}° to the {side} of the camera; both tilted by {degrees(tilt)} "
        f"(tilt plane {rig.tilt_plane}){azimuth}. Stage angles turn the sample {sense}. Parallel projection."
    )


def plastic_words(material: Material) -> str:
    """Roughness and lobe in words."""
    lobe = f"{material.alpha_along:g} along and {material.alpha_across:g} across"
    tail = f", tail {material.tail:g}" if material.tail else ""
    second = ", second lobe of weight {:g} and width {:g}".format(*material.second_lobe or (0.0, 1.0))
    return lobe + tail + (second if material.second_lobe else "")


@app.command
@with_options(
    view=Options(
        PlateView,
        readers={"angles_deg": parse_angles},
        groups={"tilt_deg": LIGHT, "ridge_directions_deg": MORE, "bounces": MORE},
        whole=True,
    ),
    cells=Options(PlateFields, whole=True),
    ridges=OF_RIDGES,
    plastic=OF_PLASTIC,
    rig=OF_LIGHT,
)
@everyday("picture", "recipe", "cells")
def checkerboard(
    *,
    picture: PictureOptions,
    recipe: RecipeOption = None,
    ridges: Given[RidgeDesign],
    view: Given[PlateView],
    cells: Given[PlateFields],
    plastic: Given[Material],
    rig: Given[Convention],
) -> int:
    """Render a plate of fields with two directions of ridges, turned on the stage.

    Examples:
        anisoscope render checkerboard --out plate.png
        anisoscope render checkerboard --pattern logo.png --plate-width 20 --out logo-on-plastic.png
    """
    from anisoscope.operations.render import read_pattern, render_plate
    from anisoscope.operations.stated import stated

    plate = cells.made()
    picture.check(plate.pattern)
    seen = view.made()
    base = stated(recipe)
    if base.height_map is not None and "ridge_angle_deg" not in ridges:
        raise UsageError(f"{recipe}: its surface is a height map; say the --ridge-angle of the plate")
    design = ridges.over(base.design or RidgeDesign(base.pitch_um or USUAL_PITCH_UM, 10.0))
    second = plate.fields if plate.pattern is None else read_pattern(plate.pattern)
    with progress("render", quiet=picture.json_) as advance:
        found = render_plate(
            design,
            second,
            cell_mm=plate.field_size_mm
            if isinstance(second, int)
            else plate.plate_width_mm / second.shape[1],
            view=seen,
            material=plastic.over(base.material),
            convention=rig.over(base.convention),
            panel=picture.panel,
            on_progress=advance,
        )
    # Fields of a plate are flat, without sparkle: white is their maximum, not a percentile.
    shown = [one.radiance for one in found.pictures]
    white = picture.brightest(shown, 100.0)
    _write_plate(picture, found, design, white, rig_sentence(found.convention, seen.tilt_deg))
    rows = [
        [
            f"{one.stage_deg:g}",
            f"{one.first:.5f}",
            f"{one.second:.5f}",
            f"{one.difference:+.5f}",
            signed(one.michelson),
            signed(one.log_ratio),
        ]
        for one in found.panels
    ]
    answer(picture, found, shown, white, ("Fields of the plate", FIELD_COLUMNS, rows))
    return 0


def _write_plate(
    picture: PictureOptions, found: "PlatePictures", design: RidgeDesign, white: float, rig: str
) -> None:
    """Draw and write the panels."""
    from anisoscope.report.renderings import Panel, panels_png, scale_bar

    light = (
        "parallel light"
        if found.near_light_mm is None
        else f"a point of light at {found.near_light_mm:g} mm, irradiance at the axis = 1"
    )
    counts = {"all": "all reflections", 1: "direct light"}
    words = (
        f"Corrected model, {counts.get(found.bounces, f'{found.bounces} reflections')}, {light}; ridge angle "
        f"{design.ridge_angle_deg:g}°, roughness {plastic_words(found.material)} the ridges, albedo "
        f"{found.material.albedo:g}."
    )
    names = [f"ridges at {degrees(one)} on the plate" for one in found.plate.ridge_deg]
    panels = []
    for one, seen in zip(found.panels, found.pictures, strict=True):
        pixels = painted(seen.radiance, white, picture.transfer, ~np.isfinite(seen.radiance))
        lines = (
            f"{names[0]}: {one.first:.4f} 1/sr",
            f"{names[1]}: {one.second:.4f} 1/sr",
            f"Michelson {signed(one.michelson)}, ln ratio {signed(one.log_ratio)}",
        )
        panels.append(Panel(pixels, f"stage {degrees(one.stage_deg)}", lines))
    shown = [one.radiance for one in found.pictures]
    bar = scale_bar(found.pixel_um, found.view.shape[1])
    picture.write(panels_png(panels, [words, rig, picture.exposure_sentence(shown, white)], bar), shown)


@Parameter(name="*")
@dataclass(frozen=True)
class ComparedOptions(SurfaceOptions):
    """How a map is compared with its picture.

    Attributes:
        cut: Also draw height and radiance along the line this far above the middle, in µm.
    """

    stage: Annotated[float, Parameter(help="Stage angle in degrees.")] = 0.0
    cut: float | None = None


OF_VIEW = Options(
    MapView,
    readers={"angles_deg": parse_angles},
    groups={"tilt_deg": LIGHT, "bounces": MORE},
    whole=True,
)


class Shot:
    """Microscope pictures with their caption, scale and printed results."""

    def __init__(
        self,
        height_map: Path | None,
        picture: PictureOptions,
        view: MapView,
        surface: "SurfaceOptions | None",
        models: tuple[Given[RidgeDesign], Given[Microscope], Given[Material], Given[Convention]],
    ) -> None:
        from anisoscope.operations.render import reflections, render_frame
        from anisoscope.operations.stated import stated

        self.picture, taken = picture, surface or SurfaceOptions()
        ridges, microscope, plastic, rig = models
        picture.check(height_map)
        reflections(view.bounces)
        base = stated(taken.recipe)
        seen, region = microscope.over(Microscope()), taken.region_um()
        material, convention = plastic.over(base.material), rig.over(base.convention)
        heights, how = taken.read(height_map, ridges, base)
        with progress("render", quiet=picture.json_) as advance:
            self.found: Frames = render_frame(
                heights,
                view=view,
                sample=replace(how, region_um=region),
                material=material,
                convention=convention,
                microscope=seen,
                panel=picture.panel,
                on_progress=advance,
            )
        self.pictures: list[FloatArray] = list(self.found.radiance)
        self.white, self.tilt = picture.brightest(self.pictures, 99.5), view.tilt_deg

    def caption(self) -> list[str]:
        """Caption of the pictures."""
        sample, material = self.found.sample, self.found.material
        what = sample.surface + (f"; {sample.cut}" if sample.cut else "")
        gaps = (
            f" {100 * sample.missing_share:.2g} % of the facets were not measured."
            if sample.missing_share
            else ""
        )
        light = (
            "direct light"
            if self.found.bounces == 1
            else f"{self.found.bounces} reflections, what is reflected again spread evenly"
        )
        surface = (
            f"{what}. Relief model, {light}; roughness below the map's resolution {plastic_words(material)}, "
            f"albedo {material.albedo:g}.{gaps}"
        )
        return [
            surface,
            self._optics(),
            rig_sentence(self.found.convention, self.tilt),
            self.picture.exposure_sentence(self.pictures, self.white),
        ]

    def _optics(self) -> str:
        """Magnification, blur and field in words."""
        view, seen, lens = self.found.views[0], self.found.microscope, self.found.lens
        words = (
            f"Magnification {self.found.magnification:.3g}× onto pixels of {seen.sensor_pixel_um:g} µm, "
            f"{view.pixel_um:.3g} µm on the sample"
        )
        if lens.na > 0:
            words += f"; NA {lens.na:g} at {seen.wavelength_nm:g} nm, finest detail {1 / lens.cutoff_per_um:.3g} µm"
        else:
            words += "; no blur by the lens"
        if lens.disc_um > 0:
            words += f"; {seen.defocus_um:g} µm out of focus, disc of {2 * lens.disc_um:.3g} µm"
        height, width = view.extent_um(self.found.sample.size_um)
        if height > view.shape[0] * view.pixel_um * 1.01 or width > view.shape[1] * view.pixel_um * 1.01:
            words += "; the sample is larger than the picture, its middle is shown"
        return words + "."

    def answer(self) -> None:
        """Print the rendered quantities."""
        rows = [
            [f"{one.stage_deg:g}", f"{one.mean_of_surface:.5f}", f"{one.mean_of_picture or 0:.5f}"]
            for one in self.found.panels
        ]
        columns = ["stage [°]", "mean of the surface [1/sr]", "mean of the picture [1/sr]"]
        answer(self.picture, self.found, self.pictures, self.white, ("Microscope pictures", columns, rows))


@app.command
@with_options(view=OF_VIEW, ridges=OF_SURFACE, microscope=OF_MICROSCOPE, plastic=OF_PLASTIC, rig=OF_LIGHT)
@everyday("picture", "surface")
def frame(
    height_map: Path | None = None,
    /,
    *,
    picture: PictureOptions,
    view: Given[MapView],
    surface: SurfaceOptions | None = None,
    ridges: Given[RidgeDesign],
    microscope: Given[Microscope],
    plastic: Given[Material],
    rig: Given[Convention],
) -> int:
    """Render what a microscope camera sees of a height map or of ideal ridges, one panel for each stage angle.

    Args:
        height_map: File with a measured height map; leave it out and give --ridge-angle for ideal ridges.

    Examples:
        anisoscope render frame part.x3p --angles 0,90,180 --out frames.png
        anisoscope render frame --ridge-angle 10 --pitch 100 --out frames.png
    """
    from anisoscope.report.renderings import BEYOND_RGB, MISSING_RGB, Panel, panels_png, scale_bar

    models = ridges, microscope, plastic, rig
    shot = Shot(height_map, picture, view.made(), surface, models)
    frames = shot.found.pictures
    panels = [
        Panel(
            painted(p.radiance, shot.white, picture.transfer, ~p.covered, p.missing),
            f"stage {degrees(one.stage_deg)}",
            (f"mean of the surface {one.mean_of_surface:.4f} 1/sr",),
        )
        for one, p in zip(shot.found.panels, frames, strict=True)
    ]
    marks = []
    if any(p.missing.any() for p in frames):
        marks.append((MISSING_RGB, "not measured"))
    if not all(p.covered.all() for p in frames):
        marks.append((BEYOND_RGB, "beyond the map"))
    bar = scale_bar(shot.found.pixel_um, shot.found.shape[1])
    picture.write(panels_png(panels, shot.caption(), bar, marks), shot.pictures)
    shot.answer()
    return 0


@app.command
@with_options(
    view=replace(OF_VIEW, without={"angles_deg": "one picture: --stage"}),
    ridges=OF_SURFACE,
    microscope=OF_MICROSCOPE,
    plastic=OF_PLASTIC,
    rig=OF_LIGHT,
)
@everyday("picture", "surface")
def comparison(
    height_map: Path | None = None,
    /,
    *,
    picture: PictureOptions,
    view: Given[MapView],
    surface: ComparedOptions | None = None,
    ridges: Given[RidgeDesign],
    microscope: Given[Microscope],
    plastic: Given[Material],
    rig: Given[Convention],
) -> int:
    """Render a height map in colours and its microscope picture side by side, in the same orientation and scale.

    Args:
        height_map: File with a measured height map; leave it out and give --ridge-angle for ideal ridges.

    Examples:
        anisoscope render comparison part.x3p --stage 0 --cut 40 --out beside.png
    """
    from anisoscope.report.renderings import (
        BEYOND_RGB,
        MISSING_RGB,
        Panel,
        height_colours,
        panels_png,
        scale_bar,
    )

    models = ridges, microscope, plastic, rig
    taken = surface or ComparedOptions()
    shot = Shot(height_map, picture, replace(view.made(), angles_deg=(taken.stage,)), taken, models)
    seen = shot.found.pictures[0]
    heights = shot.found.sample.heights_um(shot.found.views[0])
    known = heights[np.isfinite(heights)]
    if known.size == 0:
        raise UsageError("no measured point lies in the picture: take another --region")
    low, high = (float(end) for end in np.percentile(known, [0.5, 99.5]))
    colours = height_colours(heights, low, high)
    colours[~np.isfinite(heights)] = MISSING_RGB
    colours[~seen.covered] = BEYOND_RGB
    line = _cut_line(taken.cut, shot.found, heights, (low, high))
    panels = [
        Panel(colours, "height map", (f"colours from {low:.2f} to {high:.2f} µm, 99 % of the points",)),
        Panel(
            painted(seen.radiance, shot.white, picture.transfer, ~seen.covered, seen.missing),
            f"microscope picture, stage {degrees(taken.stage)}",
            (f"mean of the surface {shot.found.panels[0].mean_of_surface:.4f} 1/sr",),
        ),
    ]
    marks = [(MISSING_RGB, "not measured")] if seen.missing.any() else []
    marks += [(BEYOND_RGB, "beyond the map")] if not seen.covered.all() else []
    bar = scale_bar(shot.found.pixel_um, shot.found.shape[1])
    picture.write(panels_png(panels, shot.caption(), bar, marks, line), shot.pictures)
    shot.answer()
    return 0


def _cut_line(
    cut: float | None, found: "Frames", heights: "FloatArray", ends: tuple[float, float]
) -> "Heights":
    """Colour scale of the heights and, on request, the profile along a line."""
    from anisoscope.report.renderings import Heights

    if cut is None:
        return Heights(*ends)
    (rows, cols), pixel = found.shape, found.pixel_um
    half = 0.5 * rows * pixel
    if not abs(cut) < half:
        raise UsageError(
            f"--cut takes a place within ±{half:.4g} µm of the middle of the picture, not {cut:g}"
        )
    row = min(int(np.floor((half - cut) / pixel)), rows - 1)
    x: FloatArray = (np.arange(cols, dtype=np.float64) - 0.5 * (cols - 1)) * pixel
    return Heights(*ends, row, x, heights[row], found.pictures[0].radiance[row].astype(np.float64))
