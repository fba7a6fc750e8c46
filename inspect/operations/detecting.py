"""How probably a defect is found, over its size: of simulated parts of a recipe, or of master parts."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import isfinite
from pathlib import Path

from anisoscope.base.errors import UsageError
from anisoscope.base.json_fields import LEFT_OUT, json_field
from anisoscope.base.progress import Advance, silent
from anisoscope.parameters.detection import LotSize, MasterSignals, PartTrials, SizeCurve
from anisoscope.parameters.keywords import by_keywords
from anisoscope.parameters.workers import Workers
from anisoscope.quality.detection_probability import (
    DetectionCurve,
    Trials,
    hit_miss,
    read_trials,
    signal_over_size,
)
from anisoscope.report.study_page import Chart, Curve, StudyPage, Table
from anisoscope.rig.rigfile import read_rig
from anisoscope.study.lot import Lot, Shift, Spread, lot_of
from anisoscope.study.part_yield import PartYield, detection_trials, part_yield


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


@by_keywords(signals=MasterSignals, curve=SizeCurve)
def detection_of_masters(table: Path | str, *, signals: MasterSignals, curve: SizeCurve) -> Detection:
    """Probability of detection from master parts (MIL-HDBK-1823A).

    Args:
        table: CSV file size,hit (1 or 0) or size,signal.
        signals: `MasterSignals`.
        curve: `SizeCurve`.

    Raises:
        UsageError: a file that cannot be used, signals without a threshold, or trials that give no curve.
    """
    table = Path(table)
    sizes, signal, hit = read_trials(table)
    if hit is not None:
        found = hit_miss(Trials(sizes, hit), curve.size_scale, curve.link, curve.confidence)
    elif signal is None or signals.threshold is None:
        raise UsageError(f"{table}: signals need --threshold, from which on a defect counts as found")
    else:
        found = signal_over_size(
            sizes,
            signal,
            signals.threshold,
            (curve.size_scale, signals.signal_scale),
            noise=signals.noise,
            saturation=signals.saturation,
            confidence=curve.confidence,
        )
    return Detection(found, table.stem, str(table))


@by_keywords(trials=PartTrials, curve=SizeCurve)
def detection_of_parts(
    recipe: Path | str,
    *,
    trials: PartTrials,
    curve: SizeCurve,
    rig: Path | str | None = None,
    light_angle_deg: float = 10.0,
    workers: Workers | None = None,
    on_progress: Advance = silent,
) -> Detection:
    """Probability of detection from simulated parts of a recipe, each on a rig of its own and found by FAIL.

    Args:
        recipe: recipe file of the parts.
        trials: `PartTrials`.
        curve: `SizeCurve`.
        rig: rig file, for its light angle.
        light_angle_deg: of a rig without a file.
        workers: processes; one by default.
        on_progress: called with the work being done, steps done and steps in all.

    Raises:
        UsageError: another defect, a size that is none, or no size that is found at all.
        RecipeError, RigFileError, HeightMapError: a file that cannot be used.
        SweepError: a process failed.
    """
    recipe = Path(recipe)
    angle = light_angle_deg if rig is None else read_rig(Path(rig)).light.angle_deg
    golden, defect = trials.golden_parts, trials.defect
    lot = lot_of(recipe, angle, LotSize(trials.parts, golden, rigs=2))
    hits = detection_trials(lot, defect, trials.largest, workers or Workers(), trials.seed, on_progress)
    found = hit_miss(hits, curve.size_scale, curve.link, curve.confidence)
    reference = f"{golden} golden parts" if golden else "the prediction"
    return Detection(
        found, defect, f"{recipe.name}: simulated parts, each on a rig of its own, against {reference}"
    )


@dataclass(frozen=True, eq=False)
class LotYield:
    """Yield of a lot.

    Attributes:
        lot: its parts and how they are inspected.
        found: verdicts of its parts, with the risks of producer and consumer.
    """

    lot: Lot = field(
        metadata=json_field(
            by=lambda lot: {
                "parts": lot.parts,
                "rigs": lot.rigs,
                "golden_parts": lot.golden,
                "scatter": lot.spread,
                "shift": lot.shift,
            },
            merged=True,
        )
    )
    found: PartYield = field(metadata=json_field("yield"))


@by_keywords(size=LotSize)
def recipe_yield(
    recipe: Path | str,
    *,
    size: LotSize,
    scatter: Mapping[str, float] | None = None,
    shift: Mapping[str, float] | None = None,
    rig: Path | str | None = None,
    light_angle_deg: float = 10.0,
    workers: Workers | None = None,
    on_progress: Advance = silent,
) -> LotYield:
    """How many parts of a lot pass a recipe: ``anisoscope recipe yield``.

    Args:
        recipe: recipe file.
        size: `LotSize`, or its fields as keywords.
        scatter: standard deviations between the parts by name: ridge_angle (degrees), alpha, albedo, height_loss
            (shares), edge_radius (µm), seating (degrees); None: those of good parts in the recipe.
        shift: how far the mean of the lot is off the nominal part, by the same names but seating.
        rig: rig file, for its light angle.
        light_angle_deg: angle between light and camera, without a rig file.
        workers: processes; one by default.
        on_progress: called with the number of finished rigs.

    Raises:
        UsageError: a name that is none, a number that means nothing, or a kind of part without [scatter].
        RecipeError, RigFileError: a file.
    """
    try:
        spread = None if scatter is None else Spread(**scatter)
        off = Shift(**(shift or {}))
    except TypeError as error:
        raise UsageError(f"scatter and shift: {str(error).rpartition('() ')[2]}") from None
    angle = light_angle_deg if rig is None else read_rig(Path(rig)).light.angle_deg
    lot = lot_of(Path(recipe), angle, size, spread, off)
    return LotYield(lot, part_yield(lot, workers or Workers(), size.seed, on_progress))
