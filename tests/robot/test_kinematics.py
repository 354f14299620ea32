"""Forward kinematics against the textbook product of DH matrices, against UR's URDF, and by its derivatives."""

from __future__ import annotations

import re
from pathlib import Path

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from twin_node.robot import (
    UR_NAMES,
    RobotError,
    arm_model,
    forward_kinematics,
    place_capsules,
    ur_dh,
    ur_model,
    ur_shape,
)
from twin_node.robot.kinematics import tool_jacobian
from twin_node.scene import JointSample

UR10E_DATA = Path(__file__).resolve().parents[3] / "shared" / "data" / "ur10e_model"
angles = st.lists(st.floats(-6.2, 6.2), min_size=6, max_size=6).map(np.array)


def product_of_dh_matrices(name: str, q: NDArray[np.float64]) -> NDArray[np.float64]:
    """Tool pose in `base_link`, written out element by element as in the textbooks."""
    dh = ur_dh(name)
    pose = np.diag([-1.0, -1.0, 1.0, 1.0])
    for theta, d, a, alpha in zip(q, dh.d, dh.a, dh.alpha, strict=True):
        ct, st_, ca, sa = np.cos(theta), np.sin(theta), np.cos(alpha), np.sin(alpha)
        pose = pose @ np.array(
            [[ct, -st_ * ca, st_ * sa, a * ct], [st_, ct * ca, -ct * sa, a * st_], [0, sa, ca, d], [0, 0, 0, 1]]
        )
    return pose


@pytest.mark.parametrize("name", UR_NAMES)
@given(q=angles)
@settings(max_examples=30, deadline=None)
def test_tool_pose_is_the_product_of_dh_matrices(name: str, q: NDArray[np.float64]) -> None:
    np.testing.assert_allclose(forward_kinematics(ur_model(name), q)[-1], product_of_dh_matrices(name, q), atol=1e-9)


def test_link_poses_are_those_of_the_urdf() -> None:
    if not UR10E_DATA.exists():
        pytest.skip(f"no UR10e URDF at {UR10E_DATA}")
    text = re.sub(r"<(visual|collision)>.*?</\1>", "", (UR10E_DATA / "ur10e.urdf").read_text(), flags=re.S)
    text = text.replace("<link name", '<mujoco><compiler fusestatic="false"/></mujoco><link name', 1)
    urdf = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(urdf)
    model = ur_model("ur10e")
    bodies = [urdf.body(name).id for name in model.link_names[1:]]
    for q in np.random.default_rng(3).uniform(-np.pi, np.pi, (100, 6)):
        data.qpos[:] = q
        mujoco.mj_kinematics(urdf, data)
        poses = forward_kinematics(model, q)[1:]
        np.testing.assert_allclose(poses[:, :3, 3], data.xpos[bodies], atol=1e-4)
        np.testing.assert_allclose(poses[:, :3, :3], data.xmat[bodies].reshape(-1, 3, 3), atol=1e-4)


def test_arms_that_carry_more_have_the_links_of_those_that_they_are_sold_in_place_of() -> None:
    shapes = {name: ur_shape(name) for name in UR_NAMES}
    assert {name: shape for name, shape in shapes.items() if shape != name} == {"ur7e": "ur5e", "ur12e": "ur10e"}
    assert ur_model("ur7e").name == "ur7e"
    np.testing.assert_array_equal(ur_model("ur7e").origins, ur_model("ur5e").origins)


def test_zero_angles_stretch_the_arm_along_x_of_base_link() -> None:
    tool = forward_kinematics(ur_model("ur10e"), np.zeros(6))[-1, :3, 3]
    # The arm lies along +x of base_link (-x of base); wrist offsets point to +y.
    np.testing.assert_allclose(tool, [0.6127 + 0.57155, 0.17415 + 0.11655, 0.1807 - 0.11985], atol=1e-9)


@given(q=angles)
@settings(max_examples=20, deadline=None)
def test_jacobian_is_the_derivative_of_the_tool_pose(q: NDArray[np.float64]) -> None:
    model, step = ur_model("ur5e"), 1e-6
    jacobian = tool_jacobian(forward_kinematics(model, q))
    pairs = forward_kinematics(model, q + step * np.stack([np.eye(6), -np.eye(6)]))[..., -1, :3, :]
    np.testing.assert_allclose(jacobian[:3], ((pairs[0] - pairs[1])[..., 3] / (2 * step)).T, atol=1e-7)
    now = forward_kinematics(model, q)[-1, :3, :3]
    spins = (pairs[0] - pairs[1])[..., :3] / (2 * step) @ now.T
    np.testing.assert_allclose(jacobian[3:], np.stack([spins[:, 2, 1], spins[:, 0, 2], spins[:, 1, 0]]), atol=1e-7)


def test_batches_are_what_single_poses_are() -> None:
    model = ur_model("ur3e")
    q = np.random.default_rng(0).uniform(-3, 3, (4, 5, 6))
    batch = place_capsules(model, forward_kinematics(model, q))
    assert batch.ends.shape == (4, 5, len(model.capsules), 2, 3)
    single = place_capsules(model, forward_kinematics(model, q[2, 3]))
    np.testing.assert_allclose(batch.ends[2, 3], single.ends, atol=1e-14)


def test_joints_are_put_into_the_models_order() -> None:
    model = ur_model("ur5e")
    shuffled = (2, 1, 0, 3, 5, 4)  # UR's ROS driver publishes the elbow first
    names = ("gripper", *(model.joint_names[j] for j in shuffled))
    sample = JointSample(0, names, np.array([9.0, *(float(j) for j in shuffled)]), np.zeros(7))
    np.testing.assert_array_equal(model.ordered_positions(sample), np.arange(6.0))


def test_joints_with_a_prefix_are_taken_once_they_are_named() -> None:
    """As a UR driver with a `tf_prefix` publishes them, here of two arms on one topic."""
    left, right = (tuple(prefix + name for name in ur_model("ur5e").joint_names) for prefix in ("left_", "right_"))
    sample = JointSample(0, (*right, *left), np.arange(12.0), np.zeros(12))
    with pytest.raises(RobotError, match=rf"say that they are called so: 'arm.joints: \[{', '.join(right)}\]'"):
        ur_model("ur5e").ordered_positions(sample)
    np.testing.assert_array_equal(arm_model("ur5e", joint_names=left).ordered_positions(sample), np.arange(6.0, 12))
    for wrong in (left[:5], left[::-1], ()):
        with pytest.raises(RobotError, match="expected those of ur5e in this order, shoulder_pan_joint"):
            arm_model("ur5e", joint_names=wrong)


def test_an_arm_is_found_under_the_names_that_its_joints_have() -> None:
    arm = ur_model("ur5e")
    left, right = (tuple(prefix + name for name in arm.joint_names) for prefix in ("left_", "right_"))
    assert arm.called_as(("gripper", *left)).joint_names == left
    assert arm.called_as((*left, *arm.joint_names)) is arm
    for several_or_none in ((*left, *right), ("gripper", *left[:5]), ()):
        with pytest.raises(RobotError, match="joints: expected those of one ur5e, shoulder_pan_joint"):
            arm.called_as(several_or_none)


def test_wrong_joint_values_are_refused() -> None:
    model = ur_model("ur5e")
    with pytest.raises(RobotError, match=r"expected 6 angles for ur5e, found shape \(5,\)"):
        forward_kinematics(model, np.zeros(5))
    with pytest.raises(RobotError, match="finite"):
        forward_kinematics(model, np.array([0, 0, np.nan, 0, 0, 0]))
    with pytest.raises(RobotError, match="finite angles of at most 1e\\+06 rad"):
        model.order(model.joint_names, np.array([0, 0, -1e300, 0, 0, 0]))
    with pytest.raises(RobotError, match="publish elbow_joint too"):
        model.order(tuple(name for name in model.joint_names if name != "elbow_joint"), np.zeros(5))
    for count in (0, 5, 7):
        with pytest.raises(RobotError, match=rf"expected one per name .*found shape \({count},\)"):
            model.ordered_positions(JointSample(0, model.joint_names, np.zeros(count), np.zeros(6)))
    with pytest.raises(RobotError, match=r"expected one of ur3e, ur5e, ur7e, ur10e, ur12e, ur16e.*; check the name"):
        ur_model("ur7")


@pytest.mark.parametrize(
    ("name", "told"),
    [("ur20", r"; ur_description makes one: .*/ur.urdf.xacro name:=ur ur_type:=ur20 > ur20.urdf"), ("UR10e", "ur10e")],
)
def test_arms_of_ur_that_are_not_known_by_name_are_told_where_theirs_is(name: str, told: str) -> None:
    """To check the name is no help to who has one of UR's larger arms."""
    with pytest.raises(RobotError, match=f"arm '{name}': expected one of ur3e.*{told}$"):
        arm_model(name)
