"""Asks the nodes of a live graph, other programs' too, about their parameters and their lives, and leads them."""

from __future__ import annotations

import contextlib
import difflib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Self, TypeVar

from twin_node.messages import Message, message_type
from twin_node.messages.services import service_type
from twin_node.nodes.launch.kinds import CHAIN_SECTIONS, KINDS, nearest
from twin_node.nodes.sizes import SIZES
from twin_node.nodes.topics import ACKNOWLEDGE, TRIGGER, GraphError
from twin_node.runtime.names import within
from twin_node.runtime.parameter_values import SEPARATOR, USE_SIM_TIME, ParameterType, value_of
from twin_node.runtime.parameters import EVERY_NODE
from twin_node.runtime.services import PATIENCE_S, ServiceClient
from twin_node.runtime.zenoh_session import NoRouterError, ZenohParameters

T = TypeVar("T")

HANGS = "does not answer"
"""Told of a node that has a service and does not answer, in place of its state or its parameters."""
APPEARS_S = 2.0
"""How long a driver that is not there is waited for by who acknowledges, s: it may just be starting."""
CHANGES_S = 120.0
"""How long a node may take for a transition, s: a first set of images may have to wait for kernels to be compiled."""
SHARED = ("rig", USE_SIM_TIME)
"""Parameters that a file has once, for every node."""


@dataclass(frozen=True)
class Described:
    """A parameter as its node describes it."""

    name: str
    kind: str
    """Name of a `ParameterType`, in small letters."""
    value: Any
    description: str


class Asking:
    """The nodes of the graph, for as long as this is open."""

    def __init__(self, parameters: ZenohParameters | None = None) -> None:
        """Raises `GraphError` where there is none, `WireError` where zenoh is not installed."""
        parameters = parameters or ZenohParameters()
        self._namespace = parameters.namespace
        try:
            self._client = ServiceClient(parameters)
        except NoRouterError:
            raise GraphError(
                f"expected a graph at {parameters.endpoint}, found none there: start it ('twin_node launch'), or name "
                "the router of another machine's in ZENOH_SESSION_CONFIG_URI"
            ) from None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._client.close()

    def acknowledge(self) -> tuple[bool, str]:
        """Tells the driver of the namespace's arm that somebody has seen to its halt: whether the arm is halted no
        longer, and what the driver says of it. Raises `GraphError` where there is none, or it does not answer."""
        name = within(self._namespace, ACKNOWLEDGE)
        if not self._client.awaits(name, APPEARS_S):
            raise GraphError(
                f"{name}: expected the driver of an arm on the graph of this machine to serve it, found none; "
                "'twin_node doctor' says who is there (another ROS_DOMAIN_ID or --namespace?)"
            )
        answer = self._client.ask(name, service_type(TRIGGER))
        if answer is None:
            raise GraphError(
                f"{name}: expected the driver of the arm to answer within {PATIENCE_S:g} s, but it did not: it "
                "hangs, or has ended; 'twin_node doctor' says who is there"
            )
        return bool(answer.success), str(answer.message)

    def nodes(self) -> tuple[str, ...]:
        """Full names of the nodes that are alive: `/twin`. Raises `GraphError` where there are none."""
        nodes = self._client.nodes()
        if not nodes:
            raise GraphError("expected nodes on the graph of this machine, found none; start a launch, or see 'doctor'")
        return nodes

    def node(self, name: str) -> str:
        """The full name of a node that is alive. Raises `GraphError` where it is not, with the nearest one."""
        full, nodes = f"/{name.strip('/')}", self.nodes()
        if full not in nodes:
            raise GraphError(f"expected a node of the graph, found '{name}'; {nearest(full, set(nodes))}")
        return full

    def states(self) -> dict[str, str]:
        """Label of the state of every node that has a lifecycle, or that it hangs."""
        return self._of_all("get_state", self.state, HANGS)

    def all_parameters(self) -> dict[str, tuple[str, ...]]:
        """Names of the parameters of every node that has some, or that it hangs."""
        return self._of_all("list_parameters", self.parameters, (HANGS,))

    def _of_all(self, service: str, ask: Callable[[str], T], hangs: T) -> dict[str, T]:
        """What `ask` gives of every node with a service, and `hangs` of those that do not answer."""
        found, served = {}, self._client.services()
        for node in self.nodes():
            try:
                found[node] = ask(node)
            except GraphError:  # another program's may have no such service
                if f"{node}/{service}" in served:
                    found[node] = hangs
        return found

    def state(self, node: str) -> str:
        """Label of a node's state. Raises `GraphError` where it does not say."""
        return str(self._ask(node, "get_state", "lifecycle_msgs/srv/GetState").current_state.label)

    def transitions(self, node: str) -> dict[str, int]:
        """What may be asked of a node in its state: label -> number."""
        answer = self._ask(node, "get_available_transitions", "lifecycle_msgs/srv/GetAvailableTransitions")
        return {one.transition.label: int(one.transition.id) for one in answer.available_transitions}

    def change(self, node: str, wanted: str) -> str:
        """Leads a node through a transition, named by label or number; the label of the state it is in then.

        Raises `GraphError` for a transition that there is not from its state, and where it does not succeed.
        """
        possible = self.transitions(node)
        by_number = {str(number): label for label, number in possible.items()}
        label = by_number.get(wanted, wanted)
        if label not in possible:
            raise GraphError(
                f"{node} is {self.state(node)}: expected {', '.join(possible) or 'no transition'}, found '{wanted}'"
            )
        transition = message_type("lifecycle_msgs/msg/Transition")(id=possible[label], label=label)
        answer = self._ask(node, "change_state", "lifecycle_msgs/srv/ChangeState", CHANGES_S, transition=transition)
        if not answer.success:
            raise GraphError(f"{node} could not {label}; its log and 'twin_node doctor' say why")
        return "finalized" if label == "shutdown" else self.state(node)

    def parameters(self, node: str) -> tuple[str, ...]:
        """Names of a node's parameters, in its own order. Raises `GraphError` where it does not say."""
        answer = self._ask(node, "list_parameters", "rcl_interfaces/srv/ListParameters", prefixes=[], depth=0)
        return tuple(answer.result.names)

    def values(self, node: str, names: Sequence[str]) -> dict[str, Any]:
        """Values of a node's parameters; None where one is not set. Raises `GraphError` for one that it has not."""
        known = self.parameters(node)
        for name in names:
            if name not in known:
                raise GraphError(f"{node} has no parameter '{name}'; {_meant(node, name, known)}")
        answer = self._ask(node, "get_parameters", "rcl_interfaces/srv/GetParameters", names=list(names))
        return dict(zip(names, map(value_of, _each(node, names, answer.values)), strict=True))

    def described(self, node: str, names: Sequence[str]) -> list[Described]:
        """What a node says of its parameters. Raises `GraphError` for one that it has not."""
        values = self.values(node, names)
        answer = self._ask(node, "describe_parameters", "rcl_interfaces/srv/DescribeParameters", names=list(names))
        told = zip(names, _each(node, names, answer.descriptors), strict=True)
        return [Described(name, _kind(one.type), values[name], one.description) for name, one in told]

    def _ask(self, node: str, name: str, kind: str, patience_s: float = PATIENCE_S, **fields: object) -> Message:
        answer = self._client.ask(f"{node}/{name}", service_type(kind), patience_s, **fields)
        if answer is None:
            raise GraphError(
                f"{node}: expected its service {name} to answer within {patience_s:g} s, but it did not: it has none, "
                "as nodes of other programs may, or it hangs"
            )
        return answer


def as_file(node: str, values: Mapping[str, Any]) -> dict[str, Any]:
    """A node's parameters as a parameter file has them: nested, and of the twin by the sections that a launch has.

    One of ours is named as a launch knows it, whatever namespace it is in. What is not set is left out, and so is a
    size's name where the model is told as that size has made it.
    """
    name = node.strip("/")
    own = name.rpartition("/")[2]
    name = own if own in KINDS else name
    is_sized = values.get("size.name") in SIZES
    sections: dict[str, dict[str, Any]] = {}
    for full, value in values.items():
        *path, last = full.split(SEPARATOR)
        if value is None or (is_sized and path[:1] == ["size"]):
            continue
        section, path = _section(name, path, last)
        place = sections.setdefault(section, {})
        for part in path:
            place = place.setdefault(part, {})
        place[last] = _structured(value) if name in KINDS else value
    return {section: {"ros__parameters": inside} for section, inside in sections.items()}


def _section(node: str, path: list[str], last: str) -> tuple[str, list[str]]:
    """Where a parameter file has a parameter of a node, and the path to it there."""
    if node not in KINDS:
        return f"/{node}", path
    if (path or [last])[0] in SHARED:
        return EVERY_NODE, path
    if path and path[0] in CHAIN_SECTIONS and node not in CHAIN_SECTIONS:
        return path[0], path[1:]
    return node, path


def _structured(value: Any) -> Any:
    """A value for which ROS 2 has no type, as it was before it became a text."""
    if isinstance(value, str) and value[:1] in ("[", "{"):
        with contextlib.suppress(ValueError):
            return json.loads(value)
    return value


def _each(node: str, names: Sequence[str], answers: Sequence[Message]) -> Sequence[Message]:
    """The answers about parameters, one each. Raises `GraphError` where another program gives fewer, or more."""
    if len(answers) != len(names):
        raise GraphError(f"{node}: expected an answer about each of {len(names)} parameters, found {len(answers)}")
    return answers


def _meant(node: str, name: str, known: Sequence[str]) -> str:
    near = difflib.get_close_matches(name, known, n=1)
    near = near or [one for one in known if one.endswith(f"{SEPARATOR}{name}")]
    return f"did you mean '{near[0]}'?" if near else f"'twin_node param list {node}' names them"


def _kind(number: int) -> str:
    try:
        return ParameterType(number).name.lower()
    except ValueError:
        return f"type {number}"
