"""Linear stages of all families: the same rules of motion, in millimetres, on real bytes."""

import pytest

from anisoscope.base.errors import LimitExceeded, NotHomed, ProtocolError, RigError, RigFileError
from anisoscope.rig.acquisition.opening import open_axis
from anisoscope.rig.drivers import open_stage
from anisoscope.rig.rigfile import LinearPart
from anisoscope.sim.bench.firmware.axis import LinearAxis
from anisoscope.sim.bench.firmware.catalogue import Mount, build

SCALE = {"counts_per_mm": 1000.0 / 0.047625}
STAGES = {
    "ELL17": ("elliptec", {}, (0.0, 28.0), 1 / 1024),
    "ELL20": ("elliptec", {}, (0.0, 60.0), 1 / 1024),
    "X-LSM025A": ("zaber", SCALE, (0.0, 25.4), 0.047625e-3),
    "MTS25-Z8": ("apt", {"actuator": "MTS25-Z8"}, (0.0, 25.0), 1 / 34554.96),
    "LTS150": ("apt", {}, (0.0, 150.0), 1 / 409600),
    "mfa-cc": ("smc100", {}, (-12.5, 12.5), 5e-5),
    "mfa-pp": ("smc100", {}, (-12.5, 12.5), 1e-4),
    "": ("grbl", {"axis": "Z"}, (-199.0, 0.0), 1 / 250),
}


@pytest.fixture(params=STAGES, ids=lambda name: name or "grbl-z")
def stage(request, in_process):
    """(table of the rig file, true axis, expected limits, expected step) of a linear stage."""
    protocol, options, limits, step = STAGES[request.param]
    axis = LinearAxis(time_scale=0.0, start_deg=-1.0)
    port = in_process(build(protocol, [Mount(axis, "", request.param)]))
    return LinearPart(driver=protocol, port=port, options=options), axis, limits, step


def test_a_linear_stage_moves_in_millimetres_and_keeps_the_rules(stage):
    part, axis, limits, step = stage
    opened = open_axis(part, "z")
    try:
        assert opened.unit == "mm"
        assert opened.limits_deg == pytest.approx(limits, abs=1e-4)
        assert opened.resolution_deg == pytest.approx(step)
        with pytest.raises(NotHomed, match="search the reference"):
            opened.move_to(1.0)
        opened.home()
        target = limits[0] + 0.3 * (limits[1] - limits[0])
        assert opened.move_to(target) == pytest.approx(target, abs=step)
        assert axis.position() == pytest.approx(target, abs=step)
        assert opened.move_by(-1.5) == pytest.approx(target - 1.5, abs=2 * step)
        stood = axis.position()
        with pytest.raises(LimitExceeded, match=r"1000 mm is outside .* mm….* mm; nothing was moved"):
            opened.move_to(1000.0)
        assert axis.position() == stood
    finally:
        opened.close()


@pytest.mark.parametrize(
    ("protocol", "model", "options", "message"),
    [
        ("elliptec", "ELL17", {}, r"ELL17 is a linear stage; .* in a table \[x\], \[y\] or \[z\]"),
        ("apt", "LTS150", {}, r"LTS150 is a linear stage"),
        ("zaber", "X-LSM025A", {}, "if it is a rotary stage, set the option counts_per_turn"),
    ],
)
def test_a_linear_stage_is_not_taken_for_one_that_turns(in_process, protocol, model, options, message):
    port = in_process(build(protocol, [Mount(LinearAxis(time_scale=0.0), "", model)]))
    with pytest.raises(RigError, match=message):
        open_stage(protocol, port=port, **options)


@pytest.mark.parametrize(
    ("protocol", "options", "message"),
    [
        ("elliptec", {}, r"ELL14 is a rotation stage; .* describe it in \[stage\] or \[tilt\]"),
        ("apt", {}, "K10CR1 is a rotation stage"),
        ("zaber", SCALE, "is a rotary stage"),
    ],
)
def test_one_that_turns_is_not_taken_for_a_linear_stage(protocol, options, message):
    part = LinearPart(driver=protocol, port=f"sim://{protocol}?time_scale=0", options=options)
    with pytest.raises(RigError, match=message):
        open_axis(part, "z")


def test_what_a_linear_stage_does_not_say_has_to_be_given():
    for model, name, message in [
        ("X-LSM025A", "zaber", "set the option counts_per_mm"),
        ("MTS25-Z8", "apt", "set the option actuator = 'MTS25-Z8', or counts_per_mm"),
    ]:
        part = LinearPart(driver=name, port=f"sim://{name}?model={model}&time_scale=0")
        with pytest.raises(ProtocolError if name == "zaber" else RigError, match=message):
            open_axis(part, "z")
    scaled = LinearPart(driver="apt", port="sim://apt?model=MTS25-Z8", options={"counts_per_mm": 34554.96})
    with pytest.raises(RigError, match="does not tell its travel; set the option max_mm"):
        open_axis(scaled, "z")


def test_a_driver_that_only_turns_is_refused_for_a_linear_axis():
    with pytest.raises(
        RigFileError, match=r"z\.options: the driver 'turntable' does not take them|z\.driver"
    ):
        open_axis(LinearPart(driver="turntable", port="COM1"), "z")
