"""The topics of a log of one or several files, each read as one type by one definition of it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from twin_node.bag.log import BagError, Channel, Topic
from twin_node.bag.qos import any_transient_local
from twin_node.errors import several
from twin_node.messages import builtin_types


@dataclass(frozen=True)
class MergedTopics:
    """What of a log's topics is read."""

    topics: tuple[Topic, ...]
    """By name, each of the type, and by the definition of it, that most of its messages have."""
    definitions: Mapping[str, frozenset[str]]
    """Topic -> texts that define its type so; they may differ in comments, and be empty."""
    left_out: tuple[str, ...]
    """What is not, a line each."""


@dataclass(frozen=True)
class _Kind:
    """Messages of one topic and type."""

    topic: Topic
    """Counts those by the definition that most have."""
    definitions: frozenset[str]
    odd: int
    """Messages by other definitions."""


def merged_topics(path: Path, channels: Sequence[Channel], outside: Mapping[tuple[str, str], int]) -> MergedTopics:
    """The topics of a log's channels; `outside`: topic and type -> messages that do not count.

    Raises `BagError` where no channel is in CDR; `path`: of the log.
    """
    encodings = sorted({channel.encoding for channel in channels})
    if channels and "cdr" not in encodings:
        raise BagError(f"{path}: expected messages in cdr, found {', '.join(encodings)}; convert the log to ROS 2")
    by_kind: dict[tuple[str, str], list[Channel]] = {}
    others: Counter[tuple[str, str]] = Counter()
    for channel in channels:
        if channel.encoding == "cdr":
            by_kind.setdefault((channel.topic, channel.msgtype), []).append(channel)
        else:
            others[channel.topic, channel.encoding] += channel.count
    kinds = [_kind(of_kind, outside.get(key, 0)) for key, of_kind in by_kind.items()]
    lines = [f"{topic}: {several(count, 'message')} in {form}; expected cdr" for (topic, form), count in others.items()]
    read: dict[str, _Kind] = {}
    for kind in sorted(kinds, key=lambda kind: (kind.topic.name, -kind.topic.count, kind.topic.msgtype)):
        topic, first = kind.topic, read.setdefault(kind.topic.name, kind)
        if first is not kind:
            count, chosen = topic.count + kind.odd, first.topic
            lines.append(
                f"{topic.name}: {several(count, 'message')} of {topic.msgtype}; {chosen.count} are of {chosen.msgtype}"
            )
        elif kind.odd:
            lines.append(
                f"{topic.name}: {several(kind.odd, 'message')} by another definition of {topic.msgtype} than the "
                f"{topic.count} others"
            )
    return MergedTopics(
        tuple(kind.topic for kind in read.values()),
        {name: kind.definitions for name, kind in read.items()},
        tuple(sorted(lines)),
    )


def _kind(channels: Sequence[Channel], outside: int) -> _Kind:
    definitions = _main_definitions(channels)
    count = sum(channel.count for channel in channels if channel.definition in definitions) - outside
    latched = any(any_transient_local(channel.profiles) for channel in channels)
    topic = Topic(channels[0].topic, channels[0].msgtype, count, latched)
    return _Kind(topic, definitions, sum(channel.count for channel in channels) - outside - count)


def _main_definitions(channels: Sequence[Channel]) -> frozenset[str]:
    """The texts that say the same as that of most messages; an empty one says nothing else than any."""
    texts = {channel.definition for channel in channels}
    if len(texts - {""}) < 2:
        return frozenset(texts)
    meanings = {text: _meaning(channels[0].msgtype, text) for text in texts - {""}}
    counts: Counter[str] = Counter()
    for channel in channels:
        if channel.definition:
            counts[meanings[channel.definition]] += channel.count
    most = counts.most_common(1)[0][0]
    return frozenset({"", *(text for text, meaning in meanings.items() if meaning == most)})


def _meaning(msgtype: str, text: str) -> str:
    """The type's hash, which comments do not change; of what is no definition the text itself."""
    types = builtin_types().extended({msgtype: text})
    return types.type_hash(msgtype) if msgtype in types else text
