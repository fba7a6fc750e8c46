"""``anisoscope rig commission`` and ``anisoscope rig check``: commissioning of a rig, and its daily self test."""

import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from anisoscope.base.errors import UsageError
from anisoscope.base.language import decimal, message, translated
from anisoscope.cli.help_page import MORE, everyday
from anisoscope.cli.options import Flag, Json
from anisoscope.cli.progress import progress
from anisoscope.cli.rig.options import OF_TAKING, RigPath, Yes, ask_to_turn
from anisoscope.cli.tables import console, print_lines, print_table
from anisoscope.parameters.taking import KnownPart, Taking, Turning
from anisoscope.views.options import Given, Options, with_options

if TYPE_CHECKING:
    from anisoscope.commissioning.record import Commissioning
    from anisoscope.commissioning.selftest_record import SelfTest


@Parameter(name="*")
@dataclass(frozen=True)
class Files:
    """Files of a commissioning.

    Attributes:
        out: Record to write; else RIG.commissioning.json next to the rig file.
        write: Write the findings into the rig file; with a flat the markers are taught then, the part may stay.
    """

    out: Path | None = None
    html: Annotated[Path | None, Parameter(help="Page to write.")] = None
    write: Flag = False
    keep_frames: Annotated[Path | None, Parameter(help="Empty folder for the frames.", group=MORE)] = None


RECORD = Files()


@with_options(
    known=Options(
        KnownPart,
        names={"recipe": ("--recipe", "-r"), "spot_mm": "--spot-mm"},
        groups={"u_ridge_angle_deg": MORE, "u_alpha": MORE},
        whole=True,
    ),
    turning=Options(
        Turning,
        names={"frames": "--count"},
        groups=dict.fromkeys(("gain", "channel", "step_deg", "frames", "settle_s", "bounces"), MORE),
        whole=True,
    ),
)
@everyday("rig", "known", "files", "json_")
def commission(
    *,
    rig: RigPath,
    known: Given[KnownPart],
    turning: Given[Turning],
    all_reflections: Annotated[bool, Parameter(negative="", show=False)] = False,
    files: Files = RECORD,
    yes: Yes = False,
    json_: Json = False,
) -> int:
    """Find rotation sense, zero, centre, pixel size, tilt and light angle of a rig, from a known ridged part.

    Place the part on the stage first. The command turns it by a full turn, also at tilts if an axis tilts the arm; the
    first time it asks, or takes --yes.
    Sense and zero in the rig file need not be right. Exit code 0: done; undetermined quantities are named.

    Examples:
        anisoscope rig commission --rig rig.toml --recipe recipe.toml --html commissioning.html
        anisoscope rig commission --rig rig.toml --ridge-angle 10 --pitch 100 --spot-mm 1.5 --exposure 0.006
    """  # fmt: skip
    from anisoscope.commissioning.angles import Assumed
    from anisoscope.commissioning.commissioning import commission as find
    from anisoscope.commissioning.commissioning import (
        known_part,
        lacks_reference,
        series_of,
        tilts_of,
        write_to_rig_file,
    )
    from anisoscope.commissioning.record import default_record_path, write_commissioning
    from anisoscope.kinds.registry import read_recipe
    from anisoscope.rig.rigfile import read_rig

    how = turning.made()
    if how.bounces != "all" and all_reflections:
        raise UsageError(f"--all-reflections is --bounces all: leave it out with --bounces {how.bounces}")
    on_stage = known.made()
    recipe = None if on_stage.recipe is None else read_recipe(on_stage.recipe)
    series = series_of(how, recipe)
    part = known_part(on_stage, recipe)
    ask_to_turn(rig, yes=yes)
    with progress("commissioning", quiet=json_) as advance:
        done = find(
            rig,
            part,
            series,
            Assumed(bounces=None if how.bounces == "all" else how.bounces),
            frames=files.keep_frames,
            on_progress=advance,
        )
    target = files.out or default_record_path(rig)
    write_commissioning(done.record, target)
    if files.html is not None:
        from anisoscope.report.commission_page import write_commission_page

        write_commission_page(done, files.html)
    lines = [message("record: {path}", path=target)]
    if files.write:
        written = write_to_rig_file(rig, done.record)
        lines.append(
            message("the rig file states all this already")
            if written is None
            else message("{path} was updated; the old file is {file}", path=rig, file=written.backup.name)
        )
        if written is not None and not written.comments_preserved:
            lines.append(message("the comments of the rig file are lost; the old file has them"))
        if lacks_reference(read_rig(rig, channel=series.light_channel)):
            taking = Taking(
                series.exposure_s, series.gain, max(how.frames, 4), light_channel=series.light_channel
            )
            lines += _taught(rig, taking, () if recipe is None else tilts_of(rig, recipe), quiet=json_)
    _show(done.record, lines, json_)
    return 0


def _show(record: "Commissioning", lines: list[str], as_json: bool) -> None:
    from anisoscope.report.commission_page import finding_row

    if as_json:
        sys.stdout.write(record.model_dump_json(by_alias=True, indent=2) + "\n")
        return
    rows = [finding_row(finding) for finding in record.findings]
    cells = [
        [translated(words), unit, decimal(old), decimal(translated(value)), decimal(u)]
        for words, _, unit, old, value, u, _ in rows
    ]
    columns = [message("quantity"), message("unit"), message("rig file"), message("found"), "u"]
    print_table(message("Commissioning of {name}", name=record.rig), columns, cells)
    remarks = [f"{row[1]}: {translated(row[6])}" for row in rows if row[6]]
    for line in (*remarks, *map(translated, record.notes), *lines):
        console().print(line, markup=False, highlight=False)


@with_options(
    taking=replace(
        OF_TAKING,
        default={"frames": 20},
        help={
            "exposure_s": "Exposure in seconds for the part or tile on the stage.",
            "frames": "Frames over which the lamp is observed.",
        },
        without=dict.fromkeys(("valid_days", "operator", "temperature_c"), "a self test is no calibration"),
    )
)
def check(
    *,
    rig: RigPath,
    taking: Given[Taking],
    commissioned: Path | None = None,
    tile: Flag = False,
    teach: Flag = False,
    out: Annotated[Path | None, Parameter(help="Folder that receives the result as JSON.")] = None,
    yes: Yes = False,
    json_: Json = False,
) -> int:
    """Test a rig at the start of a shift: stage, camera, light, markers, focus. Exit code 0: fit; 3: not fit.

    The stage homes and turns: keep its path free. A rig that was never commissioned asks first, or takes --yes.

    Args:
        commissioned: Record of the commissioning; else the one next to the rig file.
        tile: The white tile lies on the stage: compare its shading.
        teach: Teach the markers of the fixture where the rig is fit: they watch it then.

    Examples:
        anisoscope rig check --rig rig.toml --exposure 0.006 --out selftests
    """  # fmt: skip
    from anisoscope.commissioning.selftest import self_test
    from anisoscope.commissioning.selftest_record import Settings, write_self_test

    how = taking.made()
    if teach and tile:
        raise UsageError("--teach photographs the markers, which the white tile hides: leave --tile out")
    ask_to_turn(rig, yes=yes)
    settings = Settings(
        exposure_s=how.exposure_s,
        gain=how.gain,
        frames=how.frames,
        tile=tile,
        light_channel=how.light_channel,
    )
    with progress("self test", quiet=json_) as advance:
        result = self_test(rig, settings, commissioned, on_progress=advance)
    written_to = None if out is None else write_self_test(result, out)
    if json_:
        sys.stdout.write(result.model_dump_json(by_alias=True, indent=2) + "\n")
    else:
        _show_checks(result, written_to)
    if teach and result.fit:
        lines = _taught(rig, replace(how, frames=4), (), quiet=json_)
        if not json_:
            print_lines(*lines)
    return result.exit_code


def _taught(rig: Path, taking: "Taking", tilts: tuple[float, ...], *, quiet: bool) -> list[str]:
    """Teach the markers of the fixture; lines on what came of it."""
    from anisoscope.commissioning.commissioning import teach_fixture

    with progress("fixture", quiet=quiet) as advance:
        done = teach_fixture(rig, taking, tilts=tilts, on_progress=advance)
    lines = [message("the markers are taught: {path}", path=done.path), *done.record.remarks]
    if not done.record.in_limits:
        lines[0] = message("the markers are out of limits, and not taught: {path}", path=done.path)
    return lines


def _show_checks(result: "SelfTest", written_to: Path | None) -> None:

    rows = [
        [
            translated(one.words),
            decimal(_short(one.value)),
            decimal(_short(one.limit)),
            one.unit or "1",
            translated(one.outcome),
        ]
        for one in result.checks
    ]
    columns = [message(one) for one in ("check", "value", "limit", "unit", "outcome")]
    print_table(message("Self test of {name}", name=result.rig), columns, rows)
    for one in result.checks:
        if one.remark:
            console().print(
                f"{translated(one.words)}: {translated(one.remark)}", markup=False, highlight=False
            )
    fit = result.fit
    words = message("the rig is fit") if fit else message("the rig is NOT fit: what it measures is INVALID")
    console().print(
        words if written_to is None else f"{words}; {message('record: {path}', path=written_to)}",
        markup=False,
        highlight=False,
    )


def _short(value: float | str | None) -> str:
    """Three digits: these are limits and how far off them a rig is."""
    return (
        f"{value:.3g}".replace("-", "−") if isinstance(value, float) else "–" if value is None else str(value)
    )
