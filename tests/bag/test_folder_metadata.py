"""What `ros2 bag info` reads of a folder: its files, their times and messages, its topics and what else was said."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import yaml

from twin_node.bag.folder_metadata import METADATA_FILE, FolderFile, FolderTopic, write_metadata

TOPIC = FolderTopic("/joint_states", "sensor_msgs/msg/JointState", "", "RIHS01_0", 5)


def written(folder: Path, *files: FolderFile, **records: dict[str, str]) -> dict:
    """What is in the file."""
    write_metadata(folder, files, [TOPIC], records)
    assert [path.name for path in folder.iterdir()] == [METADATA_FILE]
    return yaml.safe_load((folder / METADATA_FILE).read_text())["rosbag2_bagfile_information"]


def test_times_reach_from_the_first_message_of_all_files_to_the_last(tmp_path: Path) -> None:
    files = FolderFile("a.mcap", 70, 90, 2), FolderFile("b.mcap", 60, 80, 3), FolderFile("c.mcap", None, 0, 0)
    told = written(tmp_path, *files)
    assert told["starting_time"]["nanoseconds_since_epoch"] == 60
    assert told["duration"]["nanoseconds"] == 30
    assert told["message_count"] == 5
    of_files = [
        (one["path"], one["starting_time"]["nanoseconds_since_epoch"], one["duration"]["nanoseconds"])
        for one in told["files"]
    ]
    assert of_files == [("a.mcap", 70, 20), ("b.mcap", 60, 20), ("c.mcap", 0, 0)]
    assert told["relative_file_paths"] == ["a.mcap", "b.mcap", "c.mcap"]


@pytest.mark.parametrize("records", [{}, {"twin": {"name": "a cell", "seed": "3"}}])
def test_metadata_records_are_custom_data_and_a_folder_without_any_says_so(tmp_path: Path, records: dict) -> None:
    told = written(tmp_path, FolderFile("a.mcap", 70, 90, 5), **records)
    assert {name: json.loads(text) for name, text in (told["custom_data"] or {}).items()} == records
    assert told["topics_with_message_count"][0]["message_count"] == 5


def test_of_a_folder_without_messages_no_time_is_told(tmp_path: Path) -> None:
    told = written(tmp_path, FolderFile("a.mcap", None, 0, 0))
    assert told["starting_time"]["nanoseconds_since_epoch"] == told["duration"]["nanoseconds"] == 0
