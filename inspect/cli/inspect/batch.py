"""``anisoscope batch``: inspect the parts of a tray, one after the other."""

from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from anisoscope.base.language import message, translated
from anisoscope.cli.inspect.batch_operator import Terminal, table_of
from anisoscope.cli.json_output import print_json
from anisoscope.cli.options import Flag, HistoryOption, Json
from anisoscope.cli.tables import console, print_lines

CodeKind = Annotated[
    Literal["any", "datamatrix", "code128", "qr"],
    Parameter(name="--code-kind", help="Kind of code to look for, where several are in the picture."),
]


def batch(
    tray: Path,
    /,
    *,
    recipe: Annotated[Path, Parameter(name=["--recipe", "-r"], help="Recipe file (TOML).")],
    rig: Annotated[Path, Parameter(name=["--rig", "-g"], help="Rig file (TOML).")],
    out: Path = Path("inspections"),
    resume: Flag = False,
    yes: Annotated[bool, Parameter(name=["--yes", "-y"], negative="")] = False,
    read_code: Flag = False,
    code_kind: CodeKind = "any",
    code_exposure: float | None = None,
    operator: Annotated[str | None, Parameter(help="Operator, for the records.")] = None,
    station: Annotated[str | None, Parameter(help="Station where the rig stands.")] = None,
    history: HistoryOption = None,
    json_: Json = False,
) -> int:
    """Inspect the parts of a tray list; a fault at one part does not stop the others.

    Where the list gives every part's place (x_mm, y_mm), the axes x and y bring one after the other below the camera.
    Otherwise before each part: Enter inspects it, s skips it, q stops; a scanned code is compared with the list. Writes
    batch.json, batch.html, and one inspection folder per part.

    Exit codes: that of the first hardware fault (64 and above); else of the worst verdict: 3 INVALID, 1 FAIL,
    2 INCONCLUSIVE; 75 skipped slots; 0 all PASS.

    Args:
        tray: Tray list: CSV with slot,serial and, if wanted, lot,cavity,recipe,rig,x_mm,y_mm; or AQDEF (.dfq).
        out: Folder that receives the folder of the batch, batch-NAME after the list.
        code_exposure: Exposure in seconds for the picture of the code; by default the recipe's.
        resume: Continue an interrupted batch; finished parts are kept.
        read_code: Read the code on every part with the camera before inspecting it.
        yes: Begin each part without asking: the tray fills itself, or the rig is virtual.

    Examples:
        anisoscope batch tray.csv --recipe recipe.toml --rig rig.toml
        anisoscope batch tray.csv --recipe recipe.toml --rig rig.toml --resume
    """
    from anisoscope.inspection.batch.first_pose import Look
    from anisoscope.inspection.batch.operator import Unattended
    from anisoscope.operations.series import batch as inspected

    who = Terminal(quiet=json_, answers=not yes)
    found = inspected(
        tray,
        recipe,
        rig,
        out=out,
        resume=resume,
        who=Unattended() if yes and json_ else who,
        look=Look(code_kind, code_exposure) if read_code else None,
        operator=operator,
        station=station,
        history=history,
        note=lambda text: who.say(f"note: {text}"),
    )
    if json_:
        print_json(found)
        return found.file.exit_code
    console().print(table_of(found.file))
    print_lines(
        ", ".join(f"{number} {translated(word)}" for word, number in found.file.counts.items() if number),
        message("page: {path}", path=found.page),
    )
    return found.file.exit_code
