import pytest

from anisoscope.base.errors import RigError
from anisoscope.rig.drivers import open_light
from anisoscope.rig.light import Light, rest
from anisoscope.rig.lights.always_on import AlwaysOn


def test_darkness_is_a_cover_that_the_operator_is_asked_for_once():
    asked = []
    light = AlwaysOn(asked.append)
    light.on()
    assert asked == []
    light.off()
    light.off()
    light.on()
    light.on()
    light.close()
    assert [request.rpartition(" ")[2] for request in asked] == ["lens", "lens"]
    assert "cannot be switched off: cover" in asked[0]
    assert "take the cover off" in asked[1]


def test_without_anybody_to_ask_it_does_not_get_dark():
    light = open_light("none")
    assert isinstance(light, Light)
    light.on()
    with pytest.raises(RigError, match=r"no terminal.*take no dark frames"):
        light.off()
    light.close()


def test_a_request_that_fails_leaves_the_lens_uncovered():
    def nobody(_request):
        raise RigError("nobody answered")

    light = AlwaysOn(nobody)
    for _ in range(2):
        with pytest.raises(RigError):
            light.off()


def test_making_the_rig_safe_asks_nobody_for_a_cover():
    asked = []
    light = AlwaysOn(asked.append)
    rest(light)
    assert asked == []
    light.off()
    assert len(asked) == 1
