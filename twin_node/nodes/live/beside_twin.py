"""What stands before and behind the twin of a live graph, in processes of their own, which do without torch."""

from __future__ import annotations

from twin_node.arm.ur import UrParameters
from twin_node.nodes.arm import make_arm_node
from twin_node.nodes.live.rig_source import read_rig, working_volume
from twin_node.nodes.live.setup import Setup
from twin_node.nodes.synchronizer import SynchronizerNode
from twin_node.nodes.topics import GraphError
from twin_node.robot import UR_NAMES
from twin_node.runtime.node import Node


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
    return make_arm_node(setup.bus, setup.clock, workspace, parameters.arm, setup.timers)


def _check_driven(setup: Setup, model: str) -> None:
    """All UR arms name their joints alike: nothing that comes tells that another one is judged than the one driven."""
    driver = setup.sections.get("ur_driver", {})
    driven = str(driver.get("model", UrParameters.model))
    if driver.get("robot") and driven != model and {driven, model} <= set(UR_NAMES):
        raise GraphError(
            f"{setup.where}: arm.model: expected the arm that is driven, {driven}, found {model}; give 'arm' and "
            "'ur_driver' the same 'model'"
        )
