"""Readings of a stage that turns round: a turn apart they are the same place."""

import pytest

from anisoscope.rig.collisions import Collision, Guard
from anisoscope.rig.stage import MotionRules, apart_deg, approach_from, within_a_turn
from anisoscope.rig.stages.motion import StageBase


@pytest.mark.parametrize(
    ("limits", "reading", "approach", "found"),
    [
        ((0.0, 360.0), 396.99988, 2.0, 36.99988),
        ((0.0, 360.0), -10.0, 2.0, 350.0),
        ((0.0, 360.0), 0.0, 2.0, 360.0),
        ((0.0, 360.0), 0.0, 0.0, 0.0),
        ((0.0, 359.995), 0.0, 2.0, 359.995),
        ((0.0, 360.0), 361.0, 2.0, 1.0),
        ((-720.0, 720.0), 370.0, 2.0, 370.0),
        ((-170.0, 170.0), 190.0, 2.0, 190.0),
        ((0.0, 360.0), 1e9, 2.0, 1e9),
    ],
)
def test_the_reading_that_is_reached_from_below(limits, reading, approach, found):
    assert within_a_turn(limits, reading, approach) == pytest.approx(found, abs=1e-9)


def test_near_its_lower_end_a_stage_that_turns_round_is_approached_from_there():
    assert approach_from((0.0, 360.0), 90.0, 2.0) == 88.0
    assert approach_from((0.0, 360.0), 1.0, 2.0) == 0.0
    assert approach_from((0.0, 360.0), 0.4, 2.0) == -1.6
    assert approach_from((0.0, 300.0), 1.0, 2.0) == -1.0


def test_directions_differ_by_less_than_half_a_turn():
    assert apart_deg(359.997, 0.0) == pytest.approx(-0.003)
    assert apart_deg(0.0, 360.0) == 0.0
    assert apart_deg(-179.0, 179.0) == pytest.approx(2.0)


class Wrapping(StageBase):
    """A stage that reports every angle within a turn, and stands a little before its reference."""

    def __init__(self, after_home=359.997):
        super().__init__("wrapping", MotionRules(0.01, 100.0), (0.0, 360.0), 0.001)
        self.at, self.after_home = 12.0, after_home

    def _read_deg(self):
        return self.at

    def _begin_home(self):
        self.at = self.after_home

    def _begin_move(self, target_deg):
        self.at = target_deg % 360.0

    def _is_busy(self, wait_s):
        return False

    def _send_stop(self):
        pass

    def _disconnect(self):
        pass


def test_a_stage_that_reads_nearly_a_turn_is_at_home():
    with Wrapping() as stage:
        assert stage.home() == 359.997
        assert stage.move_to(360.0) == 0.0
        stage.at = 359.999  # it creeps over its zero
        assert stage.position_deg() == 359.999
        assert stage.is_homed


@pytest.mark.parametrize("row", ["-10 .. 10", "350 .. 370", "710 .. 730"])
def test_a_forbidden_range_of_a_stage_that_turns_round_lies_in_every_turn(row):
    stage, tilt = Wrapping(), Wrapping()
    for one in (stage, tilt):
        one.home()
    tilt.move_to(50.0)
    guard = Guard([Collision(stage=row, tilt="> 40")], {"stage": stage, "tilt": tilt})
    for reading in (0.0, 5.0, 355.0, 360.0):
        with pytest.raises(Exception, match="may collide"):
            guard.check_together({"stage": reading, "tilt": 50.0})
    guard.check_together({"stage": 180.0, "tilt": 50.0})
    guard.check_together({"stage": 5.0, "tilt": 30.0})
