"""Cameras that fail in a running graph: each must be named in `/diagnostics`, and the twin must go on."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

from twin_node.bench.graph import blind_plan, cell_plan
from twin_node.bench.graph_run import GraphRun, running
from twin_node.cell import SimulatedRig, load_scenario
from twin_node.messages import convert
from twin_node.nodes.live.rig_source import RigParameters, topics_of
from twin_node.nodes.topics import DIAGNOSTICS, OBSTACLES
from twin_node.runtime.parameters import fill
from twin_node.scene import Float32, UInt8

RATE_HZ = 15.0
"""Of every camera: half of the scenario's, so that two busy cores keep up."""
PERIOD_NS = round(1e9 / RATE_HZ)


@dataclass(frozen=True)
class Fault:
    """What one camera does that it should not."""

    name: str
    word: str
    """What its diagnosis must say."""
    keeps: Callable[[int], bool] = lambda index: True
    """Whether an image is sent at all, by its number."""
    delay_ns: int = 0
    """Between the others' arrival and its own."""
    step_ns: int = 0
    """By how much its clock is put forward."""


FAULTS = (
    Fault("dead", "silent", keeps=lambda index: False),
    Fault("half rate", "slow", keeps=lambda index: index % 2 == 0),
    Fault("40 ms late", "lags", delay_ns=40_000_000),
    Fault("clock 1 s forward", "future", step_ns=1_000_000_000),
    Fault("clock 1 s back", "late", step_ns=-1_000_000_000),
)
SOUND = Fault("none", "in step")


@dataclass(frozen=True)
class FaultFigures:
    """What became of one fault."""

    fault: str
    named_after_s: float
    """From its first image on until its diagnosis was heard, s; diagnostics go out at 1 Hz. NaN: never."""
    forecasts_per_s: float
    """While it lasted; without a fault: `CameraFigures.forecasts_per_s`."""
    well_after_s: float
    """From its end until nothing was said of the camera any more, s."""
    others_named: int
    """Other cameras that were named meanwhile."""


@dataclass(frozen=True)
class CameraFigures:
    """Three cameras at 15 Hz into the simulated cell's graph, faults one after another."""

    forecasts_per_s: float
    named: int
    """Faults that were named."""
    faults: tuple[FaultFigures, ...]


@dataclass
class _Heard:
    """What the graph has said."""

    forecasts: list[float] = field(default_factory=list)
    """When (monotonic, s)."""
    said: dict[str, tuple[float, convert.Level, str]] = field(default_factory=dict)
    """Of each camera, last: when, how bad, what."""

    def on_diagnostics(self, message: object) -> None:
        for diagnosis in convert.diagnostics_from_message(message):
            if diagnosis.name.startswith("synchronizer: ") and diagnosis.hardware:
                self.said[diagnosis.hardware] = (time.monotonic(), diagnosis.level, diagnosis.message)

    def rate(self, since: float) -> float:
        """Forecasts per second since then."""
        return sum(at >= since for at in self.forecasts) / (time.monotonic() - since)


class _Cameras:
    """Publishes the simulated cell's first images again and again, stamped by the wall clock."""

    def __init__(self, run: GraphRun) -> None:
        self._run = run
        rig = SimulatedRig(load_scenario("demo"))
        self._pictures: dict[str, tuple[UInt8, Float32]] = {}
        for exposure in rig.exposures():
            if exposure.tick:
                break
            image = rig.take(exposure)
            self._pictures[image.camera] = (image.rgb, image.depth_m)
        sections = cell_plan().sections
        parameters = fill(RigParameters, sections["/**"]["rig"], "bench graph")
        self._topics = {name: topics_of(name, parameters) for name in self._pictures}
        self._index = 0

    @property
    def names(self) -> tuple[str, ...]:
        """Of the cameras."""
        return tuple(self._pictures)

    def play(self, seconds: float, faulty: str, fault: Fault, until: Callable[[], bool] = lambda: False) -> None:
        """Publishes for so long, or until something is true, one camera with a fault."""
        first, begun = self._index, time.time_ns()
        while time.time_ns() < begun + seconds * 1e9 and not until():
            taken = begun + (self._index - first) * PERIOD_NS
            for arrival, stamp, name in arrivals(self._index, taken, self.names, faulty, fault):
                self._run.spin(max(0.0, (arrival - time.time_ns()) / 1e9))
                self._publish(name, stamp)
            self._index += 1

    def _publish(self, name: str, stamp: int) -> None:
        topics, (rgb, depth) = self._topics[name], self._pictures[name]
        if topics.depth is not None:
            self._run.bus.publish(topics.depth, convert.depth_image(name, stamp, depth))
        self._run.bus.publish(topics.image, convert.raw_image(name, stamp, rgb))


def arrivals(
    index: int, taken: int, names: tuple[str, ...], faulty: str, fault: Fault
) -> Iterator[tuple[int, int, str]]:
    """When each camera's image of an exposure at `taken` (ns) comes, and its stamp, both ns, in order of arrival."""
    of = {name: fault if name == faulty else SOUND for name in names}
    kept = [name for name in names if of[name].keeps(index)]
    yield from sorted((taken + of[name].delay_ns, taken + of[name].step_ns, name) for name in kept)


def cameras(seconds: float) -> CameraFigures:
    """Every fault for `seconds`, on each of the cameras in turn; in between until all is well again."""
    with running(blind_plan()) as run:
        heard, source = _Heard(), _Cameras(run)
        run.listen(DIAGNOSTICS, heard.on_diagnostics)
        run.listen(OBSTACLES, lambda message: heard.forecasts.append(time.monotonic()))
        source.play(60.0, "", SOUND, lambda: len(heard.forecasts) > RATE_HZ)
        begun = time.monotonic()
        source.play(seconds, "", SOUND)
        usual = heard.rate(begun)
        found = tuple(
            _fault(source, heard, source.names[i % len(source.names)], fault, seconds) for i, fault in enumerate(FAULTS)
        )
    return CameraFigures(usual, sum(not math.isnan(f.named_after_s) for f in found), found)


def _fault(source: _Cameras, heard: _Heard, camera: str, fault: Fault, seconds: float) -> FaultFigures:
    heard.said.clear()
    begun, named = time.monotonic(), [float("nan")]

    def watch() -> bool:
        at, level, message = heard.said.get(camera, (0.0, convert.Level.OK, ""))
        if level is not convert.Level.OK and fault.word in message and math.isnan(named[0]):
            named[0] = at - begun
        return False

    source.play(seconds, camera, fault, watch)
    rate = heard.rate(begun)
    others = sum(level is not convert.Level.OK for name, (_, level, _) in heard.said.items() if name != camera)
    ended = time.monotonic()

    def is_well() -> bool:
        return all(at > ended and level is convert.Level.OK for at, level, _ in heard.said.values())

    source.play(10.0, "", SOUND, is_well)
    return FaultFigures(fault.name, named[0], rate, time.monotonic() - ended if is_well() else float("nan"), others)
