"""The layout for Foxglove names topics that the graph publishes, and fields that their messages have."""

from __future__ import annotations

import json

from twin_node import resources
from twin_node.messages import message_type
from twin_node.nodes.topics import kind_of


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
