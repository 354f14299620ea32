"""The layouts for Foxglove and RViz name topics that the graph publishes, and what their messages have."""

from __future__ import annotations

import json
from typing import Any

import pytest

from twin_node import resources
from twin_node.messages import convert, message_type
from twin_node.messages.convert.pointcloud2 import VOXEL
from twin_node.nodes.topics import GAUSSIANS, OCCUPIED_POINTS, kind_of
from twin_node.scene import GaussianCloud
from twin_node.yaml_file import parse_yaml

SHOWN = {"PointCloud2": "sensor_msgs", "MarkerArray": "visualization_msgs", "Marker": "visualization_msgs"}
"""Display of `rviz_default_plugins` -> the package of what it shows, whose type has its name."""


def test_every_topic_of_the_layout_is_one_of_the_graph() -> None:
    layout = json.loads(resources.find("launch/foxglove_layout.json").read_text())["configById"]
    shown = list(layout["3D!twin"]["topics"])
    shown += [layout["DiagnosticSummary!all"]["topicToRender"], *layout["Image!front"]["imageMode"].values()]
    for topic in shown:
        assert kind_of(topic).msgtype is not None, topic
    for plot in ("Plot!speed", "Plot!latency"):
        for path in layout[plot]["paths"]:
            topic, _, field = path["value"].partition(".")
            assert field in message_type(str(kind_of(topic).msgtype)).__dataclass_fields__


def rviz_displays() -> list[dict[str, Any]]:
    content: Any = parse_yaml(resources.find("launch/twin.rviz").read_text())
    manager = content["Visualization Manager"]
    assert manager["Global Options"]["Fixed Frame"] == "base_link"
    return [display for display in manager["Displays"] if "Topic" in display]


@pytest.mark.parametrize("display", rviz_displays(), ids=lambda display: display["Name"])
def test_rviz_subscribes_as_the_graph_publishes(display: dict[str, Any]) -> None:
    """A late subscriber is given what is latched only if it asks for that, and nothing of a topic that is not."""
    topic, name = display["Topic"], display["Class"].removeprefix("rviz_default_plugins/")
    kind = kind_of(topic["Value"])
    assert kind is not None and kind.msgtype == f"{SHOWN[name]}/msg/{name}"
    assert topic["Reliability Policy"] == ("Reliable" if kind.qos.reliable else "Best Effort")
    assert topic["Durability Policy"] == ("Transient Local" if kind.qos.latched else "Volatile")
    assert display["Enabled"] is display["Value"]


def test_points_have_the_channels_that_rviz_colours_them_by() -> None:
    displays = {display["Topic"]["Value"]: display for display in rviz_displays()}
    assert displays[GAUSSIANS]["Color Transformer"] == "RGB8"
    assert "rgb" in {field.name for field in convert.gaussians_to_pointcloud2(GaussianCloud.none(), 0).fields}
    assert displays[OCCUPIED_POINTS]["Channel Name"] in (VOXEL.names or ())
