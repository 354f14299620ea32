"""What is foreseen as obstacles of MoveIt's planning scene: plans keep clear of where people will be."""

from __future__ import annotations

from dataclasses import dataclass

from twin_node.errors import TwinError
from twin_node.messages import Message, convert
from twin_node.nodes.live.setup import Setup
from twin_node.nodes.topics import COLLISION_OBJECT, OBSTACLES
from twin_node.ranges import NOT_NEGATIVE, check_ranges
from twin_node.runtime.node import LifecycleState, Node
from twin_node.scene import ObstacleKind, Obstacles


@dataclass(frozen=True)
class MoveItParameters:
    """How the planning scene hears of obstacles."""

    kinds: tuple[str, ...] = ("moving",)
    """Of `moving`, `static`, `unknown` and `unseen`. What stands is often in a planning scene already, and touches the
    arm where that is mounted; unseen space is behind the arm wherever that is."""
    frame: str = "base_link"
    """Name of the arm's base in the planning scene."""
    prefix: str = "twin_"
    """Begins the objects' names, which end with their kind."""
    period_s: float = 0.1
    """Shortest time between two tellings, s: the planning scene makes its shapes anew with each."""

    def __post_init__(self) -> None:
        """Raises `TwinError` for a kind that there is not, and for a period that none is."""
        known = [kind.name.lower() for kind in ObstacleKind]
        for kind in self.kinds:
            if kind not in known:
                raise TwinError(f"kinds: expected some of {', '.join(known)}, found '{kind}'")
        check_ranges(self, TwinError, "", period_s=NOT_NEGATIVE)


def make_moveit(setup: Setup) -> Node:
    """The node `moveit`."""
    return MoveItNode(setup, setup.parameters(MoveItParameters))


class MoveItNode(Node):
    """An object per kind, of every shape that holds things of that kind at any time of the forecast.

    What was told stays until a newer forecast comes, so that nothing is free for want of one; it is taken away when
    the node is deactivated. Where nobody listens, nothing is made.
    """

    def __init__(self, setup: Setup, parameters: MoveItParameters) -> None:
        super().__init__(setup.name, setup.bus, setup.clock)
        self._bus = setup.bus
        self._parameters = parameters
        self._kinds = [ObstacleKind[kind.upper()] for kind in parameters.kinds]
        self._told_ns: int | None = None
        self._present: set[ObstacleKind] = set()
        """Kinds of which the planning scene has an object."""

    def on_configure(self) -> None:
        self._bus.advertise(COLLISION_OBJECT)
        self.bus.subscribe(OBSTACLES, self._on_obstacles)

    def on_deactivate(self) -> None:
        self._tell(Obstacles.none(self.clock.now()))

    def _on_obstacles(self, message: Message) -> None:
        now = self.clock.now()
        is_early = self._told_ns is not None and 0 <= now - self._told_ns < self._parameters.period_s * 1e9
        if is_early or self.state is not LifecycleState.ACTIVE or not self._bus.is_heard(COLLISION_OBJECT):
            return
        self._told_ns = now
        self._tell(convert.obstacles_from_message(message))

    def _tell(self, obstacles: Obstacles) -> None:
        for kind in self._kinds:
            name = f"{self._parameters.prefix}{kind.name.lower()}"
            chosen = obstacles.only(obstacles.kinds == kind)
            if not len(chosen.ids) and kind not in self._present:
                continue  # a planning scene warns of what it is to take away and has not
            (self._present.add if len(chosen.ids) else self._present.discard)(kind)
            told = convert.obstacles_to_collision_object(chosen, name, self._parameters.frame)
            self.bus.publish(COLLISION_OBJECT, told)
