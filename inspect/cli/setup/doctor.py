"""``anisoscope doctor``: what is installed, compiled, reachable and calibrated."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from anisoscope.base.errors import RigError
from anisoscope.cli.json_output import print_json
from anisoscope.cli.options import Json
from anisoscope.cli.tables import print_lines


def doctor(
    *,
    rig: Annotated[
        Path | None, Parameter(name=["--rig", "-g"], help="Rig file to look at; by default the project's.")
    ] = None,
    recipe: Annotated[
        Path | None, Parameter(name=["--recipe", "-r"], help="Recipe to look at; by default the project's.")
    ] = None,
    json_: Json = False,
) -> int:
    """List what is installed, compiled, reachable and calibrated on this machine; nothing moves, no device is opened.

    Exit codes: 0 complete, 69 something is missing.

    Examples:
        anisoscope doctor
        anisoscope doctor --rig rig.toml --json
    """
    from anisoscope.operations.installation import findings

    found = list(findings(rig, recipe))
    if json_:
        print_json({"findings": found, "missing": sum(one.state == "missing" for one in found)})
    else:
        for one in found:
            line = f"{one.state:<8} {one.what:<22} {one.text}"
            print_lines(line)
    return RigError.exit_code if any(one.state == "missing" for one in found) else 0
