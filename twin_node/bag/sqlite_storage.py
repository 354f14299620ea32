"""SQLite files of rosbag2 (`.db3`), read by rosbags."""

from __future__ import annotations

import contextlib
import tempfile
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import cast

from rosbags.interfaces import ConnectionExtRosbag2
from rosbags.rosbag2 import Reader, ReaderError

from twin_node.bag.log import BagError, Channel, DamageError, Part, Record
from twin_node.bag.log_times import NO_STOP
from twin_node.errors import several

MAGIC = b"SQLite format 3\x00"
ENDING = ".db3"
"""By which rosbags knows such a file."""
URI_SIGNS = frozenset("?#%")
"""What means something else in an SQLite URI, as which rosbags takes a path."""


class SqliteStorage:
    """A `.db3` file. Raises `BagError` if it is damaged from the start or not a rosbag2 file."""

    def __init__(self, path: Path, told: Path | None = None) -> None:
        """`told`: what messages to people call the file, where that is not `path`."""
        self._path = path
        self._told = told or path
        try:
            with _plainly_named(path) as plain, _known_definitions():
                self._reader = Reader(plain)
                self._reader.open()
            self._check()
            named = sum(connection.msgcount for connection in self._reader.connections)
            self._nameless = self._reader.message_count - named
        except OSError:
            raise
        except Exception as error:  # names and policies that are none are met in rosbags, SQLite and the YAML parser
            reason = " ".join(str(error).split())
            raise BagError(f"{self._told}: not a readable rosbag2 SQLite file ({reason}); record it again") from None

    @property
    def channels(self) -> tuple[Channel, ...]:
        """What the file holds."""
        return tuple(
            Channel(
                topic=connection.topic,
                msgtype=connection.msgtype,
                encoding=cast("ConnectionExtRosbag2", connection.ext).serialization_format,
                count=connection.msgcount,
                profiles=tuple(cast("ConnectionExtRosbag2", connection.ext).offered_qos_profiles),
                definition=connection.msgdef.data,
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
    def attachments(self) -> tuple[str, ...]:
        """None: SQLite files of rosbag2 hold nothing but messages."""
        return ()

    @property
    def parts(self) -> tuple[Part, ...]:
        """The whole file: SQLite streams it in log-time order by its own index."""
        if not self._reader.message_count:
            return ()
        end = int(self._reader.end_time)  # after the last time there is none, and SQLite gives a float
        return (Part(self, self._reader.start_time, end - 1),)

    @property
    def damage(self) -> str | None:
        """Messages that are of none of the file's topics, and a write-ahead log beside it, whose recorder was killed.

        Other damage shows when the file is read.
        """
        lines = []
        if self._nameless > 0:  # below it, the index leads to fewer than there are
            count = several(self._nameless, "message")
            lines.append(f"{self._told}: {count} of topics that nothing undamaged names; read without them")
        ahead = self._path.with_name(f"{self._path.name}-wal")
        if ahead.is_file() and ahead.stat().st_size:
            lines.append(
                f"{ahead}: its recorder was killed, and the last messages, which are still in here, are not read; take "
                f"them over with: sqlite3 '{self._path}' 'PRAGMA wal_checkpoint(TRUNCATE)'"
            )
        return " | ".join(lines) or None

    def records(self, part: Part, topics: Collection[str] | None, start: int, stop: int) -> Iterator[Record]:
        """Messages of the file in log-time order; raises `DamageError` at the first page that SQLite cannot read."""
        wanted = [c for c in self._reader.connections if topics is None or c.topic in topics]
        if not wanted:
            return
        messages = self._reader.messages(wanted, start, stop if stop < NO_STOP else None)  # SQLite knows none beyond
        stamp, found = max(start, part.start), 0
        is_all = start <= self._reader.start_time and stop >= self._reader.end_time
        while True:
            try:
                connection, told, data = next(messages)
                if not (isinstance(told, int) and isinstance(data, bytes)):
                    raise ReaderError(f"a message on {connection.topic} without time or content")
                if not stamp <= told < stop:
                    raise ReaderError(f"a message on {connection.topic} at {told} ns, out of order")
                stamp = told
            except StopIteration:
                break
            except Exception as error:  # what was read stands; SQLite bindings raise classes of their own
                reason = " ".join(str(error).split())
                raise DamageError(
                    f"{self._told}: damaged after the message at {stamp} ns ({reason}); read up to it"
                ) from None
            found += 1
            yield Record(connection.topic, connection.msgtype, stamp, data, stamp, connection.msgdef.data)
        count = sum(connection.msgcount for connection in wanted)
        if is_all and found < count:
            raise DamageError(f"{self._told}: damaged, its index of times leads to {found} of {count} messages")

    def close(self) -> None:
        """Releases the file."""
        self._reader.close()

    def _check(self) -> None:
        """Raises `ReaderError`, and closes the file, where what names the topics is no text, or no time is known."""
        count = sum(connection.msgcount for connection in self._reader.connections)
        if count and self._reader.start_time >= self._reader.end_time:
            self._reader.close()
            raise ReaderError(f"damaged, its index of times leads to none of {count} messages")
        for connection in self._reader.connections:
            named = (connection.topic, connection.msgtype, cast("ConnectionExtRosbag2", connection.ext))
            if not all(isinstance(text, str) for text in (*named[:2], named[2].serialization_format)):
                self._reader.close()
                raise ReaderError(f"topic {connection.topic!r} of type {connection.msgtype!r}")


@contextlib.contextmanager
def _known_definitions() -> Iterator[None]:
    """Databases that are opened meanwhile show only message definitions of a form that rosbags knows.

    Of a type that it finds no definition of, rosbag2 (since Iron) keeps one of no form, or of form "unknown"; rosbags
    reads nothing of such a file.
    """
    try:
        import apsw
    except ImportError:  # older versions of rosbags ask another library
        yield
        return

    def hide(database: apsw.Connection) -> None:
        database.execute(
            "CREATE TEMP VIEW IF NOT EXISTS message_definitions AS "
            "SELECT * FROM main.message_definitions WHERE encoding IN ('ros2msg', 'ros2idl')"
        )

    apsw.connection_hooks.append(hide)
    try:
        yield
    finally:
        apsw.connection_hooks.remove(hide)


@contextlib.contextmanager
def _plainly_named(path: Path) -> Iterator[Path]:
    """The path, or, where rosbags would take its name for something else, a link to it that goes when it is open."""
    if path.suffix == ENDING and URI_SIGNS.isdisjoint(str(path)):
        yield path
        return
    with tempfile.TemporaryDirectory(prefix="twin_node_") as folder:
        link = Path(folder) / f"log{ENDING}"
        link.symlink_to(path.absolute())
        yield link
