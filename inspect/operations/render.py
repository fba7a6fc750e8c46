"""Pictures of ridged plates and of height maps under the rig's light, as radiances."""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import UsageError
from anisoscope.base.json_fields import LEFT_OUT, in_json, json_field
from anisoscope.base.progress import Advance, silent
from anisoscope.base.regular_file import MOST_PICTURE_BYTES, bounded_bytes
from anisoscope.parameters.geometry import Convention, Pose
from anisoscope.parameters.keywords import by_keywords
from anisoscope.parameters.material import Material
from anisoscope.parameters.microscope import Lens, Microscope
from anisoscope.parameters.rendering import MapSample, MapView, PlateView
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.prediction.reflections import reflections_of_map
from anisoscope.prediction.relief_preparation import prepare_relief
from anisoscope.profiles.defects import burrs as with_burrs
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.profiles.ideal import add_facet_roughness, ridges
from anisoscope.sim.light.contrasts import Contrast, contrasts
from anisoscope.sim.light.geometry import directions
from anisoscope.sim.light.micrograph import Micrograph, facet_lookup, micrograph
from anisoscope.sim.light.picture import Plate, PlatePicture, View, checkerboard, plate_picture, view_of
from anisoscope.sim.light.relief import Relief, radiance_maps

Bounces = int | Literal["all"]
LEAST_PIXELS = 64
MAX_POINTS = 9_000_000
LEAST_POINTS = 8
DESIGN_PIXEL_UM = 0.5
DESIGN_FIELD_UM = 400.0
ROUGHNESS_LENGTH_UM = 8.0
USUAL_PITCH_UM = 100.0


def reflections(bounces: Bounces) -> int | None:
    """Largest number of reflections; None counts all.

    Raises:
        UsageError: less than one.
    """
    if bounces != "all" and bounces < 1:
        raise UsageError(f"--bounces must be 1 or more, or all, not {bounces}")
    return None if bounces == "all" else bounces


def ridge_sample(design: RidgeDesign, rough: float = 0.0, burrs: float = 0.0, seed: int = 1) -> HeightMap:
    """Height map of four ideal ridges, on request with roughness modelled as heights and with burrs.

    Args:
        design: the ridges.
        rough: Beckmann roughness of the heights, 0 to 0.5; its correlation length is 8 µm.
        burrs: share of the ridges that burrs cover, 0 to 0.5.
        seed: of roughness and burrs.

    Returns:
        (801, 801) heights in µm.

    Raises:
        UsageError: a number outside its range.
    """
    for name, value, what in (("burrs", burrs, "share"), ("rough", rough, "roughness")):
        if not 0.0 <= value <= 0.5:
            raise UsageError(f"--{name} takes a {what} of 0 to 0.5, not {value:g}")
    if seed < 0:
        raise UsageError(f"--seed takes a whole number from 0 on, not {seed}")
    unit = design.pitch_um / USUAL_PITCH_UM  # four ridges, whatever their pitch
    points = round(DESIGN_FIELD_UM / DESIGN_PIXEL_UM) + 1
    surface = ridges(design, (points, points), DESIGN_PIXEL_UM * unit)
    rng = np.random.default_rng(seed)
    if rough:
        surface = add_facet_roughness(surface, rough, rough, ROUGHNESS_LENGTH_UM, rng)
    return with_burrs(surface, burrs, pitch_um=design.pitch_um, rng=rng).map if burrs else surface


@dataclass(frozen=True)
class Sample:
    """What is rendered of a surface.

    Attributes:
        relief: the surface.
        surface: its name.
        cut: what was cut out, in words; None where all is shown.
    """

    relief: Relief = field(metadata=LEFT_OUT)
    surface: str
    cut: str | None = None

    @property
    @in_json()
    def size_um(self) -> tuple[float, float]:
        """(along y, along x) of all facets."""
        rows, cols = self.relief.surface.shape
        return (rows - 1) * self.facet_um[0], (cols - 1) * self.facet_um[1]

    @property
    @in_json()
    def facet_um(self) -> tuple[float, float]:
        """Size of a facet (y, x)."""
        return self.relief.surface.pixel_y_um, self.relief.surface.pixel_x_um

    @property
    @in_json()
    def missing_share(self) -> float:
        """Share of the facets that were not measured."""
        return self.relief.missing_share

    def heights_um(self, view: View) -> FloatArray:
        """(rows, cols) height of the facet at every pixel of a view; NaN where missing or beyond the map."""
        z = self.relief.surface.height_um
        middle = 0.25 * (z[:-1, :-1] + z[1:, :-1] + z[:-1, 1:] + z[1:, 1:])
        index, inside = facet_lookup(view, (middle.shape[0], middle.shape[1]), self.facet_um, 1)
        return np.where(inside, middle.ravel()[index], np.nan)


@dataclass(frozen=True)
class FramePanel:
    """Numbers of one microscope picture, radiances in 1/sr per unit irradiance.

    Attributes:
        stage_deg: stage angle.
        tilt_deg: tilt of camera and light.
        mean_of_surface: mean radiance of all measured facets.
        reflected_again: part of it that is reflected more than once, spread evenly.
        mean_of_picture: mean over the pixels; None without any.
        missing_pixels: share of the pixels that show points that were not measured.
    """

    stage_deg: float
    tilt_deg: float
    mean_of_surface: float
    reflected_again: float
    mean_of_picture: float | None
    missing_pixels: float


@dataclass(frozen=True)
class Frames:
    """Microscope pictures of a surface, one a stage angle.

    Attributes:
        model: how radiance is computed.
        bounces: reflections that are counted.
        sample: the rendered part of the surface.
        convention: how angles are counted.
        material: the plastic.
        microscope: lens and sensor.
        poses: P poses.
        views: P views of equal shape and scale.
        pictures: P pictures.
        panels: P records of their numbers.
        contrasts: of consecutive poses, by the means of the surface.
    """

    bounces: Bounces
    sample: Sample = field(metadata=json_field(merged=True))
    convention: Convention
    material: Material
    microscope: Microscope = field(metadata=LEFT_OUT)
    poses: tuple[Pose, ...] = field(metadata=LEFT_OUT)
    views: tuple[View, ...] = field(metadata=LEFT_OUT)
    pictures: tuple[Micrograph, ...] = field(metadata=LEFT_OUT)
    panels: tuple[FramePanel, ...]
    contrasts: tuple[Contrast, ...]
    model: str = "relief"

    @property
    @in_json()
    def lens(self) -> Lens:
        """The lens."""
        return self.microscope.lens

    @property
    @in_json()
    def magnification(self) -> float:
        """Magnification onto the sensor."""
        return self.microscope.sensor_pixel_um / self.pixel_um

    @property
    @in_json()
    def pixel_um(self) -> float:
        """Size of a pixel on the sample."""
        return self.views[0].pixel_um

    @property
    @in_json()
    def shape(self) -> tuple[int, int]:
        """(rows, cols) of a picture."""
        return self.views[0].shape

    @property
    def radiance(self) -> FloatArray:
        """(P, rows, cols) radiances in 1/sr per unit irradiance; NaN where nothing was measured, and beyond the map."""
        return np.stack([one.radiance.astype(np.float64) for one in self.pictures])


@by_keywords(view=MapView, sample=MapSample)
def render_frame(
    surface: HeightMap | RidgeDesign,
    *,
    view: MapView,
    sample: MapSample,
    material: Material | None = None,
    convention: Convention | None = None,
    microscope: Microscope | None = None,
    panel: int = 420,
    on_progress: Advance = silent,
) -> Frames:
    """What a microscope camera sees of a surface at every stage angle: ``anisoscope render frame``.

    Every facet has its radiance by the relief model, imaged through an ideal lens (`anisoscope.sim.light.micrograph`);
    what reflects more than once is spread evenly over the facets.

    Args:
        surface: a height map, or ideal ridges, of which four are made (`ridge_sample`).
        view: stage angles, tilt and reflections, or the fields as keywords.
        sample: what is taken of a map, or the fields as keywords.
        material: the plastic below what the map resolves; the default one where it is not given.
        convention: how angles are counted, and the light angle.
        microscope: lens, magnification and sensor.
        panel: longest side of a picture in pixels.
        on_progress: called before every picture.

    Raises:
        UsageError: a region outside the map, too small or too large, or fewer than one reflection.
        HeightMapError: a map that cannot be used.
        ModelError: a pose below the horizon, or a picture of too many points.
    """
    depth = reflections(view.bounces)
    plastic, counted = material or Material(), convention or Convention()
    seen = microscope or Microscope()
    if isinstance(surface, RidgeDesign):
        sample = replace(sample, pitch_um=surface.pitch_um, levelling="none")
        surface = ridge_sample(surface)
    poses = tuple(Pose(angle, view.tilt_deg) for angle in view.angles_deg)
    sides = directions(poses, counted)
    taken_of = _sample(surface, sample)
    views = _frame_views(taken_of, poses, counted, seen, panel)
    source = reflections_of_map(taken_of.relief, depth)
    again = np.zeros(len(poses)) if source is None else source.light(*sides, plastic)
    pictures, panels = [], []
    maps = radiance_maps(taken_of.relief, *sides, plastic)
    for number, (direct, seen_from) in enumerate(zip(maps, views, strict=True)):
        pose = poses[number]
        on_progress(f"stage {pose.stage_deg:g}°", number, len(poses))
        facets = direct + direct.dtype.type(again[number])
        taken = micrograph(facets, taken_of.facet_um, seen_from, seen.lens)
        known = taken.radiance[np.isfinite(taken.radiance)]
        mean = float(known.mean(dtype=np.float64)) if known.size else None
        of_surface = float(np.nanmean(facets, dtype=np.float64))
        shares = float(again[number]), mean, float(taken.missing.mean())
        panels.append(FramePanel(pose.stage_deg, pose.tilt_deg, of_surface, *shares))
        pictures.append(taken)
    ratios = contrasts(poses, np.array([one.mean_of_surface for one in panels]))
    shown = poses, views, tuple(pictures), tuple(panels), ratios
    return Frames(view.bounces, taken_of, counted, plastic, seen, *shown)


def _frame_views(
    sample: Sample, poses: tuple[Pose, ...], convention: Convention, microscope: Microscope, panel: int
) -> tuple[View, ...]:
    """Views of equal shape and scale, one for each pose."""
    reach = _reach_um(sample.size_um, poses, convention)
    fixed = microscope.magnification
    pixel = float(reach.max()) / panel if fixed is None else microscope.sensor_pixel_um / fixed
    rows, cols = (min(panel, max(LEAST_PIXELS, int(np.ceil(side / pixel - 1e-6)))) for side in reach)
    return tuple(view_of(pose, convention, (rows, cols), pixel) for pose in poses)


def _reach_um(size_um: tuple[float, float], poses: tuple[Pose, ...], convention: Convention) -> FloatArray:
    """(height, width) in which a rectangle (y, x) has room in every pose."""
    turned = [view_of(pose, convention, (1, 1), 1.0).extent_um(size_um) for pose in poses]
    return np.asarray(np.max(turned, axis=0), dtype=np.float64)


def _sample(surface: HeightMap, how: MapSample) -> Sample:
    """The surface levelled, and cut to what is rendered."""
    relief, _ = prepare_relief(surface, how.pitch_um, how.levelling, placed=False)
    cut, note = _cut(relief.surface, how.region_um)
    if note is not None:
        width = (cut.shape[1] - 1) * cut.pixel_x_um
        pitch = relief.pitch_um if relief.pitch_um is not None and relief.pitch_um <= width else None
        relief = Relief(cut, pitch, 1.0, direction_deg=relief.direction_deg)
    return Sample(relief, how.name, note)


def _cut(
    surface: HeightMap, region_um: tuple[float, float, float, float] | None
) -> tuple[HeightMap, str | None]:
    """Rendered region and its description: the given region, or the middle of a large map."""
    rows, cols = surface.shape
    full = f"{(cols - 1) * surface.pixel_x_um:g} × {(rows - 1) * surface.pixel_y_um:g} µm"
    reason = ""
    if region_um is None:
        if rows * cols <= MAX_POINTS:
            return surface, None
        share = np.sqrt(MAX_POINTS / (rows * cols))
        height, width = max(int(rows * share), LEAST_POINTS), max(int(cols * share), LEAST_POINTS)
        top, left = (rows - height) // 2, (cols - width) // 2
        bottom, right = top + height, left + width
        reason = (
            f" (the map has {rows * cols / 1e6:.3g} million points; --region X0,Y0,X1,Y1 shows another part)"
        )
    else:
        named = "--region " + ",".join(f"{one:g}" for one in region_um)
        left, right = _range(region_um[0], region_um[2], surface.pixel_x_um, cols)
        top, bottom = _range(region_um[1], region_um[3], surface.pixel_y_um, rows)
        if min(right - left, bottom - top) < LEAST_POINTS:
            raise UsageError(f"{named} holds fewer than {LEAST_POINTS} points a side of this map of {full}")
        if (right - left) * (bottom - top) > MAX_POINTS:
            raise UsageError(
                f"{named} holds {(right - left) * (bottom - top) / 1e6:.3g} million points; "
                f"at most {MAX_POINTS / 1e6:g} million are rendered"
            )
    cut = surface.with_height(surface.height_um[top:bottom, left:right])
    x = f"x {left * surface.pixel_x_um:g} to {(right - 1) * surface.pixel_x_um:g} µm"
    y = f"y {top * surface.pixel_y_um:g} to {(bottom - 1) * surface.pixel_y_um:g} µm"
    return cut, f"{x}, {y} of {full}{reason}"


def _range(low: float, high: float, pixel: float, count: int) -> tuple[int, int]:
    first, last = np.clip([np.ceil(low / pixel - 1e-9), np.floor(high / pixel + 1e-9) + 1], 0, count)
    return int(first), int(last)


@dataclass(frozen=True)
class PlatePanel:
    """Radiances of the two kinds of fields of a plate in one pose, in 1/sr per unit irradiance.

    Attributes:
        stage_deg: stage angle.
        tilt_deg: tilt of camera and light.
        first: mean of the fields of the first direction.
        second: mean of those of the second.
        darkest: least radiance in the picture.
        brightest: largest one.
    """

    stage_deg: float
    tilt_deg: float
    first: float
    second: float
    darkest: float
    brightest: float

    @property
    @in_json()
    def difference(self) -> float:
        """First less second."""
        return self.first - self.second

    @property
    @in_json()
    def michelson(self) -> float | None:
        """Difference over sum; None where all is dark."""
        total = self.first + self.second
        return self.difference / total if total > 0 else None

    @property
    @in_json()
    def log_ratio(self) -> float | None:
        """Natural logarithm of first over second; None where one is dark."""
        return float(np.log(self.first / self.second)) if self.first > 0 and self.second > 0 else None


@dataclass(frozen=True)
class PlatePictures:
    """Pictures of a plate of ridged fields, one a stage angle.

    Attributes:
        model: how radiance is computed.
        bounces: reflections that are counted.
        convention: how angles are counted.
        near_light_mm: distance of the light; None for parallel light.
        plate: the plate.
        view: the view of the first pose; those of the others have its shape and scale.
        pictures: P pictures.
        panels: P records of their numbers.
    """

    bounces: Bounces
    convention: Convention
    near_light_mm: float | None
    plate: Plate = field(metadata=LEFT_OUT)
    view: View = field(metadata=LEFT_OUT)
    pictures: tuple[PlatePicture, ...] = field(metadata=LEFT_OUT)
    panels: tuple[PlatePanel, ...]
    model: str = "corrected"

    @property
    @in_json()
    def material(self) -> Material:
        """The plastic."""
        return self.plate.material

    @property
    @in_json()
    def plate_mm(self) -> list[float]:
        """(along y, along x)."""
        return [side / 1000 for side in self.plate.size_um]

    @property
    @in_json()
    def pixel_um(self) -> float:
        """Size of a pixel on the plate."""
        return self.view.pixel_um

    @property
    @in_json()
    def ridge_directions_deg(self) -> tuple[float, float]:
        """Directions of the ridges, counter-clockwise from +y."""
        return self.plate.ridge_deg

    @property
    def radiance(self) -> FloatArray:
        """(P, rows, cols) radiances in 1/sr per unit irradiance; NaN beyond the plate."""
        return np.stack([one.radiance for one in self.pictures])


@by_keywords(view=PlateView)
def render_plate(
    design: RidgeDesign,
    second: npt.NDArray[np.bool_] | int = 7,
    *,
    cell_mm: float = 5.0,
    view: PlateView,
    material: Material | None = None,
    convention: Convention | None = None,
    panel: int = 420,
    on_progress: Advance = silent,
) -> PlatePictures:
    """A plate of fields with two directions of ridges, turned on the stage: ``anisoscope render checkerboard``.

    Fields have the radiance of the corrected model for their direction (Luongo et al. 2017, Fig. 2).

    Args:
        design: the ridges.
        second: (rows, cols) cells with the second direction, or the count of a checkerboard's fields along a side.
        cell_mm: side of a cell.
        view: stage angles, directions of the ridges, tilt, light and reflections, or the fields as keywords.
        material: the plastic; the default one where it is not given.
        convention: how angles are counted, and the light angle.
        panel: longest side of a picture in pixels.
        on_progress: called before every picture.

    Raises:
        UsageError: a distance or a number of reflections that is none, or cells of one direction only.
        ModelError: a pose below the horizon, or a near light with interreflection or too close.
    """
    bounces, near_light_mm = view.bounces, view.near_light_mm
    if near_light_mm is not None and not 0.0 < near_light_mm < float("inf"):
        raise UsageError(f"--near-light takes a positive distance in mm, not {near_light_mm:g}")
    if bounces is None:
        bounces = "all" if near_light_mm is None else 1
    if len(view.ridge_directions_deg) != 2:
        shown = ",".join(f"{one:g}" for one in view.ridge_directions_deg)
        raise UsageError(f"--ridge-directions takes two angles in degrees, such as 0,-90, not {shown!r}")
    first, other = view.ridge_directions_deg
    depth, counted = reflections(bounces), convention or Convention()
    cells = checkerboard(second) if isinstance(second, int) else second
    plate = Plate(cells, 1000.0 * cell_mm, design, material or Material(), (first, other))
    poses = tuple(Pose(angle, view.tilt_deg) for angle in view.angles_deg)
    reach = _reach_um(plate.size_um, poses, counted)
    pixel_um = float(reach.max()) / panel
    rows, cols = (max(1, int(np.ceil(side / pixel_um - 1e-6))) for side in reach)
    views = [view_of(pose, counted, (rows, cols), pixel_um) for pose in poses]
    distance = None if near_light_mm is None else 1000.0 * near_light_mm
    pictures, panels = [], []
    for number, (pose, seen_from) in enumerate(zip(poses, views, strict=True)):
        on_progress(f"stage {pose.stage_deg:g}°", number, len(poses))
        taken = plate_picture(plate, pose, counted, seen_from, distance, depth)
        pictures.append(taken)
        panels.append(_plate_panel(pose, taken))
    return PlatePictures(bounces, counted, near_light_mm, plate, views[0], tuple(pictures), tuple(panels))


def _plate_panel(pose: Pose, picture: PlatePicture) -> PlatePanel:
    if not np.isfinite(picture.fields).all():
        raise UsageError(
            "the picture shows cells of one direction only: the other is too small, or not there"
        )
    ends = float(np.nanmin(picture.radiance)), float(np.nanmax(picture.radiance))
    return PlatePanel(pose.stage_deg, pose.tilt_deg, *picture.fields, *ends)


MAX_PATTERN = 4096


def read_pattern(path: Path) -> npt.NDArray[np.bool_]:
    """Dark pixels of an image: below the middle between its darkest and its brightest.

    Returns:
        (rows, cols) cells of a plate that have the second direction.

    Raises:
        UsageError: no image, one that is too large, or one of a single level.
    """
    import cv2

    try:
        data = np.frombuffer(bounded_bytes(path, MOST_PICTURE_BYTES), dtype=np.uint8)
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
