"""Messages read before they are due: in order, no more than there is room for, until who plays them has ended."""

import threading
from collections.abc import Iterator

import pytest

from twin_node.bag import LogMessage
from twin_node.messages import builtin_types
from twin_node.nodes.live import read_ahead as module
from twin_node.nodes.live.read_ahead import read_ahead

LENGTH = 90
ENOUGH_S = 0.2
"""Time in which a reader that is not held back reads all."""


class Log:
    """Messages of `LENGTH` bytes, how many have been read, and whether all have."""

    def __init__(self, count: int, length: int = LENGTH) -> None:
        self.count, self.length, self.read = count, length, 0
        self.at_end = threading.Event()

    def __iter__(self) -> Iterator[LogMessage]:
        for i in range(self.count):
            self.read += 1
            yield LogMessage("/a", "std_msgs/msg/String", i, bytes(self.length), builtin_types(), i)
        self.at_end.set()


def stamps(log: Log, size: int = 1000) -> list[int]:
    return [message.stamp for message in read_ahead(iter(log), size, threading.Event())]


@pytest.mark.parametrize(("size", "most_bytes", "wait"), [(4, 10**6, 4), (1000, 4 * LENGTH, 4), (1000, 1, 1)])
def test_no_more_is_read_than_has_room(monkeypatch: pytest.MonkeyPatch, size: int, most_bytes: int, wait: int) -> None:
    """A thousand raw images would fill the memory. One message has room whatever its length."""
    monkeypatch.setattr(module, "MOST_BYTES", most_bytes)
    log = Log(50)
    ahead = read_ahead(iter(log), size, threading.Event())
    assert next(ahead).stamp == 0
    assert not log.at_end.wait(ENOUGH_S)
    assert log.read == 1 + wait + 1  # taken, waiting, and one that is held until it has room
    assert [message.stamp for message in ahead] == list(range(1, 50))


def test_what_was_taken_makes_room(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "MOST_BYTES", 10 * LENGTH)
    assert stamps(Log(500)) == list(range(500))
    assert stamps(Log(0)) == []


def test_what_ends_the_reading_ends_the_playing() -> None:
    def broken() -> Iterator[LogMessage]:
        yield from Log(3)
        raise OSError("gone")

    ahead = read_ahead(broken(), 1000, threading.Event())
    assert [next(ahead).stamp for _ in range(3)] == [0, 1, 2]
    with pytest.raises(OSError, match="gone"):
        next(ahead)


def test_who_is_stopped_waits_for_nothing() -> None:
    stop = threading.Event()
    ahead = read_ahead(iter(Log(50)), 2, stop)
    next(ahead)
    stop.set()
    assert list(ahead) == []
    assert [thread.name for thread in threading.enumerate() if thread.name == "read ahead"] == []
