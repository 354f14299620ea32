"""What joints move on an arm's link is enclosed wherever they may take it."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from twin_node.geometry import distance_to_segment
from twin_node.robot import arm_model, forward_kinematics, place_capsules

ARM = """<mujoco><compiler boundmass=".01" boundinertia=".01"/><worldbody><body name="a"><geom size=".05"/>
  <body name="b" pos=".3 0 .1" euler="20 0 0"><joint name="pan" axis="0 0 1"/><geom size=".03"/>
    <body pos="0 .02 .05" euler="0 30 0">{}</body>
</body></body></worldbody></mujoco>"""
TIP = '<geom size=".005" type="capsule" fromto="0 .02 0 0 .08 .1"/>'


def hinge(axis: str, limits: str, place: str = "0 0 0") -> str:
    return f'<joint axis="{axis}" range="{limits}" pos="{place}"/>'


def chain(*joints: str) -> str:
    """A tip at the end of bodies with one joint each."""
    return "".join(f'<body pos="0 0 .02">{joint}' for joint in joints) + TIP + len(joints) * "</body>"


@pytest.mark.parametrize(
    ("held", "most_m"),
    [
        (hinge("1 0 0", "-180 180") + TIP, 0.16),
        (hinge("1 0 0", "0 90") + TIP, 0.08),
        (hinge("0 1 0", "-120 20") + hinge("1 0 0", "-90 90", "0 0 .03") + TIP, 0.15),
        ('<joint type="slide" range="0 .05"/>' + hinge("0 1 1", "-90 90") + TIP, 0.13),
        (chain(hinge("1 0 0", "-90 90"), hinge("0 1 0", "-90 90"), hinge("1 0 0", "0 90")), 0.2),
        (chain(*(hinge(f"{k % 2} 1 0", "-300 300") for k in range(6))), 0.26),
    ],
)
def test_what_turns_on_an_arm_is_enclosed_between_the_places_that_are_looked_at_too(
    tmp_path: Path, held: str, most_m: float
) -> None:
    """Capsules about five places of a full turn let a finger stick out by 35 mm."""
    path = tmp_path / "turning.xml"
    path.write_text(ARM.format(held))
    arm = arm_model(path, joint_names=("pan",))
    placed = place_capsules(arm, forward_kinematics(arm, np.array([0.4])))
    engine = mujoco.MjModel.from_xml_path(str(path))
    data, rng, tip = mujoco.MjData(engine), np.random.default_rng(0), engine.ngeom - 1
    data.qpos[0] = 0.4
    for _ in range(500):
        data.qpos[1:] = rng.uniform(*engine.jnt_range[1:].T)
        mujoco.mj_kinematics(engine, data)
        half = engine.geom_size[tip, 1] * data.geom_xmat[tip].reshape(3, 3)[:, 2]
        ends = data.geom_xpos[tip] + np.stack([-half, half])
        assert distance_to_segment(ends, placed.ends[-1]).max() + 0.005 <= placed.radii[-1] + 1e-9
    assert placed.radii[-1] < most_m


def test_what_hangs_on_a_ball_is_enclosed_whichever_way_it_turns(tmp_path: Path) -> None:
    """Its range is how far it turns about any axis: taken for a hinge's, it stayed where the file draws it."""
    path = tmp_path / "ball.xml"
    path.write_text(ARM.format(f'<joint type="ball" range="0 90" pos="0 0 .03"/>{TIP}'))
    arm = arm_model(path, joint_names=("pan",))
    placed = place_capsules(arm, forward_kinematics(arm, np.zeros(1)))
    engine = mujoco.MjModel.from_xml_path(str(path))
    data, rng, tip = mujoco.MjData(engine), np.random.default_rng(0), engine.ngeom - 1
    for _ in range(500):
        axis = rng.normal(size=3)
        half_turn = rng.uniform(0, np.pi / 4)
        data.qpos[1:] = [np.cos(half_turn), *(np.sin(half_turn) * axis / np.linalg.norm(axis))]
        mujoco.mj_kinematics(engine, data)
        half = engine.geom_size[tip, 1] * data.geom_xmat[tip].reshape(3, 3)[:, 2]
        ends = data.geom_xpos[tip] + np.stack([-half, half])
        assert distance_to_segment(ends, placed.ends[-1]).max() + 0.005 <= placed.radii[-1] + 1e-9
    assert placed.radii[-1] < 0.13
