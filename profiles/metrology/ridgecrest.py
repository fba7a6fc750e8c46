"""Wall and crest of the ridges: wall angle, height, what is missing of it, and how round the edge is."""

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import UsageError
from anisoscope.profiles.metrology.quantity import Quantity, jackknife
from anisoscope.profiles.metrology.ridgeoutline import Fit, Outline, best_fit

CORE = (0.2, 0.8)
MAX_BEND_DEG = 2.0
CREST_PIXELS = 4.0
RESOLVED_PIXELS = 2.0
REACH = 0.4
SEARCH = 25
LEAST_FILL = 0.05
POSITION_PIXELS = 0.03
CLEARLY = 0.8
LEAST_WEIGHT = 0.15
SPREAD_OF_PLACES = 0.5  # of that of places evenly over the wall; two places a gap apart reach 0.58 and more
FEWEST_PLACES = 3
UPRIGHT_DEG = 90.0
BLURRED_PIXELS = 0.3
SIGMA_KNOWN = 0.05
MOST_BLUR = 2.0
LEAST_STRAIGHT = 0.1
TIP_KNOWN = 0.05


@dataclass(frozen=True)
class Crest:
    """Shape of walls and crests.

    Attributes:
        wall_angle_deg: against the plane of the surface; a lower bound where the wall is narrower than two pixels.
        wall_width_um: horizontal width of the wall as seen, at most a pixel too wide.
        height_um: from foot to crest, as it is.
        full_height_um: from where facet and wall meet below to where they would meet above.
        height_loss: share of the full height that is missing at the crest.
        edge_radius_um: radius of the crest; an upper bound where it is not clear of the pixels, empty on a plateau.
        plateau: whether a level top fits the crest better than a round one.
        foot_loss: share of the full height that is filled at the foot.
        foot_radius_um: radius of the foot, as of the crest.
        blur_um: σ of a point spread function that alone would round crest and foot, where none is known; else 0.
    """

    wall_angle_deg: Quantity
    wall_width_um: float
    height_um: Quantity
    full_height_um: Quantity
    height_loss: Quantity
    edge_radius_um: Quantity
    plateau: bool
    foot_loss: Quantity
    foot_radius_um: Quantity
    blur_um: float


@dataclass(frozen=True)
class Line:
    """The mean facet in the profile about a wall: its height at the wall and its slope (below 0), in µm."""

    height: float
    slope: float

    def at(self, x: FloatArray) -> FloatArray:
        """Heights at x µm from the wall."""
        return self.height + self.slope * x


def mean_profile(parts: FloatArray, pitch_um: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Positions x in µm from the wall, heights and numbers of points, from (bins, 3) sums; empty bins dropped."""
    count = parts[:, 0]
    use = _filled(parts)
    return parts[use, 2] / count[use] * pitch_um, parts[use, 1] / count[use], count[use]


def _filled(parts: FloatArray) -> npt.NDArray[np.intp]:
    """Bins that hold enough points."""
    count = parts[:, 0]
    return np.flatnonzero(count > LEAST_FILL * float(np.median(count[count > 0])))


def core_of_wall(x: FloatArray, height: FloatArray) -> tuple[float, float]:
    """Positions at which the wall has risen by 20 % and by 80 %."""
    low, high = _risen(x, height, CORE)
    return low, high


def _bend(x: FloatArray, height: FloatArray) -> float:
    """Half of how much the inclinations of the lower and the upper half of the core differ, in degrees.

    Where a crest is rounded so far down that no straight wall is left, or a wall is curved, that is large.
    """
    low, middle, high = _risen(x, height, (CORE[0], 0.5 * sum(CORE), CORE[1]))
    rise = 0.5 * (CORE[1] - CORE[0]) * float(np.ptp(height))
    return 0.5 * abs(float(np.degrees(np.arctan2(rise, high - middle) - np.arctan2(rise, middle - low))))


def _risen(x: FloatArray, height: FloatArray, shares: tuple[float, ...]) -> list[float]:
    """Positions at which the wall has risen by shares of its height."""
    top = int(np.argmax(height))
    foot = int(np.argmin(height[: top + 1]))
    low, high = float(height[foot]), float(height[top])
    found = []
    for share in shares:
        level = low + share * (high - low)
        at = foot + int(np.argmax(height[foot : top + 1] >= level))
        before = max(at - 1, foot)
        rise = height[at] - height[before]
        part = (level - height[before]) / rise if rise > 0 else 0.0
        found.append(float(x[before] + part * (x[at] - x[before])))
    return found


def _wall_slope(sums: FloatArray) -> tuple[float, float, float]:
    """Slope of the wall and its middle (x, z), from the sums of all ridges or of all but one."""
    n, t, tt, z, tz = sums
    if n < 2:
        return np.nan, np.nan, np.nan
    spread = tt - t * t / n
    return (tz - t * z / n) / spread if spread > 0 else np.nan, t / n, z / n


def _carries_slope(sums: FloatArray, width: float) -> bool:
    """Whether the points between the positions of the core, ``width`` µm apart, are at more than one place.

    Walls along the grid, whole pixels apart, may all be sampled at a single one: then no regression is possible,
    and rounding errors would make a slope.
    """
    n, t, tt = sums[:3]
    if n < 2 or not np.isfinite(_wall_slope(sums)[0]):
        return False
    deviation = float(np.sqrt(max(tt / n - (t / n) ** 2, 0.0)))
    return deviation > SPREAD_OF_PLACES * width / float(np.sqrt(12.0))


def _plateau(
    x: FloatArray, height: FloatArray, count: FloatArray, line: Line, vertex: float
) -> tuple[float, float]:
    """Height of the level top that fits best, and the sum of squares left; the top is not above the vertex."""
    low, high = line.height + line.slope * REACH * 2.5 * float(x[-1]), float(line.at(np.array(vertex)))
    expected = line.at(x)
    left = np.empty(SEARCH)
    tops = np.linspace(high, low, SEARCH)
    for _ in range(3):
        tops = np.linspace(high, low, SEARCH)  # from above: of equally good tops the highest counts
        left = np.square(height - np.minimum(expected, tops[:, None])) @ count
        best = int(np.argmin(left))
        high, low = float(tops[max(best - 1, 0)]), float(tops[min(best + 1, SEARCH - 1)])
    best = int(np.argmin(left))
    return float(tops[best]), float(left[best])


def _arc(
    x: FloatArray, height: FloatArray, count: FloatArray, line: Line, vertex: float, wall: float
) -> tuple[float, float, float]:
    """Radius of the round crest that fits best, its highest point, and the sum of squares left.

    The arc touches the facet and the wall, whose angle is ``wall`` (radians).
    """
    facet = float(np.arctan(-line.slope))
    half = 0.5 * (np.pi - facet - wall)
    low, high = 0.0, 0.9 * float(x[-1]) * float(np.tan(half)) / float(np.cos(facet))
    expected = line.at(x)
    radii, left = np.zeros(SEARCH), np.zeros(SEARCH)
    for _ in range(3):
        radii = np.linspace(low, high, SEARCH)
        reach = radii / np.tan(half)
        touch_x = vertex + reach * np.cos(facet)
        centre_x = touch_x - radii * np.sin(facet)
        centre_z = line.at(touch_x) - radii * np.cos(facet)
        inside = np.square(radii)[:, None] - np.square(x - centre_x[:, None])
        arc = centre_z[:, None] + np.sqrt(np.maximum(inside, 0.0))
        model = np.where((x < touch_x[:, None]) & (inside > 0), np.minimum(arc, expected), expected)
        left = np.square(height - model) @ count
        best = int(np.argmin(left))
        low, high = float(radii[max(best - 1, 0)]), float(radii[min(best + 1, SEARCH - 1)])
    best = int(np.argmin(left))
    radius = float(radii[best])
    vertex_z = float(line.at(np.array(vertex)))
    reach = radius / np.tan(half)
    top = vertex_z + line.slope * reach * np.cos(facet) - radius * np.cos(facet) + radius
    return radius, float(min(top, vertex_z)), float(left[best])


@dataclass(frozen=True)
class _Wall:
    """The wall as first seen.

    Attributes:
        low: where it has risen by 20 %.
        high: where it has risen by 80 %.
        rise: from foot to crest.
        gap: largest distance of neighbouring places of the profile about it.
        resolved: whether its slope can be measured.
    """

    low: float
    high: float
    rise: float
    gap: float
    resolved: bool

    @property
    def width(self) -> float:
        return (self.high - self.low) / (CORE[1] - CORE[0])

    @property
    def seen(self) -> float:
        """Inclination in radians as if it were as wide as it looks: at least that."""
        return float(np.arctan2(self.rise, self.width))


def _estimate(
    total: FloatArray, line: Line, wall: _Wall, pitch: float, step: float, upright: float = 0.5 * np.pi
) -> FloatArray:
    """(8,) inclination of the wall in degrees and full height; loss, radius, 1 for a plateau of crest and of foot.

    From joined sums. A wall that is not resolved is taken to stand at ``upright`` (radians). The foot is the crest of
    the profile turned by 180°.
    """
    x, height, count = mean_profile(total[:-5].reshape(-1, 3), pitch)
    slope, at, z = _wall_slope(total[-5:])
    seen = wall.resolved and np.isfinite(slope) and slope > 0
    inclination = float(np.arctan(slope)) if seen else upright
    full = -pitch * line.slope * (1.0 - 0.5 * wall.width / pitch)
    if seen:
        full = pitch / (1.0 / np.tan(inclination) - 1.0 / line.slope)
    flank = _Flank(slope if seen else None, at, z, inclination)
    crest = _end(x, height, count, line, flank, wall, pitch, step)
    below = Line(-(line.height + line.slope * pitch), line.slope)
    turned = replace(wall, low=-wall.high, high=-wall.low)
    foot = _end(
        -x[::-1], -height[::-1], count[::-1], below, replace(flank, at=-at, z=-z), turned, pitch, step
    )
    return np.array([np.degrees(inclination), full, crest[0] / full, *crest[1:], foot[0] / full, *foot[1:]])


@dataclass(frozen=True)
class _Flank:
    """The wall as a line: slope, None where it is not resolved, a point (at, z) on it, inclination in radians."""

    slope: float | None
    at: float
    z: float
    inclination: float


def _end(
    x: FloatArray,
    height: FloatArray,
    count: FloatArray,
    line: Line,
    flank: _Flank,
    wall: _Wall,
    pitch: float,
    step: float,
) -> tuple[float, float, float]:
    """What is missing at a crest in µm, its radius, and 1 for a plateau."""
    straight = (x > 0.5 * REACH * pitch) & (x < REACH * pitch)
    # all points count here, in the line of the folded medians only the middle ones
    offset = float(np.average(height[straight] - line.at(x[straight]), weights=count[straight]))
    height, z = height - offset, flank.z - offset
    vertex = 0.5 * (wall.low + wall.high) + 0.25 * wall.width
    if flank.slope is not None:
        vertex = flank.at + (float(line.at(np.array(flank.at))) - z) / (flank.slope - line.slope)
    near = (x > (vertex + 0.3 * step if wall.resolved else wall.high + 0.5 * step)) & (x < REACH * pitch)
    if np.count_nonzero(near) < FEWEST_PLACES:
        return 0.0, 0.0, 0.0
    data = x[near], height[near], count[near]
    sharp = float(np.square(data[1] - line.at(data[0])) @ data[2])
    top, left = _plateau(*data, line, vertex)
    radius, round_top, round_left = _arc(*data, line, vertex, flank.inclination)
    if min(left, round_left) > CLEARLY * sharp:  # within the first pixel next to the edge anything fits
        return 0.0, 0.0, 0.0
    flat = left < round_left
    missing = float(line.at(np.array(vertex))) - (top if flat else round_top)
    return max(missing, 0.0), radius, float(flat)


def measure_crest(
    parts: FloatArray,
    walls: FloatArray,
    line: Line,
    angle: Quantity,
    pitch: Quantity,
    step_um: float,
    spread_um: float,
    sigma_um: float | None = None,
) -> Crest:
    """Wall and crest from the profiles of all ridges about their walls.

    With facets at θ and walls at ψ, the full height is p/(cot θ + cot ψ). The wall's slope is that of the regression
    of height on position between 20 % and 80 % of its height. Where the wall is narrower than two pixels it may be
    anything between upright and what is seen. The crest is fitted twice, cut level and rounded; the better one
    counts, if it leaves clearly less than a sharp edge does. Where the point spread function is known, or rounding
    leaves no straight wall, the whole outline is fitted (:mod:`.ridgeoutline`). Where it is not known, the outline is
    fitted as blurred too: the numbers are those seen or those of a sharp outline, and u is their distance over √2.

    Args:
        parts: (ridges, bins, 3) from ``profile_sums``.
        walls: (ridges, 5) from ``wall_sums``, between the positions of ``core_of_wall``.
        line: the mean facet next to the crest.
        angle: ridge angle in degrees.
        pitch: in µm.
        step_um: pixel across the ridges.
        spread_um: standard deviation of the heights about the facets.
        sigma_um: of the point spread function of the instrument; None where it is not known.
    """
    assert pitch.value is not None
    total, p = parts.sum(axis=0), pitch.value
    x, height, _ = mean_profile(total, p)
    low, high = core_of_wall(x, height)
    wide = (high - low) / (CORE[1] - CORE[0]) > RESOLVED_PIXELS * step_um
    bend = _bend(x, height)
    resolved = bool(wide and bend < MAX_BEND_DEG and _carries_slope(walls.sum(axis=0), high - low))
    gap = float(np.diff(x[np.abs(x) < max(CREST_PIXELS * step_um, high)]).max(initial=0.0))
    wall = _Wall(low, high, float(height.max() - height.min()), gap, resolved)
    joined = np.concatenate([parts.reshape(parts.shape[0], -1), walls], axis=1)
    weight = parts[..., 0].sum(axis=1)
    use = weight > LEAST_WEIGHT * weight.max()
    outline = _outline(total, line, wall, p, step_um, spread_um, sigma_um or 0.0)
    blur, doubt = 0.0, np.zeros(8)
    known_blur = sigma_um is not None and sigma_um > BLURRED_PIXELS * step_um
    fit = best_fit(outline, step_um) if known_blur or (wide and bend >= MAX_BEND_DEG) else None
    if fit is not None and fit.straight > LEAST_STRAIGHT:
        about = parts[use][:, _about(total)]
        value, u = jackknife(about, lambda one: fit.shape(fit.moved(*_places(one, p))), weight[use])
        wider = replace(fit.outline, sigma=(1.0 + SIGMA_KNOWN) * outline.sigma).fitted(step_um)
        u, doubt = np.hypot(u, fit.misfit()), wider.shape(wider.found) - value
        middle, width = fit.found[:2]
        wall = replace(wall, low=middle - 0.3 * width, high=middle + 0.3 * width, resolved=True)
        bend = 0.0
    else:
        wall = replace(wall, resolved=resolved and fit is None)
        value, u = jackknife(joined[use], lambda one: _estimate(one, line, wall, p, step_um), weight[use])
        if not wall.resolved:  # the radius depends on how upright the wall is
            seen = _estimate(joined[use].sum(axis=0), line, wall, p, step_um, wall.seen)
            for at in (3, 6):
                u[at] = float(np.hypot(u[at], (seen[at] - value[at]) / np.sqrt(3.0)))
    if sigma_um is None and wall.resolved:
        blurred = _blurred(outline, step_um)
        if blurred.found[-1] > BLURRED_PIXELS * step_um:
            blur, doubt = float(blurred.found[-1]), (blurred.shape(blurred.found) - value) / np.sqrt(2.0)
            u = np.hypot(u, blurred.misfit())
    return _crest(value, u, doubt, wall, angle, pitch, step_um, max(step_um, sigma_um or 0.0), bend, blur)


def _blurred(outline: Outline, step: float) -> Fit:
    """Fit of the outline under the widest point spread function: both ends rounded by it, or one of them."""
    both = outline.fitted(step, free=(False, False, True))
    if both.found[-1] <= BLURRED_PIXELS * step:
        return both
    ends = ((False, True), (True, False))
    one = min(
        (
            replace(outline, level=level).fitted(step, free=(*end, True))
            for end in ends
            for level in ((False, False), end)
        ),
        key=lambda fit: fit.square,
    )
    return both if both.square < MOST_BLUR * one.square else one


def _outline(
    total: FloatArray, line: Line, wall: _Wall, pitch: float, step: float, spread: float, sigma: float
) -> Outline:
    """The mean profile about the wall, weighed by scatter, place of the walls and width of the bins."""
    x, height, count = (one[_about(total)] for one in (*_places(total, pitch), total[:, 0]))
    slope = np.gradient(height, x)
    place = POSITION_PIXELS * step * np.maximum(np.abs(slope), -line.slope)
    bins = 0.1 * np.abs(np.gradient(slope, x)) * (0.5 * step) ** 2
    u = np.sqrt(spread**2 / count + place**2 + bins**2)
    start = 0.5 * (wall.low + wall.high), wall.width
    return Outline(x, height, u, -line.slope, line.height, pitch, start, sigma)


def _about(total: FloatArray) -> npt.NDArray[np.intp]:
    """Bins about the wall that hold enough points."""
    filled = _filled(total)
    found: npt.NDArray[np.intp] = filled[np.abs(total[filled, 2] / total[filled, 0]) < REACH]
    return found


def _places(parts: FloatArray, pitch: float) -> tuple[FloatArray, FloatArray]:
    """Places in µm from the wall and heights of every bin, NaN where it is empty."""
    with np.errstate(invalid="ignore", divide="ignore"):
        return parts[:, 2] / parts[:, 0] * pitch, parts[:, 1] / parts[:, 0]


def _crest(
    value: FloatArray,
    u: FloatArray,
    doubt: FloatArray,
    wall: _Wall,
    angle: Quantity,
    pitch: Quantity,
    step: float,
    finest: float,
    bend: float,
    blur_um: float,
) -> Crest:
    """The crest with the uncertainties that the ridges do not show between them.

    ``doubt`` is one for all numbers; radii below two of ``finest`` (pixel or σ) are bounds.
    """
    assert angle.value is not None
    assert angle.u is not None
    assert pitch.value is not None
    assert pitch.u is not None
    p, theta, psi = pitch.value, np.radians(angle.value), np.radians(value[0])
    # what the positions of the walls, known to some hundredths of a pixel, leave open of their width
    apparent = psi if wall.resolved else wall.seen
    narrow = np.sqrt(1.0 + 3.0 * (RESOLVED_PIXELS * step / max(wall.width, step)) ** 4)
    blur = np.degrees(0.5 * np.sin(2.0 * apparent)) * POSITION_PIXELS * narrow * step / max(wall.width, step)
    u_wall = float(np.sqrt(u[0] ** 2 + blur**2 + bend**2))
    hidden = 0.0 if wall.resolved else wall.width / np.sqrt(12.0)
    full, loss, filled = float(value[1]), float(value[2]), float(value[5])
    by_angle = full * np.radians(angle.u) / (np.sin(theta) * np.cos(theta))
    by_wall = full**2 / p / np.sin(psi) ** 2 * np.radians(u_wall) if wall.resolved else hidden * np.tan(theta)
    u_full = float(np.sqrt(by_angle**2 + by_wall**2 + (full * pitch.u / p) ** 2))
    # the crest is somewhere between two places, or bins of half a pixel; nearly sharp ones within the pixel beside it
    place = max(wall.gap, 0.5 * step if loss > 0 else step) / np.sqrt(3.0)
    u_loss = float(np.hypot(u[2], np.hypot(place, 0.5 * hidden) / p))
    below = max(wall.gap, 0.5 * step if filled > 0 else step) / np.sqrt(3.0)
    u_filled = float(np.hypot(u[5], np.hypot(below, 0.5 * hidden) / p))
    inclination = Quantity(float(value[0]), float(np.hypot(u_wall, doubt[0])))
    if not wall.resolved:
        inclination = Quantity(None, at_least=float(np.degrees(wall.seen)) - 2.0 * float(blur))
    elif value[0] + 2.0 * max(u_wall, doubt[0]) > UPRIGHT_DEG:
        inclination = Quantity(None, at_least=float(value[0]) - 2.0 * u_wall)
    flat, level = (
        bool(value[4] > 0.5) and loss > 2.0 * u_loss,
        bool(value[7] > 0.5) and filled > 2.0 * u_filled,
    )
    left = 1.0 - loss - filled
    parts = left * u_full, full * u_loss, full * u_filled, left * doubt[1] - full * (doubt[2] + doubt[5])
    actual = Quantity(left * full, float(np.linalg.norm(parts)))
    u_full, u_loss, u_filled = np.hypot((u_full, u_loss, u_filled), doubt[[1, 2, 5]]).tolist()
    u = np.hypot(u, doubt)
    radius = _radius(float(value[3]), float(u[3]), step, finest, plateau=flat)
    return Crest(
        inclination, wall.width, actual, Quantity(full, u_full), Quantity(loss, u_loss), radius, flat,
        Quantity(filled, u_filled), _radius(float(value[6]), float(u[6]), step, finest, plateau=level), blur_um,
    )  # fmt: skip


def without_tip(crest: Crest, tip_um: float, angle: Quantity) -> Crest:
    """The crest and foot of a surface that a ball of a known radius R has scanned.

    The image is the dilation of the surface by the ball (Villarrubia 1997, J. Res. NIST 102, 425). Facet and wall are
    moved along their normals, so that angles and full height stay and every corner of both is k·R higher, with
    k = cos ½(ψ − θ)/cos ½(ψ + θ) − 1. A crest radius is larger by R. A foot is seen smaller by R: one below R is not
    seen, and fills 0 to k·R. R is taken as known within 5 %.

    Raises:
        UsageError: the crest is clearly sharper than the ball.
    """
    assert angle.value is not None
    assert crest.full_height_um.value is not None
    wall = crest.wall_angle_deg
    psi = np.radians(wall.value if wall.value is not None else 0.5 * (UPRIGHT_DEG + (wall.at_least or 0.0)))
    theta, full = np.radians(angle.value), crest.full_height_um.value
    raised = float(np.cos(0.5 * (psi - theta)) / np.cos(0.5 * (psi + theta)) - 1.0) * tip_um
    edge, foot, u_tip = crest.edge_radius_um, crest.foot_radius_um, TIP_KNOWN * tip_um
    loss, filled, height = crest.height_loss, crest.foot_loss, crest.height_um
    assert loss.value is not None
    assert filled.value is not None
    assert height.value is not None
    widest = edge.at_most if edge.value is None else edge.value + 2.0 * (edge.u or 0.0)
    if widest is not None and widest < tip_um - 2.0 * u_tip:
        raise UsageError(
            f"a crest radius of at most {widest:.3g} µm was seen, less than that of the tip, {tip_um:g} µm: no tip "
            "shows a crest sharper than itself; give the radius of the tip that measured the map"
        )
    if edge.value is not None:
        edge = _clear(edge.value - tip_um, float(np.hypot(edge.u or 0.0, u_tip)))
    elif edge.at_most is not None:
        edge = Quantity(None, at_most=edge.at_most - tip_um + 2.0 * u_tip)
    seen = foot.value is not None
    if foot.value is not None:
        foot = Quantity(foot.value + tip_um, float(np.hypot(foot.u or 0.0, u_tip)))
    elif foot.at_most is not None:
        foot = Quantity(None, at_most=foot.at_most + tip_um)
    below, open_um = (raised, 0.0) if seen else (0.5 * raised, raised / float(np.sqrt(12.0)))
    share, known = raised / full, TIP_KNOWN * raised
    return replace(
        crest,
        height_loss=Quantity(max(loss.value - share, 0.0), float(np.hypot(loss.u or 0.0, known / full))),
        edge_radius_um=edge,
        foot_loss=Quantity(
            filled.value + below / full, float(np.hypot(filled.u or 0.0, max(open_um, known) / full))
        ),
        foot_radius_um=foot,
        height_um=Quantity(
            height.value + raised - below, float(np.linalg.norm((height.u or 0.0, known, open_um)))
        ),
    )


def _clear(radius: float, u: float) -> Quantity:
    return Quantity(radius, u) if radius > 3.0 * u else Quantity(None, at_most=max(radius, 0.0) + 2.0 * u)


def against_the_surface(wall: Quantity, removed: float, tilt: float) -> Quantity:
    """Wall angle in degrees against the plane of the surface, from that against levelled heights.

    Levelling takes a slope off all heights, which changes the angle of a steep wall by more than that of the plane; so
    slopes are turned into angles before they are subtracted.

    Args:
        wall: angle in levelled heights, or a lower bound.
        removed: slope across that levelling took off, in the direction in which the walls rise.
        tilt: slope across of the plane of the surface in levelled heights.
    """

    def turned(angle_deg: float | None) -> float | None:
        if angle_deg is None:
            return None
        slope = np.tan(np.radians(angle_deg))
        return float(np.degrees(np.arctan(slope + removed) - np.arctan(tilt + removed)))

    return replace(wall, value=turned(wall.value), at_least=turned(wall.at_least))


def _radius(radius: float, u: float, step_um: float, finest_um: float, *, plateau: bool) -> Quantity:
    if plateau:
        return Quantity(None)
    u = float(np.hypot(u, step_um / np.sqrt(3.0)))
    if radius > RESOLVED_PIXELS * finest_um and radius > 3.0 * u:
        return Quantity(radius, u)
    return Quantity(None, at_most=max(radius + 2.0 * u, RESOLVED_PIXELS * finest_um))
