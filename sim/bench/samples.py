"""Virtual samples on the stage, as the bench photographs them.

A new kind of sample is a class with the two members of `Sample` in a module of its own, a table of its own in the bench
file (`SamplePart`), a word for it in ``SamplePart.kind``, and a line in `build_sample`. It need not know of poses,
seating, lens, lamp level or noise: these are the bench's.
"""

from typing import Protocol

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.profiles.defects import burrs
from anisoscope.profiles.files.load import read_height_map
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.profiles.ideal import RidgeDesign, add_facet_roughness, ridges
from anisoscope.sim.bench.benchfile import BenchFile, MaterialPart, SamplePart
from anisoscope.sim.bench.printpart import PrintPart
from anisoscope.sim.bench.prints import PrintSample
from anisoscope.sim.light.material import Material
from anisoscope.sim.light.relief import Relief, radiance_maps

Image = npt.NDArray[np.float32]

PIXEL_X_UM = 1.0
PIXEL_Y_UM = 2.0


class Sample(Protocol):
    """A sample on the stage, centred on its axis.

    A perfect white diffuser that faces the lamp has the radiance 1/π, in every channel alike. So a grey sample is
    equally bright in all channels; how much less light one colour filter passes than another is not the sample's
    affair (`anisoscope.sim.bench.sensor`).
    """

    @property
    def pixel_um(self) -> tuple[float, float]:
        """Size (y, x) of the pixels of `radiance`."""
        ...

    def radiance(self, to_light: FloatArray, to_camera: FloatArray) -> Image:
        """(channels, rows, cols) radiance in the sample's own frame; row index rises with +y, NaN is not known.

        One channel for a sample that is grey, or a camera without colour filters; otherwise three: red, green, blue,
        each the mean over wavelengths under the bench's lamp as the filter of that colour weighs them
        (`anisoscope.sim.light.colour.vision.Vision.weights`).

        Args:
            to_light: (3,) unit vector in the frame of the sample as it is seated.
            to_camera: (3,) likewise.
        """
        ...


class ReliefSample:
    """A height map of plastic: grey."""

    def __init__(self, relief: Relief, material: Material) -> None:
        self.relief, self.material = relief, material

    @property
    def pixel_um(self) -> tuple[float, float]:
        """Size (y, x) of a facet."""
        return self.relief.surface.pixel_y_um, self.relief.surface.pixel_x_um

    def radiance(self, to_light: FloatArray, to_camera: FloatArray) -> Image:
        """(1, rows, cols) radiance of every facet."""
        shown = next(radiance_maps(self.relief, to_light[None], to_camera[None], self.material))
        return np.asarray(shown[None], dtype=np.float32)


def build_sample(file: BenchFile, rng: np.random.Generator) -> Sample:
    """The sample of a bench, but for a white tile, which has no edges and fills the picture.

    Raises:
        HeightMapError: the file of a height map cannot be read.
        RigFileError: what the bench file names cannot be used.
    """
    part = file.sample
    if part.kind == "print":
        return PrintSample(part.print or PrintPart(), part.size_mm, file.optics.pixel_um, file.vision(), rng)
    if part.kind == "wafer":
        from anisoscope.sim.bench.wafer import build_wafer  # noqa: PLC0415 - of one kind of sample only

        assert part.wafer is not None  # the bench file's own check
        return build_wafer(part.wafer, part.size_mm, rng)
    return ReliefSample(build_surface(part, rng), plastic(part.material))


def plastic(part: MaterialPart) -> Material:
    """The material that a bench file describes."""
    return Material(part.alpha_along, part.alpha_across, part.albedo, part.index)


def build_surface(part: SamplePart, rng: np.random.Generator) -> Relief:
    """The surface of a sample, as large as the sample, in whole pitches.

    Raises:
        HeightMapError: the file cannot be read.
    """
    if part.kind == "height-map":
        assert part.file is not None  # the bench file's own check
        return Relief(_repeat(read_height_map(part.file), part))
    pitches = max(1, int(part.size_mm * 1000.0 // part.pitch_um))
    cols = round(pitches * part.pitch_um / PIXEL_X_UM) + 1
    rows = round(part.size_mm * 1000.0 / PIXEL_Y_UM) + 1
    design = RidgeDesign(pitch_um=part.pitch_um, ridge_angle_deg=part.ridge_angle_deg)
    surface = ridges(design, (rows, cols), (PIXEL_Y_UM, PIXEL_X_UM))
    if part.resolved_alpha > 0:
        alpha = part.resolved_alpha
        surface = add_facet_roughness(
            surface, alpha_along=alpha, alpha_across=alpha, correlation_um=part.correlation_um, rng=rng
        )
    if part.burr_coverage > 0:
        surface = burrs(surface, part.burr_coverage, pitch_um=part.pitch_um, rng=rng).map
    return Relief(surface, part.pitch_um)


def _repeat(surface: HeightMap, part: SamplePart) -> HeightMap:
    """Lay copies of a map side by side, every other one mirrored so that heights meet, up to the sample's size."""
    tile = surface.height_um
    tall = np.concatenate([tile, tile[::-1]])
    size_um = part.size_mm * 1000.0
    rows, cols = (round(size_um / pixel) + 1 for pixel in (surface.pixel_y_um, surface.pixel_x_um))
    repeats = -(-rows // tall.shape[0]), -(-cols // tall.shape[1])
    return surface.with_height(np.tile(tall, repeats)[:rows, :cols])
