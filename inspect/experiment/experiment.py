"""The experiment of the ridge paper (Luongo et al. 2017, section 4 and Fig. 8), predicted.

Ridge angles 5, 10, 15 and 20°, tilts of camera and light from -20° to 20°, stage angles 0, 90 and 180°. Contrast is
|H(0°) - H(90°)| and |H(90°) - H(180°)|, H = k·L the radiant exposure, k one global scale. Arrays of contrasts have
the shape (ridge angles, tilts, pairs); NaN is not measured.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.csv_style import csv_text, number_text
from anisoscope.base.csv_table import read_table
from anisoscope.base.errors import UsageError
from anisoscope.base.json_fields import LEFT_OUT, fields_of, in_json, json_field
from anisoscope.parameters.geometry import Convention
from anisoscope.parameters.material import Material
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.sim.light import corrected, printed
from anisoscope.sim.light.contrasts import fit_scale
from anisoscope.sim.light.geometry import directions, pose_grid
from anisoscope.sim.light.printed import ShadowFrame

Model = Literal["printed", "corrected"]

RIDGE_ANGLES_DEG = (5.0, 10.0, 15.0, 20.0)
TILTS_DEG = (-20.0, -10.0, 0.0, 10.0, 20.0)
STAGE_DEG = (0.0, 90.0, 180.0)
PAIRS_DEG = ((0.0, 90.0), (90.0, 180.0))
SHAPE = (len(RIDGE_ANGLES_DEG), len(TILTS_DEG), len(PAIRS_DEG))
PUBLISHED_BEST_DEG = 5.0
COLUMNS = ("ridge_angle_deg", "tilt_deg", "from_deg", "to_deg", "contrast")
AXES = ("ridge_angle", "tilt", "pair")

_PITCH_UM = 100.0  # enters neither model: both know angles only
_TIE = 1e-9  # contrasts that symmetry makes equal differ by rounding


@dataclass(frozen=True)
class Setup:
    """Model and angle convention of the prediction.

    Attributes:
        model: "printed" as published, or "corrected".
        material: the plastic; index and albedo only scale the printed experiment.
        convention: how angles are counted.
        shadow_frame: of the printed model only: the axis from which its shadowing is counted.
    """

    model: Model = "printed"
    material: Material = field(default_factory=Material, metadata=LEFT_OUT)
    convention: Convention = field(default_factory=Convention)
    shadow_frame: ShadowFrame = field(default="pitch-normal", metadata=LEFT_OUT)

    def __post_init__(self) -> None:
        if self.model != "printed" and self.shadow_frame != "pitch-normal":
            raise UsageError(f"the shadow frame {self.shadow_frame} belongs to the printed model only")

    @property
    @in_json("shadow_frame", only_given=True)
    def printed_frame(self) -> ShadowFrame | None:
        """The shadow frame of the printed model; None of the corrected one."""
        return self.shadow_frame if self.model == "printed" else None

    @property
    def model_text(self) -> str:
        """The model in words."""
        return f"model {self.model}" + (
            f", shadow frame {self.shadow_frame}" if self.model == "printed" else ""
        )


@dataclass(frozen=True)
class Findings:
    """The paper's findings for a table of contrasts.

    Attributes:
        max_at_zero_tilt: the mean contrast at zero tilt is larger than at every other tilt.
        falls_on_both_sides: it also falls from each tilt to the next, away from zero.
        first_pair_larger: the mean of 0° / 90° exceeds that of 90° / 180°.
        best_ridge_angle_deg: ridge angle of the largest mean contrast; None where two tie.
    """

    max_at_zero_tilt: bool
    falls_on_both_sides: bool
    first_pair_larger: bool
    best_ridge_angle_deg: float | None

    @property
    def as_published(self) -> bool:
        """All three findings of the paper's prediction hold."""
        return (
            self.max_at_zero_tilt
            and self.first_pair_larger
            and self.best_ridge_angle_deg == PUBLISHED_BEST_DEG
        )

    @property
    def text(self) -> str:
        """The findings in words."""
        zero, sides, first = (
            "yes" if found else "no"
            for found in (self.max_at_zero_tilt, self.falls_on_both_sides, self.first_pair_larger)
        )
        best = "none" if self.best_ridge_angle_deg is None else f"{self.best_ridge_angle_deg:g}°"
        return (
            f"largest at zero tilt: {zero} (falling on both sides: {sides}); 0° / 90° larger than 90° / 180°: "
            f"{first}; best ridge angle: {best}"
        )


@dataclass(frozen=True)
class Mean:
    """Mean contrast at one level of one parameter, over all levels of the others.

    Attributes:
        level_deg: the level; for a pair its two stage angles.
        predicted: mean of all predicted contrasts at this level.
        measured: mean of the measured ones, None where there are none.
        predicted_same_rows: mean of the predicted contrasts that were measured too.
        measured_rows: how many were measured.
    """

    level_deg: tuple[float, ...] = field(metadata=json_field(by=lambda it: it[0] if len(it) == 1 else it))
    predicted: float
    measured: float | None
    predicted_same_rows: float | None
    measured_rows: int


@dataclass(frozen=True, eq=False)
class Experiment:
    """The experiment predicted, and measured where that was given.

    Attributes:
        setup: what was predicted.
        k: the global scale of the predictions; 1 unless it was fitted.
        predicted: contrasts, k included; in 1/sr where k was not fitted, else in the unit of the measured ones.
        measured: contrasts of the same shape, NaN where not measured, or None.
        rms_residual: root mean square of predicted - measured over the measured rows, or None.
    """

    setup: Setup = field(metadata=json_field(merged=True))
    k: float
    predicted: FloatArray = field(metadata=LEFT_OUT)
    measured: FloatArray | None = field(metadata=LEFT_OUT)
    rms_residual: float | None = field(metadata=json_field(only_given=True))

    @property
    @in_json()
    def material(self) -> Material:
        """The plastic."""
        return self.setup.material

    @property
    @in_json()
    def unit(self) -> str:
        """Unit of the contrasts."""
        return "1/sr" if self.measured is None else "as measured"

    @property
    @in_json()
    def rows(self) -> list[dict[str, float]]:
        """Every combination with its predicted contrast, and the measured one where there is one."""
        rows = []
        for place, row in combinations():
            found = dict(zip(COLUMNS, (*row, float(self.predicted[place])), strict=True))
            if self.measured is not None and np.isfinite(self.measured[place]):
                found["measured"] = float(self.measured[place])
            rows.append(found)
        return rows

    def csv(self) -> str:
        """One line a combination, as ``read_measured`` reads it."""
        heads = (*COLUMNS, *(() if self.measured is None else ("measured",)))
        lines = [
            [
                number_text(repr(row[name]) if name in heads[4:] else f"{row[name]:g}") if name in row else ""
                for name in heads
            ]
            for row in self.rows
        ]
        return csv_text([list(heads), *lines], file=False)

    @property
    def complete(self) -> bool:
        """Every row was measured."""
        return self.measured is not None and bool(np.isfinite(self.measured).all())

    @property
    @in_json()
    def findings(self) -> Findings:
        """Findings in the predicted contrasts."""
        return findings(self.predicted)

    @property
    @in_json(only_given=True)
    def measured_findings(self) -> Findings | None:
        """Findings in the measured contrasts; None unless all rows were measured."""
        return findings(self.measured) if self.measured is not None and self.complete else None

    @property
    def means(self) -> dict[str, tuple[Mean, ...]]:
        """The three marginal means of Fig. 8, keyed "ridge_angle", "tilt" and "pair"."""
        return {name: tuple(self._means(axis)) for axis, name in enumerate(AXES)}

    @property
    @in_json("means")
    def shown_means(self) -> dict[str, list[dict[str, Any]]]:
        """The means, without numbers of measured contrasts where there are none."""
        shown = slice(2 if self.measured is None else None)
        return {
            name: [dict(list(fields_of(one).items())[shown]) for one in means]
            for name, means in self.means.items()
        }

    def _means(self, axis: int) -> Iterator[Mean]:
        measured = np.full(SHAPE, np.nan) if self.measured is None else self.measured
        for number, level in enumerate(_levels(axis)):
            cut = np.take(self.predicted, number, axis)
            seen = np.take(measured, number, axis)
            given = np.isfinite(seen)
            rows = int(given.sum())
            yield Mean(
                level,
                float(cut.mean()),
                float(seen[given].mean()) if rows else None,
                float(cut[given].mean()) if rows else None,
                rows,
            )


def _levels(axis: int) -> tuple[tuple[float, ...], ...]:
    return (tuple((a,) for a in RIDGE_ANGLES_DEG), tuple((t,) for t in TILTS_DEG), PAIRS_DEG)[axis]


def combinations() -> Iterator[tuple[tuple[int, int, int], tuple[float, float, float, float]]]:
    """Every row of the experiment: its index, and its ridge angle, tilt and two stage angles in degrees."""
    for a, t, p in np.ndindex(*SHAPE):
        yield (a, t, p), (RIDGE_ANGLES_DEG[a], TILTS_DEG[t], *PAIRS_DEG[p])


def absolute_contrasts(setup: Setup) -> FloatArray:
    """Predicted absolute contrasts with k = 1, in 1/sr.

    Raises:
        ModelError: light or camera stands below the horizon in some pose.
    """
    to_light, to_camera = directions(pose_grid(STAGE_DEG, TILTS_DEG), setup.convention)
    return contrast_table(setup, setup.material, to_light, to_camera)


def contrast_table(
    setup: Setup, material: Material, to_light: FloatArray, to_camera: FloatArray
) -> FloatArray:
    """(ridge angle, tilt, pair) absolute contrasts for a material and known directions, each (P, 3)."""
    exposure = []
    for angle in RIDGE_ANGLES_DEG:
        design = RidgeDesign(_PITCH_UM, angle)
        if setup.model == "corrected":
            exposure.append(corrected.radiance(to_light, to_camera, design, material))
        else:
            brdf = printed.ridge_brdf(to_light, to_camera, design, material, setup.shadow_frame)
            exposure.append(brdf * to_light[:, 2])
    table = np.reshape(exposure, (len(RIDGE_ANGLES_DEG), len(TILTS_DEG), len(STAGE_DEG)))
    return np.abs(np.diff(table, axis=2))


def read_measured(path: Path) -> FloatArray:
    """Measured contrasts from a CSV file with the columns ``COLUMNS``; rows may be missing, none twice.

    Returns:
        Contrasts in the unit of the file, NaN where not measured.

    Raises:
        UsageError: the file cannot be read, or a line of it cannot be used.
    """
    table = read_table(path, (COLUMNS,), not_negative=("contrast",), what="contrasts")
    where = {row: index for index, row in combinations()}
    measured = np.full(SHAPE, np.nan)
    for number, (*row, contrast) in enumerate(table.rows.tolist()):
        index = where.get((row[0], row[1], row[2], row[3]))
        if index is None:
            raise UsageError(
                f"{table.place(number)}: the experiment has no ridge angle {row[0]:g}°, tilt {row[1]:g}°, "
                f"pair {row[2]:g}°/{row[3]:g}°"
            )
        if not np.isnan(measured[index]):
            raise UsageError(f"{table.place(number)}: this combination is given twice")
        measured[index] = contrast
    return measured


def run_experiment(setup: Setup | None = None, measured: FloatArray | Path | str | None = None) -> Experiment:
    """Predict the experiment and, where contrasts were measured, fit the one global scale k to them.

    Args:
        setup: what to predict; the published model by default.
        measured: contrasts, NaN where not measured, or the CSV file of them.

    Raises:
        ModelError: light or camera stands below the horizon in some pose.
        UsageError: no positive scale fits, as where all measured rows are zero or predicted as zero; or a file
            that cannot be used.
    """
    setup = Setup() if setup is None else setup
    measured = read_measured(Path(measured)) if isinstance(measured, Path | str) else measured
    predicted = absolute_contrasts(setup)
    if measured is None:
        return Experiment(setup, 1.0, predicted, None, None)
    given = np.isfinite(measured)
    with np.errstate(all="ignore"):
        k = fit_scale(predicted[given], measured[given])
        rms = float(np.sqrt(np.mean((k * predicted[given] - measured[given]) ** 2)))
    if not (k > 0.0 and np.isfinite([k, rms]).all()):
        raise UsageError(
            "no scale k can be fitted: the predicted or the measured contrasts are all zero, or not sane"
        )
    return Experiment(setup, k, k * predicted, measured, rms)


def findings(table: FloatArray) -> Findings:
    """Findings of the paper in a table of contrasts; levels that tie count as not larger."""
    angle, tilt, pair = (table.mean(axis=others) for others in ((1, 2), (0, 2), (0, 1)))
    zero, best = TILTS_DEG.index(0.0), int(np.argmax(angle))
    left, right = tilt[: zero + 1], tilt[zero:][::-1]
    return Findings(
        max_at_zero_tilt=_is_largest(tilt, zero),
        falls_on_both_sides=all(_larger(b, a) for side in (left, right) for a, b in pairwise(side)),
        first_pair_larger=_larger(pair[0], pair[1]),
        best_ridge_angle_deg=RIDGE_ANGLES_DEG[best] if _is_largest(angle, best) else None,
    )


def _larger(a: float, b: float) -> bool:
    return bool(a - b > _TIE * abs(a))


def _is_largest(values: FloatArray, index: int) -> bool:
    return all(_larger(values[index], value) for value in np.delete(values, index))
