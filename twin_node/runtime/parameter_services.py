"""What other ROS 2 programs are told of a node's parameters: `ros2 param list`, `get`, `describe` and `dump`.

A node takes its parameters when it is made, so that others can read them and none can be set.
"""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from typing import Any

import numpy as np

from twin_node.messages import Message, message_type
from twin_node.messages.services import service_type
from twin_node.runtime.parameter_values import SEPARATOR, Parameter, ParameterType, value_of
from twin_node.runtime.services import Answer, Reply
from twin_node.runtime.wire import Wire

_UNDECLARED = Parameter(ParameterType.NOT_SET, None)


def serve_parameters(wire: Wire, node: str, parameters: Mapping[str, Parameter]) -> None:
    """Answers as node `node` what others ask about its parameters, as long as the wire is open.

    `parameters` are looked up with every request.
    """
    answers = {
        "list_parameters": ("ListParameters", _list),
        "get_parameters": ("GetParameters", _get),
        "get_parameter_types": ("GetParameterTypes", _get_types),
        "describe_parameters": ("DescribeParameters", _describe),
        "set_parameters": ("SetParameters", _set),
        "set_parameters_atomically": ("SetParametersAtomically", _set_atomically),
    }
    for name, (kind, answer) in answers.items():
        wire.serve(node, f"/{node}/{name}", service_type(f"rcl_interfaces/srv/{kind}"), _bound(answer, parameters))


def _bound(answer: Any, parameters: Mapping[str, Parameter]) -> Answer:
    def given(request: Message, reply: Reply) -> None:
        reply(answer(parameters, request))

    return given


def _list(parameters: Mapping[str, Parameter], request: Message) -> Message:
    """As rclcpp has it: a depth of 0 is any, others count the parts of a name after its prefix."""
    prefixes, depth = request.prefixes, int(request.depth)

    def is_asked(name: str) -> bool:
        for prefix in prefixes or [""]:
            if name == prefix:
                return True
            inside = name.removeprefix(f"{prefix}{SEPARATOR}") if prefix else name
            if (not prefix or inside != name) and (depth == 0 or inside.count(SEPARATOR) < depth):
                return True
        return False

    names = [name for name in parameters if is_asked(name)]
    found = dict.fromkeys(name.rpartition(SEPARATOR)[0] for name in names if SEPARATOR in name)
    result = message_type("rcl_interfaces/msg/ListParametersResult")(names=names, prefixes=list(found))
    return service_type("rcl_interfaces/srv/ListParameters").answer(result=result)


def _get(parameters: Mapping[str, Parameter], request: Message) -> Message:
    values = [parameters.get(name, _UNDECLARED).to_message() for name in request.names]
    return service_type("rcl_interfaces/srv/GetParameters").answer(values=values)


def _get_types(parameters: Mapping[str, Parameter], request: Message) -> Message:
    kinds = np.array([parameters.get(name, _UNDECLARED).kind for name in request.names], np.uint8)
    return service_type("rcl_interfaces/srv/GetParameterTypes").answer(types=kinds)


def _describe(parameters: Mapping[str, Parameter], request: Message) -> Message:
    made = message_type("rcl_interfaces/msg/ParameterDescriptor")
    descriptors = [
        made(
            name=name,
            type=int((known := parameters.get(name, _UNDECLARED)).kind),
            description=known.describe(),
            additional_constraints="",
            read_only=True,
            dynamic_typing=False,
            floating_point_range=[],
            integer_range=[],
        )
        for name in request.names
    ]
    return service_type("rcl_interfaces/srv/DescribeParameters").answer(descriptors=descriptors)


def _set(parameters: Mapping[str, Parameter], request: Message) -> Message:
    results = [_result(_refusal(parameters, one)) for one in request.parameters]
    return service_type("rcl_interfaces/srv/SetParameters").answer(results=results)


def _set_atomically(parameters: Mapping[str, Parameter], request: Message) -> Message:
    refusals = [refusal for one in request.parameters if (refusal := _refusal(parameters, one))]
    answered = _result(refusals[0] if refusals else "")
    return service_type("rcl_interfaces/srv/SetParametersAtomically").answer(result=answered)


def _refusal(parameters: Mapping[str, Parameter], wanted: Message) -> str:
    """Why a parameter is not set; nothing where it has that value."""
    known = parameters.get(wanted.name)
    if known is None:
        near = difflib.get_close_matches(wanted.name, parameters, n=1)
        return f"unknown parameter '{wanted.name}'" + (f"; did you mean '{near[0]}'?" if near else "")
    if value_of(wanted.value) == known.value:
        return ""
    return f"'{wanted.name}' is read when the node is made: set it in the launch file, or with -p, and launch again"


def _result(refusal: str) -> Message:
    return message_type("rcl_interfaces/msg/SetParametersResult")(successful=not refusal, reason=refusal)
