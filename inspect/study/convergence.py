"""Convergence of contrasts to the ideal prediction as defects vanish, and its order.

Luongo et al. 2017 (section 6) expect measured contrasts to converge to the predicted ones as samples get better.
Here defects of decreasing size are applied to a surface, its contrasts are predicted by the relief predictor, and their
deviation from those of the ideal surface on the same grid of points is followed. The deviation has two parts: the bias
is common to all defective surfaces, the scatter differs from one piece of surface to the next.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import UsageError
from anisoscope.base.progress import Advance, silent
from anisoscope.experiment.experiment import STAGE_DEG, TILTS_DEG
from anisoscope.parameters.geometry import Convention
from anisoscope.parameters.material import Material
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.profiles.defects import burrs, ridge_angle_error
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.profiles.ideal import add_facet_roughness, ridges
from anisoscope.profiles.period import Period
from anisoscope.sim.light import corrected
from anisoscope.sim.light.geometry import directions, pose_grid
from anisoscope.sim.light.relief import Relief
from anisoscope.sim.light.relief import radiance as relief_radiance
from anisoscope.study.sweep import Workers, sweep

FITTED = 4  # mildest severities that give the order
PITCH_UM = 100.0
FINE_PIXEL_UM = PITCH_UM / 4000
_BOOTSTRAPS = 400


@dataclass(frozen=True)
class Sampling:
    """Sampling of a study.

    Attributes:
        ridges: across the map.
        length_um: of the map along the ridges.
        pixel_um: of the map.
        seeds: pieces of surface for a random defect.
    """

    ridges: int
    length_um: float
    pixel_um: float
    seeds: int


QUALITIES = {
    "quick": Sampling(4, 200.0, 1.0, 4),
    "normal": Sampling(4, 300.0, 1.0, 12),
    "fine": Sampling(8, 600.0, 0.5, 32),
}


@dataclass(frozen=True)
class Order:
    """Slope of a deviation against severity, both in the logarithm, with its 95 % interval."""

    slope: float
    low: float
    high: float


@dataclass(frozen=True, eq=False)
class Convergence:
    """One defect at S severities; deviations are relative to the rms of the ideal contrasts.

    Attributes:
        defect: which.
        severity: (S,) rising, in its unit.
        total: (S,) rms deviation over contrasts and pieces of surface.
        bias: (S,) rms over the contrasts of the mean deviation; NaN where it is below the scatter.
        scatter: (S,) rms standard deviation between pieces, 0 for defects that are not random.
        mean_contrast: (S,) mean absolute contrast, in multiples of the ideal one.
        orders: of "total", and of "bias" and "scatter" where these can be separated.
        sampling_bias: relief of the ideal map against the corrected model, relative to the rms contrast.
    """

    defect: str
    severity: FloatArray
    total: FloatArray
    bias: FloatArray
    scatter: FloatArray
    mean_contrast: FloatArray
    orders: dict[str, Order]
    sampling_bias: float


@dataclass(frozen=True, eq=False)
class ConvergenceStudy:
    """All defects, and their common reference.

    Attributes:
        design: the ridges.
        material: the plastic, with the roughness that the maps do not resolve.
        sampling: of the maps with random defects.
        curves: one a defect.
    """

    design: RidgeDesign
    material: Material
    sampling: Sampling
    curves: tuple[Convergence, ...]


@dataclass(frozen=True)
class _Task:
    defect: str | None
    severity: float
    seed: int
    design: RidgeDesign
    material: Material
    sampling: Sampling


def ideal_map(design: RidgeDesign, sampling: Sampling) -> HeightMap:
    """The ideal surface, one column and row more than whole pitches and pixels."""
    cols = round(sampling.ridges * design.pitch_um / sampling.pixel_um) + 1
    return ridges(design, (round(sampling.length_um / sampling.pixel_um) + 1, cols), sampling.pixel_um, 0.25)


def sampling_for(defect: str | None, sampling: Sampling) -> Sampling:
    """Sampling for a defect: one that is uniform along the ridges needs fine profiles but few rows."""
    if defect is None or IMPERFECTIONS[defect].is_random:
        return sampling
    return Sampling(2, FINE_PIXEL_UM, FINE_PIXEL_UM, 1)


def with_defect(
    surface: HeightMap, defect: str, size: float, design: RidgeDesign, seed: int
) -> list[HeightMap]:
    """The surface with an imperfection of a given size in its unit.

    One seed means one piece of surface at every size.
    """
    return IMPERFECTIONS[defect].make(surface, size, design, np.random.default_rng(seed))


def _rough(
    surface: HeightMap, size: float, _design: RidgeDesign, rng: np.random.Generator
) -> list[HeightMap]:
    """One field scaled, as a pair of opposite fields, so that what is linear in the field cancels in their mean."""
    rough = add_facet_roughness(surface, size, size, 5.0, rng)
    return [rough, surface.with_height(2.0 * surface.height_um - rough.height_um)]


def _burrs(surface: HeightMap, size: float, design: RidgeDesign, rng: np.random.Generator) -> list[HeightMap]:
    return [burrs(surface, size, pitch_um=design.pitch_um, rng=rng).map]


def _steeper(
    surface: HeightMap, size: float, design: RidgeDesign, _rng: np.random.Generator
) -> list[HeightMap]:
    period = Period(design.pitch_um, 0.0, 1.0, True)
    return [ridge_angle_error(surface, size, ridge_angle_deg=design.ridge_angle_deg, period=period)]


def _cut(surface: HeightMap, size: float, design: RidgeDesign, _rng: np.random.Generator) -> list[HeightMap]:
    return [surface.with_height(np.minimum(surface.height_um, design.full_height_um * (1.0 - size)))]


def _rounded(
    surface: HeightMap, size: float, design: RidgeDesign, _rng: np.random.Generator
) -> list[HeightMap]:
    from scipy.ndimage import gaussian_filter1d  # noqa: PLC0415 - slow to import

    sigma = size * design.pitch_um / surface.pixel_x_um
    profile = gaussian_filter1d(surface.height_um[0, :-1], sigma, mode="wrap")
    rounded = np.append(profile, profile[0])
    return [surface.with_height(np.broadcast_to(rounded, surface.shape).copy())]


@dataclass(frozen=True)
class Imperfection:
    """What vanishes in the limit: exact on ideal ridges, unlike a defect that is made on any map.

    Attributes:
        largest: size to begin with.
        unit: of the size.
        make: the imperfect pieces of a surface, of its size, the design and a source of randomness.
        is_random: needs pieces of surface; else uniform along the ridges.
    """

    largest: float
    unit: str
    make: Callable[[HeightMap, float, RidgeDesign, np.random.Generator], list[HeightMap]]
    is_random: bool = False


IMPERFECTIONS = {
    "roughness": Imperfection(0.10, "alpha", _rough, is_random=True),
    "burrs": Imperfection(0.10, "share of the area", _burrs, is_random=True),
    "angle-error": Imperfection(2.0, "°", _steeper),
    "height-loss": Imperfection(0.20, "share of the height", _cut),
    "edge-rounding": Imperfection(0.05, "pitches", _rounded),
}


def signed_contrasts(radiance: FloatArray) -> FloatArray:
    """(10,) signed differences of the published experiment's poses."""
    return -np.diff(radiance.reshape(len(TILTS_DEG), len(STAGE_DEG)), axis=1).ravel()


def _contrasts(task: _Task) -> FloatArray:
    """(pieces, 10) contrasts of one spoiled surface and, for roughness, of its opposite."""
    surface = ideal_map(task.design, task.sampling)
    spoiled = [surface]
    if task.severity > 0.0 and task.defect is not None:
        spoiled = with_defect(surface, task.defect, task.severity, task.design, task.seed)
    to_light, to_camera = directions(pose_grid(STAGE_DEG, TILTS_DEG), Convention())
    return np.stack(
        [
            signed_contrasts(
                relief_radiance(Relief(one, task.design.pitch_um), to_light, to_camera, task.material)
            )
            for one in spoiled
        ]
    )


def convergence(
    defects: Sequence[str],
    design: RidgeDesign,
    material: Material,
    sampling: Sampling,
    workers: Workers,
    *,
    severities: int = 6,
    seed: int = 1,
    advance: Advance = silent,
) -> ConvergenceStudy:
    """Follow the deviation of every defect from its largest size down, each step half the one before.

    Args:
        defects: which.
        design: the ridges.
        material: the plastic.
        sampling: of the maps with random defects.
        workers: processes or cluster.
        severities: how many sizes, at least 3.
        seed: of the pieces of surface.
        advance: progress.

    Raises:
        UsageError: fewer than three sizes, or none of the defects known.
    """
    if severities < 3:
        raise UsageError(f"an order needs at least three severities, not {severities}")
    unknown = [defect for defect in defects if defect not in IMPERFECTIONS]
    if unknown or not defects:
        raise UsageError(
            f"{unknown[0] if unknown else ''!r} is no defect; there are {', '.join(IMPERFECTIONS)}"
        )
    if not design.ridge_angle_deg > 0.0:
        raise UsageError("a flat surface has no contrast to converge to: take a ridge angle above 0°")
    steps = 0.5 ** np.arange(severities)[::-1]
    tasks = []
    for defect in defects:
        finely = sampling_for(defect, sampling)
        sizes = [0.0] + [float(IMPERFECTIONS[defect].largest * step) for step in steps]
        tasks += [
            _Task(defect, size, 1000 * seed + piece, design, material, finely)
            for size in sizes
            for piece in range(finely.seeds if size else 1)
        ]
    found = iter(sweep(_contrasts, tasks, workers, advance=advance, doing="spoiling and predicting"))
    to_light, to_camera = directions(pose_grid(STAGE_DEG, TILTS_DEG), Convention())
    exact = signed_contrasts(corrected.radiance(to_light, to_camera, design, material))
    curves = []
    for defect in defects:
        pieces = sampling_for(defect, sampling).seeds
        ideal = next(found)[0]
        rows = [next(found) for _ in range(severities * pieces)]
        severity: FloatArray = np.asarray(IMPERFECTIONS[defect].largest * steps, dtype=np.float64)
        table = np.reshape(rows, (severities, pieces, -1, ideal.size))
        curves.append(_curve(defect, severity, table, ideal, exact, seed))
    return ConvergenceStudy(design, material, sampling, tuple(curves))


def _curve(
    defect: str, severity: FloatArray, table: FloatArray, ideal: FloatArray, exact: FloatArray, seed: int
) -> Convergence:
    """Deviations from (severities, pieces, opposite, contrasts) contrasts."""
    scale = float(np.sqrt(np.mean(ideal**2)))
    deviation = (table - ideal) / scale
    total, bias, scatter = _parts(deviation)
    strength = np.abs(table).mean(axis=(1, 2, 3)) / np.abs(ideal).mean()
    orders = {}
    named = {"total": total, "bias": bias, "scatter": scatter}
    pieces = table.shape[1]
    for number, (name, values) in enumerate(named.items()):
        if pieces == 1 and name != "total":
            continue
        usable = np.isfinite(values[:FITTED]) & (values[:FITTED] > 0)
        if usable.sum() >= 3:
            orders[name] = (
                _regression(severity, values)
                if pieces == 1
                else _bootstrap(severity, deviation, number, np.random.default_rng(seed))
            )
    sampling_bias = float(np.sqrt(np.mean((ideal - exact) ** 2)) / scale)
    return Convergence(defect, severity, total, bias, scatter, strength, orders, sampling_bias)


def _parts(deviation: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Total, bias and scatter, (severities,) each, of (severities, pieces, opposite, contrasts) deviations."""
    total = np.sqrt(np.mean(deviation**2, axis=(1, 2, 3)))
    per_piece = deviation.mean(axis=2)  # opposite fields cancel what is linear in them
    pieces = per_piece.shape[1]
    centre = per_piece.mean(axis=1)
    if pieces == 1:
        return total, np.sqrt(np.mean(centre**2, axis=1)), np.zeros(len(total))
    by_chance = per_piece.var(axis=1, ddof=1).mean(axis=1) / pieces
    square = np.mean(centre**2, axis=1) - by_chance
    bias = np.sqrt(np.where(square > 2.0 * by_chance, square, np.nan))
    single = deviation - deviation.mean(axis=(1, 2), keepdims=True)
    return total, bias, np.sqrt(np.mean(single**2, axis=(1, 2, 3)))


def _slope(severity: FloatArray, values: FloatArray) -> float:
    usable = np.isfinite(values[:FITTED]) & (values[:FITTED] > 0)
    if usable.sum() < 2:
        return float("nan")
    x, y = np.log(severity[:FITTED][usable]), np.log(values[:FITTED][usable])
    return float(np.polyfit(x, y, 1)[0])


def _regression(severity: FloatArray, values: FloatArray) -> Order:
    """Slope with the interval that its residuals give; of a smooth curve that is its bend."""
    from scipy.stats import linregress, t  # noqa: PLC0415 - slow to import

    x, y = np.log(severity[:FITTED]), np.log(values[:FITTED])
    fit = linregress(x, y)
    reach = float(t.ppf(0.975, x.size - 2)) * float(fit.stderr)
    slope = float(fit.slope)
    return Order(slope, slope - reach, slope + reach)


def _bootstrap(severity: FloatArray, deviation: FloatArray, number: int, rng: np.random.Generator) -> Order:
    """Slope with the interval that other draws of the same pieces give."""
    pieces = deviation.shape[1]
    drawn = []
    for _ in range(_BOOTSTRAPS):
        chosen = deviation[:, rng.integers(0, pieces, pieces)]
        drawn.append(_slope(severity, _parts(chosen)[number]))
    low, high = np.nanquantile(drawn, [0.025, 0.975])
    return Order(_slope(severity, _parts(deviation)[number]), float(low), float(high))
