"""What a recorder of a live graph says of topics whose types it cannot record."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from recorder_studio import Studio

from twin_node.runtime.clock import SystemClock
from twin_node.runtime.qos import Qos
from twin_node.runtime.rmw_zenoh import Endpoint, EntityKind, NodeIdentity


@pytest.mark.parametrize("more", [{"topics": ("/odd",)}, {"all": True}])
def test_a_topic_of_an_unknown_type_is_not_recorded_and_told_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, more: dict[str, Any]
) -> None:
    monkeypatch.setattr("twin_node.nodes.live.recorder.DISCOVERY_S", 0.0)
    studio = Studio(tmp_path / "run.mcap", SystemClock(), **more)
    who = NodeIdentity("1", 1, "somebody")
    studio.graph = (Endpoint(EntityKind.PUBLISHER, who, 1, "/odd", "odd_msgs/msg/Odd", "RIHS01_0", Qos()),)
    for _ in range(3):
        studio.step()
    assert studio.said == ["not recorded: /odd, whose type odd_msgs/msg/Odd is not known here"]
    studio.end()


@pytest.mark.parametrize("more", [{"topics": ("/joint_states",)}, {"all": True}])
def test_another_definition_of_a_type_is_told_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, more: dict[str, Any]
) -> None:
    """Keys on the graph hold its hash: nothing of that topic ever came, and nobody was told."""
    monkeypatch.setattr("twin_node.nodes.live.recorder.DISCOVERY_S", 0.0)
    studio = Studio(tmp_path / "run.mcap", SystemClock(), **more)
    of = ("/joint_states", "sensor_msgs/msg/JointState")
    same, other, own = (NodeIdentity(str(i), i, name) for i, name in enumerate(("same", "other", "recorder")))
    studio.graph = (
        Endpoint(EntityKind.PUBLISHER, same, 1, *of, "RIHS01_0", Qos()),
        Endpoint(EntityKind.SUBSCRIBER, other, 2, *of, "RIHS01_2", Qos()),
        Endpoint(EntityKind.SUBSCRIBER, own, 3, *of, "RIHS01_0", Qos()),
    )
    for _ in range(3):
        studio.step()
    assert studio.said == []
    studio.graph = (*studio.graph, Endpoint(EntityKind.PUBLISHER, other, 4, *of, "RIHS01_1", Qos()))
    for _ in range(3):
        studio.step()
    assert studio.said == [
        "not recorded: /joint_states of other, whose sensor_msgs/msg/JointState has another definition than the one "
        "known here; 'twin_node doctor' tells more"
    ]
    studio.end()


@pytest.mark.parametrize("more", [{"topics": ("/note",)}, {"all": True}])
def test_a_second_type_under_a_topic_s_name_is_told_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, more: dict[str, Any]
) -> None:
    """A log has one type per topic; on the graph two nodes may use one name for two things, whenever they come."""
    monkeypatch.setattr("twin_node.nodes.live.recorder.DISCOVERY_S", 0.0)
    studio = Studio(tmp_path / "run.mcap", SystemClock(), **more)
    kinds = ("std_msgs/msg/String", "std_msgs/msg/Empty")
    nodes = (NodeIdentity("1", 1, "first"), NodeIdentity("2", 1, "second"))
    ends = [
        Endpoint(EntityKind.PUBLISHER, node, 1, "/note", kind, "RIHS01_0", Qos())
        for node, kind in zip(nodes, kinds, strict=True)
    ]
    for number in (1, 2, 2, 2):
        studio.graph = tuple(ends[:number])
        studio.step()
    assert studio.said == [
        "not recorded: /note of type std_msgs/msg/Empty, which second sends; a log has one type per topic, and "
        "std_msgs/msg/String came first"
    ]
    studio.end()
