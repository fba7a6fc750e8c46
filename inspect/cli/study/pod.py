"""``anisoscope research pod``: how probably a defect is found, over its size."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from anisoscope.base.errors import UsageError
from anisoscope.cli.help_page import MORE, everyday
from anisoscope.cli.options import OF_WORKERS, PRINTED, USUAL_LAMP, Lamp, Output
from anisoscope.cli.progress import progress
from anisoscope.parameters.detection import MasterSignals, PartTrials, SizeCurve
from anisoscope.parameters.workers import Workers
from anisoscope.views.options import Given, Options, with_options

OF_SIGNALS = Options(
    MasterSignals, groups=dict.fromkeys(("noise", "saturation", "signal_scale"), MORE), whole=True
)


@with_options(
    trials=Options(PartTrials, groups={"largest": MORE, "seed": MORE}, whole=True),
    signals=OF_SIGNALS,
    curve=Options(SizeCurve, whole=True),
    workers=OF_WORKERS,
)
@everyday("recipe", "csv", "trials", "signals", "lamp", "output")
def pod_command(
    *,
    recipe: Annotated[Path | None, Parameter(name=["--recipe", "-r"])] = None,
    csv: Path | None = None,
    trials: Given[PartTrials],
    lamp: Lamp = USUAL_LAMP,
    signals: Given[MasterSignals],
    curve: Given[SizeCurve],
    workers: Given[Workers],
    output: Output = PRINTED,
) -> int:
    """Probability of detection over the size of a defect: a50, a90, a90/95 (MIL-HDBK-1823A).

    From simulated parts of a recipe, each on a rig of its own and found by the verdict FAIL, or from master parts.

    Args:
        csv: CSV file of master parts instead: size,hit (1 or 0) or size,signal.
        recipe: Recipe file of simulated parts (TOML).

    Examples:
        anisoscope research pod --recipe recipe.toml --defect height_loss --html pod.html
        anisoscope research pod --csv scratches.csv
    """
    from anisoscope.operations.detecting import detection_of_masters, detection_of_parts

    if (recipe is None) == (csv is None):
        raise UsageError("name the parts: --recipe FILE for simulated ones, or --csv FILE for master parts")
    if csv is not None:
        found = detection_of_masters(csv, signals=signals.made(), curve=curve.made())
    else:
        assert recipe is not None
        asked = trials.made()
        with lamp.angle() as angle, progress(asked.defect, quiet=output.json_) as advance:
            found = detection_of_parts(
                recipe,
                trials=asked,
                curve=curve.made(),
                rig=lamp.rig,
                light_angle_deg=angle,
                workers=workers.made(),
                on_progress=advance,
            )
    output.hand_out(found)
    return 0
