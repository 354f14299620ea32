"""What sends a topic's messages over zenoh."""

from __future__ import annotations

import sys
import threading
from types import SimpleNamespace
from typing import Any

from twin_node.messages import message_type
from twin_node.runtime.rmw_zenoh import unpack_attachment
from twin_node.runtime.zenoh_wire import _RemotePublisher, _Sender


def test_threads_that_speak_on_one_topic_speak_in_turn() -> None:
    """What a player plays and its node's own diagnoses: one that was put after a later one was refused by all."""
    put: list[int] = []

    class Publisher:
        matching_status = SimpleNamespace(matching=True)

        def put(self, _: bytes, attachment: bytes) -> None:
            found = unpack_attachment(attachment)
            assert found is not None
            put.append(found.sequence)

    declared: list[Any] = []

    def declare(_: Any) -> _RemotePublisher:
        declared.append(None)
        return _RemotePublisher(Publisher(), bytes(16), latched=False)

    message = message_type("std_msgs/msg/String")(data="a")
    send = _Sender(lambda _: None, declare)
    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    try:
        threads = [threading.Thread(target=lambda: [send(message) for _ in range(1000)]) for _ in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    finally:
        sys.setswitchinterval(interval)
    assert len(declared) == 1
    assert put == list(range(1, 4001))
