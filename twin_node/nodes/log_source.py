"""A log as a source of frame sets: the player and the synchroniser in lockstep, without the rest of the graph."""

from __future__ import annotations

import warnings
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from twin_node.bag import LogReader, open_log
from twin_node.errors import TwinWarning
from twin_node.nodes.calibration import check_depth, damage_first, rig_for
from twin_node.nodes.log_cameras import cameras_of
from twin_node.nodes.log_clocks import LogClocks
from twin_node.nodes.log_doubts import base_doubts, depth_doubts, joint_doubts, joints_told, rig_doubts
from twin_node.nodes.player import Player, Span, span_of
from twin_node.nodes.renaming import check_types, renamed
from twin_node.nodes.set_contents import SetContents
from twin_node.nodes.synchronizer import SynchronizerNode, SynchronizerParameters
from twin_node.nodes.topics import FRAMES, JOINT_STATES, TF_STATIC, TRAJECTORY, CameraTopics
from twin_node.rig import FrameAssembler, workspace_of
from twin_node.robot import ArmModel, arm_model
from twin_node.runtime.bus import Bus, LocalBus
from twin_node.runtime.clock import Clock, SteppedClock
from twin_node.scene import Camera, Float64, FrameSet, Rig

DEFAULT_WIDTH = 160
"""Working width in pixels at which the twin keeps camera rate on two CPU cores."""


class LogSession:
    """An open log with what the graph needs to know of it: cameras, rig, span, and topics under their new names."""

    def __init__(
        self,
        path: Path,
        rig_file: Path | Rig | None = None,
        remaps: Mapping[str, str] | None = None,
        start_offset_s: float = 0.0,
        duration_s: float | None = None,
    ) -> None:
        """Raises `BagError`, `RigError` or `GraphError` for whatever is wrong with log, calibration or new names."""
        self._opened = (path, rig_file, remaps, start_offset_s, duration_s)
        self.log: LogReader = open_log(path)
        try:
            self._names = names = renamed(self.log, remaps)
            check_types(self.log, names)
            with damage_first(self.log):
                cameras = cameras_of(self.log, names)
                in_log = [names.original_camera(camera) for camera in cameras.found]
                found = rig_for(self.log, in_log, rig_file, names.original(TF_STATIC))
                looked_through = [camera for camera in in_log if found.has(camera.name)]
                check_depth(self.log, looked_through, names.original(TF_STATIC))
            self.rig: Rig = found.rig
            self.cameras: tuple[CameraTopics, ...] = tuple(c for c in cameras.found if found.has(c.name))
            """Those of the rig."""
            self.span: Span = span_of(self.log, start_offset_s, duration_s)
            self.clocks = LogClocks(self.log, looked_through, self.rig, self.span)
            of_joints = (*joint_doubts(names), *self.clocks.joint_doubts(names.original(JOINT_STATES)))
            of_base = base_doubts(self.log, names) if rig_file is None else ()
            of_places = rig_doubts(looked_through, self.rig)
            self.camera_doubts = (*cameras.unused, *found.left_out, *of_places, *self.clocks.camera_doubts())
            """What of the cameras may not be meant as it is taken, a line each."""
            of_depth = depth_doubts(self.log, looked_through)
            unread = (f"not read: {line}" for line in self.log.left_out)
            self.set_doubts = (*unread, *self.camera_doubts, *of_depth, *of_joints, *of_base)
            """The same of all that sets are made of."""
            self.doubts: tuple[str, ...] = (*self.set_doubts, *self.clocks.image_doubts())
            """The same for an arm that is to go by it."""
        except BaseException:
            self.log.close()
            raise
        played = {JOINT_STATES, TRAJECTORY}
        for camera in self.cameras:
            played |= {camera.image} | ({camera.depth} if camera.depth else set())
        self.topics = {names.original(name): name for name in sorted(played) if name in names.types}
        """The log's topics to play -> the names they are published under."""

    @property
    def cameras_in_sets(self) -> tuple[str, ...]:
        """Names of the cameras by the cell's clock, whose images sets can hold."""
        return tuple(camera.name for camera in self.rig.cameras if camera.name not in self.clocks.strangers)

    def __reduce__(self) -> tuple[Any, ...]:
        """In another process: opened there."""
        return LogSession, self._opened

    def arm(self, name: str) -> ArmModel:
        """The arm of a name or file, its joints as the log calls them.

        Raises `RobotError` for an arm that is not known, and where the log tells of no such arm or of several.
        """
        return arm_model(name).called_as(joints_told(self.log, self._names))

    def warn(self, doubts: Sequence[str]) -> None:
        """Warns of some of its doubts, with a `TwinWarning` each; of each once in a command."""
        for line in doubts:
            warnings.warn(f"{self.log.path}: {line}", TwinWarning, stacklevel=1)

    def synchronizer(
        self,
        bus: Bus,
        clock: Clock,
        parameters: SynchronizerParameters,
        joint_names: Collection[str],
        takes_all: bool = False,
    ) -> SynchronizerNode:
        """What groups the log's images; `joint_names`: the arm's, see `SynchronizerNode`.

        `takes_all`: those by another clock too, taken to be as old as the others' that were recorded with them.
        """
        rig, apart = (self.clocks.by_one_clock(self.rig), {}) if takes_all else (self.rig, self.clocks.apart)
        return SynchronizerNode(bus, clock, self.cameras, rig, parameters, joint_names=joint_names, clocks_apart=apart)

    def player(self, bus: Bus) -> Player:
        """What plays the span onto a bus, its topics under the names that they are published under."""
        return Player(self.log, bus, self.topics, self.span)

    def expected_hz(self, most_hz: float | None) -> float:
        """Sets per second to expect: the fastest camera's images, unless fewer are taken."""
        counts = {topic.name: topic.count for topic in self.log.topics}
        cameras = {camera.image for camera in self.cameras}
        images = max(counts.get(source, 0) for source, name in self.topics.items() if name in cameras)
        rate = images / max((self.log.end_ns - self.log.start_ns) / 1e9, 1e-3)
        return rate if most_hz is None else min(rate, most_hz)

    def __enter__(self) -> LogSession:
        return self

    def __exit__(self, *_: object) -> None:
        self.log.close()


class LogSource:
    """Frame sets of a log in lockstep; a `scene.FrameSource`."""

    def __init__(
        self,
        session: LogSession,
        parameters: SynchronizerParameters,
        joint_names: Collection[str] = (),
        takes_all: bool = False,
    ) -> None:
        """`joint_names`, `takes_all`: see `LogSession.synchronizer`."""
        self._session = session
        self._grouping = (parameters, joint_names, takes_all)
        self._cameras = FrameAssembler(session.rig.cameras, parameters.width).cameras

    @property
    def cameras(self) -> tuple[Camera, ...]:
        """All cameras of the log, in the order of every set's views."""
        return self._cameras

    @property
    def workspace(self) -> Float64:
        """[2, 3] corners of the volume to model, m: the rig's, else derived from what the cameras see together."""
        return workspace_for(self._session.rig, self._cameras)

    def __iter__(self) -> Iterator[FrameSet]:
        """Sets in rising order of stamps, from the beginning of the session's span.

        Warns, with a `TwinWarning`, of what the session doubts, where damage or anything else has ended them before
        the log's end, of damaged images, and of a camera that most of them lack, or its depth: what is made of them is
        made of a part.
        """
        self._session.warn(self._session.set_doubts)
        held = SetContents()
        bus, clock = LocalBus(), SteppedClock()
        synchronizer = self._session.synchronizer(bus, clock, *self._grouping)
        synchronizer.configure()
        ready: list[FrameSet] = []
        bus.subscribe(FRAMES, ready.append)
        for _ in self._session.player(bus).steps(clock):
            for frames in ready:
                held.add(frames, clock.now())
                yield frames
            ready.clear()
        ended = self._session.log.damage or held.ended_before(self._session.span.stop_ns)
        if ended is not None:
            warnings.warn(ended, TwinWarning, stacklevel=2)
        damaged = synchronizer.damaged
        lacking = held.lacking(self._session.cameras_in_sets, self._session.cameras, damaged=damaged.counts)
        for line in (*damaged.lines, *lacking):
            warnings.warn(line, TwinWarning, stacklevel=2)


def workspace_for(rig: Rig, cameras: Sequence[Camera]) -> Float64:
    """[2, 3] corners of the volume to model, m: the rig's own, else derived from what the cameras see together."""
    return workspace_of(cameras) if rig.workspace is None else rig.workspace
