"""Stopping tables give back what was measured and go on sensibly between and beyond."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twin_node.arm import ArmError, StoppingTable, stopping_table
from twin_node.robot import UR_NAMES

FULL = np.deg2rad(183)


def test_the_manuals_figures_come_back() -> None:
    shoulder = np.array([0.0, FULL, 0, 0, 0, 0])
    stop = stopping_table("ur5e").stop(shoulder)
    assert stop.duration_s == pytest.approx(0.530)
    assert stop.travel_s * FULL == pytest.approx(0.70)


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
def test_beyond_its_last_row_a_table_counts_in_proportion_among_others_too(speed: float) -> None:
    slow = StoppingTable(np.array([1.0]), np.array([[0.5]]), np.array([[0.3]]))
    quick = StoppingTable(np.array([1.0, 4.0]), np.array([[0.1], [0.4]]), np.array([[0.05], [0.8]]))
    both, at = slow.slower_of(quick), np.array([speed])
    assert both.stop(at).duration_s == pytest.approx(slow.stop(at).duration_s)
    assert both.stop(at).travel_s == pytest.approx(max(slow.stop(at).travel_s, quick.stop(at).travel_s))


def test_wrong_tables_are_refused() -> None:
    with pytest.raises(ArmError, match="expected rising speeds"):
        StoppingTable(np.array([2.0, 1.0]), np.ones((2, 6)), np.ones((2, 6)))
    with pytest.raises(ArmError, match="expected rising speeds"):
        StoppingTable(np.array([1.0]), np.ones((2, 6)), np.ones((2, 6)))
    with pytest.raises(ArmError, match="expected rising speeds"):
        StoppingTable(np.empty(0), np.ones((0, 6)), np.ones((0, 6)))


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


@pytest.mark.parametrize("wrong", [np.nan, np.inf, -0.1])
def test_times_and_angles_that_none_are_are_refused(wrong: float) -> None:
    right, bad = np.ones((1, 6)), np.ones((1, 6))
    bad[0, 3] = wrong
    for times, angles in ((bad, right), (right, bad)):
        with pytest.raises(ArmError, match="expected finite times and angles of 0 or more"):
            StoppingTable(np.array([1.0]), times, angles)
    with pytest.raises(ArmError, match="expected rising speeds"):
        StoppingTable(np.array([1.0, np.nan]), np.ones((2, 6)), np.ones((2, 6)))
