# ruff: noqa: ANN401 - harvesters and genicam have no types
"""Cameras by the GenTL producer of their maker (a file ``*.cti``), through Harvesters; extra ``genicam``.

Every frame is an acquisition of its own: started when the frame is asked for, triggered by software where the camera
can, and stopped. Settings go by the names of GenICam; see `anisoscope.rig.cameras.genicam`. Source: Harvesters 1.4 and
GenTL 1.6.
"""

import contextlib
import os
import signal
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from anisoscope.base.errors import CameraError, NotConnected, RigFileError
from anisoscope.rig.camera import CameraInfo, CameraSettings
from anisoscope.rig.cameras.genicam import GenicamCamera, Value, check_options, prepare
from anisoscope.rig.cameras.pixelformats import FORMATS, counts_of

PATHS = "GENICAM_GENTL64_PATH"
"""Environment variable in which makers register the folders of their producers."""
_LOST = (
    -1004,
    -1005,
    -1006,
    -1010,
    -1012,
)  # GenTL: resource in use, access denied, invalid handle, closed, I/O


class Producer:
    """A producer that is loaded, shared by those who open its cameras.

    Attributes:
        harvester: the object of Harvesters.
    """

    _open: ClassVar[dict[Path, "Producer"]] = {}
    _lock: ClassVar[threading.Lock] = threading.Lock()

    def __init__(self, path: Path, harvester: Any) -> None:
        self.harvester, self._path, self._holders = harvester, path, 0

    @classmethod
    def take(cls, path: Path) -> "Producer":
        """The producer of a file, loaded by the first who asks.

        Raises:
            CameraError: Harvesters is not installed, or the file is no producer.
        """
        with cls._lock:
            known = cls._open.get(path)
            if known is None:
                known = cls._open[path] = cls(path, _load(path))
            known._holders += 1
            return known

    def let_go(self) -> None:
        """One holder less; after the last the producer is unloaded."""
        with Producer._lock:
            self._holders -= 1
            if self._holders == 0:
                del Producer._open[self._path]
                self.harvester.reset()


def _load(path: Path) -> Any:
    try:
        from genicam import gentl  # noqa: PLC0415 - an extra
        from harvesters.core import Harvester  # noqa: PLC0415 - an extra
    except ImportError as problem:
        raise CameraError(
            f"the driver 'gentl' needs Harvesters: pip install 'anisoscope[genicam]' ({problem})"
        ) from problem
    producer = gentl.GenTLProducer.create_producer()
    try:  # Harvesters passes over a file that does not load
        producer.open(str(path))
        producer.close()
    except (gentl.GenericException, RuntimeError) as problem:
        raise CameraError(
            f"{path} does not load: take the producer for this operating system and processor from the maker"
        ) from problem
    harvester = Harvester()
    harvester.add_file(str(path))
    harvester.update()
    return harvester


def find_producer(producer: str) -> Path:
    """The file of a producer; without a name the only one in the folders that the environment names.

    Raises:
        RigFileError: there is no such file, or there are several.
    """
    if producer:
        path = Path(producer)
        if not path.is_file():
            raise RigFileError(f"camera.options.producer: there is no file {path}")
        return path.resolve()
    folders = [Path(part) for part in os.environ.get(PATHS, "").split(os.pathsep) if part]
    found = sorted(path for folder in folders for path in folder.glob("*.cti"))
    if len(found) != 1:
        listed = ", ".join(str(path) for path in found) or f"none in {PATHS}"
        raise RigFileError(
            f"camera.options.producer: name the maker's GenTL producer, a file *.cti; found: {listed}"
        )
    return found[0].resolve()


class GenApiFeatures:
    """The features of a node map of the package genicam; see `anisoscope.rig.cameras.genicam.Features`."""

    def __init__(self, nodes: Any) -> None:
        from genicam import genapi  # noqa: PLC0415 - an extra

        self._nodes, self._genapi = nodes, genapi

    def _node(self, name: str) -> Any:
        return getattr(self._nodes, name)

    def readable(self, name: str) -> bool:
        """Whether there is such a feature and it can be read now."""
        if not self._nodes.has_node(name):
            return False
        node = self._node(name)
        return hasattr(node, "value") and bool(self._genapi.is_readable(node.get_access_mode()))

    def writable(self, name: str) -> bool:
        """Whether the feature can be set now."""
        return bool(self._genapi.is_writable(self._node(name).get_access_mode()))

    def get(self, name: str) -> Value:
        """Its value; of an enumeration the name of the entry."""
        value: Value = self._node(name).value
        return value

    def set(self, name: str, value: Value) -> None:
        """Set it, without reading it back."""
        self._node(name).value = value

    def bounds(self, name: str) -> tuple[float, float]:
        """Least and largest value of a number."""
        node = self._node(name)
        return node.min, node.max

    def step(self, name: str) -> int:
        """Distance of the values of a whole number."""
        return int(self._node(name).inc)

    def choices(self, name: str) -> tuple[str, ...]:
        """Names of the entries of an enumeration; empty for anything else."""
        return tuple(getattr(self._node(name), "symbolics", ())) if self.readable(name) else ()

    def execute(self, name: str) -> None:
        """Execute a command."""
        self._node(name).execute()


class GentlCamera(GenicamCamera):
    """A camera behind a GenTL producer that takes single frames."""

    def __init__(
        self,
        producer: Producer,
        acquirer: Any,
        info: CameraInfo,
        *,
        pixel_format: str,
        triggered: bool,
        exposure_s: float,
        big_endian: bool,
        retries: int,
        timeout_s: float,
    ) -> None:
        features = GenApiFeatures(acquirer.remote_device.node_map)
        super().__init__(features, info, retries=retries, timeout_s=timeout_s)
        self._producer: Producer | None = producer
        self._acquirer, self._triggered, self._exposure_s = acquirer, triggered, exposure_s
        self._pixel_format, self._big_endian = pixel_format, big_endian

    @classmethod
    def open(
        cls,
        *,
        producer: str = "",
        serial: str = "",
        pixel_format: str = "Mono12",
        width: int = 0,
        height: int = 0,
        black_level: float = 0.0,
        retries: int = 3,
        timeout_s: float = 2.0,
        features: str = "",
        triggered: bool = True,
        exposure_s: float = 0.0,
        big_endian: bool = False,
    ) -> "GentlCamera":
        """Connect to a camera.

        Args:
            producer: the maker's file ``*.cti``; without it the only one in the folders of GENICAM_GENTL64_PATH.
            serial: serial number; without it there must be one camera only.
            pixel_format: as for the driver aravis.
            width: columns of the picture, in the middle of the sensor; 0 for all.
            height: rows of the picture, likewise.
            black_level: counts of a pixel without light.
            retries: how often a frame that came incomplete is asked for again.
            timeout_s: seconds to wait for a frame beyond its exposure.
            features: further features by name, as ``ReverseX=1``.
            triggered: False for a camera without a software trigger; it takes frames as soon as it is started.
            exposure_s: the exposure of a camera whose exposure cannot be set.
            big_endian: as for the driver aravis.

        Raises:
            RigFileError: an option that makes no sense.
            NotConnected: no such camera, or in use elsewhere.
            CameraError: Harvesters is not installed, or the camera refuses a setting.
        """
        check_options(pixel_format, retries, timeout_s)
        shared = Producer.take(find_producer(producer))
        acquirer = None
        try:
            with _as_ours("the camera"):
                device = _find(shared.harvester, serial)
                acquirer = _acquirer_of(shared.harvester, device)
                settings = GenApiFeatures(acquirer.remote_device.node_map)
                used = prepare(settings, pixel_format, (height, width), features, triggered=triggered)
                if not exposure_s and not any(map(settings.readable, ("ExposureTime", "ExposureTimeAbs"))):
                    raise CameraError(
                        "the exposure of this camera cannot be set; state it as camera.options.exposure_s"
                    )
                info = CameraInfo(
                    model=str(device.model),
                    serial=str(device.serial_number),
                    rows=int(settings.get("Height")),
                    cols=int(settings.get("Width")),
                    bit_depth=FORMATS[used].bits,
                    black_level=black_level,
                    filters=FORMATS[used].filters,
                )
        except BaseException:
            if acquirer is not None:
                acquirer.destroy()
            shared.let_go()
            raise
        return cls(
            shared,
            acquirer,
            info,
            pixel_format=used,
            triggered=triggered,
            exposure_s=exposure_s,
            big_endian=big_endian,
            retries=retries,
            timeout_s=timeout_s,
        )

    def configure(self, exposure_s: float, gain: float) -> CameraSettings:
        """Set exposure and gain as `GenicamCamera.configure` does; a stated exposure is the only one."""
        if not self._exposure_s:
            return super().configure(exposure_s, gain)
        if exposure_s != self._exposure_s or gain != 1.0:
            raise CameraError(
                f"{self._name}: exposure and gain are fixed at {self._exposure_s:g} s and 1, not {exposure_s:g} s "
                f"and {gain:g}"
            )
        self._settings = CameraSettings(exposure_s, 1.0)
        return self._settings

    def close(self) -> None:
        """Disconnect; closing twice is fine."""
        producer, self._producer = self._producer, None
        if producer is not None:
            with contextlib.suppress(Exception):
                self._acquirer.destroy()
            producer.let_go()

    def _errors(self) -> contextlib.AbstractContextManager[None]:
        return _as_ours(self._name)

    def _is_gone(self) -> bool:
        return not self._acquirer.is_valid()

    def _attempt(self, exposure_s: float) -> tuple[npt.NDArray[np.uint16] | None, str]:
        if self._producer is None:
            raise NotConnected(f"{self._name} is closed: open it again")
        self._acquirer.start()
        try:
            if self._triggered:
                self._features.execute("TriggerSoftware")
            wait_s = self._timeout_s + exposure_s
            buffer = self._acquirer.try_fetch(timeout=wait_s, is_raw=True)
            if buffer is None:
                return None, f"no complete frame came in {round(1e3 * wait_s)} ms"
            try:
                return self._counts(buffer)
            finally:
                buffer.parent.queue_buffer(buffer)
        finally:
            self._acquirer.stop()

    def _counts(self, buffer: Any) -> tuple[npt.NDArray[np.uint16] | None, str]:
        shape = self.info.rows, self.info.cols
        part = buffer.parts[0] if buffer.parts else buffer
        start = part.data_offset if buffer.parts else buffer.image_offset
        if (part.height, part.width) != shape:
            return None, f"a picture of {part.width} × {part.height} came"
        size = shape[0] * FORMATS[self._pixel_format].size(shape[1])
        data = memoryview(buffer.raw_buffer)[start : start + size]
        return counts_of(data, shape, self._pixel_format, big_endian=self._big_endian), ""


def _acquirer_of(harvester: Any, device: Any) -> Any:
    """The image acquirer of a device, without the handler of Ctrl-C that Harvesters installs with it.

    That handler gives the camera up and lets the program go on: no measurement could be broken off.
    """
    before = signal.getsignal(signal.SIGINT)
    try:
        return harvester.create(device)
    finally:
        if before is not None and threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGINT, before)


def _find(harvester: Any, serial: str) -> Any:
    """The device with a serial number; the only one if none is given.

    Raises:
        NotConnected: no such camera, or more than one; the cameras found are listed.
    """
    found = list(harvester.device_info_list)
    fitting = [device for device in found if serial in {"", str(device.serial_number)}]
    listed = ", ".join(f"{device.model} {device.serial_number}" for device in found) or "none"
    asked = f" with serial number '{serial}'" if serial else ""
    if not fitting:
        raise NotConnected(f"this producer has no camera{asked}; found: {listed}")
    if len(fitting) > 1:
        raise NotConnected(
            f"there are {len(fitting)} cameras{asked}; name one by camera.options.serial: {listed}"
        )
    return fitting[0]


@contextlib.contextmanager
def _as_ours(name: str) -> Iterator[None]:
    from genicam import genapi, gentl  # noqa: PLC0415 - an extra

    try:
        yield
    except gentl.GenericException as problem:
        reason = " ".join(str(problem).split())
        if any(f"ID: {code}" in reason for code in _LOST):
            raise NotConnected(f"{name} does not answer, or another program has it: {reason}") from problem
        raise CameraError(f"{name} refuses: {reason}") from problem
    except genapi.GenericException as problem:
        raise CameraError(f"{name} refuses: {' '.join(str(problem).split())}") from problem
