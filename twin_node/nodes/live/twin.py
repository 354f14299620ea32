"""The twin of a live graph: the chain from frame sets to obstacles, always on the newest set."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from twin_node.nodes.chain import Chain, ChainParameters, make_arm_node
from twin_node.nodes.latency import ASSUMED_LATENCY_NS, Latency
from twin_node.nodes.live.rig_source import RigSource, read_rig
from twin_node.nodes.live.setup import Setup
from twin_node.nodes.log_source import workspace_for
from twin_node.nodes.synchronizer import SynchronizerNode
from twin_node.nodes.topics import FORECAST, FRAMES, TRUSTED_FRAMES
from twin_node.rig import FrameAssembler
from twin_node.runtime.node import Node
from twin_node.scene import Float64


def make_synchronizer(setup: Setup) -> Node:
    """The synchroniser, with a timer for its deadlines."""
    source = read_rig(setup.rig())
    parameters = setup.chain_parameters().synchronizer
    return SynchronizerNode(setup.bus, setup.clock, source.cameras, source.rig, parameters, setup.timers)


def make_twin(setup: Setup) -> Node:
    """Drift watch, model, forecast and status in one thread: what they hand on stays where it is."""
    return TwinNode(setup, read_rig(setup.rig()), setup.chain_parameters())


def make_arm(setup: Setup) -> Node:
    """The arm's collision checker and its speed decisions, with a timer for forecasts that do not come."""
    source, parameters = read_rig(setup.rig()), setup.chain_parameters()
    workspace = working_volume(source, parameters)
    return make_arm_node(setup.bus, setup.clock, workspace, parameters, setup.timers)


def working_volume(source: RigSource, parameters: ChainParameters) -> Float64:
    """[2, 3] corners of the volume that is modelled, m."""
    return workspace_for(source.rig, FrameAssembler(source.rig.cameras, parameters.synchronizer.width).cameras)


class TwinNode(Node):
    """The chain's nodes but the arm's; latency counts from the first forecast on: what came before was start-up."""

    def __init__(self, setup: Setup, source: RigSource, parameters: ChainParameters) -> None:
        super().__init__(setup.name, setup.bus, setup.clock)
        self._latency = Latency(ASSUMED_LATENCY_NS, is_measured=True)
        bus = setup.bus
        workspace = working_volume(source, parameters)
        chain = Chain(
            bus, setup.clock, workspace, parameters, self._latency, lambda: bus.dropped(FRAMES), False, setup.say
        )
        self._chain = chain
        self._nodes: Sequence[Node] = chain.nodes
        self._bus = bus

    def on_configure(self) -> None:
        for node in reversed(self._nodes):
            node.configure()
        self.bus.subscribe(FORECAST, self._on_forecast)

    def on_activate(self) -> None:
        for node in reversed(self._nodes):
            node.activate()

    def on_deactivate(self) -> None:
        for node in self._nodes:
            node.deactivate()

    def on_cleanup(self) -> None:
        for node in self._nodes:
            node.cleanup()

    def _on_forecast(self, _: Any) -> None:
        """All that comes of a set is out: what is left of its time is the model's."""
        self._latency.start()
        self._chain.rest(lambda: not any(self._bus.is_waiting(topic) for topic in (FRAMES, TRUSTED_FRAMES)))
