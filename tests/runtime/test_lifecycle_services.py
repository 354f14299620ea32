"""How other ROS 2 programs see a node's life, and lead it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from twin_node.messages import message_type
from twin_node.messages.services import service_type
from twin_node.runtime.lifecycle_services import Transition, asked, possible, serve_lifecycle
from twin_node.runtime.node import LifecycleState
from twin_node.runtime.services import Answer
from twin_node.runtime.wire import Cancel, LocalWire

UNCONFIGURED, INACTIVE, ACTIVE = LifecycleState.UNCONFIGURED, LifecycleState.INACTIVE, LifecycleState.ACTIVE


class Heard(LocalWire):
    """Keeps what is served."""

    def __init__(self) -> None:
        super().__init__()
        self.served: dict[str, Answer] = {}

    def serve(self, node: str, name: str, service: Any, answer: Answer) -> Cancel:
        self.served[name.removeprefix(f"/{node}/")] = answer
        return lambda: None

    def ask(self, name: str, kind: str, **fields: object) -> Any:
        replies: list[Any] = []
        self.served[name](service_type(f"lifecycle_msgs/srv/{kind}").ask(**fields), replies.append)
        return replies[0] if replies else None


class Led:
    """A node that does as it is told, but for what it refuses."""

    def __init__(self, state: LifecycleState) -> None:
        self.lifecycle = state
        self.asked: list[Transition] = []
        self.answers: list[Callable[[bool], None]] = []

    def change(self, transition: Transition, done: Callable[[bool], None]) -> None:
        self.asked.append(transition)
        self.answers.append(done)


def served(state: LifecycleState) -> tuple[Heard, Led]:
    wire, led = Heard(), Led(state)
    serve_lifecycle(wire, "twin", led)
    return wire, led


def transition(number: int, label: str) -> Any:
    return message_type("lifecycle_msgs/msg/Transition")(id=number, label=label)


def test_numbers_are_those_of_lifecycle_msgs() -> None:
    kind = message_type("lifecycle_msgs/msg/Transition")
    for one in Transition:
        assert int(one) == getattr(kind, f"TRANSITION_{one.name}")
    states = message_type("lifecycle_msgs/msg/State")
    wire, _ = served(ACTIVE)
    told = {one.label: one.id for one in wire.ask("get_available_states", "GetAvailableStates").available_states}
    numbers = {name.split("_", 2)[2].lower(): value for name, value in vars(states).items() if name.startswith("PRIM")}
    numbers |= {name.split("_", 2)[2].lower(): value for name, value in vars(states).items() if name.startswith("TRAN")}
    assert told == numbers
    assert len(told) == 11


@pytest.mark.parametrize("state", [UNCONFIGURED, INACTIVE, ACTIVE])
def test_a_node_says_where_it_is(state: LifecycleState) -> None:
    wire, led = served(state)
    told = wire.ask("get_state", "GetState").current_state
    assert (told.id, told.label) == (state, state.name.lower())
    led.lifecycle = INACTIVE
    assert wire.ask("get_state", "GetState").current_state.label == "inactive", "as it is when somebody asks"


@pytest.mark.parametrize(
    ("state", "labels"),
    [
        (UNCONFIGURED, {"configure": (1, 10), "shutdown": (5, 12)}),
        (INACTIVE, {"cleanup": (2, 11), "activate": (3, 13), "shutdown": (6, 12)}),
        (ACTIVE, {"deactivate": (4, 14), "shutdown": (7, 12)}),
    ],
)
def test_what_may_be_asked_follows_from_where_it_is(state: LifecycleState, labels: dict[str, tuple[int, int]]) -> None:
    wire, _ = served(state)
    told = wire.ask("get_available_transitions", "GetAvailableTransitions").available_transitions
    assert {one.transition.label: (one.transition.id, one.goal_state.id) for one in told} == labels
    assert {one.start_state.id for one in told} == {state}
    everything = wire.ask("get_transition_graph", "GetAvailableTransitions").available_transitions
    assert len(everything) == 7


@pytest.mark.parametrize("success", [True, False])
def test_a_node_is_led_and_the_answer_comes_when_it_has_been(success: bool) -> None:
    wire, led = served(ACTIVE)
    replies: list[Any] = []
    wire.served["change_state"](
        service_type("lifecycle_msgs/srv/ChangeState").ask(transition=transition(4, "deactivate")), replies.append
    )
    assert led.asked == [Transition.DEACTIVATE]
    assert not replies
    led.answers[0](success)
    assert replies[0].success is success


@pytest.mark.parametrize(
    ("state", "number", "label", "found"),
    [
        (ACTIVE, 4, "", Transition.DEACTIVATE),
        (ACTIVE, 0, "deactivate", Transition.DEACTIVATE),
        (ACTIVE, 0, "shutdown", Transition.ACTIVE_SHUTDOWN),
        (INACTIVE, 0, "shutdown", Transition.INACTIVE_SHUTDOWN),
        (UNCONFIGURED, 5, "shutdown", Transition.UNCONFIGURED_SHUTDOWN),
        (ACTIVE, 4, "activate", None),
        (ACTIVE, 3, "", None),
        (INACTIVE, 99, "", None),
        (INACTIVE, 3, "dance", None),
    ],
)
def test_a_label_wins_over_a_number(state: LifecycleState, number: int, label: str, found: Transition | None) -> None:
    assert asked(number, label, state) is found


def test_what_cannot_be_asked_is_refused_at_once() -> None:
    wire, led = served(ACTIVE)
    refused = wire.ask("change_state", "ChangeState", transition=transition(3, "activate"))
    assert refused.success is False
    assert not led.asked


def test_a_node_that_can_only_be_shut_down_offers_no_more() -> None:
    """A command's own: it was told to deactivate, which `list` said is possible, and could not."""
    wire, led = Heard(), Led(ACTIVE)
    serve_lifecycle(wire, "player", led, [Transition.ACTIVE_SHUTDOWN])
    for question in ("get_available_transitions", "get_transition_graph"):
        told = wire.ask(question, "GetAvailableTransitions").available_transitions
        assert [one.transition.label for one in told] == ["shutdown"]
    assert wire.ask("change_state", "ChangeState", transition=transition(4, "deactivate")).success is False
    assert not led.asked
    assert wire.ask("change_state", "ChangeState", transition=transition(0, "shutdown")) is None, "it has not yet"
    assert led.asked == [Transition.ACTIVE_SHUTDOWN]


def test_nothing_is_possible_at_the_end() -> None:
    assert possible(LifecycleState.FINALIZED) == []
