"""What a log says at a series of times, cut to what other programs can show: obstacles in force, arm, Gaussians."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol

from twin_node.errors import TwinError
from twin_node.nodes.playback import Playback
from twin_node.nodes.snapshot import Snapshot, in_force
from twin_node.robot import ArmModel
from twin_node.scene import Float32, Float64, GaussianCloud, ObstacleKind, Obstacles


class ExportError(TwinError):
    """A log cannot be exported as asked."""


@dataclass(frozen=True)
class Moment:
    """One time of a log."""

    stamp: int
    """Log time, ns."""
    seconds: float
    """Since the first moment of the export."""
    obstacles: Obstacles
    """Those in force at `stamp`: of a forecast, the interval that holds it."""
    q: Float64 | None
    """[J] the arm's joints, rad; None where the log does not say, or they are not wanted."""
    cloud: GaussianCloud | None
    """All Gaussians; None where the log has none, or none are wanted."""
    harmonics: Float32 | None = None
    """[N, K, 3] of the cloud's colours, where they differ from side to side."""


def opacity(kind: ObstacleKind) -> float:
    """How an obstacle of a kind is shown: what moves hides more of what is behind it."""
    return 0.6 if kind == ObstacleKind.MOVING else 0.3


class Source(Protocol):
    """What can be exported: a span of time, and what is there at any time of it."""

    @property
    def start_ns(self) -> int:
        """Its first time, ns."""

    @property
    def end_ns(self) -> int:
        """Its last time, ns."""

    def require(self, topic: str, purpose: str) -> None:
        """Raises `TwinError` where it lacks a topic that is needed for `purpose`."""

    def moments(self, stamps: Sequence[int], arm: ArmModel | None, with_clouds: bool) -> Iterator[Moment]:
        """The moments at rising `stamps` (ns), with the joints of `arm` where it has them (None: none are wanted)."""


@dataclass(frozen=True)
class Moments:
    """The moments of an export, read one after another: never more than one is held. Each pass reads them anew."""

    source: Source
    stamps: Sequence[int]
    """Rising, ns."""
    arm: ArmModel
    """Whose joints the source has."""
    rate_hz: float
    with_clouds: bool
    with_arm: bool
    on_read: Callable[[int], None]
    """Told how many have been read."""

    def __len__(self) -> int:
        return len(self.stamps)

    def __iter__(self) -> Iterator[Moment]:
        arm = self.arm if self.with_arm else None
        for count, moment in enumerate(self.source.moments(self.stamps, arm, self.with_clouds), 1):
            yield moment
            self.on_read(count)


class LogSource:
    """The logs of a run."""

    def __init__(self, playback: Playback) -> None:
        self._playback = playback
        self.start_ns, self.end_ns = playback.start_ns, playback.end_ns

    def require(self, topic: str, purpose: str) -> None:
        """Raises `GraphError` where no log has a topic."""
        self._playback.require(topic, purpose)

    def moments(self, stamps: Sequence[int], arm: ArmModel | None, with_clouds: bool) -> Iterator[Moment]:
        """The moments at rising `stamps` (ns). Raises `RobotError` where the log's joints are not those of `arm`."""
        for stamp in stamps:
            said = self._playback.at(stamp)
            q = None if arm is None else _angles(said, arm)
            cloud = said.cloud_now if with_clouds else None
            yield Moment(stamp, (stamp - stamps[0]) / 1e9, in_force(said.obstacles, stamp), q, cloud)


def _angles(said: Snapshot, arm: ArmModel) -> Float64 | None:
    """[J] the arm's joints, rad; None before the first were said."""
    joints = said.joints_at(arm.joint_names, said.stamp)
    return None if joints is None else arm.ordered_positions(joints)
