"""The nodes that launch files can name, and where they are made."""

from __future__ import annotations

import dataclasses
import difflib
import importlib
from collections.abc import Callable, Mapping, Sequence
from importlib.metadata import entry_points
from typing import Any

from twin_node.nodes.topics import GraphError

ENTRY_POINTS = "twin_node.nodes"
"""Entry-point group under which other packages offer nodes: functions from a `live.setup.Setup` to a `Node`.
One may have the name of a node below, and takes its place. What is made takes nothing that only one process can have
(ports, devices, files to write) before it is configured: spare processes make their nodes ahead."""

KINDS = {
    "arm": "twin_node.nodes.live.beside_twin:make_arm",
    "cell": "twin_node.nodes.live.cell:make_cell",
    "cameras": "twin_node.nodes.live.cameras:make_cameras",
    "moveit": "twin_node.nodes.live.moveit:make_moveit",
    "player": "twin_node.nodes.live.player:make_player",
    "recorder": "twin_node.nodes.live.recorder:make_recorder",
    "speed_scaling": "twin_node.nodes.live.speed_scaling:make_speed_scaling",
    "synchronizer": "twin_node.nodes.live.beside_twin:make_synchronizer",
    "twin": "twin_node.nodes.live.twin:make_twin",
    "ur_driver": "twin_node.nodes.live.arm_driver:make_ur_driver",
    "ur_sim": "twin_node.nodes.live.arm_stand_in:make_ur_sim",
    "viewer": "twin_node.nodes.live.viewer:make_viewer",
    "viewer_topics": "twin_node.nodes.live.viewer_topics:make_viewer_topics",
}
"""Node name -> module and function."""

PARAMETERS = {
    "cameras": "twin_node.nodes.live.cameras:CamerasParameters",
    "cell": "twin_node.nodes.live.cell:CellParameters",
    "moveit": "twin_node.nodes.live.moveit:MoveItParameters",
    "player": "twin_node.nodes.live.player:PlayParameters",
    "recorder": "twin_node.nodes.live.recorder:RecordParameters",
    "speed_scaling": "twin_node.nodes.live.speed_scaling:SpeedScalingParameters",
    "ur_driver": "twin_node.arm.ur:UrParameters",
    "ur_sim": "twin_node.nodes.live.arm_stand_in:UrSimParameters",
    "viewer": "twin_node.nodes.viewer.live:ViewerParameters",
}
"""Node name -> module and class of the parameters of its own section."""

SHARED = {"rig", "use_sim_time"}
"""What the section for every node says that is no single node's: where the rig is, and whether time is `/clock`'s."""

SOURCES = ("cameras", "player", "recorder", "ur_driver", "ur_sim")
"""Nodes that a jump in time does not concern: they go by a clock that has none, or only write down what comes."""

TOGETHER = ("synchronizer", "twin")
"""Nodes that only have a meaning in one process: sets of images, and all else that has no type, do not leave it."""

IN_LOCKSTEP = ("player", "synchronizer", "twin", "arm", "recorder")
"""Nodes that a launch in lockstep stands for."""

CHAIN_SECTIONS = {
    "synchronizer": "twin_node.nodes.synchronizer:SynchronizerParameters",
    "drift": "twin_node.rig.drift:DriftParameters",
    "model": "twin_node.model:ModelParameters",
    "grid": "twin_node.forecast:GridParameters",
    "forecast": "twin_node.forecast:ForecastParameters",
    "obstacles": "twin_node.forecast:CoverParameters",
    "arm": "twin_node.nodes.arm_parameters:ArmParameters",
    "size": "twin_node.nodes.sizes:SizeParameters",
}
"""Sections that the chain's nodes read -> module and class of their parameters, as in
`nodes.chain_parameters.ChainParameters`."""

WITHOUT_PARAMETERS = ("twin", "viewer_topics")
"""Nodes that read the chain's sections alone, none of their own."""


def check_kind(name: str, where: str) -> None:
    """Raises `GraphError` for a name that no node has, with the nearest one."""
    _check_known(name, {*KINDS, *_foreign()}, where)


def check_together(nodes: Sequence[str], where: str) -> None:
    """Raises `GraphError` for nodes of one process that want for another one there; those of another package may do."""
    held = [node for node in TOGETHER if node in nodes]
    missing = [node for node in TOGETHER if node not in nodes]
    if held and missing and not any(map(is_foreign, nodes)):
        raise GraphError(
            f"{where}: found node '{held[0]}' without '{missing[0]}': the sets of images that go between them do not "
            f"leave their process; write nodes: [{', '.join(TOGETHER)}]"
        )


def check_section(name: str, values: Mapping[str, Any], where: str) -> None:
    """Raises `GraphError` for parameters of a node that there is not, or that reads none of them."""
    _check_known(name, {*CHAIN_SECTIONS, *KINDS, *_foreign()}, where)
    if values and name in WITHOUT_PARAMETERS and not is_foreign(name):
        raise GraphError(
            f"{where}: node '{name}' has no parameters of its own, found {', '.join(map(str, values))}; those of the "
            f"chain are in {', '.join(CHAIN_SECTIONS)}"
        )


def check_shared(values: Mapping[str, Any], where: str) -> None:
    """Raises `GraphError` for parameters of every node that none of ours has."""
    unknown = set(values) - SHARED
    if not unknown:
        return
    kinds = map(_loaded, [*CHAIN_SECTIONS.values(), *PARAMETERS.values()])
    known = SHARED.union(*({field.name for field in dataclasses.fields(kind)} for kind in kinds))
    for key in sorted(map(str, unknown - known)):
        near = difflib.get_close_matches(key, known, n=1)
        hint = f"did you mean '{near[0]}'?" if near else "write it into the section of its node"
        raise GraphError(f"{where}: unknown parameter '{key}', which no node has; {hint}")


def is_foreign(name: str) -> bool:
    """Whether another package makes the node."""
    return name in _foreign()


def find_factory(name: str) -> Callable[[Any], Any]:
    """The function that makes a node; the name has been checked."""
    foreign = _foreign()
    if name in foreign:
        made: Callable[[Any], Any] = foreign[name].load()
        return made
    factory: Callable[[Any], Any] = _loaded(KINDS[name])
    return factory


def nearest(name: str, known: set[str]) -> str:
    """What was probably meant, or all that could have been."""
    near = difflib.get_close_matches(name, known, n=1)
    return f"did you mean '{near[0]}'?" if near else f"known: {', '.join(sorted(known)) or 'none'}"


def _check_known(name: str, known: set[str], where: str) -> None:
    if name in known:
        return
    own = name.rpartition("/")[2]
    hint = f"write '{own}': a file has no namespaces" if own in known else nearest(name, known)
    raise GraphError(f"{where}: unknown node '{name}'; {hint}")


def _loaded(place: str) -> Any:
    """What a module has by a name."""
    module, _, name = place.partition(":")
    return getattr(importlib.import_module(module), name)


def _foreign() -> dict[str, Any]:
    return {point.name: point for point in entry_points(group=ENTRY_POINTS)}
