"""Writes what can be read of a damaged or unfinished log as one that is whole."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

from twin_node.bag.log import BagError
from twin_node.bag.reader import open_log
from twin_node.bag.writer import LogWriter


@dataclass(frozen=True)
class Repaired:
    """What became of a log."""

    messages: int
    """Written."""
    damage: str | None
    """What was wrong with the log; None: nothing was."""
    left_out: tuple[str, ...]
    """What was not written, a line each: topics whose type is defined nowhere, `LogReader.left_out`, attachments."""


def repair(source: Path, output: Path) -> Repaired:
    """Copies a log's topics, metadata and readable messages to `output`: an `.mcap` file, or a new rosbag2 folder.

    Messages keep their times of recording and of publishing, topics their quality of service; sequence numbers begin
    anew. What defines a type goes with it as it is where nobody here understands it. Chunks that are damaged are passed
    over; a folder that lacks some of its files is taken too, and one whose `metadata.yaml` was never written, or is
    damaged.
    Raises `BagError` where `source` is no log, `output` exists, or cannot be written; then nothing is left of it.
    """
    if os.path.lexists(output):
        raise BagError(f"{output}: exists already; remove it or choose another name for the repaired log")
    with open_log(source, unfinished=True) as log, LogWriter(output, recorded=True) as writer:
        definitions = {topic: log.definition(topic) for topic in log.topics}
        known = [topic for topic in log.topics if definitions[topic] is not None]
        for topic in known:
            definition = definitions[topic]
            writer.add_topic(topic.name, topic.msgtype, definition=definition, profiles=log.profiles(topic.name))
        for name, record in log.metadata.items():
            writer.add_metadata(name, record)
        messages = 0
        for message in log.messages([topic.name for topic in known], past_damage=True):
            writer.write_raw(message.topic, message.msgtype, message.data, message.stamp, message.published)
            messages += 1
        unknown = [f"{topic.name}, whose type is defined nowhere" for topic in log.topics if topic not in known]
        attached = [f"the attachment {name}" for name in log.attachments]
        return Repaired(messages, log.damage, (*unknown, *log.left_out, *attached))
