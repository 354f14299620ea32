"""What Foxglove and RViz show without plugins: obstacles, what cameras see, the speed decision and the arm's frames."""

from __future__ import annotations

from twin_node.messages import Message, convert
from twin_node.nodes.live.rig_source import RigSource, read_rig
from twin_node.nodes.live.setup import Setup
from twin_node.nodes.topics import (
    FRUSTA,
    JOINT_STATES,
    OBSTACLE_MARKERS,
    OBSTACLES,
    OCCUPANCY,
    OCCUPIED_POINTS,
    SEPARATION,
    SEPARATION_MARKER,
    TF,
)
from twin_node.robot import ArmModel, forward_kinematics
from twin_node.runtime.node import Node
from twin_node.runtime.rmw_zenoh import EntityKind

FRUSTA_PERIOD_S = 5.0
"""How often the frusta are sent again, for viewers that do not ask for what is latched."""
LOOK_NS = 1_000_000_000
"""How often it is looked who else publishes frames, and whether anybody looks at occupied space, ns."""


def make_viewer_topics(setup: Setup) -> Node:
    """Markers and frames of the graph that the launch file describes."""
    return ViewerTopicsNode(setup, read_rig(setup.rig()), setup.chain_parameters().arm.arm())


class ViewerTopicsNode(Node):
    """Turns our own messages into `visualization_msgs`, `tf2_msgs` and points.

    Markers of hundreds of obstacles at camera rate, and frames at that of the controller, would keep a third of a core
    busy: they are made when somebody looks. Frames are left to whoever else publishes any: a robot_state_publisher has
    the arm's links under the same names, each below the one before and where the arm's own calibration has it.
    """

    def __init__(self, setup: Setup, source: RigSource, arm: ArmModel) -> None:
        super().__init__(setup.name, setup.bus, setup.clock)
        self._bus = setup.bus
        self._timers = setup.timers
        self._source = source
        self._arm = arm
        self._endpoints = setup.endpoints
        self._looked: int | None = None
        self._is_told_frames = False
        self._hears_occupancy = False

    def on_configure(self) -> None:
        self._endpoints()  # it is told of others from the first call on
        for topic in (OBSTACLE_MARKERS, OCCUPIED_POINTS, SEPARATION_MARKER):
            self._bus.advertise(topic)
        self.bus.subscribe(OBSTACLES, self._on_obstacles)
        self.bus.subscribe(SEPARATION, self._on_separation)
        self.bus.subscribe(JOINT_STATES, self._on_joints)
        self._timers.every(FRUSTA_PERIOD_S, self._publish_frusta)
        self._timers.every(LOOK_NS / 1e9, self._hear_occupancy)

    def on_activate(self) -> None:
        self._publish_frusta()

    def _publish_frusta(self) -> None:
        self.bus.publish(FRUSTA, convert.frusta_to_markers(self._source.rig, self.clock.now()))

    def _on_obstacles(self, message: Message) -> None:
        if self._bus.is_heard(OBSTACLE_MARKERS):
            self.bus.publish(OBSTACLE_MARKERS, convert.obstacles_to_markers(convert.obstacles_from_message(message)))

    def _hear_occupancy(self) -> None:
        """Once somebody looks: where nobody hears it, a twin does not even send it."""
        if not self._hears_occupancy and self._bus.is_heard(OCCUPIED_POINTS):
            self._hears_occupancy = True
            self.bus.subscribe(OCCUPANCY, self._on_occupancy)

    def _on_occupancy(self, message: Message) -> None:
        if self._bus.is_heard(OCCUPIED_POINTS):
            points = convert.occupancy_to_pointcloud2(convert.occupancy_from_message(message))
            self.bus.publish(OCCUPIED_POINTS, points)

    def _on_separation(self, message: Message) -> None:
        separation = convert.separation_from_message(message)
        self.bus.publish(SEPARATION_MARKER, convert.separation_to_marker(separation))

    def _on_joints(self, message: Message) -> None:
        if not self._bus.is_heard(TF) or self._are_frames_told():
            return
        sample = convert.joint_sample_from_message(message)
        if not set(sample.names) & set(self._arm.joint_names):
            return  # a gripper's, or an axis': they come on the same topic
        poses = forward_kinematics(self._arm, self._arm.ordered_positions(sample))
        self.bus.publish(TF, convert.links_to_tf(self._arm.link_names, poses, sample.stamp))

    def _are_frames_told(self) -> bool:
        """Whether another node publishes frames."""
        now = self.clock.now()
        if self._looked is None or abs(now - self._looked) > LOOK_NS:
            self._looked, topic = now, self._bus.resolved(TF)
            publishers = {e.node.name for e in self._endpoints() if e.topic == topic and e.kind is EntityKind.PUBLISHER}
            self._is_told_frames = bool(publishers - {self.name})
        return self._is_told_frames
