"""Tells the user of cameras that send nothing: a twin without images waits, and its diagnostics alone would say so."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

from twin_node.nodes.topics import CameraTopics
from twin_node.runtime.rmw_zenoh import Endpoint, EntityKind

LOOK_S = 1.0
"""How often `look` is to be called, s."""
PATIENCE_S = 8.0
"""After so long without an image a camera is told of, s: devices take some seconds to begin. Twice as long after each
time that it has sent again, so that one which sends rarely is not told of for ever."""


class SilentCameras:
    """Says once that cameras send nothing and who should, and that they send."""

    def __init__(
        self,
        cameras: Sequence[CameraTopics],
        resolved: Callable[[str], str],
        endpoints: Callable[[], Sequence[Endpoint]],
        say: Callable[[str], None],
    ) -> None:
        """`resolved(topic)`: its name on the graph, whose publishers and subscribers are `endpoints()`."""
        self._cameras = cameras
        self._resolved = resolved
        self._endpoints = endpoints
        self._say = say
        self._heard_s: dict[str, float] = {}
        """When each camera was heard last, or looked for first, s of the monotonic clock."""
        self._patience_s = {camera.name: PATIENCE_S for camera in cameras}
        self._told: set[str] = set()

    def hear(self, name: str) -> None:
        """An image of a camera has come."""
        self._heard_s[name] = time.monotonic()
        if name in self._told:
            self._told.remove(name)
            self._patience_s[name] *= 2
            self._say(f"images of {name} come")

    def look(self) -> None:
        """Tells of those that have been silent for long."""
        now = time.monotonic()
        silent = [camera for camera in self._cameras if camera.name not in self._told and self._is_silent(camera, now)]
        if not silent:
            return
        self._told.update(camera.name for camera in silent)
        publishers: dict[str, set[str]] = {}
        for one in self._endpoints():
            if one.kind is EntityKind.PUBLISHER:
                publishers.setdefault(one.topic, set()).add(one.node.name)
        topics = {camera.name: self._resolved(camera.image) for camera in silent}
        lost = [name for name, topic in topics.items() if topic not in publishers]
        if lost:
            self._say(
                f"no image of {', '.join(lost)}: nobody publishes {', '.join(topics[name] for name in lost)}; "
                "'twin_node doctor' says who is there (of ROS 2 nodes those on rmw_zenoh_cpp)"
            )
        for name in (name for name in topics if name not in lost):
            who = " and ".join(sorted(publishers[topics[name]]))
            self._say(f"no image of {name}: {who} publishes {topics[name]}, but nothing comes")

    def _is_silent(self, camera: CameraTopics, now: float) -> bool:
        return now - self._heard_s.setdefault(camera.name, now) > self._patience_s[camera.name]
