"""How probably a defect is found, over its size: of simulated parts of a recipe, or of master parts."""

from dataclasses import dataclass, field
from math import isfinite
from pathlib import Path
from typing import Literal

from anisoscope.base.errors import UsageError
from anisoscope.base.json_fields import LEFT_OUT, json_field
from anisoscope.base.progress import Advance, silent
from anisoscope.quality.detection_probability import (
    DetectionCurve,
    Scale,
    Trials,
    hit_miss,
    read_trials,
    signal_over_size,
)
from anisoscope.report.study_page import Chart, Curve, StudyPage, Table
from anisoscope.rig.rigfile import read_rig
from anisoscope.study.lot import lot_of
from anisoscope.study.part_yield import detection_trials
from anisoscope.study.sweep import Workers


@dataclass(frozen=True, eq=False)
class Detection:
    """Probability of detection of one defect.

    Attributes:
        curve: over the size.
        defect: its name.
        source: which parts.
    """

    curve: DetectionCurve = field(metadata=json_field(merged=True))
    defect: str = field(metadata=LEFT_OUT)
    source: str = field(metadata=LEFT_OUT)

    def page(self) -> StudyPage:
        """Curve with its band, sizes with their limits, and the fit."""
        found = self.curve
        curve = Curve("probability of detection", found.grid, found.probability, found.low, found.high)
        chart = Chart(
            found.verdict,
            f"size of {self.defect}",
            "probability of detection [1]",
            (curve,),
            mark_x=found.sizes[1].size,
            points=False,
        )
        fit = tuple((name, f"{value:.6g}") for name, value in found.parameters.items())
        over = "logarithm of the size" if found.size_scale == "log" else "size"
        return StudyPage(
            f"Probability of detection: {self.defect}",
            self.source,
            [chart],
            [self._sizes(), Table(f"Fit over the {over}", ("parameter", "value"), fit)],
            [
                f"{self.defect}: {found.verdict}",
                f"Band and limits: profile likelihood ratio, {found.confidence:.0%}; the line marks a90.",
            ],
        )

    def _sizes(self) -> Table:
        found, level = self.curve, f"{self.curve.confidence:.0%}"
        rows = tuple(
            (
                f"a{100 * one.probability:.0f}",
                *(
                    f"{value:.4g}" if isfinite(value) else "none"
                    for value in (one.size, one.low, one.high, one.bound)
                ),
            )
            for one in found.sizes
        )
        note = f"{found.method}: {found.found} of {found.count} defects found"
        if found.false_calls is not None:
            hits, of, low, high = found.false_calls
            note += f"; false calls: {hits} of {of} parts without one ({low:.1%} to {high:.1%})"
        return Table(
            "Sizes", ("size found", "estimate", f"{level} from", "to", f"upper {level} limit"), rows, note
        )


def detection_of_masters(
    table: Path | str,
    *,
    threshold: float | None = None,
    noise: float | None = None,
    saturation: float | None = None,
    size_scale: Scale = "log",
    signal_scale: Scale = "log",
    link: Literal["logit", "probit"] = "logit",
    confidence: float = 0.95,
) -> Detection:
    """Probability of detection from master parts (MIL-HDBK-1823A).

    Args:
        table: CSV file size,hit (1 or 0) or size,signal.
        threshold: of signals: a defect counts as found from this signal on.
        noise: signals at or below this are known to be so only.
        saturation: signals at or above this are known to be so only.
        size_scale: the curve is over the size or its logarithm.
        signal_scale: of signals, likewise.
        link: of hits: logistic or normal curve.
        confidence: of intervals and bounds.

    Raises:
        UsageError: a file that cannot be used, signals without a threshold, or trials that give no curve.
    """
    table = Path(table)
    sizes, signal, hit = read_trials(table)
    if hit is not None:
        found = hit_miss(Trials(sizes, hit), size_scale, link, confidence)
    elif signal is None or threshold is None:
        raise UsageError(f"{table}: signals need --threshold, from which on a defect counts as found")
    else:
        scales = size_scale, signal_scale
        found = signal_over_size(
            sizes,
            signal,
            threshold,
            scales,
            noise=noise,
            saturation=saturation,
            confidence=confidence,
        )
    return Detection(found, table.stem, str(table))


def detection_of_parts(
    recipe: Path | str,
    defect: str = "height_loss",
    *,
    parts: int = 400,
    largest: float | None = None,
    golden_parts: int = 3,
    rig: Path | str | None = None,
    light_angle_deg: float = 10.0,
    size_scale: Scale = "log",
    link: Literal["logit", "probit"] = "logit",
    confidence: float = 0.95,
    seed: int = 1,
    workers: Workers | None = None,
    on_progress: Advance = silent,
) -> Detection:
    """Probability of detection from simulated parts of a recipe, each on a rig of its own and found by FAIL.

    Args:
        recipe: recipe file of the parts.
        defect: height_loss, edge_radius (µm), ridge_angle (degrees), alpha or albedo.
        parts: how many with a defect.
        largest: largest size; found by a short series of trials where it is not given.
        golden_parts: of every rig; with 0 the prediction is the reference.
        rig: rig file, for its light angle.
        light_angle_deg: of a rig without a file.
        size_scale: the curve is over the size or its logarithm.
        link: logistic or normal curve.
        confidence: of intervals and bounds.
        seed: of parts, rigs and errors.
        workers: processes; one by default.
        on_progress: called with the work being done, steps done and steps in all.

    Raises:
        UsageError: another defect, a size that is none, or no size that is found at all.
        RecipeError, RigFileError, HeightMapError: a file that cannot be used.
        SweepError: a process failed.
    """
    recipe = Path(recipe)
    angle = light_angle_deg if rig is None else read_rig(Path(rig)).light.angle_deg
    lot = lot_of(recipe, angle, parts=parts, rigs=2, golden=golden_parts)
    trials = detection_trials(lot, defect, largest, workers or Workers(), seed, on_progress)
    found = hit_miss(trials, size_scale, link, confidence)
    reference = f"{golden_parts} golden parts" if golden_parts else "the prediction"
    return Detection(
        found, defect, f"{recipe.name}: simulated parts, each on a rig of its own, against {reference}"
    )
