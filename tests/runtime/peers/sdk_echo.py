"""Echoes strings and one of our own messages through zenoh-ros2-sdk: `sdk_echo.py PORT OWN_DEFINITION OWN_HASH`."""

import os
import sys

from zenoh_ros2_sdk import ROS2Publisher, ROS2Subscriber
from zenoh_ros2_sdk.qos import QosDurability, QosProfile

STRING = "string data\n"
port, definition, own_hash = int(sys.argv[1]), sys.argv[2], sys.argv[3]
own = {"msg_type": "twin_msgs/msg/OccupancyLayer", "msg_definition": definition, "type_hash": own_hash}
string = {"msg_type": "std_msgs/msg/String", "msg_definition": STRING}

latched = QosProfile(durability=QosDurability.TRANSIENT_LOCAL, history_depth=1)
strings = ROS2Publisher(topic="/from_peer", router_port=port, **string)
layers = ROS2Publisher(topic="/own_from_peer", router_port=port, **own)
fields = list(layers.msg_class.__dataclass_fields__)


def echo_layer(message: object) -> None:
    layers.publish(**{name: getattr(message, name) for name in fields if not name.startswith("__")})


listeners = [
    ROS2Subscriber(
        topic="/to_peer", callback=lambda m: strings.publish(data=f"echo {m.data}"), router_port=port, **string
    ),
    ROS2Subscriber(
        topic="/latched",
        callback=lambda m: strings.publish(data=f"kept {m.data}"),
        router_port=port,
        qos=latched,
        **string,
    ),
    ROS2Subscriber(topic="/own_to_peer", callback=echo_layer, router_port=port, **own),
]
print("ready", flush=True)
sys.stdin.read()
os._exit(0)  # the package's session does not let go by itself
