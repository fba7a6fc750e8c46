"""Check of a recipe before inspection: contrasts with u, T/U, budget, separability of causes, helpful tilts."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime

import numpy as np

from anisoscope.base.progress import Advance, silent
from anisoscope.decision.consistency import contrast_scatter
from anisoscope.decision.decision import contrast_gradient
from anisoscope.decision.surface_exclusion import parts_needed, planned_limits, remedy_text
from anisoscope.diagnosis.cause_model import PLASTIC_CAUSES, CauseModel
from anisoscope.diagnosis.discriminating_poses import cached_options
from anisoscope.diagnosis.evidence import background_of
from anisoscope.diagnosis.separability import Separability, planned_covariance, planned_inputs, separability
from anisoscope.diagnosis.signature_cache import cached_signatures
from anisoscope.diagnosis.signatures import Signatures
from anisoscope.imaging.deviation_map import LEAST_DEVIATION, CellScatter
from anisoscope.kinds.command_output import Table
from anisoscope.kinds.recipe_check import RecipeCheck
from anisoscope.prediction.cache import cached_expectation
from anisoscope.prediction.expectation import PLASTIC, Expectation, SurfaceOptics
from anisoscope.prediction.part_scatter import CAMERA_SHARE, part_scatter
from anisoscope.recipe.surface import MOST_DEVIATION, SurfaceRecipe
from anisoscope.record.schema import BudgetRecord
from anisoscope.sim.light.contrasts import consecutive_pairs, contrasts
from anisoscope.sim.light.relief import Relief
from anisoscope.sim.light.unresolved import resolve

TARGET_RATIO = 4.0
FREE_LEVEL = 0.3
"""`uncertainty.scale_share` from which the radiance of a white tile counts as unknown."""


@dataclass(frozen=True)
class PlannedPair:
    """A contrast as it will be judged.

    Attributes:
        from_deg: first stage angle.
        to_deg: second stage angle.
        tilt_deg: tilt.
        predicted: the contrast.
        u: standard uncertainty of measured − predicted, as far as the recipe says.
        tolerance: or None.
        ratio: T/U, U = 2u, or None.
    """

    from_deg: float
    to_deg: float
    tilt_deg: float
    predicted: float
    u: float
    tolerance: float | None
    ratio: float | None


@dataclass(frozen=True)
class TiltAdvice:
    """Benefit of a further tilt: causes that become detectable, and pairs of causes that become separable."""

    tilt_deg: float
    shows: tuple[str, ...]
    tells_apart: tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class LampAdvice:
    """Benefit of a second lamp: pairs of causes that become separable with the recipe's poses under it."""

    says: str
    tells_apart: tuple[tuple[str, str], ...]


@dataclass(frozen=True, kw_only=True)
class SurfaceCheck(RecipeCheck):
    """Capability of the recipe of a surface.

    Attributes:
        contrast: which contrast is judged.
        pairs: the contrasts.
        budget: sources of uncertainty of the contrasts, the largest first; the measurement's in one row.
        left_out: causes that this surface cannot have, with the reason.
        advice: what further tilts would add, the best first; only those that add something.
        lamps: second lamps that would add something, the nearest wavelength first, where they are tried.
        never: pairs of causes that neither these poses separate, nor any tilt or lamp that was tried.
        roughness: of the whole plastic, by the height map and the recipe's lobe, in one line; None without a map.
        thresholds: assumed for the cells, of which every part sets its own, in one line; None without a limit of the
            area.
        angles: what the angle map will tell, in one line; None of a surface without ridges.
    """

    contrast: str
    pairs: tuple[PlannedPair, ...]
    budget: tuple[BudgetRecord, ...]
    left_out: tuple[tuple[str, str], ...]
    advice: tuple[TiltAdvice, ...]
    lamps: tuple[LampAdvice, ...] = ()
    never: tuple[tuple[str, str], ...] = ()
    roughness: str | None = None
    thresholds: str | None = None
    angles: str | None = None

    def tables(self) -> tuple[Table, ...]:
        """Contrasts, and their budget."""
        names = [f"{p.from_deg:g}°/{p.to_deg:g}° @ {p.tilt_deg:g}°" for p in self.pairs]
        pairs = Table(
            self.product,
            ["pair", "predicted", "u", "tolerance", "T/U"],
            [
                [
                    name,
                    f"{pair.predicted:+.4f}",
                    f"{pair.u:.4f}",
                    "–" if pair.tolerance is None else f"±{pair.tolerance:g}",
                    "–" if pair.ratio is None else f"{pair.ratio:.1f}",
                ]
                for name, pair in zip(names, self.pairs, strict=True)
            ],
        )
        budget = Table(
            "uncertainty budget",
            ["source", *(f"u({name})" for name in names)],
            [[row.source, *(f"{value:.4f}" for value in row.contributions)] for row in self.budget],
        )
        return pairs, budget

    def notes(self) -> tuple[str, ...]:
        """Causes left out, and what further tilts or lamps would separate."""
        lines = [f"not examined: {_named(cause)}: {reason}" for cause, reason in self.left_out]
        for one in self.advice:
            benefits = [f"show {', '.join(map(_named, one.shows))}"] if one.shows else []
            benefits += [f"distinguish {_apart(one.tells_apart)}"] if one.tells_apart else []
            lines.append(f"an additional tilt of {one.tilt_deg:g}° would {' and '.join(benefits)}")
        lines += [f"{one.says} would distinguish {_apart(one.tells_apart)}" for one in self.lamps]
        if self.never:
            lines.append(f"nothing that was tried would distinguish {_apart(self.never)}")
        lines += [line for line in (self.roughness, self.thresholds, self.angles) if line is not None]
        return tuple(lines)


def _roughness(recipe: SurfaceRecipe, expected: Expectation) -> str | None:
    """Roughness that the height map resolves, and that of the whole plastic if the recipe states the rest."""
    if expected.surface is None:
        return None
    relief = Relief(expected.surface, direction_deg=expected.turn_deg, turn_deg=expected.turn_deg)
    shown, lobe = resolve(relief), recipe.material
    if recipe.surface.roughness == "plastic":
        left = shown.lobe(lobe.material())
        used = " (nothing: its noise, or alpha is too small)" if shown.exhausts(lobe.material()) else ""
        return (
            f"the height map resolves a roughness of {shown.along:.3f} along and {shown.across:.3f} across the ridges, "
            f"which leaves {left.alpha_along:.3f} and {left.alpha_across:.3f} of the plastic to its facets{used}"
        )
    whole = np.hypot(shown.along, lobe.alpha_along), np.hypot(shown.across, lobe.alpha_across)
    return (
        f"the height map resolves a roughness of {shown.along:.3f} along and {shown.across:.3f} across the ridges, and "
        f"[material] states what it does not: a plastic of {whole[0]:.3f} along and {whole[1]:.3f} across in all"
    )


def check_recipe(
    recipe: SurfaceRecipe,
    light_angle_deg: float,
    tries: Sequence[float] = (),
    advance: Advance = silent,
    optics: SurfaceOptics = PLASTIC,
    model: CauseModel = PLASTIC_CAUSES,
) -> SurfaceCheck:
    """Check the recipe of a surface; nothing moves.

    Args:
        recipe: the recipe.
        light_angle_deg: of the rig.
        tries: tilts that might be added, degrees.
        advance: progress.
        optics: of the kind of surface.
        model: causes of the kind of surface.

    Raises:
        HeightMapError, RecipeError: nothing can be predicted.
    """
    advance("prediction", 0, 1)
    expected = cached_expectation(recipe, light_angle_deg, optics)
    pairs, budget = _plan(recipe, expected)
    single = recipe.poses.stage_and_tilt_deg is not None  # chosen as a whole: `recipe suggest` chooses others
    new = [] if single else [tilt for tilt in tries if tilt not in recipe.poses.tilts_deg]
    wide = _tilted(recipe, new) if new else None
    every = cached_signatures(recipe, light_angle_deg, advance, model, wide)
    known = _with_texture(every)
    with_map = recipe.area is not None
    u_background = 0.0 if recipe.area is None else background_of(recipe.area.max_share)[1]

    def causes_by(shown: Signatures) -> tuple[Separability, ...]:
        return separability(
            shown,
            planned_covariance(recipe, expected),
            with_map=with_map,
            u_background=u_background,
            inputs=planned_inputs(recipe, expected),
        )

    causes = causes_by(known)
    parts = None if recipe.scatter is None else part_scatter(recipe, light_angle_deg, optics)
    advice: tuple[TiltAdvice, ...] = ()
    if wide is not None and _lacking(causes):
        advice = _advice(wide, recipe.poses.tilts_deg, light_angle_deg, advance, optics, model)
    unresolved = [(cause.cause, other) for cause in causes for other in cause.inseparable_causes]
    lamps = (
        second_lamps_for(recipe, light_angle_deg, unresolved, advance, model) if new and unresolved else ()
    )
    resolved = {pair for one in advice for pair in one.tells_apart}
    resolved |= {pair for one in lamps for pair in one.tells_apart}
    never = tuple(pair for pair in unresolved if pair not in resolved) if new else ()
    excludes = planned_limits(expected, parts, recipe, CAMERA_SHARE)
    scatter = None if parts is None else contrast_scatter(parts, CAMERA_SHARE)
    needed = parts_needed({one.defect for one in excludes if not one.excluded}, scatter, parts, recipe)
    compares = recipe.decision.compare_with_lot
    return SurfaceCheck(
        product=recipe.product,
        contrast=recipe.decision.contrast,
        pairs=pairs,
        budget=budget,
        causes=causes,
        left_out=known.left_out,
        roughness=_roughness(recipe, expected) if optics is PLASTIC else None,
        thresholds=None if every.levels is None else _thresholds_text(every, causes, causes_by),
        advice=advice,
        complaints=_complaints(recipe, pairs),
        lamps=lamps,
        never=never,
        excludes=excludes,
        remedy=remedy_text(expected, None, needed, of_lot=False, compares=compares),
    )


def _thresholds_text(
    known: Signatures,
    causes: tuple[Separability, ...],
    causes_by: Callable[[Signatures], tuple[Separability, ...]],
) -> str:
    """Thresholds of the cells where "auto" leaves them to every part, and the size from which they show marks."""
    if known.scatter is not None:
        each = ", ".join(f"{one:.2f}" for one in known.scatter.thresholds(consecutive_pairs(known.poses)))
        return (
            f"marks: by the texture of the height map cells deviate beyond a ln ratio of about {each} (one a pair of "
            f"angles; more where noise scatters them), which shows {_marks(causes)}"
        )
    even = causes_by(known.by_scatter(CellScatter.even(LEAST_DEVIATION, len(known.poses))))
    return (
        "marks: from which ln ratio on cells deviate is not known yet, because a design has no texture, and every part "
        f"sets its own limit by what its points scatter; {MOST_DEVIATION:g} is assumed here, which shows "
        f"{_marks(causes)}; at {LEAST_DEVIATION:g} it would be {_marks(even)}. The first inspection states it"
    )


def _marks(causes: tuple[Separability, ...]) -> str:
    """Local defects with the extent from which on they are shown."""
    found = []
    for one in causes:
        if one.group != "area":
            continue
        name, extent = _named(one.cause), one.detection_extent
        if extent is None:
            found.append(f"no {name}")
            continue
        size = float(f"{extent if one.unit else 100.0 * extent:.2g}")
        found.append(f"{name} from {size:g} {one.unit.replace('1/', 'per ') or '%'}")
    return ", ".join(found)


def _with_texture(known: Signatures) -> Signatures:
    """Signatures whose cells deviate by the scatter of the height map, or of a design beyond `MOST_DEVIATION`.

    How the cells of good parts scatter is not known of a design before one is photographed.
    """
    return known.by_scatter(known.scatter or CellScatter.even(MOST_DEVIATION, len(known.poses)))


def second_lamps_for(
    recipe: SurfaceRecipe,
    light_angle_deg: float,
    unresolved: Sequence[tuple[str, str]],
    advance: Advance,
    model: CauseModel,
) -> tuple[LampAdvice, ...]:
    """Second lamps, nearest wavelength first, each with the pairs that no nearer one separates.

    Args:
        recipe: the recipe.
        light_angle_deg: of the rig.
        unresolved: pairs of causes that the recipe's poses never separate.
        advance: progress.
        model: causes of the kind of surface; one that tries no lamps finds none.
    """
    names = sorted({name for pair in unresolved for name in pair})
    left, found = list(unresolved), []
    for option in cached_options(recipe, light_angle_deg, names, advance, model):
        apart = tuple(pair for pair in left if option.separation_extents[pair[0]][pair[1]] is not None)
        if option.kind == "lamp" and apart:
            found.append(LampAdvice(option.says, apart))
            left = [pair for pair in left if pair not in apart]
    return tuple(found)


def _plan(
    recipe: SurfaceRecipe, expected: Expectation
) -> tuple[tuple[PlannedPair, ...], tuple[BudgetRecord, ...]]:
    kind = recipe.decision.contrast
    gradient = contrast_gradient(expected.poses, expected.radiance, kind)
    measured = planned_covariance(recipe, expected)
    if kind != "difference":
        measured = measured - recipe.uncertainty.scale_share**2  # cancels in ratios
    parts = [c.covariance() for c in expected.components]
    rest = measured - np.sum(parts, axis=0)
    u = np.sqrt(np.maximum(np.diag(gradient @ measured @ gradient.T), 0.0))
    tolerances = recipe.tolerances() or (None,) * len(gradient)
    pairs = tuple(
        PlannedPair(
            one.from_deg,
            one.to_deg,
            one.tilt_deg,
            float(getattr(one, kind)),
            float(spread),
            limit,
            None if limit is None or spread == 0.0 else float(limit / (2.0 * spread)),
        )
        for one, spread, limit in zip(
            contrasts(expected.poses, expected.radiance), u, tolerances, strict=True
        )
    )
    names = [(c.source, c.kind) for c in expected.components] + [
        ("measurement, without noise", "measurement")
    ]
    rows = [
        BudgetRecord(
            source=name,
            kind=what,
            contributions=tuple(np.sqrt(np.maximum(np.diag(gradient @ v @ gradient.T), 0.0))),
        )
        for (name, what), v in zip(names, [*parts, rest], strict=True)
    ]
    return pairs, tuple(sorted(rows, key=lambda row: -max(row.contributions)))


def _complaints(recipe: SurfaceRecipe, pairs: tuple[PlannedPair, ...]) -> tuple[str, ...]:
    found = []
    if recipe.decision.tolerance is None:
        found.append("no tolerance: every significant deviation fails the part (set one, or `recipe teach`)")
    file = recipe.material.calibrated
    expired = None if file is None else file.expired(datetime.now(UTC))
    if expired is not None:
        found.append(expired)
    if recipe.uncertainty.scale_share >= FREE_LEVEL:
        found.append(
            f"uncertainty.scale_share is {recipe.uncertainty.scale_share:.0%}: the reflectance of the white tile is "
            "unknown, so that only ratios between poses count against the prediction; limits are larger"
        )
    if recipe.material.u_tail is None:
        found.append(
            "the lobe of the plastic is unmeasured: without golden parts only large defects fail a part; measure it "
            "with `anisoscope calibrate material`, or state material.u_tail"
        )
    weak = [pair for pair in pairs if pair.ratio is not None and pair.ratio < TARGET_RATIO]
    if weak:
        least = min(weak, key=lambda pair: pair.ratio or 0.0)
        found.append(
            f"T/U is {least.ratio:.1f} at {least.from_deg:g}°/{least.to_deg:g}°, tilt {least.tilt_deg:g}° "
            f"({TARGET_RATIO:g} wanted): good parts may end undecided; "
            f"{TARGET_RATIO * 2.0 * least.u:.2g} would be enough, or less uncertainty (see the budget)"
        )
    return tuple(found)


def _lacking(causes: tuple[Separability, ...]) -> bool:
    return any(cause.detection_extent is None or cause.inseparable_causes for cause in causes)


def _tilted(recipe: SurfaceRecipe, tries: Sequence[float]) -> SurfaceRecipe:
    """The recipe with further tilts; a tolerance has no number for their contrasts."""
    poses = recipe.poses.model_copy(update={"tilts_deg": (*recipe.poses.tilts_deg, *tries)})
    decision = recipe.decision.model_copy(update={"tolerance": None})
    return recipe.model_copy(update={"poses": poses, "decision": decision})


def _advice(
    wide: SurfaceRecipe,
    tilts_deg: Sequence[float],
    light_angle_deg: float,
    advance: Advance,
    optics: SurfaceOptics,
    model: CauseModel,
) -> tuple[TiltAdvice, ...]:
    """Advice on further tilts of a recipe, from parts of one set of signatures over all of them."""
    known = _with_texture(cached_signatures(wide, light_angle_deg, advance, model))
    expected = cached_expectation(wide, light_angle_deg, optics)
    covariance, with_map = planned_covariance(wide, expected), wide.area is not None
    inputs = planned_inputs(wide, expected)
    u_background = 0.0 if wide.area is None else background_of(wide.area.max_share)[1]

    def separability_with(chosen: Sequence[float]) -> tuple[Separability, ...]:
        kept = [k for k, pose in enumerate(known.poses) if pose.tilt_deg in chosen]
        return separability(
            known.of(kept),
            covariance[np.ix_(kept, kept)],
            with_map=with_map,
            u_background=u_background,
            inputs=None if inputs is None else inputs.of(kept),
        )

    before = separability_with(tilts_deg)
    tries = [tilt for tilt in wide.poses.tilts_deg if tilt not in tilts_deg]
    found = [_added(tilt, before, separability_with((*tilts_deg, tilt))) for tilt in tries]
    useful = [one for one in found if one.shows or one.tells_apart]
    return tuple(sorted(useful, key=lambda one: -(len(one.shows) + len(one.tells_apart))))


def _added(tilt_deg: float, before: tuple[Separability, ...], after: tuple[Separability, ...]) -> TiltAdvice:
    shows = tuple(
        new.cause
        for old, new in zip(before, after, strict=True)
        if old.detection_extent is None and new.detection_extent is not None
    )
    apart = tuple(
        (old.cause, other)
        for old, new in zip(before, after, strict=True)
        for other in old.inseparable_causes
        if other not in new.inseparable_causes
    )
    return TiltAdvice(tilt_deg, shows, apart)


MOST_PAIRS = 6


def _apart(pairs: Sequence[tuple[str, str]]) -> str:
    """Pairs of causes in words; of many the first."""
    more = f" and {len(pairs) - MOST_PAIRS} more" if len(pairs) > MOST_PAIRS else ""
    return ", ".join(f"{_named(a)} from {_named(b)}" for a, b in pairs[:MOST_PAIRS]) + more


def _named(cause: str) -> str:
    """Name of a cause in a sentence."""
    return cause.replace("-", " ")
