"""The player by rosbag2's flags: what it publishes, under which names, its clock, pauses and loops."""

from __future__ import annotations

import threading
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.writer import Writer
from twin_logs import with_notes

from twin_node.bag import LogWriter, RecordingWriter, open_log
from twin_node.messages import builtin_types, convert, message_type, serialize
from twin_node.nodes.live.player import PlayNode, PlayParameters
from twin_node.nodes.live.setup import Setup
from twin_node.nodes.topics import ACKNOWLEDGE, CLOCK, FOLLOW, GraphError, kind_of, kind_of_own
from twin_node.runtime.clock import SystemClock
from twin_node.runtime.executor import Executor
from twin_node.runtime.qos import TopicKind
from twin_node.runtime.wire import LocalWire
from twin_node.runtime.wire_bus import WireBus
from twin_node.scene import Rig, RigCamera

STRING = "std_msgs/msg/String"
START, STEP = 1_000_000_000_000, 50_000_000
FAST = 1000.0
WAIT_S = 60.0
CLOCK_KIND = kind_of_own(CLOCK)


@pytest.fixture
def log(tmp_path: Path) -> Path:
    """Ten messages on /a and ten on /b, 50 ms apart."""
    path = tmp_path / "small.mcap"
    with RecordingWriter(path) as writer:
        for i in range(10):
            for topic in ("/a", "/b"):
                data = bytes(serialize(message_type(STRING)(data=f"{topic} {i}")))
                writer.write(topic, STRING, data, START + i * STEP, builtin_types())
    return path


class Announced(LocalWire):
    """A wire that notes what others are told of."""

    def __init__(self) -> None:
        super().__init__()
        self.topics: dict[str, TopicKind] = {}

    def advertise(self, node: str, topic: str, kind: TopicKind) -> None:
        self.topics[topic] = kind


class Theatre:
    """A player, and what it has played."""

    def __init__(self, log: Path, **flags: Any) -> None:
        self.heard: list[tuple[str, str]] = []
        self.clock: list[int] = []
        self.finished, self.enough = threading.Event(), threading.Event()
        self.wire = wire = Announced()
        for topic in ("/a", "/b", "/c"):
            wire.subscribe("test", topic, TopicKind(STRING), self._hear(topic))
        wire.subscribe("test", CLOCK, kind_of(CLOCK), lambda m: self.clock.append(convert.clock_from_message(m)))
        executor = Executor()
        bus = WireBus(wire, executor, "player", kind_of)
        setup = Setup("player", bus, SystemClock(), executor, {}, "test", self.finished.set, wire.endpoints)
        self.node = PlayNode(setup, PlayParameters(log=str(log), **{"rate": FAST, **flags}))

    def _hear(self, topic: str) -> Callable[[Any], None]:
        def hear(message: Any) -> None:
            self.heard.append((topic, message.decode().data))
            if len(self.heard) >= 25:
                self.enough.set()

        return hear

    def begin(self) -> None:
        self.node.configure()
        self.node.activate()

    def end(self) -> None:
        self.node.deactivate()
        self.node.cleanup()

    def play(self) -> None:
        self.begin()
        assert self.finished.wait(WAIT_S)
        self.end()


def test_everything_in_order_and_then_the_end(log: Path) -> None:
    theatre = Theatre(log)
    theatre.play()
    assert theatre.heard == [(topic, f"{topic} {i}") for i in range(10) for topic in ("/a", "/b")]
    assert theatre.clock == []


def test_a_part_of_some_topics_under_other_names(log: Path) -> None:
    theatre = Theatre(log, topics=("/a",), remap=("/a:=/c",), start_offset=0.1, playback_duration=0.2)
    theatre.play()
    assert theatre.heard == [("/c", f"/a {i}") for i in range(2, 6)]


def test_others_are_told_of_all_topics_before_the_first_message(tmp_path: Path) -> None:
    """A recorder of all that comes, too, has to find a topic before it can hear it; the log says what its type is."""
    text = "int32 of_ours"
    types = builtin_types().extended({"my_msgs/msg/Note": text})
    with LogWriter(tmp_path / "log.mcap") as log:
        log.add_topic("/note", "my_msgs/msg/Note", definition=text)
        note = types.message_type("my_msgs/msg/Note")(of_ours=1)
        log.write_raw("/note", "my_msgs/msg/Note", types.serialize(note), START)
        log.write("/a", message_type(STRING)(data="x"), START + 60_000_000_000)
    theatre = Theatre(tmp_path / "log.mcap", start_paused=True, clock=10.0, remap=("/a:=/c",))
    theatre.begin()
    announced = theatre.wire.topics
    assert (announced["/note"].msgtype, announced["/c"].msgtype) == ("my_msgs/msg/Note", STRING)
    assert announced["/note"].type_hash == types.type_hash("my_msgs/msg/Note")
    assert CLOCK in announced
    theatre.end()


def test_topics_of_two_types_are_not_played_under_one_name(tmp_path: Path) -> None:
    """All would go out as of the first one's type."""
    with LogWriter(tmp_path / "log.mcap") as log:
        log.write("/a", message_type(STRING)(data="x"), START)
        log.write("/b", message_type("std_msgs/msg/Int32")(data=1), START)
    with pytest.raises(
        GraphError, match=r"one type as /b, found /a \(std_msgs/msg/String\) and /b \(std_msgs/msg/Int32"
    ):
        Theatre(tmp_path / "log.mcap", remap=("/a:=/b",))


def test_what_stands_is_told_before_a_part(tmp_path: Path) -> None:
    """A map and transforms are said once, at the log's start: without them nobody could place what the part shows."""
    path = tmp_path / "run.mcap"
    with RecordingWriter(path) as writer:
        for second, topic, words in (
            (0, "/map", "old walls"),
            (1, "/map", "walls"),
            (1, "/tf_static", "cameras"),
            (2, "/tf_static", "robot"),
            (3, "/tf_static", "cameras"),
            (3, "/a", "before"),
            (100, "/a", "within"),
            (101, "/map", "new walls"),
        ):
            data = bytes(serialize(message_type(STRING)(data=words)))
            writer.write(topic, STRING, data, START + second * 1_000_000_000, builtin_types(), topic != "/a")
    theatre = Theatre(path, start_offset=100.0, remap=("/map:=/c", "/tf_static:=/b"))
    theatre.play()
    assert sorted(theatre.heard[:3]) == [("/b", "cameras"), ("/b", "robot"), ("/c", "walls")]
    assert theatre.heard[3:] == [("/a", "within"), ("/c", "new walls")]
    assert theatre.heard.index(("/b", "robot")) < theatre.heard.index(("/b", "cameras"))
    theatre = Theatre(path, start_offset=100.0, topics=("/a",))
    theatre.play()
    assert theatre.heard == [("/a", "within")]


def test_who_comes_late_is_told_all_transforms(tmp_path: Path) -> None:
    """They are one publisher's now, and were several ones' when they were recorded: cameras', the robot's."""
    path, kind = tmp_path / "run.mcap", kind_of("/tf_static")
    with RecordingWriter(path) as writer:
        for i, words in enumerate(("cameras", "robot", "tool")):
            data = bytes(serialize(message_type(STRING)(data=words)))
            writer.write("/tf_static", STRING, data, START + i, builtin_types())
    theatre, late = Theatre(path), list[str]()
    theatre.play()
    theatre.wire.subscribe("late", "/tf_static", kind, lambda message: late.append(message.decode().data))
    assert late == ["cameras", "robot", "tool"]


def test_the_clock_ticks_with_the_log(log: Path) -> None:
    theatre = Theatre(log, clock=100.0, read_ahead_queue_size=1)
    theatre.play()
    assert theatre.clock == [START + i * 10_000_000 for i in range(46)]


def test_the_clock_can_have_another_name(log: Path) -> None:
    """Of a log that is played beside a launch whose clock is `/cell/clock`: `/clock` would be no topic of the log."""
    theatre = Theatre(log, clock=100.0, remap=("/clock:=/cell/clock",))
    heard: list[int] = []
    theatre.wire.subscribe("test", "/cell/clock", CLOCK_KIND, lambda m: heard.append(convert.clock_from_message(m)))
    theatre.play()
    assert (heard, theatre.clock) == ([START + i * 10_000_000 for i in range(46)], [])
    assert theatre.wire.topics["/cell/clock"] == CLOCK_KIND


@pytest.mark.parametrize("flags", [{"topics": ("/clock", "/a")}, {"remap": ("/time:=/clock",)}])
def test_no_time_but_the_players_is_played_as_its_clock(tmp_path: Path, flags: dict[str, Any]) -> None:
    """Time went to and fro between the two, and every node began anew again and again."""
    logged = named(tmp_path / "log.mcap", "/a", "/clock", "/time")
    with pytest.raises(GraphError, match=r"no topic of the log has, found /clock, as which /(clock|time) is to be"):
        Theatre(logged, clock=100.0, **flags)
    Theatre(logged, clock=100.0)
    Theatre(logged, topics=("/clock", "/a"))


def test_a_loop_begins_again_and_its_clock_goes_back(log: Path) -> None:
    theatre = Theatre(log, loop=True, clock=40.0)
    theatre.begin()
    assert theatre.enough.wait(WAIT_S)
    theatre.end()
    assert theatre.heard[20:22] == [("/a", "/a 0"), ("/b", "/b 0")]
    assert any(later < before for before, later in pairwise(theatre.clock))


def test_a_loop_over_nothing_ends(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    with RecordingWriter(path) as writer:
        for i, topic in enumerate(("/a", "/b")):
            writer.write(topic, STRING, bytes(serialize(message_type(STRING)(data="x"))), START + i, builtin_types())
    theatre = Theatre(path, loop=True, topics=("/a",), start_offset=1e-9)
    theatre.play()
    assert theatre.heard == []


def test_a_paused_player_waits_for_its_word(log: Path) -> None:
    theatre = Theatre(log, start_paused=True)
    theatre.begin()
    assert not theatre.finished.wait(0.05)
    assert theatre.node.is_paused
    assert theatre.heard == []
    theatre.node.pause(False)
    assert theatre.finished.wait(WAIT_S)
    theatre.end()
    assert len(theatre.heard) == 20


def test_nobody_reads_on_when_the_log_is_closed(log: Path) -> None:
    theatre = Theatre(log, start_paused=True, read_ahead_queue_size=1)
    theatre.begin()
    assert not theatre.finished.wait(0.05)
    theatre.end()
    assert [thread.name for thread in threading.enumerate() if thread.name == "read ahead"] == []


def test_whatever_ends_the_playing_ends_the_player(log: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    theatre = Theatre(log)

    def broken() -> Any:
        raise RuntimeError("cannot go on")

    monkeypatch.setattr(theatre.node, "_messages", broken)
    theatre.begin()
    assert theatre.finished.wait(WAIT_S)
    with pytest.raises(RuntimeError, match="cannot go on"):
        theatre.end()


def with_an_unknown_type(log: Path, tmp_path: Path) -> Path:
    """The log, and a topic /odd whose type it does not define."""
    path = tmp_path / "odd.mcap"
    with open_log(log) as read, path.open("wb") as file:
        writer = Writer(file)
        writer.start("ros2", "test")
        definitions = {STRING: b"string data", "odd_msgs/msg/Odd": b"no definition ~~~ {"}
        schemas = {name: writer.register_schema(name, "ros2msg", text) for name, text in definitions.items()}
        channels = {topic: writer.register_channel(topic, "cdr", schemas[STRING]) for topic in ("/a", "/b")}
        channels["/odd"] = writer.register_channel("/odd", "cdr", schemas["odd_msgs/msg/Odd"])
        for message in read.messages():
            for topic in (message.topic, "/odd"):
                writer.add_message(channels[topic], message.stamp, bytes(message.data), message.stamp)
        writer.finish()
    return path


def test_a_topic_whose_type_nobody_knows_is_left_out_and_told(
    log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    odd = with_an_unknown_type(log, tmp_path)
    theatre = Theatre(odd)
    theatre.play()
    assert len(theatre.heard) == 20
    assert "not played: /odd, whose type odd_msgs/msg/Odd" in capsys.readouterr().out
    with pytest.raises(GraphError, match="found /odd, whose type odd_msgs/msg/Odd is defined nowhere"):
        Theatre(odd, topics=("/odd",))


def test_a_topic_in_another_encoding_is_left_out_and_told(
    log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    noted = with_notes(log, tmp_path / "noted.mcap")
    theatre = Theatre(noted)
    theatre.play()
    assert len(theatre.heard) == 20
    assert "not played: /notes: 1 message in json; expected cdr" in capsys.readouterr().out
    Theatre(noted, topics=("/a",))
    assert "not played" not in capsys.readouterr().out


def named(path: Path, *topics: str) -> Path:
    """A log with a message on each topic, whatever its name."""
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start("ros2", "test")
        schema = writer.register_schema(STRING, "ros2msg", b"string data")
        for topic in topics:
            data = bytes(serialize(message_type(STRING)(data=topic)))
            writer.add_message(writer.register_channel(topic, "cdr", schema), START, data, START)
        writer.finish()
    return path


def test_topics_are_played_whose_names_can_be_on_the_graph(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Other programs than ROS name them as they like: without a slash at the front, with signs, not at all."""
    log = named(tmp_path / "log.mcap", "a", "/b", "/gripper #1", "/a//b", "")
    theatre = Theatre(log, remap=("/gripper #1:=/c",))
    theatre.play()
    assert sorted(theatre.heard) == [("/a", "a"), ("/b", "/b"), ("/c", "/gripper #1")]
    told = capsys.readouterr().out
    assert "not played: /a//b, which is no name of a topic" in told
    assert "not played: /, which is no name of a topic" in told
    with pytest.raises(GraphError, match="found /a//b, which is no name of a topic on the graph; leave it out"):
        Theatre(log, topics=("/a//b",))


def test_what_was_ordered_of_an_arm_is_not_ordered_again_unless_asked_for(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A log that was played beside a driver let its arm go on after a halt, and a servoed one follow a path."""
    log = named(tmp_path / "log.mcap", "/a", "/b", FOLLOW, ACKNOWLEDGE)
    Theatre(log).play()
    told = capsys.readouterr().out
    for order in (FOLLOW, ACKNOWLEDGE):
        assert f"not played: {order}, which an arm on this graph would obey; name it with --topics" in told
    as_named = {
        (): {"/a", "/b"},
        ("/a", ACKNOWLEDGE): {"/a", ACKNOWLEDGE},
    }
    for topics, played in as_named.items():
        theatre = Theatre(log, topics=topics)
        theatre.node.configure()
        assert theatre.wire.topics.keys() == played
    theatre = Theatre(log, remap=(f"{FOLLOW}:=/c", f"/b:={ACKNOWLEDGE}"))
    theatre.node.configure()
    assert theatre.wire.topics.keys() == {"/a", "/c"}


@pytest.mark.parametrize("topics", [(), ("/a",)])
def test_of_two_topics_with_one_name_on_the_graph_one_is_played_and_the_other_told(
    tmp_path: Path, topics: tuple[str, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    theatre = Theatre(named(tmp_path / "log.mcap", "a", "/a"), topics=topics)
    theatre.play()
    assert theatre.heard == [("/a", "/a")]
    assert "not played: a, for /a is played under that name" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("flags", "words"),
    [
        ({"topics": ("/d",)}, "has no topic /d; it holds /a, /b"),
        ({"remap": ("/a=/b",)}, "expected FROM:=TO"),
        ({"rate": 0.0}, "play: rate: expected 0.001 to 1000000, found 0"),
        ({"rate": 1e300}, "play: rate: expected 0.001 to 1000000, found 1e"),
        ({"clock": 1e-310}, "play: clock: expected 0.001 to 1000000, found 9.99"),
        ({"remap": ("/clock:=/b",)}, "has no topic /clock; it holds /a, /b"),
        ({"clock": 1.0, "remap": ("/clock:=/b",)}, "a name for the clock that no topic of the log has, found /b"),
        ({"clock": -1.0}, "play: clock: expected 0.001 to 1000000, found -1"),
        ({"delay": 1e300}, "play: delay: expected 0 to 86400, found 1e"),
        ({"read_ahead_queue_size": 0}, "play: read_ahead_queue_size: expected 1 or more, found 0"),
        ({"start_offset": 60.0}, "is past its end"),
        ({"start_offset": -1.0}, "start_offset: expected a number of 0 or more, found -1"),
        ({"playback_duration": -1.0}, "playback_duration: expected a number of 0 or more"),
    ],
)
def test_what_cannot_be_played_is_told(log: Path, flags: dict[str, Any], words: str) -> None:
    with pytest.raises(GraphError, match=words):
        Theatre(log, **flags)


def test_a_reader_that_hangs_holds_no_player_up(tmp_path: Path) -> None:
    """What comes with every image of a recording soon comes anew, latched or not: it waited for a viewer's room."""
    path = tmp_path / "run.mcap"
    info = convert.camera_info(RigCamera("left", 4, 3, np.eye(3), np.eye(4)), START)
    with RecordingWriter(path) as writer:
        for topic in ("/left/camera_info", "/tf_static", "/map"):
            message = convert.tf_static(Rig(()), START) if topic == "/tf_static" else info
            writer.write(topic, message.__msgtype__, bytes(serialize(message)), START, builtin_types(), latched=True)
    theatre = Theatre(path)
    theatre.node.configure()
    announced = {topic: told.qos for topic, told in theatre.wire.topics.items()}
    assert all(qos.latched for qos in announced.values())
    assert [topic for topic, qos in announced.items() if qos.repeats] == ["/left/camera_info"]
    assert announced["/tf_static"].depth > 1
    theatre.node.cleanup()
