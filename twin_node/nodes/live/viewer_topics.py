"""What Foxglove and RViz show without plugins: obstacles, what cameras see, the speed decision and the arm's frames."""

from __future__ import annotations

from twin_node.messages import Message, convert
from twin_node.nodes.live.rig_source import RigSource, read_rig
from twin_node.nodes.live.setup import Setup
from twin_node.nodes.topics import FRUSTA, JOINT_STATES, OBSTACLE_MARKERS, OBSTACLES, SEPARATION, SEPARATION_MARKER, TF
from twin_node.robot import ArmModel, forward_kinematics
from twin_node.runtime.node import Node

FRUSTA_PERIOD_S = 5.0
"""How often the frusta are sent again, for viewers that do not ask for what is latched."""


def make_viewer_topics(setup: Setup) -> Node:
    """Markers and frames of the graph that the launch file describes."""
    return ViewerTopicsNode(setup, read_rig(setup.rig()), setup.chain_parameters().arm.arm())


class ViewerTopicsNode(Node):
    """Turns our own messages into `visualization_msgs` and `tf2_msgs`.

    Markers of hundreds of obstacles at camera rate, and frames at that of the controller, would keep a third of a core
    busy: they are made when somebody looks.
    """

    def __init__(self, setup: Setup, source: RigSource, arm: ArmModel) -> None:
        super().__init__(setup.name, setup.bus, setup.clock)
        self._bus = setup.bus
        self._timers = setup.timers
        self._source = source
        self._arm = arm

    def on_configure(self) -> None:
        self.bus.subscribe(OBSTACLES, self._on_obstacles)
        self.bus.subscribe(SEPARATION, self._on_separation)
        self.bus.subscribe(JOINT_STATES, self._on_joints)
        self._timers.every(FRUSTA_PERIOD_S, self._publish_frusta)

    def on_activate(self) -> None:
        self._publish_frusta()

    def _publish_frusta(self) -> None:
        self.bus.publish(FRUSTA, convert.frusta_to_markers(self._source.rig, self.clock.now()))

    def _on_obstacles(self, message: Message) -> None:
        if self._bus.is_heard(OBSTACLE_MARKERS):
            self.bus.publish(OBSTACLE_MARKERS, convert.obstacles_to_markers(convert.obstacles_from_message(message)))

    def _on_separation(self, message: Message) -> None:
        separation = convert.separation_from_message(message)
        self.bus.publish(SEPARATION_MARKER, convert.separation_to_marker(separation))

    def _on_joints(self, message: Message) -> None:
        if not self._bus.is_heard(TF):
            return
        sample = convert.joint_sample_from_message(message)
        if not set(sample.names) & set(self._arm.joint_names):
            return  # a gripper's, or an axis': they come on the same topic
        poses = forward_kinematics(self._arm, self._arm.ordered_positions(sample))
        self.bus.publish(TF, convert.links_to_tf(self._arm.link_names, poses, sample.stamp))
