"""Plans, the runner, drivers by name, and the light by hand."""

import threading
import time
from types import SimpleNamespace

import numpy as np
import pytest

from anisoscope.base.errors import CameraError, NotConnected, RecordError, RigError, RigFileError
from anisoscope.record.schema import sha256_of
from anisoscope.rig import drivers
from anisoscope.rig.acquisition import opening, writer
from anisoscope.rig.acquisition.journal import read_journal
from anisoscope.rig.acquisition.plan import Plan, Pose
from anisoscope.rig.acquisition.runner import Rig, open_rig, run_plan
from anisoscope.rig.camera import Camera, CameraInfo, CameraSettings
from anisoscope.rig.drivers import open_stage
from anisoscope.rig.frame import read_frame
from anisoscope.rig.light import Light
from anisoscope.rig.lights.manual import ManualLight, open_manual
from anisoscope.rig.rigfile import CameraPart, GeometryPart, LightPart, RigFile, StagePart, TiltPart


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
    info = CameraInfo("fake", "7", 2, 3, 12, 64.0, filters="bggr")

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


def test_a_run_in_order(rig, log, tmp_path):
    told = []
    records = run_plan(PLAN, rig, tmp_path, told.append)
    assert log == [
        *["home", "light off", "grab", "grab", "light on"],
        *["move 10", "grab", "move 100", "grab", "move 8", "move 10", "grab", "light off"],
    ]
    assert [record.path.name for record in records] == [
        "000_dark.tif",
        "001_dark.tif",
        "002_sample_0000.00.tif",
        "003_sample_0090.00.tif",
        "004_sample_0000.00.tif",
    ]
    assert [record.again for record in records] == [False] * 4 + [True]
    frame = records[3].frame
    assert (frame.stage_deg, frame.commanded_deg, frame.exposure_s) == (pytest.approx(90.001), 90.0, 0.0202)
    assert (frame.camera, frame.filters) == ("fake 7", "bggr")
    assert told[0].text == "homing fake stage"
    assert (told[-1].done, told[-1].total) == (5, 5)


def test_at_most_one_frame_is_not_on_disk_yet(rig, tmp_path):
    seen = []
    rig.camera.on_grab = lambda: seen.append(len(read_journal(tmp_path).frames))
    records = run_plan(PLAN, rig, tmp_path)
    assert all(taken - 1 <= written <= taken for taken, written in enumerate(seen))
    assert [line.sha256 for line in read_journal(tmp_path).frames] == [record.sha256 for record in records]
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
    assert len(read_journal(tmp_path).frames) == len(list((tmp_path / "frames").iterdir())) == 2


def test_cancel(rig, log, tmp_path):
    cancel = threading.Event()
    rig.camera.on_grab = lambda: cancel.set() if log.count("grab") == 3 else None
    with pytest.raises(RigError, match="cancelled after 3 frames"):
        run_plan(PLAN, rig, tmp_path, cancel=cancel)
    dark = log.index("light off", log.index("light on"))
    assert log[dark - 1] == "stop"
    assert set(log[dark + 1 :]) <= {"stop"}  # which is repeated until all is over


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
        ({"zero_deg": 0.4}, 0.0),
        ({"zero_deg": 1.0}, 0.0),
        ({"zero_deg": 10.0}, 351.0),
        ({"zero_deg": 10.0, "turns": "cw"}, 90.0),
    ],
)
def test_an_angle_that_cannot_be_reached_from_below(rig, log, tmp_path, stage, angle):
    if stage["zero_deg"] > 0.4:
        rig.stage.limits_deg = (0.0, 350.0)
    rig = Rig(rig.stage, rig.camera, rig.light, rig_file(**stage))
    with pytest.raises(RigFileError, match=r"stage\.zero_deg"):
        run_plan(Plan(poses=(Pose(angle),), exposure_s=0.01), rig, tmp_path)
    assert log == []


@pytest.mark.parametrize(
    ("stage", "moves"),
    [
        ({"zero_deg": 0.0}, ["move 360", "move 88", "move 90"]),
        ({"zero_deg": 396.99988}, ["move 36.9999", "move 127"]),
        ({"zero_deg": 181.0, "turns": "cw"}, ["move 181", "move 89", "move 91"]),
        ({"zero_deg": 271.0}, ["move 271", "move 0", "move 1"]),
        ({"zero_deg": 359.9}, ["move 359.9", "move 87.9", "move 89.9"]),
    ],
)
def test_readings_of_a_stage_that_turns_round_wrap(rig, log, tmp_path, stage, moves):
    rig = Rig(rig.stage, rig.camera, rig.light, rig_file(**stage))
    plan = Plan(poses=(Pose(0.0), Pose(90.0)), exposure_s=0.01, return_to_first=False)
    records = run_plan(plan, rig, tmp_path)
    assert [line for line in log if line.startswith("move")] == moves
    taken = [record.frame.stage_deg for record in records if record.frame.kind == "sample"]
    assert taken == pytest.approx([0.0, 90.0], abs=0.002)


def test_counts_above_full_scale_are_refused_live(rig, log, tmp_path, monkeypatch):
    monkeypatch.setattr(rig.camera, "grab", lambda: np.full((2, 3), 4096, dtype=np.uint16))
    with pytest.raises(CameraError, match="fake: counts reach 4096, above the 4095 of 12 bits"):
        run_plan(PLAN, rig, tmp_path)
    assert log[-1] == "light off"


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
    monkeypatch.setattr(opening, "atexit", SimpleNamespace(register=nets.append, unregister=nets.remove))
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
    assert "Switch the light on and press Enter" in capsys.readouterr().err
    monkeypatch.setattr("sys.stdin", SimpleNamespace(readline=lambda: ""))
    with pytest.raises(RigError, match="nobody answered the request 'Switch the light off'"):
        open_manual().off()  # a dark frame in the light would be taken for a dark one


TILTED = Plan(poses=(Pose(0.0), Pose(90.0), Pose(0.0, 10.0), Pose(90.0, 10.0)), exposure_s=0.02)


@pytest.fixture
def tilted(log):
    """A rig whose arm is tilted by an axis of its own."""
    file = rig_file().model_copy(update={"tilt": TiltPart(driver="fake", zero_deg=30.0, sign=-1)})
    tilt = FakeStage([])
    return Rig(FakeStage(log), FakeCamera(log), FakeLight(log), file, tilt)


def test_every_tilt_is_visited_once_and_the_first_pose_again(tilted, log, tmp_path):
    records = run_plan(TILTED, tilted, tmp_path)
    assert tilted.tilt.log == ["home", "move 30", "move 18", "move 20", "move 30"]
    lit = records[1:]
    assert [(r.pose.stage_deg, r.pose.tilt_deg, r.again) for r in lit] == [
        *((stage, tilt, False) for tilt in (0.0, 10.0) for stage in (0.0, 90.0)),
        (0.0, 0.0, True),
    ]
    # as read back: the fake stops 0.001° late, and a growing reading lowers this tilt
    assert [r.frame.tilt_deg for r in lit] == pytest.approx([-0.001, -0.001, 9.999, 9.999, -0.001])
    assert lit[2].path.name == "003_sample_0000.00_tilt+10.00.tif"
    assert log.count("home") == 1


def test_a_tilt_out_of_reach(tilted, log, tmp_path):
    with pytest.raises(RigFileError, match=r"a tilt of 29° needs the tilt at 1° .*choose tilt\.zero_deg"):
        run_plan(Plan(poses=(Pose(0.0, 29.0),), exposure_s=0.01), tilted, tmp_path)
    assert log == tilted.tilt.log == []


def test_both_axes_are_stopped(tilted, tmp_path):
    tilted.camera.on_grab = lambda: 1 / 0
    with pytest.raises(ZeroDivisionError):
        run_plan(TILTED, tilted, tmp_path)
    assert tilted.stage.log[-2:] == ["stop", "light off"]
    assert tilted.tilt.log[-1] == "stop"


def interrupted(rig, tmp_path, plan, after):
    """Run a plan until so many frames were asked for."""
    grabs = []

    def fail():
        grabs.append(1)
        if len(grabs) > after:
            raise CameraError("no frame")

    rig.camera.on_grab = fail
    with pytest.raises(CameraError, match="no frame"):
        run_plan(plan, rig, tmp_path)
    rig.camera.on_grab = lambda: None


@pytest.mark.parametrize("after", range(5))
def test_a_plan_is_taken_up_where_it_stopped(rig, log, tmp_path, after):
    interrupted(rig, tmp_path, PLAN, after)
    before = read_journal(tmp_path)
    assert len(before.frames) == after
    rig.stage.is_homed = True
    log.clear()
    records = run_plan(PLAN, rig, tmp_path)
    assert log[0] == "home"  # anew, whatever the stage believes
    assert log[-1] == "light off"
    journal = read_journal(tmp_path)
    assert set(journal.by_step) == set(range(5))
    assert [line.run for line in journal.frames] == [0] * after + [1] * len(records)
    assert [record.step is None for record in records].count(True) == (after == 3)
    for line in journal.frames:
        assert sha256_of(tmp_path / line.name) == line.sha256
    kept = {line.step for line in before.frames} - {record.step for record in records}
    assert kept == {0: set(), 1: set(), 2: {0, 1}, 3: {0, 1, 2}, 4: {0, 1, 2, 3}}[after]


def test_a_camera_that_exposes_otherwise_makes_dark_frames_useless(rig, tmp_path):
    interrupted(rig, tmp_path, PLAN, after=2)
    rig.camera.configure = CameraSettings
    assert [record.step for record in run_plan(PLAN, rig, tmp_path)] == [0, 1, 2, 3, 4]


def test_a_camera_that_exposes_otherwise_cannot_go_on_with_lit_frames(rig, log, tmp_path):
    interrupted(rig, tmp_path, PLAN, after=3)
    rig.camera.configure = CameraSettings
    with pytest.raises(CameraError, match=r"now exposes for 0\.02 s .* but for 0\.0202 s"):
        run_plan(PLAN, rig, tmp_path)
    assert log[-1] == "light off"


class Waiting(FakeStage):
    """A stage whose moves last until it is stopped."""

    def __init__(self, log):
        super().__init__(log)
        self.stopped = threading.Event()
        self.moving = threading.Event()

    def move_to(self, angle_deg):
        self.moving.set()
        assert self.stopped.wait(60), "nobody stopped the stage"
        raise RigError("the move was stopped")

    def stop(self):
        super().stop()
        self.stopped.set()


def in_background(action):
    """Run an action in a thread; returns the thread and the list of what it raised."""
    raised = []

    def work():
        try:
            action()
        except BaseException as error:  # noqa: BLE001 - the test looks at it
            raised.append(error)

    thread = threading.Thread(target=work)
    thread.start()
    return thread, raised


def test_a_cancel_stops_a_move_at_once(rig, log, tmp_path):
    rig = Rig(Waiting(log), rig.camera, rig.light, rig.file)
    cancel = threading.Event()
    thread, raised = in_background(lambda: run_plan(PLAN, rig, tmp_path, cancel=cancel))
    assert rig.stage.moving.wait(60)
    cancel.set()
    thread.join(60)
    assert str(raised[0]) == "the acquisition was cancelled after 2 frames"
    assert log[-1] == "light off"


def test_a_cancel_ends_a_long_pause(rig, log, tmp_path):
    cancel = threading.Event()
    plan = Plan(poses=(Pose(0.0),), exposure_s=0.02, settle_s=1000.0)
    told = []

    def tell(now):
        told.append(now.text)
        if now.text.startswith("turning"):
            cancel.set()

    thread, raised = in_background(lambda: run_plan(plan, rig, tmp_path, tell, cancel=cancel))
    thread.join(60)
    assert "cancelled after 1 frames" in str(raised[0])
    assert "stop" in log


def test_a_cancel_stops_the_stage_while_the_camera_exposes(rig, log, tmp_path):
    cancel = threading.Event()
    stopped = []

    def expose():
        cancel.set()
        deadline = time.monotonic() + 60
        while "stop" not in log and time.monotonic() < deadline:
            time.sleep(0.005)
        stopped.append("stop" in log)

    rig.camera.on_grab = expose
    with pytest.raises(RigError, match="cancelled after 1 frames"):  # the frame that was exposed is kept
        run_plan(PLAN, rig, tmp_path, cancel=cancel)
    assert stopped == [True]
    assert len(read_journal(tmp_path).frames) == 1


def test_a_full_disk_ends_a_move_at_once(rig, log, tmp_path, monkeypatch):
    rig = Rig(Waiting(log), rig.camera, rig.light, rig.file)

    def fail(frame, path, packing):
        assert rig.stage.moving.wait(60)
        raise RecordError("no space left")

    monkeypatch.setattr(writer, "write_frame", fail)
    with pytest.raises(RecordError, match="no space left"):
        run_plan(Plan(poses=(Pose(0.0),), exposure_s=0.02), rig, tmp_path)
    assert log[-1] == "light off"
    assert read_journal(tmp_path).frames == ()


def test_frames_already_taken_are_written_when_a_run_breaks_off(rig, tmp_path, monkeypatch):
    slow = threading.Event()
    really = writer.write_frame

    def write_late(frame, path, packing):
        slow.wait(0.2)
        really(frame, path, packing)

    monkeypatch.setattr(writer, "write_frame", write_late)
    interrupted(rig, tmp_path, PLAN, after=4)
    assert len(read_journal(tmp_path).frames) == 4


def test_a_camera_may_fill_its_memory_again(rig, tmp_path):
    memory = np.zeros((2, 3), np.uint16)

    def grab():
        memory[:] += 1
        return memory

    rig.camera.grab = grab
    records = run_plan(PLAN, rig, tmp_path)
    assert [int(read_frame(record.path).counts[0, 0]) for record in records] == [1, 2, 3, 4, 5]


def test_a_bracket_sets_each_exposure_and_frames_tell_what_the_camera_made_of_it(rig, tmp_path):
    plan = Plan(poses=(Pose(0.0),), exposure_s=0.01, brackets=(4.0,), return_to_first=False)
    records = run_plan(plan, rig, tmp_path)
    assert [record.frame.exposure_s for record in records] == pytest.approx([0.0101, 0.0404] * 2)
    lines = read_journal(tmp_path).frames
    assert [line.exposure_s for line in lines] == [record.frame.exposure_s for record in records]
    assert run_plan(plan, rig, tmp_path) == []  # all of it is there


def test_exposures_that_are_one_to_the_camera(rig, log, tmp_path, monkeypatch):
    steps = lambda _self, exposure_s, gain: CameraSettings(2.0 ** np.floor(np.log2(exposure_s)), gain)  # noqa: E731
    monkeypatch.setattr(FakeCamera, "configure", steps)
    plan = Plan(poses=(Pose(0.0),), exposure_s=0.01, brackets=(1.5,))
    with pytest.raises(CameraError, match=r"0\.01 s and 0\.015 s both as 0\.0078125 s: choose other"):
        run_plan(plan, rig, tmp_path)
    assert log[-2:] == ["stop", "light off"]
