"""Files as ROS's tools leave them are read, or refused with what is to be done."""

from __future__ import annotations

import warnings
from pathlib import Path

import mujoco
import numpy as np
import pytest

from twin_node.errors import TwinWarning
from twin_node.robot import RobotError
from twin_node.robot.mjcf import load_arm, write_mjcf

ROS_URDF = """
<robot name="arm">
  <link name="base"/>
  <link name="upper"><inertial><mass value="1"/><inertia ixx="1" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/>
    </inertial><collision><geometry><mesh filename="{mesh}"/></geometry></collision></link>
  <link name="flange"/>
  <joint name="swing" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="0 1 0"/>
    <limit lower="-2" upper="2" velocity="2" effort="1"/></joint>
  <joint name="turn" type="continuous"><parent link="upper"/><child link="flange"/><axis xyz="0 0 1"/></joint>
</robot>
"""


@pytest.mark.parametrize("place", ["above", "ament", "ros", "ros itself", "file", "beside"])
def test_meshes_are_found_where_ros_has_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, place: str) -> None:
    """In a package; and masses, which nobody asks for here, may be missing or impossible."""
    places = {"above": "src/my arm", "ament": "install/share/my arm", "ros": "ws/my arm", "ros itself": "ws/my arm"}
    package = tmp_path / places.get(place, "my arm")
    (package / "meshes").mkdir(parents=True)
    (package / "meshes" / "upper.obj").write_text(
        "v 0 0 0\nv .1 0 0\nv 0 .1 0\nv 0 0 .4\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n"
    )
    by_path = {"file": f"file://{package}/meshes/upper.obj", "beside": "my arm/meshes/upper.obj"}
    mesh = by_path.get(place, "package://my arm/meshes/upper.obj")
    monkeypatch.setenv("AMENT_PREFIX_PATH", f"/nowhere:{tmp_path / 'install'}" if place == "ament" else "")
    ros_path = {"ros": tmp_path / "ws", "ros itself": package}.get(place, "")
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(ros_path))
    file = (package / "urdf" if place == "above" else tmp_path) / "arm.urdf"
    file.parent.mkdir(exist_ok=True)
    file.write_text(ROS_URDF.format(mesh=mesh))
    arm = load_arm(file)
    assert set(arm.capsules.links) == {1}
    assert np.linalg.norm(arm.capsules.ends.reshape(-1, 3), axis=1).max() < 0.5


def test_a_mesh_that_is_nowhere_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("AMENT_PREFIX_PATH", raising=False)
    (tmp_path / "arm.urdf").write_text(ROS_URDF.format(mesh="package://ur_description/upper.stl"))
    with pytest.raises(
        RobotError, match=r"mesh package://ur_description/upper.stl, found no such file in a folder ur_des"
    ):
        load_arm(tmp_path / "arm.urdf")


def test_what_xacro_has_to_expand_is_refused(tmp_path: Path) -> None:
    """MuJoCo passes over what it does not know: the arm was there without its gripper."""
    gripper = '<xacro:gripper parent="flange"/></robot>'
    (tmp_path / "arm.urdf").write_text(ROS_URDF.format(mesh="").replace("</robot>", gripper))
    with pytest.raises(RobotError, match=r"arm.urdf: expected a URDF, found one that xacro has to expand: xacro"):
        load_arm(tmp_path / "arm.urdf")


def test_what_xacro_has_expanded_may_speak_of_it_in_a_comment(tmp_path: Path) -> None:
    """As the URDF of every UR arm does: its user was told to expand it once more, and again."""
    box, comment = '<box size="0.1 0.1 0.4"/>', '<!--<xacro:ur_arm_transmission\n  prefix="${prefix}"/>--><joint'
    text = ROS_URDF.replace('<mesh filename="{mesh}"/>', box).replace("<joint", comment)
    (tmp_path / "arm.urdf").write_text(text)
    assert load_arm(tmp_path / "arm.urdf").joint_names == ("swing", "turn")


FINGER = """
  <link name="finger"><collision><geometry><box size="0.02 0.02 0.1"/></geometry></collision></link>
  <joint name="grip" type="prismatic"><parent link="flange"/><child link="finger"/><axis xyz="0 1 0"/>
    <limit {range} effort="1" velocity="1"/></joint></robot>"""


@pytest.mark.parametrize(
    ("given", "meant"),
    [('upper="0.1"', 'lower="0" upper="0.1"'), ('lower="-0.1"', 'lower="-0.1" upper="0"')],
)
def test_an_end_that_a_urdf_does_not_give_is_0(tmp_path: Path, given: str, meant: str) -> None:
    """Such a finger stayed where the file draws it, and opened out of what enclosed it; such a hinge had no ends."""
    arms = []
    for ends in (given, meant):
        text = ROS_URDF.replace('<mesh filename="{mesh}"/>', '<box size="0.1 0.1 0.4"/>')
        text = text.replace('lower="-2" upper="2"', ends).replace("</robot>", FINGER.replace("{range}", ends))
        (tmp_path / "arm.urdf").write_text(text)
        arms.append(load_arm(tmp_path / "arm.urdf", ("swing", "turn")))
    found, expected = arms
    assert np.ptp(expected.capsules.ends[-1], axis=0).max() > 0.05
    np.testing.assert_allclose(found.capsules.ends, expected.capsules.ends)
    np.testing.assert_allclose([found.lower, found.upper], [expected.lower, expected.upper])


BASE = """<link name="world"/><link name="base_link"/><joint name="stand" type="fixed"><parent link="world"/>
  <child link="base_link"/><origin xyz="{}" rpy="{}"/></joint><joint name="mount" type="fixed">
  <parent link="base_link"/><child link="base"/></joint><link name="base"/>"""


@pytest.mark.parametrize(
    ("place", "turn", "said"),
    [
        ("0 0 0.8", "0 0 0", "0.80 m and 0 degrees"),
        ("0 0 0", "3.1416 0 0", "0.00 m and 180 degrees"),
        ("0 0 0", "0 0 0", None),
    ],
)
def test_a_base_that_is_not_where_the_files_world_is_is_told(
    tmp_path: Path, place: str, turn: str, said: str | None
) -> None:
    """By TF that is where cameras are from: the arm on a table was looked for, and judged, as much too high."""
    text = ROS_URDF.replace('<mesh filename="{mesh}"/>', '<box size="0.1 0.1 0.4"/>')
    (tmp_path / "arm.urdf").write_text(text.replace('<link name="base"/>', BASE.format(place, turn)))
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        assert load_arm(tmp_path / "arm.urdf").joint_names == ("swing", "turn")
    assert [str(one.message).count(f"link base_link is {said} from the file's world") for one in told] == [1] * bool(
        said
    )
    assert all(one.category is TwinWarning for one in told)


@pytest.mark.parametrize(("first", "base"), [("turntable", "base_link"), ("base_link", "link_0")])
def test_an_arm_may_stand_on_the_files_world_itself(tmp_path: Path, first: str, base: str) -> None:
    """Its collision scene was to have a body of the world's name, and ended in a trace of MuJoCo's."""
    (tmp_path / "arm.xml").write_text(
        f'<mujoco><worldbody><geom type="plane" size="1 1 1"/><body name="{first}"><joint/><geom size="0.1"/>'
        '<body pos="0 0 0.3"><joint axis="0 1 0"/><geom size="0.1"/></body></body></worldbody></mujoco>'
    )
    arm = load_arm(tmp_path / "arm.xml")
    assert arm.link_names == (base, first, "link_2")
    assert mujoco.MjModel.from_xml_string(write_mjcf(arm)).njnt == 2


@pytest.mark.parametrize("encoding", ["GB2312", "none-such"])
def test_an_arms_file_may_name_any_encoding(tmp_path: Path, encoding: str) -> None:
    """MuJoCo reads it; what looks for the joints' ratings in it did not, and ended in a trace."""
    text = ROS_URDF.replace('<mesh filename="{mesh}"/>', '<box size="0.1 0.1 0.4"/>').strip()
    (tmp_path / "arm.urdf").write_text(f'<?xml version="1.0" encoding="{encoding}"?>\n{text}')
    assert load_arm(tmp_path / "arm.urdf").max_velocity.tolist() == [2.0, 15.0]


@pytest.mark.parametrize(
    ("sound", "wrong", "what"),
    [
        ('<box size="0.1 0.1 0.4"/>', '<box size="0.1 0.1 inf"/>', "geom_size"),
        ('<axis xyz="0 1 0"/>', '<axis xyz="0 1 0"/><origin xyz="nan 0 0"/>', "body_pos"),
    ],
)
def test_a_file_with_numbers_that_are_none_is_refused(tmp_path: Path, sound: str, wrong: str, what: str) -> None:
    """As an expression of xacro's may come out: fitting a shape to it ended in a trace of SciPy's or NumPy's."""
    text = ROS_URDF.replace('<mesh filename="{mesh}"/>', '<box size="0.1 0.1 0.4"/>')
    (tmp_path / "arm.urdf").write_text(text.replace(sound, wrong))
    with pytest.raises(RobotError, match=f"arm.urdf: expected finite numbers, found others as {what}"):
        load_arm(tmp_path / "arm.urdf")


@pytest.mark.parametrize(("joint", "said"), [("<freejoint/>", "is none"), ("<joint/>", "does not go on")])
def test_a_joint_without_a_name_that_is_not_the_arms_is_told_of(tmp_path: Path, joint: str, said: str) -> None:
    """As of a thing that lies beside the arm: nothing was named there."""
    (tmp_path / "arm.xml").write_text(
        f'<mujoco><worldbody><body name="a"><joint name="j"/><geom size="0.1"/></body><body pos="2 0 0">{joint}'
        '<geom size="0.1"/></body></worldbody></mujoco>'
    )
    with pytest.raises(RobotError, match=f"found that one without a name {said}"):
        load_arm(tmp_path / "arm.xml")


@pytest.mark.parametrize(
    ("links", "joints", "called", "moved"),
    [
        (("link_2", ""), ("a", "b"), ("base_link", "link_2", "link_2_"), ("a", "b")),
        (("base_link", "link_0"), ("a", "b"), ("link_0_", "base_link", "link_0"), ("a", "b")),
        (("", ""), ("joint_2", ""), ("base_link", "link_1", "link_2"), ("joint_2", "joint_2_")),
    ],
)
def test_what_has_no_name_is_called_as_nothing_else_is(
    tmp_path: Path,
    links: tuple[str, str],
    joints: tuple[str, str],
    called: tuple[str, ...],
    moved: tuple[str, ...],
) -> None:
    """Two links of one name ended in a trace when the arm's collision scene was made, and so did two joints."""
    said = [f' name="{name}"' if name else "" for name in (*links, *joints)]
    bodies = [f'<body{link}><joint{joint}/><geom size="0.1"/>' for link, joint in zip(said[:2], said[2:], strict=True)]
    file = tmp_path / "arm.xml"
    file.write_text(f"<mujoco><worldbody>{''.join(bodies)}</body></body></worldbody></mujoco>")
    model = load_arm(file)
    assert (model.link_names, model.joint_names) == (called, moved)
    assert mujoco.MjModel.from_xml_string(write_mjcf(model)).njnt == 2
