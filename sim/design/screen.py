"""A lobe on a screen: from a photograph of it back to the angular reflectance, and against that of a design.

The lamp shines on a small sample, whose lobe falls on a diffuse screen that a camera photographs. A point P of the
screen, r from the sample, is lit with E ∝ I(v)·cos θ/r², v = P/r and θ the angle to the screen's normal; the radiant
intensity is I(v) ∝ BRDF·v_z. The screen is Lambertian, so that every direction of the camera sees the same. Source of
the set-up: Levin et al. 2013, section 4 and Fig. 9.
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
from anisoscope.sim.light.colour.spaces import encode
from anisoscope.sim.light.wave.correlation import DensityLadder
from anisoscope.sim.light.wave.surface import WaveSurface
from anisoscope.sim.light.wave.windows import Extent, Window

DOT_UM = 112.0
AREAS = 4
"""Areas along each axis, whose shares of the light are compared."""


@dataclass(frozen=True)
class Screen:
    """Lamp, sample and screen. The sample lies at the origin, its normal along z.

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
        """Where (…, 3) directions meet the screen, (…, 2) in mm along its axes, and r²/cos θ there in mm².

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
        parts = [cv2.GaussianBlur(one, (0, 0), sigma) for one in parts]
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
