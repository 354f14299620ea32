"""What is written comes back, in log-time order, from files and folders, and other libraries read it too."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.writer import IndexType, Writer
from rosbags.highlevel import AnyReader
from rosbags.interfaces import QosDurability
from rosbags.rosbag2 import Reader, StoragePlugin
from rosbags.rosbag2 import Writer as FolderWriter
from rosbags.typesys import Stores, get_typestore

from twin_node.bag import BagError, LogWriter, open_log, read_rig_record, write_rig
from twin_node.bag.repair import repair
from twin_node.bag.rig import RecordedClock
from twin_node.messages import Message, MessageError, definition, message_type, serialize
from twin_node.messages.convert import camera_info
from twin_node.scene import Rig, RigCamera

START = 1_700_000_000_000_000_000
STRING = "std_msgs/msg/String"


def text(data: str) -> Message:
    return message_type(STRING)(data=data)


def camera(sigma_m: float = 0.01) -> RigCamera:
    K, clock = np.diag([50.0, 50.0, 1.0]), (-7, 12.5, START)
    return RigCamera("front", 64, 48, K, np.eye(4), "plumb_bob", np.zeros(5), sigma_m, *clock)


def write_example(path: Path, **options: str) -> None:
    with LogWriter(path, **options) as log:
        write_rig(log, Rig((camera(),), np.array([[-1.0, -1.5, 0.0], [1.0, 1.25, 2.0]])), START)
        for i in range(300):
            log.write("/chatter", text(f"{i} " + "x" * 10_000), START + 10 * i)
            log.write("/front/camera_info", camera_info(camera(), START + 10 * i), START + 10 * i)
        log.write_raw("/late", STRING, serialize(text("written late, logged early")), START + 5)


@pytest.mark.parametrize("name", ["log.mcap", "folder"])
def test_messages_come_back_in_log_time_order(tmp_path: Path, name: str) -> None:
    write_example(tmp_path / name)
    with open_log(tmp_path / name) as log:
        assert [(t.name, t.msgtype, t.count, t.latched) for t in log.topics] == [
            ("/chatter", STRING, 300, False),
            ("/front/camera_info", "sensor_msgs/msg/CameraInfo", 300, True),
            ("/late", STRING, 1, False),
            ("/tf_static", "tf2_msgs/msg/TFMessage", 1, True),
        ]
        messages = list(log.messages())
        stamps = [m.stamp for m in messages]
        assert stamps == sorted(stamps)
        assert (log.start_ns, log.end_ns) == (START, START + 2990)
        assert [m.topic for m in messages[:4]] == ["/tf_static", "/chatter", "/front/camera_info", "/late"]
        assert [m.message.data.split()[0] for m in messages if m.topic == "/chatter"] == [str(i) for i in range(300)]
        assert log.damage is None


@pytest.mark.parametrize("name", ["log.mcap", "folder"])
def test_topics_and_times_select(tmp_path: Path, name: str) -> None:
    write_example(tmp_path / name)
    with open_log(tmp_path / name) as log:
        chosen = list(log.messages(["/chatter"], START + 20, START + 50))
        assert [(m.topic, m.stamp - START) for m in chosen] == [("/chatter", 20), ("/chatter", 30), ("/chatter", 40)]
        assert list(log.messages([])) == []
        assert list(log.messages(["/nothing"])) == []
        assert list(log.messages(start_ns=START + 10_000)) == []
        first, second = log.messages(["/chatter"]), log.messages(["/late"])
        assert next(first).stamp == START
        assert next(second).stamp == START + 5
        assert next(first).stamp == START + 10


@pytest.mark.parametrize("name", ["log.mcap", "folder"])
def test_rig_and_metadata_come_back(tmp_path: Path, name: str) -> None:
    write_example(tmp_path / name)
    with open_log(tmp_path / name) as log:
        record = read_rig_record(log)
        np.testing.assert_array_equal(record.workspace, [[-1.0, -1.5, 0.0], [1.0, 1.25, 2.0]])
        assert record.sigmas_m == {"front": 0.01}
        assert record.clocks == {"front": RecordedClock(-7, 12.5, START)}
        [tf] = log.messages(["/tf_static"])
        assert tf.message.transforms[0].child_frame_id == "front_optical_frame"


def test_a_rig_record_of_nonsense_is_refused(tmp_path: Path) -> None:
    with LogWriter(tmp_path / "log.mcap") as log:
        log.write("/chatter", text("a"), START)
        log.add_metadata("twin_node.rig", {"workspace": "1 2 three"})
    with open_log(tmp_path / "log.mcap") as reader, pytest.raises(BagError, match=r"twin_node\.rig cannot be read"):
        read_rig_record(reader)


@pytest.mark.parametrize("compression", ["none", "zstd", "lz4"])
def test_same_calls_give_the_same_bytes(tmp_path: Path, compression: str) -> None:
    for name in ("a.mcap", "b.mcap"):
        write_example(tmp_path / name, compression=compression)
    assert (tmp_path / "a.mcap").read_bytes() == (tmp_path / "b.mcap").read_bytes()
    with open_log(tmp_path / "a.mcap") as log:
        assert sum(1 for _ in log.messages()) == 602


def test_same_calls_give_the_same_folder(tmp_path: Path) -> None:
    for place in ("a", "b"):
        (tmp_path / place).mkdir()
        write_example(tmp_path / place / "bag")
    files = sorted(path.name for path in (tmp_path / "a/bag").iterdir())
    assert files == ["bag.mcap", "metadata.yaml"]
    for file in files:
        assert (tmp_path / "a/bag" / file).read_bytes() == (tmp_path / "b/bag" / file).read_bytes()


def test_mcap_library_reads_our_file_as_ros2_profile(tmp_path: Path) -> None:
    write_example(tmp_path / "log.mcap")
    with (tmp_path / "log.mcap").open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        assert reader.get_header().profile == "ros2"
        schemas = {schema.name: schema for schema, _, _ in reader.iter_messages() if schema}
        assert schemas[STRING].encoding == "ros2msg"
        summary = reader.get_summary()
        assert summary is not None
        channels = {channel.topic: channel for channel in summary.channels.values()}
        assert {channel.message_encoding for channel in channels.values()} == {"cdr"}
        assert "durability: 1" in channels["/tf_static"].metadata["offered_qos_profiles"]
        assert "durability: 2" in channels["/chatter"].metadata["offered_qos_profiles"]


@pytest.mark.parametrize("name", ["log.mcap", "folder"])
def test_rosbags_reads_our_logs(tmp_path: Path, name: str) -> None:
    write_example(tmp_path / name)
    with AnyReader([tmp_path / name]) as reader:
        assert reader.message_count == 602
        latched = {
            connection.topic
            for connection in reader.connections
            if any(q.durability is QosDurability.TRANSIENT_LOCAL for q in connection.ext.offered_qos_profiles)
        }
        assert latched == {"/tf_static", "/front/camera_info"}
        [info] = [c for c in reader.connections if c.topic == "/front/camera_info"]
        _, _, raw = next(reader.messages([info]))
        np.testing.assert_array_equal(reader.deserialize(raw, info.msgtype).k.reshape(3, 3), camera().K)


@given(
    st.lists(st.tuples(st.integers(0, 50), st.sampled_from(["/a", "/b"])), min_size=1, max_size=60), st.integers(1, 3)
)
def test_any_order_of_stamps_is_merged_stably(tmp_path_factory: pytest.TempPathFactory, calls: list, size: int) -> None:
    path = tmp_path_factory.mktemp("order") / "log.mcap"
    with LogWriter(path) as log:
        for i, (stamp, topic) in enumerate(calls):
            log.write(topic, text(str(i)), stamp)
            if i % size == 0:
                log.flush()
    expected = sorted(range(len(calls)), key=lambda i: calls[i][0])
    with open_log(path) as reader:
        assert [int(m.message.data) for m in reader.messages()] == expected


@pytest.mark.parametrize("chunked", [True, False])
@pytest.mark.parametrize("index", [IndexType.NONE, IndexType.ALL])
def test_foreign_files_without_chunks_or_index(tmp_path: Path, chunked: bool, index: IndexType) -> None:
    path = tmp_path / "foreign.mcap"
    with path.open("wb") as file:
        writer = Writer(
            file, chunk_size=5000, use_chunking=chunked, index_types=index, use_statistics=index is IndexType.ALL
        )
        writer.start()
        schema = writer.register_schema("mine/msg/Pair", "ros2msg", b"uint8 a\nuint8 b\n")
        channel = writer.register_channel("/pairs", "cdr", schema)
        for i in reversed(range(200)):
            writer.add_message(channel, i, b"\0\1\0\0" + bytes([i, 2]) * 1, i)
        writer.finish()
    with open_log(path) as log:
        assert [(m.stamp, m.message.a, m.message.b) for m in log.messages()] == [(i, i, 2) for i in range(200)]
        assert [m.stamp for m in log.messages(start_ns=3, stop_ns=6)] == [3, 4, 5]
        assert (log.start_ns, log.end_ns) == (0, 199)
        assert log.topics[0].count == 200
        assert log.damage is None


def test_types_of_the_log_are_used_only_for_that_log(tmp_path: Path) -> None:
    with LogWriter(tmp_path / "log.mcap") as log:
        log.add_topic("/pairs", "mine/msg/Pair", definition="uint8 a\nuint8 b\n", latched=True)
        log.write_raw("/pairs", "mine/msg/Pair", b"\0\1\0\0\7\10", START)
    with open_log(tmp_path / "log.mcap") as reader:
        [item] = reader.messages()
        assert (item.message.a, item.message.b) == (7, 8)
        assert reader.topics[0].latched
    with pytest.raises(MessageError, match="mine/msg/Pair"):
        definition("mine/msg/Pair")


@pytest.mark.parametrize("plugin", list(StoragePlugin))
def test_folders_of_both_storages(tmp_path: Path, plugin: StoragePlugin) -> None:
    types = get_typestore(Stores.ROS2_JAZZY)
    with FolderWriter(tmp_path / "bag", version=9, storage_plugin=plugin) as bag:
        bag.set_custom_data("author", "me")
        bag.set_custom_data("of the job", '{"run": 12}')
        connection = bag.add_connection("/chatter", STRING, typestore=types)
        for i in range(10):
            bag.write(connection, START + i, serialize(text(str(i))))
    with open_log(tmp_path / "bag") as log:
        assert [m.message.data for m in log.messages(start_ns=START + 7)] == ["7", "8", "9"]
        assert log.metadata["author"] == {"value": "me"}
        assert log.metadata["of the job"] == {"value": '{"run": 12}'}
    assert repair(tmp_path / "bag", tmp_path / "whole.mcap").messages == 10
    with Reader(tmp_path / "bag") as reader:
        assert reader.message_count == 10


@pytest.mark.parametrize("value", ["12", "007", "yes", "12:30:45", "2026-02-30", "1.50"])
def test_custom_data_are_the_text_that_they_were_given_as(tmp_path: Path, value: str) -> None:
    """`ros2 bag record --custom-data run=12` writes it without quotes: such a folder was none of rosbag2's."""
    with FolderWriter(tmp_path / "bag", version=9) as bag:
        bag.set_custom_data("run", "VALUE")
        connection = bag.add_connection("/chatter", STRING, typestore=get_typestore(Stores.ROS2_JAZZY))
        bag.write(connection, START, serialize(text("a")))
    file = tmp_path / "bag" / "metadata.yaml"
    file.write_text(file.read_text().replace("VALUE", value))
    with open_log(tmp_path / "bag") as log:
        assert log.metadata["run"] == {"value": value}
        assert len(list(log.messages())) == 1
