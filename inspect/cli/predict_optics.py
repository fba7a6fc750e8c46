"""Options of ``anisoscope predict`` that give lamp and lens a size."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

from cyclopts import Group, Parameter

from anisoscope.cli.console import parse_numbers
from anisoscope.errors import UsageError

if TYPE_CHECKING:
    from anisoscope.sim.light.optics import Optics

OPTICS_GROUP = Group(
    "Lamp and lens", help="Sizes as the sample sees them; without them both are points far away.", sort_key=9
)


@dataclass(frozen=True)
class OpticsOptions:
    """The options; meaning as in `anisoscope.sim.light.optics.Optics`."""

    lamp_half_angle: Annotated[
        float, Parameter("--lamp-half-angle", help="Half of the angle that the lamp subtends, degrees.")
    ] = 0.0
    aperture: Annotated[float, Parameter("--aperture", help="Numerical aperture of the lens.")] = 0.0
    lamp_distance: Annotated[
        float | None, Parameter("--lamp-distance", help="From the middle of the field to the lamp, mm.")
    ] = None
    field: Annotated[
        str | None,
        Parameter(
            "--field",
            help="Size of the field on the sample in mm: SIZE or WIDTH,HEIGHT; with --lamp-distance.",
        ),
    ] = None
    disc_rings: Annotated[
        int,
        Parameter("--disc-rings", help="Rings of directions for lamp and lens; more where lobes are narrow."),
    ] = 1


OPTICS_DEFAULTS = OpticsOptions()


def optics_of(options: OpticsOptions) -> "Optics":
    """The optics of the options.

    Raises:
        UsageError: a field without a lamp distance or the other way round, or a numerical aperture beyond 0 to 0.86.
    """
    import numpy as np

    from anisoscope.sim.light.optics import Optics

    if (options.field is None) != (options.lamp_distance is None):
        raise UsageError("--lamp-distance and --field belong together: the light angle varies over the field")
    if not 0.0 <= options.aperture < 0.86:
        raise UsageError(f"--aperture must be a numerical aperture of 0 to 0.86, not {options.aperture:g}")
    size = (0.0,) if options.field is None else parse_numbers(options.field, "--field")
    if len(size) not in (1, 2) or (options.field is not None and min(size) <= 0.0):
        raise UsageError(f"--field takes one or two positive numbers of mm, not {options.field!r}")
    half_angle = float(np.degrees(np.arcsin(options.aperture)))
    field = size[0], size[-1]
    return Optics(options.lamp_half_angle, half_angle, options.lamp_distance, field, options.disc_rings)
