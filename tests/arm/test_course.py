"""How an arm comes to a standstill, and what of its commands it has not heard yet."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from obstacle_sets import MS, NOW
from turning_arm import TURNING

from twin_node.arm import ArmError, Commands, StoppingTable, Underway
from twin_node.arm.course import ArmMotion


@given(
    measured=st.floats(0.0, 1.5),
    share=st.floats(0.0, 1.0),
    reaction_s=st.floats(0.0, 0.5),
    underway=st.builds(Underway, latency_s=st.floats(0.0, 0.6), share=st.floats(0.0, 1.0)),
)
@settings(max_examples=100, deadline=None)
def test_the_course_of_an_arm_that_brakes_is_that_of_its_steps(
    measured: float, share: float, reaction_s: float, underway: Underway
) -> None:
    """Against an arm that slows by 4 rad/s^2, step by step, from when it hears of it."""
    speeds = np.array([0.01, 3.0])
    steady = StoppingTable(speeds, np.tile(speeds[:, None] / 4, 6), np.tile(speeds[:, None] ** 2 / 8, 6))
    course = ArmMotion(NOW, reaction_s, TURNING, steady, measured, underway).course(share)
    now, way, passed_s, step_s = max(measured, underway.share, share), 0.0, 0.0, 5e-4
    while now > 0 or passed_s < reaction_s:
        before, target = now, share if passed_s < reaction_s else 0.0
        is_deaf = passed_s < min(underway.latency_s, reaction_s)
        now = now if is_deaf else max(now - 4 * step_s, target)
        way, passed_s = way + (before + now) / 2 * step_s, passed_s + step_s
    assert course.steady_s + course.braking_s == pytest.approx(way, abs=3e-3)
    assert course.duration_s == pytest.approx(passed_s, abs=5e-3)


@given(
    shares=st.tuples(st.floats(0.0, 1.0), st.floats(0.0, 1.0)),
    measured=st.floats(0.0, 1.5),
    underway=st.builds(Underway, st.floats(0.0, 0.6), st.floats(0.0, 1.0), slide_s=st.floats(0.0, 0.5)),
)
def test_who_is_told_more_never_stands_sooner_or_nearer(
    shares: tuple[float, float], measured: float, underway: Underway
) -> None:
    speeds = np.array([0.5, 3.0])
    table = StoppingTable(speeds, np.tile(speeds[:, None] / 4, 6), np.tile(speeds[:, None] ** 2 / 9, 6))
    motion = ArmMotion(NOW, 0.3, TURNING, table, measured, underway)
    slower, faster = (motion.course(share) for share in sorted(shares))
    assert slower.duration_s <= faster.duration_s + 1e-9
    assert slower.steady_s + slower.braking_s <= faster.steady_s + faster.braking_s + 1e-9


@pytest.mark.parametrize("program", [1.0, 0.05, 0.0])
def test_an_arm_that_slides_to_a_stop_takes_as_long_from_a_slow_part_of_its_program(program: float) -> None:
    """Its controller takes all of its speed to none in 0.2 s; a stopping table by joint speeds knows nothing of it."""
    table = StoppingTable(np.array([3.0]), np.full((1, 6), 0.03), np.full((1, 6), 0.045))
    motion = ArmMotion(NOW, 0.1, program * TURNING, table, 0.0, Underway(0.02, 0.4, slide_s=0.2))
    assert motion.course(1.0).duration_s == pytest.approx(0.1 + 0.2)
    assert motion.course(1.0).braking_s == pytest.approx(0.1)
    assert motion.course(0.5).duration_s == pytest.approx(0.1 + 0.1)
    assert motion.course(0.0).duration_s == pytest.approx(0.02 + 0.08)  # of what is underway, once it has heard
    assert motion.course(0.0).braking_s == pytest.approx(0.4 * 0.04)


def test_a_slide_that_was_told_before_outlasts_that_of_a_smaller_share() -> None:
    """It begins as soon as the new share is heard, and may end after what that one begins with the next command."""
    table = StoppingTable(np.array([3.0]), np.full((1, 6), 0.03), np.full((1, 6), 0.045))
    for before, share in ((0.8, 0.3), (0.8, 0.1), (0.5, 0.4)):
        course = ArmMotion(NOW, 0.1, TURNING, table, 0.0, Underway(0.02, before, slide_s=0.4)).course(share)
        assert course.duration_s == pytest.approx(max(0.1 + share * 0.4, 0.02 + before * 0.4))
        assert course.braking_s == pytest.approx(before**2 * 0.2)


def test_what_is_told_an_arm_that_still_brakes_is_slid_from_as_well() -> None:
    """It was measured faster than anybody told it to be: of a new share it was held to stop by the table alone."""
    table = StoppingTable(np.array([3.0]), np.full((1, 6), 0.03), np.full((1, 6), 0.045))
    course = ArmMotion(NOW, 0.1, TURNING, table, 1.0, Underway(0.02, 0.0, slide_s=0.2)).course(0.9)
    assert course.duration_s == pytest.approx(0.1 + 0.9 * 0.2)
    assert course.braking_s == pytest.approx(0.9**2 * 0.1)


def test_commands_are_underway_for_as_long_as_they_take() -> None:
    commands = Commands(0.1)
    assert commands.underway(NOW) == Underway(0.1, 0.0)
    for ms, share in ((0, 0.8), (40, 0.3), (80, 0.5)):
        commands.tell(share, NOW + ms * MS)
    for ms, most, least in (
        (99, 0.8, 0.0),
        (100, 0.8, 0.3),
        (139, 0.8, 0.3),
        (140, 0.5, 0.3),
        (180, 0.5, 0.5),
        (900, 0.5, 0.5),
    ):
        assert (commands.underway(NOW + ms * MS).share, commands.least(NOW + ms * MS)) == (most, least)


@pytest.mark.parametrize(("ms", "least"), [(100, 0.3), (199, 0.3), (200, 0.6)])
def test_the_least_that_it_may_be_held_to_is_told_though_nobody_asks_for_the_most(ms: int, least: float) -> None:
    commands = Commands(0.1)
    for told_ms, share in ((0, 0.3), (100, 0.6)):
        commands.tell(share, NOW + told_ms * MS)
    assert commands.least(NOW + ms * MS) == least


def test_a_clock_that_is_put_back_keeps_no_command_underway_for_ever() -> None:
    commands = Commands(0.1)
    commands.tell(0.9, NOW)
    commands.tell(0.4, NOW + 10 * MS)
    commands.tell(0.2, NOW - 3_600_000 * MS)
    assert commands.least(NOW - 3_600_000 * MS + 99 * MS) == 0.0
    assert commands.underway(NOW - 3_600_000 * MS + 99 * MS).share == 0.9
    assert commands.underway(NOW - 3_600_000 * MS + 100 * MS).share == 0.2


@pytest.mark.parametrize("wrong", [{"latency_s": -0.1}, {"share": -0.1}, {"latency_s": np.nan}, {"share": np.inf}])
def test_no_command_is_underway_for_less_than_no_time(wrong: dict[str, float]) -> None:
    with pytest.raises(ArmError, match="commands underway"):
        Underway(**wrong)


@pytest.mark.parametrize("share", [-0.1, 1.1, 80.0, np.nan])
def test_no_arm_is_told_a_share_that_is_none(share: float) -> None:
    """What is not a number was no share at all: the arm counted as standing."""
    commands = Commands(0.1)
    commands.tell(0.5, NOW)
    with pytest.raises(ArmError, match="commands: expected a share from 0 to 1, found"):
        commands.tell(share, NOW + 10 * MS)
    assert commands.underway(NOW + 10 * MS).share == 0.5
