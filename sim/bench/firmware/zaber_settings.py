"""Models and settings of simulated Zaber stages, in the device's own units.

Sources: names, scopes and units of the settings from the Zaber ASCII protocol manual and the setting names of the
maker's client `zaber-motion`. Microsteps per turn of the X-RSW60 (384 000) and its top speed (115°/s) are as users
of that stage give them; those of the others follow from their gears (180:1 and 3:1, 200 steps of 64 microsteps) and
are unverified, and so are all accelerations. The device ids are placeholders that the maker did not give to a
product that we know of: no table of his was at hand.
"""

from collections.abc import Callable
from dataclasses import dataclass

SPEED_FACTOR = 1.6384
ACCELERATION_FACTOR = SPEED_FACTOR / 1e4
FARTHEST = 1_000_000_000
HIGHEST_SPEED = 64 * 16384
MAX_ADDRESS = 99
DEVICE, AXIS = 0, 1


@dataclass(frozen=True)
class ZaberModel:
    """What distinguishes a stage: id, microsteps per turn, top speed in degrees per second, acceleration setting."""

    device_id: int
    counts_per_turn: int
    velocity_deg_s: float
    accel: int
    serial: int = 68101
    version: str = "7.33"
    build: int = 12045

    @property
    def counts_per_deg(self) -> float:
        """Microsteps for one degree."""
        return self.counts_per_turn / 360.0

    @property
    def maxspeed(self) -> int:
        """The top speed as data of a setting."""
        return round(self.velocity_deg_s * self.counts_per_deg * SPEED_FACTOR)


X_RSW60A = ZaberModel(59060, 384_000, 115.0, 205)
X_RST120AK = ZaberModel(59120, 2_304_000, 24.0, 205)
X_RSB060AD = ZaberModel(59061, 38_400, 450.0, 20)
MODELS = {"X-RSW60A": X_RSW60A, "X-RST120AK": X_RST120AK, "X-RSB060AD": X_RSB060AD}


@dataclass
class Setting:
    """A setting: its value, whether it belongs to the device or to the axis, and what may be written to it.

    Attributes:
        value: the value, or a function that measures it.
        scope: `DEVICE` or `AXIS`.
        lowest, highest: what may be written; nothing may be if they are the same.
    """

    value: int | str | Callable[[], int]
    scope: int
    lowest: int = 0
    highest: int = 0

    @property
    def text(self) -> str:
        """The value in the format of the device."""
        return str(self.value() if callable(self.value) else self.value)

    def takes(self, number: int) -> bool:
        """Whether a number may be written to it."""
        return self.lowest <= number <= self.highest

    @property
    def writable(self) -> bool:
        """Whether anything may be written to it."""
        return self.lowest < self.highest


class Settings:
    """The settings of one stage.

    Args:
        model: what they are made from.
        address: address of the device.
        measured: settings of the axis that are measured when asked for.
    """

    def __init__(self, model: ZaberModel, address: int, measured: dict[str, Callable[[], int]]) -> None:
        self._by_name = {
            "deviceid": Setting(model.device_id, DEVICE),
            "device.id": Setting(model.device_id, DEVICE),
            "system.serial": Setting(model.serial, DEVICE),
            "system.axiscount": Setting(1, DEVICE),
            "system.access": Setting(1, DEVICE, 1, 2),
            "system.led.enable": Setting(1, DEVICE, 0, 1),
            "system.voltage": Setting("48.1", DEVICE),
            "system.temperature": Setting("31.5", DEVICE),
            "version": Setting(model.version, DEVICE),
            "version.build": Setting(model.build, DEVICE),
            "comm.address": Setting(address, DEVICE, 1, MAX_ADDRESS),
            "comm.alert": Setting(0, DEVICE, 0, 1),
            "comm.checksum": Setting(0, DEVICE, 0, 1),
            "comm.protocol": Setting(2, DEVICE),
            "comm.rs232.baud": Setting(115200, DEVICE),
            "comm.rs232.protocol": Setting(2, DEVICE),
            "limit.cycle.dist": Setting(model.counts_per_turn, AXIS, 0, FARTHEST),
            "limit.min": Setting(-FARTHEST, AXIS, -FARTHEST, FARTHEST),
            "limit.max": Setting(FARTHEST, AXIS, -FARTHEST, FARTHEST),
            "limit.approach.maxspeed": Setting(model.maxspeed, AXIS, 1, HIGHEST_SPEED),
            "maxspeed": Setting(model.maxspeed, AXIS, 1, HIGHEST_SPEED),
            "accel": Setting(model.accel, AXIS, 0, 32767),
            "resolution": Setting(64, AXIS),
            "driver.temperature": Setting("33.0", AXIS),
            **{name: Setting(measure, AXIS) for name, measure in measured.items()},
        }

    def __getitem__(self, name: str) -> int:
        """The value of a setting that is a whole number."""
        return int(self._by_name[name].text)

    def __setitem__(self, name: str, value: int) -> None:
        self._by_name[name].value = value

    def get(self, name: str, axis: int) -> tuple[bool, str]:
        """Answer a question: whether there is an answer, and the answer or the reason why there is none."""
        setting = self._by_name.get(name)
        if setting is None:
            return False, "BADCOMMAND"
        if setting.scope < axis:
            return False, "DEVICEONLY"
        return True, setting.text

    def set(self, name: str, value: str, axis: int) -> tuple[bool, str]:
        """Write a setting: whether that was possible, and ``0`` or the reason why not."""
        setting = self._by_name.get(name)
        if setting is None or not setting.writable:
            return False, "BADCOMMAND"
        if setting.scope < axis:
            return False, "DEVICEONLY"
        try:
            number = int(value)
        except ValueError:
            return False, "BADDATA"
        if not setting.takes(number):
            return False, "BADDATA"
        setting.value = number
        return True, "0"
