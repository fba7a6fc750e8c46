"""``anisoscope init``: a folder for a job, with recipe, rig file and project file."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import tomli_w
from cyclopts import Parameter

from anisoscope.base.errors import RecordError, UsageError
from anisoscope.base.printable import check_printable
from anisoscope.cli.tables import print_lines
from anisoscope.operations import project_place
from anisoscope.operations.project_place import PROJECT_NAME
from anisoscope.parameters.new_recipe import NewRecipe
from anisoscope.views.options import Given, Options, with_options

RIG = """\
# Devices of the rig. Ports of this machine: anisoscope rig ports. All keys: docs/recipe-and-rig.md.
schema = 1
name = "{station}"

[stage]
driver = "elliptec"              # or zaber, grbl, apt, smc100, manual
port = "/dev/ttyUSB0"            # COM3, socket://host:port, sim://elliptec
zero_deg = 0.0                   # stage reading at which the part stands at 0°: anisoscope rig commission

[camera]
driver = "uvc"                   # or basler, folder
pixel_um = 4.0                   # size of a pixel on the part: anisoscope calibrate rotation

[light]
driver = "manual"                # asks the operator to switch; "serial" with a port switches by itself
angle_deg = 10.0                 # between light and camera

[geometry]
tilt_deg = 0.0                   # the camera arm, fixed

[calibration]
flat = "flat.tif"                # anisoscope calibrate flat --exposure 0.006 --out flat.tif
"""


@with_options(
    part=Options(
        NewRecipe,
        help={"ridge_angle_deg": "Ridge angle of the design in degrees; 10 where nothing else is named."},
        without={
            "u_ridge_angle_deg": "recipe new states it",
            "largest_mm": "there is no fixture yet",
        },
        whole=True,
    )
)
def init(
    folder: Annotated[Path, Parameter(help="Folder of the job; made if it does not exist.")] = Path(),
    /,
    *,
    part: Given[NewRecipe],
    operator: str | None = None,
    station: Annotated[str | None, Parameter(help="Station where the rig stands.")] = None,
) -> int:
    """Write a job folder: recipe, rig file and anisoscope.toml, which names them for all commands.

    The station gets a key that signs its records, unless it has one.

    Commands in this folder and below it then need no --recipe, --rig, --out, --operator and --station.
    Existing files are not replaced.

    Args:
        operator: Operator who inspects here; goes into the records.

    Examples:
        anisoscope init job --ridge-angle 10 --pitch 100
        anisoscope init job --kind prints --ink synthetic-red --station "rig 2"
    """
    from anisoscope.kinds.parts import beginning
    from anisoscope.kinds.registry import kind_of_new

    check_printable({"--operator": operator, "--station": station})
    recipe, rig, project = (folder / name for name in ("recipe.toml", "rig.toml", PROJECT_NAME))
    for path in (recipe, rig, project):
        if path.exists():
            raise UsageError(f"{path} exists already: name another folder")
    requested = part.made()
    if requested == replace(NewRecipe(), product=requested.product, pitch_um=requested.pitch_um):
        requested = replace(requested, ridge_angle_deg=10.0)
    chosen = kind_of_new(requested)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        tables = beginning(chosen).new_recipe(recipe, requested)
        key, made = _key(station or folder.resolve().name)
        rig.write_text(RIG.format(station=(station or "rig 1").replace('"', "'")), encoding="utf-8")
        project.write_text(_project(operator, station, key), encoding="utf-8")
    except OSError as error:
        raise RecordError(f"{folder}: cannot be written: {error.strerror}") from error
    print_lines(
        f"{recipe}: adapt {tables}, then: anisoscope recipe check {recipe}",
        f"{rig}: name your devices; anisoscope rig ports lists the ports",
        f"{key}: {'new; ' if made else ''}signs the records of this station; its public part: anisoscope key show",
        f"{project}: recipe and rig of all commands in this folder; anisoscope doctor says what is missing",
    )
    return 0


def station_key(station: str) -> Path:
    """Where `init` puts the key of a station: among the settings of the user."""
    name = "".join(one if one.isalnum() or one in "._-" else "-" for one in station).strip("-") or "station"
    return project_place.user_path().parent / "keys" / f"{name}.pem"


def _key(station: str) -> tuple[Path, bool]:
    """The key of the station, and whether it is new."""
    from anisoscope.base.signature import KeyFile, make_key

    path = station_key(station)
    if path.exists():
        KeyFile(path)
        return path, False
    make_key(path)
    return path, True


def _project(operator: str | None, station: str | None, key: Path) -> str:
    values = {"recipe": "recipe.toml", "rig": "rig.toml", "out": "inspections", "signing_key": str(key)}
    who = {"operator": operator, "station": station}
    stated = tomli_w.dumps(values | {name: text for name, text in who.items() if text is not None})
    missing = "".join(f'# {name} = ""\n' for name, text in who.items() if text is None)
    return (
        "# Options that commands in this folder take where they are left out; paths count from here.\n"
        f'{stated}{missing}# history = "inspections/history.sqlite"\n'
    )
