"""Logs written by stream: one MCAP file of the `ros2` profile, or a rosbag2 folder around one."""

from __future__ import annotations

import contextlib
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Literal, Protocol

from mcap.writer import CompressionType
from rosbags.interfaces import Qos

from twin_node.bag.folder_metadata import write_metadata
from twin_node.bag.log import BagError
from twin_node.bag.log_times import check_log_time, check_published
from twin_node.bag.mcap_records import library_of
from twin_node.bag.mcap_stream import Announced, McapStream
from twin_node.bag.qos import is_latched, profile, stored
from twin_node.messages import Message, builtin_types, serialize
from twin_node.paths import is_there
from twin_node.unfinished import partial_of, taken, unwritable

LIBRARY = "twin_node"
"""Written into logs that a command makes of something, and can make again: such a log may be replaced."""
RECORDER = "twin_node record"
"""Written into logs of what happened once."""
CHUNK_BYTES = 1 << 20
"""Uncompressed size at which a chunk is closed: mcap's default, half a second of one 640x480 JPEG stream."""
ChunkCompression = Literal["none", "zstd", "lz4"]
"""How the chunks of an MCAP file are compressed. Zstd makes what a twin says a quarter, for a twentieth of a core."""


class _Sink(Protocol):
    """Where a log goes: a file or a folder."""

    @property
    def stream(self) -> McapStream: ...

    def add_metadata(self, name: str, record: Mapping[str, str]) -> None: ...

    def commit(self) -> None: ...

    def abort(self) -> None: ...


class LogWriter:
    """Writes a log by stream; use it as a context manager.

    `path` ends in `.mcap` for one MCAP file, or has no suffix for a new rosbag2 folder. An `.mcap` file that is empty,
    or that a `LogWriter` made, is replaced at the end; any other is refused, at the beginning and then: a recording
    cannot be made again. All goes to a sibling ending in `.partial`, which takes the name when the log is closed; if
    the context ends with an exception it is removed, and whatever stood at `path` is untouched. A sibling that is there
    already is another writer's, or all that is left of a log whose writer was killed: it is refused. The same calls
    give the same bytes.

    `compression` of the chunks: none by default, as `ros2 bag record`, because images are compressed. `recorded`: what
    is written happened once, and no other writer is to replace it.
    Raises `BagError` for a wrong path, stamp or type, for messages after `close`, and when the disk refuses.
    """

    def __init__(self, path: Path | str, compression: ChunkCompression = "none", *, recorded: bool = False) -> None:
        self.path = Path(path)
        self._topics: dict[str, str] = {}
        self._closed = False
        try:
            if not (is_there(self.path.parent) and self.path.parent.is_dir()):
                raise BagError(f"{self.path}: folder {self.path.parent} does not exist; create it first")
            self._sink = _open_sink(self.path, CompressionType[compression.upper()], recorded)
        except OSError as error:
            raise self._refused(error) from None

    def add_topic(
        self,
        name: str,
        msgtype: str,
        *,
        definition: str | None = None,
        latched: bool | None = None,
        profiles: Sequence[Qos] = (),
    ) -> None:
        """Announces a topic; needed only for what `write` cannot know.

        `definition`: `ros2msg` or IDL text of a type outside of the built-in set; one that is not understood here is
        kept as it is, for `write_raw`. `latched`: None follows `qos.is_latched`.
        `profiles`: quality of service of its publishers; none: reliable, and latched or not.
        """
        if self._topics.setdefault(name, msgtype) != msgtype:
            raise BagError(f"{self.path}: topic {name} holds {self._topics[name]}, found a message of {msgtype}")
        types = builtin_types()
        if definition is not None:
            types = types.extended({msgtype: definition})
        is_foreign = definition is not None and msgtype not in types
        text = types.definition(msgtype) if definition is None else definition
        type_hash = "" if is_foreign else types.type_hash(msgtype)
        latched = is_latched(name) if latched is None else latched
        qos = stored(profiles or [profile(latched)])
        try:
            self._sink.stream.add_topic(Announced(name, msgtype, text, type_hash, qos))
        except OSError as error:
            raise self._refused(error) from None

    def write(self, topic: str, message: Message, stamp_ns: int) -> None:
        """Writes a message at a log time in ns."""
        self.write_raw(topic, message.__msgtype__, serialize(message), stamp_ns)

    def write_raw(
        self, topic: str, msgtype: str, data: bytes | memoryview, stamp_ns: int, published_ns: int | None = None
    ) -> None:
        """Writes CDR bytes of a message at a log time in ns, published at that time or another."""
        published_ns = stamp_ns if published_ns is None else published_ns
        check_log_time(stamp_ns, topic, self.path)
        check_published(published_ns, topic, self.path)
        if self._closed:
            raise BagError(f"{self.path}: closed already, found another message on {topic}; write it before")
        try:
            if self._topics.get(topic) != msgtype:
                self.add_topic(topic, msgtype)
            self._sink.stream.write(topic, data, stamp_ns, published_ns)
        except OSError as error:
            raise self._refused(error) from None

    def add_metadata(self, name: str, record: Mapping[str, str]) -> None:
        """Adds a record of strings that is kept beside the messages (MCAP Metadata; custom data of a folder)."""
        try:
            self._sink.add_metadata(name, record)
        except OSError as error:
            raise self._refused(error) from None

    def flush(self) -> None:
        """Hands all that was written to the operating system, so that a crash loses nothing of it."""
        try:
            self._sink.stream.flush()
        except OSError as error:
            raise self._refused(error) from None

    def close(self) -> None:
        """Finishes the log and gives it its name; a second call does nothing."""
        if self._closed:
            return
        self._closed = True
        try:
            self._sink.commit()
        except (BagError, OSError) as error:
            self._sink.abort()
            raise (self._refused(error) if isinstance(error, OSError) else error) from None

    def abort(self) -> None:
        """Throws away what was written; a call after `close` does nothing."""
        if not self._closed:
            self._closed = True
            self._sink.abort()

    def __enter__(self) -> LogWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is None:
            self.close()
        else:
            self.abort()

    def _refused(self, error: OSError) -> BagError:
        return BagError(unwritable(self.path, error))


def _open_sink(path: Path, compression: CompressionType, recorded: bool) -> _Sink:
    library = RECORDER if recorded else LIBRARY
    if path.suffix == ".mcap":
        if path.is_dir():
            raise BagError(f"{path}: is a folder; expected the name of a file")
        _refuse_recording(path)
        return _FileSink(path, compression, library)
    if path.suffix:
        raise BagError(f"{path}: expected a name ending in .mcap, or one without an ending for a rosbag2 folder")
    if path.exists():
        raise BagError(f"{path}: exists already; remove it or choose another name")
    return _FolderSink(path, compression, library)


def _refuse_recording(path: Path) -> None:
    """Raises `BagError` for a file that could not be made again."""
    if not path.exists() or path.stat().st_size == 0:
        return
    library = library_of(path)
    if library != LIBRARY:
        found = "something else" if library is None else f"a recording ({library})"
        raise BagError(
            f"{path}: expected a new name, or a log made by a command that can make it again, found {found}; move it "
            "elsewhere or choose another name"
        )


class _FileSink:
    """One MCAP file."""

    def __init__(self, path: Path, compression: CompressionType, library: str) -> None:
        self._path = path
        self._partial = partial_of(path)
        try:
            self._file = self._partial.open("xb")
        except FileExistsError:
            raise BagError(taken(path)) from None
        self.stream = McapStream(self._file, library, CHUNK_BYTES, compression)

    def add_metadata(self, name: str, record: Mapping[str, str]) -> None:
        self.stream.add_metadata(name, record)

    def commit(self) -> None:
        self.stream.finish()
        self._file.close()
        _refuse_recording(self._path)  # one may have been begun there meanwhile
        self._partial.replace(self._path)

    def abort(self) -> None:
        with contextlib.suppress(OSError):  # of what waited in its buffer; the file goes
            self._file.close()
        self._partial.unlink(missing_ok=True)


class _FolderSink:
    """A rosbag2 folder around one file, which carries the folder's name; it grows inside a `.partial` folder."""

    def __init__(self, path: Path, compression: CompressionType, library: str) -> None:
        self._path = path
        self._partial = partial_of(path)
        for left in (self._partial / path.name, self._partial):
            with contextlib.suppress(OSError):  # with anything in it, it stays
                left.rmdir()
        try:
            self._partial.mkdir()
        except FileExistsError:
            raise BagError(taken(path)) from None
        self._folder = self._partial / path.name
        self._name = f"{path.name}.mcap"
        try:
            self._folder.mkdir()
            self._file = _FileSink(self._folder / self._name, compression, library)
        except OSError:
            shutil.rmtree(self._partial, ignore_errors=True)
            raise
        self._records: dict[str, Mapping[str, str]] = {}

    @property
    def stream(self) -> McapStream:
        return self._file.stream

    def add_metadata(self, name: str, record: Mapping[str, str]) -> None:
        self._records[name] = record

    def commit(self) -> None:
        self._file.commit()
        written = self.stream.written
        topics = [topic.in_folder(written.counts[name]) for name, topic in self.stream.topics.items()]
        write_metadata(self._folder, [written.in_folder(self._name)], topics, self._records)
        self._folder.rename(self._path)
        self._partial.rmdir()

    def abort(self) -> None:
        self._file.abort()
        shutil.rmtree(self._partial, ignore_errors=True)
