"""``anisoscope ink proof``: how a print will look, as a page to turn it in the browser, and as pictures."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Group, Parameter

from anisoscope.base.errors import UsageError
from anisoscope.cli.help_page import MORE, everyday
from anisoscope.cli.ink.options import NAMES, InksOption, printed_inks
from anisoscope.cli.json_output import fields_of, print_json
from anisoscope.cli.options import Json, Overwrite, check_new, check_target
from anisoscope.cli.progress import progress
from anisoscope.cli.tables import print_lines, print_table
from anisoscope.parameters.proof import ProofSettings, ProofView
from anisoscope.views.options import Given, Options, with_options

if TYPE_CHECKING:
    from anisoscope.operations.proofing import SoftProof
    from anisoscope.sim.light.ink.ink import Ink
    from anisoscope.sim.proof.halftone import Press

VIEW = Group("View and light", sort_key=20)
PRESS = Group("Press", help="Inks are printed in the order in which they are named.", sort_key=21)
OF_SETTINGS = Options(
    ProofSettings,
    names={**NAMES, "illuminants": "--illuminant"},
    groups={"method": MORE, "gain": MORE, "substrate": MORE},
    whole=True,
)
OF_VIEW = Options(ProofView, VIEW, names={"pitch_deg": "--pitch-angle"}, default=ProofView())


@Parameter(name="*", group=PRESS)
@dataclass(frozen=True, kw_only=True)
class PressOptions:
    """What the press does to the dots; inks overlap by that.

    Attributes:
        screen_shifts: Shift of the screen of each ink in µm, to the right and up: X,Y;X,Y;X,Y.
        overprint: Ink file of inks on each other, by their numbers from below: 1+2=FILE.toml; else they are modelled.
    """

    screen_shifts: str | None = None
    dot_gain: Annotated[float, Parameter(help="By how much dots spread beyond each edge, in µm.")] = 0.0
    dpi: Annotated[float, Parameter(help="Dots per inch of the print.")] = 300.0
    overprint: Annotated[tuple[str, ...], Parameter(negative="")] = ()


@Parameter(name="*")
@dataclass(frozen=True)
class ProofFiles:
    """Files of a proof."""

    out: Annotated[Path | None, Parameter(help="Write the page *.html.")] = None
    png: Annotated[Path | None, Parameter(help="Write a picture *.png, without a browser.")] = None
    picture_size: Annotated[int, Parameter(help="Side of the picture of --png in pixels.", group=MORE)] = 1024
    photo: Annotated[Path | None, Parameter(help="Photograph to show next to the proof.")] = None
    overwrite: Overwrite = False

    def check(self, image: Path, mesh: Path | None) -> None:
        """Refuse files that cannot be written.

        Raises:
            UsageError: none is named, one is an input or exists, or a photograph without a page.
        """
        if self.out is None and self.png is None:
            raise UsageError(
                "ink proof needs something to write: --out proof.html, --png picture.png, or both"
            )
        check_target(self.out, "--out", (image, self.photo, mesh), ".html", ".htm")
        check_target(self.png, "--png", (image, self.photo, mesh), ".png")
        check_new((self.out, self.png), overwrite=self.overwrite)
        if self.photo is not None and self.out is None:
            raise UsageError("--photo shows a photograph on the page: it needs --out proof.html")


NO_FILES = ProofFiles()


@with_options(view=OF_VIEW, settings=OF_SETTINGS)
@everyday("files", "inks", "settings", "json_")
def proof(
    image: Path,
    /,
    *,
    files: ProofFiles = NO_FILES,
    inks: InksOption = None,
    settings: Given[ProofSettings],
    press: PressOptions | None = None,
    view: Given[ProofView],
    json_: Json = False,
) -> int:
    """Show how a print of an image will look from all sides.

    Args:
        image: The picture to print.

    Examples:
        anisoscope ink proof image.png --out proof.html
        anisoscope ink proof image.png --png proof.png --shape cylinder --illuminant a
        anisoscope ink proof image.png --png proof.png --screen-shifts "0,0;25,-10;0,0" --dot-gain 10
    """
    from anisoscope.operations.proofing import soft_proof

    shown, asked = view.over(ProofView()), settings.made()
    mesh = asked.mesh
    # All options are checked before the separation: planning and dithering take long.
    files.check(image, mesh)
    if shown.shape == "mesh" and mesh is None:
        raise UsageError("--shape mesh needs --mesh FILE.obj")
    if not 0 <= asked.dots <= 16384 or not 16 <= files.picture_size <= 4096 or not asked.illuminants:
        raise UsageError("--dots takes 0 to 16384, --picture-size 16 to 4096, --illuminant a light or more")
    chosen = printed_inks(inks)
    machine, over = _press(press or PressOptions(), len(chosen))
    with progress("proof", quiet=json_) as advance:
        found = soft_proof(
            image,
            chosen,
            settings=asked,
            view=shown,
            press=machine,
            overprints=over,
            paged=files.out is not None,
            on_progress=advance,
        )
    if files.png is not None:
        found.write_picture(files.png, files.picture_size)
    if files.out is not None:
        found.write_page(files.out, f"Soft proof of {image.name}", files.photo)
    written = [path for path in (files.png, files.out) if path is not None]
    if json_:
        print_json({**fields_of(found), "files": written})
    else:
        _print(found, written)
    return 0


def _press(options: PressOptions, inks: int) -> "tuple[Press | None, dict[tuple[int, ...], Ink]]":
    """The press, None where it has no errors, and measured overprints by the inks that they are of.

    Raises:
        UsageError: not a shift for each ink, or an overprint of inks that are not printed in this order.
    """
    from anisoscope.sim.materials.inks import find_ink
    from anisoscope.sim.proof.halftone import MOST_MOVED, Press
    from anisoscope.views.options import parse_numbers

    if not 1.0 <= options.dpi <= 20000.0:
        raise UsageError(f"--dpi takes 1 to 20000, not {options.dpi:g}")
    dot_um = 25400.0 / options.dpi
    shifts = [(0.0, 0.0)] * inks
    if options.screen_shifts is not None:
        parts = [
            parse_numbers(one, "--screen-shifts", "0,0;25,-10;0,0")
            for one in options.screen_shifts.split(";")
        ]
        if len(parts) != inks or any(len(one) != 2 for one in parts):
            raise UsageError(f"--screen-shifts takes X,Y of each of the {inks} inks, with semicolons between")
        shifts = [(one[0] / dot_um, one[1] / dot_um) for one in parts]
    reach = max(*(abs(x) for one in shifts for x in one), options.dot_gain / dot_um)
    if not (options.dot_gain >= 0.0 and reach <= MOST_MOVED / 2.0):
        raise UsageError(
            f"--screen-shifts and --dot-gain reach up to {MOST_MOVED / 2.0:g} dots, {MOST_MOVED / 2.0 * dot_um:.0f} µm "
            f"at {options.dpi:g} dpi; a gain is 0 or more"
        )
    over: dict[tuple[int, ...], Ink] = {}
    for text in options.overprint:
        numbers, equals, path = text.partition("=")
        key = tuple(int(one) - 1 if one.isascii() and one.isdigit() else -1 for one in numbers.split("+"))
        if not equals or len(key) < 2 or list(key) != sorted(set(key)) or not 0 <= key[0] <= key[-1] < inks:
            raise UsageError(
                f"--overprint takes numbers of inks from below and a file, such as 1+2=FILE.toml, not {text}"
            )
        over[key] = find_ink(path)
    if options.screen_shifts is None and options.dot_gain == 0.0:
        if over:
            raise UsageError("--overprint needs inks that overlap: give --screen-shifts or --dot-gain too")
        return None, over
    return Press(tuple(shifts), options.dot_gain / dot_um), over


def _print(proof: "SoftProof", written: list[Path]) -> None:
    from anisoscope.operations.proofing import percent

    found = proof.halftone
    print_lines(
        f"{found.dots.shape[1]} × {found.dots.shape[0]} dots; out of gamut: {percent(found.outside)}, "
        f"coverages scaled down: {percent(found.scaled)}; exposure {proof.exposure:.3g}."
    )
    if proof.pressed is not None:
        rows = [[name, f"{100.0 * share:.2f}"] for name, share in proof.primaries.items()]
        print_table("What the press makes of the dots", ["primary", "coverage [%]"], rows)
    print_lines(*(f"Image: {note}." for note in proof.notes), *(f"{path}: written" for path in written))
