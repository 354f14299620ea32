"""What the doctor says of a graph whose ends do not meet."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
import pytest

from twin_node.messages import builtin_types, convert, message_type
from twin_node.nodes.live import doctor
from twin_node.nodes.live.doctor import examine, graph_faults
from twin_node.nodes.topics import CLOCK, COMPRESSED, DIAGNOSTICS, JOINT_STATES, RAW, SEPARATION, STATUS
from twin_node.runtime.qos import LATCHED, RELIABLE, TopicKind
from twin_node.runtime.rmw_zenoh import HUMBLE_HASH, Endpoint, EntityKind, NodeIdentity
from twin_node.runtime.wire import Encoded, LocalWire
from twin_node.scene import JointSample


def end(kind: EntityKind, node: str, topic: str, msgtype: str, type_hash: str = "RIHS01_aa") -> Endpoint:
    return Endpoint(kind, NodeIdentity("ab", 0, node), 1, topic, msgtype, type_hash, RELIABLE)


def of_another_session(endpoint: Endpoint) -> Endpoint:
    return replace(endpoint, node=replace(endpoint.node, session="cd"))


def publisher(node: str, topic: str, msgtype: str = RAW, type_hash: str = "RIHS01_aa") -> Endpoint:
    return end(EntityKind.PUBLISHER, node, topic, msgtype, type_hash)


def subscriber(node: str, topic: str, msgtype: str = RAW, type_hash: str = "RIHS01_aa") -> Endpoint:
    return end(EntityKind.SUBSCRIBER, node, topic, msgtype, type_hash)


def test_ends_that_meet_are_no_fault_and_extras_may_be_missing() -> None:
    ends = [publisher("cameras", "/a/image_raw"), subscriber("synchronizer", "/a/image_raw")]
    assert graph_faults([*ends, subscriber("arm", JOINT_STATES, "sensor_msgs/msg/JointState")]) == []


def test_an_image_that_is_waited_for_is_named_with_the_remap_that_brings_it() -> None:
    ends = [
        subscriber("synchronizer", "/front/image_raw"),
        publisher("cameras", "/front_camera/image_raw"),
        publisher("cameras", "/front/image_raw/compressed", COMPRESSED),
        publisher("cameras", "/left/image_raw"),
        subscriber("synchronizer", "/left/image_raw"),
    ]
    assert graph_faults(ends) == [
        "/front/image_raw: synchronizer waits for it, nobody publishes it; launch with --remap "
        "/front/image_raw:=/front_camera/image_raw?"
    ]
    assert graph_faults(ends[:1]) == [
        f"/front/image_raw: synchronizer waits for it, nobody publishes it; start who publishes {RAW} "
        "(a ROS 2 node: on rmw_zenoh_cpp)"
    ]
    others = [subscriber(node, SEPARATION, "twin_msgs/msg/SeparationState") for node in ("arm", "viewer")]
    assert graph_faults(others) == [
        f"{SEPARATION}: arm and viewer wait for it, nobody publishes it; start who publishes "
        "twin_msgs/msg/SeparationState"
    ]


def test_ends_that_cannot_hear_each_other_are_told_what_to_set() -> None:
    humble = publisher("driver", "/a/image_raw", type_hash=HUMBLE_HASH)
    assert "ros_distro differs" in graph_faults([humble, subscriber("synchronizer", "/a/image_raw")])[0]
    other = publisher("driver", "/a/image_raw", COMPRESSED)
    assert "their types differ" in graph_faults([other, subscriber("synchronizer", "/a/image_raw")])[0]


def test_a_service_that_has_a_topic_s_name_is_not_another_end_of_it() -> None:
    """As `/arm/acknowledge` of our own driver."""
    trigger = "std_srvs/srv/Trigger"
    topic = subscriber("ur_driver", "/arm/acknowledge", "std_msgs/msg/Empty")
    service = end(EntityKind.SERVICE, "ur_driver", "/arm/acknowledge", trigger, "RIHS01_bb")
    assert graph_faults([topic, service]) == []
    client = end(EntityKind.CLIENT, "panel", "/arm/acknowledge", trigger, "RIHS01_cc")
    assert graph_faults([topic, service, client]) == [
        f"/arm/acknowledge: their types differ, so they do not hear each other (panel: {trigger} RIHS01_cc; "
        f"ur_driver: {trigger} RIHS01_bb); build them from the same definitions"
    ]


@pytest.mark.parametrize(
    ("topic", "msgtype", "is_fault"),
    [
        (CLOCK, "rosgraph_msgs/msg/Clock", True),
        (SEPARATION, "twin_msgs/msg/SeparationState", True),
        ("/front/image_raw", RAW, True),
        (DIAGNOSTICS, "diagnostic_msgs/msg/DiagnosticArray", False),
        (JOINT_STATES, "sensor_msgs/msg/JointState", False),
    ],
)
def test_two_who_say_what_one_is_to_say_are_named(topic: str, msgtype: str, is_fault: bool) -> None:
    """Two players' clocks jump to and fro, two arms' decisions are obeyed in turn; who listens cannot tell."""
    first = publisher("first", topic, msgtype)
    for second in (of_another_session(first), of_another_session(publisher("second", topic, msgtype))):
        told = [f"{topic}: first and {second.node.name} publish it, and contradict each other; end all but one"]
        assert graph_faults([first, second, subscriber("listener", topic, msgtype)]) == (told if is_fault else [])
    assert graph_faults([first, subscriber("listener", topic, msgtype)]) == []


def in_namespace(endpoint: Endpoint, namespace: str) -> Endpoint:
    """Whose topics are as told; the node of `/cell` alone is in it."""
    return replace(endpoint, node=replace(endpoint.node, namespace=namespace))


def test_nodes_of_two_namespaces_are_no_rivals_and_those_of_one_are() -> None:
    msgtype = "twin_msgs/msg/SeparationState"
    a, b = (in_namespace(publisher("arm", f"/{name}{SEPARATION}", msgtype), f"/{name}") for name in "ab")
    assert graph_faults([a, b]) == []
    again = of_another_session(in_namespace(publisher("other", a.topic, msgtype), "/a"))
    assert graph_faults([a, b, again]) == [
        f"/a{SEPARATION}: /a/arm and /a/other publish it, and contradict each other; end all but one"
    ]


def test_a_camera_outside_the_namespace_is_brought_in_by_a_remap_of_the_name_within_it() -> None:
    waits = in_namespace(subscriber("synchronizer", "/cell/front/image_raw"), "/cell")
    assert graph_faults([waits, publisher("cameras", "/front/image_raw")]) == [
        "/cell/front/image_raw: /cell/synchronizer waits for it, nobody publishes it; launch with --remap "
        "/front/image_raw:=/front/image_raw?"
    ]


def test_what_nodes_of_two_namespaces_say_of_themselves_is_told_apart(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor, "DISCOVERY_S", 0.0)
    msgtype, wire, ends = "diagnostic_msgs/msg/DiagnosticArray", LocalWire(), []
    for name, level in (("a", convert.Level.OK), ("b", convert.Level.ERROR)):
        topic = f"/{name}{DIAGNOSTICS}"
        message = convert.diagnostics_to_message(1, [convert.Diagnosis("arm: joints", level, "none")])
        wire.publisher("arm", topic, TopicKind(msgtype, LATCHED))(message)
        ends.append(replace(in_namespace(publisher("arm", topic, msgtype), f"/{name}"), qos=LATCHED))
    ends.append(replace(in_namespace(publisher("twin", ends[0].topic, msgtype), "/a"), qos=LATCHED))
    wire.endpoints = lambda: tuple(ends)  # type: ignore[method-assign]
    assert examine(wire, 0.5).faults == ("/b/arm: joints: ERROR: none",)
    monkeypatch.setattr(doctor, "SILENCE_S", 0.5)
    assert examine(wire, 0.5).faults[0].startswith("/a/twin: nothing comes of all that it publishes (/a/diagnostics)")


def test_topics_of_other_programs_that_only_end_alike_are_theirs(monkeypatch: pytest.MonkeyPatch) -> None:
    """What an engine calls diagnostics may be a text."""
    monkeypatch.setattr(doctor, "DISCOVERY_S", 0.0)
    msgtype, wire, topic = "std_msgs/msg/String", LocalWire(), f"/engine{DIAGNOSTICS}"
    wire.publisher("engine", topic, TopicKind(msgtype, LATCHED))(message_type(msgtype)(data="warm"))
    ends = [replace(publisher("engine", topic, msgtype), qos=LATCHED)]
    wire.endpoints = lambda: tuple(ends)  # type: ignore[method-assign]
    assert examine(wire, 0.05).faults == ()
    first = publisher("first", f"/engine{SEPARATION}", msgtype)
    assert graph_faults([first, of_another_session(replace(first, number=2))]) == []


def test_a_graph_whose_time_stands_is_told() -> None:
    follower = subscriber("clock", "/player/clock", "rosgraph_msgs/msg/Clock")  # renamed, perhaps
    [fault] = graph_faults([follower])
    assert fault.startswith("/player/clock: nodes take their time from it (use_sim_time), nobody publishes it")
    assert graph_faults([follower, publisher("player", "/player/clock", "rosgraph_msgs/msg/Clock")]) == []
    assert graph_faults([subscriber("viewer", CLOCK, "rosgraph_msgs/msg/Clock")]) == []  # it has a time of its own


class DamagedCamera(LocalWire):
    """A graph with one publisher, which sends half of an image as soon as somebody listens."""

    def endpoints(self) -> tuple[Endpoint, ...]:
        self.publisher("cameras", "/a/image_raw", TopicKind(RAW))(Encoded(RAW, b"\0\1\0\0\7"))
        return (publisher("cameras", "/a/image_raw"),)


def test_messages_that_cannot_be_read_are_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor, "DISCOVERY_S", 0.0)
    found = examine(DamagedCamera(), 0.05)
    assert any(
        "/a/image_raw: 1 message cannot be read, the last: sensor_msgs/msg/Image: 5 bytes" in f for f in found.faults
    )


def told_of_stamps(*said: tuple[str, str, int]) -> list[str]:
    """What is found in a graph in which node, topic and stamp are all that is said, of a clock or of joints."""
    wire, ends = LocalWire(), []
    for node, topic, stamp in said:
        if topic.endswith(CLOCK):
            message = convert.clock_to_message(stamp)
        else:
            message = convert.joint_sample_to_message(JointSample(stamp, ("a",), np.zeros(1), np.zeros(1)))
        msgtype = message.__msgtype__
        namespace, name = node.rsplit("/", 1) if "/" in node else ("/", node)
        ends.append(replace(in_namespace(publisher(name, topic, msgtype), namespace), qos=LATCHED))
        wire.publisher(node, topic, TopicKind(msgtype, LATCHED))(
            Encoded(msgtype, bytes(builtin_types().serialize(message)))
        )
    wire.endpoints = lambda: tuple(ends)  # type: ignore[method-assign]
    return list(examine(wire, 0.05).faults)


def test_stamps_of_a_log_that_is_played_are_no_fault_of_this_computers_clock(monkeypatch: pytest.MonkeyPatch) -> None:
    """chrony was blamed, and with --clock too."""
    monkeypatch.setattr(doctor, "DISCOVERY_S", 0.0)
    recorded, now = 1_700_000_000_000_000_000, time.time_ns()
    monkeypatch.setattr(time, "time_ns", lambda: now)
    [fault] = told_of_stamps(("player", JOINT_STATES, recorded))
    assert fault.endswith(
        "from its arrival, when it was recorded; play the log with --clock, and launch with use_sim_time"
    )
    [fault] = told_of_stamps(("driver", JOINT_STATES, recorded))
    assert fault.endswith("let chrony or PTP keep the machines' clocks together")
    assert told_of_stamps(("driver", JOINT_STATES, now)) == []
    assert told_of_stamps(("player", CLOCK, recorded), ("player", JOINT_STATES, recorded)) == []
    [fault] = told_of_stamps(("player", CLOCK, recorded), ("driver", JOINT_STATES, now))
    assert fault.endswith(
        "from its arrival by /clock: driver does not take its time from there; launch it with use_sim_time"
    )


def test_each_namespace_may_have_a_clock_of_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    """Stamps by `/cell/clock` were told to be of another time, and to launch as it had been launched."""
    monkeypatch.setattr(doctor, "DISCOVERY_S", 0.0)
    recorded, now = 1_700_000_000_000_000_000, time.time_ns()
    monkeypatch.setattr(time, "time_ns", lambda: now)
    clock, played = ("/cell/player", "/cell/clock", recorded), ("/cell/player", "/cell/joint_states", recorded)
    assert told_of_stamps(clock, played, ("driver", JOINT_STATES, now)) == []
    assert told_of_stamps((clock[0], CLOCK, recorded), played) == [], "that of all where it has none"
    [fault] = told_of_stamps(clock, ("/cell/driver", "/cell/joint_states", now))
    assert "from its arrival by /cell/clock: /cell/driver does not take its time from there" in fault


@pytest.mark.parametrize(
    ("behind_s", "found"),
    [
        (0.5, "stamped -0.50 s from its arrival; look for what holds it up, or let chrony"),
        (-0.05, "stamped +0.05 s from its arrival; let chrony"),
    ],
)
def test_stamps_for_which_an_arm_stands_are_told(monkeypatch: pytest.MonkeyPatch, behind_s: float, found: str) -> None:
    """Up to a second behind, all was sound but for the arm, which stood."""
    monkeypatch.setattr(doctor, "DISCOVERY_S", 0.0)
    now = time.time_ns()
    monkeypatch.setattr(time, "time_ns", lambda: now)
    [fault] = told_of_stamps(("driver", JOINT_STATES, now - round(behind_s * 1e9)))
    assert found in fault


def test_devices_that_tell_their_joints_on_one_topic_are_judged_each_by_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two that are sound, side by side, were said to run backwards and to jitter."""
    monkeypatch.setattr(doctor, "DISCOVERY_S", 0.0)
    now = time.time_ns()
    monkeypatch.setattr(time, "time_ns", lambda: now)
    wire, qos = LocalWire(), replace(LATCHED, depth=100)
    kind = TopicKind("sensor_msgs/msg/JointState", qos)

    def say(node: str, joint: str, period_ms: float, begun_ms: float) -> None:
        send = wire.publisher(node, JOINT_STATES, kind)
        for number in range(20):
            stamp = now + round(1e6 * (begun_ms + period_ms * number))
            send(convert.joint_sample_to_message(JointSample(stamp, (joint,), np.zeros(1), np.zeros(1))))

    say("arm", "elbow", 8, -170)
    say("gripper", "finger", 8, -169)
    ends = [replace(publisher(node, JOINT_STATES, kind.msgtype), qos=qos) for node in ("arm", "gripper")]
    wire.endpoints = lambda: tuple(ends)  # type: ignore[method-assign]
    found = examine(wire, 0.05)
    assert found.faults == ()
    assert "    40    125.00 Hz" in found.lines[0]
    say("axis", "rail", -8, -10)
    assert examine(wire, 0.05).faults == (f"{JOINT_STATES}: rail: 19 stamps run backwards",)


def test_nodes_of_which_nothing_comes_are_told(monkeypatch: pytest.MonkeyPatch) -> None:
    """After the link to the twin's machine was cut the graph was sound for ten seconds."""
    monkeypatch.setattr(doctor, "DISCOVERY_S", 0.0)
    diagnostics = "diagnostic_msgs/msg/DiagnosticArray"
    wire = LocalWire()
    message = convert.diagnostics_to_message(1, [convert.Diagnosis("arm: messages", convert.Level.OK, "")])
    wire.publisher("arm", DIAGNOSTICS, TopicKind(diagnostics, LATCHED))(message)
    ends = [replace(publisher(node, DIAGNOSTICS, diagnostics), qos=LATCHED) for node in ("arm", "twin")]
    ends += [publisher("cell", "/a/image_raw"), publisher("tf", "/tf_static", "tf2_msgs/msg/TFMessage")]
    wire.endpoints = lambda: tuple(ends)  # type: ignore[method-assign]
    assert examine(wire, 0.05).faults == ()  # too short to tell
    monkeypatch.setattr(doctor, "SILENCE_S", 0.05)
    cell, twin = examine(wire, 0.05).faults
    assert cell.startswith("cell: nothing comes of all that it publishes (/a/image_raw); it hangs or waits")
    assert twin.startswith("twin: nothing comes of all that it publishes (/diagnostics)")


def test_what_the_twins_status_warns_of_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """Beside a twin that says it is not to be trusted all was sound, and the arm's node says to look at that status."""
    monkeypatch.setattr(doctor, "DISCOVERY_S", 0.0)
    kind, wire, ends = TopicKind("twin_msgs/msg/TwinStatus", LATCHED), LocalWire(), []
    for name, warnings in (("a", ["model: it looks like a ur10e", "light: too dark"]), ("b", [])):
        topic = f"/{name}{STATUS}"
        send = wire.publisher("twin", topic, kind)
        send(convert.status_to_message(convert.Status(1, (0,) * 5, 0, 1, 0, warnings=tuple(warnings))))
        ends.append(replace(in_namespace(publisher("twin", topic, str(kind.msgtype)), f"/{name}"), qos=LATCHED))
    monkeypatch.setattr(wire, "endpoints", lambda: tuple(ends))
    told = ("/a/twin: WARN: model: it looks like a ur10e", "/a/twin: WARN: light: too dark")
    assert examine(wire, 0.5).faults == told
