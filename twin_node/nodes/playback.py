"""Logs of one run, read as one."""

from __future__ import annotations

import contextlib
import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from twin_node.bag import LogMessage, LogReader, open_log
from twin_node.bag.latched import newest_before
from twin_node.messages import MessageError, header_stamp
from twin_node.nodes.calibration import damage_first, rig_for
from twin_node.nodes.log_cameras import cameras_of
from twin_node.nodes.log_clocks import OTHER_CLOCK_NS
from twin_node.nodes.renaming import Renamed, check_types, of_log, renamed
from twin_node.nodes.snapshot import Snapshot, newest_joints
from twin_node.nodes.topics import (
    DEPTH_BY_NAME,
    JOINT_STATES,
    OBSTACLES,
    RECORDED,
    TF_STATIC,
    CameraTopics,
    GraphError,
    has_colour,
    has_images,
)
from twin_node.rig import FrameAssembler
from twin_node.scene import Camera

LONGEST_STEP_NS = 2_000_000_000
"""A step forward in time that is no longer is read through; after a longer one each topic's newest is looked for."""
JOINTS_REACHES_NS = (100_000_000, 2_000_000_000, 60_000_000_000)
"""How far back an arm's joints are looked for where others have come since: one that works tells at 10 Hz or more."""
CLOCK_TOLD_BY = 5
"""Messages that tell whether a log was recorded by the clock of their stamps: the first may be late."""


@dataclass(frozen=True)
class _LastJoints:
    """The newest joints of some names up to a time."""

    said: LogMessage
    until: int
    """ns."""


class Playback:
    """The logs of one run (what the twin said, what it saw), open together."""

    def __init__(
        self,
        paths: Sequence[Path],
        width: int | None = None,
        rig_file: Path | None = None,
        with_images: bool = True,
        remaps: Mapping[str, str] | None = None,
    ) -> None:
        """`width`: of the images, px; without images their calibration is not asked for.

        `remaps`: names of topics in the logs -> those that they are known by here, all absolute. Raises `BagError`,
        `RigError` or `GraphError` for what is wrong with a log or a new name.
        """
        self._logs: list[LogReader] = []
        self._unseen: tuple[str, ...] = ()
        """Cameras that are not shown, and why, a line each."""
        try:
            for path in paths:
                self._logs.append(open_log(path))
            self._names = self._renamed(remaps or {})
            self._topics = _holders(self._logs, self._names)
            self._cameras, self._assembler = self._find_cameras(width, rig_file) if with_images else ({}, None)
            self.start_ns, self.end_ns = self._span()
        except BaseException:
            self.close()
            raise
        self._last_stamp: int | None = None
        self._said: dict[str, LogMessage] = {}
        self._begun: dict[frozenset[str], int | None] = {}
        self._joints: dict[frozenset[str], _LastJoints] = {}

    @property
    def name(self) -> str:
        """The logs' paths, for messages to the user."""
        return " and ".join(str(log.path) for log in self._logs)

    @property
    def damage(self) -> tuple[str, ...]:
        """What of the logs cannot be read, a line each."""
        return tuple(log.damage for log in self._logs if log.damage)

    @property
    def left_out(self) -> tuple[str, ...]:
        """What of the logs is not read, a line each; see `LogReader.left_out`, and which cameras are not shown.

        Depth alone shows none.
        """
        lines = [f"{log.path}: not read: {line}" for log in self._logs for line in log.left_out]
        for log, names in zip(self._logs, self._names, strict=True):
            if has_images(names.spoken) and not has_colour(names.spoken):
                lines.append(f"{log.path}: depth without colour images: no camera is shown; {DEPTH_BY_NAME}")
        return (*lines, *self._unseen)

    @property
    def apart(self) -> tuple[str, ...]:
        """Logs that say nothing of the time that is shown, a line each: those of another run, most likely."""
        return tuple(
            f"{log.path}: it ends before the twin's log begins, or begins after its end; is it of another run?"
            for log in self._logs
            if log.end_ns < self.start_ns or log.start_ns > self.end_ns
        )

    @property
    def doubts(self) -> tuple[str, ...]:
        """A line where obstacles were recorded by another clock than that of their stamps: none of them counts then."""
        late_ns: list[int] = []
        with contextlib.suppress(MessageError):  # of damaged ones who shows them tells
            said = itertools.islice(self._messages(OBSTACLES), CLOCK_TOLD_BY)
            late_ns += [entry.stamp - header_stamp(entry.message) for entry in said]
        apart_ns = min(late_ns, key=abs, default=0)
        if abs(apart_ns) <= OTHER_CLOCK_NS:
            return ()
        when = "before" if apart_ns > 0 else "after"
        return (
            f"{self.name}: {OBSTACLES} is stamped {abs(apart_ns) / 1e9:.1f} s {when} it was recorded, by another "
            "clock: which obstacles and forecasts count at a time of the log is not known: they are missing or wrong; "
            "record by the clock of the stamps (a simulator's or a log's: ros2 bag record --use-sim-time)",
        )

    @property
    def cameras(self) -> tuple[Camera, ...]:
        """The pinhole cameras of the images; none where no log has images, or none are wanted."""
        return () if self._assembler is None else self._assembler.cameras

    @property
    def has_twin(self) -> bool:
        """Whether a log holds what a twin publishes."""
        return any(topic in self._topics for topic in RECORDED)

    def at(self, stamp: int) -> Snapshot:
        """What had been said by log time `stamp` (ns). Rising stamps cost only what lies between them."""
        last = self._last_stamp
        if last is not None and last <= stamp <= last + LONGEST_STEP_NS:
            self._said = {**self._said, **self._newest(last + 1, stamp + 1)}
        else:
            self._said = self._look_back(stamp)
        self._last_stamp = stamp
        earlier = partial(self._before, stamp)
        return Snapshot(stamp, self._said, self._cameras, self._assembler, earlier, partial(self._joints_with, stamp))

    def require(self, topic: str, purpose: str) -> None:
        """Raises `GraphError` where no log has a topic that is needed for `purpose`."""
        if topic not in self._topics:
            raise GraphError(
                f"{self.name}: expected {topic}, which {purpose} needs, found {', '.join(sorted(self._topics))}; "
                "give a log that 'twin_node replay LOG -o FILE' has written"
            )

    def close(self) -> None:
        """Releases the files."""
        for log in self._logs:
            log.close()

    def __enter__(self) -> Playback:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _before(self, stamp: int, topic: str, ns: int) -> Sequence[LogMessage]:
        return tuple(self._messages(topic, stamp - ns, stamp + 1))

    def _joints_with(self, stamp: int, names: frozenset[str]) -> LogMessage | None:
        """The newest joints up to `stamp` with all of some names; what was once looked through for them is not again.

        None before the first. Raises `LookupError` where none ever come.
        """
        first, last = self._joints_begin(names), self._joints.get(names)
        if first is None:
            raise LookupError
        if first > stamp:
            return None
        said = last.said if last is not None and last.said.stamp <= stamp else None
        if last is not None and said is not None:
            if stamp <= last.until:
                return said
            first = last.until + 1
        for reach in (*JOINTS_REACHES_NS, stamp - first):
            begin = max(stamp - reach, first)
            found = newest_joints(tuple(self._messages(JOINT_STATES, begin, stamp + 1)), names)
            if found is not None or begin == first:
                said = found or said
                break
        if said is None:
            raise LookupError
        self._joints[names] = _LastJoints(said, stamp)
        return said

    def _joints_begin(self, names: frozenset[str]) -> int | None:
        if names not in self._begun:
            told = self._messages(JOINT_STATES)
            stamps = (entry.stamp for entry in told if names.issubset(entry.message.name))
            self._begun[names] = next(stamps, None)
        return self._begun[names]

    def _messages(self, topic: str, start_ns: int | None = None, stop_ns: int | None = None) -> Iterator[LogMessage]:
        if topic in self._topics:
            place = self._topics[topic]
            original = self._names[place].original(topic)
            yield from self._logs[place].messages([original], start_ns, stop_ns)

    def _renamed(self, remaps: Mapping[str, str]) -> tuple[Renamed, ...]:
        """Each log's topics by their new names.

        Raises `GraphError` for a remap of what no log has, and for a name of ours that is that of something else.
        """
        of_logs = [of_log(remaps, log) for log in self._logs]
        for source in remaps:
            if not any(source in known for known in of_logs):
                raise GraphError(f"--remap {source}:={remaps[source]}: {self.name}: no topic {source}")
        found = tuple(renamed(log, known) for log, known in zip(self._logs, of_logs, strict=True))
        for log, names in zip(self._logs, found, strict=True):
            check_types(log, names)
        return found

    def _span(self) -> tuple[int, int]:
        """The time in which there is something of the twin to see; of the images where there is no twin."""
        known = zip(self._logs, self._names, strict=True)
        twin = [log for log, names in known if any(topic in RECORDED for topic in names.types)] or self._logs
        return max(log.start_ns for log in twin), max(log.end_ns for log in twin)

    def _find_cameras(
        self, width: int | None, rig_file: Path | None
    ) -> tuple[Mapping[str, CameraTopics], FrameAssembler | None]:
        for log, names in zip(self._logs, self._names, strict=True):
            if has_colour(names.spoken):
                with damage_first(log):
                    cameras = cameras_of(log, names)
                    in_log = tuple(names.original_camera(camera) for camera in cameras.found)
                    found = rig_for(log, in_log, rig_file, names.original(TF_STATIC))
                self._unseen = tuple(f"{log.path}: {line}" for line in (*cameras.unused, *found.left_out))
                known = {camera.name: camera for camera in cameras.found if found.has(camera.name)}
                return known, FrameAssembler(found.rig.cameras, width)
        if rig_file is not None:
            raise GraphError(
                f"{rig_file}: expected images to calibrate, found none in {self.name}; give the log that the twin's "
                "was made from too, or no rig file"
            )
        return {}, None

    def _look_back(self, stamp: int) -> dict[str, LogMessage]:
        """The newest message of every topic up to `stamp`, looking back further where some are still missing."""
        found: dict[str, LogMessage] = {}
        for log, own in self._owned():
            found.update((own[topic], entry) for topic, entry in newest_before(log, own, stamp + 1).items())
        return found

    def _newest(self, start: int, stop: int) -> dict[str, LogMessage]:
        newest: dict[str, LogMessage] = {}
        for log, own in self._owned():
            newest.update((own[entry.topic], entry) for entry in log.messages(list(own), start, stop))
        return newest

    def _owned(self) -> Iterator[tuple[LogReader, Mapping[str, str]]]:
        """Each log with the topics that are read from it, see `_holders`: what it calls them -> their names here."""
        for place, (log, names) in enumerate(zip(self._logs, self._names, strict=True)):
            own = {names.original(topic): topic for topic, holder in self._topics.items() if holder == place}
            if own:
                yield log, own


def _holders(logs: Sequence[LogReader], names: Sequence[Renamed]) -> Mapping[str, int]:
    """Topic -> which log it is read from: the last that has messages of it, or that names it where none has any."""
    counts = [{topic.name: topic.count for topic in log.topics} for log in logs]
    told = [(topic, place) for place, known in enumerate(names) for topic in known.types]
    return dict(sorted(told, key=lambda of: counts[of[1]][names[of[1]].original(of[0])] > 0))
