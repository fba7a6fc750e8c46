"""``anisoscope render``: pictures of ridged plates and of height maps under the rig's light."""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from cyclopts import Parameter

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import UsageError
from anisoscope.cli.progress import progress
from anisoscope.cli.render.scene import (
    MICROSCOPE,
    PictureOptions,
    PlasticOptions,
    RigOptions,
    Scene,
    SurfaceOptions,
    answer,
    parse_angles,
)

if TYPE_CHECKING:
    from anisoscope.base.progress import Advance
    from anisoscope.parameters.geometry import Convention, Pose
    from anisoscope.parameters.material import Material
    from anisoscope.report.renderings import Heights, Rgb
    from anisoscope.sim.light.micrograph import Lens, Micrograph
    from anisoscope.sim.light.picture import View
from typing import TYPE_CHECKING

import numpy.typing as npt

from anisoscope.cli.render.scene import degrees, painted, signed

if TYPE_CHECKING:
    from anisoscope.parameters.geometry import Convention, Pose
    from anisoscope.sim.light.picture import Plate, PlatePicture, View
from typing import Literal

from cyclopts import App

from anisoscope.cli.help_page import everyday

LEAST_PIXELS = 64


@Parameter(name="*", group=MICROSCOPE)
@dataclass(frozen=True)
class MicroscopeOptions:
    """The microscope."""

    magnification: Annotated[
        float | None, Parameter(help="Magnification onto the sensor; default: the sample fills the panel.")
    ] = None
    sensor_pixel: Annotated[float, Parameter(help="Pixel of the sensor in µm.")] = 3.45
    na: Annotated[float, Parameter(help="Numerical aperture at the sample; 0: no blur by the lens.")] = 0.1
    wavelength: Annotated[float, Parameter(help="Wavelength of the light in nm.")] = 550.0
    defocus: Annotated[float, Parameter(help="Distance from the plane in focus in µm.")] = 0.0
    bounces: Annotated[
        int | Literal["all"],
        Parameter(
            help="Reflections between facet and wall that are counted: 1 is direct light, or 'all'; spread evenly."
        ),
    ] = "all"

    def reflections(self) -> int | None:
        """Largest number of reflections; None counts all.

        Raises:
            UsageError: less than one.
        """
        if self.bounces != "all" and self.bounces < 1:
            raise UsageError(f"--bounces must be 1 or more, or all, not {self.bounces}")
        return None if self.bounces == "all" else self.bounces

    def lens(self) -> "Lens":
        """The lens of the options."""
        from anisoscope.sim.light.micrograph import Lens

        return Lens(self.na, self.wavelength / 1000.0, self.defocus)

    def views(
        self, scene: Scene, poses: "tuple[Pose, ...]", convention: "Convention", panel: int
    ) -> "list[View]":
        """Views of equal shape and scale, one for each pose."""
        from anisoscope.sim.light.picture import view_of

        if not 0.0 < self.sensor_pixel < float("inf"):
            raise UsageError(f"--sensor-pixel takes a positive number of µm, not {self.sensor_pixel:g}")
        if self.magnification is not None and not 0.0 < self.magnification < float("inf"):
            raise UsageError(f"--magnification takes a positive number, not {self.magnification:g}")
        reach = np.max(
            [view_of(pose, convention, (1, 1), 1.0).extent_um(scene.size_um) for pose in poses], axis=0
        )
        pixel = (
            float(reach.max()) / panel
            if self.magnification is None
            else self.sensor_pixel / self.magnification
        )
        rows, cols = (min(panel, max(LEAST_PIXELS, int(np.ceil(side / pixel - 1e-6)))) for side in reach)
        return [view_of(pose, convention, (rows, cols), pixel) for pose in poses]

    def sentence(self, view: "View", scene: Scene) -> str:
        """Magnification, blur and field in words."""
        lens = self.lens()
        words = (
            f"Magnification {self.sensor_pixel / view.pixel_um:.3g}× onto pixels of {self.sensor_pixel:g} µm, "
            f"{view.pixel_um:.3g} µm on the sample"
        )
        if lens.na > 0:
            words += (
                f"; NA {lens.na:g} at {self.wavelength:g} nm, finest detail {1 / lens.cutoff_per_um:.3g} µm"
            )
        else:
            words += "; no blur by the lens"
        if lens.disc_um > 0:
            words += f"; {self.defocus:g} µm out of focus, disc of {2 * lens.disc_um:.3g} µm"
        height, width = view.extent_um(scene.size_um)
        if height > view.shape[0] * view.pixel_um * 1.01 or width > view.shape[1] * view.pixel_um * 1.01:
            words += "; the sample is larger than the picture, its middle is shown"
        return words + "."


def take_frames(
    scene: Scene,
    material: "Material",
    poses: "tuple[Pose, ...]",
    convention: "Convention",
    views: "list[View]",
    microscope: MicroscopeOptions,
    advance: "Advance",
) -> "tuple[list[Micrograph], list[float], FloatArray]":
    """A micrograph of every pose, the mean radiance of all measured facets, and how much of it is reflected again."""
    from anisoscope.prediction.reflections import reflections_of_map
    from anisoscope.sim.light.geometry import directions
    from anisoscope.sim.light.micrograph import micrograph
    from anisoscope.sim.light.relief import radiance_maps

    sides, lens = directions(poses, convention), microscope.lens()
    source = reflections_of_map(scene.relief, microscope.reflections())
    again = np.zeros(len(poses)) if source is None else source.light(*sides, material)
    maps = radiance_maps(scene.relief, *sides, material)
    pictures, means = [], []
    for number, (direct, view) in enumerate(zip(maps, views, strict=True)):
        advance(f"stage {poses[number].stage_deg:g}°", number, len(poses))
        facets = direct + direct.dtype.type(again[number])
        means.append(float(np.nanmean(facets, dtype=np.float64)))
        pictures.append(micrograph(facets, scene.facet_um, view, lens))
    return pictures, means, again


class Shot:
    """Microscope pictures with their caption, scale and printed results."""

    def __init__(
        self,
        height_map: Path | None,
        picture: PictureOptions,
        stage: str,
        surface: SurfaceOptions | None,
        microscope: MicroscopeOptions | None,
        plastic: PlasticOptions | None,
        rig: RigOptions | None,
    ) -> None:
        from anisoscope.parameters.geometry import Pose

        self.picture, self.plastic = picture, plastic or PlasticOptions()
        self.rig, self.microscope = rig or RigOptions(), microscope or MicroscopeOptions()
        picture.check(height_map)
        self.poses = tuple(Pose(angle, self.rig.tilt) for angle in parse_angles(stage, "--stage"))
        self.convention = self.rig.convention()
        self.microscope.reflections()
        material = self.plastic.material()
        self.scene: Scene = (surface or SurfaceOptions()).scene(height_map)
        self.views = self.microscope.views(self.scene, self.poses, self.convention, picture.panel)
        with progress("render", quiet=picture.json_) as advance:
            self.frames, self.means, self.again = take_frames(
                self.scene, material, self.poses, self.convention, self.views, self.microscope, advance
            )
        self.pictures: list[FloatArray] = [p.radiance.astype(np.float64) for p in self.frames]
        self.white = picture.brightest(self.pictures, 99.5)

    def caption(self) -> list[str]:
        """Caption of the pictures."""
        what = self.scene.name + (f"; {self.scene.note}" if self.scene.note else "")
        missing = self.scene.relief.missing_share
        gaps = f" {100 * missing:.2g} % of the facets were not measured." if missing else ""
        light = (
            "direct light"
            if self.microscope.bounces == 1
            else f"{self.microscope.bounces} reflections, what is reflected again spread evenly"
        )
        surface = (
            f"{what}. Relief model, {light}; roughness below the map's resolution {self.plastic.alpha_along:g} "
            f"along and {self.plastic.alpha_across:g} across, albedo {self.plastic.albedo:g}.{gaps}"
        )
        return [
            surface,
            self.microscope.sentence(self.views[0], self.scene),
            self.rig.sentence(),
            self.picture.exposure_sentence(self.pictures, self.white),
        ]

    def answer(self) -> None:
        """Print the rendered quantities."""
        from anisoscope.sim.light.contrasts import contrasts

        view = self.views[0]
        ratios = contrasts(self.poses, np.array(self.means))
        panels: list[dict[str, Any]] = [
            {
                "stage_deg": pose.stage_deg,
                "tilt_deg": pose.tilt_deg,
                "mean_of_surface": mean,
                "reflected_again": again,
                "mean_of_picture": _mean(p),
                "missing_pixels": float(p.missing.mean()),
            }
            for pose, p, mean, again in zip(
                self.poses, self.frames, self.means, map(float, self.again), strict=True
            )
        ]
        found = {
            "model": "relief",
            "bounces": self.microscope.bounces,
            **self.scene.as_json(),
            "convention": asdict(self.convention),
            "material": asdict(self.plastic.material()),
            "lens": asdict(self.microscope.lens()),
            "magnification": self.microscope.sensor_pixel / view.pixel_um,
            "pixel_um": view.pixel_um,
            "shape": list(view.shape),
            "exposure": self.picture.as_json(self.pictures, self.white),
            "panels": panels,
            "contrasts": [
                {key: value if np.isfinite(value) else None for key, value in asdict(c).items()}
                for c in ratios
            ],
        }
        rows = [
            [f"{p['stage_deg']:g}", f"{p['mean_of_surface']:.5f}", f"{p['mean_of_picture'] or 0:.5f}"]
            for p in panels
        ]
        columns = ["stage [°]", "mean of the surface [1/sr]", "mean of the picture [1/sr]"]
        answer(self.picture, found, "Microscope pictures", columns, rows)


def _mean(found: "Micrograph") -> float | None:
    known = found.radiance[np.isfinite(found.radiance)]
    return float(known.mean(dtype=np.float64)) if known.size else None


def heights_in_view(scene: Scene, view: "View") -> FloatArray:
    """(rows, cols) height in µm of the facet at every pixel; NaN where missing or beyond the map."""
    from anisoscope.sim.light.micrograph import facet_lookup

    z = scene.relief.surface.height_um
    middle = 0.25 * (z[:-1, :-1] + z[1:, :-1] + z[:-1, 1:] + z[1:, 1:])
    index, inside = facet_lookup(view, (middle.shape[0], middle.shape[1]), scene.facet_um, 1)
    return np.where(inside, middle.ravel()[index], np.nan)


def height_pixels(heights: FloatArray, low: float, high: float, found: "Micrograph") -> "Rgb":
    """Heights in colours; missing points and the region beyond the map in their own colours."""
    from anisoscope.report.renderings import BEYOND_RGB, MISSING_RGB, height_colours

    pixels = height_colours(heights, low, high)
    pixels[~np.isfinite(heights)] = MISSING_RGB
    pixels[~found.covered] = BEYOND_RGB
    return pixels


def cut_line(
    cut: float | None, view: "View", heights: FloatArray, found: "Micrograph", ends: tuple[float, float]
) -> "Heights":
    """Colour scale of the heights and, on request, the profile along a line.

    Raises:
        UsageError: a line outside the picture.
    """
    from anisoscope.report.renderings import Heights

    if cut is None:
        return Heights(*ends)
    half = 0.5 * view.shape[0] * view.pixel_um
    if not abs(cut) < half:
        raise UsageError(
            f"--cut takes a place within ±{half:.4g} µm of the middle of the picture, not {cut:g}"
        )
    row = min(int(np.floor((half - cut) / view.pixel_um)), view.shape[0] - 1)
    x: FloatArray = (np.arange(view.shape[1], dtype=np.float64) - 0.5 * (view.shape[1] - 1)) * view.pixel_um
    return Heights(*ends, row, x, heights[row], found.radiance[row].astype(np.float64))


MAX_PATTERN = 4096
FIELD_COLUMNS = ["stage [°]", "first [1/sr]", "second [1/sr]", "difference [1/sr]", "Michelson", "ln ratio"]


def plate_views(
    plate: "Plate", poses: "tuple[Pose, ...]", convention: "Convention", panel: int
) -> "list[View]":
    """Views of equal shape and scale in which every pose has room."""
    from anisoscope.sim.light.picture import view_of

    reach = np.max(
        [view_of(pose, convention, (1, 1), 1.0).extent_um(plate.size_um) for pose in poses], axis=0
    )
    pixel_um = float(reach.max()) / panel
    rows, cols = (max(1, int(np.ceil(side / pixel_um - 1e-6))) for side in reach)
    return [view_of(pose, convention, (rows, cols), pixel_um) for pose in poses]


def two_directions(text: str) -> tuple[float, float]:
    """Directions of the ridges of both kinds of fields.

    Raises:
        UsageError: not two numbers.
    """
    from anisoscope.cli.options import parse_numbers

    found = parse_numbers(text, "--ridge-directions")
    if len(found) != 2:
        raise UsageError(f"--ridge-directions takes two angles in degrees, such as 0,-90, not {text!r}")
    return found[0], found[1]


def plate_cells(
    pattern: Path | None, size_mm: float, fields: int, field_mm: float
) -> tuple[npt.NDArray[np.bool_], float]:
    """Cells with the second direction, and the side of a cell in mm."""
    from anisoscope.sim.light.picture import checkerboard as board

    for name, value in (("--plate-width", size_mm), ("--field-size", field_mm)):
        if not 0.0 < value <= 10_000.0:
            raise UsageError(f"{name} takes a length above 0 and up to 10000 mm, not {value:g}")
    if pattern is None:
        if not 2 <= fields <= 64:
            raise UsageError(f"--fields takes 2 to 64, not {fields}")
        return board(fields), field_mm
    second = _read_pattern(pattern)
    return second, size_mm / second.shape[1]


def _read_pattern(path: Path) -> npt.NDArray[np.bool_]:
    """Dark pixels of an image: below the middle between its darkest and its brightest."""
    import cv2

    try:
        data = np.frombuffer(path.read_bytes(), dtype=np.uint8)
    except OSError as error:
        raise UsageError(f"--pattern {path}: cannot be read ({error.strerror}); check the path") from None
    try:
        image = cv2.imdecode(data, cv2.IMREAD_UNCHANGED) if data.size else None
    except cv2.error:
        image = None
    if image is None:
        raise UsageError(f"--pattern {path}: not an image that can be read; take a PNG of two levels")
    if max(image.shape[:2]) > MAX_PATTERN:
        raise UsageError(
            f"--pattern {path}: {image.shape[1]} × {image.shape[0]} pixels; at most {MAX_PATTERN} a side"
        )
    level = np.asarray(image, dtype=np.float64)
    if level.ndim == 3:
        full = 65535.0 if image.dtype == np.uint16 else 255.0
        cover = level[:, :, 3] / full if level.shape[2] == 4 else 1.0
        level = level[:, :, :3].mean(axis=2) * cover + full * (1.0 - cover)
    low, high = float(level.min()), float(level.max())
    if high <= low:
        raise UsageError(f"--pattern {path}: has one level only; dark and light pixels are needed")
    return np.asarray(level < 0.5 * (low + high))


def _log_ratio(first: float, second: float) -> float | None:
    return float(np.log(first / second)) if first > 0 and second > 0 else None


def fields_as_json(pose: "Pose", picture: "PlatePicture") -> dict[str, Any]:
    """Radiances and contrasts of the two kinds of fields in one pose."""
    first, second = picture.fields
    if not (np.isfinite(first) and np.isfinite(second)):
        raise UsageError(
            "the picture shows cells of one direction only: the other is too small, or not there"
        )
    total = first + second
    return {
        "stage_deg": pose.stage_deg,
        "tilt_deg": pose.tilt_deg,
        "first": first,
        "second": second,
        "difference": first - second,
        "michelson": (first - second) / total if total > 0 else None,
        "log_ratio": _log_ratio(first, second),
        "darkest": float(np.nanmin(picture.radiance)),
        "brightest": float(np.nanmax(picture.radiance)),
    }


def field_row(panel: dict[str, Any]) -> list[str]:
    """The same, for the table."""
    return [
        f"{panel['stage_deg']:g}",
        f"{panel['first']:.5f}",
        f"{panel['second']:.5f}",
        f"{panel['difference']:+.5f}",
        signed(panel["michelson"]),
        signed(panel["log_ratio"]),
    ]


def write_plate(
    picture: PictureOptions,
    plate: "Plate",
    poses: "tuple[Pose, ...]",
    view: "View",
    shown: "list[PlatePicture]",
    words: list[str],
    white: float,
) -> None:
    """Draw and write the panels."""
    from anisoscope.report.renderings import Panel, panels_png, scale_bar

    panels = []
    for pose, found in zip(poses, shown, strict=True):
        values = fields_as_json(pose, found)
        pixels = painted(found.radiance, white, picture.transfer, ~np.isfinite(found.radiance))
        lines = (
            f"ridges at {degrees(plate.ridge_deg[0])} on the plate: {values['first']:.4f} 1/sr",
            f"ridges at {degrees(plate.ridge_deg[1])} on the plate: {values['second']:.4f} 1/sr",
            f"Michelson {signed(values['michelson'])}, ln ratio {signed(values['log_ratio'])}",
        )
        panels.append(Panel(pixels, f"stage {degrees(pose.stage_deg)}", lines))
    pictures = [found.radiance for found in shown]
    bar = scale_bar(view.pixel_um, view.shape[1])
    caption = [*words, picture.exposure_sentence(pictures, white)]
    picture.write(panels_png(panels, caption, bar), pictures)


app = App(name="render", help="Render pictures of ridged plates and of height maps under the rig's light.")


@app.command
@everyday(
    "picture",
    "plastic",
    "rig",
    "ridge_angle",
    "angles",
    "fields",
    "field_size",
    "pattern",
    "plate_width",
    "near_light",
)
def checkerboard(
    *,
    picture: PictureOptions,
    ridge_angle: Annotated[float, Parameter(help="Ridge angle in degrees.")] = 10.0,
    wall: Annotated[
        Literal["perpendicular", "vertical"], Parameter(help="Wall of a ridge.")
    ] = "perpendicular",
    height_loss: Annotated[float, Parameter(help="Share of the ridge height missing at the crest.")] = 0.0,
    angles: Annotated[str, Parameter(help="Stage angles in degrees, one panel each.")] = "0,90",
    ridge_directions: Annotated[
        str, Parameter(help="Directions of the ridges in the two kinds of fields, from +y, in degrees.")
    ] = "0,-90",
    fields: Annotated[int, Parameter(help="Fields along a side, 2 to 64.")] = 7,
    field_size: Annotated[float, Parameter(help="Side of a field in mm.")] = 5.0,
    pattern: Annotated[
        Path | None, Parameter(help="Image of two levels in place of the checkerboard: dark is the second.")
    ] = None,
    plate_width: Annotated[float, Parameter(help="Width of the plate with --pattern in mm.")] = 40.0,
    near_light: Annotated[
        float | None, Parameter(help="Distance of the light in mm; default: parallel light.")
    ] = None,
    bounces: Annotated[
        int | Literal["all"] | None,
        Parameter(
            help="Reflections followed: 1 is direct light, or 'all'. All by default, under a near light 1."
        ),
    ] = None,
    plastic: PlasticOptions | None = None,
    rig: RigOptions | None = None,
) -> int:
    """Render a plate of fields with two directions of ridges, turned on the stage.

    Examples:
        anisoscope render checkerboard --out plate.png
        anisoscope render checkerboard --pattern logo.png --plate-width 20 --out logo-on-plastic.png
    """
    from anisoscope.parameters.geometry import Pose
    from anisoscope.parameters.ridges import RidgeDesign
    from anisoscope.sim.light.picture import Plate, plate_picture

    plastic, rig = plastic or PlasticOptions(), rig or RigOptions()
    picture.check(pattern)
    turns = parse_angles(angles, "--angles")
    second, cell_mm = plate_cells(pattern, plate_width, fields, field_size)
    design = RidgeDesign(100.0, ridge_angle, wall=wall, height_loss=height_loss)
    plate = Plate(second, 1000.0 * cell_mm, design, plastic.material(), two_directions(ridge_directions))
    if near_light is not None and not 0.0 < near_light < float("inf"):
        raise UsageError(f"--near-light takes a positive distance in mm, not {near_light:g}")
    if bounces is None:
        bounces = "all" if near_light is None else 1
    if bounces != "all" and bounces < 1:
        raise UsageError(f"--bounces must be 1 or more, or all, not {bounces}")
    convention = rig.convention()
    poses = tuple(Pose(angle, rig.tilt) for angle in turns)
    views = plate_views(plate, poses, convention, picture.panel)
    distance = None if near_light is None else 1000.0 * near_light
    shown = []
    with progress("render", quiet=picture.json_) as advance:
        for number, (pose, view) in enumerate(zip(poses, views, strict=True)):
            advance(f"stage {degrees(pose.stage_deg)}", number, len(poses))
            depth = None if bounces == "all" else bounces
            shown.append(plate_picture(plate, pose, convention, view, distance, depth))
    light = (
        "parallel light"
        if near_light is None
        else f"a point of light at {near_light:g} mm, irradiance at the axis = 1"
    )
    count = (
        "all reflections"
        if bounces == "all"
        else "direct light"
        if bounces == 1
        else f"{bounces} reflections"
    )
    words = (
        f"Corrected model, {count}, {light}; ridge angle {ridge_angle:g}°, roughness {plastic.alpha_along:g} along and "
        f"{plastic.alpha_across:g} across the ridges, albedo {plastic.albedo:g}."
    )
    # Fields of a plate are flat, without sparkle: white is their maximum, not a percentile.
    white = picture.brightest([p.radiance for p in shown], 100.0)
    write_plate(picture, plate, poses, views[0], shown, [words, rig.sentence()], white)
    values = [fields_as_json(pose, p) for pose, p in zip(poses, shown, strict=True)]
    found = {
        "model": "corrected",
        "bounces": bounces,
        "convention": asdict(convention),
        "near_light_mm": near_light,
        "material": asdict(plate.material),
        "plate_mm": [side / 1000 for side in plate.size_um],
        "pixel_um": views[0].pixel_um,
        "ridge_directions_deg": list(plate.ridge_deg),
        "exposure": picture.as_json([p.radiance for p in shown], white),
        "panels": values,
    }
    answer(picture, found, "Fields of the plate", FIELD_COLUMNS, [field_row(panel) for panel in values])
    return 0


@app.command
def frame(
    height_map: Path | None = None,
    /,
    *,
    picture: PictureOptions,
    angles: Annotated[str, Parameter(help="Stage angles in degrees, one panel each.")] = "0,90,180",
    surface: SurfaceOptions | None = None,
    microscope: MicroscopeOptions | None = None,
    plastic: PlasticOptions | None = None,
    rig: RigOptions | None = None,
) -> int:
    """Render what a microscope camera sees of a height map or of ideal ridges, one panel for each stage angle.

    Args:
        height_map: File with a measured height map; leave it out and give --ridge-angle for ideal ridges.

    Examples:
        anisoscope render frame part.x3p --angles 0,90,180 --out frames.png
        anisoscope render frame --ridge-angle 10 --pitch 100 --out frames.png
    """
    from anisoscope.report.renderings import BEYOND_RGB, MISSING_RGB, Panel, panels_png, scale_bar

    shot = Shot(height_map, picture, angles, surface, microscope, plastic, rig)
    panels = [
        Panel(
            painted(p.radiance, shot.white, picture.transfer, ~p.covered, p.missing),
            f"stage {degrees(pose.stage_deg)}",
            (f"mean of the surface {mean:.4f} 1/sr",),
        )
        for pose, p, mean in zip(shot.poses, shot.frames, shot.means, strict=True)
    ]
    marks = []
    if any(p.missing.any() for p in shot.frames):
        marks.append((MISSING_RGB, "not measured"))
    if not all(p.covered.all() for p in shot.frames):
        marks.append((BEYOND_RGB, "beyond the map"))
    bar = scale_bar(shot.views[0].pixel_um, shot.views[0].shape[1])
    picture.write(panels_png(panels, shot.caption(), bar, marks), shot.pictures)
    shot.answer()
    return 0


@app.command
def beside(
    height_map: Path | None = None,
    /,
    *,
    picture: PictureOptions,
    stage: Annotated[float, Parameter(help="Stage angle in degrees.")] = 0.0,
    cut: Annotated[
        float | None,
        Parameter(help="Also draw height and radiance along the line this far above the middle, in µm."),
    ] = None,
    surface: SurfaceOptions | None = None,
    microscope: MicroscopeOptions | None = None,
    plastic: PlasticOptions | None = None,
    rig: RigOptions | None = None,
) -> int:
    """Render a height map in colours and its microscope picture side by side, in the same orientation and scale.

    Args:
        height_map: File with a measured height map; leave it out and give --ridge-angle for ideal ridges.

    Examples:
        anisoscope render beside part.x3p --stage 0 --cut 40 --out beside.png
    """
    from anisoscope.report.renderings import BEYOND_RGB, MISSING_RGB, Panel, panels_png, scale_bar

    shot = Shot(height_map, picture, f"{stage:g}", surface, microscope, plastic, rig)
    view, found = shot.views[0], shot.frames[0]
    heights = heights_in_view(shot.scene, view)
    known = heights[np.isfinite(heights)]
    if known.size == 0:
        raise UsageError("no measured point lies in the picture: take another --region")
    low, high = (float(end) for end in np.percentile(known, [0.5, 99.5]))
    colours = height_pixels(heights, low, high, found)
    line = cut_line(cut, view, heights, found, (low, high))
    panels = [
        Panel(colours, "height map", (f"colours from {low:.2f} to {high:.2f} µm, 99 % of the points",)),
        Panel(
            painted(found.radiance, shot.white, picture.transfer, ~found.covered, found.missing),
            f"microscope picture, stage {degrees(stage)}",
            (f"mean of the surface {shot.means[0]:.4f} 1/sr",),
        ),
    ]
    marks = [(MISSING_RGB, "not measured")] if found.missing.any() else []
    marks += [(BEYOND_RGB, "beyond the map")] if not found.covered.all() else []
    bar = scale_bar(view.pixel_um, view.shape[1])
    picture.write(panels_png(panels, shot.caption(), bar, marks, line), shot.pictures)
    shot.answer()
    return 0
