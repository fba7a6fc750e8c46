"""What a Zaber stage says about itself: who it is, its scale, limits and speed, and its warning flags.

Whoever asks holds the lock of the transport.
"""

import math

from anisoscope.base.errors import LimitExceeded, ProtocolError
from anisoscope.rig.stages.zaber_line import ZaberLine
from anisoscope.rig.stages.zaber_wire import deg_s2_of_acceleration, deg_s_of_speed, error_of_flag

FULL_TURN_DEG = 360.0
RAMP_WITHOUT_LIMIT_S = 0.01


def identify(line: ZaberLine) -> str:
    """Maker, device id and serial number, for records."""
    device = line.ask("get deviceid", axis=0)
    if not device.accepted:  # the newer name
        device = line.command("get device.id", axis=0)
    serial = line.ask("get system.serial", axis=0)
    return f"Zaber {device.data} {serial.data}" if serial.accepted else f"Zaber {device.data}"


def read_counts_per_deg(line: ZaberLine, counts_per_turn: float | None) -> float:
    """Microsteps for one degree; `counts_per_turn`, if given, goes before what the device says.

    Raises:
        ProtocolError: neither is known.
    """
    counts = counts_per_turn or line.number("limit.cycle.dist") or 0.0
    if counts <= 0.0:
        raise ProtocolError(
            f"{line.name} does not say how many microsteps a turn has (limit.cycle.dist); "
            "if it is a rotary stage, set the option counts_per_turn"
        )
    return counts / FULL_TURN_DEG


def read_limits_deg(
    line: ZaberLine, counts_per_deg: float, min_deg: float | None, max_deg: float | None
) -> tuple[float, float]:
    """Lowest and highest angle in degrees: as asked for, else one turn within the limits of the device.

    Raises:
        LimitExceeded: what is asked for is beyond the limits of the device.
    """
    lowest, highest = line.number("limit.min"), line.number("limit.max")
    low = -math.inf if lowest is None else lowest / counts_per_deg
    high = math.inf if highest is None else highest / counts_per_deg
    asked_low = max(0.0, low) if min_deg is None else min_deg
    asked_high = min(FULL_TURN_DEG, high) if max_deg is None else max_deg
    slack = 1.0 / counts_per_deg
    if asked_low < low - slack or asked_high > high + slack or asked_low > asked_high:
        raise LimitExceeded(
            f"{line.name}: the limits {asked_low:.6g}°…{asked_high:.6g}° are not within those of the device, "
            f"{low:.6g}°…{high:.6g}°; change min_deg and max_deg, or the device's limit.min and limit.max"
        )
    return asked_low, asked_high


def read_pace(line: ZaberLine, counts_per_deg: float) -> tuple[float, float]:
    """Speed in degrees per second and acceleration in degrees per second squared, as the device is set.

    Raises:
        ProtocolError: it has no speed.
    """
    speed = line.number("maxspeed") or 0.0
    if speed <= 0.0:
        raise ProtocolError(f"{line.name} claims a maxspeed of {speed:g}; is it a motion stage?")
    velocity = deg_s_of_speed(speed, counts_per_deg)
    # An acceleration of 0 means: as fast as it can.
    data = line.number("accel") or 0.0
    return velocity, deg_s2_of_acceleration(
        data, counts_per_deg
    ) if data > 0.0 else velocity / RAMP_WITHOUT_LIMIT_S


def read_flags(line: ZaberLine) -> tuple[str, ...]:
    """The warning flags that stand, the gravest first."""
    return tuple(line.command("warnings").data.split()[1:])  # before them: how many


def acknowledge_flags(line: ZaberLine) -> tuple[str, ...]:
    """Clear a fault of the past, which is latched until then, and return the flags that stand.

    Raises:
        RigError: a fault stays; it is of now.
    """
    flags = read_flags(line)
    if any(flag.startswith("F") for flag in flags):
        line.command("warnings clear")
        flags = read_flags(line)
    faults = [flag for flag in flags if flag.startswith("F")]
    if faults:
        raise error_of_flag(line.name, faults[0])
    return flags
