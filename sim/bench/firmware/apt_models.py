"""The Thorlabs APT controllers that can be simulated: scales, speeds, parameters at power-up."""

import struct
from dataclasses import dataclass

CHANNEL = 1


@dataclass(frozen=True)
class AptModel:
    """A controller with its motor; velocity and acceleration in the units of the protocol for 1°/s and 1°/s²."""

    name: str
    serial: int
    counts_per_deg: float
    velocity_unit: float
    acceleration_unit: float
    velocity_deg_s: float
    acceleration_deg_s2: float
    servo: bool

    def settings(self) -> dict[int, bytes]:
        """Parameters at power-up, by the id that sets them; they are asked for by the next."""
        velocity = round(self.velocity_deg_s * self.velocity_unit)
        acceleration = round(self.acceleration_deg_s2 * self.acceleration_unit)
        step = round(5.0 * self.counts_per_deg)
        return {
            0x0413: struct.pack("<Hiii", CHANNEL, 0, acceleration, velocity),
            0x0416: struct.pack("<HHiiiiH", CHANNEL, 2, step, 0, acceleration, velocity, 2),
            0x043A: struct.pack("<Hi", CHANNEL, 0),
            0x0440: struct.pack("<HHHii", CHANNEL, 2, 1, velocity, 0),
            0x0445: struct.pack("<Hi", CHANNEL, 0),
            0x0450: struct.pack("<Hi", CHANNEL, 0),
        }


_PRM1_COUNTS = 1919.6418578623391
_SERVO_CLOCK_S = 2048.0 / 6e6
MODELS = {
    "K10CR1": AptModel("K10CR1", 55000123, 409600.0 / 3.0, 7329109.0, 1502.0, 10.0, 10.0, servo=False),
    "KDC101": AptModel(
        "KDC101",
        27000123,
        _PRM1_COUNTS,
        _PRM1_COUNTS * _SERVO_CLOCK_S * 65536.0,
        _PRM1_COUNTS * _SERVO_CLOCK_S**2 * 65536.0,
        25.0,
        25.0,
        servo=True,
    ),
}
