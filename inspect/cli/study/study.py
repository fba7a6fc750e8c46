"""``anisoscope research``: published results repeated, and effects of imperfect surfaces by simulation."""

from dataclasses import replace
from typing import Annotated

from cyclopts import App, Parameter

from anisoscope.base.errors import UsageError
from anisoscope.cli.help_page import everyday
from anisoscope.cli.options import DRAWN, NO_BASE, OF_PLASTIC, OF_RIDGES, OF_WORKERS, Base, DrawnOutput
from anisoscope.cli.progress import progress
from anisoscope.parameters.material import Material
from anisoscope.parameters.random_surfaces import RandomSurfaces
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.parameters.workers import Workers
from anisoscope.views.options import Given, Options, with_options

OF_SURFACES = Options(RandomSurfaces, whole=True)

app = App(
    name="research", help="Repeat published results, and simulate how defects change contrasts and verdicts."
)
app.command("anisoscope.cli.experiment.experiment:experiment", name="experiment")
app.command("anisoscope.cli.experiment.experiment:findings", name="findings")
app.command("anisoscope.cli.study.pod:pod_command", name="pod")
app.command("anisoscope.cli.study.papers:papers", name="papers")


@app.command(name="convergence")
@with_options(
    ridges=replace(
        OF_RIDGES,
        without={
            "pitch_um": "the study's own, 100 µm",
            **dict.fromkeys(("height_loss", "edge_radius_um"), "defects that the study adds"),
            "wall": "the study's surfaces have walls perpendicular to the facet",
        },
    ),
    plastic=OF_PLASTIC,
    surfaces=OF_SURFACES,
    workers=OF_WORKERS,
)
@everyday("defects", "ridges", "plastic", "base", "severities", "surfaces", "output")
def convergence_command(
    *,
    base: Base = NO_BASE,
    defects: str = "all",
    ridges: Given[RidgeDesign],
    plastic: Given[Material],
    severities: int = 6,
    surfaces: Given[RandomSurfaces],
    workers: Given[Workers],
    output: DrawnOutput = DRAWN,
) -> int:
    """Show how contrasts approach the ideal prediction as defects vanish, and at which order.

    Args:
        defects: Comma-separated: roughness, burrs, angle-error, height-loss, edge-rounding; or all.
        severities: Sizes of each defect, each half the one before; 3 to 10.

    Examples:
        anisoscope research convergence --plot convergence.png
    """
    from anisoscope.study.convergence import PITCH_UM, convergence

    output.check()
    known = base.stated()
    material = plastic.over(known.material)
    angle_deg = 10.0 if known.design is None else known.design.ridge_angle_deg
    design = ridges.over(RidgeDesign(PITCH_UM, angle_deg))
    if not 3 <= severities <= 10:
        raise UsageError(f"--severities takes 3 to 10, not {severities}")
    drawn = surfaces.made()
    chosen = () if defects == "all" else tuple(dict.fromkeys(defects.split(",")))
    with progress("convergence", quiet=output.json_) as advance:
        found = convergence(
            chosen,
            design,
            material,
            drawn.quality,
            workers.made(),
            severities=severities,
            seed=drawn.seed,
            on_progress=advance,
        )
    output.hand_out(found)
    return 0


@app.command(name="best-angle")
@with_options(
    plastic=OF_PLASTIC, surfaces=replace(OF_SURFACES, default={"quality": "quick"}), workers=OF_WORKERS
)
@everyday("base", "imperfections", "plastic", "step", "surfaces", "output")
def best_angle_command(
    *,
    base: Base = NO_BASE,
    imperfections: str = "all",
    plastic: Given[Material],
    step: Annotated[float, Parameter(help="Step of the ridge angles in degrees, 0.1 to 1.")] = 0.5,
    surfaces: Given[RandomSurfaces],
    workers: Given[Workers],
    output: DrawnOutput = DRAWN,
) -> int:
    """Test whether an imperfection moves the best ridge angle of the published experiment from 5° to 10°.

    Args:
        imperfections: Comma-separated: roughness, roughness-along, roughness-across, height-loss, edge-radius, burrs,
            seating, noise, bounces, albedo; or all.

    Examples:
        anisoscope research best-angle --step 1
    """
    from anisoscope.study.best_angle import best_angle

    output.check()
    material = plastic.over(base.stated().material)
    if not 0.1 <= step <= 1.0:
        raise UsageError(f"--step takes 0.1 to 1 degree, not {step:g}")
    drawn = surfaces.made()
    names = () if imperfections == "all" else tuple(dict.fromkeys(imperfections.split(",")))
    with progress("best angle", quiet=output.json_) as advance:
        found = best_angle(
            names,
            material,
            drawn.quality,
            workers.made(),
            step_deg=step,
            seed=drawn.seed,
            on_progress=advance,
        )
    output.hand_out(found)
    return 0
