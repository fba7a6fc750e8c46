"""``anisoscope research pod``: how probably a defect is found, over its size."""

from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from anisoscope.base.errors import UsageError
from anisoscope.cli.help_page import everyday
from anisoscope.cli.options import Json, LightAngleOption, light_angle_of
from anisoscope.cli.progress import progress
from anisoscope.cli.study.optimise import HtmlOption, JobsOption, SchedulerOption
from anisoscope.cli.tables import hand_out

Scaled = Literal["linear", "log"]


@everyday("recipe", "defect", "csv", "parts", "golden_parts", "threshold", "rig", "json_", "html")
def pod_command(
    *,
    recipe: Annotated[Path | None, Parameter(name=["--recipe", "-r"])] = None,
    defect: str = "height_loss",
    csv: Path | None = None,
    parts: Annotated[int, Parameter(help="Simulated parts with a defect.")] = 400,
    largest: float | None = None,
    golden_parts: int = 3,
    rig: Annotated[Path | None, Parameter(name=["--rig", "-g"])] = None,
    light_angle: LightAngleOption = None,
    threshold: float | None = None,
    noise: float | None = None,
    saturation: float | None = None,
    size_scale: Annotated[Scaled, Parameter(help="The curve is over the size or its logarithm.")] = "log",
    signal_scale: Annotated[Scaled, Parameter(help="Of signals: the signal or its logarithm.")] = "log",
    link: Literal["logit", "probit"] = "logit",
    confidence: Annotated[float, Parameter(help="Confidence of intervals and of a90/95.")] = 0.95,
    seed: Annotated[int, Parameter(help="Seed of parts, rigs and errors.")] = 1,
    jobs: JobsOption = None,
    scheduler: SchedulerOption = None,
    json_: Json = False,
    html: HtmlOption = None,
) -> int:
    """Probability of detection over the size of a defect: a50, a90, a90/95 (MIL-HDBK-1823A).

    From simulated parts of a recipe, each on a rig of its own and found by the verdict FAIL, or from master parts.

    Args:
        defect: Defect of simulated parts: height_loss, edge_radius [µm], ridge_angle [°], alpha, albedo.
        csv: CSV file of master parts instead: size,hit (1 or 0) or size,signal.
        largest: Largest simulated size; else found by a short series of trials.
        golden_parts: Golden parts of every rig; with 0 the prediction is the reference.
        threshold: Of signals: a defect counts as found from this signal on.
        noise: Noise: signals at or below this are known to be so only.
        saturation: Saturation: signals at or above this are known to be so only.
        link: Of hits: logistic or normal curve.
        recipe: Recipe file of simulated parts (TOML).
        rig: Rig file, for its light angle.

    Examples:
        anisoscope research pod --recipe recipe.toml --defect height_loss --html pod.html
        anisoscope research pod --csv scratches.csv
    """
    from anisoscope.operations.detecting import detection_of_masters, detection_of_parts
    from anisoscope.study.sweep import Workers

    if (recipe is None) == (csv is None):
        raise UsageError("name the parts: --recipe FILE for simulated ones, or --csv FILE for master parts")
    if csv is not None:
        found = detection_of_masters(
            csv,
            threshold=threshold,
            noise=noise,
            saturation=saturation,
            size_scale=size_scale,
            signal_scale=signal_scale,
            link=link,
            confidence=confidence,
        )
    else:
        assert recipe is not None
        with light_angle_of(rig, light_angle) as angle, progress(defect, quiet=json_) as advance:
            found = detection_of_parts(
                recipe,
                defect,
                parts=parts,
                largest=largest,
                golden_parts=golden_parts,
                rig=rig,
                light_angle_deg=angle,
                size_scale=size_scale,
                link=link,
                confidence=confidence,
                seed=seed,
                workers=Workers(jobs, scheduler),
                on_progress=advance,
            )
    hand_out(found, found.page(), json_=json_, html=html)
    return 0
