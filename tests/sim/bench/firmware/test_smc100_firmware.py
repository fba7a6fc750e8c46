"""The controller's bytes, against the user's manual of the SMC100."""

import pytest

from anisoscope.base.errors import UsageError
from anisoscope.sim.bench.firmware.axis import RotaryAxis
from anisoscope.sim.bench.firmware.catalogue import Mount, build
from anisoscope.sim.bench.firmware.smc100 import AG_PR100P, ERROR_TEXTS, URS75PP, Smc100Firmware


class Clock:
    def __init__(self):
        self.now = 100.0

    def __call__(self):
        return self.now


@pytest.fixture
def clock():
    return Clock()


def ask(firmware, *commands):
    for command in commands:
        firmware.write(command.encode() + b"\r\n")
    return firmware.read().decode().replace("\r\n", " ").strip()


def instant(**options):
    return Smc100Firmware(RotaryAxis(time_scale=0.0), **options)


def ready(**options):
    firmware = instant(**options)
    assert ask(firmware, "1OR", "1TS") == "1TS000032"
    return firmware


def stepper(**options):
    return instant(model=URS75PP, **options)


def disabled():
    firmware = ready()
    ask(firmware, "1MM0")
    return firmware


def configured():
    firmware = instant()
    ask(firmware, "1PW1")
    return firmware


@pytest.mark.parametrize(
    ("make", "commands", "answer"),
    [
        (instant, ["1TS"], "1TS00000A"),
        (instant, ["1ts"], "1TS00000A"),
        (instant, [" 1 T S ?"], "1TS00000A"),
        (instant, ["01TS"], "1TS00000A"),
        (instant, ["1TE", "1TB"], "1TE@ 1TB@ No error"),
        (instant, ["1TBD"], "1TBD Command not allowed"),
        (instant, ["1ID?", "1VE"], "1IDURS100CC 1VESMC_CC_1.0.0"),
        (instant, ["1SL?", "1SR?", "1VA?", "1SU?"], "1SL0 1SR360 1VA40 1SU0.0005"),
        (instant, ["1PA5", "1TE"], "1TEH"),
        (instant, ["1MM1", "1TE"], "1TEH"),
        (instant, ["1VA5", "1TE"], "1TEH"),
        (instant, ["1XX", "1TE", "1TE"], "1TEA 1TE@"),
        (instant, ["TS", "1TE"], "1TEB"),
        (instant, ["2TS", "2TE"], ""),
        (instant, ["1PW1", "1TS", "1PW0", "1TS"], "1TS000014 1TS00000C"),
        (instant, ["1PW2", "1TE"], "1TEC"),
        (ready, ["1TP", "1TH"], "1TP0.00000 1TH0.00000"),
        (ready, ["1PA90", "1TS", "1TP"], "1TS000033 1TP90.00000"),
        (ready, ["1PA1.43 6", "1TP"], "1TP1.43600"),
        (ready, ["1PA10", "1PR-2.5", "1TP"], "1TP7.50000"),
        (ready, ["1PA360.01", "1TE", "1TS"], "1TEG 1TS000032"),
        (ready, ["1PR-1", "1TE"], "1TEG"),
        (ready, ["1PA", "1TE"], "1TEC"),
        (ready, ["1PAx", "1TE"], "1TEC"),
        (ready, ["1OR", "1TE"], "1TEK"),
        (ready, ["1PW1", "1TB"], "1TBK Command not allowed in READY state"),
        (ready, ["1HT1", "1TE"], "1TEK"),
        (ready, ["1VA10", "1VA?", "1SL-5", "1SL?"], "1VA10 1SL-5"),
        (ready, ["1VA-10", "1TE"], "1TEC"),
        (ready, ["1MM0", "1TS", "1MM1", "1TS"], "1TS00003C 1TS000034"),
        (ready, ["1ST", "1TE", "1TS"], "1TE@ 1TS000032"),
        (ready, ["1RS", "1TS", "1VA?"], "1TS00000A 1VA40"),
        (disabled, ["1PA5", "1TE"], "1TEJ"),
        (disabled, ["1OR", "1TE"], "1TEJ"),
        (disabled, ["1MM?"], "1MM0"),
        (configured, ["1PA5", "1TE"], "1TEI"),
        (configured, ["1SL5", "1TE"], "1TEC"),
        (configured, ["1SA7", "1PW0", "1TS", "1SA?"], "1TS00000C 1SA7"),
        (stepper, ["1ID?", "1VE", "1FRM?", "1FRS?"], "1IDURS75PP 1VESMC_PP_1.0.0 1FRM100 1FRS0.02"),
        (stepper, ["1SU?", "1TE", "1FE?", "1TE"], "1TEW 1TEW"),
        (instant, ["1FRM?", "1TE"], "1TEX"),
        (configured, ["1IDPR50", "1ID?", "1ZX3", "1TE", "1ZX?"], "1IDPR50 1TE@ 1ZX3"),
    ],
)
def test_commands_and_answers(make, commands, answer):
    assert ask(make(), *commands) == answer


def test_what_is_configured_survives_a_restart_and_what_is_set_in_use_does_not():
    firmware = configured()
    ask(firmware, "1VA10", "1PW0", "1OR", "1VA20")
    assert ask(firmware, "1VA?") == "1VA20"
    assert ask(firmware, "1RS", "1VA?") == "1VA10"


def test_all_parameters_at_once():
    answers = ask(instant(), "1ZT").split()
    assert "1SU0.0005" in answers
    assert (answers[0], answers[1], answers[-1]) == ("1PW1", "1IDURS100CC", "1PW0")


def test_all_parameters_of_a_stepper_in_the_order_of_the_manual():
    letters = [answer.rstrip("-.0123456789")[1:] for answer in ask(stepper(), "1ZT").split()]
    assert " ".join(letters[2:-1]) == "AC BA BH FRM FRS HT JR OH OT QIL SA SL SR VA VB ZX"


def test_a_controller_behind_the_first_takes_its_address_from_the_configuration():
    firmware = instant(address=3)
    assert ask(firmware, "3PW1", "3SA7", "3PW0", "3TS", "7TS") == "7TS00000C"


def test_a_stepper_loses_steps_at_an_obstacle_and_says_nothing():
    firmware = stepper(faults=("stall:45",))
    assert ask(firmware, "1OR", "1PA90", "1TS", "1TP") == "1TS000033 1TP90.00000"
    assert firmware.axis.position() == 45.0
    firmware.clear_faults()
    assert ask(firmware, "1PA60", "1TP") == "1TP60.00000"
    assert firmware.axis.position() == pytest.approx(15.0)


def test_a_motion_goes_through_its_states(clock):
    firmware = Smc100Firmware(RotaryAxis(start_deg=30.0, clock=clock))
    assert ask(firmware, "1OR", "1TS", "1OR", "1TE", "1PA1", "1TE") == "1TS00001E 1TEL 1TEL"
    clock.now += 5.0
    assert ask(firmware, "1TS", "1TP") == "1TS000032 1TP0.00000"
    assert ask(firmware, "1PA90", "1TS", "1PA10", "1TE") == "1TS000028 1TEM"
    clock.now += 1.0
    assert 10.0 < float(ask(firmware, "1TP")[3:]) < 50.0
    clock.now += 5.0
    assert ask(firmware, "1TS", "1TP") == "1TS000033 1TP90.00000"


def test_a_stop_ends_a_move_ready_and_a_search_without_reference(clock):
    firmware = Smc100Firmware(RotaryAxis(start_deg=30.0, clock=clock))
    ask(firmware, "1OR")
    clock.now += 0.5
    assert ask(firmware, "1ST", "1TS") == "1TS00000B"
    ask(firmware, "1OR")
    clock.now += 9.0
    ask(firmware, "1PA90")
    clock.now += 1.0
    assert ask(firmware, "1ST", "1TS") == "1TS000033"
    assert 0.0 < firmware.axis.position() < 90.0
    assert firmware.stops == 2


def test_a_stop_without_address_stops_every_controller(clock):
    mounts = [Mount(RotaryAxis(clock=clock)) for _ in range(2)]
    bus = build("smc100", mounts)
    ask(bus, "1OR", "2OR")
    clock.now += 1.0
    ask(bus, "1PA90", "2PA90")
    clock.now += 1.0
    assert ask(bus, "ST", "1TS", "1TE", "2TS") == "1TS000033 1TE@ 2TS000033"
    assert not any(mount.axis.busy() for mount in mounts)


def test_an_obstacle_disables_the_motor():
    firmware = ready(faults=("stall:45",))
    assert ask(firmware, "1PA90", "1TS") == "1TS00203D"
    assert ask(firmware, "1TP", "1MM1", "1TS") == "1TP45.00000 1TS000034"


def test_a_search_that_is_blocked_times_out():
    firmware = Smc100Firmware(RotaryAxis(start_deg=90.0, time_scale=0.0), faults=("stall:45",))
    assert ask(firmware, "1OR", "1TS") == "1TS00400B"


def test_a_restart_takes_its_time_and_forgets_the_reference(clock):
    firmware = Smc100Firmware(RotaryAxis(clock=clock))
    ask(firmware, "1OR")
    clock.now += 1.0
    ask(firmware, "1PA5")
    clock.now += 5.0
    assert ask(firmware, "1RS", "1TS") == ""
    clock.now += 4.0
    assert ask(firmware, "1TS", "1TP") == "1TS00000A 1TP0.00000"
    assert firmware.axis.position() == pytest.approx(5.0)


def test_lines_end_with_both_characters():
    firmware = instant()
    firmware.write(b"1TS\r")
    assert firmware.read() == b""
    firmware.write(b"\n1T")
    assert firmware.read() == b"1TS00000A\r\n"
    firmware.write(b"P\r\n")
    assert firmware.read() == b"1TP0.00000\r\n"


def test_every_error_has_a_text():
    firmware = instant()
    for letter, text in ERROR_TEXTS.items():
        assert ask(firmware, f"1TB{letter}") == f"1TB{letter} {text}"


def test_building_several_on_a_line():
    mounts = [Mount(RotaryAxis(time_scale=0.0)), Mount(RotaryAxis(time_scale=0.0), "12")]
    bus = build("smc100", mounts, model="conex-agp")
    assert ask(bus, "12OR", "12PA3", "12TP", "1TS") == "1TS00000A 12TP3.00000"
    assert mounts[1].axis.position() == pytest.approx(3.0)
    assert ask(bus, "12ID?") == f"12ID{AG_PR100P.stage}"
    for address in ("0", "32", "x"):
        with pytest.raises(UsageError):
            build("smc100", [Mount(RotaryAxis(), address)])
