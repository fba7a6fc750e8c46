"""``anisoscope read-code``: read the code on a part, from a picture or with the camera."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from anisoscope.base.errors import UsageError
from anisoscope.cli.json_output import print_json
from anisoscope.cli.options import Json
from anisoscope.cli.rig.options import Yes, ask_to_turn
from anisoscope.parameters.inspecting import CodeReading
from anisoscope.views.options import Given, Options, with_options

if TYPE_CHECKING:
    from anisoscope.inspection.batch.codes import Code, Counts


@with_options(code=Options(CodeReading, without={"read_code": "this is what the command does"}, whole=True))
def read_code(
    picture: Annotated[Path | None, Parameter(help="Picture to read (PNG, TIFF, JPEG).")] = None,
    /,
    *,
    rig: Annotated[Path | None, Parameter(name=["--rig", "-g"])] = None,
    recipe: Annotated[Path | None, Parameter(name=["--recipe", "-r"])] = None,
    exposure: Annotated[float | None, Parameter(help="With --rig: exposure in seconds instead.")] = None,
    code: Given[CodeReading],
    yes: Yes = False,
    json_: Json = False,
) -> int:
    """Read the Data Matrix, Code 128 or QR code on a part; GS1 codes give lot and serial number.

    Exit codes: 0 one code, 3 no readable code or several, 64 and above usage or hardware.

    Args:
        rig: Rig file; its camera takes the picture.
        recipe: With --rig: recipe, for its first pose and exposure.

    Examples:
        anisoscope read-code picture.png
        anisoscope read-code --rig rig.toml --recipe recipe.toml
    """
    from anisoscope.inspection.batch.codes import one_code, read_codes

    if rig is not None:
        ask_to_turn(rig, yes=yes)
    kind = code.made().code_kind
    counts, where = _picture(picture, rig, recipe, exposure)
    found = read_codes(counts, kind)
    if json_:
        print_json({"codes": found})
        return 0 if len(found) == 1 else 3
    for line in _lines(one_code(found, kind, where)):
        print(line)  # noqa: T201
    return 0


def _picture(
    picture: Path | None, rig: Path | None, recipe: Path | None, exposure: float | None
) -> "tuple[Counts, str]":
    from anisoscope.inspection.batch.codes import read_picture
    from anisoscope.inspection.batch.first_pose import photograph_first_pose

    if (picture is None) == (rig is None):
        raise UsageError("name a picture, or a rig file with --rig")
    if picture is not None:
        return read_picture(picture), str(picture)
    if recipe is None:
        raise UsageError(
            "--rig needs --recipe: it says at which pose and for how long the part is photographed"
        )
    assert rig is not None
    return photograph_first_pose(recipe, rig, exposure).counts, "the picture at the first pose"


def _lines(one: "Code") -> list[str]:
    scan = one.scan
    lines = [f"{one.title}: {scan.text}"]
    if scan.gs1:
        lines += [f"serial: {scan.serial or '–'}", f"lot: {scan.lot or '–'}"]
    return lines
