"""Serves one service and asks another through zenoh-ros2-sdk: `sdk_services.py PORT HASH`."""

import os
import sys
import threading

from zenoh_ros2_sdk import ROS2Publisher, ROS2ServiceClient, ROS2ServiceServer

port = int(sys.argv[1])
kind = {
    "srv_type": "rcl_interfaces/srv/GetParameterTypes",
    "request_definition": "string[] names\n",
    "response_definition": "uint8[] types\n",
    "type_hash": sys.argv[2],
    "router_port": port,
}
told = ROS2Publisher(
    topic="/from_peer", msg_type="std_msgs/msg/String", msg_definition="string data\n", router_port=port
)


def answer(request: object) -> object:
    """Types that stand for the lengths of the names."""
    import numpy as np

    return server.response_msg_class(types=np.array([len(name) for name in request.names], np.uint8))


def ask() -> None:
    """Asks again and again, and tells what comes: discovery takes its time."""
    client = ROS2ServiceClient("/twin/get_parameter_types", timeout=1.0, **kind)
    while True:
        response = client.call(names=["on", "width"])
        told.publish(data="none" if response is None else f"types {list(map(int, response.types))}")


server = ROS2ServiceServer("/peer/get_parameter_types", callback=answer, **kind)
threading.Thread(target=ask, daemon=True).start()
print("ready", flush=True)
sys.stdin.read()
os._exit(0)  # the package's session does not let go by itself
