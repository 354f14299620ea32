"""ROS 2 service types: what is asked and answered, and the hash by which clients and servers know each other."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache

from rosbags.interfaces import Nodetype
from rosbags.interfaces.typing import Fielddefs, Typesdict
from rosbags.typesys import get_types_from_msg

from twin_node.messages.types import Message, MessageError, MessageTypes, builtin_types

DEFINITIONS: Mapping[str, tuple[str, str]] = {
    "lifecycle_msgs/srv/ChangeState": ("Transition transition", "bool success"),
    "lifecycle_msgs/srv/GetAvailableStates": ("", "State[] available_states"),
    "lifecycle_msgs/srv/GetAvailableTransitions": ("", "TransitionDescription[] available_transitions"),
    "lifecycle_msgs/srv/GetState": ("", "State current_state"),
    "rcl_interfaces/srv/DescribeParameters": ("string[] names", "ParameterDescriptor[] descriptors"),
    "rcl_interfaces/srv/GetParameterTypes": ("string[] names", "uint8[] types"),
    "rcl_interfaces/srv/GetParameters": ("string[] names", "ParameterValue[] values"),
    "rcl_interfaces/srv/ListParameters": ("string[] prefixes\nuint64 depth", "ListParametersResult result"),
    "rcl_interfaces/srv/SetParameters": ("Parameter[] parameters", "SetParametersResult[] results"),
    "rcl_interfaces/srv/SetParametersAtomically": ("Parameter[] parameters", "SetParametersResult result"),
    "std_srvs/srv/Trigger": ("", "bool success\nstring message"),
}
"""Fields of request and response of every service that is spoken: what every node of ROS 2 (Iron to Rolling) serves,
and what asks for something to be done."""


@dataclass(frozen=True)
class ServiceType:
    """One type of service."""

    name: str
    """Full ROS 2 name: `rcl_interfaces/srv/GetParameters`."""
    type_hash: str
    """RIHS01 hash of request, response and event taken together (REP-2016)."""
    types: MessageTypes
    """Where request and response are defined."""

    @property
    def request(self) -> str:
        """Name of the request's type."""
        return f"{self.name}_Request"

    @property
    def response(self) -> str:
        """Name of the response's type."""
        return f"{self.name}_Response"

    def ask(self, **fields: object) -> Message:
        """A request; what is not given is empty."""
        return self._made(self.request, fields)

    def answer(self, **fields: object) -> Message:
        """A response; what is not given is empty."""
        return self._made(self.response, fields)

    def _made(self, name: str, fields: dict[str, object]) -> Message:
        return self.types.message_type(name)(**fields)


@cache
def service_type(name: str) -> ServiceType:
    """A type of service by its full ROS 2 name. Raises `MessageError` for one that is not spoken here."""
    if name not in DEFINITIONS:
        raise MessageError(f"{name}: unknown service type; expected one of {', '.join(DEFINITIONS)}")
    return defined_service(name, *DEFINITIONS[name])


def defined_service(name: str, request: str, response: str) -> ServiceType:
    """A type of service by the fields of its request and its response, as an `.srv` file has them."""
    parts = {**_fields(f"{name}_Request", request), **_fields(f"{name}_Response", response)}
    event: Fielddefs = [("info", (Nodetype.NAME, "service_msgs/msg/ServiceEventInfo"))]
    event += [(part, (Nodetype.SEQUENCE, ((Nodetype.NAME, f"{name}_{part.title()}"), 1))) for part in _EXCHANGED]
    whole: Fielddefs = [
        (f"{part}_message", (Nodetype.NAME, f"{name}_{part.title()}")) for part in (*_EXCHANGED, "event")
    ]
    types = builtin_types().with_types({**parts, f"{name}_Event": ([], event), name: ([], whole)})
    return ServiceType(name, types.type_hash(name), types)


_EXCHANGED = ("request", "response")


def _fields(name: str, text: str) -> Typesdict:
    """The definition of a part of a service, which the parser of message files would call a message."""
    package, _, short = name.split("/")
    (parsed,) = get_types_from_msg(text, f"{package}/msg/{short}").values()
    return {name: parsed}
