"""What MoveIt's planning scene is told of what is foreseen."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from twin_node.errors import TwinError
from twin_node.messages import convert, deserialize, message_type, serialize, type_hash
from twin_node.nodes.live.moveit import MoveItNode, MoveItParameters, make_moveit
from twin_node.nodes.live.setup import Setup
from twin_node.nodes.topics import COLLISION_OBJECT, OBSTACLES, kind_of, kind_of_own
from twin_node.runtime.executor import Executor
from twin_node.runtime.wire import LocalWire
from twin_node.runtime.wire_bus import WireBus
from twin_node.scene import ObstacleKind, Obstacles, ObstacleShape

START = 1_700_000_000_000_000_000
MOVING, STATIC, UNKNOWN = ObstacleKind.MOVING, ObstacleKind.STATIC, ObstacleKind.UNKNOWN


def obstacles(*kinds: ObstacleKind) -> Obstacles:
    """One box of 0.2 x 0.4 x 0.6 m each, turned about z, but the last, a ball of 0.3 m; one more metre away each."""
    n = len(kinds)
    shapes = np.full(n, ObstacleShape.BOX, np.uint8)
    shapes[-1:] = ObstacleShape.SPHERE
    sizes = np.tile([0.2, 0.4, 0.6], (n, 1))
    sizes[-1:] = 0.3
    return Obstacles(
        stamp=START,
        ids=np.arange(n, dtype=np.uint32),
        kinds=np.array(kinds, np.uint8),
        shapes=shapes,
        positions=np.column_stack([np.arange(n) + 1.0, np.zeros(n), np.full(n, 0.5)]),
        quats=np.tile([0.8, 0.0, 0.0, 0.6], (n, 1)),
        sizes=sizes,
        velocities=np.zeros((n, 3)),
        bounds=np.zeros(n),
        valid_from=np.full(n, START),
        valid_to=np.full(n, START + 200_000_000),
    )


class Scene:
    """A planning scene that listens to the node on a wire of the test's own."""

    def __init__(self, listens: bool = True, **parameters: Any) -> None:
        self.wire, self._executor, self.now = LocalWire(), Executor(), START
        self.heard: list[Any] = []
        if listens:
            self.wire.subscribe("move_group", COLLISION_OBJECT, kind_of_own(COLLISION_OBJECT), self.heard.append)
        bus = WireBus(self.wire, self._executor, "moveit", kind_of)
        sections = {"moveit": parameters}
        setup = Setup(
            "moveit", bus, SimpleNamespace(now=lambda: self.now), self._executor, sections, "test", lambda: None, tuple
        )
        self.node = make_moveit(setup)
        self.node.configure()
        self.node.activate()
        self._send = self.wire.publisher("twin", OBSTACLES, kind_of_own(OBSTACLES))

    def see(self, found: Obstacles, later_s: float = 1.0) -> list[Any]:
        """What the scene is told of a forecast that comes so much later."""
        self.now += int(later_s * 1e9)
        before = len(self.heard)
        self._send(convert.obstacles_to_message(found))
        while self._executor.step(0.0):
            pass
        return [deserialize(bytes(serialize(one)), one.__msgtype__) for one in self.heard[before:]]


def test_what_moves_is_one_object_of_all_its_shapes() -> None:
    [told] = Scene().see(obstacles(MOVING, STATIC, MOVING))
    assert (told.id, told.operation, told.header.frame_id) == ("twin_moving", told.ADD, "base_link")
    kind = message_type("shape_msgs/msg/SolidPrimitive")
    assert [one.type for one in told.primitives] == [kind.BOX, kind.SPHERE]
    assert told.primitives[0].dimensions.tolist() == [0.2, 0.4, 0.6]
    assert told.primitives[1].dimensions.tolist() == [0.15], "a radius, not a diameter"
    first, second = told.primitive_poses
    assert (first.position.x, second.position.x, first.position.z) == (1.0, 3.0, 0.5)
    assert (first.orientation.w, first.orientation.z) == (0.8, 0.6)
    assert (told.pose.orientation.w, told.pose.position.x) == (1.0, 0.0)


def test_every_kind_that_is_asked_for_is_an_object_of_its_own() -> None:
    scene = Scene(kinds=["static", "unknown"], frame="world", prefix="cell/")
    static, unknown = scene.see(obstacles(MOVING, STATIC, STATIC, UNKNOWN))
    assert (static.id, static.header.frame_id, len(static.primitives)) == ("cell/static", "world", 2)
    assert (unknown.id, len(unknown.primitives)) == ("cell/unknown", 1)


def test_nobody_is_there_any_more_and_the_object_is_taken_away() -> None:
    scene = Scene()
    scene.see(obstacles(MOVING))
    [told] = scene.see(obstacles(STATIC))
    assert (told.id, told.operation, told.primitives) == ("twin_moving", told.REMOVE, [])
    assert scene.see(obstacles(STATIC)) == [], "MoveIt warns of what it has not"
    assert len(scene.see(obstacles(MOVING))) == 1


def test_what_was_told_is_taken_away_with_the_node() -> None:
    scene = Scene()
    scene.see(obstacles(MOVING))
    scene.node.deactivate()
    assert scene.heard[-1].operation == scene.heard[-1].REMOVE
    assert scene.see(obstacles(MOVING)) == [], "it has ended"


def test_a_planning_scene_is_told_no_more_often_than_it_may_be() -> None:
    scene = Scene(period_s=0.1)
    assert len(scene.see(obstacles(MOVING))) == 1
    assert scene.see(obstacles(MOVING), 0.05) == []
    assert len(scene.see(obstacles(MOVING), 0.05)) == 1
    assert len(scene.see(obstacles(MOVING), -5.0)) == 1, "a clock that was put back holds nothing up"


def test_nothing_is_made_for_nobody(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = Scene(listens=False)
    monkeypatch.setattr(MoveItNode, "_tell", None)
    assert scene.see(obstacles(MOVING)) == []


@pytest.mark.parametrize(
    ("parameters", "told"),
    [
        ({"kinds": ("people",)}, "kinds: expected some of moving, static, unknown, unseen, found 'people'"),
        ({"period_s": -1.0}, "period_s: expected a number of 0 or more, found -1"),
        ({"period_s": float("nan")}, "period_s: expected a number of 0 or more, found nan"),
        ({"period_s": float("inf")}, "period_s: expected a number of 0 or more, found inf"),
    ],
)
def test_wrong_parameters_are_named(parameters: dict[str, Any], told: str) -> None:
    with pytest.raises(TwinError, match=told):
        MoveItParameters(**parameters)


def test_its_type_is_that_of_moveit_2() -> None:
    """By the hash in code that rosidl has generated of moveit_msgs (`CollisionObject__EXPECTED_HASH`)."""
    announced = "RIHS01_74b0acd6d56be032bf4f764b2c2633f50588b5fb2bd71e97206c59052747cf7e"
    assert type_hash("moveit_msgs/msg/CollisionObject") == announced
