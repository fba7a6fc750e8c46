"""Ideal ridged surfaces, smooth or with rough facets.

Sample frame: z up, ridges along +y, the large facets lean toward +x: their normal is (sin θ, 0, cos θ), so
that z falls toward +x along a facet, and a narrow wall rises from the foot of each facet to the next crest.
"""

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import HeightMapError, UsageError
from anisoscope.parameters.keywords import by_keywords
from anisoscope.parameters.patterns import Grid, Lines, Pattern, Rough, Stairs
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.profiles import patterns
from anisoscope.profiles.heightmap import HeightMap

PADDING_LENGTHS = 3.0
MIN_LENGTH_PIXELS = 1.0


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
        "foot_radius_um": design.foot_radius_um,
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


USUAL = RidgeDesign(100.0, 10.0)


@by_keywords(grid=Grid, lines=Lines, stairs=Stairs, rough=Rough)
def make_surface(
    pattern: Pattern,
    design: RidgeDesign = USUAL,
    *,
    grid: Grid,
    lines: Lines,
    stairs: Stairs,
    rough: Rough,
    seed: int = 0,
) -> HeightMap:
    """Make an ideal surface, smooth or with Gaussian roughness.

    Args:
        pattern: "ridges", "v-grooves", "checkerboard", "flat" or "staircase".
        design: shape of ridges; pitch of grooves.
        grid: field and pixel, or its fields as keywords.
        lines: place and direction of ridges and grooves, or its fields as keywords.
        stairs: of a staircase, or its fields as keywords.
        rough: roughness along and across the ridges, or its fields as keywords.
        seed: of everything random.

    Returns:
        The map; design and seed are ``made`` of its origin.

    Raises:
        UsageError: a negative seed, or too many points.
        HeightMapError: a number outside its range.
    """
    if seed < 0:
        raise UsageError(f"--seed takes a whole number from 0, not {seed}")
    rng = np.random.default_rng(seed)
    surface = _pattern(pattern, design, grid, lines, stairs, rng)
    roughness = rough.alpha_along, rough.alpha_across, rough.correlation_um, rng
    found = add_facet_roughness(surface, *roughness, 0.0 if pattern == "flat" else lines.lay_deg)
    if pattern == "checkerboard":  # each field along its own ridges
        second = add_facet_roughness(surface, *roughness, lines.second_lay_deg)
        fields = patterns.second_fields(grid.shape, grid.pixel_um, lines.square_um)
        found = found.with_height(np.where(fields, second.height_um, found.height_um))
    return found.with_height(found.height_um, made={**found.origin, "seed": seed})


def _pattern(
    pattern: Pattern, design: RidgeDesign, grid: Grid, lines: Lines, stairs: Stairs, rng: np.random.Generator
) -> HeightMap:
    field = grid.shape, grid.pixel_um
    if pattern == "flat":
        return patterns.flat(*field)
    if pattern == "staircase":
        if stairs.passes_nm is None:
            levels = patterns.even_levels(stairs.levels, 1e-3 * stairs.step_height_nm)
        else:
            levels = patterns.etched_levels([1e-3 * depth for depth in stairs.passes_nm])
        if stairs.random:
            both = (stairs.width_um, stairs.width_um)
            return patterns.random_steps(levels, *field, both, rng, spread=stairs.spread)
        return patterns.staircase(levels, *field, stairs.width_um, direction_deg=lines.lay_deg)
    if pattern == "checkerboard":
        both = (lines.lay_deg, lines.second_lay_deg)
        return patterns.checkerboard(design, *field, lines.square_um, directions_deg=both)
    if pattern == "v-grooves":
        grooves = patterns.GrooveDesign(design.pitch_um, lines.flank_deg, lines.land_um)
        return patterns.v_grooves(grooves, *field, direction_deg=lines.lay_deg, phase=lines.phase)
    return patterns.turned_ridges(design, *field, direction_deg=lines.lay_deg, phase=lines.phase)
