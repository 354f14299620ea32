"""The in-process bus: order, latching, and what happens when a callback fails."""

import pytest

from twin_node.runtime.bus import LocalBus


def test_messages_published_by_a_callback_wait_their_turn() -> None:
    bus, seen = LocalBus(), []

    def relay(message: int) -> None:
        seen.append(("relay in", message))
        bus.publish("/b", message + 10)
        seen.append(("relay out", message))

    bus.subscribe("/a", relay)
    bus.subscribe("/a", lambda m: seen.append(("second", m)))
    bus.subscribe("/b", lambda m: seen.append(("b", m)))
    bus.publish("/a", 1)
    assert seen == [("relay in", 1), ("relay out", 1), ("second", 1), ("b", 11)]


def test_only_a_latched_topic_reaches_a_late_subscriber() -> None:
    bus, seen = LocalBus(lambda topic: topic == "/map"), []
    for topic in ("/map", "/other"):
        bus.publish(topic, 1)
        bus.publish(topic, 2)
        bus.subscribe(topic, seen.append)
    assert seen == [2]


@pytest.mark.parametrize("is_latched", [True, False])
def test_who_subscribes_while_a_message_is_delivered_is_given_it_once_or_not_at_all(is_latched: bool) -> None:
    bus, seen = LocalBus(lambda _: is_latched), []
    bus.subscribe("/map", lambda message: bus.subscribe("/map", seen.append) if message == 1 else None)
    bus.publish("/map", 1)
    assert seen == ([1] if is_latched else [])
    bus.publish("/map", 2)
    assert seen == [*([1] if is_latched else []), 2]


def test_a_failing_callback_reaches_the_publisher_and_leaves_the_bus_usable() -> None:
    bus, seen = LocalBus(), []

    def fail(message: int) -> None:
        bus.publish("/later", message)
        raise ValueError("bad message")

    bus.subscribe("/a", fail)
    bus.subscribe("/later", seen.append)
    with pytest.raises(ValueError, match="bad message"):
        bus.publish("/a", 1)
    bus.publish("/later", 2)
    assert seen == [2]
