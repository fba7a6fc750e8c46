"""An axis that somebody sets by hand."""

import io
import subprocess
import sys

import pytest

from anisoscope.base.errors import LimitExceeded, NotConnected, RigError
from anisoscope.rig.drivers import open_stage
from anisoscope.rig.stage import RotationStage
from anisoscope.rig.stages.manual import ManualStage, prompt_in_terminal


@pytest.fixture
def asked():
    return []


@pytest.fixture
def stage(asked):
    return ManualStage(label="tilt", min_deg=-60, max_deg=60, prompt=asked.append)


def test_it_is_a_stage_that_asks_only_when_needed(stage, asked):
    assert isinstance(stage, RotationStage)
    assert not stage.is_homed
    assert stage.home() == 0.0
    assert stage.is_homed
    assert [stage.move_to(10.0), stage.move_to(10), stage.move_by(-15.0)] == [10.0, 10.0, -5.0]
    assert stage.position_deg() == -5.0
    assert asked == ["set the tilt to 0°", "set the tilt to 10°", "set the tilt to -5°"]
    stage.stop()
    stage.close()
    stage.close()
    assert not stage.is_homed


def test_nothing_is_guessed(stage, asked):
    with pytest.raises(RigError, match="nobody has set the tilt yet"):
        stage.position_deg()
    for wrong in (60.1, float("nan")):
        with pytest.raises(LimitExceeded, match="outside"):
            stage.move_to(wrong)
    assert asked == []
    stage.home()

    def refuse(_request):
        raise RigError("no")

    stage._prompt = refuse
    with pytest.raises(RigError):
        stage.move_to(20.0)
    with pytest.raises(RigError, match="nobody has set"):  # neither 0° nor 20° is known to be true
        stage.position_deg()


def test_zero_may_be_out_of_reach(asked):
    assert ManualStage(min_deg=5.0, max_deg=50.0, prompt=asked.append).home() == 5.0


def test_the_question_in_the_terminal(monkeypatch, capsys):
    monkeypatch.setattr(sys, "stdin", io.StringIO("\n"))
    prompt_in_terminal("set the tilt to 10°")
    assert capsys.readouterr().err == "set the tilt to 10° and press Enter: "
    with pytest.raises(RigError, match="nobody answered the request 'set the tilt to 10°'"):
        prompt_in_terminal("set the tilt to 10°")


def test_without_a_terminal_it_does_not_open():
    code = "from anisoscope.rig.drivers import open_stage; open_stage('manual', table='tilt', label='tilt')"
    done = subprocess.run(
        [sys.executable, "-Ic", code], stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False
    )
    assert "NotConnected: the tilt is set by hand, and there is no terminal to ask in" in done.stderr


def test_no_stdin_at_all(monkeypatch):
    monkeypatch.setattr(sys, "stdin", None)
    with pytest.raises(NotConnected, match="no terminal"):
        open_stage("manual", port=None)
