"""What the status bits of a Thorlabs APT controller say about a motor that stands where it should not."""

from anisoscope.base.errors import LimitExceeded, RigError, Stalled
from anisoscope.rig.stages.apt_wire import Status

# By bit; the controller keeps them until its channel is switched off and on.
TROUBLES: dict[int, tuple[type[RigError], str]] = {
    14: (Stalled, "a motion error: the motor did not follow"),
    15: (RigError, "an instrument error"),
    16: (RigError, "an open interlock"),
    17: (Stalled, "that it is too hot"),
    18: (RigError, "a fault of the supply voltage"),
    24: (Stalled, "that the motor has reached its current limit"),
    25: (Stalled, "a fault of the encoder"),
    26: (Stalled, "over-current"),
}


def trouble_of(name: str, status: Status, at_deg: float, *, moved: bool) -> RigError | None:
    """The error that explains it, or None.

    Args:
        name: how messages call the stage.
        status: its status, standing still short of its target.
        at_deg: where it stands, in degrees.
        moved: whether it has moved at all; a limit switch stops only a stage that did.
    """
    for bit, (kind, text) in TROUBLES.items():
        if status.has(bit):
            return kind(f"{name} reports {text} (status {status.bits:08X})")
    if not status.enabled:
        return RigError(f"{name} does not switch its motor on (status {status.bits:08X})")
    if status.at_limit_switch and moved:
        return LimitExceeded(f"{name} ended at its limit switch, at {at_deg:.4g}°")
    return None
