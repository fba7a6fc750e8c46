"""Camera, stage and light behind Micro-Manager: whatever its adapters drive, by the labels of its configuration.

The drivers are all named ``micromanager``; devices of one configuration file share one core, which is unloaded when the
last of them is closed. Needs the extra ``micromanager`` (pymmcore, LGPL) and Micro-Manager's device adapters of its
device interface. Source: documentation of MMCore, device interface 75.
"""

import contextlib
import os
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np
import numpy.typing as npt

from anisoscope.base.errors import CameraError, NotConnected, RigError, RigFileError
from anisoscope.rig.camera import CameraInfo, CameraSettings
from anisoscope.rig.stage import MotionRules, Unit
from anisoscope.rig.stages.motion import StageBase

FOLDER = "MICROMANAGER_PATH"
POLL_S = 0.01
MM_ERRORS = (RuntimeError, OSError, ValueError)


class Core:
    """A core with the devices of a configuration file, shared by those who open it.

    Attributes:
        mm: the core of Micro-Manager.
    """

    _open: ClassVar[dict[Path, "Core"]] = {}
    _lock: ClassVar[threading.Lock] = threading.Lock()

    def __init__(self, path: Path, mm: Any) -> None:  # noqa: ANN401 - of a package without types
        self.mm, self._path, self._holders = mm, path, 0

    @classmethod
    def take(cls, config: str, adapters: str) -> Self:
        """The core of a configuration file, loaded by the first who asks.

        Args:
            config: the file.
            adapters: folder of the device adapters; "" is that of the environment.

        Raises:
            RigFileError: the package, its adapters or the file is missing.
            NotConnected: a device of the file does not start.
        """
        path = Path(config).resolve()
        with cls._lock:
            known = cls._open.get(path)
            if known is None:
                known = cls._open[path] = cls(path, _load(path, adapters))
            known._holders += 1
            return known  # type: ignore[return-value]

    def let_go(self) -> None:
        """One holder less; after the last the devices are unloaded."""
        with Core._lock:
            self._holders -= 1
            if self._holders == 0:
                del Core._open[self._path]
                self.mm.unloadAllDevices()
                self.mm.reset()

    def label(self, wanted: str, default: str, what: str) -> str:
        """A label of the configuration, the usual one of Micro-Manager if none is named.

        Raises:
            RigFileError: there is no such device.
        """
        label, known = wanted or default, tuple(self.mm.getLoadedDevices())
        if label and label in known:
            return label
        names = ", ".join(name for name in known if name != "Core") or "none"
        raise RigFileError(
            f"{self._path}: it has no {what} {label or '(none is its default)'}; devices: {names}"
        )


def _load(path: Path, adapters: str) -> Any:  # noqa: ANN401 - of a package without types
    try:
        from pymmcore import CMMCore  # noqa: PLC0415 - an extra
    except ImportError:
        raise RigFileError(
            "the driver 'micromanager' needs pymmcore: pip install 'anisoscope[micromanager]'"
        ) from None
    if not path.is_file():
        raise RigFileError(f"options.config: there is no file {path}; write one with Micro-Manager")
    folder = adapters or os.environ.get(FOLDER, "")
    if not Path(folder).is_dir() or not folder:
        raise RigFileError(
            f"options.adapters: there is no folder {folder or '(none is named)'}; name the folder of Micro-Manager "
            f"there or in {FOLDER}"
        )
    mm = CMMCore()
    mm.setDeviceAdapterSearchPaths([folder])
    try:
        mm.loadSystemConfiguration(str(path))
    except MM_ERRORS as problem:
        mm.unloadAllDevices()
        raise NotConnected(
            f"{path}: {_one_line(problem)}; check the cables, then the file in Micro-Manager"
        ) from problem
    mm.setAutoShutter(False)  # the light is switched by its own driver
    return mm


def _one_line(problem: BaseException) -> str:
    return " ".join(str(problem).split())[:300]


@contextlib.contextmanager
def _as(kind: type[RigError], name: str) -> Iterator[None]:
    try:
        yield
    except MM_ERRORS as problem:
        raise kind(
            f"{name}: Micro-Manager reports: {_one_line(problem)}; check the device in Micro-Manager"
        ) from problem


class MicroManagerCamera:
    """A monochrome camera.

    Args:
        config: configuration file of Micro-Manager.
        adapters: folder of its device adapters; by default that which MICROMANAGER_PATH names.
        label: the camera's label; by default the file's default camera.
        black_level: counts of a pixel without light.
        gain_property: property that is the gain as a factor; without one the gain can only be 1.
        linear: whether counts grow in proportion to light.

    Raises:
        RigFileError: file, label or property is missing, or pictures are not monochrome with 8 to 16 bits.
        NotConnected: a device does not start.
    """

    def __init__(
        self,
        *,
        config: str,
        adapters: str = "",
        label: str = "",
        black_level: float = 0.0,
        gain_property: str = "",
        linear: bool = True,
    ) -> None:
        self._core: Core | None = Core.take(config, adapters)
        try:
            self._mm = mm = self._core.mm
            self._label = self._core.label(label, mm.getCameraDevice(), "camera")
            mm.setCameraDevice(self._label)
            properties = tuple(mm.getDevicePropertyNames(self._label))
            if gain_property and gain_property not in properties:
                raise RigFileError(f"camera.options.gain_property: {self._label} has no '{gain_property}'")
            self._gain_property = gain_property
            bits, channels = mm.getImageBitDepth(), mm.getNumberOfComponents()
            if channels != 1 or not 8 <= bits <= 16:
                raise RigFileError(
                    f"{self._label} gives {channels} channels of {bits} bits; set a monochrome PixelType of 8 to 16 "
                    "bits in the configuration of Micro-Manager"
                )
            serial = next(
                (mm.getProperty(self._label, name) for name in ("CameraID", "Serial") if name in properties),
                "",
            )
            self.info = CameraInfo(
                model=f"{mm.getDeviceLibrary(self._label)} {mm.getDeviceName(self._label)}",
                serial=serial or self._label,
                rows=mm.getImageHeight(),
                cols=mm.getImageWidth(),
                bit_depth=bits,
                black_level=black_level,
                linear=linear,
            )
        except BaseException:
            self.close()
            raise

    def configure(self, exposure_s: float, gain: float) -> CameraSettings:
        """Set exposure in seconds and gain as a factor; return what the camera really uses.

        Raises:
            CameraError: a value that it does not take.
        """
        if exposure_s <= 0.0 or gain <= 0.0:
            raise CameraError(
                f"{self._label}: exposure and gain must lie above 0, not {exposure_s:g} s and {gain:g}"
            )
        with _as(CameraError, self._label):
            self._mm.setExposure(self._label, 1e3 * exposure_s)
            used_s = self._mm.getExposure(self._label) / 1e3
            if not self._gain_property:
                if gain != 1.0:
                    raise CameraError(f"{self._label}: a gain of {gain:g} needs the option gain_property")
                return CameraSettings(used_s, 1.0)
            self._mm.setProperty(self._label, self._gain_property, f"{gain:g}")
            return CameraSettings(used_s, float(self._mm.getProperty(self._label, self._gain_property)))

    def grab(self) -> npt.NDArray[np.uint16]:
        """Snap a picture: (rows, cols) counts.

        Raises:
            CameraError: none came, or one of another shape.
        """
        with _as(CameraError, self._label):
            self._mm.snapImage()
            counts = np.asarray(self._mm.getImage())
        if (
            counts.shape != (self.info.rows, self.info.cols)
            or counts.dtype.kind != "u"
            or counts.dtype.itemsize > 2
        ):
            raise CameraError(
                f"{self._label} delivered {counts.dtype} of shape {counts.shape} instead of "
                f"{(self.info.rows, self.info.cols)}; leave binning and region alone while the rig is open"
            )
        return counts.astype(np.uint16)

    def close(self) -> None:
        """Let go of the core; closing twice is fine."""
        if self._core is not None:
            core, self._core = self._core, None
            core.let_go()


class MicroManagerLight:
    """A light that is a shutter of Micro-Manager; arguments and errors as for the camera."""

    def __init__(self, *, config: str, adapters: str = "", label: str = "") -> None:
        self._core: Core | None = Core.take(config, adapters)
        try:
            self._mm = self._core.mm
            self.name = self._core.label(label, self._mm.getShutterDevice(), "shutter")
        except BaseException:
            self.close()
            raise

    def on(self) -> None:
        """Open the shutter; return when it is open."""
        self._switch(True)

    def off(self) -> None:
        """Close the shutter; return when it is closed."""
        self._switch(False)

    def _switch(self, is_open: bool) -> None:
        with _as(RigError, self.name):
            self._mm.setShutterOpen(self.name, is_open)
            self._mm.waitForDevice(self.name)
            if self._mm.getShutterOpen(self.name) != is_open:
                raise RigError(
                    f"{self.name} did not {'open' if is_open else 'close'}; check it in Micro-Manager"
                )

    def close(self) -> None:
        """Let go of the core; closing twice is fine."""
        if self._core is not None:
            core, self._core = self._core, None
            core.let_go()


@dataclass(frozen=True)
class Usual:
    """Usual properties of a stage: micrometres of Micro-Manager per unit, tolerance and smallest step."""

    units: float
    tolerance: float
    resolution: float


USUAL: dict[Unit, Usual] = {"deg": Usual(1.0, 0.05, 0.01), "mm": Usual(1000.0, 0.001, 0.0001)}


class MicroManagerStage(StageBase):
    """A stage that is a single-axis stage of Micro-Manager.

    Args:
        unit: ``deg`` for a rotation stage, ``mm`` for a linear one (a focus drive); all that follows counts in it.
        config: configuration file of Micro-Manager.
        adapters: folder of its device adapters; by default that which MICROMANAGER_PATH names.
        label: the stage's label; of a linear one by default the file's focus drive.
        units_per_deg: what Micro-Manager counts as micrometres for one degree, by default 1; or for 1 mm, by default
            1000.
        home: ``device`` searches the reference; ``here`` declares the present position to be 0°.
        tolerance_deg: a stage this near to the target has arrived; by default 0.05° or 0.001 mm.
        resolution_deg: smallest step; by default 0.01° or 0.0001 mm.
        velocity_deg_s: speed that the stage at least reaches; time limits follow from it.
        margin_s: seconds added to every time limit.
        min_deg, max_deg: limits.

    Raises:
        RigFileError: file or label is missing, or an option is wrong.
        NotConnected: a device does not start.
    """

    def __init__(
        self,
        *,
        config: str,
        unit: Unit = "deg",
        adapters: str = "",
        label: str = "",
        units_per_deg: float | None = None,
        home: str = "device",
        tolerance_deg: float | None = None,
        resolution_deg: float | None = None,
        velocity_deg_s: float = 5.0,
        margin_s: float = 3.0,
        min_deg: float = 0.0,
        max_deg: float = 360.0,
    ) -> None:
        usual = USUAL[unit]
        units_per_deg = usual.units if units_per_deg is None else units_per_deg
        if home not in {"device", "here"} or units_per_deg == 0.0:
            raise RigFileError(f"options: home is 'device' or 'here', and units_per_{unit} is not 0")
        self.unit = unit
        self._core: Core | None = Core.take(config, adapters)
        try:
            drive = self._core.mm.getFocusDevice() if unit == "mm" else ""
            self._label = self._core.label(label, drive, "stage")
        except BaseException:
            self._disconnect()
            raise
        self._mm, self._units_per_deg, self._home_here = self._core.mm, units_per_deg, home == "here"
        tolerance = usual.tolerance if tolerance_deg is None else tolerance_deg
        rules = MotionRules(tolerance, velocity_deg_s, velocity_deg_s / 0.1, margin_s)
        name = f"{self._mm.getDeviceLibrary(self._label)} {self._label}"
        super().__init__(name, rules, (min_deg, max_deg), resolution_deg or usual.resolution)

    def _read_deg(self) -> float:
        with _as(RigError, self._label):
            return float(self._mm.getPosition(self._label)) / self._units_per_deg

    def _read_moving_deg(self) -> float | None:
        return self._read_deg()

    def _begin_home(self) -> None:
        with _as(RigError, self._label):
            if self._home_here:
                self._mm.setOrigin(self._label)
            else:
                self._mm.home(self._label)

    def _begin_move(self, target_deg: float) -> None:
        with _as(RigError, self._label):
            self._mm.setPosition(self._label, target_deg * self._units_per_deg)

    def _is_busy(self, wait_s: float) -> bool:
        with _as(RigError, self._label):
            if not self._mm.deviceBusy(self._label):
                return False
            time.sleep(max(0.0, min(wait_s, POLL_S)))
            return bool(self._mm.deviceBusy(self._label))

    def _send_stop(self) -> None:
        with _as(RigError, self._label):
            self._mm.stop(self._label)

    def _disconnect(self) -> None:
        if self._core is not None:
            core, self._core = self._core, None
            core.let_go()
