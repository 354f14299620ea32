"""The arm node: obstacles and the arm's own next 200 ms in, a speed fraction out."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from enum import Enum

from twin_node.arm import (
    ArmCollisionChecker,
    ArmError,
    ArmPredictor,
    Commands,
    CyclicPath,
    SpeedLimiter,
    beyond,
    decide,
    default_path,
    standing,
)
from twin_node.arm.ur import servo_stopping
from twin_node.errors import TwinError
from twin_node.messages import Message, convert
from twin_node.nodes.arm_parameters import ArmParameters
from twin_node.nodes.topics import DIAGNOSTICS, JOINT_STATES, OBSTACLES, SEPARATION, TRAJECTORY
from twin_node.nodes.ur_driver import driven_model, is_other_arm
from twin_node.robot import RobotError
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
AHEAD_S = 0.05
"""Evidence so far in the future tells of clocks that differ, s: two of the periods in which a player tells the time."""
OUTSIDE_M = 0.02
"""So far out the arm's end is outside the workspace, m: less than a voxel."""
TOLD_NS = 10_000_000_000
"""So long after it is told that the arm was outside the workspace, ns: about a cycle."""
MADE_UP = " (of a made-up arm)"
"""Said after the reason of a decision where nobody has told of an arm."""
CLOCKS = "keep the clocks of cameras, twin and arm together (chrony, PTP)"
"""What to do about stamps of another time."""
ROUNDING = 1e-6
"""Share of a step by which a moment that was aimed at may be missed for reasons of floating point."""


class Driving(Enum):
    """Who obeys the decisions, as far as is known."""

    NOBODY = "nobody"
    BY_SLIDER = "by slider"
    """A driver holds the arm's own program back, or reads only."""
    SERVOED = "servoed"
    """A driver leads the arm along trajectories, and brakes for it."""


class ArmNode(Node):
    """Looks along the arm's next 200 ms at every new set of obstacles, and publishes `/twin/separation`.

    The arm's future comes from `/arm/trajectory` while it lasts and the joints are on it, else from `/joint_states`
    extrapolated, which must be as fresh as forecasts. In a live graph they are those of an arm that obeys: the share
    that it was told is taken out. Where neither has ever come it is that of a made-up cycle: a log without an arm is
    judged as if one worked in it. Not so where a driver obeys, or where all that came was refused: that arm stands
    until somebody tells where it is.
    """

    def __init__(
        self,
        bus: Bus,
        clock: Clock,
        checker: ArmCollisionChecker,
        make_cycle: Callable[[], CyclicPath],
        parameters: ArmParameters,
        timers: Timers | None = None,
        driving: Callable[[], Driving] | None = None,
        workspace: Float64 | None = None,
    ) -> None:
        """`make_cycle()`: what an arm of which nobody tells is taken to do.

        `timers`: tell of forecasts that do not come; None in lockstep, where nothing is late, and where the arm of the
        log, which heard nobody, moves at its full speed whatever is told.
        `driving()`: who drives the arm now; it may be servoed beside what the parameters say. None: nobody.
        `workspace` [2, 3]: corners of what is looked at, m; None: nobody is told where the arm leaves it.
        """
        super().__init__("arm", bus, clock)
        self._silence = (timers or NoTimers()).alarm(self._on_silence)
        self._arrived = 0
        self._gaps: deque[float] = deque(maxlen=GAPS_KEPT)
        self._checker = checker
        self._parameters = parameters
        self._own_stop = parameters.table(checker.bare_model)
        self._servo_stop = servo_stopping(checker.bare_model, self._own_stop, parameters.servo_lookahead_s)
        self._driving = driving or (lambda: Driving.NOBODY)
        self._limiter = SpeedLimiter(parameters.limiter)
        limits = parameters.limiter
        self._arm = ArmPredictor(checker.model, make_cycle, limits.evidence_latency_s + 2 * limits.deadline_s)
        self._workspace = workspace
        self._outside: tuple[int, float] | None = None
        """When the arm's end was last outside the workspace, ns, and how far, m."""
        self._driven_model: str | None = None
        """The arm that the driver says it drives; None: it has said nothing."""
        self._refused: str | None = None
        self._ahead_s = 0.0
        """How far the newest evidence lay in the future, s."""
        self._is_live = timers is not None
        self._commands = Commands(parameters.command_latency_ms * 1e-3)

    def on_configure(self) -> None:
        self._driving()  # a graph tells of others from the first look on, and not with the first obstacles yet
        self.bus.subscribe(TRAJECTORY, self._on_trajectory)
        self.bus.subscribe(JOINT_STATES, self._on_joints)
        self.bus.subscribe(OBSTACLES, self._on_obstacles)
        if self._is_live:
            self.bus.subscribe(DIAGNOSTICS, self._on_diagnostics)
        self._silence.set(SHORTEST_WAIT_S)

    def diagnoses(self) -> tuple[convert.Diagnosis, ...]:
        """Whether it knows of an arm, whether that works where somebody looks, and whether forecasts come in time."""
        return (self._known(), self._reach(), self._forecasts())

    def _known(self) -> convert.Diagnosis:
        """Whether somebody tells where the arm is, and can be believed."""
        level, message = convert.Level.OK, "known"
        if (other := self._other_arm()) is not None:
            level, message = convert.Level.ERROR, f"{other}, so it stands"
        elif self._arm.is_made_up:
            level = convert.Level.WARN
            message = f"nobody publishes {JOINT_STATES} or {TRAJECTORY}: a made-up cycle is judged in place of an arm"
        elif self._arm.refused is not None:
            level, message = convert.Level.ERROR, self._arm.refused
        elif (torn_rad := self._arm.torn_rad(self.clock.now())) is not None:
            level = convert.Level.ERROR
            message = (
                f"the arm's joints jump by {torn_rad:.2f} rad, so it stands: where two arms tell of themselves on "
                f"{JOINT_STATES}, give their joints' names a prefix each ('joints' of 'arm' and 'ur_driver')"
            )
        elif (lost := self._lost()) is not None:
            level = convert.Level.ERROR
            message = f"{lost}, so it stands; look at who publishes {JOINT_STATES}, and {CLOCKS}"
        elif self._arm.stray_rad is not None:
            level = convert.Level.WARN
            message = (
                f"the arm is {self._arm.stray_rad:.2f} rad from where {TRAJECTORY} has it: {JOINT_STATES} alone are "
                "believed until another one comes; publish what it will do as it is held back"
            )
        elif (stale := self._arm.stale(self.clock.now())) is not None:
            level = convert.Level.WARN
            message = (
                f"{stale}: {TRAJECTORY} alone is believed, and in images the arm is a thing that moves; look at who "
                f"publishes {JOINT_STATES}, and {CLOCKS}"
            )
        return convert.Diagnosis(f"{self.name}: joints", level, message)

    def _lost(self) -> str | None:
        """Why nobody knows where the arm is by now; None: somebody does."""
        now = self.clock.now()
        try:
            self._arm.ahead(now, now)
        except (ArmError, RobotError) as error:
            return str(error)
        return None

    def _reach(self) -> convert.Diagnosis:
        """Whether the arm works where somebody looks: elsewhere nothing is seen, and nothing stops it."""
        level, message = convert.Level.OK, "inside the workspace"
        if self._outside is not None and self.clock.now() - self._outside[0] < TOLD_NS:
            level = convert.Level.WARN
            message = (
                f"the arm's end is {self._outside[1]:.2f} m outside the workspace, where nothing is looked for and "
                "nothing stops it; let the rig's 'workspace' reach farther"
            )
        return convert.Diagnosis(f"{self.name}: reach", level, message)

    def _forecasts(self) -> convert.Diagnosis:
        """Whether the arm stands because nothing is known: a twin that hangs cannot say so, nor one that has ended."""
        now = self.clock.now()
        silence_s = self._limiter.silence_s(now)
        level, message = convert.Level.OK, "in time"
        if silence_s >= 2 * self._parameters.limiter.deadline_s:
            level = convert.Level.ERROR
            message = f"{self._limiter.lack(now)}: the arm stands; look at the twin's status"
            if self._refused is not None:
                message = f"refused: {self._refused}"
        elif self._ahead_s > AHEAD_S:
            level = convert.Level.WARN
            message = (
                f"their evidence lies {self._ahead_s * 1e3:.0f} ms in the future, so nobody knows how old it is; "
                f"{CLOCKS}"
            )
        readings = (convert.Reading("silence_s", f"{silence_s:.3f}"),)
        return convert.Diagnosis(f"{self.name}: forecasts", level, message, readings)

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
        self._commands.tell(separation.speed_fraction, self.clock.now())
        self.bus.publish(SEPARATION, convert.separation_to_message(separation))

    def _on_diagnostics(self, message: Message) -> None:
        self._driven_model = driven_model(message) or self._driven_model

    def _other_arm(self) -> str | None:
        """That the driver on the graph drives another arm than is judged here; None: it does not, or there is none."""
        driven, judged = self._driven_model, self._parameters.model
        if driven is None or self._driving() is Driving.NOBODY or not is_other_arm(driven, judged):
            return None
        return f"another arm is driven than judged: 'model' of 'ur_driver' is {driven}, of 'arm' {judged}"

    def _on_trajectory(self, message: Message) -> None:
        if not message.points:  # so ROS's trajectory controllers are told to stay where they are
            self._arm.leave_path()
            return
        try:
            self._arm.take_path(convert.joint_path_from_message(message, self.clock.now()))
        except TwinError as error:
            self._arm.leave_path()  # whatever this one says, the arm goes along it and not along the one before
            self._arm.refuse(str(error))
            raise

    def _on_joints(self, message: Message) -> None:
        try:
            sample = convert.joint_sample_from_message(message)
            tells_velocities = convert.has_velocities(message, self._checker.model.joint_names)
            share = self._commands.least(self.clock.now()) if self._is_live else 1.0
            self._arm.take_joints(sample, tells_velocities, share)
        except TwinError as error:
            self._arm.refuse(str(error))
            raise

    def _on_obstacles(self, message: Message) -> None:
        now = self.clock.now()
        try:
            _check_frame(message.header.frame_id)
            obstacles = convert.obstacles_from_message(message)
            self._ahead_s = (obstacles.stamp - now) * 1e-9
            self._checker.update(obstacles)
            decision = self._decided(obstacles, now)
        except TwinError as error:
            self._refused = str(error)  # the arm slows and stops by itself; it is to say why
            raise
        self._refused = None
        self._tell(replace(self._limiter.decide(decision, now), stamp=decision.stamp))
        self._watch(now)

    def _decided(self, obstacles: Obstacles, now: int) -> Separation:
        """What the law says now (ns); an arm of which nobody knows stands.

        In lockstep, of the time that the obstacles are valid from, for the log's arm has gone on at its full speed by
        then. One that is held back has not: where it would be then may lie beyond somebody whom it still closes in on.
        """
        reaction_s, driving = self._reaction_s(now), self._driving()
        stamp, heard = (now, now) if self._is_live else (max(now, obstacles.begins), max(now, obstacles.stamp))
        if (driving is not Driving.NOBODY or self._parameters.driven) and self._arm.is_made_up:
            why = f"an arm is driven, and nobody publishes its {JOINT_STATES} or {TRAJECTORY}"
            return standing(stamp, obstacles.stamp, f"stopped: {why}")
        if (other := self._other_arm()) is not None:
            return standing(stamp, obstacles.stamp, f"stopped: {other}")
        try:
            path = self._arm.ahead(stamp, heard)  # a log may be recorded before its stamps
        except (ArmError, RobotError) as error:
            if isinstance(error, RobotError) and not self._is_live:
                raise  # who replays the log of another arm can name that one
            return standing(stamp, obstacles.stamp, f"stopped: {error}")
        if self._workspace is not None and not self._arm.is_made_up:
            out_m = beyond(self._checker.model, path.positions[0], self._workspace)
            if out_m > OUTSIDE_M:
                self._outside = now, out_m
        is_servoed = self._parameters.servoed or driving is Driving.SERVOED
        table = self._servo_stop if is_servoed else self._own_stop
        law, measured, underway = self._parameters.separation, None, None
        if self._is_live:  # a log's arm brakes for nobody
            measured, underway = self._arm.joints(now), self._commands.underway(now)
            underway = underway if is_servoed else replace(underway, slide_s=self._parameters.slide_s)
        decision = decide(self._checker, path, stamp, reaction_s, law, table, measured, underway)
        return replace(decision, reason=decision.reason + MADE_UP) if self._arm.is_made_up else decision

    def _reaction_s(self, now: int) -> float:
        """From a decision until the arm obeys the next one: the longest of the last gaps, then the command's way.

        No gap counts longer than two deadlines, after which the arm stands without a decision: a slow one goes on
        until then.
        """
        stands_ns = 2 * self._parameters.limiter.deadline_s * 1e9
        self._gaps.append(min(max(now - self._arrived, 0), stands_ns))
        self._arrived = now
        return max(self._gaps) * 1e-9 + self._parameters.command_latency_ms * 1e-3


def _check_frame(frame: str) -> None:
    if frame.lstrip("/") != convert.BASE_FRAME:
        raise ArmError(f"obstacles: expected them in {convert.BASE_FRAME}, found {frame!r}; transform them before")


def make_arm_node(
    bus: Bus,
    clock: Clock,
    workspace: Float64,
    parameters: ArmParameters,
    timers: Timers | None = None,
    driving: Callable[[], Driving] | None = None,
) -> ArmNode:
    """The arm's node of a chain; `workspace` [2, 3] m. `timers` and `driving`: see `ArmNode`."""
    arm = parameters.arm()
    checker = ArmCollisionChecker(arm, max_obstacles=parameters.max_obstacles, allowed=parameters.regions(arm))
    return ArmNode(bus, clock, checker, lambda: default_path(arm, workspace), parameters, timers, driving, workspace)
