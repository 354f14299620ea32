"""The nodes that launch files can name, and where they are made."""

from __future__ import annotations

import difflib
import importlib
from collections.abc import Callable
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
    "player": "twin_node.nodes.live.player:make_player",
    "recorder": "twin_node.nodes.live.recorder:make_recorder",
    "synchronizer": "twin_node.nodes.live.beside_twin:make_synchronizer",
    "twin": "twin_node.nodes.live.twin:make_twin",
    "ur_driver": "twin_node.nodes.live.arm_driver:make_ur_driver",
    "ur_sim": "twin_node.nodes.live.arm_stand_in:make_ur_sim",
    "viewer": "twin_node.nodes.live.viewer:make_viewer",
    "viewer_topics": "twin_node.nodes.live.viewer_topics:make_viewer_topics",
}
"""Node name -> module and function."""

SOURCES = ("cameras", "cell", "player", "recorder", "ur_driver", "ur_sim")
"""Nodes that a jump in time does not concern: they make the time, or only write down what comes."""

IN_LOCKSTEP = ("player", "synchronizer", "twin", "arm", "recorder")
"""Nodes that a launch in lockstep stands for."""

CHAIN_SECTIONS = ("synchronizer", "drift", "model", "grid", "forecast", "obstacles", "arm", "size")
"""Sections that the chain's nodes read; `nodes.chain_parameters.ChainParameters` documents them."""


def check_kind(name: str, where: str) -> None:
    """Raises `GraphError` for a name that no node has, with the nearest one."""
    known = {*KINDS, *_foreign()}
    if name not in known:
        raise GraphError(f"{where}: unknown node '{name}'; {nearest(name, known)}")


def is_foreign(name: str) -> bool:
    """Whether another package makes the node."""
    return name in _foreign()


def find_factory(name: str) -> Callable[[Any], Any]:
    """The function that makes a node; the name has been checked."""
    foreign = _foreign()
    if name in foreign:
        made: Callable[[Any], Any] = foreign[name].load()
        return made
    module, _, function = KINDS[name].partition(":")
    factory: Callable[[Any], Any] = getattr(importlib.import_module(module), function)
    return factory


def nearest(name: str, known: set[str]) -> str:
    """What was probably meant, or all that could have been."""
    near = difflib.get_close_matches(name, known, n=1)
    return f"did you mean '{near[0]}'?" if near else f"known: {', '.join(sorted(known))}"


def _foreign() -> dict[str, Any]:
    return {point.name: point for point in entry_points(group=ENTRY_POINTS)}
