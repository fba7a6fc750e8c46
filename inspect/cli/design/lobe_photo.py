"""``anisoscope design compare-lobe``: a photographed lobe against its design."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from anisoscope.base.errors import UsageError
from anisoscope.cli.help_page import everyday
from anisoscope.cli.json_output import print_json
from anisoscope.cli.options import Json, parse_numbers
from anisoscope.cli.tables import print_table

if TYPE_CHECKING:
    from anisoscope.base.arrays import FloatArray
    from anisoscope.sim.design.appearance import LobeComparison
    from anisoscope.sim.design.designfile import DesignFile
    from anisoscope.sim.design.layout import Layout

MARKS = "COL,ROW=X,Y of four marks, ;-separated"


@everyday(
    "design",
    "wavelength",
    "distance",
    "light",
    "screen_tilt",
    "marks",
    "pixel_mm",
    "background",
    "reach",
    "png",
    "json_",
)
def compare_lobe(
    photo: Path,
    /,
    *,
    design: Annotated[Path, Parameter(help="Design *.toml or layout *.npz that the sample was made of.")],
    wavelength: Annotated[float, Parameter(help="Wavelength of the lamp, nm.")],
    distance: Annotated[
        float, Parameter(help="From the sample to where the mirrored beam meets the screen, mm.")
    ],
    light: Annotated[
        str, Parameter(help="Direction of the light: inclination and azimuth, degrees.")
    ] = "0,0",
    screen_tilt: Annotated[
        str, Parameter(help="Turns of the screen about its x and y axes, degrees; 0,0 faces the beam.")
    ] = "0,0",
    marks: Annotated[
        str | None, Parameter(help=f"{MARKS}: pixels, and mm on the screen from the mirrored beam.")
    ] = None,
    pixel_mm: Annotated[
        float | None, Parameter(help="Instead of marks: mm on the screen of a pixel; seen straight on.")
    ] = None,
    center: Annotated[
        str | None,
        Parameter(help="With --pixel-mm: COL,ROW of the mirrored beam; the middle if not given."),
    ] = None,
    from_behind: Annotated[
        bool, Parameter(negative="", help="With --pixel-mm: the camera looks at the back of the screen.")
    ] = False,
    background: Annotated[float, Parameter(help="Grey value without the lamp.")] = 0.0,
    tone: Annotated[
        Literal["linear", "srgb"],
        Parameter(help="Greys of the photograph: proportional to light, or sRGB of a camera for people."),
    ] = "linear",
    lamp_half_angle: Annotated[
        float | None,
        Parameter(
            help="Half of the angle subtended by a round lamp, degrees; the design's source if not given."
        ),
    ] = None,
    reach: Annotated[float, Parameter(help="Largest |h_x| and |h_y|, from the mirrored beam.")] = 0.12,
    points: Annotated[int, Parameter(help="Directions along each axis, 16 to 256.")] = 64,
    png: Annotated[Path | None, Parameter(help="Picture of photograph, design and their difference.")] = None,
    json_: Json = False,
) -> int:
    """Read a lobe back from a photograph of the screen it falls on, and compare it with the design.

    Lamp, sample and screen are known; four marks on the screen, or the scale of the picture, fix the camera.
    Prints SSIM, correlation and the light of sixteen areas. Clipped pixels count for nothing.

    Args:
        photo: Grey or colour photograph, 8 or 16 bits.

    Examples:
        anisoscope design compare-lobe lobe.png --design unit.npz --wavelength 532 --distance 500 --pixel-mm 0.5
    """
    from anisoscope.cli.design.image import check_target, draw_panels
    from anisoscope.sim.design.appearance import (
        Grid,
        Screen,
        compared_lobes,
        designed_intensity,
        photographed_intensity,
    )
    from anisoscope.sim.light.wave.windows import Extent

    check_target(png, ".png", "--png")
    if not 16 <= points <= 256 or not 100.0 <= wavelength <= 20000.0:
        raise UsageError("--points takes 16 to 256, --wavelength 100 to 20000 nm")
    if (marks is None) == (pixel_mm is None):
        raise UsageError(f"give either --marks ({MARKS}), or --pixel-mm")
    screen = Screen(distance, _pair(light, "--light"), _pair(screen_tilt, "--screen-tilt"))
    seen = _photograph(photo, background, tone)
    to_pixels = (
        _from_marks(marks)
        if marks is not None
        else _from_scale(pixel_mm, center, seen.shape, from_behind=from_behind)
    )
    source = None
    if lamp_half_angle is not None:
        if not 0.0 < lamp_half_angle <= 10.0:
            raise UsageError(f"--lamp-half-angle takes above 0 to 10°, not {lamp_half_angle:g}°")
        import numpy as np

        source = Extent("disc", 2.0 * float(np.sin(np.radians(lamp_half_angle))))
    grid = Grid.of(screen, reach, points)
    measured, _ = photographed_intensity(seen, to_pixels, screen, grid)
    found = compared_lobes(measured, designed_intensity(_design(design), grid, wavelength, source), grid)
    if png is not None:
        top = float(found.designed.max())
        off = found.photographed - found.designed
        draw_panels(
            [
                (found.photographed, "photographed", "inferno", 0.0, top),
                (found.designed, "designed", "inferno", 0.0, top),
                (off, "photographed − designed", "PuOr", -top, top),
            ],
            reach,
            png,
        )
    if json_:
        print_json(found)
        return 0
    _print(found, png)
    return 0


def _print(found: "LobeComparison", png: Path | None) -> None:
    h_x, h_y = found.shift_h
    print_table(
        "photographed lobe against its design",
        ["quantity", "value", "unit"],
        [
            ["SSIM", f"{found.ssim:.3f}", "1"],
            ["correlation", f"{found.correlation:.4f}", "1"],
            ["difference, relative L2", f"{found.rel_l2:.3f}", "1"],
            ["displaced along h_x, h_y", f"{h_x:+.4f}, {h_y:+.4f}".replace("-", "−"), "1"],
            ["directions that the camera clipped", f"{100.0 * found.clipped:.1f}", "%"],
        ],
    )
    many = len(found.areas)
    print_table(
        "light of each area over that of the design (share of the designed light), top: largest h_y",
        [f"column {number + 1}" for number in range(many)],
        [
            [
                f"{ratio:.2f} ({100.0 * share:.1f} %)" if share > 1e-4 else "–"
                for ratio, share in zip(ratios, shares, strict=True)
            ]
            for ratios, shares in zip(found.areas[::-1], found.designed_areas[::-1], strict=True)
        ],
        caption="" if png is None else f"written: {png}",
    )


def _pair(text: str, option: str) -> tuple[float, float]:
    numbers = parse_numbers(text, option)
    if len(numbers) != 2:
        raise UsageError(f"{option} takes two numbers A,B, not {text!r}")
    return numbers[0], numbers[1]


def _photograph(path: Path, background: float, tone: str) -> "FloatArray":
    """(rows, cols) light, NaN where a channel clips."""
    import cv2
    import numpy as np

    data = np.fromfile(path, dtype=np.uint8) if path.is_file() else np.zeros(0, dtype=np.uint8)
    found = cv2.imdecode(data, cv2.IMREAD_UNCHANGED) if data.size else None
    if found is None or found.dtype not in (np.dtype(np.uint8), np.dtype(np.uint16)):
        raise UsageError(f"{path}: no photograph of 8 or 16 bits; give a PNG, TIFF or JPEG")
    top = 255.0 if found.dtype == np.uint8 else 65535.0
    channels = np.atleast_3d(found)[..., :3].astype(np.float64)
    if not 0.0 <= background < top:
        raise UsageError(f"--background takes a grey value from 0 to below {top:g}, not {background:g}")

    def light(value: "FloatArray") -> "FloatArray":
        share = value / top
        if tone == "linear":
            return share
        # IEC 61966-2-1
        return np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)

    grey = light(channels).mean(axis=-1) - float(light(np.array(background)))
    return np.where((channels >= top).any(axis=-1), np.nan, grey)


def _from_marks(text: str) -> "FloatArray":
    """(3, 3) homography from mm on the screen to pixels."""
    import cv2
    import numpy as np

    pairs = [part.split("=") for part in text.split(";") if part.strip()]
    if len(pairs) != 4 or any(len(pair) != 2 for pair in pairs):
        raise UsageError(f"--marks takes {MARKS}, not {text!r}")
    pixels, places = (
        np.array([_pair(pair[which], "--marks") for pair in pairs], dtype=np.float32) for which in (0, 1)
    )
    for what in (pixels, places):
        corners = [what[np.array(three)] for three in ((0, 1, 2), (0, 1, 3), (0, 2, 3), (1, 2, 3))]
        across = [abs((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])) for a, b, c in corners]
        if min(across) < 1e-3 * float(np.ptp(what)) ** 2:
            raise UsageError(
                "--marks: three of the marks lie on a line: take four that are corners of a quadrangle"
            )
    return np.asarray(cv2.getPerspectiveTransform(places, pixels), dtype=np.float64)


def _from_scale(
    pixel_mm: float | None, center: str | None, shape: tuple[int, ...], *, from_behind: bool
) -> "FloatArray":
    """(3, 3) homography of a picture seen straight on, y up; x runs to the left as seen from the sample."""
    import numpy as np

    if pixel_mm is None or not 0.0 < pixel_mm < float("inf"):
        raise UsageError(f"--pixel-mm must be a positive length, not {pixel_mm}")
    col, row = (0.5 * (shape[1] - 1), 0.5 * (shape[0] - 1)) if center is None else _pair(center, "--center")
    along = 1.0 / pixel_mm
    return np.array([[along if from_behind else -along, 0.0, col], [0.0, -along, row], [0.0, 0.0, 1.0]])


def _design(path: Path) -> "DesignFile | Layout":
    from anisoscope.sim.design.designfile import read_design, read_layout

    if path.suffix.lower() == ".toml":
        return read_design(path)
    if path.suffix.lower() == ".npz":
        return read_layout(path)[0]
    raise UsageError(f"--design {path}: takes a design *.toml or a layout *.npz")
