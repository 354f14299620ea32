"""A node's parameters as ROS 2 has them: flat names, and values of nine types."""

from __future__ import annotations

import ast
import dataclasses
import inspect
import json
import math
import re
import sys
import textwrap
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum, IntEnum
from functools import cache, partial
from itertools import pairwise
from typing import Any

import numpy as np

from twin_node.messages import Message, message_type

SEPARATOR = "."
"""Between the names of nested parameters."""
USE_SIM_TIME = "use_sim_time"
"""A parameter that every node of ROS 2 has: whether its time is that of `/clock`."""
_LARGEST = 2**63 - 1
_SECRET = re.compile(r"(?<=://)[^/@\s]+@")
"""Who logs in at an address, and by which password: nothing for everybody on the network."""


class ParameterType(IntEnum):
    """As in `rcl_interfaces/msg/ParameterType`."""

    NOT_SET = 0
    BOOL = 1
    INTEGER = 2
    DOUBLE = 3
    STRING = 4
    BYTE_ARRAY = 5
    BOOL_ARRAY = 6
    INTEGER_ARRAY = 7
    DOUBLE_ARRAY = 8
    STRING_ARRAY = 9


_OF_ONE = {
    bool: ParameterType.BOOL,
    int: ParameterType.INTEGER,
    float: ParameterType.DOUBLE,
    str: ParameterType.STRING,
}
_OF_SEVERAL = {
    bool: ParameterType.BOOL_ARRAY,
    int: ParameterType.INTEGER_ARRAY,
    float: ParameterType.DOUBLE_ARRAY,
    str: ParameterType.STRING_ARRAY,
}
_FIELDS = {kind: f"{kind.name.lower()}_value" for kind in ParameterType if kind is not ParameterType.NOT_SET}
"""Type -> the field of `rcl_interfaces/msg/ParameterValue` that holds it."""


@dataclass(frozen=True)
class Parameter:
    """One parameter of a node."""

    kind: ParameterType
    value: Any
    """None where it is not set."""
    describe: Callable[[], str] = str
    """Says what it is, which takes a look into the source: only who asks waits for that."""

    def to_message(self) -> Message:
        """A `rcl_interfaces/msg/ParameterValue`."""
        return _value_message(self.kind, self.value)


def named_parameters(of_sections: Mapping[str, Any], follows_clock: bool) -> dict[str, Parameter]:
    """All of a node by name: the dataclasses of its sections, its own by no name, and `use_sim_time`."""
    found = {USE_SIM_TIME: Parameter(ParameterType.BOOL, follows_clock, lambda: "Whether its time is /clock's.")}
    for section, values in of_sections.items():
        found.update(parameters_of(values, section))
    return found


def parameters_of(values: Any, prefix: str = "") -> dict[str, Parameter]:
    """The fields of a dataclass, by name; those of dataclasses and mappings in it by names such as `limiter.ramp_s`.

    What ROS 2 has no type for, as a list of lists, is a text in JSON.
    """
    found: dict[str, Parameter] = {}
    for name, value, describe in _members(values):
        full = f"{prefix}{SEPARATOR}{name}" if prefix else name
        if dataclasses.is_dataclass(value) or (isinstance(value, Mapping) and value):
            found.update(parameters_of(value, full))
        else:
            found[full] = _parameter(value, describe)
    return found


def value_of(message: Message) -> Any:
    """What a `rcl_interfaces/msg/ParameterValue` holds; None where it is not set, or of no known type."""
    try:
        kind = ParameterType(message.type)
    except ValueError:
        return None
    if kind is ParameterType.NOT_SET:
        return None
    value = getattr(message, _FIELDS[kind])
    return value.tolist() if hasattr(value, "tolist") else value


def _members(values: Any) -> Iterator[tuple[str, Any, Callable[[], str]]]:
    """Name and value of what a dataclass or a mapping holds, and what says what it is."""
    if isinstance(values, Mapping):
        yield from ((str(key), value, str) for key, value in values.items())
        return
    for field in dataclasses.fields(values):
        if field.init:
            yield field.name, getattr(values, field.name), partial(_description, type(values), field.name)


def _description(kind: Any, field: str) -> str:
    return _descriptions(kind).get(field, "")


def _parameter(value: Any, describe: Callable[[], str]) -> Parameter:
    """A plain value with the type that ROS 2 has for it."""
    value = _plain(value)
    if value is None:
        return Parameter(ParameterType.NOT_SET, None, describe)
    if type(value) in _OF_ONE:
        return Parameter(_OF_ONE[type(value)], value, describe)
    if isinstance(value, list):
        kinds = {type(one) for one in value} or {str}
        if kinds == {int, float}:
            value, kinds = [float(one) for one in value], {float}
        if len(kinds) == 1 and (kind := kinds.pop()) in _OF_SEVERAL:
            return Parameter(_OF_SEVERAL[kind], value, describe)
    return Parameter(ParameterType.STRING, json.dumps(value), describe)


def _plain(value: Any) -> Any:
    """A value as JSON has it; a whole number that ROS 2 has no room for is one with a fraction, or infinite."""
    if isinstance(value, Enum):
        return _plain(value.value)
    if dataclasses.is_dataclass(value) or isinstance(value, Mapping):
        return {name: _plain(inside) for name, inside, _ in _members(value)}
    if isinstance(value, Sequence) and not isinstance(value, str | bytes):
        return [_plain(one) for one in value]
    if isinstance(value, int) and not isinstance(value, bool) and abs(value) > _LARGEST:
        return float(value) if abs(value) <= sys.float_info.max else (math.inf if value > 0 else -math.inf)
    return value if value is None or isinstance(value, bool | int | float) else _SECRET.sub("***@", str(value))


@cache
def _descriptions(kind: Any) -> Mapping[str, str]:
    """What stands below each field of a dataclass in its source, in one line each."""
    found: dict[str, str] = {}
    for one in reversed(kind.__mro__):
        try:
            (written,) = ast.parse(textwrap.dedent(inspect.getsource(one))).body
        except (OSError, TypeError, SyntaxError, ValueError):
            continue  # made while the program runs: nothing is written of it
        body = getattr(written, "body", [])
        for field, below in pairwise(body):
            if isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name) and isinstance(below, ast.Expr):
                text = getattr(below.value, "value", None)
                if isinstance(text, str):
                    found[field.target.id] = " ".join(text.split())
    return found


def _value_message(kind: ParameterType, value: Any) -> Message:
    empty: dict[str, Any] = {
        "bool_value": False,
        "integer_value": 0,
        "double_value": 0.0,
        "string_value": "",
        "byte_array_value": np.zeros(0, np.uint8),
        "bool_array_value": np.zeros(0, np.bool_),
        "integer_array_value": np.zeros(0, np.int64),
        "double_array_value": np.zeros(0, np.float64),
        "string_array_value": [],
    }
    if kind is not ParameterType.NOT_SET:
        default = empty[_FIELDS[kind]]
        empty[_FIELDS[kind]] = np.array(value, default.dtype) if isinstance(default, np.ndarray) else value
    return message_type("rcl_interfaces/msg/ParameterValue")(type=int(kind), **empty)
