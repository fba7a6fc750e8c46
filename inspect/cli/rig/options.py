"""Options that the commands of ``anisoscope rig`` share, and how they print."""

import sys
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from anisoscope.base.errors import UsageError
from anisoscope.base.language import message, per_cent, translated
from anisoscope.cli.help_page import MORE
from anisoscope.parameters.taking import Shot, Taking
from anisoscope.views.options import Options

if TYPE_CHECKING:
    from anisoscope.operations.rigging import Confirm
    from anisoscope.rig.rigfile import MotorPart, RigAxes

AxisName = Literal["stage", "tilt", "x", "y", "z"]
DryRun = Annotated[bool, Parameter(negative="", help="Only print the plan; nothing moves.")]
OF_SHOT = Options(Shot, whole=True)
Channel = Annotated[
    str | None,
    Parameter(name="--channel", help="Light channel of the rig file; its light.channel by default."),
]
RigPath = Annotated[Path, Parameter(name=["--rig", "-g"], help="Rig file (TOML).")]
Yes = Annotated[
    bool,
    Parameter(
        name=["--yes", "-y"], negative="", help="Move without asking, also a rig that was never commissioned."
    ),
]


OF_TAKING = Options(
    Taking,
    names={"frames": "--count", "light_channel": "--channel", "temperature_c": "--temperature"},
    groups={"operator": MORE, "temperature_c": MORE},
    whole=True,
)


@Parameter(name="*")
@dataclass(frozen=True)
class Scanned:
    """Specimen of a scan, and its recipe."""

    coupon: Annotated[bool, Parameter(negative="", help="Scan a flat piece of the plastic.")] = False
    part: Annotated[bool, Parameter(negative="", help="Scan the ridged part of the recipe.")] = False
    recipe: Annotated[
        Path | None,
        Parameter(name=["--recipe", "-r"], help="Recipe with region, exposure and surface of the part."),
    ] = None

    def specimen(self) -> Literal["coupon", "part"]:
        """What is scanned.

        Raises:
            UsageError: neither is stated, or both.
        """
        if self.coupon == self.part:
            raise UsageError("say what is scanned: --coupon, a flat piece of the plastic, or --part")
        return "coupon" if self.coupon else "part"


SCANNED = Scanned()


@dataclass(frozen=True)
class Which:
    """Selected devices: those of a rig file, or a stage alone."""

    rig: Annotated[
        Path | None, Parameter(name=["--rig", "-g"], help="Rig file (TOML) that names the devices.")
    ] = None
    driver: Annotated[str | None, Parameter(help="Instead of a rig file: driver of a stage.")] = None
    port: Annotated[str | None, Parameter(help="With --driver: its port.")] = None
    option: Annotated[
        tuple[str, ...],
        Parameter(negative="", help="With --driver: its option as KEY=VALUE; may be repeated."),
    ] = ()

    def read(self) -> "tuple[RigAxes | None, dict[str, MotorPart]]":
        """The rig file, if one is named; and its axes by table, the stage first.

        Raises:
            UsageError: neither a rig file nor a driver is named, or both.
            RigFileError: the rig file.
        """
        from anisoscope.rig.rigfile import StagePart, read_axes

        if (self.rig is None) == (self.driver is None):
            raise UsageError("name the devices: --rig FILE, or --driver NAME --port PORT for a stage alone")
        if self.rig is None:
            assert self.driver is not None
            options = dict(_pair(text) for text in self.option)
            return None, {"stage": StagePart(driver=self.driver, port=self.port, options=options)}
        if self.port is not None or self.option:
            raise UsageError("--port and --option go with --driver; with --rig they stand in the rig file")
        file = read_axes(self.rig)
        return file, file.axes

    def axis(self, name: AxisName) -> "tuple[RigAxes | None, dict[str, MotorPart]]":
        """The rig file, if one is named; and one of its axes, with those with which it may collide, by table.

        Errors as for `read`.

        Raises:
            UsageError: the rig has no such axis.
        """
        file, axes = self.read()
        if name not in axes:
            raise UsageError(
                f"--axis {name}: there is no such axis; name a rig file with a table [{name}] for it"
            )
        return file, axes if file is None else file.moved_with(name)


NOTHING_NAMED = Which()


def _pair(text: str) -> "tuple[str, str | int | float | bool]":
    key, equals, value = text.partition("=")
    if not (key and equals):
        raise UsageError(f"--option takes KEY=VALUE, such as address=2, not {text!r}")
    if value in {"true", "false"}:
        return key, value == "true"
    if key == "address":  # a text also where it looks like a number, as Elliptec's 0…F
        return key, value
    for kind in (int, float):
        try:
            return key, kind(value)
        except ValueError:
            continue
    return key, value


def write_line(text: str) -> None:
    """Write a line for the operator to stderr."""
    print(per_cent(translated(text)), file=sys.stderr, flush=True)  # noqa: T201


def confirm(what: str, *, yes: bool) -> None:
    """Announce the motion, and ask for confirmation.

    Raises:
        UsageError: nobody said yes, or there is no terminal to ask in.
    """
    if yes:
        write_line(what)
        return
    if sys.stdin is None or not sys.stdin.isatty():
        raise UsageError(f"{what}; there is no terminal to ask in whether it may: say so with --yes")
    print(f"{translated(what)}. {message('Go on? [y/N]')} ", end="", file=sys.stderr, flush=True)  # noqa: T201
    if sys.stdin.readline().strip().lower() not in {"y", "yes", message("yes"), message("yes")[0]}:
        raise UsageError("nothing was moved: the motion was not confirmed")


def asked_to_seat_fixture() -> bool:
    """Ask for the fixture in place of the tile; False where the answer is no, or there is no terminal to ask in."""
    if sys.stdin is None or not sys.stdin.isatty():
        return False
    text = message(
        "Take the tile away and seat the fixture, empty or with a part. The axes home and move: keep their paths free. "
        "Enter teaches its markers, n leaves that:"
    )
    print(f"{text} ", end="", file=sys.stderr, flush=True)  # noqa: T201
    line = sys.stdin.readline()
    return bool(line) and line.strip().lower() not in {"n", "no", message("no"), message("no")[0]}


def asking(rig: Path | None, *, yes: bool) -> "Confirm":
    """Announcement of motions as `confirm`, which asks where the rig was never taught, or none is named."""
    from anisoscope.operations.rigging import is_taught
    from anisoscope.rig.rigfile import read_axes

    return partial(confirm, yes=yes or (rig is not None and is_taught(rig, read_axes(rig))))


def ask_to_turn(*rigs: Path, yes: bool) -> None:
    """Ask before the first motion of rigs that were never taught; errors as for `confirm`, and of the rig file."""
    from anisoscope.operations.rigging import question_of

    for what in filter(None, map(question_of, rigs)):
        confirm(what, yes=yes)
