"""Depth of a live graph's cameras of foreign drivers: what it was seen by is told by its CameraInfo alone."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from twin_node.messages import convert
from twin_node.nodes.calibration import depth_lens_of
from twin_node.nodes.live.beside_twin import make_synchronizer
from twin_node.nodes.live.setup import Setup
from twin_node.nodes.topics import FRAMES, RAW, CameraTopics, kind_of
from twin_node.rig import RigFile, save_rig
from twin_node.runtime.clock import SystemClock
from twin_node.runtime.executor import Executor
from twin_node.runtime.qos import Qos, TopicKind
from twin_node.runtime.rmw_zenoh import Endpoint, EntityKind, NodeIdentity
from twin_node.runtime.wire import LocalWire
from twin_node.runtime.wire_bus import WireBus
from twin_node.scene import FrameSet, Rig, RigCamera

BENT, STRAIGHT = np.array([-0.3, 0.1, 0.0, 0.0, 0.0]), np.zeros(5)
LENS = RigCamera("oak", 64, 48, np.array([[60.0, 0, 31.5], [0, 60, 23.5], [0, 0, 1]]), np.eye(4), D=BENT)
COLUMNS = np.tile(np.arange(1, 65, dtype=np.float32), (48, 1))


class Graph:
    """A live synchroniser of one camera, whose rig file has been calibrated anew, and what its driver says."""

    def __init__(self, folder: Path) -> None:
        K = LENS.K * [[1.01], [1.01], [1]]
        save_rig(RigFile(Rig((replace(LENS, K=K),))), folder / "rig.yaml")
        self.wire, self.executor, self.said = LocalWire(), Executor(), list[str]()
        rig = {"file": str(folder / "rig.yaml"), "image": "rgb/image_raw", "depth": "stereo/image_raw"}
        self.sets: list[FrameSet] = []
        self.graph: tuple[Endpoint, ...] = ()
        bus, clock = WireBus(self.wire, self.executor, "synchronizer", kind_of), SystemClock()
        bus.subscribe(FRAMES, self.sets.append)
        sections = {"/**": {"rig": rig}}
        setup = Setup(
            *("synchronizer", bus, clock, self.executor, sections, "test", lambda: None, lambda: self.graph),
            self.said.append,
        )
        self.node = make_synchronizer(setup)
        self.node.configure()
        self.node.activate()
        self.stamp = clock.now()

    def send(self, topic: str, message: object) -> None:
        self.wire.publisher("driver", topic, TopicKind(message.__msgtype__, kind_of(topic).qos))(message)
        while self.executor.step(0.0):
            pass

    def tell(self) -> None:
        """One set: the camera measured at each pixel what column that is in."""
        self.stamp += 1_000_000
        self.send("/oak/stereo/image_raw", convert.depth_image("oak", self.stamp, COLUMNS))
        self.send("/oak/rgb/image_raw", convert.raw_image("oak", self.stamp, np.zeros((48, 64, 3), np.uint8)))

    def depth(self) -> np.ndarray:
        """How far the depth of one set is from the column that it is in, px."""
        self.tell()
        (view,) = self.sets.pop().views
        assert view.depth is not None
        return view.depth[4:-4, 4:-4] - COLUMNS[4:-4, 4:-4]


@pytest.mark.parametrize(("of_depth", "is_straight"), [(STRAIGHT, True), (BENT, False), (None, False)])
def test_depth_is_that_of_the_lens_that_its_camera_info_tells(
    tmp_path: Path, of_depth: np.ndarray | None, is_straight: bool
) -> None:
    """depthai_ros aligns depth without the image's distortion: with a rig file it was up to pixels off, in silence."""
    graph = Graph(tmp_path)
    off = np.abs(graph.depth()).max()
    graph.send("/oak/rgb/camera_info", convert.camera_info(LENS, graph.stamp))
    if of_depth is not None:
        graph.send("/oak/stereo/camera_info", convert.camera_info(replace(LENS, D=of_depth), graph.stamp))
    assert off >= 2.0
    assert (np.abs(graph.depth()).max() < 1.1) == is_straight
    assert not graph.said


def test_a_fisheye_whose_coefficients_are_zeros_is_no_straight_lens() -> None:
    camera = CameraTopics("oak", "/oak/rgb/image_raw", RAW, "/oak/rgb/camera_info")
    fisheye, straight = replace(LENS, distortion_model="equidistant", D=np.zeros(4)), replace(LENS, D=STRAIGHT)
    infos = [convert.camera_info(lens, 0) for lens in (fisheye, straight)]
    assert depth_lens_of(camera, *infos) is not None
    assert depth_lens_of(camera, *infos[1:], *infos[1:]) is None


def test_depth_that_is_not_aligned_is_told(tmp_path: Path) -> None:
    graph = Graph(tmp_path)
    before = graph.depth()
    graph.send("/oak/stereo/camera_info", convert.camera_info(replace(LENS, K=LENS.K * 0.8, D=STRAIGHT), graph.stamp))
    graph.send("/oak/rgb/camera_info", convert.camera_info(LENS, graph.stamp))
    (line,) = graph.said
    assert line.startswith("camera 'oak': expected depth aligned with its colour image") and "/oak/stereo" in line
    np.testing.assert_array_equal(graph.depth(), before)


@pytest.mark.parametrize("patience_ns", [10**18, 0])
def test_no_set_comes_before_the_lens_of_its_depth_where_that_is_about_to_be_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, patience_ns: int
) -> None:
    """The first set is what stands: with depth of the wrong lens its corners were things that moved for 20 s."""
    monkeypatch.setattr("twin_node.nodes.live.depth_lenses.PATIENCE_NS", patience_ns)
    graph = Graph(tmp_path)
    driver, info = NodeIdentity("1", 1, "oak"), "sensor_msgs/msg/CameraInfo"
    graph.graph = tuple(
        Endpoint(EntityKind.PUBLISHER, driver, k, f"/oak/{of}/camera_info", info, "RIHS01_0", Qos())
        for k, of in enumerate(("rgb", "stereo"))
    )
    graph.tell()
    graph.send("/oak/rgb/camera_info", convert.camera_info(LENS, graph.stamp))
    graph.tell()
    assert len(graph.sets) == (0 if patience_ns else 2), "who never tells it is not waited for any longer"
    graph.send("/oak/stereo/camera_info", convert.camera_info(replace(LENS, D=STRAIGHT), graph.stamp))
    assert np.abs(graph.depth()).max() < 1.1
