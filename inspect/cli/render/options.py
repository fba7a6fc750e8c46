"""Options that the render commands share, and how their files are checked and written."""

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
import numpy.typing as npt
from cyclopts import Parameter

from anisoscope.base.arrays import FloatArray
from anisoscope.base.atomic_write import write_bytes
from anisoscope.base.errors import RecordError, UsageError
from anisoscope.cli.json_output import print_json
from anisoscope.cli.options import Json

if TYPE_CHECKING:
    from anisoscope.report.renderings import Rgb
    from anisoscope.sim.light.geometry import Convention
    from anisoscope.sim.light.material import Material


MAX_PANELS = 8
RAW_SUFFIXES = (".npy", ".tif", ".tiff")


@Parameter(name="*")
@dataclass(frozen=True)
class PlasticOptions:
    """The plastic."""

    alpha_along: Annotated[float, Parameter(help="Beckmann roughness along the ridges.")] = 0.06
    alpha_across: Annotated[float, Parameter(help="Beckmann roughness across the ridges.")] = 0.10
    albedo: Annotated[float, Parameter(help="Diffuse albedo of the plastic, 0 to 1.")] = 0.2
    index: Annotated[float, Parameter(help="Refractive index of the plastic.")] = 1.5

    def material(self) -> "Material":
        """The plastic of the options."""
        from anisoscope.sim.light.material import Material

        return Material(self.alpha_along, self.alpha_across, self.albedo, self.index)


@Parameter(name="*")
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
        from anisoscope.sim.light.geometry import Convention

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
