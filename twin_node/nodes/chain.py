"""The chain behind the synchroniser: drift watch, window model, forecast, arm and status on one bus."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from twin_node.forecast import Forecaster, default_grid
from twin_node.model import WindowModel
from twin_node.nodes.arm import make_arm_node
from twin_node.nodes.chain_parameters import ChainParameters
from twin_node.nodes.drift import DriftNode
from twin_node.nodes.forecast import ForecastNode
from twin_node.nodes.latency import Latency
from twin_node.nodes.model import ModelNode
from twin_node.nodes.sizes import SizeChoice
from twin_node.nodes.sizing import Trial
from twin_node.nodes.status import StatusNode
from twin_node.runtime.bus import Bus
from twin_node.runtime.clock import Clock
from twin_node.runtime.node import Node
from twin_node.scene import Float64


def make_model(parameters: ChainParameters) -> WindowModel:
    """A fresh window model as the chain's."""
    return WindowModel(parameters.model, arm=parameters.arm.arm())


class Chain:
    """The nodes from frame sets to the arm's speed, made and wired."""

    def __init__(
        self,
        bus: Bus,
        clock: Clock,
        workspace: Float64,
        parameters: ChainParameters,
        latency: Latency,
        dropped: Callable[[], int],
        with_arm: bool = True,
        say: Callable[[str], None] | None = None,
        own_process: bool = False,
    ) -> None:
        """`workspace` [2, 3] m; `dropped()`: frame sets dropped so far, for the status.

        `own_process`: sets come by the wall clock, so the model may follow them in one, see `ModelNode`.

        The arm's node reads messages only, so it can stand in another process: `with_arm` False leaves it out. Where
        the size is to be measured it is if there is a user to `say` it to; else the parameters stand as they are.
        """
        grid = default_grid(workspace, parameters.grid.voxel_size)
        self.forecaster = Forecaster(grid, parameters.forecast, parameters.arm.arm())
        self.status = StatusNode(bus, clock, latency, lambda: self.model_node.parameters_count, dropped)
        trial = None
        if say is not None and parameters.size.name is SizeChoice.AUTO:
            arm, budget_ms = parameters.arm.arm(), parameters.size.budget_ms
            trial = Trial(parameters.model, parameters.forecast, arm, grid, budget_ms, say)
        own_process = own_process and parameters.model.own_process
        self.model_node = ModelNode(bus, clock, make_model(parameters), trial, latency.is_measured, own_process)
        self._nodes: Sequence[Node] = (
            self.status,
            DriftNode(bus, clock, parameters.drift),
            self.model_node,
            ForecastNode(bus, clock, self.forecaster, parameters.obstacles, latency),
            *([make_arm_node(bus, clock, workspace, parameters.arm)] if with_arm else []),
        )

    def start(self) -> None:
        """Configures and activates all."""
        self.configure()
        self.activate()

    def stop(self) -> None:
        """Deactivates and cleans up all."""
        self.deactivate()
        self.cleanup()

    def configure(self) -> None:
        """Configures every node, the last of the chain first, so that no message is missed."""
        for node in reversed(self._nodes):
            node.configure()

    def activate(self) -> None:
        """Activates every node, the last of the chain first."""
        for node in reversed(self._nodes):
            node.activate()

    def deactivate(self) -> None:
        """Deactivates every node, the first of the chain first."""
        for node in self._nodes:
            node.deactivate()

    def cleanup(self) -> None:
        """Cleans up every node, the first of the chain first."""
        for node in self._nodes:
            node.cleanup()
