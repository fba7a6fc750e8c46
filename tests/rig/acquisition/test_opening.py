"""Leaving a rig: safe, told, and not to be hurried."""

import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from anisoscope.base.errors import NotConnected, RigError, RigFileError
from anisoscope.rig.acquisition.interruptions import undisturbed
from anisoscope.rig.acquisition.opening import open_devices, open_rig
from anisoscope.rig.rigfile import CameraPart, LightPart, RigFile, StagePart, TiltPart
from anisoscope.sim.bench.bench import shared_bench

BENCH = 'schema = 1\n[stage]\ntime_scale = 0.0\n[tilt]\naddress = "1"\n'


@pytest.fixture
def file(tmp_path):
    """A rig on a bench; nothing of it is rendered."""
    bench = tmp_path / "bench.toml"
    bench.write_text(BENCH)
    port, options = f"sim://elliptec?bench={bench}", {"bench": str(bench)}
    return RigFile(
        schema=1,
        name="bench",
        stage=StagePart(driver="elliptec", port=port, zero_deg=10.0),
        tilt=TiltPart(driver="elliptec", port=port, options={"address": "1"}),
        camera=CameraPart(driver="simulated", pixel_um=4.0, options=options),
        light=LightPart(driver="simulated", options=options),
    )


def test_an_interruption_is_told_what_became_of_the_rig(file):
    with pytest.raises(KeyboardInterrupt) as caught, open_rig(file):
        raise KeyboardInterrupt
    assert caught.value.__notes__ == ["stage and tilt are stopped and the light is off"]


def test_an_error_speaks_for_itself(file):
    with pytest.raises(RigError) as caught, open_rig(file):
        raise RigError("it burns")
    assert not hasattr(caught.value, "__notes__")


def test_a_device_that_does_not_obey_is_named(file, monkeypatch):
    def fail():
        raise NotConnected("the lamp is gone")

    with pytest.raises(KeyboardInterrupt) as caught, open_rig(file) as rig:
        monkeypatch.setattr(rig.light, "off", fail)
        raise KeyboardInterrupt
    assert caught.value.__notes__ == ["the light was not switched off: the lamp is gone"]


IMPATIENT = """
import os, signal
from anisoscope.rig.acquisition.opening import Rig

class Device:
    name = "stage"

    def stop(self):
        os.kill(os.getpid(), signal.SIGINT)
        print("stop")

    def off(self):
        print("off")

try:
    Rig(Device(), None, Device(), None).make_safe()
except KeyboardInterrupt:
    print("interrupted", signal.getsignal(signal.SIGINT) is signal.default_int_handler)
"""


def test_an_impatient_ctrl_c_waits_until_the_light_is_off():
    done = subprocess.run([sys.executable, "-Ic", IMPATIENT], capture_output=True, text=True, check=False)
    assert done.stdout.split("\n")[:3] == ["stop", "off", "interrupted True"], done.stderr


def test_in_other_threads_signals_are_left_alone():
    before = signal.getsignal(signal.SIGTERM)
    seen = []

    def work():
        with undisturbed():
            seen.append(signal.getsignal(signal.SIGTERM))

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert seen == [before]


def test_drivers_of_both_axes_are_named_by_their_tables(file):
    wrong = file.model_copy(update={"tilt": TiltPart(driver="laser")})
    with (
        pytest.raises(RigFileError, match=r"tilt\.driver: there is no stage driver 'laser'"),
        open_rig(wrong),
    ):
        pass
    wrong = file.model_copy(update={"tilt": TiltPart(driver="elliptec")})
    needs = r"tilt\.port: missing; the driver 'elliptec' needs one"
    with pytest.raises(RigFileError, match=needs), open_rig(wrong):
        pass
    with open_rig(file.model_copy(update={"tilt": None})) as rig:  # the first axis was let go each time
        assert rig.tilt is None


def test_a_tilt_by_hand_without_a_terminal_is_an_error(file, monkeypatch):
    by_hand = file.model_copy(update={"tilt": TiltPart(driver="manual")})
    with Path(os.devnull).open() as nothing:
        monkeypatch.setattr("sys.stdin", nothing)
        told = "the tilt is set by hand, and there is no terminal"
        with pytest.raises(NotConnected, match=told), open_rig(by_hand):
            pass


def test_some_devices_alone_are_left_as_all_of_them(file):
    bench = shared_bench(file.camera.options["bench"])
    with open_devices({}, file.camera, file.light) as found:
        assert (found.axes, found.safe) == ({}, "the light is off")
        found.light.on()
        assert bench.light_on
    assert not bench.light_on
    with open_devices({"tilt": file.tilt}) as found:
        assert (found.camera, found.light, found.safe) == (None, None, "the tilt is stopped")
        assert found.make_safe() == ()


def test_nobody_is_asked_to_switch_a_lamp_off_where_a_rig_is_left(capsys):
    with open_devices({}, light=LightPart()) as found:
        assert found.safe == ""
    assert capsys.readouterr().err == ""
