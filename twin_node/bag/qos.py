"""Quality of service as logs store it: `offered_qos_profiles`, one YAML list per topic."""

from __future__ import annotations

from collections.abc import Sequence

from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag2 import ReaderError
from rosbags.rosbag2.metadata import dump_qos_v8, parse_qos

LATCHED_TOPICS = ("/tf_static", "/robot_description", "/twin/gaussians")
LATCHED_SUFFIX = "/camera_info"

INFINITE = QosTime(9223372036, 854775807)
"""rmw's infinite duration (rmw/time.h: 2^63 - 1 ns)."""

DEFAULT_DEPTH = 10
"""Depth of rclcpp's default profile."""


def is_latched(topic: str) -> bool:
    """Whether late joiners need the last message of a topic of ours: what is sent once or rarely."""
    return topic in LATCHED_TOPICS or topic.endswith(LATCHED_SUFFIX)


def profile(latched: bool) -> Qos:
    """Reliable profile of a topic: transient-local with depth 1 if latched, else volatile with rclcpp's depth."""
    return Qos(
        history=QosHistory.KEEP_LAST,
        depth=1 if latched else DEFAULT_DEPTH,
        reliability=QosReliability.RELIABLE,
        durability=QosDurability.TRANSIENT_LOCAL if latched else QosDurability.VOLATILE,
        deadline=INFINITE,
        lifespan=INFINITE,
        liveliness=QosLiveliness.AUTOMATIC,
        liveliness_lease_duration=INFINITE,
        avoid_ros_namespace_conventions=False,
    )


def offered_qos_profiles(latched: bool) -> str:
    """The profile of a topic of ours as logs store it."""
    return stored([profile(latched)])


def profiles_of(text: str) -> tuple[Qos, ...]:
    """The profiles of a stored `offered_qos_profiles`, whatever distribution wrote it; none of an unreadable one."""
    try:
        return tuple(parse_qos(text))
    except (ReaderError, KeyError, TypeError, AttributeError, ValueError, RecursionError):
        return ()


def stored(profiles: Sequence[Qos]) -> str:
    """Profiles as YAML with numeric policies, the form that every ROS 2 distribution reads."""
    return dump_qos_v8(list(profiles))


def any_transient_local(profiles: Sequence[Qos]) -> bool:
    """Whether one of the profiles is transient-local."""
    return any(qos.durability is QosDurability.TRANSIENT_LOCAL for qos in profiles)
