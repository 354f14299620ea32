"""Listens to a live graph for a while and says what it found."""

from __future__ import annotations

import difflib
import math
import time
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from twin_node.errors import several
from twin_node.messages import builtin_types, convert, header_stamp
from twin_node.nodes.latency import LONGEST_BRIDGED_NS
from twin_node.nodes.stream_statistics import faults_of, statistics_of
from twin_node.nodes.topics import (
    CLOCK,
    CLOCK_FOLLOWER,
    DIAGNOSTICS,
    IMAGE_TYPES,
    JOINT_STATE,
    RECORDED,
    REGULAR_TYPES,
    STATUS,
    TRAJECTORY,
    kind_of,
    kind_of_own,
)
from twin_node.runtime.clock import FollowedClock
from twin_node.runtime.executor import Executor
from twin_node.runtime.names import full_name, without
from twin_node.runtime.qos import TopicKind
from twin_node.runtime.rmw_zenoh import HUMBLE_HASH, Endpoint, EntityKind
from twin_node.runtime.wire import Encoded, Wire
from twin_node.runtime.wire_bus import WireBus

OF_ONE = (CLOCK, TRAJECTORY, *(topic for topic in RECORDED if topic != DIAGNOSTICS))
"""Topics of which a graph has one publisher: of two, who listens would follow now one and now the other."""
OWN_PACKAGE = "twin_msgs/"
"""What the types of the twin's own nodes begin with."""
CLOCK_TOLERANCE_NS = 20_000_000
"""Stamps that lie so far ahead of their arrival were made by another clock."""
PLAYERS = ("player", "rosbag2_player")
"""Nodes of `twin_node play` and `ros2 bag play`: what they say was stamped when it was recorded."""
LATE_NS = LONGEST_BRIDGED_NS
"""Messages this old when they come are of no use to anybody: another clock, or a link that is overloaded."""
DISCOVERY_S = 0.5
"""Time given to the graph to make itself known, s."""
SILENCE_S = 2.0
"""Who has been listened to for so long, and says something every second, has been heard, s."""


@dataclass(frozen=True)
class Findings:
    """What a doctor has to say."""

    lines: tuple[str, ...]
    faults: tuple[str, ...]


class _Ear:
    """Hears every topic that is published, and keeps when its messages came and how old they were."""

    def __init__(self, wire: Wire, executor: Executor, published: Mapping[str, Endpoint]) -> None:
        self.newest: dict[str, convert.Diagnosis] = {}
        """Diagnosis by its name, with the namespace before it where there is one."""
        self.warnings: dict[str, tuple[str, ...]] = {}
        """What each twin's newest status warns of, by its node."""
        self._published = published
        self._clocks = {t: FollowedClock() for t, end in published.items() if _is_own(t, end.msgtype, CLOCK)}
        """By their topics: those of namespaces may be renamed."""
        self._stamps: dict[str, dict[tuple[str, ...], list[int]]] = defaultdict(lambda: defaultdict(list))
        """Of each topic by the names of the joints that they tell: an arm and its gripper share a topic, each at a rate
        of its own. Of other messages there is one list, without names."""
        self._delays: dict[str, list[int]] = defaultdict(list)
        self._bus = WireBus(wire, executor, "doctor", kind_of)
        for topic, endpoint in published.items():
            if endpoint.msgtype in builtin_types():
                self._bus.declare(topic, TopicKind(endpoint.msgtype, endpoint.qos))
                self._bus.subscribe_raw(topic, partial(self._hear, topic))

    def _hear(self, topic: str, message: Encoded) -> None:
        stamp = time.time_ns()
        if topic in self._clocks:
            self._clocks[topic].set(convert.clock_from_message(message.decode()))
        joints: tuple[str, ...] = ()
        if message.msgtype in REGULAR_TYPES:
            content = message.decode()
            taken = header_stamp(content)
            joints = tuple(content.name) if message.msgtype == JOINT_STATE else ()
            clock = self._clock_of(topic)
            now = stamp if clock is None else self._clocks[clock].now()
            if now:  # the graph's time has been heard
                self._delays[topic].append(now - taken)
            stamp = taken
        self._stamps[topic][joints].append(stamp)
        if _is_own(topic, message.msgtype, DIAGNOSTICS):
            found = convert.diagnostics_from_message(message.decode())
            self.newest |= {_full(one.name, topic.removesuffix(DIAGNOSTICS)): one for one in found}
        elif _is_own(topic, message.msgtype, STATUS):
            self.warnings[_node(self._published[topic])] = convert.status_from_message(message.decode()).warnings

    def line(self, topic: str, width: int) -> str:
        """How often a topic was heard, how old its messages were, and what they are.

        Of joints that several devices tell the rate is of those that come most often.
        """
        streams, delays = self._stamps[topic].values(), self._delays[topic]
        statistics, count = statistics_of(max(streams, key=len, default=[])), sum(map(len, streams))
        rate = f"{statistics.rate_hz:8.2f} Hz" if math.isfinite(statistics.rate_hz) else ""
        lag = f"  {np.median(delays) / 1e6:6.1f} ms old" if delays else ""
        return f"{topic:{width}}  {count:6d}  {rate:>11}{lag}  {self._published[topic].msgtype}"

    def faults(self, topic: str) -> list[str]:
        """What is wrong with when a topic's messages come and were made."""
        if self._published[topic].msgtype not in REGULAR_TYPES:
            return []
        streams = self._stamps[topic]
        irregular = [
            f"{topic}: {', '.join(joints)}: {fault}" if len(streams) > 1 else f"{topic}: {fault}"
            for joints, stamps in streams.items()
            for fault in faults_of(statistics_of(stamps))
        ]
        return irregular + _clock_faults(self._published[topic], self._delays[topic], self._clock_of(topic))

    def _clock_of(self, topic: str) -> str | None:
        """Topic of the clock that a topic's publisher goes by, its namespace's or that of all; None: there is none."""
        own = full_name(CLOCK.strip("/"), self._published[topic].node.namespace)
        return next((clock for clock in (own, CLOCK) if clock in self._clocks), None)

    def has_heard(self, node: str, topics: Sequence[str]) -> bool:
        """Whether anything came of what a node publishes; diagnoses are of many nodes, and begin with their names."""
        others = any(self._stamps[topic] for topic in topics if not self._are_diagnoses(topic))
        return others or any(name.startswith(f"{node}:") for name in self.newest)

    def _are_diagnoses(self, topic: str) -> bool:
        return _is_own(topic, self._published[topic].msgtype, DIAGNOSTICS)

    def close(self) -> list[str]:
        """Hears no more; topics whose messages could not be read."""
        unreadable = [t for t in self._bus.traffic if t.unreadable]
        self._bus.close()
        return [
            f"{t.topic}: {several(t.unreadable, 'message')} cannot be read, the last: {t.last_error}"
            for t in unreadable
        ]


def examine(wire: Wire, seconds: float) -> Findings:
    """Listens to every topic of the graph for `seconds`."""
    executor = Executor()
    _spin(executor, wire, DISCOVERY_S)
    endpoints = [endpoint for endpoint in wire.endpoints() if endpoint.node.name != "doctor"]
    published = {e.topic: e for e in endpoints if e.kind is EntityKind.PUBLISHER}
    nodes = {topic: " and ".join(_publishers([e for e in endpoints if e.topic == topic])) for topic in published}
    ear = _Ear(wire, executor, published)
    _spin(executor, wire, seconds)
    lines, faults = [], graph_faults(endpoints)
    if not endpoints:
        faults.append("nobody is there: start a graph ('twin_node launch'), or check the router and ROS_DOMAIN_ID")
    width = max((len(topic) for topic in published), default=0)
    for topic in sorted(published):
        lines.append(f"{ear.line(topic, width)} of {nodes[topic]}")
        faults += ear.faults(topic)
    faults += ear.close() + (_silent(ear, endpoints) if seconds >= SILENCE_S else [])
    bad = [(name, d) for name, d in ear.newest.items() if d.level is not convert.Level.OK]
    faults += [f"{name}: {d.level.name}: {d.message}" for name, d in bad]
    faults += [f"{node}: WARN: {warning}" for node, warnings in sorted(ear.warnings.items()) for warning in warnings]
    return Findings(tuple(lines), tuple(faults))


def _spin(executor: Executor, wire: Wire, seconds: float) -> None:
    wire.endpoints()
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        executor.step(max(0.0, until - time.monotonic()))


def graph_faults(endpoints: Sequence[Endpoint]) -> list[str]:
    """Topics whose ends cannot hear each other, that somebody waits for in vain, or that two say who must agree."""
    faults: list[str | None] = []
    for topic, is_service in sorted({(endpoint.topic, _is_of_service(endpoint)) for endpoint in endpoints}):
        ends = [end for end in endpoints if end.topic == topic and _is_of_service(end) is is_service]
        faults += [_type_fault(topic, ends) or _silence_fault(topic, ends, endpoints), _rivalry_fault(topic, ends)]
    return [fault for fault in faults if fault is not None]


def _silent(ear: _Ear, endpoints: Sequence[Endpoint]) -> list[str]:
    """Nodes that are to say something all the time, of which nothing comes.

    They are in the graph for ten seconds more after a link is cut.
    """
    said: dict[str, list[str]] = defaultdict(list)
    for end in endpoints:
        if end.kind is EntityKind.PUBLISHER:
            said[_node(end)].append(end.topic)
    regular = {
        end.topic for end in endpoints if end.msgtype in REGULAR_TYPES or _is_own(end.topic, end.msgtype, DIAGNOSTICS)
    }
    return [
        f"{node}: nothing comes of all that it publishes ({', '.join(sorted(topics))}); it hangs or waits, or its "
        "machine, or the link to it, has failed"
        for node, topics in sorted(said.items())
        if not regular.isdisjoint(topics) and not ear.has_heard(node, topics)
    ]


def _is_of_service(end: Endpoint) -> bool:
    """Whether this is an end of a service, which may have a topic's name."""
    return end.kind in (EntityKind.SERVICE, EntityKind.CLIENT)


def _is_own(topic: str, msgtype: str, own: str) -> bool:
    """Whether a topic of the graph is one of the graph's own, in whatever namespace."""
    return topic.endswith(own) and msgtype == kind_of_own(own).msgtype


def _node(end: Endpoint) -> str:
    """A node's name as it is told: with its namespace where it is in one."""
    return _full(end.node.name, end.node.namespace)


def _full(name: str, namespace: str) -> str:
    return full_name(name, namespace) if namespace.strip("/") else name


def _type_fault(topic: str, ends: Sequence[Endpoint]) -> str | None:
    """What keeps the ends of a topic from hearing each other; None: nothing does."""
    if len({(end.msgtype, end.type_hash) for end in ends}) == 1:
        return None
    names = "; ".join(sorted(f"{_node(e)}: {e.msgtype} {e.type_hash[:15]}" for e in ends))
    is_humble = any(e.type_hash == HUMBLE_HASH for e in ends)
    why = "ros_distro differs" if is_humble else "their types differ"
    advice = "set ROS_DISTRO, or launch: zenoh: {ros_distro}" if is_humble else "build them from the same definitions"
    return f"{topic}: {why}, so they do not hear each other ({names}); {advice}"


def _silence_fault(topic: str, ends: Sequence[Endpoint], endpoints: Sequence[Endpoint]) -> str | None:
    """Who waits in vain for a topic that nobody publishes; None: nobody does."""
    if any(end.kind is EntityKind.PUBLISHER for end in ends):
        return None
    if _is_needed(ends[0].msgtype):
        return _waited_for(ends, endpoints)
    if any(end.node.name == CLOCK_FOLLOWER for end in ends):
        return (
            f"{topic}: nodes take their time from it (use_sim_time), nobody publishes it, so time stands; play a log "
            "with --clock, or launch without use_sim_time"
        )
    return None


def _rivalry_fault(topic: str, ends: Sequence[Endpoint]) -> str | None:
    """Who publish a topic that only one may; None: one, or it may be several."""
    said_by = _publishers(ends)
    msgtype = ends[0].msgtype
    if len(said_by) < 2 or not (msgtype in IMAGE_TYPES or any(_is_own(topic, msgtype, own) for own in OF_ONE)):
        return None
    return f"{topic}: {' and '.join(said_by)} publish it, and contradict each other; end all but one"


def _publishers(ends: Sequence[Endpoint]) -> list[str]:
    """Names of the publishers among a topic's ends; two nodes of one name stand there twice."""
    by_node = {(e.node.session, e.node.number): e for e in ends if e.kind is EntityKind.PUBLISHER}
    return sorted(map(_node, by_node.values()))


def _is_needed(msgtype: str) -> bool:
    """Whether who listens cannot do without: images, and what the twin's own nodes say; joints and paths are extras."""
    return msgtype in IMAGE_TYPES or msgtype.startswith(OWN_PACKAGE)


def _waited_for(waiting: Sequence[Endpoint], endpoints: Sequence[Endpoint]) -> str:
    topic, msgtype = waiting[0].topic, waiting[0].msgtype
    listened = {e.topic for e in endpoints if e.kind is EntityKind.SUBSCRIBER}
    spare = [
        e.topic
        for e in endpoints
        if e.kind is EntityKind.PUBLISHER and e.msgtype == msgtype and e.topic not in listened
    ]
    near = difflib.get_close_matches(topic, spare, n=1, cutoff=0.0)
    own = without(waiting[0].node.namespace, topic) or topic
    on_zenoh = "" if msgtype.startswith(OWN_PACKAGE) else " (a ROS 2 node: on rmw_zenoh_cpp)"
    advice = f"launch with --remap {own}:={near[0]}?" if near else f"start who publishes {msgtype}{on_zenoh}"
    names = sorted(set(map(_node, waiting)))
    wait = "waits" if len(names) == 1 else "wait"
    return f"{topic}: {' and '.join(names)} {wait} for it, nobody publishes it; {advice}"


def _clock_faults(publisher: Endpoint, delays: Sequence[int], clock: str | None) -> list[str]:
    """What speaks for another clock; `delays`: from the stamp to the arrival here, by the graph's `clock`, ns."""
    if not delays or -CLOCK_TOLERANCE_NS < np.median(delays) < LATE_NS:
        return []
    seconds, node = float(np.median(delays)) / 1e9, _node(publisher)
    lag = f"{publisher.topic}: stamped {-seconds:+.2f} s from its arrival"
    if clock is not None:
        return [f"{lag} by {clock}: {node} does not take its time from there; launch it with use_sim_time"]
    if publisher.node.name in PLAYERS:
        return [f"{lag}, when it was recorded; play the log with --clock, and launch with use_sim_time"]
    held_up = "look for what holds it up, or " if seconds > 0 else ""
    return [f"{lag}; {held_up}let chrony or PTP keep the machines' clocks together"]
