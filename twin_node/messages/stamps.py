"""Stamps: integer nanoseconds here, `builtin_interfaces` seconds and nanoseconds in messages."""

from __future__ import annotations

from numbers import Integral

from twin_node.messages.types import Message, MessageError, message_type

NS_PER_S = 1_000_000_000


def to_time(stamp_ns: int) -> Message:
    """`builtin_interfaces/msg/Time` of a stamp in ns. Raises as `require_stamp` does."""
    require_stamp(stamp_ns, "stamp")
    seconds, nanoseconds = divmod(int(stamp_ns), NS_PER_S)
    return message_type("builtin_interfaces/msg/Time")(sec=seconds, nanosec=nanoseconds)


def require_stamp(stamp_ns: int, name: str) -> None:
    """Raises `MessageError`, naming it, for a stamp that is no whole ns or outside of 1970 to 2038 (int32 seconds)."""
    if not isinstance(stamp_ns, Integral):
        raise MessageError(
            f"{name}: expected whole nanoseconds, found {stamp_ns!r}; of seconds give round(1e9 * seconds)"
        )
    if not 0 <= stamp_ns < 2**31 * NS_PER_S:
        raise MessageError(
            f"{name} {stamp_ns} ns: expected 0 to {2**31 * NS_PER_S - 1} ns since 1970 (ROS seconds are int32); "
            "check the unit of the stamp"
        )


def from_time(time: Message) -> int:
    """Stamp in ns of a `builtin_interfaces/msg/Time`."""
    return int(time.sec) * NS_PER_S + int(time.nanosec)


def to_duration(duration_ns: int) -> Message:
    """`builtin_interfaces/msg/Duration` of a time span in ns. Raises `MessageError` beyond 68 years (int32 seconds)."""
    seconds, nanoseconds = divmod(int(duration_ns), NS_PER_S)
    if not -(2**31) <= seconds < 2**31:
        raise MessageError(
            f"time span {duration_ns} ns: expected at most 68 years (ROS seconds are int32); check its unit"
        )
    return message_type("builtin_interfaces/msg/Duration")(sec=seconds, nanosec=nanoseconds)


def from_duration(duration: Message) -> int:
    """Time span in ns of a `builtin_interfaces/msg/Duration`."""
    return int(duration.sec) * NS_PER_S + int(duration.nanosec)


def header(stamp_ns: int, frame_id: str) -> Message:
    """`std_msgs/msg/Header` of a stamp in ns and a frame."""
    return message_type("std_msgs/msg/Header")(stamp=to_time(stamp_ns), frame_id=frame_id)


def header_stamp(message: Message) -> int:
    """Stamp in ns of a message's header."""
    return from_time(message.header.stamp)
