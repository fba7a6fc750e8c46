"""``anisoscope demo``: the whole job on a virtual rig, with good and defective parts."""

from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter

from anisoscope.base.language import message, translated
from anisoscope.base.progress import Advance
from anisoscope.cli.json_output import print_json
from anisoscope.cli.options import Json
from anisoscope.cli.progress import progress
from anisoscope.cli.tables import console, print_table

if TYPE_CHECKING:
    from anisoscope.inspection.reports import Reports
    from anisoscope.inspection.run import Inspected
    from anisoscope.operations.demo.folder import Scene


Kind = Literal["ridges", "wafers", "prints", "plates", "wafer", "print", "plate"]
SCENES: dict[Kind, str] = {
    "ridges": "ridges",
    "wafers": "wafers",
    "prints": "prints",
    "plates": "plates",
    "wafer": "wafers",
    "print": "prints",
    "plate": "plates",
}


def demo(
    *,
    kind: Kind = "ridges",
    out: Path = Path("demo-output"),
    seed: Annotated[int, Parameter(help="Seed of everything random on the virtual rig.")] = 1,
    json_: Json = False,
) -> int:
    """Inspect good and defective parts on a virtual rig; no hardware is needed.

    Takes a flat of a white tile, then photographs every part at 0°, 90° and 180° (prints and wafers at several tilts as
    well, plates at 0° and 90°) and judges it. Ends with exit code 0 when every verdict is the expected one.

    Args:
        kind: Kind of part: plastic with ridges, etched wafers (also: wafer), prints with a structural-colour ink (also:
            print), or plates that carry a code of ridges (also: plate).
        out: Folder for recipe, rig files, frames and reports.

    Examples:
        anisoscope demo
        anisoscope demo --kind prints --out print-demo --seed 7
    """
    from anisoscope.history.address import HISTORY_NAME
    from anisoscope.inspection.reports import Reports
    from anisoscope.operations.remembering import remember

    scene: Scene = import_module(f"anisoscope.operations.demo.{SCENES[kind]}").SCENE
    if not json_:
        console().print(
            f"{len(scene.parts)} parts on the virtual rig: flat field, photographs, verdicts, reports; about "
            f"{scene.megabytes} MB in {out}. The first run renders the scenes and may take two minutes, later ones "
            "take less than half a minute.",
            highlight=False,
        )
    with progress("demo", quiet=json_) as advance, Reports() as reports:
        folder = scene.lay_out(out, seed, advance)
        found = [
            (name, expected, _inspect(folder, name, advance, reports))
            for name, expected in scene.parts.items()
        ]
    for _, _, inspected in found:
        remember(inspected, folder / "inspections" / HISTORY_NAME)
    parts = [
        {
            "serial": inspected.record.serial,
            "expected": expected,
            "verdict": inspected.record.verdict,
            "finding": _finding(inspected),
            "report": str(inspected.report),
        }
        for _, expected, inspected in found
    ]
    right = all(part["verdict"] == part["expected"] for part in parts)
    if json_:
        print_json({"parts": parts})
    else:
        _print(parts, right)
    return 0 if right else 1


def _inspect(folder: Path, name: str, advance: Advance, reports: "Reports") -> "Inspected":
    from anisoscope.inspection.run import inspect_part

    return inspect_part(
        folder / "recipe.toml",
        folder / "bench" / name / "rig.toml",
        f"DEMO-{name}",
        folder / "inspections",
        on_progress=lambda doing, done, total: advance(f"{name}: {doing}", done, total),
        reports=reports,
    )


def _finding(inspected: "Inspected") -> str:
    """What was found, in a sentence; notes on the measurement stand in the report."""
    conclusion = inspected.record.conclusion
    return inspected.record.reasons[0] if conclusion is None else conclusion.finding


def _print(parts: list[dict[str, Any]], right: bool) -> None:
    print_table(
        message("Verdicts"),
        [message("part"), message("expected"), message("verdict"), message("finding")],
        [
            [part["serial"], *(translated(part[key]) for key in ("expected", "verdict", "finding"))]
            for part in parts
        ],
    )
    out = console()
    for part in parts:
        line = message("report of {name}: {path}", name=part["serial"], path=part["report"])
        out.print(line, highlight=False, soft_wrap=True)
    out.print(
        message("Every verdict is the expected one.")
        if right
        else f"[bold]{message('A verdict is not the expected one.')}[/bold]"
    )
