"""The shipped arm files are what the models say, and foreign arm files become models."""

from __future__ import annotations

import re
from itertools import product
from pathlib import Path

import mujoco
import numpy as np
import pytest

from twin_node.geometry import distance_to_segment
from twin_node.resources import ResourceError, find
from twin_node.robot import UR_NAMES, RobotError, arm_model, forward_kinematics, place_capsules, ur_model
from twin_node.robot.mjcf import geom_names, load_arm, write_mjcf

UR10E_DATA = Path(__file__).resolve().parents[3] / "shared" / "data" / "ur10e_model"


@pytest.mark.parametrize("name", UR_NAMES)
def test_shipped_file_is_up_to_date(name: str) -> None:
    assert find(f"sim/{name}.xml").read_text() == write_mjcf(ur_model(name)), f"write sim/{name}.xml again"


@pytest.mark.parametrize("name", UR_NAMES)
def test_mujoco_poses_the_capsules_where_the_model_does(name: str) -> None:
    model = ur_model(name)
    engine = mujoco.MjModel.from_xml_path(str(find(f"sim/{name}.xml")))
    data = mujoco.MjData(engine)
    geoms = [engine.geom(geom).id for geom in geom_names(model)]
    assert engine.ngeom == len(geoms)
    for q in np.random.default_rng(1).uniform(-3, 3, (20, 6)):
        data.qpos[:] = q
        mujoco.mj_kinematics(engine, data)
        placed = place_capsules(model, forward_kinematics(model, q))
        np.testing.assert_allclose(data.geom_xpos[geoms], placed.ends.mean(1), atol=1e-6)
        np.testing.assert_allclose(engine.geom_size[geoms, 0], placed.radii)


def test_a_written_arm_reads_back_as_it_was() -> None:
    model = ur_model("ur16e")
    loaded = load_arm(find("sim/ur16e.xml"))
    assert (loaded.name, loaded.joint_names, loaded.link_names) == (model.name, model.joint_names, model.link_names)
    np.testing.assert_allclose(loaded.origins, model.origins, atol=1e-8)
    np.testing.assert_allclose([loaded.lower, loaded.upper], [model.lower, model.upper], atol=1e-8)
    np.testing.assert_array_equal(loaded.capsules.links, model.capsules.links)
    np.testing.assert_allclose(loaded.capsules.radii, model.capsules.radii)
    np.testing.assert_allclose(loaded.capsules.ends.sum(1), model.capsules.ends.sum(1), atol=1e-8)


FOREIGN = """
<mujoco>
  <compiler angle="degree"/>
  <worldbody>
    <body name="stand" pos="0 0 0.1">
      <geom type="box" size="0.1 0.08 0.05"/>
      <body name="first" pos="0 0 0.2" euler="0 0 30">
        <joint name="swing" axis="0 1 0" pos="0.02 0 0" range="-90 90"/>
        <geom type="cylinder" size="0.05 0.2" pos="0 0 0.2"/>
        <body name="second" pos="0 0 0.4">
          <joint name="turn" axis="1 0 1"/>
          <geom name="tube" type="capsule" size="0.04" fromto="0 0 0 0 0 0.3"/>
          <geom type="box" size="0.5 0.5 0.5" contype="0" conaffinity="0"/>
          <body name="finger" pos="0 0 0.3">
            <joint name="slide" type="slide" axis="1 0 0"/>
            <geom type="sphere" size="0.03"/>
          </body>
        </body>
      </body>
    </body>
  </worldbody>
</mujoco>
"""


@pytest.mark.parametrize("refs", [(0, 0), (40, 0), (40, -70)])
def test_a_foreign_arm_moves_as_its_file_says(tmp_path: Path, refs: tuple[int, int]) -> None:
    path = tmp_path / "foreign.xml"
    text = FOREIGN
    for joint, ref in zip(("swing", "turn"), refs, strict=True):
        text = text.replace(f'name="{joint}"', f'name="{joint}" ref="{ref}"')
    path.write_text(text)
    model = load_arm(path, joint_names=("swing", "turn"))
    assert model.link_names == ("stand", "first", "second")
    engine = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(engine)
    tube = engine.geom("tube").id
    capsule = int(np.flatnonzero(np.isclose(model.capsules.radii, 0.04))[0])
    for q in np.random.default_rng(5).uniform(-1.5, 1.5, (20, 2)):
        data.qpos[:2] = q
        mujoco.mj_kinematics(engine, data)
        placed = place_capsules(model, forward_kinematics(model, q))
        np.testing.assert_allclose(placed.ends[capsule].mean(0), data.geom_xpos[tube], atol=1e-9)
        np.testing.assert_allclose(forward_kinematics(model, q)[1:, :3, 3], data.xanchor[:2], atol=1e-9)
    assert model.upper.tolist() == pytest.approx([np.pi / 2, np.inf])
    assert model.lower.tolist() == pytest.approx([-np.pi / 2, -np.inf])
    assert len(model.capsules) == 4  # the visual box is left out, the finger belongs to the second link
    assert (model.capsules.links == [0, 1, 2, 2]).all()


def test_other_shapes_are_enclosed(tmp_path: Path) -> None:
    path = tmp_path / "foreign.xml"
    path.write_text(FOREIGN)
    model = load_arm(path, joint_names=("swing", "turn"))
    rim = np.stack([0.05 * np.cos(np.linspace(0, 6.28, 50)), 0.05 * np.sin(np.linspace(0, 6.28, 50)), np.full(50, 0.4)])
    engine = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(engine)
    mujoco.mj_kinematics(engine, data)
    first = engine.body("first").id
    points = rim.T @ data.xmat[first].reshape(3, 3).T + data.xpos[first]
    placed = place_capsules(model, forward_kinematics(model, np.zeros(2)))
    assert (distance_to_segment(points, placed.ends[1]) <= placed.radii[1] + 1e-9).all()
    corners = np.array([0.0, 0.0, 0.1]) + np.array([0.1, 0.08, 0.05]) * list(product([-1, 1], repeat=3))
    assert (distance_to_segment(corners, placed.ends[0]) <= placed.radii[0] + 1e-9).all()


def test_meshes_of_a_urdf_become_capsules(tmp_path: Path) -> None:
    if not UR10E_DATA.exists():
        pytest.skip(f"no UR10e URDF at {UR10E_DATA}")
    text = (UR10E_DATA / "ur10e.urdf").read_text().replace("meshes/ur10e/collision/", f"{UR10E_DATA}/meshes/")
    before, after = text.split("<link name", 1)
    compiler = '<mujoco><compiler strippath="false" discardvisual="true"/></mujoco>'
    (tmp_path / "ur10e.urdf").write_text(f"{before}{compiler}<link name{after}")
    loaded, model = load_arm(tmp_path / "ur10e.urdf"), ur_model("ur10e")
    q = np.array([0.3, -1.0, 1.2, -0.4, 0.8, 2.0])
    np.testing.assert_allclose(
        forward_kinematics(loaded, q)[1:, :3, 3], forward_kinematics(model, q)[1:, :3, 3], atol=1e-4
    )
    assert set(loaded.capsules.links) == set(range(7))


def test_a_second_arm_beside_it_is_none_of_the_arms(tmp_path: Path) -> None:
    """Nobody tells where it is: its shape would make those who are there part of this arm, and masked like it."""
    one = """<body name="{name}_base" pos="0 {y} 0"><geom size="0.1"/>
      <body pos="0 0 0.4"><joint name="{name}" axis="0 1 0"/>
      <geom type="capsule" size="0.05" fromto="0 0 0 0 0 0.3"/></body></body>"""
    arms = one.format(name="left", y=0.5) + one.format(name="right", y=-0.5)
    torso = (
        f'<mujoco><worldbody><body name="torso"><geom type="box" size="0.2 0.6 0.1"/>{arms}</body></worldbody></mujoco>'
    )
    (tmp_path / "two.xml").write_text(torso)
    arm = load_arm(tmp_path / "two.xml", ["right"])
    placed = place_capsules(arm, forward_kinematics(arm, np.zeros(1)))
    assert placed.links.tolist() == [0, 0, 0, 1]
    assert placed.ends[placed.ends[..., 2] > 0.35].reshape(-1, 3)[:, 1].tolist() == [-0.5, -0.5]


@pytest.mark.parametrize("tool", ["body", "site", "none"])
def test_a_tool_is_where_the_file_has_its_frame(tmp_path: Path, tool: str) -> None:
    """Most arms' last joint is a flange's length away from `tool0`, and may turn about another axis."""
    at = 'name="tool0" pos="0 0 0.3" euler="0 90 0"'
    inside = {"body": f"<body><body {at}/></body>", "site": f"<site {at}/>", "none": ""}[tool]
    (tmp_path / "arm.xml").write_text(
        f"""<mujoco><worldbody><body><joint axis="0 1 0"/><geom type="capsule" size="0.05" fromto="0 0 0 0 0 0.3"/>
        {inside}</body></worldbody></mujoco>"""
    )
    arm = load_arm(tmp_path / "arm.xml")
    assert (arm.link_names[1], arm.joint_names[0]) == ("link_1", "joint_1"), "what has no name is told by one"
    arm = arm.carrying(np.array([[[0, 0, 0.1], [0, 0, 0.2]]]), np.array([0.02]))
    ends = place_capsules(arm, forward_kinematics(arm, np.zeros(1))).ends[-1]
    there = [[0, 0.1, 0], [0, 0.2, 0]] if tool == "none" else [[0.1, 0, 0.3], [0.2, 0, 0.3]]
    np.testing.assert_allclose(ends, there, atol=1e-9)


def test_wrong_files_are_refused(tmp_path: Path) -> None:
    broken = tmp_path / "broken.xml"
    broken.write_text("<mujoco><worldbody>")
    with pytest.raises(RobotError, match=r"broken\.xml: expected an arm as MJCF or URDF"):
        load_arm(broken)
    with pytest.raises(RobotError, match=r"nowhere\.xml: expected an arm"):
        load_arm(tmp_path / "nowhere.xml")
    foreign = tmp_path / "foreign.xml"
    foreign.write_text(FOREIGN)
    with pytest.raises(RobotError, match="slide is none"):
        load_arm(foreign)
    with pytest.raises(RobotError, match="expected joint elbow, found swing, turn, slide"):
        load_arm(foreign, joint_names=("elbow",))
    empty = tmp_path / "empty.xml"
    empty.write_text("<mujoco/>")
    with pytest.raises(RobotError, match="found no joints"):
        load_arm(empty)


URDF_WITHOUT_COLLISION = """<robot name="seen">
  <link name="base"/>
  <link name="upper">
    <inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
    <visual><geometry><box size="0.1 0.1 0.3"/></geometry></visual>
  </link>
  <joint name="turn" type="revolute">
    <parent link="base"/><child link="upper"/><axis xyz="0 0 1"/>
    <limit lower="-1" upper="1" effort="1" velocity="1"/>
  </joint>
</robot>"""
LINK = '<mujoco><worldbody><body name="link"><joint axis="0 0 1"/>{}</body></worldbody></mujoco>'


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        (
            "seen.urdf",
            URDF_WITHOUT_COLLISION,
            r"seen\.urdf: expected links with shapes .*<collision> elements in a URDF",
        ),
        ("bare.xml", LINK.format('<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>'), r"bare\.xml: expected links"),
        ("egg.xml", LINK.format('<geom type="ellipsoid" size=".1 .1 .2"/>'), r"egg\.xml: geom 0: expected a capsule"),
    ],
)
def test_an_arm_of_unknown_shape_is_refused(tmp_path: Path, name: str, text: str, said: str) -> None:
    """Nothing would ever be near an arm without capsules: it would never slow down."""
    (tmp_path / name).write_text(text)
    with pytest.raises(RobotError, match=said):
        arm_model(tmp_path / name)


VISUAL_ARM = """<mujoco><worldbody>{}
  <body name="link"><joint axis="0 0 1"/><geom size=".1" contype="0" conaffinity="0"/></body>
</worldbody></mujoco>"""


@pytest.mark.parametrize("around", ["", '<geom type="plane" size="1 1 1"/>', '<body><geom size=".5"/></body>'])
def test_what_else_a_file_holds_does_not_take_the_arms_shapes_away(tmp_path: Path, around: str) -> None:
    """A floor takes part in contacts; the geoms of the arm, none of which does, were left out for that."""
    path = tmp_path / "visual.xml"
    path.write_text(VISUAL_ARM.format(around))
    np.testing.assert_allclose(arm_model(path).capsules.radii, [0.1])


def _urdf(*limits: str) -> str:
    links = "".join(
        f'<link name="l{k}"><collision><geometry><sphere radius="0.05"/></geometry></collision></link>'
        for k in range(len(limits) + 1)
    )
    joints = "".join(
        f'<joint name="j{k}" type="revolute"><parent link="l{k}"/><child link="l{k + 1}"/><origin xyz="0 0 0.05"/>'
        f'<axis xyz="0 1 0"/>{limit}</joint>'
        for k, limit in enumerate(limits)
    )
    drives = '<transmission name="t"><joint name="j0"/></transmission>'
    return f'<robot name="r" drake:v="1">{links}{joints}{drives}</robot>'  # nobody has declared the prefix


def test_a_urdf_rates_its_joints_unless_it_gives_a_placeholder(tmp_path: Path) -> None:
    """All were rated 15 rad/s: servo mode took a trajectory that its arm cannot follow."""
    given = ('velocity="3.14"', 'velocity="0"', 'velocity="1e6"', 'velocity="fast"', 'velocity="-1"', "")
    limits = [f'<limit lower="-2" upper="2" effort="1" {rating}/>' for rating in given]
    (tmp_path / "arm.urdf").write_text(_urdf(*limits))
    arm = load_arm(tmp_path / "arm.urdf")
    np.testing.assert_array_equal(arm.max_velocity, [3.14, 15, 15, 15, 15, 15])
    assert arm.capsules.links.tolist() == list(range(7)), "its base has a shape too"
    assert arm.link_names == tuple(f"l{k}" for k in range(7))
    assert (load_arm(find("sim/ur5e.xml")).max_velocity == 15).all()


GRIPPED = """<mujoco><worldbody><body name="a"><geom size=".05"/>
  <body name="b"><joint name="shoulder" axis="0 1 0"/><geom size=".05"/>
    <body name="c" pos="0 0 .3"><joint name="elbow" axis="0 1 0"/><geom size=".05"/>
      <body name="left"><joint name="finger" type="slide" axis="0 1 0"/><geom size=".02"/></body>
      <body name="right"><joint name="thumb" type="slide" axis="0 1 0"/><geom size=".02"/></body>
</body></body></body></worldbody></mujoco>"""


def test_an_arm_with_a_gripper_is_told_how_to_name_its_joints(tmp_path: Path) -> None:
    path = tmp_path / "gripped.xml"
    path.write_text(GRIPPED)
    with pytest.raises(RobotError, match=r"with joint_names, of a launched arm with 'arm\.joints'"):
        arm_model(path)
    model = arm_model(path, joint_names=("shoulder", "elbow"))
    assert model.joint_names == ("shoulder", "elbow")
    assert (model.capsules.links == 2).sum() == 3  # the fingers are carried by the last link
    own = ur_model("ur5e").joint_names
    for wrong in (("shoulder",), (own[1], own[0], *own[2:])):
        with pytest.raises(RobotError, match="joints: expected those of ur5e in this order, shoulder_pan_joint"):
            arm_model("ur5e", joint_names=wrong)


@pytest.mark.parametrize("open_m", [0.0, 0.03, 0.06])
def test_fingers_are_the_arms_wherever_they_are(tmp_path: Path, open_m: float) -> None:
    """The file has them closed: open, they stuck out of all capsules, and were something that moves beside the arm."""
    path = tmp_path / "gripped.xml"
    ranged = GRIPPED.replace('type="slide" axis="0 1 0"', 'type="slide" axis="0 1 0" range="0 0.06"')
    tipped = ranged.replace(
        "</body>",
        '<body pos="0 0 .1"><joint axis="1 0 0" range="-60 10"/><geom pos="0 0 .05" size=".01"/></body></body>',
        1,
    )
    path.write_text(tipped)
    arm = arm_model(path, joint_names=("shoulder", "elbow"))
    assert arm.capsules.links.tolist() == [0, 1, 2, 2, 2, 2]
    engine = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(engine)
    for bent in np.radians([-60, -20, 10]):
        data.qpos[:] = [0.0, 0.0, open_m, bent, open_m]
        mujoco.mj_kinematics(engine, data)
        placed = place_capsules(arm, forward_kinematics(arm, np.zeros(2)))
        for geom, capsule in zip(range(2, engine.ngeom), range(2, 6), strict=True):
            apart = distance_to_segment(data.geom_xpos[geom][None], placed.ends[capsule])[0]
            assert apart + engine.geom_size[geom, 0] <= placed.radii[capsule] + 1e-3
            assert placed.radii[capsule] < 0.1


RAIL = """<mujoco><worldbody><body name="carriage"><joint name="rail" type="slide" axis="1 0 0"/><geom size=".05"/>
  <body name="a"><joint name="pan" axis="0 0 1"/><geom size=".05"/>
    <body name="b" pos="0 0 .3"><joint name="shoulder" axis="0 1 0"/><geom size=".05"/>
      <body name="c" pos="0 0 .3"><joint name="elbow" axis="0 1 0"/><geom size=".05"/>
</body></body></body></body></worldbody></mujoco>"""


@pytest.mark.parametrize(
    ("joints", "besides"), [("pan shoulder elbow", "rail"), ("rail pan elbow", "shoulder"), ("pan elbow", "rail")]
)
def test_an_arm_that_a_joint_carries_which_nobody_follows_is_refused(tmp_path: Path, joints: str, besides: str) -> None:
    """The arm would be looked for at the rail's zero, wherever on it the arm works."""
    path = tmp_path / "rail.xml"
    path.write_text(RAIL.replace('type="slide"', "") if "rail" in joints else RAIL)
    with pytest.raises(RobotError, match=rf"found {besides} besides, which nobody would follow"):
        arm_model(path, joint_names=joints.split())


MIXED = """<mujoco><default><default class="seen"><geom contype="0" conaffinity="0"/></default></default>
<worldbody><body name="a"><geom class="seen" size=".3"/>
  <body name="b"><joint name="pan" axis="0 0 1"/>{}
    <body name="c" pos="0 0 .3"><joint name="elbow" axis="0 1 0"/><geom size=".05"/><geom class="seen" size=".4"/>
      <body name="d"><geom class="seen" size=".07"/></body>
</body></body></body></worldbody></mujoco>"""


@pytest.mark.parametrize("touches", ["", 'contype="0"', 'conaffinity="0"'])
def test_a_body_of_which_only_visuals_are_given_is_as_large_as_they_are(tmp_path: Path, touches: str) -> None:
    """Only fingers take part in contacts in many a model: the arm behind them was without capsules."""
    path = tmp_path / "mixed.xml"
    text = MIXED.replace('<geom size=".05"', f'<geom {touches} size=".05"')
    path.write_text(text.format('<geom class="seen" type="capsule" size=".06" fromto="0 0 0 0 0 .3"/>'))
    capsules = arm_model(path).capsules
    assert (capsules.links.tolist(), capsules.radii.tolist()) == ([1, 2, 2], [0.06, 0.05, 0.07])


def test_a_long_link_without_a_shape_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "bare.xml"
    path.write_text(MIXED.format('<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>'))
    with pytest.raises(RobotError, match=r"bare\.xml: expected shapes of link b, 0\.30 m long, found none"):
        arm_model(path)


@pytest.mark.parametrize("scaled", ["size=", "fromto=", "pos="])
def test_an_arm_in_millimetres_is_refused(tmp_path: Path, scaled: str) -> None:
    """It hid all that cameras saw, or was nowhere near it: no obstacle was left, and it might go."""

    def enlarged(found: re.Match[str]) -> str:
        return scaled + '"' + " ".join(str(1000 * float(number)) for number in found[1].split()) + '"'

    (tmp_path / "arm.xml").write_text(re.sub(f'{scaled}"([^"]*)"', enlarged, write_mjcf(ur_model("ur5e"))))
    with pytest.raises(RobotError, match=r"arm arm: expected link \w+ in metres, at most 10, found one of [0-9.e+]+;"):
        arm_model(tmp_path / "arm.xml")
    with pytest.raises(RobotError, match="arm ur5e: expected link wrist_3_link in metres"):
        ur_model("ur5e").carrying(np.array([[[0, 0, 45.0], [0, 0, 120.0]]]), np.array([50.0]))


def test_an_arm_is_found_by_name_or_file(tmp_path: Path) -> None:
    assert arm_model("ur5e").name == "ur5e"
    assert arm_model("sim/ur3e.xml").joint_names == ur_model("ur3e").joint_names
    with pytest.raises(RobotError, match="expected one of ur3e"):
        arm_model("kuka")
    with pytest.raises(ResourceError, match=r"missing\.xml: no such file"):
        arm_model(tmp_path / "missing.xml")
    with pytest.raises(RobotError, match=r"mine\.yaml: expected a UR arm to calibrate, found sim/ur3e\.xml"):
        arm_model("sim/ur3e.xml", kinematics="mine.yaml")


@pytest.mark.parametrize("name", ["ur3e", "ur5e"])
def test_detailed_meshes_give_the_same_arm_in_closer_capsules(name: str) -> None:
    """The arm of airo-models moves as the published DH parameters say, and its capsules lie about the same places."""
    pytest.importorskip("airo_models")
    detailed, own = arm_model(f"airo:{name}"), arm_model(name)
    q = np.array([0.3, -1.1, 1.2, -1.6, -1.4, 0.7])
    theirs, ours = forward_kinematics(detailed, q), forward_kinematics(own, q)
    assert np.allclose(theirs[1:, :3, 3], ours[1:, :3, 3], atol=1e-4)
    assert set(detailed.link_names[1:]) <= set(own.link_names)
    for link in range(2, 4):  # the long links
        ends = [
            place_capsules(arm, forward_kinematics(arm, q)).ends[arm.capsules.links == link] for arm in (detailed, own)
        ]
        assert np.linalg.norm(ends[0].mean(axis=(0, 1)) - ends[1].mean(axis=(0, 1))) < 0.1


def test_an_unknown_detailed_arm_is_refused() -> None:
    pytest.importorskip("airo_models")
    with pytest.raises(RobotError, match="airo:ur5e"):
        arm_model("airo:ur99")
