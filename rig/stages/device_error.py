"""Errors that a stage reports by a code: what the code says, and what to do about it."""

from anisoscope.base.errors import LimitExceeded, MotionTimeout, NotHomed, ProtocolError, RigError, Stalled

REMEDIES: dict[type[RigError], str] = {
    Stalled: "look for an obstacle, lower load or speed, then home it again",
    LimitExceeded: "check the angle against the travel of the device and against min_deg and max_deg",
    NotHomed: "home it again",
    MotionTimeout: "wait until it is idle and try again; switch it off and on if it stays so",
    ProtocolError: "check model, firmware and options of the driver",
}
FOR_ALL_OTHERS = (
    "remove the cause that the maker's manual gives for this code, then switch the device off and on"
)


def device_error(kind: type[RigError], text: str) -> RigError:
    """The error of a class with its remedy; a text that names one after a semicolon keeps its own."""
    return kind(text if ";" in text else f"{text}; {REMEDIES.get(kind, FOR_ALL_OTHERS)}")
