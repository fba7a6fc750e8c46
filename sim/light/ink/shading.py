"""Pictures of printed shapes in directional light, by table.

Colours are linear sRGB, unclipped. With the default irradiance π, a perfect white tile that faces the light is
(1, 1, 1) under D65.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import ModelError
from anisoscope.sim.light import threads
from anisoscope.sim.light.colour.illuminant import Illuminant, standard
from anisoscope.sim.light.ink import tio2
from anisoscope.sim.light.ink.distributions import tail_of
from anisoscope.sim.light.ink.ink import Ink
from anisoscope.sim.light.ink.model import Model
from anisoscope.sim.light.ink.shapes import Surface
from anisoscope.sim.light.ink.table import InkTable, ink_table

Float32 = npt.NDArray[np.float32]
Direction = tuple[float, float, float]
Shade = Callable[[tuple[int, int], Float32], None]

UPWARD: Direction = (0.0, 0.0, 1.0)
ROWS_A_SHARE = 8
SHARES_A_THREAD = 4


@dataclass(frozen=True)
class Light:
    """Directional light.

    Attributes:
        to_light: direction to it; its length does not matter.
        irradiance: on a surface that faces it; π shows a perfect white tile as 1.
        illuminant: its spectrum.
    """

    to_light: Direction
    irradiance: float = float(np.pi)
    illuminant: Illuminant = field(default_factory=lambda: standard("d65"))


def _unit(direction: Direction) -> FloatArray:
    found = np.array(direction, dtype=np.float64)
    length = float(np.linalg.norm(found))
    if found.shape != (3,) or not 0.0 < length < np.inf:
        raise ModelError(f"a direction needs three finite components that are not all 0, not {direction}")
    return np.asarray(found / length)


def _checked_coverage(
    surface: Surface, inks: Sequence[Ink], lights: Sequence[Light], coverage: npt.ArrayLike | None
) -> Float32:
    if not inks or not lights:
        raise ModelError("a picture needs an ink and a light")
    if coverage is None:
        if len(inks) != 1:
            raise ModelError(f"{len(inks)} inks need a coverage: (rows, cols, {len(inks)})")
        return np.ones((1, 1, 1), dtype=np.float32)
    found = np.ascontiguousarray(coverage, dtype=np.float32)
    if found.shape not in ((1, 1, len(inks)), (*surface.normal.shape[:2], len(inks))):
        raise ModelError(
            f"the coverage must be (rows, cols, inks) = {(*surface.normal.shape[:2], len(inks))}, not {found.shape}"
        )
    return found


def picture(
    surface: Surface,
    inks: Sequence[Ink],
    lights: Sequence[Light],
    *,
    coverage: npt.ArrayLike | None = None,
    to_camera: Direction = UPWARD,
    model: Model = "goniochromatic",
    tio2_source: str = tio2.DEFAULT,
    out: Float32 | None = None,
) -> Float32:
    """(rows, cols, 3) linear sRGB of a print, Σ over lights and inks of E·w·f·cosθi, by table; 0 where nothing is.

    Args:
        surface: normals and tangents; of isotropic inks the tangents are not looked at.
        inks: K of them.
        lights: one or more, each with its own spectrum.
        coverage: (rows, cols, K) share of the paper under each ink, or (1, 1, K) everywhere alike; None for one ink
            that covers all.
        to_camera: direction to the camera, the same for all pixels.
        model: of the BRDF.
        tio2_source: data set of the model "tio2".
        out: (rows, cols, 3) picture to fill and return, such as that of the frame before: fresh memory costs time.

    Raises:
        ModelError: shapes that do not fit, a direction without length, and as :func:`ink_table`.
    """
    inks, covered = with_bases(inks, _checked_coverage(surface, inks, lights, coverage))
    normal = np.ascontiguousarray(surface.normal, dtype=np.float32)
    result = np.empty_like(normal) if out is None else _checked_target(out, normal)
    camera = _unit(to_camera)
    eye: Direction = tuple(map(np.float32, camera))  # type: ignore[assignment]
    beams = _beams(lights, camera)
    tables = [
        [ink_table(k, light.illuminant, model, tio2_source=tio2_source) for k in inks] for light in lights
    ]
    shade = _by_series(normal, covered, eye, beams, inks, tables)
    if shade is None:
        tangent = np.ascontiguousarray(surface.tangent, dtype=np.float32)
        shade = _by_table(normal, tangent, covered, eye, beams, inks, tables)
    most = min(SHARES_A_THREAD * threads.count(), -(-len(normal) // ROWS_A_SHARE))
    threads.each(lambda share: shade(share, result), threads.runs(len(normal), most))
    return result


def with_bases(inks: Sequence[Ink], coverage: Float32) -> tuple[tuple[Ink, ...], Float32]:
    """Inks and (rows, cols, K) coverage in which the base of an ink is one more ink that covers the same."""
    parts = [ink.parts for ink in inks]
    shares = np.repeat(coverage, [len(one) for one in parts], axis=2)
    return tuple(part for one in parts for part in one), np.ascontiguousarray(shares)


def _checked_target(out: Float32, normal: Float32) -> Float32:
    if out.shape != normal.shape or out.dtype != np.float32 or not out.flags.c_contiguous:
        raise ModelError(f"a picture is filled into a contiguous array of float32 of {normal.shape}")
    return out


def _beams(lights: Sequence[Light], camera: FloatArray) -> Float32:
    """(L, 8) direction to every light, half vector, irradiance/4, 1 − cosθd."""
    found = []
    for light in lights:
        one = _unit(light.to_light)
        half = (one + camera) / max(float(np.linalg.norm(one + camera)), 1e-12)
        found.append([*one, *half, 0.25 * light.irradiance, 1.0 - float(np.clip(one @ half, 0.0, 1.0))])
    return np.array(found, dtype=np.float32)


def _by_table(
    normal: Float32,
    tangent: Float32,
    covered: Float32,
    eye: Direction,
    beams: Float32,
    inks: Sequence[Ink],
    tables: list[list[InkTable]],
) -> Shade:
    from anisoscope.sim.light.ink.kernels import SCRATCH, shade  # noqa: PLC0415 - loads the compiler

    colours = np.array([[table.with_steps for table in row] for row in tables])
    given = (eye, beams, lobes(inks), colours, tables[0][0].model != "goniochromatic")

    def rows(share: tuple[int, int], result: Float32) -> None:
        work = np.empty((SCRATCH, normal.shape[1]), dtype=np.float32)
        shade(normal, tangent, covered, *given, *share, work, result)

    return rows


def _by_series(
    normal: Float32,
    covered: Float32,
    eye: Direction,
    beams: Float32,
    inks: Sequence[Ink],
    tables: list[list[InkTable]],
) -> Shade | None:
    """Without look-up, which is twice as fast; None where lobes or colours need the table."""
    series = [[table.series for table in row] for row in tables]
    usual = tables[0][0].model == "goniochromatic" and all(
        k.isotropic and tail_of(k.distribution) == 1.0 for k in inks
    )
    if not usual or any(one is None for row in series for one in row):
        return None
    from anisoscope.sim.light.ink.series_kernels import SCRATCH, shade_by_series  # noqa: PLC0415 - as above

    terms = np.array(series, dtype=np.float32)
    even = covered.shape[:2] == (1, 1)
    if even:
        terms *= covered[0, 0, :, None, None]
    flat, alphas = normal.reshape(len(normal), -1), np.array([k.alpha for k in inks], dtype=np.float32)
    given = (flat, covered.reshape(len(covered), -1), eye, beams, alphas, terms, even)

    def rows(share: tuple[int, int], result: Float32) -> None:
        work = np.empty((SCRATCH, normal.shape[1]), dtype=np.float32)
        shade_by_series(*given, *share, work, result.reshape(len(normal), -1))

    return rows


def lobes(inks: Sequence[Ink]) -> Float32:
    """(K, 6) α_x, α_y, cosine and sine of the brushing, tail of the lobe, 1 for an anisotropic one."""
    return np.array(
        [
            [
                ink.alpha,
                ink.across,
                np.cos(np.radians(ink.brush_deg)),
                np.sin(np.radians(ink.brush_deg)),
                tail_of(ink.distribution),
                not ink.isotropic,
            ]
            for ink in inks
        ],
        dtype=np.float32,
    )
