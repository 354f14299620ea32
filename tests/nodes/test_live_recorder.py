"""The recorder of a live graph: a disk that refuses, and what is said before the graph has a time."""

from __future__ import annotations

import errno
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from recorder_studio import Studio

from twin_node.bag import BagError, RecordingWriter, open_log
from twin_node.messages import convert, message_type
from twin_node.messages.convert import Level
from twin_node.nodes.live.recorder import EARLY_KEPT, make_recorder
from twin_node.nodes.live.setup import Setup
from twin_node.nodes.topics import DIAGNOSTICS, TF_STATIC, GraphError, kind_of
from twin_node.runtime.clock import FollowedClock, SystemClock
from twin_node.runtime.executor import Executor
from twin_node.runtime.qos import Qos, TopicKind
from twin_node.runtime.rmw_zenoh import Endpoint, EntityKind, NodeIdentity
from twin_node.runtime.wire import LocalWire
from twin_node.runtime.wire_bus import WireBus
from twin_node.scene import Rig, RigCamera

LOG_START = 1_700_000_000_000_000_000


def refuse(*_: Any) -> None:
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def test_a_disk_that_refuses_is_told_to_the_user_of_a_graph(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    studio = Studio(tmp_path / "run.mcap", SystemClock())
    studio.hear_diagnostics()
    monkeypatch.setattr(RecordingWriter, "_put", refuse)
    studio.hear_diagnostics()
    studio.hear_diagnostics()
    assert len(studio.said) == 1
    assert "No space left on device" in studio.said[0]
    assert not studio.is_finished
    (diagnosis,) = studio.node.diagnoses()
    assert diagnosis.level is Level.ERROR
    studio.end()
    with open_log(tmp_path / "run.mcap") as log:
        assert len(list(log.messages())) == 1


def test_a_recorder_that_is_started_again_on_a_full_disk_ends_no_launch(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It failed at once as often as it was tried, and then twin and arm were brought down with it."""
    (tmp_path / "run").mkdir()
    monkeypatch.setattr(RecordingWriter, "_begin_file", refuse)
    with pytest.raises(BagError, match="No space left on device"):
        Studio(tmp_path / "other", SystemClock())
    studio = Studio(tmp_path / "run", SystemClock())
    studio.hear_diagnostics()
    assert "run exists already: recording into" in studio.said[0]
    assert "No space left on device" in studio.said[1]
    assert [diagnosis.level for diagnosis in studio.node.diagnoses()] == [Level.ERROR]
    studio.end()
    with pytest.raises(BagError, match="No space left on device"):
        Studio(tmp_path / "run", SystemClock(), ends_when_refused=True)


@pytest.mark.parametrize("is_latched", [True, False])
def test_what_its_publisher_keeps_for_late_listeners_is_recorded_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, is_latched: bool
) -> None:
    monkeypatch.setattr("twin_node.nodes.live.recorder.DISCOVERY_S", 0.001)
    studio = Studio(tmp_path / "run.mcap", SystemClock(), all=True)
    kind = "std_msgs/msg/String"
    qos = Qos(latched=is_latched)
    studio.graph = (Endpoint(EntityKind.PUBLISHER, NodeIdentity("1", 1, "map"), 1, "/map", kind, "RIHS01_0", qos),)
    studio.step()
    studio.hear("/map", message_type(kind)(data="where walls are"))
    studio.end()
    with open_log(tmp_path / "run.mcap") as log:
        assert [(topic.name, topic.latched) for topic in log.topics] == [("/map", is_latched)]


def test_a_topic_with_another_name_on_the_graph_is_recorded_under_that(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One whose type only the graph tells was looked for under the name that it does not have there, in silence."""
    monkeypatch.setattr("twin_node.nodes.live.recorder.DISCOVERY_S", 0.001)
    studio = Studio(tmp_path / "run.mcap", SystemClock(), topics=("/note",), remaps={"/note": "/left/note"})
    kind, who = "std_msgs/msg/String", NodeIdentity("1", 1, "somebody")
    studio.graph = (Endpoint(EntityKind.PUBLISHER, who, 1, "/left/note", kind, "RIHS01_0", Qos()),)
    studio.step()
    studio.hear("/left/note", message_type(kind)(data="of the left arm"))
    studio.hear("/note", message_type(kind)(data="of another"))
    studio.end()
    with open_log(tmp_path / "run.mcap") as log:
        assert [(entry.topic, entry.message.data) for entry in log.messages()] == [("/left/note", "of the left arm")]


@pytest.mark.parametrize(("topics", "remaps"), [((DIAGNOSTICS,) * 2, {}), ((DIAGNOSTICS, "/d"), {"/d": DIAGNOSTICS})])
def test_a_topic_that_is_asked_for_twice_is_recorded_once(
    tmp_path: Path, topics: tuple[str, ...], remaps: dict[str, str]
) -> None:
    """Each of its messages was in the log twice."""
    studio = Studio(tmp_path / "run.mcap", SystemClock(), topics=topics, remaps=remaps)
    who = NodeIdentity("1", 1, "somebody")
    kind = "diagnostic_msgs/msg/DiagnosticArray"
    studio.graph = (Endpoint(EntityKind.PUBLISHER, who, 1, DIAGNOSTICS, kind, "RIHS01_0", Qos()),)
    studio.step()
    studio.hear_diagnostics()
    studio.end()
    with open_log(tmp_path / "run.mcap") as log:
        assert [entry.topic for entry in log.messages()] == [DIAGNOSTICS]


def test_what_a_slow_disk_has_cost_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("twin_node.nodes.live.recorder.FLUSH_TIMER_S", 0.001)
    monkeypatch.setattr("twin_node.nodes.live.recorder.EVERY", Qos(depth=2))
    studio = Studio(tmp_path / "run.mcap", SystemClock())
    studio.hear_at_once(*(convert.diagnostics_to_message(k, []) for k in range(5)))
    for _ in range(3):
        studio.step()
    told = "the disk is too slow: 3 messages were lost; record fewer topics, or to another disk"
    assert studio.said == [told]
    (diagnosis,) = studio.node.diagnoses()
    assert (diagnosis.level, diagnosis.message) == (Level.WARN, told)
    studio.end()


def test_messages_are_of_the_time_at_which_they_came(tmp_path: Path) -> None:
    """What waited for a slow disk was told to have come seconds late, all at once: a replay took that for true."""
    clock = FollowedClock()
    studio = Studio(tmp_path / "run.mcap", clock)
    for second in range(3):
        clock.set(LOG_START + second * 10**9)
        studio.hear_at_once(convert.diagnostics_to_message(second, []))
    clock.set(LOG_START + 9 * 10**9)
    for _ in range(3):
        studio.step()
    studio.end()
    with open_log(tmp_path / "run.mcap") as log:
        assert [(entry.stamp - LOG_START) // 10**9 for entry in log.messages()] == [0, 1, 2]


class SetClock:
    """A computer's, which somebody sets."""

    def __init__(self) -> None:
        self.stamp = LOG_START

    def now(self) -> int:
        return self.stamp


def test_a_disk_too_slow_for_images_is_no_clock_that_is_put_back(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What was left of them came before older messages of others, each of which began a recording of its own."""
    monkeypatch.setattr("twin_node.nodes.live.recorder.EVERY", Qos(depth=3))
    clock, topic = SetClock(), "/front/image_raw"
    studio = Studio(tmp_path / "run.mcap", clock, topics=(DIAGNOSTICS, topic))
    image = convert.raw_image("front", LOG_START, np.zeros((4, 4, 3), np.uint8))
    for second in range(9):
        clock.stamp = LOG_START + second * 10**9
        studio.bring(topic, image)
        if second % 3 == 0:
            studio.bring(DIAGNOSTICS, convert.diagnostics_to_message(second, []))
    studio.run()
    studio.end()
    assert studio.said == []
    assert [path.name for path in tmp_path.iterdir()] == ["run.mcap"]
    with open_log(tmp_path / "run.mcap") as log:
        assert [(entry.stamp - LOG_START) // 10**9 for entry in log.messages()] == [0, 3, 6, 6, 7, 8]


@pytest.mark.parametrize(("name", "second"), [("run", "run_r1"), ("run.mcap", "run_r1.mcap")])
def test_a_clock_that_is_put_back_begins_another_recording(tmp_path: Path, name: str, second: str) -> None:
    """In one log what came before and after stood between each other, and a replay saw two times at once."""
    clock = SetClock()
    studio = Studio(tmp_path / name, clock, tells=True)
    rig = Rig((RigCamera("front", 16, 12, np.array([[20.0, 0, 7.5], [0, 20.0, 5.5], [0, 0, 1]]), np.eye(4)),))
    studio.hear(TF_STATIC, convert.tf_static(rig, 0))
    for step_s in (1, 1, -5, 1, 1):
        clock.stamp += step_s * 10**9
        studio.hear_diagnostics()
    studio.end()
    begun, put_back, first_told, second_told = studio.said
    assert begun == f"recording into {tmp_path / name}; Ctrl-C ends it"
    assert "time was put back by 5.0 s" in put_back and put_back.endswith(second)
    assert f"{name}: 3 messages of 2 topics" in first_told and f"{second}: 4 messages" in second_told
    for path, times in ((name, [0, 1, 2]), (second, [-3, -3, -2, -1])):
        with open_log(tmp_path / path) as log:
            heard = list(log.messages())
        assert [(entry.stamp - LOG_START) // 10**9 for entry in heard] == times
        assert heard[0].topic == TF_STATIC, "each is whole"


@pytest.mark.parametrize("name", ["run", "run.mcap"])
def test_nothing_stays_of_a_graph_that_never_began(tmp_path: Path, name: str) -> None:
    """Of a launch that was refused: its next try would find the output's name taken, and record under another."""
    studio = Studio(tmp_path / name, SystemClock(), is_active=False)
    studio.hear_diagnostics()
    assert list(tmp_path.iterdir()) == [tmp_path / name]
    studio.node.cleanup()
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["run", "run.mcap"])
def test_nothing_stays_where_nobody_hears_that_it_begins(name: str, tmp_path: Path) -> None:
    """As of `twin_node record -o run | true`: 45 bytes had the name, and were damaged for `info`."""

    def say(_line: str) -> None:
        raise BrokenPipeError

    with pytest.raises(BrokenPipeError):
        Studio(tmp_path / name, SystemClock(), say=say, tells=True)
    assert not list(tmp_path.iterdir())


def test_a_recorder_by_itself_ends_with_the_disk_s_word(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    studio = Studio(tmp_path / "run.mcap", SystemClock(), ends_when_refused=True)
    monkeypatch.setattr(RecordingWriter, "_put", refuse)
    studio.hear_diagnostics()
    assert studio.is_finished
    with pytest.raises(BagError, match="No space left on device"):
        studio.end()


def test_what_is_said_before_the_graph_has_a_time_is_not_of_1970(tmp_path: Path) -> None:
    """A graph on a log's time has none until `/clock` begins; what is latched is kept until then."""
    clock = FollowedClock()
    studio = Studio(tmp_path / "run.mcap", clock)
    K = np.array([[20.0, 0, 7.5], [0, 20.0, 5.5], [0, 0, 1]])
    rig = Rig((RigCamera("front", 16, 12, K, np.eye(4)),))
    studio.hear_diagnostics()
    studio.hear(TF_STATIC, convert.tf_static(rig, 0))
    clock.set(LOG_START)
    studio.hear_diagnostics()
    studio.end()
    with open_log(tmp_path / "run.mcap") as log:
        assert [message.topic for message in log.messages()] == [TF_STATIC, DIAGNOSTICS]
        assert log.start_ns >= LOG_START


def test_transforms_outlast_what_is_said_again_and_again_before_the_graph_has_a_time(tmp_path: Path) -> None:
    """Cameras say their calibration with every image: after a second of three of them no transforms were left."""
    clock, info = FollowedClock(), "/front/camera_info"
    studio = Studio(tmp_path / "run.mcap", clock, topics=(info, TF_STATIC, DIAGNOSTICS))
    camera = RigCamera("front", 16, 12, np.array([[20.0, 0, 7.5], [0, 20.0, 5.5], [0, 0, 1]]), np.eye(4))
    studio.hear(TF_STATIC, convert.tf_static(Rig((camera,)), 0))
    for _ in range(EARLY_KEPT + 20):
        studio.hear(info, convert.camera_info(camera, 0))
    clock.set(LOG_START)
    studio.hear_diagnostics()
    studio.end()
    with open_log(tmp_path / "run.mcap") as log:
        kept = [message.topic for message in log.messages()]
    assert [kept.count(topic) for topic in (TF_STATIC, info, DIAGNOSTICS)] == [1, EARLY_KEPT, 1]


@pytest.mark.parametrize(
    ("more", "silent", "wanted"),
    [({}, "/diagnostics", "/diagnostics, /tf_static"), ({"all": True}, "anything", "any topic")],
)
def test_who_records_nothing_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, more: dict[str, Any], silent: str, wanted: str
) -> None:
    monkeypatch.setattr("twin_node.nodes.live.recorder.SILENCE_S", 0.0)
    studio = Studio(tmp_path / "run.mcap", SystemClock(), tells=True, **more)
    if not more:
        who = NodeIdentity("1", 1, "somebody")
        kind = kind_of(TF_STATIC)
        studio.graph = (Endpoint(EntityKind.PUBLISHER, who, 1, TF_STATIC, str(kind.msgtype), "RIHS01_0", kind.qos),)
    studio.step()
    studio.end()
    hint = "'twin_node doctor' tells what there is"
    assert studio.said == [
        f"recording into {tmp_path / 'run.mcap'}; Ctrl-C ends it",
        f"nobody publishes {silent} yet; {hint}",
        f"{tmp_path / 'run.mcap'}: 0 messages, nothing came on {wanted}; {hint}",
    ]


class LateStudio(Studio):
    """Somebody publishes all that is recorded, of whom the wire tells from the second question on."""

    @property
    def graph(self) -> tuple[Endpoint, ...]:
        self._asked += 1
        who, kinds = NodeIdentity("1", 1, "somebody"), {topic: kind_of(topic) for topic in (DIAGNOSTICS, TF_STATIC)}
        ends = (
            Endpoint(EntityKind.PUBLISHER, who, 1, topic, str(kind.msgtype), "RIHS01_0", kind.qos)
            for topic, kind in kinds.items()
            if kind is not None
        )
        return tuple(ends) if self._asked > 1 else ()

    @graph.setter
    def graph(self, _: tuple[Endpoint, ...]) -> None:
        self._asked = 0


def test_topics_that_are_published_are_not_said_to_be_missing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of topics whose types are known nobody had asked by then, and the first answer is empty."""
    monkeypatch.setattr("twin_node.nodes.live.recorder.SILENCE_S", 0.0)
    studio = LateStudio(tmp_path / "run.mcap", SystemClock(), tells=True)
    studio.step()
    studio.end()
    assert not [line for line in studio.said if "nobody publishes" in line]


def test_what_was_recorded_is_told_in_the_end(tmp_path: Path) -> None:
    clock = FollowedClock()
    studio = Studio(tmp_path / "run", clock, tells=True)
    for after in (0, 1, 2):
        clock.set(LOG_START + after * 1_500_000_000)
        studio.hear_diagnostics()
    studio.end()
    begun, told = studio.said
    assert begun == f"recording into {tmp_path / 'run'}; Ctrl-C ends it"
    assert told.startswith(f"{tmp_path / 'run'}: 3 messages of 1 topic in 3.")


@pytest.mark.parametrize("topic", ["/twin/*", "/", "/a b", "", "joint_states"])
def test_names_that_no_topic_has_are_refused(tmp_path: Path, topic: str) -> None:
    bus = WireBus(LocalWire(), Executor(), "recorder", kind_of)
    parameters = {"output": str(tmp_path / "run"), "topics": [topic]}
    sections = {"recorder": parameters}
    setup = Setup("recorder", bus, SystemClock(), Executor(), sections, "record", lambda: None, lambda: ())
    with pytest.raises(GraphError, match="record: recorder: expected names of topics such as /joint_states, found"):
        make_recorder(setup)
    assert not (tmp_path / "run").exists()


def test_what_nodes_of_a_namespace_say_is_recorded_under_their_own_names(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is replayed, drawn and judged as any other; what those of others say is theirs."""
    monkeypatch.setattr("twin_node.nodes.live.recorder.DISCOVERY_S", 0.001)
    string = message_type("std_msgs/msg/String")
    studio = Studio(tmp_path / "run.mcap", SystemClock(), namespace="/cell", all=True)
    node = NodeIdentity("ab", 0, "somebody", "/cell")
    topics = ("/cell/notes", "/other/notes", "/notes", "/rosout")
    kind = TopicKind("std_msgs/msg/String", Qos(depth=10))
    studio.graph = tuple(
        Endpoint(EntityKind.PUBLISHER, node, 1, topic, kind.msgtype or "", "", kind.qos) for topic in topics
    )
    studio.step()
    for topic in topics:
        studio.hear(topic, string(data=topic))
    studio.end()
    with open_log(tmp_path / "run.mcap") as log:
        found = {entry.topic: entry.message.data for entry in log.messages()}
    assert found == {"/notes": "/cell/notes", "/rosout": "/rosout"}


def test_the_topics_asked_for_are_those_of_the_namespace(tmp_path: Path) -> None:
    studio = Studio(tmp_path / "run.mcap", SystemClock(), namespace="/cell")
    studio.hear_diagnostics()
    studio.hear(f"/cell{DIAGNOSTICS}", convert.diagnostics_to_message(0, []))
    studio.end()
    with open_log(tmp_path / "run.mcap") as log:
        assert [m.topic for m in log.messages()] == [DIAGNOSTICS]
