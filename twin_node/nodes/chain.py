"""The chain behind the synchroniser: drift watch, window model, forecast and status on one bus."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from twin_node.forecast import Forecaster, default_grid
from twin_node.messages.convert import Diagnosis
from twin_node.model import WindowModel
from twin_node.nodes.chain_parameters import ChainParameters
from twin_node.nodes.drift import DriftNode
from twin_node.nodes.forecast import ForecastNode
from twin_node.nodes.latency import OFTEN, Latency
from twin_node.nodes.model import Following, ModelNode
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
    """The nodes from frame sets to obstacles, made and wired; the arm's reads messages only, and is no part of it."""

    def __init__(
        self,
        bus: Bus,
        clock: Clock,
        workspace: Float64,
        parameters: ChainParameters,
        latency: Latency,
        following: Following = Following.IN_TURN,
        dropped: Callable[[], int] = lambda: 0,
        say: Callable[[str], None] | None = None,
        kept: Path | None = None,
        is_ending: Callable[[], bool] = lambda: False,
    ) -> None:
        """`workspace` [2, 3] m; `following`: see `ModelNode`; `dropped()`: frame sets dropped so far, for the status.

        `kept`: see `DriftNode` and `Trial`; `is_ending`: see `Trial`. Where the size is to be measured it is if there
        is a user to `say` it to; else the parameters stand as they are.
        """
        grid = default_grid(workspace, parameters.grid.voxel_size)
        self._latency = latency
        self._forecast_node = ForecastNode(
            *(bus, clock, lambda: Forecaster(grid, parameters.forecast, parameters.arm.arm())),
            *(parameters.obstacles, latency, dropped),
        )
        self.status = StatusNode(bus, clock, latency, lambda: self.model_node.parameters_count, dropped)
        trial = None
        if say is not None and parameters.size.name is SizeChoice.AUTO:
            arm, budget_ms = parameters.arm.arm(), parameters.size.budget_ms
            trial = Trial(parameters.model, parameters.forecast, arm, grid, budget_ms, say, is_ending, kept)
        if following is Following.APART and not parameters.model.own_process:
            following = Following.IN_TIME
        self.model_node = ModelNode(
            *(bus, clock, make_model(parameters), following, trial),
            is_too_slow=lambda: latency.slowed >= OFTEN,
            on_anew=self._begin_anew,
        )
        self._nodes: Sequence[Node] = (
            self.status,
            DriftNode(bus, clock, parameters.drift, kept),
            self.model_node,
            self._forecast_node,
        )

    @property
    def forecaster(self) -> Forecaster:
        """The one that forecasts now."""
        return self._forecast_node.forecaster

    def _begin_anew(self, stamp: int) -> None:
        """The model begins anew with the set of a stamp, ns."""
        self._latency.begin_anew()
        self._forecast_node.begin_anew(stamp)

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

    def diagnoses(self) -> tuple[Diagnosis, ...]:
        """How its nodes are doing, see `Node.diagnoses`."""
        return tuple(diagnosis for node in self._nodes for diagnosis in node.diagnoses())

    def cleanup(self) -> None:
        """Cleans up every node, the first of the chain first."""
        for node in self._nodes:
            node.cleanup()
