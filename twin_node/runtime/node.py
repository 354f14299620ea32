"""The base of every node: a name, a bus, a clock, and the ROS 2 lifecycle."""

from __future__ import annotations

from enum import IntEnum

from twin_node.messages.convert import Diagnosis
from twin_node.runtime.bus import Bus
from twin_node.runtime.clock import Clock


class LifecycleState(IntEnum):
    """Primary states, values as in `lifecycle_msgs/State`."""

    UNCONFIGURED = 1
    INACTIVE = 2
    ACTIVE = 3
    FINALIZED = 4


class LifecycleError(RuntimeError):
    """A transition was asked for that the node's state does not allow."""


class Node:
    """A lifecycle node (design.ros2.org/articles/node_lifecycle): subclasses fill in the `on_` methods they need.

    What it has subscribed to reaches it from `on_configure` on, before it is active too, so that no latched message is
    missed: a node that drives anything looks at `state` first.
    """

    def __init__(self, name: str, bus: Bus, clock: Clock) -> None:
        self.name = name
        self.bus = bus
        self.clock = clock
        self._lifecycle = LifecycleState.UNCONFIGURED

    @property
    def state(self) -> LifecycleState:
        """Where the node is in its life."""
        return self._lifecycle

    def configure(self) -> None:
        """Unconfigured to inactive: allocate, subscribe."""
        self._move(LifecycleState.UNCONFIGURED, LifecycleState.INACTIVE)
        self.on_configure()

    def activate(self) -> None:
        """Inactive to active: all others of the graph are there; begin."""
        self._move(LifecycleState.INACTIVE, LifecycleState.ACTIVE)
        self.on_activate()

    def deactivate(self) -> None:
        """Active to inactive: end what was begun, state is kept."""
        self._move(LifecycleState.ACTIVE, LifecycleState.INACTIVE)
        self.on_deactivate()

    def cleanup(self) -> None:
        """Inactive to unconfigured: release what `on_configure` took."""
        self._move(LifecycleState.INACTIVE, LifecycleState.UNCONFIGURED)
        self.on_cleanup()

    def diagnoses(self) -> tuple[Diagnosis, ...]:
        """How the node is doing, as `/diagnostics` tells once a second; may count anew with every call."""
        return ()

    def on_configure(self) -> None:
        """Called on the way from unconfigured to inactive."""

    def on_activate(self) -> None:
        """Called on the way from inactive to active."""

    def on_deactivate(self) -> None:
        """Called on the way from active to inactive."""

    def on_cleanup(self) -> None:
        """Called on the way from inactive to unconfigured."""

    def _move(self, source: LifecycleState, target: LifecycleState) -> None:
        if self._lifecycle is not source:
            raise LifecycleError(f"node '{self.name}' is {self._lifecycle.name.lower()}, not {source.name.lower()}")
        self._lifecycle = target
