"""Effect of imperfections on the best ridge angle of the published experiment, 5° or 10°.

Luongo et al. 2017 predict most contrast at 5°, cite measurements with most at 10°, and suspect the surface
structure (sections 5 and 6). Here one imperfection at a time grows, and the mean absolute contrast of the whole
experiment is followed over the ridge angle.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import UsageError
from anisoscope.base.json_fields import LEFT_OUT, in_json, json_field
from anisoscope.base.progress import Advance, silent
from anisoscope.experiment.experiment import (
    PAIRS_DEG,
    RIDGE_ANGLES_DEG,
    SHAPE,
    STAGE_DEG,
    TILTS_DEG,
    Findings,
    findings,
)
from anisoscope.parameters.geometry import Convention
from anisoscope.parameters.material import Material
from anisoscope.parameters.random_surfaces import Quality
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.parameters.workers import Workers
from anisoscope.profiles.defects import burrs
from anisoscope.report.study_page import Chart, Curve, StudyPage, Table
from anisoscope.sim.light import corrected
from anisoscope.sim.light.geometry import directions, pose_grid, seating_rotation
from anisoscope.sim.light.relief import Relief
from anisoscope.sim.light.relief import radiance as relief_radiance
from anisoscope.study.convergence import (
    PITCH_UM,
    QUALITIES,
    Sampling,
    ideal_map,
    quality_text,
    signed_contrasts,
)
from anisoscope.study.ridges import ridge_radiance
from anisoscope.study.sweep import sweep

_SEATINGS = 7  # Gauss-Hermite nodes about each axis


@dataclass(frozen=True)
class Imperfection:
    """One imperfection and its severities.

    Attributes:
        name: as on the command line.
        what: in words, with its unit.
        severities: rising.
        is_random: needs pieces of surface.
        is_slow: is computed at whole degrees only.
    """

    name: str = field(metadata=json_field("imperfection"))
    what: str = field(metadata=json_field("severity_is"))
    severities: tuple[float, ...] = field(metadata=LEFT_OUT)
    is_random: bool = field(default=False, metadata=LEFT_OUT)
    is_slow: bool = field(default=False, metadata=LEFT_OUT)


IMPERFECTIONS = {
    one.name: one
    for one in (
        Imperfection(
            "roughness", "isotropic roughness alpha [1]", (0.03, 0.05, 0.07, 0.085, 0.1, 0.12, 0.15, 0.2)
        ),
        Imperfection(
            "roughness-along", "alpha along the ridges [1]", (0.03, 0.06, 0.08, 0.1, 0.12, 0.15, 0.2)
        ),
        Imperfection(
            "roughness-across", "alpha across the ridges [1]", (0.03, 0.06, 0.1, 0.12, 0.14, 0.16, 0.2, 0.3)
        ),
        Imperfection("height-loss", "height loss [share]", (0.0, 0.05, 0.1, 0.2, 0.3, 0.5)),
        Imperfection(
            "edge-radius", f"edge radius [µm at pitch {PITCH_UM:g} µm]", (0.0, 2.0, 5.0, 10.0, 20.0, 40.0)
        ),
        Imperfection(
            "burrs", "area under burrs [share]", (0.0, 0.02, 0.05, 0.1, 0.2), is_random=True, is_slow=True
        ),
        Imperfection("seating", "seating tilt, sd about x and y [°]", (0.0, 0.5, 1.0, 2.0, 4.0)),
        Imperfection("noise", "noise of a radiance, sd [1/sr]", (0.0, 0.01, 0.02, 0.05, 0.1)),
        Imperfection("bounces", "reflections counted [1; 0 is all]", (1.0, 2.0, 0.0), is_slow=True),
        Imperfection("albedo", "albedo of the plastic [1]", (0.0, 0.2, 0.5, 0.8, 1.0)),
    )
}


def _of_curve(found: Findings) -> dict[str, bool]:
    return {"max_at_zero_tilt": found.max_at_zero_tilt, "first_pair_larger": found.first_pair_larger}


@dataclass(frozen=True, eq=False)
class AngleCurve:
    """Mean absolute contrast over the ridge angle, for one severity.

    Attributes:
        severity: in the unit of its imperfection.
        angles_deg: (A,) ridge angles.
        contrast: (A,) mean over tilts, pairs and pieces of surface, in 1/sr.
        sd: (A,) standard deviation of that mean by the pieces, 0 where nothing is random.
        published: contrast at the four published angles.
        best_published_deg: the best of these.
        best_deg: best ridge angle, by a parabola through the highest points.
        best_sd_deg: its standard deviation by the pieces.
        at_edge: the best angle is the first or last of the range.
        findings: the findings of the paper, asked of the four published angles.
    """

    severity: float
    angles_deg: FloatArray
    contrast: FloatArray
    sd: FloatArray = field(metadata=json_field("contrast_sd"))
    published: tuple[float, ...] = field(metadata=LEFT_OUT)
    best_published_deg: float
    best_deg: float
    best_sd_deg: float
    at_edge: bool
    findings: Findings = field(metadata=json_field(by=_of_curve, merged=True))

    @property
    @in_json()
    def ten_over_five(self) -> float:
        """Contrast at 10° over that at 5°: above 1 where the measured order of the two comes out."""
        return self.published[1] / self.published[0]

    def drawn(self) -> Curve:
        """Contrast over its maximum, with a band of one standard deviation where something is random."""
        top = self.contrast.max()
        ends = (self.contrast - self.sd, self.contrast + self.sd) if self.sd.any() else ()
        return Curve(f"{self.severity:g}", self.angles_deg, self.contrast / top, *(end / top for end in ends))

    def row(self) -> tuple[str, ...]:
        """Best angle, contrasts at the published ones and findings in words."""
        best = f"{self.best_deg:.2f}" + (f" ± {self.best_sd_deg:.2f}" if self.best_sd_deg else "")
        return (
            f"{self.severity:g}",
            best + (" (edge)" if self.at_edge else ""),
            f"{self.best_published_deg:g}",
            *(f"{value:.5f}" for value in self.published),
            f"{self.ten_over_five:.3f}",
            "yes" if self.findings.max_at_zero_tilt else "no",
        )


@dataclass(frozen=True, eq=False)
class AngleStudy:
    """One imperfection.

    Attributes:
        imperfection: which.
        curves: one a severity.
    """

    imperfection: Imperfection = field(metadata=json_field(merged=True))
    curves: tuple[AngleCurve, ...]

    @property
    @in_json("ten_overtakes_five_at")
    def turns_at(self) -> float | None:
        """Severity at which 10° overtakes 5°, interpolated; None where it never does, or always."""
        found = self.curves
        for low, high in pairwise(found):
            a, b = np.log(low.ten_over_five), np.log(high.ten_over_five)
            if (a < 0.0) != (b < 0.0) and high.severity > low.severity:
                return float(low.severity + (high.severity - low.severity) * a / (a - b))
        return None

    def table(self) -> Table:
        """A row a severity; the note says which of 5° and 10° is better, and from where."""
        turns, always = self.turns_at, self.curves[0].ten_over_five > 1.0
        first, then = ("10°", "5°") if always else ("5°", "10°")
        note = (
            f"{first} exceeds {then} throughout"
            if turns is None
            else f"{then} overtakes {first} at {turns:.3g}"
        )
        columns = (
            self.imperfection.what,
            "best [°]",
            "best of the four [°]",
            *(f"{angle:g}° [1/sr]" for angle in RIDGE_ANGLES_DEG),
            "10° / 5° [1]",
            "most at zero tilt",
        )
        return Table(self.imperfection.name, columns, tuple(curve.row() for curve in self.curves), note)

    def chart(self) -> Chart:
        """Contrast over the ridge angle, a curve a severity."""
        curves = tuple(curve.drawn() for curve in self.curves)
        return Chart(
            self.imperfection.what, "ridge angle [°]", "mean |C| / its maximum [1]", curves, points=False
        )


@dataclass(frozen=True, eq=False)
class BestAngle:
    """All imperfections.

    Attributes:
        imperfections: a study of each.
        material: the plastic without any.
        sampling: of height maps with burrs.
        seed: of the pieces of surface.
    """

    imperfections: tuple[AngleStudy, ...]
    material: Material = field(metadata=LEFT_OUT)
    sampling: Sampling = field(metadata=LEFT_OUT)
    seed: int = field(metadata=LEFT_OUT)

    def page(self) -> StudyPage:
        """Charts, tables and notes."""
        plastic = self.material
        return StudyPage(
            "Best ridge angle of the published experiment",
            f"roughness {plastic.alpha_along:g}/{plastic.alpha_across:g}, albedo {plastic.albedo:g}, but for the "
            f"imperfection; {quality_text(self.sampling, self.seed)}",
            [study.chart() for study in self.imperfections],
            [study.table() for study in self.imperfections],
            [
                (
                    "Contrast: mean of |C| over the 5 tilts and 2 pairs of the published experiment, 1/sr; corrected "
                    "model in direct light, with burrs the relief predictor, reflections where they are what grows."
                ),
                (
                    "Best angle: over 2° to 25°, not only the four published ones; ± is the standard deviation of the "
                    "mean by the pieces of surface."
                ),
            ],
        )


@dataclass(frozen=True)
class _Task:
    name: str
    severity: float
    angle_deg: float
    material: Material
    sampling: Sampling
    seed: int


Radiance = Callable[[FloatArray, FloatArray], FloatArray]


def _contrasts(task: _Task) -> FloatArray:
    """(pieces, 10) absolute contrasts of one ridge angle."""
    poses = directions(pose_grid(STAGE_DEG, TILTS_DEG), Convention())
    if task.name == "seating":
        return _seated(task, *poses)[None, :]
    if task.name == "burrs":
        return _with_burrs(task, *poses)
    contrasts = signed_contrasts(_radiance(task)(*poses))[None, :]
    if task.name == "noise":
        return folded_mean(contrasts, np.sqrt(2.0) * task.severity)
    return np.abs(contrasts)


def _radiance(task: _Task) -> Radiance:
    """The direct model, or all reflections, of a part with this imperfection."""
    size, material, radius = task.severity, task.material, 0.0
    design = RidgeDesign(PITCH_UM, task.angle_deg)
    if task.name == "roughness":
        material = replace(material, alpha_along=size, alpha_across=size)
    elif task.name == "roughness-along":
        material = replace(material, alpha_along=size)
    elif task.name == "roughness-across":
        material = replace(material, alpha_across=size)
    elif task.name == "albedo":
        material = replace(material, albedo=size)
    elif task.name == "height-loss":
        design = replace(design, height_loss=size)
    elif task.name == "edge-radius":
        radius = size

    def radiance(to_light: FloatArray, to_camera: FloatArray) -> FloatArray:
        if task.name == "bounces":
            return corrected.radiance(to_light, to_camera, design, material, bounces=int(size) or None)
        return ridge_radiance(to_light, to_camera, design, radius, material)

    return radiance


def folded_mean(value: FloatArray, sd: float) -> FloatArray:
    """Expectation of |value + noise| for Gaussian noise: the bias of averaged absolute contrasts."""
    if sd == 0.0:
        return np.abs(value)
    from scipy.special import erf  # noqa: PLC0415 - slow to import

    ratio = value / (np.sqrt(2.0) * sd)
    return np.asarray(sd * np.sqrt(2.0 / np.pi) * np.exp(-(ratio**2)) + value * erf(ratio), dtype=np.float64)


def _seated(task: _Task, to_light: FloatArray, to_camera: FloatArray) -> FloatArray:
    """Means over seatings of the absolute contrasts; each seating keeps for a whole experiment."""
    node, weight = np.polynomial.hermite.hermgauss(_SEATINGS)
    tilts = np.sqrt(2.0) * task.severity * node
    share = weight / np.sqrt(np.pi)
    radiance = _radiance(task)
    total = np.zeros(len(PAIRS_DEG) * len(TILTS_DEG))
    for about_x, weight_x in zip(tilts, share, strict=True):
        for about_y, weight_y in zip(tilts, share, strict=True):
            seat = seating_rotation(float(about_x), float(about_y))
            measured = signed_contrasts(radiance(to_light @ seat, to_camera @ seat))
            total += weight_x * weight_y * np.abs(measured)
    return total


def _with_burrs(task: _Task, to_light: FloatArray, to_camera: FloatArray) -> FloatArray:
    """Rows for one piece of surface each; the same burrs at every ridge angle."""
    design = RidgeDesign(PITCH_UM, task.angle_deg)
    surface = ideal_map(design, task.sampling)
    found = []
    for piece in range(task.sampling.seeds if task.severity else 1):
        rng = np.random.default_rng(1000 * task.seed + piece)
        spoiled = burrs(surface, task.severity, pitch_um=PITCH_UM, rng=rng).map
        measured = relief_radiance(Relief(spoiled, PITCH_UM), to_light, to_camera, task.material)
        found.append(np.abs(signed_contrasts(measured)))
    return np.array(found)


def best_angle(
    names: Sequence[str] = (),
    material: Material | None = None,
    sampling: Sampling | Quality = "quick",
    workers: Workers | None = None,
    *,
    step_deg: float = 0.5,
    seed: int = 1,
    on_progress: Advance = silent,
) -> BestAngle:
    """Follow the best ridge angle while each imperfection grows.

    Args:
        names: of ``IMPERFECTIONS``; all where none is named.
        material: the plastic without the imperfection.
        sampling: of height maps with burrs.
        workers: processes or cluster; one process by default.
        step_deg: of the ridge angles from 2° to 25°; slow imperfections take at least 1°.
        seed: of the pieces of surface.
        on_progress: called with the work being done, steps done and steps in all.

    Raises:
        UsageError: no such imperfection.
    """
    names, material = names or tuple(IMPERFECTIONS), material or Material()
    sampling = sampling if isinstance(sampling, Sampling) else QUALITIES[sampling]
    unknown = [name for name in names if name not in IMPERFECTIONS]
    if unknown:
        raise UsageError(f"{unknown[0]!r} is no imperfection; there are {', '.join(IMPERFECTIONS)}")
    tasks = [
        _Task(name, severity, float(angle), material, sampling, seed)
        for name in names
        for severity in IMPERFECTIONS[name].severities
        for angle in _angles(IMPERFECTIONS[name], step_deg)
    ]
    found = sweep(_contrasts, tasks, workers or Workers(), advance=on_progress, doing="ridge angles")
    values = dict(zip(tasks, found, strict=True))
    studies = []
    for name in names:
        kind = IMPERFECTIONS[name]
        angles = _angles(kind, step_deg)
        curves = []
        for severity in kind.severities:
            rows = [values[_Task(name, severity, float(angle), material, sampling, seed)] for angle in angles]
            curves.append(_angle_curve(severity, angles, np.array(rows)))
        studies.append(AngleStudy(kind, tuple(curves)))
    return BestAngle(tuple(studies), material, sampling, seed)


def _angles(kind: Imperfection, step_deg: float) -> FloatArray:
    step = max(step_deg, 1.0) if kind.is_slow else step_deg
    return np.unique(np.round(np.concatenate([np.arange(2.0, 25.0 + 1e-9, step), RIDGE_ANGLES_DEG]), 9))


def _angle_curve(severity: float, angles: FloatArray, rows: FloatArray) -> AngleCurve:
    """From (angles, pieces, 10) absolute contrasts."""
    places = np.searchsorted(angles, RIDGE_ANGLES_DEG)
    found = findings(rows[places].mean(axis=1).reshape(SHAPE))
    rows = rows.mean(axis=2)
    pieces = rows.shape[1]
    contrast = rows.mean(axis=1)
    root = np.sqrt(pieces)
    sd = rows.std(axis=1, ddof=1) / root if pieces > 1 else np.zeros(len(angles))
    each = [_peak(angles, rows[:, piece]) for piece in range(pieces)]
    published = tuple(float(contrast[place]) for place in places)
    top = int(np.argmax(contrast))
    return AngleCurve(
        severity,
        angles,
        contrast,
        sd,
        published,
        RIDGE_ANGLES_DEG[int(np.argmax(published))],
        _peak(angles, contrast),
        float(np.std(each, ddof=1) / root) if pieces > 1 else 0.0,
        top in (0, len(angles) - 1),
        found,
    )


def _peak(angles: FloatArray, values: FloatArray) -> float:
    """Angle of the largest value, by the parabola through it and its neighbours."""
    top = int(np.argmax(values))
    if top in (0, len(values) - 1):
        return float(angles[top])
    x, y = angles[top - 1 : top + 2] - angles[top], values[top - 1 : top + 2] - values[top]
    square, slope, _ = np.polyfit(x, y, 2)
    return float(angles[top] - 0.5 * slope / square) if square < 0.0 else float(angles[top])
