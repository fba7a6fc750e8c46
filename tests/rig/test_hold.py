"""A rig that one process holds and others use."""

import contextlib
import json
import socket
import threading
import time

import numpy as np
import pytest

from anisoscope.base.errors import CameraError, LimitExceeded, NotConnected, NotHomed, RigError
from anisoscope.rig import hold, holdline, portholder
from anisoscope.rig.acquisition.opening import open_axis
from anisoscope.rig.camera import Camera, CameraInfo, CameraSettings
from anisoscope.rig.hold import HeldCamera, HeldLight, HeldStage, Owner, held_camera, held_stage, key_of
from anisoscope.rig.holdline import HoldLine, stop_held
from anisoscope.rig.rigfile import CameraPart, LightPart, LinearPart, StagePart
from anisoscope.sim.bench.firmware.axis import LinearAxis, RotaryAxis
from anisoscope.sim.bench.firmware.catalogue import Mount, build
from anisoscope.sim.bench.serve import PtyServer

SLOW = 30.0


class Lamp:
    name = "lamp 1"
    asks = False
    lit = False

    def on(self):
        self.lit = True

    def off(self):
        self.lit = False

    def close(self):
        pass


class Eye:
    """A camera whose frames say with which exposure they were taken, and which frame each is."""

    info = CameraInfo("eye", "7", 3, 5, 12, 64.0, pixel_pitch_um=3.45, filters="rggb")

    def __init__(self):
        self.exposure_s, self.frames, self.open = None, 0, True

    def configure(self, exposure_s, gain):
        if exposure_s > 1.0:
            raise CameraError("eye: exposures are 1 s at most; choose a shorter one")
        self.exposure_s = exposure_s
        return CameraSettings(round(exposure_s, 3), gain)

    def grab(self):
        self.frames += 1
        counts = np.arange(15, dtype=np.uint16).reshape(3, 5) + 256 * self.frames
        counts[0, 0] = round(1e4 * self.exposure_s)
        return counts

    def close(self):
        self.open = False


class Rig:
    """A stage behind a port that this process owns and serves; `others` uses it as another process would."""

    def __init__(self, opened, time_scale, protocol="elliptec", linear=None, eye=None):
        self.axis = (
            RotaryAxis(time_scale=time_scale, start_deg=300.0)
            if linear is None
            else LinearAxis(time_scale=time_scale, start_deg=20.0)
        )
        self.firmware = build(protocol, [Mount(self.axis)])
        server = opened.enter_context(PtyServer(self.firmware))
        kind, options = (StagePart, {}) if linear is None else (LinearPart, linear)
        self.part = kind(driver=protocol, port=server.url, options={"margin_s": 5.0, **options})
        stage = open_axis(self.part, "z")
        opened.callback(stage.close)
        self.lamp, self.lamp_part = Lamp(), LightPart(driver="serial", port="/dev/lamp")
        self.eye = eye or Eye()
        self.eye_part = CameraPart(driver="eye", pixel_um=1.0, options={"serial": "7"})
        lamp, camera = (self.lamp_part, self.lamp), (self.eye_part, self.eye)
        owner = Owner({"stage": (self.part, stage)}, lamp, "/rig.toml", camera)
        self.owner, self.stage = opened.enter_context(owner), stage
        self.holder = portholder._noted(server.url)
        self._opened = opened

    def slow_down(self, time_scale):
        self.axis.stop()  # what it did before was at the former pace
        self.axis.time_scale = time_scale

    def camera(self):
        held = HeldCamera(self.holder, key_of(self.eye_part))
        self._opened.callback(held.close)
        return held

    def others(self):
        held = HeldStage(self.holder, key_of(self.part))
        self._opened.callback(held.close)
        return held


@pytest.fixture
def rig(tmp_path, monkeypatch):
    """``rig(time_scale=0)`` opens and serves one; notes lie in a folder of the test."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    with contextlib.ExitStack() as opened:
        yield lambda time_scale=0.0, **options: Rig(opened, time_scale, **options)


def until(condition, every_s=0.002):
    while not condition():
        time.sleep(every_s)


@pytest.fixture
def in_background():
    """``in_background(action)`` runs it in a thread; gives a function that waits for it and raises what it raised."""
    threads = []

    def start(action):
        problems = []

        def work():
            try:
                action()
            except Exception as problem:  # noqa: BLE001 - raised again in the thread of the test
                problems.append(problem)

        threads.append(threading.Thread(target=work))
        threads[-1].start()

        def finish():
            threads[-1].join()
            if problems:
                raise problems[0]

        return finish

    yield start
    for thread in threads:
        thread.join()


def test_a_held_stage_is_used_as_its_own_would_be_and_stays_homed(rig):
    held = rig()
    with pytest.raises(NotHomed, match="search the reference"):
        held.others().move_to(10.0)
    first = held.others()
    assert (first.name, first.limits_deg) == (held.stage.name, (0.0, 360.0))
    assert not first.is_homed
    assert first.home() == 0.0
    assert first.move_to(90.0) == pytest.approx(90.0, abs=0.01)
    first.close()
    second = held.others()
    assert second.is_homed
    assert second.move_by(-30.0) == pytest.approx(60.0, abs=0.01)
    assert second.position_deg() == pytest.approx(held.axis.position(), abs=0.01)
    with pytest.raises(LimitExceeded, match="400° is outside"):
        second.move_to(400.0)


def test_who_looks_for_a_device_finds_its_owner_unless_that_is_itself(rig, monkeypatch):
    held = rig()
    assert held_stage(held.part) is None
    monkeypatch.setattr(hold, "holder_of", portholder._noted)
    with contextlib.closing(held_stage(held.part)) as found:
        assert found.name == held.stage.name
    other = held.part.model_copy(update={"options": {"address": "3"}})
    with pytest.raises(RigError, match="other options; end it with q"):
        held_stage(other)
    assert held_stage(StagePart(driver="manual")) is None


@pytest.mark.parametrize("motion", ["home", "move_to"])
def test_a_stop_reaches_a_motion_of_another_client(rig, in_background, motion):
    held = rig(SLOW)
    if motion == "move_to":
        held.axis.time_scale = 0.0
        held.others().home()
        held.slow_down(SLOW)
    start_deg = held.axis.position()
    finish = in_background(lambda: getattr(held.others(), motion)(*[200.0] * (motion == "move_to")))
    until(lambda: abs(held.axis.position() - start_deg) > 0.5)
    held.others().stop()
    assert not held.axis.busy()
    with pytest.raises(RigError, match=f"the {motion.partition('_')[0]} .*was stopped at"):
        finish()


def test_a_held_focus_jogs_in_millimetres_and_stops_at_once(rig, in_background):
    held = rig(protocol="zaber", linear={"counts_per_mm": 1000.0 / 0.047625})
    z = held.others()
    assert (z.unit, z.home()) == ("mm", 0.0)
    assert z.move_to(12.0) == pytest.approx(12.0, abs=1e-4)
    assert held.others().move_by(-0.5) == pytest.approx(11.5, abs=1e-4)
    with pytest.raises(LimitExceeded, match=r"mm is outside 0 mm…25\.4 mm; nothing was moved"):
        z.move_by(-12.0)
    held.slow_down(SLOW)
    finish = in_background(lambda: held.others().move_by(5.0))
    until(lambda: held.axis.position() > 11.51)
    z.stop()
    assert not held.axis.busy()
    assert 11.5 < held.axis.position() < 16.5
    with pytest.raises(RigError, match=r"the move .*was stopped at"):
        finish()
    assert z.is_homed


def test_all_that_is_held_is_stopped_without_naming_it(rig, in_background, monkeypatch):
    held = rig(SLOW)
    monkeypatch.setattr(holdline, "servers", lambda: (held.holder,))
    finish = in_background(held.others().home)
    until(held.axis.busy)
    assert stop_held() == {held.holder.pid: {"stage": ""}}
    assert not held.axis.busy()
    with pytest.raises(RigError, match="was stopped"):
        finish()


def test_a_client_that_goes_away_during_a_motion_stops_it(rig, in_background):
    held = rig(SLOW)
    client = held.others()
    finish = in_background(client.home)
    until(held.axis.busy)
    client._line._socket.shutdown(socket.SHUT_RDWR)
    with pytest.raises(NotConnected, match="has ended"):
        finish()
    until(lambda: held.firmware.stops)
    until(lambda: not held.axis.busy())


def test_a_second_motion_at_the_same_time_is_refused(rig, in_background):
    held = rig(SLOW)
    finish = in_background(held.others().home)
    until(held.axis.busy)
    with pytest.raises(RigError, match="moving already"):
        held.others().home()
    held.others().stop()
    with pytest.raises(RigError, match="stopped"):
        finish()


def test_a_motion_longer_than_the_patience_of_a_client_is_waited_for(rig, monkeypatch):
    monkeypatch.setattr(holdline, "SILENCE_S", 1.0)
    monkeypatch.setattr(hold, "ALIVE_S", 0.05)
    held = rig(1.5)  # 300° in a second and a half
    assert held.others().home() == pytest.approx(0.0, abs=0.01)


def test_an_owner_that_hangs_or_ends_is_named(rig, monkeypatch, tmp_path):
    held = rig()
    with socket.create_server(("127.0.0.1", 0)) as deaf:
        monkeypatch.setattr(holdline, "SILENCE_S", 0.2)
        port = deaf.getsockname()[1]
        holder = portholder.Holder(4711, "COM3", "x", "1", "SIGINT", f"127.0.0.1:{port}", "t")
        with pytest.raises(
            NotConnected, match=r"process 4711, which holds COM3, does not answer; look at its window"
        ):
            HoldLine(holder).ask(None, "stop")
    client = held.others()
    held.owner.__exit__()
    monkeypatch.setattr(holdline, "SILENCE_S", 2.0)
    client.close()
    with pytest.raises(NotConnected, match="has ended; start the command again"):
        client.position_deg()
    assert not list((tmp_path / "anisoscope").glob("*.json"))


def test_only_this_user_may_ask(rig, tmp_path):
    held = rig()
    (note, *_) = (tmp_path / "anisoscope").glob("*.json")
    assert note.stat().st_mode & 0o077 == 0
    stranger = portholder.Holder(**{**vars(held.holder), "token": "guess"})
    with pytest.raises(RigError, match="does not know this client"):
        HoldLine(stranger).describe(key_of(held.part))


@pytest.mark.parametrize(
    "request_",
    [b"\n", b"{\n", b"[]\n", b'{"token": 3}\n', b"\xff\xfe\n", b'{"do": "close"}\n', b"x" * 70000 + b"\n"],
)
def test_what_is_no_request_is_answered_by_an_error(rig, request_):
    host, _, port = rig().holder.serves_at.rpartition(":")
    with socket.create_connection((host, int(port)), timeout=5.0) as line:
        line.sendall(request_)
        answer = json.loads(line.makefile().readline())
    assert answer["error"] == "RigError"


@pytest.mark.parametrize(
    ("do", "arguments"), [("close", ()), ("move_to", ()), ("home", (3.0,)), ("_bus", ())]
)
def test_nothing_else_can_be_called(rig, do, arguments):
    held = rig()
    with (
        contextlib.closing(HoldLine(held.holder)) as line,
        pytest.raises(RigError, match=f"knows no '{do}' of a stage"),
    ):
        line.ask(key_of(held.part), do, *arguments)


def test_a_light_is_switched_and_stays_open(rig):
    held = rig()
    light = HeldLight(held.holder, key_of(held.lamp_part))
    assert (light.name, light.asks) == ("lamp 1", False)
    light.on()
    assert held.lamp.lit
    light.off()
    light.close()
    assert not held.lamp.lit
    with (
        contextlib.closing(HoldLine(held.holder)) as line,
        pytest.raises(RigError, match="knows no 'dim' of a light"),
    ):
        line.ask(key_of(held.lamp_part), "dim")


@pytest.mark.parametrize("protocol", ["apt", "smc100", "zaber"])
def test_where_a_moving_stage_is_and_how_fast_it_turns(rig, in_background, protocol):
    held = rig(0.0, protocol=protocol)
    client = held.others()
    client.home()
    assert client.motion_state().moving is False
    held.slow_down(SLOW)
    finish = in_background(lambda: client.move_to(60.0))
    watcher, states = held.others(), []
    until(lambda: states.append(watcher.motion_state()) or states[-1].speed_deg_s, every_s=0.1)
    watcher.stop()
    with pytest.raises(RigError, match="stopped"):
        finish()
    assert states[-1].moving
    assert 0.0 < states[-1].position_deg < 60.0
    assert states[-1].speed_deg_s > 0.0


def test_every_client_of_a_camera_has_its_own_exposure_and_nobody_elses_frame(rig):
    held = rig()
    live, snap = held.camera(), held.camera()
    assert isinstance(live, Camera)
    assert live.info == Eye.info
    with pytest.raises(CameraError, match="before exposure and gain were set"):
        live.grab()
    assert live.configure(0.0023456, 2.0) == CameraSettings(0.002, 2.0)
    snap.configure(0.5, 1.0)
    frames = [camera.grab() for camera in (live, snap, live, live, snap)]
    assert [frame[0, 0] for frame in frames] == [23, 5000, 23, 23, 5000]
    assert [frame[2, 4] for frame in frames] == [256 * number + 14 for number in range(1, 6)]
    assert all((frame.dtype, frame.shape) == (np.uint16, (3, 5)) for frame in frames)
    frames[0][:] = 0  # a frame is the client's own
    with pytest.raises(CameraError, match="exposures are 1 s at most; choose"):
        snap.configure(2.0, 1.0)
    assert snap.grab()[0, 0] == 5000
    snap.close()
    assert (live.grab()[0, 0], held.eye.open) == (23, True)


def test_large_frames_arrive_whole_while_another_client_stops_the_stage(rig, in_background):
    class Large(Eye):
        info = CameraInfo("large", "7", 2000, 3001, 16, 64.0)

        def __init__(self):
            super().__init__()
            self.random = np.random.default_rng(1)
            self.taken = []

        def grab(self):
            self.taken.append(self.random.integers(0, 65536, (2000, 3001), np.uint16))
            return self.taken[-1]

    held = rig(SLOW, eye=Large())
    finish = in_background(held.others().home)
    until(held.axis.busy)
    camera = held.camera()
    camera.configure(0.01, 1.0)
    frames = [camera.grab(), camera.grab()]
    held.others().stop()
    assert not held.axis.busy()
    frames.append(camera.grab())
    with pytest.raises(RigError, match="stopped"):
        finish()
    for frame, taken in zip(frames, held.eye.taken, strict=True):
        np.testing.assert_array_equal(frame, taken)


def test_a_camera_without_a_port_is_found_by_driver_and_options(rig, monkeypatch):
    held = rig()
    assert held_camera(held.eye_part) is None, "its own process opened it"
    monkeypatch.setattr(hold, "holder_of", portholder._noted)
    with contextlib.closing(held_camera(held.eye_part)) as found:
        assert found.info.serial == "7"
    other = held.eye_part.model_copy(update={"options": {"serial": "8"}})
    assert held_camera(other) is None
    same = held.eye_part.model_copy(update={"pixel_um": 2.0, "half_angle_deg": 3.0})
    with contextlib.closing(held_camera(same)) as found:
        assert found.info.serial == "7", "what the rig file says of its lens does not matter"


@pytest.mark.parametrize(("do", "arguments"), [("grab", (0.1,)), ("close", ()), ("describe", (1.0,))])
def test_nothing_else_can_be_asked_of_a_camera(rig, do, arguments):
    held = rig()
    with (
        contextlib.closing(HoldLine(held.holder)) as line,
        pytest.raises(RigError, match=f"knows no '{do}' of a camera"),
    ):
        line.ask(key_of(held.eye_part), do, *arguments)


def test_who_asks_learns_the_names_of_all_devices(rig):
    held = rig()
    with contextlib.closing(HoldLine(held.holder)) as line:
        keys = {"stage": key_of(held.part), "light": key_of(held.lamp_part), "camera": key_of(held.eye_part)}
        assert line.ask(None, "devices") == keys
        with pytest.raises(RigError, match="knows no 'home' for all devices"):
            line.ask(None, "home")
