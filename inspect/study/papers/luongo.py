"""Figures of Luongo et al. 2017, on the anisotropic reflectance of ridged plastics."""

from functools import cache

import numpy as np

from anisoscope.experiment.experiment import RIDGE_ANGLES_DEG, Experiment, Setup, run_experiment
from anisoscope.parameters.geometry import Convention, Pose
from anisoscope.parameters.material import Material
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.profiles.defects import burrs
from anisoscope.profiles.ideal import ridges
from anisoscope.report.experiment_page import AXIS_NAMES, bar_chart, level_text
from anisoscope.report.figures import BLUE, GREEN
from anisoscope.sim.light import printed
from anisoscope.sim.light.geometry import directions, pose_grid
from anisoscope.sim.light.picture import Plate, checkerboard, plate_picture, view_of
from anisoscope.study.best_angle import best_angle
from anisoscope.study.papers.rows import Paper, Row, picture

NOTHING = "A drawing: there is nothing to compare."


def fig_2() -> Row:
    """Checkerboard of two ridge directions before and after a quarter turn."""
    fields = 6
    plate = Plate(checkerboard(fields), 5000.0, RidgeDesign(100.0, 10.0), Material(), (0.0, -90.0))
    convention, shape = Convention(), (180, 180)
    side_um = fields * 5000.0
    pictures, ratios = [], []
    for stage in (0.0, 90.0):
        pose = Pose(stage, 0.0)
        view = view_of(pose, convention, shape, side_um / shape[0])
        seen = plate_picture(plate, pose, convention, view)
        ratios.append(seen.fields[0] / seen.fields[1])
        pictures.append((seen.radiance, f"stage at {stage:g}°"))
    top = max(float(np.nanmax(seen)) for seen, _ in pictures)
    before, after = ratios
    return Row(
        "Fig. 2", "a checkerboard of two ridge directions before and after a turn by 90°",
        "the contrast is clearly visible and the fields change places (rendering)",
        f"radiance of the one kind of fields over the other {before:.2f} before, {after:.2f} after", "order",
        (before - 1.0) * (after - 1.0) < 0.0 and max(before, 1.0 / before) > 1.5,
        "anisoscope render checkerboard --out plate.png",
        "", [picture((np.nan_to_num(seen) / top) ** (1 / 2.2), words) for seen, words in pictures],
    )  # fmt: skip


def drawing(label: str, shows: str) -> Row:
    """A figure without values."""
    return Row(label, shows, "no values", "–", "none", None, "", NOTHING)


def fig_1() -> Row:
    """Ridges."""
    return drawing("Fig. 1, 3, 4, 6", "drawings: ridges, macro surface, angle θ_p, frame of the pitch normal")


def fig_5() -> Row:
    """A rough surface and a measured one with burrs."""
    surface = ridges(RidgeDesign(100.0, 10.0), (400, 400), 1.0)
    z = burrs(surface, 0.05, pitch_um=100.0, rng=np.random.default_rng(2017)).map.height_um
    return Row(
        "Fig. 5 and 9", "a rough surface; height map and micrograph of a part with burrs", "pictures only",
        "ideal ridges of 10° with burrs over 5 % of the area", "none", None,
        "anisoscope profile spoil ridges.x3p burrs --out spoiled.x3p",
        "The authors' height map is not published; the picture shows our model of burrs.",
        [picture((z - z.min()) / max(float(np.ptp(z)), 1e-9), "height, bright is high")],
    )  # fmt: skip


def fig_7() -> Row:
    """Set-up of the experiment."""
    to_light, to_camera = directions(pose_grid((0.0, 90.0, 180.0), (-20.0, 0.0, 20.0)), Convention())
    half = to_light + to_camera
    half /= np.linalg.norm(half, axis=1, keepdims=True)
    angle = np.degrees(np.arccos(np.sum(to_light * half, axis=1)))
    return Row(
        "Fig. 7", "the light 10° from the camera, both tilt together", "θ_l = 10°",
        f"angle between light and half vector {angle.min():.3f}° to {angle.max():.3f}° in every pose", "number",
        bool(np.allclose(angle, 5.0)), "anisoscope research experiment",
        "So refractive index and ρ_d only scale the printed model: this experiment does not determine them.",
    )  # fmt: skip


@cache
def experiments() -> tuple[Experiment, Experiment]:
    """Predicted by the printed and by the corrected model."""
    return run_experiment(Setup("printed")), run_experiment(Setup("corrected"))


def fig_8() -> Row:
    """Mean contrasts."""
    as_stated, corrected = experiments()
    charts = []
    for name, axis in AXIS_NAMES.items():
        series = [
            ("as published", BLUE, [m.predicted for m in as_stated.means[name]]),
            ("corrected", GREEN, [m.predicted for m in corrected.means[name]]),
        ]
        labels = [level_text(m.level_deg) for m in as_stated.means[name]]
        charts.append((bar_chart(labels, series, axis, "1/sr"), f"mean contrast by {axis}"))
    found, better = as_stated.findings, corrected.findings
    pair = [m.predicted for m in as_stated.means["pair"]]
    return Row(
        "Fig. 8, predicted", "mean contrasts over tilt, ridge angle and pair of stage angles",
        "largest at 0° tilt, falling on both sides; 0°/90° above 90°/180°; 5° is best",
        f"largest at 0°: {_yes(found.max_at_zero_tilt)}, falling on both sides: {_yes(found.falls_on_both_sides)}; "
        f"{pair[0]:.3f} above {pair[1]:.3f}/sr; best {found.best_ridge_angle_deg or 0:g}°. Corrected model: all three "
        f"{_yes(better.as_published)}, falling on both sides: {_yes(better.falls_on_both_sides)}",
        "order", found.as_published and found.falls_on_both_sides and better.as_published,
        "anisoscope research experiment --html fig8.html",
        "The paper states neither roughness nor the plane of tilt; at α 0.06 × 0.10 and tilt perpendicular to the "
        "light's plane all three findings come out (`anisoscope research findings` maps where).", charts,
    )  # fmt: skip


def _yes(value: bool) -> str:
    return "yes" if value else "no"


def fig_8_measured() -> Row:
    """Measured contrasts and the conjecture on surface quality."""
    turn = best_angle(("roughness",), step_deg=1.0).imperfections[0].turns_at
    return Row(
        "Fig. 8, measured, and section 5", "the measured contrasts have their maximum at 10°, not at 5°",
        "measured best 10°; conjecture: an effect of the surface",
        "10° overtakes 5° at an isotropic roughness of " + ("–" if turn is None else f"{turn:.3f}"),
        "order", turn is not None and 0.05 < turn < 0.15,
        "anisoscope research best-angle --imperfections roughness",
        "The measured bars carry no numbers, so that no k can be fitted; "
        "`research experiment --measured` takes a table of your own.",
    )  # fmt: skip


def lit_share(ridge_angle_deg: float, from_deg: float, wall: str) -> float:
    """Share of a facet that is seen from a direction leaning away from it, by rays against the ridge behind.

    Points of one facet from valley (0) to crest; the crest of the next ridge stands one period on, above the valley.
    """
    theta, turn = np.radians(ridge_angle_deg), np.radians(from_deg)
    # facet of length 1 falls toward +x; the wall rises from its foot to the crest of the next ridge
    foot = np.array([np.cos(theta), -np.sin(theta)])
    if wall == "perpendicular":
        wall_length = np.tan(theta)
        crest = foot + wall_length * np.array([np.sin(theta), np.cos(theta)])
    else:
        crest = foot + np.array([0.0, np.sin(theta)])
    along = (np.arange(20000) + 0.5) / 20000
    x, z = along * np.cos(theta), -along * np.sin(theta)
    rise = np.arctan2(crest[1] - z, crest[0] - x)
    return float(np.mean(rise <= 0.5 * np.pi - turn))


def fig_10() -> Row:
    """Shadowing by the ridges: Eq. 8 to 10."""
    worst = {"perpendicular": 0.0, "vertical": 0.0}
    for angle in RIDGE_ANGLES_DEG:
        theta = np.radians(angle)
        normal = np.array([np.sin(theta), 0.0, np.cos(theta)])
        for tilt in (10.0, 30.0, 50.0, 65.0):
            # the wall stands on the side of +x: from there it hides what is past the facet's normal
            turn = np.radians(tilt)
            direction = np.array([np.sin(turn), 0.0, np.cos(turn)])
            stated = float(printed._g1(direction, normal, theta))  # noqa: SLF001 - the term of Eq. 10 alone
            for wall, value in worst.items():
                if tilt > angle:
                    worst[wall] = max(value, abs(lit_share(angle, tilt, wall) - stated))
    return Row(
        "Fig. 10, Eq. 8 to 10", "share of a facet that the ridges hide: 1 − tan θ_r·tan θ_p",
        "derived for a wall of length r = p·tan θ_r",
        f"largest difference from rays {worst['perpendicular']:.4f} with a wall perpendicular to the facet, "
        f"{worst['vertical']:.3f} with a vertical one",
        "number", worst["perpendicular"] < 1e-3, "anisoscope predict --ridge-angle 10 --model printed",
        "Exact for a perpendicular wall only. G = G1·G1 counts a strip twice that is both shadowed and masked "
        "(page on models).",
    )  # fmt: skip


PAPER = Paper(
    "luongo",
    "Modeling the Anisotropic Reflectance of a Surface with Microstructure Engineered to Obtain Visible Contrast after "
    "Rotation",
    "Luongo et al. 2017, ICCV Workshops, 159–165, doi 10.1109/ICCVW.2017.27; the paper has no tables",
    (fig_1, fig_2, fig_5, fig_7, fig_8, fig_8_measured, fig_10),
)
