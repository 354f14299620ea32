"""What a launch says of cameras that send nothing."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest

from twin_node.messages import convert
from twin_node.nodes.live.beside_twin import make_synchronizer
from twin_node.nodes.live.setup import Setup
from twin_node.nodes.live.silent_cameras import LOOK_S, PATIENCE_S
from twin_node.nodes.topics import RAW, kind_of
from twin_node.rig import RigFile, save_rig
from twin_node.runtime.clock import SystemClock
from twin_node.runtime.executor import Executor
from twin_node.runtime.qos import RELIABLE, TopicKind
from twin_node.runtime.rmw_zenoh import Endpoint, EntityKind, NodeIdentity
from twin_node.runtime.wire import LocalWire
from twin_node.runtime.wire_bus import WireBus
from twin_node.scene import Rig, RigCamera

NAMES = ("front", "left")


class Cell:
    """The synchroniser of a launch with two cameras, in a time of the test's own."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch, image: str = "image_raw") -> None:
        """`image`: what the driver calls its images."""
        self._image = image
        monkeypatch.setattr(time, "monotonic", lambda: self.now_s)
        self.now_s = 100.0
        K = np.array([[20.0, 0, 7.5], [0, 20.0, 5.5], [0, 0, 1]])
        save_rig(RigFile(Rig(tuple(RigCamera(name, 16, 12, K, np.eye(4)) for name in NAMES))), folder / "rig.yaml")
        self.wire, self.executor, self.said = LocalWire(), Executor(), list[str]()
        self.graph: tuple[Endpoint, ...] = ()
        bus, self.clock = WireBus(self.wire, self.executor, "synchronizer", kind_of), SystemClock()
        sections = {"/**": {"rig": {"file": str(folder / "rig.yaml"), "image": image}}}
        self.node = make_synchronizer(
            Setup(
                *("synchronizer", bus, self.clock, self.executor, sections, "test", lambda: None, lambda: self.graph),
                self.said.append,
            )
        )
        self.node.configure()
        self.node.activate()

    def publishes(self, node: str, topic: str) -> None:
        """A node of the graph does from now on."""
        self.graph += (
            Endpoint(EntityKind.PUBLISHER, NodeIdentity("ab", 0, node), 1, topic, RAW, "RIHS01_aa", RELIABLE),
        )

    def run(self, seconds: float, *cameras: str) -> list[str]:
        """What is said while `cameras` send every second."""
        until = self.now_s + seconds
        while self.now_s < until:
            self.now_s += LOOK_S
            for name in cameras:
                message = convert.raw_image(name, self.clock.now(), np.zeros((12, 16, 3), np.uint8))
                self.wire.publisher("driver", f"/{name}/{self._image}", TopicKind(RAW, RELIABLE))(message)
            while self.executor.step(0.0):
                pass
        said, self.said[:] = list(self.said), []
        return said


@pytest.fixture
def cell(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Cell:
    return Cell(tmp_path, monkeypatch)


def test_images_are_heard_whatever_their_driver_calls_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As ZED's and many others do; a launch was refused, with words for programmers."""
    cell = Cell(tmp_path, monkeypatch, image="rgb/image_rect_color")
    assert cell.run(PATIENCE_S + 5, *NAMES) == []


def test_who_sees_nothing_says_which_topics_nobody_publishes(cell: Cell) -> None:
    """A launch beside ROS 2 nodes on DDS, which it does not hear, said that it was active, and nothing more."""
    assert cell.run(PATIENCE_S - 1) == []
    (line,) = cell.run(60)
    assert line.startswith("no image of front, left: nobody publishes /front/image_raw, /left/image_raw; ")
    assert "rmw_zenoh_cpp" in line


def test_a_camera_of_whose_publisher_nothing_comes_is_told_with_it(cell: Cell) -> None:
    cell.publishes("realsense", "/front/image_raw")
    cell.publishes("realsense", "/left/image_raw")
    assert cell.run(60, "left") == ["no image of front: realsense publishes /front/image_raw, but nothing comes"]
    assert cell.run(60, "left", "front") == ["images of front come"]


def test_a_camera_that_sends_rarely_is_told_of_ever_more_rarely(cell: Cell) -> None:
    told = 0
    for _ in range(40):
        told += len(cell.run(PATIENCE_S + 3, "left")) + len(cell.run(LOOK_S, "left", "front"))
    assert told == 2


def test_cameras_that_send_are_not_told_of(cell: Cell) -> None:
    assert cell.run(10 * PATIENCE_S, *NAMES) == []
