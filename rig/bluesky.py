"""Stage, camera and light as devices of Bluesky: ``RE(count([camera]))``, ``RE(grid_scan([camera], tilt, …))``.

The devices are made from a rig that is open; whoever opened it makes it safe and closes it. Needs the extra ``bluesky``
(bluesky and ophyd-async, both BSD). An event holds the counts of the frame as an array; units stand in the descriptors.
Source: the protocols of `bluesky.protocols`, the documents of event-model.
"""

import asyncio
import time
from typing import Any

import numpy as np
import numpy.typing as npt
from bluesky.protocols import Reading
from event_model import DataKey
from ophyd_async.core import AsyncStatus, Device

from anisoscope.base.errors import CameraError, RigError
from anisoscope.rig.acquisition.opening import Rig
from anisoscope.rig.camera import Camera
from anisoscope.rig.light import Light
from anisoscope.rig.rigfile import MotorPart
from anisoscope.rig.stage import RotationStage, check_limits

SOURCE = "anisoscope"


def devices_of(rig: Rig, exposure_s: float, gain: float = 1.0) -> dict[str, Device]:
    """Devices of an open rig by name: ``stage``, ``tilt`` if the rig has it, ``camera`` and ``light``.

    Args:
        rig: an opened rig, its axes homed.
        exposure_s: exposure of the camera in seconds.
        gain: gain of the camera as a factor.

    Raises:
        CameraError: exposure or gain is outside the range of the camera.
    """
    found: dict[str, Device] = {"stage": Axis(rig.stage, rig.file.stage, "stage")}
    if rig.tilt is not None and rig.file.tilt is not None:
        found["tilt"] = Axis(rig.tilt, rig.file.tilt, "tilt")
    found["camera"] = Frames(rig.camera, "camera", exposure_s, gain)
    found["light"] = Lamp(rig.light, "light")
    return found


class Axis(Device):
    """An axis by angle of sample or arm, or mm of x, y or z, approached from below. Movable, Locatable, Stoppable.

    Args:
        axis: the axis, open and homed.
        part: its table in the rig file.
        name: name of the device.
    """

    def __init__(self, axis: RotationStage, part: MotorPart, name: str) -> None:
        super().__init__(name=name)
        self._axis, self._part = axis, part
        self._target: float | None = None

    def set(self, value: float) -> AsyncStatus[None]:
        """Move to a place; the status fails with the error of the axis, and one that is out of reach moves nothing."""
        return AsyncStatus(asyncio.to_thread(self._go, float(value)))

    def _go(self, place: float) -> None:
        below, reading = self._part.way(place, self._axis.limits_deg)
        check_limits(self._axis, reading)
        check_limits(self._axis, below)
        self._target = place
        if self._axis.position_deg() > below:
            self._axis.move_to(below)
        self._axis.move_to(reading)

    def _place(self) -> float:
        return self._part.place(self._axis.position_deg())

    async def stop(self, success: bool = True) -> None:
        """Stop at once."""
        del success
        await asyncio.to_thread(self._axis.stop)

    async def locate(self) -> dict[str, float]:
        """Target and position."""
        place = await asyncio.to_thread(self._place)
        return {"setpoint": place if self._target is None else self._target, "readback": place}

    async def read(self) -> dict[str, Reading[Any]]:
        """The place, read back."""
        return {self.name: _reading(await asyncio.to_thread(self._place))}

    async def describe(self) -> dict[str, DataKey]:
        """Unit and source."""
        key = DataKey(
            source=f"{SOURCE}:{self._axis.name}",
            dtype="number",
            shape=[],
            dtype_numpy="<f8",
            units=self._part.unit,
        )
        return {self.name: key}


class Frames(Device):
    """A camera: a trigger takes a frame, reading gives its counts; Readable, Triggerable, Configurable."""

    def __init__(self, camera: Camera, name: str, exposure_s: float, gain: float) -> None:
        super().__init__(name=name)
        self._camera = camera
        self._settings = camera.configure(exposure_s, gain)
        self._counts: npt.NDArray[np.uint16] | None = None
        self._taken = 0.0

    def trigger(self) -> AsyncStatus[None]:
        """Take a frame."""
        return AsyncStatus(asyncio.to_thread(self._take))

    def _take(self) -> None:
        self._counts, self._taken = self._camera.grab().copy(), time.time()

    async def read(self) -> dict[str, Reading[Any]]:
        """Counts of the last frame, (rows, cols).

        Raises:
            CameraError: none was taken yet.
        """
        if self._counts is None:
            raise CameraError(f"{self.name} was read before a frame was taken; trigger it first")
        return {self.name: Reading(value=self._counts, timestamp=self._taken)}

    async def describe(self) -> dict[str, DataKey]:
        """Shape and unit of the counts."""
        info = self._camera.info
        key = DataKey(
            source=f"{SOURCE}:{info.model} {info.serial}".strip(),
            dtype="array",
            shape=[info.rows, info.cols],
            dtype_numpy="<u2",
            units="counts",
        )
        return {self.name: key}

    async def read_configuration(self) -> dict[str, Reading[Any]]:
        """Exposure, gain, black level and bit depth."""
        return {key: _reading(value) for key, (value, _) in self._configuration().items()}

    async def describe_configuration(self) -> dict[str, DataKey]:
        """Units of the configuration."""
        return {
            key: DataKey(source=SOURCE, dtype="number", shape=[], dtype_numpy="<f8", units=unit)
            for key, (_, unit) in self._configuration().items()
        }

    def _configuration(self) -> dict[str, tuple[float, str]]:
        info = self._camera.info
        values = {
            "exposure": (self._settings.exposure_s, "s"),
            "gain": (self._settings.gain, ""),
            "black_level": (info.black_level, "counts"),
            "bit_depth": (float(info.bit_depth), "bit"),
        }
        return {f"{self.name}_{key}": value for key, value in values.items()}


class Lamp(Device):
    """A light: ``set(True)`` switches on; Movable, Readable."""

    def __init__(self, light: Light, name: str) -> None:
        super().__init__(name=name)
        self._light = light
        self._lit: bool | None = None

    def set(self, value: bool) -> AsyncStatus[None]:
        """Switch on or off."""
        return AsyncStatus(asyncio.to_thread(self._switch, bool(value)))

    def _switch(self, on: bool) -> None:
        (self._light.on if on else self._light.off)()
        self._lit = on

    async def read(self) -> dict[str, Reading[Any]]:
        """Whether it was switched on here.

        Raises:
            RigError: nothing was switched yet.
        """
        if self._lit is None:
            raise RigError(f"{self.name} was read before it was switched; set it first")
        return {self.name: _reading(self._lit)}

    async def describe(self) -> dict[str, DataKey]:
        """Kind of the value."""
        return {self.name: DataKey(source=SOURCE, dtype="boolean", shape=[], dtype_numpy="|b1")}


def _reading(value: Any) -> Reading[Any]:  # noqa: ANN401 - number or truth value
    return Reading(value=value, timestamp=time.time())
