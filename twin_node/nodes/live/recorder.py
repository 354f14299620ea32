"""Records a live graph as `ros2 bag record` does: topics as they come, undecoded."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

from twin_node.bag import BagError, RecordingWriter, SplitParameters
from twin_node.bag.recording import free_path
from twin_node.errors import several
from twin_node.messages import builtin_types, convert
from twin_node.nodes.live.setup import Setup
from twin_node.nodes.put_back import Arrival, Arrivals, PutBackClock
from twin_node.nodes.topics import RECORDED, GraphError, is_topic_name, kind_of
from twin_node.runtime.node import Node
from twin_node.runtime.qos import EVERY, TopicKind
from twin_node.runtime.rmw_zenoh import Endpoint, EntityKind
from twin_node.runtime.wire import Encoded

DISCOVERY_S = 0.2
"""How often the graph is looked over for topics to record, s."""
FLUSH_TIMER_S = 0.25
"""How often a recorder without messages looks whether a chunk is due, s: half of its time."""
SILENCE_S = 3.0
"""By then a graph that runs is known: what nobody publishes is told."""
EARLY_KEPT = 100
"""Latched messages of a topic that are kept until time begins, the newest: transforms come from many nodes."""


@dataclass(frozen=True)
class RecordParameters:
    """What is recorded, and where to."""

    output: str = ""
    """New `.mcap` file, or new folder."""
    topics: tuple[str, ...] = RECORDED
    all: bool = False
    """Every topic of the graph whose type is known here, also those that come later."""
    split: SplitParameters = field(default_factory=SplitParameters)
    compression: str = "none"
    """Of the chunks: none, as `ros2 bag record`, zstd or lz4."""
    ends_when_refused: bool = False
    """Where the disk refuses, the node ends with that error; else it stays, so that a graph goes on, and says so."""
    tells: bool = False
    """Says what nobody publishes, and in the end what was recorded: for a user who has started the recorder alone."""


def make_recorder(setup: Setup) -> Node:
    """A recorder of the topics that its parameters name."""
    parameters = setup.parameters(RecordParameters)
    if not parameters.output:
        raise GraphError(f"{setup.where}: {setup.name}: expected 'output', the file or folder to write")
    for topic in parameters.topics:
        if not is_topic_name(topic):
            raise GraphError(
                f"{setup.where}: {setup.name}: expected names of topics such as /joint_states, found {topic!r}; there "
                "are no patterns: name them one by one, or take all"
            )
    return LiveRecorderNode(setup, parameters)


class LiveRecorderNode(Node):
    """Writes every message when it comes; a disk that refuses ends the recording, and the diagnostics say so.

    A graph on a log's time has none before `/clock` begins: what is said by then is left out, and what is latched is
    kept until time begins.
    """

    def __init__(self, setup: Setup, parameters: RecordParameters) -> None:
        super().__init__(setup.name, setup.bus, setup.clock)
        self._bus = setup.bus
        self._timers = setup.timers
        asked = () if parameters.all else parameters.topics
        self._topics: Sequence[str] = tuple({self._bus.resolved(topic): topic for topic in asked}.values())
        """Each of the graph's once, by whatever names it was asked for."""
        self._is_all = parameters.all
        self._endpoints = setup.endpoints
        self._say = setup.say
        self._finish = setup.finish
        self._early: dict[str, deque[Encoded]] = {}
        self._added: dict[str, str | None] = {}
        self._told: set[tuple[str, str]] = set()
        self._parameters = parameters
        self._writer: RecordingWriter | None = None
        self._has_begun = False
        self._has_told_of_loss = False
        self._error: BagError | None = None
        self._arrivals, self._put_back = Arrivals(), PutBackClock(Path(parameters.output), setup.say)

    def on_configure(self) -> None:
        """Raises `BagError` where the output cannot be begun.

        Not where something has its name already, as when a recorder of a graph is started again and the disk is full by
        now: the rest of the graph goes on.
        """
        wanted = Path(self._parameters.output)
        path = free_path(wanted)
        if path != wanted:
            self._say(f"{wanted} exists already: recording into {path}")
        builtin_types()  # takes half a second when first called: a topic that has just been found cannot wait for it
        try:
            self._writer = RecordingWriter(path, self._parameters.split, self._parameters.compression)
        except BagError as error:
            if path == wanted or self._parameters.ends_when_refused:
                raise
            self._fail(error)
        try:
            self._listen(path)
        except BaseException:  # such as one that nobody hears what is said: the name is free for the next try
            if self._writer is not None:
                self._writer.discard()
            raise

    def _listen(self, path: Path) -> None:
        self._endpoints()  # it is told from now on who publishes
        for topic in self._topics:
            kind = kind_of(topic)
            if kind is not None and kind.msgtype is not None:
                self.add(topic, kind)
        self._find_more()
        self._timers.every(DISCOVERY_S, self._find_more)
        self._timers.every(FLUSH_TIMER_S, self._flush)
        if self._parameters.tells:
            self._say(f"recording into {path}; Ctrl-C ends it")
            self._timers.alarm(self._tell_of_silence).set(SILENCE_S)

    def on_activate(self) -> None:
        self._has_begun = True

    def on_cleanup(self) -> None:
        """Raises what has ended a recording that is to end with it.

        Of a graph that was refused before it began nothing stays: the output's name is free for the next try.
        """
        if self._writer is not None and not self._has_begun:
            self._writer.discard()
            self._writer = None
        writer = self._writer
        self._end()
        if self._error is not None and self._parameters.ends_when_refused:
            raise self._error
        if writer is not None and self._parameters.tells:
            self._say(self._summary(writer))

    def add(self, topic: str, kind: TopicKind) -> None:
        """Record a topic from now on."""
        self._added[topic] = kind.msgtype
        qos = replace(EVERY, latched=kind.qos.latched)
        self._bus.declare(topic, TopicKind(kind.msgtype, qos))
        self._bus.subscribe_timed(topic, partial(self._write, self._bus.renamed(topic), qos.latched), self._now)

    def _find_more(self) -> None:
        """Takes up topics that others publish: those asked for whose type their name does not tell, or all.

        Of another type than is recorded by then, or of another definition of it, they are told.
        """
        asked = {self._bus.resolved(topic): topic for topic in self._topics}
        graph = self._endpoints()
        heard = {one.topic: one.type_hash for one in graph if self._is_own(one)}
        for endpoint in graph:
            topic = self._bus.named(endpoint.topic) if self._is_all else asked.get(endpoint.topic)
            if topic is None or endpoint.kind is not EntityKind.PUBLISHER:
                continue
            recorded = self._added.get(topic)
            if recorded is not None and recorded != endpoint.msgtype:
                self._leave_out(
                    endpoint,
                    f" of type {endpoint.msgtype}, which {endpoint.node.name} sends; a log has one type per topic, and "
                    f"{recorded} came first",
                )
            elif recorded is not None and heard.get(endpoint.topic, endpoint.type_hash) != endpoint.type_hash:
                self._leave_out(
                    endpoint,
                    f" of {endpoint.node.name}, whose {endpoint.msgtype} has another definition than the one known "
                    "here; 'twin_node doctor' tells more",
                )
            elif recorded is None and endpoint.msgtype in builtin_types():
                self.add(topic, TopicKind(endpoint.msgtype, endpoint.qos))
            elif recorded is None:
                self._leave_out(endpoint, f", whose type {endpoint.msgtype} is not known here")

    def _is_own(self, endpoint: Endpoint) -> bool:
        return endpoint.kind is EntityKind.SUBSCRIBER and endpoint.node.name == self.name

    def _tell_of_silence(self) -> None:
        published = {one.topic for one in self._endpoints() if one.kind is EntityKind.PUBLISHER}
        silent = [topic for topic in self._topics if self._bus.resolved(topic) not in published]
        if silent or (self._is_all and not any(map(self._bus.named, published))):
            self._say(f"nobody publishes {', '.join(silent) or 'anything'} yet; 'twin_node doctor' tells what there is")

    def _summary(self, writer: RecordingWriter) -> str:
        """What has become of a recording."""
        if writer.messages:
            topics = several(len(writer.topics), "topic")
            return f"{writer.path}: {several(writer.messages, 'message')} of {topics} in {writer.seconds:.1f} s"
        wanted = "any topic" if self._is_all else ", ".join(self._topics)
        return f"{writer.path}: 0 messages, nothing came on {wanted}; 'twin_node doctor' tells what there is"

    def _leave_out(self, endpoint: Endpoint, why: str) -> None:
        """Tells, once, of what cannot be recorded."""
        if (endpoint.topic, endpoint.msgtype) not in self._told:
            self._told.add((endpoint.topic, endpoint.msgtype))
            self._say(f"not recorded: {endpoint.topic}{why}")

    def diagnoses(self) -> tuple[convert.Diagnosis, ...]:
        """How much was written, or why no more is."""
        if self._error is not None:
            return (convert.Diagnosis(f"{self.name}: log", convert.Level.ERROR, str(self._error)),)
        count = 0 if self._writer is None else self._writer.messages
        readings = (convert.Reading("messages", str(count)), convert.Reading("lost", str(self._lost)))
        level, message = convert.Level.OK, "recording"
        if self._lost:
            level, message = convert.Level.WARN, self._too_slow()
        return (convert.Diagnosis(f"{self.name}: log", level, message, readings),)

    @property
    def _lost(self) -> int:
        """Messages that waited for the disk until there was no room for them."""
        return sum(traffic.dropped for traffic in self._bus.traffic)

    def _too_slow(self) -> str:
        return f"the disk is too slow: {self._lost} messages were lost; record fewer topics, or to another disk"

    def _now(self) -> Arrival:
        """Of a message that comes now, in the thread that brings it."""
        return self._arrivals.at(self.clock.now())

    def _write(self, topic: str, latched: bool, message: Encoded, came: Arrival) -> None:
        """`came`: a disk that was slow to take what came before does not make it later."""
        if came.stamp <= 0:
            if latched:
                self._early.setdefault(topic, deque(maxlen=EARLY_KEPT)).append(message)
            return
        early, self._early = self._early, {}
        for name, messages in early.items():
            for one in messages:
                self._put(name, one, came, latched=True)
        self._put(topic, message, came, latched)

    def _put(self, topic: str, message: Encoded, came: Arrival, latched: bool) -> None:
        try:
            if self._writer is None:
                return
            if (beside := self._put_back.beside(came)) is not None:
                if self._parameters.tells:
                    self._say(self._summary(self._writer))
                self._writer = self._writer.followed_by(beside, came.stamp)
            self._writer.write(topic, message.msgtype, message.data, came.stamp, message.types, latched)
        except BagError as error:
            self._fail(error)

    def _flush(self) -> None:
        if self._writer is None:
            return
        if self._lost and not self._has_told_of_loss:
            self._has_told_of_loss = True
            self._say(self._too_slow())
        try:
            self._writer.flush_if_due()
        except BagError as error:
            self._fail(error)

    def _fail(self, error: BagError) -> None:
        """Ends the recording; nobody may take it for one that goes on."""
        self._error = error
        self._end()
        if self._parameters.ends_when_refused:
            self._finish()
        else:
            self._say(str(error))

    def _end(self) -> None:
        writer, self._writer = self._writer, None
        if writer is None:
            return
        try:
            writer.close()
        except BagError as error:  # its beginning stands; why it ended is told
            self._error = self._error or error
