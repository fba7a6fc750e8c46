"""``anisoscope recipe yield``: how many parts of a lot pass a recipe, without photographing any."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from anisoscope.base.errors import UsageError
from anisoscope.cli.help_page import everyday
from anisoscope.cli.json_output import print_json
from anisoscope.cli.options import Json
from anisoscope.cli.progress import progress
from anisoscope.cli.study.optimise import JobsOption, SchedulerOption, named_numbers
from anisoscope.cli.tables import console, print_table

if TYPE_CHECKING:
    from anisoscope.study.lot import Lot
    from anisoscope.study.part_yield import PartYield
    from anisoscope.study.rates import Rate

SCATTER_NAMES = "ridge_angle [°], alpha [share], albedo [share], height_loss [share], edge_radius [µm]"


@everyday("parts", "scatter", "shift", "golden_parts", "rig", "light_angle", "jobs", "json_")
def yield_command(
    file: Annotated[Path, Parameter(help="Recipe file (TOML).")],
    /,
    *,
    parts: Annotated[int, Parameter(help="Parts of the lot.")] = 1000,
    scatter: Annotated[
        str | None,
        Parameter(
            help=f"Standard deviations between the parts, NAME=SD,…: {SCATTER_NAMES}, seating [°]; left out, those of "
            "good parts in the recipe's table scatter."
        ),
    ] = None,
    shift: Annotated[
        str | None,
        Parameter(help=f"How far the lot's mean is off the nominal part, NAME=VALUE,…: {SCATTER_NAMES}."),
    ] = None,
    golden_parts: Annotated[
        int,
        Parameter(help="Golden parts of every rig, good parts all; with 0 the prediction is the reference."),
    ] = 0,
    rigs: Annotated[
        int, Parameter(help="Rigs, each with a plastic of its own, among which the parts are divided.")
    ] = 25,
    u_pose: Annotated[
        float,
        Parameter(
            help="Relative standard uncertainty of a pose by camera and lamp, with the recipe's frames."
        ),
    ] = 0.003,
    rig: Annotated[
        Path | None, Parameter(name=["--rig", "-g"], help="Rig file, for its light angle.")
    ] = None,
    light_angle: Annotated[float, Parameter(help="Without --rig: angle of the light, degrees.")] = 10.0,
    seed: Annotated[int, Parameter(help="Seed of parts, rigs and errors.")] = 1,
    jobs: JobsOption = None,
    scheduler: SchedulerOption = None,
    json_: Json = False,
) -> int:
    """Predict how many parts of a lot pass a recipe, and the risks of producer and consumer; nothing moves.

    Every part is predicted in a state of its own, measured without pictures, and judged by the recipe's rule.

    Examples:
        anisoscope recipe yield recipe.toml --scatter ridge_angle=0.3,alpha=0.1
        anisoscope recipe yield recipe.toml --golden-parts 3 --shift ridge_angle=0.5
    """
    from anisoscope.kinds.registry import kind_of
    from anisoscope.rig.rigfile import read_rig
    from anisoscope.study.lot import Lot, Shift, Spread
    from anisoscope.study.part_yield import part_yield
    from anisoscope.study.sweep import Workers

    kind = kind_of(file)
    recipe = kind.read_recipe(file)
    if not getattr(kind.reference_set, "predictive", False):
        raise UsageError(
            f"{file}: a lot is drawn where a recipe states how good parts differ ([scatter]), not for {kind.one}"
        )
    angle = light_angle if rig is None else read_rig(rig).light.angle_deg
    spread = Spread.of(recipe)
    if scatter is not None:
        spread = Spread(**named_numbers(scatter, "--scatter", "NAME=SD,…", Spread))
    off = Shift() if shift is None else Shift(**named_numbers(shift, "--shift", "NAME=VALUE,…", Shift))
    lot = Lot(recipe, angle, spread, off, parts, rigs, golden_parts, u_pose)
    with progress(file.name, quiet=json_) as advance:
        found = part_yield(lot, Workers(jobs, scheduler), seed, advance)
    if json_:
        print_json(
            {
                "parts": parts,
                "rigs": rigs,
                "golden_parts": golden_parts,
                "scatter": spread,
                "shift": off,
                "yield": found,
            }
        )
        return 0
    _print_yield(file.name, lot, found)
    return 0


def _share(found: "Rate") -> list[str]:
    return [f"{found.count} of {found.of}", *(f"{one:.1%}" for one in (found.value, found.low, found.high))]


def _print_yield(name: str, lot: "Lot", found: "PartYield") -> None:
    """Verdicts, risks, contrasts, and what is not in them."""
    rows = [[verdict, *_share(one)] for verdict, one in found.verdicts.items()]
    rows.append(["significant deviation", *_share(found.significant)])
    risks = (
        ("within all tolerances", found.conforming),
        ("of these FAIL (producer's risk)", found.producer_risk),
        ("of the others PASS (consumer's risk)", found.consumer_risk),
    )
    rows += [[words, *_share(one)] for words, one in risks if one is not None and one.of]
    print_table(f"{name}: {lot.parts} parts", ["", "parts", "share", "95 % from", "to"], rows)
    rows = [
        [
            f"{one.from_deg:g}°/{one.to_deg:g}° @ {one.tilt_deg:g}°",
            *(f"{value:+.4f}" for value in (one.predicted, one.mean)),
            *(f"{value:.4f}" for value in (one.sd, one.u)),
            "–" if one.tolerance is None else f"±{one.tolerance:g}",
            "–" if one.outside is None else f"{one.outside.value:.1%}",
        ]
        for one in found.contrasts
    ]
    print_table(
        lot.recipe.decision.contrast,
        ["pair", "predicted", "mean of the lot", "sd", "stated u", "tolerance", "parts outside"],
        rows,
    )
    reference = f"{lot.golden} golden parts a rig" if lot.golden else "the prediction"
    lines = [
        f"{lot.rigs} rigs; reference: {reference}; one measurement of every part, without a contrast map."
    ]
    if found.conforming is None:
        lines.append("The recipe has no decision.tolerance: risks of producer and consumer are not defined.")
    for line in lines:
        console().print(line, markup=False, highlight=False, soft_wrap=True)
