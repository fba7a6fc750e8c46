"""Registers of a controller (`anisoscope.line.modbus`)."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Addresses:
    """Addresses of inputs and outputs, counted from 0.

    Attributes:
        trigger: discrete input of the trigger, counted from 0.
        number: first of two holding registers with the number of the job, high word first.
        outputs: first of five coils: ready, busy, pass, fail, invalid.
        device: unit identifier of the controller.
    """

    trigger: int = 0
    number: int = 0
    outputs: int = 0
    device: int = 1
