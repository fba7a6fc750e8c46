"""The simulated devices by name, as ``sim://NAME``, ``rig sim NAME`` and a bench file build them.

A protocol lives in a module of its own, which ends in a `Simulated` named ``SIMULATED``; it is imported when asked for.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from importlib import import_module
from typing import cast

from anisoscope.base.errors import UsageError
from anisoscope.sim.bench.firmware.axis import LinearAxis, RotaryAxis
from anisoscope.sim.bench.firmware.device import Firmware

STAGES = ("elliptec", "zaber", "grbl", "apt", "smc100")
LIGHT = "light"
COOLLED, WHEEL = "coolled", "fw102c"
DEVICES = (*STAGES, LIGHT, COOLLED, WHEEL)


@dataclass(frozen=True)
class Mount:
    """An axis, and how the host finds it.

    Attributes:
        axis: the axis.
        address: "" is the protocol's first, or the one after the last.
        model: of a linear axis, its device; "" is the first linear one of the protocol.
    """

    axis: RotaryAxis
    address: str = ""
    model: str = ""


Builder = Callable[[Sequence[Mount], str, Sequence[str]], Firmware]


@dataclass(frozen=True)
class Simulated:
    """A protocol of which devices can be simulated.

    Attributes:
        title: what it is, for people.
        models: names of the devices that it can be, the usual one first.
        build: makes the device from its axes (rotation first, then tilt), a model name and faults. With more axes
            than one controller has, what it makes is several controllers on one line; faults are those of the first.
            Raises `UsageError` for an address, a number of axes or a fault that the protocol does not know.
        linear: names of the devices that move along a line.
    """

    title: str
    models: tuple[str, ...]
    build: Builder
    linear: tuple[str, ...] = ()

    def model_of(self, mount: Mount, usual: str) -> str:
        """Name of the device that moves an axis.

        Args:
            mount: the axis.
            usual: the device of axes that turn.

        Raises:
            UsageError: it does not exist, or moves otherwise.
        """
        if not isinstance(mount.axis, LinearAxis):
            if usual in self.linear:
                raise UsageError(f"{usual} moves along a line; describe it in a table [x], [y] or [z]")
            return usual
        model = mount.model or self.linear[0]
        if model not in self.linear:
            raise UsageError(
                f"'{model}' is no linear stage that is simulated; there are: {', '.join(self.linear)}"
            )
        return model


def simulated(name: str) -> Simulated:
    """The protocol of a name.

    Raises:
        UsageError: there is none.
    """
    if name not in DEVICES:
        near = get_close_matches(name, DEVICES, n=1)
        meant = f"; did you mean {near[0]}?" if near else ""
        raise UsageError(f"there is no simulated device '{name}'; there are: {', '.join(DEVICES)}{meant}")
    return cast("Simulated", import_module(f"anisoscope.sim.bench.firmware.{name}").SIMULATED)


def lone_mount(name: str, model: str, address: str, time_scale: float) -> Mount:
    """An axis for a device of its own, as its model moves: round or along a line. Errors as for `simulated`."""
    kind = LinearAxis if model in simulated(name).linear else RotaryAxis
    return Mount(kind(time_scale=time_scale), address, model)


def build(name: str, mounts: Sequence[Mount], *, model: str = "", faults: Sequence[str] = ()) -> Firmware:
    """A simulated device.

    Args:
        name: protocol, one of `DEVICES`.
        mounts: its axes, the rotation first; a light moves none of them.
        model: name of a model of the protocol; "" is the usual one.
        faults: what is wrong with it.

    Raises:
        UsageError: a name, an address or a fault that does not exist.
    """
    protocol = simulated(name)
    model = model or protocol.models[0]
    if model not in protocol.models:
        raise UsageError(f"{name} knows no model '{model}'; it knows: {', '.join(protocol.models)}")
    return protocol.build(mounts, model, faults)
