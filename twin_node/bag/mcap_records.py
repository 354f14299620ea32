"""Records of MCAP files as they lie there: each found by the length of the one before, chunks opened and checked."""

from __future__ import annotations

import io
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from struct import Struct
from struct import error as StructError
from typing import BinaryIO

from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Header, McapRecord, Message, Schema
from mcap.stream_reader import StreamReader, get_chunk_data_stream
from zstandard import ZstdError

MAGIC = b"\x89MCAP0\r\n"

DAMAGED = (McapError, StructError, ZstdError, EOFError, ValueError, KeyError, RuntimeError, OverflowError, MemoryError)
"""What the mcap package lets out when bytes are not what they should be (decompressors and decoding included)."""

RECORD_HEAD = Struct("<BQ")
"""Before a record's content: opcode, length."""
CHUNK_FIELDS_BYTES = 8 + 8 + 8 + 4 + 4 + 8
"""Of a chunk's content all but its data and the name of its compression."""
STRING_HEAD_BYTES = 4
"""Before a string: its length."""
MOST_CHUNK_BYTES = 1 << 30
"""Of a chunk's content; writers close theirs after some megabytes. A few damaged bytes must not take all memory."""
MOST_HEADER_BYTES = 1 << 16
"""Of a header: the names of a profile and a library."""
ZEROS = "found zeros in place of a record"
WRONG_LENGTH = "a record in it is not as long as it says"


@dataclass(frozen=True)
class Frame:
    """A record as it lies in its file."""

    opcode: int
    start: int
    """Where it begins and ends, bytes."""
    end: int

    @property
    def size(self) -> int:
        """Bytes."""
        return self.end - self.start


def frames(file: BinaryIO, start: int, stop: int) -> Iterator[Frame]:
    """Records from one byte up to another, each found by the length of the one before.

    Raises `EOFError` or `StructError` where one leads beyond, `ValueError` where there is none: zeros, as disks leave
    blocks that never reached them.
    """
    while start < stop:
        file.seek(start)
        opcode, length = RECORD_HEAD.unpack(file.read(RECORD_HEAD.size))
        frame = Frame(opcode, start, start + RECORD_HEAD.size + length)
        if not opcode:
            raise ValueError(ZEROS)
        if frame.end > stop:
            raise EOFError
        yield frame
        start = frame.end


@dataclass(frozen=True)
class Indexed:
    """A record, and those behind it that say what is in it where it is a chunk."""

    frame: Frame
    indexes: tuple[Frame, ...] = ()
    is_whole: bool = True
    """Whether something else was found behind them: a file may end before the last of them."""

    @property
    def end(self) -> int:
        """Where the last of them ends, bytes."""
        return self.indexes[-1].end if self.indexes else self.frame.end


def indexed(found: Iterator[Frame]) -> Iterator[Indexed]:
    """Records with their message indexes; what `found` raises comes after all that it has found."""
    last: Frame | None = None
    indexes: list[Frame] = []
    try:
        for frame in found:
            if frame.opcode == Opcode.MESSAGE_INDEX and last is not None:
                indexes.append(frame)
                continue
            if last is not None:
                yield Indexed(last, tuple(indexes))
            last, indexes = frame, []
    except DAMAGED:
        if last is not None:
            yield Indexed(last, tuple(indexes), is_whole=False)
        raise
    if last is not None:
        yield Indexed(last, tuple(indexes), is_whole=False)


def parsed(file: BinaryIO, frame: Frame) -> McapRecord:
    """A record; a chunk's data is not opened. Raises `DAMAGED`, as do all that read records."""
    file.seek(frame.start)
    return next(StreamReader(file, skip_magic=True, emit_chunks=True, record_size_limit=None).records)


def library_of(path: Path) -> str | None:
    """Which library says that it wrote an MCAP file; None where it is none, or cannot be read."""
    try:
        with path.open("rb") as file:
            if file.read(len(MAGIC)) != MAGIC:
                return None
            first = next(StreamReader(file, skip_magic=True, record_size_limit=MOST_HEADER_BYTES).records)
    except (OSError, StopIteration, *DAMAGED):
        return None
    return first.library if isinstance(first, Header) else None


def is_header(record: McapRecord, size: int) -> bool:
    """Whether a file's first record is a header that ends where its two strings end.

    A wrong length would lead into the middle of a chunk, where no checksum tells what is wrong.
    """
    if not isinstance(record, Header):
        return False
    return size == RECORD_HEAD.size + sum(STRING_HEAD_BYTES + len(s.encode()) for s in (record.profile, record.library))


def opened(record: McapRecord, size: int) -> list[McapRecord]:
    """What a record of so many bytes holds: of a chunk all that is in it, its checksum compared."""
    if not isinstance(record, Chunk):
        return [record]
    filled = RECORD_HEAD.size + CHUNK_FIELDS_BYTES + len(record.compression.encode()) + len(record.data)
    if filled > size or (filled < size and not record.data):
        raise ValueError("a chunk's data is not as long as the chunk")
    if record.uncompressed_size > MOST_CHUNK_BYTES:
        raise ValueError(f"a chunk says that it holds {record.uncompressed_size} bytes")
    return list(_contents(record))


def _contents(chunk: Chunk) -> Iterator[McapRecord]:
    """As the mcap package's `breakup_chunk`, which passes over zeros nine by nine and without a word, and takes what is
    left of a chunk for one message where that has a wrong length."""
    stream, length = get_chunk_data_stream(chunk, validate_crc=True)
    while stream.count < length:
        opcode, size = stream.read1(), stream.read8()
        end = stream.count + size
        if end > length:
            raise ValueError(WRONG_LENGTH)
        if opcode == Opcode.MESSAGE:
            yield Message.read(stream, size)
        elif opcode == Opcode.CHANNEL:
            yield Channel.read(stream)
        elif opcode == Opcode.SCHEMA:
            yield Schema.read(stream)
        elif not opcode:
            raise ValueError(ZEROS)
        if stream.count < end:  # records of other kinds, and fields of later versions
            stream.read(end - stream.count)
        if stream.count > end:
            raise ValueError(WRONG_LENGTH)


def messages_in(data: bytes) -> Iterator[Message]:
    """Messages of a run of whole records, chunks opened and their checksums compared."""
    stream = io.BytesIO(data)
    records = StreamReader(stream, skip_magic=True, emit_chunks=True).records
    while (start := stream.tell()) < len(data):
        record = next(records)
        yield from (item for item in opened(record, stream.tell() - start) if isinstance(item, Message))


def damage_in_words(error: BaseException) -> str:
    """Which of `DAMAGED` it was."""
    if isinstance(error, EOFError | StructError) or type(error).__name__ == "EndOfFile":
        return "the file ends in the middle of a record"
    return str(error) or type(error).__name__
