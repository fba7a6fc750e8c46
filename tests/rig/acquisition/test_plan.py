"""What a plan asks for, from the start and when some of it is done."""

from dataclasses import replace

import pytest

from anisoscope.base.errors import UsageError
from anisoscope.rig.acquisition.plan import (
    DarkEvent,
    ExposeEvent,
    LightEvent,
    MoveEvent,
    Plan,
    Pose,
    SampleEvent,
)

PLAN = Plan(poses=(Pose(0.0), Pose(90.0)), exposure_s=0.02, dark_frames=2)
GRID = tuple(Pose(stage, tilt) for tilt in (0.0, 10.0) for stage in (0.0, 90.0))


def test_a_plan_is_a_sequence_of_events():
    assert list(PLAN) == [
        LightEvent(on=False),
        DarkEvent(0),
        DarkEvent(1),
        LightEvent(on=True),
        MoveEvent(Pose(0.0), 0.0),
        SampleEvent(Pose(0.0), 2),
        MoveEvent(Pose(90.0), 0.0),
        SampleEvent(Pose(90.0), 3),
        MoveEvent(Pose(0.0), 0.0),
        SampleEvent(Pose(0.0), 4, again=True),
        LightEvent(on=False, needed=False),
    ]
    assert PLAN.frame_count == 5


@pytest.mark.parametrize(
    "wrong",
    [
        {"poses": ()},
        {"poses": (Pose(float("nan")),)},
        {"exposure_s": 0.0},
        {"exposure_s": float("inf")},
        {"gain": -1.0},
        {"frames_per_pose": 0},
        {"dark_frames": -1},
        {"settle_s": -1.0},
        {"brackets": (1.2,)},
        {"brackets": (4.0, 4.0)},
        {"brackets": (float("nan"),)},
    ],
)
def test_plans_that_make_no_sense(wrong):
    with pytest.raises(UsageError, match=next(iter(wrong))):
        Plan(**({"poses": (Pose(0.0),), "exposure_s": 0.01} | wrong))


def test_a_tilt_is_visited_once():
    with pytest.raises(UsageError, match="all stage angles of a tilt in a row"):
        Plan(poses=(Pose(0.0), Pose(0.0, 10.0), Pose(90.0)), exposure_s=0.01)
    moves = [event.pose for event in Plan(poses=GRID, exposure_s=0.01) if isinstance(event, MoveEvent)]
    assert moves == [*GRID, GRID[0]]


def left(plan, done):
    """Steps that a plan still asks for; those that check the first pose are None."""
    taken = [event for event in plan.remaining(done) if isinstance(event, DarkEvent | SampleEvent)]
    return [event.step for event in taken]


PAIRS = Plan(poses=(Pose(0.0), Pose(90.0)), exposure_s=0.02, dark_frames=2, frames_per_pose=2)


@pytest.mark.parametrize(
    ("done", "expected"),
    [
        (set(), [0, 1, 2, 3, 4, 5, 6, 7]),
        ({0}, [0, 1, 2, 3, 4, 5, 6, 7]),  # dark frames are averaged: all of them or none
        ({0, 1}, [2, 3, 4, 5, 6, 7]),
        ({0, 1, 2}, [2, 3, 4, 5, 6, 7]),  # half a pose is no pose
        ({0, 1, 2, 3}, [None, None, 4, 5, 6, 7]),  # the first pose once more, before going on
        ({0, 1, 2, 3, 4}, [None, None, 4, 5, 6, 7]),
        ({2, 3, 4, 5}, [0, 1, 6, 7]),  # the return to the first pose shows the same
        ({0, 1, 2, 3, 4, 5, 6}, [6, 7]),
        (set(range(8)), []),
    ],
)
def test_what_is_left_when_some_frames_are_there(done, expected):
    assert left(PAIRS, done) == expected


def test_nothing_is_done_when_nothing_is_left():
    assert list(PAIRS.remaining(range(8))) == []


def test_the_light_is_on_where_frames_need_it_and_off_at_the_end():
    for done in ({0, 1}, {2, 3, 4, 5, 6, 7}, {0, 1, 2, 3}):
        lit = None
        for event in PAIRS.remaining(done):
            if isinstance(event, LightEvent):
                lit = event.on
            elif isinstance(event, DarkEvent | SampleEvent):
                assert lit is isinstance(event, SampleEvent)
        assert lit is False


def test_another_round_takes_all_poses_again_but_no_dark_frames():
    more = replace(PLAN, rounds=2)
    assert (PLAN.frame_count, more.frame_count) == (5, 8)
    taken = [event for event in more.remaining(range(5)) if isinstance(event, DarkEvent | SampleEvent)]
    assert taken == [
        SampleEvent(Pose(0.0), None, again=True),
        SampleEvent(Pose(0.0), 5),
        SampleEvent(Pose(90.0), 6),
        SampleEvent(Pose(0.0), 7, again=True),
    ]
    with pytest.raises(UsageError, match="rounds: expected at least 1"):
        replace(PLAN, rounds=0)


BRACKET = Plan(poses=(Pose(0.0), Pose(90.0)), exposure_s=0.006, brackets=(4.0,), frames_per_pose=2)


def test_a_bracket_takes_every_exposure_in_the_dark_and_at_every_pose():
    assert BRACKET.exposures_s == (0.006, 0.024)
    events = [event for event in BRACKET if not isinstance(event, LightEvent | MoveEvent)]
    first, there = Pose(0.0), Pose(90.0)
    assert events == [
        *(ExposeEvent(0.006), DarkEvent(0), ExposeEvent(0.024), DarkEvent(1)),
        *(ExposeEvent(0.006), SampleEvent(first, 2), SampleEvent(first, 3)),
        *(ExposeEvent(0.024), SampleEvent(first, 4), SampleEvent(first, 5)),
        *(ExposeEvent(0.006), SampleEvent(there, 6), SampleEvent(there, 7)),
        *(ExposeEvent(0.024), SampleEvent(there, 8), SampleEvent(there, 9)),
        *(ExposeEvent(0.006), SampleEvent(first, 10, again=True), SampleEvent(first, 11, again=True)),
        *(ExposeEvent(0.024), SampleEvent(first, 12, again=True), SampleEvent(first, 13, again=True)),
    ]
    assert (BRACKET.frame_count, BRACKET.shots_per_pose) == (14, 4)
    assert [BRACKET.exposure_of(step) for step in (0, 1, 3, 4, 7, 8, 13)] == [
        *(0.006, 0.024, 0.006, 0.024, 0.006, 0.024, 0.024)
    ]


def test_a_pose_without_all_of_its_exposures_is_taken_anew():
    assert left(BRACKET, {0, 1, 2, 3, 4, 5, 6, 7}) == [None] * 4 + [8 - 2, 8 - 1, *range(8, 14)]
    assert left(BRACKET, {0}) == list(range(14))
