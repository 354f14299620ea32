"""The arm node: obstacles and the arm's own next 200 ms in, a speed fraction out."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from twin_node.arm import (
    ArmCollisionChecker,
    ArmError,
    CyclicPath,
    LimiterParameters,
    SeparationParameters,
    SpeedLimiter,
    Whereabouts,
    decide,
    default_path,
    standing,
)
from twin_node.errors import TwinError
from twin_node.messages import convert
from twin_node.nodes.topics import JOINT_STATES, OBSTACLES, SEPARATION, TRAJECTORY
from twin_node.ranges import NOT_NEGATIVE, Range, check_ranges
from twin_node.robot import ArmModel, Capsules, arm_model
from twin_node.runtime.bus import Bus
from twin_node.runtime.clock import Clock
from twin_node.runtime.executor import SHORTEST_WAIT_S, NoTimers, Timers
from twin_node.runtime.node import Node
from twin_node.scene import Float64, Obstacles, Separation

GAPS_KEPT = 10
"""Gaps between decisions that tell how long the next may be, a third of a second at 30 Hz."""
REPEATS_PER_DEADLINE = 2
"""How often it says again that the arm stands: who drives it must hear of somebody."""
HEARD_NS = 5_000_000
"""From a decision until another process of the host has heard it, ns, ten times the usual: silence is answered so much
before its deadline, so that who drives the arm knows by then."""
FARTHEST_TOOL_M = 2.0
"""No part of a tool is farther from `tool0`, m: who gives more means millimetres."""
ROUNDING = 1e-6
"""Share of a step by which a moment that was aimed at may be missed for reasons of floating point."""


@dataclass(frozen=True)
class ToolCapsule:
    """A capsule about a part of what the arm carries for good, in the frame of `tool0`; equal ends make a sphere."""

    start: tuple[float, float, float]
    """m."""
    end: tuple[float, float, float]
    """m."""
    radius: float
    """m."""

    def __post_init__(self) -> None:
        """Raises `ArmError` for values that make no capsule, or one in millimetres."""
        places = np.abs([*self.start, *self.end])
        if not (places <= FARTHEST_TOOL_M).all() or not 0 < self.radius <= FARTHEST_TOOL_M:
            raise ArmError(
                f"tool: expected ends and a radius in metres, at most {FARTHEST_TOOL_M:g} from tool0, found "
                f"{list(self.start)}, {list(self.end)} and {self.radius:g}"
            )


@dataclass(frozen=True)
class ArmParameters:
    """Which arm works in the cell, and how it keeps its distance."""

    model: str = "ur10e"
    """One of the arms of `twin_node.robot.UR_NAMES`, or an MJCF or URDF file."""
    kinematics: str | None = None
    """A UR arm's own calibration file from `ur_calibration`; None: the published DH parameters."""
    tool: tuple[ToolCapsule, ...] = ()
    """What it carries for good, a gripper at its widest for example: kept away, and masked, as the arm's links are."""
    command_latency_ms: float = 20.0
    """From the decision until the arm begins to brake: two periods of RTDE at 125 Hz and its input buffer."""
    max_obstacles: int = 1024
    """Room for spheres and for boxes each: 704 boxes are the most of the cover's defaults (section `obstacles`)."""
    separation: SeparationParameters = field(default_factory=SeparationParameters)
    limiter: LimiterParameters = field(default_factory=LimiterParameters)

    def __post_init__(self) -> None:
        """Raises `ArmError` for a latency that no command has, and for room for nothing."""
        check_ranges(self, ArmError, "arm: ", command_latency_ms=NOT_NEGATIVE, max_obstacles=Range(1))

    def arm(self) -> ArmModel:
        """The arm's model with its tool. Raises `RobotError` or `ResourceError` for a wrong name or file."""
        bare = arm_model(self.model, self.kinematics)
        if not self.tool:
            return bare
        carried = Capsules(
            links=np.full(len(self.tool), bare.joints),
            ends=np.array([[capsule.start, capsule.end] for capsule in self.tool]),
            radii=np.array([capsule.radius for capsule in self.tool]),
        )
        return replace(bare, capsules=bare.capsules.joined(carried))


class ArmNode(Node):
    """Looks along the arm's next 200 ms at every new set of obstacles, and publishes `/twin/separation`.

    The arm's future comes from `/arm/trajectory` while it lasts, else from `/joint_states` extrapolated, which must be
    as fresh as forecasts. In a live graph they are those of an arm that obeys: the share that it was told is taken out.
    Where neither has ever come it is that of the given cycle: a log without an arm is judged as if one worked in it.
    """

    def __init__(
        self,
        bus: Bus,
        clock: Clock,
        checker: ArmCollisionChecker,
        cycle: CyclicPath,
        parameters: ArmParameters,
        timers: Timers | None = None,
    ) -> None:
        """`timers`: tell of forecasts that do not come; None in lockstep, where nothing is late."""
        super().__init__("arm", bus, clock)
        self._silence = (timers or NoTimers()).alarm(self._on_silence)
        self._arrived = 0
        self._gaps: deque[float] = deque(maxlen=GAPS_KEPT)
        self._checker = checker
        self._parameters = parameters
        self._limiter = SpeedLimiter(parameters.limiter)
        limits = parameters.limiter
        self._arm = Whereabouts(checker.model, cycle, limits.evidence_latency_s + 2 * limits.deadline_s)
        self._refused: str | None = None
        self._is_live = timers is not None
        self._share = 0.0

    def on_configure(self) -> None:
        self.bus.subscribe(TRAJECTORY, self._on_trajectory)
        self.bus.subscribe(JOINT_STATES, self._on_joints)
        self.bus.subscribe(OBSTACLES, self._on_obstacles)
        self._silence.set(SHORTEST_WAIT_S)

    def diagnoses(self) -> tuple[convert.Diagnosis, ...]:
        """Whether it knows of an arm."""
        level, message = convert.Level.OK, "known"
        if self._arm.is_made_up:
            level = convert.Level.WARN
            message = f"nobody publishes {JOINT_STATES} or {TRAJECTORY}: a made-up cycle is judged in place of an arm"
        return (convert.Diagnosis(f"{self.name}: joints", level, message),)

    def _on_silence(self) -> None:
        """Slows an arm one deadline after its last forecast, stops it after two, and says so while it lasts."""
        now = self.clock.now()
        heard = now + HEARD_NS
        told = self._limiter.tick(heard)
        if self._limiter.silence_s(heard) >= self._parameters.limiter.deadline_s:
            why = told.reason if self._refused is None else f"{told.reason}; the last was refused: {self._refused}"
            self._tell(replace(told, stamp=now, reason=why))
        self._watch(now)

    def _watch(self, now: int) -> None:
        """Sets the alarm for when something is to be said if no forecast comes by then."""
        deadline, silence = self._parameters.limiter.deadline_s, self._limiter.silence_s(now + HEARD_NS)
        step = deadline if silence < deadline else deadline / REPEATS_PER_DEADLINE
        passed = silence if math.isfinite(silence) else 0.0
        left = (math.floor(passed / step + ROUNDING) + 1) * step - passed
        self._silence.set(max(left, SHORTEST_WAIT_S))

    def _tell(self, separation: Separation) -> None:
        self._share = separation.speed_fraction
        self.bus.publish(SEPARATION, convert.separation_to_message(separation))

    def _on_trajectory(self, message: Any) -> None:
        self._arm.take_path(convert.joint_path_from_message(message, self.clock.now()))

    def _on_joints(self, message: Any) -> None:
        sample = convert.joint_sample_from_message(message)
        self._arm.take_joints(sample, len(message.velocity) > 0, self._share if self._is_live else 1.0)

    def _on_obstacles(self, message: Any) -> None:
        now = self.clock.now()
        try:
            _check_frame(message.header.frame_id)
            obstacles = convert.obstacles_from_message(message)
            self._checker.update(obstacles)
            decision = self._decided(obstacles, max(now, obstacles.begins), now)
        except TwinError as error:
            self._refused = str(error)  # the arm slows and stops by itself; it is to say why
            raise
        self._refused = None
        self._tell(replace(self._limiter.decide(decision, now), stamp=decision.stamp))
        self._watch(now)

    def _decided(self, obstacles: Obstacles, stamp: int, now: int) -> Separation:
        """What the law says at a time (ns) that the obstacles are valid from; an arm of which nobody knows stands."""
        reaction_s = self._reaction_s(now)
        try:
            path = self._arm.ahead(stamp, max(now, obstacles.stamp))  # a log may be recorded before its stamps
        except ArmError as error:
            return standing(stamp, obstacles.stamp, f"stopped: {error}")
        return decide(self._checker, path, stamp, reaction_s, self._parameters.separation)

    def _reaction_s(self, now: int) -> float:
        """From a decision until the arm obeys the next one: the longest of the last gaps, then the command's way.

        No gap counts longer than the deadline, after which the arm is slow without a decision.
        """
        deadline_ns = self._parameters.limiter.deadline_s * 1e9
        self._gaps.append(min(max(now - self._arrived, 0), deadline_ns))
        self._arrived = now
        return max(self._gaps) * 1e-9 + self._parameters.command_latency_ms * 1e-3


def _check_frame(frame: str) -> None:
    if frame.lstrip("/") != convert.BASE_FRAME:
        raise ArmError(f"obstacles: expected them in {convert.BASE_FRAME}, found {frame!r}; transform them before")


def make_arm_node(
    bus: Bus, clock: Clock, workspace: Float64, parameters: ArmParameters, timers: Timers | None = None
) -> ArmNode:
    """The arm's node of a chain; `workspace` [2, 3] m. `timers`: see `ArmNode`."""
    arm = parameters.arm()
    checker = ArmCollisionChecker(arm, max_obstacles=parameters.max_obstacles)
    return ArmNode(bus, clock, checker, default_path(arm, workspace), parameters, timers)
