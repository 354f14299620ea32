"""How the UR driver behaves; every default works for an arm at the e-Series' 500 Hz on a quiet network."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from enum import Enum

from twin_node.arm.errors import ArmError
from twin_node.arm.limiter import LimiterParameters
from twin_node.arm.ur.braking import LOOKAHEAD_S, LOOKAHEADS_S
from twin_node.ranges import Range, check_ranges
from twin_node.robot import ArmModel, arm_model


class DriverMode(Enum):
    """How much the driver does."""

    READ_ONLY = "read-only"
    """Reads joints and states, writes nothing."""
    SLIDER = "slider"
    """The robot runs its own program; the driver sets the speed slider and beats the program's watchdog."""
    SERVO = "servo"
    """The driver makes the arm follow trajectories, slowed along their own path."""


def _deadlines() -> LimiterParameters:
    # 70 ms lets one image of 30 Hz go missing; twice that and one period of the driver stay within 150 ms.
    return LimiterParameters(deadline_s=0.07)


@dataclass(frozen=True)
class UrParameters:
    """One arm and the way it is driven."""

    robot: str = "127.0.0.1"
    """Address or host name of the controller."""
    model: str = "ur5e"
    """One of `twin_node.robot.UR_NAMES`; for an arm of the CB3 series its MJCF or URDF file."""
    kinematics: str | None = None
    """The arm's own calibration file from `ur_calibration`; None: the published DH parameters."""
    joints: tuple[str, ...] = ()
    """Names of its joints from base to tool, as `/joint_states` and trajectories are to have them: with a prefix
    (`left_`) where other nodes know them so, or those of a file that has others too; none: its own."""
    mode: DriverMode = DriverMode.SLIDER
    limiter: LimiterParameters = field(default_factory=_deadlines)
    """How the speed follows the decisions, and what it does without them."""
    period_s: float = 0.004
    """Between two looks at arm and decisions: half of `receive_hz`'s period, so that no package waits long."""
    receive_hz: float = 125.0
    """Rate at which the controller sends its state: what every UR controller can."""
    stale_s: float = 0.05
    """Time without an advancing controller clock after which the driver halts: six packages at 125 Hz."""
    lost_s: float = 1.0
    """The same, after which the connection is given up and made anew: `ur_rtde` itself waits 2.5 s."""
    heartbeat_register: int = 20
    """Input integer register (18 to 22, `ur_rtde`'s) that the robot's program watches."""
    watchdog_hz: float = 10.0
    """Servo mode: the control script stops by itself when no command came for one period of this."""
    lookahead_s: float = LOOKAHEAD_S
    """Servo mode: servoJ's, 0.03 to 0.2. The arm brakes as much sooner as it is shorter, and the law counts on that;
    too short a one makes an arm vibrate."""
    realtime_priority: int = 20
    """Of the driver's process (SCHED_FIFO, 1 to 99), where the system grants it; 0: ordinary."""
    reconnects: bool = True
    """Connect again by itself when a link was lost; the arm still waits for somebody to acknowledge."""
    resumes: bool = False
    """Go on by itself when the cause of a halt is over; what the safety system stopped always waits, and so
    does an arm that was not seen for long."""
    plays: bool = False
    """Slider mode: press play on the dashboard when a halt is over that has left the robot's program paused, if it ran
    until then; needs remote control. False: somebody presses it on the pendant."""

    def __post_init__(self) -> None:
        """Raises `ArmError` for values that no controller accepts."""
        if not re.fullmatch(r"[A-Za-z0-9_.:-]+", self.robot) or not _is_name(self.robot):
            raise ArmError(f"robot {self.robot!r}: expected an address or host name such as 192.168.1.10")
        if not 18 <= self.heartbeat_register <= 22:
            raise ArmError(
                f"heartbeat_register: expected 18 to 22, which ur_rtde can write, found {self.heartbeat_register}"
            )
        check_ranges(  # of longer times nothing would be noticed in time: who gives them means milliseconds
            self,
            ArmError,
            "",
            receive_hz=Range(1, 500),
            watchdog_hz=Range(1, 500),
            stale_s=Range(0, 1, above=True),
            lost_s=Range(0, 10, above=True),
            lookahead_s=LOOKAHEADS_S,
            realtime_priority=Range(0, 99),
        )
        if not 0 < self.period_s <= min(0.5 / self.watchdog_hz, self.stale_s / 2):
            raise ArmError(
                f"period_s: expected at most half the watchdog's period, {0.5 / self.watchdog_hz:g} s, and half of "
                f"stale_s, {self.stale_s / 2:g} s, found {self.period_s:g}"
            )
        if not 2 / self.receive_hz < self.stale_s < self.lost_s:
            raise ArmError(
                f"stale_s: expected more than two packages ({2 / self.receive_hz:g} s) and less than lost_s "
                f"({self.lost_s:g} s), found {self.stale_s:g}"
            )

    def arm(self) -> ArmModel:
        """The arm's model, calibrated where there is a file; raises `RobotError` for a wrong name, joint or file."""
        return arm_model(self.model, self.kinematics, self.joints or None)


def _is_name(host: str) -> bool:
    """Whether the parts of a host's name are as long as they may be, and none is empty: no socket looks for another."""
    try:
        host.encode("idna")
    except UnicodeError:
        return False
    return True
