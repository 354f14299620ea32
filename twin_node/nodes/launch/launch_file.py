"""Launch files: which nodes run in which processes, with which parameters, and what the user can set."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from twin_node import resources
from twin_node.errors import kind_of, told
from twin_node.nodes.launch.arguments import (
    Argument,
    arguments_of,
    launch_section,
    parameters_alone,
    parsed,
    substituted,
    table_of,
    values_given,
    with_home,
)
from twin_node.nodes.launch.kinds import (
    CHAIN_SECTIONS,
    IN_LOCKSTEP,
    KINDS,
    check_section,
    check_shared,
    is_foreign,
)
from twin_node.nodes.launch.process_plan import ProcessPlan, is_wanted, named_nodes, read_flag, read_process
from twin_node.nodes.live.rig_source import kind_of_camera
from twin_node.nodes.topics import GraphError, check_remaps, parse_remaps
from twin_node.runtime.parameters import EVERY_NODE, LAUNCH, Sections, fill, merged, read_parameters
from twin_node.runtime.qos import KindOf
from twin_node.runtime.zenoh_session import ZenohParameters

NAMESPACE = "__ns"
"""What ROS has in place of a topic to say in which namespace nodes are."""


@dataclass(frozen=True)
class LaunchPlan:
    """What is to run, all values filled in."""

    path: Path
    where: str
    """What errors about parameters name: the file, and what was given beside it."""
    processes: tuple[ProcessPlan, ...]
    sections: Sections
    follows_clock: bool = False
    """Nodes take time from `/clock` (`use_sim_time`)."""
    is_lockstep: bool = False
    """All nodes in one thread, driven by the player's log: repeatable to the byte."""
    zenoh: ZenohParameters = field(default_factory=ZenohParameters)
    remaps: Mapping[str, str] = field(default_factory=dict)
    """Of all nodes: their own names of topics -> those on the graph."""


def read_arguments(path: Path | str) -> tuple[Argument, ...]:
    """The arguments of a launch file. Raises `GraphError` where it is none."""
    path = resources.find(path)
    return arguments_of(launch_section(path), path)


def read_launch_file(
    path: Path | str,
    given: Sequence[str] = (),
    parameters: Sequence[str] = (),
    parameter_files: Sequence[Path] = (),
) -> LaunchPlan:
    """The plan of a launch file with the user's `name:=value` arguments and `node.key:=value` parameters.

    `parameter_files`: ROS parameter files whose values take the place of the launch file's; later ones win, and
    `parameters` win over all.

    Raises `GraphError` or `ParameterError` for unknown names, with the nearest known one, and for missing values.
    """
    path = resources.find(path)
    section = launch_section(path)
    values = values_given(arguments_of(section, path), given, path)
    section = substituted(section, values, path)
    entries = table_of(section, "processes", path)
    processes = tuple(
        replace(read_process(str(name), entry, path), place=place)
        for place, (name, entry) in enumerate(entries.items())
        if is_wanted(entry)
    )
    if not processes:
        raise GraphError(_nothing_to_run(path, entries, given))
    _check_nodes_once(processes, path)
    is_lockstep = read_flag(section, "lockstep", False, f"{path}: {LAUNCH}")
    if is_lockstep:
        _check_lockstep(processes, path)
    sections = substituted(read_parameters(path), values, path)
    for file in parameter_files:
        given_here = parameters_alone(resources.find(file))
        _check_sections(given_here, str(file), processes)
        sections = merged(sections, given_here)
    _set_parameters(sections, parameters)
    _check_takes_part(parameters, entries, path)
    where = _named(path, parameter_files, parameters)
    _check_sections(sections, where, processes)
    return LaunchPlan(
        path,
        where,
        processes,
        sections,
        follows_clock=_follows_clock(section, sections, where),
        is_lockstep=is_lockstep,
        zenoh=fill(ZenohParameters, section.get("zenoh") or {}, f"{path}: {LAUNCH}: zenoh"),
    )


def remapped(plan: LaunchPlan, remaps: Sequence[str]) -> LaunchPlan:
    """The plan with `from:=to` names of topics for all its nodes, and with `__ns:=/name` for their namespace.

    Raises `GraphError` for a topic that no node has, unless a node of another package takes part, and in lockstep,
    `WireError` for what is no namespace.
    """
    namespaces = [remap.partition(":=")[2] for remap in remaps if remap.startswith(f"{NAMESPACE}:=")]
    pairs = parse_remaps([remap for remap in remaps if not remap.startswith(f"{NAMESPACE}:=")])
    if plan.is_lockstep and namespaces:
        raise GraphError("namespace: expected where there is a graph; in lockstep there is none, so leave it out")
    if plan.is_lockstep and pairs:
        raise GraphError(
            "--remap: in lockstep there is no graph; rename what the log holds with -p player.remap:=[A:=B]"
        )
    if not _have_foreign(plan.processes):
        check_remaps(pairs, _kinds_of_cameras(plan.sections))
    zenoh = replace(plan.zenoh, namespace=namespaces[-1]) if namespaces else plan.zenoh
    return replace(plan, remaps=pairs, zenoh=zenoh)


def _kinds_of_cameras(sections: Sections) -> KindOf:
    """What topics of the rig's cameras carry, as it names them."""
    rig = sections.get(EVERY_NODE, {}).get("rig")
    image, depth = (str(rig.get(key) or "") if isinstance(rig, Mapping) else "" for key in ("image", "depth"))
    return lambda topic: kind_of_camera(topic, image, depth)


def _have_foreign(processes: Sequence[ProcessPlan]) -> bool:
    """Whether a node of another package takes part."""
    return any(is_foreign(node) for process in processes for node in process.nodes)


def _named(path: Path, parameter_files: Sequence[Path], parameters: Sequence[str]) -> str:
    """A launch file and what wins over its values, for errors about those: they may be of any of these."""
    given = [*map(str, parameter_files), *(f"-p {text}" for text in parameters)]
    return f"{path} (with {', '.join(given)})" if given else str(path)


def in_one_process(plan: LaunchPlan) -> LaunchPlan:
    """The plan with all nodes in one process, a thread each: messages go by reference.

    It is started again only where each of its processes would be.
    """
    nodes = tuple(node for process in plan.processes for node in process.nodes)
    restarts = all(process.restarts for process in plan.processes)
    ends_launch = any(process.ends_launch for process in plan.processes)
    whole = ProcessPlan("all", nodes, restarts, ends_launch)
    return replace(plan, processes=(whole,))


def _nothing_to_run(path: Path, entries: Mapping[str, Any], given: Sequence[str]) -> str:
    if not entries:
        return f"{path}: expected at least one process under launch: processes, found none"
    asked = ", ".join(f"{name}: {entry['if']}" for name, entry in entries.items())
    return (
        f"{path}: nothing to run with {' '.join(given) or 'no arguments'}: expected one of the conditions of its "
        f"processes to hold, found {asked}; 'twin_node launch {path} --show-args' tells what can be given"
    )


def _follows_clock(section: Mapping[str, Any], sections: Sections, where: str) -> bool:
    """As the file's launch section says, unless parameters of every node say otherwise, as those of ROS nodes do."""
    told = read_flag(section, "use_sim_time", False, f"{where}: {LAUNCH}")
    return read_flag(sections.get(EVERY_NODE, {}), "use_sim_time", told, f"{where}: {EVERY_NODE}")


def _check_nodes_once(processes: Sequence[ProcessPlan], path: Path) -> None:
    """Two nodes of one name would contradict each other."""
    place: dict[str, str] = {}
    for process in processes:
        for node in process.nodes:
            if node in place:
                both = place[node], process.name
                found = (
                    f"in process '{both[0]}' twice" if both[0] == both[1] else f"in two processes, {' and '.join(both)}"
                )
                raise GraphError(f"{path}: node '{node}' is {found}; take one away")
            place[node] = process.name


def _check_lockstep(processes: Sequence[ProcessPlan], path: Path) -> None:
    """Raises `GraphError` for a node that would not run."""
    for process in processes:
        for node in process.nodes:
            if node not in IN_LOCKSTEP:
                raise GraphError(
                    f"{path}: process '{process.name}': node '{node}' has no part in lockstep, which runs "
                    f"{', '.join(IN_LOCKSTEP)} alone; leave it out"
                )


def _set_parameters(sections: dict[str, dict[str, Any]], given: Sequence[str]) -> None:
    """Puts `node.key:=value` parameters into their sections; nested keys go on with dots."""
    for text in given:
        name, separator, value = text.partition(":=")
        node, _, keys = name.partition(".")
        if not (separator and keys):
            raise GraphError(f"-p {text}: expected NODE.KEY:=VALUE, for example synchronizer.width:=160")
        inner = sections.setdefault(node, {})
        *outer, last = keys.split(".")
        for key in outer:
            inner = inner.setdefault(key, {})
            if not isinstance(inner, dict):
                raise GraphError(f"-p {text}: expected keys and values under '{key}', found {told(inner)}")
        inner[last] = with_home(parsed(value, f"-p {text}: expected a value"))


def _check_takes_part(given: Sequence[str], entries: Mapping[str, Any], path: Path) -> None:
    """Raises `GraphError` for a parameter of a node that the file has in no process: it would change nothing."""
    nodes = {node for name, entry in entries.items() for node in named_nodes(entry, f"{path}: process '{name}'")}
    for text in given:
        node = text.partition(".")[0]
        if node in KINDS and node not in {*CHAIN_SECTIONS, *nodes}:
            raise GraphError(f"-p {text}: {path} has no node '{node}'; it has {', '.join(sorted(nodes))}")


def _check_sections(sections: Sections, where: str, processes: Sequence[ProcessPlan]) -> None:
    """Raises `GraphError` for parameters that nobody reads; a node of another package that takes part may read any of
    those for every node."""
    for name, values in sections.items():
        if name != EVERY_NODE:
            check_section(name, values, f"{where}: parameters")
        elif not _have_foreign(processes):
            check_shared(values, f"{where}: parameters: {name}")
        _check_plain(values, f"{where}: {name}")


def _check_plain(value: Any, where: str) -> None:
    """Raises `GraphError` for what YAML makes of a text without quotes, and no parameter is: a date, for example."""
    if isinstance(value, Mapping):
        for key, inner in value.items():
            _check_plain(key, f"{where}: a key")
            _check_plain(inner, f"{where}.{key}")
    elif isinstance(value, list):
        for inner in value:
            _check_plain(inner, where)
    elif not isinstance(value, str | int | float | None):
        raise GraphError(f"{where}: expected text or numbers, found {value} ({kind_of(value)}); quote it")
