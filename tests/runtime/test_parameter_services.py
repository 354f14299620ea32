"""What other ROS 2 programs are told of a node's parameters."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path
from typing import Any

import pytest

from twin_node.messages import Message, message_type
from twin_node.messages.services import ServiceType
from twin_node.runtime.parameter_services import serve_parameters
from twin_node.runtime.parameter_values import Parameter, ParameterType, parameters_of, value_of
from twin_node.runtime.services import Answer
from twin_node.runtime.wire import Cancel, LocalWire


class Side(Enum):
    """Which one."""

    LEFT = "left"


@dataclass(frozen=True)
class Inner:
    """Nested."""

    ramp_s: float = 0.75
    """How long it takes,
    in all, s."""
    steps: int = 3


@dataclass(frozen=True)
class Outer:
    """A node's."""

    name: str = "ur5e"
    """Of the arm."""
    on: bool = True
    side: Side = Side.LEFT
    width: int | None = None
    path: Path = Path("rig.yaml")
    limiter: Inner = field(default_factory=Inner)
    horizons: tuple[float, ...] = (0.0, 0.2)
    mixed: tuple[float, ...] = (1, 0.5)
    counts: tuple[int, ...] = (1, 2)
    flags: tuple[bool, ...] = (True, False)
    topics: tuple[str, ...] = ()
    boxes: tuple[tuple[float, ...], ...] = ((1.0, 2.0), (3.0, 4.0))
    cameras: Mapping[str, Any] = field(default_factory=lambda: {"left": {"opencv": 0}, "right": Inner(steps=5)})
    none_yet: Mapping[str, Any] = field(default_factory=dict)
    largest: int = 2**70


class Heard(LocalWire):
    """Keeps what is served, to ask it without a network."""

    def __init__(self) -> None:
        super().__init__()
        self.served: dict[str, tuple[ServiceType, Answer]] = {}

    def serve(self, node: str, name: str, service: ServiceType, answer: Answer) -> Cancel:
        self.served[name] = service, answer
        return lambda: None

    def ask(self, name: str, **fields: object) -> Message:
        """The response, by way of its bytes and those of the request."""
        service, answer = self.served[name]
        asked = service.types.deserialize(bytes(service.types.serialize(service.ask(**fields))), service.request)
        replies: list[bytes] = []
        answer(asked, lambda response: replies.append(bytes(service.types.serialize(response))))
        [reply] = replies
        return service.types.deserialize(reply, service.response)


@pytest.fixture
def heard() -> Heard:
    wire = Heard()
    serve_parameters(wire, "arm", parameters_of(Outer()))
    return wire


EXPECTED = {
    "name": (ParameterType.STRING, "ur5e"),
    "on": (ParameterType.BOOL, True),
    "side": (ParameterType.STRING, "left"),
    "width": (ParameterType.NOT_SET, None),
    "path": (ParameterType.STRING, "rig.yaml"),
    "limiter.ramp_s": (ParameterType.DOUBLE, 0.75),
    "limiter.steps": (ParameterType.INTEGER, 3),
    "horizons": (ParameterType.DOUBLE_ARRAY, [0.0, 0.2]),
    "mixed": (ParameterType.DOUBLE_ARRAY, [1.0, 0.5]),
    "counts": (ParameterType.INTEGER_ARRAY, [1, 2]),
    "flags": (ParameterType.BOOL_ARRAY, [True, False]),
    "topics": (ParameterType.STRING_ARRAY, []),
    "boxes": (ParameterType.STRING, "[[1.0, 2.0], [3.0, 4.0]]"),
    "cameras.left.opencv": (ParameterType.INTEGER, 0),
    "cameras.right.ramp_s": (ParameterType.DOUBLE, 0.75),
    "cameras.right.steps": (ParameterType.INTEGER, 5),
    "none_yet": (ParameterType.STRING, "{}"),
    "largest": (ParameterType.DOUBLE, float(2**70)),
}


def test_every_parameter_has_a_name_a_type_and_a_value() -> None:
    assert {name: (one.kind, one.value) for name, one in parameters_of(Outer()).items()} == EXPECTED
    assert list(parameters_of(Inner(), "arm")) == ["arm.ramp_s", "arm.steps"]


@pytest.mark.parametrize(("value", "told"), [(10**400, math.inf), (-(10**400), -math.inf), (10**300, 1e300)])
def test_a_number_beyond_all_is_told_as_infinite(value: int, told: float) -> None:
    """As of a seed, which may be any: the node ended in a traceback as it told of itself."""
    [parameter] = parameters_of({"seed": value}).values()
    assert (parameter.kind, parameter.value) == (ParameterType.DOUBLE, told)
    assert value_of(parameter.to_message()) == told


def test_values_are_read_as_they_are(heard: Heard) -> None:
    values = heard.ask("/arm/get_parameters", names=list(EXPECTED)).values
    assert {name: (one.type, value_of(one)) for name, one in zip(EXPECTED, values, strict=True)} == EXPECTED
    types = heard.ask("/arm/get_parameter_types", names=list(EXPECTED)).types
    assert types.tolist() == [kind for kind, _ in EXPECTED.values()]


def test_what_a_node_has_not_is_not_set(heard: Heard) -> None:
    """As rclpy answers: of a question about several the others are answered."""
    first, second = heard.ask("/arm/get_parameters", names=["nothing", "on"]).values
    assert (first.type, second.type, second.bool_value) == (ParameterType.NOT_SET, ParameterType.BOOL, True)
    assert heard.ask("/arm/get_parameter_types", names=["nothing"]).types.tolist() == [ParameterType.NOT_SET]
    assert heard.ask("/arm/get_parameters", names=[]).values == []


@pytest.mark.parametrize(
    ("prefixes", "depth", "names"),
    [
        ([], 0, list(EXPECTED)),
        ([], 1, [name for name in EXPECTED if "." not in name]),
        ([], 2, [name for name in EXPECTED if name.count(".") < 2]),
        (["cameras"], 0, ["cameras.left.opencv", "cameras.right.ramp_s", "cameras.right.steps"]),
        (["cameras"], 1, []),
        (["limiter", "cameras.left"], 1, ["limiter.ramp_s", "limiter.steps", "cameras.left.opencv"]),
        (["name"], 1, ["name"]),
        (["camera"], 0, []),
    ],
)
def test_names_are_listed_by_prefix_and_depth(heard: Heard, prefixes: list[str], depth: int, names: list[str]) -> None:
    result = heard.ask("/arm/list_parameters", prefixes=prefixes, depth=depth).result
    assert result.names == names
    assert set(result.prefixes) == {name.rpartition(".")[0] for name in names if "." in name}


def test_a_parameter_is_described_by_what_its_source_says(heard: Heard) -> None:
    ramp, name, unknown = heard.ask("/arm/describe_parameters", names=["limiter.ramp_s", "name", "nothing"]).descriptors
    assert (ramp.name, ramp.type, ramp.description) == ("limiter.ramp_s", 3, "How long it takes, in all, s.")
    assert (name.description, name.read_only) == ("Of the arm.", True)
    assert (unknown.name, unknown.type) == ("nothing", ParameterType.NOT_SET)


def wanted(name: str, value: object) -> Any:
    parameter = parameters_of({name: value})[name]
    return message_type("rcl_interfaces/msg/Parameter")(name=name, value=parameter.to_message())


def test_parameters_are_not_set_and_it_is_said_how_they_can_be(heard: Heard) -> None:
    asked = [wanted("limiter.steps", 4), wanted("limiter.stepz", 4), wanted("limiter.steps", 3)]
    changed, unknown, same = heard.ask("/arm/set_parameters", parameters=asked).results
    assert not changed.successful
    assert changed.reason.startswith("'limiter.steps' is read when the node is made: set it in the launch file")
    assert (unknown.successful, unknown.reason) == (
        False,
        "unknown parameter 'limiter.stepz'; did you mean 'limiter.steps'?",
    )
    assert same.successful, "what it has already need not be set"
    together = heard.ask("/arm/set_parameters_atomically", parameters=asked).result
    assert (together.successful, together.reason) == (False, changed.reason)
    assert heard.ask("/arm/set_parameters_atomically", parameters=asked[2:]).result.successful


def test_passwords_in_addresses_are_told_to_nobody() -> None:
    cameras = {"left": {"opencv": "rtsp://admin:secret@10.0.0.2/stream"}, "all": ["rtsp://admin:secret@10.0.0.3"]}
    told = parameters_of({"cameras": cameras})
    assert told["cameras.left.opencv"].value == "rtsp://***@10.0.0.2/stream"
    assert told["cameras.all"].value == ["rtsp://***@10.0.0.3"]


def test_numbers_without_end_survive() -> None:
    [one] = parameters_of({"limit": math.inf}).values()
    assert (one.kind, value_of(one.to_message())) == (ParameterType.DOUBLE, math.inf)


def test_what_is_of_no_known_type_has_no_value() -> None:
    message = Parameter(ParameterType.NOT_SET, None).to_message()
    message.type = 77
    assert value_of(message) is None
