"""The arm, obstacles and points of exported files, held to kinematics and log: where they are, and what they touch."""

from __future__ import annotations

import csv
from pathlib import Path

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from twin_logs import PERIOD, START, cloud_at, obstacles_at

from twin_node.bag import LogWriter
from twin_node.cli import main
from twin_node.messages import convert
from twin_node.messages.convert.markers import KIND_COLOURS
from twin_node.nodes.topics import JOINT_STATES, OBSTACLES
from twin_node.robot import forward_kinematics, ur_model
from twin_node.scene import Float64, JointSample, ObstacleKind

ARM = ur_model("ur5e")


def angles(k: int) -> Float64:
    """Those of the log at its moment k, rad."""
    return np.array([0.1 * k, -1.2, 1.4, -1.8, -1.5, 0.0])


def exported(log: Path, form: str, output: Path) -> Path:
    given = ["export", log, "--to", form, "--rate", 10, "-o", output, "--arm", "ur5e"]
    assert main([str(word) for word in given]) == 0
    return output


@pytest.mark.parametrize("frame", [0, 7])
def test_capsules_of_a_stage_are_those_of_the_arm(frame: int, twin_log: Path, tmp_path: Path) -> None:
    pytest.importorskip("pxr")
    from pxr import Usd, UsdGeom

    stage = Usd.Stage.Open(str(exported(twin_log, "usd", tmp_path / "a.usda")))
    poses, capsules = forward_kinematics(ARM, angles(frame)), ARM.capsules
    found = [prim for prim in stage.Traverse() if prim.IsA(UsdGeom.Capsule)]
    assert len(found) == len(capsules.radii)
    order = [int(row) for link in range(len(poses)) for row in np.flatnonzero(capsules.links == link)]
    for prim, row in zip(found, order, strict=True):
        capsule, pose = UsdGeom.Capsule(prim), poses[capsules.links[row]]
        placed = np.array(UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(frame)).T
        half = np.array([[0, 0, -1], [0, 0, 1]]) * capsule.GetHeightAttr().Get() / 2
        ends = half @ placed[:3, :3].T + placed[:3, 3]
        expected = capsules.ends[row] @ pose[:3, :3].T + pose[:3, 3]
        np.testing.assert_allclose(ends, expected, atol=1e-5)
        assert capsule.GetAxisAttr().Get() == "Z"
        assert capsule.GetRadiusAttr().Get() == pytest.approx(capsules.radii[row])


def test_an_obstacle_that_is_not_there_is_not_met_in_a_stage(tmp_path: Path) -> None:
    """The first alone is there at the second frame alone."""
    pytest.importorskip("pxr")
    from pxr import Usd, UsdPhysics

    with LogWriter(tmp_path / "log.mcap") as log:
        for k in range(3):
            stamp = START + k * PERIOD
            said = obstacles_at(k, stamp)
            there = np.arange(len(said.ids)) % 3 >= (0 if k == 1 else 1)
            log.write(OBSTACLES, convert.obstacles_to_message(said.only(there)), stamp)
    stage = Usd.Stage.Open(str(exported(tmp_path / "log.mcap", "usd", tmp_path / "a.usda")))
    for name, expected in (("MOVING_7", [False, True, False]), ("STATIC_9", [True] * 3)):
        collides = UsdPhysics.CollisionAPI(stage.GetPrimAtPath(f"/World/Obstacles/{name}")).GetCollisionEnabledAttr()
        assert [collides.Get(frame) for frame in range(3)] == expected


def test_points_of_a_stage_are_two_deviations_wide_either_side(twin_log: Path, tmp_path: Path) -> None:
    pytest.importorskip("pxr")
    from pxr import Usd, UsdGeom

    stage = Usd.Stage.Open(str(exported(twin_log, "usd", tmp_path / "a.usda")))
    points = UsdGeom.Points(stage.GetPrimAtPath("/World/Gaussians/Moving"))
    cloud = cloud_at(7, False)
    np.testing.assert_allclose(points.GetWidthsAttr().Get(7), 4 * cloud.scales.mean(axis=1), rtol=1e-5)
    assert list(points.GetIdsAttr().Get(7)) == cloud.ids.tolist()
    whole = UsdGeom.Points.ComputeExtent(points.GetPointsAttr().Get(7), points.GetWidthsAttr().Get(7))
    np.testing.assert_allclose(points.GetExtentAttr().Get(7), whole, atol=1e-6)


def test_tables_say_how_obstacles_move_and_where_the_tool_is(tmp_path: Path) -> None:
    said = obstacles_at(0, START)
    said.velocities[0] = 0.1, -0.2, 0.3
    with LogWriter(tmp_path / "log.mcap") as log:
        log.write(OBSTACLES, convert.obstacles_to_message(said), START)
        joints = JointSample(START, ARM.joint_names, angles(4), np.zeros(6))
        log.write(JOINT_STATES, convert.joint_sample_to_message(joints), START)
    tables = exported(tmp_path / "log.mcap", "csv", tmp_path / "tables")
    with (tables / "obstacles.csv").open() as file:
        first = next(csv.DictReader(file))
    assert [float(first[f"v{axis}_m_s"]) for axis in "xyz"] == [0.1, -0.2, 0.3]
    assert [float(first[f"size_{axis}_m"]) for axis in "xyz"] == pytest.approx(said.sizes[0])
    assert [float(first[f"q{axis}"]) for axis in "wxyz"] == pytest.approx(said.quats[0])
    with (tables / "arm.csv").open() as file:
        (row,) = csv.DictReader(file)
    tool = forward_kinematics(ARM, angles(4))[-1]
    turned = Rotation.from_quat([float(row[f"q{axis}"]) for axis in "xyzw"]).as_matrix()
    np.testing.assert_allclose(turned, tool[:3, :3], atol=1e-6)
    assert [float(row[f"{axis}_m"]) for axis in "xyz"] == pytest.approx(tool[:3, 3], abs=1e-6)


def test_an_arm_meets_obstacles_in_mujoco_and_these_meet_nothing_else(tmp_path: Path) -> None:
    """Two of them stand in the arm's upper link, and in each other."""
    said = obstacles_at(0, START)
    link = forward_kinematics(ARM, angles(0))[ARM.link_names.index("forearm_link")]
    said.positions[:2] = link[:3, 3]
    with LogWriter(tmp_path / "log.mcap") as log:
        log.write(OBSTACLES, convert.obstacles_to_message(said), START)
        joints = JointSample(START, ARM.joint_names, angles(0), np.zeros(6))
        log.write(JOINT_STATES, convert.joint_sample_to_message(joints), START)
    model = mujoco.MjModel.from_xml_path(str(exported(tmp_path / "log.mcap", "mjcf", tmp_path / "a.xml")))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_forward(model, data)
    is_obstacle = model.body_mocapid[model.geom_bodyid] >= 0
    met = {tuple(pair) for pair in data.contact.geom.tolist()}
    assert {geom for pair in met for geom in pair if is_obstacle[geom]} == set(np.flatnonzero(is_obstacle)[:2])
    assert all(is_obstacle[a] != is_obstacle[b] for a, b in met)
    colours = [KIND_COLOURS[kind] for kind in (ObstacleKind.MOVING, ObstacleKind.MOVING, ObstacleKind.STATIC)]
    np.testing.assert_allclose(model.geom_rgba[is_obstacle][:, :3], colours, atol=1e-6)
