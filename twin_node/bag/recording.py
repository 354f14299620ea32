"""Recordings as they grow: files that can be read whatever ends their process, split by size or time, in a folder."""

from __future__ import annotations

import contextlib
import errno
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, get_args

from mcap.writer import CompressionType

from twin_node.bag.disk import DiskSync
from twin_node.bag.folder_metadata import METADATA_FILE, write_metadata
from twin_node.bag.latched import kept_with
from twin_node.bag.log import BagError
from twin_node.bag.log_times import check_log_time
from twin_node.bag.mcap_stream import Announced, McapStream, Written
from twin_node.bag.qos import is_latched, offered_qos_profiles
from twin_node.bag.writer import RECORDER, ChunkCompression
from twin_node.messages import MessageTypes
from twin_node.ranges import NOT_NEGATIVE, check_ranges

FLUSH_S = 0.5
"""How long messages wait for their chunk, s: what a killed recorder loses."""
CHUNK_BYTES = 4 << 20
"""Uncompressed size at which a chunk is closed before its time, bytes."""
PUT_BACK_NS = 1_000_000_000
"""A message that came so long before the one before it tells of a clock that was put back, ns; by less the threads that
take messages may overtake each other on a busy machine."""


def free_path(path: Path) -> Path:
    """The path of a recording, or, where its name is taken, the next free one beside it: NAME_r1, NAME_r2, ..."""
    number, free = 0, path
    while free.exists():
        number += 1
        free = path.with_name(f"{path.stem}_r{number}{path.suffix}")
    return free


@dataclass(frozen=True)
class SplitParameters:
    """When the next file of a recording is begun."""

    max_size_mb: float = 0.0
    """Size of a file before its compression, MB, beside the latched messages that it begins with again; 0: no limit."""
    max_duration_s: float = 0.0
    """Time that a file spans, s; 0: no limit."""

    def __post_init__(self) -> None:
        """Raises `BagError` for a size or a time below 0."""
        check_ranges(self, BagError, "split: ", max_size_mb=NOT_NEGATIVE, max_duration_s=NOT_NEGATIVE)


@dataclass(frozen=True)
class _File:
    """What is known of one file of a recording."""

    path: Path
    written: Written


@dataclass
class _Open:
    """What only the file that is being written needs. It is dropped when that file ends: the index of all chunks of
    some days would fill the memory."""

    file: BinaryIO
    stream: McapStream
    bytes: int = 0
    repeated: int = 0
    """Of those, what other files had too: a limit below it would begin a file for every message."""


class RecordingWriter:
    """Writes messages as they come. Nothing is lost of what is older than half a second, however its process ends.

    What is written is put onto the disk at once, by a thread beside: a power cut takes the last second on a disk that
    keeps up, and what a slower one has not taken yet.

    `path` ends in `.mcap` for one file, which cannot be split, or is a new folder: NAME_0.mcap, NAME_1.mcap and so on,
    and `metadata.yaml`. Latched messages stand at the beginning of every file again, so that each is whole.
    Raises `BagError` for a path that exists, a compression that is none, and where the disk refuses; what was written
    by then can be read.
    """

    def __init__(
        self, path: Path | str, split: SplitParameters | None = None, compression: ChunkCompression | str = "none"
    ) -> None:
        if compression not in get_args(ChunkCompression):
            known = ", ".join(get_args(ChunkCompression))
            raise BagError(f"{path}: compression: expected one of {known}, found {compression!r}")
        self.path = Path(path)
        self._compression = CompressionType[compression.upper()]
        self._split = split or SplitParameters()
        self._topics: dict[str, Announced] = {}
        self._kept: dict[str, list[bytes]] = {}
        """By latched topic what the next file begins with."""
        self._files: list[_File] = []
        self._open: _Open | None = None
        self._disk = DiskSync()
        self._flushed_at = time.monotonic()
        self._is_closed = False
        try:
            _check(self.path, self._split)
            if self.path.suffix != ".mcap":
                self.path.mkdir(parents=True)
                self._disk.ask(self.path.parent)
            self._begin_file()
        except OSError as error:
            with contextlib.suppress(OSError):
                self.discard()  # the name is free for the next try
            raise self._refused(error) from None

    @property
    def messages(self) -> int:
        """Messages written so far."""
        return sum(sum(file.written.counts.values()) for file in self._files)

    @property
    def topics(self) -> tuple[str, ...]:
        """Topics that messages were written of."""
        return tuple(self._topics)

    @property
    def seconds(self) -> float:
        """From the first message to the last one, s."""
        starts = [file.written.start for file in self._files if file.written.start is not None]
        return (max(file.written.end for file in self._files) - min(starts)) / 1e9 if starts else 0.0

    @property
    def files(self) -> tuple[Path, ...]:
        """Files begun so far."""
        return tuple(file.path for file in self._files)

    def write(
        self,
        topic: str,
        msgtype: str,
        data: bytes | memoryview,
        stamp: int,
        types: MessageTypes,
        latched: bool | None = None,
    ) -> None:
        """Writes CDR bytes at a log time in ns; `types` defines their type.

        `latched`: whether the topic's publishers keep their last message for who joins late; None follows
        `qos.is_latched`. What the topic's first message says of it stands. Raises `BagError` for a log time that cannot
        be.
        """
        check_log_time(stamp, topic, self.path)
        try:
            known = self._topics.get(topic)
            if known is None:
                latched = is_latched(topic) if latched is None else latched
                qos = offered_qos_profiles(latched)
                self._topics[topic] = Announced(
                    topic, msgtype, types.definition(msgtype), types.type_hash(msgtype), qos
                )
                if latched:
                    self._kept[topic] = []
            elif known.msgtype != msgtype:
                raise BagError(f"{self.path}: topic {topic} holds {known.msgtype}, found a message of {msgtype}")
            if self._is_full(stamp):
                self._end_file()
                self._begin_file()
                self._repeat_latched(stamp)
            self._put(topic, data, stamp)
            if topic in self._kept:
                self._kept[topic] = kept_with(self._kept[topic], topic, bytes(data))
            self.flush_if_due()
        except OSError as error:
            raise self._refused(error) from None

    def flush_if_due(self) -> None:
        """Closes the chunk in progress when it has waited long enough; to be called when no message comes, too."""
        now = time.monotonic()
        if now - self._flushed_at >= FLUSH_S:
            self._flushed_at = now
            try:
                self._now_open.stream.flush()
                self._disk.ask(self._files[-1].path)
                self._check_is_there()
            except OSError as error:
                raise self._refused(error) from None

    def add_metadata(self, name: str, record: Mapping[str, str]) -> None:
        """Adds a record of strings to the file that is being written."""
        try:
            self._now_open.stream.add_metadata(name, record)
        except OSError as error:
            raise self._refused(error) from None

    def close(self) -> None:
        """Finishes the last file and writes the folder's metadata; a second call does nothing."""
        if self._is_closed:
            return
        self._is_closed = True
        try:
            try:
                self._end_file()
            finally:
                self._write_metadata()
            self._disk.settle()
            self._check_is_there()
        except OSError as error:
            raise self._refused(error) from None

    def followed_by(self, path: Path, stamp: int) -> RecordingWriter:
        """Ends this recording; another one like it, which begins at log time `stamp`, ns, with what was latched here.

        Raises `BagError` as the constructor.
        """
        self.close()
        other = RecordingWriter(path, self._split, self._compression.name.lower())
        other._topics = {name: self._topics[name] for name in self._kept}
        other._kept = self._kept
        try:
            other._repeat_latched(stamp)
        except OSError as error:
            other.discard()  # nothing is in it that this one has not
            raise other._refused(error) from None
        return other

    def discard(self) -> None:
        """Ends the recording and takes it away: nobody wanted it."""
        self._is_closed = True
        if self._open is not None:
            with contextlib.suppress(OSError):  # what waits for the disk is not wanted either
                self._open.file.close()
        for file in self._files:
            file.path.unlink(missing_ok=True)
        if self.path.suffix != ".mcap":
            (self.path / METADATA_FILE).unlink(missing_ok=True)
            with contextlib.suppress(OSError):  # somebody else's files are in it by now
                self.path.rmdir()

    def __enter__(self) -> RecordingWriter:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def _now_open(self) -> _Open:
        assert self._open is not None, "a recording that has ended takes nothing more"
        return self._open

    def _begin_file(self) -> None:
        path = self.path
        if path.suffix != ".mcap":
            path = path / f"{path.name}_{len(self._files)}.mcap"
        file = path.open("xb")
        try:
            stream = McapStream(file, RECORDER, CHUNK_BYTES, self._compression)
            file.flush()  # before the metadata names it: an empty file is no log
        except OSError:
            with contextlib.suppress(OSError):
                file.close()
            path.unlink()
            raise
        self._files.append(_File(path, stream.written))
        self._open = _Open(file, stream)
        self._disk.ask(path.parent)
        self._write_metadata()

    def _repeat_latched(self, stamp: int) -> None:
        for name, messages in self._kept.items():
            for kept in messages:
                self._put(name, kept, stamp)
        self._now_open.repeated = self._now_open.bytes

    def _write_metadata(self) -> None:
        """Of a folder: it names all files from the first moment on, so that an interrupted recording opens too."""
        if self.path.suffix == ".mcap":
            return
        files = [file.written.in_folder(file.path.name) for file in self._files]
        counts = {name: sum(file.written.counts.get(name, 0) for file in self._files) for name in self._topics}
        write_metadata(self.path, files, [topic.in_folder(counts[name]) for name, topic in self._topics.items()])
        self._disk.ask(self.path / METADATA_FILE)
        self._disk.ask(self.path)

    def _end_file(self) -> None:
        """Finishes the last file, unless it was the next one that could not be begun."""
        ended, self._open = self._open, None
        if ended is None:
            return
        try:
            ended.stream.finish()
        finally:
            ended.file.close()
        self._disk.ask(self._files[-1].path)

    def _check_is_there(self) -> None:
        """Raises `OSError` where somebody has taken away what is written: nothing else would, and it is lost."""
        self._files[-1].path.stat()

    def _is_full(self, stamp: int) -> bool:
        start, now_open = self._files[-1].written.start, self._now_open
        if self.path.suffix == ".mcap" or start is None:
            return False
        too_big = 0 < self._split.max_size_mb * 1e6 <= now_open.bytes - now_open.repeated
        return too_big or 0 < self._split.max_duration_s * 1e9 <= stamp - start

    def _put(self, topic: str, data: bytes | memoryview, stamp: int) -> None:
        now_open = self._now_open
        if topic not in now_open.stream.topics:
            now_open.stream.add_topic(self._topics[topic])
        now_open.stream.write(topic, data, stamp, stamp)
        now_open.bytes += len(data)

    def _refused(self, error: OSError) -> BagError:
        if error.errno == errno.ENOENT and self._files:
            return BagError(
                f"{self.path}: is not there any more, somebody has removed or moved it, or its disk, while it was "
                "recorded; begin another recording"
            )
        kept = "; what was recorded until then can be read" if self.messages else ", so nothing is recorded"
        return BagError(
            f"{self.path}: cannot be written on ({error.strerror}){kept}; free space or choose another place"
        )


def _check(path: Path, split: SplitParameters) -> None:
    if path.exists():
        raise BagError(f"{path}: exists already; remove it or choose another name")
    if path.suffix not in ("", ".mcap"):
        raise BagError(f"{path}: expected a name ending in .mcap, or one without an ending for a folder")
    if path.suffix == ".mcap" and not path.parent.is_dir():
        raise BagError(f"{path}: folder {path.parent} does not exist; create it first")
    if path.suffix == ".mcap" and split != SplitParameters():
        raise BagError(f"{path}: one file cannot be split; give a name without an ending for a folder of files")
