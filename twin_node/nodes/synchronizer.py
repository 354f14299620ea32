"""The synchroniser node: images of several cameras in, `FrameSet`s out."""

from __future__ import annotations

import contextlib
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial

from twin_node.errors import TwinError
from twin_node.messages import DamagedError, Message, MessageError, convert, from_time
from twin_node.native_library import thread_count
from twin_node.nodes.camera_watch import CameraWatch
from twin_node.nodes.damaged_images import DamagedImages
from twin_node.nodes.depth_pairs import DepthPairs, EncodedView
from twin_node.nodes.early import EarlyViews
from twin_node.nodes.set_ahead import ClocksSetAhead
from twin_node.nodes.topics import FRAMES, JOINT_STATES, CameraTopics, GraphError
from twin_node.ranges import WIDTHS_PX
from twin_node.rig import ApproximateTimeSynchronizer, DecodedImage, FrameAssembler, SyncParameters, SyncSet
from twin_node.rig.approximate_time import Stamped
from twin_node.runtime.bus import Bus
from twin_node.runtime.clock import Clock, SteppedClock
from twin_node.runtime.executor import SHORTEST_WAIT_S, NoTimers, Timers
from twin_node.runtime.node import Node
from twin_node.scene import Camera, Rig, RigCamera, View
from twin_node.side_thread import SideThread, Task

MOST_TOLERANCE_MS = 10_000.0
"""Depth images are not kept for so long."""
MODEL_THREADS = 2
"""Threads that looking and following keep busy: with no more processors than that, one that decodes would only slow
these down."""
LEAST_RATE_HZ = 1e-6
"""A set in eleven days: between rarer ones no stamp could lie."""


@dataclass(frozen=True)
class SynchronizerParameters:
    """How images are grouped and prepared."""

    width: int | None = None
    """Working width of the images in pixels; None, and of narrower ones: the cameras' own."""
    max_rate_hz: float | None = None
    """Sets above this rate are skipped (not counted as dropped); None takes all."""
    depth_tolerance_ms: float = 10.0
    """A depth image belongs to the colour image whose stamp is at most so far away: under half a period at 45 Hz."""
    grouping: SyncParameters = field(default_factory=SyncParameters)

    def __post_init__(self) -> None:
        """Raises `GraphError` for a width, a rate or a time that is none, `RigError` for a grouping that is none."""
        if self.width is not None and not WIDTHS_PX.holds(self.width):
            raise GraphError(
                f"synchronizer: width: expected {WIDTHS_PX} pixels, found {self.width}; leave it out to take the "
                "cameras' own"
            )
        if self.max_rate_hz is not None and not self.max_rate_hz >= LEAST_RATE_HZ:
            raise GraphError(
                f"synchronizer: max_rate_hz: expected {LEAST_RATE_HZ:g} Hz or more, found {self.max_rate_hz:g}; leave "
                "it out to take all sets"
            )
        if not 0 <= self.depth_tolerance_ms <= MOST_TOLERANCE_MS:
            raise GraphError(
                f"synchronizer: depth_tolerance_ms: expected 0 to {MOST_TOLERANCE_MS:g} ms, found "
                f"{self.depth_tolerance_ms:g}"
            )
        self.grouping.check("synchronizer: grouping.")


class SynchronizerNode(Node):
    """Groups the cameras' images by stamp; decodes, undistorts and publishes the sets that are wanted.

    Of a log it raises `GraphError` for images whose stamps run backwards, `MessageError` for those of another format,
    `RigError` for those of another size than the calibrated; one that is damaged its set goes without, and `damaged`
    tells. Live, a camera whose image is no good is left out of its set, and `/diagnostics` says why.
    """

    def __init__(
        self,
        bus: Bus,
        clock: Clock,
        cameras: tuple[CameraTopics, ...],
        rig: Rig,
        parameters: SynchronizerParameters,
        timers: Timers | None = None,
        joint_names: Collection[str] = (),
        clocks_apart: Mapping[str, int] | None = None,
    ) -> None:
        """`timers` of a live graph end the wait for silent cameras, and wrong stamps are counted; None in lockstep.

        `joint_names`: the arm's; joints that are not all of these (a gripper's, an axis') are left out of the sets.
        `clocks_apart`: cameras of a log that another clock than the others' stamps, and by how much it is ahead, ns.
        """
        super().__init__("synchronizer", bus, clock)
        self.damaged = DamagedImages()
        """Of a log."""
        self._is_live = timers is not None
        self._joint_names = frozenset(joint_names)
        self._clocks_apart = clocks_apart or {}
        self._set_ahead = ClocksSetAhead()
        self._deadline = (timers or NoTimers()).alarm(self._on_deadline)
        self._watch = CameraWatch(tuple(camera.name for camera in rig.cameras))
        """Of a live graph: of a log nobody asks for its diagnoses, and it would keep the times of every image."""
        self._assembler = FrameAssembler(rig.cameras, parameters.width)
        self._topics = {camera.name: camera for camera in cameras}
        self._rig_cameras = {camera.name: camera for camera in rig.cameras}
        self._parameters = parameters
        self._synchronizer: ApproximateTimeSynchronizer[EncodedView] = ApproximateTimeSynchronizer(
            list(self._rig_cameras), parameters.grouping
        )
        tolerance_ns = int(parameters.depth_tolerance_ms * 1e6)
        self._pairs = {name: DepthPairs(tolerance_ns) for name in self._rig_cameras}
        self._last_stamp: dict[str, int] = {}
        self._early = EarlyViews(self._rig_cameras)
        self._decodes_early = not isinstance(clock, SteppedClock)
        """Not in lockstep: nobody waits there, and what is in no set need not be decoded."""
        self._side_thread = SideThread() if self._decodes_early and thread_count() > MODEL_THREADS else None
        self._next_due: int | None = None
        self._published = 0

    @property
    def cameras(self) -> tuple[Camera, ...]:
        """The pinhole cameras of the sets, in the rig's order."""
        return self._assembler.cameras

    def see_depth_by(self, name: str, lens: RigCamera) -> None:
        """From now on a camera's depth is taken to be what another lens in its place sees."""
        self._assembler.see_depth_by(name, lens)

    def on_configure(self) -> None:
        for name in self._rig_cameras:
            topics = self._topics[name]
            self.bus.subscribe(topics.image, partial(self._on_colour, name))
            if topics.depth:
                self.bus.subscribe(topics.depth, partial(self._on_depth, name))
        self.bus.subscribe(JOINT_STATES, self._on_joints)

    def diagnoses(self) -> tuple[convert.Diagnosis, ...]:
        """What each camera does that it should not, since the last call."""
        return self._watch.diagnoses(self.name, self._synchronizer.report)

    def _on_deadline(self) -> None:
        now = self.clock.now()
        self._take(self._synchronizer.poll(now), now)

    def _on_joints(self, message: Message) -> None:
        sample = convert.joint_sample_from_message(message)
        if sample.names and self._joint_names.issubset(sample.names):
            self._assembler.add_joints(sample)

    def _on_colour(self, name: str, message: Message) -> None:
        if not self._is_live:
            self._check_order(name, from_time(message.header.stamp))
        if self._topics[name].depth is None:
            self._add(name, EncodedView(message, None))
            return
        for view in self._pairs[name].add_colour(message):
            self._add(name, view)

    def _on_depth(self, name: str, message: Message) -> None:
        self._watch.add_depth(name)
        for view in self._pairs[name].add_depth(message):
            self._add(name, view)

    def _check_order(self, name: str, stamp: int) -> None:
        last = self._last_stamp.get(name, stamp)
        if stamp < last:
            raise GraphError(
                f"camera '{name}': image stamps run backwards by {(last - stamp) / 1e6:.1f} ms on "
                f"{self._topics[name].image} (at {stamp / 1e9:.3f} s); a log's images must be in the order of their "
                "header stamps: sort them, or mend the camera's clock"
            )
        self._last_stamp[name] = stamp

    def _add(self, name: str, view: EncodedView) -> None:
        stamp = self._rig_cameras[name].rig_time(from_time(view.colour.header.stamp))
        now = self.clock.now()
        if self._is_live:
            self._watch.add(name, stamp, now, view.depth is not None)
            if view.depth is not None and not self._topics[name].is_depth_aligned:
                self._watch.add_depth_frame(name, view.depth.header.frame_id, view.colour.header.frame_id)
        else:  # a log's clock is its recording times, which may lie before the stamps
            by_the_cells = stamp - self._clocks_apart.get(name, 0)
            now = max(now, by_the_cells - self._set_ahead.ahead_ns(name, by_the_cells, now))
        self._take(self._synchronizer.add(name, stamp, view, now), now)
        if self._decodes_early and self._is_due(self._early.set_of(name, stamp)):
            self._early.keep(name, stamp, view, self._begun(name, stamp, view))

    def _take(self, ready: Sequence[SyncSet[EncodedView]], now: int) -> None:
        """Hands on the sets that are ready at a time, ns, and sees to it that what waits does not wait too long."""
        for grouped in ready:
            if self._is_wanted(grouped.stamp):
                self._publish(grouped)
            members = zip(self._rig_cameras, grouped.members, strict=True)
            self._early.pass_set(grouped.stamp, [(name, m.stamp) for name, m in members if m is not None])
        due = self._synchronizer.due
        if due is not None:
            self._deadline.set(max((due - now) / 1e9, SHORTEST_WAIT_S))

    def _is_wanted(self, stamp: int) -> bool:
        """Whether a set is due under `max_rate_hz`: sets are taken at that rate on average, never in bursts."""
        rate = self._parameters.max_rate_hz
        if rate is None:
            return True
        if not self._is_due(stamp):
            return False
        due = stamp if self._next_due is None else self._next_due
        self._next_due = max(due + int(1e9 / rate), stamp)
        return True

    def _is_due(self, stamp: int | None) -> bool:
        """Whether a set of this stamp, ns, would be taken; none is that of no set."""
        return stamp is not None and (self._next_due is None or stamp >= self._next_due)

    def _publish(self, grouped: SyncSet[EncodedView]) -> None:
        members = {name: m for name, m in zip(self._rig_cameras, grouped.members, strict=True) if m is not None}
        views = [view for name, member in members.items() if (view := self._view(name, member)) is not None]
        stamp = max((view.stamp for view in views), default=0)
        if len(views) < len(members) and stamp <= self._published:
            return  # without its newest image a set may reach less far than the one before it
        self._published = stamp
        self.bus.publish(FRAMES, self._assembler.assemble_views(views))

    def _view(self, name: str, member: Stamped[EncodedView]) -> View | None:
        """A camera's part of a set; None, and told, where its image is damaged or, live, no good: the others go on."""
        early = self._early.get(name, member.stamp, member.payload)
        try:
            view = self._decoded(name, member.stamp, member.payload) if early is None else early.result()
        except TwinError as error:
            if self._is_live:
                self._watch.add_unusable(name, str(error))
            elif isinstance(error, DamagedError):
                self.damaged.add(name, error)
            else:
                raise
            return None
        self.damaged.add_whole(name)
        if view.depth is not None and not view.depth.any():
            self._watch.add_unmeasured(name)
        return view

    def _begun(self, name: str, stamp: int, encoded: EncodedView) -> Task[View]:
        """A view that another thread decodes where there is a processor left for it, else this one, now."""
        work = partial(self._decoded, name, stamp, encoded)
        if self._side_thread is not None:
            return self._side_thread.begin(work)
        view = Task(work)
        with contextlib.suppress(TwinError):  # if its set is wanted, it is told of then
            view.result()
        return view

    def _decoded(self, name: str, stamp: int, encoded: EncodedView) -> View:
        topics, depth = self._topics[name], None
        if encoded.depth is not None:
            with _told_of(topics.depth):
                depth = convert.depth_from_message(encoded.depth)
        with _told_of(topics.image):
            rgb = convert.rgb_from_message(encoded.colour)
        return self._assembler.view(name, DecodedImage(stamp, rgb, depth))


@contextlib.contextmanager
def _told_of(topic: str | None) -> Iterator[None]:
    """Images of another format are told by their topic: a frame may be called as it likes."""
    try:
        yield
    except DamagedError:
        raise  # who counts these tells the camera
    except MessageError as error:
        raise MessageError(f"{topic}: {error}") from error
