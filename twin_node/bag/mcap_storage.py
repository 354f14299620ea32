"""MCAP files: read through the index where there is one, else through one pass over the file."""

from __future__ import annotations

import contextlib
import io
import zlib
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from struct import Struct
from typing import BinaryIO

from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Attachment, ChunkIndex, Footer, McapRecord, Message, MessageIndex, Metadata, Schema, Statistics
from mcap.records import Channel as ChannelRecord
from mcap.stream_reader import StreamReader
from mcap.summary import Summary

from twin_node.bag.log import BagError, Channel, DamageError, Part, Record
from twin_node.bag.log_times import NO_STOP
from twin_node.bag.mcap_records import (
    DAMAGED,
    MAGIC,
    RECORD_HEAD,
    Frame,
    Indexed,
    damage_in_words,
    frames,
    indexed,
    is_header,
    messages_in,
    opened,
    parsed,
)
from twin_node.bag.qos import profiles_of
from twin_node.errors import several

FOOTER_BYTES = 1 + 8 + 8 + 8 + 4
"""A footer record: opcode, length, two offsets, checksum (MCAP format, Footer)."""

CRC_BYTES = 4
DATA_END_BYTES = 1 + 8 + CRC_BYTES
"""A data end record: opcode, length, checksum."""
MESSAGE_HEAD = Struct("<HIQQ")
"""Of a message's content all but its data: its channel, its number, its log time and that of publishing, ns."""
CHUNK_TIMES = Struct("<QQ")
"""A chunk's content begins with the first and the last log time of its messages, ns."""
LOOSE_PART_BYTES = 1 << 20
"""Messages outside of chunks are read in parts of this size: the default chunk size of mcap writers."""


@dataclass
class _Index:
    """What one pass over a file gathers; equal to what an intact file says in its summary."""

    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, ChannelRecord] = field(default_factory=dict)
    counts: Counter[int] = field(default_factory=Counter)
    parts: list[Part] = field(default_factory=list)
    metadata: dict[str, Mapping[str, str]] = field(default_factory=dict)
    attachments: list[str] = field(default_factory=list)
    """Names."""
    damage: list[str] = field(default_factory=list)
    """Chunks that cannot be opened: where and why, in words."""

    @property
    def nameless(self) -> frozenset[int]:
        """Channels that messages are on and that nothing names: it was in what is damaged."""
        return frozenset(self.counts) - frozenset(self.channels)

    def topics_of(self, channels: Collection[int]) -> frozenset[str] | None:
        """Topics of channels; None where one of them has not been met."""
        known = all(channel in self.channels for channel in channels)
        return frozenset(self.channels[channel].topic for channel in channels) if known else None


class McapStorage:
    """An MCAP file. Raises `BagError` where no message can be read."""

    def __init__(self, path: Path, told: Path | None = None) -> None:
        """`told`: what messages to people call the file, where that is not `path`."""
        self._path = path
        self._told = told or path
        self._file: BinaryIO = path.open("rb")
        self._damage: str | None = None
        try:
            self._index = self._from_summary() or self._from_scan()
            self._nameless = self._index.nameless
            self._definitions = {
                number: schema.data.decode("utf-8", errors="replace")
                for number, schema in self._index.schemas.items()
                if schema.encoding in ("ros2msg", "ros2idl", "omgidl")
            }
        except BaseException:
            self._file.close()
            raise

    @property
    def channels(self) -> tuple[Channel, ...]:
        """What the file holds."""
        return tuple(
            Channel(
                topic=channel.topic,
                msgtype=self._msgtype(channel),
                encoding=channel.message_encoding,
                count=self._index.counts[channel.id],
                profiles=profiles_of(channel.metadata.get("offered_qos_profiles", "")),
                definition=self._definitions.get(channel.schema_id, ""),
            )
            for channel in self._index.channels.values()
        )

    @property
    def definitions(self) -> Mapping[str, str]:
        """Message definitions that the file carries."""
        schemas = self._index.schemas
        return {schemas[number].name: text for number, text in self._definitions.items()}

    @property
    def metadata(self) -> Mapping[str, Mapping[str, str]]:
        """Metadata records by name."""
        return self._index.metadata

    @property
    def attachments(self) -> tuple[str, ...]:
        """Names of the files beside the messages."""
        return tuple(self._index.attachments)

    @property
    def parts(self) -> tuple[Part, ...]:
        """Chunks, and runs of messages outside of chunks."""
        return tuple(self._index.parts)

    @property
    def damage(self) -> str | None:
        """Where the file ends too early."""
        return self._damage

    def records(self, part: Part, topics: Collection[str] | None, start: int, stop: int) -> Iterator[Record]:
        """Messages of a part in log-time order; raises `DamageError` before the first of a damaged one."""
        try:
            self._file.seek(part.offset)
            data = self._file.read(part.size)
            messages = list(messages_in(data))
            if not messages and part.topics:
                raise ValueError("the index knows messages where there are none")
            records = [
                self._record(message)
                for message in messages
                if start <= message.log_time < stop and message.channel_id not in self._nameless
            ]
        except (*DAMAGED, OSError) as error:
            raise DamageError(
                f"{self._told}: damaged at byte {part.offset} ({damage_in_words(error)}); read up to it"
            ) from None
        wanted = records if topics is None else [record for record in records if record.topic in topics]
        yield from sorted(wanted, key=lambda record: record.stamp)

    def close(self) -> None:
        """Releases the file."""
        self._file.close()

    def _record(self, message: Message) -> Record:
        channel = self._index.channels[message.channel_id]
        published = message.publish_time or message.log_time
        definition = self._definitions.get(channel.schema_id, "")
        return Record(channel.topic, self._msgtype(channel), message.log_time, message.data, published, definition)

    def _msgtype(self, channel: ChannelRecord) -> str:
        schema = self._index.schemas.get(channel.schema_id)
        return schema.name if schema else ""

    def _from_summary(self) -> _Index | None:
        """Index from the file's summary; None where the file has none, or one that leaves messages out."""
        try:
            summary_start = self._summary_start()
            if not summary_start:
                return None
            self._file.seek(0)
            reader = make_reader(self._file)
            reader.get_header()
            summary = reader.get_summary()
            if summary is None or summary.statistics is None or not _complete(summary, summary.statistics):
                return None
            metadata = {record.name: record.metadata for record in reader.iter_metadata()}
        except (*DAMAGED, OSError):
            return None
        chunks = sorted(summary.chunk_indexes, key=lambda chunk: chunk.chunk_start_offset)
        if self._has_loose_messages(chunks, summary_start):
            return None
        parts = [self._indexed_part(chunk, summary.channels) for chunk in chunks]
        counts = Counter(summary.statistics.channel_message_counts)
        attachments = [attachment.name for attachment in summary.attachment_indexes]
        return _Index(summary.schemas, summary.channels, counts, parts, metadata, attachments)

    def _indexed_part(self, chunk: ChunkIndex, channels: Mapping[int, ChannelRecord]) -> Part:
        known = [channels[channel].topic for channel in chunk.message_index_offsets if channel in channels]
        return Part(
            storage=self,
            start=chunk.message_start_time,
            end=chunk.message_end_time,
            offset=chunk.chunk_start_offset,
            size=chunk.chunk_length,
            topics=frozenset(known) or None,
        )

    def _has_loose_messages(self, chunks: Sequence[ChunkIndex], stop: int) -> bool:
        """Whether there are messages between the chunks, up to the byte `stop`: no index leads to those."""
        start = len(MAGIC)
        for chunk in chunks:
            if self._is_any_message(start, min(chunk.chunk_start_offset, stop)):
                return True
            start = chunk.chunk_start_offset + chunk.chunk_length + chunk.message_index_length
        return self._is_any_message(start, stop)

    def _is_any_message(self, start: int, stop: int) -> bool:
        with contextlib.suppress(*DAMAGED):  # what is damaged here is no chunk: the index leads past it
            return any(frame.opcode == Opcode.MESSAGE for frame in frames(self._file, start, stop))
        return False

    def _summary_start(self) -> int:
        """Byte at which the summary begins; 0 without one, or where its checksum is wrong (MCAP format, Footer)."""
        footer_start = self._file.seek(-(FOOTER_BYTES + len(MAGIC)), io.SEEK_END)
        footer = next(StreamReader(self._file, skip_magic=True).records)
        if not isinstance(footer, Footer) or footer.summary_start == 0:
            return 0
        self._file.seek(footer.summary_start)
        covered = self._file.read(footer_start + FOOTER_BYTES - CRC_BYTES - footer.summary_start)
        return int(footer.summary_start) if footer.summary_crc in (0, zlib.crc32(covered)) else 0

    def _from_scan(self) -> _Index:
        """Index from one pass over the data section, as far as one record leads to the next.

        A chunk is opened where the records behind it do not tell what is in it, or nothing has named a channel of its.
        Damaged ones are passed over: they are parts too, and told when they are read.
        """
        index, size, start = _Index(), self._path.stat().st_size, len(MAGIC)
        damage: list[str] = []
        try:
            for record in indexed(frames(self._file, start, size)):
                frame = record.frame
                if frame.opcode == Opcode.DATA_END and frame.size == DATA_END_BYTES:
                    break
                if start == len(MAGIC) and not is_header(parsed(self._file, frame), frame.size):
                    raise ValueError("it does not begin with a header")
                self._take(index, record)
                start = record.end
            else:
                raise EOFError
        except DAMAGED as error:
            damage.append(f"{self._told}: damaged at byte {start} of {size} ({damage_in_words(error)}); read up to it")
        if index.nameless:
            count = sum(index.counts[channel] for channel in index.nameless)
            damage.append(
                f"{self._told}: {several(count, 'message')} of topics that nothing undamaged names; read without them"
            )
        if damage and not index.channels.keys() & index.counts.keys():
            where = f"{self._told}: damaged at {index.damage[0]}" if index.damage else damage[0].rpartition(";")[0]
            raise BagError(f"{where}; no message could be read, record it again")
        self._damage = " | ".join(damage) or None
        return index

    def _head(self, frame: Frame, form: Struct) -> tuple[int, ...]:
        """Numbers that a record's content begins with."""
        self._file.seek(frame.start + RECORD_HEAD.size)
        return form.unpack(self._file.read(form.size))

    def _take(self, index: _Index, record: Indexed) -> None:
        frame = record.frame
        if frame.opcode == Opcode.CHUNK:
            stamps = self._stamps(index, record)
            if stamps is None:
                self._take_chunk(index, frame)
            else:
                self._add_part(index, frame, stamps)
        elif frame.opcode == Opcode.MESSAGE:
            if frame.size < RECORD_HEAD.size + MESSAGE_HEAD.size:
                raise ValueError("a message is shorter than any")
            channel, _, stamp, _ = self._head(frame, MESSAGE_HEAD)
            index.counts[channel] += 1
            _append_loose(index, Part(self, stamp, stamp, frame.start, frame.size))
        elif frame.opcode in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.METADATA, Opcode.ATTACHMENT):
            _take_name(index, parsed(self._file, frame))

    def _stamps(self, index: _Index, chunk: Indexed) -> dict[int, list[int]] | None:
        """Log times, ns, per channel by a chunk's message indexes; None where these cannot be all that there is."""
        try:
            records = [parsed(self._file, frame) for frame in chunk.indexes] if chunk.is_whole else []
            ends = self._head(chunk.frame, CHUNK_TIMES)
        except DAMAGED:
            return None
        told = {record.channel_id: record.records for record in records if isinstance(record, MessageIndex)}
        stamps = {channel: [stamp for stamp, _ in messages] for channel, messages in told.items() if messages}
        found = [stamp for each in stamps.values() for stamp in each]
        is_all = bool(found) and len(told) == len(records) and (min(found), max(found)) == ends
        return stamps if is_all and stamps.keys() <= index.channels.keys() else None

    def _add_part(self, index: _Index, frame: Frame, stamps: Mapping[int, Sequence[int]]) -> None:
        """A chunk with messages of these log times, ns, per channel."""
        for channel, each in stamps.items():
            index.counts[channel] += len(each)
        first, last = min(map(min, stamps.values())), max(map(max, stamps.values()))
        index.parts.append(Part(self, first, last, frame.start, frame.size, index.topics_of(stamps.keys())))

    def _take_chunk(self, index: _Index, frame: Frame) -> None:
        try:
            contents = opened(parsed(self._file, frame), frame.size)
        except DAMAGED as error:  # `records` meets it again, and tells
            index.damage.append(f"byte {frame.start} ({damage_in_words(error)})")
            index.parts.append(self._damaged_part(index, frame))
            return
        stamps: dict[int, list[int]] = {}
        for item in contents:
            if isinstance(item, Message):
                stamps.setdefault(item.channel_id, []).append(item.log_time)
            else:
                _take_name(index, item)
        if stamps:
            self._add_part(index, frame, stamps)

    def _damaged_part(self, index: _Index, frame: Frame) -> Part:
        """A chunk that cannot be opened, at the times that it says, or at the last one before where those cannot be."""
        first, last = self._head(frame, CHUNK_TIMES)
        if not (first <= last < NO_STOP and last):
            if not index.parts:
                raise ValueError("its first chunk is damaged")
            first = last = index.parts[-1].end
        return Part(self, first, last, frame.start, frame.size)


def _take_name(index: _Index, record: McapRecord) -> None:
    if isinstance(record, Schema):
        index.schemas[record.id] = record
    elif isinstance(record, ChannelRecord):
        index.channels[record.id] = record
    elif isinstance(record, Metadata):
        index.metadata[record.name] = record.metadata
    elif isinstance(record, Attachment):
        index.attachments.append(record.name)


def _append_loose(index: _Index, message: Part) -> None:
    """Joins a message outside of chunks to the run of such messages that it follows."""
    last = index.parts[-1] if index.parts else None
    if last and last.offset + last.size == message.offset and last.size < LOOSE_PART_BYTES:
        start, end = min(last.start, message.start), max(last.end, message.end)
        index.parts[-1] = Part(message.storage, start, end, last.offset, last.size + message.size)
    else:
        index.parts.append(message)


def _complete(summary: Summary, statistics: Statistics) -> bool:
    """Whether the summary leads to all messages: each in an indexed chunk, counted on a channel that it repeats."""
    return (
        len(summary.chunk_indexes) == statistics.chunk_count
        and (statistics.chunk_count > 0 or statistics.message_count == 0)
        and sum(statistics.channel_message_counts.values()) == statistics.message_count
        and all(_tells_its_time(chunk, statistics) for chunk in summary.chunk_indexes)
        and all(channel in summary.channels for channel in statistics.channel_message_counts)
        and all(not channel.schema_id or channel.schema_id in summary.schemas for channel in summary.channels.values())
    )


def _tells_its_time(chunk: ChunkIndex, statistics: Statistics) -> bool:
    """Whether a chunk's times are those of messages: of one without any they are 0 (MCAP format, Chunk).

    Damaged ones, where no checksum tells, lie outside of the log's.
    """
    first, last = chunk.message_start_time, chunk.message_end_time
    is_any = bool(first or last or chunk.message_index_offsets)
    return is_any and statistics.message_start_time <= first <= last <= statistics.message_end_time
