"""Plans, the runner, drivers by name, and the light by hand."""

import threading
from types import SimpleNamespace

import numpy as np
import pytest

from anisoscope.errors import CameraError, NotConnected, RecordError, RigError, RigFileError, UsageError
from anisoscope.rig import drivers, runner
from anisoscope.rig.acquisition.plan import DarkEvent, LightEvent, MoveEvent, Plan, Pose, SampleEvent
from anisoscope.rig.acquisition.runner import Rig, open_rig, run_plan
from anisoscope.rig.camera import Camera, CameraInfo, CameraSettings
from anisoscope.rig.drivers import open_stage
from anisoscope.rig.frame import read_frame
from anisoscope.rig.light import Light
from anisoscope.rig.lights.manual import ManualLight, open_manual
from anisoscope.rig.rigfile import CameraPart, GeometryPart, LightPart, RigFile, StagePart


class FakeStage:
    name = "fake stage"
    limits_deg = (0.0, 360.0)
    resolution_deg = 0.0025

    def __init__(self, log, at_deg=300.0):
        self.log, self.at_deg, self.is_homed = log, at_deg, False

    def position_deg(self):
        return self.at_deg

    def home(self):
        self.log.append("home")
        self.at_deg, self.is_homed = 0.0, True
        return 0.0

    def move_to(self, angle_deg):
        self.log.append(f"move {angle_deg:g}")
        self.at_deg = angle_deg + 0.001
        return self.at_deg

    def move_by(self, delta_deg):
        return self.move_to(self.at_deg + delta_deg)

    def stop(self):
        self.log.append("stop")

    def close(self):
        self.log.append("close stage")


class FakeCamera:
    info = CameraInfo("fake", "7", 2, 3, 12, 64.0)

    def __init__(self, log):
        self.log = log
        self.on_grab = lambda: None

    def configure(self, exposure_s, gain):
        return CameraSettings(exposure_s * 1.01, gain)

    def grab(self):
        self.log.append("grab")
        self.on_grab()
        return np.full((2, 3), len(self.log), dtype=np.uint16)

    def close(self):
        self.log.append("close camera")


class FakeLight:
    def __init__(self, log):
        self.log = log

    def on(self):
        self.log.append("light on")

    def off(self):
        self.log.append("light off")

    def close(self):
        self.log.append("close light")


def rig_file(**stage):
    options = {"driver": "fake", "port": "COM1", "zero_deg": 10.0} | stage
    return RigFile(
        schema=1,
        name="bench",
        stage=StagePart(**options),
        camera=CameraPart(driver="fake", pixel_um=4.0),
        light=LightPart(driver="fake"),
        geometry=GeometryPart(tilt_deg=0.0),
    )


@pytest.fixture
def log():
    return []


@pytest.fixture
def rig(log):
    return Rig(FakeStage(log), FakeCamera(log), FakeLight(log), rig_file())


PLAN = Plan(poses=(Pose(0.0), Pose(90.0)), exposure_s=0.02, dark_frames=2)


def test_a_plan_is_a_sequence_of_events():
    assert list(PLAN) == [
        LightEvent(on=False),
        DarkEvent(0),
        DarkEvent(1),
        LightEvent(on=True),
        MoveEvent(Pose(0.0), 0.0),
        SampleEvent(Pose(0.0), 0),
        MoveEvent(Pose(90.0), 0.0),
        SampleEvent(Pose(90.0), 0),
        MoveEvent(Pose(0.0), 0.0),
        SampleEvent(Pose(0.0), 0, again=True),
        LightEvent(on=False),
    ]
    assert PLAN.frame_count == 5


@pytest.mark.parametrize(
    "wrong",
    [
        {"poses": ()},
        {"poses": (Pose(float("nan")),)},
        {"exposure_s": 0.0},
        {"exposure_s": float("inf")},
        {"gain": -1.0},
        {"frames_per_pose": 0},
        {"dark_frames": -1},
        {"settle_s": -1.0},
    ],
)
def test_plans_that_make_no_sense(wrong):
    with pytest.raises(UsageError, match=next(iter(wrong))):
        Plan(**({"poses": (Pose(0.0),), "exposure_s": 0.01} | wrong))


def test_a_run_in_order(rig, log, tmp_path):
    told = []
    records = run_plan(PLAN, rig, tmp_path, told.append)
    assert log == [
        *["home", "light off", "grab", "grab", "light on"],
        *["move 10", "grab", "move 100", "grab", "move 8", "move 10", "grab", "light off"],
    ]
    assert [record.path.name for record in records] == [
        "000_dark_-010.00.tif",
        "001_dark_-010.00.tif",
        "002_sample_0000.00.tif",
        "003_sample_0090.00.tif",
        "004_sample_0000.00.tif",
    ]
    assert [record.again for record in records] == [False] * 4 + [True]
    frame = records[3].frame
    assert (frame.stage_deg, frame.commanded_deg, frame.exposure_s) == (pytest.approx(90.001), 90.0, 0.0202)
    assert frame.camera == "fake 7"
    assert told[0].text == "homing fake stage"
    assert (told[-1].done, told[-1].total) == (5, 5)


def test_frames_are_on_disk_the_moment_they_arrive(rig, tmp_path):
    seen = []
    rig.camera.on_grab = lambda: seen.append(len(list((tmp_path / "frames").glob("*.tif"))))
    records = run_plan(PLAN, rig, tmp_path)
    assert seen == [0, 1, 2, 3, 4]
    for record in records:
        np.testing.assert_array_equal(read_frame(record.path).counts, record.frame.counts)


def test_a_homed_stage_is_not_homed_again(rig, log, tmp_path):
    rig.stage.is_homed = True
    run_plan(PLAN, rig, tmp_path)
    assert "home" not in log
    assert log.index("move 8") < log.index("move 10")


@pytest.mark.parametrize(
    "error", [KeyboardInterrupt, CameraError("no frame"), SystemExit(1), ValueError("bug")]
)
def test_whatever_happens_the_stage_is_stopped_and_the_light_is_off(rig, log, tmp_path, error):
    def fail():
        if log.count("grab") == 3:
            raise error

    rig.camera.on_grab = fail
    with pytest.raises(error if isinstance(error, type) else type(error)):
        run_plan(PLAN, rig, tmp_path)
    assert log[-2:] == ["stop", "light off"]
    assert len(list((tmp_path / "frames").glob("*.tif"))) == 2


def test_cancel(rig, log, tmp_path):
    cancel = threading.Event()
    rig.camera.on_grab = lambda: cancel.set() if log.count("grab") == 3 else None
    with pytest.raises(RigError, match="cancelled after 3 frames"):
        run_plan(PLAN, rig, tmp_path, cancel=cancel)
    assert log[-2:] == ["stop", "light off"]


def test_a_stage_that_does_not_stop_leaves_the_light_off(rig, log, monkeypatch):
    monkeypatch.setattr(rig.stage, "stop", lambda: 1 / 0)
    rig.make_safe()
    assert log == ["light off"]


def test_a_tilt_that_the_arm_does_not_have(rig, log, tmp_path):
    with pytest.raises(
        RigError, match="a tilt of 5° was asked for, but the camera arm of 'bench' is fixed at 0°"
    ):
        run_plan(Plan(poses=(Pose(0.0), Pose(0.0, 5.0)), exposure_s=0.01), rig, tmp_path)
    assert log == []


@pytest.mark.parametrize(
    ("stage", "angle"),
    [
        ({"zero_deg": 1.0}, 0.0),
        ({"zero_deg": 10.0}, 351.0),
        ({"zero_deg": 10.0, "turns": "cw"}, 90.0),
    ],
)
def test_an_angle_that_cannot_be_reached_from_below(rig, log, tmp_path, stage, angle):
    rig = Rig(rig.stage, rig.camera, rig.light, rig_file(**stage))
    with pytest.raises(RigFileError, match=r"stage\.zero_deg"):
        run_plan(Plan(poses=(Pose(angle),), exposure_s=0.01), rig, tmp_path)
    assert log == []


def test_a_clockwise_stage(rig, log, tmp_path):
    rig = Rig(rig.stage, rig.camera, rig.light, rig_file(zero_deg=200.0, turns="cw"))
    records = run_plan(Plan(poses=(Pose(90.0),), exposure_s=0.01, return_to_first=False), rig, tmp_path)
    assert "move 110" in log
    assert records[-1].frame.stage_deg == pytest.approx(89.999)


def test_a_camera_that_delivers_something_else(rig, log, tmp_path):
    rig.camera.grab = lambda: np.zeros((5, 5), np.uint16)
    with pytest.raises(CameraError, match="shape"):
        run_plan(PLAN, rig, tmp_path)
    assert log[-1] == "light off"


def test_a_folder_that_cannot_be_made(rig, tmp_path):
    (tmp_path / "frames").write_text("in the way")
    with pytest.raises(RecordError, match="cannot be made"):
        run_plan(PLAN, rig, tmp_path)


@pytest.fixture
def fakes(monkeypatch, log):
    def entry(name, opener):
        return SimpleNamespace(name=name, load=lambda: opener)

    def open_fake_stage(*, port, speed=1.0):
        return FakeStage(log)

    found = {
        drivers.STAGES: {"fake": entry("fake", open_fake_stage)},
        drivers.CAMERAS: {"fake": entry("fake", lambda: FakeCamera(log))},
        drivers.LIGHTS: {"fake": entry("fake", lambda: FakeLight(log))},
    }
    monkeypatch.setattr(drivers, "installed", found.__getitem__)
    return found


@pytest.mark.usefixtures("fakes")
def test_leaving_a_rig_disconnects_everything(log, monkeypatch):
    nets = []
    monkeypatch.setattr(runner, "atexit", SimpleNamespace(register=nets.append, unregister=nets.remove))
    with open_rig(rig_file()) as rig:
        assert isinstance(rig.camera, Camera)
        assert isinstance(rig.light, Light)
        assert len(nets) == 1
    assert nets == []
    assert log[-3:] == ["close light", "close camera", "close stage"]
    with pytest.raises(KeyboardInterrupt), open_rig(rig_file()):
        raise KeyboardInterrupt
    assert log[-5:] == ["stop", "light off", "close light", "close camera", "close stage"]


def test_a_device_that_is_missing_closes_those_that_are_open(fakes, log):
    def missing():
        raise NotConnected("no camera")

    fakes[drivers.CAMERAS]["fake"] = SimpleNamespace(name="fake", load=lambda: missing)
    with pytest.raises(NotConnected), open_rig(rig_file()):
        pass
    assert log == ["close stage"]


@pytest.mark.usefixtures("fakes")
def test_drivers_that_do_not_exist_and_options_they_do_not_know():
    with pytest.raises(
        RigFileError, match=r"stage\.driver: there is no stage driver 'laser'; installed: fake"
    ):
        open_stage("laser")
    with pytest.raises(RigFileError, match=r"stage\.options: the driver 'fake'.*sped"):
        open_stage("fake", port="COM1", sped=3)
    with pytest.raises(RigFileError, match="port"):
        open_stage("fake")


def test_a_driver_that_does_not_load(fakes):
    def load():
        raise ImportError("No module named 'pypylon'")

    fakes[drivers.CAMERAS]["basler"] = SimpleNamespace(name="basler", load=load)
    with pytest.raises(RigFileError, match="does not load: No module named 'pypylon'"):
        drivers.open_camera("basler")


def test_installed_drivers():
    assert "elliptec" in drivers.installed(drivers.STAGES)
    with open_stage("elliptec", port="sim://elliptec?time_scale=0", address="0") as stage:
        assert stage.home() == 0.0
    for wrong in ({"adress": "0"}, {"timeout_s": "long"}):
        with pytest.raises(RigFileError, match=r"stage\.options"):
            open_stage("elliptec", port="sim://elliptec", **wrong)


def test_the_light_by_hand_asks_only_when_needed():
    asked = []
    light = ManualLight(asked.append)
    for action in (light.off, light.off, light.on, light.on, light.off):
        action()
    light.close()
    assert asked == ["Switch the light off", "Switch the light on", "Switch the light off"]


def test_the_light_by_hand_asks_in_the_terminal(capsys, monkeypatch):
    monkeypatch.setattr("sys.stdin", SimpleNamespace(readline=lambda: "\n"))
    open_manual().on()
    assert "Switch the light on, then press Enter" in capsys.readouterr().err
