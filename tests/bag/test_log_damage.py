"""Damaged, truncated and foreign files: read up to the damage and said so, or refused in one line; never silent."""

from collections.abc import Sequence
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from rosbags.rosbag2 import ReaderError, StoragePlugin
from rosbags.rosbag2 import Writer as FolderWriter
from rosbags.typesys import Stores, get_typestore

from twin_node.bag import BagError, LogWriter, mcap_storage, open_log
from twin_node.bag.mcap_records import opened
from twin_node.messages import message_type, serialize

COUNT = 400
STRING = "std_msgs/msg/String"
NONE = "not the metadata of a rosbag2 folder"


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("whole") / "log.mcap"
    with LogWriter(path) as log:
        for i in range(COUNT):
            log.write("/a" if i % 3 else "/b", message_type("std_msgs/msg/String")(data="x" * 500 + str(i)), i)
            if i % 20 == 19:
                log.flush()
    return path


def read(path: Path) -> tuple[list[int], str | None]:
    with open_log(path) as log:
        stamps = [m.stamp for m in log.messages() if m.message.data]
        assert [m.stamp for m in log.messages()] == stamps
        return stamps, log.damage


@pytest.mark.parametrize("share", [0.25, 0.5, 0.75, 0.95])
def test_a_truncated_file_is_read_up_to_its_end(tmp_path: Path, whole: Path, share: float) -> None:
    path = tmp_path / "cut.mcap"
    content = whole.read_bytes()
    path.write_bytes(content[: int(len(content) * share)])
    stamps, damage = read(path)
    assert stamps == list(range(len(stamps)))
    assert COUNT * (share - 0.15) < len(stamps) < COUNT
    assert damage is not None
    assert "cut.mcap: damaged at byte" in damage
    with open_log(path) as log:
        assert sum(topic.count for topic in log.topics) == len(stamps)
        assert (log.start_ns, log.end_ns) == (0, stamps[-1])


def test_a_file_without_its_end_loses_nothing(tmp_path: Path, whole: Path) -> None:
    path = tmp_path / "cut.mcap"
    path.write_bytes(whole.read_bytes()[:-20])
    assert read(path) == (list(range(COUNT)), None)


def test_a_log_without_its_end_is_known_without_being_read_whole(
    tmp_path: Path, whole: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A recording of gigabytes took minutes to open: each chunk is opened only where no records behind it tell."""
    path = tmp_path / "cut.mcap"
    path.write_bytes(whole.read_bytes()[:-20])
    opens: list[int] = []
    monkeypatch.setattr(mcap_storage, "opened", lambda record, size: opens.append(size) or opened(record, size))
    told, by_indexes = [], mcap_storage.McapStorage._stamps
    for stamps in (by_indexes, lambda *_: None):
        monkeypatch.setattr(mcap_storage.McapStorage, "_stamps", stamps)
        storage = mcap_storage.McapStorage(path)
        told.append((len(opens), storage.channels, [(p.start, p.end, p.offset, p.topics) for p in storage.parts]))
        storage.close()
    assert (told[0][0], told[1][0]) == (1, 1 + COUNT // 20)
    assert told[0][1:] == told[1][1:]


def test_a_damaged_index_loses_nothing(tmp_path: Path, whole: Path) -> None:
    broken = bytearray(whole.read_bytes())
    broken[broken.rindex(b"/b")] ^= 0xFF
    path = tmp_path / "broken.mcap"
    path.write_bytes(broken)
    assert read(path) == (list(range(COUNT)), None)
    with open_log(path) as log:
        assert [topic.name for topic in log.topics] == ["/a", "/b"]


def test_a_damaged_chunk_ends_reading_there(tmp_path: Path, whole: Path) -> None:
    broken = bytearray(whole.read_bytes())
    broken[broken.index(b"x" * 500 + b"200") + 10] ^= 0xFF
    path = tmp_path / "broken.mcap"
    path.write_bytes(broken)
    stamps, damage = read(path)
    assert stamps == list(range(200))
    assert damage is not None
    assert "crc" in damage


def write_with_zeros(path: Path, whole: Path, content: bytes, kept: int) -> int:
    """Writes `content`, of the log `whole`, with zeros after `kept` bytes of its sixth chunk; where that begins."""
    with whole.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    chunk = sorted(summary.chunk_indexes, key=lambda index: index.chunk_start_offset)[5]
    start, end = chunk.chunk_start_offset, chunk.chunk_start_offset + chunk.chunk_length
    path.write_bytes(content[: start + kept] + bytes(end - start - kept) + content[end:])
    return start


@pytest.mark.parametrize("kept", [0, 9, 25, 37])
def test_a_chunk_of_zeros_is_damage(tmp_path: Path, whole: Path, kept: int) -> None:
    """As disks leave blocks that never reached them: without size, checksum and messages it looks like an empty one.

    `kept`: bytes at its beginning; the record's head is 9 long, with the times 25, with the checksum 37.
    """
    path = tmp_path / "zeros.mcap"
    start = write_with_zeros(path, whole, whole.read_bytes(), kept)
    stamps, damage = read(path)
    assert stamps == list(range(100))
    assert damage is not None and f"zeros.mcap: damaged at byte {start}" in damage


@pytest.mark.parametrize("kept", [9, 25, 37])
def test_a_chunk_of_zeros_in_a_log_without_its_end_is_damage_and_the_rest_is_there(
    tmp_path: Path, whole: Path, kept: int
) -> None:
    path = tmp_path / "zeros.mcap"
    start = write_with_zeros(path, whole, whole.read_bytes()[:-20], kept)
    stamps, damage = read(path)
    assert stamps == list(range(100))
    assert damage is not None and f"zeros.mcap: damaged at byte {start}" in damage
    with open_log(path) as log:
        assert [m.stamp for m in log.messages(past_damage=True)] == [*range(100), *range(120, COUNT)]


def test_zeros_in_a_chunk_without_a_checksum_are_damage(tmp_path: Path) -> None:
    """As rosbag2's preset fastwrite writes chunks: nothing else tells that half of one never reached the disk."""
    path = tmp_path / "zeros.mcap"
    with path.open("wb") as file:
        writer = Writer(file, compression=CompressionType.NONE, enable_crcs=False)
        writer.start("ros2", "fast")
        channel = writer.register_channel("/a", "cdr", writer.register_schema(STRING, "ros2msg", b"string data"))
        for i in range(40):
            writer.add_message(channel, i, bytes(serialize(message_type(STRING)(data=f"{i:0500}"))), i)
            if i % 20 == 19:
                writer.flush()
        writer.finish()
    content = path.read_bytes()
    assert read(path) == (list(range(40)), None)
    at = content.index(f"{30:0500}".encode()) - 35
    path.write_bytes(content[:at] + bytes(4096) + content[at + 4096 :])
    stamps, damage = read(path)
    assert stamps == list(range(20))
    assert damage is not None and "found zeros" in damage


def test_a_chunk_that_claims_more_than_any_holds_takes_no_memory(tmp_path: Path, whole: Path) -> None:
    content = bytearray(whole.read_bytes()[:-20])
    with whole.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    start = summary.chunk_indexes[5].chunk_start_offset
    content[start + 9 + 16 : start + 9 + 24] = (1 << 40).to_bytes(8, "little")
    (tmp_path / "claims.mcap").write_bytes(content)
    stamps, damage = read(tmp_path / "claims.mcap")
    assert stamps == list(range(100))
    assert damage is not None and "says that it holds 1099511627776 bytes" in damage


def test_zeros_behind_the_last_record_are_damage(tmp_path: Path, whole: Path) -> None:
    """As a power cut leaves them: the file has its length, and its blocks never reached the disk."""
    content = whole.read_bytes()
    with whole.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    end = max(index.chunk_start_offset + index.chunk_length for index in summary.chunk_indexes)
    path = tmp_path / "zeros.mcap"
    path.write_bytes(content[:end] + bytes(4096))
    stamps, damage = read(path)
    assert stamps == list(range(COUNT))
    assert damage is not None and f"damaged at byte {end} of {end + 4096} (found zeros" in damage


def unfinished(path: Path, texts: Sequence[Sequence[str]]) -> bytearray:
    """A log as a killed recorder leaves it: chunks of messages, each of which is on a topic of its own name."""
    stamp = 0
    with LogWriter(path) as log:
        for chunk in texts:
            for text in chunk:
                stamp += 1
                log.write(f"/{text}", message_type("std_msgs/msg/String")(data=f"text {stamp}"), stamp)
            log.flush()
        partial = path.with_name(f"{path.name}.partial")
        return bytearray(partial.read_bytes())


def test_a_damaged_chunk_of_a_log_without_its_end_is_passed_over_by_who_goes_on(tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    content = unfinished(path, [["a", "b"], ["a", "b"], ["a", "b"]])
    content[content.index(b"text 3")] ^= 0xFF
    path.write_bytes(content)
    stamps, damage = read(path)
    assert stamps == [1, 2]
    assert damage is not None and "crc" in damage and "ends in the middle" in damage
    with open_log(path) as log:
        assert [m.stamp for m in log.messages(past_damage=True)] == [1, 2, 5, 6]


def test_messages_of_a_topic_that_only_a_damaged_chunk_names_are_missed_aloud(tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    content = unfinished(path, [["a"], ["a", "b"], ["a", "b"], ["a", "b"]])
    content[content.index(b"text 2")] ^= 0xFF
    path.write_bytes(content)
    with open_log(path) as log:
        assert [m.stamp for m in log.messages(past_damage=True)] == [1, 4, 6]
        assert [(topic.name, topic.count) for topic in log.topics] == [("/a", 3)]
        assert log.damage is not None and "2 messages of topics that nothing undamaged names" in log.damage


def test_a_log_whose_topics_only_a_damaged_chunk_names_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    content = unfinished(path, [["a"], ["a"]])
    content[content.index(b"text 1")] ^= 0xFF
    path.write_bytes(content)
    with pytest.raises(BagError, match=r"damaged at byte \d+ \(crc .*; no message could be read, record it again"):
        open_log(path)


def test_parts_without_the_wanted_topics_are_passed_over(tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    with LogWriter(path) as log:
        for i, topic in enumerate(["/a", "/b", "/a"]):
            log.write(topic, message_type("std_msgs/msg/String")(data=f"text {i}"), i)
            log.flush()
    broken = bytearray(path.read_bytes())
    broken[broken.index(b"text 1")] ^= 0xFF
    path.write_bytes(broken)
    with open_log(path) as reader:
        assert [m.stamp for m in reader.messages(["/a"])] == [0, 2]
        assert reader.damage is None
        assert [m.stamp for m in reader.messages()] == [0]
        assert reader.damage is not None


def test_parts_of_a_log_without_its_end_are_passed_over_too(tmp_path: Path) -> None:
    """Of hours that a killed recorder left, a topic that is said once is found without reading them all."""
    path = tmp_path / "log.mcap"
    with LogWriter(path) as log:
        for i, topic in enumerate(["/a", "/b", "/a"]):
            log.write(topic, message_type("std_msgs/msg/String")(data=f"text {i}" + 200_000 * "x"), i)
            log.flush()
    path.write_bytes(path.read_bytes()[:-20])
    with open_log(path) as reader:
        with path.open("r+b") as file:  # once the log is open: the pass over it would have met the damage
            file.seek(path.read_bytes().index(b"text 1"))
            file.write(b"x")
        assert [m.stamp for m in reader.messages(["/a"])] == [0, 2]
        assert [m.stamp for m in reader.messages()] == [0]


@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_random_damage_is_never_silent(tmp_path: Path, whole: Path, data: st.DataObject) -> None:
    content = whole.read_bytes()
    broken = bytearray(content[: data.draw(st.integers(0, len(content)))])
    for position in data.draw(st.lists(st.integers(0, max(0, len(broken) - 1)), max_size=3)):
        if broken:
            broken[position] = data.draw(st.integers(0, 255))
    path = tmp_path / "broken.mcap"
    path.write_bytes(broken)
    try:
        stamps, damage = read(path)
    except BagError as error:
        assert "\n" not in str(error)
    else:
        assert damage is not None or stamps == list(range(COUNT))
        assert damage is None or "\n" not in damage


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "found an empty file"),
        (b"just text, no log", "found a file that begins with b'just tex'"),
        (b"\x89MCAP0\r\n", "no message could be read"),
        (b"SQLite format 3\x00 and nothing else", "not a readable rosbag2 SQLite file"),
        (b"#ROSBAG V2.0\n", "found a bag of ROS 1; convert it: rosbags-convert --src"),
        (b'\x40\0\0\0\0\0\0\0{"means":{}}', "found a model; make a log of it: twin_node import model"),
    ],
)
def test_what_is_no_log_is_refused(tmp_path: Path, content: bytes, words: str) -> None:
    path = tmp_path / "file.mcap"
    path.write_bytes(content)
    with pytest.raises(BagError, match=words) as caught:
        open_log(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_missing_paths_and_folders_without_a_bag_are_refused(tmp_path: Path) -> None:
    with pytest.raises(BagError, match="No such file"):
        open_log(tmp_path / "missing.mcap")
    with pytest.raises(BagError, match=r"no metadata\.yaml in this folder"):
        open_log(tmp_path)


@pytest.mark.parametrize(
    ("metadata", "words"),
    [
        ("{", "not the metadata of a rosbag2 folder"),
        ("begun: 2020-13-45", NONE),
        ("something: else", r"not the metadata .* \(it has no field 'rosbag2_bagfile_information'\); copy it again"),
        ("5", r"not the metadata of a rosbag2 folder \(a field holds something else\); copy it again"),
        ("[" * 5000, r"not the metadata of a rosbag2 folder \(too many levels, one within the other\); copy it again"),
        *(
            (f"rosbag2_bagfile_information: {{relative_file_paths: {files}, topics_with_message_count: {rest}}}", NONE)
            for files, rest in (
                ("", "[]"),
                ("[5]", "[]"),
                ("[a]", ""),
                ("[a]", "[{topic_metadata: }]"),
                ("[a]", "[{}]"),
                ("[a]", "[], custom_data: [a]"),
            )
        ),
        ("rosbag2_bagfile_information: {relative_file_paths: [], topics_with_message_count: []}", "none at all"),
        (
            "rosbag2_bagfile_information: {relative_file_paths: [gone.mcap], topics_with_message_count: []}",
            r"not there: gone\.mcap",
        ),
        (
            "rosbag2_bagfile_information: "
            "{relative_file_paths: [a], topics_with_message_count: [], compression_mode: FILE}",
            "compressed with ''; expected zstd",
        ),
    ],
)
def test_folders_with_wrong_metadata_are_refused(tmp_path: Path, metadata: str, words: str) -> None:
    (tmp_path / "metadata.yaml").write_text(metadata)
    with pytest.raises(BagError, match=words) as caught:
        open_log(tmp_path)
    assert "\n" not in str(caught.value)


def test_logs_without_messages_or_without_cdr_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    with LogWriter(path):
        pass
    with pytest.raises(BagError, match="holds no messages"):
        open_log(path)
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        channel = writer.register_channel("/a", "json", writer.register_schema("a", "jsonschema", b"{}"))
        writer.add_message(channel, 0, b"{}", 0)
        writer.finish()
    with pytest.raises(BagError, match="expected messages in cdr, found json"):
        open_log(path)


def test_a_damaged_sqlite_file_is_read_up_to_the_damage(tmp_path: Path) -> None:
    with FolderWriter(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.SQLITE3) as bag:
        connection = bag.add_connection("/a", "std_msgs/msg/String", typestore=get_typestore(Stores.ROS2_JAZZY))
        for i in range(COUNT):
            bag.write(connection, i, serialize(message_type("std_msgs/msg/String")(data="x" * 10_000 + str(i))))
    file = tmp_path / "bag" / "bag.db3"
    content = bytearray(file.read_bytes())
    page = (content.index(b"x" * 4000, len(content) // 2) // 4096) * 4096
    content[page : page + 4] = b"\xff\xff\xff\xff"  # link to the next page of a large value (SQLite file format 1.6)
    file.write_bytes(content)
    stamps, damage = read(tmp_path / "bag")
    assert stamps == list(range(len(stamps)))
    assert COUNT // 4 < len(stamps) < COUNT
    assert damage is not None
    assert "bag.db3: damaged after the message at" in damage


def test_what_sqlite_says_in_two_lines_is_told_in_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise ReaderError("malformed database schema ( NOT NULL\n)")

    monkeypatch.setattr("twin_node.bag.sqlite_storage.Reader", refuse)
    path = tmp_path / "log.db3"
    path.write_bytes(b"SQLite format 3\x00")
    with pytest.raises(BagError, match=r"\( NOT NULL \)\); record it again"):
        open_log(path)


def test_a_truncated_sqlite_file_is_refused(tmp_path: Path) -> None:
    with FolderWriter(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.SQLITE3) as bag:
        connection = bag.add_connection("/a", "std_msgs/msg/String", typestore=get_typestore(Stores.ROS2_JAZZY))
        bag.write(connection, 0, serialize(message_type("std_msgs/msg/String")(data="x" * 100_000)))
    file = tmp_path / "bag" / "bag.db3"
    file.write_bytes(file.read_bytes()[:6000])
    with pytest.raises(BagError, match="not a readable rosbag2 SQLite file"):
        open_log(tmp_path / "bag")
