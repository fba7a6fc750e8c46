"""``anisoscope profile make`` and ``profile spoil``: ideal surfaces, and defects of known extent."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated

from cyclopts import Group, Parameter

from anisoscope.base.errors import UsageError
from anisoscope.base.quantity import unit_of
from anisoscope.cli.options import OF_RIDGES, Json, Overwrite, check_map, check_new, number, parse_pixel
from anisoscope.cli.profile.profile import AS_STATED, Scales, reader
from anisoscope.cli.profile.surfaces_output import deliver, list_defects
from anisoscope.parameters.patterns import Grid, Injection, Lines, Pattern, Rough, Stairs
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.views.options import Given, Options, parse_numbers, with_options


def _size(text: str, option: str) -> tuple[float, float]:
    sides = parse_numbers(text, option, "300,600", "um")
    if len(sides) not in (1, 2) or min(sides) <= 0:
        raise UsageError(f"{option} takes one or two positive numbers of µm, SIZE or Y,X, not {text!r}")
    return sides[0], sides[-1]


ON_LINES = Group("Ridges and grooves")
OF_LINES = replace(OF_RIDGES, group=ON_LINES, help={"pitch_um": "Pitch of ridges or grooves in µm."})
OF_GRID = Options(
    Grid,
    readers={"size_um": _size, "pixel_um": parse_pixel},
    default={"size_um": (1000.0,), "pixel_um": (1.0,)},
    whole=True,
)


@with_options(
    grid=OF_GRID,
    ridges=OF_LINES,
    lines=Options(Lines, ON_LINES, whole=True),
    stairs=Options(Stairs, Group("Staircases"), flags=("random",), whole=True),
    rough=Options(Rough, Group("Roughness"), whole=True),
)
def make(
    pattern: Pattern,
    /,
    *,
    out: Path,
    grid: Given[Grid],
    ridges: Given[RidgeDesign],
    lines: Given[Lines],
    stairs: Given[Stairs],
    rough: Given[Rough],
    seed: Annotated[int, Parameter(help="Seed of everything random.")] = 0,
    overwrite: Overwrite = False,
    json_: Json = False,
) -> int:
    """Make an ideal surface, smooth or with Gaussian roughness.

    Args:
        pattern: What to make.
        out: File to write: x3p or npz (they keep design and seed), or another format.

    Examples:
        anisoscope profile make ridges --pitch 100 --ridge-angle 10 --out part.x3p
        anisoscope profile make ridges --size 300,600 --pitch 50 --alpha-along 0.04 --alpha-across 0.05 --out rough.x3p
    """
    from anisoscope.profiles.ideal import USUAL, make_surface

    check_map(out, "--out")
    check_new((out,), overwrite=overwrite)
    surface = make_surface(
        pattern,
        ridges.over(USUAL),
        grid=grid.made(),
        lines=lines.made(),
        stairs=stairs.made(),
        rough=rough.made(),
        seed=seed,
    )
    return deliver(surface, out, as_json=json_)


@with_options(extent=Options(Injection, whole=True))
def spoil(
    file: Path | None = None,
    defect: str | None = None,
    /,
    *,
    out: Path | None = None,
    extent: Given[Injection],
    list_: Annotated[bool, Parameter(name="--list", negative="", help="List the defects.")] = False,
    overwrite: Overwrite = False,
    json_: Json = False,
    scales: Scales = AS_STATED,
    **parameters: str,
) -> int:
    """Add a defect to a height map: by its severity, or by its dimensions.

    Args:
        file: Height map to spoil.
        defect: Name of the defect; see --list.
        parameters: Dimensions of the defect by name, such as --radius-um 5; see --list.
        out: File to write: x3p or npz (they keep what was done), ...

    Examples:
        anisoscope profile spoil part.x3p wear --severity 0.5 --out worn.x3p
        anisoscope profile spoil --list
    """
    import numpy as np

    from anisoscope.profiles import defect_injection

    if list_:
        return list_defects(as_json=json_)
    if file is None or defect is None or out is None:
        raise UsageError("spoil needs a height map, a defect and --out FILE; --list shows the defects")
    check_map(out, "--out")
    check_new((out,), overwrite=overwrite)
    asked = extent.made()
    surface = reader(scales)(file)
    given = {
        (key := name.replace("-", "_")): number(text, f"--{name}", unit_of(key))
        for name, text in parameters.items()
    }
    spoiled = defect_injection.inject_defect(
        *(surface, defect, np.random.default_rng(asked.seed)),
        severity=asked.severity,
        values=given,
        seed=asked.seed,
    )
    changed = spoiled.height_um - surface.height_um
    changed = changed[np.isfinite(changed)]
    deviation = {
        "rms_um": float(np.sqrt(np.mean(changed**2))),
        "highest_um": float(changed.max()),
        "lowest_um": float(changed.min()),
        "share_changed": float(np.mean(changed != 0.0)),
    }
    return deliver(spoiled, out, as_json=json_, deviation=deviation)
