"""A log takes its name only when it is whole; wrong calls are one clear line."""

import errno
import io
import os
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader
from mcap.writer import Writer

from twin_node.bag import BagError, LogWriter, RecordingWriter, open_log
from twin_node.messages import (
    Message,
    MessageError,
    builtin_types,
    definition,
    message_type,
    serialize,
    type_hash,
)

STRING = "std_msgs/msg/String"


def text(data: str) -> Message:
    return message_type(STRING)(data=data)


@pytest.mark.parametrize("name", ["log.mcap", "folder"])
def test_nothing_is_left_after_an_exception(tmp_path: Path, name: str) -> None:
    with pytest.raises(RuntimeError, match="mid-way"), LogWriter(tmp_path / name) as log:
        log.write("/a", text("a"), 0)
        raise RuntimeError("mid-way")
    assert list(tmp_path.iterdir()) == []


def test_what_stood_there_stays_until_the_log_is_whole(tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    with LogWriter(path) as log:
        log.write("/a", text("precious"), 0)
    precious = path.read_bytes()
    with pytest.raises(RuntimeError), LogWriter(path) as log:
        log.write("/a", text("a"), 0)
        raise RuntimeError
    assert path.read_bytes() == precious
    with LogWriter(path) as log:
        log.write("/a", text("a"), 0)
        assert path.read_bytes() == precious
    with open_log(path) as reader:
        assert [m.message.data for m in reader.messages()] == ["a"]
    assert list(tmp_path.iterdir()) == [path]


def test_an_unfinished_file_opens_up_to_the_last_flush(tmp_path: Path) -> None:
    log = LogWriter(tmp_path / "log.mcap")
    log.write("/a", text("flushed"), 0)
    log.flush()
    log.write("/a", text("lost"), 1)
    with open_log(tmp_path / "log.mcap.partial") as reader:
        assert [m.message.data for m in reader.messages()] == ["flushed"]
        assert reader.damage is not None
        assert "ends in the middle" in reader.damage
    log.abort()
    log.close()
    assert list(tmp_path.iterdir()) == []


def test_a_left_over_partial_folder_is_replaced(tmp_path: Path) -> None:
    (tmp_path / "bag.partial" / "bag").mkdir(parents=True)
    with LogWriter(tmp_path / "bag") as log:
        log.write("/a", text("a"), 0)
    assert [path.name for path in tmp_path.iterdir()] == ["bag"]


@pytest.mark.parametrize("is_folder", [False, True])
@pytest.mark.parametrize("name", ["log.mcap", "bag"])
def test_a_partial_log_that_is_there_stays(tmp_path: Path, name: str, is_folder: bool) -> None:
    """It is another writer's, or all that is left of one that was killed."""
    left = tmp_path / f"{name}.partial"
    kept = left / name / "bag.mcap" if is_folder else left
    kept.parent.mkdir(parents=True, exist_ok=True)
    kept.write_bytes(b"precious")
    with pytest.raises(BagError, match=rf"{name}\.partial: exists already, .*; move it elsewhere, remove it or choose"):
        LogWriter(tmp_path / name)
    assert kept.read_bytes() == b"precious"
    assert list(tmp_path.iterdir()) == [left]


@pytest.mark.parametrize("name", ["log.mcap", "bag"])
def test_two_writers_of_one_log_are_not_mixed(tmp_path: Path, name: str) -> None:
    with LogWriter(tmp_path / name) as log:
        log.write("/a", text("a"), 0)
        with pytest.raises(BagError, match="or is being written"):
            LogWriter(tmp_path / name)
        log.write("/a", text("b"), 1)
    with open_log(tmp_path / name) as reader:
        assert [m.message.data for m in reader.messages()] == ["a", "b"]
    assert [path.name for path in tmp_path.iterdir()] == [name]


def test_a_folder_that_cannot_be_begun_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(Path, "open", full)
    with pytest.raises(BagError, match="No space left on device"):
        LogWriter(tmp_path / "bag")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("missing/log.mcap", "folder .*missing does not exist"),
        ("log.db3", "expected a name ending in .mcap"),
        ("taken", "exists already"),
        ("taken.mcap", "is a folder"),
    ],
)
def test_wrong_targets_are_refused(tmp_path: Path, name: str, words: str) -> None:
    (tmp_path / "taken").mkdir()
    (tmp_path / "taken.mcap").mkdir()
    with pytest.raises(BagError, match=words):
        LogWriter(tmp_path / name)
    assert len(list(tmp_path.iterdir())) == 2


def test_a_topic_has_one_type(tmp_path: Path) -> None:
    clock = message_type("builtin_interfaces/msg/Time")(sec=0, nanosec=0)
    with pytest.raises(BagError, match="topic /a holds std_msgs/msg/String"), LogWriter(tmp_path / "log.mcap") as log:
        log.write("/a", text("a"), 0)
        log.write("/a", clock, 1)


def test_unknown_types_and_negative_stamps_are_refused(tmp_path: Path) -> None:
    with LogWriter(tmp_path / "log.mcap") as log:
        with pytest.raises(MessageError, match="mine/msg/Thing"):
            log.write_raw("/a", "mine/msg/Thing", b"", 0)
        with pytest.raises(BagError, match="-1 ns"):
            log.write("/b", text("a"), -1)


class FullDisk:
    """A file that takes no more than some bytes."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def write(self, data: bytes) -> int:
        raise OSError(28, "No space left on device")


def test_a_full_disk_is_one_clear_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(BagError, match="No space left on device"), LogWriter(tmp_path / "log.mcap") as log:
        monkeypatch.setattr("mcap.writer.Writer.add_message", lambda *_: FullDisk(tmp_path).write(b""))
        log.write("/a", text("a"), 0)
    assert list(tmp_path.iterdir()) == []


class FullFile(io.FileIO):
    """A file on a disk that takes nothing any more; what is written through a buffer is refused when that is full."""

    def write(self, data: Any) -> int:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


@pytest.mark.parametrize("last_words", ["topic", "metadata", "message", "nothing"])
def test_a_full_disk_is_one_error_and_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, last_words: str
) -> None:
    """What waits in the file's buffer cannot be written when the file is given up, either."""
    monkeypatch.setattr(Path, "open", lambda path, *_: io.BufferedWriter(FullFile(path, "wb"), 1 << 14))
    long = "x" * (1 << 15)
    refused = pytest.raises(BagError, match=r"log.mcap: cannot be written \(No space left on device\)")
    with refused, LogWriter(tmp_path / "log.mcap") as log:
        log.write("/a", text("short"), 1)
        if last_words == "topic":
            log.add_topic("/b", "my_msgs/msg/B", definition=f"# {long}\nstring data\n")
        elif last_words == "metadata":
            log.add_metadata("long", {"a": long})
        elif last_words == "message":
            log.write("/a", text(32 * long), 2)
            log.write("/a", text(32 * long), 3)
    assert list(tmp_path.iterdir()) == []


def test_the_hash_of_a_topic_is_that_of_the_definition_it_is_given(tmp_path: Path) -> None:
    """Of a repaired older log; ROS would take the messages for ones of today's type."""
    path, older = tmp_path / "log.mcap", "std_msgs/Header header\nstring note\n"
    with LogWriter(path) as log:
        log.add_topic("/twin/status", "twin_msgs/msg/TwinStatus", definition=older)
        log.add_topic("/text", STRING, definition=definition(STRING))
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    hashes = {channel.topic: channel.metadata["topic_type_hash"] for channel in summary.channels.values()}
    assert hashes["/text"] == type_hash(STRING)
    assert hashes["/twin/status"] != type_hash("twin_msgs/msg/TwinStatus")


def test_a_log_that_can_be_made_again_is_replaced(tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    path.touch()  # as who reserves a name leaves it
    for word in ("a", "b"):
        with LogWriter(path) as log:
            log.write("/a", text(word), 0)
    with open_log(path) as reader:
        assert [m.message.data for m in reader.messages()] == ["b"]


@pytest.mark.parametrize("kind", ["recording", "recorded", "of others", "text"])
def test_what_cannot_be_made_again_is_not_replaced(tmp_path: Path, kind: str) -> None:
    path = tmp_path / "log.mcap"
    if kind == "text":
        path.write_text("my notes")
    elif kind == "of others":
        with path.open("wb") as file:
            others = Writer(file)
            others.start("ros2", "libmcap 1.4.0")
            others.finish()
    elif kind == "recording":
        with RecordingWriter(path) as recording:
            recording.write("/a", STRING, serialize(text("a")), 0, builtin_types())
    else:
        with LogWriter(path, recorded=True) as log:
            log.write("/a", text("a"), 0)
    before = path.read_bytes()
    with pytest.raises(BagError, match=r"log\.mcap: expected a new name.*choose another name"):
        LogWriter(path)
    assert (path.read_bytes(), [one.name for one in tmp_path.iterdir()]) == (before, ["log.mcap"])


@pytest.mark.parametrize("name", ["log.mcap", "log"])
def test_a_recording_that_was_begun_meanwhile_is_not_replaced(tmp_path: Path, name: str) -> None:
    """What was written, and could be again, took the place of what had happened once."""
    log = LogWriter(tmp_path / name)
    log.write("/a", text("made again"), 0)
    with RecordingWriter(tmp_path / name) as recording:
        recording.write("/a", STRING, serialize(text("happened once")), 0, builtin_types())
    with pytest.raises(BagError, match=rf"{name}: .*choose another"):
        log.close()
    with open_log(tmp_path / name) as reader:
        assert [m.message.data for m in reader.messages()] == ["happened once"]
    assert [one.name for one in tmp_path.iterdir()] == [name]


def test_messages_of_one_topic_are_asked_for_by_its_name(tmp_path: Path) -> None:
    with LogWriter(tmp_path / "log.mcap") as log:
        log.write("/a", text("a"), 0)
        log.write("/b", text("b"), 1)
    with open_log(tmp_path / "log.mcap") as reader:
        assert [m.topic for m in reader.messages("/b")] == ["/b"]
        assert [m.topic for m in reader.messages("/b/long")] == []


def test_a_message_after_the_end_is_refused(tmp_path: Path) -> None:
    with LogWriter(tmp_path / "log.mcap") as log:
        log.write("/a", text("a"), 0)
    with pytest.raises(BagError, match=r"log\.mcap: closed already, found another message on /a"):
        log.write("/a", text("lost"), 1)
