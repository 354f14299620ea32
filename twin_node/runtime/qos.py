"""What a topic carries and how: message type and quality of service, as far as this graph uses them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from twin_node.runtime.arrivals import PATIENCE


@dataclass(frozen=True)
class Qos:
    """Quality of service of a topic; keep-last is the only history."""

    depth: int = 10
    """Messages kept for a subscriber that is busy, and of a latched topic for a late one; older ones are dropped."""
    reliable: bool = True
    latched: bool = False
    """Transient-local: a late subscriber is given the last messages, `depth` of every publisher's."""
    repeats: bool = False
    """A latched message soon comes anew: a reader without room waits for the next one, and holds nobody up."""
    most_bytes: float = math.inf
    """Bytes of messages kept for a subscriber that is busy; older ones are dropped, and counted, but for the newest."""
    patience: float = 0.0
    """How long a subscriber leaves a message for the next one, see `runtime.arrivals`; 0: not at all."""
    lifespan_s: float = math.inf
    """A message that has waited so long for a subscriber, one that hung, is dropped and counted."""


RELIABLE = Qos()
"""rclcpp's default profile."""
SENSOR_DATA = Qos(depth=5, reliable=False)
"""rmw_qos_profile_sensor_data."""
LATCHED = Qos(depth=1, latched=True)
LATCHED_BY_SEVERAL = Qos(depth=100, latched=True)
"""No message is all: each tells of some transforms, as `tf2_ros`' listeners have it, and as a log has them of many."""
NEWEST = Qos(depth=1)
"""Only the newest counts: what it replaces is dropped, and counted."""
FRESH = Qos(depth=1, patience=PATIENCE)
"""Only the newest counts, and an old one is left where a newer one is due: for what takes long to work on."""
ORDER = Qos(lifespan_s=10.0)
"""Somebody wants something done, who sees whether it is: later it may be wrong."""
EVERY = Qos(depth=100_000, most_bytes=256e6)
"""Nothing is to be lost within a process: about an hour of 30 Hz, or ten seconds of a camera's raw images while a disk
stands still; a reader that is slower for longer must not take all memory there is."""


@dataclass(frozen=True)
class TopicKind:
    """What a topic carries."""

    msgtype: str | None
    """Full ROS 2 name; None: a record that never leaves its process."""
    qos: Qos = RELIABLE
    type_hash: str | None = None
    """RIHS01 hash of a type that is not built in; None: of the built-in one, or of that which a message brings."""


KindOf = Callable[[str], TopicKind | None]
"""What is known about a topic by its name; None: nothing."""
