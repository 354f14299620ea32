"""The UR driver node: speed fractions in, the arm's joints and its next 200 ms out."""

from __future__ import annotations

import re
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

from twin_node.arm.errors import ArmError
from twin_node.arm.ur import DriverMode, DriverReport, DriverState, Halt, SupervisedDriver, UrParameters
from twin_node.errors import TwinError
from twin_node.messages import Message, convert, header_stamp
from twin_node.nodes.topics import ACKNOWLEDGE, DIAGNOSTICS, FOLLOW, JOINT_STATES, SEPARATION, TRAJECTORY
from twin_node.robot.arms import ur_name
from twin_node.runtime.bus import Bus
from twin_node.runtime.clock import Clock, ahead_of_monotonic
from twin_node.runtime.node import LifecycleState, Node
from twin_node.runtime.wire import Encoded
from twin_node.scene import NO_EVIDENCE, JointPath, JointSample

DRIVER = "ur_driver"
"""Name of the driver's node and of its section."""
DRIVEN_ARM = f"{DRIVER}: arm"
"""Name of what the driver says of the arm in `/diagnostics`."""
TICK_S = 0.02
"""How often `tick` is to be called, s: the driver reports at 50 Hz."""

_AHEAD_NS = 200_000_000
"""A path that is to begin so much later is of another clock, or for another time, ns: decisions have as much room."""
_MODEL = "model"
_DIAGNOSTICS_NS = 1_000_000_000
"""Diagnostics go out at 1 Hz, as is customary, and at once when something changes; a refusal is told for as long."""

_PATIENCE_NS = 3_000_000_000
"""What still halts so long after an acknowledgement is not over, ns: the driver reports 50 times a second."""
_REFUSALS_KEPT = 16
"""Orders refused that wait to be told, one with each `tick`: of more, the newest."""

_OF_PATHS = ("trajectory:", "JointTrajectory")
"""What refusals of a path begin with while an arm is halted: the driver's, and of what is none."""
_LEVELS = {
    DriverState.CONNECTING: convert.Level.WARN,
    DriverState.READY: convert.Level.OK,
    DriverState.HALTED: convert.Level.ERROR,
    DriverState.LOST: convert.Level.STALE,
}
_BEGINS_NS = 3_000_000_000
"""A controller that is begun with the driver, or anew, is there by then: its absence is told afterwards."""


Told: TypeAlias = Callable[[bool, str], None]
"""Is told whether the arm is halted no longer, and what the driver says of it."""


@dataclass(frozen=True)
class _Asked:
    """Somebody who waits for what becomes of an acknowledgement."""

    tell: Told
    before: str
    """What the driver said of the arm then."""
    until: int
    """By the monotonic clock, ns."""


def driven_model(diagnostics: Message) -> str | None:
    """The `model` of the driver that says these `/diagnostics`; None where they are somebody else's."""
    of_arm = [found for found in convert.diagnostics_from_message(diagnostics) if found.name == DRIVEN_ARM]
    return next((reading.value for found in of_arm for reading in found.readings if reading.key == _MODEL), None)


def is_other_arm(driven: str, judged: str) -> bool:
    """Whether an arm is judged (`model` of the arm's node) that is not the driven one (that of the driver).

    All UR arms name their joints alike: nothing else that comes tells. A file that is judged may be the driven arm with
    a gripper; a file that is driven is no e-Series arm, or it had its name. One of airo-models is the arm that it is
    named for.
    """
    name = ur_name(judged)
    return name is not None and name != ur_name(driven)


def without_numbers(line: str | None) -> str:
    """What is said without its numbers, which go on changing; empty: nothing."""
    return re.sub(r"[\d.]+", "", line or "")


class UrDriverNode(Node):
    """Drives a UR arm, in a process of its own, for as long as it is active.

    Takes `/twin/separation`, in servo mode `/arm/follow`, and `/arm/acknowledge` after a halt. Publishes
    `/joint_states`, `/arm/trajectory` and `/diagnostics`. Deactivating it stops the arm.
    """

    def __init__(
        self,
        bus: Bus,
        clock: Clock,
        parameters: UrParameters,
        say: Callable[[str], None] = lambda line: None,
        offer: Callable[[UrDriverNode], None] = lambda node: None,
    ) -> None:
        """`say(line)` tells the user why the arm stands whatever is decided, and that it no longer does.

        `offer(node)` is called when it is configured: it lets others ask for what is no topic, as `acknowledge`.
        """
        super().__init__(DRIVER, bus, clock)
        self._say = say
        self._offer = offer
        self._asked: list[_Asked] = []
        self._said = ""
        """What was last said, without its numbers, which go on changing."""
        self._lost_since: int | None = None
        self._parameters = parameters
        self._joint_names = parameters.arm().joint_names
        self._driver: SupervisedDriver | None = None
        self._refusals = deque[str](maxlen=_REFUSALS_KEPT)
        """Filled by the driver's thread too: a report that holds one is the newest for 20 ms, and may never be seen."""
        self._refusal: str | None = None
        self._refused = 0
        """When that was last said, by the monotonic clock, ns."""
        self._seen = self._sampled = 0
        self._told: DriverReport | None = None
        self._next = 0

    @property
    def report(self) -> DriverReport | None:
        """What the driver said last, with what was refused of late; None while the node is not active."""
        return None if self._driver is None else replace(self._driver.latest, refusal=self._refusal)

    def on_configure(self) -> None:
        self.bus.subscribe(SEPARATION, self._on_separation)
        self.bus.subscribe(ACKNOWLEDGE, self._on_acknowledge)
        if self._parameters.mode is DriverMode.SERVO:
            self.bus.subscribe_timed(FOLLOW, self._on_follow, time.monotonic_ns)
        self._offer(self)

    def on_activate(self) -> None:
        self._driver = SupervisedDriver(self._parameters, self._on_report)

    def on_deactivate(self) -> None:
        if self._driver is not None:
            self._driver.close()
        self._driver = None
        asked, self._asked = self._asked, []
        for one in asked:
            one.tell(False, f"was {one.before}; the driver has been deactivated since")

    def acknowledge(self, tell: Told) -> None:
        """Somebody has looked at a halted arm: it may go on; `tell` is called at once, or with a `tick`."""
        report = self.report
        if self._driver is None or report is None:
            tell(False, "the driver is not active")
        elif report.state is DriverState.HALTED:
            self._driver.acknowledge()
            self._asked.append(_Asked(tell, _in_words(report), time.monotonic_ns() + _PATIENCE_NS))
        elif report.state is DriverState.READY or (halt := self._driver.halt) is None or not self._waits(halt):
            tell(True, f"no halt waits for somebody; {_in_words(report)}")
        else:
            tell(False, f"{_in_words(report)}; it is halted when it is reached again ({halt.reason}): acknowledge then")

    def tick(self) -> None:
        """Publish what the driver has said since the last call; to be called every `TICK_S`, in the bus's thread."""
        now, passed = self.clock.now(), time.monotonic_ns()
        refusal = self._refusals.popleft() if self._refusals else None
        if refusal is not None:
            self._refusal, self._refused = refusal, passed
        elif passed - self._refused >= _DIAGNOSTICS_NS:
            self._refusal = None
        report = self.report
        if report is None:
            return
        if report.stamp > self._seen:
            self._seen = report.stamp
            self._publish_arm(report, ahead_of_monotonic(self.clock))
        self._tell(report, passed)
        self._answer(report, refusal, passed)
        if _is_news(report, self._told) or passed >= self._next:
            self._told, self._next = report, passed + _DIAGNOSTICS_NS
            self.bus.publish(DIAGNOSTICS, convert.diagnostics_to_message(now, [self._diagnosis(report)]))

    def _tell(self, report: DriverReport, passed: int) -> None:
        """Says why the arm stands whatever is decided, once, at a time of the monotonic clock, ns."""
        if report.state is DriverState.CONNECTING:
            return
        if report.state is not DriverState.LOST:
            self._lost_since = None
        elif self._lost_since is None:
            self._lost_since = passed
        if report.state is DriverState.READY:
            line, words = "ready again", ""
        elif self._lost_since is None or passed - self._lost_since > _BEGINS_NS:
            waits = report.halt is not None and self._waits(report.halt)
            wanted = "; it waits for 'twin_node acknowledge'" if waits else ""
            line = f"{_in_words(report)}{wanted}"
            words = without_numbers(line)
        else:
            return
        if words != self._said:
            self._said = words
            self._say(line)

    def _answer(self, report: DriverReport, refusal: str | None, passed: int) -> None:
        """Tells who has acknowledged a halt what has become of it by now, a time of the monotonic clock, ns.

        `refusal`: of an order of late, if any.
        """
        waiting, self._asked = self._asked, []
        for asked in waiting:
            if report.state is DriverState.READY:
                asked.tell(True, f"acknowledged what had {asked.before}; now {_in_words(report)}")
            elif report.state is DriverState.LOST:
                asked.tell(False, f"was {asked.before}; now {_in_words(report)}; acknowledge when it is reached again")
            elif report.state is DriverState.CONNECTING:  # its script begins, which may take seconds
                self._asked.append(replace(asked, until=passed + _PATIENCE_NS))
            elif (refusal is not None and not refusal.startswith(_OF_PATHS)) or passed >= asked.until:
                asked.tell(False, f"still {_in_words(report)}; {refusal or 'what halts it is not over'}")
            else:
                self._asked.append(asked)

    def _waits(self, halt: Halt) -> bool:
        """Whether a halt lasts until somebody acknowledges it."""
        is_driven = self._parameters.mode is not DriverMode.READ_ONLY
        return is_driven and (halt.is_safety or not self._parameters.resumes)

    def _publish_arm(self, report: DriverReport, offset: int) -> None:
        """Joints and their future; `offset` (ns) leads from the driver's clock to the graph's.

        What was before the graph's time began (that of `/clock`, which nobody has told yet) has no stamp there.
        """
        sample, begins = report.sample, -offset
        if sample is not None and report.sample_stamp > self._sampled and report.sample_stamp >= begins:
            self._sampled = report.sample_stamp
            joints = JointSample(report.sample_stamp + offset, self._joint_names, sample.q, sample.qd)
            self.bus.publish(JOINT_STATES, convert.joint_sample_to_message(joints))
        if report.future is not None and report.stamp >= begins:
            future = replace(report.future, stamps=report.future.stamps + offset)
            self.bus.publish(TRAJECTORY, convert.joint_path_to_message(future))

    def _diagnosis(self, report: DriverReport) -> convert.Diagnosis:
        fraction = "none" if report.speed_fraction is None else f"{report.speed_fraction:.3f}"
        readings = [convert.Reading("state", report.state.value), convert.Reading("speed_fraction", fraction)]
        readings.append(convert.Reading(_MODEL, self._parameters.model))
        if report.refusal is not None:
            readings.append(convert.Reading("refused", report.refusal))
        level, robot = _LEVELS[report.state], self._parameters.robot
        return convert.Diagnosis(DRIVEN_ARM, level, report.reason, tuple(readings), robot)

    def _on_report(self, report: DriverReport) -> None:
        if report.refusal is not None:
            self._refusals.append(report.refusal)

    def _on_separation(self, message: Message) -> None:
        if self._driver is None or self.state is not LifecycleState.ACTIVE:
            return
        separation = convert.separation_from_message(message)
        offset = -ahead_of_monotonic(self.clock)
        evidence = separation.evidence_stamp
        moved = NO_EVIDENCE if evidence == NO_EVIDENCE else evidence + offset
        self._driver.decide(replace(separation, stamp=separation.stamp + offset, evidence_stamp=moved))

    def _on_follow(self, sent: Encoded, came: int) -> None:
        """`came`: by the monotonic clock, ns; a console that takes no line may have held the node up since."""
        if self._driver is None:
            return
        message = sent.decode()
        if not message.points:  # so ROS's trajectory controllers are told to stay where they are
            self._driver.leave_path()
            return
        now = self.clock.now()
        try:
            path = convert.joint_path_from_message(message, now)
            _check_time(header_stamp(message), path, now)
            if not self._driver.follow(path, came):
                raise ArmError("trajectory: refused, no connection to the controller; send it again once there is one")
        except TwinError as error:
            self._refusals.append(str(error))
            raise

    def _on_acknowledge(self, _: Any) -> None:
        if self._driver is not None:
            self._driver.acknowledge()


def _in_words(report: DriverReport) -> str:
    return f"{report.state.value}: {report.reason}"


def _is_news(report: DriverReport, told: DriverReport | None) -> bool:
    """Whether a report is to be told at once after another; None: after none."""
    if told is None or told.state is not report.state:
        return True
    return without_numbers(told.refusal) != without_numbers(report.refusal)


def _check_time(stamp: int, path: JointPath, now: int) -> None:
    """Whether a path that is stamped so, ns, is for now; 0 says that it is. Raises `ArmError` where it is not.

    One that is over is refused as by ROS's trajectory controllers: it was recorded, or held up on its way.
    """
    if not stamp:
        return
    over_s, ahead_s = (now - int(path.stamps[-1])) * 1e-9, (stamp - now) * 1e-9
    if over_s <= 0 and ahead_s <= _AHEAD_NS * 1e-9:
        return
    found = f"was over {over_s:.2f} s ago" if over_s > 0 else f"is to begin in {ahead_s:.2f} s"
    raise ArmError(
        f"trajectory: expected one to follow now, found one that by its stamp {found}; stamp it 0 to have it followed "
        "when it comes, and let chrony or PTP keep the clocks together"
    )
