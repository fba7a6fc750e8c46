"""Check of a print's recipe before anything moves: uncertainties of the judged quantities, separability of causes."""

from dataclasses import dataclass, replace

import numpy as np

from anisoscope.base.covariance import root
from anisoscope.base.errors import MeasurementError, RecipeError
from anisoscope.base.json_fields import in_json
from anisoscope.base.progress import Advance
from anisoscope.decision.exclusion import MORE_TILTS
from anisoscope.decision.exclusion import planned as planned_limits
from anisoscope.diagnosis.separability import separability
from anisoscope.kinds.command_output import Table
from anisoscope.kinds.prints.causes import U_BACKGROUND, known_causes
from anisoscope.kinds.prints.decision import PrintDecision, decide_print
from anisoscope.kinds.prints.expectation import PrintExpectation, expect_print, rig_sources
from anisoscope.kinds.prints.lighting import SYNTHETIC, expectation_of_print
from anisoscope.kinds.prints.measurement import MeasuredPrint, cell_grid
from anisoscope.kinds.prints.pose_colours import without_lean
from anisoscope.kinds.prints.quantities import Quantity
from anisoscope.kinds.prints.recipe import UNSTATED, PrintRecipe
from anisoscope.kinds.prints.sources import Source, of_poses, total
from anisoscope.kinds.recipe_check import RecipeCheck
from anisoscope.rig.rigfile import RigFile
from anisoscope.sim.materials.spectra import find_illuminant, find_sensitivities

TARGET_SHARE = 0.9
"""Good prints that should come out of a limit decided."""
DIM = 0.1
"""Brightness of a pose, by the brightest, below which a longer exposure is worth while."""
_CURL_U_DEG = 0.05
_MEDIAN = 0.674
"""Median of the size of a normal deviate, by which `colour_map` measures the scatter of cells."""
_LENGTHS = ("chromaticity", "tilt")
_DRAWS, _SEED = 2000, 7


@dataclass(frozen=True)
class PlannedQuantity:
    """Planned knowledge of a quantity: its standard uncertainty, and T/U of the limit.

    ``passing`` is the share of good prints, as they vary by what the recipe says is uncertain, that will pass it.
    """

    name: str
    title: str
    unit: str
    limit: float
    u: float
    passing: float

    @property
    @in_json()
    def ratio(self) -> float | None:
        """T/U."""
        return None if self.u == 0.0 else self.limit / (2.0 * self.u)


@dataclass(frozen=True)
class PlannedPose:
    """A pose as it is predicted: red, green and blue in 1/sr, and how bright by the brightest pose."""

    stage_deg: float
    tilt_deg: float
    channels: tuple[float, float, float]
    brightness: float


@dataclass(frozen=True, kw_only=True)
class PrintRecipeCheck(RecipeCheck):
    """Capability of a print's recipe: poses, judged quantities, and separability of causes.

    ``synthetic_rig``: without a rig file lamp and camera are synthetic.
    """

    poses: tuple[PlannedPose, ...]
    quantities: tuple[PlannedQuantity, ...]
    matrix_residual: float
    synthetic_rig: bool = False

    def tables(self) -> tuple[Table, ...]:
        """Poses, and what is judged."""
        poses = Table(
            self.product,
            ["stage [°]", "tilt [°]", "red [1/sr]", "green [1/sr]", "blue [1/sr]", "by the brightest"],
            [
                [
                    f"{pose.stage_deg:g}",
                    f"{pose.tilt_deg:g}",
                    *(f"{value:.4f}" for value in pose.channels),
                    f"{pose.brightness:.1%}",
                ]
                for pose in self.poses
            ],
        )
        quantities = Table(
            "what is judged",
            ["quantity", "limit", "u", "T/U"],
            [
                [
                    one.title,
                    f"{one.limit:g} {one.unit}".strip(),
                    f"{one.u:.2g}",
                    "–" if one.ratio is None else f"{one.ratio:.1f}",
                ]
                for one in self.quantities
            ],
        )
        return poses, quantities

    def notes(self) -> tuple[str, ...]:
        """The colour matrix, and whose lamp and camera were taken."""
        matrix = f"the matrix from the camera's channels to XYZ leaves ΔE {self.matrix_residual:.2f} on a good print"
        if not self.synthetic_rig:
            return (matrix,)
        return matrix, "lamp and camera are made-up ones: name a rig file with --rig for its own"


def check_print_recipe(recipe: PrintRecipe, expected: PrintExpectation) -> PrintRecipeCheck:
    """Check the recipe of a print; nothing moves.

    Args:
        recipe: the recipe.
        expected: what it predicts.

    Raises:
        RecipeError: the recipe leaves nothing uncertain, so that nothing can be weighed.
    """
    poses = len(expected.poses)
    # the lamp drifts by a quarter of its limit; noise is small against the rest and left out
    lamp = 0.25 * recipe.limits.drift / np.sqrt(3.0)
    drift = of_poses("drift of the lamp", "measurement", np.full((poses, 3), lamp))
    decision = as_predicted(recipe, expected, drift)
    covariance = total((*expected.sources, *rig_sources(recipe, expected), drift), 3 * poses)
    extra = 0 if recipe.area is None else 1
    whole = np.zeros((3 * poses + extra, 3 * poses + extra))
    whole[: 3 * poses, : 3 * poses] = covariance
    if extra:
        whole[-1, -1] = _CURL_U_DEG**2
    causes = separability(
        known_causes(recipe, expected, decision.fit, extra),
        whole,
        with_map=bool(extra),
        u_background=U_BACKGROUND,
    )
    quantities = planned_quantities(recipe, expected, decision)
    planned = _poses(expected)
    return PrintRecipeCheck(
        product=recipe.product,
        poses=planned,
        quantities=quantities,
        causes=causes,
        matrix_residual=expected.eye.residual,
        complaints=_complaints(recipe, expected, planned, quantities),
        excludes=planned_limits((decision.exclusions,)),
        remedy=MORE_TILTS,
    )


def planned_quantities(
    recipe: PrintRecipe, expected: PrintExpectation, decision: PrintDecision
) -> tuple[PlannedQuantity, ...]:
    """Planned quantities of an inspection, by the decision on a print exactly as predicted."""
    return tuple(
        PlannedQuantity(
            one.name,
            one.title if one.name != "delta_e" else "ΔE2000",
            one.unit,
            one.limit,
            one.u,
            _passing(one) if one.name != "delta_e" else _colours_passing(recipe, expected, decision),
        )
        for one in decision.quantities
    )


def as_predicted(recipe: PrintRecipe, expected: PrintExpectation, drift: Source) -> PrintDecision:
    """The verdict on a print that shows exactly what is predicted.

    Raises:
        RecipeError: the recipe leaves nothing uncertain, so that nothing can be weighed.
    """
    alone = recipe.model_copy(update={"area": None})
    channels = expected.channels
    measured = MeasuredPrint(
        channels,
        channels[:, :, None, None],
        np.zeros_like(channels),
        (drift,),
        cell_grid(alone),
        None,
    )
    try:
        return decide_print(expected, measured, alone)
    except MeasurementError as problem:
        raise RecipeError(str(problem)) from None


def _passing(one: Quantity) -> float:
    """Share of good prints that stay below a limit less its guard band; of lengths in the least favourable case."""
    from scipy.special import erf  # noqa: PLC0415 - start-up time

    room = one.limit - one.guard
    if one.u == 0.0 or room <= 0.0:
        return float(room > 0.0)
    if one.name in _LENGTHS:
        return float(-np.expm1(-0.5 * (room / one.u) ** 2))  # Rayleigh
    return float(erf(room / one.u / np.sqrt(2.0)))


def _colours_passing(recipe: PrintRecipe, expected: PrintExpectation, decision: PrintDecision) -> float:
    """Share of good prints, drawn from all that is uncertain, with ΔE2000 below its limit in every pose."""
    count, metric = 3 * len(expected.poses), expected.eye.metric(expected.channels)
    assert decision.fit is not None  # what is predicted has a lobe
    spread = root(without_lean(decision.fit, total(decision.sources, count)))
    normal = np.random.default_rng(_SEED).standard_normal((_DRAWS, count))
    off = (normal @ spread).reshape(_DRAWS, -1, 3)
    delta_e = np.sqrt(np.einsum("npi,pij,npj->np", off, metric, off, optimize=True))
    guard = recipe.decision.coverage * np.array([one.u_delta_e for one in decision.colours])
    return float(np.mean(np.all(delta_e + guard <= recipe.tolerances.delta_e, axis=1)))


def _poses(expected: PrintExpectation) -> tuple[PlannedPose, ...]:
    bright = expected.channels.max(axis=1)
    found = []
    for pose, channels, level in zip(expected.poses, expected.channels, bright, strict=True):
        red, green, blue = (float(value) for value in channels)
        found.append(
            PlannedPose(pose.stage_deg, pose.tilt_deg, (red, green, blue), float(level / bright.max()))
        )
    return tuple(found)


def _complaints(
    recipe: PrintRecipe,
    expected: PrintExpectation,
    poses: tuple[PlannedPose, ...],
    quantities: tuple[PlannedQuantity, ...],
) -> tuple[str, ...]:
    found = [UNSTATED] if recipe.print.lacks_uncertainty(expected.scene.ink) else []
    found += _of_dots(recipe, expected)
    darkest = min(poses, key=lambda one: one.brightness)
    if darkest.brightness < DIM and not recipe.acquisition.brackets:
        found.append(
            f"at tilt {darkest.tilt_deg:g}° the print is {darkest.brightness:.1%} as bright as in its brightest pose: "
            "set acquisition.brackets, such as [8.0]"
        )
    found += [
        f"of prints as good as [print] and [uncertainty] say only {one.passing:.0%} will pass the limit of "
        f"{one.title} ({TARGET_SHARE:.0%} wanted), and most others end undecided: widen the limit, or lessen the "
        "uncertainties"
        for one in quantities
        if one.passing < TARGET_SHARE
    ]
    return tuple(found)


def _of_dots(recipe: PrintRecipe, expected: PrintExpectation) -> list[str]:
    """Whether cells hold too few dots of a halftone: of dots placed at random, which scatter most."""
    part, area = recipe.print, recipe.area
    if area is None or part.dot_um is None or part.coverage == 1.0:
        return []
    dots = (1000.0 * area.cell_mm / part.dot_um) ** 2
    one = np.ones(3)
    by_level = np.sqrt(np.einsum("i,pij,j->p", one, expected.eye.metric(expected.channels), one).max())
    scatter = float(by_level * np.sqrt((1.0 - part.coverage) / (part.coverage * dots)))
    limit = area.scatters * _MEDIAN * scatter
    if limit <= area.cell_delta_e:
        return []
    count = f"{dots:.0f} dots" if dots > 1.5 else "one dot or less"
    held = f"a cell of {area.cell_mm:g} mm holds {count} of {part.dot_um:g} µm"
    wide = area.cell_mm * limit / area.cell_delta_e
    if wide > min(recipe.region.size_mm):
        return [
            f"{held}, and the region too few for cells of any size: leave [area] out, or print smaller dots"
        ]
    text = (
        f"{held}: cells of a good print scatter by up to ΔE {scatter:.2g}, so that a spot has to be off by up to "
        f"{limit:.2g}, not {area.cell_delta_e:g} (area.cell_delta_e): take area.cell_mm = {wide:.2g}"
    )
    return [text]


LAMP = "led-white"


def checked_print(
    recipe: PrintRecipe, rig: RigFile | None, light_angle_deg: float, advance: Advance
) -> PrintRecipeCheck:
    """Check of a print's recipe; without a rig lamp and camera are synthetic."""
    advance("prediction", 0, 1)
    if rig is not None:
        expected = expectation_of_print(recipe, rig)
    else:
        lamp, camera = find_illuminant(LAMP), find_sensitivities(SYNTHETIC, "rggb")
        expected = expect_print(recipe, light_angle_deg, lamp, camera)
    advance("causes", 0, 1)
    return replace(check_print_recipe(recipe, expected), synthetic_rig=rig is None)
