"""``anisoscope research pod``: how probably a defect is found, over its size."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from anisoscope.base.errors import UsageError
from anisoscope.cli.help_page import MORE, everyday
from anisoscope.cli.options import Json, LightAngleOption, light_angle_of
from anisoscope.cli.progress import progress
from anisoscope.cli.study.optimise import HtmlOption, JobsOption, SchedulerOption
from anisoscope.cli.tables import hand_out
from anisoscope.parameters.detection import MasterSignals, PartTrials, SizeCurve
from anisoscope.views.options import Given, Options, with_options

OF_SIGNALS = Options(
    MasterSignals, groups=dict.fromkeys(("noise", "saturation", "signal_scale"), MORE), whole=True
)


@with_options(
    trials=Options(PartTrials, groups={"largest": MORE, "seed": MORE}, whole=True),
    signals=OF_SIGNALS,
    curve=Options(SizeCurve, whole=True),
)
@everyday("recipe", "defect", "csv", "trials", "signals", "rig", "json_", "html")
def pod_command(
    *,
    recipe: Annotated[Path | None, Parameter(name=["--recipe", "-r"])] = None,
    defect: str = "height_loss",
    csv: Path | None = None,
    trials: Given[PartTrials],
    rig: Annotated[Path | None, Parameter(name=["--rig", "-g"])] = None,
    light_angle: LightAngleOption = None,
    signals: Given[MasterSignals],
    curve: Given[SizeCurve],
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
        found = detection_of_masters(csv, signals=signals.made(), curve=curve.made())
    else:
        assert recipe is not None
        with light_angle_of(rig, light_angle) as angle, progress(defect, quiet=json_) as advance:
            found = detection_of_parts(
                recipe,
                defect,
                trials=trials.made(),
                curve=curve.made(),
                rig=rig,
                light_angle_deg=angle,
                workers=Workers(jobs, scheduler),
                on_progress=advance,
            )
    hand_out(found, found.page(), json_=json_, html=html)
    return 0
