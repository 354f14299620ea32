"""What a controller says is believed only where it can be true."""

from __future__ import annotations

import numpy as np
import pytest
from fake_link import MODEL, START, sample
from hypothesis import given
from hypothesis import strategies as st

from twin_node.arm import extrapolate
from twin_node.arm.ur import UrSample, implausible, not_ready
from twin_node.arm.ur.freshness import Freshness
from twin_node.arm.ur.sample import SafetyMode
from twin_node.resources import find
from twin_node.robot import ur_model
from twin_node.robot.mjcf import load_arm

JOINT_FIELDS = ("q", "qd", "target_q", "target_qd")


def test_a_true_state_is_believed() -> None:
    assert implausible(MODEL, sample(), None) is None
    assert implausible(MODEL, sample(1.008, q=START + 0.004), sample()) is None


@pytest.mark.parametrize("mode", SafetyMode)
def test_an_arm_may_move_in_two_safety_modes_alone(mode: SafetyMode) -> None:
    lets = mode in (SafetyMode.NORMAL, SafetyMode.REDUCED)
    assert sample(safety_mode=int(mode)).may_move == lets == (not_ready(sample(safety_mode=int(mode))) is None)


@pytest.mark.parametrize("field", JOINT_FIELDS)
@given(joint=st.integers(0, 5), value=st.sampled_from([np.nan, np.inf, -np.inf]))
def test_numbers_that_are_none_are_refused_wherever_they_stand(field: str, joint: int, value: float) -> None:
    values = np.zeros(6)
    values[joint] = value
    assert "not finite" in str(implausible(MODEL, sample(**{field: values}), None))


@pytest.mark.parametrize("field", JOINT_FIELDS)
@given(count=st.integers(0, 12).filter(lambda n: n != 6))
def test_another_number_of_joints_is_refused(field: str, count: int) -> None:
    assert f"sent {count} " in str(implausible(MODEL, sample(**{field: np.zeros(count)}), None))


@pytest.mark.parametrize(
    ("changes", "word"),
    [
        ({"robot_mode": 1072693248}, "no such modes"),
        ({"safety_mode": -5}, "no such modes"),
        ({"safety_mode": 0}, "no such modes"),
        ({"safety_mode": 1072693248}, "no such modes"),
        ({"runtime_state": 77}, "runtime state 77"),
        ({"speed_slider": 1.5}, "speed slider 1.5"),
        ({"speed_slider": float("nan")}, "speed slider nan"),
        ({"speed_scaling": float("nan")}, "speed scaling nan"),
        ({"speed_scaling": float("inf")}, "speed scaling inf"),
        ({"speed_scaling": -0.5}, "speed scaling -0.5"),
        ({"qd": np.array([0, 0, 9.0, 0, 0, 0])}, "elbow_joint: beyond its rating"),
        ({"qd": np.array([0, 1.0, -9.0, 0, 0, 0])}, "elbow_joint: beyond its rating"),
        ({"q": np.array([0, 0, 0, 8.0, 0, 0])}, "wrist_1_joint: beyond its range"),
        ({"q": np.array([0, 6.0, 0, -8.0, 0, 0])}, "wrist_1_joint: beyond its range"),
        ({"target_qd": np.array([0, 1.0, -9.0, 0, 0, 0])}, "elbow_joint: beyond its rating"),
        ({"target_q": np.array([0, 6.0, 0, 8.0, 0, 0])}, "wrist_1_joint: beyond its range"),
    ],
)
def test_numbers_in_wrong_fields_are_refused(changes: dict[str, object], word: str) -> None:
    assert word in str(implausible(MODEL, sample(**changes), None))


@pytest.mark.parametrize("way", [-0.5, 0.5])
def test_an_arm_does_not_jump(way: float) -> None:
    away = START + np.array([0.01, way, 0, 0, 0, 0])
    for clock_s in (1.008, 0.5):  # an earlier time explains nothing
        found = implausible(MODEL, sample(clock_s, q=away), sample())
        assert found == "shoulder_lift_joint jumped by 0.50 rad"
    assert implausible(MODEL, sample(2.0, q=away), sample()) is None  # a second without packages explains it


@pytest.mark.parametrize("end", [-1, 1])
def test_an_arm_may_stand_a_little_beyond_the_range_of_its_ratings(end: int) -> None:
    for beyond, believed in ((0.15, True), (0.25, False)):
        q = np.array([0, 0, 0, 0, end * (MODEL.upper[4] + beyond), 0])
        assert (implausible(MODEL, sample(q=q), None) is None) == believed


def test_five_joints_decoded_as_six_are_refused() -> None:
    """A package whose angles lack one value: all that follows slides into the fields before."""
    slid = UrSample(1.0, np.append(START[:5], 0.5), START, START, START, 1072693248, 0, 0, 2.0, 1.0)
    assert implausible(MODEL, slid, sample()) is not None


@pytest.mark.parametrize(
    ("changes", "word"),
    [({"safety_mode": 3}, "PROTECTIVE_STOP"), ({"safety_mode": 7}, "EMERGENCY"), ({"robot_mode": 5}, "IDLE")],
)
def test_an_arm_that_may_not_move_says_what_is_to_be_done(changes: dict[str, object], word: str) -> None:
    assert not_ready(sample()) is None
    assert sample().may_move
    assert not sample(**changes).may_move
    reason = not_ready(sample(**changes))
    assert reason is not None
    assert word in reason


SECOND_NS = 1_000_000_000


@given(st.lists(st.floats(0, 1e6), min_size=1, max_size=30))
def test_only_an_advancing_clock_is_fresh(clocks: list[float]) -> None:
    watch = Freshness(0, SECOND_NS)
    newest, age_s = -1.0, 0
    for step, clock in enumerate(clocks, 1):
        is_new = watch.see(clock, step * SECOND_NS)
        assert is_new == (clock > newest)
        if clock < newest:
            assert watch.has_gone_back
        newest = max(newest, clock)
        age_s = 0 if is_new else age_s + 1
        assert watch.age_s == pytest.approx(age_s)


def test_a_driver_that_was_held_up_does_not_blame_the_controller() -> None:
    watch = Freshness(0, SECOND_NS // 100)
    watch.see(1.0, SECOND_NS)
    watch.see(1.0, 2 * SECOND_NS)
    assert watch.age_s == pytest.approx(0.01)
    assert watch.see(2.0, 2 * SECOND_NS + 1)


def test_the_last_joint_of_a_ur3e_turns_for_ever() -> None:
    """As its manual says; after one turn too many the driver halted, and the arm was taken not to turn at all."""
    turned = np.array([0, 0, 0, 0, 0, 40.0])
    ur3e, state = ur_model("ur3e"), sample(q=turned, target_q=turned)
    assert implausible(ur3e, state, None) is None
    assert "wrist_3_joint: beyond its range" in str(implausible(MODEL, state, None))
    ahead = extrapolate(ur3e, turned, np.array([0, 0, 0, 0, 0, 1.0]), 0)
    np.testing.assert_allclose(ahead.positions[-1, 5], 40.2)
    assert load_arm(find("sim/ur3e.xml")).upper[5] == np.inf
