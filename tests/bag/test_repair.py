"""What a repair makes of recordings that were interrupted, or of which a part is lost."""

from __future__ import annotations

import multiprocessing
import os
from pathlib import Path

import pytest
from made_recordings import STEP, STRING, fill, stamps_of, text
from rosbags.interfaces import QosReliability
from rosbags.rosbag2 import Reader
from zstandard import ZstdCompressor

from twin_node.bag import BagError, LogWriter, RecordingWriter, SplitParameters, open_log, recording
from twin_node.bag.qos import profile
from twin_node.bag.repair import repair
from twin_node.messages import message_type


def record_in_parts(path: Path) -> None:
    """30 messages in several files."""
    with RecordingWriter(path, SplitParameters(max_duration_s=1.0)) as writer:
        fill(writer, 30)


def split_and_die(path: Path) -> None:
    recording.FLUSH_S = 3600.0  # on a busy machine those 12 messages take longer than the usual
    fill(RecordingWriter(path, SplitParameters(max_duration_s=1.0)), 12)
    os._exit(9)


def test_a_recorder_that_is_killed_before_its_new_file_has_a_message_leaves_all_others(tmp_path: Path) -> None:
    """What waits for its chunk is lost, not the files before."""
    process = multiprocessing.get_context("spawn").Process(target=split_and_die, args=(tmp_path / "run",))
    process.start()
    process.join()
    assert process.exitcode == 9
    assert stamps_of(tmp_path / "run") == [i * STEP for i in range(1, 10)]
    with open_log(tmp_path / "run") as log:
        assert log.damage is not None
        assert "run_1.mcap: damaged at byte" in log.damage
    (tmp_path / "run" / "run_1.mcap").write_bytes(b"")  # as rosbag2 leaves it
    with open_log(tmp_path / "run") as log:
        assert log.damage is not None
        assert "run_1.mcap: expected an MCAP or rosbag2 SQLite log, found an empty file" in log.damage
    assert repair(tmp_path / "run", tmp_path / "whole.mcap").messages == 10
    (tmp_path / "run" / "run_0.mcap").write_bytes(b"")
    with pytest.raises(BagError, match=r"run_0.mcap: .* found an empty file"):
        open_log(tmp_path / "run")


def test_a_bag_whose_recorder_never_wrote_its_metadata_is_repaired_by_its_numbered_files(tmp_path: Path) -> None:
    """As rosbag2 leaves it after `kill -9`."""
    record_in_parts(tmp_path / "run")
    (tmp_path / "run" / "metadata.yaml").unlink()
    with pytest.raises(BagError, match=r"no metadata.yaml in this folder, its recording was not finished; write it"):
        open_log(tmp_path / "run")
    repair(tmp_path / "run", tmp_path / "whole")
    assert stamps_of(tmp_path / "whole") == [i * STEP for i in range(1, 30)]
    (tmp_path / "run" / "run_1.mcap").rename(tmp_path / "run" / "other.mcap")
    with pytest.raises(BagError, match=r"no metadata.yaml in this folder; give one of its files \(other.mcap\)"):
        open_log(tmp_path / "run")


def test_files_that_a_recorder_had_compressed_before_it_was_killed_are_repaired_too(tmp_path: Path) -> None:
    """rosbag2 compresses one when it begins the next: those were passed over, and the last one was offered alone."""
    record_in_parts(tmp_path / "run")
    (tmp_path / "run" / "metadata.yaml").unlink()
    whole = {number: tmp_path / "run" / f"run_{number}.mcap" for number in range(2)}
    for path in whole.values():
        path.with_name(f"{path.name}.zstd").write_bytes(ZstdCompressor().compress(path.read_bytes()))
    first = stamps_of(whole[0])
    whole[0].unlink()
    packed = whole[1].with_name("run_1.mcap.zstd")  # of this one it was not done
    packed.write_bytes(packed.read_bytes()[:20])
    assert repair(tmp_path / "run", tmp_path / "whole").damage is None
    assert stamps_of(tmp_path / "whole") == [i * STEP for i in range(1, 30)]
    assert stamps_of(tmp_path / "run" / "run_0.mcap.zstd") == first


@pytest.mark.parametrize("share", [0.0, 0.2, 0.9])
def test_a_compressed_file_that_is_cut_short_is_told_by_its_own_name(tmp_path: Path, share: float) -> None:
    """It was told by that of a copy which is gone again."""
    path = tmp_path / "log.mcap.zstd"
    with LogWriter(tmp_path / "log.mcap") as log:
        for number in range(500):
            log.write("/text", message_type(STRING)(data=os.urandom(4000).hex()), number * STEP)
    packed = ZstdCompressor().compress((tmp_path / "log.mcap").read_bytes())
    path.write_bytes(packed[: max(20, round(share * len(packed)))])
    try:
        with open_log(path) as log_read:
            said = log_read.damage
    except BagError as error:
        said = str(error)
    assert said is not None and said.startswith(f"{path}: ") and "twin_node_" not in said


@pytest.mark.parametrize("metadata", [b"", b"rosbag2_bagfile_information: {", b"\0" * 500])
def test_a_bag_whose_metadata_a_power_cut_has_taken_is_repaired(tmp_path: Path, metadata: bytes) -> None:
    """An empty file, or one of zeros, is what some file systems leave of what was written last."""
    record_in_parts(tmp_path / "run")
    (tmp_path / "run" / "metadata.yaml").write_bytes(metadata)
    with pytest.raises(
        BagError, match=r"not the metadata .*; write it whole with 'twin_node check .*/run --repair OUT'"
    ):
        open_log(tmp_path / "run")
    found = repair(tmp_path / "run", tmp_path / "whole")
    assert "its files are read by their numbers" in str(found.damage)
    assert stamps_of(tmp_path / "whole") == [i * STEP for i in range(1, 30)]


def test_what_is_there_of_a_bag_is_written_whole(tmp_path: Path) -> None:
    record_in_parts(tmp_path / "run")
    (tmp_path / "run" / "run_1.mcap").unlink()
    with pytest.raises(BagError, match=r"not there: run_1.mcap; copy the whole bag, or write what is there with"):
        open_log(tmp_path / "run")
    found = repair(tmp_path / "run", tmp_path / "whole")
    assert "names files that are not there: run_1.mcap" in str(found.damage)
    assert stamps_of(tmp_path / "whole") == [i * STEP for i in range(1, 30) if not 10 <= i < 20]


@pytest.mark.parametrize("output", ["whole.mcap", "whole"])
def test_an_unfinished_recording_is_written_whole(tmp_path: Path, output: str) -> None:
    with RecordingWriter(tmp_path / "run.mcap") as writer:
        fill(writer, 25)
        writer.add_metadata("rig", {"camera": "front"})
    content = (tmp_path / "run.mcap").read_bytes()
    (tmp_path / "cut.mcap").write_bytes(content[:-30])
    found = repair(tmp_path / "cut.mcap", tmp_path / output)
    assert (found.messages, found.left_out) == (25, ())
    assert stamps_of(tmp_path / output) == [i * STEP for i in range(1, 25)]
    with open_log(tmp_path / output) as log:
        assert log.damage is None
        assert log.metadata["rig"] == {"camera": "front"}
        assert [(topic.name, topic.latched) for topic in log.topics] == [("/a", False), ("/tf_static", True)]
    with pytest.raises(BagError, match="exists already"):
        repair(tmp_path / "cut.mcap", tmp_path / output)
    with pytest.raises(BagError, match=r"expected a new name|exists already"):  # nobody can make it again
        LogWriter(tmp_path / output)


def test_repair_goes_on_behind_a_damaged_chunk(tmp_path: Path) -> None:
    with LogWriter(tmp_path / "log.mcap") as log:
        for i in range(300):
            log.write("/a", message_type(STRING)(data="x" * 500 + str(i)), i)
            if i % 100 == 99:
                log.flush()
    broken = bytearray((tmp_path / "log.mcap").read_bytes())
    broken[broken.index(b"x" * 500 + b"150") + 10] ^= 0xFF
    (tmp_path / "log.mcap").write_bytes(broken)
    found = repair(tmp_path / "log.mcap", tmp_path / "whole.mcap")
    assert found.damage is not None
    assert stamps_of(tmp_path / "whole.mcap") == [*range(100), *range(200, 300)]


@pytest.mark.parametrize("output", ["whole.mcap", "whole"])
def test_a_repaired_log_keeps_times_of_publishing_and_quality_of_service(tmp_path: Path, output: str) -> None:
    """Of best-effort images `ros2 bag play` would else make reliable ones, for which others wait."""
    offered = profile(latched=False)._replace(reliability=QosReliability.BEST_EFFORT, depth=5)
    with LogWriter(tmp_path / "log.mcap") as log:
        log.add_topic("/images", STRING, profiles=[offered, profile(latched=True)])
        log.write_raw("/images", STRING, text("a"), 100, 90)
        log.write("/notes", message_type(STRING)(data="b"), 200)
    repair(tmp_path / "log.mcap", tmp_path / output)
    with open_log(tmp_path / output) as log:
        assert [(m.stamp, m.published) for m in log.messages()] == [(100, 90), (200, 200)]
        assert log.profiles("/images") == (offered, profile(latched=True))
        assert log.profiles("/notes") == (profile(latched=False),)
    if output == "whole":
        with Reader(tmp_path / output) as bag:
            assert bag.connections[0].ext.offered_qos_profiles == [offered, profile(latched=True)]


@pytest.mark.parametrize("cut", [0, 20])
def test_attachments_that_a_repaired_log_goes_without_are_told(tmp_path: Path, cut: int) -> None:
    path = tmp_path / "log.mcap"
    with LogWriter(path) as log:
        log.write("/a", message_type(STRING)(data="a"), 1)
        log.flush()
        log._sink.stream._writer.add_attachment(1, 1, "notes.txt", "text/plain", b"what was seen")
    path.write_bytes(path.read_bytes()[: path.stat().st_size - cut])
    assert repair(path, tmp_path / "whole.mcap").left_out == ("the attachment notes.txt",)
    with open_log(path) as log:
        assert log.left_out == ()
