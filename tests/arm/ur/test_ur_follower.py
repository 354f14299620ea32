"""Trajectories in stretched time: slowed along their path, refused where the arm could not follow."""

from __future__ import annotations

import numpy as np
import pytest
from fake_link import MODEL, START, quintic
from hypothesis import given, settings
from hypothesis import strategies as st

from twin_node.arm.errors import ArmError
from twin_node.arm.ur import PathFollower
from twin_node.robot import RobotError
from twin_node.scene import Float64, JointPath

PERIOD_S = 0.004


def followed(path: JointPath, fractions: list[float]) -> Float64:
    follower = PathFollower(MODEL, path, START)
    return np.array([follower.advance(fraction, PERIOD_S) for fraction in fractions])


@settings(max_examples=25)
@given(fractions=st.lists(st.floats(0, 1), min_size=10, max_size=10), way=st.sampled_from([-0.8, 0.8]))
def test_the_arm_stays_on_its_path_within_its_limits_whatever_the_speed(fractions: list[float], way: float) -> None:
    path = quintic(way=way)
    positions = followed(path, [fraction for fraction in fractions for _ in range(60)])
    nearest = np.linalg.norm(positions[:, None] - path.positions[None], axis=2).min(axis=1)
    assert nearest.max() < 0.01  # between two of the path's own samples
    velocities = np.diff(positions, axis=0) / PERIOD_S
    accelerations = np.diff(velocities, axis=0) / PERIOD_S
    assert np.all(np.abs(velocities) <= MODEL.max_velocity)
    assert np.abs(accelerations).max() <= 2 * MODEL.max_acceleration.max()


def test_full_speed_takes_the_paths_own_time_but_for_the_start() -> None:
    path = quintic(seconds=1.0)
    positions = followed(path, [1.0] * 270)
    np.testing.assert_allclose(positions[-1], path.positions[-1])
    assert not np.allclose(positions[240], path.positions[-1], atol=1e-9)


def test_a_stop_is_made_on_the_path_and_gone_on_from() -> None:
    path = quintic()
    positions = followed(path, [1.0] * 250 + [0.0] * 150 + [1.0] * 600)
    speeds = np.abs(np.diff(positions, axis=0)).max(axis=1) / PERIOD_S
    assert speeds[380:399].max() < 1e-9
    np.testing.assert_allclose(positions[-1], path.positions[-1])


def test_the_future_is_told_at_the_paths_own_speed_even_when_slowed() -> None:
    path = quintic()
    follower = PathFollower(MODEL, path, START)
    for _ in range(200):
        follower.advance(0.1, PERIOD_S)
    ahead = follower.ahead(7_000_000_000)
    np.testing.assert_array_equal(ahead.stamps, 7_000_000_000 + 10_000_000 * np.arange(21))
    np.testing.assert_allclose(ahead.positions[0], follower.q, atol=1e-3)  # 0.1 s behind at a tenth of the speed
    begun = follower.q
    for _ in range(50):
        follower.advance(0.1, PERIOD_S)
    travelled = np.abs(follower.q - begun).max()
    assert np.abs(ahead.positions[-1] - begun).max() > 5 * travelled


@pytest.mark.parametrize(
    ("path", "word"),
    [
        (quintic(START + 0.3), "begin where the arm stands"),
        (quintic(START - 0.3), "begin where the arm stands"),
        (quintic(START + 0.1 * np.eye(6)[4]), "begin where the arm stands, found wrist_2_joint 0.10 rad away"),
        (quintic(way=0.8, seconds=0.2), "shoulder_pan_joint at 3.14 rad/s at most"),
        (quintic(way=-0.8, seconds=0.2), "shoulder_pan_joint at 3.14 rad/s at most"),
        (quintic(way=7.0, seconds=20.0), "shoulder_pan_joint within -6.28 to 6.28"),
        (quintic(way=-7.0, seconds=20.0), "shoulder_pan_joint within -6.28 to 6.28"),
        (JointPath(MODEL.joint_names, quintic().stamps, quintic().positions[:, :5]), "expected positions of shape"),
        (JointPath(MODEL.joint_names[:5], quintic().stamps, quintic().positions[:, :5]), "wrist_3_joint"),
        (JointPath(MODEL.joint_names, quintic().stamps, quintic().positions * np.nan), "finite"),
        (JointPath(MODEL.joint_names, quintic().stamps[::-1], quintic().positions), "increasing"),
        (JointPath(MODEL.joint_names, np.zeros(0, np.int64), np.zeros((0, 6))), "at least one row"),
    ],
)
def test_paths_that_cannot_be_followed_are_refused_with_the_reason(path: JointPath, word: str) -> None:
    with pytest.raises((ArmError, RobotError), match=word):
        PathFollower(MODEL, path, START)
