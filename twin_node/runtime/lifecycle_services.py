"""A node's life as other ROS 2 programs see and lead it: `ros2 lifecycle nodes`, `get`, `list` and `set`.

Source: design.ros2.org/articles/node_lifecycle, and the names and numbers of lifecycle_msgs and rclcpp_lifecycle.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import Protocol

from twin_node.messages import Message, message_type
from twin_node.messages.services import ServiceType, service_type
from twin_node.runtime.node import LifecycleState
from twin_node.runtime.services import Reply
from twin_node.runtime.wire import Wire


class Transition(IntEnum):
    """What may be asked of a node, as in `lifecycle_msgs/Transition`."""

    CONFIGURE = 1
    CLEANUP = 2
    ACTIVATE = 3
    DEACTIVATE = 4
    UNCONFIGURED_SHUTDOWN = 5
    INACTIVE_SHUTDOWN = 6
    ACTIVE_SHUTDOWN = 7


@dataclass(frozen=True)
class Step:
    """Where a transition begins, and the state that a node is in meanwhile."""

    label: str
    start: LifecycleState
    meanwhile: int
    done: str
    """What has become of the node then, in words."""

    @property
    def is_shutdown(self) -> bool:
        """Whether the node ends with it."""
        return self.label == SHUTDOWN


SHUTDOWN = "shutdown"
STEPS: Mapping[Transition, Step] = {
    Transition.CONFIGURE: Step("configure", LifecycleState.UNCONFIGURED, 10, "configured"),
    Transition.CLEANUP: Step("cleanup", LifecycleState.INACTIVE, 11, "cleaned up"),
    Transition.ACTIVATE: Step("activate", LifecycleState.INACTIVE, 13, "activated"),
    Transition.DEACTIVATE: Step("deactivate", LifecycleState.ACTIVE, 14, "deactivated"),
    Transition.UNCONFIGURED_SHUTDOWN: Step(SHUTDOWN, LifecycleState.UNCONFIGURED, 12, "shut down"),
    Transition.INACTIVE_SHUTDOWN: Step(SHUTDOWN, LifecycleState.INACTIVE, 12, "shut down"),
    Transition.ACTIVE_SHUTDOWN: Step(SHUTDOWN, LifecycleState.ACTIVE, 12, "shut down"),
}
LABELS: Mapping[int, str] = {
    0: "unknown",
    **{int(state): state.name.lower() for state in LifecycleState},
    10: "configuring",
    11: "cleaningup",
    12: "shuttingdown",
    13: "activating",
    14: "deactivating",
    15: "errorprocessing",
}
"""Of every state: those that a node stays in, and those on the way between them."""


class Living(Protocol):
    """A node, and whoever leads it through its life."""

    @property
    def lifecycle(self) -> LifecycleState:
        """Where the node is in its life; from any thread."""

    def change(self, transition: Transition, done: Callable[[bool], None]) -> None:
        """Has the node go through a transition, and calls `done(whether it did)` then; from any thread."""


def serve_lifecycle(
    wire: Wire, node: str, living: Living, allowed: Collection[Transition] = frozenset(Transition)
) -> None:
    """Answers as node `node` what others ask about its life, and leads it as they tell, as long as the wire is open.

    `allowed`: the transitions that it can be led through.
    """

    def serve(name: str, kind: str, answer: Callable[[ServiceType, Message], Message]) -> None:
        service = service_type(f"lifecycle_msgs/srv/{kind}")
        wire.serve(node, f"/{node}/{name}", service, lambda request, reply: reply(answer(service, request)))

    serve("get_state", "GetState", lambda to, _: to.answer(current_state=_state(living.lifecycle)))
    serve("get_available_states", "GetAvailableStates", lambda to, _: to.answer(available_states=_states()))
    serve(
        "get_available_transitions",
        "GetAvailableTransitions",
        lambda to, _: to.answer(available_transitions=_transitions(possible(living.lifecycle, allowed))),
    )
    serve(
        "get_transition_graph",
        "GetAvailableTransitions",
        lambda to, _: to.answer(available_transitions=_transitions(t for t in Transition if t in allowed)),
    )
    changing = service_type("lifecycle_msgs/srv/ChangeState")

    def change(request: Message, reply: Reply) -> None:
        wanted = asked(request.transition.id, request.transition.label, living.lifecycle)
        if wanted is None or wanted not in allowed:
            reply(changing.answer(success=False))
        else:
            living.change(wanted, lambda success: reply(changing.answer(success=success)))

    wire.serve(node, f"/{node}/change_state", changing, change)


def possible(state: LifecycleState, allowed: Collection[Transition] = frozenset(Transition)) -> list[Transition]:
    """What may be asked of a node in a state, of the transitions that it can be led through at all."""
    return [transition for transition, step in STEPS.items() if step.start is state and transition in allowed]


def asked(number: int, label: str, state: LifecycleState) -> Transition | None:
    """The transition from a state that a label names, or a number where there is none; None: there is no such."""
    for transition in possible(state):
        if STEPS[transition].label == label if label else int(transition) == number:
            return transition
    return None


def _state(number: int) -> Message:
    return message_type("lifecycle_msgs/msg/State")(id=int(number), label=LABELS[int(number)])


def _states() -> list[Message]:
    return [_state(number) for number in LABELS]


def _transitions(transitions: Iterable[Transition]) -> list[Message]:
    named = message_type("lifecycle_msgs/msg/Transition")
    described = message_type("lifecycle_msgs/msg/TransitionDescription")
    return [
        described(
            transition=named(id=int(transition), label=STEPS[transition].label),
            start_state=_state(STEPS[transition].start),
            goal_state=_state(STEPS[transition].meanwhile),
        )
        for transition in transitions
    ]
