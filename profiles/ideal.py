"""Ideal ridged surfaces, smooth or with rough facets.

Sample frame: z up, ridges along +y, the large facets lean toward +x: their normal is (sin θ, 0, cos θ), so
that z falls toward +x along a facet, and a narrow wall rises from the foot of each facet to the next crest.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import HeightMapError
from anisoscope.profiles.heightmap import HeightMap

Wall = Literal["perpendicular", "vertical"]

PADDING_LENGTHS = 3.0
MIN_LENGTH_PIXELS = 1.0


@dataclass(frozen=True)
class RidgeDesign:
    """Parallel ridges of one shape. Geometry: Luongo et al. 2017, for the perpendicular wall.

    Attributes:
        pitch_um: p, distance of neighbouring crests in µm.
        ridge_angle_deg: θ, slope of the large facets, 0 ≤ θ < 45°.
        wall: "perpendicular" to the facet, or "vertical".
        height_loss: share of the height that is missing at the crest, which ends in a plateau, 0 to 1.

    Raises:
        HeightMapError: a parameter outside its range.
    """

    pitch_um: float
    ridge_angle_deg: float
    wall: Wall = "perpendicular"
    height_loss: float = 0.0

    def __post_init__(self) -> None:
        if not (np.isfinite(self.pitch_um) and self.pitch_um > 0):
            raise HeightMapError(f"the pitch must be a positive number of µm, not {self.pitch_um}")
        if not 0.0 <= self.ridge_angle_deg < 45.0:
            raise HeightMapError(f"the ridge angle must be within 0° and 45°, not {self.ridge_angle_deg}°")
        if self.wall not in ("perpendicular", "vertical"):
            raise HeightMapError(f"a wall is perpendicular or vertical, not {self.wall!r}")
        if not 0.0 <= self.height_loss <= 1.0:
            raise HeightMapError(f"the height loss must be a share of 0 to 1, not {self.height_loss}")

    @property
    def facet_width_um(self) -> float:
        """Width along x of the facet of the uncut ridge: p·cos²θ, or p with a vertical wall."""
        if self.wall == "vertical":
            return self.pitch_um
        return float(self.pitch_um * np.cos(np.radians(self.ridge_angle_deg)) ** 2)

    @property
    def wall_width_um(self) -> float:
        """Width along x of the wall of the uncut ridge: p·sin²θ, or 0 with a vertical wall."""
        return self.pitch_um - self.facet_width_um

    @property
    def full_height_um(self) -> float:
        """Height from foot to crest of the uncut ridge: p·sin θ·cos θ, or p·tan θ with a vertical wall."""
        return float(self.facet_width_um * np.tan(np.radians(self.ridge_angle_deg)))

    @property
    def height_um(self) -> float:
        """Height from foot to crest, or to the plateau where height is lost."""
        return (1.0 - self.height_loss) * self.full_height_um

    def profile(self, x_um: FloatArray) -> FloatArray:
        """Height in µm above the foot at positions x in µm; an uncut crest stands at x = 0."""
        position = np.mod(x_um, self.pitch_um)
        facet, full = self.facet_width_um, self.full_height_um
        if full == 0.0:
            return np.zeros_like(position)
        height = full * (1.0 - position / facet)
        if self.wall_width_um > 0.0:
            height = np.where(position > facet, full * (position - facet) / self.wall_width_um, height)
        return np.minimum(height, self.height_um)


def ridges(
    design: RidgeDesign, shape: tuple[int, int], pixel_um: float | tuple[float, float], phase: float = 0.0
) -> HeightMap:
    """An ideal ridged surface, sampled at points.

    Args:
        design: the shape of the ridges.
        shape: (rows, cols).
        pixel_um: pixel size in µm, one number or (y, x).
        phase: position of the first (uncut) crest as a share of the pitch.

    Returns:
        Heights in µm above the foot of the ridges, constant along y.

    Raises:
        HeightMapError: a pixel size or shape that is none.
    """
    pixel_y, pixel_x = (pixel_um, pixel_um) if isinstance(pixel_um, int | float) else pixel_um
    profile = design.profile(np.arange(shape[1], dtype=np.float64) * pixel_x - phase * design.pitch_um)
    origin = {
        "ideal": "ridges",
        "pitch_um": design.pitch_um,
        "ridge_angle_deg": design.ridge_angle_deg,
        "wall": design.wall,
        "height_loss": design.height_loss,
    }
    return HeightMap(np.broadcast_to(profile, shape), float(pixel_x), float(pixel_y), origin)


def _slope_gain(length_um: float, pixel_um: float) -> float:
    """Rms difference quotient between neighbours, per µm of rms height, for a Gaussian correlation."""
    return float(np.sqrt(-2.0 * np.expm1(-((pixel_um / length_um) ** 2))) / pixel_um)


def _lengths(
    along: float, across: float, mean_um: float, pixel_y: float, pixel_x: float
) -> tuple[float, float]:
    """Correlation lengths (y, x) in µm of geometric mean ``mean_um`` whose slopes stand as along : across."""
    if along == 0.0 or across == 0.0:
        return mean_um, mean_um
    from scipy.optimize import brentq  # noqa: PLC0415 - slow to import

    def mismatch(log_ratio: float) -> float:
        stretch = np.exp(0.5 * log_ratio)
        gain_y, gain_x = _slope_gain(mean_um * stretch, pixel_y), _slope_gain(mean_um / stretch, pixel_x)
        return float(np.log(gain_x / gain_y) - np.log(across / along))

    try:
        stretch = float(np.exp(0.5 * brentq(mismatch, -12.0, 12.0)))
    except ValueError:
        stretch = 0.0
    lengths = mean_um * stretch, mean_um / stretch if stretch else 0.0
    if lengths[0] < MIN_LENGTH_PIXELS * pixel_y or lengths[1] < MIN_LENGTH_PIXELS * pixel_x:
        raise HeightMapError(
            f"roughness of correlation length {mean_um:g} µm cannot be sampled with pixels of "
            f"{pixel_y:g} × {pixel_x:g} µm; take a longer correlation or smaller pixels"
        )
    return lengths


def add_facet_roughness(
    surface: HeightMap,
    alpha_along: float,
    alpha_across: float,
    correlation_um: float,
    rng: np.random.Generator,
) -> HeightMap:
    """Add a Gaussian random height field with given slopes.

    The field has a Gaussian height distribution and the correlation σ²·exp(−x²/lx² − y²/ly²). Its rms slopes
    are α/√2 (Beckmann's α is √2 times the standard deviation of the slope; Walter et al. 2007): σ√2/lx =
    α_across/√2 and σ√2/ly = α_along/√2. So lengths and α are inverse: lx : ly = α_along : α_across, with
    ``correlation_um`` = √(lx·ly), and σ = correlation_um·√(α_along·α_across)/2. Slopes are meant as
    difference quotients between neighbours on the grid, for which lx, ly and σ are adjusted a little. Heights
    are added along z, whatever the slope beneath. If one α is 0, the field is constant in that direction and
    has the correlation length ``correlation_um`` in the other.

    Args:
        surface: the map; its missing points stay missing.
        alpha_along: Beckmann roughness along y.
        alpha_across: Beckmann roughness across, along x.
        correlation_um: geometric mean of the correlation lengths in µm, at least about a pixel.
        rng: source of randomness.

    Raises:
        HeightMapError: a negative roughness, or a correlation that the pixels cannot hold.
    """
    if not (alpha_along >= 0 and alpha_across >= 0 and correlation_um > 0):
        raise HeightMapError(
            "roughness must not be negative and its correlation length positive, not "
            f"{alpha_along}, {alpha_across}, {correlation_um} µm"
        )
    if alpha_along == 0.0 and alpha_across == 0.0:
        return surface
    length_y, length_x = _lengths(
        alpha_along, alpha_across, correlation_um, surface.pixel_y_um, surface.pixel_x_um
    )
    rows, cols = surface.shape
    field = _correlated(
        (rows if alpha_along else 1, cols if alpha_across else 1),
        (length_y / surface.pixel_y_um, length_x / surface.pixel_x_um),
        rng,
    )
    if alpha_across:
        sigma = alpha_across / np.sqrt(2.0) / _slope_gain(length_x, surface.pixel_x_um)
    else:
        sigma = alpha_along / np.sqrt(2.0) / _slope_gain(length_y, surface.pixel_y_um)
    roughness = {"alpha_along": alpha_along, "alpha_across": alpha_across, "correlation_um": correlation_um}
    return surface.with_height(surface.height_um + sigma * field, added_roughness=roughness)


def _correlated(shape: tuple[int, int], lengths: tuple[float, float], rng: np.random.Generator) -> FloatArray:
    """(rows, cols) Gaussian field of unit variance with Gaussian correlation lengths in pixels."""
    from scipy import fft  # noqa: PLC0415 - slow to import

    padded = [
        n if n == 1 else fft.next_fast_len(n + int(np.ceil(PADDING_LENGTHS * length)), real=True)
        for n, length in zip(shape, lengths, strict=True)
    ]
    fy, fx = np.fft.fftfreq(padded[0])[:, None], np.fft.rfftfreq(padded[1])[None, :]
    gain = np.exp(-0.5 * np.pi**2 * ((lengths[0] * fy) ** 2 + (lengths[1] * fx) ** 2))
    twice = np.full(gain.shape[1], 2.0)
    twice[0] = 1.0
    if padded[1] % 2 == 0 and padded[1] > 1:
        twice[-1] = 1.0
    gain /= np.sqrt(float(np.sum(gain**2 * twice)) / (padded[0] * padded[1]))
    noise = rng.standard_normal(padded)
    field: FloatArray = fft.irfft2(fft.rfft2(noise) * gain, s=padded)
    return field[: shape[0], : shape[1]]
