"""SQLite files of rosbag2 (`.db3`), read by rosbags."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import cast

from rosbags.interfaces import ConnectionExtRosbag2
from rosbags.rosbag2 import Reader, ReaderError

from twin_node.bag.log import BagError, Channel, DamageError, Part, Record
from twin_node.bag.qos import any_transient_local

MAGIC = b"SQLite format 3\x00"


class SqliteStorage:
    """A `.db3` file. Raises `BagError` if it is damaged from the start or not a rosbag2 file."""

    def __init__(self, path: Path) -> None:
        self._path = path
        try:
            self._reader = Reader(path)
            self._reader.open()
        except (ReaderError, KeyError, TypeError) as error:
            reason = " ".join(str(error).split())
            raise BagError(f"{path}: not a readable rosbag2 SQLite file ({reason}); record it again") from None

    @property
    def channels(self) -> tuple[Channel, ...]:
        """What the file holds."""
        return tuple(
            Channel(
                topic=connection.topic,
                msgtype=connection.msgtype,
                encoding=cast("ConnectionExtRosbag2", connection.ext).serialization_format,
                count=connection.msgcount,
                latched=any_transient_local(cast("ConnectionExtRosbag2", connection.ext).offered_qos_profiles),
            )
            for connection in self._reader.connections
        )

    @property
    def definitions(self) -> Mapping[str, str]:
        """Message definitions that the file carries (rosbag2 since Iron)."""
        return {c.msgtype: c.msgdef.data for c in self._reader.connections if c.msgdef.data}

    @property
    def metadata(self) -> Mapping[str, Mapping[str, str]]:
        """Nothing: rosbag2 keeps custom data in `metadata.yaml`."""
        return {}

    @property
    def parts(self) -> tuple[Part, ...]:
        """The whole file: SQLite streams it in log-time order by its own index."""
        if not self._reader.message_count:
            return ()
        return (Part(self, self._reader.start_time, self._reader.end_time - 1),)

    @property
    def damage(self) -> str | None:
        """None: what is missing from a SQLite file shows when it is read."""
        return None

    def records(self, part: Part, topics: Collection[str] | None, start: int, stop: int) -> Iterator[Record]:
        """Messages of the file in log-time order; raises `DamageError` at the first page that SQLite cannot read."""
        wanted = [c for c in self._reader.connections if topics is None or c.topic in topics]
        if not wanted:
            return
        messages = self._reader.messages(wanted, start, stop)
        stamp = max(start, part.start)
        while True:
            try:
                connection, stamp, data = next(messages)
            except StopIteration:
                return
            except Exception as error:  # what was read stands; SQLite bindings raise classes of their own
                reason = " ".join(str(error).split())
                raise DamageError(
                    f"{self._path}: damaged after the message at {stamp} ns ({reason}); read up to it"
                ) from None
            yield Record(connection.topic, connection.msgtype, stamp, data)

    def close(self) -> None:
        """Releases the file."""
        self._reader.close()
