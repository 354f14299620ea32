"""Cameras that see past the arm tell that the rig, the hand-eye pose or the joints are wrong."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from twin_node.geometry import looking_at
from twin_node.model import ModelParameters, SeedParameters, WindowModel
from twin_node.model.arm_sight import ArmSight
from twin_node.model.robot_links import arm_depth
from twin_node.robot import ArmModel, robot_mask, ur_model
from twin_node.scene import Camera, FrameSet, JointSample, View

ARM = ur_model("ur5e")
Q = np.array([0.3, -1.2, 1.4, -1.7, -1.57, 0.0])
K = np.array([[60.0, 0, 40.0], [0, 60.0, 30.0], [0, 0, 1.0]])
EYES = ((1.6, 0.6, 0.9), (0.4, -1.7, 1.0), (-1.2, 1.1, 1.1))
CAMERAS = [
    Camera(f"cam{i}", 80, 60, K, looking_at(np.array(eye), np.array([0.1, 0, 0.3]))) for i, eye in enumerate(EYES)
]
WALL_M = np.float32(4.0)


def seen(stamp_s: float, q: NDArray[np.float64] = Q, hand: bool = False) -> FrameSet:
    """The arm at `q` before a wall, its joints told as `Q`; `hand`: something close to the lens hides all."""
    views = []
    for camera in CAMERAS:
        depth = arm_depth(ARM, q, camera, robot_mask(ARM, q, camera))
        depth = np.where(depth > 0, depth, WALL_M)
        depth = np.full_like(depth, 0.3) if hand else depth
        views.append(View(camera, int(stamp_s * 1e9), np.zeros((60, 80, 3), np.uint8), depth))
    joints = JointSample(int(stamp_s * 1e9), ARM.joint_names, Q, np.zeros(6))
    return FrameSet(int(stamp_s * 1e9), tuple(views), joints=joints)


def told_by(frames: FrameSet, arm: ArmModel = ARM) -> tuple[str, ...]:
    """What is told of a set that goes on, taken for that of `arm`."""
    sight = ArmSight(arm)
    for at in np.arange(0.0, 1.5, 0.1):
        sight.heed(replace(frames, stamp=int(at * 1e9)))
    return sight.warnings


def moved(frames: FrameSet, X: NDArray[np.float64], only: str = "") -> FrameSet:
    """The same images, of cameras that are said to be elsewhere."""
    views = [
        replace(v, camera=replace(v.camera, T_base_cam=X @ v.camera.T_base_cam)) if only in v.camera.name else v
        for v in frames.views
    ]
    return replace(frames, views=tuple(views))


def turned(degrees: float) -> NDArray[np.float64]:
    X = np.eye(4)
    X[:2, :2] = [
        [np.cos(np.radians(degrees)), -np.sin(np.radians(degrees))],
        [np.sin(np.radians(degrees)), np.cos(np.radians(degrees))],
    ]
    return X


def shifted(*by_m: float) -> NDArray[np.float64]:
    X = np.eye(4)
    X[:3, 3] = by_m
    return X


@pytest.mark.parametrize("X", [np.eye(4), shifted(0.03, 0, 0), shifted(0, -0.03, 0.02), turned(3)])
def test_an_arm_that_is_about_where_it_should_be_is_nothing_to_tell(X: NDArray[np.float64]) -> None:
    assert told_by(moved(seen(0), X)) == ()


def test_a_rig_that_is_far_off_is_told() -> None:
    (line,) = told_by(moved(seen(0), shifted(0.25, 0, 0)))
    assert "base_link" in line
    assert "hand-eye" in line


@pytest.mark.parametrize("degrees", [180, 90, -90])
def test_a_rig_in_a_base_that_is_turned_is_told_by_how_much_to_turn_it(degrees: int) -> None:
    (line,) = told_by(moved(seen(0), turned(degrees)))
    assert f"by {-degrees if abs(degrees) == 90 else degrees} degrees about z against base_link" in line


@pytest.mark.parametrize("name", ["ur3e", "ur10e", "ur12e"])
def test_an_arm_of_another_size_is_told_by_its_name(name: str) -> None:
    (line,) = told_by(seen(0), arm=ur_model(name))
    assert f"it looks like a ur5e and not like a {name}" in line


def test_an_arm_with_the_same_links_is_about_where_it_should_be() -> None:
    assert told_by(seen(0), arm=ur_model("ur7e")) == ()


def test_joints_of_another_order_are_told() -> None:
    (line,) = told_by(seen(0, q=Q[[2, 1, 0, 3, 4, 5]]))
    assert "joints" in line


def test_one_camera_that_alone_sees_past_it_is_named() -> None:
    (line,) = told_by(moved(seen(0), turned(180), only="cam1"))
    assert "cam1" in line
    assert "cam0" not in line


def test_a_gripper_that_holds_less_than_it_may_says_nothing() -> None:
    along = np.linspace([0, 0, 0.1], [0, 0, 0.9], 9)
    tool = np.stack([along[:-1], along[1:]], axis=1)
    assert told_by(seen(0), arm=ARM.carrying(tool, np.full(len(tool), 0.03))) == ()


def test_what_hides_the_arm_says_nothing_of_it() -> None:
    assert told_by(moved(seen(0, hand=True), turned(180))) == ()


def test_it_is_told_after_a_moment_and_taken_back_once_it_fits() -> None:
    sight = ArmSight(ARM)
    told = []
    for at in np.arange(0.0, 8.0, 0.1):
        wrong = at < 2
        sight.heed(moved(seen(at), turned(180) if wrong else np.eye(4)))
        told.append(bool(sight.warnings))
    assert not told[0]
    assert told[10]
    assert not told[-1]


def test_what_was_told_is_forgotten_once_nobody_sees_the_arm_any_more() -> None:
    """As where somebody stands before every lens, a camera is gone, or nobody tells the joints any more."""
    no_joints = replace(moved(seen(0), shifted(0.25, 0, 0)), joints=None)
    for later in (moved(seen(0, hand=True), turned(180)), replace(seen(0), views=()), no_joints):
        sight = ArmSight(ARM)
        for at in np.arange(0.0, 2.0, 0.1):
            sight.heed(replace(moved(seen(0), shifted(0.25, 0, 0)), stamp=int(at * 1e9)))
        assert sight.warnings
        sight.heed(replace(later, stamp=int(2.2e9)))
        assert sight.warnings
        for at in np.arange(2.4, 6.0, 0.2):
            sight.heed(replace(later, stamp=int(at * 1e9)))
        assert sight.warnings == ()


def test_joints_that_were_told_some_time_ago_say_where_the_arm_is_by_now() -> None:
    """At 10 Hz they are up to 0.1 s old: a quick arm is elsewhere since, as they say themselves."""
    frames, speeds = seen(0), np.array([2.5, 1.0, 0, 0, 0, 0])
    assert frames.joints is not None
    old = replace(frames.joints, positions=Q - 0.1 * speeds, velocities=speeds)
    for told, is_wrong in ((old, False), (replace(old, velocities=np.zeros(6)), True)):
        sight = ArmSight(ARM)
        for at in np.arange(0.0, 1.5, 0.1):
            stamp = int(at * 1e9)
            sight.heed(replace(frames, stamp=stamp, joints=replace(told, stamp=stamp - 100_000_000)))
        assert bool(sight.warnings) == is_wrong


def test_without_an_arm_joints_or_depth_there_is_nothing_to_tell() -> None:
    wrong = moved(seen(0), turned(180))
    for sight, frames in (
        (ArmSight(None), wrong),
        (ArmSight(ARM), replace(wrong, joints=None)),
        (ArmSight(ARM), replace(wrong, views=tuple(replace(view, depth=None) for view in wrong.views))),
    ):
        for at in range(5):
            sight.heed(replace(frames, stamp=at * 10**9))
        assert sight.warnings == ()


def test_the_models_state_tells_of_it() -> None:
    model = WindowModel(ModelParameters(seed=SeedParameters(steps=4), gaussians_per_pixel=0.3), arm=ARM)
    for at in (0.0, 0.5, 1.0):
        state = model.update(moved(seen(at), turned(180)))
    assert any("base_link" in warning for warning in state.warnings)
