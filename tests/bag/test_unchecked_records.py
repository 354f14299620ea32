"""Records of MCAP files that are damaged where no checksum tells: rosbag2's preset fastwrite writes none."""

from __future__ import annotations

import io
import struct
from pathlib import Path

import pytest
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Chunk, Message, Schema
from mcap.writer import CompressionType, Writer

from twin_node.bag import open_log
from twin_node.bag.mcap_records import CHUNK_FIELDS_BYTES, RECORD_HEAD, opened
from twin_node.messages import message_type, serialize

STRING = "std_msgs/msg/String"
COUNT, PER_CHUNK, DAMAGED = 40, 20, 30
"""Messages, and which of them has a wrong length."""
BEFORE_LENGTH, BEFORE_DATA = 1, 31
"""Bytes of a message's record before its length, and before its data."""


def written(path: Path, use_chunking: bool) -> bytes:
    with path.open("wb") as file:
        writer = Writer(file, compression=CompressionType.NONE, enable_crcs=False, use_chunking=use_chunking)
        writer.start("ros2", "fast")
        channel = writer.register_channel("/a", "cdr", writer.register_schema(STRING, "ros2msg", b"string data"))
        for i in range(COUNT):
            writer.add_message(channel, i, data_of(i), i)
            if use_chunking and (i + 1) % PER_CHUNK == 0:
                writer.flush()
        writer.finish()
    return path.read_bytes()


def data_of(number: int) -> bytes:
    return bytes(serialize(message_type(STRING)(data=f"{number:0500}")))


def with_length(content: bytes, length: int) -> bytes:
    """The log with a message that says to be so long; below 0: so much shorter than it is."""
    at = content.index(data_of(DAMAGED)) - BEFORE_DATA
    assert content[at] == Opcode.MESSAGE
    start, end = at + BEFORE_LENGTH, at + BEFORE_LENGTH + 8
    told = length if length >= 0 else int.from_bytes(content[start:end], "little") + length
    return content[:start] + told.to_bytes(8, "little") + content[end:]


@pytest.mark.parametrize("length", [0, 5, 21, 22, -1, 600, 1_000_000, 2**63])
@pytest.mark.parametrize("has_end", [True, False])
def test_a_chunk_with_a_wrong_length_in_it_is_damaged(tmp_path: Path, length: int, has_end: bool) -> None:
    """What was left of the chunk was taken for one message, and the others were missed in silence."""
    path = tmp_path / "log.mcap"
    content = with_length(written(path, use_chunking=True), length)
    path.write_bytes(content if has_end else content[:-20])
    with open_log(path) as log:
        assert [message.stamp for message in log.messages()] == list(range(PER_CHUNK))
        assert log.damage is not None and "damaged at byte" in log.damage


@pytest.mark.parametrize("length", [0, 5, 21, 1_000_000, 2**63])
def test_messages_before_one_with_a_wrong_length_are_read(tmp_path: Path, length: int) -> None:
    """Outside of chunks one that said to be shorter than any took those before it along."""
    path = tmp_path / "log.mcap"
    path.write_bytes(with_length(written(path, use_chunking=False), length))
    with open_log(path) as log:
        assert [message.stamp for message in log.messages()] == list(range(DAMAGED))
        assert log.damage is not None and "log.mcap: damaged at byte" in log.damage


@pytest.mark.parametrize("start", [2**63, 2**64 - 1, PER_CHUNK + 5])
def test_times_that_are_none_of_the_log_s_lose_no_chunk(tmp_path: Path, start: int) -> None:
    """In the summary: a chunk that began after its end held nothing, and was passed over without a word."""
    path = tmp_path / "log.mcap"
    content = written(path, use_chunking=True)
    summary = make_reader(io.BytesIO(content)).get_summary()
    assert summary is not None
    chunk = summary.chunk_indexes[0]
    told = struct.pack("<QQQ", 0, PER_CHUNK - 1, chunk.chunk_start_offset)
    assert content.count(told) == 1
    path.write_bytes(content.replace(told, struct.pack("<Q", start) + told[8:]))
    with open_log(path) as log:
        assert [message.stamp for message in log.messages()] == list(range(COUNT))
        assert (log.start_ns, log.damage) == (0, None)


def test_counts_in_a_summary_that_do_not_add_up_are_counted_anew(tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    content = written(path, use_chunking=True)
    told = struct.pack("<IHQ", 10, 1, COUNT)
    assert content.count(told) == 1
    path.write_bytes(content.replace(told, struct.pack("<IHQ", 10, 1, 1 << 60)))
    with open_log(path) as log:
        assert [topic.count for topic in log.topics] == [COUNT]


def test_no_other_record_ends_a_log_without_its_end(tmp_path: Path) -> None:
    """One bit made a message index the end of the data: what came after it was missed in silence."""
    path = tmp_path / "log.mcap"
    content = written(path, use_chunking=True)[:-20]
    at = content.index(struct.pack("<BQHI", Opcode.MESSAGE_INDEX, 6 + 16 * PER_CHUNK, 1, 16 * PER_CHUNK))
    path.write_bytes(content[:at] + bytes([Opcode.DATA_END]) + content[at + 1 :])
    with open_log(path) as log:
        assert [message.stamp for message in log.messages()] == list(range(COUNT))


def test_records_of_later_versions_are_read() -> None:
    """MCAP lets records have more fields than are known here, and be of kinds that are not."""
    builder = RecordBuilder()
    Schema(id=1, name=STRING, encoding="ros2msg", data=b"string data").write(builder)
    schema = builder.end()
    Message(channel_id=1, log_time=5, data=data_of(0), publish_time=5, sequence=0).write(builder)
    later = schema[:1] + (len(schema) - 9 + 3).to_bytes(8, "little") + schema[9:] + b"new"
    unknown = bytes([0x70]) + (4).to_bytes(8, "little") + b"\0\0\0\0"
    data = later + unknown + builder.end()
    chunk = Chunk("", data, message_start_time=5, message_end_time=5, uncompressed_crc=0, uncompressed_size=len(data))
    found = opened(chunk, RECORD_HEAD.size + CHUNK_FIELDS_BYTES + len(data))
    assert [type(record) for record in found] == [Schema, Message]
    assert isinstance(found[1], Message) and found[1].data == data_of(0)
