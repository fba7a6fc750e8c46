"""Fields of a plate: modules of a code, and classes of fields that show grey pictures.

A field that is seen after a turn of the stage by φ is a field whose facets lean toward an azimuth that is greater by φ.
So a table of radiances over azimuth and ridge angle holds what a field can show at both stage angles: the joint gamut.
Black and white are the ends of the widest range of radiance of which every pair of greys, one at each stage angle, is
in the gamut; between them greys are proportional to radiance. Fields are grouped into classes by the greys that they
ask for (k-means), so that common greys are shown most exactly; a class is one direction and one ridge angle.

Direct light only: reflections between facet and wall add a few percent everywhere.
"""

import importlib
import string
import warnings
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import HeightMapError, UsageError
from anisoscope.parameters.geometry import Convention, Pose
from anisoscope.parameters.material import Material
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.profiles.plates import MOST_FIELDS, Plan, inner_share
from anisoscope.sim.design.toolpath import Tool
from anisoscope.sim.light import corrected
from anisoscope.sim.light.geometry import directions

Symbology = Literal["datamatrix", "qr"]
QUIET = {"datamatrix": 1, "qr": 4}
"""Width of the quiet zone in modules."""
SHOWN = 40
"""Characters of a text that a message repeats."""
FORMATS = {"datamatrix": "DataMatrix", "qr": "QRCode"}


def modules_of_code(text: str, symbology: Symbology, quiet: int | None = None) -> npt.NDArray[np.bool_]:
    """(rows, cols) dark modules of a code, first row at the top, quiet zone included.

    Encoded by zxing-cpp, in the smallest symbol that holds the text; of Data Matrices the smallest square one, because
    many readers do not know the long rectangles (ISO/IEC 21471).

    Args:
        text: what it says.
        symbology: kind of code.
        quiet: width of the quiet zone in modules; that of the standard by default.

    Raises:
        UsageError: the text cannot be written in such a code.
    """
    library: Any = importlib.import_module("zxingcpp")  # compiled, without types
    try:
        square = {"force_square": True} if symbology == "datamatrix" else {}
        barcode = library.create_barcode(text, getattr(library.BarcodeFormat, FORMATS[symbology]), **square)
        dark = np.asarray(barcode.to_image(scale=1)) < 128
    except (ValueError, RuntimeError) as problem:
        shown = repr(text) if len(text) <= SHOWN else f"{text[:SHOWN]!r} … ({len(text)} characters)"
        raise UsageError(f"{shown} cannot be written as {symbology}: {problem}") from problem
    rows, cols = np.nonzero(dark)
    symbol = dark[rows.min() : rows.max() + 1, cols.min() : cols.max() + 1]
    return np.pad(symbol, QUIET[symbology] if quiet is None else quiet)


STEP_DEG = 1.5
"""Step of the azimuths in the table."""
ANGLES_DEG = tuple(float(one) for one in np.arange(10, 161) / 10.0)
"""Ridge angles in the table."""
LETTERS = (
    *string.ascii_uppercase, *string.ascii_lowercase, *string.digits, "+", "*",
    *(chr(one) for one in range(0x100, 0x1C0)),
)  # fmt: skip
"""Letters of classes: the first 64 in every font."""
CLASSES = 64
LEAST_PITCH_UM, LEAST_DRAFT_DEG = 50.0, 1.0
GRID, MISSED = 9, 0.03
"""Greys a picture of which all combinations are tried, and how far they may be off, over the range of radiance."""
ROUNDS = 20
"""Of the grouping of greys."""
LEAST_CONTRAST = 1.5
"""White over black."""
TRIED = 32
"""Black and white points that are tried."""


def check_mould(design: RidgeDesign, tool: Tool | None = None) -> None:
    """Check that a part with such ridges leaves its mould, and that a tool cuts the insert.

    Raises:
        UsageError: a draft below 1°, or a tool that does not reach the walls.
    """
    draft = float(np.degrees(design.draft_rad))
    if draft < LEAST_DRAFT_DEG * (1.0 - 1e-9):
        raise UsageError(
            f"walls with a draft of {draft:g}° hold the part in its mould, {LEAST_DRAFT_DEG:g}° is needed: give a "
            "larger --draft"
        )
    if tool is not None:
        tool.check(design)


def check_picture_ridges(design: RidgeDesign, field_um: float) -> None:
    """Check what fields of pictures must keep to.

    Raises:
        UsageError: a pitch below 50 µm, fields that hold no whole number of ridges, or a draft below 1°.
    """
    pitch = design.pitch_um
    if pitch < LEAST_PITCH_UM:
        raise UsageError(
            f"--pitch must be {LEAST_PITCH_UM:g} µm or more, not {pitch:g}: finer ridges diffract, and are not milled"
        )
    ridges = field_um / pitch
    if ridges >= 2.0 and abs(ridges - round(ridges)) > 1e-6:
        low = int(ridges) * pitch
        raise UsageError(
            f"fields of {field_um:g} µm hold {ridges:.2f} ridges of {pitch:g} µm: make them {low:g} or "
            f"{low + pitch:g} µm wide, so that they hold whole ridges"
        )
    check_mould(design)


@dataclass(frozen=True, eq=False)
class PictureDesign:
    """Fields that show pictures.

    Attributes:
        plan: the fields, a class for every pair of grey levels that occurs.
        shown: (K, rows, cols) radiance at the stage angles in 1/sr.
        wanted: (K, rows, cols) what the pictures ask for.
        stages_deg: the K stage angles.
        black, white: radiances of both in 1/sr.
        missed: largest distance of a class from the greys that it stands for, over the range from black to white.
    """

    plan: Plan
    shown: FloatArray
    wanted: FloatArray
    stages_deg: tuple[float, ...]
    black: float
    white: float
    missed: float

    def likeness(self, radiance: FloatArray | None = None) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """SSIM of each picture, and cross-talk, of radiances (K, rows, cols) of fields; of those designed if None.

        Radiances are scaled from black to white. The cross-talk is the weight of the other picture in what is shown
        over that of its own, by least squares over all fields with a constant; 0 for one picture.
        """
        span = self.white - self.black
        shown = np.clip(((self.shown if radiance is None else radiance) - self.black) / span, 0.0, 1.0)
        pictures = (self.wanted - self.black) / span
        similar = tuple(_similar(a, b) for a, b in zip(shown, pictures, strict=True))
        return similar, _cross_talk(shown, pictures)


@dataclass(frozen=True, eq=False)
class Gamut:
    """Range of radiances of a field over all stage angles.

    Attributes:
        radiance: (N, K) in 1/sr.
        azimuth_deg, ridge_angle_deg: (N,) of the facets.
    """

    radiance: FloatArray
    azimuth_deg: FloatArray
    ridge_angle_deg: FloatArray

    @cached_property
    def _tree(self) -> Any:  # noqa: ANN401 - of scipy
        spatial: Any = importlib.import_module("scipy.spatial")  # slow to import
        return spatial.KDTree(self.radiance)

    def nearest(
        self, grey: FloatArray, black: float, white: float
    ) -> tuple[npt.NDArray[np.intp], FloatArray]:
        """Numbers of the entries that are nearest to greys (M, K) from 0 to 1, and (M,) how far they are off."""
        distance, number = self._tree.query(black + grey * (white - black))
        return np.asarray(number), np.asarray(distance) / (white - black)


def gamut(
    design: RidgeDesign,
    field_um: float,
    stages_deg: tuple[float, ...],
    material: Material,
    light_angle_deg: float,
) -> Gamut:
    """The joint gamut of ridges.

    Args:
        design: ridges whose azimuth and ridge angle are free.
        field_um: side of a field; its drafted border shows nothing.
        stages_deg: K stage angles.
        material: the plastic.
        light_angle_deg: between light and camera.

    """
    azimuths = np.arange(-180.0, 180.0, STEP_DEG)
    rows, angles = [], []
    for angle in ANGLES_DEG:
        try:
            ridges = replace(design, ridge_angle_deg=angle)
        except HeightMapError:  # the tool leaves no facet
            continue
        rows.append(
            _row(ridges, azimuths, stages_deg, material, light_angle_deg) * inner_share(ridges, field_um)
        )
        angles.append(angle)
    radiance = np.array(rows).transpose(0, 2, 1).reshape(-1, len(stages_deg))
    return Gamut(radiance, np.tile(azimuths, len(angles)), np.repeat(angles, azimuths.size))


def black_and_white(reach: Gamut) -> tuple[float, float]:
    """Ends of the widest range of radiance of which every combination of greys is in the gamut.

    Raises:
        UsageError: there is none.
    """
    count = reach.radiance.shape[1]
    pairs = np.stack(np.meshgrid(*[np.linspace(0.0, 1.0, GRID)] * count, indexing="ij"), axis=-1).reshape(
        -1, count
    )
    lowest, highest = float(reach.radiance.max(axis=1).min()), float(reach.radiance.min(axis=1).max())
    tried = np.linspace(lowest, highest, TRIED).tolist()
    for span in range(TRIED - 1, 0, -1):
        for black, white in zip(tried, tried[span:], strict=False):
            if (
                white >= LEAST_CONTRAST * black
                and float(reach.nearest(pairs, black, white)[1].max()) <= MISSED
            ):
                return black, white
    raise UsageError(
        f"no field is {LEAST_CONTRAST:g} times as bright at one stage angle as another one, and as dark at the other: "
        "take stage angles farther apart, or a plastic with a narrower lobe"
    )


def design_pictures(
    pictures: FloatArray,
    stages_deg: tuple[float, ...],
    design: RidgeDesign,
    field_um: float,
    material: Material,
    light_angle_deg: float,
    classes: int = CLASSES,
) -> PictureDesign:
    """Choose direction and ridge angle of every field.

    Args:
        pictures: (K, rows, cols) grey from 0 to 1, K of 1 or 2.
        stages_deg: stage angle at which each is seen.
        design: ridges whose azimuth and ridge angle are free.
        field_um: side of a field.
        material: the plastic.
        light_angle_deg: between light and camera.
        classes: largest number of classes.

    Raises:
        UsageError: another number of pictures or classes, too many fields, ridges that `check_picture_ridges` refuses,
            or stage angles at which both must look the same.
        HeightMapError: fields hold less than two ridges.
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
    if not 2 <= classes <= len(LETTERS):
        raise UsageError(f"--class-count must be 2 to {len(LETTERS)}, not {classes}")
    check_picture_ridges(design, field_um)
    reach = gamut(design, field_um, stages_deg, material, light_angle_deg)
    black, white = black_and_white(reach)
    grey, number = _grouped(pictures.reshape(count, -1).T, classes)
    entry, missed = reach.nearest(grey, black, white)
    letters = np.array(LETTERS[: len(grey)])
    plan = Plan(
        tuple("".join(row) for row in letters[number].reshape(pictures.shape[1:])),
        dict(zip(letters.tolist(), reach.azimuth_deg[entry].tolist(), strict=True)),
        1e-3 * field_um,
        dict(zip(letters.tolist(), reach.ridge_angle_deg[entry].tolist(), strict=True)),
    )
    plan.check_ridges(design.pitch_um)
    return PictureDesign(
        plan,
        reach.radiance[entry[number]].T.reshape(pictures.shape),
        black + pictures * (white - black),
        stages_deg,
        black,
        white,
        float(missed.max()),
    )


def _grouped(greys: FloatArray, most: int) -> tuple[FloatArray, npt.NDArray[np.intp]]:
    """(C, K) greys of classes from dark to bright at the first angle, and (N,) class of each of (N, K) greys."""
    values, number = np.unique(greys, axis=0, return_inverse=True)
    if len(values) > most:
        vq: Any = importlib.import_module("scipy.cluster.vq")  # slow to import
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # an empty class is left out below
            values, number = vq.kmeans2(greys, most, minit="++", rng=np.random.default_rng(0), iter=ROUNDS)
    used, number = np.unique(number.ravel(), return_inverse=True)
    values = values[used]
    order = np.lexsort(values.T[::-1])
    return values[order], np.asarray(np.argsort(order)[number.ravel()])


def _row(
    design: RidgeDesign,
    azimuths: FloatArray,
    stages_deg: tuple[float, ...],
    material: Material,
    light_angle_deg: float,
) -> FloatArray:
    """(K, azimuths) radiances of ridges that lean toward the azimuths, at the stage angles.

    Light and camera are in one plane, so that both senses of an azimuth show the same.
    """
    seen = np.abs((np.add.outer(stages_deg, azimuths) + 180.0) % 360.0 - 180.0)
    angles, number = np.unique(np.round(seen, 9), return_inverse=True)
    sides = directions(tuple(Pose(float(one)) for one in angles), Convention(light_angle_deg))
    return np.asarray(corrected.radiance(*sides, design, material)[number.reshape(seen.shape)])


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
