"""What viewers draw: one marker per obstacle, frusta that end where images do, transforms of links; all serialise."""

from __future__ import annotations

import numpy as np
import pytest

from twin_node.messages import convert, serialize
from twin_node.scene import ObstacleKind, Obstacles, ObstacleShape, Rig, RigCamera, Separation

STAMP = 1_700_000_000_000_000_000


def obstacles() -> Obstacles:
    return Obstacles(
        stamp=STAMP,
        ids=np.array([4, 9], np.uint32),
        kinds=np.array([ObstacleKind.MOVING, ObstacleKind.UNKNOWN], np.uint8),
        shapes=np.array([ObstacleShape.SPHERE, ObstacleShape.BOX], np.uint8),
        positions=np.array([[1.0, 2.0, 3.0], [0.0, 0.0, 1.0]]),
        quats=np.array([[1.0, 0, 0, 0], [0.0, 0, 0, 1.0]]),
        sizes=np.array([[0.5, 0.5, 0.5], [1.0, 2.0, 3.0]]),
        velocities=np.zeros((2, 3)),
        bounds=np.zeros(2),
        valid_from=np.array([STAMP, STAMP]),
        valid_to=np.array([STAMP, STAMP]),
    )


def test_every_obstacle_has_a_marker_of_its_shape_and_kind() -> None:
    message = convert.obstacles_to_markers(obstacles())
    wipe, ball, box = message.markers
    assert (wipe.action, wipe.ns) == (wipe.DELETEALL, ""), "RViz takes away those of a namespace alone, if one is named"
    assert (ball.type, ball.ns, ball.pose.position.y, ball.scale.x) == (ball.SPHERE, "moving", 2.0, 0.5)
    assert (box.type, box.ns, box.pose.orientation.z, box.scale.z) == (box.CUBE, "unknown", 1.0, 3.0)
    assert box.color.a < ball.color.a
    assert ball.header.frame_id == "base_link"
    assert len(serialize(message)) > 500


def test_frusta_pass_through_the_corners_of_the_image() -> None:
    K = np.array([[100.0, 0, 49.5], [0, 100.0, 29.5], [0, 0, 1]])
    looking_down = np.array([[1.0, 0, 0, 0.5], [0, -1, 0, 0], [0, 0, -1, 2], [0, 0, 0, 1]])
    message = convert.frusta_to_markers(Rig((RigCamera("front", 100, 60, K, looking_down),)), STAMP)
    [marker] = message.markers
    assert marker.header.frame_id == "base_link", "a driver of others gives the camera's own frame another name"
    assert (marker.pose.position.x, marker.pose.position.z, abs(marker.pose.orientation.x)) == (0.5, 2.0, 1.0)
    points = np.array([[p.x, p.y, p.z] for p in marker.points])
    assert len(points) == 16
    far = points[points[:, 2] > 0]
    pixels = far[:, :2] / far[:, 2:] * 100 + [49.5, 29.5]
    assert set(np.unique(pixels.round(6)[:, 0])) == {-0.5, 99.5}
    assert set(np.unique(pixels.round(6)[:, 1])) == {-0.5, 59.5}
    edges = [{tuple(end.round(6)) for end in edge} for edge in points.reshape(8, 2, 3)]
    corners, eye = {tuple(end) for end in far.round(6)}, (0.0, 0.0, 0.0)
    assert len(corners) == 4
    assert all({eye, corner} in edges for corner in corners)
    rim = [np.array(list(edge)) for edge in edges if eye not in edge]
    assert len(rim) == 4, "each side of the image once, and no diagonals"
    assert {tuple(np.abs(a - b).round(6)) for a, b in rim} == {(0.3, 0.0, 0.0), (0.0, 0.18, 0.0)}
    assert len({tuple(np.mean(side, axis=0).round(6)) for side in rim}) == 4
    assert len(serialize(message)) > 100


@pytest.mark.parametrize(("fraction", "text"), [(0.25, "25 %: close"), (1.0, "100 %: close")])
def test_the_decision_is_written_above_the_arm(fraction: float, text: str) -> None:
    decision = Separation(STAMP, STAMP, 1.0, 0.5, 0.1, 0.1, 0.1, 0.1, 0.1, "wrist", 1, fraction, "close")
    marker = convert.separation_to_marker(decision)
    assert marker.text == text
    assert marker.color.g == fraction
    assert (marker.lifetime.sec, marker.lifetime.nanosec) == (0, 500_000_000), "100 % stood there after the arm's node"
    assert len(serialize(marker)) > 100


def test_links_have_transforms_and_the_base_has_none() -> None:
    poses = np.stack([np.eye(4), np.eye(4)])
    poses[1, :3, 3] = [0.1, 0.2, 0.3]
    message = convert.links_to_tf(["base_link", "upper_arm_link"], poses, STAMP)
    [stamped] = message.transforms
    assert (stamped.header.frame_id, stamped.child_frame_id) == ("base_link", "upper_arm_link")
    assert stamped.transform.translation.z == 0.3
