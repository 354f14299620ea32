"""Echoes strings and one of our own messages through zenoh-ros2-sdk: `sdk_echo.py PORT OWN_DEFINITION OWN_HASH`."""

import os
import queue
import sys
import threading

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


kept: list[str] = []
asked: queue.SimpleQueue[None] = queue.SimpleQueue()


def echo(message: object) -> None:
    """Tells with every echo what came to the late joiner."""
    asked.put(None)
    strings.publish(data=f"echo {message.data}")
    for data in kept:
        strings.publish(data=f"kept {data}")


def keep(message: object) -> None:
    kept.append(message.data)
    strings.publish(data=f"kept {message.data}")


def join_late() -> None:
    """The package asks for what is latched once, and at times too early for its own session: another joins then."""
    while not kept:
        asked.get()
        listeners.append(ROS2Subscriber(topic="/latched", callback=keep, router_port=port, qos=latched, **string))


def echo_layer(message: object) -> None:
    layers.publish(**{name: getattr(message, name) for name in fields if not name.startswith("__")})


listeners = [
    ROS2Subscriber(topic="/to_peer", callback=echo, router_port=port, **string),
    ROS2Subscriber(topic="/own_to_peer", callback=echo_layer, router_port=port, **own),
]
threading.Thread(target=join_late, daemon=True).start()
print("ready", flush=True)
sys.stdin.read()
os._exit(0)  # the package's session does not let go by itself
