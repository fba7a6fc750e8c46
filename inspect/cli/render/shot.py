"""A microscope shot of the render commands: its pictures, and everything that is said about them."""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from cyclopts import Parameter

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import UsageError
from anisoscope.cli.console import progress
from anisoscope.cli.render.options import PictureOptions, PlasticOptions, RigOptions, answer, parse_angles
from anisoscope.cli.render.scene import Scene, SurfaceOptions

if TYPE_CHECKING:
    from anisoscope.base.progress import Advance
    from anisoscope.report.renderings import Heights, Rgb
    from anisoscope.sim.light.geometry import Convention, Pose
    from anisoscope.sim.light.material import Material
    from anisoscope.sim.light.micrograph import Lens, Micrograph
    from anisoscope.sim.light.picture import View


LEAST_PIXELS = 64


@Parameter(name="*")
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
    lens: "Lens",
    advance: "Advance",
) -> "tuple[list[Micrograph], list[float]]":
    """A micrograph of every pose, and the mean radiance of all measured facets."""
    from anisoscope.sim.light.geometry import directions
    from anisoscope.sim.light.micrograph import micrograph
    from anisoscope.sim.light.relief import radiance_maps

    maps = radiance_maps(scene.relief, *directions(poses, convention), material)
    pictures, means = [], []
    for number, (facets, view) in enumerate(zip(maps, views, strict=True)):
        advance(f"stage {poses[number].stage_deg:g}°", number, len(poses))
        means.append(float(np.nanmean(facets, dtype=np.float64)))
        pictures.append(micrograph(facets, scene.facet_um, view, lens))
    return pictures, means


class Shot:
    """Microscope pictures and everything that is said about them."""

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
        from anisoscope.sim.light.geometry import Pose

        self.picture, self.plastic = picture, plastic or PlasticOptions()
        self.rig, self.microscope = rig or RigOptions(), microscope or MicroscopeOptions()
        picture.check(height_map)
        self.poses = tuple(Pose(angle, self.rig.tilt) for angle in parse_angles(stage, "--stage"))
        self.convention, lens = self.rig.convention(), self.microscope.lens()
        material = self.plastic.material()
        self.scene: Scene = (surface or SurfaceOptions()).scene(height_map)
        self.views = self.microscope.views(self.scene, self.poses, self.convention, picture.panel)
        with progress("render", quiet=picture.json_) as advance:
            self.frames, self.means = take_frames(
                self.scene, material, self.poses, self.convention, self.views, lens, advance
            )
        self.pictures: list[FloatArray] = [p.radiance.astype(np.float64) for p in self.frames]
        self.white = picture.brightest(self.pictures, 99.5)

    def caption(self) -> list[str]:
        """What stands below the pictures."""
        what = self.scene.name + (f"; {self.scene.note}" if self.scene.note else "")
        missing = self.scene.relief.missing_share
        gaps = f" {100 * missing:.2g} % of the facets were not measured." if missing else ""
        surface = (
            f"{what}. Relief model, direct light; roughness below the map's resolution {self.plastic.alpha_along:g} "
            f"along and {self.plastic.alpha_across:g} across, albedo {self.plastic.albedo:g}.{gaps}"
        )
        return [
            surface,
            self.microscope.sentence(self.views[0], self.scene),
            self.rig.sentence(),
            self.picture.exposure_sentence(self.pictures, self.white),
        ]

    def answer(self) -> None:
        """Print what was rendered."""
        from anisoscope.sim.light.contrasts import contrasts

        view = self.views[0]
        ratios = contrasts(self.poses, np.array(self.means))
        panels: list[dict[str, Any]] = [
            {
                "stage_deg": pose.stage_deg,
                "tilt_deg": pose.tilt_deg,
                "mean_of_surface": mean,
                "mean_of_picture": _mean(p),
                "missing_pixels": float(p.missing.mean()),
            }
            for pose, p, mean in zip(self.poses, self.frames, self.means, strict=True)
        ]
        found = {
            "model": "relief",
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
    """Heights in colours, with what is missing and what is beyond the map."""
    from anisoscope.report.renderings import BEYOND_RGB, MISSING_RGB, height_colours

    pixels = height_colours(heights, low, high)
    pixels[~np.isfinite(heights)] = MISSING_RGB
    pixels[~found.covered] = BEYOND_RGB
    return pixels


def cut_line(
    cut: float | None, view: "View", heights: FloatArray, found: "Micrograph", ends: tuple[float, float]
) -> "Heights":
    """Colour scale of the heights and, if asked for, the profile along a line.

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
