"""Follows a log with a window model: in lockstep, at the log's pace, or to and fro."""

from __future__ import annotations

import contextlib
import dataclasses
import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field

from twin_node.model import WindowModel
from twin_node.model.first_light import once_lit
from twin_node.nodes.bridge import Bridge
from twin_node.nodes.chain import make_model
from twin_node.nodes.chain_parameters import ChainParameters
from twin_node.nodes.log_source import LogSession, LogSource
from twin_node.nodes.model import Following, ModelNode
from twin_node.nodes.reading import Order, Reading
from twin_node.nodes.spool import Spool, Tick
from twin_node.nodes.topics import GAUSSIANS_MOVING, STATE, TRUSTED_FRAMES
from twin_node.runtime.bus import LocalBus
from twin_node.runtime.clock import PacedClock
from twin_node.runtime.image_threads import image_loops_alone
from twin_node.runtime.memory import resident_bytes
from twin_node.scene import FrameSet, Tier, TwinState


@dataclass
class Watch:
    """Wall-clock times of the stages of every update, ms."""

    stages: dict[str, list[float]] = field(default_factory=dict)
    _last: float = 0.0

    def begin(self) -> None:
        """An update begins."""
        self._last = time.perf_counter()

    def __call__(self, stage: str) -> None:
        """A stage has ended; a `model.stages.OnStage`."""
        now = time.perf_counter()
        self.stages.setdefault(stage, []).append((now - self._last) * 1e3)
        self._last = now


@dataclass
class Followed:
    """What following a log has cost, set by set."""

    model: WindowModel
    watch: Watch
    sets: int = 0
    dropped: int = 0
    seconds: float = 0.0
    """That the span took at the clock's rate, or until the last set had gone through, if that was later; in lockstep
    wall-clock time."""
    latencies_ms: list[float] = field(default_factory=list)
    """From the newest image's stamp to the published cloud, by the run's clock; empty in lockstep."""
    offers_ms: list[float] = field(default_factory=list)
    """From the newest image's stamp to the set's being decoded and offered; sets that are dropped later count too."""
    waits_ms: list[float] = field(default_factory=list)
    """From the newest image's stamp to the model's having the set."""
    updates_ms: list[float] = field(default_factory=list)
    """Set by set; the first builds the model."""
    tiers: list[tuple[int, ...]] = field(default_factory=list)
    """Living Gaussians per tier, in the order of `Tier`."""
    bytes_per_frame: list[int] = field(default_factory=list)
    warnings: dict[str, int] = field(default_factory=dict)
    memory_bytes: list[int] = field(default_factory=list)
    """What the process holds after each set."""

    def count(self, state: TwinState) -> None:
        """Takes in what an update has led to."""
        self.sets += 1
        counts = self.model.tier_counts
        self.tiers.append(tuple(counts[tier] for tier in Tier))
        self.bytes_per_frame.append(self.model.bytes_per_frame)
        for warning in state.warnings:
            self.warnings[warning] = self.warnings.get(warning, 0) + 1
        self.memory_bytes.append(resident_bytes())


def start(chain: ChainParameters) -> Followed:
    """A fresh model of the chain's, watched."""
    image_loops_alone()
    watch = Watch()
    model = make_model(chain)
    model.on_stage = watch
    return Followed(model, watch)


def follow(followed: Followed, sets: Iterable[FrameSet]) -> Iterator[Tick]:
    """Every set in turn, and the state that it led to."""
    for frames in sets:
        begun = time.perf_counter()
        followed.watch.begin()
        state = followed.model.update(frames)
        followed.updates_ms.append((time.perf_counter() - begun) * 1e3)
        followed.model.refine()
        followed.seconds += time.perf_counter() - begun
        followed.count(state)
        yield Tick(frames, state)


def to_and_fro(sets: Sequence[FrameSet], passes: int) -> Iterator[Iterator[FrameSet]]:
    """`passes` over the same sets, every other one backward; stamps always rise."""
    gap = (sets[-1].stamp - sets[0].stamp) // max(len(sets) - 1, 1)
    length = sets[-1].stamp - min(view.stamp for view in sets[0].views) + gap
    for index in range(passes):
        yield _passed(sets, index * length, backward=index % 2 == 1)


def _passed(sets: Sequence[FrameSet], shift_ns: int, backward: bool) -> Iterator[FrameSet]:
    """The sets `shift_ns` later; backward, their times mirrored between the first and the last, the arm's way too."""
    low, high = min(view.stamp for view in sets[0].views), sets[-1].stamp

    def moved(stamp: int) -> int:
        return (low + high - stamp if backward else stamp) + shift_ns

    for frames in reversed(sets) if backward else sets:
        views = tuple(dataclasses.replace(view, stamp=moved(view.stamp)) for view in frames.views)
        joints = frames.joints
        if joints is not None:
            velocities = -joints.velocities if backward else joints.velocities
            joints = dataclasses.replace(joints, stamp=moved(joints.stamp), velocities=velocities)
        yield dataclasses.replace(frames, stamp=max(view.stamp for view in views), views=views, joints=joints)


def follow_live(
    followed: Followed, session: LogSession, chain: ChainParameters, rate: float, spool: Spool
) -> Iterator[float]:
    """Follows the log at its pace times `rate`, the newest set first; yields the seconds played.

    Another process reads, decodes and groups, this one works. As a twin that goes live does, the model is built from
    the first set before the clock starts.
    """
    names = chain.arm.arm().joint_names
    with contextlib.closing(Reading(Order(session, chain.synchronizer, names))) as reading:
        clock, working = PacedClock(session.span.start_ns, rate), LocalBus()
        node = ModelNode(working, clock, followed.model, Following.IN_TIME)
        node.configure()
        node.activate()
        states: list[TwinState] = []
        working.subscribe(STATE, states.append)
        published: list[int] = []
        working.subscribe(GAUSSIANS_MOVING, lambda _: published.append(clock.now()))
        bridge = Bridge(lambda frames: _keep(spool, Tick(frames)))
        first = next(once_lit(LogSource(session, chain.synchronizer, names)), None)
        if first is None:
            return

        def follow(frames: FrameSet) -> None:
            begun = time.perf_counter()
            followed.watch.begin()
            working.publish(TRUSTED_FRAMES, frames)
            node.follow()
            followed.updates_ms.append((time.perf_counter() - begun) * 1e3)

        def offer(frames: FrameSet) -> None:
            if frames.stamp > first.stamp:
                followed.offers_ms.append((clock.now() - frames.stamp) / (1e6 * rate))
                bridge.put_frames(frames)

        follow(first)
        followed.count(states[-1])
        _keep(spool, Tick(first, states[-1], published=published[-1]))
        through = clock.now()
        reading.start(clock, bridge, offer)
        try:
            for _, frames in bridge.batches():
                followed.waits_ms.append((clock.now() - frames.stamp) / (1e6 * rate))
                follow(frames)
                through = clock.now()
                node.work_between_sets(lambda: not bridge.is_waiting)
                followed.latencies_ms.append((published[-1] - frames.stamp) / (1e6 * rate))
                followed.count(states[-1])
                _keep(spool, Tick(frames, states[-1], published=published[-1]))
                states.clear()
                yield (frames.stamp - session.span.start_ns) * 1e-9
        finally:
            bridge.close()
    followed.dropped = bridge.dropped
    followed.seconds = max(session.span.seconds, (through - session.span.start_ns) * 1e-9) / rate


def _keep(spool: Spool, tick: Tick) -> None:
    if spool.keeps(tick.stamp):
        spool.add(tick)
