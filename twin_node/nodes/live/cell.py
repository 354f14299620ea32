"""The simulated cell as a live source: cameras and arm by the wall clock."""

from __future__ import annotations

import math
import threading
from dataclasses import dataclass, field, replace

from twin_node.cell import SimulatedRig, load_scenario
from twin_node.cell.record import TRAJECTORY_RATE_HZ, nan_depth
from twin_node.cell.sensor import RawImage
from twin_node.cell.simulator import Exposure
from twin_node.cell.ur_arm import HeardArm
from twin_node.messages import Message, convert
from twin_node.nodes.live.own_thread import OwnThread
from twin_node.nodes.live.rig_messages import depth_message, publish_calibration, publish_image
from twin_node.nodes.live.rig_source import RigParameters, topics_of
from twin_node.nodes.live.setup import Setup
from twin_node.nodes.topics import COMPRESSED, JOINT_STATES, TRAJECTORY, CameraTopics, GraphError
from twin_node.ranges import NOT_NEGATIVE, check_ranges
from twin_node.runtime.node import Node

SCENARIOS_OWN = "scenario"
"""The `arm` that moves as the scenario has it."""


@dataclass(frozen=True)
class CellParameters:
    """What is simulated, and how it is sent."""

    rig: RigParameters = field(default_factory=RigParameters)
    duration: float = 0.0
    """Seconds to run, s; the scenario begins again when it is over, and stamps go on. 0: until stopped."""
    arm: str = SCENARIOS_OWN
    """`scenario`: it follows its cycle, and its joints and path are published too; anything else: a driver does that,
    and the arm is drawn where its joints are heard to be."""
    model: str = ""
    """Of `twin_node.robot.UR_NAMES`, the arm that a driver moves; empty: as the scenario's."""

    def __post_init__(self) -> None:
        """Raises `GraphError` for a duration below 0, which would be over at once."""
        check_ranges(self, GraphError, "", duration=NOT_NEGATIVE)


def make_cell(setup: Setup) -> Node:
    """The simulated cell of `rig.scenario`."""
    return CellNode(setup, setup.parameters(CellParameters))


class CellNode(Node):
    """Renders what is due, when it is due; a set that it cannot begin in time is left out, and counted."""

    def __init__(self, setup: Setup, parameters: CellParameters) -> None:
        super().__init__(setup.name, setup.bus, setup.clock)
        self._parameters = parameters
        self._finish = setup.finish
        self._simulated = SimulatedRig(load_scenario(parameters.rig.scenario), draws_noise_once=True)
        scenario = self._simulated.scenario
        self._heard_arm: HeardArm | None = None
        """The arm, where somebody else moves it."""
        if scenario.arm is not None and parameters.arm != SCENARIOS_OWN:
            driven = replace(scenario.arm, model=parameters.model or scenario.arm.model)
            self._heard_arm = self._simulated.world.arm = HeardArm(driven, scenario)
        self._period_ns = int(1e9 / scenario.sensing.rate_hz)
        self._stop = threading.Event()
        self._thread = OwnThread("cell", self._send, setup.finish)
        self._begun: int | None = None
        self._timers = setup.timers
        self.skipped = 0

    def on_configure(self) -> None:
        scenario = self._simulated.scenario
        heard = self._heard_arm
        if heard is not None:
            self.bus.subscribe(JOINT_STATES, lambda told: heard.hear(convert.joint_sample_from_message(told)))
        elif scenario.arm is not None:
            self._timers.every(1 / scenario.arm.joint_rate_hz, self._publish_joints)
            self._timers.every(1 / TRAJECTORY_RATE_HZ, self._publish_path)

    def on_activate(self) -> None:
        publish_calibration(self.bus, self._simulated.rig, self._parameters.rig, self.clock.now())
        self._stop.clear()
        self._thread.start()

    def on_deactivate(self) -> None:
        self._stop.set()
        self._thread.join()

    def on_cleanup(self) -> None:
        """Raises what ended the images before their time."""
        self._thread.check()

    def diagnoses(self) -> tuple[convert.Diagnosis, ...]:
        """How many images came too late to be made."""
        readings = (convert.Reading("skipped_images", str(self.skipped)),)
        return (convert.Diagnosis(f"{self.name}: cameras", convert.Level.OK, "simulated", readings),)

    def _send(self) -> None:
        exposures, start = self._simulated.exposures(), self._simulated.scenario.start_ns
        until = self._parameters.duration * 1e9 or math.inf
        self._begun = first = self.clock.now()
        tick, is_late = -1, False
        while not self._stop.is_set():
            for exposure in exposures:
                stamp = self._begun + exposure.stamp - start
                if stamp - first > until:
                    self._finish()
                    return
                if self._stop.wait(max(0.0, (stamp - self.clock.now()) / 1e9)):
                    return
                if exposure.tick != tick:
                    tick, is_late = exposure.tick, self.clock.now() - stamp > self._period_ns
                if is_late:
                    self.skipped += 1
                else:
                    self._publish(exposure, stamp)
            over = self._begun + round(self._simulated.scenario.duration_s * 1e9)
            if self._stop.wait(max(0.0, (min(over, first + until) - self.clock.now()) / 1e9)):
                return
            if over - first >= until:
                self._finish()
                return
            self._begun = self.clock.now()

    def _publish(self, exposure: Exposure, stamp: int) -> None:
        if self._heard_arm is not None:
            self._heard_arm.teller_ahead_ns = stamp - exposure.stamp
        image = self._simulated.take(exposure)
        stamp += image.stamp - exposure.stamp  # but for a fault of the camera's they are the same
        topics = topics_of(image.camera, self._parameters.rig)
        camera = self._simulated.rig.cameras[exposure.camera]
        depth = None if topics.depth is None else _depth(image, stamp, topics)
        publish_image(self.bus, topics, camera, stamp, image.rgb, depth)

    def _publish_joints(self) -> None:
        arm, begun = self._simulated.world.arm, self._begun
        if arm is not None and begun is not None:
            stamp = self.clock.now()
            sample = replace(arm.sample(self._simulated_time(stamp - begun)), stamp=stamp)
            self.bus.publish(JOINT_STATES, convert.joint_sample_to_message(sample))

    def _publish_path(self) -> None:
        arm, begun = self._simulated.world.arm, self._begun
        if arm is not None and begun is not None:
            stamp = self.clock.now()
            simulated = self._simulated_time(stamp - begun)
            path = arm.ahead(simulated)
            moved = replace(path, stamps=path.stamps + stamp - simulated)
            self.bus.publish(TRAJECTORY, convert.joint_path_to_message(moved))

    def _simulated_time(self, passed: int) -> int:
        """The scenario's time, ns, when so much has passed since it began."""
        scenario = self._simulated.scenario
        return scenario.start_ns + min(passed, int(scenario.duration_s * 1e9))


def _depth(image: RawImage, stamp: int, topics: CameraTopics) -> Message:
    if image.depth_is_nan and topics.depth_type != COMPRESSED:
        return nan_depth(image, stamp)
    return depth_message(topics, stamp, image.depth_m)
