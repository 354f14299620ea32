"""`metadata.yaml` of a rosbag2 folder of MCAP files, as `ros2 bag` writes it."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

import yaml

METADATA_FILE = "metadata.yaml"
BAG_VERSION = 8
"""Version of the metadata with numeric QoS policies, read by every distribution since Humble."""


@dataclass(frozen=True)
class FolderFile:
    """A file of a folder."""

    name: str
    start: int | None
    """Log time of its first message, ns; None: it has none."""
    end: int
    """Log time of its last message, ns."""
    messages: int


@dataclass(frozen=True)
class FolderTopic:
    """A topic of a folder."""

    name: str
    msgtype: str
    qos: str
    """`offered_qos_profiles`."""
    type_hash: str
    messages: int
    """In all files."""


def write_metadata(
    folder: Path,
    files: Sequence[FolderFile],
    topics: Sequence[FolderTopic],
    records: Mapping[str, Mapping[str, str]] = MappingProxyType({}),
) -> None:
    """Puts a folder's `metadata.yaml` in place, whole. `records`: metadata records, kept as custom data.

    Raises `OSError` as writing does.
    """
    new = folder / f"{METADATA_FILE}.new"
    content = {"rosbag2_bagfile_information": _information(files, topics, records)}
    try:
        new.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")
    except OSError:
        new.unlink(missing_ok=True)  # of a disk that is full: half of it, or nothing
        raise
    new.replace(folder / METADATA_FILE)


def _information(
    files: Sequence[FolderFile], topics: Sequence[FolderTopic], records: Mapping[str, Mapping[str, str]]
) -> dict[str, object]:
    begun = [file for file in files if file.start is not None]
    start = min((file.start or 0 for file in begun), default=0)
    end = max((file.end for file in begun), default=0)
    return {
        "version": BAG_VERSION,
        "storage_identifier": "mcap",
        "duration": {"nanoseconds": end - start},
        "starting_time": {"nanoseconds_since_epoch": start},
        "message_count": sum(file.messages for file in files),
        "topics_with_message_count": [_topic_entry(topic) for topic in topics],
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [file.name for file in files],
        "files": [_file_entry(file) for file in files],
        "custom_data": {name: json.dumps(dict(record), sort_keys=True) for name, record in records.items()} or None,
        "ros_distro": "",
    }


def _topic_entry(topic: FolderTopic) -> dict[str, object]:
    return {
        "topic_metadata": {
            "name": topic.name,
            "type": topic.msgtype,
            "serialization_format": "cdr",
            "offered_qos_profiles": topic.qos,
            "type_description_hash": topic.type_hash,
        },
        "message_count": topic.messages,
    }


def _file_entry(file: FolderFile) -> dict[str, object]:
    start = file.start or 0
    return {
        "path": file.name,
        "starting_time": {"nanoseconds_since_epoch": start},
        "duration": {"nanoseconds": file.end - start},
        "message_count": file.messages,
    }
