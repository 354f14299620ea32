"""What latched topics have said: what who joins late is told."""

from __future__ import annotations

from collections.abc import Collection, Sequence

from twin_node.bag.log import LogMessage
from twin_node.bag.reader import LogReader

SEVERAL = 100
"""How many messages of a topic of several publishers (`is_of_several`) are kept, the newest."""
FIRST_REACH_NS = 2_000_000_000
"""How far back a first look goes: twice the period of what is published once a second."""


def is_of_several(topic: str) -> bool:
    """Whether a latched topic's last message is not all: each publisher of transforms tells of its own."""
    return topic.rpartition("/")[2] == "tf_static"


def kept_with(kept: Sequence[bytes], topic: str, data: bytes) -> list[bytes]:
    """What stands of a latched topic once `data` has come: that; of several publishers' also what is not the same."""
    others = [one for one in kept if one != data] if is_of_several(topic) else []
    return [*others, data][-SEVERAL:]


def newest_before(log: LogReader, topics: Collection[str], stop_ns: int) -> dict[str, LogMessage]:
    """The newest message of each topic before a log time, ns; looks back further while some are still missing."""
    found: dict[str, LogMessage] = {}
    stop_ns, reach = min(stop_ns, log.end_ns + 1), FIRST_REACH_NS
    while stop_ns > log.start_ns and (missing := set(topics) - set(found)):
        start_ns = max(stop_ns - reach, log.start_ns)
        found.update({entry.topic: entry for entry in log.messages(missing, start_ns, stop_ns)})
        stop_ns, reach = start_ns, 4 * reach
    return found


def standing_before(log: LogReader, topics: Collection[str], stop_ns: int) -> dict[str, list[bytes]]:
    """Latched topic -> what stands of it at a log time, ns, of what was said before: CDR bytes, oldest first."""
    several = [topic for topic in topics if is_of_several(topic)]
    newest = newest_before(log, set(topics) - set(several), stop_ns)
    standing = {topic: [bytes(entry.data)] for topic, entry in newest.items()}
    for entry in log.messages(several, stop_ns=stop_ns) if several else ():
        standing[entry.topic] = kept_with(standing.get(entry.topic, ()), entry.topic, bytes(entry.data))
    return standing
