"""GigE Vision and USB3 Vision cameras of any maker, by the library Aravis 0.8 or 0.10 (Debian: ``libaravis-0.8-0``).

Aravis (LGPL) is loaded by ctypes when a camera is opened: its Python bindings come for the system's own Python only,
or have to be compiled (docs/decisions/0022). Source of all names and values: the C headers of Aravis 0.8.26.

The acquisition runs as long as frames come whole. After a frame that did not, the stream is made anew, so that nothing
of an earlier trigger can come. A frame is taken only if every packet arrived, if size and pixel format are those that
were set, if its time is later than that of the frame before, and if the exposure is the one that was set, where the
camera states it in the frame.
"""

import contextlib
import ctypes
import functools
import logging
import threading
import time
from collections.abc import Callable, Iterator
from ctypes import POINTER, byref, c_char_p, c_double, c_int, c_int64, c_size_t, c_uint, c_uint64, c_void_p
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from anisoscope.base.errors import CameraError, NotConnected, RigFileError
from anisoscope.rig.camera import CameraInfo, CameraSettings
from anisoscope.rig.cameras.genicam import (
    EXPOSURE_TOLERANCE,
    GenicamCamera,
    Value,
    check_options,
    prepare,
    set_exposure,
    set_gain,
)
from anisoscope.rig.cameras.pixelformats import FORMATS, counts_of

T = TypeVar("T")
NAMES = (
    "libaravis-0.10.so.0",
    "libaravis-0.8.so.0",
    "libaravis-0.10.0.dylib",
    "libaravis-0.8.0.dylib",
)
"""File names of the library, in the order in which they are tried."""
LOST = {2, 4, 5, 6, 9, 10, 17}
"""Codes of ArvDeviceError after which a camera is gone or not ours: not connected, transfer, time-out, not found, no
stream (so many are read as 0 from a camera that is gone), not controller, access denied."""
STATUS = {
    1: "it was emptied",
    2: "packets were lost",
    3: "packets were lost",
    4: "packets came in disorder",
    5: "it does not fit its size",
    6: "it was still filling",
    7: "it was broken off",
    8: "its payload is not known",
}
CHUNKS = ("Timestamp", "ExposureTime")
_IMAGE, _IMAGE_WITH_CHUNKS = 1, 5
_BUFFERS = 4
_NO_PACKET_SOCKET = 1  # read by ordinary sockets, with or without the rights for others
_LOOK_S = 0.2
_LOG = logging.getLogger(__name__)

_P, _S = c_void_p, c_char_p
# Results and arguments; "E" as the last argument is a GError**, which becomes an exception.
_FUNCTIONS: dict[str, tuple[Any, list[Any]]] = {
    "arv_get_minor_version": (c_uint, []),
    "arv_update_device_list": (None, []),
    "arv_get_n_devices": (c_uint, []),
    "arv_get_device_id": (_S, [c_uint]),
    "arv_get_device_model": (_S, [c_uint]),
    "arv_get_device_serial_nbr": (_S, [c_uint]),
    "arv_camera_new": (_P, [_S, "E"]),
    "arv_camera_get_device": (_P, [_P]),
    "arv_camera_get_model_name": (_S, [_P, "E"]),
    "arv_camera_get_device_serial_number": (_S, [_P, "E"]),
    "arv_camera_is_gv_device": (c_int, [_P]),
    "arv_camera_gv_set_packet_size": (None, [_P, c_int, "E"]),
    "arv_camera_gv_set_stream_options": (None, [_P, c_int]),
    "arv_camera_get_payload": (c_uint, [_P, "E"]),
    "arv_camera_start_acquisition": (None, [_P, "E"]),
    "arv_camera_stop_acquisition": (None, [_P, "E"]),
    "arv_camera_create_chunk_parser": (_P, [_P]),
    "arv_gv_device_is_controller": (c_int, [_P]),
    "arv_device_get_feature": (_P, [_P, _S]),
    "arv_device_is_feature_available": (c_int, [_P, _S, "E"]),
    "arv_device_get_feature_access_mode": (c_int, [_P, _S]),
    "arv_device_execute_command": (c_int, [_P, _S, "E"]),
    "arv_device_get_boolean_feature_value": (c_int, [_P, _S, "E"]),
    "arv_device_set_boolean_feature_value": (None, [_P, _S, c_int, "E"]),
    "arv_device_get_string_feature_value": (_S, [_P, _S, "E"]),
    "arv_device_set_string_feature_value": (None, [_P, _S, _S, "E"]),
    "arv_device_get_integer_feature_value": (c_int64, [_P, _S, "E"]),
    "arv_device_set_integer_feature_value": (None, [_P, _S, c_int64, "E"]),
    "arv_device_get_integer_feature_bounds": (None, [_P, _S, POINTER(c_int64), POINTER(c_int64), "E"]),
    "arv_device_get_integer_feature_increment": (c_int64, [_P, _S, "E"]),
    "arv_device_get_float_feature_value": (c_double, [_P, _S, "E"]),
    "arv_device_set_float_feature_value": (None, [_P, _S, c_double, "E"]),
    "arv_device_get_float_feature_bounds": (None, [_P, _S, POINTER(c_double), POINTER(c_double), "E"]),
    "arv_device_dup_available_enumeration_feature_values_as_strings": (
        POINTER(_S),
        [_P, _S, POINTER(c_uint), "E"],
    ),
    "arv_gc_enumeration_get_type": (c_size_t, []),
    "arv_gc_boolean_get_type": (c_size_t, []),
    "arv_gc_float_get_type": (c_size_t, []),
    "arv_gc_integer_get_type": (c_size_t, []),
    "arv_chunk_parser_get_integer_value": (c_int64, [_P, _P, _S, "E"]),
    "arv_chunk_parser_get_float_value": (c_double, [_P, _P, _S, "E"]),
    "arv_buffer_new_allocate": (_P, [c_size_t]),
    "arv_buffer_get_status": (c_int, [_P]),
    "arv_buffer_get_payload_type": (c_int, [_P]),
    "arv_buffer_has_chunks": (c_int, [_P]),
    "arv_buffer_get_data": (_P, [_P, POINTER(c_size_t)]),
    "arv_buffer_get_image_width": (c_int, [_P]),
    "arv_buffer_get_image_height": (c_int, [_P]),
    "arv_buffer_get_image_pixel_format": (c_uint, [_P]),
    "arv_buffer_get_timestamp": (c_uint64, [_P]),
    "arv_buffer_get_frame_id": (c_uint64, [_P]),
    "arv_stream_push_buffer": (None, [_P, _P]),
    "arv_stream_get_statistics": (None, [_P, POINTER(c_uint64), POINTER(c_uint64), POINTER(c_uint64)]),
    "arv_stream_timeout_pop_buffer": (_P, [_P, c_uint64]),
    "g_object_unref": (None, [_P]),
    "g_free": (None, [_P]),
    "g_error_free": (None, [_P]),
    "g_type_check_instance_is_a": (c_int, [_P, c_size_t]),
}


class _Error(ctypes.Structure):
    _fields_ = (("domain", ctypes.c_uint32), ("code", c_int), ("message", c_char_p))


class AravisError(Exception):
    """An error of the library, with its code of ArvDeviceError."""

    def __init__(self, message: str, code: int) -> None:
        super().__init__(message)
        self.code = code


class Library:
    """The functions of the library; `call` raises `AravisError` where they report an error."""

    def __init__(self, path: str) -> None:
        self._library = ctypes.CDLL(path)
        self._functions: dict[str, Callable[..., Any]] = {}
        self._raises: set[str] = set()
        for name, (result, arguments) in _FUNCTIONS.items():
            self._declare(name, result, arguments)
        # From 0.9 on the callback has a destructor.
        pointers = [_P] * (3 if self.call("arv_get_minor_version") == 8 else 4)
        self._declare("arv_camera_create_stream", _P, [*pointers, "E"])
        self._no_callback = (None,) * (len(pointers) - 1)

    def _declare(self, name: str, result: Any, arguments: list[Any]) -> None:  # noqa: ANN401 - types of C
        function = getattr(self._library, name)
        function.restype = result
        function.argtypes = [POINTER(POINTER(_Error)) if kind == "E" else kind for kind in arguments]
        if arguments[-1:] == ["E"]:
            self._raises.add(name)
        self._functions[name] = function

    def call(self, name: str, *arguments: Any) -> Any:  # noqa: ANN401 - of C
        """The result of a function.

        Raises:
            AravisError: the function reports an error.
        """
        if name not in self._raises:
            return self._functions[name](*arguments)
        error = POINTER(_Error)()
        result = self._functions[name](*arguments, byref(error))
        if error:
            message, code = (error.contents.message or b"").decode("utf-8", "replace"), error.contents.code
            self._functions["g_error_free"](error)
            raise AravisError(" ".join(message.split()), code)
        return result

    def create_stream(self, camera: int) -> int | None:
        """A stream of a camera."""
        stream: int | None = self.call("arv_camera_create_stream", camera, *self._no_callback)
        return stream


@functools.cache
def load(path: str = "") -> Library:
    """The library, or that of a path.

    Raises:
        CameraError: it is not installed, or too old.
    """
    problem = ""
    for name in (path,) if path else NAMES:
        try:
            return Library(name)
        except OSError as error:
            problem = str(error)
        except AttributeError as error:
            problem = f"{name} is older than 0.8.20: {error}"
            break
    raise CameraError(
        f"the driver 'aravis' needs the library Aravis: apt-get install libaravis-0.8-0, or name its file as "
        f"camera.options.library ({problem})"
    )


class AravisFeatures:
    """The features of a device of Aravis; see `anisoscope.rig.cameras.genicam.Features`."""

    def __init__(self, library: Library, device: int) -> None:
        self._call = functools.partial(_on, library, device)
        self._library, self._device = library, device
        self._types = [
            (library.call(f"arv_gc_{kind}_get_type"), kind)
            for kind in ("enumeration", "boolean", "float", "integer")
        ]
        self._kinds: dict[str, str] = {}

    def _kind(self, name: str) -> str:
        """enumeration, boolean, float, integer, or string; "" for what does not exist."""
        if name not in self._kinds:
            node = self._call("get_feature", name)
            self._kinds[name] = node and next(
                (
                    kind
                    for number, kind in self._types
                    if self._library.call("g_type_check_instance_is_a", node, number)
                ),
                "string",
            )
        return self._kinds[name] or ""

    def readable(self, name: str) -> bool:
        """Whether there is such a feature and it can be read now."""
        return self._kind(name) != "" and bool(self._call("is_feature_available", name))

    def writable(self, name: str) -> bool:
        """Whether the feature can be set now."""
        return bool(self._call("get_feature_access_mode", name) != 0)

    def get(self, name: str) -> Value:
        """Its value; of an enumeration the name of the entry."""
        kind = self._kind(name)
        if kind in {"enumeration", "string"}:
            return bytes(self._call("get_string_feature_value", name) or b"").decode("utf-8", "replace")
        value: Value = self._call(f"get_{kind}_feature_value", name)
        return bool(value) if kind == "boolean" else value

    def set(self, name: str, value: Value) -> None:
        """Set it, without reading it back."""
        kind = self._kind(name)
        if kind in {"enumeration", "string"}:
            self._call("set_string_feature_value", name, str(value).encode())
        else:
            number = float(value) if kind == "float" else int(value)
            self._call(f"set_{kind}_feature_value", name, number)

    def bounds(self, name: str) -> tuple[float, float]:
        """Least and largest value of a number."""
        kind = self._kind(name)
        low, high = (c_double(), c_double()) if kind == "float" else (c_int64(), c_int64())
        self._call(f"get_{kind}_feature_bounds", name, byref(low), byref(high))
        return low.value, high.value

    def step(self, name: str) -> int:
        """Distance of the values of a whole number."""
        return max(1, int(self._call("get_integer_feature_increment", name)))

    def choices(self, name: str) -> tuple[str, ...]:
        """Names of the entries of an enumeration; empty for anything else."""
        if self._kind(name) != "enumeration":
            return ()
        count = c_uint()
        names = self._call("dup_available_enumeration_feature_values_as_strings", name, byref(count))
        found = tuple(names[i].decode() for i in range(count.value))
        self._library.call("g_free", ctypes.cast(names, c_void_p))
        return found

    def execute(self, name: str) -> None:
        """Execute a command."""
        self._call("execute_command", name)

    def code(self, name: str) -> int:
        """The number behind an entry of an enumeration."""
        return int(self._call("get_integer_feature_value", name))


def _on(library: Library, device: int, function: str, name: str, *arguments: Any) -> Any:  # noqa: ANN401 - of C
    return library.call(f"arv_device_{function}", device, name.encode(), *arguments)


@dataclass(frozen=True)
class Stamp:
    """Metadata that came with a frame.

    Attributes:
        frame_id: the camera's number of the frame.
        time_ns: the camera's own clock at the frame, in nanoseconds; 0 if it has none.
        exposure_s: the exposure that the camera states in the frame (chunk data); None if it does not.
    """

    frame_id: int
    time_ns: int
    exposure_s: float | None = None


@dataclass(frozen=True)
class Wanted:
    """Settings of every connection."""

    pixel_format: str
    size: tuple[int, int]
    features: str
    packet_size: int
    big_endian: bool = False


class Connection:
    """A camera that is connected and prepared.

    Raises:
        AravisError: it does not answer, or refuses.
        NotConnected: another program controls it.
        CameraError: it cannot be used.
        RigFileError: an option that it does not have.
    """

    def __init__(self, library: Library, device_id: str, wanted: Wanted) -> None:
        self._library, self._call = library, library.call
        self._stream: int | None = None
        self._parser: int | None = None
        self._last_ns, self._big_endian = 0, wanted.big_endian
        self._camera: int | None = self._call("arv_camera_new", device_id.encode())
        if not self._camera:
            raise NotConnected(f"{device_id} does not answer")
        try:
            self.device: int = self._call("arv_camera_get_device", self._camera)
            self._is_gige = bool(self._call("arv_camera_is_gv_device", self._camera))
            if not self.controls():
                raise NotConnected(f"{device_id} is in use by another program; close that one")
            self.features = AravisFeatures(library, self.device)
            if self._is_gige:
                self._call("arv_camera_gv_set_stream_options", self._camera, _NO_PACKET_SOCKET)
                if wanted.packet_size:
                    self._call("arv_camera_gv_set_packet_size", self._camera, wanted.packet_size)
            self.pixel_format = prepare(self.features, wanted.pixel_format, wanted.size, wanted.features)
            self.chunks = self._enable_chunks()
            self._code = self.features.code("PixelFormat")
            self.shape = int(self.features.get("Height")), int(self.features.get("Width"))
            self._bytes = self.shape[0] * FORMATS[self.pixel_format].size(self.shape[1])
            model = self._call("arv_camera_get_model_name", self._camera) or b"camera"
            serial = self._call("arv_camera_get_device_serial_number", self._camera) or b""
            self.model, self.serial = model.decode("utf-8", "replace"), serial.decode("utf-8", "replace")
        except BaseException:
            self.close()
            raise

    def controls(self) -> bool:
        """Whether the camera obeys us; false too after it went away."""
        return not self._is_gige or bool(self._call("arv_gv_device_is_controller", self.device))

    def _enable_chunks(self) -> tuple[str, ...]:
        """Have the frames carry their time and exposure, where the camera can; returns which they carry."""
        features = self.features
        if not (features.readable("ChunkModeActive") and features.writable("ChunkModeActive")):
            return ()
        features.set("ChunkModeActive", True)
        found = []
        for name in features.choices("ChunkSelector"):
            features.set("ChunkSelector", name)
            if name in CHUNKS:
                features.set("ChunkEnable", True)
                found.append(name)
        return tuple(found)

    def begin(self) -> None:
        """Make the stream and start the acquisition, if that is not done yet."""
        if self._stream is not None:
            return
        self._stream = self._library.create_stream(self._camera or 0)
        if not self._stream:
            raise AravisError("no stream", 2)
        size = self._call("arv_camera_get_payload", self._camera)
        for _ in range(_BUFFERS):
            self._call("arv_stream_push_buffer", self._stream, self._call("arv_buffer_new_allocate", size))
        if self.chunks:
            self._parser = self._call("arv_camera_create_chunk_parser", self._camera)
        self._call("arv_camera_start_acquisition", self._camera)

    def end(self) -> None:
        """Stop the acquisition and drop the stream with all that is in it."""
        stream, self._stream = self._stream, None
        parser, self._parser = self._parser, None
        if stream:
            with contextlib.suppress(AravisError):
                self._call("arv_camera_stop_acquisition", self._camera)
        for thing in (parser, stream):
            if thing:
                self._call("g_object_unref", thing)

    def frame(self, wait_s: float, exposure_s: float) -> tuple[npt.NDArray[np.uint16] | None, Stamp | str]:
        """Trigger a frame: its counts and what came with it, or None and why there is none."""
        self.begin()
        self.features.execute("TriggerSoftware")
        buffer = self._call("arv_stream_timeout_pop_buffer", self._stream, round(1e6 * wait_s))
        if not buffer:
            return None, f"nothing came in {round(1e3 * wait_s)} ms{self._no_packet()}"
        try:
            fault = self._fault(buffer)
            if fault:
                return None, fault
            stamp = self._stamp(buffer)
            fault = self._stale(stamp, exposure_s)
            if fault:
                return None, fault
            self._last_ns = stamp.time_ns
            size = c_size_t()
            data = self._call("arv_buffer_get_data", buffer, byref(size))
            view = (ctypes.c_ubyte * self._bytes).from_address(data)
            return counts_of(
                memoryview(view), self.shape, self.pixel_format, big_endian=self._big_endian
            ), stamp
        finally:
            self._call("arv_stream_push_buffer", self._stream, buffer)

    def _no_packet(self) -> str:
        """What to look at where a network camera answers, and its stream brought not even a part of a frame."""
        counts = [c_uint64() for _ in range(3)]
        self._call("arv_stream_get_statistics", self._stream, *(byref(one) for one in counts))
        if any(one.value for one in counts) or not self._call("arv_camera_is_gv_device", self._camera):
            return ""
        return (
            ", no packet at all: a firewall holds them back, or the reverse-path filter of the network interface, or "
            "their packet_size is too large (docs/cameras.md)"
        )

    def _fault(self, buffer: int) -> str:
        status = self._call("arv_buffer_get_status", buffer)
        if status != 0:
            return f"the frame is incomplete: {STATUS.get(status, f'status {status}')}"
        if self._call("arv_buffer_get_payload_type", buffer) not in {_IMAGE, _IMAGE_WITH_CHUNKS}:
            return "what came is no picture"
        rows = self._call("arv_buffer_get_image_height", buffer)
        cols = self._call("arv_buffer_get_image_width", buffer)
        if (rows, cols) != self.shape or self._call(
            "arv_buffer_get_image_pixel_format", buffer
        ) != self._code:
            return f"a picture of {cols} × {rows}, or of another pixel format, came"
        size = c_size_t()
        self._call("arv_buffer_get_data", buffer, byref(size))
        if size.value < self._bytes or (size.value != self._bytes and not self.chunks):
            return f"the frame is incomplete: {size.value} of {self._bytes} bytes"
        return ""

    def _stamp(self, buffer: int) -> Stamp:
        time_ns = self._call("arv_buffer_get_timestamp", buffer)
        exposure_s = None
        if self._parser and self._call("arv_buffer_has_chunks", buffer):
            if "Timestamp" in self.chunks:
                time_ns = self._call(
                    "arv_chunk_parser_get_integer_value", self._parser, buffer, b"ChunkTimestamp"
                )
            if "ExposureTime" in self.chunks:
                exposure_s = 1e-6 * self._call(
                    "arv_chunk_parser_get_float_value", self._parser, buffer, b"ChunkExposureTime"
                )
        return Stamp(self._call("arv_buffer_get_frame_id", buffer), time_ns, exposure_s)

    def _stale(self, stamp: Stamp, exposure_s: float) -> str:
        if stamp.time_ns and stamp.time_ns <= self._last_ns:
            return "the frame is not later than the one before"
        used_s = stamp.exposure_s
        if used_s is not None and abs(used_s - exposure_s) > EXPOSURE_TOLERANCE * exposure_s:
            return f"the frame was exposed for {used_s:g} s instead of {exposure_s:g} s"
        return ""

    def drop(self) -> None:
        """Disconnect from a camera that went away: in a thread, as the library waits for its answers, some 15 s."""
        threading.Thread(target=self.close, name="camera that went away", daemon=True).start()

    def close(self) -> None:
        """Stop and disconnect; closing twice is fine."""
        self.end()
        camera, self._camera = self._camera, None
        if camera:
            self._call("g_object_unref", camera)


class AravisCamera(GenicamCamera):
    """A GigE Vision or USB3 Vision camera that takes single frames.

    Attributes:
        stamp: what came with the last frame; None before the first.
    """

    stamp: Stamp | None = None

    def __init__(
        self,
        library: Library,
        device_id: str,
        wanted: Wanted,
        *,
        black_level: float,
        retries: int,
        timeout_s: float,
        reconnect_s: float,
    ) -> None:
        self._library, self._device_id, self._wanted = library, device_id, wanted
        self._reconnect_s = reconnect_s
        with _as_ours(device_id):
            self._connection: Connection | None = Connection(library, device_id, wanted)
        now = self._connection
        form = FORMATS[now.pixel_format]
        info = CameraInfo(
            model=now.model,
            serial=now.serial,
            rows=now.shape[0],
            cols=now.shape[1],
            bit_depth=form.bits,
            black_level=black_level,
            filters=form.filters,
        )
        super().__init__(now.features, info, retries=retries, timeout_s=timeout_s)

    @classmethod
    def open(
        cls,
        *,
        serial: str = "",
        address: str = "",
        pixel_format: str = "Mono12",
        width: int = 0,
        height: int = 0,
        black_level: float = 0.0,
        retries: int = 3,
        timeout_s: float = 2.0,
        features: str = "",
        packet_size: int = 0,
        reconnect_s: float = 10.0,
        library: str = "",
        big_endian: bool = False,
    ) -> "AravisCamera":
        """Connect to a camera.

        Args:
            serial: serial number; without it and `address` there must be one camera only.
            address: network address of a GigE camera, which is then not searched for.
            pixel_format: the format of raw counts; the same counts in another layout are used where the camera lacks
                it, and Mono8 for grey ones.
            width: columns of the picture, in the middle of the sensor; 0 for all.
            height: rows of the picture, likewise.
            black_level: counts of a pixel without light.
            retries: how often a frame that came incomplete is asked for again.
            timeout_s: seconds to wait for a frame beyond its exposure.
            features: further features by name, as ``ReverseX=1, BinningHorizontal=2``.
            packet_size: bytes of a GigE packet; 0 leaves what fits.
            reconnect_s: seconds in which a camera that went away is looked for; 0 for not at all.
            library: file of the library, if it has another name or place.
            big_endian: counts of 16 bits come with their high byte first.

        Raises:
            RigFileError: an option that makes no sense, or that the camera does not have.
            NotConnected: no such camera, or in use elsewhere.
            CameraError: the library is not installed, or the camera refuses a setting.
        """
        check_options(pixel_format, retries, timeout_s)
        if packet_size < 0 or reconnect_s < 0.0:
            raise RigFileError("camera.options: packet_size and reconnect_s must be 0 or more")
        loaded = load(library)
        return cls(
            loaded,
            address or _find(loaded, serial),
            Wanted(pixel_format, (height, width), features, packet_size, big_endian),
            black_level=black_level,
            retries=retries,
            timeout_s=timeout_s,
            reconnect_s=reconnect_s,
        )

    def configure(self, exposure_s: float, gain: float) -> CameraSettings:
        """Set exposure and gain as `GenicamCamera.configure` does; a camera that went away is looked for first."""
        return self._with_return(lambda: super(AravisCamera, self).configure(exposure_s, gain))

    def grab(self) -> npt.NDArray[np.uint16]:
        """Take a frame as `GenicamCamera.grab` does; a camera that went away is looked for first."""
        return self._with_return(super().grab)

    def close(self) -> None:
        """Disconnect; closing twice is fine."""
        connection, self._connection = self._connection, None
        self._reconnect_s = 0.0
        if connection is not None:
            connection.close()

    def _leave(self) -> None:
        connection, self._connection = self._connection, None
        if connection is not None:
            connection.drop()

    def _errors(self) -> contextlib.AbstractContextManager[None]:
        return _as_ours(self._name)

    def _is_gone(self) -> bool:
        """Whether the camera went away, or lost its settings, as after a loss of power."""
        if self._connection is None or not self._connection.controls():
            return True
        name = "ExposureTime" if self._features.readable("ExposureTime") else "ExposureTimeAbs"
        set_s = self._settings.exposure_s if self._settings else 0.0
        kept = abs(float(self._features.get(name)) * 1e-6 - set_s) <= EXPOSURE_TOLERANCE * set_s
        return not kept or self._features.get("TriggerMode") != "On"

    def _attempt(self, exposure_s: float) -> tuple[npt.NDArray[np.uint16] | None, str]:
        assert self._connection is not None
        if not self._connection.controls():
            raise NotConnected(f"{self._name} was unplugged, or another program took it")
        counts, came = self._connection.frame(self._timeout_s + exposure_s, exposure_s)
        if isinstance(came, Stamp):
            self.stamp = came
            return counts, ""
        self._connection.end()
        return None, came

    def _with_return(self, job: Callable[[], T]) -> T:
        settings = self._settings
        try:
            if self._connection is None:
                raise NotConnected(f"{self._name} is closed: open it again")
            return job()
        except NotConnected as lost:
            if not self._reconnect_s:
                self._leave()
                raise
            self._reconnect(lost, settings)
            return job()

    def _reconnect(self, lost: NotConnected, settings: CameraSettings | None) -> None:
        """Connect again and restore all settings."""
        _LOG.warning("%s; looking for it for %g s", lost, self._reconnect_s)
        self._leave()
        until = time.monotonic() + self._reconnect_s
        while True:
            try:
                with _as_ours(self._name):
                    self._connection = Connection(self._library, self._device_id, self._wanted)
                break
            except NotConnected:
                if time.monotonic() > until:
                    raise NotConnected(
                        f"{lost}; it did not come back in {self._reconnect_s:g} s: check power, cable and network"
                    ) from lost
                time.sleep(_LOOK_S)
        now = self._connection
        found = (now.model, now.serial, now.shape, FORMATS[now.pixel_format].bits)
        known = (self.info.model, self.info.serial, (self.info.rows, self.info.cols), self.info.bit_depth)
        if found != known:
            self._connection = None
            now.close()
            raise CameraError(
                f"{self._name} went away; what came back is another camera, or otherwise set: "
                f"{now.model} {now.serial}, {now.shape[1]} × {now.shape[0]}"
            )
        self._features = now.features
        if settings is not None:
            with self._errors():
                set_exposure(self._features, settings.exposure_s)
                set_gain(self._features, settings.gain)
            self._settings = settings
        _LOG.warning("%s is back", self._name)


@contextlib.contextmanager
def _as_ours(name: str) -> Iterator[None]:
    try:
        yield
    except AravisError as problem:
        if problem.code in LOST:
            raise NotConnected(
                f"{name} does not answer ({problem}); check power, cable and network"
            ) from problem
        raise CameraError(f"{name} refuses: {problem}") from problem


def _find(library: Library, serial: str) -> str:
    """The id of the camera with a serial number; of the only one if none is given.

    Raises:
        NotConnected: no such camera, or more than one; the cameras found are listed.
    """
    library.call("arv_update_device_list")
    found = []
    for number in range(library.call("arv_get_n_devices")):
        parts = [
            library.call(f"arv_get_device_{what}", number) or b"" for what in ("id", "model", "serial_nbr")
        ]
        found.append(tuple(part.decode("utf-8", "replace") for part in parts))
    fitting = [one for one in found if serial in {"", one[2]}]
    listed = ", ".join(f"{model} {number}" for _, model, number in found) or "none"
    asked = f" with serial number '{serial}'" if serial else ""
    if not fitting:
        raise NotConnected(
            f"there is no GigE Vision or USB3 Vision camera{asked}; found: {listed}. A GigE camera must be in the "
            "computer's own subnet; name one behind a router by camera.options.address"
        )
    if len(fitting) > 1:
        raise NotConnected(
            f"there are {len(fitting)} cameras{asked}; name one by camera.options.serial: {listed}"
        )
    return fitting[0][0]
