"""Convergence of contrasts to the ideal prediction as defects vanish, and its order.

Luongo et al. 2017 (section 6) expect measured contrasts to converge to the predicted ones as samples get better.
Here defects of decreasing size are applied to a surface, its contrasts are predicted by the relief predictor, and their
deviation from those of the ideal surface on the same grid of points is followed. The deviation has two parts: the bias
is common to all defective surfaces, the scatter differs from one piece of surface to the next.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from math import isfinite

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import UsageError
from anisoscope.base.json_fields import LEFT_OUT, in_json, json_field
from anisoscope.base.progress import Advance, silent
from anisoscope.experiment.experiment import STAGE_DEG, TILTS_DEG
from anisoscope.parameters.geometry import Convention
from anisoscope.parameters.material import Material
from anisoscope.parameters.random_surfaces import Quality
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.parameters.workers import Workers
from anisoscope.profiles.defects import burrs, ridge_angle_error
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.profiles.ideal import add_facet_roughness, ridges
from anisoscope.profiles.period import Period
from anisoscope.report.study_page import Chart, Curve, StudyPage, Table
from anisoscope.sim.light import corrected
from anisoscope.sim.light.geometry import directions, pose_grid
from anisoscope.sim.light.relief import Relief
from anisoscope.sim.light.relief import radiance as relief_radiance
from anisoscope.study.sweep import sweep

FITTED = 4  # mildest severities that give the order
PITCH_UM = 100.0
FINE_PIXEL_UM = PITCH_UM / 4000
IDEAL = RidgeDesign(PITCH_UM, 10.0)
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


QUALITIES: dict[Quality, Sampling] = {
    "quick": Sampling(4, 200.0, 1.0, 4),
    "normal": Sampling(4, 300.0, 1.0, 12),
    "fine": Sampling(8, 600.0, 0.5, 32),
}


def quality_text(sampling: Sampling, seed: int) -> str:
    """Quality and seed of a study in words."""
    name = next((name for name, one in QUALITIES.items() if one == sampling), f"{sampling.seeds} pieces")
    return f"quality {name}, seed {seed}"


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

    @property
    @in_json()
    def unit(self) -> str:
        """Unit of the severity."""
        return IMPERFECTIONS[self.defect].unit

    def chart(self) -> Chart:
        """Deviations over the severity, with slopes of order 1 and 2."""
        lines = [Curve("total", self.severity, self.total)]
        if "scatter" in self.orders:
            lines += [Curve("bias", self.severity, self.bias), Curve("scatter", self.severity, self.scatter)]
        for order in (1, 2):
            guide: FloatArray = self.total[-1] * (self.severity / self.severity[-1]) ** order
            lines.append(Curve(f"order {order}", self.severity, guide, dashed=True))
        return Chart(self.defect, f"severity [{self.unit}]", "deviation / ideal [1]", tuple(lines), log=True)

    def rows(self) -> list[tuple[str, ...]]:
        """Deviation by severity, the largest first."""
        columns = self.severity, self.total, self.bias, self.scatter, self.mean_contrast
        return [
            (self.defect, f"{size:.4g} {self.unit}", *map(_percent, shares), f"{mean:.4f}")
            for size, *shares, mean in zip(*(column[::-1] for column in columns), strict=True)
        ]


@dataclass(frozen=True, eq=False)
class ConvergenceStudy:
    """All defects, and their common reference.

    Attributes:
        design: the ridges.
        material: the plastic, with the roughness that the maps do not resolve.
        sampling: of the maps with random defects.
        curves: one a defect.
        seed: of the pieces of surface.
    """

    design: RidgeDesign
    material: Material
    sampling: Sampling
    curves: tuple[Convergence, ...] = field(metadata=json_field("defects"))
    seed: int = field(metadata=LEFT_OUT)

    def page(self) -> StudyPage:
        """Charts, tables and notes."""
        orders = tuple(
            (curve.defect, name, f"{order.slope:.2f}", f"{order.low:.2f} … {order.high:.2f}")
            for curve in self.curves
            for name, order in curve.orders.items()
        )
        rows = tuple(row for curve in self.curves for row in curve.rows())
        plastic = self.material
        return StudyPage(
            "Convergence to the ideal prediction",
            f"ridge angle {self.design.ridge_angle_deg:g}°, unresolved roughness "
            f"{plastic.alpha_along:g}/{plastic.alpha_across:g}, albedo {plastic.albedo:g}; published poses; "
            + quality_text(self.sampling, self.seed),
            [curve.chart() for curve in self.curves],
            [
                Table(
                    "Order of convergence", ("defect", "deviation", "order [1]", "95 % interval [1]"), orders
                ),
                Table(
                    "Deviation by severity",
                    ("defect", "severity", "total [%]", "bias [%]", "scatter [%]", "mean |C| / ideal [1]"),
                    rows,
                ),
            ],
            [
                (
                    "Deviation: rms of C − C(ideal) over the 10 signed differences, relative to the rms of C(ideal); "
                    "both by the relief predictor on the same points, direct light."
                ),
                (
                    "Bias is what all surfaces have in common, scatter what differs between pieces of "
                    f"{self.sampling.ridges * PITCH_UM:g} × {self.sampling.length_um:g} µm; order: slope of the four "
                    "mildest sizes in the logarithm, 95 % interval."
                ),
                (
                    "Sampling itself, relief of the unspoiled surface against the corrected model: "
                    f"{max(curve.sampling_bias for curve in self.curves):.3%}."
                ),
            ],
        )


def _percent(share: float) -> str:
    return f"{share:.3%}" if isfinite(share) else "–"


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
    defects: Sequence[str] = (),
    design: RidgeDesign | None = None,
    material: Material | None = None,
    sampling: Sampling | Quality = "normal",
    workers: Workers | None = None,
    *,
    severities: int = 6,
    seed: int = 1,
    on_progress: Advance = silent,
) -> ConvergenceStudy:
    """Follow the deviation of every defect from its largest size down, each step half the one before.

    Args:
        defects: which of ``IMPERFECTIONS``; all where none is named.
        design: the ridges; 100 µm and 10° by default.
        material: the plastic.
        sampling: of the maps with random defects.
        workers: processes or cluster; one process by default.
        severities: how many sizes, at least 3.
        seed: of the pieces of surface.
        on_progress: called with the work being done, steps done and steps in all.

    Raises:
        UsageError: fewer than three sizes, or none of the defects known.
    """
    if severities < 3:
        raise UsageError(f"an order needs at least three severities, not {severities}")
    defects, design, material = defects or tuple(IMPERFECTIONS), design or IDEAL, material or Material()
    sampling = sampling if isinstance(sampling, Sampling) else QUALITIES[sampling]
    unknown = [defect for defect in defects if defect not in IMPERFECTIONS]
    if unknown:
        raise UsageError(f"{unknown[0]!r} is no defect; there are {', '.join(IMPERFECTIONS)}")
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
    doing = "spoiling and predicting"
    found = iter(sweep(_contrasts, tasks, workers or Workers(), advance=on_progress, doing=doing))
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
    return ConvergenceStudy(design, material, sampling, tuple(curves), seed)


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
