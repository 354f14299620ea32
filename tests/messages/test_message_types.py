"""Types, hashes and CDR against published values; arrays without copies; definitions that a log brings along."""

import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_typestore

from twin_node import resources
from twin_node.messages import (
    MessageError,
    builtin_types,
    definition,
    deserialize,
    from_duration,
    from_time,
    message_type,
    serialize,
    to_duration,
    to_time,
    type_hash,
)
from twin_node.messages.types import read_types
from twin_node.runtime.zenoh_session import DISTRIBUTIONS

OWN_TYPES = sorted(path.stem for path in resources.find("msgs/msg").glob("*.msg"))


def test_every_own_type_is_built_by_cmake() -> None:
    listed = re.findall(r'"msg/(\w+)\.msg"', resources.find("msgs/CMakeLists.txt").read_text())
    assert sorted(listed) == OWN_TYPES


@pytest.mark.parametrize("name", OWN_TYPES)
def test_own_types_are_known_and_hashed(name: str) -> None:
    msgtype = f"twin_msgs/msg/{name}"
    assert message_type(msgtype).__msgtype__ == msgtype
    assert re.fullmatch(r"RIHS01_[0-9a-f]{64}", type_hash(msgtype))
    assert builtin_types().extended({msgtype: definition(msgtype)}).type_hash(msgtype) == type_hash(msgtype)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("{ no definition", r"Wrong\.msg: not a ROS 2 message definition"),
        ("twin_msgs/Missing item\n", "twin_msgs/msg/Wrong: uses twin_msgs/msg/Missing, defined nowhere"),
        ("Missing[] items\n", "twin_msgs/msg/Wrong: uses twin_msgs/msg/Missing, defined nowhere"),
    ],
)
def test_a_wrong_definition_file_is_named(tmp_path: Path, content: str, words: str) -> None:
    (tmp_path / "Right.msg").write_text("uint8 value\n")
    assert "twin_msgs/msg/Right" in read_types(tmp_path)
    (tmp_path / "Wrong.msg").write_text(content)
    with pytest.raises(MessageError, match=words) as caught:
        read_types(tmp_path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("distribution", sorted({*DISTRIBUTIONS} - {"humble", "rolling"}))
@pytest.mark.parametrize(
    "msgtype",
    [
        "diagnostic_msgs/msg/DiagnosticArray",
        "rosgraph_msgs/msg/Clock",
        "sensor_msgs/msg/CameraInfo",
        "sensor_msgs/msg/CompressedImage",
        "sensor_msgs/msg/Image",
        "sensor_msgs/msg/JointState",
        "sensor_msgs/msg/PointCloud2",
        "std_msgs/msg/Empty",
        "tf2_msgs/msg/TFMessage",
        "trajectory_msgs/msg/JointTrajectory",
        "visualization_msgs/msg/MarkerArray",
    ],
)
def test_every_distribution_announces_what_the_graph_speaks_alike(distribution: str, msgtype: str) -> None:
    """Else what its nodes publish would be dropped without a word."""
    theirs = get_typestore(Stores[f"ROS2_{distribution.upper()}"]).hash_rihs01(msgtype)
    assert type_hash(msgtype) == theirs


def test_hashes_are_those_that_ros_announces() -> None:
    # sources: design document of rmw_zenoh for String; `ros2 topic info -v` output in public files for PointCloud2
    assert type_hash("std_msgs/msg/String") == "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
    expected = "RIHS01_9198cabf7da3796ae6fe19c4cb3bdd3525492988c70522628af5daa124bae2b5"
    assert type_hash("sensor_msgs/msg/PointCloud2") == expected


def test_cdr_is_the_standard_layout() -> None:
    # encapsulation CDR_LE, then uint32 length with the terminator, then the characters (OMG DDSI-RTPS 10.2)
    assert bytes(serialize(message_type("std_msgs/msg/String")(data="hey"))) == b"\0\1\0\0\4\0\0\0hey\0"


def test_arrays_are_views_of_the_bytes() -> None:
    layer = message_type("twin_msgs/msg/OccupancyLayer")(
        horizon=to_duration(50_000_000),
        indices=np.arange(1000, dtype=np.uint32),
        probability=np.full(1000, 255, dtype=np.uint8),
    )
    data = bytes(serialize(layer))
    back = deserialize(data, layer.__msgtype__)
    np.testing.assert_array_equal(back.indices, layer.indices)
    assert np.shares_memory(back.indices, np.frombuffer(data, dtype=np.uint8))
    assert not back.indices.flags.writeable


@given(st.binary(max_size=200), st.sampled_from(["twin_msgs/msg/ObstacleArray", "sensor_msgs/msg/PointCloud2"]))
def test_random_bytes_are_a_message_or_a_clear_error(data: bytes, msgtype: str) -> None:
    try:
        assert deserialize(data, msgtype).__msgtype__ == msgtype
    except MessageError as error:
        assert msgtype in str(error)
        assert "\n" not in str(error)


def test_unknown_type_is_named() -> None:
    with pytest.raises(MessageError, match="sensor_msgs/msg/Imag: unknown message type"):
        message_type("sensor_msgs/msg/Imag")


def test_a_logs_definition_wins_over_the_built_in_one() -> None:
    types = builtin_types().extended({"std_msgs/msg/String": "string data\nuint32 count\n"})
    message = types.message_type("std_msgs/msg/String")(data="a", count=7)
    assert types.deserialize(types.serialize(message), "std_msgs/msg/String").count == 7
    assert not hasattr(message_type("std_msgs/msg/String")(data="a"), "count")


def test_new_types_and_idl_are_taken_from_definitions() -> None:
    idl = "=" * 80 + "\nIDL: mine/msg/Point\nmodule mine { module msg { struct Point { double x; }; }; };\n"
    text = "mine/Inner[] items\n" + "=" * 80 + "\nMSG: mine/Inner\nint16 value\n"
    types = builtin_types().extended({"mine/msg/Outer": text, "mine/msg/Point": idl})
    inner = types.message_type("mine/msg/Inner")
    message = types.message_type("mine/msg/Outer")(items=[inner(value=3), inner(value=-3)])
    assert [i.value for i in types.deserialize(types.serialize(message), "mine/msg/Outer").items] == [3, -3]
    assert types.message_type("mine/msg/Point")(x=1.5).x == 1.5


@pytest.mark.parametrize(
    "text", ["string data\nstring data\n", "uint8 A=1\nuint8 A=2\nstring b\n", "Bad inner\n", "Bad[] inner\n"]
)
def test_a_definition_that_none_can_have_leaves_the_rest(text: str) -> None:
    """Damaged logs bring such: names that come twice, types within themselves."""
    given = {"std_msgs/msg/String": text, "mine/msg/Bad": text, "mine/msg/Good": "uint8 a\n"}
    types = builtin_types().extended(given)
    assert "mine/msg/Bad" not in types
    assert "mine/msg/Good" in types
    message = types.deserialize(serialize(message_type("std_msgs/msg/String")(data="as ever")), "std_msgs/msg/String")
    assert message.data == "as ever"


def test_a_definition_that_cannot_be_parsed_leaves_the_rest() -> None:
    types = builtin_types().extended({"mine/msg/Bad": "this is no definition at all {"})
    assert "mine/msg/Bad" not in types
    assert "std_msgs/msg/String" in types


@given(st.integers(0, 2**31 * 10**9 - 1))
def test_stamps_survive(stamp: int) -> None:
    time = to_time(stamp)
    assert 0 <= time.nanosec < 10**9
    assert from_time(time) == stamp


@given(st.integers(-(10**18), 10**18))
def test_durations_survive(span: int) -> None:
    assert from_duration(to_duration(span)) == span


@pytest.mark.parametrize("stamp", [-1, 2**31 * 10**9])
def test_stamps_that_ros_cannot_hold_are_refused(stamp: int) -> None:
    with pytest.raises(MessageError, match=str(stamp)):
        to_time(stamp)


@pytest.mark.parametrize("span", [2**31 * 10**9, -(2**31) * 10**9 - 1])
def test_durations_that_ros_cannot_hold_are_refused(span: int) -> None:
    with pytest.raises(MessageError, match=str(span)):
        to_duration(span)
