"""MCAP files: read through the index where there is one, else through one pass over the file."""

from __future__ import annotations

import io
import zlib
from collections import Counter
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from struct import error as StructError
from typing import BinaryIO

from mcap.exceptions import McapError
from mcap.reader import make_reader
from mcap.records import Channel as ChannelRecord
from mcap.records import Chunk, ChunkIndex, DataEnd, Footer, Header, Message, Metadata, Schema, Statistics
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.summary import Summary
from zstandard import ZstdError

from twin_node.bag.log import BagError, Channel, DamageError, Part, Record
from twin_node.bag.qos import offers_latched

MAGIC = b"\x89MCAP0\r\n"

DAMAGED = (McapError, StructError, ZstdError, EOFError, ValueError, KeyError, RuntimeError, OverflowError, MemoryError)
"""What the mcap package lets out when bytes are not what they should be (decompressors and decoding included)."""

FOOTER_BYTES = 1 + 8 + 8 + 8 + 4
"""A footer record: opcode, length, two offsets, checksum (MCAP format, Footer)."""

CRC_BYTES = 4
RECORD_HEAD_BYTES = 1 + 8
"""Before a record's content: opcode, length."""
STRING_HEAD_BYTES = 4
"""Before a string: its length."""

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

    def topics_of(self, channels: Collection[int]) -> frozenset[str] | None:
        """Topics of channels; None where one of them has not been met."""
        known = all(channel in self.channels for channel in channels)
        return frozenset(self.channels[channel].topic for channel in channels) if known else None


class McapStorage:
    """An MCAP file. Raises `BagError` where no message can be read."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._file: BinaryIO = path.open("rb")
        self._damage: str | None = None
        try:
            self._index = self._from_summary() or self._from_scan()
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
                latched=offers_latched(channel.metadata.get("offered_qos_profiles", "")),
            )
            for channel in self._index.channels.values()
        )

    @property
    def definitions(self) -> Mapping[str, str]:
        """Message definitions that the file carries."""
        return {
            schema.name: schema.data.decode("utf-8", errors="replace")
            for schema in self._index.schemas.values()
            if schema.encoding in ("ros2msg", "ros2idl", "omgidl")
        }

    @property
    def metadata(self) -> Mapping[str, Mapping[str, str]]:
        """Metadata records by name."""
        return self._index.metadata

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
            messages = list(_messages(data))
            if not messages and part.topics:
                raise ValueError("the index knows messages where there are none")
            records = [self._record(message) for message in messages if start <= message.log_time < stop]
        except (*DAMAGED, OSError) as error:
            raise DamageError(
                f"{self._path}: damaged at byte {part.offset} ({_reason(error)}); read up to it"
            ) from None
        wanted = records if topics is None else [record for record in records if record.topic in topics]
        yield from sorted(wanted, key=lambda record: record.stamp)

    def close(self) -> None:
        """Releases the file."""
        self._file.close()

    def _record(self, message: Message) -> Record:
        channel = self._index.channels[message.channel_id]
        return Record(channel.topic, self._msgtype(channel), message.log_time, message.data)

    def _msgtype(self, channel: ChannelRecord) -> str:
        schema = self._index.schemas.get(channel.schema_id)
        return schema.name if schema else ""

    def _from_summary(self) -> _Index | None:
        """Index from the file's summary; None where the file has none, or one that leaves messages out."""
        try:
            if not self._summary_is_intact():
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
        parts = [self._indexed_part(chunk, summary.channels) for chunk in chunks]
        counts = Counter(summary.statistics.channel_message_counts)
        return _Index(summary.schemas, summary.channels, counts, parts, metadata)

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

    def _summary_is_intact(self) -> bool:
        """Whether the footer leads to a summary whose checksum, where it has one, is right (MCAP format, Footer)."""
        footer_start = self._file.seek(-(FOOTER_BYTES + len(MAGIC)), io.SEEK_END)
        footer = next(StreamReader(self._file, skip_magic=True).records)
        if not isinstance(footer, Footer) or footer.summary_start == 0:
            return False
        self._file.seek(footer.summary_start)
        covered = self._file.read(footer_start + FOOTER_BYTES - CRC_BYTES - footer.summary_start)
        return footer.summary_crc in (0, zlib.crc32(covered))

    def _from_scan(self) -> _Index:
        """Index from one pass over the data section, up to the damage where it is damaged or was never ended."""
        index = _Index()
        self._file.seek(0)
        size = self._path.stat().st_size
        reader = StreamReader(self._file, emit_chunks=True, record_size_limit=size)
        start = len(MAGIC)
        try:
            for record in reader.records:
                if isinstance(record, DataEnd):
                    break
                end = self._file.tell()
                if end > size:
                    raise EOFError
                if start == len(MAGIC) and not _is_header(record, end - start):
                    raise ValueError("it does not begin with a header")
                self._take(index, record, start, end)
                start = end
        except DAMAGED as error:
            damage = f"{self._path}: damaged at byte {start} of {size} ({_reason(error)})"
            if not index.parts:
                raise BagError(f"{damage}; no message could be read, record it again") from None
            self._damage = f"{damage}; read up to it"
        return index

    def _take(self, index: _Index, record: object, start: int, end: int) -> None:
        if isinstance(record, Chunk):
            contents = breakup_chunk(record, validate_crc=True)
            stamps, channels = [], set()
            for item in contents:
                if isinstance(item, Message):
                    stamps.append(item.log_time)
                    channels.add(item.channel_id)
                    index.counts[item.channel_id] += 1
                else:
                    self._take(index, item, start, end)
            if stamps:
                topics = index.topics_of(channels)
                index.parts.append(Part(self, min(stamps), max(stamps), start, end - start, topics))
        elif isinstance(record, Message):
            index.counts[record.channel_id] += 1
            _append_loose(index, Part(self, record.log_time, record.log_time, start, end - start))
        elif isinstance(record, Schema):
            index.schemas[record.id] = record
        elif isinstance(record, ChannelRecord):
            index.channels[record.id] = record
        elif isinstance(record, Metadata):
            index.metadata[record.name] = record.metadata


def _is_header(record: object, size: int) -> bool:
    """Whether a file's first record is a header that ends where its two strings end.

    A wrong length would lead into the middle of a chunk, where no checksum tells what is wrong.
    """
    if not isinstance(record, Header):
        return False
    return size == RECORD_HEAD_BYTES + sum(
        STRING_HEAD_BYTES + len(s.encode()) for s in (record.profile, record.library)
    )


def _append_loose(index: _Index, message: Part) -> None:
    """Joins a message outside of chunks to the run of such messages that it follows."""
    last = index.parts[-1] if index.parts else None
    if last and last.offset + last.size == message.offset and last.size < LOOSE_PART_BYTES:
        start, end = min(last.start, message.start), max(last.end, message.end)
        index.parts[-1] = Part(message.storage, start, end, last.offset, last.size + message.size)
    else:
        index.parts.append(message)


def _messages(data: bytes) -> Iterator[Message]:
    """Messages of a run of whole records, chunks opened and their checksums compared."""
    stream = io.BytesIO(data)
    records = StreamReader(stream, skip_magic=True, emit_chunks=True).records
    while stream.tell() < len(data):
        record = next(records)
        contents = breakup_chunk(record, validate_crc=True) if isinstance(record, Chunk) else [record]
        yield from (item for item in contents if isinstance(item, Message))


def _complete(summary: Summary, statistics: Statistics) -> bool:
    """Whether the summary leads to all messages: every one in an indexed chunk and on a channel that it repeats."""
    return (
        len(summary.chunk_indexes) == statistics.chunk_count
        and (statistics.chunk_count > 0 or statistics.message_count == 0)
        and all(_tells_its_time(chunk) for chunk in summary.chunk_indexes)
        and all(channel in summary.channels for channel in statistics.channel_message_counts)
        and all(not channel.schema_id or channel.schema_id in summary.schemas for channel in summary.channels.values())
    )


def _tells_its_time(chunk: ChunkIndex) -> bool:
    """Whether a chunk's times are those of messages: of one without any they are 0 (MCAP format, Chunk)."""
    return bool(chunk.message_start_time or chunk.message_end_time or chunk.message_index_offsets)


def _reason(error: BaseException) -> str:
    if isinstance(error, EOFError | StructError) or type(error).__name__ == "EndOfFile":
        return "the file ends in the middle of a record"
    return str(error) or type(error).__name__
