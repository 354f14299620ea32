"""Services between sessions of zenoh, as if they were processes."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import pytest

from twin_node.messages import message_type
from twin_node.messages.services import service_type
from twin_node.runtime.qos import RELIABLE, TopicKind
from twin_node.runtime.rmw_zenoh import EntityKind
from twin_node.runtime.services import Answer, Reply, ServiceClient
from twin_node.runtime.zenoh_session import WireError, ZenohParameters
from twin_node.runtime.zenoh_wire import ZenohWire

pytest.importorskip("zenoh")

STATE = service_type("lifecycle_msgs/srv/GetState")
CHANGE = service_type("lifecycle_msgs/srv/ChangeState")
LONG_S = 60.0


def state(label: str) -> Any:
    return STATE.answer(current_state=message_type("lifecycle_msgs/msg/State")(id=1, label=label))


def saying(label: str) -> Answer:
    return lambda _, reply: reply(state(label))


@pytest.fixture
def wire(zenoh_router: ZenohParameters) -> Iterator[ZenohWire]:
    with contextlib.closing(ZenohWire(zenoh_router)) as opened:
        yield opened


@pytest.fixture
def client(zenoh_router: ZenohParameters, wire: ZenohWire) -> Iterator[ServiceClient]:
    with contextlib.closing(ServiceClient(zenoh_router)) as opened:
        yield opened


def soon(look: Callable[[], Any]) -> Any:
    """What `look()` finds, once it finds anything: discovery takes its time."""
    until = time.monotonic() + LONG_S
    while not (found := look()) and time.monotonic() < until:
        time.sleep(0.01)
    return found


def test_who_asks_a_service_is_answered(wire: ZenohWire, client: ServiceClient) -> None:
    wire.serve("twin", "/twin/get_state", STATE, saying("active"))
    wire.serve("arm", "/arm/get_state", STATE, saying("inactive"))
    for name, label in (("/twin/get_state", "active"), ("/arm/get_state", "inactive"), ("/twin/get_state", "active")):
        assert soon(lambda name=name: client.ask(name, STATE)).current_state.label == label
    assert soon(client.nodes) == ("/arm", "/twin")


def test_a_request_reaches_its_service_and_an_answer_may_come_later(wire: ZenohWire, client: ServiceClient) -> None:
    """From another thread, while the same process answers others."""
    waiting: list[Reply] = []
    asked: list[str] = []

    def answer(request: Any, reply: Reply) -> None:
        asked.append(request.transition.label)
        waiting.append(reply)

    wire.serve("twin", "/twin/change_state", CHANGE, answer)
    wire.serve("twin", "/twin/get_state", STATE, saying("active"))
    assert soon(lambda: client.ask("/twin/get_state", STATE)), "it is there"
    transition = message_type("lifecycle_msgs/msg/Transition")(id=4, label="deactivate")
    answers: list[Any] = []
    thread = threading.Thread(
        target=lambda: answers.append(client.ask("/twin/change_state", CHANGE, LONG_S, transition=transition))
    )
    thread.start()
    assert soon(lambda: asked) == ["deactivate"]
    assert client.ask("/twin/get_state", STATE) is not None
    assert not answers
    waiting[0](CHANGE.answer(success=True))
    thread.join(LONG_S)
    assert answers[0].success


def test_nobody_answers_for_a_service_that_there_is_not_or_is_no_more(wire: ZenohWire, client: ServiceClient) -> None:
    cancel = wire.serve("twin", "/twin/get_state", STATE, saying("active"))
    assert soon(lambda: client.ask("/twin/get_state", STATE)) is not None
    assert client.ask("/arm/get_state", STATE, 1.0) is None
    cancel()
    assert soon(lambda: client.ask("/twin/get_state", STATE, 1.0) is None)


def test_a_service_is_awaited_until_it_is_there(wire: ZenohWire, client: ServiceClient) -> None:
    assert not client.awaits("/twin/get_state", 0.0)
    late = threading.Timer(0.3, lambda: wire.serve("twin", "/twin/get_state", STATE, saying("active")))
    late.start()
    assert client.awaits("/twin/get_state", LONG_S)
    assert client.ask("/twin/get_state", STATE) is not None, "and answers at once"


def test_what_is_no_request_is_not_answered(zenoh_router: ZenohParameters, wire: ZenohWire) -> None:
    """Neither bytes that are none nor a query without what tells who asks; whoever asks next is answered."""
    import zenoh

    from twin_node.runtime.rmw_zenoh import Attachment, topic_key
    from twin_node.runtime.zenoh_session import open_client

    wire.serve("twin", "/twin/change_state", CHANGE, lambda _, reply: reply(CHANGE.answer(success=True)))
    key = topic_key(0, "/twin/change_state", CHANGE.name, CHANGE.type_hash)
    transition = message_type("lifecycle_msgs/msg/Transition")(id=4, label="deactivate")
    whole = bytes(CHANGE.types.serialize(CHANGE.ask(transition=transition)))
    who = Attachment(1, 2, bytes(range(16))).pack()
    with contextlib.closing(open_client(zenoh_router)) as session:

        def ask(payload: bytes | None, attachment: bytes | None) -> list[Any]:
            target = zenoh.QueryTarget.ALL_COMPLETE
            return list(session.get(key, target=target, payload=payload, attachment=attachment, timeout=LONG_S))

        [answered] = soon(lambda: ask(whole, who))
        assert answered.ok.attachment.to_bytes()[17:] == bytes(range(16)), "a response names who has asked"
        assert answered.ok.attachment.to_bytes()[:8] == (1).to_bytes(8, "little"), "and for what"
        assert ask(whole[:-3], who) == []
        assert ask(None, who) == []
        assert ask(whole, None) == []
        assert ask(whole, b"short") == []
        assert len(ask(whole, who)) == 1


def test_a_service_that_fails_leaves_the_others_at_work(
    wire: ZenohWire, client: ServiceClient, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail(_: Any, reply: Reply) -> None:
        raise ZeroDivisionError("a bug")

    wire.serve("arm", "/arm/get_state", STATE, fail)
    wire.serve("twin", "/twin/get_state", STATE, saying("active"))
    assert soon(lambda: client.ask("/twin/get_state", STATE)) is not None
    assert client.ask("/arm/get_state", STATE, LONG_S) is None, "and who asked does not wait for nothing"
    assert client.ask("/twin/get_state", STATE) is not None
    assert "ZeroDivisionError: a bug" in capsys.readouterr().err


def test_an_answer_that_nobody_waits_for_any_more_troubles_nobody(
    zenoh_router: ZenohParameters, client: ServiceClient
) -> None:
    waiting: list[Reply] = []
    wire = ZenohWire(zenoh_router)
    wire.serve("twin", "/twin/get_state", STATE, lambda _, reply: waiting.append(reply))
    assert soon(lambda: client.ask("/twin/get_state", STATE, 0.2) or waiting)
    waiting[0](state("late"))
    assert client.ask("/twin/get_state", STATE, 0.2) is None
    wire.close()
    waiting[1](state("too late"))
    waiting[1](state("twice"))


def test_services_are_announced_with_their_node(zenoh_router: ZenohParameters, wire: ZenohWire) -> None:
    wire.serve("twin", "/twin/get_state", STATE, saying("active"))
    with contextlib.closing(ZenohWire(zenoh_router)) as other:
        [seen] = soon(other.endpoints)
    assert (seen.kind, seen.node.name, seen.topic) == (EntityKind.SERVICE, "twin", "/twin/get_state")
    assert (seen.msgtype, seen.type_hash) == (STATE.name, STATE.type_hash)


def test_humble_asks_and_answers_without_hashes(zenoh_router: ZenohParameters) -> None:
    humble = replace(zenoh_router, ros_distro="humble")
    with contextlib.closing(ZenohWire(humble)) as wire, contextlib.closing(ServiceClient(humble)) as client:
        wire.serve("twin", "/twin/get_state", STATE, saying("active"))
        assert soon(lambda: client.ask("/twin/get_state", STATE)) is not None
        with contextlib.closing(ServiceClient(zenoh_router)) as later:
            assert later.ask("/twin/get_state", STATE, 1.0) is None


def test_nodes_are_told_with_their_namespaces(zenoh_router: ZenohParameters, client: ServiceClient) -> None:
    from twin_node.runtime.rmw_zenoh import NodeIdentity, node_token
    from twin_node.runtime.zenoh_session import open_session

    with contextlib.closing(open_session(zenoh_router)) as session:
        token = session.liveliness().declare_token(node_token(NodeIdentity("a1", 0, "twin", "/line/two")))
        assert soon(client.nodes) == ("/line/two/twin",)
        token.undeclare()


def test_without_a_router_nobody_can_be_asked() -> None:
    with pytest.raises(WireError, match=r"127\.0\.0\.1:1: expected a zenoh router"):
        ServiceClient(ZenohParameters(endpoint="tcp/127.0.0.1:1"))


def test_a_wire_that_serves_closes(zenoh_router: ZenohParameters) -> None:
    wire = ZenohWire(zenoh_router)
    wire.serve("twin", "/twin/get_state", STATE, saying("active"))
    wire.publisher("twin", "/text", TopicKind("std_msgs/msg/String", RELIABLE))
    wire.close()
    wire.close()
    alive = [thread.name for thread in threading.enumerate() if thread.name == "services"]
    assert not alive or soon(lambda: not any(t.name == "services" for t in threading.enumerate()))
