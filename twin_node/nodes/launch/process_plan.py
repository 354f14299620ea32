"""What a launch file says of a process: its nodes, and how it is treated."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from twin_node.errors import told
from twin_node.nodes.launch.kinds import check_kind, nearest
from twin_node.nodes.topics import GraphError

PROCESS_NAME = re.compile(r"[\w.-]+")
MOST_NICE = 19
_WORDS = {"True": "true", "False": "false"}
"""What an argument that is true or false is within a text, and in YAML."""


@dataclass(frozen=True)
class ProcessPlan:
    """One process."""

    name: str
    nodes: tuple[str, ...]
    restarts: bool = True
    """Started again when it fails."""
    ends_launch: bool = False
    """When it has finished, everything else is brought down."""
    has_spare: bool = False
    """A second process waits with its nodes made, and takes over when the first fails."""
    niceness: int = 0
    """How far it gives way to the launch's others where all want the processors, 0 to `MOST_NICE`, as `nice` has it."""
    place: int = 0
    """Among all processes of the file, those left out by their `if` too."""


def is_wanted(entry: Any) -> bool:
    """Whether a process's `if` holds: it is neither empty nor false, and both sides of an `==` are equal.

    An argument that is true or false may be compared to either as YAML has it, too.
    """
    condition = entry.get("if", True) if isinstance(entry, Mapping) else True
    if isinstance(condition, str) and "==" in condition:
        left, _, right = condition.partition("==")
        return _WORDS.get(left.strip(), left.strip()) == _WORDS.get(right.strip(), right.strip())
    return condition not in ("", "false", "False", False, None, 0)


def read_process(name: str, entry: Any, path: Path) -> ProcessPlan:
    """A process of the launch file at `path`. Raises `GraphError` for what is no such entry."""
    where = f"{path}: process '{name}'"
    if not PROCESS_NAME.fullmatch(name):
        raise GraphError(f"{where}: expected a name of letters, digits, _, - and ., which its log file is named after")
    if not isinstance(entry, Mapping):
        raise GraphError(f"{where}: expected keys and values with a list of nodes, found {told(entry)}")
    known = {"nodes", "restart", "ends_launch", "spare", "nice", "if"}
    for key in entry:
        if key not in known:
            raise GraphError(f"{where}: unknown key '{key}'; {nearest(str(key), known)}")
    nodes = named_nodes(entry, where)
    for node in nodes:
        check_kind(node, where)
    if not nodes:
        raise GraphError(f"{where}: expected a list of nodes, found none")
    niceness = entry.get("nice", 0)
    if isinstance(niceness, bool) or not isinstance(niceness, int) or not 0 <= niceness <= MOST_NICE:
        raise GraphError(f"{where}: nice: expected a whole number from 0 to {MOST_NICE}, found {told(niceness)}")
    return ProcessPlan(
        name,
        nodes,
        restarts=read_flag(entry, "restart", True, where),
        ends_launch=read_flag(entry, "ends_launch", False, where),
        has_spare=read_flag(entry, "spare", False, where),
        niceness=niceness,
    )


def named_nodes(entry: Mapping[str, Any], where: str) -> tuple[str, ...]:
    """What a process's entry lists as its nodes. Raises `GraphError` for what is no list."""
    given = entry.get("nodes") or ()
    if not isinstance(given, list | tuple):
        raise GraphError(f"{where}: nodes: expected a list, found {given!r}; write [{given}]")
    return tuple(map(str, given))


def read_flag(section: Mapping[str, Any], key: str, default: bool, where: str) -> bool:
    """A key that is true or false. Raises `GraphError` for anything else, also for such a word in quotes."""
    value = section.get(key, default)
    if not isinstance(value, bool):
        raise GraphError(f"{where}: {key}: expected true or false, without quotes, found {told(value)}")
    return value
