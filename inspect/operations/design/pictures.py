"""Etched surfaces whose angular reflectance is a picture: targets, holograms, and photographs of their lobes."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.csv_table import read_table
from anisoscope.base.errors import UsageError
from anisoscope.base.json_fields import LEFT_OUT, in_json, json_field
from anisoscope.base.progress import Advance, silent
from anisoscope.base.regular_file import MOST_PICTURE_BYTES, bounded_bytes
from anisoscope.operations.design.pages import draw_panels
from anisoscope.parameters.etching import MARKS, LobePhoto, StepMixture
from anisoscope.parameters.fabrication import Fabrication, HologramSearch
from anisoscope.parameters.keywords import by_keywords
from anisoscope.sim.design.appearance import (
    Grid,
    LobeComparison,
    Screen,
    compared_lobes,
    designed_intensity,
    photographed_intensity,
)
from anisoscope.sim.design.depths import Depths
from anisoscope.sim.design.designfile import DesignFile, read_design, read_layout
from anisoscope.sim.design.gradient import BAND_NM, Judged, PictureTask, design_picture, judged
from anisoscope.sim.design.layout import Layout
from anisoscope.sim.design.targets import TargetDesign, TargetTask, design_target, radial_target
from anisoscope.sim.light.colour.illuminant import Illuminant
from anisoscope.sim.light.colour.observer import matching_functions
from anisoscope.sim.light.colour.spaces import SRGB_WHITE
from anisoscope.sim.light.wave.windows import Extent
from anisoscope.sim.materials.spectra import find_illuminant
from anisoscope.sim.proof.separation import decode_srgb

POINTS = 121
HOLOGRAM = Fabrication(550.0, min_width_um=0.5, grid_um=0.001)  # cells are the grid


def read_image(path: Path, *, colour: bool = False, others: str = "") -> npt.NDArray[np.uint8]:
    """An image as (rows, cols) grey values, or as (rows, cols, 3) blue, green and red; 0 to 255.

    Args:
        path: a PNG, TIFF or JPEG.
        colour: three channels.
        others: what else the option takes, for the message.

    Raises:
        UsageError: the file cannot be read, or is none.
    """
    try:
        data = np.frombuffer(bounded_bytes(path, MOST_PICTURE_BYTES), dtype=np.uint8)
    except OSError as error:
        raise UsageError(f"{path}: cannot be read ({error.strerror}); check the path") from None
    found = cv2.imdecode(data, cv2.IMREAD_COLOR if colour else cv2.IMREAD_GRAYSCALE) if data.size else None
    if found is None:
        raise UsageError(f"{path}: not a picture; give a PNG, TIFF or JPEG{others}")
    return np.asarray(found, dtype=np.uint8)


def read_target(path: Path, reach: float) -> FloatArray:
    """(121, 121) target of one file, its largest value 1.

    Args:
        path: grey picture over h, or CSV h,density of a radial profile.
        reach: largest ``|h_x|`` and ``|h_y|``.

    Raises:
        UsageError: it cannot be read, or wants no light.
    """
    if path.suffix.lower() == ".csv":
        table = read_table(path, (("h", "density"),), not_negative=("h", "density"))
        found = radial_target(table.column("h"), table.column("density"), POINTS, reach)
    else:
        grey = read_image(path, others=", or a CSV h,density")
        side = min(grey.shape)
        top, left = (grey.shape[0] - side) // 2, (grey.shape[1] - side) // 2
        square = grey[top : top + side, left : left + side].astype(np.float64)
        how = cv2.INTER_AREA if side > POINTS else cv2.INTER_LINEAR
        small = cv2.resize(square, (POINTS, POINTS), interpolation=how)
        found = np.asarray(small[::-1], dtype=np.float64)
    if float(found.max()) <= 0.0:
        raise UsageError(f"{path}: wants no light at |h| up to {reach:g}")
    return np.asarray(found / found.max(), dtype=np.float64)


def _keys_of(design: DesignFile) -> dict[str, Any]:
    """Name, depths, and what is missed, for JSON."""
    return {"name": design.name, "depths_nm": design.passes_nm, **design.figures}


@dataclass(frozen=True)
class EtchedPicture:
    """The mixture of step structures whose reflectance comes closest to a picture.

    Attributes:
        found: shares, structures and what is missed.
        design: the same as a design file.
    """

    found: TargetDesign = field(metadata=LEFT_OUT)
    design: DesignFile = field(metadata=json_field(by=_keys_of, merged=True))

    @property
    @in_json()
    def parts(self) -> list[dict[str, Any]]:
        """Structures with their shares of the area."""
        pairs = zip(self.found.shares, self.found.models, strict=True)
        return [{"share": share, **model.model_dump(mode="json")} for share, model in pairs]


@by_keywords(mixture=StepMixture)
def etched_picture(
    targets: Sequence[FloatArray],
    *,
    mixture: StepMixture,
    fabrication: Fabrication | None = None,
    name: str = "picture",
) -> EtchedPicture:
    """The mixture of step structures whose reflectance comes closest to targets: ``anisoscope design picture``.

    Args:
        targets: (121, 121) light over h_y, h_x each (`read_target`); their weighted sum is wanted.
        mixture: `StepMixture`.
        fabrication: wavelength, source, smallest feature and grid.
        name: of the design.

    Raises:
        UsageError: weights or passes that are none.
        ModelError: most of the wanted light is out of reach.
    """
    made, etch_passes, weights = fabrication or Fabrication(), mixture.etch_passes, mixture.weights
    factors = [1.0] * len(targets) if weights is None else list(weights)
    if len(factors) != len(targets) or min(factors) < 0.0 or max(factors) <= 0.0:
        raise UsageError(f"--weights takes a weight of 0 or more for each of the {len(targets)} targets")
    wanted = np.sum([factor * one for factor, one in zip(factors, targets, strict=True)], axis=0)
    task = TargetTask(
        wanted,
        mixture.reach,
        2**etch_passes,
        made.min_width_um,
        mixture.max_width_um,
        made.grid_um,
        1e-3 * made.wavelength_nm,
        made.coherence_um,
    )
    found = design_target(task)
    if not mixture.nearest:
        found.check()
    # levels even over half a wave of height: λ/4, λ/8, … have a zero mean phase
    passes = tuple(sorted(made.wavelength_nm / 4.0 / 2**number for number in range(etch_passes)))
    design = DesignFile(
        name=name,
        model=found.model,
        passes_nm=passes,
        wavelength_nm=made.wavelength_nm,
        band_nm=(made.wavelength_nm, made.wavelength_nm),
        coherence_um=made.coherence_um,
        min_width_um=made.min_width_um,
        grid_um=made.grid_um,
        figures={
            "rel_l2": found.rel_l2,
            "unreachable": found.unreachable_share,
            "asymmetric": found.asymmetric,
        },
    )
    return EtchedPicture(found, design)


def draw_target(found: TargetDesign, path: Path) -> None:
    """Draw wanted, achieved and unreachable light into a PNG."""
    reach = found.task.reach
    top = max(float(np.percentile(found.wanted, 99.7)), float(np.percentile(found.achieved, 99.7)))
    panels = (
        (found.wanted, "wanted", "inferno", 0.0),
        (found.achieved, "achieved", "inferno", 0.0),
        (found.unreachable, "wanted − achieved", "PuOr", -top),
    )
    draw_panels([(values, title, colours, low, top) for values, title, colours, low in panels], reach, path)


@dataclass(frozen=True)
class HologramLight:
    """What a picture assumes of light and eye.

    Attributes:
        spectrum: name of the light, or its wavelength.
        lamp_deg: side of the square lamp, as seen from the unit.
        picture_deg: side of the picture from the middle, as seen from the unit.
        pupil_deg: most that the eye's or camera's pupil may subtend: a direction of the picture.
    """

    spectrum: str
    lamp_deg: float
    picture_deg: float
    pupil_deg: float

    @classmethod
    def of(cls, task: PictureTask) -> "HologramLight":
        """Of a task, light and eye near the normal."""
        design = task.wavelength_um if task.illuminant is None else 0.55
        name = f"{1e3 * design:g} nm" if task.illuminant is None else task.illuminant.name
        reach, step = 2.0 * task.reach, 4.0 * task.reach / (task.wanted.shape[0] - 1)
        return cls(
            name, *(float(np.degrees(one)) for one in (design / task.coherence_um, np.arcsin(reach), step))
        )


@dataclass(frozen=True)
class Hologram:
    """A periodic unit of etched cells whose angular reflectance is a picture.

    Attributes:
        layout: the unit as a layout of one dot.
        wanted: (points, points, 1 or 3) wanted picture, encoded sRGB.
        depths_nm: of the etch passes.
        unit_um: side of the unit.
        error: of the search.
        seed: of start and wavelengths.
        light: what is assumed of light and eye.
        history: errors along the search.
        achieved: how it looks.
        over_etch_percent: error of all depths that is judged as well.
        over_etched: how it looks then.
    """

    layout: Layout = field(metadata=LEFT_OUT)
    wanted: FloatArray = field(metadata=LEFT_OUT)
    depths_nm: tuple[float, ...]
    unit_um: float
    error: float
    seed: int
    light: HologramLight
    history: tuple[float, ...]
    achieved: Judged
    over_etch_percent: float
    over_etched: Judged


@by_keywords(search=HologramSearch)
def etched_hologram(
    wanted: FloatArray,
    *,
    lamp: Illuminant | None = None,
    passes_nm: Sequence[float] | None = None,
    fabrication: Fabrication = HOLOGRAM,
    search: HologramSearch,
    name: str = "picture",
    on_progress: Advance = silent,
) -> Hologram:
    """A periodic unit of etched cells whose angular reflectance is a picture: ``anisoscope design hologram``.

    Random steps are refined by gradients; the unit is judged by another computation, at 61 wavelengths in colour.

    Args:
        wanted: (points, points, 1 or 3) encoded sRGB from 0 to 1, rows along rising h_y (`read_wanted`).
        lamp: light of a picture in colour; None for a grey one.
        passes_nm: depths of 1 to 8 etch passes; parts of half a wave, in colour 40 to 320 nm, where left out.
        fabrication: wavelength of a grey picture, and side of a cell as the smallest feature.
        search: unit, lamp, blur of the process, and the search.
        name: of the unit.
        on_progress: called along the search.

    Raises:
        UsageError: a number outside its range.
    """
    side, wavelength = fabrication.min_width_um, fabrication.wavelength_nm
    if not 16 <= wanted.shape[0] <= 256:
        raise UsageError(f"--picture-points takes 16 to 256, not {wanted.shape[0]}")
    if passes_nm is not None:
        passes = tuple(sorted(passes_nm))
    elif lamp is not None:
        passes = (40.0, 80.0, 160.0, 320.0)
    else:
        passes = tuple(wavelength / 32.0 * 2**number for number in range(4))
    if not 1 <= len(passes) <= 8:
        raise UsageError(f"--passes-nm takes 1 to 8 etch passes, not {len(passes)}")
    band = BAND_NM if lamp is not None else (wavelength, wavelength)
    linear = np.asarray(decode_srgb()[np.rint(255.0 * wanted).astype(np.uint8)], dtype=np.float64)
    unit_um = search.cells * side
    coherence = 0.5 * unit_um if search.coherence_um is None else search.coherence_um
    levels = Depths(passes, band).levels_um
    task = PictureTask(
        linear,
        levels,
        lamp,
        1e-3 * wavelength,
        search.cells,
        side,
        coherence,
        search.reach,
        blur_um=search.blur_um,
        displayed=search.displayed,
    )
    light = HologramLight.of(task)
    found = design_picture(task, np.random.default_rng(search.seed), search.search_steps, advance=on_progress)
    layout = Layout(
        found.labels[None],
        np.zeros(1, dtype=np.int64),
        np.zeros((1, 1), dtype=np.uint16),
        passes,
        side,
        (name,),
        wavelength if lamp is None else 550.0,
        coherence,
    )
    return Hologram(
        layout,
        wanted,
        passes,
        unit_um,
        found.error,
        search.seed,
        light,
        tuple(found.history),
        judged(found),
        search.over_etch_percent,
        judged(found, 1.0 + 0.01 * search.over_etch_percent),
    )


def draw_hologram(found: Hologram, reach: float, path: Path) -> None:
    """Draw wanted, achieved and over-etched light into a PNG."""
    shown = [
        (found.wanted, "wanted"),
        (found.achieved.srgb, "achieved"),
        (found.over_etched.srgb, f"depths {found.over_etch_percent:+g} %"),
    ]
    draw_panels(
        [(one[..., 0] if one.shape[2] == 1 else one, title, "gray", 0.0, 1.0) for one, title in shown],
        reach,
        path,
    )


def picture_lamp(text: str, width_nm: float) -> Illuminant:
    """A light by name, or three lines balanced to the white of sRGB."""
    if "," not in text:
        return find_illuminant(text)
    try:
        middles = tuple(float(part) for part in text.split(","))
    except ValueError:
        middles = ()
    if len(middles) != 3 or not 1.0 <= width_nm <= 40.0 or min(middles) < 410.0 or max(middles) > 690.0:
        raise UsageError("--picture-light takes three lines of 410 to 690 nm, --line-width 1 to 40 nm")
    nm = np.arange(380.0, 731.0)
    lines = np.exp(-4.0 * np.log(2.0) * ((nm - np.array(middles)[:, None]) / width_nm) ** 2)
    fine, matching = matching_functions()
    each = np.stack([np.interp(fine, nm, one) @ matching for one in lines])
    share = np.linalg.solve(each.T, SRGB_WHITE)
    if float(share.min()) <= 0.0:
        raise UsageError(
            f"--picture-light {text}: white is no mixture of these lines: take a red, a green and a blue"
        )
    return Illuminant(
        f"lines of {text} nm, {width_nm:g} nm wide", tuple(nm.tolist()), tuple((share @ lines).tolist())
    )


def read_wanted(path: Path, points: int, *, colour: bool) -> FloatArray:
    """(points, points, 1 or 3) encoded sRGB, rows along rising h_y."""
    found = read_image(path, colour=colour)
    how = cv2.INTER_AREA if min(found.shape[:2]) > points else cv2.INTER_LINEAR
    small = cv2.resize(found, (points, points), interpolation=how)[::-1]
    if not small.any():
        raise UsageError(f"{path}: is black: there is no light to design")
    values = small[..., ::-1] if colour else small[..., None]
    return np.asarray(values / 255.0, dtype=np.float64)


def compare_lobe(photo: Path, design: Path, taken: LobePhoto) -> LobeComparison:
    """A photographed lobe against its design: ``anisoscope design compare-lobe``.

    Args:
        photo: grey or colour photograph of the screen, 8 or 16 bits; clipped pixels count for nothing.
        design: design *.toml or layout *.npz of which the sample was made.
        taken: lamp, screen and camera.

    Raises:
        UsageError: a number outside its range, or a file that cannot be used.
        ModelError: the photograph does not show the lobe.
    """
    screen = Screen(taken.distance_mm, taken.light, taken.screen_tilt)
    seen = read_photograph(photo, taken.background, taken.tone)
    to_pixels = _pixels_of_scale(taken, seen.shape) if taken.marks is None else pixels_of_marks(taken.marks)
    source = None
    if taken.lamp_half_angle_deg is not None:
        source = Extent("disc", 2.0 * float(np.sin(np.radians(taken.lamp_half_angle_deg))))
    grid = Grid.of(screen, taken.reach, taken.points)
    measured, _ = photographed_intensity(seen, to_pixels, screen, grid)
    expected = designed_intensity(read_sample_design(design), grid, taken.wavelength_nm, source)
    return compared_lobes(measured, expected, grid)


def draw_comparison(found: LobeComparison, reach: float, path: Path) -> None:
    """Draw photograph, design and their difference into a PNG."""
    top = float(found.designed.max())
    off = found.photographed - found.designed
    draw_panels(
        [
            (found.photographed, "photographed", "inferno", 0.0, top),
            (found.designed, "designed", "inferno", 0.0, top),
            (off, "photographed − designed", "PuOr", -top, top),
        ],
        reach,
        path,
    )


def read_photograph(path: Path, background: float, tone: str) -> FloatArray:
    """(rows, cols) light, NaN where a channel clips."""
    data = np.fromfile(path, dtype=np.uint8) if path.is_file() else np.zeros(0, dtype=np.uint8)
    found = cv2.imdecode(data, cv2.IMREAD_UNCHANGED) if data.size else None
    if found is None or found.dtype not in (np.dtype(np.uint8), np.dtype(np.uint16)):
        raise UsageError(f"{path}: no photograph of 8 or 16 bits; give a PNG, TIFF or JPEG")
    top = 255.0 if found.dtype == np.uint8 else 65535.0
    channels = np.atleast_3d(found)[..., :3].astype(np.float64)
    if not 0.0 <= background < top:
        raise UsageError(f"--background takes a grey value from 0 to below {top:g}, not {background:g}")

    def light(value: FloatArray) -> FloatArray:
        share = value / top
        if tone == "linear":
            return share
        # IEC 61966-2-1
        return np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)

    grey = light(channels).mean(axis=-1) - float(light(np.array(background)))
    return np.where((channels >= top).any(axis=-1), np.nan, grey)


def pair_of(text: str, option: str) -> tuple[float, float]:
    """Two numbers.

    Raises:
        UsageError: something else.
    """
    try:
        first, second = (float(part) for part in text.split(","))
    except ValueError:
        raise UsageError(f"{option} takes two numbers A,B, not {text!r}") from None
    if not np.isfinite((first, second)).all():
        raise UsageError(f"{option} takes finite numbers, not {text!r}")
    return first, second


def pixels_of_marks(text: str) -> FloatArray:
    """(3, 3) homography from mm on the screen to pixels."""
    pairs = [part.split("=") for part in text.split(";") if part.strip()]
    if len(pairs) != 4 or any(len(pair) != 2 for pair in pairs):
        raise UsageError(f"--marks takes {MARKS}, not {text!r}")
    pixels, places = (
        np.array([pair_of(pair[which], "--marks") for pair in pairs], dtype=np.float32) for which in (0, 1)
    )
    for what in (pixels, places):
        corners = [what[np.array(three)] for three in ((0, 1, 2), (0, 1, 3), (0, 2, 3), (1, 2, 3))]
        across = [abs((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])) for a, b, c in corners]
        if min(across) < 1e-3 * float(np.ptp(what)) ** 2:
            raise UsageError(
                "--marks: three of the marks lie on a line: take four that are corners of a quadrangle"
            )
    return np.asarray(cv2.getPerspectiveTransform(places, pixels), dtype=np.float64)


def _pixels_of_scale(taken: LobePhoto, shape: tuple[int, ...]) -> FloatArray:
    """(3, 3) homography of a picture seen straight on, y up; x runs to the left as seen from the sample."""
    assert taken.pixel_mm is not None
    col, row = taken.center or (0.5 * (shape[1] - 1), 0.5 * (shape[0] - 1))
    along = 1.0 / taken.pixel_mm
    return np.array([[along if taken.from_behind else -along, 0.0, col], [0.0, -along, row], [0.0, 0.0, 1.0]])


def read_sample_design(path: Path) -> DesignFile | Layout:
    """What a sample was made of.

    Raises:
        UsageError: neither a design nor a layout.
        ConfigError: it cannot be read.
    """
    if path.suffix.lower() == ".toml":
        return read_design(path)
    if path.suffix.lower() == ".npz":
        return read_layout(path)[0]
    raise UsageError(f"--design {path}: takes a design *.toml or a layout *.npz")


def check_target(path: Path | None, ending: str, option: str) -> None:
    """Refuse a file to write with another ending, or in no folder.

    Raises:
        UsageError: so.
    """
    if path is not None and path.suffix.lower() != ending:
        raise UsageError(f"{option} writes *{ending}, not {path.name}")
    if path is not None and not path.parent.is_dir():
        raise UsageError(f"{path}: there is no folder {path.parent}; make it first")
