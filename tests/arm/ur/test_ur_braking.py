"""A servoed arm stops no later, and no farther on, than the law takes it to."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from fake_link import MODEL, START, quintic
from hypothesis import given, settings
from hypothesis import strategies as st

from twin_node.arm import ArmError, SeparationParameters, StoppingTable, stopping_table
from twin_node.arm.ur import LOOKAHEAD_S, LOOKAHEADS_S, PathFollower, servo_stopping
from twin_node.scene import Float64, JointPath

PERIOD_S = 0.004
OWN = stopping_table("ur5e")
TABLE = servo_stopping(MODEL, OWN)
WITHIN_RAD = SeparationParameters().position_error_m
"""What the law allows for otherwise, at 1 m."""


@dataclass(frozen=True)
class Stopped:
    """An arm that closes in on what it is sent, as servoJ's does with its look-ahead, when it is told to stand."""

    ahead: JointPath
    """What was told of it then."""
    sent: Float64
    """Where it was sent [J], rad."""
    arm: Float64
    """Where it was from then on [T, J], rad."""


def stopped(way: float, seconds: float, fraction: float, after: int, lookahead_s: float = LOOKAHEAD_S) -> Stopped:
    """An arm on a path that is told to stand after so many periods."""
    follower, arm = PathFollower(MODEL, quintic(way=way, seconds=seconds), START, lookahead_s), START
    for _ in range(after):
        arm = arm + (follower.advance(fraction, PERIOD_S) - arm) * PERIOD_S / lookahead_s
    ahead, sent, rows = follower.ahead(0), follower.q, [arm]
    for _ in range(400):
        arm = arm + (follower.advance(0.0, PERIOD_S) - arm) * PERIOD_S / lookahead_s
        rows.append(arm)
    return Stopped(ahead, sent, np.array(rows))


@settings(max_examples=8, deadline=None)
@given(
    way=st.floats(0.5, 2.0),
    speed=st.floats(0.2, 2.5),
    fraction=st.floats(0.3, 1.0),
    at=st.floats(0.02, 0.98),
    lookahead_s=st.floats(LOOKAHEADS_S.least, LOOKAHEADS_S.most),
)
def test_the_arm_stands_when_and_where_the_law_says(
    way: float, speed: float, fraction: float, at: float, lookahead_s: float
) -> None:
    seconds = 1.875 * way / speed
    found = stopped(way, seconds, fraction, round(at * seconds / fraction / PERIOD_S), lookahead_s)
    fastest = fraction * np.abs(np.diff(found.ahead.positions, axis=0)).max(axis=0) / 0.01
    stop = servo_stopping(MODEL, OWN, lookahead_s).stop(fastest)
    left = np.abs(found.arm - found.arm[-1]).max(axis=1)
    assert left[int(stop.duration_s / PERIOD_S) + 1] <= WITHIN_RAD
    assert left[0] <= stop.travel_s * fastest.max() + WITHIN_RAD


@pytest.mark.parametrize("speed", [1.05, 2.0, 3.0])
def test_what_is_told_of_the_arm_begins_where_it_is_and_not_where_it_was_sent(speed: float) -> None:
    seconds = 1.875 * 3.0 / speed
    found = stopped(3.0, seconds, 1.0, round(0.5 * seconds / PERIOD_S))
    np.testing.assert_allclose(found.ahead.positions[0], found.arm[0], atol=0.02)
    assert np.abs(found.sent - found.arm[0]).max() > 0.09 * speed


def test_where_the_arms_own_stop_is_slower_that_counts() -> None:
    slow = StoppingTable(OWN.speeds, 10 * OWN.times, 10 * OWN.angles)
    for speed in (0.01, 0.3, 3.0, 6.0):
        for joint in range(6):
            alone = speed * (np.arange(6) == joint)
            mixed, own, braked = (table.stop(alone) for table in (servo_stopping(MODEL, slow), slow, TABLE))
            assert mixed.duration_s >= max(own.duration_s, braked.duration_s) - 1e-12
            assert mixed.travel_s >= max(own.travel_s, braked.travel_s) - 1e-12
    assert servo_stopping(MODEL, slow).stop(np.full(6, 3.0)).duration_s == pytest.approx(
        slow.stop(np.full(6, 3.0)).duration_s, rel=0.05
    )


def test_the_table_of_an_arm_of_other_joints_is_refused() -> None:
    with pytest.raises(ArmError, match="expected one of 6 joints, found one of 7"):
        servo_stopping(MODEL, stopping_table("another", 7))
