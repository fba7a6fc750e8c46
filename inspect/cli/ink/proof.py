"""``anisoscope ink proof``: how a print will look, as a page to turn it in the browser, and as pictures."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Group, Parameter

from anisoscope.base.errors import UsageError
from anisoscope.cli.help_page import everyday
from anisoscope.cli.ink.options import (
    AngleOption,
    GainOption,
    InksOption,
    OverwriteOption,
    check_new,
    check_target,
    percent,
    printed_inks,
)
from anisoscope.cli.json_output import print_json
from anisoscope.cli.options import Json
from anisoscope.cli.progress import progress
from anisoscope.cli.tables import print_lines, print_table

if TYPE_CHECKING:
    import numpy as np

    from anisoscope.report.proof_page import Proof
    from anisoscope.sim.light.colour.illuminant import Illuminant
    from anisoscope.sim.light.ink.ink import Ink
    from anisoscope.sim.proof.halftone import Halftone, Press, Pressed
    from anisoscope.sim.proof.mesh import Mesh
    from anisoscope.sim.proof.scene import Scene

SECOND_LIGHT_DEG = (-15.0, 35.0)
_CONVENTION = (
    "Colours are linear sums of coverage times the inks' colours in sRGB, clipped at the end; the eye looks along "
    "parallel rays. Sphere and cylinder bear the print on each half; backs are bare paper."
)
BRIGHT = 0.9
MOST_DOTS = 16384
MOST_TURN = 1e6

VIEW = Group("View and light", sort_key=20)
PRESS = Group("Press", help="Inks are printed in the order in which they are named.", sort_key=21)
TONE_DOTS = 8
MOST_PRESSED = 16_000_000


@Parameter(name="*", group=PRESS)
@dataclass(frozen=True, kw_only=True)
class PressOptions:
    """What the press does to the dots; inks overlap by that."""

    screen_shifts: Annotated[
        str | None,
        Parameter(help="Shift of the screen of each ink in µm, to the right and up: X,Y;X,Y;X,Y."),
    ] = None
    dot_gain: Annotated[float, Parameter(help="By how much dots spread beyond each edge, in µm.")] = 0.0
    dpi: Annotated[float, Parameter(help="Dots per inch of the print.")] = 300.0
    overprint: Annotated[
        tuple[str, ...],
        Parameter(
            help="Ink file of inks on each other, by their numbers from below: 1+2=FILE.toml; else they are modelled.",
            negative="",
        ),
    ] = ()


@Parameter(name="*", group=VIEW)
@dataclass(frozen=True, kw_only=True)
class View:
    """How the page begins, and what ``--png`` shows."""

    shape: Annotated[
        Literal["sphere", "cylinder", "plane", "mesh"] | None, Parameter(help="Shape that is printed on.")
    ] = None
    yaw: Annotated[float, Parameter(help="Turn about the upright axis, degrees.")] = 0.0
    pitch: Annotated[
        float, Parameter(name="--pitch-angle", help="Tilt about the horizontal axis, degrees.")
    ] = 0.0
    azimuth: Annotated[
        float, Parameter(help="Azimuth of the light, counter-clockwise from the right, degrees.")
    ] = 135.0
    elevation: Annotated[float, Parameter(help="Elevation of the light above the picture, degrees.")] = 45.0
    second: Annotated[bool, Parameter(help="A second light, half as bright, from the right.")] = True
    ink_model: Annotated[
        Literal["goniochromatic", "schlick", "tio2"], Parameter(help="The ink model, or a standard one.")
    ] = "goniochromatic"
    process: Annotated[
        Literal["brushed", "binder-mixed"] | None,
        Parameter(help="Roughness by the printing process: brushed 0.19, binder-mixed 0.30 (assumed)."),
    ] = None
    match: Annotated[
        bool,
        Parameter(
            negative="",
            help="Add what photographs show: highlight and scattering of the paper, light behind.",
        ),
    ] = False


@everyday(
    "out", "png", "inks", "mesh", "photo", "illuminant", "separation", "angle", "dots", "overwrite", "json_"
)
def proof(
    image: Path,
    /,
    *,
    out: Annotated[Path | None, Parameter(help="Write the page *.html.")] = None,
    png: Annotated[Path | None, Parameter(help="Write a picture *.png, without a browser.")] = None,
    inks: InksOption = None,
    mesh: Annotated[Path | None, Parameter(help="Mesh *.obj to print on.")] = None,
    photo: Annotated[Path | None, Parameter(help="Photograph to show next to the proof.")] = None,
    illuminant: Annotated[
        tuple[str, ...],
        Parameter(
            help="Illuminants: names or CSV files; the first is that of the separation and the picture.",
            negative="",
        ),
    ] = ("d65", "a", "led-b1", "led-b3", "led-b5", "led-rgb1", "led-v1"),
    method: Annotated[Literal["mask", "diffusion"], Parameter(help="How the dots are placed.")] = "mask",
    separation: Annotated[
        Literal["match", "channels"], Parameter(help="Coverages as for ink halftone.")
    ] = "match",
    angle: AngleOption = 20.0,
    image_gain: GainOption = 1.0,
    dots: Annotated[int, Parameter(help="Dots across the print; 0: one a pixel of the image.")] = 768,
    picture_size: Annotated[int, Parameter(help="Side of the picture of --png in pixels.")] = 1024,
    press: PressOptions | None = None,
    view: View | None = None,
    overwrite: OverwriteOption = False,
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
    from anisoscope.sim.materials.spectra import find_illuminant
    from anisoscope.sim.proof.halftone import coverage
    from anisoscope.sim.proof.halftone import halftone as place_dots
    from anisoscope.sim.proof.imagefile import read_image, to_dots
    from anisoscope.sim.proof.mesh import read_obj
    from anisoscope.sim.proof.separation import separation as plan_separation

    shown = view or View()
    # All options are checked before the separation: planning and dithering take long.
    if out is None and png is None:
        raise UsageError("ink proof needs something to write: --out proof.html, --png picture.png, or both")
    check_target(out, "--out", (image, photo, mesh), ".html", ".htm")
    check_target(png, "--png", (image, photo, mesh), ".png")
    check_new((out, png), overwrite=overwrite)
    if photo is not None and out is None:
        raise UsageError("--photo shows a photograph on the page: it needs --out proof.html")
    if shown.shape == "mesh" and mesh is None:
        raise UsageError("--shape mesh needs --mesh FILE.obj")
    if not 0 <= dots <= 16384 or not 16 <= picture_size <= 4096 or not illuminant:
        raise UsageError("--dots takes 0 to 16384, --picture-size 16 to 4096, --illuminant a light or more")
    if not (abs(shown.pitch) <= 90.0 and abs(shown.elevation) <= 90.0):
        raise UsageError("--pitch-angle and --elevation take degrees from -90 to 90")
    if not (abs(shown.yaw) < MOST_TURN and abs(shown.azimuth) < MOST_TURN):
        raise UsageError("--yaw and --azimuth take finite degrees")
    chosen = printed_inks(inks)
    machine, over = _press(press or PressOptions(), len(chosen))
    lamps = [find_illuminant(text) for text in illuminant]
    solid = None if mesh is None else read_obj(mesh)
    plan = plan_separation(chosen, lamps[0], way=separation, angle_deg=angle, gain=image_gain)
    picture = read_image(image)
    pixels = to_dots(picture, dots or picture.srgb.shape[1])
    # The page holds all dots in one WebGL texture, whose side is limited; a PNG has no such limit.
    if out is not None and max(pixels.shape[:2]) > MOST_DOTS:
        raise UsageError(
            f"{pixels.shape[1]} × {pixels.shape[0]} dots are more than the {MOST_DOTS} a side that a page can show: "
            "lower --dots"
        )
    with progress("proof", quiet=json_) as advance:
        found = place_dots(pixels, plan, method, advance=advance)
        advance("press", 0, 1)
        work = _printed(chosen, lamps, found, coverage(pixels, plan), solid, shown, machine, over)
    exposure = work.exposure()
    if png is not None:
        work.write_png(png, picture_size, exposure)
    if out is not None:
        from anisoscope.report.proof_page import write_proof_page

        notes = tuple(f"Image: {note}." for note in picture.notes)
        page = _page(work, f"Soft proof of {image.name}", exposure, notes, None if photo is None else photo)
        write_proof_page(page, out)
    _print_summary(work, exposure, [path for path in (png, out) if path is not None], json_)
    return 0


def _press(options: PressOptions, inks: int) -> "tuple[Press | None, dict[tuple[int, ...], Ink]]":
    """The press, None where it has no errors, and measured overprints by the inks that they are of.

    Raises:
        UsageError: not a shift for each ink, or an overprint of inks that are not printed in this order.
    """
    from anisoscope.cli.options import parse_numbers
    from anisoscope.sim.materials.inks import find_ink
    from anisoscope.sim.proof.halftone import MOST_MOVED, Press

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


def _printed(
    inks: "tuple[Ink, ...]",
    lamps: "list[Illuminant]",
    found: "Halftone",
    tones: "np.ndarray[Any, Any]",
    mesh: "Mesh | None",
    view: View,
    press: "Press | None",
    over: "dict[tuple[int, ...], Ink]",
) -> "_Work":
    """The print: dots as they were placed, or as a press prints them, with the primaries where inks overlap."""
    import numpy as np

    if press is None:
        dots = (found.dots[..., None] == np.arange(1, len(inks) + 1)).astype(np.float32)
        return _Work(inks, lamps, found, dots, tones, mesh, view)
    from scipy import ndimage

    from anisoscope.sim.light.ink.model import overprint
    from anisoscope.sim.proof.halftone import pressed

    if found.dots.size > MOST_PRESSED:
        raise UsageError(
            f"{found.dots.size:,} dots are more than the {MOST_PRESSED:,} of which a press is simulated: lower --dots"
        )
    result = pressed(found.dots, len(inks), press)
    primaries = [
        inks[one[0]] if len(one) == 1 else over.get(one) or overprint([inks[k] for k in one])
        for one in result.sets
    ]
    mean = ndimage.uniform_filter(result.shares, (TONE_DOTS, TONE_DOTS, 1), mode="nearest")
    return _Work(tuple(primaries), lamps, found, result.shares, mean, mesh, view, result)


def _print_summary(work: "_Work", exposure: float, written: list[Path], json_: bool) -> None:
    found = work.halftone
    if json_:
        content: dict[str, Any] = {
            "dots": list(found.dots.shape),
            "printed": found.printed.tolist(),
            "primaries": dict(zip([ink.name for ink in work.inks], work.coverage, strict=True)),
            "out_of_gamut": found.outside,
            "scaled_down": found.scaled,
            "exposure": exposure,
            "files": [str(path) for path in written],
        }
        print_json(content)
        return
    print_lines(
        f"{found.dots.shape[1]} × {found.dots.shape[0]} dots; out of gamut: {percent(found.outside)}, "
        f"coverages scaled down: {percent(found.scaled)}; exposure {exposure:.3g}."
    )
    if work.pressed is not None:
        rows = [
            [ink.name, f"{100.0 * share:.2f}"] for ink, share in zip(work.inks, work.coverage, strict=True)
        ]
        print_table("What the press makes of the dots", ["primary", "coverage [%]"], rows)
    for path in written:
        print_lines(f"{path}: written")


@dataclass(frozen=True, eq=False)
class _Work:
    """A print, and how it is looked at; dots and tones are (rows, cols, primaries)."""

    inks: "tuple[Ink, ...]"
    lamps: "list[Illuminant]"
    halftone: "Halftone"
    dots: "np.ndarray[Any, Any]"
    tones: "np.ndarray[Any, Any]"
    mesh: "Mesh | None"
    view: View
    pressed: "Pressed | None" = None

    @property
    def coverage(self) -> list[float]:
        """Of the print, by each primary."""
        found = self.halftone.printed if self.pressed is None else self.pressed.coverage
        return [float(share) for share in found]

    @property
    def shape(self) -> Literal["sphere", "cylinder", "plane", "mesh"]:
        return self.view.shape or ("cylinder" if self.mesh is None else "mesh")

    @property
    def scene(self) -> "Scene":
        from anisoscope.sim.proof.scene import Scene

        rows, cols = self.halftone.dots.shape
        return Scene(self.shape, self.view.yaw, self.view.pitch, cols / rows, mesh=self.mesh)

    def linear(self, size: int) -> "np.ndarray[Any, Any]":
        """(size, size, 3) linear light; where a pixel holds many dots, the tones are their mean."""
        import numpy as np

        from anisoscope.sim.light.ink.shading import Light
        from anisoscope.sim.materials.inks import with_roughness
        from anisoscope.sim.proof.render import PHOTO, ROUGHNESS, direction, proof_picture
        from anisoscope.sim.proof.scene import printed, surface

        view = self.view
        inks = self.inks
        if view.process is not None:
            inks = tuple(with_roughness(ink, ROUGHNESS[view.process]) for ink in inks)
        lights = [Light(direction(view.azimuth, view.elevation), np.pi, self.lamps[0])]
        if view.second:
            lights.append(Light(direction(*SECOND_LIGHT_DEG), 0.5 * np.pi, self.lamps[0]))
        where = surface(self.scene, size, size)
        extras = PHOTO if view.match else None
        cover = printed(where, self.tones)
        return proof_picture(where, inks, lights, cover, model=view.ink_model, extras=extras)

    def exposure(self) -> float:
        """Factor at which 99 % of the print are below 0.9."""
        import numpy as np

        brightest = self.linear(192).max(axis=-1)
        lit = brightest[brightest > 0.0]
        return BRIGHT / float(np.quantile(lit, 0.99)) if lit.size else 1.0

    def write_png(self, path: Path, size: int, exposure: float) -> None:
        import numpy as np

        from anisoscope.base.atomic_write import write_bytes
        from anisoscope.sim.proof.imagefile import picture_png
        from anisoscope.sim.proof.render import to_screen

        # four samples a pixel, so that edges and tones are even
        fine = self.linear(2 * size).reshape(size, 2, size, 2, 3).mean(axis=(1, 3))
        write_bytes(path, picture_png(np.ascontiguousarray(to_screen(fine, exposure))))


def _page(work: _Work, title: str, exposure: float, notes: tuple[str, ...], photo: Path | None) -> "Proof":
    import numpy as np

    from anisoscope.report.proof_page import Proof, ProofLight, ProofMesh
    from anisoscope.sim.light.colour.observer import white_point
    from anisoscope.sim.light.colour.spaces import linear_srgb
    from anisoscope.sim.proof.imagefile import photo_uri, read_image
    from anisoscope.sim.proof.render import ROUGHNESS, adaptation

    rows, cols = work.dots.shape[:2]
    mesh = work.mesh
    vertices = None if mesh is None else np.hstack([mesh.position, mesh.normal, mesh.tangent, mesh.uv])
    more = notes if mesh is None else (*notes, *(f"Mesh: {note}." for note in mesh.notes))
    return Proof(
        title=title,
        subtitle=f"{cols} × {rows} dots of {work.halftone.printed.size} inks "
        f"{'that never meet' if work.pressed is None else 'as a press prints them'} ({work.halftone.method}); "
        f"out of gamut {percent(work.halftone.outside)}, coverages scaled down {percent(work.halftone.scaled)}",
        inks=work.inks,
        lights=tuple(ProofLight(one, linear_srgb(white_point(one)), adaptation(one)) for one in work.lamps),
        halftone_pngs=_layers(work.dots),
        tones_pngs=_layers(work.tones),
        aspect=work.scene.aspect,
        exposure=exposure,
        fill=work.scene.fill,
        second_light_deg=SECOND_LIGHT_DEG,
        start=_start(work, photo is not None),
        roughness=(
            ("file", "as the ink files say", None),
            ("brushed", "brushed, 0.19", ROUGHNESS["brushed"]),
            ("binder-mixed", "binder-mixed, 0.30 (assumed)", ROUGHNESS["binder-mixed"]),
            ("own", "own value", None),
        ),
        facts=tuple(
            (ink.name, f"α {ink.alpha:g}; coverage {100 * share:.1f} %. {ink.source}")
            for ink, share in zip(work.inks, work.coverage, strict=True)
        ),
        notes=(
            *more,
            _CONVENTION,
        ),
        mesh=None
        if mesh is None or vertices is None
        else ProofMesh(vertices.astype(np.float32), mesh.triangles.astype(np.uint32)),
        photo=None if photo is None else photo_uri(read_image(photo)),
    )


def _layers(shares: "np.ndarray[Any, Any]") -> tuple[bytes, ...]:
    """Pictures of (rows, cols, P) coverages, three primaries each."""
    import numpy as np

    from anisoscope.sim.proof.imagefile import picture_png

    count = -(-shares.shape[2] // 3)
    codes = np.zeros((*shares.shape[:2], 3 * count), dtype=np.uint8)
    codes[..., : shares.shape[2]] = np.rint(255.0 * shares)
    return tuple(picture_png(np.ascontiguousarray(codes[..., 3 * n : 3 * n + 3])) for n in range(count))


def _around(degrees: float) -> float:
    return (degrees + 180.0) % 360.0 - 180.0


def _start(work: _Work, photo: bool) -> dict[str, Any]:
    from anisoscope.sim.proof.render import PHOTO

    view = work.view
    return {
        "shape": work.shape,
        "print": "halftone",
        "dots": "eye",
        "zoom": 1,
        "yaw": _around(view.yaw),
        "pitch": view.pitch,
        "illuminant": 0,
        "azimuth": _around(view.azimuth),
        "elevation": view.elevation,
        "drag": "print",
        "second": view.second,
        "exposure": 0,
        "adapt": False,
        "model": view.ink_model,
        "beside": "schlick" if view.ink_model != "schlick" else "goniochromatic",
        "roughness": view.process or "file",
        "alpha": work.inks[0].alpha,
        "match": view.match,
        "phong": PHOTO.phong,
        "shininess": PHOTO.shininess,
        "scattering": PHOTO.scattering,
        "behind": PHOTO.behind,
        "photo": photo,
    }
