"""Logs read by stream: MCAP files, rosbag2 folders of MCAP or SQLite files, split or whole, and single `.db3` files."""

from __future__ import annotations

import heapq
import json
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from types import TracebackType
from typing import Any

from rosbags.interfaces import Qos

from twin_node.bag import mcap_records, open_files, sqlite_storage
from twin_node.bag.compression import Compression, UnpackedMessages, plain_name, unpacked
from twin_node.bag.folder_metadata import METADATA_FILE
from twin_node.bag.log import BagError, DamageError, LogMessage, Part, Record, Storage, Topic
from twin_node.bag.log_times import NO_START, NO_STOP, within
from twin_node.bag.mcap_storage import McapStorage
from twin_node.bag.merged_topics import merged_topics
from twin_node.bag.sqlite_storage import SqliteStorage
from twin_node.messages import MessageTypes, builtin_types
from twin_node.yaml_file import YAML_ERRORS, parse_yaml, yaml_reason

ROS1_MAGIC = b"#ROSBAG V"
"""What a bag of ROS 1 begins with."""
SAFETENSORS_HEADER = b'{"'
"""What a model's file goes on with after eight bytes, which say how long this is."""


class LogReader:
    """A log, opened for reading; close it, or use it as a context manager.

    Messages can be read any number of times, and by several iterators at once in one thread.
    """

    def __init__(
        self,
        path: Path,
        storages: Collection[Storage],
        metadata: Mapping[str, Mapping[str, str]],
        unreadable: Sequence[str] = (),
    ) -> None:
        """`unreadable`: a line for each file of the log that nothing can be read of, or that is not there."""
        self.path = path
        self._storages = tuple(storages)
        self._unreadable = tuple(unreadable)
        self._damage: str | None = None
        self._metadata = {name: record for storage in storages for name, record in storage.metadata.items()}
        self._metadata.update(metadata)
        kept = within(part for storage in storages for part in storage.parts)
        self._parts = kept.parts
        merged = merged_topics(path, [c for storage in storages for c in storage.channels], kept.outside)
        self._topics = merged.topics
        self._left_out = (*merged.left_out, *kept.lines)
        self._kinds = {topic.name: topic.msgtype for topic in self._topics}
        self._definitions = merged.definitions
        self._types = builtin_types().extended(
            {name: text for storage in storages for name, text in storage.definitions.items()}
        )
        self._types_of: dict[str, MessageTypes] = {}
        if not self._parts:
            why = f" ({'; '.join(kept.lines)})" if kept.lines else ""
            raise BagError(f"{path}: the log holds no messages{why}; record it again")
        if not self._topics:
            raise BagError(f"{path}: the log names none of the topics that its messages are of; record it again")

    @property
    def topics(self) -> tuple[Topic, ...]:
        """All topics, by name."""
        return self._topics

    @property
    def spoken(self) -> Mapping[str, str]:
        """Topics that have messages -> their types: recorders name those, too, that nobody has said anything on."""
        return {topic.name: topic.msgtype for topic in self._topics if topic.count}

    @property
    def left_out(self) -> tuple[str, ...]:
        """What the log holds that is not read, a line each.

        Other encodings, a topic's messages of a second type or by a second definition of their type, messages at log
        times that cannot be.
        """
        return self._left_out

    @property
    def attachments(self) -> tuple[str, ...]:
        """Names of files that MCAP keeps beside the messages; nothing reads them."""
        return tuple(name for storage in self._storages for name in storage.attachments)

    def types_of(self, topic: str) -> MessageTypes:
        """Message types as this log defines them for a topic, beside the built-in ones.

        A log of several recordings may define one type in several ways.
        """
        if topic not in self._types_of:
            texts = self._definitions.get(topic, frozenset()) - {""}
            own = {self._kinds[topic]: min(texts)} if texts else {}
            self._types_of[topic] = self._types.extended(own)
        return self._types_of[topic]

    def definition(self, topic: Topic) -> str | None:
        """What defines a topic's type, as `ros2msg`; as the log has it where that is not understood; None: nothing."""
        types = self.types_of(topic.name)
        if topic.msgtype in types:
            return types.definition(topic.msgtype)
        return max(self._definitions[topic.name], default="") or None

    def profiles(self, topic: str) -> tuple[Qos, ...]:
        """Quality of service that a topic's publishers offered, as its first file has it; none where none says."""
        msgtype = self._kinds.get(topic)
        for storage in self._storages:
            for channel in storage.channels:
                if (channel.topic, channel.msgtype) == (topic, msgtype) and channel.profiles:
                    return channel.profiles
        return ()

    @property
    def start_ns(self) -> int:
        """Log time of the first message, ns."""
        return min(part.start for part in self._parts)

    @property
    def end_ns(self) -> int:
        """Log time of the last message, ns."""
        return max(part.end for part in self._parts)

    @property
    def metadata(self) -> Mapping[str, Mapping[str, str]]:
        """Metadata records by name."""
        return self._metadata

    @property
    def damage(self) -> str | None:
        """One line that says where the log is damaged; None where no damage has been met.

        A missing end is known once the log is open, a damaged chunk once iteration has come to it.
        """
        known = [*self._unreadable, *(storage.damage for storage in self._storages), self._damage]
        return " | ".join(line for line in known if line) or None

    def messages(
        self,
        topics: Collection[str] | str | None = None,
        start_ns: int | None = None,
        stop_ns: int | None = None,
        *,
        past_damage: bool = False,
    ) -> Iterator[LogMessage]:
        """Messages in log-time order (ties as stored); of the log, only the parts about that time are in memory.

        `topics`: names, or one; None for all. Of one that the log does not have there are none. From `start_ns` on and
        before `stop_ns`. Parts that hold none of these are not read; where one that is read is damaged, the messages
        end (`past_damage`: go on after it), and `damage` tells.
        """
        if isinstance(topics, str):
            topics = (topics,)
        start = NO_START if start_ns is None else start_ns
        stop = NO_STOP if stop_ns is None else stop_ns
        streams = [
            _stream(index, part, topics, start, stop)
            for index, part in enumerate(self._parts)
            if part.holds(topics, start, stop)
        ]
        if past_damage:
            streams = [self._until_damage(stream) for stream in streams]
        try:
            for entry in heapq.merge(*streams, key=_Entry.order):
                record = entry.record
                if record is not None and self._is_read(record):
                    types = self.types_of(record.topic)
                    yield LogMessage(record.topic, record.msgtype, record.stamp, record.data, types, record.published)
        except DamageError as damage:
            self._damage = str(damage)

    def _is_read(self, record: Record) -> bool:
        is_of_kind = self._kinds.get(record.topic) == record.msgtype
        return is_of_kind and record.definition in self._definitions[record.topic]

    def _until_damage(self, entries: Iterator[_Entry]) -> Iterator[_Entry]:
        try:
            yield from entries
        except DamageError as damage:
            self._damage = self._damage or str(damage)

    def close(self) -> None:
        """Releases the files."""
        for storage in self._storages:
            storage.close()

    def __enter__(self) -> LogReader:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


class _Entry:
    """A message on its way through the merge; without a record, it announces a part that begins at that time."""

    __slots__ = ("part", "record", "stamp")

    def __init__(self, stamp: int, part: int, record: Record | None) -> None:
        self.stamp, self.part, self.record = stamp, part, record

    def order(self) -> tuple[int, int]:
        return self.stamp, self.part


def _stream(index: int, part: Part, topics: Collection[str] | None, start: int, stop: int) -> Iterator[_Entry]:
    """The part's messages after an announcement, so that merging opens no part before its time has come."""
    yield _Entry(max(part.start, start), index, None)
    for record in part.storage.records(part, topics, start, stop):
        yield _Entry(record.stamp, index, record)


def open_log(path: Path | str, *, unfinished: bool = False) -> LogReader:
    """Opens an MCAP file, a `.db3` file, or a rosbag2 folder (the kind is told by content, not by name).

    `unfinished`: a folder opens without those of its files that are not there, and by their numbers where its recorder
    was killed before it wrote `metadata.yaml`, or that was damaged.

    Raises `BagError` with one line for a path that is missing, empty, no log, holds no messages, or none in CDR. A
    damaged or unfinished MCAP file opens up to its damage, a folder without those of its files that nothing can be read
    of (the last one of a recorder that was killed may be empty), and `LogReader.damage` tells.
    """
    path = Path(path)
    try:
        return _open_folder(path, unfinished) if path.is_dir() else _open_files(path, [path], {})
    except OSError as error:
        raise BagError(f"{path}: cannot be read ({error.strerror}); {open_files.advice(error)}") from None


def _open_folder(folder: Path, unfinished: bool) -> LogReader:
    file = folder / METADATA_FILE
    logs = _logs_of(folder)
    if not file.is_file() and _is_bag(logs):
        if unfinished:
            return _open_numbered(folder, logs)
        raise BagError(
            f"{folder}: no {METADATA_FILE} in this folder, its recording was not finished; {_way_out(folder, logs)}"
        )
    if not file.is_file():
        hint = f"give one of its files ({logs[0]})" if logs else "expected a rosbag2 folder or an MCAP file"
        raise BagError(f"{folder}: no {METADATA_FILE} in this folder; {hint}")
    try:
        information = _bag_information(file)
    except BagError as error:
        if unfinished and _is_bag(logs):
            return _open_numbered(folder, logs, f"{error}; its files are read by their numbers")
        raise BagError(f"{error}; {_way_out(folder, logs)}") from None
    if information.formats - {"cdr"}:
        found = ", ".join(sorted(information.formats))
        raise BagError(f"{file}: expected messages in cdr, found {found}; convert the bag to cdr")
    paths = [folder / name for name in information.files]
    missing = [path.name for path in paths if not path.is_file()]
    lost = f"{file}: names files that are not there: {', '.join(missing) or 'none at all'}"
    if len(missing) == len(paths) or (missing and not unfinished):
        rest = f", or write what is there with {_repairing(folder)}" if len(missing) < len(paths) else ""
        raise BagError(f"{lost}; copy the whole bag{rest}")
    there = [path for path in paths if path.name not in missing]
    return _open_files(folder, there, information.records, information.compression, [lost] if missing else [])


def _logs_of(folder: Path) -> list[str]:
    """Names of a folder's logs; of one that is there compressed and plain, the plain one's: that is whole."""
    names = sorted((entry.name for entry in folder.iterdir()), key=len, reverse=True)
    found = {plain_name(name): name for name in names if Path(plain_name(name)).suffix in (".mcap", ".db3")}
    return sorted(found.values())


def _open_numbered(folder: Path, names: Sequence[str], *lost: str) -> LogReader:
    """The files of a recording of which no metadata tells."""
    return _open_files(folder, [folder / name for name in sorted(names, key=_number)], {}, lost=lost)


def _way_out(folder: Path, logs: Sequence[str]) -> str:
    """What to do with the logs of a folder that does not tell of them."""
    if not logs:
        return "copy it again"
    one = f"give one of its files ({logs[0]})"
    return f"write it whole with {_repairing(folder)}, or {one}" if _is_bag(logs) else one


def _repairing(folder: Path) -> str:
    return f"'twin_node check {folder} --repair OUT'"


def _is_bag(names: Sequence[str]) -> bool:
    """Whether these are the files of one recording, numbered from 0: rosbag2 writes its metadata at the very end."""
    parts = [plain_name(name).rpartition(".")[0].rpartition("_") for name in names]
    numbers = sorted(number for _, _, number in parts)
    return (
        bool(parts) and len({stem for stem, _, _ in parts}) == 1 and "0" in numbers and all(map(str.isdecimal, numbers))
    )


def _number(name: str) -> int:
    return int(plain_name(name).rpartition(".")[0].rpartition("_")[2])


@dataclass(frozen=True)
class _Information:
    """What a folder's `metadata.yaml` says."""

    files: tuple[str, ...]
    formats: frozenset[str]
    """Of its messages."""
    compression: Compression
    records: Mapping[str, Mapping[str, str]]
    """Metadata records by name."""


def _bag_information(file: Path) -> _Information:
    try:
        content: Any = parse_yaml(file.read_text(encoding="utf-8"), texts_of="custom_data")
        information = content["rosbag2_bagfile_information"]
        topics = [topic["topic_metadata"] for topic in information["topics_with_message_count"]]
        return _Information(
            files=tuple(PurePosixPath(name).name for name in information["relative_file_paths"]),
            formats=frozenset(str(topic["serialization_format"]) for topic in topics),
            compression=Compression.of(information, file),
            records=_custom_data(information),
        )
    except YAML_ERRORS as error:
        why = yaml_reason(error)
    except KeyError as error:
        why = f"it has no field {error}"
    except (TypeError, AttributeError):
        why = "a field holds something else"
    raise BagError(f"{file}: not the metadata of a rosbag2 folder ({why})")


def _custom_data(information: Any) -> dict[str, Mapping[str, str]]:
    """Metadata records that `LogWriter` put into the folder's custom data as JSON; other custom data as they are."""
    records: dict[str, Mapping[str, str]] = {}
    for name, text in (information.get("custom_data") or {}).items():
        try:
            content = json.loads(text or "")
        except (ValueError, RecursionError):
            content = None
        is_record = isinstance(content, dict) and all(isinstance(value, str) for value in content.values())
        records[name] = content if is_record else {"value": text or ""}
    return records


def _open_files(
    path: Path,
    files: Collection[Path],
    metadata: Mapping[str, Mapping[str, str]],
    compression: Compression = Compression.NONE,
    lost: Sequence[str] = (),
) -> LogReader:
    """`lost`: a line for what else should be there."""
    open_files.make_room(len(files))
    storages: list[Storage] = []
    refused: list[BagError] = []
    try:
        for file in files:
            try:
                with unpacked(file, compression) as plain:
                    storages.append(_open_file(plain, file))
            except BagError as error:
                refused.append(error)
        if refused and not storages:
            raise refused[0]
        if compression is Compression.MESSAGE:
            storages = [UnpackedMessages(path, storage) for storage in storages]
        unreadable = (*lost, *(f"{error}; the others are read" for error in refused))
        return LogReader(path, storages, metadata, unreadable)
    except BaseException:
        for storage in storages:
            storage.close()
        raise


def _open_file(path: Path, told: Path) -> Storage:
    """`told`: what messages to people call the file."""
    with path.open("rb") as file:
        head = file.read(len(sqlite_storage.MAGIC))
    if head.startswith(mcap_records.MAGIC):
        return McapStorage(path, told)
    if head == sqlite_storage.MAGIC:
        return SqliteStorage(path, told)
    if head.startswith(ROS1_MAGIC):
        raise BagError(
            f"{told}: expected a log of ROS 2, found a bag of ROS 1; convert it: rosbags-convert --src {told} --dst OUT"
        )
    if head[8:].startswith(SAFETENSORS_HEADER):
        raise BagError(f"{told}: expected a log, found a model; make a log of it: twin_node import model {told} -o OUT")
    found = f"a file that begins with {head[:8]!r}" if head else "an empty file"
    raise BagError(f"{told}: expected an MCAP or rosbag2 SQLite log, found {found}; check the path")
