"""Buses on wires: between threads, and between sessions of zenoh as if they were processes."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest

from twin_node.errors import TwinError
from twin_node.messages import message_type
from twin_node.messages.services import ServiceType, service_type
from twin_node.runtime.executor import Executor
from twin_node.runtime.late_wire import LateWire
from twin_node.runtime.qos import LATCHED, LATCHED_BY_SEVERAL, NEWEST, RELIABLE, TopicKind
from twin_node.runtime.rmw_zenoh import HUMBLE_HASH, Attachment
from twin_node.runtime.services import PATIENCE_S, Answer
from twin_node.runtime.wire import Cancel, Encoded, LocalWire, Wire, encoded
from twin_node.runtime.wire_bus import BusError, WireBus
from twin_node.runtime.zenoh_session import WireError, ZenohParameters, open_session
from twin_node.runtime.zenoh_wire import PUBLISHERS_REMEMBERED, ZenohWire, _Receiver

STRING = "std_msgs/msg/String"
ATTEMPTS = 600
"""Times that something is tried until it is seen; discovery takes a few, and on a busy machine a minute."""


def text(data: str) -> Any:
    return message_type(STRING)(data=data)


def kind_of(topic: str) -> TopicKind | None:
    if topic == "/record":
        return TopicKind(None, NEWEST)
    if topic == "/foreign":
        return None
    return TopicKind(STRING, LATCHED if topic == "/map" else RELIABLE)


class Side:
    """One thread's bus, and what it has been told."""

    def __init__(self, wire: Wire, name: str) -> None:
        self.executor = Executor()
        self.bus = WireBus(wire, self.executor, name, kind_of)
        self.seen: list[Any] = []

    def listen(self, topic: str) -> None:
        self.bus.subscribe(topic, self.seen.append)

    def wait(self) -> Any:
        assert self.executor.step(60.0)
        return self.seen[-1]


@pytest.fixture
def wires(zenoh_router: ZenohParameters) -> Iterator[tuple[ZenohWire, ZenohWire]]:
    a, b = ZenohWire(zenoh_router), ZenohWire(zenoh_router)
    yield a, b
    a.close()
    b.close()


def send_until_heard(talker: Side, listener: Side, topic: str, message: Any) -> Any:
    for _ in range(ATTEMPTS):
        talker.bus.publish(topic, message)
        if listener.executor.step(0.1):
            return listener.seen[-1]
    raise AssertionError("never heard")


def test_threads_of_a_process_share_messages_by_reference() -> None:
    wire = LocalWire()
    talker, listener = Side(wire, "talker"), Side(wire, "listener")
    record = object()
    listener.listen("/record")
    for _ in range(3):
        talker.bus.publish("/record", object())
    talker.bus.publish("/record", record)
    assert listener.bus.is_waiting("/record") and not listener.bus.is_waiting("/other")
    assert listener.wait() is record
    assert listener.bus.dropped("/record") == 3 and not listener.bus.is_waiting("/record")
    assert [(one.received, one.dropped) for one in listener.bus.traffic] == [(4, 3)]


def test_renamed_topics_meet_under_the_name_on_the_wire_and_keep_their_kind() -> None:
    wire = LocalWire()
    remaps = {"/map": "/other/map"}
    talker, listener = Side(wire, "talker"), Side(wire, "listener")
    talker.bus = WireBus(wire, talker.executor, "talker", kind_of, remaps)
    talker.bus.publish("/map", text("here"))
    listener.bus.declare("/other/map", kind_of("/map"))
    listener.listen("/other/map")
    assert listener.wait().data == "here"
    listener.listen("/map")
    assert not listener.executor.step(0.0)
    assert talker.bus.resolved("/map") == "/other/map"


def test_a_bus_may_end_after_its_wire() -> None:
    listener = Side(wire := LocalWire(), "listener")
    listener.listen("/record")
    wire.close()
    listener.bus.close()


class CellWire(LocalWire):
    namespace = "/cell"


def test_topics_have_their_namespace_before_them_but_for_those_that_are_renamed_or_of_all() -> None:
    executor = Executor()
    bus = WireBus(CellWire(), executor, "twin", kind_of, {"/image": "/driver/image", "/status": "/cell/told"})
    names = ("/map", "/image", "/status", "/clock")
    assert [bus.resolved(name) for name in names] == ["/cell/map", "/driver/image", "/cell/told", "/clock"]
    assert [bus.renamed(name) for name in names] == ["/map", "/driver/image", "/cell/told", "/clock"]
    assert [bus.named(bus.resolved(name)) for name in names] == list(names)
    assert bus.named("/map") is None and bus.named("/other/map") is None
    assert bus.named("/cell/image") is None, "the node would listen to /driver/image by that name"


def test_twins_of_two_namespaces_do_not_hear_each_other(zenoh_router: ZenohParameters) -> None:
    """What is of all they hear both, and others find their nodes and topics under their full names."""
    wires = [ZenohWire(replace(zenoh_router, namespace=namespace)) for namespace in ("/a", "/b", "/")]
    a, b, outside = (Side(wire, "twin") for wire in wires)
    try:
        for side in (a, b):
            side.listen("/chatter")
            side.listen("/clock")
        outside.listen("/a/chatter")
        assert send_until_heard(a, outside, "/chatter", text("of a")).data == "of a"
        assert send_until_heard(outside, b, "/clock", text("of all")).data == "of all"
        assert {message.data for message in b.seen} == {"of all"}
        expected = {("/a", "/a/chatter"), ("/b", "/b/chatter"), ("/b", "/clock"), ("/", "/a/chatter")}
        for _ in range(ATTEMPTS):
            listens = {(e.node.namespace, e.topic) for e in wires[2].endpoints() if e.kind.name == "SUBSCRIBER"}
            if expected <= listens:
                return
            outside.executor.step(0.1)
        raise AssertionError(f"found {listens}")
    finally:
        for wire in wires:
            wire.close()


def test_nobody_speaks_before_the_network_is_joined(zenoh_router: ZenohParameters) -> None:
    wire = LateWire(zenoh_router)
    side = Side(wire, "early")
    assert wire.endpoints() == ()
    with pytest.raises(WireError, match="before it was configured"):
        side.bus.publish("/chatter", text("too early"))
    wire.open()
    side.listen("/chatter")
    side.bus.publish("/chatter", text("now"))
    assert side.wait().data == "now"
    wire.close()


def test_a_latched_message_awaits_the_late() -> None:
    wire = LocalWire()
    talker, listener = Side(wire, "talker"), Side(wire, "listener")
    talker.bus.publish("/map", text("old"))
    talker.bus.publish("/map", text("new"))
    talker.bus.publish("/chatter", text("gone"))
    listener.listen("/map")
    listener.listen("/chatter")
    assert listener.wait().data == "new"
    assert not listener.executor.step(0.0)


def test_bytes_are_decoded_where_they_arrive_and_damage_is_counted() -> None:
    wire = LocalWire()
    talker, listener, recorder = Side(wire, "talker"), Side(wire, "listener"), Side(wire, "recorder")
    listener.listen("/chatter")
    cancel = recorder.bus.subscribe_raw("/chatter", recorder.seen.append)
    talker.bus.publish("/chatter", encoded(text("as bytes")))
    assert listener.wait().data == "as bytes"
    assert isinstance(recorder.wait(), Encoded)
    talker.bus.publish("/chatter", Encoded(STRING, b"\x00\x01"))
    assert listener.executor.step(1.0)
    [traffic] = listener.bus.traffic
    assert (traffic.received, traffic.unreadable) == (2, 1)
    assert traffic.last_error is not None and STRING in traffic.last_error
    listener.bus.close()
    cancel()
    assert not talker.bus.is_heard("/chatter")


def test_what_a_node_refuses_does_not_end_it() -> None:
    wire = LocalWire()
    talker, listener = Side(wire, "talker"), Side(wire, "listener")

    def refuse(message: Any) -> None:
        raise TwinError("not this one")

    listener.bus.subscribe("/chatter", refuse)
    talker.bus.publish("/chatter", text("x"))
    assert listener.executor.step(1.0)
    assert listener.bus.traffic[0].last_error == "not this one"


def test_messages_cross_zenoh_and_the_graph_shows_who_offers_what(wires: tuple[ZenohWire, ZenohWire]) -> None:
    talker, listener = Side(wires[0], "talker"), Side(wires[1], "listener")
    listener.listen("/chatter")
    assert send_until_heard(talker, listener, "/chatter", text("over there")).data == "over there"
    expected = {("PUBLISHER", "talker", "/chatter", STRING), ("SUBSCRIBER", "listener", "/chatter", STRING)}
    for _ in range(ATTEMPTS):
        offered = {(e.kind.name, e.node.name, e.topic, e.msgtype) for e in wires[1].endpoints()}
        if offered == expected:
            return
        listener.executor.step(0.1)
    raise AssertionError(f"found {offered}")


def test_a_latched_message_crosses_zenoh_to_the_late(wires: tuple[ZenohWire, ZenohWire]) -> None:
    talker, listener = Side(wires[0], "talker"), Side(wires[1], "listener")
    talker.bus.publish("/map", text("old"))
    talker.bus.publish("/map", text("new"))
    listener.listen("/map")
    while listener.wait().data != "new":
        pass  # "old" was still on its way when it began to listen
    while listener.executor.step(0.2):
        pass
    assert listener.seen[-1].data == "new"


def test_all_that_is_kept_of_a_latched_topic_crosses_zenoh_to_the_late(wires: tuple[ZenohWire, ZenohWire]) -> None:
    talker, listener = Side(wires[0], "talker"), Side(wires[1], "listener")
    for side in (talker, listener):
        side.bus.declare("/tf_static", TopicKind(STRING, LATCHED_BY_SEVERAL))
    for words in ("cameras", "robot", "tool"):
        talker.bus.publish("/tf_static", text(words))
    listener.listen("/tf_static")
    assert [listener.wait().data for _ in range(3)] == ["cameras", "robot", "tool"]


@pytest.mark.parametrize("repeats", [False, True])
def test_only_a_latched_message_that_never_comes_again_may_hold_up_its_publisher(
    wires: tuple[ZenohWire, ZenohWire], monkeypatch: pytest.MonkeyPatch, repeats: bool
) -> None:
    """What zenoh is asked to do when a reader has no room: to wait for it, or to drop the message."""
    zenoh = pytest.importorskip("zenoh")
    asked: list[Any] = []
    declare = zenoh.ext.declare_advanced_publisher

    def ask(*arguments: Any, **options: Any) -> Any:
        asked.append(options["congestion_control"])
        return declare(*arguments, **options)

    monkeypatch.setattr(zenoh.ext, "declare_advanced_publisher", ask)
    wires[0].publisher("a", "/map", TopicKind(STRING, replace(LATCHED, repeats=repeats)))(text("anew"))
    assert asked == [zenoh.CongestionControl.DROP if repeats else zenoh.CongestionControl.BLOCK]


def test_a_publisher_knows_whether_anybody_listens(wires: tuple[ZenohWire, ZenohWire]) -> None:
    talker, listener = Side(wires[0], "talker"), Side(wires[1], "listener")
    assert not talker.bus.is_heard("/chatter")
    listener.listen("/chatter")
    assert send_until_heard(talker, listener, "/chatter", text("you")).data == "you"
    assert talker.bus.is_heard("/chatter")
    near = Side(wires[0], "near")
    assert not talker.bus.is_heard("/record")
    near.listen("/record")
    assert talker.bus.is_heard("/record")
    assert talker.bus.is_heard("/map"), "what is latched is heard by whoever comes later"


def test_of_one_publisher_nothing_that_is_older_than_what_has_come_is_taken() -> None:
    """Two ways through a network may bring its samples out of order, or twice; nodes without rmw_zenoh number none."""
    wire, taken = SimpleNamespace(refused=0), []
    receive = _Receiver(wire, STRING, lambda message: taken.append(int(message.data)))  # type: ignore[arg-type]

    def come(publisher: int, number: int, is_numbered: bool = True) -> None:
        packed = Attachment(number, 0, publisher.to_bytes(16, "little")).pack()
        attachment = SimpleNamespace(to_bytes=lambda: packed) if is_numbered else None
        receive(SimpleNamespace(attachment=attachment, payload=SimpleNamespace(to_bytes=lambda: b"%d" % number)))

    for number in (1, 3, 2, 3, 4):
        come(1, number)
    assert (taken, wire.refused) == ([1, 3, 4], 2)
    come(2, 1)
    come(3, 1, is_numbered=False)
    come(3, 0, is_numbered=False)
    assert taken[3:] == [1, 1, 0]
    for publisher in (*range(10, 10 + 2 * PUBLISHERS_REMEMBERED), 10):  # the first, which is forgotten by then
        come(publisher, 5)
        come(publisher, 4)
    assert taken[6:] == [5] * (2 * PUBLISHERS_REMEMBERED + 1)


def test_records_stay_at_home(wires: tuple[ZenohWire, ZenohWire]) -> None:
    talker, here, there = Side(wires[0], "talker"), Side(wires[0], "here"), Side(wires[1], "there")
    here.listen("/record")
    there.listen("/record")
    record = object()
    talker.bus.publish("/record", record)
    assert here.wait() is record
    assert not there.executor.step(0.0)


class Served(LocalWire):
    """A wire that keeps what answers a service."""

    answer: Answer

    def serve(self, node: str, name: str, service: ServiceType, answer: Answer) -> Cancel:
        self.answer = answer
        return lambda: None


def test_what_nobody_waits_for_any_more_is_not_done(monkeypatch: pytest.MonkeyPatch) -> None:
    """A node that hung let an arm go on when it came to itself, long after somebody had asked in vain."""
    now = [0.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    wire, executor, done = Served(), Executor(), list[object]()
    bus = WireBus(wire, executor, "driver", kind_of)
    bus.serve(
        "/arm/acknowledge", service_type("std_srvs/srv/Trigger"), lambda request, reply: done.append(request.of_s)
    )
    for asked_s, come_to_s in ((0.0, 1.0), (2.0, 2.0 + PATIENCE_S), (20.0, 20.0)):
        now[0] = asked_s
        wire.answer(SimpleNamespace(of_s=asked_s), lambda response: None)
        now[0] = come_to_s
        while executor.step(0.0):
            pass
    assert done == [0.0, 20.0]


@pytest.mark.parametrize(("given", "sourced"), [("humble", None), ("humble", "jazzy"), (None, "humble")])
def test_humble_is_spoken_to_without_hashes(
    zenoh_router: ZenohParameters, monkeypatch: pytest.MonkeyPatch, given: str | None, sourced: str | None
) -> None:
    """Commands, which have no launch file to say so in, did not hear it: `ROS_DISTRO` says so where ROS is sourced."""
    monkeypatch.delenv("ROS_DISTRO", raising=False)
    if sourced is not None:
        monkeypatch.setenv("ROS_DISTRO", sourced)
    assert ZenohParameters().speaks_hashes == (sourced != "humble")
    humble = ZenohWire(ZenohParameters("external", zenoh_router.endpoint, ros_distro=given, domain=0))
    old = Side(humble, "old")
    old.listen("/chatter")
    for _ in range(ATTEMPTS):
        if humble.endpoints():
            break
        old.executor.step(0.1)
    [endpoint] = humble.endpoints()
    old.bus.declare("/unknown", TopicKind("of_others/msg/Unknown"))
    old.bus.subscribe_raw("/unknown", old.seen.append)  # whose hash nobody could tell
    humble.close()
    assert endpoint.type_hash == HUMBLE_HASH


def test_wrong_settings_are_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Any) -> None:
    with pytest.raises(WireError, match="ros_distro: expected one of humble, jazzy, kilted, lyrical"):
        ZenohParameters(ros_distro="noetic")
    with pytest.raises(WireError, match="expected auto, builtin or external, found 'none'"):
        ZenohParameters(router="none")
    monkeypatch.setenv("ROS_DOMAIN_ID", "233")
    with pytest.raises(WireError, match="from 0 to 232, found '233'; correct ROS_DOMAIN_ID"):
        _ = ZenohParameters().domain_id
    with pytest.raises(WireError, match=r"from 0 to 232, found '-1'; correct launch: zenoh: \{domain\}"):
        _ = ZenohParameters(domain=-1).domain_id
    (tmp_path / "bad.json5").write_text("{mode: 'starship'}")
    with pytest.raises(WireError, match=r"expected addresses such as tcp/127\.0\.0\.1:7447, found .*nonsense"):
        open_session(ZenohParameters(endpoint="nonsense"))
    with pytest.raises(WireError, match=r"bad\.json5: not a zenoh configuration"):
        open_session(ZenohParameters(config=str(tmp_path / "bad.json5")))


def test_a_topic_that_nobody_knows_is_declared_before_it_is_listened_to() -> None:
    """Its messages would stay within the process: others find a subscriber by the type and the QoS of its topic."""
    wire = LocalWire()
    talker, listener = Side(wire, "talker"), Side(wire, "listener")
    for use in (listener.listen, talker.bus.is_heard, talker.bus.advertise):
        with pytest.raises(
            BusError, match=r"expected to know what /foreign carries, .* declare\('/foreign', TopicKind"
        ):
            use("/foreign")
    listener.bus.declare("/foreign", TopicKind(STRING))
    listener.listen("/foreign")
    talker.bus.publish("/foreign", text("known by its message"))
    assert listener.wait().data == "known by its message"


def test_a_program_ends_that_never_closed_its_wire() -> None:
    """Python waits for the thread that zenoh calls back on before anything that is told by `atexit`."""
    pytest.importorskip("zenoh")
    program = """
from twin_node.bench.graph_run import free_endpoint
from twin_node.runtime.qos import RELIABLE, TopicKind
from twin_node.runtime.zenoh_session import ZenohParameters
from twin_node.runtime.zenoh_wire import ZenohWire
wire = ZenohWire(ZenohParameters(router="external", endpoint=free_endpoint(), domain=0))
wire.subscribe("listener", "/chatter", TopicKind("std_msgs/msg/String", RELIABLE), print)
"""
    assert subprocess.run([sys.executable, "-c", program], check=False, timeout=120).returncode == 0
