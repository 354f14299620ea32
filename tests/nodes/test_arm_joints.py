"""What the arm's node makes of the joints that it is told of: late, old, of others, without velocities."""

from __future__ import annotations

import numpy as np
import pytest
from arm_cell import MODEL, READY, TURNING, Cell, Timers

from twin_node.errors import TwinError
from twin_node.messages import convert
from twin_node.nodes.topics import JOINT_STATES
from twin_node.scene import JointSample


def test_an_arm_whose_joints_come_without_velocities_is_known_to_move() -> None:
    cell = Cell()
    for i in range(20):
        cell.joints(READY + TURNING * (i - 20) * 0.008, has_velocities=False)
        cell.wait(8)
    assert cell.somebody().reason == "slow for MOVING"


def test_an_arm_whose_driver_fills_in_zeros_for_its_velocities_is_known_to_move() -> None:
    """It was taken to stand wherever it was seen: "clear", at full speed towards somebody."""
    cell = Cell()
    for i in range(20):
        cell.joints(READY + TURNING * (i - 20) * 0.008, 0 * TURNING)
        cell.wait(8)
    assert cell.somebody().reason == "slow for MOVING"
    cell.joints(READY)  # once one is told they all are believed
    cell.wait(8)
    cell.joints(READY + 0.1 * TURNING, 0 * TURNING)
    assert cell.somebody().reason == "clear; speeding up"


def test_an_arm_beside_a_gripper_that_tells_no_velocity_is_known() -> None:
    """ros2_control's broadcaster says NaN for it, in one message with the arm's joints."""
    cell = Cell()
    message = convert.joint_sample_to_message(JointSample(cell.clock.now(), MODEL.joint_names, READY, TURNING))
    message.name.append("gripper")
    message.position, message.velocity = np.append(message.position, 0.02), np.append(message.velocity, np.nan)
    cell.bus.publish(JOINT_STATES, message)
    assert cell.somebody().reason == "slow for MOVING"


def test_joints_that_have_stopped_coming_stop_the_arm_and_it_says_so() -> None:
    cell = Cell()
    cell.joints(qd=np.zeros(6))
    assert cell.somebody().reason == "clear; speeding up"
    cell.wait(390)
    assert cell.somebody().reason == "clear; speeding up"
    cell.wait(20)
    told = cell.somebody()
    assert (told.speed_fraction, told.reason) == (0.0, "stopped: the arm's joints are 410 ms old")
    cell.joints(ago_ms=-500)
    assert cell.somebody().reason == "stopped: the arm's joints are 500 ms in the future"
    cell.joints(qd=np.zeros(6), ago_ms=0)
    assert cell.somebody().reason == "clear; speeding up"


def test_a_gripper_that_publishes_its_own_joints_beside_the_arms_changes_nothing() -> None:
    cell = Cell()
    cell.gripper()
    cell.joints()
    cell.gripper()
    assert cell.somebody().reason == "slow for MOVING"


def test_joints_of_another_arm_alone_are_refused_by_name() -> None:
    """`/diagnostics` said that nobody publishes any, and that a made-up cycle is judged."""
    cell = Cell()
    cell.gripper()
    with pytest.raises(TwinError, match="found finger_joint"):
        cell.somebody()
    told = cell.node.diagnoses()[0]
    assert told.level is convert.Level.ERROR and "expected shoulder_pan_joint" in told.message
    cell.joints()
    assert cell.node.diagnoses()[0].message == "known"


def test_a_live_arm_of_which_only_another_ones_joints_come_stands_for_that_and_no_forecast_is_refused() -> None:
    """Each of the obstacles was refused for it: there was said to be no forecast, and none that could be read."""
    cell = Cell(Timers())
    cell.gripper()
    told = cell.somebody()
    assert told.speed_fraction == 0 and told.reason.startswith("stopped: joint values: expected shoulder_pan_joint")
    known, _, forecasts = cell.node.diagnoses()
    assert known.level is convert.Level.ERROR and "found finger_joint" in known.message
    assert (forecasts.level, forecasts.message) == (convert.Level.OK, "in time")


def test_an_arm_whose_joints_are_two_arms_stands_and_says_so() -> None:
    cell = Cell()
    for _ in range(3):
        cell.wait(8)
        cell.joints(READY, 0 * TURNING)
        cell.joints(READY + TURNING, 0 * TURNING)
    told = cell.somebody(at=np.full(3, 5.0))
    assert (told.speed_fraction, told.reason) == (
        0.0,
        "stopped: the arm's joints jump by 1.00 rad: two arms' have the same names",
    )
    known = cell.node.diagnoses()[0]
    assert known.level is convert.Level.ERROR
    assert "give their joints' names a prefix each" in known.message


def test_joints_that_come_late_do_not_replace_newer_ones() -> None:
    cell = Cell()
    cell.joints()
    cell.joints(qd=np.zeros(6), ago_ms=30)
    assert cell.somebody().reason == "slow for MOVING"


@pytest.mark.parametrize(
    ("ago_ms", "when"),
    [(410, "410 ms old"), (37_000, "37000 ms old"), (-3_600_000, "3600000 ms in the future")],
)
def test_diagnostics_tell_an_arm_that_stands_since_its_joints_are_of_another_time(ago_ms: int, when: str) -> None:
    """They said "known": `doctor` found all sound beside an arm whose driver had died, or went by another clock."""
    cell = Cell(Timers())
    cell.joints(qd=np.zeros(6), ago_ms=ago_ms)
    assert cell.somebody().reason == f"stopped: the arm's joints are {when}"
    known = cell.node.diagnoses()[0]
    assert known.level is convert.Level.ERROR
    assert known.message.startswith(f"the arm's joints are {when}, so it stands; look at who publishes /joint_states")
    cell.joints()
    assert cell.node.diagnoses()[0].message == "known"


def test_diagnostics_warn_of_an_arm_whose_path_alone_is_fresh() -> None:
    """Nobody knows then whether it follows that, and to the images it is a thing that moves."""
    cell = Cell(Timers())
    cell.joints(ago_ms=37_000)
    cell.path(0, 1000)
    assert not cell.somebody().reason.startswith("stopped: the arm's joints")
    known = cell.node.diagnoses()[0]
    assert known.level is convert.Level.WARN
    assert known.message.startswith("the arm's joints are 37000 ms old: /arm/trajectory alone is believed")
