"""Check of a print's recipe before anything moves: uncertainties of the judged quantities, separability of causes."""

from dataclasses import dataclass, replace

import numpy as np

from anisoscope.base.arrays import FloatArray
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
from anisoscope.kinds.prints.model import Scene
from anisoscope.kinds.prints.pose_colours import without_lean
from anisoscope.kinds.prints.quantities import Quantity
from anisoscope.kinds.prints.recipe import UNSTATED, PrintRecipe
from anisoscope.kinds.prints.sources import Source, of_poses, total
from anisoscope.kinds.recipe_check import RecipeCheck
from anisoscope.parameters.geometry import Convention
from anisoscope.rig.rigfile import RigFile
from anisoscope.sim.light.geometry import directions
from anisoscope.sim.light.ink.angles import half_vector
from anisoscope.sim.materials.spectra import find_illuminant, find_sensitivities

TARGET_SHARE = 0.9
"""Good prints that should come out of a limit decided."""
LEAST_SHINING = 0.5
"""Share of the light of the brightest pose that flakes send at least."""
DIM = 0.1
"""Brightness of a pose, by the brightest, below which a longer exposure is worth while."""
_CURL_U_DEG = 0.05
_MEDIAN = 0.674
"""Median of the size of a normal deviate, by which `colour_map` measures the scatter of cells."""
_LENGTHS = ("chromaticity", "tilt")
_DRAWS, _SEED = 2000, 7
_LIGHT_UM = 0.55
Cones = tuple[float | None, float | None]
"""Half angles of the cones of light of lamp and lens in degrees."""


@dataclass(frozen=True)
class PlannedQuantity:
    """Planned knowledge of a quantity: its standard uncertainty, and T/U of the limit.

    ``passing`` is the share of good prints, as they vary by what the recipe says is uncertain, that will pass it, and
    ``wanted`` the limit that `TARGET_SHARE` of them pass.
    """

    name: str
    title: str
    unit: str
    limit: float
    u: float
    passing: float
    wanted: float

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


def check_print_recipe(
    recipe: PrintRecipe, expected: PrintExpectation, cones_deg: Cones = (None, None)
) -> PrintRecipeCheck:
    """Check the recipe of a print; nothing moves.

    Args:
        recipe: the recipe.
        expected: what it predicts.
        cones_deg: half angles of the cones of light of lamp and lens; None: not stated.

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
        complaints=_complaints(recipe, expected, planned, quantities, cones_deg),
        excludes=planned_limits((decision.exclusions,)),
        remedy=MORE_TILTS,
    )


def planned_quantities(
    recipe: PrintRecipe, expected: PrintExpectation, decision: PrintDecision
) -> tuple[PlannedQuantity, ...]:
    """Planned quantities of an inspection, by the decision on a print exactly as predicted."""
    found = []
    for one in decision.quantities:
        if one.name == "delta_e":
            reached = _colours_reached(recipe, expected, decision)
            passing, wanted = float(np.mean(reached <= one.limit)), float(np.quantile(reached, TARGET_SHARE))
            title = "ΔE2000"
        else:
            passing, wanted, title = *_passing(one), one.title
        found.append(PlannedQuantity(one.name, title, one.unit, one.limit, one.u, passing, wanted))
    return tuple(found)


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


def _passing(one: Quantity) -> tuple[float, float]:
    """Share of good prints below a limit less its guard band, and the limit of `TARGET_SHARE` of them.

    Of lengths in the least favourable case.
    """
    from scipy.special import erf, erfinv  # noqa: PLC0415 - start-up time

    room, length = one.limit - one.guard, one.name in _LENGTHS
    most = np.sqrt(-2.0 * np.log1p(-TARGET_SHARE)) if length else np.sqrt(2.0) * erfinv(TARGET_SHARE)
    wanted = one.guard + float(most) * one.u
    if one.u == 0.0 or room <= 0.0:
        return float(room > 0.0), wanted
    if length:
        return float(-np.expm1(-0.5 * (room / one.u) ** 2)), wanted  # Rayleigh
    return float(erf(room / one.u / np.sqrt(2.0))), wanted


def _colours_reached(recipe: PrintRecipe, expected: PrintExpectation, decision: PrintDecision) -> FloatArray:
    """(N,) largest ΔE2000 with its guard band of good prints, drawn from all that is uncertain."""
    count, metric = 3 * len(expected.poses), expected.eye.metric(expected.channels)
    assert decision.fit is not None  # what is predicted has a lobe
    spread = root(without_lean(decision.fit, total(decision.sources, count)))
    normal = np.random.default_rng(_SEED).standard_normal((_DRAWS, count))
    off = (normal @ spread).reshape(_DRAWS, -1, 3)
    delta_e = np.sqrt(np.einsum("npi,pij,npj->np", off, metric, off, optimize=True))
    guard = recipe.decision.coverage * np.array([one.u_delta_e for one in decision.colours])
    return np.asarray((delta_e + guard).max(axis=1))


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
    cones_deg: Cones,
) -> tuple[str, ...]:
    found = [UNSTATED] if recipe.print.lacks_uncertainty(expected.scene.ink) else []
    found += _of_cells(recipe, expected, cones_deg)
    darkest = min(poses, key=lambda one: one.brightness)
    if darkest.brightness < DIM and not recipe.acquisition.brackets:
        found.append(
            f"at tilt {darkest.tilt_deg:g}° the print is {darkest.brightness:.1%} as bright as in its brightest pose: "
            "set acquisition.brackets, such as [8.0]"
        )
    shining = float(expected.scene.of_flakes().max())
    if shining < LEAST_SHINING:
        part = recipe.print
        found.append(
            f"the sheet is brighter than the ink: even where they shine most the flakes send {shining:.0%} of the "
            f"light: check print.coverage ({part.coverage:g}) and print.substrate ({part.substrate:g})"
        )
    few = [one for one in quantities if one.passing < TARGET_SHARE]
    if few:
        shares = ", ".join(
            f"{one.passing:.0%} the limit of {one.title} ({_rounded_up(one.wanted):g} would do)"
            for one in few
        )
        found.append(
            f"if ink file and rig are off as much as they state, too few good prints will pass ({TARGET_SHARE:.0%} "
            f"wanted), and most others end undecided: only {shares}; widen the limit{'s' * (len(few) > 1)}, measure "
            "the ink, or teach golden prints"
        )
    return tuple(found)


def _rounded_up(value: float) -> float:
    """To two digits."""
    digit = 10.0 ** (np.floor(np.log10(value)) - 1.0)
    return float(np.ceil(value / digit - 1e-9) * digit)


def sparkles(scene: Scene, flake_um: float, cell_mm: float, lamp_deg: float, lens_deg: float) -> FloatArray:
    """(P,) number of flakes of a cell that shine into the lens, as far as they make its light vary.

    The light of a cell is the sum over its flakes of the overlap f of lamp and lens, seen by the flake as a mirror:
    flakes lie by chance, so that its relative variance is ∫f² D cosθ dω / (N (∫f D cosθ dω)²), one over this number.
    A flake's own diffraction widens the lamp.

    Args:
        scene: the print.
        flake_um: diameter of its flakes, which lie side by side.
        cell_mm: side of a cell.
        lamp_deg: half angle of the cone of light.
        lens_deg: half angle of the cone that the lens collects.
    """
    flakes = scene.coverage * (1000.0 * cell_mm) ** 2 / (0.25 * np.pi * flake_um**2)
    a = float(np.hypot(np.radians(lamp_deg), 2.0 * _LIGHT_UM / (np.pi * flake_um)))
    b = max(float(np.radians(lens_deg)), 1e-6)
    apart = np.linspace(0.0, a + b, 400)
    overlap = _overlap(apart, a, b)
    solid = 2.0 * np.pi * float(np.trapezoid(overlap**2 * apart, apart))
    shining = (np.pi**2 * a**2 * b**2) ** 2 / solid  # sr of the mirrored light
    to_light, to_camera = directions(scene.poses, Convention(scene.light_angle_deg))
    half = half_vector(to_light, to_camera)
    into = np.sum(half * to_light, axis=1)
    return np.asarray(flakes * scene.density(half) * half[:, 2] * shining / (4.0 * into))


def _overlap(apart: FloatArray, a: float, b: float) -> FloatArray:
    """Area that two discs of radii a and b share, their centres (N,) apart."""
    small, large = min(a, b), max(a, b)
    near, far = apart <= large - small, apart >= a + b
    d = np.where(near | far, large, apart)
    angles = [
        np.arccos(np.clip((d**2 + r**2 - s**2) / (2.0 * d * r), -1.0, 1.0)) for r, s in ((a, b), (b, a))
    ]
    lens = sum(r**2 * (angle - 0.5 * np.sin(2.0 * angle)) for r, angle in zip((a, b), angles, strict=True))
    return np.where(near, np.pi * small**2, np.where(far, 0.0, lens))


def _of_cells(recipe: PrintRecipe, expected: PrintExpectation, cones_deg: Cones) -> list[str]:
    """Whether cells hold too few dots of a halftone, at random, which scatter most, or too few flakes that shine."""
    part, area, scene = recipe.print, recipe.area, expected.scene
    if area is None:
        return []
    found, held, variance = [], [], np.zeros(len(expected.poses))
    if part.dot_um is not None and part.coverage < 1.0:
        dots = (1000.0 * area.cell_mm / part.dot_um) ** 2
        variance += (1.0 - part.coverage) / (part.coverage * dots)
        held.append(f"{f'{dots:.0f} dots' if dots > 1.5 else 'one dot or less'} of {part.dot_um:g} µm")
    if part.flake_um is not None:
        lamp_deg, lens_deg = cones_deg
        if lamp_deg is None or lens_deg is None:
            found.append(
                "print.flake_um: which flakes shine depends on lamp and lens: state light.half_angle_deg and "
                "camera.half_angle_deg in the rig file (--rig)"
            )
        else:
            count = sparkles(scene, part.flake_um, area.cell_mm, lamp_deg, lens_deg)
            variance += scene.of_flakes() ** 2 / count
            held.append(f"{count.min():.2g} to {count.max():.2g} flakes that shine")
    one = np.ones(3)
    by_level = np.sqrt(np.einsum("i,pij,j->p", one, expected.eye.metric(expected.channels), one))
    scatter = float((by_level * np.sqrt(variance)).max())
    limit = area.scatters * _MEDIAN * scatter
    if limit <= area.cell_delta_e:
        return found
    holds = f"a cell of {area.cell_mm:g} mm holds {' and '.join(held)}"
    wide = area.cell_mm * limit / area.cell_delta_e
    if wide > min(recipe.region.size_mm):
        return [
            *found,
            f"{holds}, and the region too few for cells of any size: leave [area] out, or print smaller ones",
        ]
    text = (
        f"{holds}: cells of a good print scatter by up to ΔE {scatter:.2g}, so that a spot has to be off by up to "
        f"{limit:.2g}, not {area.cell_delta_e:g} (area.cell_delta_e): take area.cell_mm = {wide:.2g}"
    )
    return [*found, text]


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
    cones: Cones = (None, None) if rig is None else (rig.light.half_angle_deg, rig.camera.half_angle_deg)
    return replace(check_print_recipe(recipe, expected, cones), synthetic_rig=rig is None)
