"""Logs that other programs make, and that are sound in parts: what is not read is told, the rest comes whole."""

import sqlite3
import struct
from collections.abc import Callable
from pathlib import Path

import pytest
from mcap.reader import make_reader
from mcap.records import Message
from mcap.writer import Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as FolderWriter
from rosbags.typesys import Stores, get_typestore

from twin_node.bag import BagError, open_log
from twin_node.bag.repair import repair
from twin_node.messages import definition, message_type, serialize

STRING, EMPTY = "std_msgs/msg/String", "std_msgs/msg/Empty"
START = 1_700_000_000_000_000_000
COUNT = 20


def text(number: int) -> bytes:
    return bytes(serialize(message_type(STRING)(data=f"number {number}")))


def mcap_file(path: Path, fill: Callable[[Writer], None]) -> Path:
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start("ros2", "a test")
        fill(writer)
        writer.finish()
    return path


def add_strings(writer: Writer) -> None:
    schema = writer.register_schema(STRING, "ros2msg", definition(STRING).encode())
    channel = writer.register_channel("/text", "cdr", schema)
    for number in range(COUNT):
        writer.add_message(channel, START + number, text(number), START + number)


def add_json(writer: Writer) -> None:
    schema = writer.register_schema(STRING, "jsonschema", b'{"type": "object"}')
    channel = writer.register_channel("/notes", "json", schema)
    writer.add_message(channel, START, b'{"data": "no cdr"}', START)


def add_another_type(writer: Writer) -> None:
    schema = writer.register_schema(EMPTY, "ros2msg", definition(EMPTY).encode())
    channel = writer.register_channel("/text", "cdr", schema)
    writer.add_message(channel, START, bytes(serialize(message_type(EMPTY)(structure_needs_at_least_one_member=0))), 0)


@pytest.mark.parametrize(
    ("add", "line"),
    [
        (add_json, "/notes: 1 message in json; expected cdr"),
        (add_another_type, f"/text: 1 message of {EMPTY}; {COUNT} are of {STRING}"),
    ],
)
def test_what_cannot_be_read_beside_the_rest_is_left_out_and_told(
    tmp_path: Path, add: Callable[[Writer], None], line: str
) -> None:
    """JSON bytes taken for CDR, or one type's bytes under another's name, are nonsense to whoever gets them."""

    def fill(writer: Writer) -> None:
        add(writer)
        add_strings(writer)

    path = mcap_file(tmp_path / "log.mcap", fill)
    with open_log(path) as log:
        assert [(topic.name, topic.msgtype, topic.count) for topic in log.topics] == [("/text", STRING, COUNT)]
        assert [entry.message.data for entry in log.messages()] == [f"number {number}" for number in range(COUNT)]
        assert log.left_out == (line,)
    repaired = repair(path, tmp_path / "repaired.mcap")
    assert (repaired.messages, repaired.left_out) == (COUNT, (line,))


def add_loose(writer: Writer) -> None:
    """A message outside of chunks, which the statistics count and no index leads to."""
    writer.flush()
    Message(channel_id=1, log_time=START + COUNT, data=text(COUNT), publish_time=0, sequence=0).write(
        writer._Writer__record_builder
    )
    writer._Writer__statistics.message_count += 1
    writer._Writer__statistics.channel_message_counts[1] += 1


def add_nothing(_writer: Writer) -> None:
    pass


@pytest.mark.parametrize("behind", [add_nothing, add_strings])
def test_messages_beside_chunks_are_read(tmp_path: Path, behind: Callable[[Writer], None]) -> None:
    def fill(writer: Writer) -> None:
        for add in (add_strings, add_loose, behind):
            add(writer)

    with open_log(mcap_file(tmp_path / "log.mcap", fill)) as log:
        read = [entry.message.data for entry in log.messages()]
        assert len(read) == sum(topic.count for topic in log.topics)
        assert read.count(f"number {COUNT}") == 1


def test_topics_are_counted_where_the_statistics_do_not(tmp_path: Path) -> None:
    """An empty map says that nobody counted (MCAP format, Statistics)."""

    def fill(writer: Writer) -> None:
        add_strings(writer)
        writer.flush()
        writer._Writer__statistics.channel_message_counts.clear()

    with open_log(mcap_file(tmp_path / "log.mcap", fill)) as log:
        assert [(topic.name, topic.count) for topic in log.topics] == [("/text", COUNT)]


def test_a_bag_that_names_no_topic_is_refused(tmp_path: Path) -> None:
    path = sqlite_bag(tmp_path / "bag")
    with sqlite3.connect(path) as file:
        file.execute("DELETE FROM topics")
    with pytest.raises(BagError, match="names none of the topics that its messages are of"):
        open_log(path)


def test_a_log_that_names_no_topic_is_refused(tmp_path: Path) -> None:
    with (tmp_path / "log.mcap").open("wb") as stream:
        writer = Writer(stream, use_chunking=False)
        writer.start("ros2", "a test")
        writer._Writer__statistics.channel_message_counts[7] = 0
        writer.add_message(7, START, text(0), START)
        writer.finish()
    with pytest.raises(BagError, match="1 message of topics that nothing undamaged names; no message could be read"):
        open_log(tmp_path / "log.mcap")


def test_a_chunk_without_messages_does_not_begin_the_log_in_1970(tmp_path: Path) -> None:
    def fill(writer: Writer) -> None:
        writer.register_schema(EMPTY, "ros2msg", definition(EMPTY).encode())
        writer._Writer__chunk_builder.num_messages = 1  # or it would write none
        writer._Writer__finalize_chunk()
        add_strings(writer)

    with open_log(mcap_file(tmp_path / "log.mcap", fill)) as log:
        assert (log.start_ns, log.end_ns) == (START, START + COUNT - 1)


@pytest.mark.parametrize(("offset", "length"), [(0, 2**62), (2**62, 100), (2**63, 100), (2**64 - 1, 2**64 - 1)])
def test_an_index_that_leads_out_of_the_file_is_damage(tmp_path: Path, offset: int, length: int) -> None:
    def fill(writer: Writer) -> None:
        add_strings(writer)
        writer._Writer__finalize_chunk()
        chunk = writer._Writer__chunk_indices[0]
        chunk.chunk_start_offset, chunk.chunk_length = offset, length

    with open_log(mcap_file(tmp_path / "log.mcap", fill)) as log:
        assert list(log.messages()) == []
        assert log.damage is not None
        assert f"damaged at byte {offset}" in log.damage


def sqlite_bag(folder: Path) -> Path:
    with FolderWriter(folder, version=8, storage_plugin=StoragePlugin.SQLITE3) as bag:
        connection = bag.add_connection("/text", STRING, typestore=get_typestore(Stores.ROS2_JAZZY))
        for number in range(COUNT):
            bag.write(connection, START + number, text(number))
    return next(folder.glob("*.db3"))


@pytest.mark.parametrize("name", ["run #1.db3", "what?.db3", "a%20b.db3", "text.sqlite"])
def test_sqlite_files_may_have_any_name(tmp_path: Path, name: str) -> None:
    path = sqlite_bag(tmp_path / "bag").rename(tmp_path / name)
    with open_log(path) as log:
        assert [entry.message.data for entry in log.messages()] == [f"number {number}" for number in range(COUNT)]


def test_messages_in_a_write_ahead_log_are_missed_aloud(tmp_path: Path) -> None:
    """rosbag2's preset `resilient` leaves one when its recorder is killed."""
    path = sqlite_bag(tmp_path / "bag")
    recorder = sqlite3.connect(path)
    recorder.execute("PRAGMA journal_mode=WAL")
    recorder.execute("INSERT INTO messages(topic_id, timestamp, data) VALUES (1, ?, ?)", (START + COUNT, text(COUNT)))
    recorder.commit()
    with open_log(path) as log:
        assert log.damage is not None
        assert f"{path.name}-wal: its recorder was killed" in log.damage
    recorder.close()
    with open_log(path) as log:
        assert log.damage is None
        assert len(list(log.messages())) == COUNT + 1


@pytest.mark.parametrize(
    "change",
    [
        "UPDATE topics SET serialization_format = x'80ff'",
        "UPDATE topics SET name = CAST(x'80ff' AS TEXT)",
        "UPDATE topics SET offered_qos_profiles = '- history: [1'",
    ],
)
def test_sqlite_topics_that_cannot_be_are_refused_in_one_line(tmp_path: Path, change: str) -> None:
    path = sqlite_bag(tmp_path / "bag")
    with sqlite3.connect(path) as file:
        file.execute(change)
    with pytest.raises(BagError, match="not a readable rosbag2 SQLite file") as caught:
        open_log(path)
    assert "\n" not in str(caught.value)


def test_sqlite_messages_without_content_are_damage(tmp_path: Path) -> None:
    path = sqlite_bag(tmp_path / "bag")
    with sqlite3.connect(path) as file:
        file.execute(f"UPDATE messages SET data = 'text' WHERE timestamp = {START + 5}")
    with open_log(path) as log:
        assert len(list(log.messages())) == 5
        assert log.damage is not None
        assert "without time or content" in log.damage


def test_sqlite_messages_of_no_topic_are_missed_aloud(tmp_path: Path) -> None:
    """As in MCAP files; they were gone without a word."""
    path = sqlite_bag(tmp_path / "bag")
    with sqlite3.connect(path) as file:
        file.execute(f"UPDATE messages SET topic_id = 7 WHERE timestamp > {START + 5}")
    with open_log(path) as log:
        assert [entry.stamp for entry in log.messages()] == [START + number for number in range(6)]
        assert log.damage == (f"{path}: {COUNT - 6} messages of topics that nothing undamaged names; read without them")


def test_sqlite_messages_out_of_order_are_damage(tmp_path: Path) -> None:
    """Times are read from the index, and one with other times in it gave messages back in its own order."""
    path = sqlite_bag(tmp_path / "bag")
    content = path.read_bytes()
    with sqlite3.connect(path) as file:
        [[page]] = file.execute("SELECT rootpage FROM sqlite_master WHERE name = 'timestamp_idx'")
    index, time = content[(page - 1) * 4096 : page * 4096], struct.pack(">q", START + 9)
    assert index.count(time) == 1
    other = index.replace(time, struct.pack(">q", START + 4))
    path.write_bytes(content.replace(index, other))
    with open_log(path) as log:
        assert [entry.stamp for entry in log.messages()] == [START + number for number in range(9)]
        assert log.damage is not None
        assert f"damaged after the message at {START + 8} ns (a message on /text at {START + 4} ns, " in log.damage


@pytest.mark.parametrize("form", ["unknown", ""])
def test_an_sqlite_file_with_a_type_that_nobody_could_define_is_read(tmp_path: Path, form: str) -> None:
    """So rosbag2 writes a type whose package it does not find: nothing of the whole file could be read."""
    path = sqlite_bag(tmp_path / "bag")
    with sqlite3.connect(path) as file:
        file.execute("INSERT INTO message_definitions VALUES (9, 'my_msgs/msg/Odd', ?, '', '')", (form,))
        file.execute("INSERT INTO topics VALUES (9, '/odd', 'my_msgs/msg/Odd', 'cdr', '', '')")
        file.execute("INSERT INTO messages(topic_id, timestamp, data) VALUES (9, ?, ?)", (START, bytes(8)))
    with open_log(path) as log:
        assert [(topic.name, topic.count) for topic in log.topics] == [("/odd", 1), ("/text", COUNT)]
        assert [m.message.data for m in log.messages("/text")] == [f"number {number}" for number in range(COUNT)]
        assert [bytes(entry.data) for entry in log.messages("/odd")] == [bytes(8)]


def cut_index(path: Path, left: int) -> None:
    """So that it leads to the first so many messages, as of a page that never reached the disk whole."""
    with sqlite3.connect(path) as file:
        [[page]] = file.execute("SELECT rootpage FROM sqlite_master WHERE name = 'timestamp_idx'")
    content = bytearray(path.read_bytes())
    count_at = (page - 1) * 4096 + 3  # SQLite file format 1.6: cells of the page, two bytes
    assert content[count_at : count_at + 2] == struct.pack(">H", COUNT)
    content[count_at : count_at + 2] = struct.pack(">H", left)
    path.write_bytes(content)


def test_messages_that_an_index_of_sqlites_does_not_lead_to_are_missed_aloud(tmp_path: Path) -> None:
    """They were gone without a word."""
    path = sqlite_bag(tmp_path / "bag")
    cut_index(path, COUNT - 6)
    with open_log(path) as log:
        assert len(list(log.messages(stop_ns=START + 3))) == 3
        assert log.damage is None
        assert len(list(log.messages())) == COUNT - 6
        assert log.damage == f"{path}: damaged, its index of times leads to {COUNT - 6} of {COUNT} messages"
    cut_index(sqlite_bag(tmp_path / "other"), 0)
    with pytest.raises(BagError, match=f"its index of times leads to none of {COUNT} messages"):
        open_log(tmp_path / "other")


def add_pairs(writer: Writer, topic: str, definition: str, count: int = 1) -> None:
    schema = writer.register_schema("my_msgs/msg/Pair", "ros2msg", definition.encode())
    channel = writer.register_channel(topic, "cdr", schema)
    for number in range(count):
        writer.add_message(channel, START + number, b"\0\1\0\0" + struct.pack("<ii", 1, 2), START)


def pairs_of(path: Path) -> list[str]:
    with open_log(path) as log:
        return [f"{m.topic} a={m.message.a} b={m.message.b}" for m in log.messages()]


def test_topics_of_one_type_are_read_by_their_own_definitions(tmp_path: Path) -> None:
    """A log of two machines with two versions of a package; equal sizes would hide that fields have changed places."""

    def fill(writer: Writer) -> None:
        add_pairs(writer, "/new", "int32 a\nint32 b")
        add_pairs(writer, "/old", "int32 b\nint32 a")

    path = mcap_file(tmp_path / "two.mcap", fill)
    assert pairs_of(path) == ["/new a=1 b=2", "/old a=2 b=1"]
    repair(path, tmp_path / "whole.mcap")
    assert pairs_of(tmp_path / "whole.mcap") == ["/new a=1 b=2", "/old a=2 b=1"]


def test_of_a_topic_whose_definition_changes_most_is_read_and_the_rest_told(tmp_path: Path) -> None:
    def fill(writer: Writer) -> None:
        add_pairs(writer, "/pair", "int32 b\nint32 a", count=2)
        add_pairs(writer, "/pair", "# the newer one\nint32 a\nint32 b", count=2)
        add_pairs(writer, "/pair", "int32 a\nint32 b", count=1)

    path = mcap_file(tmp_path / "changed.mcap", fill)
    assert pairs_of(path) == ["/pair a=1 b=2"] * 3
    with open_log(path) as log:
        assert [(topic.name, topic.count) for topic in log.topics] == [("/pair", 3)]
        assert log.left_out == ("/pair: 2 messages by another definition of my_msgs/msg/Pair than the 3 others",)


IDL = (
    "=" * 80
    + """
IDL: my_msgs/msg/Label
module my_msgs { module msg { struct Label { wstring text; long double weight; }; }; };
"""
)


@pytest.mark.parametrize(("form", "label"), [("ros2msg", "wstring text\nint32 n\n"), ("ros2idl", IDL)])
def test_what_is_not_understood_is_written_whole_all_the_same(tmp_path: Path, form: str, label: str) -> None:
    """Wide strings, and what newer distributions define: others can read them."""
    content = b"\0\1\0\0" + bytes(32)

    def fill(writer: Writer) -> None:
        add_strings(writer)
        schema = writer.register_schema("my_msgs/msg/Label", form, label.encode())
        writer.add_message(writer.register_channel("/label", "cdr", schema), START, content, START)

    found = repair(mcap_file(tmp_path / "log.mcap", fill), tmp_path / "whole.mcap")
    assert (found.messages, found.left_out) == (COUNT + 1, ())
    with (tmp_path / "whole.mcap").open("rb") as file:
        [(schema, _, message)] = make_reader(file).iter_messages(["/label"])
    assert schema is not None
    assert (schema.name, schema.encoding, schema.data) == ("my_msgs/msg/Label", form, label.encode())
    assert message.data == content
