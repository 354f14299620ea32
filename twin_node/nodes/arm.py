"""The arm node: obstacles and the arm's own next 200 ms in, a speed fraction out."""

from __future__ import annotations

from typing import Any

from twin_node.arm import ArmCollisionChecker, CyclicPath, SeparationLimiter, decide, extrapolate, path_ahead
from twin_node.messages import convert
from twin_node.nodes.topics import JOINT_STATES, OBSTACLES, SEPARATION, TRAJECTORY
from twin_node.runtime.bus import Bus
from twin_node.runtime.clock import Clock
from twin_node.runtime.node import Node
from twin_node.scene import JointPath, JointSample


class ArmNode(Node):
    """Looks along the arm's next 200 ms at every new set of obstacles, and publishes `/twin/separation`.

    The arm's future comes from `/arm/trajectory` while it lasts, else from `/joint_states` extrapolated, else from the
    given cycle: a log without an arm is judged as if one worked in it.
    """

    def __init__(
        self, bus: Bus, clock: Clock, checker: ArmCollisionChecker, limiter: SeparationLimiter, cycle: CyclicPath
    ) -> None:
        super().__init__("arm", bus, clock)
        self._checker = checker
        self._limiter = limiter
        self._cycle = cycle
        self._path: JointPath | None = None
        self._joints: JointSample | None = None

    def on_configure(self) -> None:
        self.bus.subscribe(TRAJECTORY, self._on_trajectory)
        self.bus.subscribe(JOINT_STATES, self._on_joints)
        self.bus.subscribe(OBSTACLES, self._on_obstacles)

    def _on_trajectory(self, message: Any) -> None:
        self._path = convert.joint_path_from_message(message, self.clock.now())

    def _on_joints(self, message: Any) -> None:
        self._joints = convert.joint_sample_from_message(message)

    def _on_obstacles(self, message: Any) -> None:
        obstacles = convert.obstacles_from_message(message)
        self._checker.update(obstacles)
        stamp = max(self.clock.now(), obstacles.stamp)
        separation = decide(self._checker, self._path_from(stamp), stamp, self._limiter)
        self.bus.publish(SEPARATION, convert.separation_to_message(separation))

    def _path_from(self, stamp: int) -> JointPath:
        model = self._checker.model
        if self._path is not None and self._path.stamps[-1] > stamp:
            return path_ahead(model, self._path, stamp)
        if self._joints is not None:
            return extrapolate(model, self._joints.positions, self._joints.velocities, stamp)
        return self._cycle.ahead(stamp)
