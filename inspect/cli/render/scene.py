"""Scene of the render commands: surface, light, exposure, and the pictures written."""

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
import numpy.typing as npt
from cyclopts import Group, Parameter

from anisoscope.base.arrays import FloatArray
from anisoscope.base.atomic_write import write_bytes
from anisoscope.base.errors import RecordError, UsageError
from anisoscope.cli.help_page import everyday
from anisoscope.cli.json_output import print_json
from anisoscope.cli.options import Json, RecipeOption

if TYPE_CHECKING:
    from anisoscope.parameters.geometry import Convention
    from anisoscope.parameters.material import Material
    from anisoscope.report.renderings import Rgb
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from anisoscope.profiles.heightmap import HeightMap
    from anisoscope.sim.light.relief import Relief


MAX_PANELS = 8
PLASTIC = Group("Plastic", sort_key=20)
LIGHT = Group("Light and camera angles", sort_key=21)
MICROSCOPE = Group("Microscope", sort_key=22)
RAW_SUFFIXES = (".npy", ".tif", ".tiff")


@Parameter(name="*", group=PLASTIC)
@dataclass(frozen=True)
class PlasticOptions:
    """The plastic."""

    recipe: RecipeOption = None
    alpha_along: Annotated[float, Parameter(help="Beckmann roughness along the ridges.")] = 0.06
    alpha_across: Annotated[float, Parameter(help="Beckmann roughness across the ridges.")] = 0.10
    albedo: Annotated[float, Parameter(help="Diffuse albedo of the plastic, 0 to 1.")] = 0.2
    index: Annotated[float, Parameter(help="Refractive index of the plastic.")] = 1.5

    def material(self) -> "Material":
        """The plastic of the options."""
        from anisoscope.parameters.material import Material

        return Material(self.alpha_along, self.alpha_across, self.albedo, self.index)


@Parameter(name="*", group=LIGHT)
@dataclass(frozen=True)
class RigOptions:
    """Light and camera."""

    tilt: Annotated[float, Parameter(help="Tilt of camera and light in degrees (--tilt=-10).")] = 0.0
    light_angle: Annotated[float, Parameter(help="Angle between light and camera in degrees.")] = 10.0
    tilt_plane: Annotated[
        Literal["perpendicular", "in-plane"], Parameter(help="Plane in which camera and light tilt.")
    ] = "perpendicular"
    facet_azimuth: Annotated[float, Parameter(help="Azimuth toward which the facets lean at 0°.")] = 0.0

    def convention(self) -> "Convention":
        """Angle convention."""
        from anisoscope.parameters.geometry import Convention

        return Convention(self.light_angle, self.tilt_plane, self.facet_azimuth)

    def sentence(self) -> str:
        """Light, camera and tilt in words."""
        side = "right" if self.light_angle >= 0 else "left"
        azimuth = f", facets toward {self.facet_azimuth:g}° at stage 0°" if self.facet_azimuth else ""
        return (
            f"Light {abs(self.light_angle):g}° to the {side} of the camera; both tilted by {degrees(self.tilt)} "
            f"(tilt plane {self.tilt_plane}){azimuth}. "
            "Stage angles turn the sample counter-clockwise. Parallel projection."
        )


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

    def as_json(self, pictures: Sequence[FloatArray], white: float) -> dict[str, Any]:
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
    from anisoscope.cli.options import parse_numbers

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
    picture: PictureOptions, found: dict[str, Any], title: str, columns: list[str], rows: list[list[str]]
) -> None:
    """Print JSON, or a table and the written files."""
    from anisoscope.cli.tables import console, print_table

    if picture.json_:
        print_json(found)
        return
    print_table(title, columns, rows)
    files = [str(path) for path in (picture.out, picture.raw) if path is not None]
    console().print(f"written: {', '.join(files)}", markup=False, highlight=False, soft_wrap=True)


MAX_POINTS = 9_000_000
LEAST_POINTS = 8
DESIGN_PIXEL_UM = 0.5
DESIGN_FIELD_UM = 400.0
ROUGHNESS_LENGTH_UM = 8.0


@Parameter(name="*")
@dataclass(frozen=True)
@everyday("ridge_angle", "pitch", "region", "pixel")
class SurfaceOptions:
    """The surface: a file, or ideal ridges."""

    ridge_angle: Annotated[float | None, Parameter(help="Ridge angle of ideal ridges in degrees.")] = None
    pitch: Annotated[float | None, Parameter(help="Pitch in µm, of ideal ridges (100) or of the map.")] = None
    wall: Annotated[Literal["perpendicular", "vertical"], Parameter(help="Wall of an ideal ridge.")] = (
        "perpendicular"
    )
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

    def scene(self, height_map: Path | None) -> "Scene":
        """Read or make the surface, level it, and cut out the rendered region.

        Raises:
            UsageError: options that make no sense together.
            HeightMapError: a map that cannot be read or used.
        """
        from anisoscope.prediction.relief_preparation import prepare_relief
        from anisoscope.sim.light.relief import Relief

        if (height_map is None) == (self.ridge_angle is None):
            raise UsageError("give either a height map file or --ridge-angle of ideal ridges")
        if height_map is not None and (self.rough or self.burrs):
            raise UsageError(
                "--rough and --burrs belong to ideal ridges (--ridge-angle), not to a height map"
            )
        if height_map is None:
            surface, name = self._design()
            relief, _ = prepare_relief(
                surface, 100.0 if self.pitch is None else self.pitch, "none", placed=False
            )
        else:
            from anisoscope.cli.profile.profile import parse_pixel
            from anisoscope.profiles.files.load import read_height_map

            surface, name = read_height_map(height_map, pixel_um=parse_pixel(self.pixel)), height_map.name
            relief, _ = prepare_relief(surface, self.pitch, self.level, placed=False)
        cut, note = _cut(relief.surface, self.region)
        if note:
            width = (cut.shape[1] - 1) * cut.pixel_x_um
            pitch = relief.pitch_um if relief.pitch_um is not None and relief.pitch_um <= width else None
            relief = Relief(cut, pitch, 1.0, direction_deg=relief.direction_deg)
        return Scene(relief, name, note)

    def _design(self) -> "tuple[HeightMap, str]":
        from anisoscope.parameters.ridges import RidgeDesign
        from anisoscope.profiles.defects import burrs
        from anisoscope.profiles.ideal import add_facet_roughness, ridges

        if not 0.0 <= self.burrs <= 0.5:
            raise UsageError(f"--burrs takes a share of 0 to 0.5, not {self.burrs:g}")
        if not 0.0 <= self.rough <= 0.5:
            raise UsageError(f"--rough takes a roughness of 0 to 0.5, not {self.rough:g}")
        if self.seed < 0:
            raise UsageError(f"--seed takes a whole number from 0 on, not {self.seed}")
        assert self.ridge_angle is not None
        pitch = 100.0 if self.pitch is None else self.pitch
        design = RidgeDesign(pitch, self.ridge_angle, wall=self.wall)
        unit = pitch / 100.0  # four ridges, whatever their pitch
        points = round(DESIGN_FIELD_UM / DESIGN_PIXEL_UM) + 1
        surface = ridges(design, (points, points), DESIGN_PIXEL_UM * unit)
        rng = np.random.default_rng(self.seed)
        if self.rough:
            surface = add_facet_roughness(surface, self.rough, self.rough, ROUGHNESS_LENGTH_UM, rng)
        if self.burrs:
            surface = burrs(surface, self.burrs, pitch_um=pitch, rng=rng).map
        words = f"Ideal ridges, {self.ridge_angle:g}°, pitch {pitch:g} µm, {self.wall} wall"
        if self.rough:
            words += f", heights of roughness α = {self.rough:g}"
        if self.burrs:
            words += f", burrs on {100 * self.burrs:g} %"
        return surface, words


@dataclass(frozen=True)
class Scene:
    """Rendered surface with its material and sampling.

    Attributes:
        relief: the surface.
        name: the file, or the design in words.
        note: what was cut out, or empty.
    """

    relief: "Relief"
    name: str
    note: str

    @property
    def facet_um(self) -> tuple[float, float]:
        """Size of a facet (y, x)."""
        return self.relief.surface.pixel_y_um, self.relief.surface.pixel_x_um

    @property
    def size_um(self) -> tuple[float, float]:
        """(along y, along x) of all facets."""
        rows, cols = self.relief.surface.shape
        return (rows - 1) * self.facet_um[0], (cols - 1) * self.facet_um[1]

    def as_json(self) -> dict[str, Any]:
        """The scene, for the JSON."""
        return {
            "surface": self.name,
            "size_um": list(self.size_um),
            "facet_um": list(self.facet_um),
            "missing_share": self.relief.missing_share,
            "cut": self.note or None,
        }


def _cut(surface: "HeightMap", region: str | None) -> "tuple[HeightMap, str]":
    """Rendered region and its description: the given region, or the middle of a large map."""
    rows, cols = surface.shape
    full = f"{(cols - 1) * surface.pixel_x_um:g} × {(rows - 1) * surface.pixel_y_um:g} µm"
    if region is None:
        if rows * cols <= MAX_POINTS:
            return surface, ""
        share = np.sqrt(MAX_POINTS / (rows * cols))
        height, width = max(int(rows * share), LEAST_POINTS), max(int(cols * share), LEAST_POINTS)
        top, left = (rows - height) // 2, (cols - width) // 2
        bottom, right = top + height, left + width
        reason = (
            f"the map has {rows * cols / 1e6:.3g} million points; --region X0,Y0,X1,Y1 shows another part"
        )
    else:
        from anisoscope.cli.options import parse_numbers

        corners = parse_numbers(region, "--region")
        if len(corners) != 4 or corners[0] >= corners[2] or corners[1] >= corners[3]:
            raise UsageError(
                f"--region takes X0,Y0,X1,Y1 in µm with X0 < X1 and Y0 < Y1, such as 0,0,300,200, not {region!r}"
            )
        left, right = _range(corners[0], corners[2], surface.pixel_x_um, cols)
        top, bottom = _range(corners[1], corners[3], surface.pixel_y_um, rows)
        if min(right - left, bottom - top) < LEAST_POINTS:
            raise UsageError(
                f"--region {region} holds fewer than {LEAST_POINTS} points a side of this map of {full}"
            )
        if (right - left) * (bottom - top) > MAX_POINTS:
            raise UsageError(
                f"--region {region} holds {(right - left) * (bottom - top) / 1e6:.3g} million points; "
                f"at most {MAX_POINTS / 1e6:g} million are rendered"
            )
        reason = ""
    cut = surface.with_height(surface.height_um[top:bottom, left:right])
    ends = [left * surface.pixel_x_um, (right - 1) * surface.pixel_x_um]
    ends += [top * surface.pixel_y_um, (bottom - 1) * surface.pixel_y_um]
    note = f"x {ends[0]:g} to {ends[1]:g} µm, y {ends[2]:g} to {ends[3]:g} µm of {full}"
    return cut, f"{note} ({reason})" if reason else note


def _range(low: float, high: float, pixel: float, count: int) -> tuple[int, int]:
    first, last = np.clip([np.ceil(low / pixel - 1e-9), np.floor(high / pixel + 1e-9) + 1], 0, count)
    return int(first), int(last)
