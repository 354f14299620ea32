"""Recordings: split files, what an interrupted one holds, a full disk, and bags that rosbag2 has compressed."""

from __future__ import annotations

import contextlib
import errno
import gc
import multiprocessing
import os
import re
import resource
import tempfile
import weakref
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal

import pytest
from made_recordings import STEP, STRING, fill, stamps_of, text
from mcap.reader import make_reader
from mcap.writer import Writer as McapWriter
from rosbags.interfaces import QosReliability
from rosbags.rosbag2 import CompressionFormat, CompressionMode, Reader, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from twin_node.bag import BagError, LogWriter, RecordingWriter, SplitParameters, open_log, reader, recording
from twin_node.bag.folder_metadata import FolderFile, write_metadata
from twin_node.bag.latched import standing_before
from twin_node.bag.qos import profile
from twin_node.messages import builtin_types, deserialize


def test_a_folder_is_split_by_time_and_each_file_stands_alone(tmp_path: Path) -> None:
    with RecordingWriter(tmp_path / "run", SplitParameters(max_duration_s=1.0)) as writer:
        fill(writer, 30)
    files = sorted(path.name for path in (tmp_path / "run").iterdir())
    assert files == ["metadata.yaml", "run_0.mcap", "run_1.mcap", "run_2.mcap"]
    assert stamps_of(tmp_path / "run") == [i * STEP for i in range(1, 30)]
    for name in files[1:]:
        with open_log(tmp_path / "run" / name) as log:
            assert [m.message.data for m in log.messages(["/tf_static"])] == ["where things are"]
    with Reader(tmp_path / "run") as bag:
        assert bag.message_count == 29 + 3
        assert sum(1 for _ in bag.messages()) == 29 + 3


@pytest.mark.parametrize("topic", ["/tf_static", "tf_static", "/cell_2/tf_static"])
def test_every_file_has_the_transforms_of_all_their_publishers(tmp_path: Path, topic: str) -> None:
    """Cameras and robot say theirs each by itself; one that says the same again adds nothing."""
    types = builtin_types()
    with RecordingWriter(tmp_path / "run", SplitParameters(max_duration_s=1.0)) as writer:
        for said in ("cameras", "robot", "cameras"):
            writer.write(topic, STRING, text(said), STEP, types, latched=True)
        fill(writer, 15)
    with open_log(tmp_path / "run" / "run_1.mcap") as log:
        said_again = [m.message.data for m in log.messages([topic])]
        standing = [deserialize(data, STRING).data for data in standing_before(log, [topic], log.end_ns)[topic]]
    own = ["where things are"] if topic == "/tf_static" else []
    assert said_again == ["robot", "cameras", *own]
    assert standing == said_again


def test_topics_of_any_name_may_be_latched(tmp_path: Path) -> None:
    """As their publisher on the graph says: a map is said once, and who joins late must be given it."""
    types = builtin_types()
    with RecordingWriter(tmp_path / "run", SplitParameters(max_duration_s=1.0)) as writer:
        writer.write("/map", STRING, text("where walls are"), STEP, types, latched=True)
        fill(writer, 15)
    with open_log(tmp_path / "run") as log:
        assert [topic.name for topic in log.topics if topic.latched] == ["/map", "/tf_static"]
    with open_log(tmp_path / "run" / "run_1.mcap") as log:
        assert [m.message.data for m in log.messages(["/map"])] == ["where walls are"]


@pytest.mark.parametrize("name", ["run.mcap", "run"])
def test_topics_of_one_type_keep_the_definitions_that_each_has_of_it(tmp_path: Path, name: str) -> None:
    """All topics of a type were written with the definition that the first one had of it, and read by that."""
    split = SplitParameters(max_duration_s=1.0) if name == "run" else None
    older, newer = (builtin_types().extended({STRING: text}) for text in ("string data\n", "string data\nint32 size\n"))
    with RecordingWriter(tmp_path / name, split) as writer:
        for stamp in (0, 10 * STEP, 20 * STEP):
            writer.write("/old", STRING, older.serialize(older.message_type(STRING)(data="a")), stamp, older)
            writer.write("/new", STRING, newer.serialize(newer.message_type(STRING)(data="b", size=1)), stamp, newer)
    with open_log(tmp_path / name) as log:
        assert [message.message.size for message in log.messages(["/new"])] == [1, 1, 1]
        assert [message.message.data for message in log.messages(["/old"])] == ["a", "a", "a"]


def test_nothing_of_finished_files_stays_in_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The index of their chunks stayed: a recorder that ran for days in files of a minute grew by the day."""
    alive: list[weakref.ref[McapWriter]] = []

    class Watched(McapWriter):
        def __init__(self, *told: Any, **more: Any) -> None:
            super().__init__(*told, **more)
            alive.append(weakref.ref(self))

    monkeypatch.setattr("twin_node.bag.mcap_stream.Writer", Watched)
    writer = RecordingWriter(tmp_path / "run", SplitParameters(max_duration_s=1.0))
    fill(writer, 30)
    gc.collect()
    assert [one() is not None for one in alive] == [False, False, True]
    assert writer.messages == 29 + 3
    writer.close()


def test_a_folder_is_split_by_size(tmp_path: Path) -> None:
    with RecordingWriter(tmp_path / "run", SplitParameters(max_size_mb=0.01)) as writer:
        fill(writer, 30, size=1000)
    assert len(writer.files) == 3
    assert len(stamps_of(tmp_path / "run")) == 29


def test_a_compressed_recording_is_smaller_and_holds_the_same(tmp_path: Path) -> None:
    for compression in ("none", "zstd", "lz4"):
        with RecordingWriter(tmp_path / f"{compression}.mcap", compression=compression) as writer:
            fill(writer, 300, size=1000)
        assert stamps_of(tmp_path / f"{compression}.mcap") == [i * STEP for i in range(1, 300)]
    sizes = {path.stem: path.stat().st_size for path in tmp_path.iterdir()}
    assert sizes["zstd"] < sizes["none"] / 3 and sizes["lz4"] < sizes["none"] / 3
    with pytest.raises(BagError, match=r"b\.mcap: compression: expected one of none, zstd, lz4, found 'gzip'"):
        RecordingWriter(tmp_path / "b.mcap", compression="gzip")
    assert not (tmp_path / "b.mcap").exists()


def test_latched_messages_beyond_the_size_do_not_begin_a_file_for_every_message(tmp_path: Path) -> None:
    with RecordingWriter(tmp_path / "run", SplitParameters(max_size_mb=0.01)) as writer:
        writer.write("/map", STRING, text("m" * 11_000), 0, builtin_types(), latched=True)
        fill(writer, 30, size=1000)
    assert len(writer.files) == 4
    for file in writer.files:
        with open_log(file) as log:
            assert len(list(log.messages(["/map"]))) == 1


def test_one_file_is_read_by_mcap_s_own_reader(tmp_path: Path) -> None:
    with RecordingWriter(tmp_path / "run.mcap") as writer:
        fill(writer, 10)
        writer.close()  # as whoever wants the file now, and again when all is over
    with (tmp_path / "run.mcap").open("rb") as file:
        reader = make_reader(file)
        assert reader.get_header().profile == "ros2"
        assert sum(1 for _ in reader.iter_messages()) == 10


def record_and_die(path: Path) -> None:
    writer = RecordingWriter(path, SplitParameters(max_duration_s=1.0) if not path.suffix else None)
    fill(writer, 25)
    writer._flushed_at = 0.0  # as if its half second had passed
    writer.flush_if_due()
    os._exit(9)


@pytest.mark.parametrize("name", ["run", "run.mcap"])
def test_what_a_killed_recorder_has_written_is_read(tmp_path: Path, name: str) -> None:
    process = multiprocessing.get_context("spawn").Process(target=record_and_die, args=(tmp_path / name,))
    process.start()
    process.join()
    assert process.exitcode == 9
    assert stamps_of(tmp_path / name) == [i * STEP for i in range(1, 25)]
    with open_log(tmp_path / name) as log:
        assert log.damage is not None
        assert "ends in the middle" in log.damage


@pytest.fixture
def few_files() -> Iterator[int]:
    """A process that may have fewer files open than is usual: so many."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    few = len(list(Path("/dev/fd").iterdir())) + 20
    resource.setrlimit(resource.RLIMIT_NOFILE, (few, hard))
    yield few
    resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


def test_a_recording_of_more_files_than_a_process_may_open_is_read(tmp_path: Path, few_files: int) -> None:
    """As after a night of files of a minute."""
    with RecordingWriter(tmp_path / "run.mcap") as writer:
        fill(writer, 2)
    (tmp_path / "run").mkdir()
    names = [f"run_{number}.mcap" for number in range(few_files)]
    for name in names:
        (tmp_path / "run" / name).hardlink_to(tmp_path / "run.mcap")
    write_metadata(tmp_path / "run", [FolderFile(name, 0, STEP, 2) for name in names], [])
    assert len(stamps_of(tmp_path / "run")) == few_files


def test_what_to_do_is_told_where_no_more_files_may_be_open(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: Path) -> None:
        raise OSError(errno.EMFILE, os.strerror(errno.EMFILE))

    with RecordingWriter(tmp_path / "run.mcap") as writer:
        fill(writer, 2)
    monkeypatch.setattr(reader, "_open_file", refuse)
    with pytest.raises(BagError, match=r"Too many open files\); let a process have as many files open"):
        open_log(tmp_path / "run.mcap")


@pytest.mark.parametrize("plugin", list(StoragePlugin))
@pytest.mark.parametrize("version", [8, 9])
def test_quality_of_service_is_read_as_each_distribution_writes_it(
    tmp_path: Path, plugin: StoragePlugin, version: Literal[8, 9]
) -> None:
    offered = profile(latched=True)._replace(reliability=QosReliability.BEST_EFFORT)
    with Writer(tmp_path / "bag", version=version, storage_plugin=plugin) as bag:
        store = get_typestore(Stores.ROS2_JAZZY)
        bag.write(bag.add_connection("/a", STRING, typestore=store, offered_qos_profiles=[offered]), 1, text("a"))
    with open_log(tmp_path / "bag") as log:
        assert log.profiles("/a") == (offered,)
        assert log.topics[0].latched


class FullDisk:
    """A file on a disk that takes no more than so many bytes."""

    def __init__(self, stream: Any, room: int) -> None:
        self._stream, self._room = stream, room

    def write(self, data: bytes) -> int:
        self._room -= len(data)
        if self._room < 0:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return int(self._stream.write(data))

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def __enter__(self) -> FullDisk:
        return self

    def __exit__(self, *_: object) -> None:
        self._stream.close()


@pytest.mark.parametrize("name", ["run.mcap", "run"])
@pytest.mark.parametrize("is_at_end", [True, False], ids=["at its end", "under way"])
def test_a_recording_that_was_taken_away_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, is_at_end: bool
) -> None:
    """Nothing refuses what is written to a file without a name: an hour of messages was told of, and was nowhere."""
    now = [0.0]
    monkeypatch.setattr(recording.time, "monotonic", lambda: now[0])
    writer = RecordingWriter(tmp_path / name)
    fill(writer, 3)
    (tmp_path / name).rename(tmp_path / "elsewhere")
    with pytest.raises(BagError, match=rf"{name}: is not there any more, somebody has removed or moved it"):
        if not is_at_end:
            now[0] += recording.FLUSH_S
            fill(writer, 3)
        writer.close()
    with contextlib.suppress(BagError):
        writer.close()
    moved = tmp_path / "elsewhere"
    assert len(stamps_of(moved / "run_0.mcap" if moved.is_dir() else moved)) >= 2


def test_finished_files_of_a_recording_may_be_moved_away(tmp_path: Path) -> None:
    with RecordingWriter(tmp_path / "run", SplitParameters(max_duration_s=1.0)) as writer:
        fill(writer, 15)
        writer._disk.settle()
        (tmp_path / "run" / "run_0.mcap").rename(tmp_path / "kept.mcap")
        fill(writer, 15)


def test_a_full_disk_ends_the_recording_and_leaves_the_rest(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, open_file = tmp_path / "run.mcap", Path.open
    monkeypatch.setattr(Path, "open", lambda p, *a, **k: FullDisk(open_file(p, *a, **k), 20_000))
    writer = RecordingWriter(path)
    with pytest.raises(BagError, match=r"cannot be written on \(No space left on device\).*can be read; free space"):
        for i in range(1, 1000):
            writer.write("/a", STRING, text("x" * 500), i * STEP, builtin_types())
            writer._flushed_at = 0.0
    with pytest.raises(BagError, match=r"cannot be written on \(No space left on device\)"):
        writer.add_metadata("note", {"long": "x" * 20_000})
    monkeypatch.undo()
    stamps = stamps_of(path)
    assert len(stamps) > 20
    assert stamps == [i * STEP for i in range(1, len(stamps) + 1)]


@pytest.mark.parametrize("name", ["run.mcap", "run"])
def test_a_disk_that_is_full_from_the_start_leaves_the_name_free(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    """An empty file stayed, and the next try was refused for it; what was recorded was said to be readable."""
    open_file = Path.open
    monkeypatch.setattr(Path, "open", lambda p, *a, **k: FullDisk(open_file(p, *a, **k), 10))
    with pytest.raises(BagError, match=r"on \(No space left on device\), so nothing is recorded; free space"):
        RecordingWriter(tmp_path / name)
    assert not list(tmp_path.iterdir())
    monkeypatch.undo()
    with RecordingWriter(tmp_path / name) as writer:
        fill(writer, 3)


def test_a_next_file_that_cannot_be_begun_ends_the_recording_and_leaves_the_rest(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: Any) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    writer = RecordingWriter(tmp_path / "run", SplitParameters(max_duration_s=1.0))
    fill(writer, 9)
    monkeypatch.setattr(RecordingWriter, "_begin_file", refuse)
    with pytest.raises(BagError, match=r"cannot be written on \(No space left on device\)"):
        writer.write("/a", STRING, text("one too many"), 20 * STEP, builtin_types())
    monkeypatch.undo()
    monkeypatch.setattr(Path, "write_text", lambda path, *_, **__: path.touch() or refuse())
    with pytest.raises(BagError, match=r"cannot be written on \(No space left on device\)"):
        writer.close()
    assert sorted(path.name for path in (tmp_path / "run").iterdir()) == ["metadata.yaml", "run_0.mcap"]
    assert stamps_of(tmp_path / "run") == [i * STEP for i in range(1, 9)]
    with open_log(tmp_path / "run") as log:
        assert log.damage is None


@pytest.mark.filterwarnings("error::pytest.PytestUnraisableExceptionWarning")
def test_a_recording_that_cannot_go_on_in_another_leaves_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where a clock was put back and the disk was full: the other one stayed, open and without an end."""
    writer = RecordingWriter(tmp_path / "run.mcap")
    writer.write("/map", STRING, text("a map"), 2 * STEP, builtin_types(), latched=True)

    def refuse(*_: Any) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(RecordingWriter, "_repeat_latched", refuse)
    with pytest.raises(BagError, match="No space left on device"):
        writer.followed_by(tmp_path / "run_r1.mcap", STEP)
    gc.collect()  # what is open still is told of then
    assert list(tmp_path.iterdir()) == [tmp_path / "run.mcap"]
    assert stamps_of(tmp_path / "run.mcap", "/map") == [2 * STEP]


def test_wrong_places_are_refused(tmp_path: Path) -> None:
    (tmp_path / "there").mkdir()
    (tmp_path / "there" / "file").touch()
    for name, split, words in (
        ("there", None, "exists already"),
        ("run.bag", None, "expected a name ending in .mcap"),
        ("run.mcap", SplitParameters(max_size_mb=1), "one file cannot be split"),
        ("no/such/run.mcap", None, "no/such does not exist; create it first"),
        ("there/file/run", None, "cannot be written"),
        (300 * "n", None, r"cannot be written on \(File name too long\)"),
    ):
        with pytest.raises(BagError, match=words):
            RecordingWriter(tmp_path / name, split)
    for name in (300 * "n", f"{300 * 'n'}/run.mcap"):
        with pytest.raises(BagError, match=r"cannot be written \(File name too long\)"):
            LogWriter(tmp_path / name)
    with pytest.raises(BagError, match="split: max_size_mb: expected a number of 0 or more, found -1"):
        SplitParameters(max_size_mb=-1)


def packed_bag(folder: Path, mode: str, plugin: StoragePlugin = StoragePlugin.MCAP) -> Path:
    """Four messages in a bag that rosbag2 has compressed."""
    packed = Writer(folder, version=8, storage_plugin=plugin)
    packed.set_compression(CompressionMode[mode], CompressionFormat.ZSTD)
    with packed as bag:
        connection = bag.add_connection("/a", STRING, msgdef="string data", rihs01=builtin_types().type_hash(STRING))
        for i in range(1, 5):
            bag.write(connection, i, text(f"message {i}"))
    return folder


@pytest.mark.parametrize("plugin", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
@pytest.mark.parametrize("mode", ["FILE", "MESSAGE"])
def test_bags_that_rosbag2_compressed_are_read(tmp_path: Path, plugin: StoragePlugin, mode: str) -> None:
    with open_log(packed_bag(tmp_path / "packed", mode, plugin)) as log:
        assert [m.message.data for m in log.messages()] == [f"message {i}" for i in range(1, 5)]


def test_a_packed_message_that_claims_all_memory_is_damage(tmp_path: Path) -> None:
    """A flipped bit in its head does."""
    bag = packed_bag(tmp_path / "packed", "MESSAGE")
    claim = b"\x28\xb5\x2f\xfd\xe0" + (1 << 50).to_bytes(8, "little") + b"\1\0\0"
    with LogWriter(tmp_path / "claims.mcap") as log:
        log.write_raw("/a", STRING, claim, 1)
    (tmp_path / "claims.mcap").replace(next(bag.glob("*.mcap")))
    with open_log(bag) as log:
        assert list(log.messages()) == []
        assert log.damage is not None and "larger than all memory" in log.damage


def test_a_full_disk_for_what_is_unpacked_is_told_by_its_place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The bag itself can be read."""

    def open_file(path: Path, *arguments: Any, **options: Any) -> Any:
        stream = whole(path, *arguments, **options)
        return FullDisk(stream, 100) if "wb" in arguments else stream

    bag, whole = packed_bag(tmp_path / "packed", "FILE"), Path.open
    monkeypatch.setattr(Path, "open", open_file)
    where = re.escape(tempfile.gettempdir())
    with pytest.raises(BagError, match=rf"decompressed into {where} \(No space left on device\); free space there, or"):
        open_log(bag)
