"""What the microscope pictures of the render commands show: a height map file, or ideal ridges."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from cyclopts import Parameter

from anisoscope.base.errors import UsageError

if TYPE_CHECKING:
    from anisoscope.profiles.heightmap import HeightMap
    from anisoscope.sim.light.relief import Relief

MAX_POINTS = 9_000_000
LEAST_POINTS = 8
DESIGN_PIXEL_UM = 0.5
DESIGN_FIELD_UM = 400.0
ROUGHNESS_LENGTH_UM = 8.0


@Parameter(name="*")
@dataclass(frozen=True)
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
            relief, _ = prepare_relief(surface, 100.0 if self.pitch is None else self.pitch, "none")
        else:
            from anisoscope.cli.profile.profile import parse_pixel
            from anisoscope.profiles.files.load import read_height_map

            surface, name = read_height_map(height_map, pixel_um=parse_pixel(self.pixel)), height_map.name
            relief, _ = prepare_relief(surface, self.pitch, self.level)
        cut, note = _cut(relief.surface, self.region)
        if note:
            width = (cut.shape[1] - 1) * cut.pixel_x_um
            pitch = relief.pitch_um if relief.pitch_um is not None and relief.pitch_um <= width else None
            relief = Relief(cut, pitch, 1.0)
        return Scene(relief, name, note)

    def _design(self) -> "tuple[HeightMap, str]":
        from anisoscope.profiles.defects import burrs
        from anisoscope.profiles.ideal import RidgeDesign, add_facet_roughness, ridges

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
