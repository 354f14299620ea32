"""A log as a MuJoCo model: obstacles as mocap bodies, their motion and the arm's as keyframes, and a player."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from twin_node.messages.convert.markers import KIND_COLOURS
from twin_node.nodes.export.moments import Moments, opacity
from twin_node.robot.mjcf import write_mjcf
from twin_node.scene import Float64, ObstacleKind, Obstacles, ObstacleShape

PARKED = np.array([0.0, 0.0, -1000.0])
"""Where a body waits that no obstacle needs, m: no arm comes near."""
THINNEST_M = 1e-6
"""Half extents below this are shown as it, m: MuJoCo loads no geometry without a size."""

PLAYER = '''"""Plays the model beside this file in MuJoCo's viewer at its own pace, over and over."""

import time
from pathlib import Path

import mujoco
import mujoco.viewer

model = mujoco.MjModel.from_xml_path(str(Path(__file__).with_name({model!r})))
data = mujoco.MjData(model)
with mujoco.viewer.launch_passive(model, data) as viewer:
    while viewer.is_running():
        begun = time.monotonic()
        for key in range(model.nkey):
            time.sleep(max(model.key_time[key] - (time.monotonic() - begun), 0.01))  # of one moment, too
            mujoco.mj_resetDataKeyframe(model, data, key)
            mujoco.mj_forward(model, data)
            viewer.sync()
            if not viewer.is_running():
                break
'''


@dataclass(frozen=True)
class _Body:
    """What a mocap body looks like for good: MuJoCo moves bodies between keyframes, and never changes their size."""

    kind: int
    shape: int
    half: NDArray[np.float64]
    """[3] half extents; the radius three times for a sphere, m."""


@dataclass(frozen=True)
class _Pose:
    """Where a body stands at one keyframe."""

    position: Float64
    quat: Float64


_NOWHERE = _Pose(PARKED, np.array([1.0, 0.0, 0.0, 0.0]))


class _Cast:
    """The bodies that together play all obstacles of all keyframes: as many of a size as are there at once."""

    def __init__(self) -> None:
        self.bodies: list[_Body] = []
        self._of_look: dict[bytes, list[int]] = defaultdict(list)

    def play(self, obstacles: Obstacles) -> dict[int, _Pose]:
        """Which body stands where, for the obstacles of one keyframe."""
        poses: dict[int, _Pose] = {}
        taken: dict[bytes, int] = defaultdict(int)
        for kind, shape, size, position, quat in zip(
            obstacles.kinds, obstacles.shapes, obstacles.sizes, obstacles.positions, obstacles.quats, strict=True
        ):
            body = _Body(int(kind), int(shape), np.maximum(size / 2, THINNEST_M))
            look = bytes([body.kind, body.shape]) + np.round(size, 9).tobytes()
            own = self._of_look[look]
            if taken[look] == len(own):
                own.append(len(self.bodies))
                self.bodies.append(body)
            poses[own[taken[look]]] = _Pose(position, quat)
            taken[look] += 1
        return poses


def write_collision_scene(moments: Moments, path: Path) -> None:
    """Writes the model to `path` and its player beside it, as `<name>_play.py`.

    Keyframe k is moment k; bodies that are not needed stand at `PARKED`. The arm is there where the log has its joints.
    Contact masks let the arm meet obstacles, and obstacles nothing else.
    """
    taken = list(moments)
    q = next((moment.q for moment in taken if moment.q is not None), None)
    root = ET.fromstring(write_mjcf(moments.arm)) if q is not None else ET.fromstring("<mujoco><worldbody/></mujoco>")
    root.set("model", path.stem)
    cast = _Cast()
    scenes = [cast.play(moment.obstacles) for moment in taken]
    world = root.find("worldbody")
    assert world is not None
    for number, body in enumerate(cast.bodies):
        world.append(_body_element(number, body))
    keys = ET.SubElement(root, "keyframe")
    for moment, poses in zip(taken, scenes, strict=True):
        placed = [poses.get(number, _NOWHERE) for number in range(len(cast.bodies))]
        q = q if moment.q is None else moment.q
        keys.append(_key_element(moment.seconds, placed if cast.bodies else [], q))
    ET.indent(root)
    path.write_text(ET.tostring(root, encoding="unicode") + "\n", encoding="utf-8")
    path.with_name(f"{path.stem}_play.py").write_text(PLAYER.format(model=path.name), encoding="utf-8")


def _body_element(number: int, body: _Body) -> ET.Element:
    element = ET.Element("body", name=f"obstacle_{number}", mocap="true", pos=_text(PARKED))
    kind, is_sphere = ObstacleKind(body.kind), body.shape == ObstacleShape.SPHERE
    ET.SubElement(
        element,
        "geom",
        name=f"obstacle_{number}",
        type="sphere" if is_sphere else "box",
        size=_text(body.half[:1] if is_sphere else body.half),
        contype="0",
        conaffinity="1",
        rgba=_text(np.array([*KIND_COLOURS[kind], opacity(kind)])),
    )
    return element


def _key_element(seconds: float, placed: Sequence[_Pose], q: Float64 | None) -> ET.Element:
    key = ET.Element("key", name=f"t{seconds:.3f}", time=_text(np.array([seconds])))
    if q is not None:
        key.set("qpos", _text(q))
    if placed:
        key.set("mpos", _text(np.concatenate([pose.position for pose in placed])))
        key.set("mquat", _text(np.concatenate([pose.quat for pose in placed])))
    return key


def _text(values: NDArray[np.floating]) -> str:
    return " ".join(f"{value:.10g}" for value in values)
