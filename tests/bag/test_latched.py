"""What latched topics have said: how much of it is kept."""

from __future__ import annotations

from twin_node.bag.latched import SEVERAL, kept_with


def test_of_many_publishers_of_a_latched_topic_the_newest_are_kept() -> None:
    """Transforms that change with every message would fill the memory, and the head of every file."""
    kept: list[bytes] = []
    for number in range(3 * SEVERAL):
        kept = kept_with(kept, "/tf_static", b"%d" % number)
    assert kept == [b"%d" % number for number in range(2 * SEVERAL, 3 * SEVERAL)]
    assert kept_with(kept, "/tf_static", kept[0]) == [*kept[1:], kept[0]]
    assert kept_with([b"old"], "/map", b"new") == [b"new"]
