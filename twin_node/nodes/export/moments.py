"""What a log says at a series of times, cut to what other programs can show: obstacles in force, arm, Gaussians."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from twin_node.errors import TwinError
from twin_node.nodes.playback import Playback
from twin_node.robot import ArmModel
from twin_node.scene import Float32, Float64, GaussianCloud, Obstacles


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
    """[J] the arm's joints, rad; None where the log does not say."""
    cloud: GaussianCloud | None
    """All Gaussians; None where the log has none, or none are wanted."""
    harmonics: Float32 | None = None
    """[N, K, 3] of the cloud's colours, where they differ from side to side."""


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

    def moments(self, stamps: Sequence[int], arm: ArmModel, with_clouds: bool) -> Iterator[Moment]:
        """The moments at rising `stamps` (ns)."""


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
    on_read: Callable[[int], None]
    """Told how many have been read."""

    def __len__(self) -> int:
        return len(self.stamps)

    def __iter__(self) -> Iterator[Moment]:
        for count, moment in enumerate(self.source.moments(self.stamps, self.arm, self.with_clouds), 1):
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

    def moments(self, stamps: Sequence[int], arm: ArmModel, with_clouds: bool) -> Iterator[Moment]:
        """The moments at rising `stamps` (ns). Raises `RobotError` where the log's joints are not those of `arm`."""
        for stamp in stamps:
            said = self._playback.at(stamp)
            q = None if said.joints is None else arm.ordered_positions(said.joints)
            cloud = said.cloud if with_clouds else None
            yield Moment(stamp, (stamp - stamps[0]) / 1e9, in_force(said.obstacles, stamp), q, cloud)


def in_force(obstacles: Obstacles | None, stamp: int) -> Obstacles:
    """The obstacles whose validity holds `stamp` (ns), or the first of it where all begin later; none of none.

    A forecast begins when it can be acted on: in lockstep that is the assumed latency after its log time.
    """
    if obstacles is None or not len(obstacles.ids):
        return _NO_OBSTACLES
    at = max(stamp, int(obstacles.valid_from.min()))
    chosen = (obstacles.valid_from <= at) & (at <= obstacles.valid_to)
    columns: dict[str, Any] = {
        name: None if values is None else values[chosen] for name, values in vars(obstacles).items() if name != "stamp"
    }
    return Obstacles(stamp=obstacles.stamp, **columns)


_NO_OBSTACLES = Obstacles(
    0,
    np.empty(0, np.uint32),
    np.empty(0, np.uint8),
    np.empty(0, np.uint8),
    np.empty((0, 3)),
    np.empty((0, 4)),
    np.empty((0, 3)),
    np.empty((0, 3)),
    np.empty(0),
    np.empty(0, np.int64),
    np.empty(0, np.int64),
)
