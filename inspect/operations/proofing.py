"""Images as prints of structural-colour inks: dots and films of a halftone, and how a print will look."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy import ndimage

from anisoscope.base.arrays import FloatArray
from anisoscope.base.atomic_write import write_bytes
from anisoscope.base.errors import UsageError
from anisoscope.base.json_fields import LEFT_OUT, in_json, json_field
from anisoscope.base.progress import Advance, silent
from anisoscope.parameters.keywords import by_keywords
from anisoscope.parameters.proof import FilmSettings, ProofSettings, ProofView, Separating
from anisoscope.report.proof_page import Proof, ProofLight, ProofMesh, write_proof_page
from anisoscope.sim.light.colour.illuminant import Illuminant
from anisoscope.sim.light.colour.observer import white_point
from anisoscope.sim.light.colour.spaces import encode, linear_srgb
from anisoscope.sim.light.ink.ink import Ink
from anisoscope.sim.light.ink.model import overprint
from anisoscope.sim.light.ink.shading import Light
from anisoscope.sim.materials.inks import SYNTHETIC, find_ink, with_roughness
from anisoscope.sim.materials.spectra import find_illuminant
from anisoscope.sim.proof.halftone import Float32, Halftone, Method, Press, Pressed, coverage, pressed
from anisoscope.sim.proof.halftone import halftone as place_dots
from anisoscope.sim.proof.imagefile import (
    MM_AN_INCH,
    Image,
    dots_png,
    film_png,
    photo_uri,
    picture_png,
    read_image,
    to_dots,
)
from anisoscope.sim.proof.mesh import Mesh, read_obj
from anisoscope.sim.proof.render import PHOTO, ROUGHNESS, adaptation, direction, proof_picture, to_screen
from anisoscope.sim.proof.scene import Scene, Shape, printed, surface
from anisoscope.sim.proof.separation import Separation, separation

SECOND_LIGHT_DEG = (-15.0, 35.0)
CONVENTION = (
    "Colours are linear sums of coverage times the inks' colours in sRGB, clipped at the end; the eye looks along "
    "parallel rays. Sphere and cylinder bear the print on each half; backs are bare paper."
)
BRIGHT = 0.9
MOST_DOTS = 16384
STILL_SIDE = 360
TONE_DOTS = 8
MOST_PRESSED = 16_000_000
BRIGHT_SHEET = 0.1
"""Light of a sheet over that of white from which on it is said what it costs."""


def percent(share: float) -> str:
    """A share in words."""
    return "none" if share == 0.0 else f"{100.0 * share:.{2 if share < 0.995 else 3}g} %"


def _inks(given: Sequence[Ink | str]) -> tuple[Ink, ...]:
    return tuple(find_ink(one) if isinstance(one, str) else one for one in given or SYNTHETIC)


@dataclass(frozen=True, eq=False)
class Films:
    """An image as dots, with a film for the screen of every ink.

    Attributes:
        halftone: where which ink goes.
        separation: how colours became coverages.
        inks: in the order of the dots.
        dpi: dots per inch.
        notes: what was converted in the image.
    """

    halftone: Halftone = field(metadata=LEFT_OUT)
    separation: Separation = field(metadata=LEFT_OUT)
    inks: tuple[Ink, ...] = field(metadata=LEFT_OUT)
    dpi: float
    notes: tuple[str, ...]

    @property
    @in_json()
    def rows(self) -> int:
        """Rows of dots."""
        return int(self.halftone.dots.shape[0])

    @property
    @in_json()
    def cols(self) -> int:
        """Columns of dots."""
        return int(self.halftone.dots.shape[1])

    @property
    @in_json()
    def method(self) -> Method:
        """How the dots were placed."""
        return self.halftone.method

    @property
    @in_json()
    def aimed(self) -> dict[str, float]:
        """Requested mean coverage, by ink."""
        return dict(zip([ink.name for ink in self.inks], self.halftone.aimed.tolist(), strict=True))

    @property
    @in_json()
    def printed(self) -> dict[str, float]:
        """Mean coverage of the dots, by ink."""
        return dict(zip([ink.name for ink in self.inks], self.halftone.printed.tolist(), strict=True))

    @property
    @in_json()
    def block_error_max(self) -> float | None:
        """Largest difference of the two in a block of 64 × 64 dots."""
        return float(self.halftone.block_error.max()) if self.halftone.block_error.size else None

    @property
    @in_json()
    def out_of_gamut(self) -> float:
        """Share of pixels whose colour the inks cannot mix."""
        return self.halftone.outside

    @property
    @in_json()
    def scaled_down(self) -> float:
        """Share of pixels whose coverages summed up to more than 1."""
        return self.halftone.scaled

    def write(self, out: Path | str, *, negative: bool = False) -> tuple[Path, ...]:
        """Write a PNG of all dots, and the films next to it, and return their paths.

        Args:
            out: picture of all dots.
            negative: films with white where the ink goes; else black, as screens need them.

        Raises:
            RecordError: a file cannot be written.
        """
        paths = film_paths(Path(out), self.inks)
        tints = encode(self.separation.colours.T / self.separation.colours.max()).srgb
        palette = np.rint(255.0 * np.vstack([np.zeros(3), tints])).astype(np.uint8)
        write_bytes(paths[0], dots_png(self.halftone.dots, palette, self.dpi))
        for number, path in enumerate(paths[1:]):
            write_bytes(path, film_png(self.halftone.mask(number), self.dpi, positive=not negative))
        return paths


def _separated(inks: tuple[Ink, ...], lamp: Illuminant, how: Separating) -> Separation:
    return separation(
        inks, lamp, way=how.way, angle_deg=how.angle_deg, gain=how.gain, substrate=how.substrate
    )


def _notes(picture: Image, plan: Separation) -> tuple[str, ...]:
    """What was converted in an image, and what a bright sheet costs it."""
    if plan.sheet_share < BRIGHT_SHEET:
        return picture.notes
    note = (
        f"darker than {percent(plan.sheet_share)} of white, the light of the sheet without ink at {plan.angle_deg:g}°, "
        "nothing can be printed: take a darker sheet"
    )
    return (*picture.notes, note)


def film_paths(out: Path, inks: Sequence[Ink]) -> tuple[Path, ...]:
    """The picture of all dots and, next to it, each ink's film, named after the ink."""
    names = [out]
    for number, ink in enumerate(inks, start=1):
        slug = re.sub(r"[^a-z0-9]+", "-", ink.name.lower()).strip("-") or f"ink-{number}"
        path = out.with_name(f"{out.stem}-{slug}.png")
        names.append(out.with_name(f"{out.stem}-{slug}-{number}.png") if path in names else path)
    return tuple(names)


@by_keywords(films=FilmSettings)
def halftone(
    image: Path | str,
    inks: Sequence[Ink | str] = (),
    *,
    films: FilmSettings,
    on_progress: Advance = silent,
) -> Films:
    """Dots of three or four inks that never meet.

    Args:
        image: picture; its colour profile is applied.
        inks: red, green, blue, and perhaps white: inks, ink files or names; the synthetic ones by default.
        films: `FilmSettings`.
        on_progress: called with the work being done, steps done and steps in all.

    Raises:
        UsageError: no picture, ink or light of this name, or a size that means nothing.
        ModelError: inks that mix no white, or as the separation.
    """
    chosen = _inks(inks)
    lamp = find_illuminant(films.illuminant)
    plan = _separated(chosen, lamp, films)
    picture = read_image(Path(image))
    size = films.width_mm
    dots = picture.srgb.shape[1] if size is None else round(size / MM_AN_INCH * films.dpi)
    found = place_dots(to_dots(picture, dots), plan, films.method, advance=on_progress)
    return Films(found, plan, chosen, films.dpi, _notes(picture, plan))


def _of_halftone(found: Halftone) -> dict[str, Any]:
    return {
        "dots": found.dots.shape,
        "printed": found.printed,
        "out_of_gamut": found.outside,
        "scaled_down": found.scaled,
    }


@dataclass(frozen=True, eq=False)
class SoftProof:
    """A print, and how it is looked at; dots and tones are (rows, cols, primaries).

    Attributes:
        inks: primaries: the inks, and what they are on top of each other.
        lamps: lights of the page; the first is that of the picture.
        halftone: the dots.
        dots: share of every dot that a primary covers.
        tones: the same as continuous tones.
        view: shape, turn and lights.
        notes: what was converted in the image.
        mesh: shape to print on.
        pressed: what a press makes of the dots.
        substrate: diffuse reflectance of the sheet.
        exposure: factor on linear light at which 99 % of the print are below 0.9.
    """

    inks: tuple[Ink, ...] = field(metadata=LEFT_OUT)
    lamps: tuple[Illuminant, ...] = field(metadata=LEFT_OUT)
    halftone: Halftone = field(metadata=json_field(by=_of_halftone, merged=True))
    dots: Float32 = field(metadata=LEFT_OUT)
    tones: Float32 = field(metadata=LEFT_OUT)
    view: ProofView = field(metadata=LEFT_OUT)
    notes: tuple[str, ...] = field(metadata=LEFT_OUT)
    mesh: Mesh | None = field(metadata=LEFT_OUT)
    pressed: Pressed | None = field(metadata=LEFT_OUT)
    substrate: float = field(default=0.0, metadata=LEFT_OUT)
    exposure: float = 1.0

    @property
    @in_json()
    def primaries(self) -> dict[str, float]:
        """Coverage of the print by each primary."""
        found = self.halftone.printed if self.pressed is None else self.pressed.coverage
        return dict(zip([ink.name for ink in self.inks], map(float, found), strict=True))

    @property
    def shape(self) -> Shape:
        """What is printed on."""
        return self.view.shape or ("cylinder" if self.mesh is None else "mesh")

    @property
    def scene(self) -> Scene:
        """The shape, turned."""
        rows, cols = self.halftone.dots.shape
        return Scene(self.shape, self.view.yaw_deg, self.view.pitch_deg, cols / rows, mesh=self.mesh)

    def linear(self, size: int) -> Float32:
        """(size, size, 3) linear light; where a pixel holds many dots, the tones are their mean."""
        view, inks = self.view, self.inks
        if view.process is not None:
            inks = tuple(with_roughness(ink, ROUGHNESS[view.process]) for ink in inks)
        lights = [Light(direction(view.azimuth_deg, view.elevation_deg), np.pi, self.lamps[0])]
        if view.second:
            lights.append(Light(direction(*SECOND_LIGHT_DEG), 0.5 * np.pi, self.lamps[0]))
        where = surface(self.scene, size, size)
        extras = PHOTO if view.match else None
        cover = printed(where, self.tones)
        return proof_picture(
            where, inks, lights, cover, model=view.ink_model, extras=extras, substrate=self.substrate
        )

    def exposed(self) -> "SoftProof":
        """The same with its exposure."""
        brightest = self.linear(192).max(axis=-1)
        lit = brightest[brightest > 0.0]
        return replace(self, exposure=BRIGHT / float(np.quantile(lit, 0.99)) if lit.size else 1.0)

    def picture(self, size: int = 1024) -> np.ndarray[Any, Any]:
        """(size, size, 3) 8-bit sRGB."""
        # four samples a pixel, so that edges and tones are even
        fine = self.linear(2 * size).reshape(size, 2, size, 2, 3).mean(axis=(1, 3))
        return np.ascontiguousarray(to_screen(fine, self.exposure))

    def write_picture(self, path: Path | str, size: int = 1024) -> None:
        """Write the picture as PNG, atomically.

        Raises:
            RecordError: the file cannot be written.
        """
        write_bytes(Path(path), picture_png(self.picture(size)))

    def write_page(
        self, path: Path | str, title: str = "Soft proof", photo: Path | str | None = None
    ) -> None:
        """Write a page to turn the print in the browser.

        Args:
            path: HTML file.
            title: of the page.
            photo: photograph to show next to the proof.

        Raises:
            UsageError: an ink whose distribution the page does not know, more dots than it can show, or no photograph.
            RecordError: the file cannot be written.
        """
        if max(self.halftone.dots.shape) > MOST_DOTS:
            raise UsageError(_too_many(*self.halftone.dots.shape))
        write_proof_page(self._page(title, None if photo is None else Path(photo)), Path(path))

    def _page(self, title: str, photo: Path | None) -> Proof:
        rows, cols = self.dots.shape[:2]
        found, mesh = self.halftone, self.mesh
        how = "that never meet" if self.pressed is None else "as a press prints them"
        return Proof(
            title=title,
            subtitle=f"{cols} × {rows} dots of {found.printed.size} inks {how} ({found.method}); out of gamut "
            f"{percent(found.outside)}, coverages scaled down {percent(found.scaled)}",
            inks=self.inks,
            lights=tuple(
                ProofLight(one, linear_srgb(white_point(one)), adaptation(one)) for one in self.lamps
            ),
            halftone_pngs=_layers(self.dots),
            tones_pngs=_layers(self.tones),
            aspect=self.scene.aspect,
            exposure=self.exposure,
            fill=self.scene.fill,
            second_light_deg=SECOND_LIGHT_DEG,
            start=self._start(photo is not None),
            roughness=(
                ("file", "as the ink files say", None),
                ("brushed", "brushed, 0.19", ROUGHNESS["brushed"]),
                ("binder-mixed", "binder-mixed, 0.30 (assumed)", ROUGHNESS["binder-mixed"]),
                ("own", "own value", None),
            ),
            facts=tuple(
                (ink.name, f"α {ink.alpha:g}; coverage {100 * share:.1f} %. {ink.source}")
                for ink, share in zip(self.inks, self.primaries.values(), strict=True)
            ),
            notes=(
                *(f"Image: {note}." for note in self.notes),
                *(() if mesh is None else (f"Mesh: {note}." for note in mesh.notes)),
                CONVENTION,
            ),
            mesh=None if mesh is None else _vertices(mesh),
            photo=None if photo is None else photo_uri(read_image(photo)),
            still=picture_png(self.picture(STILL_SIDE)),
            substrate=self.substrate,
        )

    def _start(self, photo: bool) -> dict[str, Any]:
        view = self.view
        return {
            "shape": self.shape,
            "print": "halftone",
            "dots": "eye",
            "zoom": 1,
            "yaw": _around(view.yaw_deg),
            "pitch": view.pitch_deg,
            "illuminant": 0,
            "azimuth": _around(view.azimuth_deg),
            "elevation": view.elevation_deg,
            "drag": "print",
            "second": view.second,
            "exposure": 0,
            "adapt": False,
            "model": view.ink_model,
            "beside": "schlick" if view.ink_model != "schlick" else "goniochromatic",
            "roughness": view.process or "file",
            "alpha": self.inks[0].alpha,
            "match": view.match,
            "phong": PHOTO.phong,
            "shininess": PHOTO.shininess,
            "scattering": PHOTO.scattering,
            "behind": PHOTO.behind,
            "photo": photo,
        }


def _too_many(rows: int, cols: int) -> str:
    return f"{cols} × {rows} dots are more than the {MOST_DOTS} a side that a page can show: lower --dots"


def _vertices(mesh: Mesh) -> ProofMesh:
    vertices: FloatArray = np.hstack([mesh.position, mesh.normal, mesh.tangent, mesh.uv])
    return ProofMesh(vertices.astype(np.float32), mesh.triangles.astype(np.uint32))


def _layers(shares: Float32) -> tuple[bytes, ...]:
    """Pictures of (rows, cols, P) coverages, three primaries each."""
    count = -(-shares.shape[2] // 3)
    codes = np.zeros((*shares.shape[:2], 3 * count), dtype=np.uint8)
    codes[..., : shares.shape[2]] = np.rint(255.0 * shares)
    return tuple(picture_png(np.ascontiguousarray(codes[..., 3 * n : 3 * n + 3])) for n in range(count))


def _around(degrees: float) -> float:
    return (degrees + 180.0) % 360.0 - 180.0


@by_keywords(settings=ProofSettings)
def soft_proof(
    image: Path | str,
    inks: Sequence[Ink | str] = (),
    *,
    settings: ProofSettings,
    view: ProofView | None = None,
    press: Press | None = None,
    overprints: Mapping[tuple[int, ...], Ink] | None = None,
    paged: bool = False,
    on_progress: Advance = silent,
) -> SoftProof:
    """How a print of an image will look from all sides.

    Args:
        image: picture to print.
        inks: as for a halftone.
        settings: `ProofSettings`.
        view: shape, turn and lights of the picture.
        press: errors of the press; None for one without.
        overprints: measured inks on each other, by their numbers from below, counted from 0; else they are modelled.
        paged: refuse more dots than a page can show before they are placed.
        on_progress: called with the work being done, steps done and steps in all.

    Raises:
        UsageError: a file that cannot be used, or more dots than can be shown or pressed.
        ModelError: inks that mix no white, or as the separation.
    """
    chosen = _inks(inks)
    lamps = tuple(find_illuminant(text) for text in settings.illuminants)
    solid = None if settings.mesh is None else read_obj(Path(settings.mesh))
    plan = _separated(chosen, lamps[0], settings)
    picture: Image = read_image(Path(image))
    pixels = to_dots(picture, settings.dots or picture.srgb.shape[1])
    # The page holds all dots in one WebGL texture, whose side is limited; a PNG has no such limit.
    if paged and max(pixels.shape[:2]) > MOST_DOTS:
        raise UsageError(_too_many(*pixels.shape[:2]))
    found = place_dots(pixels, plan, settings.method, advance=on_progress)
    on_progress("press", 0, 1)
    primaries, result = chosen, None
    if press is None:
        shares = (found.dots[..., None] == np.arange(1, len(chosen) + 1)).astype(np.float32)
        tones = coverage(pixels, plan)
    else:
        if found.dots.size > MOST_PRESSED:
            raise UsageError(
                f"{found.dots.size:,} dots are more than the {MOST_PRESSED:,} of which a press is simulated: "
                "lower --dots"
            )
        result = pressed(found.dots, len(chosen), press)
        known, shares = overprints or {}, result.shares
        primaries = tuple(
            chosen[one[0]] if len(one) == 1 else known.get(one) or overprint([chosen[k] for k in one])
            for one in result.sets
        )
        tones = ndimage.uniform_filter(shares, (TONE_DOTS, TONE_DOTS, 1), mode="nearest")
    return SoftProof(
        primaries,
        lamps,
        found,
        shares,
        tones,
        view or ProofView(),
        _notes(picture, plan),
        solid,
        result,
        settings.substrate,
    ).exposed()
