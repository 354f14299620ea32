"""Log times at the ends of what can be: written and read up to the last one, and told beyond it."""

from __future__ import annotations

import sqlite3
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.writer import CompressionType, Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as FolderWriter
from rosbags.typesys import Stores, get_typestore

from twin_node.bag import BagError, LogWriter, RecordingWriter, open_log
from twin_node.bag.repair import repair
from twin_node.cli import main
from twin_node.messages import MessageError, builtin_types, definition, message_type, serialize
from twin_node.messages.stamps import to_time

STRING = "std_msgs/msg/String"
LAST = 2**63 - 1
START = 1_700_000_000_000_000_000
OUTSIDE = f"/text: 1 message of {STRING} at log times that cannot be; expected 0 to 2^63 - 1 ns"


def text(words: str) -> bytes:
    return bytes(serialize(message_type(STRING)(data=words)))


def foreign(path: Path, stamps: Sequence[int], use_chunking: bool = True) -> Path:
    """A file of another program's, whose times may be anything that MCAP can hold."""
    with path.open("wb") as stream:
        writer = Writer(stream, compression=CompressionType.NONE, use_chunking=use_chunking)
        writer.start("ros2", "a test")
        schema = writer.register_schema(STRING, "ros2msg", definition(STRING).encode())
        channel = writer.register_channel("/text", "cdr", schema)
        for stamp in stamps:
            writer.add_message(channel, stamp, text(str(stamp)), stamp)
        writer.finish()
    return path


@pytest.mark.parametrize("name", ["log.mcap", "log"])
def test_first_and_last_time_are_written_and_read(tmp_path: Path, name: str) -> None:
    with LogWriter(tmp_path / name) as log:
        for stamp in (0, LAST):
            log.write("/text", message_type(STRING)(data="a"), stamp)
        for beyond in (-1, LAST + 1, 2**64 - 1):
            with pytest.raises(BagError, match=f"/text at {beyond} ns; expected a log time from 0 to 2"):
                log.write("/text", message_type(STRING)(data="a"), beyond)
    with open_log(tmp_path / name) as log:
        assert [entry.stamp for entry in log.messages()] == [0, LAST]
        assert [entry.stamp for entry in log.messages(start_ns=LAST)] == [LAST]
        assert [entry.stamp for entry in log.messages(stop_ns=LAST)] == [0]
        assert (log.start_ns, log.end_ns, log.left_out) == (0, LAST, ())


@pytest.mark.parametrize("name", ["log.mcap", "log"])
@pytest.mark.parametrize("stamp", [-1, LAST + 1, 2**64 - 1, 2**64])
def test_recordings_refuse_times_that_cannot_be(tmp_path: Path, name: str, stamp: int) -> None:
    with RecordingWriter(tmp_path / name) as log:
        log.write("/text", STRING, text("a"), LAST, builtin_types())
        with pytest.raises(BagError, match=f"/text at {stamp} ns; expected a log time from 0 to 2"):
            log.write("/text", STRING, text("a"), stamp, builtin_types())
    with open_log(tmp_path / name) as log:
        assert [entry.stamp for entry in log.messages()] == [LAST]


@pytest.mark.parametrize("name", ["log.mcap", "log"])
def test_times_may_be_integers_of_numpy_s(tmp_path: Path, name: str) -> None:
    """Folders ended in a traceback, and unfinished: their `metadata.yaml` took none."""
    stamps: Any = np.array([START, START + 5])
    with LogWriter(tmp_path / name) as log, RecordingWriter(tmp_path / f"recorded_{name}") as recording:
        for stamp in stamps:
            log.write_raw("/text", STRING, text("a"), stamp, stamp)
            recording.write("/text", STRING, text("a"), stamp, builtin_types())
    for written in (name, f"recorded_{name}"):
        with open_log(tmp_path / written) as reader:
            assert [entry.stamp for entry in reader.messages()] == stamps.tolist()


@pytest.mark.parametrize("name", ["log.mcap", "log"])
@pytest.mark.parametrize("stamp", [1.7e9, 1.7e18])
def test_times_that_are_no_whole_nanoseconds_are_refused(tmp_path: Path, name: str, stamp: Any) -> None:
    """In messages, seconds were a moment in 1970; a log ended in a traceback."""
    with pytest.raises(MessageError, match=r"stamp: expected whole nanoseconds, .*; of seconds give round"):
        to_time(stamp)
    with (
        pytest.raises(BagError, match=r"message on /words at .* ns; expected whole nanoseconds"),
        LogWriter(tmp_path / name) as log,
    ):
        log.write_raw("/words", "std_msgs/msg/String", text("now"), stamp)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["log.mcap", "log"])
@pytest.mark.parametrize("published", [-1, 2**64, 1.7e18])
def test_times_of_publishing_that_no_log_can_hold_are_refused(tmp_path: Path, name: str, published: Any) -> None:
    with LogWriter(tmp_path / name) as log:
        log.write_raw("/words", STRING, text("kept"), START, 2**64 - 1)
        with pytest.raises(BagError, match=r"message on /words published at .* ns; expected whole nanoseconds from 0"):
            log.write_raw("/words", STRING, text("none"), START, published)
    with open_log(tmp_path / name) as log:
        assert [(entry.stamp, entry.published) for entry in log.messages()] == [(START, 2**64 - 1)]


@pytest.mark.parametrize("use_chunking", [True, False])
@pytest.mark.parametrize("beyond", [LAST + 1, 2**64 - 1])
def test_a_message_beyond_is_told_and_the_rest_is_as_if_it_were_not_there(
    tmp_path: Path, beyond: int, use_chunking: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    path = foreign(tmp_path / "log.mcap", [START, beyond, START + 5], use_chunking)
    with open_log(path) as log:
        assert log.left_out == (OUTSIDE,)
        assert [entry.stamp for entry in log.messages()] == [START, START + 5]
        assert (log.start_ns, log.end_ns) == (START, START + 5)
        assert [topic.count for topic in log.topics] == [2]
    assert repair(path, tmp_path / "repaired.mcap").left_out == (OUTSIDE,)
    assert main(["info", str(path)]) == 0
    assert f"not read: {OUTSIDE}" in capsys.readouterr().out


def test_a_log_of_nothing_else_is_refused(tmp_path: Path) -> None:
    path = foreign(tmp_path / "log.mcap", [2**64 - 1])
    with pytest.raises(BagError, match=r"the log holds no messages \(/text: 1 message .* cannot be.*; record it again"):
        open_log(path)


def test_damage_beyond_is_told_as_damage(tmp_path: Path) -> None:
    path = foreign(tmp_path / "log.mcap", [START, 2**64 - 1])
    whole = path.read_bytes()
    at = whole.index(text(str(START)))
    path.write_bytes(whole[:at] + b"\xff" + whole[at + 1 :])
    with open_log(path) as log:
        assert list(log.messages()) == []
        assert log.damage is not None


def sqlite_file(folder: Path, stamps: Sequence[int]) -> Path:
    with FolderWriter(folder, version=8, storage_plugin=StoragePlugin.SQLITE3) as bag:
        connection = bag.add_connection("/text", STRING, typestore=get_typestore(Stores.ROS2_JAZZY))
        for stamp in stamps:
            bag.write(connection, stamp, text("a"))
    return next(folder.glob("*.db3"))


def test_first_and_last_time_of_sqlite_are_read(tmp_path: Path) -> None:
    with open_log(sqlite_file(tmp_path / "bag", [0, LAST])) as log:
        assert [entry.stamp for entry in log.messages()] == [0, LAST]
        assert (log.start_ns, log.end_ns, log.left_out, log.damage) == (0, LAST, (), None)


def test_times_of_sqlite_before_the_first_are_told(tmp_path: Path) -> None:
    path = sqlite_file(tmp_path / "bag", [START, START + 1, START + 2])
    with sqlite3.connect(path) as file:
        file.execute(f"UPDATE messages SET timestamp = -7 WHERE timestamp = {START}")
    with open_log(path) as log:
        assert log.left_out == (OUTSIDE,)
        assert [entry.stamp for entry in log.messages()] == [START + 1, START + 2]
        assert (log.start_ns, log.end_ns) == (START + 1, START + 2)
