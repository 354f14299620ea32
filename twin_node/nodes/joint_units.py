"""Whether the joints of a log are told in radians, by how far they go."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping, Sequence

import numpy as np

from twin_node.bag import LogReader
from twin_node.errors import TwinError
from twin_node.robot.urdf_ranges import farthest_angles
from twin_node.scene import Float64

LARGEST_ANGLE_RAD = 2 * np.pi + 0.1
"""Joints of UR arms turn by one turn each way; more is degrees, or not their angle."""
BEYOND_RANGE_RAD = 0.1
"""By so much may a joint be found beyond its range."""
RESTS_RAD = 0.1
"""What went no farther says nothing of its unit."""
ENDLESS = ("wheel", "caster")
"""In the names of joints that turn for ever."""
DESCRIPTION = "robot_description"
"""Last part of the names of topics that tell robots' URDFs."""


def ranges_told(log: LogReader) -> dict[str, float]:
    """Joint -> how far it may go, rad, by the robots' descriptions that a log has."""
    texts: dict[str, None] = {}  # some say the same again and again
    for topic, msgtype in log.spoken.items():
        if topic.rpartition("/")[2] == DESCRIPTION and msgtype == "std_msgs/msg/String":
            for message in log.messages(topic):
                with contextlib.suppress(TwinError):  # of what cannot be read, who reads it tells
                    texts[message.message.data] = None
    return {name: far for text in texts for name, far in farthest_angles(text).items()}


def angle_fault(names: Sequence[str], farthest: Float64, ranges: Mapping[str, float]) -> str | None:
    """What speaks against the unit of a device's joints; None: nothing.

    `farthest` [J]: how far each went, rad, without sign. `ranges`: see `ranges_told`. Degrees would be those of most
    joints: one of several that goes on and on is a joint without end.
    """
    judged = {
        name: far
        for name, far in zip(names, farthest.tolist(), strict=True)
        if far > RESTS_RAD and not _may_go(name, far, ranges)
    }
    beyond = {name: far for name, far in judged.items() if far > LARGEST_ANGLE_RAD}
    if not beyond or 2 * len(beyond) < len(judged):
        return None
    most = max(beyond, key=lambda name: beyond[name])
    return (
        f"positions up to {beyond[most]:.1f} rad: more than a turn; are they degrees? If {most} turns on and on, "
        f"record /{DESCRIPTION} too, which says so"
    )


def _may_go(name: str, far: float, ranges: Mapping[str, float]) -> bool:
    """Whether it is known that a joint goes farther than a turn, and so far, rad."""
    is_known = any(word in name.lower() for word in ENDLESS) or far <= ranges.get(name, 0.0) + BEYOND_RANGE_RAD
    return far > LARGEST_ANGLE_RAD and is_known
