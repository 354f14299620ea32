"""An arm's node at work, for its tests: its clock, its joints and somebody beside it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from twin_logs import START

from twin_node.messages import convert
from twin_node.nodes.arm import Driving, make_arm_node
from twin_node.nodes.arm_parameters import ArmParameters
from twin_node.nodes.topics import JOINT_STATES, OBSTACLES, SEPARATION, TRAJECTORY
from twin_node.robot import forward_kinematics, ur_model
from twin_node.runtime.bus import LocalBus
from twin_node.runtime.clock import SteppedClock
from twin_node.runtime.parameters import fill
from twin_node.scene import Float64, JointPath, JointSample, ObstacleKind, Obstacles, ObstacleShape, Separation

MS = 1_000_000
MODEL = ur_model("ur5e")
READY = np.array([0.0, -1.5, 1.5, -1.5, -1.57, 0.0])
TURNING = np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.0])
"""rad/s: the arm sweeps to its left."""
WORKSPACE = np.array([[0.1, -0.6, 0.0], [0.8, 0.6, 0.5]])
"""Corners, m."""


class Alarm:
    """Remembers for how long it was set."""

    def __init__(self) -> None:
        self.delays: list[float] = []

    def set(self, delay_s: float) -> None:
        self.delays.append(delay_s)


class Timers:
    """One alarm, which the test rings."""

    def __init__(self) -> None:
        self.alarm_ = Alarm()

    def alarm(self, callback: Callable[[], None]) -> Alarm:
        self.ring = callback
        return self.alarm_


class Cell:
    """An arm's node, its clock, and somebody 36 cm to the left of the tool: an arm that turns there slows."""

    def __init__(
        self, timers: Timers | None = None, driving: Callable[[], Driving] | None = None, **given: object
    ) -> None:
        """`driving()`: see `ArmNode`; `given`: parameters of the arm as they stand in a file."""
        self.bus, self.clock = LocalBus(), SteppedClock(START)
        self.told: list[Separation] = []
        self.bus.subscribe(SEPARATION, lambda message: self.told.append(convert.separation_from_message(message)))
        parameters = fill(ArmParameters, {"model": "ur5e", "max_obstacles": 8, **given}, "arm")
        self.node = make_arm_node(self.bus, self.clock, WORKSPACE, parameters, timers, driving)
        self.node.configure()

    def wait(self, milliseconds: int) -> None:
        self.clock.advance_to(self.clock.now() + milliseconds * MS)

    def joints(self, q: Float64 = READY, qd: Float64 = TURNING, ago_ms: int = 0, has_velocities: bool = True) -> None:
        sample = JointSample(self.clock.now() - ago_ms * MS, MODEL.joint_names, q, qd)
        message = convert.joint_sample_to_message(sample)
        if not has_velocities:
            message.velocity = np.zeros(0)
        self.bus.publish(JOINT_STATES, message)

    def gripper(self) -> None:
        sample = JointSample(self.clock.now(), ("finger_joint",), np.zeros(1), np.zeros(1))
        self.bus.publish(JOINT_STATES, convert.joint_sample_to_message(sample))

    def path(
        self,
        begins_ms: int,
        lasts_ms: int,
        velocity: Float64 = TURNING,
        is_stamped: bool = True,
        start: Float64 = READY,
    ) -> None:
        seconds = np.linspace(0, lasts_ms * 1e-3, 11)
        stamps = self.clock.now() + begins_ms * MS + np.rint(seconds * 1e9).astype(np.int64)
        path = JointPath(MODEL.joint_names, stamps, start + seconds[:, None] * velocity)
        message = convert.joint_path_to_message(path)
        if not is_stamped:
            message.header.stamp.sec = message.header.stamp.nanosec = 0
        self.bus.publish(TRAJECTORY, message)

    def stay(self) -> None:
        path = JointPath(MODEL.joint_names, np.array([self.clock.now()]), READY[None])
        message = convert.joint_path_to_message(path)
        message.points = []
        self.bus.publish(TRAJECTORY, message)

    def somebody(
        self,
        count: int = 1,
        begins_ms: int = 0,
        ahead_ms: int = 0,
        frame: str = "base_link",
        at: Float64 | None = None,
        kind: ObstacleKind = ObstacleKind.MOVING,
    ) -> Separation:
        """Obstacles, now (or stamped ahead), foreseen from so much later on; gives back what the arm is told."""
        now = self.clock.now() + ahead_ms * MS
        beside = forward_kinematics(MODEL, READY)[-1, :3, 3] + np.array([0.0, 0.41, 0.0])
        obstacles = Obstacles(
            stamp=now,
            ids=np.arange(count, dtype=np.uint32),
            kinds=np.full(count, kind, np.uint8),
            shapes=np.full(count, ObstacleShape.SPHERE, np.uint8),
            positions=np.tile(beside if at is None else at, (count, 1)),
            quats=np.tile([1.0, 0, 0, 0], (count, 1)),
            sizes=np.full((count, 3), 0.1),
            velocities=np.zeros((count, 3)),
            bounds=np.zeros(count),
            valid_from=np.full(count, now + begins_ms * MS),
            valid_to=np.full(count, now + (begins_ms + 200) * MS),
        )
        message = convert.obstacles_to_message(obstacles)
        message.header.frame_id = frame
        self.bus.publish(OBSTACLES, message)
        return self.told[-1]
