"""The arm itself: rigid-body dynamics by MuJoCo, driven by computed torque along the controller's targets."""

from __future__ import annotations

import cv2
import mujoco
import numpy as np

from twin_node.geometry import pose
from twin_node.robot import ArmModel
from twin_node.robot.mjcf import write_mjcf
from twin_node.scene import Float64

_BANDWIDTH = 100.0
"""rad/s: the joint servo's natural frequency, critically damped; five of the e-Series' 2 ms periods per radian."""
_BASE_LINK_BASE = np.diag([-1.0, -1.0, 1.0])
"""Rotation from `base`, in which RTDE speaks, to `base_link` (REP-199): half a turn about z."""


class SimulatedArm:
    """A UR arm whose motors have no torque limit and whose links touch nothing."""

    def __init__(self, model: ArmModel, q: Float64, period_s: float) -> None:
        """`q` [6] rad is where it stands; every `step` takes `period_s`."""
        self.model = model
        self._engine = mujoco.MjModel.from_xml_string(write_mjcf(model))
        self._engine.opt.timestep = period_s
        self._data = mujoco.MjData(self._engine)
        self._data.qpos[:] = q
        self._qpos, self._qvel = self._data.qpos, self._data.qvel
        self._bias, self._applied = self._data.qfrc_bias, self._data.qfrc_applied
        self._torque = np.zeros(self._engine.nv)
        mujoco.mj_forward(self._engine, self._data)

    @property
    def q(self) -> Float64:
        """Joint angles [6], rad."""
        return np.array(self._qpos)

    @property
    def qd(self) -> Float64:
        """Joint velocities [6], rad/s."""
        return np.array(self._qvel)

    def step(self, q: Float64, qd: Float64, qdd: Float64) -> None:
        """One period towards target angles, velocities and accelerations [6] (rad, rad/s, rad/s^2)."""
        data = self._data
        wanted = qdd + _BANDWIDTH**2 * (q - self._qpos) + 2 * _BANDWIDTH * (qd - self._qvel)
        mujoco.mj_mulM(self._engine, data, self._torque, wanted)
        np.add(self._torque, self._bias, out=self._applied)
        mujoco.mj_step(self._engine, data)

    def tool_pose(self, tcp_offset: Float64) -> Float64:
        """Pose of the TCP as `pose_in_base` gives it, for an offset [6] from the flange."""
        body = self._engine.body(self.model.link_names[-1]).id
        flange = pose(self._data.xmat[body].reshape(3, 3), self._data.xpos[body])
        return pose_in_base(flange, tcp_offset)


def pose_in_base(T_base_link_flange: Float64, tcp_offset: Float64) -> Float64:
    """[6] metres and rotation vector in RTDE's `base` of a TCP, at an offset [6] from the flange, [4, 4]."""
    rotation = _BASE_LINK_BASE @ T_base_link_flange[:3, :3]
    position = _BASE_LINK_BASE @ T_base_link_flange[:3, 3] + rotation @ tcp_offset[:3]
    turned = rotation @ cv2.Rodrigues(tcp_offset[3:])[0]
    return np.concatenate([position, cv2.Rodrigues(turned)[0].ravel()])
