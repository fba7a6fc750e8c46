"""``anisoscope batch``: inspect the parts of a tray, one after the other."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from anisoscope.base.language import message, translated
from anisoscope.cli.inspect.batch_operator import Terminal, table_of
from anisoscope.cli.json_output import print_json
from anisoscope.cli.options import INTO, Into, Json, RecipeFile
from anisoscope.cli.rig.options import RigPath
from anisoscope.cli.tables import console, print_lines
from anisoscope.parameters.inspecting import TrayRun
from anisoscope.views.options import Given, Options, with_options


@with_options(run=Options(TrayRun, flags=True, whole=True))
def batch(
    tray: Path,
    /,
    *,
    recipe: RecipeFile,
    rig: RigPath,
    into: Into = INTO,
    run: Given[TrayRun],
    yes: Annotated[bool, Parameter(name=["--yes", "-y"], negative="")] = False,
    json_: Json = False,
) -> int:
    """Inspect the parts of a tray list; a fault at one part does not stop the others.

    Where the list gives every part's place (x_mm, y_mm), the axes x and y bring one after the other below the camera.
    Otherwise before each part: Enter inspects it, s skips it, q stops; a scanned code is compared with the list. Writes
    batch.json, batch.html, and one inspection folder per part, into the folder batch-NAME after the list.

    Exit codes: that of the first hardware fault (64 and above); else of the worst verdict: 3 INVALID, 1 FAIL,
    2 INCONCLUSIVE; 75 skipped slots; 0 all PASS.

    Args:
        tray: Tray list: CSV with slot,serial and, if wanted, lot,cavity,recipe,rig,x_mm,y_mm; or AQDEF (.dfq).
        yes: Begin each part without asking: the tray fills itself, or the rig is virtual.

    Examples:
        anisoscope batch tray.csv --recipe recipe.toml --rig rig.toml
        anisoscope batch tray.csv --recipe recipe.toml --rig rig.toml --resume
    """
    from anisoscope.inspection.batch.operator import Unattended
    from anisoscope.operations.series import batch as inspected

    who = Terminal(quiet=json_, answers=not yes)
    found = inspected(
        tray,
        recipe,
        rig,
        run=run.made(),
        out=into.out,
        history=into.history,
        who=Unattended() if yes and json_ else who,
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
