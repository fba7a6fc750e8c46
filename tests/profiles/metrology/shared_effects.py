"""Ridged maps of known truth under effects that all their ridges share; nothing of the package makes them."""

from dataclasses import dataclass, field, replace

import numpy as np

FINE = 4096  # points of the outline of one ridge


@dataclass
class Case:
    """Ridges, and what an instrument does to their map; lengths in µm, angles in degrees."""

    seed: int = 0
    pitch: float = 70.0
    direction: float = 0.0
    angle: float = 10.0
    wall: float = 75.0
    crest: float = 0.0
    foot: float = 0.0
    slope: float = 0.07
    length: float = 5.0
    noise: float = 0.02
    tilt: float = 0.0
    tilt_along: float = 0.0
    blur: float = 0.0
    row_step: float = 0.0
    column_step: float = 0.0
    rounded: float = 0.0
    lateral: float = 1.0
    vertical: float = 1.0
    shear: float = 0.0
    bow: float = 0.0
    lower: float = 0.0  # every second ridge, in µm
    missing: float = 0.0
    lost_columns: float = 0.0
    fields: int = 1
    field_step: float = 0.0
    field_shift: float = 0.0
    shape: tuple = (240, 560)
    made: dict = field(default_factory=dict)


def _corner(x, z, at, slopes, radius):
    """Rounds the corner of an outline at x = ``at``, between two slopes; returns the height of its extreme point."""
    left, right = np.arctan(slopes)
    way = 1.0 if right > left else -1.0
    reach = radius * np.tan(0.5 * abs(right - left))
    vertex = np.interp(at, x, z)
    cx = at - reach * np.cos(left) - way * radius * np.sin(left)
    cz = vertex - reach * np.sin(left) + way * radius * np.cos(left)
    on = (x > at - reach * np.cos(left)) & (x < at + reach * np.cos(right))
    z[on] = cz - way * np.sqrt(radius**2 - (x[on] - cx) ** 2)
    return cz - way * radius


def outline(case):
    """Outline of two ridges across: places over two pitches, heights, and the true height from foot to crest."""
    a, b = np.tan(np.radians([case.angle, case.wall]))
    run = case.pitch / (1.0 + a / b)
    x = np.arange(-FINE // 2, 3 * FINE // 2) * case.pitch / FINE
    s = np.mod(x, case.pitch)
    z = np.where(s < run, a * (run - s), b * (s - run))
    ends = [a * run, 0.0]
    for at in (0.0, case.pitch):  # crests
        if case.crest:
            ends[0] = _corner(x, z, at, (b, -a), case.crest)
    for at in (run - case.pitch, run):
        if case.foot and at > x[0] + 2.0 * case.foot:
            ends[1] = _corner(x, z, at, (-a, b), case.foot)
    half = slice(FINE // 4, FINE // 4 + FINE)
    return x[half], z[half], ends[0] - ends[1]


def draw(case):
    """(rows, cols) heights in µm on a pixel of 1 µm, and the true numbers of the surface, by name."""
    rng = np.random.default_rng(case.seed)
    rows, cols = case.shape
    x, z, height = outline(case)
    pitch = case.pitch
    t = np.radians(case.tilt)
    if t:  # turned rigidly about the ridge line
        x, z = x * np.cos(t) - z * np.sin(t), x * np.sin(t) + z * np.cos(t)
        pitch = case.pitch * np.cos(t)
        z = z - x * np.tan(t)
        order = np.argsort(x)
        x, z = x[order], z[order]
    even = np.arange(FINE) * pitch / FINE
    z = np.interp(
        even, np.mod(x, pitch)[np.argsort(np.mod(x, pitch))], z[np.argsort(np.mod(x, pitch))], period=pitch
    )
    f = np.fft.rfftfreq(FINE, pitch / FINE)
    z = np.fft.irfft(np.fft.rfft(z) * np.exp(-2.0 * (np.pi * case.blur * f) ** 2), FINE)
    i, j = np.mgrid[:rows, :cols].astype(float)
    xx, yy = j * case.lateral + np.radians(case.shear) * i, i * case.lateral
    which = np.minimum(i * case.fields // rows, case.fields - 1).astype(int)
    xx = xx + case.field_shift * rng.standard_normal(case.fields)[which]
    yy = yy + case.field_shift * rng.standard_normal(case.fields)[which]
    d = np.radians(case.direction)
    across = xx * np.cos(d) + yy * np.sin(d) + pitch * rng.random()
    heights = np.interp(np.mod(across, pitch), even, z, period=pitch)
    if case.lower:
        heights -= case.lower * (np.floor(across / pitch) % 2)
    heights += across * np.tan(t) + np.tan(np.radians(case.tilt_along)) * (yy * np.cos(d) - xx * np.sin(d))
    fy, fx = np.fft.fftfreq(rows)[:, None], np.fft.rfftfreq(cols)[None, :]
    f2, sigma = fx**2 + fy**2, case.slope * case.length / np.sqrt(2.0)
    gain = np.sqrt(np.pi) * case.length * np.exp(-0.5 * np.pi**2 * case.length**2 * f2)
    spectrum = (
        np.fft.rfft2(rng.standard_normal((rows, cols))) * gain * np.exp(-2.0 * (np.pi * case.blur) ** 2 * f2)
    )
    heights += sigma * np.fft.irfft2(spectrum, s=(rows, cols))
    heights += case.row_step * np.cumsum(rng.standard_normal(rows))[:, None]
    heights += case.column_step * np.cumsum(rng.standard_normal(cols))
    heights += case.bow * (((i / rows - 0.5) ** 2 + (j / cols - 0.5) ** 2) * 4.0 - 1.0)
    heights += (case.field_step * rng.standard_normal(case.fields))[which]
    heights = case.vertical * heights + case.noise * rng.standard_normal((rows, cols))
    if case.rounded:
        heights = case.rounded * np.rint(heights / case.rounded)
    heights[rng.random((rows, cols)) < case.missing] = np.nan
    heights[:, rng.random(cols) < case.lost_columns] = np.nan
    alpha = 2.0 * sigma * np.sqrt(-np.expm1(-1.0 / case.length**2))
    truth = {
        "pitch_um": pitch,
        "direction_deg": case.direction,
        "ridge_angle_deg": case.angle,
        "height_um": height,
        "wall_angle_deg": case.wall,
        "edge_radius_um": case.crest,
        "foot_radius_um": case.foot,
        "alpha_along": alpha,
        "alpha_across": alpha,
    }
    return heights, truth


def within(quantity, truth, times=2.0):
    """Whether a number holds the truth within its uncertainty, or a bound holds it; True where nothing is stated."""
    if quantity.value is None:
        least, most = quantity.at_least, quantity.at_most
        return (least is None or truth >= least) and (most is None or truth <= most)
    away = abs(quantity.value - truth)
    return min(away, abs(away - 180.0)) <= times * quantity.u + 1e-9  # directions are of lines


def largest_radius(case, share=0.8):
    """Radius of an end that takes a share of the wall."""
    theta, psi = np.radians([case.angle, case.wall])
    length = case.pitch / (1.0 / np.tan(theta) + 1.0 / np.tan(psi)) / np.sin(psi)
    return share * length / np.tan(0.5 * (theta + psi))


def usual(seed, **more):
    """Ridges as they come; radii are given as shares of the wall that they take."""
    rng = np.random.default_rng([46, seed])
    case = Case(
        seed,
        pitch=float(rng.uniform(55.0, 90.0)),
        direction=float(rng.choice([0.0, 2.0, 17.0, 35.0, -63.0, 90.0])),
        angle=float(rng.uniform(8.0, 16.0)),
        wall=float(rng.uniform(62.0, 80.0)),
        slope=float(rng.uniform(0.04, 0.1)),
        length=float(rng.uniform(4.0, 8.0)),
        noise=float(rng.uniform(0.01, 0.04)),
        shape=(480, 720),
    )
    case = replace(case, **more)
    return replace(case, **{end: largest_radius(case, getattr(case, end)) for end in ("crest", "foot")})
