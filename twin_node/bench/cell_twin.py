"""The real chain in the closed loop: rendered images, synchroniser, model and forecast, and as late as they are."""

from __future__ import annotations

import time
from collections import deque
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
import torch

from twin_node.arm import ArmCollisionChecker
from twin_node.bench.cell_case import CellCase
from twin_node.bench.errors import BenchError
from twin_node.bench.simulated_arm import told_of_arm
from twin_node.cell.closed_loop import LoopRecord
from twin_node.cell.program import RunningProgram
from twin_node.cell.simulator import Exposure, SimulatedRig
from twin_node.cell.ur_arm import DrivenArm
from twin_node.messages import Message, convert
from twin_node.nodes.chain import Chain
from twin_node.nodes.chain_parameters import ChainParameters, load_parameters
from twin_node.nodes.latency import Latency
from twin_node.nodes.live.rig_source import RigParameters, topics_of
from twin_node.nodes.model import Following
from twin_node.nodes.synchronizer import SynchronizerNode
from twin_node.nodes.topics import FRAMES, JOINT_STATES, OBSTACLES
from twin_node.robot import UR_NAMES
from twin_node.runtime.bus import LocalBus
from twin_node.runtime.clock import SteppedClock
from twin_node.scene import Float64, FrameSet, ObstacleKind, Obstacles


@dataclass(frozen=True)
class TwinTiming:
    """How late the chain was in one run."""

    sets: int
    """Image sets that went through."""
    dropped: int
    """Sets that a newer one replaced before the chain had time for them."""
    latencies_ms: Float64
    """[sets] from the newest image of a set to its obstacles."""

    @property
    def usual_ms(self) -> float:
        """Their median, ms; the first set, which builds the model, aside."""
        return float(np.median(self.latencies_ms[1:] if len(self.latencies_ms) > 1 else self.latencies_ms))


@dataclass(frozen=True)
class TwinRun:
    """A run with the twin in the loop."""

    record: LoopRecord
    timing: TwinTiming
    first_seen_s: float
    """When some camera first saw somebody, s after the start; infinite where none did."""


def run_twin(case: CellCase, width: int, pace: Pace | None, by_sight: bool = False) -> TwinRun:
    """The arm at work, knowing what the real chain, as shipped, tells of images that are `width` pixels wide.

    `pace` None: as late and as often as the chain is on one core of this machine. `by_sight`: the arm knows where
    things were seen and nothing of how they move, as under the worst case. Raises `BenchError` for an arm that the
    chain does not know.
    """
    torch.set_num_threads(1)
    cv2.setNumThreads(1)
    chain = told_of_arm(load_parameters(None), case.scenario)
    parameters = replace(chain, synchronizer=replace(chain.synchronizer, width=width))
    seen = TwinPerception(case, parameters, pace)
    known = BySight(seen) if by_sight else seen
    checker = ArmCollisionChecker(case.arm.model, allowed=(case.taught_region,))
    try:
        record = case.run_with(known, case.parameters.separation.human_speed, checker)
    finally:
        seen.stop()
    first = seen.first_seen_ns
    first_seen_s = np.inf if first is None else (first - case.scenario.start_ns) * 1e-9
    return TwinRun(record, seen.timing, float(first_seen_s))


TOPICS = RigParameters(depth="depth/image_rect")
TRANSPORT_NS = 2_300_000
"""From camera to chain and on to the arm's node, ns: a hop of an image, its depth and the obstacles (`bench graph`)."""


class _WorkClock:
    """Simulated time that goes on while the chain works, as the processor time of this process does.

    So a run takes as long as on a core of its own, whatever else the machine does meanwhile.
    """

    def __init__(self, start_ns: int) -> None:
        self._base_ns = start_ns
        self._begun: int | None = None

    def begin(self, now: int) -> None:
        """Work begins at a simulated time, ns."""
        self._base_ns, self._begun = now, time.process_time_ns()

    def end(self) -> int:
        """Work has ended; the simulated time at which, ns."""
        self._base_ns, self._begun = self.now(), None
        return self._base_ns

    def now(self) -> int:
        """Simulated time, ns."""
        return self._base_ns if self._begun is None else self._base_ns + time.process_time_ns() - self._begun


@dataclass(frozen=True)
class Pace:
    """How late the chain is, and how often it takes a set, where that is not measured."""

    latency_ns: int
    """From a set's newest image to its obstacles."""
    period_ns: int | None
    """From one set to the next; None: each is taken when the one before is done."""

    @classmethod
    def of(cls, latency_ms: float, rate_hz: float | None = None) -> Pace:
        """So late, and so many sets per second; None: each is taken when the one before is done."""
        return cls(round(latency_ms * 1e6), None if rate_hz is None else round(1e9 / rate_hz))


class TwinPerception:
    """The twin as the loop's perception: it sees the arm where the loop has driven it, and answers when it is done.

    The chain takes the newest set whenever it is free. The processor time that it then takes, decoding and transport
    included, is when its obstacles become known, and what the model takes after that is when it is free again; a `pace`
    replaces both.
    """

    def __init__(self, case: CellCase, parameters: ChainParameters, pace: Pace | None = None) -> None:
        """Raises `BenchError` for an arm that the chain does not know."""
        scenario = case.scenario
        if scenario.arm is None or scenario.arm.model not in UR_NAMES:
            raise BenchError(f"scenario {scenario.name}: the twin knows the arms {', '.join(UR_NAMES)} alone")
        self._rig = SimulatedRig(scenario)
        self._arm = DrivenArm(scenario.arm, scenario)
        self._rig.world.arm = self._arm
        self._due: deque[Exposure] = deque(self._rig.arrivals())
        self._pace = pace
        self._reading, self._working = LocalBus(), LocalBus()
        self._reading_clock, self._clock = SteppedClock(scenario.start_ns), _WorkClock(scenario.start_ns)
        cameras = tuple(topics_of(camera.name, TOPICS) for camera in self._rig.cameras)
        synchronizer = SynchronizerNode(
            self._reading, self._reading_clock, cameras, self._rig.rig, parameters.synchronizer
        )
        synchronizer.configure()
        synchronizer.activate()
        self._latency = Latency(round(case.timing.latency_ns), is_measured=pace is None)
        following = Following.IN_TIME if pace is None else Following.IN_TURN
        workspace = np.array(scenario.workspace)
        self._chain = Chain(
            *(self._working, self._clock, workspace, parameters, self._latency, following), lambda: self._dropped
        )
        self._chain.start()
        self._newest: FrameSet | None = None
        self._decoding_ns = 0
        self._found: deque[tuple[int, Any]] = deque()
        """Obstacles, and when each becomes known, ns."""
        self._free_from = scenario.start_ns
        self._is_built = False
        self._dropped = 0
        self._latencies_ms: list[float] = []
        self._made: Any = None
        self._reading.subscribe(FRAMES, self._on_frames)
        self._working.subscribe(OBSTACLES, self._on_obstacles)
        self.first_seen_ns: int | None = None
        """When some camera first saw somebody, ns; None as long as none has."""

    def stop(self) -> None:
        """Ends the chain, without which nothing of it is ever freed."""
        self._chain.stop()

    def look(self, program: RunningProgram) -> Obstacles | None:
        """Takes the images that are due, and gives the obstacles that have become known since the last look."""
        now = program.now
        self._arm.drive(now, program.phase_ns)
        self._reading_clock.advance_to(now)
        self._reading.publish(JOINT_STATES, convert.joint_sample_to_message(self._arm.sample(now)))
        while self._due and self._due[0].arrival <= now:
            self._take(self._due.popleft())
        known = None
        while self._found and self._found[0][0] <= now:
            known = self._found.popleft()[1]
        if self._newest is not None and now >= self._free_from:
            self._work(now)
        return None if known is None else convert.obstacles_from_message(known)

    @property
    def timing(self) -> TwinTiming:
        """How late the chain has been so far."""
        return TwinTiming(len(self._latencies_ms), self._dropped, np.array(self._latencies_ms))

    def _take(self, exposure: Exposure) -> None:
        """Renders one image and sends it; the time that decoding takes is the set's, that of rendering nobody's."""
        image = self._rig.take(exposure)
        if self.first_seen_ns is None:
            owners = self._rig.see(exposure.camera, exposure.stamp).owners
            if np.isin(owners, self._rig.world.people_owners).any():
                self.first_seen_ns = exposure.stamp
        topics = topics_of(image.camera, TOPICS)
        assert topics.depth is not None
        depth = convert.depth_image(image.camera, image.stamp, image.depth_m)
        colour = convert.compressed_image(image.camera, image.stamp, image.rgb)
        before, begun = self._newest, time.process_time_ns()
        self._reading.publish(topics.depth, depth)
        self._reading.publish(topics.image, colour)
        if self._newest is not before:
            self._decoding_ns = time.process_time_ns() - begun

    def _on_frames(self, frames: FrameSet) -> None:
        self._dropped += self._newest is not None
        self._newest = frames

    def _on_obstacles(self, message: Message) -> None:
        self._made = message

    def _work(self, now: int) -> None:
        """Puts the newest set through the chain, from now on; building the model from the first set takes no time."""
        frames, self._newest = self._newest, None
        assert frames is not None
        self._made = None
        self._clock.begin(now + self._decoding_ns + TRANSPORT_NS)
        self._working.publish(FRAMES, frames)
        known = self._clock.now()
        self._chain.model_node.work_between_sets(self._has_time)
        free = self._clock.end()
        if not self._is_built:
            self._is_built = True
            self._latency.start()
            known = free = now
        if self._pace is not None:
            known = free = max(now, frames.stamp + self._pace.latency_ns)
            if self._pace.period_ns is not None:
                free = max(self._free_from, frames.stamp) + self._pace.period_ns
        self._free_from = free
        if self._made is not None:
            self._found.append((known, self._made))
        self._latencies_ms.append((known - frames.stamp) * 1e-6)

    def _has_time(self) -> bool:
        """Whether no other image has come meanwhile, or the pace says when the next one is taken."""
        return self._pace is not None or not self._due or self._due[0].arrival > self._clock.now()


class BySight:
    """What the twin sees, without what it foresees."""

    def __init__(self, twin: TwinPerception) -> None:
        self._twin = twin

    def look(self, program: RunningProgram) -> Obstacles | None:
        """What moves is where it was seen, at the evidence; how fast it moves nobody says."""
        found = self._twin.look(program)
        if found is None:
            return None
        kept = found.as_seen | (found.kinds != ObstacleKind.MOVING)
        still = np.zeros((int(kept.sum()), 3))
        return replace(found.only(kept), velocities=still, reach_speeds=None, reach_delays=None)
