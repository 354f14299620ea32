"""Plays a log to a live graph as `ros2 bag play` does: at its pace, with its clock, again and again where asked."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from twin_node.bag import LogMessage, LogReader, Topic, open_log
from twin_node.bag.latched import is_of_several, standing_before
from twin_node.messages import convert
from twin_node.nodes.live.own_thread import OwnThread
from twin_node.nodes.live.read_ahead import LONGEST_WAIT_S, read_ahead
from twin_node.nodes.live.setup import Setup
from twin_node.nodes.player import Span, span_of
from twin_node.nodes.topics import (
    ACKNOWLEDGE,
    CLOCK,
    FOLLOW,
    GraphError,
    absolute,
    is_topic_name,
    kind_of,
    kind_of_own,
    parse_remaps,
)
from twin_node.ranges import NOT_NEGATIVE, Range, check_ranges
from twin_node.runtime.node import Node
from twin_node.runtime.qos import LATCHED, LATCHED_BY_SEVERAL, RELIABLE, Qos, TopicKind
from twin_node.runtime.wire import Encoded
from twin_node.runtime.wire_bus import WireBus

SPEEDS = Range(1e-3, 1e6)
"""Against that of the recording: nothing is seen to move below, and above it takes no time."""
CLOCK_RATES = Range(1e-3, 1e6)
"""Of `/clock`, Hz: beyond, times between two ticks are none that nanoseconds can tell."""
DELAYS = Range(0, 86_400)
"""Up to a day, s."""
ORDERS = (FOLLOW, ACKNOWLEDGE)
"""What sets an arm going that its driver holds still: only who asks for them by name gives them again."""
_ORDER = "which an arm on this graph would obey; name it with --topics ('topics') to have it played"


@dataclass(frozen=True)
class PlayParameters:
    """The flags of `ros2 bag play`, under their names."""

    log: str = ""
    rate: float = 1.0
    """Speed against that of the recording."""
    loop: bool = False
    start_offset: float = 0.0
    """Seconds from the log's start to begin at."""
    playback_duration: float = 0.0
    """Seconds to play; 0: to the end."""
    delay: float = 0.0
    """Seconds to wait before the first message."""
    clock: float = 0.0
    """Rate of `/clock`, Hz; 0: none is published."""
    topics: tuple[str, ...] = ()
    """Topics to play; none given: all."""
    remap: tuple[str, ...] = ()
    """`FROM:=TO` pairs, of the log's topics and of the `/clock` that is published."""
    start_paused: bool = False
    read_ahead_queue_size: int = 1000
    """Messages read before they are due, of 256 MiB together at most."""

    def __post_init__(self) -> None:
        """Raises `GraphError` for a number that cannot be."""
        lengths = {"start_offset": NOT_NEGATIVE, "playback_duration": NOT_NEGATIVE}
        check_ranges(self, GraphError, "play: ", rate=SPEEDS, delay=DELAYS, **lengths)
        if self.clock:
            check_ranges(self, GraphError, "play: ", clock=CLOCK_RATES)
        if self.read_ahead_queue_size < 1:
            raise GraphError(f"play: read_ahead_queue_size: expected 1 or more, found {self.read_ahead_queue_size}")


def make_player(setup: Setup) -> Node:
    """A player of the log that its parameters name."""
    return PlayNode(setup, setup.parameters(PlayParameters))


class PlayNode(Node):
    """Two threads: one reads ahead, one publishes each message when it is due, undecoded.

    Raises `BagError` for a log that cannot be read, `GraphError` for topics that it does not hold.
    """

    def __init__(self, setup: Setup, parameters: PlayParameters) -> None:
        super().__init__(setup.name, setup.bus, setup.clock)
        if not parameters.log:
            raise GraphError(f"{setup.where}: {setup.name}: expected 'log', the file or folder to play; give log:=LOG")
        self._parameters = parameters
        self._finish = setup.finish
        self._log: LogReader = open_log(Path(parameters.log))
        self._clock_topic = parse_remaps(list(parameters.remap)).get(CLOCK, CLOCK)
        self._names = _names(self._log, parameters, setup.say)
        self._span: Span = span_of(self._log, parameters.start_offset, parameters.playback_duration or None)
        self._bus: WireBus = setup.bus
        self._time = _LogTime(parameters.rate, parameters.start_paused)
        self._stop = threading.Event()
        self._thread = OwnThread("player", self._play, setup.finish)
        self.published = 0

    @property
    def is_paused(self) -> bool:
        """Whether time stands."""
        return self._time.is_paused

    def pause(self, paused: bool) -> None:
        """Let time stand, or go on."""
        self._time.pause(paused)

    def on_configure(self) -> None:
        for topic in self._log.topics:
            if topic.name in self._names:
                type_hash = self._log.types_of(topic.name).type_hash(topic.msgtype)
                kind = TopicKind(topic.msgtype, _latched(topic.name) if topic.latched else RELIABLE, type_hash)
                self._bus.declare(self._names[topic.name], kind)
                self._bus.advertise(self._names[topic.name])
        if self._parameters.clock:
            self._bus.declare(self._clock_topic, kind_of_own(CLOCK))
            self._bus.advertise(self._clock_topic)

    def on_activate(self) -> None:
        self._stop.clear()
        self._thread.start()

    def on_deactivate(self) -> None:
        self._stop.set()
        self._thread.join()

    def on_cleanup(self) -> None:
        """Raises what ended the playing before its time."""
        self._log.close()
        self._thread.check()

    def diagnoses(self) -> tuple[convert.Diagnosis, ...]:
        """How far it is."""
        readings = (convert.Reading("messages", str(self.published)),)
        text = "paused" if self.is_paused else "playing"
        level = convert.Level.OK
        if self._log.damage:
            text, level = self._log.damage, convert.Level.WARN
        return (convert.Diagnosis(f"{self.name}: {self._parameters.log}", level, text, readings),)

    def _play(self) -> None:
        self._stop.wait(self._parameters.delay)
        while not self._stop.is_set():
            before = self.published
            self._play_once()
            if not self._parameters.loop or self.published == before:  # nothing, again and again, has no end
                break
        self._finish()

    def _play_once(self) -> None:
        self._publish_standing()
        self._time.start(self._span.start_ns)
        next_clock = self._span.start_ns
        period = int(1e9 / self._parameters.clock) if self._parameters.clock > 0 else 0
        for message in read_ahead(self._messages(), self._parameters.read_ahead_queue_size, self._stop):
            while period and next_clock <= message.stamp:
                if not self._wait_until(next_clock):
                    return
                self._bus.publish(self._clock_topic, convert.clock_to_message(next_clock))
                next_clock += period
            if not self._wait_until(message.stamp):
                return
            name = self._names[message.topic]
            self._bus.publish(name, Encoded(message.msgtype, message.data, message.types))
            self.published += 1

    def _publish_standing(self) -> None:
        """What latched topics said before the part that is played: transforms are said once, at a log's start."""
        types = {topic.name: topic.msgtype for topic in self._log.topics if topic.latched and topic.name in self._names}
        for source, standing in standing_before(self._log, types, self._span.start_ns).items():
            for data in standing:
                self._bus.publish(self._names[source], Encoded(types[source], data, self._log.types_of(source)))

    def _messages(self) -> Iterator[LogMessage]:
        yield from self._log.messages(list(self._names), self._span.start_ns, self._span.stop_ns)

    def _wait_until(self, stamp: int) -> bool:
        """Waits for log time `stamp`, ns; False where the player is to stop."""
        while not self._stop.is_set():
            left = self._time.seconds_until(stamp)
            if left <= 0:
                return True
            self._stop.wait(min(left, LONGEST_WAIT_S))
        return False


def _latched(topic: str) -> Qos:
    """Of a topic that the log says is latched: as the graph's own has it, which may soon come anew."""
    own = kind_of(topic)
    if own is not None and own.qos.latched:
        return own.qos
    return LATCHED_BY_SEVERAL if is_of_several(topic) else LATCHED


class _LogTime:
    """Log time that runs at a rate, and stands while paused."""

    def __init__(self, rate: float, is_paused: bool) -> None:
        self._rate = rate
        self._begun = (0, time.monotonic_ns())
        """A log time and when it was, by the monotonic clock, ns each: one value, for one thread plays as another
        pauses."""
        self.is_paused = is_paused

    def start(self, stamp: int) -> None:
        self._begun = stamp, time.monotonic_ns()

    def pause(self, paused: bool) -> None:
        self._begun = self._now(), time.monotonic_ns()
        self.is_paused = paused

    def seconds_until(self, stamp: int) -> float:
        """Wall seconds until a log time, ns; while time stands, longer than anybody waits at once."""
        if self.is_paused:
            return LONGEST_WAIT_S
        return (stamp - self._now()) / (1e9 * self._rate)

    def _now(self) -> int:
        stamp, at = self._begun
        return stamp + (0 if self.is_paused else int((time.monotonic_ns() - at) * self._rate))


def _names(log: LogReader, parameters: PlayParameters, say: Callable[[str], None]) -> dict[str, str]:
    """The log's topics to play -> the names they are published under, a slash before those that have none.

    A topic whose type is defined nowhere, or whose name can be none on the graph, cannot be told to others: it is left
    out, and said, unless it is asked for. So is one that would have another's name, and what was an order to an arm:
    one that is driven on this graph would obey it again.
    """
    held: dict[str, Topic] = {}
    twice = [topic for topic in log.topics if held.setdefault(absolute(topic.name), topic) is not topic]
    remaps = parse_remaps(list(parameters.remap))
    asked = [absolute(topic) for topic in parameters.topics]
    for name in (*asked, *(name for name in remaps if name != CLOCK or not parameters.clock)):
        if name not in held:
            raise GraphError(f"{log.path}: has no topic {name}; it holds {', '.join(sorted(held))}")
    unfit = _unfit(log, held, remaps)
    orders = {name: _ORDER for name in held if remaps.get(name, name) in ORDERS and name not in asked}
    for name in asked:
        if name in unfit:
            raise GraphError(
                f"{log.path}: expected topics that can be played, found {name}, {unfit[name]}; leave it out"
            )
    for topic in twice:
        if not asked or absolute(topic.name) in asked:
            say(f"not played: {topic.name}, for {held[absolute(topic.name)].name} is played under that name")
    if not asked:
        left_out = orders | unfit
        for line in (*(f"{name}, {left_out[name]}" for name in sorted(left_out)), *log.left_out):
            say(f"not played: {line}")
    free = held.keys() - unfit.keys() - orders.keys() - ({CLOCK} if parameters.clock else set())
    names = {held[name].name: remaps.get(name, name) for name in asked or sorted(free)}
    clock = remaps.get(CLOCK, CLOCK)
    if parameters.clock and clock in names.values():
        played = next(own for own, name in names.items() if name == clock)
        raise GraphError(
            f"{log.path}: expected a name for the clock that no topic of the log has, found {clock}, as which {played} "
            f"is to be played; leave that out, or remap {CLOCK} to another"
        )
    _check_types(log, names)
    return names


def _unfit(log: LogReader, held: Mapping[str, Topic], remaps: Mapping[str, str]) -> dict[str, str]:
    """Topics that cannot be told to others, and why."""
    found: dict[str, str] = {}
    for name, topic in held.items():
        if not is_topic_name(remaps.get(name, name)):
            found[name] = "which is no name of a topic on the graph"
        elif topic.msgtype not in log.types_of(topic.name):
            found[name] = f"whose type {topic.msgtype or '(none)'} is defined nowhere"
    return found


def _check_types(log: LogReader, names: Mapping[str, str]) -> None:
    """Raises `GraphError` where topics of two types would be published under one name."""
    played: dict[str, Topic] = {}
    for topic in log.topics:
        if topic.name not in names:
            continue
        first = played.setdefault(names[topic.name], topic)
        if first.msgtype != topic.msgtype:
            raise GraphError(
                f"{log.path}: expected topics of one type as {names[topic.name]}, found {first.name} "
                f"({first.msgtype}) and {topic.name} ({topic.msgtype}); remap one of them to another name, or leave it "
                "out with --topics"
            )
