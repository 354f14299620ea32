"""The simulated cell as a live source: sets of all cameras and the arm by the wall clock, until its time is over."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import yaml

from twin_node.cell import SimulatedRig, load_scenario
from twin_node.cell.ur_arm import ArmInCell
from twin_node.cell.ur_sim import StandInParameters
from twin_node.messages import convert, header_stamp
from twin_node.nodes.live.arm_stand_in import UrSimNode, UrSimParameters
from twin_node.nodes.live.cameras import CamerasNode, make_cameras
from twin_node.nodes.live.cell import CellNode, CellParameters
from twin_node.nodes.live.rig_messages import depth_message, publish_calibration, publish_image
from twin_node.nodes.live.rig_source import RigParameters, topics_of
from twin_node.nodes.live.setup import Setup
from twin_node.nodes.topics import FRUSTA, JOINT_STATES, TF_STATIC, TRAJECTORY, GraphError, kind_of
from twin_node.rig.cameras import CameraHealth, CameraImage
from twin_node.runtime.clock import SystemClock
from twin_node.runtime.executor import Executor
from twin_node.runtime.node import Node
from twin_node.runtime.wire import LocalWire
from twin_node.runtime.wire_bus import WireBus
from twin_node.scene import JointSample, Rig, RigCamera

RIG = RigParameters(scenario="demo", image="image_raw", depth="depth/image_rect")
WAIT_S = 60.0


def test_a_cell_cannot_run_for_less_than_no_time() -> None:
    """A launch was over at once, as if all had been done."""
    with pytest.raises(GraphError, match="duration: expected a number of 0 or more, found -5"):
        CellParameters(rig=RIG, duration=-5.0)


def test_a_cell_sends_what_a_rig_would() -> None:
    wire, executor, finished = LocalWire(), Executor(), threading.Event()
    heard: dict[str, list[Any]] = {}
    cameras = [topics_of(name, RIG) for name in ("cam_back", "cam_front", "cam_left")]
    wanted = [*(t for c in cameras for t in (c.image, c.depth, c.info) if t), JOINT_STATES, TRAJECTORY, TF_STATIC]
    for topic in wanted:
        wire.subscribe("test", topic, kind_of(topic), heard.setdefault(topic, []).append)
    bus = WireBus(wire, executor, "cell", kind_of)
    setup = Setup("cell", bus, SystemClock(), executor, {}, "test", finished.set, wire.endpoints)
    node = CellNode(setup, CellParameters(rig=RIG, duration=1.0))
    begun = time.time_ns()
    node.configure()
    node.activate()
    while not finished.is_set():
        executor.step(0.05)
    node.deactivate()
    node.cleanup()
    for camera in cameras:
        stamps = [header_stamp(message) for message in heard[camera.image]]
        assert stamps
        assert begun <= stamps[0] <= stamps[-1] <= time.time_ns()
        assert stamps == sorted(set(stamps))
        assert stamps == [header_stamp(message) for message in heard[str(camera.depth)]]
    joints = [header_stamp(message) for message in heard[JOINT_STATES]]
    assert joints == sorted(joints)
    assert len(joints) > len(heard[TRAJECTORY]) > 0
    assert len(heard[TF_STATIC]) == 1


@pytest.mark.parametrize("image", ["image_raw", "color/image_raw", "/{camera}/{camera}/rgb/image_raw"])
def test_calibration_is_where_the_images_are(image: str) -> None:
    """What late listeners are given was always on `/CAMERA/camera_info`: a topic beside which no image ever came."""
    sent: list[str] = []
    bus = SimpleNamespace(publish=lambda topic, _: sent.append(topic))
    camera, parameters = RigCamera("left", 4, 3, np.eye(3), np.eye(4)), RigParameters(image=image)
    publish_calibration(bus, Rig((camera,)), parameters, 0)
    publish_image(bus, topics_of("left", parameters), camera, 0, np.zeros((3, 4, 3), np.uint8), None)
    assert sent[:2] == [TF_STATIC, sent[2]]


def test_a_reader_that_hangs_holds_no_camera_up() -> None:
    """A recorder that was stopped let the cameras' CameraInfo wait for five seconds, their images with it, and the arm
    stood: what is latched waits for a reader's room unless it soon comes anew."""
    sent: list[str] = []
    bus = SimpleNamespace(publish=lambda topic, _: sent.append(topic))
    camera = RigCamera("left", 4, 3, np.eye(3), np.eye(4))
    topics = topics_of("left", RIG)
    image = np.zeros((3, 4, 3), np.uint8)
    publish_image(bus, topics, camera, 0, image, depth_message(topics, 0, np.ones((3, 4), np.float32)))
    assert sent == [topics.info, topics.depth, topics.image]
    for topic in (*sent, FRUSTA):
        kind = kind_of(topic)
        assert kind is not None
        assert kind.qos.repeats or not kind.qos.latched, topic


@pytest.mark.parametrize("model", ["", "ur10e"])
def test_an_arm_that_a_driver_moves_is_drawn_where_its_joints_are(model: str) -> None:
    """It was drawn on the scenario's cycle: a ghost that went through the arm, for which that stood for good."""
    wire, executor, finished = LocalWire(), Executor(), threading.Event()
    bus, images = WireBus(wire, executor, "cell", kind_of), list[Any]()
    topics = topics_of("cam_front", RIG)
    wire.subscribe("test", str(topics.depth), kind_of(str(topics.depth)), images.append)
    setup = Setup("cell", bus, SystemClock(), executor, {}, "test", finished.set, wire.endpoints)
    node = CellNode(setup, CellParameters(rig=RIG, duration=30.0, arm="driver", model=model))
    scenario = load_scenario("demo")
    assert scenario.arm is not None
    simulated, arm = SimulatedRig(scenario), ArmInCell(replace(scenario.arm, model=model or "ur5e"), scenario)
    camera = [one.name for one in simulated.cameras].index("cam_front")
    turned = arm.cycle.at(0) + np.array([0.4, 0.1, 0.0, 0.0, 0.0, 0.0])
    shown = [
        simulated.renderers[camera].render(arm.solids_at(q, len(simulated.world.names) - 1)).depth
        for q in (turned, arm.cycle.at(0))
    ]
    only_there = (shown[0] < shown[1] - 0.1) & (shown[0] > 0)
    node.configure()
    node.activate()
    for told in (False, True):
        if told:
            joints = JointSample(time.time_ns(), arm.model.joint_names, turned, np.zeros(6))
            bus.publish(JOINT_STATES, convert.joint_sample_to_message(joints))
        before, deadline = len(images), time.monotonic() + WAIT_S
        while len(images) < before + 3 and time.monotonic() < deadline:
            executor.step(0.05)
        seen = convert.depth_from_message(images[-1])
        there = np.abs(seen - shown[0])[only_there & (seen > 0)] < 0.05
        assert len(there) > 100
        assert there.mean() > 0.8 if told else there.mean() < 0.1
    node.deactivate()
    node.cleanup()


def test_a_cell_whose_cameras_are_silent_to_its_end_takes_its_time_and_ends(tmp_path: Path) -> None:
    """Its next run began at once when the last image was out: with none at all it never came to look at the clock."""
    fault = {"kind": "missing", "camera": "one", "from_s": 0.0}
    silent = {"duration_s": 0.1, "cameras": [{"name": "one"}], "faults": [fault]}
    (tmp_path / "silent.yaml").write_text(yaml.safe_dump(silent))
    wire, executor, finished = LocalWire(), Executor(), threading.Event()
    bus = WireBus(wire, executor, "cell", kind_of)
    setup = Setup("cell", bus, SystemClock(), executor, {}, "test", finished.set, wire.endpoints)
    rig = RigParameters(scenario=str(tmp_path / "silent.yaml"), image="image_raw")
    node = CellNode(setup, CellParameters(rig=rig, duration=0.25))
    node.configure()
    begun = time.monotonic()
    node.activate()
    in_time = finished.wait(10.0)
    took_s = time.monotonic() - begun
    node.deactivate()
    node.cleanup()
    assert in_time
    assert took_s >= 0.25


def test_faults_of_cameras_are_those_of_logs(tmp_path: Path) -> None:
    """Stamps and depth went out as if nothing were wrong."""
    faults = [{"kind": kind, "camera": "one"} for kind in ("unsorted_stamps", "nan_depth")]
    sensing = {"width": 32, "height": 24, "rate_hz": 40.0}
    faulty = {"duration_s": 0.5, "cameras": [{"name": "one"}], "sensing": sensing, "faults": faults}
    (tmp_path / "faulty.yaml").write_text(yaml.safe_dump(faulty))
    wire, executor, finished = LocalWire(), Executor(), threading.Event()
    rig = RigParameters(scenario=str(tmp_path / "faulty.yaml"), image="image_raw", depth="depth/image_rect")
    topics, heard = topics_of("one", rig), dict[str, list[Any]]()
    for topic in (topics.image, str(topics.depth)):
        wire.subscribe("test", topic, kind_of(topic), heard.setdefault(topic, []).append)
    bus = WireBus(wire, executor, "cell", kind_of)
    setup = Setup("cell", bus, SystemClock(), executor, {}, "test", finished.set, wire.endpoints)
    node = CellNode(setup, CellParameters(rig=rig, duration=0.4))
    node.configure()
    node.activate()
    assert finished.wait(WAIT_S)
    node.deactivate()
    node.cleanup()
    executor.step(0.0)
    stamps = [header_stamp(message) for message in heard[topics.image]]
    assert len(stamps) > 2 and stamps != sorted(stamps)
    depth = heard[str(topics.depth)][0]
    assert depth.encoding == "32FC1" and np.isnan(np.asarray(depth.data).view(np.float32)).all()


class FailingSource:
    """Cameras whose driver fails in a way that nobody has thought of."""

    cameras: tuple[str, ...] = ()
    health: tuple[CameraHealth, ...] = ()

    def images(self) -> Iterator[CameraImage]:
        raise RuntimeError("cannot go on")

    def close(self) -> None:
        pass


def test_images_that_the_computer_had_no_time_for_are_told_while_they_are_lost() -> None:
    source, wire, executor = FailingSource(), LocalWire(), Executor()
    source.cameras = ("cam_left",)
    bus = WireBus(wire, executor, "cameras", kind_of)
    setup = Setup("cameras", bus, SystemClock(), executor, {}, "test", lambda: None, wire.endpoints)
    node, told = CamerasNode(setup, source, RIG), []
    for lost in (0, 7, 7, 9):
        source.health = (CameraHealth("cam_left", True, "connected", lost=lost),)
        (one,) = node.diagnoses()
        told.append((one.level, one.message.partition(":")[0]))
        assert ("lost", str(lost)) in [(reading.key, reading.value) for reading in one.readings]
    ok, warn = convert.Level.OK, convert.Level.WARN
    assert told == [
        (ok, "connected"),
        (warn, "7 images lost since the last report"),
        (ok, "connected"),
        (warn, "2 images lost since the last report"),
    ]


@pytest.mark.parametrize("kind", ["cell", "cameras"])
def test_a_source_that_fails_ends_its_process(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its thread alone would leave a process that is alive and sends nothing, and that nobody starts again."""
    finished, wire, executor = threading.Event(), LocalWire(), Executor()
    bus = WireBus(wire, executor, kind, kind_of)
    setup = Setup(kind, bus, SystemClock(), executor, {}, "test", finished.set, wire.endpoints)
    node: Node = CamerasNode(setup, FailingSource(), RIG) if kind == "cameras" else CellNode(setup, CellParameters(RIG))

    def fail(*_: object) -> None:
        raise RuntimeError("cannot go on")

    monkeypatch.setattr(CellNode, "_publish", fail)
    node.configure()
    node.activate()
    assert finished.wait(WAIT_S)
    node.deactivate()
    with pytest.raises(RuntimeError, match="cannot go on"):
        node.cleanup()


@pytest.mark.parametrize(
    ("addresses", "told"),
    [
        (("0", "2"), ["'cam_left' at 0, 'cam_back' at 2"]),
        (("0", "/dev/v4l/by-path/b"), []),
        (("rtsp://a", "b.avi"), []),
    ],
)
def test_usb_cameras_that_may_change_places_are_told(addresses: tuple[str, str], told: list[str]) -> None:
    """The computer starts anew, and what one camera sees is put where the other one looks, in silence."""
    said: list[str] = []
    wire, executor = LocalWire(), Executor()
    bus = WireBus(wire, executor, "cameras", kind_of)
    names = zip(("cam_left", "cam_back"), addresses, strict=True)
    listed = {"opencv": [{"name": name, "address": address} for name, address in names], "rig": {"scenario": "demo"}}
    setup = Setup(
        *("cameras", bus, SystemClock(), executor, {"cameras": listed}, "test", lambda: None, wire.endpoints),
        say=said.append,
    )
    node = make_cameras(setup)
    assert not said, "a spare is made as well"
    node.configure()
    assert [line.split(":")[0] for line in said] == [f"cameras {names}" for names in told]


@pytest.mark.parametrize("model", ["ur5e", "ur3e"])
def test_the_stand_ins_program_is_made_for_the_scenario(monkeypatch: pytest.MonkeyPatch, model: str) -> None:
    """For the table that cameras show around it, whichever arm is driven."""
    given = list[StandInParameters]()

    class Noted:
        def __init__(self, parameters: StandInParameters) -> None:
            given.append(parameters)

        async def run(self, on_listening: Callable[[], None]) -> None:
            on_listening()

    monkeypatch.setattr("twin_node.nodes.live.arm_stand_in.StandIn", Noted)
    wire, executor = LocalWire(), Executor()
    bus = WireBus(wire, executor, "ur_sim", kind_of)
    setup = Setup("ur_sim", bus, SystemClock(), executor, {}, "test", lambda: None, wire.endpoints)
    node = UrSimNode(setup, UrSimParameters(model=model, rig=RIG))
    node.configure()
    node.activate()
    node.deactivate()
    node.cleanup()
    scenario = load_scenario("demo")
    assert scenario.arm is not None
    there = ArmInCell(replace(scenario.arm, model=model), scenario)
    controller = given[0].controller
    assert controller.model.name == model
    assert controller.cycle is not None
    assert np.array_equal(controller.cycle.template.positions, there.cycle.template.positions)


def test_a_controller_that_fails_ends_its_process(monkeypatch: pytest.MonkeyPatch) -> None:
    class FailingStandIn:
        def __init__(self, _: object) -> None:
            pass

        async def run(self, on_listening: Callable[[], None]) -> None:
            on_listening()
            raise RuntimeError("cannot go on")

    monkeypatch.setattr("twin_node.nodes.live.arm_stand_in.StandIn", FailingStandIn)
    finished, wire, executor = threading.Event(), LocalWire(), Executor()
    bus = WireBus(wire, executor, "ur_sim", kind_of)
    setup = Setup("ur_sim", bus, SystemClock(), executor, {}, "test", finished.set, wire.endpoints)
    node = UrSimNode(setup, UrSimParameters())
    node.configure()
    with contextlib.suppress(RuntimeError):  # it may fail before it is asked, too
        node.activate()
    assert finished.wait(WAIT_S)
    node.deactivate()
    with pytest.raises(RuntimeError, match="cannot go on"):
        node.cleanup()
