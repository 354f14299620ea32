"""What stands before and behind the twin of a live graph, in processes of their own, which do without torch."""

from __future__ import annotations

from collections.abc import Iterable

from twin_node.arm.ur import DriverMode, UrParameters
from twin_node.nodes.arm import make_arm_node
from twin_node.nodes.live.rig_source import read_rig, working_volume
from twin_node.nodes.live.setup import Setup
from twin_node.nodes.synchronizer import SynchronizerNode
from twin_node.nodes.topics import FOLLOW, GraphError, kind_of
from twin_node.robot import UR_NAMES
from twin_node.runtime.node import Node
from twin_node.runtime.parameters import EVERY_NODE
from twin_node.runtime.rmw_zenoh import Endpoint, EntityKind

DRIVER = "ur_driver"
"""Name of the driver's node and of its section."""


def make_synchronizer(setup: Setup) -> Node:
    """The synchroniser, with a timer for its deadlines."""
    source = read_rig(setup.rig())
    parameters = setup.chain_parameters()
    names = parameters.arm.arm().joint_names
    return SynchronizerNode(
        setup.bus, setup.clock, source.cameras, source.rig, parameters.synchronizer, setup.timers, names
    )


def make_arm(setup: Setup) -> Node:
    """The arm's collision checker and its speed decisions, with a timer for forecasts that do not come.

    Raises `GraphError` where the driver of the same launch drives another arm.
    """
    source, parameters = read_rig(setup.rig()), setup.chain_parameters()
    _check_driven(setup, parameters.arm.model)
    workspace = working_volume(source, parameters.synchronizer.width)
    is_told = _is_launched_servoing(setup)
    return make_arm_node(
        setup.bus,
        setup.clock,
        workspace,
        parameters.arm,
        setup.timers,
        lambda: is_told or _is_servoing(setup.endpoints()),
    )


def _is_launched_servoing(setup: Setup) -> bool:
    """Whether the driver of the same launch servoes its arm."""
    given = {**setup.sections.get(EVERY_NODE, {}), **setup.sections.get(DRIVER, {})}
    return given.get("mode") == DriverMode.SERVO.value


def _is_servoing(endpoints: Iterable[Endpoint]) -> bool:
    """Whether a driver of another launch does: only then it waits for trajectories, on whatever topic."""
    path = kind_of(FOLLOW).msgtype
    return any(
        endpoint.kind is EntityKind.SUBSCRIBER and endpoint.node.name == DRIVER and endpoint.msgtype == path
        for endpoint in endpoints
    )


def _check_driven(setup: Setup, model: str) -> None:
    """All UR arms name their joints alike: nothing that comes tells that another one is judged than the one driven."""
    driver = setup.sections.get(DRIVER, {})
    driven = str(driver.get("model", UrParameters.model))
    if driver.get("robot") and driven != model and {driven, model} <= set(UR_NAMES):
        raise GraphError(
            f"{setup.where}: arm.model: expected the arm that is driven, {driven}, found {model}; give 'arm' and "
            "'ur_driver' the same 'model'"
        )
