"""Options that the commands share."""

import math
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, overload

from cyclopts import Group, Parameter

from anisoscope.base.errors import UsageError
from anisoscope.base.quantity import read_number
from anisoscope.cli.help_page import MORE
from anisoscope.cli.log import report
from anisoscope.parameters.geometry import Convention
from anisoscope.parameters.inputs import InputUncertainty, default_uncertainty
from anisoscope.parameters.material import Material
from anisoscope.parameters.optics import Optics
from anisoscope.parameters.ridges import LIKELY_PITCH, RidgeDesign
from anisoscope.parameters.workers import Workers
from anisoscope.views.options import Options, parse_numbers, quantity

if TYPE_CHECKING:
    from anisoscope.operations.stated import Stated
    from anisoscope.report.study_page import StudyPage

RecipeOption = Annotated[
    Path | None,
    Parameter(help="Recipe file with plastic and surface; options have precedence."),
]
HistoryOption = Annotated[
    str | None,
    Parameter(
        name="--history",
        help="History that the inspection enters: a file, a postgresql:// URL, or `none`. By default what "
        "ANISOSCOPE_HISTORY says, else history.sqlite in the folder of inspections.",
    ),
]
RIDGES = Group("Ridges", sort_key=19)
PLASTIC = Group("Plastic", sort_key=20)
LIGHT = Group("Light and camera angles", sort_key=21)
MaterialOption = Annotated[
    Path | None,
    Parameter(
        name="--material",
        group=PLASTIC,
        help="Material file of `calibrate material` in place of the recipe's plastic.",
    ),
]
PITCH = quantity("pitch_um", LIKELY_PITCH)
LENGTH = quantity("um")
"""Parameter of an option that takes µm, or a number with another unit of length."""
OF_RIDGES = Options(RidgeDesign, RIDGES, default=RidgeDesign(100.0, 10.0))
OF_PLASTIC = Options(Material, PLASTIC)
OF_LIGHT = Options(Convention, LIGHT)
LAMP_AND_LENS = Group(
    "Lamp and lens", help="Sizes as the sample sees them; without them both are points far away.", sort_key=22
)
UNCERTAINTY = Group(
    "Uncertainty",
    help="Standard uncertainties (k = 1) of the inputs; 0 takes an input as exact. The defaults are those of a recipe.",
    sort_key=23,
)


def _half_angle_deg(text: str, option: str) -> float:
    aperture = read_number(text, option)
    if not 0.0 <= aperture < 0.86:
        raise ValueError(f"{option} must be a numerical aperture of 0 to 0.86, not {aperture:g}")
    return math.degrees(math.asin(aperture))


def _field_mm(text: str, option: str) -> tuple[float, float]:
    sides = parse_numbers(text, option)
    if len(sides) not in (1, 2) or min(sides) <= 0.0:
        raise ValueError(f"{option} takes one or two positive numbers of mm, not {text!r}")
    return sides[0], sides[-1]


OF_OPTICS = Options(
    Optics,
    LAMP_AND_LENS,
    names={"aperture_half_angle_deg": "--aperture"},
    help={
        "aperture_half_angle_deg": "Numerical aperture of the lens.",
        "field_mm": "Size of the field on the sample in mm: SIZE or WIDTH,HEIGHT; with --lamp-distance.",
    },
    readers={"aperture_half_angle_deg": _half_angle_deg, "field_mm": _field_mm},
)
OF_UNCERTAINTY = Options(
    InputUncertainty,
    UNCERTAINTY,
    names={"ridges_seen": "--ridges-seen", "light_field_deg": "--light-field"},
    prefix="u-",
    default=default_uncertainty(Material()),
)

TrustFile = Annotated[
    Path | None,
    Parameter(name="--trust", help="Trust file: one of its keys has to have signed (`anisoscope key`)."),
]
LightAngleOption = Annotated[
    float | None,
    Parameter(name="--light-angle", help="Without --rig: angle of the light, degrees; else 10 is assumed."),
]
Flag = Annotated[bool, Parameter(negative="")]
"""What is so where it is stated, and has no --no-…"""
Html = Annotated[Path | None, Parameter(help="Write a self-contained HTML page to this file.")]
Json = Annotated[bool, Parameter(name="--json", negative="", help="Print JSON.")]
Overwrite = Annotated[bool, Parameter(negative="", help="Replace files that exist.")]
RecipeFile = Annotated[Path, Parameter(name=["--recipe", "-r"], help="Recipe file (TOML).")]
HeightMaps = Annotated[Path, Parameter(help="Height maps in a format of docs/height-maps.md, or patterns.")]


@Parameter(name="*")
@dataclass(frozen=True)
class Output:
    """Form of a result."""

    json_: Json = False
    html: Html = None

    def one_alone(self) -> None:
        """Refuse both forms.

        Raises:
            UsageError: they are stated.
        """
        if self.json_ and self.html is not None:
            raise UsageError("--json and --html exclude each other")

    def hand_out(self, found: Any) -> None:  # noqa: ANN401 - any result with a page
        """Write the page of a study, and print it."""
        from anisoscope.cli.json_output import print_json
        from anisoscope.cli.tables import print_lines, print_table

        page = self.written(found.page())
        if self.json_:
            print_json(found)
            return
        for table in page.tables:
            print_table(table.title, table.columns, table.rows, table.note or None)
        print_lines(page.subtitle, *page.notes, *([page.answer] if page.answer else []))

    def written(self, page: "StudyPage") -> "StudyPage":
        """Write the page, if a file is named."""
        if self.html is not None:
            page.write(self.html)
        return page


@Parameter(name="*")
@dataclass(frozen=True)
class DrawnOutput(Output):
    """Form of a result with charts."""

    plot: Annotated[Path | None, Parameter(help="Write the charts as a picture, *.png or *.svg.")] = None

    def check(self) -> None:
        """Refuse a picture that cannot be written; errors as for `check_picture`."""
        from anisoscope.report.study_page import check_picture

        check_picture(self.plot)

    def written(self, page: "StudyPage") -> "StudyPage":
        """Write the page and its picture, if files are named."""
        if self.plot is not None:
            page.write_picture(self.plot)
        return super().written(page)


@Parameter(name="*")
@dataclass(frozen=True)
class Base:
    """Recipe and material file that options stand over."""

    recipe: RecipeOption = None
    file: MaterialOption = None

    def stated(self) -> "Stated":
        """Surface, plastic and orientation; errors as for `operations.stated`."""
        from anisoscope.operations.stated import stated

        return stated(self.recipe, self.file)


@Parameter(name="*")
@dataclass(frozen=True)
class Lamp:
    """Light angle, of a rig file or stated."""

    rig: Annotated[Path | None, Parameter(name=["--rig", "-g"], help="Rig file, for its light angle.")] = None
    light_angle: Annotated[LightAngleOption, Parameter(group=MORE)] = None

    @contextmanager
    def angle(self) -> Iterator[float]:
        """The stated angle, or the usual one; a line on stderr says afterwards that this was assumed."""
        usual = Convention.light_angle_deg
        yield usual if self.light_angle is None else self.light_angle
        if self.rig is None and self.light_angle is None:
            report(f"no rig file: light at {usual:g}° is assumed; name --rig, or --light-angle")


@Parameter(name="*")
@dataclass(frozen=True)
class Trusted:
    """Certificates by which programs of OPC UA know each other.

    Attributes:
        certificate: Own certificate (`anisoscope line certificate`): sign and encrypt.
        key: Its key.
        peers: Folder of the certificates that are trusted; its folder rejected receives those that are not.
    """

    certificate: Path | None = None
    key: Path | None = None
    peers: Path | None = None


@Parameter(name="*")
@dataclass(frozen=True)
class Into:
    """Folder and history that receive inspections."""

    out: Annotated[Path, Parameter(help="Folder that receives the inspections.")] = Path("inspections")
    history: HistoryOption = None


PRINTED, DRAWN, NO_BASE, USUAL_LAMP, INTO = Output(), DrawnOutput(), Base(), Lamp(), Into()
UNTRUSTED = Trusted()
OF_WORKERS = Options(
    Workers,
    MORE,
    default={"jobs": None},
    help={"jobs": "Processes on this machine; left out, one for every core."},
    whole=True,
)


@contextmanager
def extra_packages(what: str, extra: str) -> Iterator[None]:
    """Say which extra is missing where imports fail.

    Raises:
        UsageError: they do.
    """
    try:
        yield
    except ImportError as problem:
        raise UsageError(
            f"{what} needs more packages ({problem.name}): pip install 'anisoscope[{extra}]'"
        ) from problem


def number(text: str, option: str, unit: str = "") -> float:
    """Number of an option, in its unit or with its own.

    Raises:
        UsageError: the text is no number, or its unit is no unit of it.
    """
    try:
        return read_number(text, option, unit)
    except ValueError as problem:
        raise UsageError(str(problem)) from None


def parse_range(text: str, option: str) -> tuple[float, ...]:
    """Numbers of an option: ``from:to:step`` with both ends, or a comma-separated list.

    Raises:
        UsageError: the text is neither, or the range has no end.
    """
    if ":" not in text:
        return parse_numbers(text, option)
    parts = text.split(":")
    numbers = parse_numbers(",".join(parts), option)
    if len(parts) != 3 or not numbers[2] > 0.0 or not numbers[1] >= numbers[0]:
        raise UsageError(f"{option} takes from:to:step with a step above 0, such as -20:20:5, not {text!r}")
    first, last, step = numbers
    return tuple(first + step * k for k in range(int((last - first) / step + 1e-9) + 1))


@overload
def parse_pixel(text: str, option: str = "--pixel") -> tuple[float, float]: ...


@overload
def parse_pixel(text: str | None, option: str = "--pixel") -> tuple[float, float] | None: ...


def parse_pixel(text: str | None, option: str = "--pixel") -> tuple[float, float] | None:
    """Pixel size (y, x) in µm of an option SIZE or Y,X.

    Raises:
        UsageError: not one or two positive numbers.
    """
    if text is None:
        return None
    numbers = parse_numbers(text, option, "0.5,0.5", "um")
    if len(numbers) not in (1, 2) or min(numbers) <= 0:
        raise UsageError(f"{option} takes one or two positive numbers of µm, SIZE or Y,X, not {text!r}")
    return numbers[0], numbers[-1]


def check_suffix(path: Path | None, option: str, *suffixes: str) -> None:
    """Refuse a file of another kind before the work begins.

    Raises:
        UsageError: the name ends in none of the suffixes.
    """
    if path is not None and path.suffix.lower() not in suffixes:
        raise UsageError(f"{option} writes {' or '.join('*' + one for one in suffixes)}, not {path.name}")


def check_target(path: Path | None, option: str, inputs: Iterable[Path | None], *suffixes: str) -> None:
    """As :func:`check_suffix`, and refuse to overwrite an input.

    Raises:
        UsageError: the name ends in none of the suffixes, or is that of an input.
    """
    check_suffix(path, option, *suffixes)
    if path is not None and path.resolve() in {one.resolve() for one in inputs if one is not None}:
        raise UsageError(f"{option} {path} is an input: write to another file")


def check_new(paths: Iterable[Path | None], *, overwrite: bool) -> None:
    """Refuse existing output files before the work begins, unless overwriting is allowed.

    Raises:
        UsageError: one of them exists.
    """
    for path in paths:
        if path is not None and path.exists() and not overwrite:
            raise UsageError(f"{path} exists; give another name, or --overwrite")


def check_map(path: Path | None, option: str) -> None:
    """Refuse a height map of a format that is not written.

    Raises:
        UsageError: an unknown extension.
    """
    from anisoscope.profiles.files.load import WRITERS  # the first import of numpy

    if path is not None and path.suffix.lower() not in WRITERS:
        raise UsageError(f"{option} {path}: unknown extension; written are {', '.join(WRITERS)}")


def pairs_of(text: str, option: str, form: str) -> dict[str, str]:
    """Texts by name from ``NAME=VALUE,…``.

    Raises:
        UsageError: another form, or a name twice.
    """
    found: dict[str, str] = {}
    for piece in text.split(","):
        name, equals, value = piece.partition("=")
        name = name.strip().replace("-", "_")
        if not equals or not name or name in found:
            raise UsageError(f"{option} takes {form}, every name once, not {text!r}")
        found[name] = value.strip()
    return found


def one_number(text: str, option: str) -> float:
    """Number of an option; NaN for several."""
    return parse_numbers(text, option)[0] if "," not in text else math.nan


def named_numbers(text: str, option: str, form: str, kind: type) -> dict[str, float]:
    """Numbers by name from ``NAME=VALUE,…``; names are fields of a dataclass, every one once.

    Raises:
        UsageError: another form, an unknown name, or no number.
    """
    values, known = pairs_of(text, option, form), [one.name for one in fields(kind)]
    unknown = [name for name in values if name not in known]
    if unknown:
        raise UsageError(f"{option} does not know {unknown[0]!r}; it knows {', '.join(known)}")
    return {name: one_number(value, option) for name, value in values.items()}
