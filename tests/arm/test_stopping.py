"""Stopping tables give back what was measured and go on sensibly between and beyond."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twin_node.arm import ArmError, StoppingTable, stopping_table
from twin_node.robot import UR_NAMES

FULL = np.deg2rad(183)


@pytest.mark.parametrize(
    ("name", "base", "shoulder", "elbow"),
    [
        ("ur3e", (0.159, 0.18), (0.154, 0.20), (0.092, 0.15)),
        ("ur5e", (0.244, 0.31), (0.530, 0.70), (0.164, 0.22)),
        ("ur10e", (0.488, 0.62), (1.060, 1.40), (0.328, 0.44)),
        ("ur7e", (0.488, 0.62), (1.060, 1.40), (0.328, 0.44)),
        ("ur12e", (0.488, 0.62), (1.060, 1.40), (0.328, 0.44)),
        ("ur16e", (0.488, 0.62), (1.060, 1.40), (0.328, 0.44)),
        ("another", (0.488, 0.62), (1.060, 1.40), (0.328, 0.44)),
    ],
)
def test_each_joint_stops_as_the_manuals_have_it(
    name: str, base: tuple[float, float], shoulder: tuple[float, float], elbow: tuple[float, float]
) -> None:
    """Seconds and radians from 183 degrees per second; wrists as the elbow, larger arms twice a UR5's."""
    for joint, (seconds, radians) in enumerate((base, shoulder, elbow, elbow, elbow, elbow)):
        stop = stopping_table(name).stop(FULL * np.eye(6)[joint])
        assert stop.duration_s == pytest.approx(seconds)
        assert stop.travel_s * FULL == pytest.approx(radians)


def test_the_slowest_joint_decides() -> None:
    table = stopping_table("ur5e")
    both = table.stop(np.array([FULL, FULL / 2, 0, 0, 0, 0]))
    assert both.duration_s == pytest.approx(max(0.244, 0.265))
    assert table.stop(np.zeros(6)).duration_s == 0
    assert table.stop(np.zeros(6)).travel_s == 0


@pytest.mark.parametrize("name", [*UR_NAMES, "another"])
@given(speed=st.floats(0.01, 6.0), more=st.floats(1.0, 2.0))
def test_faster_never_stops_sooner_and_less_than_all_the_way_is_gone(name: str, speed: float, more: float) -> None:
    table = stopping_table(name)
    slow, fast = table.stop(np.full(6, speed)), table.stop(np.full(6, speed * more))
    assert fast.duration_s >= slow.duration_s > 0
    assert fast.travel_s >= slow.travel_s > 0
    assert slow.travel_s <= slow.duration_s


def test_rows_are_met_and_joined() -> None:
    table = StoppingTable(np.array([1.0, 2.0]), np.array([[0.1], [0.3]]), np.array([[0.06], [0.4]]))
    assert table.stop(np.array([1.0])).duration_s == pytest.approx(0.1)
    assert table.stop(np.array([2.0])).travel_s == pytest.approx(0.2)
    assert table.stop(np.array([-1.5])).duration_s == pytest.approx(0.2)
    assert table.stop(np.array([4.0])).duration_s == pytest.approx(0.6)


@pytest.mark.parametrize("speed", [0.5, 1.0, 2.0, 4.0, 6.0])
@pytest.mark.parametrize("last", [0.5, 1.0, 2.0])
def test_beyond_its_last_row_a_table_counts_in_proportion_among_others_too(speed: float, last: float) -> None:
    slow = StoppingTable(np.array([last]), np.array([[0.5 * last]]), np.array([[0.3 * last**2]]))
    quick = StoppingTable(np.array([1.0, 4.0]), np.array([[0.1], [0.4]]), np.array([[0.05], [0.8]]))
    at = np.array([speed])
    for both in (slow.slower_of(quick), quick.slower_of(slow)):
        assert both.stop(at).duration_s == pytest.approx(slow.stop(at).duration_s)
        assert both.stop(at).travel_s == pytest.approx(max(slow.stop(at).travel_s, quick.stop(at).travel_s))


def test_wrong_tables_are_refused() -> None:
    with pytest.raises(ArmError, match="expected rising speeds"):
        StoppingTable(np.array([2.0, 1.0]), np.ones((2, 6)), np.ones((2, 6)))
    with pytest.raises(ArmError, match="expected rising speeds"):
        StoppingTable(np.array([1.0]), np.ones((2, 6)), np.ones((2, 6)))
    with pytest.raises(ArmError, match="expected rising speeds"):
        StoppingTable(np.empty(0), np.ones((0, 6)), np.ones((0, 6)))
    with pytest.raises(ArmError, match="expected rising speeds"):
        StoppingTable(np.array([1.0]), np.ones((1, 6)), np.ones((1, 5)))
    with pytest.raises(ArmError, match="expected rising speeds"):
        StoppingTable(np.array([1.0]), np.ones(1), np.ones(1))


@pytest.mark.parametrize("speeds", [[183.0], [30.0], [1.0, 60.0]])
def test_a_table_in_degrees_is_refused(speeds: list[float]) -> None:
    """At the arm's 3 rad/s it would be read at its foot: as a stop in a hundredth of the way."""
    times = np.full((len(speeds), 6), 0.5)
    with pytest.raises(ArmError, match=f"expected speeds in rad/s, at most 15, found {speeds[-1]:g}; divide degrees"):
        StoppingTable(np.array(speeds), times, times)
    StoppingTable(np.deg2rad(speeds), times, times)


@pytest.mark.parametrize("joints", [1, 4, 7])
def test_an_arm_without_six_joints_stops_as_late_as_the_slowest_one(joints: int) -> None:
    table, known = stopping_table("another", joints), stopping_table("another")
    for joint in range(joints):
        alone = np.zeros(joints)
        alone[joint] = FULL
        assert table.stop(alone) == known.stop(np.array([0.0, FULL, 0, 0, 0, 0]))


def test_the_table_of_an_arm_of_other_joints_is_refused() -> None:
    with pytest.raises(ArmError, match="expected speeds of 6 joints, found 7"):
        stopping_table("ur5e").stop(np.ones(7))
    with pytest.raises(ArmError, match="expected one of 6 joints, found one of 7"):
        stopping_table("ur5e").slower_of(stopping_table("another", 7))


def test_a_joint_that_stops_at_once_is_no_error() -> None:
    table = StoppingTable(np.array([1.0]), np.array([[0.0, 0.2]]), np.array([[0.0, 0.1]]))
    assert table.stop(np.array([1.0, 0.0])).duration_s == 0
    assert table.stop(np.array([1.0, 1.0])).duration_s == 0.2


@pytest.mark.parametrize("wrong", [np.nan, np.inf, -0.1])
def test_times_and_angles_that_none_are_are_refused(wrong: float) -> None:
    right, bad = np.ones((1, 6)), np.ones((1, 6))
    bad[0, 3] = wrong
    for times, angles in ((bad, right), (right, bad)):
        with pytest.raises(ArmError, match="expected finite times and angles of 0 or more"):
            StoppingTable(np.array([1.0]), times, angles)
    with pytest.raises(ArmError, match="expected rising speeds"):
        StoppingTable(np.array([1.0, np.nan]), np.ones((2, 6)), np.ones((2, 6)))
