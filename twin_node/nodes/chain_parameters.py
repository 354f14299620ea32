"""What can be set of the chain's nodes, in files and by sizes; loads no torch: every process of a launch reads it."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from pathlib import Path
from typing import get_type_hints

from twin_node import resources
from twin_node.forecast import CoverParameters, ForecastParameters, GridParameters
from twin_node.model import ModelParameters
from twin_node.nodes.arm_parameters import ArmParameters
from twin_node.nodes.launch.arguments import parameters_alone
from twin_node.nodes.launch.kinds import CHAIN_SECTIONS, check_section, check_shared
from twin_node.nodes.sizes import SHIPPED, SIZES, SizeChoice, SizeParameters
from twin_node.nodes.synchronizer import SynchronizerParameters
from twin_node.rig.drift import DriftParameters
from twin_node.runtime.parameters import EVERY_NODE, ParameterError, Sections, fill, values_of

DEFAULT_PARAMETERS = "launch/replay.yaml"


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

    def __post_init__(self) -> None:
        """Raises `ParameterError` where the cover may have more obstacles than the arm has room for."""
        if self.arm.max_obstacles < self.obstacles.most:
            raise ParameterError(
                f"arm: max_obstacles: expected room for the {self.obstacles.most} obstacles that most_moving, "
                f"most_seen, most_static and most_unknown of 'obstacles' allow, found {self.arm.max_obstacles}; raise "
                "it, or lower those"
            )


def load_parameters(path: Path | None) -> ChainParameters:
    """Parameters from a ROS parameter file; None: the file that ships with the package.

    Raises `ParameterError` for a key that does not exist, with the nearest one, and `GraphError` for such a section.
    """
    path = resources.find(path or DEFAULT_PARAMETERS)
    sections = parameters_alone(path)
    for name, values in sections.items():
        if name == EVERY_NODE:
            check_shared(values, f"{path}: {name}")
        elif name not in CHAIN_SECTIONS:
            check_section(name, values, str(path))
    return chain_parameters(sections, str(path))


def chain_parameters(sections: Sections, where: str) -> ChainParameters:
    """The parameters that a file's sections give the chain's nodes, at the size that they name.

    Raises `ParameterError`, naming `where`, for a key that does not exist, with the nearest one.
    """
    given = {name: values_of(kind, name, sections) for name, kind in get_type_hints(ChainParameters).items()}
    return sized(fill(ChainParameters, given, where), where)


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
            "track.steps, birth.per_set and birth.moving_share as they ship, which a size decides, found others; leave "
            "them out, or set size.name to given"
        )
    return parameters if choice is SizeChoice.AUTO else at_size(parameters, choice.value)


def at_size(parameters: ChainParameters, name: str) -> ChainParameters:
    """The parameters at a size of `SIZES`."""
    size = SIZES[name]
    synchronizer = dataclasses.replace(parameters.synchronizer, width=size.width)
    return dataclasses.replace(parameters, synchronizer=synchronizer, model=size.model(parameters.model))
