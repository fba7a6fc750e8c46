"""The same cases for every driver: what a user may rely on, whatever stage stands on the rig."""

import json
import re
import subprocess
import threading
import time

import pytest

from anisoscope.base.errors import (
    LimitExceeded,
    MotionTimeout,
    NotConnected,
    NotHomed,
    ProtocolError,
    RigError,
    Stalled,
)
from anisoscope.base.plugins import installed
from anisoscope.rig import portholder
from anisoscope.rig.drivers import STAGES
from anisoscope.rig.stage import RotationStage
from anisoscope.sim.bench.firmware import catalogue
from anisoscope.sim.bench.firmware.faults import FaultKind
from anisoscope.sim.bench.serve import PtyServer

ACTION = r"; (calibrate|check|correct|find|home|let|look|lower|remove|send|unpark|wait)\b"
"""What every error ends with: what to do."""
PATIENT_S = 5.0
"""For an answer that surely comes, from a server's thread that may have to wait for its turn."""


def half_step(stage):
    return 0.5 * stage.resolution_deg + 1e-9


def test_every_simulated_stage_has_a_driver_and_a_case(request):
    cases = {item.callspec.params["case"].protocol for item in request.session.items if has_case(item)}
    assert set(catalogue.STAGES) <= set(installed(STAGES))
    assert cases == set(catalogue.STAGES)


def has_case(item):
    return hasattr(item, "callspec") and hasattr(item.callspec.params.get("case"), "protocol")


def test_every_fault_that_a_device_can_have_is_in_the_table(case):
    possible = set(FaultKind) - case.firmware().IMPOSSIBLE
    assert {fault.partition(":")[0] for fault in case.faults} == {str(kind) for kind in possible}


def test_a_day_in_the_life(served, case, clock):
    firmware = case.firmware("split", "unsolicited", "garbage", clock=clock)
    with case.open(served(firmware), timeout_s=PATIENT_S) as stage:
        assert isinstance(stage, RotationStage)
        assert stage.name == case.stage["name"]
        assert list(stage.limits_deg) == case.stage["limits_deg"]
        assert not stage.is_homed
        assert stage.home() == pytest.approx(0.0, abs=half_step(stage))
        assert stage.is_homed
        assert stage.move_to(90.0) == pytest.approx(90.0, abs=half_step(stage))
        assert stage.move_by(-30.0) == pytest.approx(60.0, abs=2 * half_step(stage))
        assert stage.position_deg() == pytest.approx(firmware.axis.position(), abs=2 * half_step(stage))
    assert not stage.is_homed


def test_clients_come_and_go(served, case, clock):
    port = served(case.firmware(clock=clock))
    for again in range(2):
        with case.open(port) as stage:
            assert stage.is_homed == (bool(again) and case.stage["remembers_its_reference"])
            assert stage.home() == pytest.approx(0.0, abs=half_step(stage))


@pytest.mark.parametrize("angle", [10.0, 0.001, 359.9999, 123.4567])
def test_angles_are_rounded_to_counts(in_process, case, angle, clock):
    with case.open(in_process(case.firmware(clock=clock))) as stage:
        stage.home()
        assert stage.move_to(angle) == pytest.approx(angle, abs=half_step(stage))


@pytest.mark.parametrize("beyond", [-0.1, 0.1, float("nan"), float("inf")])
def test_limits_are_checked_before_anything_moves(in_process, case, beyond, clock):
    firmware = case.firmware(clock=clock)
    with case.open(in_process(firmware)) as stage:
        stage.home()
        sent = firmware.taken
        low, high = stage.limits_deg
        with pytest.raises(LimitExceeded):
            stage.move_to(low + beyond if beyond < 0.0 else high + beyond)
        assert firmware.taken == sent


def test_own_limits(in_process, case, clock):
    with case.open(in_process(case.firmware(clock=clock)), min_deg=5.0, max_deg=20.0) as stage:
        stage.home()
        with pytest.raises(LimitExceeded, match="5°…20°"):
            stage.move_to(21.0)


def test_no_absolute_move_before_homing(in_process, case, clock):
    firmware = case.firmware(clock=clock)
    with case.open(in_process(firmware)) as stage:
        with pytest.raises(NotHomed):
            stage.move_to(10.0)
        with pytest.raises(NotHomed):
            stage.move_by(10.0)
    assert firmware.axis.position() == 0.0
    assert not firmware.axis.busy()


def test_a_fault_ends_in_its_error_within_its_time(served, case, fault, clock):
    firmware = case.firmware(fault, time_scale=0.02, clock=clock)
    port = served(firmware)
    threads = set(threading.enumerate())
    expected = case.error_of(fault)
    if expected is None:
        with case.open(port, timeout_s=PATIENT_S) as stage:
            stage.home()
            assert stage.move_to(90.0) == pytest.approx(90.0, abs=stage.rules.tolerance_deg + 1e-9)
        return
    error, pattern = expected
    patience = {} if error in {NotConnected, ProtocolError} else {"timeout_s": PATIENT_S}
    start, limit_s = clock(), 60.0
    with pytest.raises(error, match=pattern) as caught, case.open(port, **patience) as stage:
        limit_s += 3.0 * stage.rules.timeout_s(360.0)
        stage.home()
        stage.move_to(90.0)
        stage.move_to(100.0)
    assert "\n" not in str(caught.value)
    assert re.search(ACTION, str(caught.value))
    assert clock() - start < limit_s
    if error in {MotionTimeout, Stalled}:
        assert firmware.stops > 0
    assert not firmware.axis.busy() or error is NotConnected
    assert set(threading.enumerate()) <= threads


def test_a_reading_without_reference_is_an_error(in_process, case, clock):
    with case.open(in_process(case.firmware("lost-homing", time_scale=0.0, clock=clock))) as stage:
        stage.home()
        with pytest.raises(NotHomed, match="home it again"):  # at the latest with the reading after the move
            assert stage.move_to(90.0) == pytest.approx(90.0, abs=half_step(stage))
            stage.position_deg()
        assert not stage.is_homed


def test_after_a_fault_the_next_connection_works(in_process, case, fault, clock):
    firmware = case.firmware(fault, time_scale=0.02, clock=clock)
    port = in_process(firmware)
    if case.error_of(fault) is not None:
        with pytest.raises(RigError), case.open(port) as stage:
            stage.home()
            stage.move_to(90.0)
            stage.move_to(100.0)
    firmware.clear_faults()
    with case.open(port) as stage:
        stage.home()
        assert stage.move_to(90.0) == pytest.approx(90.0, abs=half_step(stage))


def test_stop_from_another_thread_ends_the_move(served, case, when_it_turns):
    firmware = case.firmware(time_scale=case.stage.get("unhurried", 5.0))
    with case.open(served(firmware), margin_s=5.0, timeout_s=PATIENT_S) as stage:
        stage.home()
        stopper = when_it_turns(firmware, stage.stop)
        with pytest.raises(RigError, match="was stopped at"):
            stage.move_to(180.0)
        stopper.join()
        assert 0.0 < stage.position_deg() < 180.0
        assert not firmware.axis.busy()


def test_a_second_move_at_the_same_time_is_refused(in_process, case):
    slowed = case.firmware(time_scale=case.stage.get("unhurried", 2.0))
    with case.open(in_process(slowed), margin_s=5.0) as stage:
        stage.home()
        mover = threading.Thread(target=stage.move_to, args=(20.0,))
        mover.start()
        while not slowed.axis.busy():
            assert mover.is_alive()
            time.sleep(0.001)
        with pytest.raises(RigError, match="moving already"):
            stage.move_to(30.0)
        mover.join()
        assert stage.position_deg() == pytest.approx(20.0, abs=half_step(stage))


def test_an_interrupt_stops_the_stage(in_process, case, monkeypatch):
    firmware = case.firmware(time_scale=20.0)
    with case.open(in_process(firmware)) as stage:
        stage.home()
        before = firmware.stops

        def interrupt(_wait_s):
            raise KeyboardInterrupt

        with monkeypatch.context() as patch:
            patch.setattr(stage, "_is_busy", interrupt)
            with pytest.raises(KeyboardInterrupt):
                stage.move_to(180.0)
        assert firmware.stops > before
        assert not firmware.axis.busy()


def test_stop_at_rest_and_closing_twice_are_harmless(in_process, case, clock):
    stage = case.open(in_process(case.firmware(clock=clock)))
    stage.stop()
    assert stage.home() == pytest.approx(0.0, abs=half_step(stage))
    stage.close()
    stage.close()
    with pytest.raises(NotConnected):
        stage.position_deg()


def test_an_axis_that_a_killed_process_left_moving_is_stopped_first(case, tmp_path, monkeypatch):
    """The note of a port outlives the process that did not close it."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    firmware = case.firmware(time_scale=case.stage.get("unhurried", 5.0))
    with PtyServer(firmware) as server:
        stage = case.open(server.url, margin_s=5.0, timeout_s=PATIENT_S)
        stage.home()
        stage._begin_move(300.0)
        stage._transport.close()
        note = portholder.claim(server.port)
        ended = subprocess.Popen(["true"])
        ended.wait()
        note.write_text(json.dumps(json.loads(note.read_text()) | {"pid": ended.pid}))
        assert firmware.axis.busy()
        with case.open(server.url, margin_s=5.0, timeout_s=PATIENT_S) as again:
            assert not firmware.axis.busy()
            assert 0.0 <= firmware.axis.position() < 300.0
            assert again.position_deg() < 300.0


def test_only_one_program_may_hold_a_port(in_process, case, clock):
    port = in_process(case.firmware(clock=clock))
    with case.open(port), pytest.raises(NotConnected, match="in use"):
        case.open(port)
