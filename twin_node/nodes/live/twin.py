"""The twin of a live graph: the chain from frame sets to obstacles, always on the newest set."""

from __future__ import annotations

from typing import Any

from twin_node.messages import convert
from twin_node.nodes.chain import Chain
from twin_node.nodes.chain_parameters import ChainParameters
from twin_node.nodes.latency import ASSUMED_LATENCY_NS, Latency
from twin_node.nodes.launch.kinds import CHAIN_SECTIONS, KINDS
from twin_node.nodes.live.rig_source import RigSource, read_rig, working_volume
from twin_node.nodes.live.setup import Setup
from twin_node.nodes.model import Following
from twin_node.nodes.topics import DIAGNOSTICS, FORECAST, FRAMES, RECORDED, SEEN, SEPARATION, TRUSTED_FRAMES
from twin_node.runtime.node import Node

TOLD = tuple(topic for topic in RECORDED if topic not in (SEPARATION, DIAGNOSTICS))
"""What a twin says once it has seen a set; others find it, and know its type, from the beginning."""


def make_twin(setup: Setup) -> Node:
    """Drift watch, model, forecast and status in one thread: what they hand on stays where it is."""
    own = [section for section in CHAIN_SECTIONS if section not in KINDS]
    return TwinNode(setup, read_rig(setup.rig()), setup.chain_parameters(*own))


class TwinNode(Node):
    """The chain; latency counts from the first forecast on: what came before was start-up."""

    def __init__(self, setup: Setup, source: RigSource, parameters: ChainParameters) -> None:
        super().__init__(setup.name, setup.bus, setup.clock)
        self._say, self._doubts = setup.say, source.doubts
        self._latency = Latency(ASSUMED_LATENCY_NS, is_measured=True)
        self._bus = bus = setup.bus
        workspace = working_volume(source, parameters.synchronizer.width)
        self._chain = Chain(
            *(bus, setup.clock, workspace, parameters, self._latency, Following.APART),
            dropped=lambda: bus.dropped(FRAMES),
            say=setup.say,
            kept=setup.kept,
            is_ending=setup.is_ending,
        )

    def on_configure(self) -> None:
        for line in self._doubts:
            self._say(line)
        for topic in TOLD:
            self._bus.advertise(topic)
        self._chain.configure()
        self.bus.subscribe(FORECAST, self._on_forecast)

    def on_activate(self) -> None:
        self._chain.activate()

    def on_deactivate(self) -> None:
        self._chain.deactivate()

    def on_cleanup(self) -> None:
        self._chain.cleanup()

    def diagnoses(self) -> tuple[convert.Diagnosis, ...]:
        """How the nodes of the chain are doing."""
        return self._chain.diagnoses()

    def _on_forecast(self, _: Any) -> None:
        """All that comes of a set is out: what is left of its time is the model's."""
        self._latency.start()
        waiting = (FRAMES, TRUSTED_FRAMES, SEEN)
        self._chain.model_node.work_between_sets(lambda: not any(self._bus.is_waiting(topic) for topic in waiting))
