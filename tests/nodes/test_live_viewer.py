"""The viewer's node on a graph: it finds the cameras, draws while somebody watches, and survives what it is sent."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from twin_logs import PERIOD, START, cloud_at, obstacles_at

from twin_node.bag import open_log
from twin_node.bench.visitors import free_port
from twin_node.messages import convert
from twin_node.nodes.live.graph_cameras import GraphCameras
from twin_node.nodes.live.rig_messages import publish_calibration
from twin_node.nodes.live.rig_source import RigParameters
from twin_node.nodes.live.setup import Setup
from twin_node.nodes.live.single import GraphTime
from twin_node.nodes.live.viewer import make_viewer
from twin_node.nodes.snapshot import Snapshot
from twin_node.nodes.topics import (
    CLOCK,
    DIAGNOSTICS,
    GAUSSIANS,
    GAUSSIANS_MOVING,
    JOINT_STATES,
    OBSTACLES,
    SEPARATION,
    TF_STATIC,
    kind_of,
)
from twin_node.nodes.viewer import CellPage, LiveCameras, ViewerError, ViewerNode
from twin_node.robot import ur_model
from twin_node.runtime.executor import Executor
from twin_node.runtime.parameters import ParameterError
from twin_node.runtime.qos import TopicKind
from twin_node.runtime.rmw_zenoh import Endpoint, EntityKind, NodeIdentity
from twin_node.runtime.wire import Encoded, LocalWire, encoded
from twin_node.runtime.wire_bus import WireBus
from twin_node.scene import JointSample, Rig, RigCamera, Separation

pytest.importorskip("viser")

PATIENCE_S = 60.0


class SetClock:
    """Time is what it was set to."""

    def __init__(self) -> None:
        self.stamp = START

    def now(self) -> int:
        return self.stamp


class Graph:
    """A viewer's node on a wire, and what it shows."""

    def __init__(self, sections: dict[str, Any] | None = None) -> None:
        self.wire, self.executor, self.clock = LocalWire(), Executor(), SetClock()
        self.published: list[Endpoint] = []
        self.said: list[str] = []
        bus = WireBus(self.wire, self.executor, "viewer", kind_of)
        sections = {"viewer": {"port": free_port(), "width": 32}, "arm": {"model": "ur5e"}, **(sections or {})}
        self.setup = Setup(
            "viewer", bus, self.clock, self.executor, sections, "test", lambda: None, lambda: tuple(self.published)
        )
        setup = Setup(**{**vars(self.setup), "say": self.said.append})
        self.node = make_viewer(setup)
        assert isinstance(self.node, ViewerNode)
        self.node.configure()
        self.page: CellPage = self.node._page
        self.snapshots: list[Snapshot] = []
        self._drawn = threading.Event()
        self._show = self.page.show
        self.page.show = self._watch
        self.node.activate()

    def _watch(self, snapshot: Snapshot) -> None:
        self.snapshots.append(snapshot)
        try:
            self._show(snapshot)
        finally:
            self._drawn.set()

    def send(self, topic: str, message: Any, stamp: int = START) -> None:
        self.clock.stamp = stamp
        msgtype = kind_of(topic).msgtype or message.__msgtype__
        self.wire.publisher("test", topic, TopicKind(msgtype, kind_of(topic).qos))(message)

    def until(self, shown: Callable[[], bool]) -> None:
        """Until the page shows something; the graph's own messages are dealt with meanwhile."""
        for _ in range(int(PATIENCE_S / 0.1)):
            while self.executor.step(0.0):
                pass
            self._drawn.wait(0.1)
            self._drawn.clear()
            if shown():
                return
        raise AssertionError("the page never showed it")

    def handle(self, name: str) -> Any:
        return self.page.server.scene.get_handle_by_name(name)

    def close(self) -> None:
        self.node.deactivate()
        self.node.cleanup()


@pytest.fixture
def graph(monkeypatch: pytest.MonkeyPatch) -> Iterator[Graph]:
    monkeypatch.setattr(CellPage, "visitors", 1)
    made = Graph()
    yield made
    made.close()


def publisher(topic: str, msgtype: str | None = None) -> Endpoint:
    kind = kind_of(topic) or TopicKind(msgtype)
    node = NodeIdentity("a" * 32, 1, "cameras")
    return Endpoint(EntityKind.PUBLISHER, node, 1, topic, kind.msgtype or "", "", kind.qos)


def test_the_newest_of_every_topic_is_shown_and_followed(graph: Graph) -> None:
    assert graph.said == [graph.page.url]
    graph.send(GAUSSIANS, convert.gaussians_to_pointcloud2(cloud_at(0, True), START))
    graph.until(lambda: graph.handle("/gaussians/static") is not None)
    stamp = START + 9 * PERIOD
    graph.send(GAUSSIANS_MOVING, convert.gaussians_to_pointcloud2(cloud_at(9, False), stamp), stamp)
    moved = cloud_at(9, False).means
    graph.until(lambda: np.allclose(graph.handle("/gaussians/moving").centers / 10, moved, atol=1e-5))
    past = {topic: graph.snapshots[-1].earlier(topic, 2 * 10**9) for topic in (GAUSSIANS, GAUSSIANS_MOVING)}
    assert [[said.stamp for said in told] for told in past.values()] == [[START], [stamp]], "for what is picked"


def test_a_graph_tells_of_its_cameras(graph: Graph, cell_log: Callable[..., Path]) -> None:
    """Nobody has told the node of a rig: it learns of cameras when they publish, and sees through them."""
    with open_log(cell_log(0.5)) as log:
        wanted = ("/cam_front/image_raw/compressed", "/cam_front/camera_info", TF_STATIC)
        messages = {message.topic: message for message in log.messages(wanted)}
    for topic in wanted:
        graph.published.append(publisher(topic))
        message = messages[topic]
        graph.send(topic, Encoded(message.msgtype, message.data, message.types))
    graph.until(lambda: graph.handle("/cameras/cam_front") is not None)
    message = messages[wanted[0]]
    graph.send(wanted[0], Encoded(message.msgtype, message.data, message.types))
    # A handle can be found by its name a moment before viser gives it its image.
    graph.until(lambda: getattr(graph.handle("/cameras/cam_front"), "image", None) is not None)
    assert graph.handle("/cameras/cam_front").image.shape[1] == 32


def test_cameras_are_shown_whatever_their_drivers_call_their_topics(graph: Graph) -> None:
    """One such camera on the graph, and nothing of the twin was shown."""
    front = RigCamera("front", 64, 48, np.diag([50.0, 50.0, 1.0]), np.eye(4))
    image = convert.raw_image("front", START, np.zeros((48, 64, 3), np.uint8))
    told = {"/front/image_color": image, "/front/lens": convert.camera_info(front, START)}
    graph.published += [publisher(topic, message.__msgtype__) for topic, message in told.items()]
    graph.send(TF_STATIC, convert.tf_static(Rig((front,)), START))

    def is_shown() -> bool:
        for topic, message in told.items():
            graph.wire.publisher("driver", topic, TopicKind(message.__msgtype__))(message)
        return getattr(graph.handle("/cameras/front"), "image", None) is not None

    graph.until(is_shown)
    assert graph.handle("/cameras/front").image.shape[1] == 32


def test_cameras_that_are_calibrated_anew_are_shown_where_they_are_now(graph: Graph) -> None:
    """The launch was started again with a better rig file: the viewer that ran on showed them where they had been."""
    cameras = GraphCameras(graph.setup, 32, None)
    graph.published.append(publisher("/cam_front/image_raw/compressed"))
    graph.published.append(publisher("/cam_front/camera_info"))
    seen: list[float] = []
    for x in (0.0, 0.0, 0.2):
        moved = np.eye(4)
        moved[0, 3] = x
        front = RigCamera("cam_front", 64, 48, np.diag([50.0, 50.0, 1.0]), moved)
        bus = WireBus(graph.wire, graph.executor, "cameras", kind_of)
        publish_calibration(bus, Rig((front,)), RigParameters(), START)
        bus.publish("/cam_front/camera_info", convert.camera_info(front, START))
        for _ in range(3):
            found = cameras()
            seen += [] if found is None else [found.assembler.cameras[0].T_base_cam[0, 3]]
            while graph.executor.step(0.0):
                pass
    assert seen == [0.0, 0.2]


def test_cameras_that_leave_are_taken_away_and_come_again(graph: Graph) -> None:
    """The launch was stopped, and the viewer ended with it: it expected at least one camera."""
    front = RigCamera("front", 64, 48, np.diag([50.0, 50.0, 1.0]), np.eye(4))
    ends = [publisher("/front/image_raw"), publisher("/front/camera_info")]
    graph.send(TF_STATIC, convert.tf_static(Rig((front,)), START))
    graph.send("/front/camera_info", convert.camera_info(front, START))
    for there in (ends, [], ends):
        graph.published[:] = there
        graph.until(lambda there=there: (graph.handle("/cameras/front") is not None) == bool(there))


def test_images_are_not_sent_for_cameras_that_are_looked_at_otherwise(graph: Graph) -> None:
    """Raw images went on over the network when compressed ones had been found a moment later."""
    front = RigCamera("front", 64, 48, np.diag([50.0, 50.0, 1.0]), np.eye(4))
    info, raw, small = "/front/camera_info", "/front/image_raw", "/front/image_raw/compressed"
    graph.send(TF_STATIC, convert.tf_static(Rig((front,)), START))
    graph.send(info, convert.camera_info(front, START))
    for sent, heard in (([info, raw], raw), ([info, raw, small], small), ([], None), ([info, raw], raw)):
        graph.published[:] = map(publisher, sent)
        wanted = {topic: topic == heard for topic in (raw, small)}
        graph.until(lambda wanted=wanted: {t: graph.wire.is_heard("test", t, kind_of(t)) for t in wanted} == wanted)


def test_a_camera_that_no_view_can_be_made_of_is_left_out_and_told(graph: Graph) -> None:
    """Scaled to the page's width its images had no second row, and the page ended."""
    said: list[str] = []
    front = RigCamera("front", 64, 48, np.diag([50.0, 50.0, 1.0]), np.eye(4))
    flat = RigCamera("flat", 1024, 8, np.array([[800.0, 0, 511.5], [0, 800.0, 3.5], [0, 0, 1]]), np.eye(4))
    cameras = GraphCameras(replace(graph.setup, say=said.append), 32, Rig((front, flat)))
    graph.published += [publisher("/front/image_raw"), publisher("/flat/image_raw")]
    found = cameras()
    assert found is not None and [camera.name for camera in found.topics] == ["front"]
    assert cameras() is None
    graph.published[:] = [publisher("/flat/image_raw")]
    found = cameras()
    assert found == LiveCameras((), None)
    assert len(said) == 2 and all(line.startswith("not shown: camera flat") for line in said)


def test_a_rig_given_stands_in_for_what_the_graph_does_not_say(graph: Graph) -> None:
    front = RigCamera("cam_front", 64, 48, np.diag([50.0, 50.0, 1.0]), np.eye(4))
    cameras = GraphCameras(graph.setup, 32, Rig((front,)))
    assert cameras() is None
    graph.published += [publisher("/cam_front/image_raw/compressed"), publisher("/cam_left/image_raw/compressed")]
    found = cameras()
    assert found is not None and [camera.name for camera in found.topics] == ["cam_front"]
    assert cameras() is None
    graph.published[:] = [publisher("/cam_front/image_raw")]
    found = cameras()
    assert found is not None and found.topics[0].image == "/cam_front/image_raw", "as it is sent from now on"
    assert cameras() is None


def test_cameras_of_the_viewers_own_namespace_are_shown_under_their_own_names(graph: Graph) -> None:
    graph.wire.namespace = "/cell"
    front, left = (RigCamera(n, 64, 48, np.diag([50.0, 50.0, 1.0]), np.eye(4)) for n in ("cam_front", "cam_left"))
    cameras = GraphCameras(graph.setup, 32, Rig((front, left)))
    for topic in ("/cell/cam_front/image_raw", "/other/cam_front/image_raw", "/cam_left/image_raw"):
        graph.published.append(publisher(topic))
    found = cameras()
    assert found is not None
    assert [(camera.name, camera.image) for camera in found.topics] == [("cam_front", "/cam_front/image_raw")]


def test_a_message_that_cannot_be_shown_is_told_and_the_next_one_shown(graph: Graph) -> None:
    wrong = JointSample(START, ("axis_1", "axis_2"), np.zeros(2), np.zeros(2))
    graph.send(JOINT_STATES, convert.joint_sample_to_message(wrong))
    graph.until(lambda: "axis_1" in graph.node.diagnoses()[0].message)
    names = tuple(f"{j}_joint" for j in ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3"))
    right = JointSample(START, names, np.zeros(6), np.zeros(6))
    graph.send(JOINT_STATES, convert.joint_sample_to_message(right))
    graph.until(lambda: graph.handle("/arm/forearm_link").visible)
    graph.until(lambda: graph.node.diagnoses()[0].message == graph.page.url)


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_a_page_that_stands_still_says_so(graph: Graph, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(_snapshot: Snapshot) -> None:
        raise ZeroDivisionError

    monkeypatch.setattr(graph, "_show", fail)
    graph.send(GAUSSIANS, convert.gaussians_to_pointcloud2(cloud_at(0, True), START))
    graph.until(lambda: "drawing has failed" in graph.node.diagnoses()[0].message)


def test_a_halted_driver_is_told_beside_the_decision_that_it_does_not_follow(
    graph: Graph, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The page said "Speed 100 %, clear" of an arm that stood and waited for somebody."""
    told: list[str | None] = []
    monkeypatch.setattr(graph.page, "tell", told.append)

    def say(level: convert.Level, stamp: int) -> None:
        found = convert.Diagnosis("ur_driver: arm", level, "safety mode PROTECTIVE_STOP")
        others = convert.Diagnosis("recorder: log", convert.Level.ERROR, "the disk is full")
        graph.send(DIAGNOSTICS, convert.diagnostics_to_message(stamp, [others, found]), stamp)
        clear = Separation.without_pair(stamp, stamp, 1.0, "clear")
        graph.send(SEPARATION, convert.separation_to_message(clear), stamp)

    say(convert.Level.ERROR, START)
    graph.until(lambda: "the arm stands, its driver says: safety mode PROTECTIVE_STOP" in told)
    say(convert.Level.OK, START + PERIOD)
    graph.until(lambda: told[-1] is None)
    say(convert.Level.ERROR, START + 2 * PERIOD)
    graph.until(lambda: told[-1] is not None)
    graph.clock.stamp += 5_000_000_000  # it says no more
    graph.until(lambda: told[-1] is None)


def test_silence_is_told(graph: Graph) -> None:
    """Nothing more comes, and the page says so; the moving obstacles are out of force then."""
    graph.send(OBSTACLES, convert.obstacles_to_message(obstacles_at(0, START)))
    graph.until(lambda: graph.handle("/obstacles/MOVING/BOX") is not None)
    graph.clock.stamp = START + 5_000_000_000
    graph.until(lambda: "said nothing for 5 s" in graph.page._twin_words.content)
    assert not graph.handle("/obstacles/MOVING/BOX").visible


def test_two_seconds_are_remembered_and_forgotten_when_time_goes_back(graph: Graph) -> None:
    for k in range(30):
        stamp = START + k * PERIOD
        graph.send(OBSTACLES, convert.obstacles_to_message(obstacles_at(k, stamp)), stamp)
        while graph.executor.step(0.0):
            pass
    graph.until(lambda: bool(graph.snapshots) and graph.snapshots[-1].stamp == START + 29 * PERIOD)
    earlier = graph.snapshots[-1].earlier(OBSTACLES, 2_000_000_000)
    assert [said.stamp for said in earlier] == [START + k * PERIOD for k in range(9, 30)]
    graph.send(OBSTACLES, convert.obstacles_to_message(obstacles_at(0, START)))  # a log begins again
    graph.until(lambda: graph.snapshots[-1].stamp == START)
    assert len(graph.snapshots[-1].earlier(OBSTACLES, 2_000_000_000)) == 1


def test_a_grippers_joints_do_not_hide_the_arms(graph: Graph) -> None:
    arm = ur_model("ur10e")
    for names, at in ((arm.joint_names, START), (("finger_joint",), START + PERIOD)):
        sample = JointSample(at, names, np.full(len(names), 0.3), np.zeros(len(names)))
        graph.send(JOINT_STATES, convert.joint_sample_to_message(sample), at)
        while graph.executor.step(0.0):
            pass
    graph.until(lambda: bool(graph.snapshots) and graph.snapshots[-1].stamp == START + PERIOD)
    joints = graph.snapshots[-1].joints_of(arm.joint_names)
    assert joints is not None and joints.names == arm.joint_names


def test_nothing_is_drawn_for_nobody(monkeypatch: pytest.MonkeyPatch) -> None:
    """Visitors are asked for before every picture; the first comes after the fifth time."""
    asked: list[int] = []

    def visitors(_page: CellPage) -> int:
        asked.append(len(graph.snapshots))
        return int(len(asked) > 5)

    monkeypatch.setattr(CellPage, "visitors", property(visitors))
    graph = Graph()
    graph.send(GAUSSIANS, convert.gaussians_to_pointcloud2(cloud_at(0, True), START))
    graph.until(lambda: bool(graph.snapshots))
    graph.close()
    assert asked[:6] == [0] * 6


def test_a_port_in_use_is_an_error(graph: Graph) -> None:
    """Of the node that is configured: a spare is made beside the one that it stands by for."""
    make_viewer(graph.setup)
    port = int(graph.page.url.rpartition(":")[2])
    with pytest.raises(ViewerError, match=r"give another port or host .*viewer\.port:="):
        Graph({"viewer": {"port": port}})


@pytest.mark.parametrize(("name", "value"), [("width", 0), ("width", -160), ("width", 10**6), ("port", -1)])
def test_numbers_that_no_page_has_are_an_error_at_the_start(name: str, value: int) -> None:
    """A width of 0 was found out when the first camera came, in a timer: the node ended, and was started again."""
    with pytest.raises(ParameterError, match=f"viewer: {name}: expected .*, found {value}"):
        Graph({"viewer": {"port": free_port(), name: value}})


@pytest.mark.parametrize("namespace", ["/", "/cell"])
def test_the_page_of_a_namespace_goes_by_the_clock_that_was_renamed_for_it(namespace: str) -> None:
    """By the time of day all that a log's twin says was over."""
    wire = LocalWire()
    wire.namespace = namespace
    time_of_graph = GraphTime(wire, "viewer")
    assert time_of_graph.now() > START, "the time of day, until somebody tells another"
    for topic, stamp in ((CLOCK, START), ("/cell/clock", START // 2), ("/other/clock", START // 4), (CLOCK, START)):
        clock = encoded(convert.clock_to_message(stamp))
        wire.publisher("player", topic, TopicKind(clock.msgtype))(clock)
    assert round(START / time_of_graph.now()) == (1 if namespace == "/" else 2)
