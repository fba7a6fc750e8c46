"""A rig that stays open: one process owns its axes, camera and light, others use them over a socket of this machine.

A port is open once, and a stage without memory loses its reference when it is closed. So one process (``anisoscope rig
hold``) may keep the devices open; whoever opens a device of a rig file meanwhile gets a proxy of it. The note of the
port (`anisoscope.rig.portholder`) states where the owner listens, and a token that only this user can read. A device
without a port is noted by its driver and options. Every client has exposure and gain of its own.

A client that goes away during a motion stops it. How they talk: `anisoscope.rig.holdline`.
"""

import contextlib
import hmac
import json
import logging
import secrets
import selectors
import socket
import socketserver
import threading
from collections.abc import Callable, Mapping
from dataclasses import asdict
from typing import TYPE_CHECKING, Any, Self

from anisoscope.base.errors import AnisoscopeError, CameraError, RigError
from anisoscope.rig.camera import Camera, CameraInfo, CameraSettings
from anisoscope.rig.holdline import ALIVE_S, LONGEST_LINE, HoldLine
from anisoscope.rig.light import ChannelLight, Light
from anisoscope.rig.portholder import Holder, claim, holder_of, release
from anisoscope.rig.rigfile import BY_HAND, CameraPart, LightPart, MotorPart
from anisoscope.rig.stage import MotionState, RotationStage, Unit, motion_state, unit_of

if TYPE_CHECKING:  # who only moves a stage does without
    import numpy as np
    import numpy.typing as npt

_log = logging.getLogger(__name__)

HERE = "127.0.0.1"
Part = MotorPart | LightPart | CameraPart
MOTIONS = frozenset({"home", "move_to", "move_by"})
ASKING = frozenset({BY_HAND, "none"})  # drivers that ask the operator, in the terminal of whoever opened them


KINDS = {CameraPart: "camera", LightPart: "light"}


def key_of(part: Part) -> str:
    """Key of a shared device: its kind, driver, port and options."""
    kind = KINDS.get(type(part), "axis")
    named: list[object] = [kind, part.driver, _port_of(part), dict(sorted(part.options.items()))]
    if isinstance(part, LightPart) and part.channels:
        wheel, channels = part.wheel, part.channels
        switched = {name: [one.lamps, one.level_percent, one.filter] for name, one in channels.items()}
        named += [None if wheel is None else wheel.model_dump(), switched]
    return json.dumps(named)


def _port_of(part: Part) -> str | None:
    return None if isinstance(part, CameraPart) else part.port


def noted_as(part: Part) -> str:
    """Under which name an owner notes a device: its port, or all that names it where it has none."""
    return _port_of(part) or f"held://{key_of(part)}"


# The owner.


class SharedCamera:
    """A camera for several clients: each grab has the exposure and gain that its client asks for."""

    def __init__(self, camera: Camera) -> None:
        self._camera = camera
        self._lock = threading.Lock()
        self._asked: tuple[float, float] | None = None

    @property
    def info(self) -> CameraInfo:
        """Fixed properties of the camera."""
        return self._camera.info

    def configure(self, exposure_s: float, gain: float) -> CameraSettings:
        """Set exposure in seconds and gain; return what the camera really uses."""
        with self._lock:
            return self._set(exposure_s, gain)

    def grab(self, exposure_s: float, gain: float) -> "npt.NDArray[np.uint16]":
        """The next frame under these settings."""
        with self._lock:
            if self._asked != (exposure_s, gain):
                self._set(exposure_s, gain)
            return self._camera.grab().copy()

    def _set(self, exposure_s: float, gain: float) -> CameraSettings:
        self._asked = None
        settings = self._camera.configure(exposure_s, gain)
        self._asked = (exposure_s, gain)
        return settings


class Owner:
    """Serves devices to other processes of this user until its context ends.

    Args:
        axes: open axes by their tables of the rig file, with these.
        light: the open light and its table.
        camera: the open camera and its table.
        rig: the rig file; "" without.

    Attributes:
        address: ``host:port`` at which it listens.
        camera: the camera, for this process as for others.
    """

    def __init__(
        self,
        axes: Mapping[str, tuple[MotorPart, RotationStage]],
        light: tuple[LightPart, Light] | None = None,
        rig: str = "",
        camera: tuple[CameraPart, Camera] | None = None,
    ) -> None:
        self.axes = {table: axis for table, (_, axis) in axes.items()}
        parts: list[tuple[Part, RotationStage | Light | SharedCamera]] = [*axes.values()]
        parts += [] if light is None else [light]
        parts += [] if camera is None else [(camera[0], SharedCamera(camera[1]))]
        self.camera = next((device for _, device in parts if isinstance(device, SharedCamera)), None)
        self._devices = {key_of(part): device for part, device in parts}
        tables = [*axes, *(["light"] * (light is not None)), *(["camera"] * (camera is not None))]
        self._keys = {table: key_of(part) for table, (part, _) in zip(tables, parts, strict=True)}
        self._ports = list(dict.fromkeys(noted_as(part) for part, _ in parts))
        self._rig = rig
        self._token = secrets.token_urlsafe(32)
        self._stack = contextlib.ExitStack()
        self.address = ""

    def __enter__(self) -> Self:
        server = _Server(self)
        self._stack.callback(server.server_close)
        self.address = f"{HERE}:{server.server_address[1]}"
        thread = threading.Thread(target=server.serve_forever, args=(0.05,), name="rig hold", daemon=True)
        thread.start()
        self._stack.callback(thread.join)
        self._stack.callback(server.shutdown)
        for port in self._ports:
            self._stack.callback(release, claim(port, self.address, self._token, self._rig))
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def stop_all(self) -> dict[str, str]:
        """Stop all axes at the same time; by table, what went wrong, or ""."""
        found: dict[str, str] = {}

        def stop(table: str, axis: RotationStage) -> None:
            try:
                axis.stop()
                found[table] = ""
            except RigError as problem:
                found[table] = str(problem)

        threads = [threading.Thread(target=stop, args=pair) for pair in self.axes.items()]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        return found

    def action(self, request: Mapping[str, Any]) -> tuple[Callable[[], Any], Callable[[], None]]:
        """Action of a request, and the one to take when its client goes away meanwhile.

        Raises:
            RigError: it is not from this user, or names nothing that is held.
        """
        if not hmac.compare_digest(str(request.get("token", "")).encode(), self._token.encode()):
            raise RigError(
                "the process that holds the rig does not know this client; start the command again"
            )
        do, arguments = str(request.get("do")), list(request.get("args", ()))
        key = request.get("device")
        if key is None:
            if do == "devices":
                return lambda: self._keys, _nothing
            if do != "stop":
                raise RigError(f"the process that holds the rig knows no '{do}' for all devices")
            return self.stop_all, _nothing
        device = self._devices.get(str(key))
        if device is None:
            raise RigError(
                "the process that holds the rig has this port open with another driver or other options; end it with q "
                "in its window, and start anisoscope rig hold with this rig file"
            )
        if isinstance(device, SharedCamera):
            return _camera_action(device, do, arguments), _nothing
        if isinstance(device, RotationStage):
            return _stage_action(device, do, arguments)
        return _light_action(device, do, arguments), _nothing


def _nothing() -> None:
    """Nothing has to be undone."""


def _stage_action(
    stage: RotationStage, do: str, arguments: list[Any]
) -> tuple[Callable[[], Any], Callable[[], None]]:
    queries: dict[str, Callable[[], Any]] = {
        "describe": lambda: {
            "name": stage.name,
            "unit": unit_of(stage),
            "limits_deg": list(stage.limits_deg),
            "resolution_deg": stage.resolution_deg,
        },
        "is_homed": lambda: stage.is_homed,
        "motion_state": lambda: asdict(motion_state(stage)),
        "position_deg": stage.position_deg,
        "stop": stage.stop,
    }
    if do in queries and not arguments:
        return queries[do], _nothing
    numbers = [float(value) for value in arguments]
    if do in MOTIONS and len(numbers) == (do != "home"):
        return lambda: getattr(stage, do)(*numbers), stage.stop
    raise RigError(f"the process that holds the rig knows no '{do}' of a stage")


def _camera_action(camera: SharedCamera, do: str, arguments: list[Any]) -> Callable[[], Any]:
    if do == "describe" and not arguments:
        return lambda: asdict(camera.info)
    numbers = [float(value) for value in arguments]
    if do in {"configure", "grab"} and len(numbers) == 2:
        act: Callable[[float, float], Any] = getattr(camera, do)
        return lambda: act(*numbers)
    raise RigError(f"the process that holds the rig knows no '{do}' of a camera")


def _light_action(light: Light, do: str, arguments: list[Any]) -> Callable[[], Any]:
    if do == "select" and isinstance(light, ChannelLight) and len(arguments) == 1:
        return lambda: light.select(str(arguments[0]))
    actions: dict[str, Callable[[], Any]] = {
        "describe": lambda: {
            "name": str(getattr(light, "name", "")),
            "asks": bool(getattr(light, "asks", False)),
            "channel": getattr(light, "channel", None),
        },
        "on": light.on,
        "off": light.off,
    }
    if do not in actions:
        raise RigError(f"the process that holds the rig knows no '{do}' of a light")
    return actions[do]


def _refusal(error: AnisoscopeError) -> dict[str, Any]:
    return {"error": type(error).__name__, "text": str(error)}


class _Server(socketserver.ThreadingTCPServer):
    daemon_threads = True
    block_on_close = False
    allow_reuse_address = True

    def __init__(self, owner: Owner) -> None:
        self.owner = owner
        super().__init__((HERE, 0), _Client)


class _Client(socketserver.StreamRequestHandler):
    """One client: its requests one after the other."""

    server: _Server
    disable_nagle_algorithm = True

    def handle(self) -> None:
        with contextlib.suppress(OSError):
            while line := self.rfile.readline(LONGEST_LINE):
                self._send(self._answer(line))

    def _send(self, answer: Mapping[str, Any]) -> None:
        found: Any = answer.get("ok")
        data, axes = b"", getattr(found, "ndim", None)
        if axes:  # a frame: its counts follow the line
            data = found.astype("<u2", copy=False).tobytes()
            answer = {"ok": list(found.shape), "bytes": len(data)}
        elif isinstance(found, CameraSettings):
            answer = {"ok": asdict(found)}
        self.wfile.write(json.dumps(answer).encode() + b"\n" + data)

    def _answer(self, line: bytes) -> Mapping[str, Any]:
        try:
            action, undo = self.server.owner.action(json.loads(line))
        except AnisoscopeError as error:
            return _refusal(error)
        except (ValueError, TypeError, AttributeError):
            return _refusal(RigError("the process that holds the rig does not understand the request"))
        try:
            return {"ok": self._wait_for(action, undo)}
        except AnisoscopeError as error:
            return _refusal(error)
        except Exception as error:  # noqa: BLE001 - the client learns of it, and this process goes on
            _log.exception("a request of another process")
            return _refusal(
                RigError(f"internal error in the process that holds the rig: {type(error).__name__}: {error}")
            )

    def _wait_for(self, action: Callable[[], Any], undo: Callable[[], None]) -> Any:  # noqa: ANN401
        """Result of an action, which runs in a thread; a client that goes away meanwhile has it undone."""
        ours, theirs = socket.socketpair()
        outcome: list[Any] = []

        def work() -> None:
            try:
                outcome.extend((True, action()))
            except BaseException as error:  # noqa: BLE001 - goes on in the thread of the client
                outcome.extend((False, error))
            finally:
                theirs.close()

        thread = threading.Thread(target=work, name="rig hold action", daemon=True)
        with ours:
            thread.start()
            self._stay(ours, undo)
        thread.join()
        if not outcome[0]:
            raise outcome[1]
        return outcome[1]

    def _stay(self, done: socket.socket, undo: Callable[[], None]) -> None:
        """Wait until an action is done; send signs of life, and undo the action where the client disconnects."""
        client: socket.socket | None = self.connection
        with selectors.DefaultSelector() as waiting:
            waiting.register(done, selectors.EVENT_READ)
            waiting.register(self.connection, selectors.EVENT_READ)
            while True:
                ready = [key.fileobj for key, _ in waiting.select(ALIVE_S)]
                if done in ready:
                    return
                if client is not None and not self._is_there(heard=client in ready):
                    waiting.unregister(client)
                    client = None
                    with contextlib.suppress(RigError):
                        undo()

    def _is_there(self, *, heard: bool) -> bool:
        try:
            if heard and not self.connection.recv(1, socket.MSG_PEEK):
                return False
            self.connection.sendall(b"\n")
        except OSError:
            return False
        return True


# The clients.


class HeldStage:
    """A stage that another process holds; what it does is what the stage of its driver does."""

    def __init__(self, holder: Holder, key: str) -> None:
        self._holder, self._key, self._line = holder, key, HoldLine(holder)
        found = self._line.describe(key)
        self.name = str(found["name"])
        self.unit: Unit = found["unit"]
        self.limits_deg = (float(found["limits_deg"][0]), float(found["limits_deg"][1]))
        self.resolution_deg = float(found["resolution_deg"])

    @property
    def is_homed(self) -> bool:
        """Whether the reference was searched since its owner opened it, or the device knows it."""
        return bool(self._line.ask(self._key, "is_homed"))

    def motion_state(self) -> MotionState:
        """Query whether it moves, where it is, and its speed, whichever process moves it."""
        line = HoldLine(self._holder)
        try:
            return MotionState(**line.ask(self._key, "motion_state"))
        finally:
            line.close()

    def position_deg(self) -> float:
        """Read the angle."""
        return float(self._line.ask(self._key, "position_deg"))

    def home(self) -> float:
        """Search the reference; return the angle read back."""
        return float(self._line.ask(self._key, "home"))

    def move_to(self, angle_deg: float) -> float:
        """Move to an angle; return the angle read back."""
        return float(self._line.ask(self._key, "move_to", angle_deg))

    def move_by(self, delta_deg: float) -> float:
        """Move by an angle; return the angle read back."""
        return float(self._line.ask(self._key, "move_by", delta_deg))

    def stop(self) -> None:
        """Stop at once, on a separate connection."""
        line = HoldLine(self._holder)
        try:
            line.ask(self._key, "stop")
        finally:
            line.close()

    def close(self) -> None:
        """Let go of the owner, which keeps the stage open; a motion of this client is stopped."""
        self._line.close()


class HeldLight:
    """A light that another process holds."""

    def __init__(self, holder: Holder, key: str) -> None:
        self._key, self._line = key, HoldLine(holder)
        found = self._line.describe(key)
        self.name, self.asks = str(found["name"]), bool(found["asks"])
        self._channel: str | None = None

    def select(self, channel: str) -> None:
        """Choose the channel that `on` lights, for this client alone."""
        self._channel = channel
        self._line.ask(self._key, "select", channel)

    def on(self) -> None:
        """Switch on; return when it is lit."""
        if self._channel is not None:
            self._line.ask(self._key, "select", self._channel)
        self._line.ask(self._key, "on")

    def off(self) -> None:
        """Switch off; return when it is dark."""
        self._line.ask(self._key, "off")

    def close(self) -> None:
        """Let go of the owner, which keeps the light open."""
        self._line.close()


class HeldCamera:
    """A camera that another process holds, with settings of this client's own; errors as for the camera."""

    def __init__(self, holder: Holder, key: str) -> None:
        self._key, self._line = key, HoldLine(holder)
        self.info = CameraInfo(**self._line.describe(key))
        self._asked: tuple[float, float] | None = None

    def configure(self, exposure_s: float, gain: float) -> CameraSettings:
        """Set exposure in seconds and gain; return what the camera really uses."""
        settings = CameraSettings(**self._line.ask(self._key, "configure", exposure_s, gain))
        self._asked = (exposure_s, gain)
        return settings

    def grab(self) -> "npt.NDArray[np.uint16]":
        """The next frame under these settings, (rows, cols) counts.

        Raises:
            CameraError: `configure` was not called, or a frame of another size came.
        """
        if self._asked is None:
            raise CameraError("the camera was asked for a frame before exposure and gain were set")
        shape, data = self._line.fetch(self._key, "grab", *self._asked)
        if shape != [self.info.rows, self.info.cols] or len(data) != 2 * self.info.rows * self.info.cols:
            raise CameraError(
                f"{self.info.model} delivered a frame of {shape}; it said {[self.info.rows, self.info.cols]}"
            )
        import numpy as np  # noqa: PLC0415 - as above

        return np.frombuffer(data, dtype="<u2").reshape(shape).astype(np.uint16, copy=False)

    def close(self) -> None:
        """Let go of the owner, which keeps the camera open."""
        self._line.close()


def held_stage(part: MotorPart) -> HeldStage | None:
    """The axis of a rig file if another process holds it for others, else None.

    Raises:
        NotConnected: that process does not answer.
        RigError: it holds the port with another driver or other options.
    """
    holder = _owner_of(part)
    return None if holder is None else HeldStage(holder, key_of(part))


def held_light(part: LightPart) -> HeldLight | None:
    """The light of a rig file if another process holds it for others, else None; errors as for `held_stage`."""
    holder = _owner_of(part)
    return None if holder is None else HeldLight(holder, key_of(part))


def held_camera(part: CameraPart) -> HeldCamera | None:
    """The camera of a rig file if another process holds it for others, else None; errors as for `held_stage`."""
    holder = _owner_of(part)
    return None if holder is None else HeldCamera(holder, key_of(part))


def is_held(part: Part) -> bool:
    """Whether another process holds the device for others."""
    return _owner_of(part) is not None


def _owner_of(part: Part) -> Holder | None:
    if part.driver in ASKING:
        return None
    holder = holder_of(noted_as(part))
    return holder if holder is not None and holder.serves_at else None
