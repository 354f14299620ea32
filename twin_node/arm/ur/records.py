"""What the driver and its supervisor tell each other."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from twin_node.arm.ur.sample import UrSample
from twin_node.scene import JointPath, Separation


class DriverState(Enum):
    """Where the driver is."""

    CONNECTING = "connecting"
    READY = "ready"
    """Connected and well: the arm goes as fast as the decisions let it."""
    HALTED = "halted"
    """Something was wrong: the arm was told to stop and is kept so until somebody acknowledges."""
    LOST = "lost"
    """No connection, or no driver process."""


@dataclass(frozen=True)
class Halt:
    """Why the arm is kept standing."""

    reason: str
    is_safety: bool = False
    """Whether the controller's safety system had stopped the arm: only somebody who has looked may go on."""
    interrupts: bool = False
    """Whether the robot's program ran until then: it is the halt that pauses it, and nobody who wanted it to stand."""
    seen: int | None = None
    """When the arm was last seen, CLOCK_MONOTONIC, ns, where a connection was lost since; None: it is seen."""


@dataclass(frozen=True)
class DriverReport:
    """What the driver has to say, several times per received package. Times are CLOCK_MONOTONIC, ns."""

    stamp: int
    """When it was said."""
    state: DriverState
    reason: str
    """Why the arm goes as fast as it does, or stands."""
    speed_fraction: float | None = 0.0
    """What the arm is told, 0 to 1; None where it is told nothing."""
    sample: UrSample | None = None
    """The controller's state last received, checked; None before the first, and when it is not to be trusted."""
    sample_stamp: int = 0
    """When it came."""
    future: JointPath | None = None
    """The arm's next 200 ms from `stamp` on at its full programmed speed; None without a sample."""
    halt: Halt | None = None
    """What keeps the arm standing; None: it is not halted."""
    refusal: str | None = None
    """Why the last order was not carried out; None: it was, or there was none."""
    is_over: bool = False
    """Whether the process ends with this report: its connection is lost."""


@dataclass(frozen=True)
class Begin:
    """The first order of a process: connect."""

    halt: Halt | None
    """Why an earlier process left the arm halted; None: it did not."""


@dataclass(frozen=True)
class Decide:
    """A new decision; its evidence stamp is CLOCK_MONOTONIC, ns."""

    separation: Separation


@dataclass(frozen=True)
class Follow:
    """Servo mode: follow a path from its beginning, now."""

    path: JointPath
    came: int
    """When it came, CLOCK_MONOTONIC, ns: it may have waited for a driver that hung."""


@dataclass(frozen=True)
class LeavePath:
    """Servo mode: brake on the path that is followed, and stay where that ends."""


@dataclass(frozen=True)
class Acknowledge:
    """Somebody has looked: go on, if what was wrong is over."""


Order = Decide | Follow | LeavePath | Acknowledge
