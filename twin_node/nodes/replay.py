"""Runs the twin on a recorded log: at the log's pace, newest set first, or in lockstep, every set in turn."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from twin_node.bag import ChunkCompression, LogWriter
from twin_node.bag.qos import is_latched
from twin_node.model import WindowModel
from twin_node.model.first_light import FirstLight
from twin_node.nodes.arm import make_arm_node
from twin_node.nodes.bridge import Bridge
from twin_node.nodes.chain import Chain
from twin_node.nodes.chain_parameters import ChainParameters
from twin_node.nodes.collector import CollectorNode
from twin_node.nodes.contents import told_of
from twin_node.nodes.latency import ASSUMED_LATENCY_NS, Latency
from twin_node.nodes.log_source import LogSession, LogSource, workspace_for
from twin_node.nodes.model import Following
from twin_node.nodes.reading import Finished, Order, Play, Reading
from twin_node.nodes.recorder import RecorderNode
from twin_node.nodes.spool import Spool
from twin_node.nodes.topics import FRAMES, RECORDED, GraphError
from twin_node.runtime.arrivals import PATIENCE
from twin_node.runtime.bus import LocalBus
from twin_node.runtime.clock import PacedClock, SteppedClock
from twin_node.runtime.memory import peak_mb
from twin_node.runtime.node import Node
from twin_node.runtime.worker_process import EndedError
from twin_node.scene import Camera, FrameSet

Progress = Callable[[float], None]
"""Called with the seconds of log time that have been played."""


@dataclass(frozen=True)
class Run:
    """What a run leaves behind, beside its log."""

    parameters: ChainParameters
    """Of the chain."""
    sets: int
    """Sets that went through the chain."""
    followed: int
    """Sets of these that the model has followed; the others it had no time for."""
    dropped: int
    """Sets that a newer one replaced before the chain had time for them."""
    seconds: float
    """That the span took at the clock's rate, or until the last set had gone through, if that was later; in lockstep
    wall-clock time."""
    peak_rss_mb: float
    """Of the process and of the model's and the reader's beside it."""
    bytes_per_frame: float
    """What is published with a set, mean, bytes."""
    model: WindowModel
    """As it was fitted to the first set; what it had become at the end tell the collector's states."""
    parameters_count: int
    """Numbers that described the scene at the end."""
    collector: CollectorNode
    spool: Spool | None
    rate: float | None
    """Speed of the clock by the log's; None in lockstep."""
    damage: str | None = None
    """Where the log could not be read on; None: it was read to its end."""
    damaged_images: tuple[str, ...] = ()
    """A line for each camera some of whose images were left out."""
    damaged_counts: Mapping[str, int] = field(default_factory=dict)
    """How many these were, by the cameras' names."""

    @property
    def is_lockstep(self) -> bool:
        """Whether every set went through in turn, however long it took."""
        return self.rate is None

    @property
    def work_ms(self) -> list[float]:
        """From each set's arrival at the chain to the speed decision; in lockstep without the first, which builds the
        model."""
        return self.collector.work_ms[1:] if self.is_lockstep else self.collector.work_ms

    @property
    def latencies_ms(self) -> list[float]:
        """From each set's newest image to the speed decision; in lockstep, which knows no such time, the work."""
        return self.work_ms if self.is_lockstep else self.collector.latencies_ms

    def missed(self, session: LogSession) -> tuple[str, ...]:
        """A line for each of the log's cameras that most sets had to do without, or its images without their depth, or
        some of whose images were damaged; one where sets ended before the log did."""
        arrived = self.collector.arrived
        ended = arrived.ended_before(session.span.stop_ns) if self.damage is None else None
        lacking = arrived.lacking(session.cameras_in_sets, session.cameras, self.rate or 1.0, self.damaged_counts)
        return (*(() if ended is None else (ended,)), *self.damaged_images, *lacking)


@contextlib.contextmanager
def replay(
    session: LogSession,
    parameters: ChainParameters,
    *,
    rate: float | None,
    output: Path | None = None,
    keep_ticks: bool = False,
    progress: Progress = lambda _: None,
    recorded: Collection[str] = RECORDED,
) -> Iterator[Run]:
    """Run the chain on a session's span; `rate` None is lockstep. The topics `recorded` go to `output`.

    Yields the run with its spool of ticks (where `keep_ticks`), which is gone when the context ends. `output` appears
    only when the run has come to its end.
    """
    with contextlib.ExitStack() as stack:
        expected_hz = session.expected_hz(parameters.synchronizer.max_rate_hz)
        spool = None
        if keep_ticks:
            spool = stack.enter_context(Spool(session.span.start_ns, session.span.stop_ns, expected_hz))
        with contextlib.ExitStack() as writing:
            compression: ChunkCompression = "zstd" if rate is None else "none"  # in real time it would take the twin's
            log = writing.enter_context(LogWriter(output, compression)) if output is not None else None
            engine = _Engine(session, parameters, spool, log, recorded, progress)
            try:
                run = engine.in_lockstep() if rate is None else engine.in_real_time(rate)
            except EndedError as error:
                raise GraphError(str(error)) from error
        yield run


class _Engine:
    """One run: makes the nodes, moves the messages, adds up."""

    def __init__(
        self,
        session: LogSession,
        parameters: ChainParameters,
        spool: Spool | None,
        log: LogWriter | None,
        recorded: Collection[str],
        progress: Progress,
    ) -> None:
        self._session = session
        self._parameters = parameters
        self._spool = spool
        self._log = log
        self._recorded = recorded
        self._progress = progress

    def in_lockstep(self) -> Run:
        """Every message in the log's order, each dealt with before the next: the same bytes every time."""
        clock = SteppedClock(self._session.span.start_ns)
        bus = LocalBus(is_latched)
        joint_names = self._parameters.arm.arm().joint_names
        synchronizer = self._session.synchronizer(bus, clock, self._parameters.synchronizer, joint_names)
        synchronizer.configure()
        synchronizer.activate()
        collector = CollectorNode(bus, clock, self._spool)
        latency = Latency(ASSUMED_LATENCY_NS, is_measured=False)
        chain = self._chain(collector, synchronizer.cameras, latency, Following.IN_TURN, lambda: 0)
        begun = time.perf_counter()
        for stamp in self._session.player(bus).steps(clock):
            chain.model_node.follow()
            self._progress((stamp - self._session.span.start_ns) / 1e9)
        read = Finished(self._session.log.damage, synchronizer.damaged.lines, synchronizer.damaged.counts)
        return self._finish(chain, collector, 0, time.perf_counter() - begun, None, read)

    def in_real_time(self, rate: float) -> Run:
        """Another process, or a thread, reads at the log's pace times `rate`, this one works; the newest set wins.

        As a twin that goes live does, it first builds its model from the first set, and only then the clock starts.
        """
        order = Order(self._session, self._parameters.synchronizer, self._parameters.arm.arm().joint_names)
        reading = Reading(order)
        with contextlib.closing(reading):
            clock, working = PacedClock(self._session.span.start_ns, rate), LocalBus(is_latched)
            latency = Latency(ASSUMED_LATENCY_NS, is_measured=True)
            collector = CollectorNode(working, clock, self._spool, rate)
            bridge = Bridge(collector.keep_dropped, PATIENCE)
            cameras = LogSource(self._session, self._parameters.synchronizer).cameras
            chain = self._chain(collector, cameras, latency, Following.APART, lambda: bridge.dropped)
            first = self._first_set(order, working)
            working.publish(FRAMES, first)
            chain.model_node.follow()
            chain.model_node.await_process()

            def hand_over(frames: FrameSet) -> None:
                self._progress((frames.stamp - self._session.span.start_ns) / 1e9)
                if frames.stamp > first.stamp:
                    bridge.put_frames(frames)

            through = clock.now()
            latency.start()
            collector.start()
            reading.start(clock, bridge, hand_over)
            try:
                for messages, frames in bridge.batches():
                    for topic, message in messages:
                        with told_of(self._session.log, topic):
                            working.publish(topic, message)
                    working.publish(FRAMES, frames)
                    through = clock.now()
                    chain.model_node.work_between_sets(lambda: not bridge.is_waiting)
            finally:
                bridge.close()
        seconds = max(self._session.span.seconds, (through - self._session.span.start_ns) * 1e-9) / rate
        return self._finish(chain, collector, bridge.dropped, seconds, rate, reading.finished)

    def _first_set(self, order: Order, bus: LocalBus) -> FrameSet:
        """The first set that shows something, else the first; what the log says of the arm by then goes out on the bus,
        lest a made-up one be judged."""
        sets: list[FrameSet] = []
        light, first = FirstLight(), None
        play = Play(order, SteppedClock(), sets.append, bus.publish)
        for _ in play.steps():
            for frames in sets:
                first = first or frames
                if not light.is_dark(frames):
                    return frames
            sets.clear()
        if first is None:
            raise _nothing_followed(self._session, 0, play.finished().damaged_images)
        return first

    def _chain(
        self,
        collector: CollectorNode,
        cameras: Sequence[Camera],
        latency: Latency,
        following: Following,
        dropped: Callable[[], int],
    ) -> Chain:
        """The chain, the arm, the collector and the recorder, started on the collector's bus."""
        bus, clock = collector.bus, collector.clock
        workspace = workspace_for(self._session.rig, cameras)
        chain = Chain(bus, clock, workspace, self._parameters, latency, following, dropped)
        observers: list[Node] = [collector]
        if self._log is not None:
            observers.append(RecorderNode(bus, clock, self._log, self._recorded))
        observers.append(make_arm_node(bus, clock, workspace, self._parameters.arm))
        for node in observers:
            node.configure()
            node.activate()
        chain.start()
        return chain

    def _finish(
        self,
        chain: Chain,
        collector: CollectorNode,
        dropped: int,
        seconds: float,
        rate: float | None,
        read: Finished,
    ) -> Run:
        """What the run leaves behind; `read`: what there is to say of the log."""
        if collector.newest_state is None:
            raise _nothing_followed(self._session, collector.arrived.sets, read.damaged_images)
        chain.stop()
        collector.end()
        return Run(
            parameters=self._parameters,
            sets=chain.status.sets,
            followed=chain.model_node.followed,
            dropped=dropped,
            seconds=seconds,
            peak_rss_mb=peak_mb() + chain.model_node.peak_rss_mb_elsewhere + read.peak_rss_mb,
            bytes_per_frame=chain.status.bytes_per_frame,
            model=chain.model_node.model,
            parameters_count=chain.model_node.parameters_count,
            collector=collector,
            spool=self._spool,
            rate=rate,
            damage=read.damage,
            damaged_images=read.damaged_images,
            damaged_counts=read.damaged_counts,
        )


def _nothing_followed(session: LogSession, sets: int, damaged: Sequence[str]) -> GraphError:
    """Why no model was made, of so many sets that came; `damaged`: a line for each camera with damaged images."""
    names = ", ".join(camera.name for camera in session.rig.cameras)
    if sets:
        why = (
            f"all {sets} sets of {names} show nothing, black or burnt out: uncover the cameras or mend the light, or "
            "begin where they show something, by --start-offset"
        )
    elif damaged:
        why = f"no set of images of {names} within {session.span.seconds:.2f} s; {'; '.join(damaged)}"
    else:
        why = (
            f"no set of images of {names} within {session.span.seconds:.2f} s; the cameras' stamps lie too far apart, "
            "or the span is too short: see their times with 'twin_node check', or give a longer --duration"
        )
    return GraphError(f"{session.log.path}: {why}")
