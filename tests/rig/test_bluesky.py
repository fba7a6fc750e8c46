"""Stage, tilt, camera and light in plans of Bluesky: what they do to the rig, and documents that event-model takes."""

from collections import defaultdict

import numpy as np
import pytest
import tomli_w

from anisoscope.base.errors import CameraError, LimitExceeded, RigError
from anisoscope.rig.acquisition.opening import open_rig
from anisoscope.rig.rigfile import read_rig

pytest.importorskip("ophyd_async", reason="pip install 'anisoscope[bluesky]'")

import event_model
from bluesky import RunEngine
from bluesky.plan_stubs import mv, rd, stop
from bluesky.plans import count, grid_scan
from bluesky.protocols import Locatable, Movable, Readable, Stoppable, Triggerable, check_supports
from bluesky.utils import FailedStatus

from anisoscope.rig.bluesky import devices_of
from anisoscope.sim.bench.bench import shared_bench

BENCH = {
    "schema": 1,
    "sample": {"kind": "white-tile"},
    "sensor": {"rows": 64, "cols": 80},
    "optics": {"vignetting": 0.0, "lamp_noise": 0.0},
    "stage": {"time_scale": 0.0},
    "tilt": {"zero_deg": 30.0},
}
STAGE = {"driver": "elliptec", "port": "sim://elliptec?bench=${here}/bench.toml"}
BY_BENCH = {"driver": "simulated", "options": {"bench": "${here}/bench.toml"}}
RIG = {
    "schema": 1,
    "name": "bench",
    "stage": {**STAGE, "zero_deg": 10.0, "options": {"move_gap_s": 0.0}},
    "tilt": {**STAGE, "zero_deg": 30.0, "options": {"address": "1", "move_gap_s": 0.0}},
    "camera": {**BY_BENCH, "pixel_um": 4.0},
    "light": BY_BENCH,
}


@pytest.fixture(scope="module")
def engine():
    """A run engine for all plans of this module, and the documents that they emit, by run."""
    engine, documents = RunEngine({}), []

    def keep(name, document):
        event_model.schema_validators[event_model.DocumentNames[name]].validate(document)
        documents.append((name, document))

    engine.subscribe(keep)
    yield engine, documents
    engine.loop.call_soon_threadsafe(engine.loop.stop)


@pytest.fixture
def lab(tmp_path, engine):
    """(run, devices, open rig): ``run(plan)`` gives its documents by name."""
    (tmp_path / "bench.toml").write_text(tomli_w.dumps(BENCH), encoding="utf-8")
    (tmp_path / "rig.toml").write_text(tomli_w.dumps(RIG), encoding="utf-8")
    with open_rig(read_rig(tmp_path / "rig.toml")) as rig:
        for axis in rig.axes:
            axis.home()

        def run(plan):
            engine[1].clear()
            engine[0](plan)
            found = defaultdict(list)
            for name, document in engine[1]:
                found[name].append(document)
            return found

        yield run, devices_of(rig, exposure_s=0.002), rig


def test_the_devices_are_what_plans_ask_for(lab):
    _, devices, _ = lab
    for name, protocols in {
        "stage": (Movable, Locatable, Stoppable, Readable),
        "tilt": (Movable, Locatable, Stoppable, Readable),
        "camera": (Triggerable, Readable),
        "light": (Movable, Readable),
    }.items():
        for protocol in protocols:
            check_supports(devices[name], protocol)


def test_a_camera_is_counted_in_valid_documents(lab):
    run, devices, rig = lab
    run(mv(devices["light"], True))
    found = run(count([devices["camera"]], num=3))
    assert [document["exit_status"] for document in found["stop"]] == ["success"]
    (descriptor,) = found["descriptor"]
    key = descriptor["data_keys"]["camera"]
    assert (key["shape"], key["dtype_numpy"], key["units"]) == ([64, 80], "<u2", "counts")
    settings = descriptor["configuration"]["camera"]
    assert settings["data"]["camera_exposure"] == 0.002
    assert settings["data_keys"]["camera_exposure"]["units"] == "s"
    events = found["event"]
    assert len(events) == 3
    lit = np.mean([event["data"]["camera"] for event in events])
    assert lit > rig.camera.info.black_level + 100.0
    run(mv(devices["light"], False))
    (dark,) = run(count([devices["camera"]]))["event"]
    assert np.mean(dark["data"]["camera"]) == pytest.approx(rig.camera.info.black_level, abs=2.0)


def test_a_scan_of_tilt_and_rotation_visits_every_pose_with_its_unit(lab):
    run, devices, rig = lab
    angles, tilts = (0.0, 90.0, 180.0), (0.0, 12.0)
    run(mv(devices["light"], True))
    found = run(
        grid_scan(
            [devices["camera"], devices["light"]],
            *(devices["tilt"], tilts[0], tilts[-1], len(tilts)),
            *(devices["stage"], angles[0], angles[-1], len(angles)),
        )
    )
    poses = [(event["data"]["tilt"], event["data"]["stage"]) for event in found["event"]]
    np.testing.assert_allclose(poses, [(tilt, angle) for tilt in tilts for angle in angles], atol=0.01)
    keys = found["descriptor"][0]["data_keys"]
    assert {keys[name]["units"] for name in ("stage", "tilt")} == {"deg"}
    assert keys["stage"]["source"].startswith("anisoscope:ELL14 ")
    assert all(event["data"]["light"] for event in found["event"])
    assert rig.stage.position_deg() == pytest.approx(190.0, abs=0.01), (
        "the reading, where the sample is at 180°"
    )


def test_a_plan_stops_an_axis(lab, tmp_path):
    run, devices, _ = lab
    stage, tilt = shared_bench(tmp_path / "bench.toml").device("elliptec").devices
    run(stop(devices["stage"]))
    assert (stage.stops, tilt.stops) == (1, 0)


def test_what_a_device_refuses_ends_the_plan_with_its_own_error(lab):
    run, devices, rig = lab
    before = rig.stage.position_deg()
    with pytest.raises(FailedStatus) as failed:
        run(mv(devices["stage"], 350.2))
    assert isinstance(failed.value.__cause__, LimitExceeded)
    assert "-1.8° is outside 0°…360°; nothing was moved" in str(failed.value.__cause__)
    assert rig.stage.position_deg() == before
    for name, kind in {"camera": CameraError, "light": RigError}.items():
        with pytest.raises(kind, match="was read before"):
            run(rd(devices[name]))
