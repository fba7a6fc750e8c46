"""Fields of a plate: modules of a code, and directions and ridge angles that show grey pictures.

A field that is seen after a turn of the stage by φ is a field whose facets lean toward an azimuth that is greater by φ.
So a table of radiances over azimuth and ridge angle gives what every field can show at both angles; each field takes
the entry that is nearest to what the two pictures ask for. Direct light only: reflections between facet and wall add a
few percent everywhere.
"""

import importlib
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import UsageError
from anisoscope.profiles.ideal import RidgeDesign
from anisoscope.sim.light import corrected
from anisoscope.sim.light.geometry import Convention, Pose, directions
from anisoscope.sim.light.material import Material

Symbology = Literal["datamatrix", "qr"]
QUIET = {"datamatrix": 1, "qr": 4}
"""Width of the quiet zone in modules."""
FORMATS = {"datamatrix": "DataMatrix", "qr": "QRCode"}


def modules_of_code(text: str, symbology: Symbology, quiet: int | None = None) -> npt.NDArray[np.bool_]:
    """(rows, cols) dark modules of a code, first row at the top, quiet zone included.

    Encoded by zxing-cpp, in the smallest symbol that holds the text.

    Args:
        text: what it says.
        symbology: kind of code.
        quiet: width of the quiet zone in modules; that of the standard by default.

    Raises:
        UsageError: the text cannot be written in such a code.
    """
    library: Any = importlib.import_module("zxingcpp")  # compiled, without types
    try:
        barcode = library.create_barcode(text, getattr(library.BarcodeFormat, FORMATS[symbology]))
        dark = np.asarray(barcode.to_image(scale=1)) < 128
    except (ValueError, RuntimeError) as problem:
        raise UsageError(f"{text!r} cannot be written as {symbology}: {problem}") from problem
    rows, cols = np.nonzero(dark)
    symbol = dark[rows.min() : rows.max() + 1, cols.min() : cols.max() + 1]
    return np.pad(symbol, QUIET[symbology] if quiet is None else quiet)


STEP_DEG = 2.0
"""Step of the azimuths in the table."""
ANGLES_DEG = tuple(float(one) for one in np.arange(1.0, 16.01, 0.25))
"""Ridge angles in the table."""
MOST_FIELDS = 512
GREYS = 64
"""Grey levels of a picture that are distinguished when fields are chosen."""


@dataclass(frozen=True, eq=False)
class PictureDesign:
    """Fields that show pictures.

    Attributes:
        azimuth_deg: (rows, cols) toward which the facets of a field fall, first row at the top.
        ridge_angle_deg: (rows, cols).
        shown: (K, rows, cols) radiance at the stage angles in 1/sr.
        wanted: (K, rows, cols) what the pictures ask for.
        stages_deg: the K stage angles.
        similarity: (K,) SSIM of what is shown with the picture of this angle, both from black to white.
        cross_talk: (K,) weight of the other picture in what is shown, over that of its own; 0 for one picture.
    """

    azimuth_deg: FloatArray
    ridge_angle_deg: FloatArray
    shown: FloatArray
    wanted: FloatArray
    stages_deg: tuple[float, ...]
    similarity: tuple[float, ...]
    cross_talk: tuple[float, ...]


def design_pictures(
    pictures: FloatArray, stages_deg: tuple[float, ...], material: Material, light_angle_deg: float
) -> PictureDesign:
    """Choose direction and ridge angle of every field.

    Args:
        pictures: (K, rows, cols) grey from 0 to 1, K of 1 or 2.
        stages_deg: stage angle at which each is seen.
        material: the plastic.
        light_angle_deg: between light and camera.

    Raises:
        UsageError: another number of pictures, too many fields, or stage angles at which both must look the same.
    """
    count = len(pictures)
    if count not in (1, 2) or len(stages_deg) != count:
        raise UsageError(f"a plate shows one picture or two, each at a stage angle of its own, not {count}")
    if max(pictures.shape[1:]) > MOST_FIELDS:
        raise UsageError(
            f"pictures of {pictures.shape[1]} × {pictures.shape[2]} pixels are too large: a pixel is a field, at most "
            f"{MOST_FIELDS} × {MOST_FIELDS}; make them smaller"
        )
    if count == 2 and abs((stages_deg[0] - stages_deg[1] + 180.0) % 360.0 - 180.0) < 2.0 * STEP_DEG:
        raise UsageError(
            f"at {stages_deg[0]:g}° and {stages_deg[1]:g}° a plate looks the same: take stage angles farther apart"
        )
    azimuths = np.arange(-180.0, 180.0, STEP_DEG)
    table = np.array([_row(angle, azimuths, stages_deg, material, light_angle_deg) for angle in ANGLES_DEG])
    choices = table.transpose(0, 2, 1).reshape(-1, count)  # (angles · azimuths, K)
    low, high = _range(choices)
    levels = np.round(pictures * (GREYS - 1)).astype(np.int64)
    key = levels[0] if count == 1 else levels[0] * GREYS + levels[1]
    keys, where = np.unique(key, return_inverse=True)
    grey = np.stack([keys] if count == 1 else [keys // GREYS, keys % GREYS], axis=1) / (GREYS - 1)
    due = low + grey * (high - low)
    nearest = np.array([int(np.argmin(((choices - one) ** 2).sum(axis=1))) for one in due])
    chosen = nearest[where.reshape(key.shape)]
    shown = choices[chosen].transpose(2, 0, 1)
    wanted = low + pictures * (high - low)
    scaled = np.clip((shown - low) / (high - low), 0.0, 1.0)
    return PictureDesign(
        azimuths[chosen % azimuths.size],
        np.array(ANGLES_DEG)[chosen // azimuths.size],
        shown,
        wanted,
        stages_deg,
        tuple(_similar(a, b) for a, b in zip(scaled, pictures, strict=True)),
        _cross_talk(scaled, pictures),
    )


def _row(
    ridge_angle_deg: float,
    azimuths: FloatArray,
    stages_deg: tuple[float, ...],
    material: Material,
    light_angle_deg: float,
) -> FloatArray:
    """(K, azimuths) radiances of ridges that lean toward the azimuths, at the stage angles."""
    poses = tuple(Pose(float(stage + one)) for stage in stages_deg for one in azimuths)
    sides = directions(poses, Convention(light_angle_deg))
    design = RidgeDesign(100.0, ridge_angle_deg)
    return np.asarray(corrected.radiance(*sides, design, material).reshape(len(stages_deg), -1))


def _range(choices: FloatArray) -> tuple[float, float]:
    """Radiances of black and white: what a field can show at all angles at once."""
    return float(choices.max(axis=1).min()), float(choices.min(axis=1).max())


def _similar(shown: FloatArray, picture: FloatArray) -> float:
    metrics: Any = importlib.import_module("skimage.metrics")  # slow to import, without types

    side = min(7, *shown.shape)
    return float(metrics.structural_similarity(shown, picture, data_range=1.0, win_size=side - 1 + side % 2))


def _cross_talk(shown: FloatArray, pictures: FloatArray) -> tuple[float, ...]:
    """Weights of the other picture over those of the own one, by least squares."""
    if len(pictures) == 1:
        return (0.0,)
    basis = np.stack([*(one.ravel() for one in pictures), np.ones(pictures[0].size)], axis=1)
    found = []
    for number, one in enumerate(shown):
        weight = np.linalg.lstsq(basis, one.ravel(), rcond=None)[0]
        found.append(float(abs(weight[1 - number]) / max(abs(weight[number]), 1e-12)))
    return tuple(found)
