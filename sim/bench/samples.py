"""Whole virtual samples: the surface that lies on the stage."""

import numpy as np

from anisoscope.profiles.defects import burrs
from anisoscope.profiles.files.load import read_height_map
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.profiles.ideal import RidgeDesign, add_facet_roughness, ridges
from anisoscope.sim.bench.benchfile import MaterialPart, SamplePart
from anisoscope.sim.light.material import Material
from anisoscope.sim.light.relief import Relief

PIXEL_X_UM = 1.0
PIXEL_Y_UM = 2.0


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
