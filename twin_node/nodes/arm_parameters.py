"""Parameters of the arm: which one works in the cell, what it carries, what it may touch, how it keeps its distance."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from twin_node.arm import (
    AllowedRegion,
    ArmError,
    LimiterParameters,
    SeparationParameters,
    StoppingTable,
    ToolCapsule,
    stopping_table,
    with_tool,
)
from twin_node.arm.attachment import FARTHEST_REGION_M
from twin_node.arm.stopping import FASTEST_RAD_S
from twin_node.arm.ur import LOOKAHEAD_S, LOOKAHEADS_S
from twin_node.ranges import Range, check_ranges
from twin_node.robot import ArmModel, arm_model

OF_A_STOP = 10.0
"""A stop's angle is about half its time at the speed before; none is so many times less or more."""
LONGEST_S = 10.0
"""No command is under way, and no program slides to a stop, for so long, s: who gives more means milliseconds."""


@dataclass(frozen=True)
class AllowedBox:
    """A box in which links may touch what stands, for their program was taught clear of furniture (`AllowedRegion`)."""

    lower: tuple[float, float, float]
    """Lower corner, m, in `base_link`."""
    upper: tuple[float, float, float]
    """Upper corner, m, in `base_link`."""
    links: tuple[str, ...] = ()
    """Names of links; none: every link that moves."""

    def __post_init__(self) -> None:
        """Raises `ArmError` for corners that make no box, or one in millimetres."""
        lower, upper = np.array(self.lower), np.array(self.upper)
        if not (np.abs([lower, upper]) <= FARTHEST_REGION_M).all() or not (lower < upper).all():
            raise ArmError(
                f"allowed: expected a lower corner below the upper one in metres, at most {FARTHEST_REGION_M:g} from "
                f"base_link, found {list(self.lower)} and {list(self.upper)}"
            )

    def region(self, arm: ArmModel) -> AllowedRegion:
        """For an arm; raises `ArmError` for a link that it does not have."""
        moving = arm.link_names[1:]
        for link in self.links:
            if link not in moving:
                raise ArmError(f"allowed: expected links of {', '.join(moving)}, found {link!r}")
        return AllowedRegion(np.array(self.lower), np.array(self.upper), self.links or moving)


@dataclass(frozen=True)
class StoppingRow:
    """How the arm stopped from one speed, as it was measured: a row of its `StoppingTable`."""

    speed: float
    """Of each joint by itself, rad/s."""
    times: tuple[float, ...]
    """Until each joint stood, s."""
    angles: tuple[float, ...]
    """That each joint went meanwhile, rad."""

    def __post_init__(self) -> None:
        """Raises `ArmError` for times and angles of different joints, and for such that no stop has, in other units."""
        if len(self.times) != len(self.angles):
            raise ArmError(
                f"stopping: expected a time and an angle per joint, found {len(self.times)} and {len(self.angles)}"
            )
        if self.speed > FASTEST_RAD_S:
            raise ArmError(f"stopping: expected a speed in rad/s, at most {FASTEST_RAD_S:g}, found {self.speed:g}")
        for time_s, angle in zip(self.times, self.angles, strict=True):
            way = self.speed * time_s
            if time_s >= 0 and not way / OF_A_STOP <= angle <= way * OF_A_STOP:
                raise ArmError(
                    f"stopping: expected of a stop from {self.speed:g} rad/s in {time_s:g} s an angle of about "
                    f"{way / 2:.2g} rad, found {angle:g}; give rad/s, s and rad"
                )


@dataclass(frozen=True)
class ArmParameters:
    """Which arm works in the cell, and how it keeps its distance."""

    model: str = "ur10e"
    """One of the arms of `twin_node.robot.UR_NAMES`, or an MJCF or URDF file."""
    kinematics: str | None = None
    """A UR arm's own calibration file from `ur_calibration`; None: the published DH parameters."""
    joints: tuple[str, ...] = ()
    """Names of its joints from base to tool: of a UR arm whose driver puts a prefix before them (`left_`), and of a
    file that has others too (a gripper's); none: a UR arm's own, all of the file's."""
    tool: tuple[ToolCapsule, ...] = ()
    """What it carries for good, a gripper at its widest for example: kept away, and masked, as the arm's links are."""
    allowed: tuple[AllowedBox, ...] = ()
    """Where it may touch what stands, the table it works on for example, and where nothing can stand unseen."""
    stopping: tuple[StoppingRow, ...] = ()
    """How it stops, as measured, in rising order of speed; none: `stopping_table` of its name."""
    driven: bool = False
    """Whether a driver of your own obeys the decisions: until somebody tells where its arm is, none is made up and that
    one stands. Of `ur_driver` the node knows by the launch file and the graph."""
    servoed: bool = False
    """Whether a driver servoes it along trajectories (`ur_driver` with `mode: servo`), and so brakes for it, later and
    farther than it stops by itself. Live, the node also knows by the launch file and the graph."""
    lookahead_s: float | None = None
    """servoJ's of the driver that servoes it; None: that of the same launch's driver, 0.1 of another's. The longer one
    counts."""
    command_latency_ms: float = 20.0
    """From the decision until the arm begins to brake: two periods of RTDE at 125 Hz and its input buffer."""
    slide_s: float = 0.2
    """How long the controller takes from all of its program's speed to none when its slider is set to zero, s, however
    slow the program is just then. As the stand-in takes; UR publishes no figure: measure yours."""
    max_obstacles: int = 1024
    """Room for spheres and for boxes each: 832 boxes are the most of the cover's defaults (`CoverParameters.most`)."""
    separation: SeparationParameters = field(default_factory=SeparationParameters)
    limiter: LimiterParameters = field(default_factory=LimiterParameters)

    def __post_init__(self) -> None:
        """Raises `ArmError` for times that no command takes, and for room for nothing."""
        check_ranges(
            self,
            ArmError,
            "arm: ",
            command_latency_ms=Range(0, LONGEST_S * 1e3),
            slide_s=Range(0, LONGEST_S),
            max_obstacles=Range(1),
        )
        if self.lookahead_s is not None:
            check_ranges(self, ArmError, "arm: ", lookahead_s=LOOKAHEADS_S)

    @property
    def servo_lookahead_s(self) -> float:
        """servoJ's look-ahead that the law counts on where the arm is servoed, s."""
        return LOOKAHEAD_S if self.lookahead_s is None else self.lookahead_s

    def arm(self) -> ArmModel:
        """The arm's model with its tool. Raises `RobotError` or `ResourceError` for a wrong name or file."""
        return with_tool(arm_model(self.model, self.kinematics, self.joints or None), self.tool)

    def table(self, arm: ArmModel) -> StoppingTable:
        """How it stops by itself. Raises `ArmError` for rows that make no table, or one of other joints."""
        if not self.stopping:
            return stopping_table(arm.name, arm.joints)
        for row in self.stopping:
            if len(row.times) != arm.joints:
                raise ArmError(f"stopping: expected times of the {arm.joints} joints of {arm.name}, found {row.times}")
        return StoppingTable(
            np.array([row.speed for row in self.stopping]),
            np.array([row.times for row in self.stopping]),
            np.array([row.angles for row in self.stopping]),
        )

    def regions(self, arm: ArmModel) -> tuple[AllowedRegion, ...]:
        """What it may touch where. Raises `ArmError` for a link that the arm does not have."""
        return tuple(box.region(arm) for box in self.allowed)
