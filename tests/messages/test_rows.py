"""Sequences of flat structs as arrays: the bytes and the messages of the plain way, whatever is sent."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rosbags.typesys.store import Typestore

from twin_node.messages import MessageError, builtin_types, convert, deserialize, message_type, serialize
from twin_node.messages.convert.forecast import OBSTACLE_ARRAY
from twin_node.messages.rows import RowCodec, Rows
from twin_node.scene import ObstacleKind, ObstacleShape

FLAT = "twin_msgs/msg/ObstacleArray"


def store() -> Typestore:
    return builtin_types()._store


def codec() -> RowCodec:
    found = builtin_types().row_codec(OBSTACLE_ARRAY)
    assert found is not None
    return found


def some(count: int, seed: int, frame: str = "base_link") -> Any:
    """A message whose every number is another."""
    rng = np.random.default_rng(seed)
    rows = np.zeros(count, codec().dtype)
    for name in rows.dtype.names or ():
        kind = rows.dtype[name]
        rows[name] = rng.normal(size=count) if kind.kind == "f" else rng.integers(0, 200, count)
    header = message_type("std_msgs/msg/Header")(
        stamp=message_type("builtin_interfaces/msg/Time")(sec=3, nanosec=seed), frame_id=frame
    )
    return message_type(FLAT)(header=header, obstacles=codec().rows(rows))


def plain(message: Any) -> Any:
    """The message with single messages in place of rows."""
    return type(message)(header=message.header, obstacles=list(message.obstacles))


@given(count=st.integers(0, 5), seed=st.integers(0, 1000), frame=st.text("abc_", max_size=12))
def test_bytes_are_those_of_the_plain_way_and_so_is_what_is_read_from_them(count: int, seed: int, frame: str) -> None:
    message = some(count, seed, frame)
    expected = bytes(store().serialize_cdr(plain(message), FLAT, little_endian=True))
    assert bytes(serialize(message)) == expected
    read = deserialize(expected, FLAT)
    again = store().deserialize_cdr(expected, FLAT)
    assert read == again
    assert list(read.obstacles) == list(again.obstacles)


def test_rows_that_begin_where_they_may_are_not_copied() -> None:
    data = bytes(serialize(some(4, 1)))
    read = deserialize(data, FLAT)
    assert isinstance(read.obstacles, Rows)
    assert np.shares_memory(read.obstacles.array, np.frombuffer(data, np.uint8))
    assert not isinstance(deserialize(bytes(serialize(some(4, 1, "base_link_of_the_cell"))), FLAT).obstacles, Rows)


def test_rows_are_a_sequence_of_messages() -> None:
    rows = some(4, 1).obstacles
    assert [o.id for o in rows] == rows.array["id"].tolist()
    assert rows[2].pose.orientation.w == rows.array["pose.orientation.w"][2]
    assert rows[1:3] == list(rows)[1:3]
    assert rows[-1].valid_to.sec == rows.array["valid_to.sec"][-1]


def test_obstacles_of_both_ways_are_the_same() -> None:
    message = some(7, 2)
    message.obstacles.array["kind"] %= len(ObstacleKind)
    message.obstacles.array["shape"] %= len(ObstacleShape)
    fast, slow = convert.obstacles_from_message(message), convert.obstacles_from_message(plain(message))
    for name in ("ids", "kinds", "shapes", "positions", "quats", "sizes", "velocities", "bounds", "experts"):
        np.testing.assert_array_equal(getattr(fast, name), getattr(slow, name))
    np.testing.assert_array_equal(fast.valid_from, slow.valid_from)
    np.testing.assert_array_equal(fast.valid_to, slow.valid_to)


@pytest.mark.parametrize("cut", [1, 4, 100, 168, 700])
def test_bytes_that_are_cut_off_are_refused(cut: int) -> None:
    with pytest.raises(MessageError, match="are not a CDR message of this type"):
        deserialize(bytes(serialize(some(4, 1)))[:-cut], FLAT)


def test_other_types_are_left_to_the_plain_way() -> None:
    for name in ("sensor_msgs/msg/JointState", "visualization_msgs/msg/MarkerArray", "twin_msgs/msg/OccupancyForecast"):
        assert builtin_types().row_codec(name) is None


@pytest.mark.parametrize("more", [-8, -1, 1, 8, 200])
def test_bytes_of_another_length_than_the_rows_take_are_no_rows(more: int) -> None:
    """Larger structs of a newer sender, read as smaller ones, would put obstacles anywhere."""
    packed = codec().pack(some(3, 1))
    assert packed is not None
    assert codec().unpack(packed) is not None
    assert codec().unpack(memoryview((bytes(packed) + bytes(200))[: len(packed) + more])) is None


def test_a_frame_longer_than_all_the_bytes_is_none() -> None:
    packed = codec().pack(some(3, 1))
    assert packed is not None
    for length in range(len(packed) - 24, len(packed) + 16):
        damaged = bytearray(packed)
        damaged[12:16] = length.to_bytes(4, "little")
        assert codec().unpack(memoryview(damaged)) is None
