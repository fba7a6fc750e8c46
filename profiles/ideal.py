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

Wall = Literal["perpendicular", "vertical"] | float
"""Perpendicular to the facet, vertical, or the draft angle of the wall: degrees from the vertical."""

STEEPEST_DRAFT_DEG = 60.0

PADDING_LENGTHS = 3.0
MIN_LENGTH_PIXELS = 1.0


@dataclass(frozen=True)
class RidgeDesign:
    """Parallel ridges of one shape. Geometry: Luongo et al. 2017, for the perpendicular wall.

    Attributes:
        pitch_um: p, distance of neighbouring crests in µm.
        ridge_angle_deg: θ, slope of the large facets, 0 ≤ θ < 45°.
        wall: "perpendicular" to the facet, "vertical", or its draft angle in degrees from the vertical: 0 is
            vertical, θ is perpendicular.
        height_loss: share of the height that is missing at the crest, which ends in a plateau, 0 to 1.
        edge_radius_um: radius of the crest, an arc tangent to facet and wall. What a ball of this radius does not reach
            that rolls beneath the surface is missing; the foot stays sharp. A lost height cuts the rounded crest.

    Raises:
        HeightMapError: a parameter outside its range.
    """

    pitch_um: float
    ridge_angle_deg: float
    wall: Wall = "perpendicular"
    height_loss: float = 0.0
    edge_radius_um: float = 0.0

    def __post_init__(self) -> None:
        if not (np.isfinite(self.pitch_um) and self.pitch_um > 0):
            raise HeightMapError(f"the pitch must be a positive number of µm, not {self.pitch_um}")
        if not 0.0 <= self.ridge_angle_deg < 45.0:
            raise HeightMapError(f"the ridge angle must be within 0° and 45°, not {self.ridge_angle_deg}°")
        if isinstance(self.wall, str):
            if self.wall not in ("perpendicular", "vertical"):
                raise HeightMapError(f"a wall is perpendicular, vertical or a draft angle, not {self.wall!r}")
        elif not 0.0 <= self.wall <= STEEPEST_DRAFT_DEG:
            raise HeightMapError(
                f"a wall stands within 0° and {STEEPEST_DRAFT_DEG:g}° of the vertical, not {self.wall:g}°"
            )
        if not 0.0 <= self.height_loss <= 1.0:
            raise HeightMapError(f"the height loss must be a share of 0 to 1, not {self.height_loss}")
        if not (np.isfinite(self.edge_radius_um) and self.edge_radius_um >= 0.0):
            raise HeightMapError(f"the edge radius must be 0 µm or more, not {self.edge_radius_um}")
        if self.edge_radius_um > 0.0 and self.full_height_um > 0.0:
            self.crest_arc()

    @property
    def draft_rad(self) -> float:
        """Angle between the wall and the vertical: θ where it is perpendicular to the facet."""
        if isinstance(self.wall, str):
            return float(np.radians(self.ridge_angle_deg)) if self.wall == "perpendicular" else 0.0
        return float(np.radians(self.wall))

    @property
    def facet_width_um(self) -> float:
        """Width along x of the facet of the uncut ridge: p/(1 + tan θ·tan δ) with the draft δ; p·cos²θ, or p."""
        if self.wall == "vertical":
            return self.pitch_um
        if not isinstance(self.wall, str):
            return float(
                self.pitch_um / (1.0 + np.tan(np.radians(self.ridge_angle_deg)) * np.tan(self.draft_rad))
            )
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

    @property
    def wall_length_um(self) -> float:
        """Length of the wall of the uncut ridge in the xz plane."""
        return float(np.hypot(self.wall_width_um, self.full_height_um))

    @property
    def edge_reach_um(self) -> float:
        """Length of facet and of wall from the uncut crest to where the rounded one begins: R·cot of half their angle.

        That angle is 90° − θ + δ, with the draft δ of the wall.
        """
        corner = 0.5 * np.pi - np.radians(self.ridge_angle_deg) + self.draft_rad
        return float(self.edge_radius_um / np.tan(0.5 * corner))

    def crest_arc(self) -> "CrestArc":
        """The arc in place of the crest, before any height is lost.

        Where the wall is shorter than the arc would need, the arc ends at the foot of the wall.

        Raises:
            HeightMapError: the radius leaves no facet.
        """
        theta, radius, full = np.radians(self.ridge_angle_deg), self.edge_radius_um, self.full_height_um
        down = np.array([np.cos(theta), -np.sin(theta)])  # along the facet, from the crest
        inward = np.array([-np.sin(theta), -np.cos(theta)])
        foot = np.array([-self.wall_width_um, -full])
        reach, first = self.edge_reach_um, float(np.pi - self.draft_rad)
        at_foot = reach > self.wall_length_um
        if at_foot:  # the ball no longer touches the wall, only its foot
            along, deep = float(foot @ down), float(foot @ inward)
            reach = along + float(np.sqrt(max(radius**2 - (radius - deep) ** 2, 0.0)))
        if reach >= self.facet_width_um / np.cos(theta):
            raise HeightMapError(
                f"an edge radius of {radius:g} µm leaves no facet at a pitch of {self.pitch_um:g} µm and a ridge "
                f"angle of {self.ridge_angle_deg:g}°"
            )
        centre = reach * down + radius * inward
        if at_foot:
            first = float(np.arctan2(foot[1] - centre[1], foot[0] - centre[0]) % (2.0 * np.pi))
        return CrestArc(float(centre[0]), float(centre[1] + full), radius, first, float(0.5 * np.pi - theta))

    def profile(self, x_um: FloatArray) -> FloatArray:
        """Height in µm above the foot at positions x in µm; an uncut crest stands at x = 0."""
        position = np.mod(x_um, self.pitch_um)
        facet, full = self.facet_width_um, self.full_height_um
        if full == 0.0:
            return np.zeros_like(position)
        height = full * (1.0 - position / facet)
        if self.wall_width_um > 0.0:
            height = np.where(position > facet, full * (position - facet) / self.wall_width_um, height)
        if self.edge_radius_um > 0.0:
            arc = self.crest_arc()
            offset = np.where(position > facet, position - self.pitch_um, position) - arc.x_um
            (low, _), (high, _) = arc.at(arc.first_rad), arc.at(arc.last_rad)
            rounded = arc.z_um + np.sqrt(np.maximum(arc.radius_um**2 - offset**2, 0.0))
            inside = (offset >= low - arc.x_um - 1e-9 * arc.radius_um) & (offset < high - arc.x_um)
            height = np.where(inside, rounded, height)
        return np.minimum(height, self.height_um)


@dataclass(frozen=True)
class CrestArc:
    """Arc of a rounded crest.

    Attributes:
        x_um: of its centre, from the uncut crest.
        z_um: of its centre, from the foot of the ridge.
        radius_um: its radius.
        first_rad: direction of its normal where it begins, at the wall, from +x toward +z.
        last_rad: the same where it ends, at the facet; smaller.
    """

    x_um: float
    z_um: float
    radius_um: float
    first_rad: float
    last_rad: float

    def at(self, normal_rad: float) -> tuple[float, float]:
        """Point x, z in µm with a normal of this direction."""
        return (
            float(self.x_um + self.radius_um * np.cos(normal_rad)),
            float(self.z_um + self.radius_um * np.sin(normal_rad)),
        )


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
        "edge_radius_um": design.edge_radius_um,
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
    direction_deg: float = 0.0,
) -> HeightMap:
    """Add a Gaussian random height field with given slopes along and across a direction.

    The field has a Gaussian height distribution and the correlation σ²·exp(−x²/lx² − y²/ly²). Its rms slopes
    are α/√2 (Beckmann's α is √2 times the standard deviation of the slope; Walter et al. 2007): σ√2/lx =
    α_across/√2 and σ√2/ly = α_along/√2. So lengths and α are inverse: lx : ly = α_along : α_across, with
    ``correlation_um`` = √(lx·ly), and σ = correlation_um·√(α_along·α_across)/2. Slopes are meant as
    difference quotients between neighbours on the grid, for which lx, ly and σ are adjusted a little. Heights
    are added along z, whatever the slope beneath. If one α is 0, the field is constant in that direction and
    has the correlation length ``correlation_um`` in the other.

    Args:
        surface: the map; its missing points stay missing.
        alpha_along: Beckmann roughness along the direction.
        alpha_across: Beckmann roughness across it.
        correlation_um: geometric mean of the correlation lengths in µm, at least about a pixel.
        rng: source of randomness.
        direction_deg: direction of the ridges, counter-clockwise from +y; at 0 "along" is y, at 90 x. Between, slopes
            are meant as difference quotients over the distance at which the direction leaves a pixel.

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
    roughness = {"alpha_along": alpha_along, "alpha_across": alpha_across, "correlation_um": correlation_um}
    if direction_deg % 180.0 == 0.0:
        return surface.with_height(
            surface.height_um + _rough(surface, alpha_along, alpha_across, correlation_um, rng),
            added_roughness=roughness,
        )
    roughness["direction_deg"] = direction_deg
    if direction_deg % 180.0 == 90.0:
        field = _rough(surface, alpha_across, alpha_along, correlation_um, rng)
    else:
        field = _turned_rough(surface, (alpha_along, alpha_across), correlation_um, rng, direction_deg)
    return surface.with_height(surface.height_um + field, added_roughness=roughness)


def _rough(
    surface: HeightMap, alpha_y: float, alpha_x: float, correlation_um: float, rng: np.random.Generator
) -> FloatArray:
    """Roughness (rows, cols) or what broadcasts to it, in µm, with its axes along y and x."""
    length_y, length_x = _lengths(alpha_y, alpha_x, correlation_um, surface.pixel_y_um, surface.pixel_x_um)
    rows, cols = surface.shape
    field = _correlated(
        (rows if alpha_y else 1, cols if alpha_x else 1),
        (length_y / surface.pixel_y_um, length_x / surface.pixel_x_um),
        rng,
    )
    if alpha_x:
        sigma = alpha_x / np.sqrt(2.0) / _slope_gain(length_x, surface.pixel_x_um)
    else:
        sigma = alpha_y / np.sqrt(2.0) / _slope_gain(length_y, surface.pixel_y_um)
    return np.asarray(sigma * field)


def _turned_rough(
    surface: HeightMap,
    alphas: tuple[float, float],
    correlation_um: float,
    rng: np.random.Generator,
    direction_deg: float,
) -> FloatArray:
    """Roughness (rows, cols) in µm with its axes along and across a direction oblique to the grid."""
    (along, across), (px, py) = alphas, (surface.pixel_x_um, surface.pixel_y_um)
    sine, cosine = float(np.sin(np.radians(direction_deg))), float(np.cos(np.radians(direction_deg)))
    lag_across, lag_along = 1.0 / np.hypot(cosine / px, sine / py), 1.0 / np.hypot(sine / px, cosine / py)
    length_along, length_across = _lengths(along, across, correlation_um, lag_along, lag_across)
    if across:
        sigma = across / np.sqrt(2.0) / _slope_gain(length_across, lag_across)
    else:
        sigma = along / np.sqrt(2.0) / _slope_gain(length_along, lag_along)
    rows, cols = surface.shape
    if along and across:
        padding = PADDING_LENGTHS * max(length_along, length_across)
        lengths = length_along, length_across
        return np.asarray(
            sigma * _turned_field((rows, cols), (py, px), padding, lengths, (sine, cosine), rng)
        )
    # constant in one direction: a profile in the other, sampled finely
    x, y = np.arange(cols) * px, np.arange(rows) * py
    place = np.add.outer(y * sine, x * cosine) if across else np.add.outer(y * cosine, -x * sine)
    step = 0.25 * min(px, py)
    low = float(place.min())
    count = int(np.ceil((float(place.max()) - low) / step)) + 2
    profile = _correlated((1, count), (1.0, correlation_um / step), rng)[0]
    return np.asarray(sigma * np.interp(place, low + step * np.arange(count), profile))


def _turned_field(
    shape: tuple[int, int],
    pixel: tuple[float, float],
    padding_um: float,
    lengths: tuple[float, float],
    turn: tuple[float, float],
    rng: np.random.Generator,
) -> FloatArray:
    """(rows, cols) Gaussian field of unit variance; lengths (along, across) in µm, turn (sine, cosine)."""
    from scipy import fft  # noqa: PLC0415 - slow to import

    padded = [
        fft.next_fast_len(n + int(np.ceil(padding_um / step)), real=True)
        for n, step in zip(shape, pixel, strict=True)
    ]
    fy, fx = np.fft.fftfreq(padded[0], pixel[0])[:, None], np.fft.rfftfreq(padded[1], pixel[1])[None, :]
    across, along = fx * turn[1] + fy * turn[0], fy * turn[1] - fx * turn[0]
    gain = np.exp(-0.5 * np.pi**2 * ((lengths[0] * along) ** 2 + (lengths[1] * across) ** 2))
    return _filtered(gain, padded, rng)[: shape[0], : shape[1]]


def _correlated(shape: tuple[int, int], lengths: tuple[float, float], rng: np.random.Generator) -> FloatArray:
    """(rows, cols) Gaussian field of unit variance with Gaussian correlation lengths in pixels."""
    from scipy import fft  # noqa: PLC0415 - slow to import

    padded = [
        n if n == 1 else fft.next_fast_len(n + int(np.ceil(PADDING_LENGTHS * length)), real=True)
        for n, length in zip(shape, lengths, strict=True)
    ]
    fy, fx = np.fft.fftfreq(padded[0])[:, None], np.fft.rfftfreq(padded[1])[None, :]
    gain = np.exp(-0.5 * np.pi**2 * ((lengths[0] * fy) ** 2 + (lengths[1] * fx) ** 2))
    return _filtered(gain, padded, rng)[: shape[0], : shape[1]]


def _filtered(gain: FloatArray, padded: list[int], rng: np.random.Generator) -> FloatArray:
    """White noise of a padded shape times a gain over its real spectrum, of unit variance."""
    from scipy import fft  # noqa: PLC0415 - slow to import

    twice = np.full(gain.shape[1], 2.0)
    twice[0] = 1.0
    if padded[1] % 2 == 0 and padded[1] > 1:
        twice[-1] = 1.0
    gain /= np.sqrt(float(np.sum(gain**2 * twice)) / (padded[0] * padded[1]))
    noise = rng.standard_normal(padded)
    field: FloatArray = fft.irfft2(fft.rfft2(noise) * gain, s=padded)
    return field
