"""What runs on the two machines of the network bench: a twin that publishes obstacles, and an arm that obeys them.

Started as a process per machine; the end of its input ends it.
"""

from __future__ import annotations

import json
import sys
import tempfile
import threading
import time
from dataclasses import dataclass, replace
from pathlib import Path

from twin_node.bench.graph_run import GraphRun
from twin_node.messages import convert
from twin_node.nodes.launch.launch_file import read_launch_file
from twin_node.nodes.topics import OBSTACLES, SEPARATION, kind_of_own
from twin_node.runtime.zenoh_session import ZenohParameters, close_session, open_router
from twin_node.runtime.zenoh_wire import ZenohWire
from twin_node.scene import Obstacles

RATE_HZ = 30.0
ARM_ALONE = """
launch:
  processes:
    arm: {nodes: [arm]}
/**:
  ros__parameters: {rig: {scenario: demo}}
arm:
  ros__parameters: {model: ur5e}
"""


@dataclass(frozen=True)
class Told:
    """A speed decision as the arm's machine hears it."""

    at: float
    """When it was heard, by the monotonic clock, which all machines of a host share, s."""
    fraction: float
    evidence: int
    """Stamp of the obstacles that it was made of, ns."""


def main() -> None:
    """The process: `twin ENDPOINT`, or `arm ENDPOINT ROUTER`, which prints every decision as a line of JSON."""
    role, endpoint, *routers = sys.argv[1:]
    ended = threading.Event()
    threading.Thread(target=_await_end, args=(ended,), name="input", daemon=True).start()
    if role == "twin":
        _publish_obstacles(endpoint, ended)
    else:
        _drive_arm(endpoint, tuple(routers), ended)


def _await_end(ended: threading.Event) -> None:
    sys.stdin.read()
    ended.set()


def _publish_obstacles(endpoint: str, ended: threading.Event) -> None:
    """Sets of no obstacles, from a router of its own: the arm may run."""
    parameters = ZenohParameters(router="builtin", endpoint=endpoint, domain=0)
    router = open_router(parameters)
    wire = ZenohWire(replace(parameters, router="external"))
    send = wire.publisher("twin", OBSTACLES, kind_of_own(OBSTACLES))
    due = time.monotonic()
    while not ended.wait(max(0.0, due - time.monotonic())):
        due += 1 / RATE_HZ
        send(convert.obstacles_to_message(Obstacles.none(time.time_ns())))
    wire.close()
    if router is not None:
        close_session(router)


def _drive_arm(endpoint: str, routers: tuple[str, ...], ended: threading.Event) -> None:
    """The arm's node, launched; what it says goes to the output."""

    def hear(message: object) -> None:
        told = convert.separation_from_message(message)
        print(json.dumps([time.monotonic(), told.speed_fraction, told.evidence_stamp]), flush=True)

    with tempfile.TemporaryDirectory(prefix="twin_node_") as folder:
        path = Path(folder) / "arm.yaml"
        path.write_text(ARM_ALONE)
        run = GraphRun(read_launch_file(path), endpoint, Path(folder), routers)
        try:
            run.listen(SEPARATION, hear)
            while not ended.is_set():
                run.spin(0.2, ended.is_set)
        finally:
            run.close()


if __name__ == "__main__":
    main()
