"""The error for an answer that did not come, in the same words for every protocol."""

from anisoscope.base.errors import NotConnected, ProtocolError, RigError
from anisoscope.rig.transport import Transport

PATIENCE = 2.0
"""Further time for an answer, by which a slow device differs from a silent one, as a multiple of the first."""
SECOND_S = 0.1
"""Time for a second answer to one question, in seconds."""


def no_answer(
    name: str,
    transport: Transport,
    timeout_s: float,
    protocol: str,
    *,
    heard: bool,
    stranger: object = None,
    check: str = "the power, the cable and the address",
) -> RigError:
    """Why no answer came: an echo, another address, noise, a slow device, or silence.

    Args:
        name: how messages call the device.
        transport: its port.
        timeout_s: seconds that the answer had.
        protocol: its name, for messages.
        heard: whether anything came that is no answer.
        stranger: address that answered in its place, or None.
        check: what to look at where nothing comes.
    """
    if transport.echoes:
        return NotConnected(
            f"{name} is silent, and what is sent to {transport.port} comes back: an echo of the adapter, or its two "
            "lines touch; check the wiring, and switch the echo off"
        )
    if stranger is not None:
        return NotConnected(f"{name} is silent, but address {stranger} answers; correct the address")
    if heard or transport.pending:
        return ProtocolError(
            f"{name} sends bytes that are no {protocol} answer; check port and baud rate, and look for a second device "
            "at its address"
        )
    late_s = transport.comes_late(PATIENCE * timeout_s)
    if late_s is not None:
        return NotConnected(
            f"{name} is slow: it begins to answer after {timeout_s + late_s:.1f} s, and {timeout_s:g} s are allowed; "
            "look for what slows the line down, or set timeout_s among its options"
        )
    return NotConnected(f"{name} is silent; check {check}")


def two_devices(name: str) -> RigError:
    """The error for two answers to one question."""
    return ProtocolError(
        f"{name} answers one question twice: two devices have this address; find one of them by its serial number, "
        "take it off the line, and give it another address"
    )
