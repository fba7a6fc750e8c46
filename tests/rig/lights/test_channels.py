"""Light channels: the LED controller and the filter wheel against their firmware, and rig files with channels."""

import contextlib

import pytest

from anisoscope.base.clock import VirtualClock
from anisoscope.base.errors import NotConnected, ProtocolError, RigError, RigFileError
from anisoscope.rig import portholder
from anisoscope.rig.acquisition.opening import open_lamp
from anisoscope.rig.drivers import open_light, open_wheel
from anisoscope.rig.hold import HeldLight, Owner, key_of
from anisoscope.rig.light import Channel, ChannelLight, FilterWheel, LampController
from anisoscope.rig.lights.coolled import CoolLed
from anisoscope.rig.lights.fw102c import ThorlabsWheel
from anisoscope.rig.rigfile import ChannelPart, LightPart, WheelPart, read_replay_rig, read_rig
from anisoscope.sim.bench.firmware.coolled import CoolLedFirmware
from anisoscope.sim.bench.firmware.faults import FaultKind
from anisoscope.sim.bench.firmware.fw102c import WheelFirmware
from anisoscope.sim.bench.serialports import protocol_sim
from anisoscope.sim.bench.serve import PtyServer

LAMP_FAULTS = {
    "silent": (NotConnected, "silent"),
    "babble": (ProtocolError, "no answer of a CoolLED controller"),
    "garbage": None,
    "split": None,
    "unsolicited": None,
    "joined": None,
    "motion-error": (RigError, "lamp B shines at 0 % instead of 40 %"),
    "hangup": (NotConnected, "lost"),
    "stall:25": (RigError, "lamp B shines at 25 % instead of 40 %"),
    "lost-homing": (RigError, "lamp B shines at 0 % instead of 40 %"),
    "lost-reply": (NotConnected, "silent"),
}
WHEEL_FAULTS = {
    "silent": (NotConnected, "silent"),
    "babble": (ProtocolError, "no answer of a filter wheel"),
    "garbage": None,
    "split": None,
    "motion-error": (RigError, "refuses pos=4: CMD_ARG_INVALID"),
    "hangup": (NotConnected, "lost"),
    "stall": (RigError, "sent to place 4 and stands at 1"),
    "overshoot:1": (RigError, "sent to place 4 and stands at 5"),
    "slow": (NotConnected, "silent"),
    "lost-homing": (RigError, "sent to place 4 and stands at 1"),
    "lost-reply": None,
}


@pytest.fixture
def served(monkeypatch):
    """``served(name=firmware)``: what answers behind ``sim://name``."""
    firmware = {}
    monkeypatch.setattr(protocol_sim, "device_of_url", lambda url: firmware[url.removeprefix("sim://")])
    return firmware.update


def test_several_lamps_shine_at_their_levels_and_no_other(served):
    firmware = CoolLedFirmware(model="pE-4000", clock=VirtualClock())
    served(coolled=firmware)
    light = open_light("coolled", port="sim://coolled", level_percent=70)
    assert isinstance(light, LampController)
    assert (light.name, light.lamps) == ("light CoolLED pE-4000", ("A", "B", "C", "D"))

    def levels():
        return [firmware.lamps[letter].level for letter in "ABCD"]

    light.on()
    assert levels() == [0.7] * 4
    light.select({"B": 40, "D": 5})
    light.on()
    assert levels() == [0.0, 0.4, 0.0, 0.05]
    assert list(firmware.commands)[-2:] == [b"CSSASF000BSN040CSF000DSN005", b"CSS?"]
    light.off()
    assert levels() == [0.0] * 4
    for wrong, words in (
        ({"E": 10}, "no lamp 'E'; its lamps are A, B, C, D"),
        ({"A": 0}, "between 1 and 100, not 0"),
    ):
        with pytest.raises(RigError, match=words):
            light.select(wrong)
    light.on()
    light.close()
    light.close()
    assert levels() == [0.0] * 4


def test_a_lamp_whose_switch_the_pod_has_is_lit_all_the_same_and_the_greeting_is_no_answer(served):
    """Selected by us; the maker's client and others end their lines in CR, and in LF."""
    firmware = CoolLedFirmware(clock=VirtualClock())
    served(coolled=firmware)
    firmware.connect()
    firmware.write(b"CSSAXN100\r")
    assert firmware.lamps["A"].level == 0.0
    firmware.write(b"CSSASN100\nXVER\r\n")
    assert firmware.lamps["A"].level == 1.0
    assert firmware.read().startswith(b"CoolLED precisExcite, Hello")
    with contextlib.closing(open_light("coolled", port="sim://coolled")) as light:
        assert firmware.lamps["A"].level == 0.0  # it is dark once it is opened
        assert light.state()["A"].level_percent == 100


@pytest.mark.parametrize("fault", LAMP_FAULTS)
def test_a_fault_of_the_controller_ends_in_its_error(served, fault):
    firmware = CoolLedFirmware(faults=(fault,), clock=VirtualClock())
    served(coolled=firmware)
    with contextlib.ExitStack() as stack:
        if LAMP_FAULTS[fault] is not None:
            error, words = LAMP_FAULTS[fault]
            stack.enter_context(pytest.raises(error, match=words))
        light = CoolLed("sim://coolled")
        stack.callback(light.close)
        light.select({"B": 40})
        light.on()
        assert firmware.lamps["B"].level == 0.4
    assert firmware.lamps["B"].level == 0.0 or fault == "hangup"


@pytest.mark.parametrize(("model", "places"), [("FW102C", 6), ("FW212C", 12)])
def test_a_wheel_turns_to_its_places(served, model, places):
    firmware = WheelFirmware(model, clock=VirtualClock())
    served(fw102c=firmware)
    wheel = open_wheel("fw102c", port="sim://fw102c")
    assert isinstance(wheel, FilterWheel)
    assert (wheel.places, wheel.place()) == (places, 1)
    for place in (4, places, 1):
        wheel.go(place)
        assert (wheel.place(), firmware.place) == (place, place)
    with pytest.raises(RigError, match=f"places 1 to {places}, not 13"):
        wheel.go(13)
    wheel.close()


@pytest.mark.parametrize("fault", WHEEL_FAULTS)
def test_a_fault_of_the_wheel_ends_in_its_error(served, fault):
    firmware = WheelFirmware(faults=(fault,), clock=VirtualClock())
    served(fw102c=firmware)
    with contextlib.ExitStack() as stack:
        if WHEEL_FAULTS[fault] is not None:
            error, words = WHEEL_FAULTS[fault]
            stack.enter_context(pytest.raises(error, match=words))
        wheel = ThorlabsWheel("sim://fw102c")
        stack.callback(wheel.close)
        began = firmware.clock()
        try:
            wheel.go(4)
        finally:
            assert firmware.clock() - began < 20.0
        assert firmware.place == 4


def test_the_tables_have_every_fault():
    for table, firmware in ((LAMP_FAULTS, CoolLedFirmware), (WHEEL_FAULTS, WheelFirmware)):
        assert {fault.partition(":")[0] for fault in table} == {
            str(one) for one in set(FaultKind) - firmware.IMPOSSIBLE
        }


def test_both_on_pseudo_terminals(tmp_path):
    lamps, wheel = CoolLedFirmware(), WheelFirmware(time_scale=0.0)
    with PtyServer(lamps) as one, PtyServer(wheel) as other:
        part = LightPart(
            driver="coolled",
            port=one.url,
            options={"timeout_s": 20.0},
            wheel=WheelPart(driver="fw102c", port=other.url, options={"timeout_s": 20.0, "settle_s": 0.0}),
            channels={"red": ChannelPart(lamps=("C",), level_percent=30, filter=5)},
            channel="red",
        )
        with contextlib.closing(open_lamp(part)) as light:
            light.on()
            assert (lamps.lamps["C"].level, lamps.lamps["A"].level, wheel.place) == (0.3, 0.0, 5)
        assert lamps.lamps["C"].level == 0.0


class Lamp:
    """A light with one lamp."""

    name, asks = "lamp", False

    def __init__(self):
        self.log = []

    def on(self):
        self.log.append("on")

    def off(self):
        self.log.append("off")

    def close(self):
        self.log.append("closed")


class Wheel:
    places = 6

    def __init__(self, log):
        self._log, self._at = log, 1

    def place(self):
        return self._at

    def go(self, place):
        self._log.append(place)
        self._at = place

    def close(self):
        self._log.append("wheel closed")


def test_the_wheel_turns_in_the_dark_and_only_where_it_must():
    lamp = Lamp()
    light = ChannelLight(lamp, Wheel(lamp.log), {"red": Channel(filter=3), "white": Channel()})
    with pytest.raises(RigError, match="channels red, white: choose one"):
        light.on()
    for channel in ("red", "red", "white"):
        light.select(channel)
        light.on()
    assert lamp.log == ["off", 3, "on", "on", "on"]
    with pytest.raises(RigError, match="no channel 'blue'; it has red, white"):
        light.select("blue")
    light.close()
    assert lamp.log[-2:] == ["closed", "wheel closed"]


@pytest.mark.parametrize(
    ("channel", "words"),
    [
        (Channel({"A": 10}), r"light\.channels\.x\.lamps: lamp has no lamp 'A'; it has one lamp"),
        (Channel(filter=7), r"light\.channels\.x\.filter: the wheel has no place 7; it has 6"),
    ],
)
def test_channels_that_the_devices_do_not_have(channel, words):
    with pytest.raises(RigError, match=words):
        ChannelLight(Lamp(), Wheel([]), {"x": channel})


RIG = """
schema = 1
name = "two colours"
[stage]
driver = "manual"
[camera]
driver = "simulated"
pixel_um = 4.0
[calibration]
flat = "white.tif"
dark = "dark.json"
[light]
driver = "coolled"
port = "sim://coolled"
angle_deg = 10.0
half_angle_deg = 0.5
[light.wheel]
driver = "fw102c"
port = "sim://fw102c"
[light.channels.blue]
lamps = ["A", "B"]
wavelength_nm = 470.0
angle_deg = 30.0
flat = "blue.tif"
fixture = "fixture-blue.json"
[light.channels.red]
lamps = ["C"]
filter = 2
wavelength_nm = 630.0
"""


@pytest.fixture
def rig_file(tmp_path):
    def write(text=RIG):
        path = tmp_path / "rig.toml"
        path.write_text(text, encoding="utf-8")
        return path

    return write


def test_a_channel_replaces_what_it_states(rig_file):
    path = rig_file()
    plain, blue, red = (read_rig(path, channel=name) for name in (None, "blue", "red"))
    assert (plain.light.channel, plain.light.wavelength_nm) == (None, None)
    assert (blue.light.wavelength_nm, blue.light.angle_deg, blue.light.half_angle_deg) == (470.0, 30.0, 0.5)
    assert (red.light.wavelength_nm, red.light.angle_deg) == (630.0, 10.0)
    assert [one.calibration.flat.name for one in (plain, blue, red)] == ["white.tif", "blue.tif", "white.tif"]
    assert blue.calibration.dark.name == "dark.json"
    assert [one.calibration.fixture for one in (plain, red)] == [None, None]
    assert blue.calibration.fixture.name == "fixture-blue.json"
    assert read_replay_rig(path, "blue").light == blue.light
    default = read_rig(rig_file(RIG.replace("angle_deg = 10.0", 'angle_deg = 10.0\nchannel = "red"')))
    assert default.light.model_copy(update={"channel": None}) == red.light.model_copy(
        update={"channel": None}
    )


@pytest.mark.parametrize(
    ("change", "channel", "words"),
    [
        (("", ""), "green", r"rig\.toml|two colours' has no channel 'green'; it has blue, red"),
        (
            ('[light.wheel]\ndriver = "fw102c"\nport = "sim://fw102c"\n', ""),
            None,
            r"no table \[light\.wheel\]",
        ),
        (("half_angle_deg = 0.5", 'channel = "uv"'), None, "there is no channel 'uv'; there are: blue, red"),
        (("channels.red", "channels.'a b'"), None, "channels"),
    ],
)
def test_wrong_channels_of_a_rig_file(rig_file, change, channel, words):
    with pytest.raises(RigFileError, match=words):
        read_rig(rig_file(RIG.replace(*change)), channel=channel)


def test_one_of_several_channels_must_be_chosen(rig_file):
    with pytest.raises(RigFileError, match=r"has blue, red: choose one, by acquisition\.light_channel"):
        read_rig(rig_file()).in_channel(None)


def test_clients_of_a_held_rig_each_have_their_channel(rig_file, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    firmware, wheel = CoolLedFirmware(), WheelFirmware(time_scale=0.0)
    with contextlib.ExitStack() as stack:
        ports = [stack.enter_context(PtyServer(one)).url for one in (firmware, wheel)]
        text = RIG.replace('"sim://coolled"', f'"{ports[0]}"').replace('"sim://fw102c"', f'"{ports[1]}"')
        patient = (
            "\n[light.options]\ntimeout_s = 20.0\n[light.wheel.options]\ntimeout_s = 20.0\nsettle_s = 0.0\n"
        )
        path = rig_file(text + patient)
        held = read_rig(path).light
        own = stack.enter_context(contextlib.closing(open_lamp(held)))
        stack.enter_context(Owner({}, (held, own)))
        blue, red = (
            stack.enter_context(contextlib.closing(HeldLight(portholder._noted(ports[0]), key_of(part))))
            for part in (read_rig(path, channel=one).light for one in ("blue", "red"))
        )
        blue.select("blue")
        red.select("red")
        for light, levels in ((blue, [1.0, 1.0, 0.0]), (red, [0.0, 0.0, 1.0]), (blue, [1.0, 1.0, 0.0])):
            light.on()
            assert [firmware.lamps[one].level for one in "ABC"] == levels
        assert wheel.place == 2
