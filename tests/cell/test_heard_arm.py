"""An arm that somebody else moves is where its joints are heard to be, whenever it is drawn."""

from __future__ import annotations

import numpy as np
import pytest

from twin_node.cell import load_scenario
from twin_node.cell.ur_arm import FORESEEN_NS, HEARD_NS, HeardArm
from twin_node.scene import Float64, JointSample

MS = 1_000_000
TELLER_NS = 1_700_000_000_000_000_000
"""The teller's clock when the scenario begins, ns."""


@pytest.fixture
def arm() -> HeardArm:
    scenario = load_scenario("demo")
    assert scenario.arm is not None
    heard = HeardArm(scenario.arm, scenario)
    heard.teller_ahead_ns = TELLER_NS - scenario.start_ns
    return heard


def told(arm: HeardArm, ms: float, first_joint: float, speed: float = 0.0) -> JointSample:
    q = arm.cycle.at(0).copy()
    q[0] = first_joint
    return JointSample(TELLER_NS + round(ms * MS), arm.model.joint_names, q, np.eye(6)[0] * speed)


def first_joint(arm: HeardArm, *ms: float) -> Float64:
    stamps = TELLER_NS - arm.teller_ahead_ns + np.rint(np.array(ms) * MS).astype(np.int64)
    return arm.positions(stamps)[:, 0]


def test_until_it_is_heard_of_it_waits_where_its_program_begins(arm: HeardArm) -> None:
    assert np.array_equal(first_joint(arm, 0.0, 5000.0), np.repeat(arm.cycle.at(0)[0], 2))


def test_between_two_tellings_it_is_between_them(arm: HeardArm) -> None:
    for ms, joint in ((0.0, 0.2), (8.0, 0.4), (16.0, 0.3)):
        arm.hear(told(arm, ms, joint))
    np.testing.assert_allclose(first_joint(arm, -50.0, 0.0, 4.0, 8.0, 12.0, 16.0), [0.2, 0.2, 0.3, 0.4, 0.35, 0.3])


def test_after_the_newest_it_goes_on_at_its_speed_for_a_while(arm: HeardArm) -> None:
    arm.hear(told(arm, 0.0, 0.5, speed=2.0))
    longest = FORESEEN_NS / MS
    np.testing.assert_allclose(first_joint(arm, 30.0, longest, 10 * longest), [0.56, 0.5 + 2e-3 * longest, 0.7])


def test_whoever_tells_late_or_of_other_joints_is_not_heard(arm: HeardArm) -> None:
    arm.hear(told(arm, 8.0, 0.4))
    arm.hear(told(arm, 4.0, 9.0))
    arm.hear(JointSample(TELLER_NS + 12 * MS, ("gripper",), np.full(1, 9.0), np.zeros(1)))
    assert first_joint(arm, 20.0)[0] == 0.4


def test_a_clock_that_was_set_back_is_followed(arm: HeardArm) -> None:
    """Until it was where it had been the arm would stand in all images."""
    arm.hear(told(arm, 3_600_000.0, 0.4))
    arm.hear(told(arm, 0.0, 0.6))
    arm.hear(told(arm, 8.0, 0.7))
    np.testing.assert_allclose(first_joint(arm, 4.0, 8.0), [0.65, 0.7])


def test_joints_in_another_order_and_beside_others_are_put_in_order(arm: HeardArm) -> None:
    one = told(arm, 8.0, 0.4, speed=1.0)
    names = ("gripper", *reversed(one.names))
    swapped = JointSample(one.stamp, names, np.append(9.0, one.positions[::-1]), np.append(9.0, one.velocities[::-1]))
    arm.hear(swapped)
    stamps = np.array([one.stamp - arm.teller_ahead_ns])
    assert np.array_equal(arm.positions(stamps)[0], one.positions)
    np.testing.assert_allclose(first_joint(arm, 18.0), 0.41)


def test_no_more_is_kept_of_it_than_images_may_be_late(arm: HeardArm) -> None:
    for ms in range(0, 5000, 100):
        arm.hear(told(arm, ms, ms * 1e-4))
    oldest = 4900 - HEARD_NS / MS
    np.testing.assert_allclose(first_joint(arm, 0.0, oldest, 4850.0), [oldest * 1e-4, oldest * 1e-4, 0.485])
