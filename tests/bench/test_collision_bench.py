"""The collision benchmark: its figures' names, its references against arithmetic, and what it refuses."""

from __future__ import annotations

import json
import re
import struct
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from twin_node.bench import collision
from twin_node.bench.arm_reference import ArmReference
from twin_node.bench.errors import BenchError
from twin_node.cli import main
from twin_node.robot import UR_NAMES, ArmModel, ur_model

SMALL = collision.CollisionBench(arm="ur5e", obstacles=20, steps=4, repetitions=1, poses=200, probes=2)
URDF = """<robot name="one"><link name="base"/><link name="arm"><inertial><mass value="1"/>
<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial><collision><origin xyz="0.5 0 0"/>
<geometry><mesh filename="meshes/far/cube.stl"/></geometry></collision></link>
<joint name="turn" type="continuous"><parent link="base"/><child link="arm"/><origin xyz="0 0 1"/><axis xyz="0 0 1"/>
</joint></robot>"""
CUBE = """<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
<collision><geometry><mesh filename="cube.stl"/></geometry></collision>"""
SPHERES = "robot_cfg: {kinematics: {collision_spheres: {arm: [{center: [0.5, 0, 0], radius: 0.2}]}}}"


def cube_stl(half: float) -> bytes:
    """A cube about the origin as binary STL, its faces outward."""
    triangles = []
    for axis in range(3):
        u, v = np.eye(3)[(axis + 1) % 3], np.eye(3)[(axis + 2) % 3]
        for side in (-1, 1):
            corner = [
                half * (side * np.eye(3)[axis] + a * side * u + b * v) for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))
            ]
            triangles += [(corner[0], corner[1], corner[2]), (corner[0], corner[2], corner[3])]
    body = b"".join(struct.pack("<12fH", 0, 0, 0, *np.concatenate(t), 0) for t in triangles)
    return bytes(80) + struct.pack("<I", len(triangles)) + body


def urdf_of(model: ArmModel, base_height: float = 0.0) -> str:
    """An arm's URDF, a cube on each moving link, its base so high above the root (m)."""
    links = [f'<link name="{link}">{CUBE}</link>' for link in model.link_names[1:]]
    joints = []
    for index, (joint, origin) in enumerate(zip(model.joint_names, model.origins, strict=True)):
        roll, pitch, yaw = Rotation.from_matrix(origin[:3, :3]).as_euler("xyz")
        x, y, z = origin[:3, 3]
        joints.append(
            f'<joint name="{joint}" type="continuous"><parent link="{model.link_names[index]}"/>'
            f'<child link="{model.link_names[index + 1]}"/><origin xyz="{x} {y} {z}" rpy="{roll} {pitch} {yaw}"/>'
            '<axis xyz="0 0 1"/></joint>'
        )
    root = '<link name="floor"/><link name="base_link"/><joint name="stand" type="fixed"><parent link="floor"/>'
    root += f'<child link="base_link"/><origin xyz="0 0 {base_height}"/></joint>'
    return f'<robot name="{model.name}">{root}{"".join(links)}{"".join(joints)}</robot>'


@pytest.fixture
def reference(tmp_path: Path) -> Path:
    (tmp_path / "meshes").mkdir()
    (tmp_path / "meshes" / "cube.stl").write_bytes(cube_stl(0.1))
    (tmp_path / "one.urdf").write_text(URDF)
    (tmp_path / "one.yml").write_text(SPHERES)
    return tmp_path


def test_report_holds_every_figure() -> None:
    report = json.loads(json.dumps(collision.run(None, SMALL)))
    times = {"update_ms", "distance_ms", "check_ms", "decide_ms", "self_distance_ms"}
    assert times < set(report)
    assert all(report[name] > 0 for name in times)
    assert report["fk_dh_m"] < 1e-9
    assert "clearance" not in report
    assert "check_ms" in collision.table(report)


@pytest.mark.parametrize("name", UR_NAMES)
def test_kinematics_are_those_of_the_dh_parameters(name: str) -> None:
    assert collision.fk_error_against_dh(name, seed=4, poses=50) < 1e-9


def test_reference_distances_are_those_of_its_shapes(reference: Path) -> None:
    arm = ArmReference(reference)
    pose = np.eye(4)
    pose[:3, 3] = [0.0, 0.0, 1.0]
    poses = np.stack([np.eye(4), pose])[None]
    points = np.array([[[0.5, 0.0, 1.3], [0.5, 0.0, 1.05], [0.9, 0.0, 1.0]]])
    links = ("base", "arm")
    np.testing.assert_allclose(arm.mesh_distances(poses, links, points), [[0.2, -0.05, 0.3]], atol=1e-6)
    np.testing.assert_allclose(arm.sphere_distances(poses, links, points), [[0.1, -0.15, 0.2]], atol=1e-12)
    np.testing.assert_allclose(arm.link_positions(np.array([[0.3]]), ("arm",)), [[[0.0, 0.0, 1.0]]])


def test_every_mesh_of_a_link_counts(reference: Path) -> None:
    """Convex parts are customary: each of them is solid, where they overlap too."""
    second = """<collision><origin xyz="0.65 0 0"/><geometry><mesh filename="cube.stl"/></geometry></collision>"""
    (reference / "one.urdf").write_text(URDF.replace("</collision>", f"</collision>{second}"))
    points = np.array([[[0.3, 0.0, 0.0], [0.85, 0.0, 0.0], [0.575, 0.0, 0.0]]])
    distances = ArmReference(reference).mesh_distances(np.eye(4)[None, None].repeat(2, 1), ("base", "arm"), points)
    np.testing.assert_allclose(distances, [[0.1, 0.1, -0.025]], atol=1e-6)


def test_ur10e_capsules_enclose_its_meshes(recordings: Path) -> None:
    bench = collision.CollisionBench(poses=300)
    arm = ArmReference(recordings / "ur10e_model")
    found = collision.compare_clearances(arm, bench)
    assert found.poses > 290
    assert found.larger_than_mesh == 0
    assert 0 < found.mesh_minus_capsules.mean_mm < 40
    assert found.spheres_minus_capsules is not None
    assert collision.fk_error_against(arm, bench, poses=20) < 1e-4


def test_wrong_references_are_refused(reference: Path, refused: Callable[..., str]) -> None:
    odd = spheres_of(["arm"], ".nan"), spheres_of(["arm"], "far"), SPHERES.replace("0, 0]", "0]")
    for content in ("robot_cfg: {kinematics: {}}", "&x robot_cfg: &y {kinematics: *y}", "robot_cfg: 2026-02-30", *odd):
        (reference / "one.yml").write_text(content)
        with pytest.raises(BenchError, match=r"one\.yml: expected cuRobo's .*collision_spheres"):
            ArmReference(reference)
    (reference / "one.yml").unlink()
    (reference / "one.urdf").write_text(URDF[:100])
    with pytest.raises(BenchError, match=r"one\.urdf: expected an arm's URDF"):
        ArmReference(reference)
    (reference / "one.urdf").unlink()
    assert "expected a *.urdf file" in refused("bench", "collision", "--reference", reference)


def test_a_reference_of_another_arm_is_refused(reference: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "collision", "--reference", str(reference)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "expected a URDF of 6 joints with a collision mesh on each of shoulder_link" in line
    assert "found 1 joints, and meshes on arm; give the folder" in line


@pytest.mark.parametrize("name", ["ur3e", "ur5e", "ur16e"])
def test_another_ur_arms_urdf_is_refused_by_the_lengths_of_its_links(
    name: str, reference: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (reference / "one.urdf").write_text(urdf_of(ur_model(name)))
    assert main(["bench", "collision", "--reference", str(reference)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert f"{reference}: expected a URDF of a ur10e" in line
    assert f"found that of a {name}: " in line
    assert line.endswith("; give the folder of the arm that is measured")


@pytest.mark.parametrize("name", UR_NAMES)
def test_the_arms_own_urdf_is_taken_wherever_its_base_stands(name: str, reference: Path) -> None:
    (reference / "one.urdf").write_text(urdf_of(ur_model(name), base_height=0.8))
    (reference / "one.yml").unlink()
    ArmReference(reference).check_arm(ur_model(name))


def spheres_of(links: Sequence[str], x: str) -> str:
    """cuRobo's file with a sphere on each link, so far along x, that holds a cube of 0.2 m at 0 but for its corners."""
    rows = ", ".join(f"{link}: [{{center: [{x}, 0, 0], radius: 0.15}}]" for link in links)
    return f"robot_cfg: {{kinematics: {{collision_spheres: {{{rows}}}}}}}"


def test_another_arms_spheres_are_refused(reference: Path) -> None:
    model = ur_model("ur10e")
    links = model.link_names[1:]
    (reference / "one.urdf").write_text(urdf_of(model))
    (reference / "one.yml").write_text(spheres_of(links, "0.02"))
    ArmReference(reference).check_arm(model)
    for content, found in (
        (spheres_of(links, "0.3"), "found shoulder_link's 0.27 m off its meshes"),
        (spheres_of(links[:2], "0.0"), "found none on forearm_link"),
        (SPHERES, "found none on shoulder_link"),
    ):
        (reference / "one.yml").write_text(content)
        with pytest.raises(BenchError, match=rf"one\.yml: expected spheres of a ur10e, {found}; give this arm's file"):
            ArmReference(reference).check_arm(model)


def test_shipped_spheres_are_those_of_the_shipped_arm(recordings: Path) -> None:
    ArmReference(recordings / "ur10e_model").check_arm(ur_model("ur10e"))


def test_an_arm_that_is_none_of_urs_is_refused_by_what_differs_most(reference: Path) -> None:
    model = ur_model("ur5e")
    origins = model.origins.copy()
    origins[:, :3, 3] *= 1.02
    (reference / "one.urdf").write_text(urdf_of(replace(model, origins=origins)))
    lengths = "0.4335 m from upper_arm_link to forearm_link, where a ur5e has 0.4250 m"
    expected = f"expected a URDF of a ur5e, found another arm: {lengths}"
    with pytest.raises(BenchError, match=re.escape(expected)):
        ArmReference(reference).check_arm(model)


def test_a_reference_may_lie_in_any_folder(reference: Path, tmp_path_factory: pytest.TempPathFactory) -> None:
    folder = tmp_path_factory.mktemp("odd") / 'R&D "<new>"'
    reference.rename(folder)
    assert ArmReference(folder).sphere_distances(np.eye(4)[None, None], ("base",), np.zeros((1, 1, 3))) is not None
