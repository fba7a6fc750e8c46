"""How a design looks: its lobe on a screen, dots mirrored in it, a pattern under two lights; and a photographed lobe.

Colours are those of the CIE 1931 observer under daylight (D65) or a line; brightness is scaled, not absolute.

A photograph of the screen is read back to half vectors. A lamp shines on a small sample, whose lobe falls on a diffuse
screen. A point P of it, r from the sample, is lit with E ∝ I(v)·cos θ/r², v = P/r and θ the angle to the screen's
normal; the radiant intensity is I(v) ∝ BRDF·v_z. The screen is Lambertian: every direction of the camera sees the same
(Levin et al. 2013, section 4 and Fig. 9).
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import ModelError
from anisoscope.base.json_fields import LEFT_OUT
from anisoscope.sim.design.depths import Depths
from anisoscope.sim.design.designfile import DesignFile
from anisoscope.sim.design.layout import Layout
from anisoscope.sim.design.models import model_density
from anisoscope.sim.light.colour.illuminant import standard
from anisoscope.sim.light.colour.observer import matching_functions, xyz_weights
from anisoscope.sim.light.colour.spaces import encode, linear_srgb
from anisoscope.sim.light.wave.correlation import DensityLadder
from anisoscope.sim.light.wave.surface import WaveSurface
from anisoscope.sim.light.wave.windows import Extent, Window

WHITE_NM = tuple(float(w) for w in np.arange(400.0, 701.0, 20.0))
LINE_NM = 550.0
POINTS = 161
REACH = 0.2
DOT_UM = 112.0
AREAS = 4
"""Areas of a photograph along each axis, whose shares of the light are compared."""

BRIGHTEST = 99.7
"""Percentile of the brightness that is shown as white: a spike may saturate, the lobe must remain visible."""


@dataclass(frozen=True, eq=False)
class Picture:
    """A picture, first row at the top.

    Attributes:
        srgb: (rows, cols, 3) encoded sRGB, 0 to 1.
        caption: what it shows.
    """

    srgb: FloatArray
    caption: str


def spectral_density(
    design: DesignFile, wavelengths_nm: Sequence[float], h: FloatArray, dot_um: float = DOT_UM
) -> FloatArray:
    """(W, H, H) density over half vectors times 1/λ² (the γ² of a surface), rows along rising h_y.

    The design's coherence length belongs to its wavelength; at others the same source has another.
    """
    found = []
    depths = Depths(design.passes_nm, design.band_nm) if design.passes_nm else None
    for nm in wavelengths_nm:
        tau = 1.0 if depths is None else depths.tau_at(nm)
        f = 2.0 * h / (1e-3 * nm)
        coherence = design.coherence_um * nm / design.wavelength_nm
        found.append(model_density(design.model, f, f, coherence, dot_um, tau) / (1e-3 * nm) ** 2)
    return np.stack(found)


def screen(design: DesignFile, *, white: bool) -> Picture:
    """The light that the design throws on a diffuse screen (Levin et al. 2013, Fig. 8 and 9)."""
    h = np.linspace(-REACH, REACH, POINTS)
    light = "white light (D65)" if white else f"{LINE_NM:g} nm"
    return Picture(
        _coloured(spectral_density(design, _lines(white), h), white),
        f"Lobe on a screen, {light}; |h| ≤ {REACH:g}",
    )


def mirrored_dots(design: DesignFile, *, white: bool) -> Picture:
    """A plane with dots reflected in the design: every dot is blurred by the lobe (Levin et al. 2013, Fig. 10)."""
    h = np.linspace(-2.0 * REACH, 2.0 * REACH, 2 * POINTS - 1)
    one = spectral_density(design, _lines(white), h)
    step = POINTS // 3
    total = np.zeros((one.shape[0], POINTS, POINTS))
    for down in (-1, 0, 1):
        for over in (-1, 0, 1):
            y, x = POINTS // 2 + 1 - down * step, POINTS // 2 + 1 - over * step
            total += one[:, y - 1 : y - 1 + POINTS, x - 1 : x - 1 + POINTS]
    light = "white light (D65)" if white else f"{LINE_NM:g} nm"
    return Picture(_coloured(total, white), f"Nine dots mirrored in the design, {light}")


def _lines(white: bool) -> tuple[float, ...]:
    return WHITE_NM if white else (LINE_NM,)


def _coloured(density: FloatArray, white: bool) -> FloatArray:
    """(rows, cols, 3) encoded sRGB, rows from the top."""
    if white:
        weights = xyz_weights(standard("d65"), np.array(WHITE_NM))
    else:
        nm, functions = matching_functions()
        weights = np.array([[np.interp(LINE_NM, nm, functions[:, k]) for k in range(3)]])
    xyz = np.moveaxis(density, 0, -1)[::-1] @ weights
    linear = linear_srgb(xyz / max(float(np.percentile(xyz[..., 1], BRIGHTEST)), 1e-12))
    if not white:  # a pure line lies outside of every screen's colours
        linear = np.clip(linear, 0.0, None)
    return encode(linear).srgb


def pattern_under(
    layout: Layout, designs: Sequence[DesignFile], h_x: float, h_y: float, most: int = 512
) -> tuple[FloatArray, FloatArray]:
    """Brightness of a layout under white light from one direction, camera above.

    Args:
        layout: the dots.
        designs: of every class.
        h_x: half vector along x.
        h_y: half vector along y.
        most: larger layouts are thinned to this many dots a side.

    Returns:
        (rows, cols), first row at the top, and (classes,) the brightness of each class: luminance per unit of light.
    """
    weights = xyz_weights(standard("d65"), np.array(WHITE_NM))[:, 1]
    each = np.empty(len(designs))
    for number, design in enumerate(designs):
        found = []
        depths = Depths(layout.passes_nm, design.band_nm)
        for nm in WHITE_NM:
            tau = depths.tau_at(nm)
            x, y = (np.array([2.0e3 * value / nm]) for value in (h_x, h_y))
            coherence = layout.coherence_um * nm / layout.wavelength_nm
            one = model_density(design.model, x, y, coherence, layout.dot_um, tau)
            found.append(float(one[0, 0]) / (1e-3 * nm) ** 2)
        each[number] = float(np.dot(weights, found))
    step = max(1, -(-max(layout.index.shape) // most))
    return each[layout.classes[::-1][::step, ::step]], each


@dataclass(frozen=True)
class Screen:
    """Lamp, sample and screen. The sample is at the origin, its normal along z.

    Attributes:
        distance_mm: from the sample to where the mirrored beam meets the screen, the origin of the screen.
        light_deg: inclination and azimuth (from +x toward +y) of the lamp.
        tilt_deg: turns of the screen about its own x and y axes; without them it is perpendicular to the mirrored beam.

    Raises:
        ModelError: no distance, a lamp below 80° from the normal, or a screen seen from its edge.
    """

    distance_mm: float
    light_deg: tuple[float, float] = (0.0, 0.0)
    tilt_deg: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        if not 0.0 < self.distance_mm < float("inf"):
            raise ModelError(f"a screen stands at a positive distance, not {self.distance_mm:g} mm")
        if not 0.0 <= self.light_deg[0] < 80.0 or max(map(abs, self.tilt_deg)) > 75.0:
            raise ModelError(
                "the lamp stands 0 to 80° from the normal, and a screen is tilted by 75° at most"
            )

    @property
    def to_light(self) -> FloatArray:
        """(3,) unit vector."""
        theta, phi = np.radians(self.light_deg)
        return np.array([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)])

    @property
    def axes(self) -> FloatArray:
        """(3, 3) unit vectors of the screen in rows: along its x (along that of the sample), its y, and its normal."""
        mirrored = self.to_light * (-1.0, -1.0, 1.0)
        x = np.cross([0.0, 1.0, 0.0], mirrored)
        x /= np.linalg.norm(x)
        y = np.cross(mirrored, x)
        about_x, about_y = np.radians(self.tilt_deg)
        x, n = (
            np.cos(about_y) * x - np.sin(about_y) * mirrored,
            np.cos(about_y) * mirrored + np.sin(about_y) * x,
        )
        return np.stack(
            [x, np.cos(about_x) * y + np.sin(about_x) * n, np.cos(about_x) * n - np.sin(about_x) * y]
        )

    def places(self, v: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(…, 2) places in mm at which (…, 3) directions meet the screen, and r²/cos θ there in mm².

        Raises:
            ModelError: a direction that does not meet the screen.
        """
        x, y, n = self.axes
        middle = self.distance_mm * self.to_light * (-1.0, -1.0, 1.0)
        against = v @ n
        if float(against.min()) < 0.05:
            raise ModelError(
                "some directions do not meet the screen, or graze it: take a smaller --reach, or check its tilt"
            )
        r = float(middle @ n) / against
        off = r[..., None] * v - middle
        return np.stack([off @ x, off @ y], axis=-1), r**2 / against


@dataclass(frozen=True, eq=False)
class Grid:
    """Directions of a comparison: half vectors (N, N) from −reach to reach, rows along rising h_y.

    Attributes:
        h: (N,) along each axis.
        v: (N, N, 3) unit vectors to the screen.
        half: (N, N, 3) half vectors.
    """

    h: FloatArray
    v: FloatArray
    half: FloatArray

    @classmethod
    def of(cls, screen: Screen, reach: float, points: int) -> "Grid":
        """Half vectors about the mirrored beam.

        Raises:
            ModelError: directions below the horizon of the sample.
        """
        h = np.linspace(-reach, reach, points)
        light = screen.to_light
        y, x = np.meshgrid(2.0 * h - light[1], 2.0 * h - light[0], indexing="ij")
        square = x**2 + y**2
        if not reach > 0.0 or float(square.max()) > 0.98:
            raise ModelError(
                f"half vectors to {reach:g} go below the horizon of the sample: take a smaller --reach"
            )
        v = np.stack([x, y, np.sqrt(1.0 - square)], axis=-1)
        return cls(h, v, 0.5 * (v + light))


def designed_intensity(
    design: DesignFile | Layout, grid: Grid, wavelength_nm: float, source: Extent | None = None
) -> FloatArray:
    """(N, N) radiant intensity of a design over the grid, up to a factor.

    Args:
        design: one reflectance, by the expectation of its dots; or a layout: the mean of its dots, each by itself. One
            dot alone is a unit that repeats.
        grid: the directions.
        wavelength_nm: of the lamp.
        source: the lamp's extent; that of the design if it is not given.
    """
    um = 1e-3 * wavelength_nm
    designed = source or Extent("rect", 1e-3 * design.wavelength_nm / design.coherence_um)
    h_x, h_y, h_z = np.moveaxis(grid.half, -1, 0)
    if isinstance(design, DesignFile):
        passes = Depths(design.passes_nm, design.band_nm) if design.passes_nm else None
        tau = 1.0 if passes is None else passes.tau_at(wavelength_nm / float(h_z.mean()))
        f = 2.0 * grid.h / um
        density = model_density(design.model, f, f, um / max(designed.size, 1e-9), DOT_UM, tau)
    else:
        # a point of the grid is the mean over its own square
        square = Extent("rect", 2.0 * float(grid.h[1] - grid.h[0]))
        count = np.bincount(design.index.ravel(), minlength=len(design.tiles))
        density = np.zeros(h_x.shape)
        # steps of several pixels each, so that the directions lie well within what pixels resolve
        times = int(np.ceil(3.0 * 2.0 * float(np.abs(grid.half[..., :2]).max()) / um * design.grid_um))
        for tile, many in zip(design.tiles, count, strict=True):
            heights = design.heights_um[tile]
            if len(design.tiles) == 1:
                heights = np.tile(heights, (2, 2))
            fine = np.repeat(np.repeat(heights, times, axis=0), times, axis=1)
            surface = WaveSurface.of(fine, design.grid_um / times, cells=True)
            ladder = DensityLadder(
                surface, um, Window(designed, square), (float(h_z.min()), float(h_z.max()))
            )
            density += many / count.sum() * ladder.at(h_x, h_y, h_z)
    gamma = np.sum(grid.half**2, axis=-1) / h_z
    return np.asarray(np.maximum(density, 0.0) * gamma**2)


def photographed_intensity(
    photograph: FloatArray, to_pixels: FloatArray, screen: Screen, grid: Grid
) -> tuple[FloatArray, float]:
    """(N, N) radiant intensity over the grid from a photograph of the screen, up to a factor, and the share clipped.

    Args:
        photograph: (rows, cols) light, NaN where the camera clipped.
        to_pixels: (3, 3) homography from mm on the screen to column and row.
        screen: where it stands.
        grid: the directions.

    Raises:
        ModelError: directions outside of the photograph.
    """
    import cv2  # noqa: PLC0415 - slow to import

    place, scale = screen.places(grid.v)
    at = cv2.perspectiveTransform(place.reshape(1, -1, 2), np.asarray(to_pixels, dtype=np.float64))
    col, row = np.moveaxis(at.reshape(*place.shape), -1, 0)
    rows, cols = photograph.shape
    outside = (col < 0.0) | (row < 0.0) | (col > cols - 1.0) | (row > rows - 1.0)
    if outside.any():
        raise ModelError(
            f"{outside.mean():.0%} of the directions lie outside of the photograph: take a smaller --reach, or check "
            "distance, scale and marks"
        )
    step = float(np.median(np.hypot(np.diff(col, axis=1), np.diff(row, axis=1))))
    known = np.isfinite(photograph)
    sigma = 0.3 * step  # about the mean over the square of a direction
    parts = [np.where(known, photograph, 0.0).astype(np.float32), known.astype(np.float32)]
    if sigma > 0.5:
        parts = [np.asarray(cv2.GaussianBlur(one, (0, 0), sigma), dtype=np.float32) for one in parts]
    light, weight = (
        cv2.remap(one, col.astype(np.float32), row.astype(np.float32), cv2.INTER_LINEAR) for one in parts
    )
    clipped = weight < 0.5
    found = np.where(clipped, np.nan, light / np.maximum(weight, 0.5)) * scale
    return np.asarray(found, dtype=np.float64), float(clipped.mean())


@dataclass(frozen=True, eq=False)
class LobeComparison:
    """A photographed lobe against a designed one; both shares of the light in the grid.

    Attributes:
        ssim: structural similarity of encoded sRGB (Gaussian window, σ 1.5 points), white at the brightest design.
        correlation: of the light, point by point.
        rel_l2: ‖photographed − designed‖/‖designed‖.
        shift_h: (h_x, h_y) by which the photograph is displaced.
        clipped: share of directions where the camera clipped; they count for nothing.
        areas: (A, A) photographed over designed light, rows along rising h_y.
        designed_areas: (A, A) share of the designed light.
        photographed: (N, N), NaN where clipped.
        designed: (N, N).
    """

    ssim: float
    correlation: float
    rel_l2: float
    shift_h: tuple[float, float]
    clipped: float
    areas: list[list[float]]
    designed_areas: list[list[float]]
    photographed: FloatArray = field(metadata=LEFT_OUT)
    designed: FloatArray = field(metadata=LEFT_OUT)


def compared_lobes(photographed: FloatArray, designed: FloatArray, grid: Grid) -> LobeComparison:
    """Compare (N, N) intensities at the scale where both hold the same light.

    Raises:
        ModelError: a photograph without light, or nearly all of it clipped.
    """
    from skimage.metrics import structural_similarity  # noqa: PLC0415 - slow to import
    from skimage.registration import phase_cross_correlation  # noqa: PLC0415 - slow to import

    known = np.isfinite(photographed)
    total = float(np.nansum(photographed))
    if known.mean() < 0.5 or total <= 0.0:
        raise ModelError(
            "the photograph holds no light above the background there, or the camera clipped most of it: check "
            "--background, and expose less"
        )
    due = designed / designed[known].sum()
    seen = photographed / total
    whole = np.where(known, seen, due)
    top = float(due.max())
    first, second = (
        encode(np.repeat((one / top)[..., None], 3, axis=-1)).srgb[..., 0] for one in (whole, due)
    )
    similar = structural_similarity(  # type: ignore[no-untyped-call]
        first, second, data_range=1.0, gaussian_weights=True, sigma=1.5, use_sample_covariance=False
    )
    moved = phase_cross_correlation(second, first, upsample_factor=20, normalization=None)[0]  # type: ignore[no-untyped-call]
    step = float(grid.h[1] - grid.h[0])
    a, b = _areas(np.where(known, seen, 0.0)), _areas(np.where(known, due, 0.0))
    return LobeComparison(
        float(similar),
        float(np.corrcoef(seen[known], due[known])[0, 1]),
        float(np.linalg.norm((seen - due)[known]) / np.linalg.norm(due[known])),
        (-step * float(moved[1]), -step * float(moved[0])),
        float(1.0 - known.mean()),
        (a / np.maximum(b, 1e-12)).tolist(),
        b.tolist(),
        seen,
        due,
    )


def _areas(light: FloatArray) -> FloatArray:
    parts: Sequence[npt.NDArray[np.float64]] = np.array_split(light, AREAS, axis=0)
    return np.array([[float(one.sum()) for one in np.array_split(part, AREAS, axis=1)] for part in parts])
