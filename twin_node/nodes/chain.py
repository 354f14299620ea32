"""The chain behind the synchroniser: drift watch, window model, forecast, arm and status on one bus."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from twin_node import resources
from twin_node.arm import ArmCollisionChecker, default_path
from twin_node.forecast import CoverParameters, Forecaster, ForecastParameters, default_grid
from twin_node.model import ModelParameters, WindowModel
from twin_node.model.stages import Proceed, unhurried
from twin_node.nodes.arm import ArmNode, ArmParameters
from twin_node.nodes.drift import DriftNode
from twin_node.nodes.forecast import ForecastNode
from twin_node.nodes.latency import Latency
from twin_node.nodes.launch.kinds import CHAIN_SECTIONS, KINDS
from twin_node.nodes.model import ModelNode
from twin_node.nodes.sizes import SHIPPED, SIZES, SizeChoice, SizeParameters
from twin_node.nodes.sizing import Trial
from twin_node.nodes.status import StatusNode
from twin_node.nodes.synchronizer import SynchronizerParameters
from twin_node.rig.drift import DriftParameters
from twin_node.runtime.bus import Bus
from twin_node.runtime.clock import Clock
from twin_node.runtime.executor import Timers
from twin_node.runtime.node import Node
from twin_node.runtime.parameters import EVERY_NODE, ParameterError, fill, read_parameters
from twin_node.scene import Float64

DEFAULT_PARAMETERS = "launch/replay.yaml"
OTHER_SECTIONS = {EVERY_NODE, *KINDS} - {*CHAIN_SECTIONS}
"""Sections of launch files that say nothing of the chain."""


@dataclass(frozen=True)
class GridParameters:
    """The voxels that occupancy is reported on."""

    voxel_size: float = 0.02
    """Edge of a voxel, m."""


@dataclass(frozen=True)
class ChainParameters:
    """Parameters of every node of the chain; a parameter file has one section per field."""

    synchronizer: SynchronizerParameters = field(default_factory=SynchronizerParameters)
    drift: DriftParameters = field(default_factory=DriftParameters)
    model: ModelParameters = field(default_factory=ModelParameters)
    grid: GridParameters = field(default_factory=GridParameters)
    forecast: ForecastParameters = field(default_factory=ForecastParameters)
    obstacles: CoverParameters = field(default_factory=CoverParameters)
    arm: ArmParameters = field(default_factory=ArmParameters)
    size: SizeParameters = field(default_factory=SizeParameters)


def load_parameters(path: Path | None) -> ChainParameters:
    """Parameters from a ROS parameter file; None: the file that ships with the package.

    Raises `ParameterError` for a section or key that does not exist, with the nearest one.
    """
    path = resources.find(path or DEFAULT_PARAMETERS)
    sections = {name: values for name, values in read_parameters(path).items() if name not in OTHER_SECTIONS}
    known = {f.name for f in dataclasses.fields(ChainParameters)}
    for name in sections:
        if name not in known:
            raise ParameterError(f"{path}: unknown node '{name}'; expected some of {', '.join(sorted(known))}")
    return sized(fill(ChainParameters, sections, str(path)), str(path))


def sized(parameters: ChainParameters, where: str) -> ChainParameters:
    """The parameters at the size that they name; where they name none, or one that is to be measured, as they are.

    Raises `ParameterError`, naming `where`, for a size beside parameters of the model that a size decides.
    """
    choice = parameters.size.name
    if choice is SizeChoice.GIVEN:
        return parameters
    if SIZES[SHIPPED].model(parameters.model) != parameters.model:
        raise ParameterError(
            f"{where}: size: name: {choice.value}: expected the model's gaussians_per_pixel, most_gaussians, "
            "track.steps and birth.per_set as they ship, which a size decides, found others; leave them out, or set "
            "size.name to given"
        )
    return parameters if choice is SizeChoice.AUTO else at_size(parameters, choice.value)


def at_size(parameters: ChainParameters, name: str) -> ChainParameters:
    """The parameters at a size of `SIZES`."""
    size = SIZES[name]
    synchronizer = dataclasses.replace(parameters.synchronizer, width=size.width)
    return dataclasses.replace(parameters, synchronizer=synchronizer, model=size.model(parameters.model))


def make_model(parameters: ChainParameters) -> WindowModel:
    """A fresh window model as the chain's."""
    return WindowModel(parameters.model, arm=parameters.arm.arm())


def make_arm_node(
    bus: Bus, clock: Clock, workspace: Float64, parameters: ChainParameters, timers: Timers | None = None
) -> ArmNode:
    """The arm's node of a chain; `workspace` [2, 3] m. `timers`: see `ArmNode`."""
    arm = parameters.arm.arm()
    return ArmNode(bus, clock, ArmCollisionChecker(arm), default_path(arm, workspace), parameters.arm, timers)


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
    ) -> None:
        """`workspace` [2, 3] m; `dropped()`: frame sets dropped so far, for the status.

        The arm's node reads messages only, so it can stand in another process: `with_arm` False leaves it out. Where
        the size is to be measured it is if there is a user to `say` it to; else the parameters stand as they are.
        """
        grid = default_grid(workspace, parameters.grid.voxel_size)
        self.forecaster = Forecaster(grid, parameters.forecast, parameters.arm.arm())
        self.status = StatusNode(bus, clock, latency, lambda: self.model.parameters_count, dropped)
        trial = None
        if say is not None and parameters.size.name is SizeChoice.AUTO:
            arm, budget_ms = parameters.arm.arm(), parameters.size.budget_ms
            trial = Trial(parameters.model, parameters.forecast, arm, grid, budget_ms, say)
        self._model_node = ModelNode(bus, clock, make_model(parameters), trial)
        self.nodes: Sequence[Node] = (
            self.status,
            DriftNode(bus, clock, parameters.drift),
            self._model_node,
            ForecastNode(bus, clock, self.forecaster, parameters.obstacles, latency),
            *([make_arm_node(bus, clock, workspace, parameters)] if with_arm else []),
        )

    @property
    def model(self) -> WindowModel:
        """What follows the images: another one once its size has been measured."""
        return self._model_node.model

    def start(self) -> None:
        """Configure and activate every node, the last of the chain first, so that no message is missed."""
        for node in reversed(self.nodes):
            node.configure()
            node.activate()

    def rest(self, proceed: Proceed = unhurried) -> None:
        """Uses the time between two sets, see `ModelNode.rest`."""
        self._model_node.rest(proceed)

    def stop(self) -> None:
        """Deactivate and clean up every node, the first of the chain first."""
        for node in self.nodes:
            node.deactivate()
            node.cleanup()
