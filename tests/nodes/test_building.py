"""The examples of `docs/building.md` run as they stand."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any
from unittest.mock import MagicMock

import numpy as np
import pytest

from twin_node.messages import convert, message_type
from twin_node.nodes.live.setup import Setup
from twin_node.nodes.topics import kind_of
from twin_node.rig import RigFile, save_rig
from twin_node.rig.cameras import CameraImage, SynchronizedSource
from twin_node.robot import forward_kinematics, ur_model
from twin_node.runtime.clock import SystemClock
from twin_node.runtime.executor import Executor
from twin_node.runtime.qos import TopicKind
from twin_node.runtime.wire import LocalWire
from twin_node.runtime.wire_bus import WireBus
from twin_node.scene import FrameSet, JointSample, ObstacleKind, Obstacles, ObstacleShape, Rig, RigCamera

ARM = ur_model("ur5e")
READY = np.array([0.0, -1.5, 1.5, -1.5, -1.57, 0.0])
TURNING = np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.0])
PAGE = Path(__file__).resolve().parents[2] / "docs" / "building.md"
NOW = 1_700_000_000_000_000_000


def example(monkeypatch: pytest.MonkeyPatch, number: int, **given: object) -> Any:
    """A module of one of the page's blocks of Python; names that it takes for granted are given."""
    block = re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.S)[number]
    module = ModuleType("example")
    monkeypatch.setitem(sys.modules, "example", module)
    vars(module).update(given)
    exec(compile(block, str(PAGE), "exec", dont_inherit=True), vars(module))
    return module


def box_at(x: float) -> Obstacles:
    column, stamps = np.zeros(1, np.uint8), np.array([NOW])
    kinds, shapes = column + np.uint8(ObstacleKind.MOVING), column + np.uint8(ObstacleShape.BOX)
    place, size, turn = np.array([[x, 0.0, 0.0]]), np.full((1, 3), 0.1), np.eye(4)[:1]
    return Obstacles(
        NOW, column.astype(np.uint32), kinds, shapes, place, turn, size, 0 * place, np.zeros(1), stamps, stamps
    )


def test_a_node_of_another_package(monkeypatch: pytest.MonkeyPatch) -> None:
    wire, executor, alarms = LocalWire(), Executor(), []
    bus = WireBus(wire, executor, "guard", kind_of)
    sections = {"guard": {"radius": 0.3}}
    setup = Setup("guard", bus, SystemClock(), executor, sections, "test", executor.stop, wire.endpoints)
    node = example(monkeypatch, 0).make_guard(setup)
    node.configure()
    node.activate()
    wire.subscribe("test", "/guard/alarm", TopicKind("std_msgs/msg/Bool"), alarms.append)
    send = {topic: wire.publisher("test", topic, TopicKind(None)) for topic in ("/cell/door", "/twin/obstacles")}
    send["/cell/door"](message_type("std_msgs/msg/Bool")(data=True))
    for x in (1.2, 1.4):
        send["/twin/obstacles"](convert.obstacles_to_message(box_at(x)))
        while executor.step(0.0):
            pass
    assert [alarm.data for alarm in alarms] == [True, False]


class TwoCameras:
    """A driver of one's own: what stands on a table, and something that slides over it."""

    cameras, health = ("left", "right"), ()

    def __init__(self) -> None:
        self.now = NOW
        self._table = np.random.default_rng(0).integers(0, 255, (36, 48, 3), np.uint8)

    def images(self) -> Iterator[CameraImage]:
        for number in range(4):
            self.now = NOW + 33_000_000 * number
            rgb, depth = self._table.copy(), np.full((36, 48), 1.5, np.float32)
            rgb[10:20, 10 + 3 * number : 20 + 3 * number], depth[10:20, 10 + 3 * number : 20 + 3 * number] = 200, 1.3
            for name in self.cameras:
                yield CameraImage(name, self.now, rgb, depth)

    def close(self) -> None:
        pass


class WithJoints(SynchronizedSource):
    """Knows where the arm is, as if another thread had told."""

    def __iter__(self) -> Iterator[FrameSet]:
        self.add_joints(JointSample(NOW, ARM.joint_names, READY, np.zeros(6)))
        return super().__iter__()


class Obeying:
    """Sets of an arm that means to sweep to its left, and goes as fast as the example lets it."""

    cameras = ()

    def __init__(self, *_: object, **__: object) -> None:
        pass

    def __iter__(self) -> Iterator[FrameSet]:
        q = READY
        for number in range(12):
            qd = sys.modules["example"].share * TURNING
            q = q + 0.033 * qd
            stamp = NOW + 33_000_000 * number
            yield FrameSet(stamp, (), JointSample(stamp, ARM.joint_names, q, qd))


def at_their_place(cameras: TwoCameras, monkeypatch: pytest.MonkeyPatch, folder: Path) -> None:
    """The rig file that the example reads, where it is run, at the cameras' time."""
    K = np.array([[40.0, 0, 23.5], [0, 40, 17.5], [0, 0, 1]])
    poses = [np.diag([1.0, -1, -1, 1]) + np.outer([x, 0, 1.5, 0], [0, 0, 0, 1]) for x in (0.4, 0.6)]
    rig = Rig(tuple(RigCamera(name, 48, 36, K, pose) for name, pose in zip(cameras.cameras, poses, strict=True)))
    save_rig(RigFile(rig), folder / "my_rig.yaml")
    monkeypatch.chdir(folder)
    monkeypatch.setattr("time.time_ns", lambda: cameras.now)


def test_cameras_of_ones_own_without_a_graph(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    cameras = TwoCameras()
    at_their_place(cameras, monkeypatch, tmp_path)
    monkeypatch.setattr("twin_node.rig.cameras.SynchronizedSource", WithJoints)
    made = example(monkeypatch, 1, cameras=cameras)
    assert (made.obstacles.kinds == ObstacleKind.MOVING).any()
    assert re.fullmatch(r"(\d+%, told \d+%: [a-zA-Z; ]+\n)+", capsys.readouterr().out)


def test_an_arm_that_stands_for_somebody_is_not_let_go_by_the_example(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """It was judged by the velocity that was measured: an arm that stood closed in on nobody, and went on."""
    beside = forward_kinematics(ARM, READY)[-1, :3, 3] + [0.0, 0.25, 0.0]

    def somebody(*_: object) -> Obstacles:
        now = sys.modules["example"].frames.stamp
        monkeypatch.setattr("time.time_ns", lambda: now)
        there = replace(box_at(0.0), stamp=now, positions=beside[None], sizes=np.full((1, 3), 0.1))
        return replace(there, valid_from=np.array([now]), valid_to=np.array([now + 200_000_000]))

    for name in ("rig.cameras.SynchronizedSource", "forecast.cover", "forecast.Forecaster", "model.WindowModel"):
        monkeypatch.setattr(f"twin_node.{name}", MagicMock())
    monkeypatch.setattr("twin_node.rig.cameras.SynchronizedSource", Obeying)
    monkeypatch.setattr("twin_node.forecast.cover", somebody)
    monkeypatch.setattr("twin_node.rig.drift_report.DriftReport.trusted", lambda _, frames: frames)
    rig = Rig((), workspace=np.array([[0.1, -0.6, 0.0], [0.8, 0.6, 0.5]]))
    monkeypatch.setattr("twin_node.nodes.calibration.load_base_rig", lambda _: rig)
    example(monkeypatch, 1, cameras=())
    told = capsys.readouterr().out.splitlines()
    assert told[1] == "100%, told 4%: not closing in; speeding up"
    assert set(told[2:]) == {"0%, told 0%: stopped for MOVING"}


class OneHangs(TwoCameras):
    """The left camera sends its twelfth image again and again, with new stamps."""

    def images(self) -> Iterator[CameraImage]:
        noise, hung = np.random.default_rng(1), None
        for number in range(16):
            self.now = NOW + 33_000_000 * number
            for name in self.cameras:
                rgb = self._table + noise.integers(0, 3, self._table.shape, np.uint8)
                image = CameraImage(name, self.now, rgb, np.full((36, 48), 1.5, np.float32))
                hung = image if (name, number) == ("left", 11) else hung
                yield replace(hung, stamp=self.now) if hung is not None and name == "left" else image


def test_the_example_leaves_out_a_camera_that_hangs(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """It would show for ever that nobody has come."""
    cameras = OneHangs()
    at_their_place(cameras, monkeypatch, tmp_path)
    made = example(monkeypatch, 1, cameras=cameras)
    assert [view.camera.name for view in made.seen.frames.views] == ["right"]
