"""Slows an arm that ros2_control moves: the speed decided goes to its joint_trajectory_controller.

Source: `speed_scaling.rst` of the joint_trajectory_controller (ros2_controllers), which goes on by that share of its
steps, and control_msgs/SpeedScalingFactor: 1 at its own speed, 0 a full pause.
"""

from __future__ import annotations

import math
import mmap
import struct
import time
from collections.abc import Collection
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

from twin_node.arm import LimiterParameters, SpeedLimiter, standing
from twin_node.errors import TwinError
from twin_node.messages import Message, convert, message_type
from twin_node.nodes.live.obedience import Obedience
from twin_node.nodes.live.setup import Setup
from twin_node.nodes.topics import JOINT_STATES, SEPARATION, SPEED_SCALING_INPUT, is_topic_name, kind_of_own
from twin_node.ranges import Range, check_ranges
from twin_node.runtime.node import LifecycleState, Node
from twin_node.runtime.rmw_zenoh import EntityKind
from twin_node.scene import NO_EVIDENCE

REPEAT_S = 0.5
"""How often all of its speed is told though it stays, s: a controller may be a new one. Less is told again and again,
for a message that is lost where a link is full would let the arm go on."""
LONGEST_LOOK_S = 0.06
"""For so long between two looks the arm has braked meanwhile, s: three periods. A node that was held up for longer does
not make up for the rest, or the arm would stop within one period of its controller."""
STANDS = 1e-6
"""A smaller share is none."""
STANDS_RAD_S = 0.01
"""Joints that are all slower stand, rad/s."""
JOINTS_S = 0.5
"""How long joints are waited for that tell whether the arm moves, s."""
KEPT = "speed_scaling"
"""Name of the file that holds what the controller was told last."""


def _deadlines() -> LimiterParameters:
    return LimiterParameters(deadline_s=0.07)  # as the UR driver's


@dataclass(frozen=True)
class SpeedScalingParameters:
    """Which controller is told, and what it is told without decisions."""

    controller: str = "joint_trajectory_controller"
    """Name of the controller, behind its namespace where it has one."""
    limiter: LimiterParameters = field(default_factory=_deadlines)
    """How the speed follows the decisions, and what it does without them."""
    rate_hz: float = 50.0
    """How often the controller is told while it has less than all of its speed."""

    def __post_init__(self) -> None:
        """Raises `TwinError` for a name that no controller has, and for a rate out of range."""
        check_ranges(self, TwinError, "", rate_hz=Range(1, 1000))
        if not is_topic_name(self.topic):
            raise TwinError(
                f"controller: expected a name such as joint_trajectory_controller, found {self.controller!r}; "
                "'ros2 control list_controllers' lists them"
            )

    @property
    def topic(self) -> str:
        """Where the controller hears of its speed."""
        return f"/{self.controller.strip('/')}{SPEED_SCALING_INPUT}"


def make_speed_scaling(setup: Setup) -> Node:
    """The node `speed_scaling`, which slows as `arm.slide_s` says, for that is what the law counts on."""
    parameters, arm = setup.parameters(SpeedScalingParameters), setup.chain_parameters().arm
    return SpeedScalingNode(setup, parameters, arm.slide_s, arm.arm().joint_names)


class SpeedScalingNode(Node):
    """Tells a controller its share of speed: as decided, down no faster than the arm brakes, to none without decisions.

    It leaves an arm that stands, for a controller keeps what it was told last. So it begins with none, unless the arm
    moves: then with what the node told whose place it takes, or with all, as controllers do.
    """

    def __init__(
        self, setup: Setup, parameters: SpeedScalingParameters, slide_s: float, joint_names: Collection[str]
    ) -> None:
        """`slide_s`: from all of its speed to none, s; `joint_names`: the arm's."""
        super().__init__(setup.name, setup.bus, setup.clock)
        self._bus = setup.bus
        self._timers = setup.timers
        self._endpoints = setup.endpoints
        self._topic = parameters.topic
        self._period_s = 1.0 / parameters.rate_hz
        self._longest_look_s = max(self._period_s, LONGEST_LOOK_S)
        self._slide_s = slide_s
        self._joint_names = frozenset(joint_names)
        self._limiter = SpeedLimiter(parameters.limiter)
        self._obedience, self._say = Obedience(joint_names), setup.say
        self._disobeys = False
        """Whether the user has been told that the arm does not obey."""
        self._kept = None if setup.kept is None else KeptShare(setup.kept / KEPT)
        self._share: float | None = None
        """None as long as nobody knows whether the arm moves."""
        self._speeds: dict[str, float] = {}
        """What was last told of each of the arm's joints, rad/s."""
        self._reason = "stopped: no forecast yet"
        self._since = 0.0
        self._ticked: float | None = None
        self._told: tuple[float, float] | None = None
        """What the controller was told last, and when, by the monotonic clock, s."""

    def on_configure(self) -> None:
        self._bus.declare(self._topic, kind_of_own(self._topic))
        self._bus.advertise(self._topic)
        self._endpoints()  # it is told of others from the first call on
        self.bus.subscribe(SEPARATION, self._on_separation)
        self.bus.subscribe(JOINT_STATES, self._on_joints)
        self._timers.every(self._period_s, self._tick)

    def on_activate(self) -> None:
        self._since = time.monotonic()

    def on_deactivate(self) -> None:
        """The arm comes to rest as it does otherwise, and not at once."""
        self._tell_towards(0.0)
        while self._share:
            time.sleep(self._period_s)
            self._tell_towards(0.0)

    def diagnoses(self) -> tuple[convert.Diagnosis, ...]:
        """How fast the arm may be and why, whether any controller hears of it, and whether the arm obeys."""
        readings = () if self._share is None else (convert.Reading("share", f"{self._share:.2f}"),)
        if (fault := self._obedience.fault(time.monotonic())) is not None:
            return (convert.Diagnosis(f"{self.name}: arm", convert.Level.ERROR, fault, readings),)
        topic = self._bus.resolved(self._topic)
        if any(end.topic == topic and end.kind is EntityKind.SUBSCRIBER for end in self._endpoints()):
            return (convert.Diagnosis(f"{self.name}: arm", convert.Level.OK, self._reason, readings),)
        unheard = (
            f"nobody hears {topic}: no controller of that name is active, or none that can be slowed "
            "(joint_trajectory_controller of Kilted or later)"
        )
        return (convert.Diagnosis(f"{self.name}: arm", convert.Level.ERROR, unheard, readings),)

    def _on_separation(self, message: Message) -> None:
        """By evidence of the future the arm stands, as behind the UR driver: nobody knows how old it is."""
        separation, now = convert.separation_from_message(message), self.clock.now()
        ahead_ns = separation.evidence_stamp - now
        if ahead_ns > self._limiter.parameters.evidence_latency_s * 1e9:
            why = f"the evidence lies {ahead_ns / 1e6:.0f} ms in the future, so nobody knows how old it is"
            advice = "keep the clocks of cameras and controller together (chrony, PTP)"
            separation = standing(separation.stamp, NO_EVIDENCE, f"stopped: {why}; {advice}")
        self._limiter.decide(separation, now)

    def _on_joints(self, message: Message) -> None:
        """Of the arm alone, as far as its speeds are told: a gripper on the same topic stands while the arm moves.

        Its joints may be told of in several messages.
        """
        if self._share is not None and self._share > 0.0:
            return  # it may move, and joints are told of hundreds of times a second
        told = zip(message.name, message.velocity, strict=False)
        speeds = {name: abs(v) for name, v in told if name in self._joint_names and not math.isnan(v)}
        if self._share is None:
            self._speeds |= speeds
        else:
            self._obedience.hear(speeds, time.monotonic())

    def _tick(self) -> None:
        if self.state is not LifecycleState.ACTIVE or not self._has_begun():
            return
        told = self._limiter.tick(self.clock.now())
        self._reason = told.reason
        self._tell_towards(told.speed_fraction)
        fault, was_told = self._obedience.fault(time.monotonic()), self._disobeys
        self._disobeys = fault is not None
        if fault is not None and not was_told:
            self._say(fault)

    def _has_begun(self) -> bool:
        """Whether it is known by now what share the arm has, which its speed rises or falls from."""
        if self._share is not None:
            return True
        moves = max(self._speeds.values(), default=0.0) > STANDS_RAD_S
        is_known = moves or self._speeds.keys() >= self._joint_names  # one that moves tells enough
        if not is_known and time.monotonic() - self._since < JOINTS_S:
            return False
        kept = None if self._kept is None else self._kept.read()
        self._share = (1.0 if kept is None else kept) if moves else 0.0
        if not moves:
            self._limiter.stand()
        return True

    def _tell_towards(self, wanted: float) -> None:
        """Tells the share wanted, or how far braking has come by now; all that stays all is told now and then."""
        if self._share is None:
            return
        now = time.monotonic()
        elapsed_s = self._period_s if self._ticked is None else min(now - self._ticked, self._longest_look_s)
        self._ticked = now
        slowest = self._share - elapsed_s / self._slide_s if self._slide_s > 0.0 else 0.0
        self._share = max(wanted, slowest, 0.0)
        self._share = 0.0 if self._share < STANDS else self._share
        self._obedience.tell(self._share, now)
        if self._kept is not None:
            self._kept.write(self._share)
        if self._told is not None and self._told[0] == self._share == 1.0 and now - self._told[1] < REPEAT_S:
            return
        self._told = self._share, now
        self.bus.publish(self._topic, message_type("control_msgs/msg/SpeedScalingFactor")(factor=self._share))


class KeptShare:
    """What a controller was told last, for a process that takes the place of one that was killed."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._room: mmap.mmap | None = None

    def read(self) -> float | None:
        """None where nobody has told anything yet."""
        try:
            (share,) = struct.unpack("<d", self._path.read_bytes())
        except (OSError, struct.error):
            return None
        return float(share)

    def write(self, share: float) -> None:
        """Keeps a share; it costs no more than memory does. On a full disk none is kept."""
        if self._room is None:
            with suppress(OSError), self._path.open("wb+") as file:
                file.write(bytes(8))
                file.flush()
                self._room = mmap.mmap(file.fileno(), 8)
        if self._room is not None:
            self._room[:] = struct.pack("<d", share)
