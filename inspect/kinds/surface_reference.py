"""Good parts of a surface as a reference: what they show, what they teach, and the other parts of a lot."""

from dataclasses import asdict
from pathlib import Path
from typing import Any, cast

import numpy as np

from anisoscope.base.atomic_write import write_text
from anisoscope.base.errors import UsageError
from anisoscope.base.regular_file import bounded_text
from anisoscope.base.significance import log_basis
from anisoscope.base.toml_edits import with_values
from anisoscope.decision.consistency import contrast_scatter
from anisoscope.decision.decision import Decision
from anisoscope.decision.predictive import (
    MAX_BIRGE,
    birge_ratio,
    detectable,
    learnt_scatter,
    size_interval,
    size_of,
    suggested_scatter,
)
from anisoscope.decision.reference_parts import GoldenSet
from anisoscope.imaging.area_limit import LEAST_PARTS
from anisoscope.imaging.pose_radiance import Measured
from anisoscope.kinds.command_output import CommandOutput, Table
from anisoscope.kinds.parts import reference_on
from anisoscope.prediction.crests import EDGE_RADIUS
from anisoscope.prediction.part_scatter import CAMERA_SHARE, PartScatter, named_defects
from anisoscope.prediction.propagation import RIDGE_ANGLE
from anisoscope.recipe.named_defect import NamedDefect
from anisoscope.recipe.surface import SurfaceRecipe
from anisoscope.recipe.teaching import Change, Taught, previous_version_path
from anisoscope.record.schema import DirectionRecord, GoldenRecord, Record
from anisoscope.record.surface_details import surface_of
from anisoscope.rig.rigfile import read_replay_rig

TARGET_RATIO = 4.0  # T/U
GOLDEN_SIGMAS = 3.0


def taught_tolerances(
    record: Record, recipe: SurfaceRecipe, golden: GoldenSet | None
) -> tuple[list[float], str]:
    """One tolerance a pair: 4 U, or what the golden parts vary where that is more."""
    judged = surface_of(record).contrasts
    by_u = np.array([TARGET_RATIO * 2.0 * contrast.u for contrast in judged])
    why = f"{TARGET_RATIO:g} times the expanded uncertainty"
    spread = np.zeros_like(by_u)
    if golden is not None and len(golden.parts) >= 3 and recipe.decision.contrast == "log_ratio":
        logs = np.array([part.log_radiance for part in golden.parts])
        index = {(pose.stage_deg, pose.tilt_deg): k for k, pose in enumerate(record.poses)}
        for k, pair in enumerate(judged):
            a, b = index[pair.from_deg, pair.tilt_deg], index[pair.to_deg, pair.tilt_deg]
            log_ratios = logs[:, a] - logs[:, b]
            off = abs(float(log_ratios.mean()) - pair.predicted)
            spread[k] = off + GOLDEN_SIGMAS * float(log_ratios.std(ddof=1))
        why += f", or what {len(golden.parts)} golden parts vary"
    return [float(f"{value:.2g}") for value in np.maximum(by_u, spread)], why


MORE_PARTS = (1, 3, 10, 25)


def with_power(
    shown: CommandOutput, known: GoldenSet, recipe: SurfaceRecipe, parts: PartScatter
) -> CommandOutput:
    """Output with the golden parts' scatter against the stated one, and the defects that they can show."""
    scatter = contrast_scatter(parts, CAMERA_SHARE)
    golden, count, batches = known.contrasts(), len(known.parts), known.batches
    birge = birge_ratio(golden, scatter.covariance)
    size = size_of(golden, scatter.covariance)
    interval = size_interval(golden, scatter.covariance)
    numbers = sorted({count, *MORE_PARTS})
    alpha = recipe.decision.alpha
    power = {n: detectable(scatter, n, alpha, size, batches if n == count else None) for n in numbers}
    content: dict[str, Any] = {
        "birge": birge,
        "size": size,
        "size_interval": interval,
        "batches": batches,
        "detectable": {str(n): power[n] for n in numbers},
    }
    rows = [
        [one.name, *(_size(one, power[n][one.name]) for n in numbers)]
        for one in named_defects(recipe)
        if one.name in scatter.defects
    ]
    columns = [
        "defect, at its smallest interesting size",
        *(f"{n} golden parts" if n > 1 else "1 golden part" for n in numbers),
    ]
    legend = "size that is found in 9 of 10 parts, now and with other numbers of golden parts"
    tables = [*shown.tables, Table("what golden parts can show", columns, rows, legend)]
    lines = list(shown.lines)
    if count >= LEAST_PARTS:
        found = suggested_scatter(scatter, golden)
        stated = scatter_texts(recipe)
        content["scatter_of_inputs"] = [asdict(one) for one in found]
        scattered = [
            [
                one.source,
                *(f"{stated[one.source][0] * value:.3g}" for value in (1.0, one.ratio, one.low)),
                "not determined" if np.isinf(one.high) else f"{stated[one.source][0] * one.high:.3g}",
                stated[one.source][1],
            ]
            for one in found
        ]
        names = ["input", "stated", "of the golden parts", "95 % from", "to", "unit, key of [scatter]"]
        tables.append(Table("scatter between parts", names, scattered, "standard deviations"))
    if count > 1 and batches == 1:
        lines.append(
            f"all {count} golden parts are of one lot or day: their mean counts as that of one part; add parts of "
            "another lot, or of another day"
        )
    if birge is not None and interval is not None:
        low, high = interval
        line = (
            f"variance among the golden parts over the stated one: {birge:.2g} (95 %: {low:.1g} to {high:.2g}; up to "
            f"{MAX_BIRGE:g} is usual); the test takes {size:.2g}"
        )
        if birge > MAX_BIRGE:
            line += ": state theirs in [scatter], or calibrate the material, which is not the recipe's"
        lines.append(line)
    return CommandOutput(shown.content | content, tuple(tables), tuple(lines))


def _size(defect: NamedDefect, multiple: float) -> str:
    return defect.text(multiple) if np.isfinite(multiple) else "–"


def scatter_texts(recipe: SurfaceRecipe) -> dict[str, tuple[float, str]]:
    """Stated standard deviation of each input between parts, with its unit and its key in the recipe."""
    part, seat = recipe.stated_scatter, (recipe.scattered_seating_deg, "°, seating_tilt_deg")
    return {
        "roughness along the ridges": (100.0 * part.alpha_share, "%, alpha_share"),
        "roughness across the ridges": (100.0 * part.alpha_share, "%, alpha_share"),
        "albedo of the plastic": (100.0 * part.albedo_share, "%, albedo_share"),
        EDGE_RADIUS: (100.0 * part.edge_radius_share, "%, edge_radius_share"),
        "seating tilt about x": seat,
        "seating tilt about y": seat,
        RIDGE_ANGLE: (recipe.scattered_ridge_angle_deg, "°, ridge_angle_deg"),
    }


def unlike_text(decided: Decision) -> str | None:
    """Note where golden parts contradict the scatter that the recipe states, or None."""
    found = decided.predictive
    if found is None or found.birge is None or found.birge <= MAX_BIRGE:
        return None
    return (
        f"the golden parts scatter {found.birge:.1f} times as much as [scatter] and the measurement state (variance, "
        f"usually up to {MAX_BIRGE:g}): state theirs (anisoscope golden show), or the plastic is not the recipe's"
    )


def golden_record(golden: GoldenSet, measured: Measured, decided: Decision) -> GoldenRecord:
    """The golden parts behind the verdict, and this part among them."""
    found = decided.predictive
    contrasts = golden.contrasts()
    mine = log_basis(len(measured.radiance)) @ np.log(measured.radiance)
    return GoldenRecord(
        parts=len(golden.parts),
        mean=tuple(contrasts.mean(axis=0)),
        contrasts=tuple(tuple(row) for row in contrasts),
        measured=tuple(mine),
        test="sized" if found is None else "predictive",
        birge=None if found is None else found.birge,
        size=None if found is None else found.size,
        batches=golden.batches,
        unjudged=golden.unjudged,
        lot=golden.lot,
        p_distance=None if found is None else found.p_distance,
        p_direction=None if found is None else found.p_direction,
        directions=()
        if found is None
        else tuple(
            DirectionRecord(
                defect=one.defect,
                score=one.score,
                p_value=one.p_value,
                separation=one.separation,
                power=one.power,
                detectable=one.detectable if np.isfinite(one.detectable) else None,
            )
            for one in found.directions
        ),
    )


LEAST_CHANGE = 0.05
"""Relative change of a scatter for which a recipe gets a new version."""


def teach_scatter(
    kind: Any,  # noqa: ANN401
    recipe_path: Path,
    rig_path: Path,
    source_path: Path,
) -> Taught:
    """Write a new version of a recipe with the scatter that golden parts of it, or of another recipe, teach.

    How parts, plastic and seat scatter is the same in any poses and of any ridges. What the golden parts show corrects
    what their recipe states (`predictive.learnt_scatter`); what they do not show stays as it states it.

    Args:
        kind: `SurfaceKind` of both recipes.
        recipe_path: the recipe that changes.
        rig_path: the rig of both; no device is opened.
        source_path: the recipe of the golden parts.

    Raises:
        UsageError: less than three golden parts, another plastic, or nothing would change.
        CalibrationError: the golden parts are not those of recipe and rig.
        RecipeError, RigFileError, RecordError: a file.
    """
    recipe, source = kind.read_recipe(recipe_path), kind.read_recipe(source_path)
    rig = read_replay_rig(rig_path, recipe.acquisition.light_channel)
    if recipe.material.material() != source.material.material():
        raise UsageError(
            f"{recipe_path} and {source_path} state different plastics, whose parts need not scatter alike: name the "
            "same material file in both"
        )
    known = cast("GoldenSet | None", reference_on(kind, source_path, source, rig))
    parts = kind.part_scatter(source, rig.light.angle_deg)
    count = 0 if known is None else len(known.parts)
    if known is None or parts is None or count < LEAST_PARTS:
        lacking = f"it has {count}" if parts is not None else "it states none, or has no ridges"
        raise UsageError(f"{source_path}: {LEAST_PARTS} golden parts or more teach [scatter], {lacking}")
    stated, before = scatter_texts(source), scatter_texts(recipe)
    keys = {name: text.split(", ")[1] for name, (_, text) in stated.items()}
    scatter = contrast_scatter(parts, CAMERA_SHARE)
    learnt = learnt_scatter(scatter, known.contrasts(), keys)
    values: dict[tuple[str, ...], Any] = {("version",): recipe.version + 1}
    changes = []
    for one in suggested_scatter(scatter, known.contrasts()):
        key, (value, text) = keys[one.source], stated[one.source]
        new, old, unit = value * learnt[key], before[one.source][0], text.split(", ")[0]
        if ("scatter", key) in values or abs(new - old) <= LEAST_CHANGE * old:
            continue
        rounded, share = float(f"{new:.2g}"), 0.01 if unit == "%" else 1.0
        values["scatter", key] = float(f"{rounded * share:.6g}")
        why = (
            f"{count} golden parts of {source_path.name} show {value * one.ratio:.2g} {unit} of {one.source}"
        )
        changes.append(Change(f"scatter.{key}", f"{old:.2g} {unit}", f"{rounded:g} {unit}", why))
    if not changes:
        raise UsageError(
            f"{recipe_path}: [scatter] stays: it is within {LEAST_CHANGE:.0%} of what those of {source_path} teach"
        )
    previous = previous_version_path(recipe_path, recipe.version)
    text = bounded_text(recipe_path)
    new_text = with_values(text, values)
    write_text(previous, text)
    write_text(recipe_path, new_text)
    return Taught(recipe.version + 1, previous, None, tuple(changes), ())
