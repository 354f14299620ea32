"""Lifecycle: each transition calls its hook once, and only from its own source state."""

import pytest

from twin_node.runtime.bus import LocalBus
from twin_node.runtime.clock import SteppedClock
from twin_node.runtime.node import LifecycleError, LifecycleState, Node


class Recorder(Node):
    def __init__(self) -> None:
        super().__init__("recorder", LocalBus(), SteppedClock())
        self.calls: list[str] = []

    def on_configure(self) -> None:
        self.calls.append("configure")

    def on_activate(self) -> None:
        self.calls.append("activate")

    def on_deactivate(self) -> None:
        self.calls.append("deactivate")

    def on_cleanup(self) -> None:
        self.calls.append("cleanup")


def test_a_whole_life() -> None:
    node = Recorder()
    node.configure()
    node.activate()
    assert node.state is LifecycleState.ACTIVE
    node.deactivate()
    node.cleanup()
    assert node.state is LifecycleState.UNCONFIGURED
    assert node.calls == ["configure", "activate", "deactivate", "cleanup"]


def test_a_transition_from_the_wrong_state_is_refused_and_changes_nothing() -> None:
    node = Recorder()
    with pytest.raises(LifecycleError, match="'recorder' is unconfigured, not inactive"):
        node.activate()
    assert node.state is LifecycleState.UNCONFIGURED
    assert node.calls == []


def test_a_stepped_clock_never_goes_back() -> None:
    clock = SteppedClock(5)
    clock.advance_to(9)
    clock.advance_to(7)
    assert clock.now() == 9
